//! Where the stations of a region stand, in one plane.

use crate::stations::Listed;
use seabearing_host::geodesy::LocalFrame;

/// Nearest to a pole that North still has a direction, degrees.
const HIGHEST_LAT_DEG: f64 = 89.999;
/// Step by which North is found, degrees.
const NORTH_STEP_DEG: f64 = 1e-4;

/// Where a station stands.
#[derive(Clone, Copy, Debug)]
pub enum Place {
    /// East and North in a plane of its own, metres.
    Plane(f64, f64),
    /// On the Earth.
    Earth(LocalFrame),
}

impl Place {
    /// Of a station of a stations file; `in_plane`: none of the file has a latitude.
    ///
    /// # Errors
    /// It has no place, or none where North is a direction; said as what follows "station 7".
    pub fn of(s: &Listed, in_plane: bool) -> Result<Self, String> {
        let place = if in_plane {
            s.config.local_east_north_m.map(|(x, y)| Self::Plane(x, y))
        } else {
            s.config.lat_lon_deg.map(|(lat, lon)| Self::Earth(LocalFrame::new(lat, lon)))
        };
        let place = place.ok_or("has no position (lat_deg and lon_deg, or local_m in all stations)")?;
        match place.frame().map(|f| f.origin_deg.0) {
            Some(lat) if lat.abs() > HIGHEST_LAT_DEG => {
                Err(format!("is at latitude {lat}°, where North has no direction"))
            }
            _ => Ok(place),
        }
    }

    fn frame(&self) -> Option<LocalFrame> {
        match self {
            Self::Plane(..) => None,
            Self::Earth(frame) => Some(*frame),
        }
    }

    /// Distance to another, metres: the shortest way over the sea.
    pub fn distance_m(&self, other: &Self) -> f64 {
        match (self, other) {
            (Self::Plane(x, y), Self::Plane(u, v)) => (x - u).hypot(y - v),
            (Self::Earth(a), Self::Earth(b)) => {
                let (east, north) = a.east_north_m(b.origin_deg.0, b.origin_deg.1);
                east.hypot(north)
            }
            _ => f64::INFINITY,
        }
    }
}

/// A station whose bearings are fused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Site {
    /// Number of the station.
    pub station: u16,
    /// East, North, up of the plane's origin, metres.
    pub at_m: [f64; 3],
    /// Azimuth in the plane of the station's own true North, radians: meridians are not parallel.
    pub north: f64,
    /// Standard deviation of its orientation, radians.
    pub sd_orientation: f64,
    /// Standard deviation of its clock, s, where it is not what the recorder states.
    pub sd_clock_s: Option<f64>,
    /// Speed of sound, m/s.
    pub sound_speed_m_s: f64,
}

/// All of them.
#[derive(Clone, Debug, Default)]
pub struct Sites {
    /// The stations, at most [`MAX_ARRAYS`](seabearing_locate::network::MAX_ARRAYS).
    pub sites: Vec<Site>,
    /// The plane, where latitudes are known; its origin is the first station.
    pub frame: Option<LocalFrame>,
}

impl Sites {
    /// Of the stations of one region; those on the Earth stand in the plane of the first.
    pub fn of(stations: &[(&Listed, Place)]) -> Self {
        let frame = stations.first().and_then(|(_, place)| place.frame());
        let site = |(s, place): &(&Listed, Place)| {
            let (at, turned) = match (place, &frame) {
                (Place::Earth(own), Some(plane)) => {
                    let (lat, lon) = own.origin_deg;
                    let at = plane.east_north_m(lat, lon);
                    (at, north(plane, at, (lat, lon)))
                }
                (Place::Earth(_), None) => ((0.0, 0.0), 0.0),
                (Place::Plane(x, y), _) => ((*x, *y), 0.0),
            };
            Site {
                station: s.config.id,
                at_m: [at.0, at.1, -s.config.depth_m],
                north: turned,
                sd_orientation: s.sd_orientation_deg.to_radians(),
                sd_clock_s: s.sd_clock_s,
                sound_speed_m_s: s.config.sound_speed_m_s,
            }
        };
        Self { sites: stations.iter().map(site).collect(), frame }
    }

    /// Their numbers, as a person reads them: `1 to 4, 7`.
    pub fn numbers(&self) -> String {
        let mut numbers: Vec<u16> = self.sites.iter().map(|s| s.station).collect();
        numbers.sort_unstable();
        let runs = numbers.chunk_by(|a, b| b - a == 1);
        let said = runs.map(|run| match run {
            [first, .., last] if run.len() > 2 => format!("{first} to {last}"),
            some => some.iter().map(u16::to_string).collect::<Vec<_>>().join(", "),
        });
        said.collect::<Vec<_>>().join(", ")
    }

    /// Latitude and longitude of a place in the plane, degrees, where known, and the azimuth of its true North.
    pub fn lat_lon_deg(&self, at_m: [f64; 2]) -> (Option<(f64, f64)>, f64) {
        let Some(frame) = &self.frame else { return (None, 0.0) };
        let place = frame.lat_lon_deg(at_m[0], at_m[1]);
        (Some(place), north(frame, at_m.into(), place))
    }

    /// Which of them a station is.
    pub fn find(&self, station: u16) -> Option<usize> {
        self.sites.iter().position(|s| s.station == station)
    }
}

/// Azimuth in the plane of true North at a place of it.
fn north(frame: &LocalFrame, (x, y): (f64, f64), (lat, lon): (f64, f64)) -> f64 {
    let (east, north) = frame.east_north_m(lat + NORTH_STEP_DEG, lon);
    (east - x).atan2(north - y)
}
