//! Small symmetric positive definite systems: Cholesky factor, solution, inverse, largest standard deviation.
//!
//! Cost: N³/6 multiplications; N is 2 to 5 here.

use crate::math::f64 as m;

/// Smallest pivot, relative to its diagonal element, that still counts as information. Rounding leaves about 1e-15
/// of a diagonal behind where the true pivot is zero; a thousand times that is not information.
const LEAST_PIVOT: f64 = 1e-12;

/// A symmetric N×N matrix; only products keep it so, the type does not check.
pub type Square<const N: usize> = [[f64; N]; N];

/// Lower Cholesky factor; `None` where the matrix is singular to working precision or not finite.
pub fn cholesky<const N: usize>(a: &Square<N>) -> Option<Square<N>> {
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let mut s = at(a, i, j);
            for k in 0..j {
                s -= at(&l, i, k) * at(&l, j, k);
            }
            let value = if i == j {
                if !(s > LEAST_PIVOT * at(a, i, i)) || !s.is_finite() {
                    return None;
                }
                m::sqrt(s)
            } else {
                s / at(&l, j, j)
            };
            if let Some(x) = l.get_mut(i).and_then(|row| row.get_mut(j)) {
                *x = value;
            }
        }
    }
    Some(l)
}

/// Solves `A x = b` from the factor of A.
pub fn solve<const N: usize>(l: &Square<N>, b: &[f64; N]) -> [f64; N] {
    let mut x = *b;
    for i in 0..N {
        let mut s = item(&x, i);
        for k in 0..i {
            s -= at(l, i, k) * item(&x, k);
        }
        put(&mut x, i, s / at(l, i, i));
    }
    for i in (0..N).rev() {
        let mut s = item(&x, i);
        for k in i + 1..N {
            s -= at(l, k, i) * item(&x, k);
        }
        put(&mut x, i, s / at(l, i, i));
    }
    x
}

/// Inverse of a symmetric positive definite matrix; `None` where it is singular.
pub fn inverse<const N: usize>(a: &Square<N>) -> Option<Square<N>> {
    let l = cholesky(a)?;
    let mut out = [[0.0; N]; N];
    for (j, row) in out.iter_mut().enumerate() {
        let mut unit = [0.0; N];
        put(&mut unit, j, 1.0);
        *row = solve(&l, &unit);
    }
    if out.iter().flatten().all(|x| x.is_finite()) { Some(out) } else { None }
}

/// Largest eigenvalue of a covariance by power iteration (never below a diagonal element's true share: the start is
/// the column of the largest diagonal element, which is not orthogonal to the leading eigenvector).
pub fn largest_eigenvalue<const N: usize>(a: &Square<N>) -> f64 {
    let mut v = [0.0; N];
    let mut best = -1.0;
    for (i, row) in a.iter().enumerate() {
        if item(row, i) > best {
            best = item(row, i);
            v = *row;
        }
    }
    let mut value = 0.0;
    for _ in 0..64 {
        let norm = m::sqrt(v.iter().map(|x| x * x).sum());
        if !(norm > 0.0) || !norm.is_finite() {
            return if norm.is_finite() { 0.0 } else { f64::INFINITY };
        }
        for x in &mut v {
            *x /= norm;
        }
        let mut w = [0.0; N];
        for (x, row) in w.iter_mut().zip(a) {
            *x = row.iter().zip(&v).map(|(p, q)| p * q).sum();
        }
        value = w.iter().zip(&v).map(|(p, q)| p * q).sum();
        v = w;
    }
    value
}

/// Adds `weight · g gᵀ` to a matrix.
pub fn add_outer<const N: usize>(a: &mut Square<N>, g: &[f64; N], weight: f64) {
    for (row, gi) in a.iter_mut().zip(g) {
        for (x, gj) in row.iter_mut().zip(g) {
            *x += weight * gi * gj;
        }
    }
}

fn at<const N: usize>(a: &Square<N>, i: usize, j: usize) -> f64 {
    a.get(i).and_then(|row| row.get(j)).copied().unwrap_or(f64::NAN)
}

fn item<const N: usize>(x: &[f64; N], i: usize) -> f64 {
    x.get(i).copied().unwrap_or(f64::NAN)
}

fn put<const N: usize>(x: &mut [f64; N], i: usize, value: f64) {
    if let Some(slot) = x.get_mut(i) {
        *slot = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_and_eigenvalue_of_a_known_matrix() {
        let a = [[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];
        let b = inverse(&a).unwrap();
        for i in 0..3 {
            for j in 0..3 {
                let p: f64 = (0..3).map(|k| a[i][k] * b[k][j]).sum();
                assert!((p - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
        assert!((largest_eigenvalue(&[[2.0, 1.0], [1.0, 2.0]]) - 3.0).abs() < 1e-9);
    }

    #[test]
    fn rank_deficiency_is_noticed() {
        let mut a = [[0.0; 3]; 3];
        add_outer(&mut a, &[1.0, 2.0, 3.0], 1.0);
        add_outer(&mut a, &[0.3, -1.0, 0.1], 1.0);
        assert!(cholesky(&a).is_none());
        assert!(inverse(&[[f64::NAN, 0.0], [0.0, 1.0]]).is_none());
    }
}
