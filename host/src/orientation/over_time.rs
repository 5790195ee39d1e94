//! What bearings of a network tell over time: one straight motion, or how late a vessel of known track is heard.

use super::network_file::{Network, NetworkBearings};
use super::sets::BearingRow;
use super::track_file;
use anyhow::Result;
use seabearing_core::kit::median;
use seabearing_locate::network::align::{AlignError, AlignSettings, Shift, TimedBearing, align};
use seabearing_locate::network::joint::{DatedSighting, JointSettings, JointTrack, Scatter, fit};
use seabearing_locate::network::{MAX_ARRAYS, NetworkError, Sighting};
use std::path::Path;

/// Depth of a vessel's sound source where none is given, metres: a propeller's.
pub const SOURCE_DEPTH_M: f64 = 5.0;
/// Longest gap of a known track that is interpolated, seconds.
const TRACK_GAP_S: f64 = 300.0;

/// The stations that have bearings, in the order of the network.
pub fn heard_by(network: &Network, rows: &[BearingRow]) -> Vec<usize> {
    (0..network.stations.len()).filter(|i| rows.iter().any(|r| r.station == *i)).collect()
}

/// One straight motion from all bearings, which are brought in order of time. `tau_s`: interval over which successive
/// bearings of an array share one error; `robust`: an array that contradicts the others is set aside.
///
/// # Errors
/// The bearings do not determine the motion.
pub fn motion(
    network: &Network,
    heard: &mut NetworkBearings,
    tau_s: f64,
    source_depth_m: f64,
    robust: bool,
) -> Result<JointTrack, NetworkError> {
    let rows = &mut heard.rows;
    rows.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    // Errors that last over so many bearings weigh like one.
    let alike: [f64; MAX_ARRAYS] = core::array::from_fn(|i| (tau_s / interval_s(rows, i)).max(1.0));
    let later: Vec<f64> = if heard.of_the_floor {
        rows.iter().map(|r| later_s(network, rows, r, source_depth_m)).collect()
    } else {
        vec![0.0; rows.len()]
    };
    let bearings: Vec<DatedSighting> = rows
        .iter()
        .zip(later)
        .map(|(r, later_s)| DatedSighting {
            t_s: r.t_s - later_s,
            array: r.station,
            sighting: Sighting {
                array_m: network.arrays_m[r.station],
                azimuth: r.azimuth,
                elevation: r.elevation,
                sd_azimuth: r.sd.0 * alike[r.station].sqrt(),
                sd_elevation: r.sd.1 * alike[r.station].sqrt(),
            },
        })
        .collect();
    let first = rows.iter().map(|r| r.station).min().unwrap_or(0);
    let sound_speed_m_s = network.stations[first].sound_speed_m_s;
    let shared = network.shared(&heard.sd_clock_s);
    let scatter = Scatter::Measured;
    // Ranges are off by what the ways of the sound are, from the first to the last.
    let alike = if heard.of_the_floor { [f64::INFINITY; MAX_ARRAYS] } else { alike };
    let z_m = -source_depth_m;
    fit(&bearings, &JointSettings { z_m, sound_speed_m_s, robust, scatter, shared, alike })
}

/// Longest time from a bearing without range to the station's nearest with one that tells how far the vessel was, seconds.
const RANGE_WITHIN_S: f64 = 1800.0;

/// How much later than straight a station at the floor hears a vessel: what is loudest from afar has been at the surface and the floor
/// once more, three times through the water [O, II]. Two seconds at 20 km in 4300 m, in which a vessel goes on by 15 m.
fn later_s(network: &Network, rows: &[BearingRow], row: &BearingRow, source_depth_m: f64) -> f64 {
    let depth_m = -source_depth_m - network.arrays_m[row.station][2];
    let own = rows.iter().filter(|r| r.station == row.station && r.elevation.is_some_and(|e| e > 0.0));
    let nearest = own.min_by(|a, b| (a.t_s - row.t_s).abs().total_cmp(&(b.t_s - row.t_s).abs()));
    let Some(elevation) =
        nearest.filter(|r| (r.t_s - row.t_s).abs() <= RANGE_WITHIN_S).and_then(|r| r.elevation)
    else {
        return 0.0;
    };
    let range_m = depth_m / elevation.tan();
    (range_m.hypot(3.0 * depth_m) - range_m.hypot(depth_m)) / network.stations[row.station].sound_speed_m_s
}

/// Median time between bearings of one station, seconds; infinite where there are fewer than two.
fn interval_s(rows: &[BearingRow], station: usize) -> f64 {
    let times: Vec<f64> = rows.iter().filter(|r| r.station == station).map(|r| r.t_s).collect();
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|s| *s > 0.0).collect();
    median(&mut steps).unwrap_or(f64::INFINITY)
}

/// How late a station hears the vessel behind its known track. `sd`: of azimuth and elevation, radians.
///
/// # Errors
/// The track file cannot be used; within, why the bearings tell no shift.
pub fn shift(
    network: &Network,
    station: usize,
    rows: &[BearingRow],
    track: &Path,
    source_depth_m: f64,
    sd: [f64; 2],
    largest_shift_s: f64,
) -> Result<Result<Shift, AlignError>> {
    let station_config = &network.stations[station];
    let sound_speed_m_s = station_config.sound_speed_m_s;
    let track = track_file::read(track, station_config, source_depth_m)?;
    let heard: Vec<TimedBearing> = rows
        .iter()
        .filter(|r| r.station == station)
        .map(|r| {
            // What is heard left the vessel the travel time ago: the shift is that of the source alone.
            let from = track_file::heard_at(&track, r.t_s, TRACK_GAP_S, sound_speed_m_s);
            let travel_s =
                from.map_or(0.0, |p| p.iter().map(|x| x * x).sum::<f64>().sqrt() / sound_speed_m_s);
            TimedBearing { t_s: r.t_s - travel_s, azimuth: Some(r.azimuth), elevation: r.elevation }
        })
        .collect();
    Ok(align(&heard, &track, &AlignSettings { array_m: [0.0; 3], sd, largest_shift_s, gap_s: TRACK_GAP_S }))
}
