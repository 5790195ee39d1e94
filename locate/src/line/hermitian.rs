//! Eigenvalues and eigenvectors of a Hermitian matrix, by `nalgebra` (tridiagonal form, then implicit QR), in fixed memory.

use super::MAX_SENSORS;
use super::complex::Complex;
use crate::math::f64 as m;
use nalgebra::{SMatrix, SymmetricEigen};

/// A square matrix; only the leading n×n part is used.
pub type HermitianMatrix = [[Complex; MAX_SENSORS]; MAX_SENSORS];

/// Most iterations; about two a row are usual.
const ITERATIONS: usize = 30 * MAX_SENSORS;

/// Diagonalises the leading n×n part of `a` (destroyed: eigenvalues stay on its diagonal); columns of `vectors` become
/// the eigenvectors. Returns whether it converged; a matrix that is not finite does not.
pub fn eigen(a: &mut HermitianMatrix, n: usize, vectors: &mut HermitianMatrix) -> bool {
    let n = n.min(MAX_SENSORS);
    let leading = a.iter().take(n).flat_map(|row| row.iter().take(n));
    let size = m::sqrt(leading.map(|x| x.norm_sqr()).sum());
    if !size.is_finite() {
        return false;
    }
    // The rest is a block of its own, whose eigenvalue lies below all of the leading part's.
    let below = -2.0 * size - 1e-300;
    let padded =
        SMatrix::<Complex, MAX_SENSORS, MAX_SENSORS>::from_fn(|i, j| match (i < n && j < n, i == j) {
            (true, _) => a[i][j],
            (false, true) => Complex::new(below, 0.0),
            (false, false) => Complex::ZERO,
        });
    let Some(found) = SymmetricEigen::try_new(padded, f64::EPSILON, ITERATIONS) else { return false };
    *a = [[Complex::ZERO; MAX_SENSORS]; MAX_SENSORS];
    *vectors = *a;
    let own =
        found.eigenvalues.iter().zip(found.eigenvectors.column_iter()).filter(|(x, _)| **x > 0.75 * below);
    for (k, (value, vector)) in own.enumerate().take(n) {
        a[k][k] = Complex::new(*value, 0.0);
        for (row, x) in vectors.iter_mut().zip(&vector).take(n) {
            row[k] = *x;
        }
    }
    true
}

/// Which columns of the eigenvectors belong to the largest eigenvalues.
pub(super) fn signal_columns(values: &HermitianMatrix, length: usize, sources: usize) -> [bool; MAX_SENSORS] {
    let mut signal = [false; MAX_SENSORS];
    for _ in 0..sources {
        let mut best: Option<(usize, f64)> = None;
        for (k, row) in values.iter().enumerate().take(length) {
            let value = row.get(k).map_or(0.0, |x| x.re);
            let taken = signal.get(k).copied().unwrap_or(true);
            if !taken && best.is_none_or(|(_, b)| value > b) {
                best = Some((k, value));
            }
        }
        if let Some(slot) = best.and_then(|(k, _)| signal.get_mut(k)) {
            *slot = true;
        }
    }
    signal
}

/// Mean of the other eigenvalues.
pub(super) fn noise_power(values: &HermitianMatrix, length: usize, signal: &[bool; MAX_SENSORS]) -> f64 {
    let noise = values.iter().zip(signal).enumerate().take(length).filter(|(_, (_, s))| !**s);
    let (mut sum, mut n) = (0.0, 0usize);
    for (k, (row, _)) in noise {
        sum += row.get(k).map_or(0.0, |x| x.re);
        n += 1;
    }
    (sum / n.max(1) as f64).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::super::complex::norm;
    use super::*;

    #[test]
    fn eigenvectors_rebuild_the_matrix() {
        let n = 19;
        let mut a: HermitianMatrix = [[Complex::ZERO; MAX_SENSORS]; MAX_SENSORS];
        for i in 0..n {
            for j in 0..i {
                let (x, y) = ((i * 7 + j * 3) as f64, (i * 5 + j * j) as f64);
                a[i][j] = Complex::new(x.sin(), y.cos());
                a[j][i] = a[i][j].conj();
            }
            a[i][i] = Complex::new((i as f64).cos(), 0.0);
        }
        let original = a;
        let mut v: HermitianMatrix = [[Complex::ZERO; MAX_SENSORS]; MAX_SENSORS];
        assert!(eigen(&mut a, n, &mut v));
        for i in 0..n {
            for j in 0..n {
                let (mut rebuilt, mut product) = (Complex::ZERO, Complex::ZERO);
                for k in 0..n {
                    rebuilt += (v[i][k] * v[j][k].conj()).scale(a[k][k].re);
                    product += v[k][i].conj() * v[k][j];
                }
                assert!(norm(rebuilt - original[i][j]) < 1e-11);
                let unit = Complex::new(f64::from(u8::from(i == j)), 0.0);
                assert!(norm(product - unit) < 1e-12);
            }
        }
    }

    #[test]
    fn nonsense_is_reported() {
        let mut a: HermitianMatrix = [[Complex::new(f64::NAN, 0.0); MAX_SENSORS]; MAX_SENSORS];
        let mut v = a;
        assert!(!eigen(&mut a, 4, &mut v));
    }
}
