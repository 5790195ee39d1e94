//! `reproduce obs-first-motion`: whether a station that no vessel passes knows its signs by earthquakes, and is not misled by what else sets in suddenly.
//!
//! Two days each, with earthquakes of 15 to 35 dB at random times, and among whales that pass overhead, T phases and strumming. The station is right, or is
//! not what its file says. What comes of earthquakes is simulated as a wave from steeply below and the surface's answer to it.

use super::obs_checks::Altered;
use super::obs_world::{print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{Burst, ObsScenario, Strumming, Whale};
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::{run as listen, station};
use crate::propagation::Propagation;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::block::Frame;
use seabearing_core::wire::{Fault, FaultCode, Message};

/// The experiment.
pub const FIRST_MOTION: Experiment = Experiment {
    name: "obs-first-motion",
    about: "ocean bottom: signs of pressure and vertical motion by earthquakes, without a vessel",
    run,
};

/// Stations where the command line names no number.
const RUNS: usize = 8;

const DURATION_S: f64 = 172_800.0;
/// Earthquakes in that time, dB above the sea, seconds.
const EARTHQUAKES: usize = 8;
const LEVEL_DB: std::ops::Range<f64> = 15.0..35.0;
const LENGTH_S: std::ops::Range<f64> = 30.0..180.0;
/// Bouts of calls of whales that pass, and T phases.
const BOUTS: usize = 4;

/// A station.
struct Kind {
    name: &'static str,
    codes: fn(Frame) -> Frame,
    earthquakes: usize,
    towards: bool,
    /// What is to be named.
    wanted: Option<FaultCode>,
}

const KINDS: [Kind; 7] = [
    Kind { name: "right", codes: |f| f, earthquakes: EARTHQUAKES, towards: false, wanted: None },
    Kind {
        name: "right, intensity towards the source",
        codes: |f| f,
        earthquakes: EARTHQUAKES,
        towards: true,
        wanted: None,
    },
    Kind { name: "right, no earthquake", codes: |f| f, earthquakes: 0, towards: false, wanted: None },
    Kind {
        name: "pressure reversed",
        codes: |[p, n, e, z]| [-p, n, e, z],
        earthquakes: EARTHQUAKES,
        towards: false,
        wanted: Some(FaultCode::Reversed),
    },
    Kind {
        name: "vertical reversed",
        codes: |[p, n, e, z]| [p, n, e, -z],
        earthquakes: EARTHQUAKES,
        towards: false,
        wanted: Some(FaultCode::Reversed),
    },
    Kind {
        name: "pressure reversed, no earthquake",
        codes: |[p, n, e, z]| [-p, n, e, z],
        earthquakes: 0,
        towards: false,
        wanted: None,
    },
    // The vertical is what is called north: what is steep is not steep there, and nothing is asked.
    Kind {
        name: "vertical and north exchanged",
        codes: |[p, n, e, z]| [p, z, e, n],
        earthquakes: EARTHQUAKES,
        towards: false,
        wanted: None,
    },
];

/// What a station without vessels hears.
fn scene(seed: u64, kind: &Kind) -> ObsScenario {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(7_368_787));
    let mut burst = |level: std::ops::Range<f64>, length: std::ops::Range<f64>| Burst {
        azimuth_deg: rng.random_range(0.0..360.0),
        start_s: rng.random_range(600.0..DURATION_S - 600.0),
        duration_s: rng.random_range(length),
        level_db: rng.random_range(level),
    };
    let earthquake = (0..kind.earthquakes).map(|_| burst(LEVEL_DB, LENGTH_S)).collect();
    let t_phase = (0..BOUTS).map(|_| burst(5.0..20.0, 120.0..600.0)).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x00f1_757a);
    let mut whale = |interval: std::ops::Range<f64>| Whale {
        azimuth_deg: rng.random_range(0.0..360.0),
        range_m: rng.random_range(100.0..6_000.0),
        start_s: rng.random_range(0.0..DURATION_S),
        duration_s: rng.random_range(600.0..7_200.0),
        interval_s: rng.random_range(interval),
        level_db: rng.random_range(10.0..30.0),
    };
    let fin_whale = (0..BOUTS).map(|_| whale(10.0..30.0)).collect();
    let blue_whale = (0..BOUTS).map(|_| whale(60.0..150.0)).collect();
    let strumming = vec![Strumming {
        azimuth_deg: rng.random_range(0.0..180.0),
        start_s: 20_000.0,
        duration_s: 20_000.0,
        fundamental_hz: rng.random_range(2.0..6.0),
        level_db: 20.0,
        pressure_db: -20.0,
    }];
    let intensity = if kind.towards { "towards" } else { "away" };
    ObsScenario {
        earthquake,
        t_phase,
        fin_whale,
        blue_whale,
        strumming,
        intensity: intensity.into(),
        ..quiet(seed, DURATION_S)
    }
}

/// What was said of its set-up.
fn said(table: &Propagation, seed: u64, kind: &Kind) -> Result<Vec<Fault>> {
    let scenario = scene(seed, kind);
    let config = station::config(&scenario)?;
    let mut simulator = Simulator::new(scenario, table.clone(), Vec::new())?;
    let mut altered = Altered::new(&mut simulator, kind.codes);
    let mut faults = Vec::new();
    listen::run(&config, table, &mut altered, &mut |m| {
        if let Message::Fault(f) = m {
            faults.push(f);
        }
    })?;
    let of_signs = |f: &Fault| {
        matches!(
            f.code,
            FaultCode::SignInDoubt | FaultCode::Reversed | FaultCode::Exchanged | FaultCode::SetUpGood
        )
    };
    Ok(faults.into_iter().filter(of_signs).collect())
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let runs = options.runs.unwrap_or(RUNS);
    let scenes: Vec<(&Kind, u64)> =
        KINDS.iter().flat_map(|kind| (0..runs as u64).map(move |n| (kind, options.seed + n))).collect();
    let all: Vec<Vec<Fault>> =
        scenes.par_iter().map(|(kind, seed)| said(&table, *seed, kind)).collect::<Result<_>>()?;
    let mut csv = CsvText::new("station,days_of,named,earliest_h,latest_h,other_things_said");
    for (kind, all) in KINDS.iter().zip(all.chunks(runs.max(1))) {
        let hours = |f: &Fault| f.index as f64 / (3600.0 * 50.0);
        let named: Vec<f64> =
            all.iter().filter_map(|s| s.iter().find(|f| Some(f.code) == kind.wanted).map(hours)).collect();
        let others = all.iter().flatten().filter(|f| Some(f.code) != kind.wanted).count();
        let earliest = named.iter().copied().fold(f64::INFINITY, f64::min);
        let latest = named.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        csv.row(&[&kind.name, &all.len(), &named.len(), &Fixed(earliest, 1), &Fixed(latest, 1), &others]);
        let figures = &options.figures;
        if kind.wanted.is_some() {
            let percent = 100.0 * named.len() as f64 / all.len().max(1) as f64;
            figures.at_least(format!("{}: named within two days, %", kind.name), percent, 90.0);
        }
        figures.at_most(format!("{}: other things said of its signs", kind.name), others as f64, 0.0);
    }
    print(options, "obs-first-motion", csv)
}
