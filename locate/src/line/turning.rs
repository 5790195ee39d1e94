//! A source that turns while the covariance averages.
//!
//! It fills a second eigenvalue: for a spread σ_ω of its phase,
//! `λ₂ ≈ P σ_ω² h₁` with its power P. How loud it was when decides where in that spread it is found, so that `κ σ_ω²/N'` comes to
//! the variance: κ the relative variance of its power over the snapshots (0 of a steady tone, 1 of noise), N' as many snapshots as its
//! loudness is new in ([`LASTING`]).

use super::MAX_SENSORS;
use super::complex::Complex;
use super::hermitian::HermitianMatrix;

/// Successive snapshots that a source's loudness is taken to last for: that of a tone of a machine has the width of a transform or
/// less, so that neighbours have about half of it in common.
pub(super) const LASTING: f64 = 2.0;

/// Mean and mean square of what is finite over snapshots.
pub(super) fn moments(
    snapshots: &[[Complex; MAX_SENSORS]],
    of: impl Fn(&[Complex; MAX_SENSORS]) -> f64,
) -> (f64, f64) {
    let (mut n, mut sum, mut squares) = (0.0f64, 0.0, 0.0);
    for x in snapshots.iter().map(of).filter(|x| x.is_finite()) {
        n += 1.0;
        sum += x;
        squares += x * x;
    }
    (sum / n.max(1.0), squares / n.max(1.0))
}

/// Variance over the square of the mean; 0 of nothing.
pub(super) fn relative_variance((mean, square): (f64, f64)) -> f64 {
    if mean > 0.0 { (square / (mean * mean) - 1.0).max(0.0) } else { 0.0 }
}

/// How far the largest of the other eigenvalues stands out from the next, which noise alone makes about as large.
pub(super) fn excess(values: &HermitianMatrix, length: usize, signal: &[bool; MAX_SENSORS]) -> f64 {
    let (mut first, mut second) = (0.0f64, 0.0f64);
    for (k, (row, _)) in values.iter().zip(signal).enumerate().take(length).filter(|(_, (_, s))| !**s) {
        let value = row.get(k).map_or(0.0, |x| x.re);
        (first, second) = if value > first { (value, first) } else { (first, second.max(value)) };
    }
    first - second
}
