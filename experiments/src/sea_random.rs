//! `reproduce sea-random`: one vessel past one array, anyhow: slow and fast, faint and loud, overhead and far away, arrays in shallow and deep water.
//!
//! `reproduce sea-random-bottom`: the same over bottoms of any kind close below the array, and below waves.
//!
//! The other experiments have scenes of one kind each; what the recorder states is to hold in all that lies between. `--runs` is the number of passes.

use super::figure::Bar;
use super::report::CsvReport;
use super::sea::{Held, ferry, scenario, side, station};
use super::sea_passes::{Pass, all};
use super::{Experiment, Options};
use crate::scenario::Straight;
use crate::world::ArrayScenario;
use crate::world::scenario::{ArrayVessel, Water};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-random",
    about: "single vessels of any speed, level, depth and distance past arrays 30 to 400 m deep: all in their 95 %",
    run,
};

/// The same over a bottom.
pub const BOTTOM: Experiment = Experiment {
    name: "sea-random-bottom",
    about: "the same passes over bottoms of any kind 1 to 30 m below the array, and below waves",
    run: bottom,
};

/// Passes where the command line names no number.
const RUNS: usize = 60;
const DURATION_S: f64 = 200.0;
const RATES: [(f64, &str); 3] = [(16_000.0, "16 kHz"), (32_000.0, "32 kHz"), (64_000.0, "64 kHz")];
/// Depths of arrays, closest horizontal distances (m) and speeds (m/s), each as likely in every octave.
const DEPTH_M: Range<f64> = 30.0..400.0;
const CPA_M: Range<f64> = 10.0..2_000.0;
const SPEED_M_S: Range<f64> = 1.0..18.0;
/// Depths of propellers, m, and source levels, dB.
const PROPELLER_M: Range<f64> = 1.0..8.0;
const LEVEL_DB: Range<f64> = 150.0..185.0;
/// Metres from the array's centre down to the bottom, as likely in every octave, and the amplitudes that bottom and surface give back.
const BELOW_M: Range<f64> = 1.0..30.0;
const BOTTOM_REFLECTION: Range<f64> = 0.1..0.8;
const SURFACE_REFLECTION: Range<f64> = 0.6..1.0;
/// A pass with fewer of its azimuths in their 95 % is wrong for long, percent.
const WRONG_FOR_LONG: f64 = 80.0;

/// As likely in every octave.
fn octaves(rng: &mut ChaCha8Rng, range: Range<f64>) -> f64 {
    rng.random_range(range.start.ln()..range.end.ln()).exp()
}

fn scene(seed: u64) -> (usize, ArrayScenario) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rate = rng.random_range(0..RATES.len());
    let depth_m = octaves(&mut rng, DEPTH_M);
    let course = Straight {
        cpa_time_s: rng.random_range(0.2..0.8) * DURATION_S,
        cpa_range_m: octaves(&mut rng, CPA_M),
        heading_deg: rng.random_range(0.0..360.0),
        speed_m_s: octaves(&mut rng, SPEED_M_S),
        side: side(rng.random()),
    };
    let vessel = ArrayVessel {
        depth_m: rng.random_range(PROPELLER_M),
        source_level_db: rng.random_range(LEVEL_DB),
        ..ferry(course)
    };
    let config = station(RATES[rate].0, depth_m, |_| {});
    (rate, scenario(config, Water::default(), vec![vessel], DURATION_S, seed))
}

/// The scene over a bottom, its surface in waves.
fn over_bottom(mut scene: ArrayScenario) -> ArrayScenario {
    let mut rng = ChaCha8Rng::seed_from_u64(!scene.scene.seed);
    scene.scene.water = Water {
        bottom_below_m: octaves(&mut rng, BELOW_M),
        bottom_reflection: rng.random_range(BOTTOM_REFLECTION),
        surface_reflection: -rng.random_range(SURFACE_REFLECTION),
    };
    scene
}

fn run(options: &Options) -> Result<()> {
    passes(options, "sea_random", |scene| scene)
}

fn bottom(options: &Options) -> Result<()> {
    passes(options, "sea_random_bottom", over_bottom)
}

fn passes(options: &Options, name: &'static str, water: fn(ArrayScenario) -> ArrayScenario) -> Result<()> {
    let seeds = (0..options.runs.unwrap_or(RUNS) as u64).map(|n| options.seed.wrapping_mul(1_000_003) + n);
    let (rates, scenes): (Vec<usize>, Vec<ArrayScenario>) =
        seeds.map(scene).map(|(rate, scene)| (rate, water(scene))).unzip();
    let passes = all("random passes", &scenes)?;
    let mut report = CsvReport::new(
        name,
        "rate_khz,depth_m,cpa_m,speed_m_s,propeller_m,source_db,bearings,ellipse_%,azimuth_%,tracks,faults",
    );
    for ((rate, scene), pass) in rates.iter().zip(&scenes).zip(&passes) {
        let Some((vessel, course)) = scene.vessels.iter().find_map(|v| Some((v, v.straight?))) else {
            continue;
        };
        report.row(&[
            RATES[*rate].0 / 1000.0,
            scene.station.config.depth_m,
            course.cpa_range_m,
            course.speed_m_s,
            vessel.depth_m,
            vessel.source_level_db,
            pass.bearings.of as f64,
            pass.bearings.percent(),
            pass.azimuths.percent(),
            pass.tracks as f64,
            pass.faults as f64,
        ]);
    }
    let figures = &options.figures;
    for (k, (_, name)) in RATES.iter().enumerate() {
        let mut total = Pass::default();
        let (mut wrong, mut called, mut of) = (0, Held::default(), 0);
        for (_, pass) in rates.iter().zip(&passes).filter(|(rate, _)| **rate == k) {
            wrong += usize::from(pass.azimuths.of > 0 && pass.azimuths.percent() < WRONG_FOR_LONG);
            called.take(pass.faults > 0);
            of += 1;
            total = total.join(*pass);
        }
        let bar = Bar::Within(92.0, 97.0);
        figures.report(format!("{name}, azimuths in their 95 %, %"), total.azimuths.percent(), bar);
        figures.report(format!("{name}, bearings in their ellipse, %"), total.bearings.percent(), bar);
        figures.at_most(
            format!("{name}, of {of} passes those with fewer than 80 % of the azimuths in their 95 %"),
            wrong as f64,
            0.0,
        );
        total.headings.report(figures, &format!("{name}, headings in their 95 %"));
        total.ranges.report(figures, &format!("{name}, ranges in their 95 %"));
        figures.at_most(
            format!("{name}, of {of} passes those in which a well channel is called sick"),
            called.held as f64,
            0.0,
        );
    }
    report.finish(options)
}
