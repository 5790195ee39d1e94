//! Vessels slower and faster than those that are told: no final track may put one elsewhere.
//!
//! A vessel that hardly moves has echoes that hardly move, which other pairs of paths explain nearly as well, at twice the range and the
//! speed; one that is faster than the speeds looked for has echoes about its closest point alone. Closest points at 4 to 12 km, six hours
//! each, one vessel a seed. A final track is untrue as in `obs-loud`. `--runs` is the number of vessels a speed.

use super::obs_doubts::is_true;
use super::obs_week::{Stated, minutes, tracks};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, Side, Straight};
use crate::propagation::Propagation;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::wire::Track;

/// The experiment.
pub const SPEEDS: Experiment = Experiment {
    name: "obs-speeds",
    about: "vessels of 1 to 18 m/s past an ocean-bottom station: is any told at another pair of paths?",
    run,
};

/// Vessels a speed where the command line names no number.
const RUNS: usize = 4;

/// Length of a record and time of its vessel's closest point, s.
const RECORD_S: f64 = 21_600.0;
const CLOSEST_S: f64 = 10_800.0;

/// Speeds, m/s.
const SPEEDS_M_S: [f64; 8] = [1.0, 1.2, 1.5, 1.8, 3.0, 12.0, 15.0, 18.0];
/// Those at which a vessel must be tracked, well within what is told.
const TOLD_M_S: std::ops::Range<f64> = 2.5..12.5;

/// What came of a speed's vessels.
#[derive(Default)]
struct Outcome {
    tracked: usize,
    finals: usize,
    untrue: usize,
    ranges: Stated,
}

fn vessel(speed_m_s: f64, seed: u64) -> ObsVessel {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    ObsVessel {
        name: format!("seed-{seed}"),
        straight: Straight {
            cpa_time_s: CLOSEST_S,
            cpa_range_m: rng.random_range(4_000.0..12_000.0),
            heading_deg: rng.random_range(0.0..360.0),
            speed_m_s,
            side: if rng.random() { Side::Starboard } else { Side::Port },
        },
        active_s: [-1e9, 1e9],
        radiation: Default::default(),
    }
}

fn hear(options: &Options, speed_m_s: f64, table: &Propagation) -> Result<Outcome> {
    let mut out = Outcome::default();
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let scenario = ObsScenario { vessels: vec![vessel(speed_m_s, seed)], ..quiet(seed, RECORD_S) };
        let case = Case::run(scenario, table, Vec::new())?;
        out.tracked += usize::from(case.final_track(0).is_some_and(|e| super::obs_two_ships::is_tracked(&e)));
        for track in tracks(&case).filter(|t| t.stage == Track::FINAL) {
            out.finals += 1;
            out.untrue += usize::from(!is_true(&track, &case));
        }
        let (_, ranges) = minutes(&case);
        out.ranges = Stated::sum(&[out.ranges, Stated::sum(&ranges)]);
    }
    Ok(out)
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let all: Vec<Outcome> =
        SPEEDS_M_S.par_iter().map(|speed| hear(options, *speed, &table)).collect::<Result<_>>()?;
    let vessels = options.runs.unwrap_or(RUNS);
    let mut csv = CsvText::new("speed_m_s,vessels,tracked,finals,untrue_finals,ranges,wrong_ranges");
    let figures = &options.figures;
    for (speed, out) in SPEEDS_M_S.iter().zip(&all) {
        let Stated { said, wrong, .. } = out.ranges;
        csv.row(&[&Fixed(*speed, 1), &vessels, &out.tracked, &out.finals, &out.untrue, &said, &wrong]);
        if TOLD_M_S.contains(speed) {
            figures.at_most(format!("{speed} m/s: vessels not tracked"), (vessels - out.tracked) as f64, 0.0);
        }
        let of = out.finals;
        figures.at_most(
            format!("{speed} m/s: final tracks true of no vessel, of {of}"),
            out.untrue as f64,
            0.0,
        );
    }
    print(options, "obs-speeds", csv)
}
