//! What a source at a position looks like from an array, and how that changes with the position.
//!
//! `α = atan2(Δx, Δy)`, `β = atan2(Δz, d)` [N 3]; `∂α/∂x = Δy/d²`, `∂α/∂y = −Δx/d²`, `∂β/∂x = −Δx Δz/(d D²)`,
//! `∂β/∂y = −Δy Δz/(d D²)`, `∂β/∂z = d/D²`. Polar coordinates about the frame's origin [N 1, 2] and the chain
//! [N 15, 16] to them.

use super::{MAX_ARRAYS, NetworkError};
use crate::angle::wrap_pi;
use crate::math::f64 as m;

/// Horizontal distance below which a source counts as straight above an array, metres: the azimuth is then
/// undefined and its derivative would be infinite.
const OVERHEAD_M: f64 = 1e-3;

/// One array's bearing of the source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// East, North, Up of the array's centre, metres.
    pub array_m: [f64; 3],
    /// Azimuth, radians clockwise from true North.
    pub azimuth: f64,
    /// Elevation, radians up from the horizontal, where measured.
    pub elevation: Option<f64>,
    /// Standard deviation of the azimuth, radians, positive.
    pub sd_azimuth: f64,
    /// Standard deviation of the elevation, radians, positive (unused without an elevation).
    pub sd_elevation: f64,
}

/// Checks a set of sightings.
///
/// # Errors
/// [`NetworkError::NoBearings`], [`NetworkError::TooManyArrays`], [`NetworkError::NotFinite`].
pub fn check(sightings: &[Sighting]) -> Result<(), NetworkError> {
    if sightings.is_empty() {
        return Err(NetworkError::NoBearings);
    }
    if sightings.len() > MAX_ARRAYS {
        return Err(NetworkError::TooManyArrays);
    }
    let good = |s: &Sighting| {
        s.array_m.iter().all(|x| x.is_finite())
            && s.azimuth.is_finite()
            && s.sd_azimuth.is_finite()
            && s.sd_azimuth > 0.0
            && s.elevation.is_none_or(|e| e.is_finite() && s.sd_elevation.is_finite() && s.sd_elevation > 0.0)
    };
    if sightings.iter().all(good) { Ok(()) } else { Err(NetworkError::NotFinite) }
}

/// Azimuth and elevation of `source_m` from `array_m` [N 3], radians.
pub fn bearing(array_m: &[f64; 3], source_m: &[f64; 3]) -> (f64, f64) {
    let [dx, dy, dz] = difference(source_m, array_m);
    let d = m::sqrt(dx * dx + dy * dy);
    (crate::angle::wrap_tau(m::atan2(dx, dy)), m::atan2(dz, d))
}

/// Gradients of azimuth and elevation by the source's (x, y, z), radians a metre.
pub fn gradients(array_m: &[f64; 3], source_m: &[f64; 3]) -> ([f64; 3], [f64; 3]) {
    let [dx, dy, dz] = difference(source_m, array_m);
    let d2 = dx * dx + dy * dy;
    if d2 < OVERHEAD_M * OVERHEAD_M {
        return ([0.0; 3], [0.0; 3]);
    }
    let d = m::sqrt(d2);
    let slant2 = d2 + dz * dz;
    ([dy / d2, -dx / d2, 0.0], [-dx * dz / (d * slant2), -dy * dz / (d * slant2), d / slant2])
}

/// Half the weighted sum of squared wrapped residuals: minus the log-likelihood [N 7] up to a constant.
pub fn cost(sightings: &[Sighting], source_m: &[f64; 3]) -> f64 {
    let mut sum = 0.0;
    for s in sightings {
        let (azimuth, elevation) = bearing(&s.array_m, source_m);
        let a = wrap_pi(s.azimuth - azimuth) / s.sd_azimuth;
        sum += a * a;
        if let Some(measured) = s.elevation {
            let b = (measured - elevation) / s.sd_elevation;
            sum += b * b;
        }
    }
    0.5 * sum
}

/// Rectangular coordinates of polar ones (azimuth, elevation, range) [N 1].
pub fn rectangular(polar: &[f64; 3]) -> [f64; 3] {
    let [azimuth, elevation, range] = *polar;
    let (sa, ca) = m::sin_cos(azimuth);
    let (sb, cb) = m::sin_cos(elevation);
    [range * sa * cb, range * ca * cb, range * sb]
}

/// Polar coordinates (azimuth, elevation, range) of rectangular ones.
pub fn polar(position_m: &[f64; 3]) -> [f64; 3] {
    let (azimuth, elevation) = bearing(&[0.0; 3], position_m);
    let [x, y, z] = *position_m;
    [azimuth, elevation, m::sqrt(x * x + y * y + z * z)]
}

/// Derivatives of (x, y, z) by (azimuth, elevation, range) [N 16]: row k holds ∂(x, y, z)/∂γ_k.
pub fn polar_derivatives(polar: &[f64; 3]) -> [[f64; 3]; 3] {
    let [azimuth, elevation, range] = *polar;
    let (sa, ca) = m::sin_cos(azimuth);
    let (sb, cb) = m::sin_cos(elevation);
    [
        [range * ca * cb, -range * sa * cb, 0.0],
        [-range * sa * sb, -range * ca * sb, range * cb],
        [sa * cb, ca * cb, sb],
    ]
}

/// A gradient by (x, y, z) turned into one by the polar coordinates whose derivatives are given.
pub fn chain(gradient: &[f64; 3], derivatives: &[[f64; 3]; 3]) -> [f64; 3] {
    let mut out = [0.0; 3];
    for (o, row) in out.iter_mut().zip(derivatives) {
        *o = row.iter().zip(gradient).map(|(d, g)| d * g).sum();
    }
    out
}

/// `a − b`.
pub(super) fn difference(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    let ([ax, ay, az], [bx, by, bz]) = (*a, *b);
    [ax - bx, ay - by, az - bz]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_agree_with_differences() {
        let (array, source) = ([10.0, -20.0, -168.0], [300.0, 410.0, -5.0]);
        let (ga, gb) = gradients(&array, &source);
        let h = 1e-4;
        for k in 0..3 {
            let (mut up, mut down) = (source, source);
            up[k] += h;
            down[k] -= h;
            let (a1, b1) = bearing(&array, &up);
            let (a0, b0) = bearing(&array, &down);
            assert!((wrap_pi(a1 - a0) / (2.0 * h) - ga[k]).abs() < 1e-9);
            assert!(((b1 - b0) / (2.0 * h) - gb[k]).abs() < 1e-9);
        }
        let p = polar(&source);
        let d = polar_derivatives(&p);
        for k in 0..3 {
            let (mut up, mut down) = (p, p);
            up[k] += 1e-6;
            down[k] -= 1e-6;
            let (r1, r0) = (rectangular(&up), rectangular(&down));
            for j in 0..3 {
                assert!(((r1[j] - r0[j]) / 2e-6 - d[k][j]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn polar_and_rectangular_are_inverse() {
        let p = [-120.0, 45.0, -30.0];
        let q = rectangular(&polar(&p));
        assert!(p.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn straight_above_gives_no_infinite_derivative() {
        let (a, b) = gradients(&[0.0, 0.0, -100.0], &[0.0, 0.0, -5.0]);
        assert!(a.iter().chain(&b).all(|x| x.is_finite()));
    }

    #[test]
    fn bad_sightings_are_named() {
        let s = Sighting {
            array_m: [0.0; 3],
            azimuth: 1.0,
            elevation: Some(0.1),
            sd_azimuth: 0.02,
            sd_elevation: 0.02,
        };
        assert_eq!(check(&[]), Err(NetworkError::NoBearings));
        assert_eq!(check(&[s; 17]), Err(NetworkError::TooManyArrays));
        assert_eq!(check(&[Sighting { sd_azimuth: 0.0, ..s }]), Err(NetworkError::NotFinite));
        assert_eq!(check(&[Sighting { elevation: Some(f64::NAN), ..s }]), Err(NetworkError::NotFinite));
        assert_eq!(check(&[s; 16]), Ok(()));
    }
}
