//! `reproduce sea-positions`: hydrophones that are not where the station file says, by as much as it says that they may be:
//! does the stated uncertainty hold?
//!
//! Every trial has an array of its own, each coordinate displaced by a normal number of `position_sd_m`, and a still vessel
//! 500 m away at 10 dB, at 16 and 64 kHz.

use super::bearing_limit_source::{AmbientField, Sounder, exact_arrivals};
use super::figure::Bar;
use super::report::CsvReport;
use super::sea::{ELLIPSE, Held, RATES, hear, miss, station};
use super::{Experiment, Options};
use crate::progress;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
use std::f64::consts::TAU;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-positions",
    about: "hydrophones 1 and 3 cm from where they are said to be, told as such: does the stated error hold",
    run,
};

/// Samples of one record at 16 kHz: 2 s.
const RECORD: usize = 1 << 15;
const NOISE_CODES: f64 = 2e4;
const RANGE_M: f64 = 500.0;
const SNR_DB: f64 = 10.0;

/// The last whole bearing of a trial: error and stated variance of azimuth, whether the ellipse holds the truth.
fn trial(rate_hz: f64, sd_m: f64, seed: u64) -> Result<Option<(f64, f64, bool)>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let told = station(rate_hz, 168.0, |array| {
        array.position_sd_m = sd_m;
        array.vessel_depth_m = 0.0;
    });
    let built = station(rate_hz, 168.0, |array| {
        array.hydrophones_m.iter_mut().flatten().for_each(|x| *x += sd_m * normal());
    });
    let at = (rng.random_range(0.0..TAU), rng.random_range(0.0..1.0));
    let geometry = built.geometry()?;
    let sounder =
        Sounder::new(&geometry, rate_hz, RECORD * (rate_hz / 16_000.0) as usize, AmbientField::Independent);
    // The array is turned about its own middle, from which directions count.
    let arrivals = exact_arrivals(&geometry, at.0, at.1, RANGE_M);
    let said = hear(&told, sounder.record(seed, NOISE_CODES, Some((SNR_DB, arrivals))).into_iter())?;
    Ok(said.bearings.iter().rfind(|b| b.band == 0 && b.flags == 0).map(|b| {
        let azimuth = wrap_pi(f64::from(b.azimuth) - at.0);
        (azimuth, f64::from(b.var_azimuth), miss(b, at).0 <= ELLIPSE)
    }))
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(100);
    let mut report = CsvReport::new("sea_positions", "rate_khz,sd_m,bearings,az_deg,az_stated,ellipse_%");
    let bar = progress::bar((2 * RATES.len() * runs) as u64, "arrays");
    let errors = [(0.01, "1 cm"), (0.03, "3 cm")];
    for ((rate_hz, rate), (sd_m, name)) in RATES.into_iter().flat_map(|r| errors.map(|e| (r, e))) {
        let name = format!("{rate}, {name}");
        let trials = (0..runs as u64)
            .into_par_iter()
            .map(|n| {
                bar.inc(1);
                trial(rate_hz, sd_m, options.seed.wrapping_mul(29_000_009) + n)
            })
            .collect::<Result<Vec<_>>>()?;
        let mut held = Held::default();
        let (mut azimuth2, mut stated2) = (0.0, 0.0);
        for (azimuth, variance, inside) in trials.into_iter().flatten() {
            held.take(inside);
            azimuth2 += azimuth * azimuth;
            stated2 += variance;
        }
        let deg = |sum: f64| (sum / held.of as f64).sqrt().to_degrees();
        report.row(&[rate_hz / 1000.0, sd_m, held.of as f64, deg(azimuth2), deg(stated2), held.percent()]);
        held.report(&options.figures, &format!("{name}: truth in the 95 % ellipse"));
        options.figures.state(format!("{name}: azimuth RMSE, deg"), deg(azimuth2));
        let told = 100.0 * held.of as f64 / runs as f64;
        options.figures.at_least(format!("{name}: arrays that tell a bearing, %"), told, 100.0);
        options.figures.report(
            format!("{name}: azimuth RMSE over what is stated"),
            (azimuth2 / stated2).sqrt(),
            Bar::None,
        );
    }
    bar.finish_and_clear();
    report.finish(options)
}
