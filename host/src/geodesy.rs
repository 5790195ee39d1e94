//! Latitude and longitude to East and North of a place, and back: the project's one map projection.
//!
//! Azimuthal equidistant about the origin on the WGS84 ellipsoid: the chord gives the direction, and with the local radius
//! of curvature the length of the arc, within a metre in 100 km.

/// Equatorial radius (m) and squared eccentricity of WGS84.
const RADIUS_M: f64 = 6_378_137.0;
const ECCENTRICITY_2: f64 = 0.006_694_379_990_14;
/// Turns of the way back; each shrinks what is left by the share of the Earth's radius it is from the origin.
const TURNS: usize = 8;

/// A local frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    /// Latitude and longitude of the origin, degrees.
    pub origin_deg: (f64, f64),
    centre_m: [f64; 3],
    sin_cos_lat: (f64, f64),
    sin_cos_lon: (f64, f64),
    /// Radii of curvature of the meridian and of the prime vertical, m.
    radii_m: (f64, f64),
}

impl LocalFrame {
    /// A frame at an origin, degrees.
    pub fn new(lat_deg: f64, lon_deg: f64) -> Self {
        let sin_cos_lat = lat_deg.to_radians().sin_cos();
        let w = (1.0 - ECCENTRICITY_2 * sin_cos_lat.0 * sin_cos_lat.0).sqrt();
        Self {
            origin_deg: (lat_deg, lon_deg),
            centre_m: centred(lat_deg, lon_deg),
            sin_cos_lat,
            sin_cos_lon: lon_deg.to_radians().sin_cos(),
            radii_m: (RADIUS_M * (1.0 - ECCENTRICITY_2) / (w * w * w), RADIUS_M / w),
        }
    }

    /// East and North of a position, metres; the distance is the arc's, also beyond the horizon.
    pub fn east_north_m(&self, lat_deg: f64, lon_deg: f64) -> (f64, f64) {
        let (p, o) = (centred(lat_deg, lon_deg), self.centre_m);
        let d = [p[0] - o[0], p[1] - o[1], p[2] - o[2]];
        let ((s, c), (sl, cl)) = (self.sin_cos_lat, self.sin_cos_lon);
        let east = -sl * d[0] + cl * d[1];
        let north = -s * cl * d[0] - s * sl * d[1] + c * d[2];
        let chord = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let flat = east.hypot(north);
        if flat == 0.0 {
            // Here, or on the other side of the Earth, where every direction leads there.
            return (0.0, if chord < RADIUS_M { 0.0 } else { std::f64::consts::PI * RADIUS_M });
        }
        let (meridian, vertical) = self.radii_m;
        let (cos2, sin2) = ((north / flat).powi(2), (east / flat).powi(2));
        let radius = 1.0 / (cos2 / meridian + sin2 / vertical);
        let arc = 2.0 * radius * (chord / (2.0 * radius)).min(1.0).asin();
        (east / flat * arc, north / flat * arc)
    }

    /// Latitude and longitude of a local position, degrees: the inverse of [`Self::east_north_m`] within 1000 km, by steps
    /// on the tangent plane, where a pole is a place like any other.
    pub fn lat_lon_deg(&self, east_m: f64, north_m: f64) -> (f64, f64) {
        let (o, (s, c), (sl, cl)) = (self.centre_m, self.sin_cos_lat, self.sin_cos_lon);
        let (mut u, mut v) = (east_m, north_m);
        let mut at = self.origin_deg;
        for _ in 0..TURNS {
            let (x, y) = (o[0] - u * sl - v * s * cl, o[1] + u * cl - v * s * sl);
            let z = o[2] + v * c;
            let lat = z.atan2(x.hypot(y) * (1.0 - ECCENTRICITY_2));
            at = (lat.to_degrees(), y.atan2(x).to_degrees());
            let (e, n) = self.east_north_m(at.0, at.1);
            (u, v) = (u + east_m - e, v + north_m - n);
        }
        at
    }
}

/// A place on the ellipsoid from the Earth's centre, m.
fn centred(lat_deg: f64, lon_deg: f64) -> [f64; 3] {
    let ((s, c), (sl, cl)) = (lat_deg.to_radians().sin_cos(), lon_deg.to_radians().sin_cos());
    let n = RADIUS_M / (1.0 - ECCENTRICITY_2 * s * s).sqrt();
    [n * c * cl, n * c * sl, n * (1.0 - ECCENTRICITY_2) * s]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_and_a_known_length() {
        let f = LocalFrame::new(49.04, -123.32);
        let (e, n) = f.east_north_m(49.05, -123.30);
        let (lat, lon) = f.lat_lon_deg(e, n);
        assert!((lat - 49.05).abs() < 1e-10 && (lon + 123.30).abs() < 1e-10, "{lat} {lon}");
        // One degree of latitude at 49° is 111.2 km; 0.01° is 1112 m.
        assert!((n - 1112.1).abs() < 0.5, "{n}");
    }

    #[test]
    fn there_and_back_a_hundred_kilometres_away_and_across_the_date_line() {
        for (origin, at) in [((49.0, -123.0), (49.7, -122.1)), ((-20.0, 179.9), (-20.3, -179.8))] {
            let f = LocalFrame::new(origin.0, origin.1);
            let (e, n) = f.east_north_m(at.0, at.1);
            assert!(e.hypot(n) < 120e3 && e > 0.0);
            let (lat, lon) = f.lat_lon_deg(e, n);
            let turn = crate::angle::turn_deg(at.1, lon);
            assert!((lat - at.0).abs() < 1e-9 && turn.abs() < 1e-9 && lon.abs() <= 180.0, "{lat} {lon}");
        }
    }

    #[test]
    fn there_and_back_about_the_poles() {
        for (lat, lon) in [(90.0, 0.0), (-90.0, 20.0), (89.99, 30.0), (-89.9, 170.0), (89.0, -10.0)] {
            let f = LocalFrame::new(lat, lon);
            for (x, y) in [(0.0, 0.0), (1000.0, 0.0), (0.0, 3000.0), (-20e3, 15e3), (70e3, -70e3)] {
                let at = f.lat_lon_deg(x, y);
                let (e, n) = f.east_north_m(at.0, at.1);
                assert!((e - x).hypot(n - y) < 1e-3, "{lat} {x} {y}: {e} {n}");
                assert!(at.0.abs() <= 90.0 && at.1.abs() <= 180.0, "{at:?}");
            }
        }
    }

    #[test]
    fn against_known_arcs() {
        // One degree of longitude on the equator is 111 319.49 m, one of latitude at 45° about 111 131.8 m.
        let (x, y) = LocalFrame::new(0.0, 10.0).east_north_m(0.0, 10.5);
        assert!((x - 55_659.75).abs() < 0.5 && y.abs() < 1e-6, "{x} {y}");
        let (x, y) = LocalFrame::new(45.0, 0.0).east_north_m(45.5, 0.0);
        assert!(x.abs() < 1e-6 && (y - 55_570.8).abs() < 3.0, "{x} {y}");
    }
}
