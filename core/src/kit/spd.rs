//! Small symmetric positive definite matrices: Cholesky factor, solution, inverse, quadratic forms.
//!
//! In: a symmetric matrix whose upper and lower triangles agree (only one is read by the factor). Out: what is asked, or
//! `None` where the matrix is singular to working precision or not finite. Cost: N³/6 multiplications for the factor, N²
//! for a solution; N is 2 to 12. Factor and solution are nalgebra's, which link without a panic path.

use crate::math::f64 as m;
use nalgebra::{SMatrix, SVector};

/// A symmetric N×N matrix; only products keep it so, the type does not check.
pub type Square<const N: usize> = [[f64; N]; N];

/// Smallest pivot, as a share of its diagonal element, that still counts as information. Rounding leaves about 1e-15
/// of a diagonal behind where the true pivot is zero; a hundred times that is not information.
const LEAST_PIVOT: f64 = 1e-13;

/// Lower Cholesky factor of a matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factor<const N: usize> {
    /// `L` of `A = L Lᵀ`; zero above the diagonal.
    pub lower: Square<N>,
}

impl<const N: usize> Factor<N> {
    /// Factorises `a`; `None` where it is singular to working precision (`LEAST_PIVOT`) or not finite.
    pub fn new(a: &Square<N>) -> Option<Self> {
        // Rows are taken for columns and back: the matrix is symmetric.
        let lower: Square<N> = SMatrix::<f64, N, N>::from(*a).cholesky()?.l().transpose().into();
        for (i, row) in lower.iter().enumerate() {
            let left = row[i] * row[i];
            if !(left > LEAST_PIVOT * a[i][i] && left.is_finite()) {
                return None;
            }
        }
        Some(Self { lower })
    }

    /// Solves `A x = b`.
    pub fn solve(&self, b: &[f64; N]) -> [f64; N] {
        let l = SMatrix::<f64, N, N>::from(self.lower).transpose();
        let mut x = SVector::<f64, N>::from(*b);
        l.solve_lower_triangular_mut(&mut x);
        l.tr_solve_lower_triangular_mut(&mut x);
        x.into()
    }

    /// Determinant of `A`.
    pub fn determinant(&self) -> f64 {
        let mut product = 1.0;
        for i in 0..N {
            product *= self.lower[i][i] * self.lower[i][i];
        }
        product
    }

    /// `A⁻¹`.
    pub fn inverse(&self) -> Square<N> {
        let mut out = [[0.0; N]; N];
        for (j, row) in out.iter_mut().enumerate() {
            let mut unit = [0.0; N];
            unit[j] = 1.0;
            *row = self.solve(&unit);
        }
        out
    }
}

/// Triangular root of a positive *semi*definite matrix: as the factor, but a direction without spread (a parameter that is
/// known) has a zero column instead of being refused.
pub fn root<const N: usize>(a: &Square<N>) -> Square<N> {
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let mut sum = a[i][j];
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            let pivot = l[j][j];
            l[i][j] = if i == j {
                m::sqrt(sum.max(0.0))
            } else if pivot > 0.0 {
                sum / pivot
            } else {
                0.0
            };
        }
    }
    l
}

/// Inverse of `a`; `None` where it is singular or not finite.
pub fn inverse<const N: usize>(a: &Square<N>) -> Option<Square<N>> {
    let out = Factor::new(a)?.inverse();
    out.iter().flatten().all(|x| x.is_finite()).then_some(out)
}

/// Solves `A x = b`; `None` where `a` is singular or not finite.
pub fn solve<const N: usize>(a: &Square<N>, b: &[f64; N]) -> Option<[f64; N]> {
    Some(Factor::new(a)?.solve(b))
}

/// Adds `weight · g gᵀ`.
pub fn add_outer<const N: usize>(a: &mut Square<N>, g: &[f64; N], weight: f64) {
    for (row, gi) in a.iter_mut().zip(g) {
        for (x, gj) in row.iter_mut().zip(g) {
            *x += weight * gi * gj;
        }
    }
}

/// Scalar product.
pub fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// `A x`.
pub fn times<const N: usize>(a: &Square<N>, x: &[f64; N]) -> [f64; N] {
    let mut out = [0.0; N];
    for (o, row) in out.iter_mut().zip(a) {
        *o = dot(row, x);
    }
    out
}

/// `aᵀ C b`: the covariance of two linear functions of parameters whose covariance is `c`.
pub fn quadratic<const N: usize>(a: &[f64; N], c: &Square<N>, b: &[f64; N]) -> f64 {
    dot(a, &times(c, b))
}

/// `J C Jᵀ`: the covariance of M linear functions (rows of `j`) of N parameters whose covariance is `c`.
pub fn propagated<const M: usize, const N: usize>(j: &[[f64; N]; M], c: &Square<N>) -> Square<M> {
    let mut out = [[0.0; M]; M];
    for (row, a) in out.iter_mut().zip(j) {
        for (x, b) in row.iter_mut().zip(j) {
            *x = quadratic(a, c, b);
        }
    }
    out
}

/// Largest eigenvalue of a covariance, by power iteration (never below a diagonal element's true share: the start is
/// the column of the largest diagonal element, which is not orthogonal to the leading eigenvector).
pub fn largest_eigenvalue<const N: usize>(a: &Square<N>) -> f64 {
    let mut v = [0.0; N];
    let mut best = -1.0;
    for (i, row) in a.iter().enumerate() {
        if row[i] > best {
            best = row[i];
            v = *row;
        }
    }
    let mut value = 0.0;
    for _ in 0..64 {
        let norm = m::sqrt(dot(&v, &v));
        if !(norm > 0.0) || !norm.is_finite() {
            return if norm.is_finite() { 0.0 } else { f64::INFINITY };
        }
        for x in &mut v {
            *x /= norm;
        }
        let w = times(a, &v);
        value = dot(&w, &v);
        v = w;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// `B Bᵀ` of random rows, each axis on a scale of its own.
    fn matrix() -> impl Strategy<Value = (Square<4>, [f64; 4])> {
        let rows = prop::array::uniform4(prop::array::uniform4(-1.0f64..1.0));
        (rows, prop::array::uniform4(-4i32..5), prop::array::uniform4(-1.0f64..1.0)).prop_map(
            |(rows, scales, b)| {
                let scaled = rows.map(|row| {
                    let mut out = row;
                    for (x, s) in out.iter_mut().zip(scales) {
                        *x *= m::powf(10.0, f64::from(s));
                    }
                    out
                });
                let mut a = [[0.0; 4]; 4];
                for row in &scaled {
                    add_outer(&mut a, row, 1.0);
                }
                (a, b)
            },
        )
    }

    proptest! {
        #![proptest_config(seabearing_testkit::property(256))]

        #[test]
        fn the_factor_rebuilds_and_the_solution_solves((a, b) in matrix()) {
            let Some(f) = Factor::new(&a) else { return Ok(()) };
            let x = f.solve(&b);
            let back = times(&a, &x);
            let inverse = f.inverse();
            for i in 0..4 {
                for j in 0..4 {
                    let size = m::sqrt(a[i][i] * a[j][j]);
                    let rebuilt: f64 = (0..4).map(|k| f.lower[i][k] * f.lower[j][k]).sum();
                    prop_assert!((rebuilt - a[i][j]).abs() <= 1e-14 * size);
                    prop_assert!((inverse[i][j] - inverse[j][i]).abs() <= 1e-3 * m::sqrt(inverse[i][i] * inverse[j][j]));
                }
                let size: f64 = (0..4).map(|k| (a[i][k] * x[k]).abs()).sum();
                prop_assert!((back[i] - b[i]).abs() <= 1e-13 * size + 1e-15, "{} {}", back[i], b[i]);
            }
        }

        #[test]
        fn the_largest_eigenvalue_is_between_the_greatest_diagonal_and_the_trace((a, _) in matrix()) {
            let greatest = (0..4).map(|i| a[i][i]).fold(0.0, f64::max);
            let trace: f64 = (0..4).map(|i| a[i][i]).sum();
            let found = largest_eigenvalue(&a);
            prop_assert!(found >= greatest * (1.0 - 1e-9) && found <= trace * (1.0 + 1e-9));
        }
    }

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
        assert!((Factor::new(&a).unwrap().determinant() - 20.89).abs() < 1e-12);
        assert_eq!(solve(&[[4.0, 0.0], [0.0, 16.0]], &[2.0, 4.0]), Some([0.5, 0.25]));
    }

    #[test]
    fn rank_deficiency_and_nonsense_are_noticed_on_any_scale() {
        for scale in [1e-120, 1.0, 1e120] {
            let mut a = [[0.0; 3]; 3];
            add_outer(&mut a, &[1.0, 2.0, 3.0], scale);
            add_outer(&mut a, &[0.3, -1.0, 0.1], scale);
            assert!(Factor::new(&a).is_none());
            add_outer(&mut a, &[0.0, 0.0, 1e-4], scale);
            assert!(Factor::new(&a).is_some());
        }
        assert!(inverse(&[[f64::NAN, 0.0], [0.0, 1.0]]).is_none());
        assert!(inverse(&[[1.0, 0.0], [0.0, f64::INFINITY]]).is_none());
        assert!(inverse(&[[0.0; 4]; 4]).is_none());
    }

    #[test]
    fn a_known_parameter_has_a_zero_column_in_the_root() {
        let c = [[4.0, 0.0, 2.0], [0.0, 0.0, 0.0], [2.0, 0.0, 2.0]];
        let l = root(&c);
        assert_eq!(l, [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]);
    }

    #[test]
    fn covariance_of_functions() {
        let c = [[4.0, 1.0], [1.0, 9.0]];
        assert_eq!(propagated(&[[1.0, 1.0]], &c), [[15.0]]);
        assert_eq!(quadratic(&[1.0, 0.0], &c, &[0.0, 2.0]), 2.0);
    }
}
