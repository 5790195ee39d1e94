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
    one_vessel(&table)?;
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

/// Columns that name the vessel of a row.
const VESSELS: [&str; 4] = ["source", "vessel", "mmsi", "name"];

/// Refuses a table whose rows are several vessels': as one track they would be one vessel that jumps between them.
fn one_vessel(table: &CsvTable) -> Result<()> {
    for column in VESSELS.into_iter().filter(|c| table.has(c)) {
        let at = table.column(column)?;
        // Rows without a position, as calls have them in a truth table, are no vessel's.
        let first = ["x_m", "lat_deg", "lat"].into_iter().find(|c| table.has(c));
        let place = table.column(first.unwrap_or("x_m"))?;
        let has_place = |row: &usize| table.text(*row, place).is_some_and(|x| !x.trim().is_empty());
        let rows = (0..table.len()).filter(has_place);
        let name = |row| table.text(row, at).filter(|name| !name.trim().is_empty());
        let mut names: Vec<&str> = rows.filter_map(name).collect();
        names.sort_unstable();
        names.dedup();
        if let [first, second, ..] = names[..] {
            bail!(
                "{}: rows of {} vessels in column `{column}` ({first}, {second}{}): a track is of one; give a file of the rows of one, as --track for each",
                table.name(),
                names.len(),
                if names.len() > 2 { ", …" } else { "" }
            );
        }
    }
    Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_several_vessels_are_no_track() {
        let of = |rows: &str| {
            one_vessel(&CsvTable::parse(&format!("t_s,source,x_m,y_m\n{rows}"), "truth.csv").unwrap())
        };
        assert!(of("0,1,5,6\n10,1,7,8\n20,3,,\n").is_ok());
        // One that is not always named.
        assert!(of("0,1,5,6\n10,,7,8\n").is_ok());
        let refused = of("0,1,5,6\n10,2,7,8\n").unwrap_err().to_string();
        assert!(refused.contains("`source`") && refused.lines().count() == 1, "{refused}");
    }
}
