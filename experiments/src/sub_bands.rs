//! `reproduce sub-bands`: a quiet vessel whose noise lies in one octave, beside a louder one in all octaves.
//!
//! Static sources 500 m away in random directions at least 60° apart, independent ambient noise. The loud one is 10 dB above
//! the ambient noise everywhere; the quiet one is stronger or weaker than it within its octave and silent elsewhere. A look
//! at an octave that gives a bearing within 5° (or four of its standard deviations) of the quiet vessel counts as detected, one
//! of an octave elsewhere as false. A vessel that is followed in the whole band takes turns with the octaves, so that these are looked at less
//! often than is counted here. Then loud vessels alone with the surface's image: what multipath makes.

use super::bearing_limit::{bearings, station};
use super::bearing_limit_source::{AmbientField, Sounder, exact_arrivals, surfaced};
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::progress;
use anyhow::Result;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
use seabearing_core::array::Plan;
use seabearing_core::wire::Bearing;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sub-bands",
    about: "a quiet vessel heard in one octave beside a louder one; ghosts of multipath",
    run,
};

/// Octaves tried: 500 Hz to 1 kHz up to 16 to 25 kHz (`band` 4 to 9).
const OCTAVES: std::ops::RangeInclusive<u32> = 2..=7;
/// Level of the quiet vessel over the loud one within the octave, dB.
const OVER_DB: [f64; 3] = [-2.0, 0.0, 6.0];
/// Level of the loud one over the ambient noise, dB.
const LOUD_DB: f64 = 10.0;
/// Samples of one record: 16.4 s.
const RECORD: usize = 1 << 20;
const RANGE_M: f64 = 500.0;
const NOISE_CODES: f64 = 2e4;

/// What one octave's records gave.
#[derive(Default, Clone, Copy)]
struct Tally {
    records: f64,
    /// Looks at the octave that may report.
    looks: f64,
    detected: f64,
    /// Segments, and those of them in which the quiet vessel is told as one of the whole band.
    segments: f64,
    whole: f64,
    azimuth2: f64,
    stated2: f64,
    false_ones: f64,
}

impl Tally {
    fn add(self, o: Self) -> Self {
        Self {
            records: self.records + o.records,
            looks: self.looks + o.looks,
            detected: self.detected + o.detected,
            segments: self.segments + o.segments,
            whole: self.whole + o.whole,
            azimuth2: self.azimuth2 + o.azimuth2,
            stated2: self.stated2 + o.stated2,
            false_ones: self.false_ones + o.false_ones,
        }
    }
}

/// Angle between a bearing and a direction, radians.
fn apart(b: &Bearing, azimuth: f64, elevation: f64) -> f64 {
    let (e, da) = (f64::from(b.elevation), wrap_pi(f64::from(b.azimuth) - azimuth));
    (e.sin() * elevation.sin() + e.cos() * elevation.cos() * da.cos()).clamp(-1.0, 1.0).acos()
}

fn run(options: &Options) -> Result<()> {
    let plan = Plan::new(&station())?;
    let directions = options.runs.unwrap_or(4);
    let rate_hz = f64::from(plan.rate_hz());
    let sounder = Sounder::new(plan.geometry(), rate_hz, RECORD, AmbientField::Independent);
    let mut report = CsvReport::new(
        "sub_bands",
        "octave_hz,over_db,detected_%,whole_band_%,rmse_az_deg,stated_deg,false_per_hour",
    );
    let bar = progress::bar((OCTAVES.clone().count() * directions) as u64, "records");
    for octave in OCTAVES {
        let low_hz = 125.0 * f64::from(1u32 << octave);
        let within = Sounder::new(plan.geometry(), rate_hz, RECORD, AmbientField::Independent)
            .within(low_hz, (2.0 * low_hz).min(25_000.0));
        let tallies = (0..directions)
            .into_par_iter()
            .map(|n| {
                let seed =
                    options.seed.wrapping_mul(3_000_017).wrapping_add(u64::from(octave) << 32 | n as u64);
                bar.inc(1);
                trial(&plan, &sounder, &within, octave, seed)
            })
            .reduce(Default::default, |a: [Tally; 3], b| std::array::from_fn(|i| a[i].add(b[i])));
        for (over_db, t) in OVER_DB.iter().zip(tallies) {
            let at = format!("octave from {low_hz} Hz, {over_db:+} dB:");
            options
                .figures
                .state(format!("{at} looks that give the bearing, %"), 100.0 * t.detected / t.looks);
            options.figures.state(
                format!("{at} segments that tell it in the whole band, %"),
                100.0 * t.whole / t.segments,
            );
            let hours = t.records * sounder.seconds() / 3600.0;
            options.figures.state(format!("{at} false bearings an hour"), t.false_ones / hours);
            report.row(&[
                low_hz,
                *over_db,
                100.0 * t.detected / t.looks,
                100.0 * t.whole / t.segments,
                (t.azimuth2 / t.detected).sqrt().to_degrees(),
                (t.stated2 / t.detected).sqrt().to_degrees(),
                t.false_ones / (t.records * sounder.seconds() / 3600.0),
            ]);
        }
    }
    bar.finish_and_clear();
    report.finish(options)?;
    ghosts(options, &plan, &sounder, 4 * directions)
}

/// One pair of directions, the quiet vessel at each level.
fn trial(plan: &Plan, all: &Sounder, within: &Sounder, octave: u32, seed: u64) -> [Tally; 3] {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let loud = (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(0.0..0.6));
    let quiet = (loud.0 + rng.random_range(60f64..300.0).to_radians(), rng.random_range(0.0..0.6));
    let arrivals = |d: (f64, f64)| exact_arrivals(plan.geometry(), d.0, d.1, RANGE_M);
    let background = all.record(seed ^ 0x5eab_0000, NOISE_CODES, Some((LOUD_DB, arrivals(loud))));
    // Its own noise 60 dB down.
    let faint = 60.0 + LOUD_DB;
    let alone = within.record(seed ^ 0x0bad_0000, 1e-3 * NOISE_CODES, Some((faint, arrivals(quiet))));
    OVER_DB.map(|over_db| {
        let gain = 10f64.powf(over_db / 20.0);
        let mut frames = background.clone();
        for (a, b) in frames.iter_mut().zip(&alone) {
            *a = std::array::from_fn(|c| a[c] + (gain * f64::from(b[c])) as i32);
        }
        let found = bearings(plan, &frames);
        let segments = found.iter().filter(|b| b.band == 0).count();
        let mut tally = Tally {
            records: 1.0,
            looks: looks(segments, octave),
            segments: segments as f64,
            whole: found
                .iter()
                .filter(|b| b.band < 2 && apart(b, quiet.0, quiet.1) < 5f64.to_radians())
                .count() as f64,
            ..Tally::default()
        };
        for b in found.iter().filter(|b| b.band >= 2) {
            let near = 5f64.to_radians().max(4.0 * f64::from(b.var_azimuth.max(b.var_elevation)).sqrt());
            if apart(b, quiet.0, quiet.1) < near {
                if u32::from(b.band) == octave + 2 {
                    tally.detected += 1.0;
                    tally.azimuth2 += wrap_pi(f64::from(b.azimuth) - quiet.0).powi(2);
                    tally.stated2 += f64::from(b.var_azimuth);
                }
            } else {
                tally.false_ones += 1.0;
            }
        }
        tally
    })
}

/// Looks at an octave that may report: every eighth segment looks at the whole band instead, the octaves take turns in the
/// others, and the first look at each has none before it to agree with.
fn looks(segments: usize, octave: u32) -> f64 {
    let turns = (1..=segments).filter(|s| s % 8 != 0).enumerate();
    let own = turns
        .filter(|(n, _)| (*n as u32) % OCTAVES.clone().count() as u32 == octave - OCTAVES.start())
        .count();
    own.saturating_sub(1) as f64
}

/// Loud vessels alone with the surface's image: bearings of other bands that are not the vessel's.
fn ghosts(options: &Options, plan: &Plan, sounder: &Sounder, records: usize) -> Result<()> {
    let mut report = CsvReport::new("sub_band_ghosts", "snr_db,hours,first,second_ghosts,octave_ghosts");
    if !options.json {
        println!("one vessel and its image in the surface, 200 to 1000 m away: bearings of other bands");
    }
    for snr_db in [0.0, 10.0, 20.0] {
        let count = |n| {
            let seed = options.seed.wrapping_mul(5_000_011).wrapping_add(n as u64);
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let azimuth = rng.random_range(0.0..std::f64::consts::TAU);
            let (_, paths) = surfaced(plan.geometry(), azimuth, rng.random_range(200.0..1000.0));
            let mut desk = sounder.desk();
            let frames = sounder.record_paths(&mut desk, seed ^ 0x5eab_0000, NOISE_CODES, &[(snr_db, paths)]);
            bearings(plan, frames).iter().fold([0.0; 3], |mut sum, b| {
                sum[usize::from(b.band.min(2))] += 1.0;
                sum
            })
        };
        let sum = (0..records)
            .into_par_iter()
            .map(count)
            .reduce(|| [0.0; 3], |a, b| std::array::from_fn(|i| a[i] + b[i]));
        report.row(&[snr_db, records as f64 * sounder.seconds() / 3600.0, sum[0], sum[1], sum[2]]);
    }
    report.finish(options)
}
