//! The three rotation angles of a compact array, from bearings of a vessel of known track.
//!
//! Directions as the array reports them, `m_i`, and as they are, `u_i`, differ by one rotation: `u_i = R m_i`. Start:
//! least squares over all rotations, from the singular values of `Σ u mᵀ`; then small rotations
//! `ω = [Σ w (I − p pᵀ)]⁻¹ Σ w p × u`, `p = R m`, with Huber's weights of the angle between p and u. The covariance is the
//! inverse of that matrix times the residual variance, grown for the correlation of successive bearings that the
//! caller states.
//!
//! One direction alone leaves the rotation about it free; the error says so. A vessel on the sea surface seen from
//! deep below spans directions enough as soon as its azimuth turns by a few degrees.

use super::{OrientError, quantile};
use crate::angle::wrap_tau;
use crate::kit::{Huber, Normal, Square, reweighted};
use crate::math::f64 as m;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Fewest directions for three angles and their scatter.
const LEAST_DIRECTIONS: usize = 6;
/// Largest standard deviation of an angle that is one, radians (20°).
const LARGEST_SD: f64 = 0.35;
/// Smallest angular noise assumed, radians, so that exact data do not divide by zero.
const LEAST_SCALE: f64 = 1e-9;

/// One direction, as measured and as it was; unit vectors East, North, Up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectionPair {
    /// As the array reports it.
    pub measured: [f64; 3],
    /// From the known track.
    pub known: [f64; 3],
    /// Standard deviation of one component of its error against those of the others, in any unit; 1 where all are alike.
    pub sd: f64,
}

/// The rotation that turns reported directions into true ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    /// Rows of the matrix R.
    pub matrix: [[f64; 3]; 3],
    /// Turn about the vertical, clockwise from above, radians in [0, 2π).
    pub heading: f64,
    /// Rise of the array's North axis, radians.
    pub pitch: f64,
    /// Turn about the array's North axis, East side down, radians.
    pub roll: f64,
    /// Standard deviations of heading, pitch and roll, radians.
    pub sd: [f64; 3],
    /// Median angle between rotated and known directions, radians.
    pub median_error: f64,
    /// Directions used.
    pub n: usize,
}

/// Finds the rotation. `correlated` is how many successive directions share one error (1: independent).
///
/// # Errors
/// [`OrientError`].
pub fn rotation(directions: &[DirectionPair], correlated: f64) -> Result<Rotation, OrientError> {
    if directions.len() < LEAST_DIRECTIONS {
        return Err(OrientError::TooFew);
    }
    let unit = |v: &[f64; 3]| m::abs(Vector3::from(*v).norm_squared() - 1.0) < 1e-6;
    let sane = |d: &DirectionPair| unit(&d.measured) && unit(&d.known) && d.sd > 0.0 && d.sd.is_finite();
    if !directions.iter().all(sane) || !(correlated >= 1.0) {
        return Err(OrientError::NotFinite);
    }
    let equations = |_, r: &Matrix3<f64>| {
        let scale = spread(directions, r);
        let (mut h, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for d in directions {
            let (p, u) = (r * Vector3::from(d.measured), Vector3::from(d.known));
            let w = Huber::EFFICIENT.weight(angle(&p, &u) / (scale * d.sd)) / (d.sd * d.sd);
            h += (Matrix3::identity() - p * p.transpose()) * w;
            g += p.cross(&u) * w;
        }
        // A symmetric matrix: its columns are its rows.
        let mut normal = Normal::default();
        (normal.upper, normal.gradient) = (h.into(), g.into());
        Some(normal)
    };
    let turn = |_, r: &mut Matrix3<f64>, omega: &[f64; 3]| {
        let omega = Vector3::from(*omega);
        *r = Rotation3::new(omega).into_inner() * *r;
        !(omega.norm_squared() < 1e-24)
    };
    let start = best_rotation(directions).ok_or(OrientError::NotObservable)?;
    let (r, c) = reweighted(start, 30, equations, turn).ok_or(OrientError::NotObservable)?;
    let c = Matrix3::from(c);
    let scale = spread(directions, &r);
    // Axes of heading (the vertical), pitch (the turned East axis made horizontal) and roll (the array's North axis).
    let north = r * Vector3::y();
    let h = m::sqrt(north.x * north.x + north.y * north.y).max(1e-12);
    let axes = [Vector3::z(), Vector3::new(north.y / h, -north.x / h, 0.0), north];
    // The spread is of one tangential component; the information counts both.
    let sd = axes.map(|axis| scale * m::sqrt((axis.dot(&(c * axis)) * correlated).max(0.0)));
    if sd.iter().any(|s| !(*s <= LARGEST_SD)) {
        return Err(OrientError::NotObservable);
    }
    let median_error = quantile(errors(directions, &r), 0.5);
    if !(median_error < 0.5) {
        return Err(OrientError::Inconsistent);
    }
    let matrix: Square<3> = r.transpose().into();
    let [[_, ny, _], [_, ey, _], [zx, zy, zz]] = matrix;
    Ok(Rotation {
        matrix,
        heading: wrap_tau(m::atan2(ny, ey)),
        pitch: m::asin(zy.clamp(-1.0, 1.0)),
        roll: m::atan2(-zx, zz),
        sd,
        median_error,
        n: directions.len(),
    })
}

/// Angles between turned and known directions.
fn errors<'a>(
    directions: &'a [DirectionPair],
    r: &'a Matrix3<f64>,
) -> impl Iterator<Item = f64> + Clone + 'a {
    directions.iter().map(move |d| angle(&(r * Vector3::from(d.measured)), &Vector3::from(d.known)))
}

/// Standard deviation of one tangential component of the angular errors in units of those stated, robustly: the median of a Rayleigh
/// variable is 1.1774 standard deviations.
fn spread(directions: &[DirectionPair], r: &Matrix3<f64>) -> f64 {
    let stated = errors(directions, r).zip(directions).map(|(e, d)| e / d.sd);
    (quantile(stated, 0.5) / 1.1774).max(LEAST_SCALE)
}

/// Least squares over all rotations: `U diag(1, 1, ±1) Vᵀ` from the singular values of `Σ u mᵀ`.
fn best_rotation(directions: &[DirectionPair]) -> Option<Matrix3<f64>> {
    let sum: Matrix3<f64> = directions
        .iter()
        .map(|d| Vector3::from(d.known) * Vector3::from(d.measured).transpose() / (d.sd * d.sd))
        .sum();
    let parts = sum.try_svd(true, true, f64::EPSILON, 100)?;
    let (u, v_t) = (parts.u?, parts.v_t?);
    let sense = if u.determinant() * v_t.determinant() < 0.0 { -1.0 } else { 1.0 };
    Some(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sense)) * v_t)
}

/// Angle between two unit vectors, accurate also when small.
fn angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    m::atan2(a.cross(b).norm(), a.dot(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::{RAD_PER_DEG, wrap_pi};
    use std::vec::Vec;

    fn turn(omega: &[f64; 3]) -> Matrix3<f64> {
        Rotation3::new(Vector3::from(*omega)).into_inner()
    }

    fn directions(r: &Matrix3<f64>, noise: f64) -> Vec<DirectionPair> {
        (0..120)
            .map(|k| {
                let y = -600.0 + 10.0 * f64::from(k);
                let n = (200f64 * 200.0 + y * y + 163.0 * 163.0).sqrt();
                let known = [200.0 / n, y / n, 163.0 / n];
                let t = f64::from(k);
                let e = [noise * (3.0 * t).sin(), noise * (5.0 * t + 1.0).sin(), noise * (7.0 * t).cos()];
                let measured = r.transpose() * turn(&e) * Vector3::from(known);
                DirectionPair { measured: measured.into(), known, sd: 1.0 }
            })
            .collect()
    }

    #[test]
    fn any_rotation_is_found_exactly() {
        for omega in [[0.05, -0.03, -0.6], [1.0, 2.0, -1.0], [0.0, 0.0, 3.1], [3.0, 0.1, 0.0]] {
            let r = turn(&omega);
            let found = rotation(&directions(&r, 0.0), 1.0).unwrap();
            for i in 0..3 {
                for j in 0..3 {
                    assert!((found.matrix[i][j] - r[(i, j)]).abs() < 1e-8, "{omega:?} {found:?}");
                }
            }
        }
    }

    #[test]
    fn heading_is_clockwise_and_small_tilts_are_named() {
        // Turned 30° clockwise: what the array calls North points to azimuth 30°.
        let found = rotation(&directions(&turn(&[0.0, 0.0, -30.0 * RAD_PER_DEG]), 0.0), 1.0).unwrap();
        assert!(wrap_pi(found.heading - 30.0 * RAD_PER_DEG).abs() < 1e-9);
        assert!(found.pitch.abs() < 1e-9 && found.roll.abs() < 1e-9);
        let found = rotation(&directions(&turn(&[0.04, 0.0, 0.0]), 0.0), 1.0).unwrap();
        assert!((found.pitch - 0.04).abs() < 1e-9, "{found:?}");
        let found = rotation(&directions(&turn(&[0.0, 0.03, 0.0]), 0.0), 1.0).unwrap();
        assert!((found.roll - 0.03).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn noise_and_outliers_are_survived_within_the_stated_error() {
        let r = turn(&[0.02, -0.03, 0.9]);
        let mut d = directions(&r, 0.03);
        for (i, x) in d.iter_mut().enumerate() {
            if i % 9 == 4 {
                x.measured = [-x.measured[1], x.measured[0], x.measured[2]];
            }
        }
        let found = rotation(&d, 1.0).unwrap();
        let error = wrap_pi(found.heading + 0.9).abs();
        assert!(error < 0.02 && error < 4.0 * found.sd[0] && found.sd[0] < 0.02, "{found:?}");
    }

    #[test]
    fn one_direction_is_not_enough() {
        let known = [0.6, 0.64, 0.48];
        let d = [DirectionPair { measured: known, known, sd: 1.0 }; 20];
        assert_eq!(rotation(&d, 1.0), Err(OrientError::NotObservable));
        assert_eq!(rotation(&d[..2], 1.0), Err(OrientError::TooFew));
    }
}
