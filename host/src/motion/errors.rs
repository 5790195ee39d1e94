//! The error model of an array's bearings, from a vessel of known track.

use super::BatchRoom;
use crate::csv::{CsvTable, good_rows};
use crate::orientation::track_file::heard_at;
use anyhow::{Result, anyhow, bail};
use seabearing_core::angle::wrap_pi;
use seabearing_core::kit::golden;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::errors::{self, Difference, ErrorModel};
use seabearing_locate::motion::ml::Sample;
use seabearing_locate::network::known_track::TrackPoint;
use std::path::Path;

/// Greatest shift that is believed, seconds, and the coarse grid on which it is sought.
const MOST_SHIFT_S: f64 = 60.0;
const GRID_S: f64 = 2.0;
/// Least shift that is looked for where the record is short, as a share of the greatest.
const LEAST_SHARE: f64 = 1.0 / 16.0;
/// Share of the bearings that must lie on the track whatever the shift.
const LEAST_COMMON: f64 = 0.5;
/// Fewest of them.
const FEWEST: usize = 8;
/// Golden sections of the finer search, and halvings that find where an interval ends.
const SECTIONS: u32 = 16;
const HALVINGS: usize = 12;
/// Fall of the log-likelihood at the ends of a 95 % interval, and what such an interval is of a standard deviation.
const FALL_95: f64 = 1.921;
const WIDTH_95: f64 = 1.96;
/// Time over which the turning of the known azimuth is taken, seconds.
const RATE_OVER_S: f64 = 1.0;

/// The error model, and from how many bearings: those within the track `t_s,x_m,y_m` (East and North of the array) whatever the
/// shift. The shift is where the likelihood is greatest, all else at its best for each; its deviation is the
/// likelihood's own interval. Where that has no end, no shift is told, and the offset's deviation counts what any shift would turn.
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
    let mut points: Vec<TrackPoint> =
        rows.into_iter().map(|[t_s, x, y]| TrackPoint { t_s, position_m: [x, y, 0.0] }).collect();
    points.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    let mut known =
        Known { model, name, points, sound_speed_m_s, samples: Vec::new(), room: BatchRoom::new() };
    let most_s = known.keep(samples);
    let n = known.samples.len();
    if n < FEWEST {
        bail!(
            "{}: {n} bearings within the known track do not give an error model ({FEWEST} are needed)",
            known.name
        );
    }
    let Some((shift_s, sd_s)) = known.shift(most_s)? else {
        let mut found = known.at(0.0, false)?;
        let turned = most_s / 3f64.sqrt() * known.turning();
        found.offset_rad.1 = found.offset_rad.1.hypot(turned);
        found.shift_s = (0.0, f64::INFINITY);
        log::warn!(
            "{}: these bearings tell no shift within {most_s:.0} s: none is taken, and the offset's deviation counts what one would turn",
            known.name
        );
        return Ok((found, n));
    };
    let mut found = known.at(shift_s, true)?;
    // What is linear about the greatest likelihood knows the offset, with the shift's own spread.
    if found.shift_s.1.is_finite() && found.shift_s.1 > 0.0 {
        found.offset_rad.1 *= (sd_s / found.shift_s.1).max(1.0);
    }
    found.shift_s = (shift_s, sd_s);
    Ok((found, n))
}

/// A vessel of known track, and bearings of it.
struct Known {
    model: Model,
    name: String,
    points: Vec<TrackPoint>,
    sound_speed_m_s: f64,
    samples: Vec<Sample>,
    room: BatchRoom,
}

impl Known {
    /// Azimuth that a time of the track is heard from, radians.
    fn azimuth(&self, t_s: f64) -> Option<f64> {
        let [x, y, _] = heard_at(&self.points, t_s, f64::INFINITY, self.sound_speed_m_s)?;
        Some(x.atan2(y))
    }

    /// Keeps the bearings that lie on the track at every shift up to the one returned: the greatest that leaves half of them.
    fn keep(&mut self, samples: &[Sample]) -> f64 {
        let within = |most_s: f64| -> Vec<Sample> {
            let on = |s: &&Sample| {
                self.azimuth(s.t_s - most_s).is_some() && self.azimuth(s.t_s + most_s).is_some()
            };
            samples.iter().filter(on).copied().collect()
        };
        let all = within(0.0).len() as f64;
        let mut most_s = MOST_SHIFT_S;
        let mut kept = within(most_s);
        while (kept.len() as f64) < LEAST_COMMON * all && most_s > LEAST_SHARE * MOST_SHIFT_S {
            most_s *= 0.5;
            kept = within(most_s);
        }
        self.samples = kept;
        most_s
    }

    /// Mean turning of the known azimuth over the bearings, radians a second.
    fn turning(&self) -> f64 {
        let rates = self.samples.iter().map(|s| self.rate(s.t_s).abs());
        rates.sum::<f64>() / self.samples.len().max(1) as f64
    }

    /// How fast the known azimuth turns, radians a second.
    fn rate(&self, t_s: f64) -> f64 {
        let ends = (self.azimuth(t_s - 0.5 * RATE_OVER_S), self.azimuth(t_s + 0.5 * RATE_OVER_S));
        if let (Some(before), Some(after)) = ends { wrap_pi(after - before) / RATE_OVER_S } else { 0.0 }
    }

    /// The model at a shift; `shifting`: with what a small further one does.
    fn at(&mut self, shift_s: f64, shifting: bool) -> Result<ErrorModel> {
        let differences: Vec<_> = self
            .samples
            .iter()
            .filter_map(|s| {
                let at_s = s.t_s - shift_s;
                let rate_rad_s = if shifting { self.rate(at_s) } else { 0.0 };
                let error_rad = wrap_pi(s.azimuth_rad - self.azimuth(at_s)?);
                Some(Difference { t_s: s.t_s, error_rad, rate_rad_s })
            })
            .collect();
        let model = self.model;
        let found =
            self.room.with(|e| Some(*e), |work, dense| errors::estimate(model, &differences, work, dense));
        found.map_err(|e| anyhow!("{}: {e}", self.name))
    }

    /// The likeliest shift up to `most_s` and its standard deviation; none where the bearings do not tell it.
    fn shift(&mut self, most_s: f64) -> Result<Option<(f64, f64)>> {
        let steps = (most_s / GRID_S).floor() as i32;
        let mut best = (f64::NEG_INFINITY, 0.0);
        for k in -steps..=steps {
            let shift_s = GRID_S * f64::from(k);
            let ln_likelihood = self.at(shift_s, false)?.ln_likelihood;
            if ln_likelihood > best.0 {
                best = (ln_likelihood, shift_s);
            }
        }
        let mut likelihood = |shift_s: f64| self.at(shift_s, false).map_or(f64::NAN, |m| m.ln_likelihood);
        let (low, high) = ((best.1 - GRID_S).max(-most_s), (best.1 + GRID_S).min(most_s));
        let shift_s = golden(low, high, SECTIONS, |s| -likelihood(s));
        let least = likelihood(shift_s) - FALL_95;
        let mut end = |sign: f64| -> Option<f64> {
            let (mut inside, mut step) = (0.0, 0.25 * GRID_S);
            let mut outside = loop {
                let at = shift_s + sign * step;
                if at.abs() > most_s {
                    return None;
                }
                if !(likelihood(at) > least) {
                    break step;
                }
                inside = step;
                step *= 2.0;
            };
            for _ in 0..HALVINGS {
                let half = 0.5 * (inside + outside);
                if likelihood(shift_s + sign * half) > least { inside = half } else { outside = half }
            }
            Some(0.5 * (inside + outside))
        };
        Ok(end(-1.0).zip(end(1.0)).map(|(before, after)| (shift_s, before.max(after) / WIDTH_95)))
    }
}
