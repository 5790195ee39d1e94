//! Normal equations of a weighted least-squares problem, the damped step over them, and the covariance they leave.
//!
//! In: rows `∂h/∂θ` with a residual `y − h(θ)` and a weight `1/σ²`, made white beforehand. Out: information
//! `H = JᵀC⁻¹J`, gradient `g = JᵀC⁻¹r`, cost `rᵀC⁻¹r`. Parameters that are not free keep their value and have zero covariance.

use super::spd::{self, Factor, Square};
use crate::math::f64 as m;

/// Accumulated products of whitened rows.
#[derive(Clone, Copy, Debug)]
pub struct Normal<const N: usize> {
    /// `H`, upper triangle only.
    pub upper: Square<N>,
    /// `g`: points downhill.
    pub gradient: [f64; N],
    /// Weighted sum of squared residuals, priors included.
    cost: f64,
    /// Prediction-error variances: the sum of logarithms, and the product of those whose logarithm is yet to be taken.
    ln_variances: f64,
    variances: f64,
}

impl<const N: usize> Default for Normal<N> {
    fn default() -> Self {
        Self { upper: [[0.0; N]; N], gradient: [0.0; N], cost: 0.0, ln_variances: 0.0, variances: 1.0 }
    }
}

impl<const N: usize> Normal<N> {
    /// Adds a measurement whose error has variance `1 / weight`.
    #[inline]
    pub fn observe(&mut self, derivatives: &[f64; N], residual: f64, weight: f64) {
        self.observe_at_cost(derivatives, residual, weight, weight * residual * residual);
    }

    /// The same where the measurement's part of the cost is not its weighted square: twice a robust loss.
    #[inline]
    pub fn observe_at_cost(&mut self, derivatives: &[f64; N], residual: f64, weight: f64, cost: f64) {
        for i in 0..N {
            let wi = weight * derivatives[i];
            for j in i..N {
                self.upper[i][j] += wi * derivatives[j];
            }
            self.gradient[i] += wi * residual;
        }
        self.cost += cost;
    }

    /// Adds what another set of measurements of the same parameters says.
    pub fn join(&mut self, other: &Self) {
        for (a, b) in self.upper.iter_mut().flatten().zip(other.upper.iter().flatten()) {
            *a += b;
        }
        for (a, b) in self.gradient.iter_mut().zip(&other.gradient) {
            *a += b;
        }
        self.cost += other.cost;
        self.ln_variances += other.ln_variances;
        self.note(other.variances);
    }

    /// Holds a parameter where it is: no step, and none of its correlation with the others.
    pub fn hold(&mut self, parameter: usize) {
        for i in 0..N {
            for j in i..N {
                if i == parameter || j == parameter {
                    self.upper[i][j] = f64::from(u8::from(i == j));
                }
            }
            if i == parameter {
                self.gradient[i] = 0.0;
            }
        }
    }

    /// Notes the prediction-error variance of a row. Logarithms are dear: one is taken for many rows.
    pub fn note(&mut self, variance: f64) {
        self.variances *= variance;
        if !(1e-150..1e150).contains(&self.variances) {
            self.ln_variances += m::ln(self.variances);
            self.variances = 1.0;
        }
    }

    /// Sum of the logarithms of the prediction-error variances noted, `ln det C`.
    pub fn ln_det(&self) -> f64 {
        self.ln_variances + m::ln(self.variances)
    }

    /// Weighted sum of squared residuals (or twice the robust loss), priors included.
    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// Whether every element is finite.
    pub fn is_finite(&self) -> bool {
        let products = self.upper.iter().flatten().chain(&self.gradient);
        self.cost.is_finite() && products.copied().all(f64::is_finite)
    }

    /// The step `(H + damping·diag H)⁻¹ g` over the free parameters, `None` where the matrix has no factor.
    pub fn step(&self, free: &[bool; N], damping: f64) -> Option<[f64; N]> {
        let mut h = self.information(free);
        let mut g = [0.0; N];
        for i in 0..N {
            if free[i] {
                h[i][i] += damping * h[i][i] + 1e-300;
                g[i] = self.gradient[i];
            }
        }
        spd::solve(&h, &g)
    }

    /// The undamped step of all parameters; `None` where the measurements do not determine them.
    pub fn solution(&self) -> Option<[f64; N]> {
        spd::solve(&self.information(&[true; N]), &self.gradient)
    }

    /// Fall of the cost that the linear model promises for a step, damping aside.
    pub fn fall(&self, step: &[f64; N]) -> f64 {
        spd::dot(step, &self.gradient)
    }

    /// Information matrix with unit rows at parameters that are not free.
    pub fn information(&self, free: &[bool; N]) -> Square<N> {
        let mut h = [[0.0; N]; N];
        for i in 0..N {
            for j in i..N {
                if free[i] && free[j] {
                    h[i][j] = self.upper[i][j];
                    h[j][i] = self.upper[i][j];
                }
            }
            if !free[i] {
                h[i][i] = 1.0;
            }
        }
        h
    }

    /// Covariance of the estimate: inverse information plus `floor` (a least information for each parameter, so that
    /// what the data leave open has a finite spread). Zero rows for parameters that are not free.
    pub fn covariance(&self, free: &[bool; N], floor: &[f64; N]) -> Option<Square<N>> {
        let mut h = self.information(free);
        for i in 0..N {
            if free[i] {
                h[i][i] += floor[i];
            }
        }
        let mut c = Factor::new(&h)?.inverse();
        for i in 0..N {
            if !free[i] {
                c[i][i] = 0.0;
            }
        }
        Some(c)
    }
}

/// Least squares of rows `a · x = b`; `None` where they do not determine x.
pub fn least_squares<const N: usize>(rows: impl Iterator<Item = ([f64; N], f64)>) -> Option<[f64; N]> {
    let mut normal = Normal::default();
    for (row, value) in rows {
        normal.observe(&row, value, 1.0);
    }
    normal.solution()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_problems_are_solved_in_one_step() {
        let truth = [2.0, -3.0, 0.5];
        let rows = (0..9).map(|k| {
            let t = f64::from(k);
            let row = [1.0, t, t * t];
            (row, spd::dot(&row, &truth))
        });
        let found = least_squares(rows).unwrap();
        assert!(found.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 1e-10), "{found:?}");
        assert_eq!(least_squares((0..9).map(|_| ([1.0, 2.0], 3.0))), None);
        assert_eq!(least_squares((0..9).map(|_| ([1.0, 0.0], 3.0))), None);
    }

    #[test]
    fn held_parameters_stay_and_do_not_pull() {
        let mut normal = Normal::<2>::default();
        normal.observe(&[1.0, 0.5], 3.0, 4.0);
        normal.observe(&[0.0, 1.0], 1.0, 1.0);
        assert!((normal.cost() - 37.0).abs() < 1e-12);
        let by_mask = normal.step(&[true, false], 0.0).unwrap();
        let covariance = normal.covariance(&[true, false], &[0.0; 2]).unwrap();
        normal.hold(1);
        let held = normal.step(&[true; 2], 0.0).unwrap();
        assert_eq!((by_mask, held), ([3.0, 0.0], [3.0, 0.0]));
        assert_eq!(covariance, [[0.25, 0.0], [0.0, 0.0]]);
    }

    #[test]
    fn two_halves_join_to_the_whole() {
        let row = |k: i32| ([f64::from(k), 1.0 / f64::from(k)], 0.3 * f64::from(k));
        let (mut whole, mut first, mut second) =
            (Normal::<2>::default(), Normal::default(), Normal::default());
        for k in 1..9 {
            let (j, r) = row(k);
            let half = if k < 5 { &mut first } else { &mut second };
            for normal in [half, &mut whole] {
                normal.observe(&j, r, 2.0);
                normal.note(1e-40);
            }
        }
        first.join(&second);
        assert!((first.cost() - whole.cost()).abs() < 1e-12 * whole.cost());
        assert!((first.ln_det() - whole.ln_det()).abs() < 1e-9);
        let (a, b) = (first.step(&[true; 2], 0.0).unwrap(), whole.step(&[true; 2], 0.0).unwrap());
        assert!(a.iter().zip(&b).all(|(x, y)| (x - y).abs() < 1e-12));
    }
}
