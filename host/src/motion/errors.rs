//! The error model of an array's bearings, from a vessel of known track.

use super::BatchRoom;
use crate::csv::{CsvTable, good_rows};
use crate::orientation::track_file::heard_at;
use anyhow::{Result, bail};
use seabearing_core::angle::wrap_pi;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::errors::{self, Difference, ErrorModel};
use seabearing_locate::motion::ml::Sample;
use seabearing_locate::network::known_track::TrackPoint;
use std::path::Path;

/// Steps in which the shift is sought, and the last one's length at most, seconds (or a twentieth of its deviation).
const STEPS: usize = 20;
const LEAST_STEP_S: f64 = 0.01;
/// Greatest shift that is believed, seconds.
const MOST_SHIFT_S: f64 = 60.0;
/// Time over which the turning of the known azimuth is taken, seconds.
const RATE_OVER_S: f64 = 1.0;

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
    let azimuth = |t_s: f64| -> Option<f64> {
        let [x, y, _] = heard_at(&known, t_s, f64::INFINITY, sound_speed_m_s)?;
        Some(x.atan2(y))
    };
    let mut room = BatchRoom::new();
    let mut estimate = |shift_s: f64, shifting: bool| -> Result<(ErrorModel, usize)> {
        let difference = |s: &Sample| {
            let at_s = s.t_s - shift_s;
            let true_rad = azimuth(at_s)?;
            let (before, after) = (azimuth(at_s - 0.5 * RATE_OVER_S), azimuth(at_s + 0.5 * RATE_OVER_S));
            let turned = wrap_pi(after.unwrap_or(true_rad) - before.unwrap_or(true_rad));
            let over_s = RATE_OVER_S * if after.is_some() && before.is_some() { 1.0 } else { 0.5 };
            let rate_rad_s = if shifting { turned / over_s } else { 0.0 };
            Some(Difference { t_s: s.t_s, error_rad: wrap_pi(s.azimuth_rad - true_rad), rate_rad_s })
        };
        let differences: Vec<_> = samples.iter().filter_map(difference).collect();
        let n = differences.len();
        let found = room.with(|e| Some(*e), |work, dense| errors::estimate(model, &differences, work, dense));
        let Ok(found) = found else {
            bail!("{name}: {n} bearings within the known track do not give an error model (8 are needed)")
        };
        Ok((found, n))
    };
    // What is heard late belongs to where the vessel was before: the shift is sought by steps, each linear.
    let mut shift_s = 0.0f64;
    for _ in 0..STEPS {
        let (mut found, n) = estimate(shift_s, true)?;
        let step_s = found.shift_s.0;
        if step_s.abs() < LEAST_STEP_S.max(0.05 * found.shift_s.1) {
            found.shift_s.0 += shift_s;
            return Ok((found, n));
        }
        shift_s += step_s;
        if shift_s.abs() > MOST_SHIFT_S {
            break;
        }
    }
    log::warn!("{name}: the bearings fit this track at no shift within {MOST_SHIFT_S} s: none is taken");
    estimate(0.0, false)
}
