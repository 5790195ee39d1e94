//! Normal equations of a small weighted least-squares problem, and the damped Gauss-Newton step over them.
//!
//! In: whitened rows `[∂h/∂θ | y − h]`. Out: information `H = JᵀC⁻¹J`, gradient, cost; steps; covariance. Parameters
//! that are not free keep their value and have zero covariance.

use super::model::{Limits, Line, PARAMETERS};
use crate::math::f64 as m;

/// Columns of a row: derivatives by the parameters, then the residual.
pub const COLUMNS: usize = PARAMETERS + 1;

/// Symmetric matrix of the parameters.
pub type Matrix = [[f64; PARAMETERS]; PARAMETERS];

/// Accumulated products of whitened rows.
#[derive(Clone, Copy, Debug)]
pub struct Normal {
    /// Upper triangle of the Gram matrix; the last column holds `JᵀC⁻¹r`, its last element the cost `rᵀC⁻¹r`.
    pub gram: [[f64; COLUMNS]; COLUMNS],
    /// Prediction-error variances: the sum of logarithms, and the product of those whose logarithm is yet to be taken.
    ln_variances: f64,
    variances: f64,
}

impl Default for Normal {
    fn default() -> Self {
        Self { gram: [[0.0; COLUMNS]; COLUMNS], ln_variances: 0.0, variances: 1.0 }
    }
}

impl Normal {
    /// Adds a row whose error has been made white with variance `1 / weight`.
    pub fn add(&mut self, row: &[f64; COLUMNS], weight: f64) {
        for i in 0..COLUMNS {
            let wi = weight * row[i];
            for j in i..COLUMNS {
                self.gram[i][j] += wi * row[j];
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

    /// Weighted sum of squared residuals, priors included.
    pub fn cost(&self) -> f64 {
        self.gram[PARAMETERS][PARAMETERS]
    }

    /// Whether every element is finite.
    pub fn is_finite(&self) -> bool {
        self.gram.iter().flatten().all(|x| x.is_finite())
    }

    /// The step `(H + damping·diag H)⁻¹ g` over the free parameters, `None` where the matrix has no factor.
    pub fn step(&self, free: &[bool; PARAMETERS], damping: f64) -> Option<[f64; PARAMETERS]> {
        let mut h = self.information(free);
        let mut g = [0.0; PARAMETERS];
        for i in 0..PARAMETERS {
            if free[i] {
                h[i][i] += damping * h[i][i] + 1e-300;
                g[i] = self.gram[i][PARAMETERS];
            }
        }
        let l = cholesky(&h)?;
        Some(solve(&l, &g))
    }

    /// Fall of the cost that the linear model promises for a step.
    fn fall(&self, step: &[f64; PARAMETERS]) -> f64 {
        step.iter().zip(&self.gram).map(|(x, row)| x * row[PARAMETERS]).sum()
    }

    /// Information matrix with unit rows at parameters that are not free.
    pub fn information(&self, free: &[bool; PARAMETERS]) -> Matrix {
        let mut h = [[0.0; PARAMETERS]; PARAMETERS];
        for i in 0..PARAMETERS {
            for j in i..PARAMETERS {
                if free[i] && free[j] {
                    h[i][j] = self.gram[i][j];
                    h[j][i] = self.gram[i][j];
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
    pub fn covariance(&self, free: &[bool; PARAMETERS], floor: &[f64; PARAMETERS]) -> Option<Matrix> {
        let mut h = self.information(free);
        for i in 0..PARAMETERS {
            if free[i] {
                h[i][i] += floor[i];
            }
        }
        let mut c = inverse(&h)?;
        for i in 0..PARAMETERS {
            if !free[i] {
                c[i][i] = 0.0;
            }
        }
        Some(c)
    }
}

/// Lower Cholesky factor of a symmetric matrix after scaling to a unit diagonal; the scale is kept in the second part.
pub type Factor = (Matrix, [f64; PARAMETERS]);

/// Factorises `a`; `None` if it is not positive definite to working precision.
pub fn cholesky(a: &Matrix) -> Option<Factor> {
    let mut scale = [0.0; PARAMETERS];
    for i in 0..PARAMETERS {
        if a[i][i].is_nan() || a[i][i] <= 0.0 || !a[i][i].is_finite() {
            return None;
        }
        scale[i] = 1.0 / m::sqrt(a[i][i]);
    }
    let mut l = [[0.0; PARAMETERS]; PARAMETERS];
    for i in 0..PARAMETERS {
        for j in 0..=i {
            let mut sum = a[i][j] * scale[i] * scale[j];
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            if i == j {
                if sum.is_nan() || sum < 1e-14 {
                    return None;
                }
                l[i][i] = m::sqrt(sum);
            } else {
                l[i][j] = sum / l[j][j];
            }
        }
    }
    Some((l, scale))
}

/// Solves `a x = b` from the factor of `a`.
pub fn solve((l, scale): &Factor, b: &[f64; PARAMETERS]) -> [f64; PARAMETERS] {
    let mut x = [0.0; PARAMETERS];
    for i in 0..PARAMETERS {
        let mut sum = b[i] * scale[i];
        for k in 0..i {
            sum -= l[i][k] * x[k];
        }
        x[i] = sum / l[i][i];
    }
    for i in (0..PARAMETERS).rev() {
        let mut sum = x[i];
        for k in i + 1..PARAMETERS {
            sum -= l[k][i] * x[k];
        }
        x[i] = sum / l[i][i];
    }
    for i in 0..PARAMETERS {
        x[i] *= scale[i];
    }
    x
}

/// Inverse of a symmetric positive definite matrix.
pub fn inverse(a: &Matrix) -> Option<Matrix> {
    let factor = cholesky(a)?;
    let mut out = [[0.0; PARAMETERS]; PARAMETERS];
    for j in 0..PARAMETERS {
        let mut unit = [0.0; PARAMETERS];
        unit[j] = 1.0;
        let column = solve(&factor, &unit);
        for i in 0..PARAMETERS {
            out[i][j] = column[i];
        }
    }
    Some(out)
}

/// `aᵀ M b` of two gradient vectors: the covariance of two linear functions of the parameters.
pub fn quadratic(a: &[f64; PARAMETERS], c: &Matrix, b: &[f64; PARAMETERS]) -> f64 {
    let mut sum = 0.0;
    for i in 0..PARAMETERS {
        for j in 0..PARAMETERS {
            sum += a[i] * c[i][j] * b[j];
        }
    }
    sum
}

/// A point of the descent.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// Parameters.
    pub line: Line,
    /// Normal equations there.
    pub normal: Normal,
    /// Damping that last worked.
    pub damping: f64,
}

/// Largest damping tried before a descent counts as finished.
const DAMPING_MAX: f64 = 1e8;

/// Fall of the cost that is not worth an evaluation: a ten-thousandth of a standard deviation in every parameter.
const LEAST_FALL: f64 = 1e-8;

/// What a call of [`descend`] came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Cost went down; another step may help.
    Moved,
    /// The cost changed by less than 1e-7 or would change by less than 1e-8, or no damping lowers it.
    Converged,
}

/// One damped Gauss-Newton step: `evaluate` gives the normal equations at a line.
pub fn descend(
    point: &mut Point,
    free: &[bool; PARAMETERS],
    limits: &Limits,
    mut evaluate: impl FnMut(&Line) -> Option<Normal>,
) -> Progress {
    let cost = point.normal.cost();
    while point.damping < DAMPING_MAX {
        if let Some(step) = point.normal.step(free, point.damping) {
            if point.normal.fall(&step) < LEAST_FALL {
                break;
            }
            let trial = point.line.moved(&bounded(&step), limits);
            if let Some(normal) = evaluate(&trial).filter(|n| n.is_finite() && n.cost() <= cost) {
                let fall = cost - normal.cost();
                *point = Point { line: trial, normal, damping: (point.damping * 0.1).max(1e-9) };
                return if fall < 1e-7 { Progress::Converged } else { Progress::Moved };
            }
        }
        point.damping = (point.damping * 10.0).max(1e-6);
    }
    point.damping = 1e-3;
    Progress::Converged
}

/// A step no longer than one radian in bearing and a factor e in `|q|` and `v`, direction kept.
fn bounded(step: &[f64; PARAMETERS]) -> [f64; PARAMETERS] {
    let longest = step[0].abs().max(step[2].abs()).max(step[3].abs()).max(step[4].abs());
    let scale = if longest > 1.0 { 1.0 / longest } else { 1.0 };
    step.map(|x| x * scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_of_a_badly_scaled_matrix() {
        let mut a = [[0.0; PARAMETERS]; PARAMETERS];
        for i in 0..PARAMETERS {
            for j in 0..PARAMETERS {
                let s = m::powf(10.0, (i + j) as f64 - 4.0);
                a[i][j] = s * if i == j { 2.0 } else { 0.5 };
            }
        }
        let b = inverse(&a).unwrap();
        for i in 0..PARAMETERS {
            for j in 0..PARAMETERS {
                let p: f64 = (0..PARAMETERS).map(|k| a[i][k] * b[k][j]).sum();
                let s = m::powf(10.0, i as f64 - j as f64);
                assert!((p - if i == j { 1.0 } else { 0.0 }).abs() < 1e-12 * s.max(1.0));
            }
        }
        a[4] = a[3];
        for r in &mut a {
            r[4] = r[3];
        }
        assert!(inverse(&a).is_none());
    }
}
