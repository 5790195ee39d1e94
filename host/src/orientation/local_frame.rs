//! Latitude and longitude to a local East-North frame and back, metres.
//!
//! The tangent plane of the WGS84 ellipsoid at an origin: radii of curvature of the meridian and the prime vertical
//! there. Within 50 km of the origin the plane is off by less than 2 m at middle latitudes.

use seabearing_core::angle::wrap_pi;

/// Equatorial radius (m) and squared eccentricity of WGS84.
const RADIUS_M: f64 = 6_378_137.0;
const ECCENTRICITY_2: f64 = 0.006_694_379_990_14;

/// A local frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    /// Latitude and longitude of the origin, degrees.
    pub origin_deg: (f64, f64),
    metres_per_rad: (f64, f64),
}

impl LocalFrame {
    /// A frame at an origin, degrees.
    pub fn new(lat_deg: f64, lon_deg: f64) -> Self {
        let (s, c) = lat_deg.to_radians().sin_cos();
        let w = 1.0 - ECCENTRICITY_2 * s * s;
        let prime_vertical = RADIUS_M / w.sqrt();
        let meridian = RADIUS_M * (1.0 - ECCENTRICITY_2) / (w * w.sqrt());
        Self { origin_deg: (lat_deg, lon_deg), metres_per_rad: (meridian, prime_vertical * c) }
    }

    /// East and North of a position, metres.
    pub fn east_north_m(&self, lat_deg: f64, lon_deg: f64) -> (f64, f64) {
        let (north, east) = self.metres_per_rad;
        let d_lon = wrap_pi((lon_deg - self.origin_deg.1).to_radians());
        (east * d_lon, north * (lat_deg - self.origin_deg.0).to_radians())
    }

    /// Latitude and longitude of a local position, degrees.
    pub fn lat_lon_deg(&self, east_m: f64, north_m: f64) -> (f64, f64) {
        let (north, east) = self.metres_per_rad;
        (self.origin_deg.0 + (north_m / north).to_degrees(), self.origin_deg.1 + (east_m / east).to_degrees())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_and_a_known_length() {
        let f = LocalFrame::new(49.04, -123.32);
        let (e, n) = f.east_north_m(49.05, -123.30);
        let (lat, lon) = f.lat_lon_deg(e, n);
        assert!((lat - 49.05).abs() < 1e-12 && (lon + 123.30).abs() < 1e-12);
        // One degree of latitude at 49° is 111.2 km; 0.01° is 1112 m.
        assert!((n - 1112.1).abs() < 0.5, "{n}");
    }
}
