//! `reproduce sea-three`: a hydrophone falls silent while vessels pass, and three go on. Three tell no direction from its mirror image
//! in their plane: what is told is to be the vessel, or nothing.
//!
//! Vessels 150 to 600 m from an array 40 to 120 m deep cross that plane or begin beside it, one of them or two at once. The hydrophone is any of
//! the four; without a lower one both sides of the plane rise from the horizon.

use super::report::CsvReport;
use super::sea::{Held, arrival, ferry, hear, miss, scenario, side, station};
use super::sea_moving::MovingSea;
use super::{Experiment, Options};
use crate::progress;
use crate::scenario::Straight;
use crate::world::ArrayScenario;
use crate::world::scenario::{ArrayVessel, Water};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::block::{CHANNELS, Frame};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-three",
    about: "a hydrophone falls silent while one vessel or two pass: the vessel's side of the three is told, or none",
    run,
};

const DURATION_S: f64 = 100.0;
/// When the hydrophone falls silent, seconds.
const FROM_S: f64 = 15.0;
const RATES_HZ: [f64; 3] = [8_000.0, 16_000.0, 64_000.0];
/// Closest horizontal distances and depths of the array, metres.
const CPA_M: std::ops::Range<f64> = 150.0..600.0;
const DEPTH_M: std::ops::Range<f64> = 40.0..120.0;
/// Speeds, m/s, and depths of propellers, metres.
const SPEED_M_S: std::ops::Range<f64> = 4.0..11.0;
const PROPELLER_M: std::ops::Range<f64> = 2.0..6.0;
/// Scenes of each rate and number of vessels.
const RUNS: usize = 12;
/// Looks at the whole band for so many a second.
const LOOKS_A_S: f64 = 2.0;
/// A bearing so far from every vessel is of none, degrees; one that states more points nowhere.
const FALSE_DEG: f64 = 5.0;

/// What three hydrophones told of a scene.
#[derive(Clone, Copy, Debug, Default)]
struct Told {
    /// Of the looks so many gave a bearing of the strongest.
    looks: Held,
    /// Bearings of the strongest that point at no vessel, and of what is heard beside it.
    wrong: usize,
    beside: Held,
}

fn scene(rate_hz: f64, vessels: usize, seed: u64) -> (ArrayScenario, usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let channel = rng.random_range(0..CHANNELS);
    let config = station(rate_hz, rng.random_range(DEPTH_M), |_| {});
    let vessels = (0..vessels)
        .map(|_| {
            let course = Straight {
                cpa_time_s: rng.random_range(0.1..0.9) * DURATION_S,
                cpa_range_m: rng.random_range(CPA_M),
                heading_deg: rng.random_range(0.0..360.0),
                speed_m_s: rng.random_range(SPEED_M_S),
                side: side(rng.random()),
            };
            ArrayVessel { depth_m: rng.random_range(PROPELLER_M), ..ferry(course) }
        })
        .collect();
    (scenario(config, Water::default(), vessels, DURATION_S, seed), channel)
}

fn one(scene: &ArrayScenario, channel: usize) -> Result<Told> {
    let config = &scene.station.config;
    let from = (FROM_S * config.rate_hz) as usize;
    let silent = |(n, mut frame): (usize, Frame)| {
        if n >= from {
            frame[channel] = 0;
        }
        frame
    };
    let said = hear(config, MovingSea::new(scene)?.enumerate().map(silent))?;
    let mut told = Told::default();
    let mut looked = 0;
    // A segment before it fell silent may be told a little later.
    for b in said.bearings.iter().filter(|b| b.index as f64 / config.rate_hz > FROM_S + 1.0) {
        if f64::from(b.var_azimuth.max(b.var_elevation)).sqrt().to_degrees() > FALSE_DEG {
            continue;
        }
        let mut least = f64::INFINITY;
        for vessel in &scene.vessels {
            least = least.min(miss(b, arrival(scene, vessel, b.index as f64 / config.rate_hz)?).1);
        }
        let wrong = least.to_degrees() > FALSE_DEG;
        if b.band == 0 {
            looked += 1;
            told.wrong += usize::from(wrong);
        } else {
            told.beside.take(!wrong);
        }
    }
    let looks = (LOOKS_A_S * (DURATION_S - FROM_S)) as usize;
    told.looks = Held { held: looked, of: looks.max(looked) };
    Ok(told)
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let mut report = CsvReport::new(
        "sea_three",
        "rate_khz,vessels,silent_hydrophone,depth_m,told_%,wrong,beside,beside_wrong",
    );
    let bar = progress::bar((2 * runs * RATES_HZ.len()) as u64, "scenes");
    for rate_hz in RATES_HZ {
        for (vessels, called) in [(1, "one vessel"), (2, "two vessels")] {
            let seeds = (0..runs as u64).map(|n| options.seed.wrapping_mul(7_000_003) + n);
            let scenes: Vec<_> = seeds.map(|seed| scene(rate_hz, vessels, seed)).collect();
            let heard: Result<Vec<Told>> = scenes
                .par_iter()
                .map(|(scene, channel)| {
                    let told = one(scene, *channel);
                    bar.inc(1);
                    told
                })
                .collect();
            let mut total = Told::default();
            for ((scene, channel), told) in scenes.iter().zip(heard?) {
                report.row(&[
                    rate_hz / 1000.0,
                    vessels as f64,
                    *channel as f64,
                    scene.station.config.depth_m,
                    told.looks.percent(),
                    told.wrong as f64,
                    told.beside.of as f64,
                    (told.beside.of - told.beside.held) as f64,
                ]);
                total.looks.join(told.looks);
                total.beside.join(told.beside);
                total.wrong += told.wrong;
            }
            let name = format!("{} kHz, {called}", rate_hz / 1000.0);
            let share = total.looks.percent();
            options.figures.at_most(
                format!("{name}: bearings of no vessel, of {} ({share:.0} % of the looks)", total.looks.held),
                total.wrong as f64,
                0.0,
            );
            options.figures.at_most(
                format!("{name}: the same beside the strongest, of {}", total.beside.of),
                (total.beside.of - total.beside.held) as f64,
                0.0,
            );
        }
    }
    bar.finish_and_clear();
    report.finish(options)
}
