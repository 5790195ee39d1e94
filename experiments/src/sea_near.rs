//! `reproduce sea-near`: vessels that pass 30 to 60 m aside of an array 25 to 60 m deep: nothing is wrong with it, and the recorder is
//! to say so, to tell bearings all along, and to hold their 95 %.
//!
//! So near a vessel the wavefront is curved, vessel and image are heard apart, and directions turn by degrees in a segment.

use super::figure::Bar;
use super::report::CsvReport;
use super::sea::{ELLIPSE, Held, RATES, arrival, ferry, holds_azimuth, miss, play, scenario, side, station};
use super::{Experiment, Options};
use crate::progress;
use crate::scenario::Straight;
use crate::world::ArrayScenario;
use crate::world::scenario::{ArrayVessel, Water};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::wire::FaultCode;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-near",
    about: "vessels 30 to 60 m aside of an array 25 to 60 m deep: bearings all along, no channel called sick",
    run,
};

const DURATION_S: f64 = 80.0;
/// Closest horizontal distances and depths of the array, metres.
const CPA_M: std::ops::Range<f64> = 30.0..60.0;
const DEPTH_M: std::ops::Range<f64> = 25.0..60.0;
/// Speeds, m/s, and depths of propellers, metres.
const SPEED_M_S: std::ops::Range<f64> = 3.0..9.0;
const PROPELLER_M: std::ops::Range<f64> = 2.0..6.0;
/// Passes of a rate.
const RUNS: usize = 12;
/// Looks at the whole band for so many a second.
const LOOKS_A_S: f64 = 2.0;
/// A bearing so far from the vessel is of something else, degrees.
const FALSE_DEG: f64 = 5.0;

/// What became of a pass.
#[derive(Clone, Copy, Debug, Default)]
struct Pass {
    ellipses: Held,
    azimuths: Held,
    /// Of the looks at it so many gave a bearing.
    told: Held,
    beyond: usize,
    /// Times that a channel was called sick or the pairs inconsistent.
    faults: usize,
    /// Whether the longest silence was of more than five seconds.
    silent: bool,
}

fn one(scene: &ArrayScenario) -> Result<Pass> {
    let said = play(scene)?;
    let mut pass = Pass {
        faults: said.faults.iter().filter(|f| f.code != FaultCode::Impulses).count(),
        ..Pass::default()
    };
    let rate = scene.station.config.rate_hz;
    let Some(vessel) = scene.vessels.first() else { return Ok(pass) };
    let mut last_s = 0.0;
    for b in said.bearings.iter().filter(|b| b.band == 0) {
        let t_s = b.index as f64 / rate;
        let at = arrival(scene, vessel, t_s)?;
        let (chi2, off) = miss(b, at);
        pass.ellipses.take(chi2 <= ELLIPSE);
        pass.azimuths.take(holds_azimuth(b, at.0));
        pass.beyond += usize::from(off > FALSE_DEG.to_radians());
        pass.silent |= t_s - last_s > 5.0;
        last_s = t_s;
    }
    let looks = (LOOKS_A_S * DURATION_S) as usize;
    pass.silent |= DURATION_S - last_s > 5.0;
    pass.told = Held { held: pass.ellipses.of.min(looks), of: looks };
    Ok(pass)
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let mut report = CsvReport::new(
        "sea_near",
        "rate_khz,depth_m,cpa_m,speed_m_s,propeller_m,told_%,ellipse_%,azimuth_%,beyond_5_deg,faults",
    );
    for (rate_hz, rate) in RATES {
        let mut scenes = Vec::new();
        for n in 0..runs as u64 {
            let seed = options.seed.wrapping_mul(9_000_043) + n;
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let course = Straight {
                cpa_time_s: rng.random_range(0.3..0.7) * DURATION_S,
                cpa_range_m: rng.random_range(CPA_M),
                heading_deg: rng.random_range(0.0..360.0),
                speed_m_s: rng.random_range(SPEED_M_S),
                side: side(rng.random()),
            };
            let vessel = ArrayVessel { depth_m: rng.random_range(PROPELLER_M), ..ferry(course) };
            let config = station(rate_hz, rng.random_range(DEPTH_M), |_| {});
            scenes.push(scenario(config, Water::default(), vec![vessel], DURATION_S, seed));
        }
        let bar = progress::bar(scenes.len() as u64, "near passes");
        let passes: Result<Vec<Pass>> = scenes
            .par_iter()
            .map(|scene| {
                let pass = one(scene);
                bar.inc(1);
                pass
            })
            .collect();
        bar.finish_and_clear();
        let mut total = Pass::default();
        let (mut called, mut silent) = (0, 0);
        for (scene, pass) in scenes.iter().zip(passes?) {
            let course = scene.vessels.iter().find_map(|v| v.straight.map(|s| (s, v.depth_m)));
            let (cpa_m, speed, deep) =
                course.map_or((f64::NAN, f64::NAN, f64::NAN), |(s, d)| (s.cpa_range_m, s.speed_m_s, d));
            report.row(&[
                rate_hz / 1000.0,
                scene.station.config.depth_m,
                cpa_m,
                speed,
                deep,
                pass.told.percent(),
                pass.ellipses.percent(),
                pass.azimuths.percent(),
                pass.beyond as f64,
                pass.faults as f64,
            ]);
            total.ellipses.join(pass.ellipses);
            total.azimuths.join(pass.azimuths);
            total.told.join(pass.told);
            total.beyond += pass.beyond;
            called += usize::from(pass.faults > 0);
            silent += usize::from(pass.silent);
        }
        let figures = &options.figures;
        let of = scenes.len();
        figures.at_most(
            format!("{rate}, of {of} passes those in which a well channel is called sick"),
            called as f64,
            0.0,
        );
        figures.at_least(format!("{rate}, looks that give a bearing, %"), total.told.percent(), 90.0);
        figures.at_most(format!("{rate}, passes with five seconds without a bearing"), silent as f64, 0.0);
        figures.at_most(format!("{rate}, bearings beyond 5 deg"), total.beyond as f64, 0.0);
        let bar = Bar::Within(92.0, 97.0);
        figures.report(format!("{rate}, in their ellipse, %"), total.ellipses.percent(), bar);
        figures.report(format!("{rate}, azimuths in their 95 %"), total.azimuths.percent(), bar);
    }
    report.finish(options)
}
