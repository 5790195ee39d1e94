//! The track of a vessel with known positions, as a station sees it.

use crate::course::{fixes, in_order};
use crate::csv::{CsvTable, good_rows};
use anyhow::{Result, bail};
use seabearing_core::config::StationConfig;
use seabearing_locate::network::known_track::{TrackPoint, position_at};
use std::path::Path;

/// Reads `t_s,x_m,y_m` (the station's local frame) or `t_s,lat,lon`; East, North, Up relative to the station, in
/// order of time. Of rows with equal times the first is kept.
///
/// # Errors
/// The file cannot be read, has neither pair of columns, or fewer than two usable rows.
pub fn read(path: &Path, station: &StationConfig, source_depth_m: f64) -> Result<Vec<TrackPoint>> {
    let table = CsvTable::read(path)?;
    let name = table.name();
    let up_m = station.depth_m - source_depth_m;
    let local_m = station.local_east_north_m.unwrap_or((0.0, 0.0));
    let mut fixes = good_rows(name, fixes(&table, station.lat_lon_deg, local_m)?)?;
    in_order(&mut fixes);
    let track: Vec<_> =
        fixes.into_iter().map(|(t_s, (x, y))| TrackPoint { t_s, position_m: [x, y, up_m] }).collect();
    if track.len() < 2 {
        bail!("{name}: a track needs two positions at different times");
    }
    Ok(track)
}

/// Where the vessel was when the sound that arrives at `t_s` left it.
pub fn heard_at(track: &[TrackPoint], t_s: f64, gap_s: f64, sound_speed_m_s: f64) -> Option<[f64; 3]> {
    let distance = |p: &[f64; 3]| p.iter().map(|x| x * x).sum::<f64>().sqrt();
    let first = position_at(track, t_s, gap_s)?;
    position_at(track, t_s - distance(&first) / sound_speed_m_s, gap_s).or(Some(first))
}

/// The track as it is heard: each position at the time when its sound arrives. `up_m`: the vessel's height above the station, in place
/// of the track's own.
pub fn as_heard(track: &[TrackPoint], up_m: f64, sound_speed_m_s: f64) -> Vec<TrackPoint> {
    let mut heard: Vec<TrackPoint> = track
        .iter()
        .map(|p| {
            let [x, y, _] = p.position_m;
            let way_s = (x * x + y * y + up_m * up_m).sqrt() / sound_speed_m_s;
            TrackPoint { t_s: p.t_s + way_s, position_m: [x, y, up_m] }
        })
        .collect();
    // A position that would be heard before the one before it is one that no vessel was at.
    heard.dedup_by(|later, earlier| later.t_s <= earlier.t_s);
    heard
}
