//! The physical limit: what no estimator of direction beats (docs/references.md).
//!
//! Fisher information of M arrival times with one signal and independent noise of common signal-to-noise ratio S(f):
//! `F_t = 2T ∫ (2πf)² S²/(1+M S) df · (M I − 1 1ᵀ)`, and of the angles `F = Gᵀ F_t G`, `G = ∂t/∂(α, β)`. For M = 2 this is
//! the usual bound on a delay. Assumptions: stationary Gaussian signal and noise, T long against the time across the array.

use super::wavefront;
use crate::angle::unit_vector;
use crate::geometry::Geometry;
use crate::math::f64 as m;

/// Least covariance of azimuth and elevation, rad².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleLimit {
    /// Variance of azimuth.
    pub var_azimuth: f64,
    /// Variance of elevation.
    pub var_elevation: f64,
    /// Covariance of both.
    pub cov: f64,
}

/// `2T ∫ (2πf)² S²/(1+M S) df` over a band in Hz, in 1/s², by the midpoint rule in `steps` parts.
pub fn arrival_information(
    sensors: usize,
    band_hz: (f64, f64),
    seconds: f64,
    snr: impl Fn(f64) -> f64,
    steps: usize,
) -> f64 {
    let width = (band_hz.1 - band_hz.0) / steps.max(1) as f64;
    let mut sum = 0.0;
    for n in 0..steps {
        let f = band_hz.0 + (n as f64 + 0.5) * width;
        let s = snr(f);
        let omega = m::TAU * f;
        sum += omega * omega * s * s / (1.0 + sensors as f64 * s);
    }
    2.0 * seconds * sum * width
}

/// The limit for a direction (radians), wavefront curvature (1/m) and the information of [`arrival_information`] with
/// four sensors. `None` where the geometry or the signal leave the angles undetermined (the zenith included).
pub fn angle_limit(
    geometry: &Geometry,
    azimuth: f64,
    elevation: f64,
    curvature: f64,
    arrival_information: f64,
) -> Option<AngleLimit> {
    let u = unit_vector(azimuth as f32, elevation as f32);
    let e = wavefront::tangents(&u);
    let g1 = wavefront::gradient(geometry, &u, &e.0, curvature as f32);
    let g2 = wavefront::gradient(geometry, &u, &e.1, curvature as f32);
    let (first, cross, second) = wavefront::inverse(wavefront::information(&g1, &g2))?;
    let cos = m::cos(elevation);
    if !(arrival_information > 0.0 && cos > 1e-6) {
        return None;
    }
    let of = |x: f32| f64::from(x) / arrival_information;
    Some(AngleLimit { var_azimuth: of(first) / (cos * cos), var_elevation: of(second), cov: of(cross) / cos })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_sensors_give_the_usual_delay_bound() {
        // White band 0..B with constant S: 2T (2π)² B³/3 · S²/(1+2S).
        let (b, s, t) = (1000.0, 0.5, 2.0);
        let closed = 2.0 * t * m::TAU * m::TAU * b * b * b / 3.0 * s * s / (1.0 + 2.0 * s);
        let sum = arrival_information(2, (0.0, b), t, |_| s, 2000);
        assert!((sum / closed - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_regular_tetrahedron_is_equally_good_everywhere() {
        let edge = 1.85;
        let r = edge / 3f64.sqrt();
        let h = edge * (2f64 / 3.0).sqrt();
        let sensors = [
            [0.0, r, -h / 4.0],
            [r * 0.75f64.sqrt(), -r / 2.0, -h / 4.0],
            [-r * 0.75f64.sqrt(), -r / 2.0, -h / 4.0],
            [0.0, 0.0, 0.75 * h],
        ];
        let g = Geometry::new(&sensors, 0.0, 1484.0).unwrap();
        // Isotropic: GᵀPG = 2 (edge/c)² I for every direction.
        let info = arrival_information(4, (50.0, 25_000.0), 1.0, |_| 1.0, 1000);
        let closed = 1.0 / (info * 2.0 * (edge / 1484.0) * (edge / 1484.0));
        for (azimuth, elevation) in [(1.0, 0.3), (4.0, -0.8)] {
            let l = angle_limit(&g, azimuth, elevation, 0.0, info).unwrap();
            let cos = elevation.cos();
            assert!((l.var_elevation / closed - 1.0).abs() < 1e-4);
            assert!((l.var_azimuth * cos * cos / closed - 1.0).abs() < 1e-4);
            assert!(l.cov.abs() < 1e-4 * closed);
        }
        assert!(angle_limit(&g, 0.0, m::FRAC_PI_2, 0.0, info).is_none());
    }
}
