//! The error model of an array's bearings, from a vessel of known track.

use super::BatchRoom;
use crate::csv::{CsvTable, good_rows};
use crate::orientation::track_file::heard_at;
use anyhow::{Result, bail};
use seabearing_core::angle::wrap_pi;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::errors::{self, ErrorModel};
use seabearing_locate::motion::ml::Sample;
use seabearing_locate::network::known_track::TrackPoint;
use std::path::Path;

/// The error model, and from how many bearings: those within the track `t_s,x_m,y_m` (East and North of the array).
///
/// # Errors
/// The track file cannot be used, or too few bearings lie within it.
pub fn of_known_track(
    model: Model,
    samples: &[Sample],
    track: &Path,
    sound_speed_m_s: f64,
) -> Result<(ErrorModel, usize)> {
    let name = track.display().to_string();
    let rows = good_rows(&name, CsvTable::read(track)?.numbers(["t_s", "x_m", "y_m"])?)?;
    let mut known: Vec<TrackPoint> =
        rows.into_iter().map(|[t_s, x, y]| TrackPoint { t_s, position_m: [x, y, 0.0] }).collect();
    known.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    let differences: Vec<(f64, f64)> = samples
        .iter()
        .filter_map(|s| {
            let [x, y, _] = heard_at(&known, s.t_s, f64::INFINITY, sound_speed_m_s)?;
            Some((s.t_s, wrap_pi(s.azimuth_rad - x.atan2(y))))
        })
        .collect();
    let n = differences.len();
    let found =
        BatchRoom::new().with(|e| Some(*e), |work, dense| errors::estimate(model, &differences, work, dense));
    match found {
        Ok(found) => Ok((found, n)),
        Err(_) => {
            bail!("{name}: {n} bearings within the known track do not give an error model (8 are needed)")
        }
    }
}
