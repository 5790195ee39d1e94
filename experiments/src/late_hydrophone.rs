//! `reproduce late-hydrophone`: a hydrophone that is late throughout a file of measured delays, as `bearing` finds it.
//!
//! Delays of vessels past a 1.85 m tetrahedron 168 m deep, straight past it 50 to 400 m away, or round about it and up and down as a ship
//! that calibrates an array goes. Each hydrophone's arrivals err by 3 µs by themselves and by 1 µs with the direction (over some 10°), each
//! pair's delay by another 3 µs; the speed of sound by 3 m/s, as told; positions by 1 or 3 cm, told or not. One hydrophone is late by 0, 1,
//! 2 or 5 samples of 64 kHz. Judged: who is named, by how much, and whether the bearings' stated ellipses hold the truth where one is.

use super::bearing_limit::station;
use super::figure::Figures;
use super::report::CsvReport;
use super::sea::Held;
use super::{Experiment, Options};
use crate::delays::{Solved, solve_rows};
use crate::progress;
use anyhow::{Result, bail};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
use seabearing_core::config::Kind;
use seabearing_core::geometry::PAIRS;
use std::f64::consts::TAU;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "late-hydrophone",
    about: "a hydrophone late in all of a file's measured delays: found, named, and in the stated errors",
    run,
};

const DEPTH_M: f64 = 168.0;
const SPEED_SD_M_S: f64 = 3.0;
const NOISE_S: f64 = 3e-6;
const SHARED_S: f64 = 1e-6;
const SAMPLE_S: f64 = 1.0 / 64_000.0;
/// Samples late, positions off and told (metres).
const CASES: [(f64, f64, f64); 8] = [
    (0.0, 0.01, 0.01),
    (0.0, 0.01, 0.0),
    (0.0, 0.03, 0.03),
    (0.0, 0.03, 0.0),
    (1.0, 0.01, 0.01),
    (2.0, 0.01, 0.01),
    (5.0, 0.01, 0.01),
    (5.0, 0.03, 0.03),
];

/// One file.
#[derive(Clone, Copy)]
struct Case {
    round: bool,
    sets: usize,
    late_s: f64,
    off_m: f64,
    told_m: f64,
}

/// What several came to.
#[derive(Default, Clone, Copy)]
struct Tally {
    /// Files for which a line is said.
    said: Held,
    /// Of these: the late one is among the named; it alone; its lateness is within 1.96 of its deviations.
    named: Held,
    alone: Held,
    amount: Held,
    /// Bearings of such files in their 95 % ellipses, accepted ones.
    bearings: Held,
}

impl Tally {
    fn join(mut self, other: Self) -> Self {
        self.said.join(other.said);
        self.named.join(other.named);
        self.alone.join(other.alone);
        self.amount.join(other.amount);
        self.bearings.join(other.bearings);
        self
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Where a vessel is at each set, metres from the array.
fn sources(case: &Case, rng: &mut ChaCha8Rng) -> Vec<[f64; 3]> {
    let (begin, cpa_m, up) =
        (rng.random_range(0.0..TAU), rng.random_range(50.0..400.0), rng.random_range(0.0..TAU));
    let of = |n: usize| {
        let share = n as f64 / (case.sets - 1) as f64;
        if case.round {
            let turn = 3.0 * TAU * share;
            let range_m = DEPTH_M / (0.75 - 0.65 * (0.37 * turn + up).cos()).tan();
            let (s, c) = (begin + turn).sin_cos();
            [range_m * s, range_m * c, DEPTH_M]
        } else {
            let (s, c) = begin.sin_cos();
            let along = (share - 0.5) * 3000.0;
            [cpa_m * c + along * s, along * c - cpa_m * s, DEPTH_M]
        }
    };
    (0..case.sets).map(of).collect()
}

fn trial(case: &Case, seed: u64) -> Result<Tally> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut config = station();
    config.depth_m = DEPTH_M;
    let Kind::Array(array) = &mut config.kind else { bail!("an array") };
    array.position_sd_m = case.told_m;
    array.sound_speed_sd_m_s = SPEED_SD_M_S;
    let places = array.hydrophones_m.map(|h| h.map(|x| x + case.off_m * normal(&mut rng)));
    let speed = config.sound_speed_m_s + SPEED_SD_M_S * normal(&mut rng);
    let which = rng.random_range(0..4usize);
    // Errors that go with the direction: waves across the sphere, a hydrophone's own each.
    let waves: Vec<Vec<([f64; 3], f64)>> = (0..4)
        .map(|_| {
            let wave = |rng: &mut ChaCha8Rng| ([0; 3].map(|_| 6.0 * normal(rng)), rng.random_range(0.0..TAU));
            (0..12).map(|_| wave(&mut rng)).collect()
        })
        .collect();
    let sources = sources(case, &mut rng);
    let length = |v: &[f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let row = |(n, source): (usize, &[f64; 3])| {
        let u = source.map(|x| x / length(source));
        let t: Vec<f64> = (0..4)
            .map(|k| {
                let wave = |(w, phase): &([f64; 3], f64)| {
                    (w.iter().zip(&u).map(|(a, b)| a * b).sum::<f64>() + phase).sin()
                };
                let shared = SHARED_S * waves[k].iter().map(wave).sum::<f64>() / 6f64.sqrt();
                let way = length(&[0, 1, 2].map(|i: usize| source[i] - places[k][i]));
                let late = if k == which { case.late_s } else { 0.0 };
                way / speed + late + shared + NOISE_S * normal(&mut rng)
            })
            .collect();
        let mut row = [n as f64, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        for (tau, (i, j)) in row[1..].iter_mut().zip(PAIRS) {
            *tau = t[j] - t[i] + NOISE_S * normal(&mut rng);
        }
        row
    };
    let rows: Vec<[f64; 7]> = sources.iter().enumerate().map(row).collect();
    judge(case, which, &sources, &solve_rows(&config, rows, None)?)
}

fn judge(case: &Case, which: usize, sources: &[[f64; 3]], solved: &Solved) -> Result<Tally> {
    let mut tally = Tally::default();
    let said = solved.lateness.as_ref().filter(|l| l.said().is_some());
    tally.said.take(said.is_some());
    let Some(lateness) = said else { return Ok(tally) };
    let late = lateness.late();
    let own = late.iter().find(|l| l.hydrophone == which);
    tally.named.take(own.is_some());
    tally.alone.take(own.is_some() && late.len() == 1);
    if let Some(own) = own {
        tally.amount.take((own.late_s - case.late_s).abs() <= 1.96 * own.sd_s);
    }
    for (set, source) in solved.sets.iter().zip(sources).filter(|(set, _)| set.accepted()) {
        let Some(s) = set.solution else { continue };
        let da = wrap_pi(f64::from(s.azimuth) - source[0].atan2(source[1]));
        let de = f64::from(s.elevation) - source[2].atan2(source[0].hypot(source[1]));
        let (va, ve, c) = (f64::from(s.var_azimuth), f64::from(s.var_elevation), f64::from(s.cov));
        let square = (ve * da * da - 2.0 * c * da * de + va * de * de) / (va * ve - c * c);
        tally.bearings.take(square <= 5.991);
    }
    Ok(tally)
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(400) as u64;
    let mut report = CsvReport::new(
        "late_hydrophone",
        "round,sets,late_samples,off_cm,told_cm,said_%,named_%,alone_%,amount_%,ellipses_%",
    );
    let figures: &Figures = &options.figures;
    let bar = progress::bar(2 * 3 * CASES.len() as u64, "cases");
    let (mut well, mut late) = (Tally::default(), Tally::default());
    for (round, way) in [(true, "all round"), (false, "a pass")] {
        for sets in [20, 100, 400] {
            for (number, (samples, off_m, told_m)) in CASES.into_iter().enumerate() {
                let case = Case { round, sets, late_s: samples * SAMPLE_S, off_m, told_m };
                let base = options.seed.wrapping_mul(1_000_003) + 10_000 * (sets + number) as u64;
                let tally = (0..runs)
                    .into_par_iter()
                    .map(|n| trial(&case, 2 * (base + n) + u64::from(round)))
                    .try_reduce(Tally::default, |a, b| Ok(a.join(b)))?;
                bar.inc(1);
                let sum = if samples > 0.0 { &mut late } else { &mut well };
                *sum = sum.join(tally);
                report.row(&[
                    f64::from(u8::from(round)),
                    sets as f64,
                    samples,
                    100.0 * off_m,
                    100.0 * told_m,
                    tally.said.percent(),
                    tally.named.percent(),
                    tally.alone.percent(),
                    tally.amount.percent(),
                    tally.bearings.percent(),
                ]);
                if samples == 5.0 && told_m < 0.02 {
                    let name = format!("{way}, {sets} sets, late by 5 samples of 64 kHz: said, %");
                    match (round, sets) {
                        (true, 100) => figures.at_least(name, tally.said.percent(), 85.0),
                        (true, 400) => figures.at_least(name, tally.said.percent(), 95.0),
                        _ => figures.state(name, tally.said.percent()),
                    }
                }
            }
        }
    }
    bar.finish_and_clear();
    figures.at_most(format!("none late: said to be, % of {}", well.said.of), well.said.percent(), 0.3);
    figures.at_least(format!("said: the late one named, % of {}", late.named.of), late.named.percent(), 99.0);
    figures.state(format!("said: it alone named, % of {}", late.alone.of), late.alone.percent());
    figures.at_least(
        format!("named: lateness in its 95 %, % of {}", late.amount.of),
        late.amount.percent(),
        92.0,
    );
    figures.at_least(
        format!("named: bearings in their 95 % ellipses, % of {}", late.bearings.of),
        late.bearings.percent(),
        95.0,
    );
    report.finish(options)
}
