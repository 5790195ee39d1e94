//! Vessels louder than the table's, without wideband noise, and beyond the model's end: which ranges and tracks are told.
//!
//! The table's strengths are of vessels at 0 dB (wideband noise against the sea's, 20 km away). Louder ones are heard by their echoes far
//! beyond 50 km, where another pair of paths puts them at half of it, and nearer their echoes are above the table's. A vessel of tones
//! alone has azimuths and no echoes; 40 minutes of a passage show few ranges. Closest points at 3 to 20 km, 5 to 9 m/s, eleven hours
//! each, one vessel a seed. A final track is untrue where no vessel is within 2.49 of its stated deviations in all four numbers, nor is it
//! on a vessel's way as `obs-week` has it. `--runs` is the number of vessels a scene.

use super::obs_doubts::is_true;
use super::obs_week::{Stated, minutes, tracks};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, Radiation, Side, Straight};
use crate::propagation::Propagation;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::wire::{FaultCode, Message, Track};

/// The experiment.
pub const LOUD: Experiment = Experiment {
    name: "obs-loud",
    about: "vessels 5 to 20 dB louder than the table's, of tones alone, beyond the model's end, heard for 40 minutes: false ranges and tracks",
    run,
};

/// Vessels a scene where the command line names no number.
const RUNS: usize = 4;

/// Length of a record and time of its vessel's closest point, s.
const RECORD_S: f64 = 40_000.0;
const CLOSEST_S: f64 = 20_000.0;

/// What a vessel sounds like and when it is heard.
struct Scene {
    name: &'static str,
    wideband_db: f64,
    tone_db: f64,
    /// Ranges of the closest point, m.
    closest_m: std::ops::Range<f64>,
    /// How long it is heard about its closest point, s.
    heard_s: f64,
    /// Whether it must be tracked.
    tracked: bool,
}

/// As the table has it.
const PLAIN: Scene = Scene {
    name: "0 dB",
    wideband_db: 0.0,
    tone_db: 20.0,
    closest_m: 3_000.0..20_000.0,
    heard_s: 1e9,
    tracked: true,
};

const SCENES: [Scene; 8] = [
    PLAIN,
    Scene { name: "5 dB louder", wideband_db: 5.0, tone_db: 25.0, ..PLAIN },
    Scene { name: "10 dB louder", wideband_db: 10.0, tone_db: 30.0, ..PLAIN },
    Scene { name: "15 dB louder", wideband_db: 15.0, tone_db: 35.0, ..PLAIN },
    Scene { name: "20 dB louder", wideband_db: 20.0, tone_db: 40.0, ..PLAIN },
    Scene { name: "tones alone", wideband_db: -30.0, tracked: false, ..PLAIN },
    Scene {
        name: "10 dB louder, beyond the model",
        wideband_db: 10.0,
        tone_db: 30.0,
        closest_m: 52_000.0..70_000.0,
        tracked: false,
        ..PLAIN
    },
    Scene { name: "0 dB, 40 minutes", heard_s: 2_400.0, tracked: false, ..PLAIN },
];

/// A seeded vessel.
fn vessel(scene: &Scene, seed: u64) -> ObsVessel {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let middle_s = CLOSEST_S + rng.random_range(-900.0..900.0);
    let half_s = 0.5 * scene.heard_s;
    ObsVessel {
        name: format!("seed-{seed}"),
        straight: Straight {
            cpa_time_s: CLOSEST_S,
            cpa_range_m: rng.random_range(scene.closest_m.clone()),
            heading_deg: rng.random_range(0.0..360.0),
            speed_m_s: rng.random_range(5.0..9.0),
            side: if rng.random() { Side::Starboard } else { Side::Port },
        },
        active_s: [middle_s - half_s, middle_s + half_s],
        radiation: Radiation {
            wideband_db: scene.wideband_db,
            tone_db: scene.tone_db,
            ..Radiation::default()
        },
    }
}

/// What came of a scene's vessels.
#[derive(Default)]
struct Outcome {
    tracked: usize,
    untrue: usize,
    ranges: Stated,
    table_off: usize,
}

fn hear(options: &Options, scene: &Scene, table: &Propagation) -> Result<Outcome> {
    let mut out = Outcome::default();
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let scenario = ObsScenario { vessels: vec![vessel(scene, seed)], ..quiet(seed, RECORD_S) };
        let case = Case::run(scenario, table, Vec::new())?;
        out.tracked += usize::from(case.final_track(0).is_some_and(|e| {
            e.cpa_time_s.abs() <= 10.0 && e.cpa_range_m.abs() <= 150.0 && e.speed_m_s.abs() <= 0.05
        }));
        let finals = tracks(&case).filter(|t| t.stage == Track::FINAL);
        out.untrue += finals.filter(|t| !is_true(t, &case)).count();
        let (_, ranges) = minutes(&case);
        out.ranges = Stated::sum(&[out.ranges, Stated::sum(&ranges)]);
        let is_off = |m: &&Message| matches!(m, Message::Fault(f) if f.code == FaultCode::TableOff);
        out.table_off += case.messages.iter().filter(is_off).count();
    }
    Ok(out)
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let all: Vec<Outcome> =
        SCENES.par_iter().map(|scene| hear(options, scene, &table)).collect::<Result<_>>()?;
    let vessels = options.runs.unwrap_or(RUNS);
    let mut csv = CsvText::new("scene,vessels,tracked,untrue_finals,ranges,wrong_ranges,in_95,table_off");
    let figures = &options.figures;
    for (scene, out) in SCENES.iter().zip(&all) {
        let name = scene.name;
        csv.row(&[
            &name,
            &vessels,
            &out.tracked,
            &out.untrue,
            &out.ranges.said,
            &out.ranges.wrong,
            &Fixed(out.ranges.percent(out.ranges.within), 1),
            &out.table_off,
        ]);
        if scene.tracked {
            let missed = (vessels - out.tracked) as f64;
            figures.at_most(format!("{name}: not tracked (10 s, 150 m, 0.05 m/s)"), missed, 0.0);
        }
        figures.at_most(format!("{name}: final tracks that are true of no vessel"), out.untrue as f64, 0.0);
        if out.ranges.said > 0 {
            let wrong = out.ranges.percent(out.ranges.wrong);
            figures.at_most(format!("{name}: ranges more than 1500 m off, %"), wrong, 4.0);
        } else {
            figures.state(format!("{name}: ranges told"), 0.0);
        }
        figures.at_most(format!("{name}: table called wrong"), out.table_off as f64, 0.0);
    }
    print(options, "obs-loud", csv)
}
