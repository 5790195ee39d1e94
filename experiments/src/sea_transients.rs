//! `reproduce sea-transients`: explosions and whale clicks for ten minutes (two minutes a run), and no vessel: tracks and
//! transients reported.
//!
//! 16 kHz, ambient noise of a falling spectrum. Explosions from one quarter, 40 dB over the noise, dying away within half a
//! second, one in about 20 s; trains of clicks, 35 dB and a millisecond long, two a second for some seconds, from another. The
//! noise repeats itself every two minutes.

use super::bearing_limit_source::{AmbientField, Sounder, exact_arrivals};
use super::report::CsvReport;
use super::sea::{RATE_HZ, hear, station};
use super::{Experiment, Options};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use seabearing_core::block::Frame;
use seabearing_core::geometry::Geometry;
use seabearing_core::wire::FaultCode;
use std::collections::BTreeSet;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-transients",
    about: "explosions and whale clicks without a vessel: tracks, and transients reported",
    run,
};

/// Samples of a record: 131 s.
const RECORD: usize = 1 << 21;
const NOISE_CODES: f64 = 2e3;
const RANGE_M: f64 = 2000.0;

/// Adds a sound that begins at a time and comes from a direction; its value at each instant is asked for in order.
fn add(geometry: &Geometry, frames: &mut [Frame], at_s: f64, direction: (f64, f64), sound: &[f64]) {
    let arrivals = exact_arrivals(geometry, direction.0, direction.1, RANGE_M);
    for (channel, late_s) in arrivals.iter().enumerate() {
        let start = ((at_s + late_s) * RATE_HZ).round() as usize;
        for (frame, x) in frames.iter_mut().skip(start).zip(sound) {
            frame[channel] += (NOISE_CODES * x) as i32;
        }
    }
}

fn run(options: &Options) -> Result<()> {
    let minutes = 2 * options.runs.unwrap_or(5);
    let config = station(RATE_HZ, 168.0, |_| {});
    let geometry = config.geometry()?;
    let sounder = Sounder::new(&geometry, RATE_HZ, RECORD, AmbientField::Independent);
    let records = (minutes as f64 * 60.0 / sounder.seconds()).ceil() as u64;
    let (mut explosions, mut clicks) = (0usize, 0usize);
    let noise = sounder.record(options.seed, NOISE_CODES, None);
    let made = (0..records).map(|n| {
        let seed = options.seed.wrapping_mul(17_000_023) + n;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut frames = noise.clone();
        let last_s = sounder.seconds() - 10.0;
        let mut t_s = 3.0;
        while t_s < last_s {
            let direction = (rng.random_range(0.9..1.1), 0.1);
            let sound: Vec<f64> = (0..9600)
                .map(|k| {
                    let x: f64 = StandardNormal.sample(&mut rng);
                    100.0 * (-f64::from(k) / 2000.0).exp() * x
                })
                .collect();
            add(&geometry, &mut frames, t_s, direction, &sound);
            explosions += 1;
            for n in 0..rng.random_range(4u32..12) {
                let click: Vec<f64> = (0..16).map(|k| 60.0 * f64::from(k * 2 - 15).cos()).collect();
                add(&geometry, &mut frames, t_s + 2.0 + 0.5 * f64::from(n), (4.0, -0.2), &click);
                clicks += 1;
            }
            t_s += rng.random_range(15.0..25.0);
        }
        frames
    });
    let said = hear(&config, made.flatten())?;
    let tracks: BTreeSet<u16> = said.tracks.iter().map(|t| t.id).collect();
    let frames: i64 = said.faults.iter().filter(|f| f.code == FaultCode::Impulses).map(|f| f.value).sum();
    let mut report =
        CsvReport::new("sea_transients", "minutes,explosions,clicks,tracks,bearings,frames_kept_out");
    report.row(&[
        records as f64 * sounder.seconds() / 60.0,
        explosions as f64,
        clicks as f64,
        tracks.len() as f64,
        said.bearings.len() as f64,
        frames as f64,
    ]);
    report.finish(options)?;
    options.figures.at_most("vessel tracks", tracks.len() as f64, 1.0);
    options.figures.state("bearings", said.bearings.len() as f64);
    options.figures.state("frames kept out of bearings, of explosions and clicks", frames as f64);
    Ok(())
}
