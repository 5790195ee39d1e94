//! Bearings from a file of arrival-time differences, set by set.

mod contradiction;
mod echo;
mod few;
pub mod late;
mod scatter;
mod unclosed;
mod units;

use crate::csv::{CsvTable, good_rows};
use anyhow::{Context, Result, anyhow, bail};
pub use contradiction::Contradiction;
pub use few::Few;
use late::{Lateness, Model, Told};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::geometry::PAIRS;
use seabearing_locate::delays::continuity::Continuity;
use seabearing_locate::delays::tdoa::{DelaySolution, Solver};
use std::path::Path;

pub(crate) use scatter::correlated;
pub use unclosed::Unclosed;

/// Columns of the input.
pub const COLUMNS: [&str; 7] =
    ["t_s", "tdoa01_s", "tdoa02_s", "tdoa03_s", "tdoa12_s", "tdoa13_s", "tdoa23_s"];

/// One set's result; `None` where its delays give no direction at all.
#[derive(Debug, Clone, Copy)]
pub struct SetResult {
    /// Time of the set, seconds.
    pub t_s: f64,
    /// What came of it.
    pub solution: Option<DelaySolution>,
    /// It points where no vessel is: below the horizon, of a station whose vessels are well above it.
    pub below: bool,
    /// It points the way of the sets about it at another elevation, as an echo does.
    pub echo: bool,
}

impl SetResult {
    /// Whether it is a vessel's as far as its delays tell.
    pub fn accepted(&self) -> bool {
        self.solution.is_some_and(|s| s.accepted) && !self.below && !self.echo
    }
}

/// How far below the horizon no vessel is heard, whatever bends the sound, degrees.
const BELOW_DEG: f32 = 5.0;
/// Depth from which a station's vessels are well above it, metres: that from which its tracks use elevations.
const WELL_BELOW_M: f64 = 25.0;

/// Whether a direction is below the horizon by more than 5° and three standard deviations.
fn points_down(s: &DelaySolution) -> bool {
    s.elevation < -BELOW_DEG.to_radians().max(3.0 * s.var_elevation.sqrt())
}

/// Whether the accepted sets cannot be of vessels, which are above every hydrophone: more than a quarter of them point below the
/// horizon by more than 5° and three standard deviations. Of an array heard through a mirror half of a vessel's way round it does.
///
/// # Errors
/// One line: how many do.
pub fn check_above(results: &[SetResult]) -> Result<()> {
    let accepted = || results.iter().filter_map(|r| r.solution).filter(|s| s.accepted);
    let (all, wrong) = (accepted().count(), accepted().filter(points_down).count());
    if 4 * wrong > all {
        bail!(
            "{wrong} of {all} bearings point below the horizon, where no vessel is: tdoaIJ is the arrival at J minus that at I; \
             are signs or pairs mirrored, or the hydrophones upside down?"
        );
    }
    Ok(())
}

/// The sets of a file.
#[derive(Debug, Clone)]
pub struct Solved {
    /// Of each set, in order of time.
    pub sets: Vec<SetResult>,
    /// How late each hydrophone is in all of them; `None` where they do not tell. What is late is in the stated errors.
    pub lateness: Option<Lateness>,
    /// What makes the accepted sets suspect; `None` where they agree with the array, or the stated errors hold what they do not.
    pub contradiction: Option<Contradiction>,
    /// That hardly any set is accepted.
    pub few: Option<Few>,
    /// What does not close in all of them: the accepted sets may be right.
    pub unclosed: Option<Unclosed>,
}

impl Solved {
    /// What makes the accepted sets suspect, in a line; `None` where nothing does.
    pub fn suspect(&self) -> Option<String> {
        self.contradiction.map(|c| c.said()).or_else(|| self.few.map(|f| f.said()))
    }
}

/// Share of the sets that are off that lateness of all sets puts right, at least.
const PUT_RIGHT: f64 = 0.5;
/// How far the length of a set's vector may be from one, as the outlier test has it.
const OFF: f64 = 0.05;

/// The sets that give a direction as they are, where these are most and lateness found in all does not put right those whose length is off: what
/// is off in a few sets is none of all, and where the rest leaves a direction free these few alone decide it.
fn others_than(
    solver: &Solver,
    model: &Model,
    tolerance_s: f64,
    rows: &[[f64; 7]],
    each_s: [f64; 4],
) -> Option<Vec<[f64; 6]>> {
    let off = |delays: &[f64; 6]| {
        let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        model.vector(delays, tolerance_s).map(|v| (length(v) - 1.0).abs() > OFF)
    };
    let (mut all, mut put_right) = (0.0, 0.0);
    for [_, delays @ ..] in rows {
        if off(delays) == Some(true) {
            let mut delays = *delays;
            for (d, (i, j)) in delays.iter_mut().zip(PAIRS) {
                *d -= each_s[j] - each_s[i];
            }
            all += 1.0;
            put_right += f64::from(u8::from(off(&delays) == Some(false)));
        }
    }
    if all == 0.0 || put_right >= PUT_RIGHT * all {
        return None;
    }
    let mut continuity = Continuity::new();
    let good = |[t_s, delays @ ..]: &[f64; 7]| {
        let found = solver.solve(&mut continuity, *t_s, &delays.map(|d| d as f32));
        found.is_some_and(|s| s.accepted).then_some(*delays)
    };
    let good: Vec<[f64; 6]> = rows.iter().filter_map(good).collect();
    (2 * good.len() > rows.len()).then_some(good)
}

/// Bearings of all sets of a file, in order of time; bad rows are named on stderr and left out. `tolerance_s`: greatest root-mean-square
/// residual of an accepted set, instead of the usual one.
///
/// # Errors
/// The station is no array, a column is missing, or no row is usable.
pub fn solve(config: &StationConfig, tdoa: &Path, tolerance_s: Option<f64>) -> Result<Solved> {
    let name = tdoa.display().to_string();
    let rows = good_rows(&name, CsvTable::read(tdoa)?.numbers(COLUMNS)?)?;
    if matches!(config.kind, Kind::Array(_))
        && let Ok(geometry) = config.geometry()
    {
        units::check(&geometry, &rows).with_context(|| name.clone())?;
    }
    solve_rows(config, rows, tolerance_s)
}

/// The same of rows as the file has them, in any order.
///
/// # Errors
/// The station is no array.
pub fn solve_rows(
    config: &StationConfig,
    mut rows: Vec<[f64; 7]>,
    tolerance_s: Option<f64>,
) -> Result<Solved> {
    let Kind::Array(array) = &config.kind else {
        bail!("the station file is not of a compact array (kind = \"array\")");
    };
    let geometry =
        config.geometry().map_err(|e| anyhow!("the station's hydrophones give no bearings: {e:?}"))?;
    let solver = Solver::new(&geometry, array.reference_range_m, tolerance_s, array.elevation_deg)
        .uncertain(array.position_sd_m, array.sound_speed_sd_m_s);
    let is_below = config.depth_m >= WELL_BELOW_M;
    let has_surface = array.vessel_depth_m > 0.0 && config.depth_m > array.vessel_depth_m;
    let solver = if has_surface { solver.under_surface(config.depth_m) } else { solver };
    rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let told = Told {
        range_m: array.reference_range_m,
        position_sd_m: array.position_sd_m,
        sound_speed_sd_m_s: array.sound_speed_sd_m_s,
        tolerance_s: solver.tolerance_s().into(),
    };
    let delays: Vec<[f64; 6]> = rows.iter().map(|[_, delays @ ..]| *delays).collect();
    let lateness = match late::lateness(&geometry, &told, &delays) {
        Some(all) if all.said().is_some() => {
            let model = Model::new(&geometry, &told);
            match others_than(&solver, &model, told.tolerance_s, &rows, all.each_s) {
                Some(good) => late::lateness(&geometry, &told, &good),
                None => Some(all),
            }
        }
        other => other,
    };
    let solver = match &lateness {
        Some(lateness) => solver.late(lateness.unsure_s()),
        None => solver,
    };
    let mut continuity = Continuity::new();
    let of = |[t_s, delays @ ..]: [f64; 7]| {
        let solution = solver.solve(&mut continuity, t_s, &delays.map(|d| d as f32));
        let below = is_below && solution.as_ref().is_some_and(points_down);
        SetResult { t_s, solution, below, echo: false }
    };
    let mut sets: Vec<SetResult> = rows.into_iter().map(of).collect();
    for (set, echo) in echo::of(&sets).into_iter().enumerate() {
        sets[set].echo = echo;
    }
    let counted = lateness.as_ref().is_some_and(|l| l.said().is_some());
    let accepted: Vec<bool> = sets.iter().map(SetResult::accepted).collect();
    let contradiction = if counted { None } else { contradiction::of(&geometry, &told, &delays, &accepted) };
    // A set of fewer than three delays is no direction's, and what is below the horizon is said by itself.
    let enough = |delays: &[f64; 6]| delays.iter().filter(|d| d.is_finite()).count() >= 3;
    let told = sets.iter().zip(&delays).filter(|(s, delays)| enough(delays) && !s.below).count();
    let few = if counted { None } else { few::of(told, accepted.iter().filter(|a| **a).count()) };
    let unclosed = unclosed::of(&delays, solver.tolerance_s().into());
    Ok(Solved { sets, lateness, contradiction, few, unclosed })
}
