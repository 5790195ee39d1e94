//! Where the stations stand, in one plane.

use crate::stations::Listed;
use seabearing_host::angle::turn_deg;
use seabearing_host::geodesy::LocalFrame;
use seabearing_locate::network::MAX_ARRAYS;

/// Farthest that a station may be from the first, metres: beyond, the plane is no picture of the sea.
const FARTHEST_M: f64 = 100_000.0;
/// Nearest to a pole that North still has a direction, degrees.
const HIGHEST_LAT_DEG: f64 = 89.999;
/// Step by which North is found, degrees.
const NORTH_STEP_DEG: f64 = 1e-4;

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
    /// Speed of sound, m/s.
    pub sound_speed_m_s: f64,
}

/// All of them.
#[derive(Clone, Debug, Default)]
pub struct Sites {
    /// The stations, at most [`MAX_ARRAYS`].
    pub sites: Vec<Site>,
    /// The plane, where latitudes are known; its origin is the first station.
    pub frame: Option<LocalFrame>,
    /// Stations that would be fused if there were not so many.
    pub beyond: usize,
}

impl Sites {
    /// Of a stations file, and a line for each station that cannot take part.
    pub fn of(listed: &[Listed]) -> (Self, Vec<String>) {
        let (mut out, mut notes, mut beyond) = (Self::default(), Vec::new(), Vec::new());
        let local = |s: &Listed| s.config.local_east_north_m;
        let plane = !listed.is_empty() && listed.iter().all(|s| s.config.lat_lon_deg.is_none());
        for s in listed {
            let (config, id) = (&s.config, s.config.id);
            let place = if plane { local(s).map(|p| (p, 0.0)).ok_or_else(none) } else { out.place(s) };
            let (at, north) = match place {
                Ok(_) if out.sites.len() == MAX_ARRAYS => {
                    beyond.push(id);
                    continue;
                }
                Ok(place) => place,
                Err(why) => {
                    notes.push(format!("station {id} {why}; its bearings are not fused"));
                    continue;
                }
            };
            out.sites.push(Site {
                station: id,
                at_m: [at.0, at.1, -config.depth_m],
                north,
                sd_orientation: s.sd_orientation_deg.to_radians(),
                sound_speed_m_s: config.sound_speed_m_s,
            });
        }
        if let [first, .., last] | [first @ last] = &beyond[..] {
            notes.push(format!(
                "{MAX_ARRAYS} stations are fused, the first of the stations file; {} are not (from {first} to {last}): give the \
                 stations of each region to a base station of its own",
                beyond.len()
            ));
        }
        out.beyond = beyond.len();
        (out, notes)
    }

    /// East and North of a station, and its North; the first one makes the plane.
    fn place(&mut self, s: &Listed) -> Result<((f64, f64), f64), String> {
        let (lat, lon) = s.config.lat_lon_deg.ok_or_else(none)?;
        if lat.abs() > HIGHEST_LAT_DEG {
            return Err(format!("is at latitude {lat}°, where North has no direction"));
        }
        let frame = *self.frame.get_or_insert_with(|| LocalFrame::new(lat, lon));
        let at = frame.east_north_m(lat, lon);
        let far = at.0.hypot(at.1);
        // Beyond the horizon the plane folds back.
        if far > FARTHEST_M || far_apart(frame.origin_deg, (lat, lon)) {
            let first = self.sites.first().map_or(0, |s| s.station);
            return Err(format!("is {:.0} km or more from station {first}", FARTHEST_M / 1000.0));
        }
        Ok((at, north(&frame, at, (lat, lon))))
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

fn none() -> String {
    "has no position (lat_deg and lon_deg, or local_m in all stations)".to_owned()
}

/// More than a few degrees of the sphere.
fn far_apart(a: (f64, f64), b: (f64, f64)) -> bool {
    let across = turn_deg(a.1, b.1).abs() * a.0.to_radians().cos().min(b.0.to_radians().cos());
    (a.0 - b.0).abs().max(across) > 5.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::config::StationConfig;

    fn listed(id: u16, lat_lon_deg: Option<(f64, f64)>) -> Listed {
        let mut config = StationConfig::array(16_000.0, [[0.0; 3]; 4]);
        (config.id, config.lat_lon_deg, config.depth_m) = (id, lat_lon_deg, 100.0);
        Listed { config, line: None, key: None, start: None, sd_orientation_deg: 0.5 }
    }

    #[test]
    fn stations_beyond_the_most_are_counted_and_told_in_one_line() {
        let all: Vec<Listed> =
            (1..=20).map(|id| listed(id, Some((49.0, -123.0 + 0.01 * f64::from(id))))).collect();
        let (sites, notes) = Sites::of(&all);
        assert_eq!((sites.sites.len(), sites.beyond, notes.len()), (MAX_ARRAYS, 4, 1), "{notes:?}");
        assert!(notes[0].contains("4 are not (from 17 to 20)"), "{notes:?}");
    }

    #[test]
    fn stations_across_the_date_line_and_at_a_pole_stand_side_by_side() {
        let (sites, notes) = Sites::of(&[listed(1, Some((60.0, 179.99))), listed(2, Some((60.0, -179.99)))]);
        assert!(notes.is_empty(), "{notes:?}");
        let [_, east] = sites.sites[..] else { panic!() };
        assert!((east.at_m[0] - 1116.0).abs() < 2.0 && east.at_m[1].abs() < 1.0, "{east:?}");
        // 0.02° of longitude at 60° turn North by 0.0173°, to the West as one goes East.
        assert!((east.north.to_degrees() + 0.02 * 60f64.to_radians().sin()).abs() < 1e-4, "{east:?}");
        let (sites, notes) = Sites::of(&[listed(1, Some((89.99, 0.0))), listed(2, Some((89.99, 90.0)))]);
        assert!(notes.is_empty(), "{notes:?}");
        // A quarter of the way round the pole North is turned by a quarter circle.
        assert!((sites.sites[1].north.to_degrees() + 90.0).abs() < 0.01, "{:?}", sites.sites);
        let (sites, notes) = Sites::of(&[listed(1, Some((90.0, 0.0))), listed(2, Some((89.99, 90.0)))]);
        assert_eq!((sites.sites.len(), notes.len()), (1, 1));
        assert!(notes[0].starts_with("station 1 is at latitude 90°"), "{notes:?}");
    }

    #[test]
    fn who_has_no_position_or_is_far_away_is_named() {
        let all = [
            listed(1, Some((49.0, -123.0))),
            listed(2, None),
            listed(3, Some((49.0, -120.0))),
            listed(4, Some((-49.0, 57.0))),
            listed(5, Some((49.01, -123.0))),
        ];
        let (sites, notes) = Sites::of(&all);
        assert_eq!(sites.sites.iter().map(|s| s.station).collect::<Vec<_>>(), [1, 5]);
        for (note, said) in
            notes.iter().zip(["station 2 has no position", "station 3 is 100 km", "station 4 is 100 km"])
        {
            assert!(note.starts_with(said), "{note}");
        }
        assert_eq!(notes.len(), 3);
        let mut plane = [listed(1, None), listed(2, None)];
        plane[1].config.local_east_north_m = Some((1500.0, 20.0));
        let (sites, notes) = Sites::of(&plane);
        assert_eq!((sites.sites.len(), notes.len()), (1, 1));
        assert_eq!(sites.sites[0].at_m, [1500.0, 20.0, -100.0]);
    }
}
