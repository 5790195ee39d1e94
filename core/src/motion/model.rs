//! The straight track in the three numbers that bearings can see, and speed.
//!
//! In: parameters, a time of reception. Out: the expected azimuth and elevation there, their derivatives, and the
//! vessel's position. `α(t) = α_c + s·atan(|q| u)`, `s = ±1` the sense of turning, `|q| = v/r_c`, `u = t_e − t_c` the
//! time of *emission* from the closest point of approach (CPA). Scaling range and speed together leaves every
//! bearing unchanged [M 5, 6], so `v` is a parameter of its own that only a prior or elevations can fix.
//!
//! Time of emission: `t − t_e = √(r² + h²)/c` with `r² = r_c² + v²u²` is a quadratic in `u`, solved in closed form.
//! Assumes constant speed and heading and a constant height `h` of the vessel above the array. Cost: one `atan`,
//! one `sqrt`, three `exp`-free dozens of multiplications.

use crate::angle::wrap_pi;
use crate::math::f64 as m;

/// Number of parameters: bearing and time of CPA, ln|q|, ln v, elevation bias.
pub const PARAMETERS: usize = 5;

/// What the propagation and the geometry around the vessel are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Medium {
    /// One over the speed of sound, s/m; 0 leaves the travel time out.
    pub slowness_s_m: f64,
    /// Height of the vessel above the array, metres; used with elevations only (0 where unknown).
    pub height_m: f64,
}

impl Medium {
    /// Travel time at this speed of sound (infinite: none), no elevations.
    pub fn of_sound_speed(sound_speed_m_s: f64) -> Self {
        Self { slowness_s_m: if sound_speed_m_s > 1.0 { 1.0 / sound_speed_m_s } else { 0.0 }, height_m: 0.0 }
    }
}

/// A straight track. `ln` quantities keep `|q|` and `v` positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// `[α_c rad, t_c s, ln(|q| s), ln(v s/m), elevation bias rad]`.
    pub p: [f64; PARAMETERS],
    /// +1 if the bearing turns clockwise (the array lies to starboard), −1 if anticlockwise (to port).
    pub sense: f64,
}

/// Expected angles at a time of reception, with derivatives by the parameters.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Azimuth, radians, not wrapped.
    pub azimuth: f64,
    /// Its derivatives.
    pub d_azimuth: [f64; PARAMETERS],
    /// Its second derivative by time, rad/s² (travel time left out).
    pub curvature: f64,
    /// Elevation with bias, radians (0 where the height is 0).
    pub elevation: f64,
    /// Its derivatives.
    pub d_elevation: [f64; PARAMETERS],
}

impl Line {
    /// Range of the closest point, metres.
    pub fn cpa_range_m(&self) -> f64 {
        m::exp(self.p[3] - self.p[2])
    }

    /// Speed, m/s.
    pub fn speed_m_s(&self) -> f64 {
        m::exp(self.p[3])
    }

    /// Heading, radians clockwise from North, [0, 2π).
    pub fn heading_rad(&self) -> f64 {
        crate::angle::wrap_tau(self.p[0] + self.sense * m::FRAC_PI_2)
    }

    /// Azimuth alone at a time of reception; radians, not wrapped.
    pub fn azimuth(&self, medium: &Medium, t_s: f64) -> f64 {
        self.expected(medium, t_s).azimuth
    }

    /// Angles expected at time of reception `t_s`, and derivatives.
    pub fn expected(&self, medium: &Medium, t_s: f64) -> Expected {
        self.view(medium).expected(t_s)
    }

    /// What all times of one fit share.
    pub fn view(&self, medium: &Medium) -> View {
        let q = m::exp(self.p[2]);
        let v = m::exp(self.p[3]);
        let r_c = v / q;
        let slowness2 = medium.slowness_s_m * medium.slowness_s_m;
        let height2 = medium.height_m * medium.height_m;
        let mach2 = v * v * slowness2;
        let rc2 = r_c * r_c * slowness2;
        View { line: *self, q, r_c, mach2, rc2, rho2: rc2 + height2 * slowness2, height_m: medium.height_m }
    }

    /// East and North of the array at the vessel's own time `t_s`, metres, and their derivatives by the parameters.
    pub fn position(&self, t_s: f64) -> ([f64; 2], [[f64; PARAMETERS]; 2]) {
        let v = self.speed_m_s();
        let r_c = self.cpa_range_m();
        let (sa, ca) = m::sin_cos(self.p[0]);
        let along = v * (t_s - self.p[1]);
        let e = [self.sense * ca, -self.sense * sa];
        let x = r_c * sa + along * e[0];
        let y = r_c * ca + along * e[1];
        (
            [x, y],
            [
                [y, -v * e[0], -r_c * sa, r_c * sa + along * e[0], 0.0],
                [-x, -v * e[1], -r_c * ca, r_c * ca + along * e[1], 0.0],
            ],
        )
    }

    /// The line with the same bearings' geometry, parameters moved by `step` and brought back into `limits`.
    pub fn moved(&self, step: &[f64; PARAMETERS], limits: &Limits) -> Self {
        let mut p = self.p;
        for (a, d) in p.iter_mut().zip(step) {
            *a += d;
        }
        p[3] = p[3].max(limits.ln_speed.0).min(limits.ln_speed.1);
        let reach = limits.range_m.1 / m::exp(p[3]);
        p[1] = p[1].max(limits.times_s.0 - reach).min(limits.times_s.1 + reach);
        p[2] = p[2].max(p[3] - m::ln(limits.range_m.1)).min(p[3] - m::ln(limits.range_m.0));
        p[0] = wrap_pi(p[0]);
        Self { p, sense: self.sense }
    }

    /// Whether the closest range stands at the near (−1) or the far (+1) limit, or between (0).
    pub fn at_limit(&self, limits: &Limits) -> i8 {
        let r = self.cpa_range_m();
        if r >= limits.range_m.1 * (1.0 - 1e-6) {
            1
        } else if r <= limits.range_m.0 * (1.0 + 1e-6) {
            -1
        } else {
            0
        }
    }
}

/// A line seen through a medium, its exponentials taken once.
#[derive(Clone, Copy, Debug)]
pub struct View {
    line: Line,
    q: f64,
    r_c: f64,
    mach2: f64,
    rc2: f64,
    rho2: f64,
    height_m: f64,
}

impl View {
    /// Angles expected at time of reception `t_s`, and derivatives.
    pub fn expected(&self, t_s: f64) -> Expected {
        let Self { line, q, r_c, mach2, rc2, rho2, height_m } = *self;
        let s = t_s - line.p[1];
        // Emission time u and its derivatives by s, ln|q| and ln v.
        let one = 1.0 - mach2;
        let root = m::sqrt(mach2 * s * s + one * rho2);
        let (u, du_ds, du_dlnq, du_dlnv) = if root > 1e-12 {
            let u = (s - root) / one;
            let d_root = (mach2 * s * s - mach2 * rho2 + one * rc2) / root;
            (u, (1.0 - mach2 * s / root) / one, rc2 / root, (-d_root + (s - root) * 2.0 * mach2 / one) / one)
        } else {
            (s, 1.0, 0.0, 0.0)
        };
        let x = q * u;
        let g = 1.0 / (1.0 + x * x);
        let dx = [0.0, -q * du_ds, x + q * du_dlnq, q * du_dlnv, 0.0];
        let turn = line.sense * g;
        let mut d_azimuth = [1.0, turn * dx[1], turn * dx[2], turn * dx[3], 0.0];
        // A parameter far outside its scale must not poison the fit.
        for d in &mut d_azimuth {
            if !d.is_finite() {
                *d = 0.0;
            }
        }
        let azimuth = line.p[0] + line.sense * m::atan(x);
        let (mut elevation, mut d_elevation) = (0.0, [0.0; PARAMETERS]);
        if height_m > 0.0 {
            let r = r_c * m::sqrt(1.0 + x * x);
            elevation = m::atan2(height_m, r) + line.p[4];
            let by_ln_r = -height_m * r / (r * r + height_m * height_m);
            let xg = x * g;
            d_elevation =
                [0.0, by_ln_r * xg * dx[1], by_ln_r * (xg * dx[2] - 1.0), by_ln_r * (xg * dx[3] + 1.0), 1.0];
        }
        let curvature = -2.0 * line.sense * q * q * x * g * g;
        Expected { azimuth, d_azimuth, curvature, elevation, d_elevation }
    }
}

/// Where the parameters are searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Nearest and farthest closest-point range, metres.
    pub range_m: (f64, f64),
    /// Logarithms of the least and greatest speed (m/s).
    pub ln_speed: (f64, f64),
    /// First and last time of the bearings; CPA lies at most `range_m.1 / v` outside.
    pub times_s: (f64, f64),
}

/// Least and greatest speed any fit considers, m/s: from a drifting hull to the fastest ferry.
pub const SPEEDS_M_S: (f64, f64) = (0.2, 40.0);
/// Their logarithms.
pub const LN_SPEED: (f64, f64) = (-1.609_437_912_434_1, 3.688_879_454_113_94);

#[cfg(test)]
mod tests {
    use super::*;

    fn line(sense: f64) -> Line {
        Line { p: [0.8, 12.0, m::ln(7.0 / 300.0), m::ln(7.0), 0.01], sense }
    }

    #[test]
    fn received_azimuth_is_that_of_the_emission() {
        let medium = Medium { slowness_s_m: 1.0 / 1484.0, height_m: 150.0 };
        for sense in [1.0, -1.0] {
            let l = line(sense);
            for t in [-80.0, 3.0, 12.0, 95.0] {
                // Fixed-point iteration of the travel time, from positions alone.
                let mut te = t;
                for _ in 0..50 {
                    let ([x, y], _) = l.position(te);
                    te = t - m::sqrt(x * x + y * y + 150.0 * 150.0) / 1484.0;
                }
                let ([x, y], _) = l.position(te);
                let e = l.expected(&medium, t);
                assert!(wrap_pi(e.azimuth - m::atan2(x, y)).abs() < 1e-9);
                let second =
                    (l.azimuth(&medium, t + 0.1) + l.azimuth(&medium, t - 0.1) - 2.0 * e.azimuth) / 0.01;
                assert!((second - e.curvature).abs() < 1e-5, "{second} {e:?}");
                assert!((e.elevation - 0.01 - m::atan2(150.0, m::hypot(x, y))).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let medium = Medium { slowness_s_m: 1.0 / 400.0, height_m: 150.0 };
        for sense in [1.0, -1.0] {
            let l = line(sense);
            for t in [-60.0, 10.0, 40.0] {
                let e = l.expected(&medium, t);
                let (_, dp) = l.position(t);
                for k in 0..PARAMETERS {
                    let h = 1e-6;
                    let (mut a, mut b) = (l, l);
                    a.p[k] += h;
                    b.p[k] -= h;
                    let (ea, eb) = (a.expected(&medium, t), b.expected(&medium, t));
                    assert!(((ea.azimuth - eb.azimuth) / (2.0 * h) - e.d_azimuth[k]).abs() < 1e-6);
                    assert!(((ea.elevation - eb.elevation) / (2.0 * h) - e.d_elevation[k]).abs() < 1e-6);
                    let (pa, pb) = (a.position(t).0, b.position(t).0);
                    for i in 0..2 {
                        let d = (pa[i] - pb[i]) / (2.0 * h);
                        assert!((d - dp[i][k]).abs() < 1e-4 * (1.0 + d.abs()));
                    }
                }
            }
        }
    }
}
