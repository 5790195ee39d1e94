//! The track of a vessel with known positions, as a station sees it.

use crate::csv::{CsvTable, good_rows};
use crate::geodesy::LocalFrame;
use anyhow::{Result, anyhow, bail};
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
    let name = path.display().to_string();
    let up_m = station.depth_m - source_depth_m;
    let local = table.has("x_m");
    let (first, second) = if local {
        ("x_m", "y_m")
    } else if table.has("lat_deg") {
        ("lat_deg", "lon_deg")
    } else if table.has("lat") {
        ("lat", "lon")
    } else {
        bail!("{name}: the header needs t_s,x_m,y_m or t_s,lat,lon")
    };
    let rows = good_rows(&name, table.numbers(["t_s", first, second])?)?;
    let (east, north) = station.local_east_north_m.unwrap_or((0.0, 0.0));
    let frame = station.lat_lon_deg.map(|(lat, lon)| LocalFrame::new(lat, lon));
    let mut track = rows
        .into_iter()
        .map(|[t_s, a, b]| {
            let (x, y) = match (local, &frame) {
                (true, _) => (a - east, b - north),
                (false, Some(frame)) => frame.east_north_m(a, b),
                (false, None) => {
                    return Err(anyhow!(
                        "{name} has latitudes, but the station file no lat_deg and lon_deg of the station"
                    ));
                }
            };
            Ok(TrackPoint { t_s, position_m: [x, y, up_m] })
        })
        .collect::<Result<Vec<_>>>()?;
    track.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    track.dedup_by(|later, first| later.t_s == first.t_s);
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
