//! What a bearing of the compact array errs by beyond the physical limit: hydrophones that are not where the file has them,
//! and a speed of sound that is not the file's. Both last: they do not average out.

use seabearing_core::angle::unit_vector;
use seabearing_core::array::limit::angle_limit;
use seabearing_core::array::wavefront::{arrivals, gradient, information, inverse, tangents};
use seabearing_core::config::{ArrayConfig, StationConfig};
use seabearing_core::geometry::Geometry;
use seabearing_core::kit::spd;

/// Hydrophones of the array.
const SENSORS: f64 = 4.0;

/// Standard deviations of a bearing, radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AngleSd {
    /// Of the azimuth.
    pub azimuth: f64,
    /// Of the elevation.
    pub elevation: f64,
}

impl AngleSd {
    /// The larger of both, each by itself.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self { azimuth: self.azimuth.max(other.azimuth), elevation: self.elevation.max(other.elevation) }
    }

    /// Both, independent of each other.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self { azimuth: self.azimuth.hypot(other.azimuth), elevation: self.elevation.hypot(other.elevation) }
    }
}

/// What noise alone leaves: the physical limit for an information of [`seabearing_core::array::limit::arrival_information`], towards
/// an azimuth and elevation (radians). `None` where the geometry leaves the angles undetermined.
pub fn noise(
    geometry: &Geometry,
    array: &ArrayConfig,
    (azimuth, elevation): (f64, f64),
    information: f64,
) -> Option<AngleSd> {
    let found = angle_limit(geometry, azimuth, elevation, 1.0 / array.reference_range_m, information)?;
    Some(AngleSd { azimuth: found.var_azimuth.sqrt(), elevation: found.var_elevation.sqrt() })
}

/// What `position_sd_m` and `sound_speed_sd_m_s` add, as the recorder counts them in what it states (`core/src/array/report.rs`).
pub fn lasting(
    geometry: &Geometry,
    station: &StationConfig,
    array: &ArrayConfig,
    (azimuth, elevation): (f64, f64),
) -> Option<AngleSd> {
    // Each hydrophone moves its arrival by its displacement towards the source, independent of the others.
    let sigma_s = array.position_sd_m / station.sound_speed_m_s;
    let places = match sigma_s > 0.0 {
        true => noise(geometry, array, (azimuth, elevation), 1.0 / (SENSORS * sigma_s * sigma_s))?,
        false => AngleSd::default(),
    };
    // The speed of sound changes all arrivals in proportion: the part of that which looks like another direction.
    let curvature = (1.0 / array.reference_range_m) as f32;
    let u = unit_vector(azimuth as f32, elevation as f32);
    let e = tangents(&u);
    let (g1, g2) = (gradient(geometry, &u, &e.0, curvature), gradient(geometry, &u, &e.1, curvature));
    let times = arrivals(geometry, &u, curvature);
    let (a, b, c) = inverse(information(&g1, &g2))?;
    let (_, first, _) = information(&g1, &times);
    let (_, second, _) = information(&g2, &times);
    let step = spd::times(&[[a, b], [b, c]].map(|row| row.map(f64::from)), &[first, second].map(f64::from));
    let relative = array.sound_speed_sd_m_s / station.sound_speed_m_s;
    let speed = AngleSd {
        azimuth: (relative * step[0]).abs() / elevation.cos().max(1e-6),
        elevation: (relative * step[1]).abs(),
    };
    Some(places.with(speed))
}

/// The largest of a ring of azimuths, ten degrees apart, at an elevation (radians): the geometry decides which.
pub fn worst(elevation: f64, of: impl Fn((f64, f64)) -> Option<AngleSd>) -> AngleSd {
    let ring = (0..36).filter_map(|n| of(((f64::from(n) * 10.0).to_radians(), elevation)));
    ring.fold(AngleSd::default(), AngleSd::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::config::Kind;

    /// The regular tetrahedron of `scenarios/tetrahedron.toml`.
    const TETRAHEDRON: [[f64; 3]; 4] =
        [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];

    fn stated(hydrophones_m: [[f64; 3]; 4], position_sd_m: f64, sound_speed_sd_m_s: f64) -> AngleSd {
        let mut station = StationConfig::array(64_000.0, hydrophones_m);
        let Kind::Array(array) = &mut station.kind else { unreachable!() };
        (array.position_sd_m, array.sound_speed_sd_m_s) = (position_sd_m, sound_speed_sd_m_s);
        let array = array.clone();
        let geometry = station.geometry().unwrap();
        worst(0.35, |at| lasting(&geometry, &station, &array, at))
    }

    #[test]
    fn a_centimetre_is_what_it_is_by_hand_and_nothing_is_nothing() {
        assert_eq!(stated(TETRAHEDRON, 0.0, 0.0), AngleSd::default());
        // Σ x² over the four is half the squared edge of 1.84 m in every direction: σ / (edge/√2).
        let by_hand = 0.01 * 2f64.sqrt() / 1.84;
        let found = stated(TETRAHEDRON, 0.01, 0.0);
        assert!((found.elevation / by_hand - 1.0).abs() < 0.01, "{found:?} {by_hand}");
        assert!((found.azimuth * 0.35f64.cos() / by_hand - 1.0).abs() < 0.01, "{found:?}");
    }

    #[test]
    fn a_regular_array_bears_any_speed_of_sound_and_a_flat_one_does_not() {
        assert!(stated(TETRAHEDRON, 0.0, 10.0).elevation < 1e-3);
        // Nearly flat: cos β is in proportion to the speed, so that dβ = cot β dc/c.
        let flat = TETRAHEDRON.map(|[x, y, z]| [x, y, 0.02 * z]);
        let found = stated(flat, 0.0, 10.0);
        assert!(found.elevation > 0.5 * 10.0 / 1484.0 / 0.35f64.tan(), "{found:?}");
    }
}
