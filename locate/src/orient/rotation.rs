//! The three rotation angles of a compact array, from bearings of a vessel of known track.
//!
//! Directions as the array reports them, `m_i`, and as they are, `u_i`, differ by one rotation: `u_i = R m_i`. Start:
//! the eigenvector of Davenport's 4×4 matrix (least squares over all rotations); then small rotations
//! `ω = [Σ w (I − p pᵀ)]⁻¹ Σ w p × u`, `p = R m`, with Huber's weights of the angle between p and u. The covariance is the
//! inverse of that matrix times the residual variance, grown for the correlation of successive bearings that the
//! caller states.
//!
//! One direction alone leaves the rotation about it free; the error says so. A vessel on the sea surface seen from
//! deep below spans directions enough as soon as its azimuth turns by a few degrees.

use super::{OrientError, quantile};
use crate::angle::wrap_tau;
use crate::kit::Huber;
use crate::kit::spd::{self, Square, dot, quadratic};
use crate::math::f64 as m;

/// Fewest directions for three angles and their scatter.
pub const LEAST_DIRECTIONS: usize = 6;
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
    let unit = |v: &[f64; 3]| m::abs(dot(v, v) - 1.0) < 1e-6;
    if !directions.iter().all(|d| unit(&d.measured) && unit(&d.known)) || !(correlated >= 1.0) {
        return Err(OrientError::NotFinite);
    }
    let mut r = davenport(directions);
    let mut inverse = None;
    for _ in 0..30 {
        let scale = spread(directions, &r);
        let mut h = [[0.0; 3]; 3];
        let mut g = [0.0; 3];
        for d in directions {
            let p = apply(&r, &d.measured);
            let w = Huber::EFFICIENT.weight(angle(&p, &d.known) / scale);
            add_normal(&mut h, &p, w);
            for (x, c) in g.iter_mut().zip(cross(&p, &d.known)) {
                *x += w * c;
            }
        }
        let c = spd::inverse(&h).ok_or(OrientError::NotObservable)?;
        inverse = Some(c);
        let mut omega = [0.0; 3];
        for (o, row) in omega.iter_mut().zip(&c) {
            *o = dot(row, &g);
        }
        r = product(&turn(&omega), &r);
        if dot(&omega, &omega) < 1e-24 {
            break;
        }
    }
    let c = inverse.ok_or(OrientError::NotObservable)?;
    let scale = spread(directions, &r);
    // The spread is of one tangential component; the information counts both.
    let mut sd = [0.0; 3];
    let [axis_pitch, axis_roll, axis_heading] = axes(&r);
    for (s, axis) in sd.iter_mut().zip([axis_heading, axis_pitch, axis_roll]) {
        *s = scale * m::sqrt((quadratic(&axis, &c, &axis) * correlated).max(0.0));
    }
    if sd.iter().any(|s| !(*s <= LARGEST_SD)) {
        return Err(OrientError::NotObservable);
    }
    let errors = directions.iter().map(|d| angle(&apply(&r, &d.measured), &d.known));
    let median_error = quantile(errors, 0.5);
    if !(median_error < 0.5) {
        return Err(OrientError::Inconsistent);
    }
    let [[_, ny, _], [_, ey, _], [zx, zy, zz]] = r;
    Ok(Rotation {
        matrix: r,
        heading: wrap_tau(m::atan2(ny, ey)),
        pitch: m::asin(zy.clamp(-1.0, 1.0)),
        roll: m::atan2(-zx, zz),
        sd,
        median_error,
        n: directions.len(),
    })
}

/// Axes of pitch (the turned East axis made horizontal), roll (the array's North axis) and heading (the vertical).
fn axes(r: &Square<3>) -> [[f64; 3]; 3] {
    let north = apply(r, &[0.0, 1.0, 0.0]);
    let [x, y, _] = north;
    let h = m::sqrt(x * x + y * y).max(1e-12);
    [[y / h, -x / h, 0.0], north, [0.0, 0.0, 1.0]]
}

/// Standard deviation of one tangential component of the angular errors, robustly: the median of a Rayleigh variable
/// is 1.1774 standard deviations.
fn spread(directions: &[DirectionPair], r: &Square<3>) -> f64 {
    let errors = directions.iter().map(|d| angle(&apply(r, &d.measured), &d.known));
    (quantile(errors, 0.5) / 1.1774).clamp(LEAST_SCALE, 1.0)
}

/// Least squares over all rotations: the leading eigenvector of Davenport's matrix, by power iteration (shifted by n,
/// so that the greatest eigenvalue is also the greatest in size).
fn davenport(directions: &[DirectionPair]) -> Square<3> {
    let mut b = [[0.0; 3]; 3];
    for d in directions {
        for (row, u) in b.iter_mut().zip(&d.known) {
            for (x, v) in row.iter_mut().zip(&d.measured) {
                *x += u * v;
            }
        }
    }
    let [[b00, b01, b02], [b10, b11, b12], [b20, b21, b22]] = b;
    let trace = b00 + b11 + b22;
    let n = directions.len() as f64;
    // Quaternion (w, x, y, z) of the rotation measured → known.
    let k = [
        [trace + n, b21 - b12, b02 - b20, b10 - b01],
        [b21 - b12, 2.0 * b00 - trace + n, b01 + b10, b02 + b20],
        [b02 - b20, b01 + b10, 2.0 * b11 - trace + n, b12 + b21],
        [b10 - b01, b02 + b20, b12 + b21, 2.0 * b22 - trace + n],
    ];
    // Squaring the matrix doubles the powers: twelve squarings are 4096 iterations.
    let mut p = k;
    for _ in 0..12 {
        let mut q = [[0.0; 4]; 4];
        for (row, pr) in q.iter_mut().zip(&p) {
            for (x, pc) in row.iter_mut().zip(&p) {
                // p is symmetric: its rows are its columns.
                *x = pr.iter().zip(pc).map(|(a, b)| a * b).sum();
            }
        }
        let largest = q.iter().flatten().fold(0.0f64, |a, x| a.max(m::abs(*x))).max(1e-300);
        q.iter_mut().flatten().for_each(|x| *x /= largest);
        p = q;
    }
    let squared = |row: &[f64; 4]| row.iter().map(|x| x * x).sum::<f64>();
    let mut best = [1.0, 0.0, 0.0, 0.0];
    let mut size = 0.0;
    for row in &p {
        if squared(row) > size {
            size = squared(row);
            best = *row;
        }
    }
    let norm = m::sqrt(squared(&best));
    let [w, x, y, z] = best.map(|q| q / norm);
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Adds `w (I − p pᵀ)`.
fn add_normal(h: &mut Square<3>, p: &[f64; 3], w: f64) {
    spd::add_outer(h, p, -w);
    for (i, row) in h.iter_mut().enumerate() {
        if let Some(x) = row.get_mut(i) {
            *x += w;
        }
    }
}

/// Matrix of a rotation vector (Rodrigues' formula).
fn turn(omega: &[f64; 3]) -> Square<3> {
    let theta = m::sqrt(dot(omega, omega));
    if theta < 1e-15 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    }
    let [x, y, z] = omega.map(|o| o / theta);
    let (s, c) = m::sin_cos(theta);
    let v = 1.0 - c;
    [
        [c + x * x * v, x * y * v - z * s, x * z * v + y * s],
        [y * x * v + z * s, c + y * y * v, y * z * v - x * s],
        [z * x * v - y * s, z * y * v + x * s, c + z * z * v],
    ]
}

fn product(a: &Square<3>, b: &Square<3>) -> Square<3> {
    let [b0, b1, b2] = b;
    a.map(|[x, y, z]| {
        let mut row = [0.0; 3];
        for (o, ((p, q), r)) in row.iter_mut().zip(b0.iter().zip(b1).zip(b2)) {
            *o = x * p + y * q + z * r;
        }
        row
    })
}

fn apply(r: &Square<3>, v: &[f64; 3]) -> [f64; 3] {
    spd::times(r, v)
}

fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    let ([ax, ay, az], [bx, by, bz]) = (*a, *b);
    [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]
}

/// Angle between two unit vectors, accurate also when small.
fn angle(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let c = cross(a, b);
    m::atan2(m::sqrt(dot(&c, &c)), dot(a, b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::{RAD_PER_DEG, wrap_pi};
    use std::vec::Vec;

    fn directions(r: &Square<3>, noise: f64) -> Vec<DirectionPair> {
        let transposed: Square<3> = core::array::from_fn(|i| core::array::from_fn(|j| r[j][i]));
        (0..120)
            .map(|k| {
                let y = -600.0 + 10.0 * f64::from(k);
                let n = (200f64 * 200.0 + y * y + 163.0 * 163.0).sqrt();
                let known = [200.0 / n, y / n, 163.0 / n];
                let t = f64::from(k);
                let e = [noise * (3.0 * t).sin(), noise * (5.0 * t + 1.0).sin(), noise * (7.0 * t).cos()];
                let measured = apply(&transposed, &apply(&turn(&e), &known));
                DirectionPair { measured, known }
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
                    assert!((found.matrix[i][j] - r[i][j]).abs() < 1e-8, "{omega:?} {found:?}");
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
        let d = [DirectionPair { measured: known, known }; 20];
        assert_eq!(rotation(&d, 1.0), Err(OrientError::NotObservable));
        assert_eq!(rotation(&d[..2], 1.0), Err(OrientError::TooFew));
    }
}
