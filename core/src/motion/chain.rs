//! Whitening of first-order Gauss-Markov errors, one sample at a time, for any times.
//!
//! In: rows with errors `white + coloured`, the coloured part `σ²e^{−|Δt|/τ}`, also for rows that are averages of
//! several samples. Out: normal equations, and the prediction of the coloured error at a later time. The covariance of
//! (averages of) such errors has the form `cov_ij = a_i b_j e^{−(t_j−t_i)/τ}` for i < j, `v_i + w_i` on the diagonal,
//! which a Kalman-like recursion with one number of state factorises exactly. Cost: one `exp` and a few dozen
//! multiplications a row, no storage.

use super::normal::{COLUMNS, Normal};
use crate::math::f64 as m;

/// Error of one (averaged) bearing, in units of the coloured variance except `white`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour {
    /// Factor towards later rows: `Σ w_k e^{(t_k − t)/τ}` over the averaged samples.
    pub later: f64,
    /// Factor towards earlier rows: `Σ w_k e^{−(t_k − t)/τ}`.
    pub earlier: f64,
    /// Coloured variance of the average itself.
    pub own: f64,
    /// White variance, rad².
    pub white: f64,
}

impl Colour {
    /// One bearing with coloured error of `scale` times the common standard deviation and a white part.
    pub fn single(scale: f64, white: f64) -> Self {
        Self { later: scale, earlier: scale, own: scale * scale, white }
    }
}

/// The running factorisation.
#[derive(Clone, Copy, Debug)]
pub struct Chain {
    variance: f64,
    rate_hz: f64,
    state: [f64; COLUMNS],
    explained: f64,
    last_t_s: Option<f64>,
    // Decay over the last step: most records are regular, and `exp` is the dearest part.
    decay: (f64, f64),
    /// What has been accumulated.
    pub normal: Normal,
}

impl Chain {
    /// Coloured variance (rad²) and correlation time (s; 0 or less: no coloured part).
    pub fn new(variance: f64, tau_s: f64) -> Self {
        let on = tau_s > 0.0 && variance > 0.0;
        Self {
            variance: if on { variance } else { 0.0 },
            rate_hz: if on { 1.0 / tau_s } else { 0.0 },
            state: [0.0; COLUMNS],
            explained: 0.0,
            last_t_s: None,
            decay: (0.0, 1.0),
            normal: Normal::default(),
        }
    }

    /// Adds the row of time `t_s` (not before the last one).
    pub fn push(&mut self, t_s: f64, colour: &Colour, row: &[f64; COLUMNS]) {
        let decay = if self.variance > 0.0 { self.decay(t_s) } else { 0.0 };
        self.push_after(decay, colour, row);
    }

    /// Adds a row whose time has passed `decay`, `e^{−Δt/τ}`, since the row before (whatever it is for the first).
    pub fn push_after(&mut self, decay: f64, colour: &Colour, row: &[f64; COLUMNS]) {
        if self.variance == 0.0 {
            if colour.white > 0.0 {
                self.normal.add(row, 1.0 / colour.white);
                self.normal.note(colour.white);
            }
            return;
        }
        for s in &mut self.state {
            *s *= decay;
        }
        self.explained *= decay * decay;
        let total = self.variance * colour.own + colour.white;
        let f = total - self.variance * colour.earlier * colour.earlier * self.explained;
        // Coincident coloured rows without white error say the same twice: the second adds nothing.
        if f.is_nan() || f <= 1e-12 * total {
            return;
        }
        let mut z = *row;
        for (z, s) in z.iter_mut().zip(&self.state) {
            *z -= colour.earlier * s;
        }
        let gain = self.variance * (colour.later - colour.earlier * self.explained) / f;
        for (s, z) in self.state.iter_mut().zip(&z) {
            *s += gain * z;
        }
        self.explained += gain * gain * f / self.variance;
        self.normal.add(&z, 1.0 / f);
        self.normal.note(f);
    }

    /// Decay since the last row's time.
    fn decay(&mut self, t_s: f64) -> f64 {
        let step = self.last_t_s.map_or(0.0, |last| (t_s - last).max(0.0));
        self.last_t_s = Some(t_s);
        if step != self.decay.0 {
            self.decay = (step, m::exp(-step * self.rate_hz));
        }
        self.decay.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equals_the_dense_quadratic_form() {
        // Three irregular times, unequal scales and white parts: r^T C^-1 r by Cramer's rule.
        let (t, s, w, r) = ([0.0f64, 0.7, 3.0], [1.0, 2.0, 0.5], [0.1, 0.0, 0.3], [0.4, -1.0, 0.7]);
        let (var, tau) = (0.8, 2.0);
        let mut c = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                c[i][j] = var * s[i] * s[j] * m::exp(-(t[i] - t[j]).abs() / tau);
            }
            c[i][i] += w[i];
        }
        let det = |c: &[[f64; 3]; 3]| {
            c[0][0] * (c[1][1] * c[2][2] - c[1][2] * c[2][1])
                - c[0][1] * (c[1][0] * c[2][2] - c[1][2] * c[2][0])
                + c[0][2] * (c[1][0] * c[2][1] - c[1][1] * c[2][0])
        };
        let d = det(&c);
        let mut form = 0.0;
        for k in 0..3 {
            let mut ck = c;
            for i in 0..3 {
                ck[i][k] = r[i];
            }
            form += r[k] * det(&ck) / d;
        }
        let mut chain = Chain::new(var, tau);
        for i in 0..3 {
            let mut row = [0.0; COLUMNS];
            row[COLUMNS - 1] = r[i];
            chain.push(t[i], &Colour::single(s[i], w[i]), &row);
        }
        assert!((chain.normal.cost() - form).abs() < 1e-12, "{} {form}", chain.normal.cost());
        assert!((chain.normal.ln_det() - m::ln(d)).abs() < 1e-12);
    }
}
