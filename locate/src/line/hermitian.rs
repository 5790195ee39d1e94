//! Eigenvalues and eigenvectors of a Hermitian matrix by cyclic Jacobi rotations, in fixed memory.
//!
//! Each rotation makes one off-diagonal pair zero; sweeps converge quadratically (about eight for 20×20). Unconditionally
//! stable; accurate to rounding. Cost: sweeps · n³ · 12 multiplications.

use super::MAX_SENSORS;
use super::complex::Complex;
use crate::math::f64 as m;

/// A square matrix; only the leading n×n part is used.
pub type Matrix = [[Complex; MAX_SENSORS]; MAX_SENSORS];

/// Most sweeps; more than fifteen are never needed for sizes up to 32.
const SWEEPS: u32 = 30;

/// Diagonalises the leading n×n part of `a` (destroyed: eigenvalues stay on its diagonal); columns of `vectors` become
/// the eigenvectors. Returns whether it converged.
pub fn eigen(a: &mut Matrix, n: usize, vectors: &mut Matrix) -> bool {
    let n = n.min(MAX_SENSORS);
    for (i, row) in vectors.iter_mut().enumerate() {
        for (j, x) in row.iter_mut().enumerate() {
            *x = if i == j { Complex::new(1.0, 0.0) } else { Complex::ZERO };
        }
    }
    for _ in 0..SWEEPS {
        let (mut off, mut diagonal) = (0.0, 0.0);
        for (i, row) in a.iter().enumerate().take(n) {
            for (j, x) in row.iter().enumerate().take(n) {
                if i == j {
                    diagonal += x.norm_squared();
                } else {
                    off += x.norm_squared();
                }
            }
        }
        if !off.is_finite() || !diagonal.is_finite() {
            return false;
        }
        if off <= 1e-28 * diagonal {
            return true;
        }
        for p in 0..MAX_SENSORS {
            for q in p + 1..MAX_SENSORS {
                if q < n {
                    rotate(a, n, vectors, p, q);
                }
            }
        }
    }
    false
}

/// Makes the element (p, q) zero.
fn rotate(a: &mut Matrix, n: usize, vectors: &mut Matrix, p: usize, q: usize) {
    let (p, q) = (p % MAX_SENSORS, q % MAX_SENSORS);
    let apq = a[p][q];
    let size = apq.norm();
    if size < 1e-300 {
        return;
    }
    let phase = apq.scale(1.0 / size);
    // Angle of the real rotation after the phase is taken out: tan 2θ = 2|a_pq| / (a_pp − a_qq).
    let theta = (a[q][q].re - a[p][p].re) / (2.0 * size);
    let t = if theta >= 0.0 { 1.0 } else { -1.0 } / (m::abs(theta) + m::sqrt(1.0 + theta * theta));
    let c = 1.0 / m::sqrt(1.0 + t * t);
    let s = t * c;
    for row in a.iter_mut().take(n) {
        let (x, y) = (row[p], row[q]);
        row[p] = x.scale(c) - (phase.conj() * y).scale(s);
        row[q] = (phase * x).scale(s) + y.scale(c);
    }
    let (row_p, row_q) = (a[p], a[q]);
    for (k, (x, y)) in row_p.iter().zip(&row_q).enumerate().take(n) {
        let k = k % MAX_SENSORS;
        a[p][k] = x.scale(c) - (phase * *y).scale(s);
        a[q][k] = (phase.conj() * *x).scale(s) + y.scale(c);
    }
    a[p][q] = Complex::ZERO;
    a[q][p] = Complex::ZERO;
    for row in vectors.iter_mut().take(n) {
        let (x, y) = (row[p], row[q]);
        row[p] = x.scale(c) - (phase.conj() * y).scale(s);
        row[q] = (phase * x).scale(s) + y.scale(c);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvectors_rebuild_the_matrix() {
        let n = 19;
        let mut a: Matrix = [[Complex::ZERO; MAX_SENSORS]; MAX_SENSORS];
        for i in 0..n {
            for j in 0..i {
                let (x, y) = ((i * 7 + j * 3) as f64, (i * 5 + j * j) as f64);
                a[i][j] = Complex::new(x.sin(), y.cos());
                a[j][i] = a[i][j].conj();
            }
            a[i][i] = Complex::new((i as f64).cos(), 0.0);
        }
        let original = a;
        let mut v: Matrix = [[Complex::ZERO; MAX_SENSORS]; MAX_SENSORS];
        assert!(eigen(&mut a, n, &mut v));
        for i in 0..n {
            for j in 0..n {
                let (mut rebuilt, mut product) = (Complex::ZERO, Complex::ZERO);
                for k in 0..n {
                    rebuilt = rebuilt + (v[i][k] * v[j][k].conj()).scale(a[k][k].re);
                    product = product + v[k][i].conj() * v[k][j];
                }
                assert!((rebuilt - original[i][j]).norm() < 1e-11);
                let unit = Complex::new(f64::from(u8::from(i == j)), 0.0);
                assert!((product - unit).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn nonsense_is_reported() {
        let mut a: Matrix = [[Complex::new(f64::NAN, 0.0); MAX_SENSORS]; MAX_SENSORS];
        let mut v = a;
        assert!(!eigen(&mut a, 4, &mut v));
    }
}
