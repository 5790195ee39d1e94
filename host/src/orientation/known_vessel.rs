//! Which way a station looks, from one CSV file of what it measured of a vessel of known track.
//!
//! The header depends on the station: a line array's `t_s,sin_bearing`; a compact array's `t_s,azimuth_deg,elevation_deg`,
//! or its arrival-time differences, which give the hydrophones' positions; an ocean-bottom station's `t_s,azimuth_deg`.

use super::track_file::heard_at;
use crate::csv::{CsvTable, good_rows};
use crate::delays::COLUMNS;
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::config::StationConfig;
use seabearing_core::kit::median;
use seabearing_locate::network::known_track::TrackPoint;
use seabearing_locate::orient::closed_form::{self, ClosedForm};
use seabearing_locate::orient::hydrophones::{Differences, Hydrophones, hydrophones};
use seabearing_locate::orient::line::{LineBearing, LineOrientation, LineSettings, orient};
use seabearing_locate::orient::offset::{Offset, Residual, offset};

/// Rows farther apart than this belong to different passes of an ocean-bottom station, seconds.
const PASS_GAP_S: f64 = 600.0;
/// Steps of η in which the closed form searches [L 18, 19].
const STEP_ETA: f64 = 0.001;

/// What is searched for a line array.
#[derive(Clone, Copy, Debug)]
pub struct LineSearch {
    /// Largest clock shift either way, seconds; else the larger of six bearings and a tenth of the record.
    pub max_shift_s: Option<f64>,
    /// Shifts of whole bearings are not preferred.
    pub free_shift: bool,
    /// Limits of η, the cosine of the sound's common elevation.
    pub eta: (f64, f64),
    /// Longest gap of the track that is interpolated, seconds.
    pub gap_s: f64,
}

/// Bearings of a line array with what is searched.
pub struct LineRecord {
    bearings: Vec<LineBearing>,
    settings: LineSettings,
    interval_s: f64,
    name: String,
}

impl LineRecord {
    /// Reads the rows in order of time.
    ///
    /// # Errors
    /// A column is missing, or no row is usable.
    pub fn of(table: &CsvTable, search: &LineSearch) -> Result<Self> {
        let name = table.name().to_owned();
        let rows = table.numbers(["t_s", "sin_bearing"])?.into_iter().map(|(line, row)| {
            let row = row.and_then(|[t_s, sine]| {
                if sine.abs() > 1.5 {
                    bail!("{name}, line {line}: `sin_bearing` is {sine}, a sine was expected");
                }
                Ok(LineBearing { t_s, sine })
            });
            (line, row)
        });
        let bearings = good_rows(&name, rows.collect())?;
        Ok(Self::of_bearings(bearings, search, name))
    }

    /// The same of bearings in any order; `name` stands in messages.
    pub fn of_bearings(mut bearings: Vec<LineBearing>, search: &LineSearch, name: String) -> Self {
        bearings.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        let mut steps: Vec<f64> =
            bearings.windows(2).map(|w| w[1].t_s - w[0].t_s).filter(|d| *d > 0.0).collect();
        let interval_s = median(&mut steps).unwrap_or(1.0);
        let duration_s = bearings.last().zip(bearings.first()).map_or(0.0, |(b, a)| b.t_s - a.t_s);
        let most = search.max_shift_s.unwrap_or((6.0 * interval_s).max(0.1 * duration_s));
        let settings = LineSettings {
            shift_s: (-most, most),
            eta: (search.eta.0.min(search.eta.1), search.eta.0.max(search.eta.1)),
            gap_s: search.gap_s,
            whole_s: if search.free_shift { 0.0 } else { interval_s },
        };
        Self { bearings, settings, interval_s, name }
    }

    /// Orientation, clock shift and η by the robust, continuous fit.
    ///
    /// # Errors
    /// The data do not tell.
    pub fn fit(&self, track: &[TrackPoint]) -> Result<LineOrientation> {
        orient(&self.bearings, track, &self.settings).with_context(|| self.name.clone())
    }

    /// The same in closed form, with the shift by whole bearings [L 11-19], and its jackknifed standard deviation.
    ///
    /// # Errors
    /// The data do not tell.
    pub fn closed_form(&self, track: &[TrackPoint]) -> Result<(ClosedForm, Option<f64>)> {
        let whole = (self.settings.shift_s.1 / self.interval_s).floor() * self.interval_s;
        let settings = LineSettings { shift_s: (-whole, whole), ..self.settings };
        let found = closed_form::search(&self.bearings, track, &settings, self.interval_s, STEP_ETA)
            .with_context(|| self.name.clone())?;
        let sd = closed_form::spread(&self.bearings, track, &settings, self.interval_s, STEP_ETA, &found);
        Ok((found, sd))
    }
}

/// Angle to the vertical beyond which an array is not believed to lean, radians (30°): it would lie on its side.
pub(super) const MOST_LEANING: f64 = 30.0 * RAD_PER_DEG;

/// Volume that found hydrophones span over that of the configured ones, below which they are a mirror image: the sign tells the hand.
const MIRRORED_VOLUME: f64 = -0.2;

/// Six times the signed volume of a tetrahedron.
fn volume([origin, a, b, c]: &[[f64; 3]; 4]) -> f64 {
    let [a, b, c] = [a, b, c].map(|p| [p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]]);
    a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

/// What of the rows of a table lies on the track, and how many do not; where these are some, a line says so.
pub(super) fn on_track<T>(
    name: &str,
    rows: Vec<T>,
    heard: impl Fn(&T) -> Option<[f64; 3]>,
) -> (Vec<(T, [f64; 3])>, usize) {
    let all = rows.len();
    let found: Vec<_> = rows.into_iter().filter_map(|row| heard(&row).map(|at| (row, at))).collect();
    let off_track = all - found.len();
    if off_track > 0 && off_track < all {
        log::warn!("{name}: the track tells nothing of the times of {off_track} of {all} rows");
    }
    (found, off_track)
}

/// Positions of a compact array's hydrophones, in the frame of the station file (before orientation), and of how many sets
/// the track tells nothing.
///
/// # Errors
/// A column is missing, or the data do not tell; the array would hang upside down, or be its own mirror image.
pub fn positions(
    station: &StationConfig,
    table: &CsvTable,
    track: &[TrackPoint],
    gap_s: f64,
) -> Result<(Hydrophones, usize)> {
    let rows = good_rows(table.name(), table.numbers(COLUMNS)?)?;
    let (rows, off_track) =
        on_track(table.name(), rows, |[t_s, ..]| heard_at(track, *t_s, gap_s, station.sound_speed_m_s));
    let sets: Vec<Differences> =
        rows.into_iter().map(|([_, tdoa_s @ ..], source_m)| Differences { source_m, tdoa_s }).collect();
    let geometry = station.geometry().map_err(|e| anyhow!("the station's hydrophones: {e}"))?;
    let configured = geometry.position_m.map(|p| p.map(f64::from));
    let found =
        hydrophones(&sets, &configured, station.sound_speed_m_s).with_context(|| table.name().to_owned())?;
    let heights = |h: &[[f64; 3]; 4]| h.map(|p| p[2] - h.iter().map(|p| p[2]).sum::<f64>() / 4.0);
    let upright: f64 = heights(&configured).iter().zip(heights(&found.position_m)).map(|(a, b)| a * b).sum();
    if upright < 0.0 {
        bail!(
            "{}: the hydrophones would hang upside down: tdoaIJ is the arrival at J minus that at I; are the signs or pairs mirrored?",
            table.name()
        );
    }
    if volume(&found.position_m) / volume(&configured) < MIRRORED_VOLUME {
        bail!(
            "{}: the hydrophones would be the mirror image of `hydrophones_m`: are signs or pairs mirrored, or two channels exchanged?",
            table.name()
        );
    }
    let (s, c) = (station.orientation_deg * RAD_PER_DEG).sin_cos();
    let position_m = found.position_m.map(|[x, y, z]| [x * c - y * s, x * s + y * c, z]);
    Ok((Hydrophones { position_m, ..found }, off_track))
}

/// What to add to an ocean-bottom station's azimuths, and of how many of them the track tells nothing.
///
/// # Errors
/// A column is missing, or the data do not tell.
pub fn horizontals(
    station: &StationConfig,
    table: &CsvTable,
    track: &[TrackPoint],
    gap_s: f64,
) -> Result<(Offset, usize)> {
    let mut rows = good_rows(table.name(), table.numbers(["t_s", "azimuth_deg"])?)?;
    rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let (mut pass, mut last) = (0u32, f64::NEG_INFINITY);
    let mut residuals = Vec::new();
    let (rows, off_track) =
        on_track(table.name(), rows, |[t_s, _]| heard_at(track, *t_s, gap_s, station.sound_speed_m_s));
    for ([t_s, azimuth_deg], [x, y, _]) in rows {
        if t_s - last > PASS_GAP_S && last.is_finite() {
            pass += 1;
        }
        last = t_s;
        residuals.push(Residual { angle: wrap_pi(x.atan2(y) - azimuth_deg * RAD_PER_DEG), pass });
    }
    Ok((offset(&residuals).with_context(|| table.name().to_owned())?, off_track))
}
