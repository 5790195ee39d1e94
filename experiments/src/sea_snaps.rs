//! `reproduce sea-snaps`: snapping shrimp over a vessel: how many bearings go astray, and what the others lose.
//!
//! A still vessel 500 m away in ambient noise of its own spectrum, 64 kHz. Each snap comes from a direction of its own and
//! rings for half a millisecond at 3 kHz; its peak is 30 times the ambient noise's root mean square. Weak ones, of 5 times that of
//! all sound, are not loud enough to be blanked: they rise and fall within a sixth of a millisecond, in the whole band. The same record without
//! snaps is what the error is compared with.

use super::bearing_limit::station;
use super::bearing_limit_source::{AmbientField, Sounder, exact_arrivals};
use super::report::CsvReport;
use super::sea::{hear, miss};
use super::{Experiment, Options};
use crate::progress;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::block::Frame;
use seabearing_core::config::StationConfig;
use seabearing_core::geometry::Geometry;
use std::f64::consts::TAU;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-snaps",
    about: "snapping shrimp over a vessel: bearings astray, error against none",
    run,
};

/// Samples of a record: 16.4 s.
const RECORD: usize = 1 << 20;
const RANGE_M: f64 = 500.0;
const NOISE_CODES: f64 = 2e4;
/// Peak of a snap in units of the ambient noise's root mean square.
const PEAK: f64 = 30.0;
const SNR_DB: [f64; 2] = [10.0, 0.0];
/// Snaps a second, and whether they are weak.
const CASES: [(f64, bool); 4] = [(0.0, false), (5.0, false), (20.0, false), (20.0, true)];
/// Peak of a weak one in units of the root mean square of all sound.
const WEAK: f64 = 5.0;
/// A bearing farther off than this is wrong, degrees.
const WRONG_DEG: f64 = 5.0;

/// What a record gave.
#[derive(Clone, Copy, Default)]
struct Tally {
    bearings: f64,
    azimuth2: f64,
    wrong: f64,
}

impl Tally {
    fn join(self, o: Self) -> Self {
        Self {
            bearings: self.bearings + o.bearings,
            azimuth2: self.azimuth2 + o.azimuth2,
            wrong: self.wrong + o.wrong,
        }
    }
}

/// Adds snaps, at intervals from half to one and a half of their mean.
fn snap(
    geometry: &Geometry,
    rate_hz: f64,
    frames: &mut [Frame],
    (a_second, weak): (f64, bool),
    all_rms: f64,
    rng: &mut ChaCha8Rng,
) {
    let mut t_s = 0.05;
    while a_second > 0.0 && t_s < frames.len() as f64 / rate_hz - 0.1 {
        let (azimuth, sine) = (rng.random_range(0.0..TAU), rng.random_range(-1.0f64..1.0));
        let arrivals = exact_arrivals(geometry, azimuth, sine.asin(), 50.0);
        for (channel, late_s) in arrivals.iter().enumerate() {
            let start = (t_s + late_s) * rate_hz;
            let ringing = frames.iter_mut().enumerate().skip(start.ceil() as usize);
            for (at, frame) in ringing.take((0.002 * rate_hz) as usize) {
                let x = (at as f64 - start) / rate_hz;
                let pressure = if weak {
                    WEAK * all_rms * (-x / 1.5e-4).exp() * (TAU * 12_000.0 * x).cos()
                } else {
                    PEAK * (-x / 4e-4).exp() * (TAU * 3000.0 * x).cos()
                };
                frame[channel] += (NOISE_CODES * pressure) as i32;
            }
        }
        t_s += rng.random_range(0.5..1.5) / a_second;
    }
}

fn trial(config: &StationConfig, sounder: &Sounder, seed: u64, snr_db: f64) -> Result<[Tally; CASES.len()]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let at = (rng.random_range(0.0..TAU), rng.random_range(0.0..0.7));
    let arrivals = exact_arrivals(sounder.geometry(), at.0, at.1, RANGE_M);
    let quiet = sounder.record(seed ^ 0x5eab_0000, NOISE_CODES, Some((snr_db, arrivals)));
    let mut out = [Tally::default(); CASES.len()];
    let all_rms = (1.0 + 10f64.powf(snr_db / 10.0)).sqrt();
    for (tally, case) in out.iter_mut().zip(CASES) {
        let mut frames = quiet.clone();
        snap(sounder.geometry(), config.rate_hz, &mut frames, case, all_rms, &mut rng);
        for b in hear(config, frames.into_iter())?.bearings {
            tally.wrong += f64::from(u8::from(miss(&b, at).1 > WRONG_DEG.to_radians()));
            if b.band == 0 {
                tally.bearings += 1.0;
                tally.azimuth2 += seabearing_core::angle::wrap_pi(f64::from(b.azimuth) - at.0).powi(2);
            }
        }
    }
    Ok(out)
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(2);
    let config = station();
    let geometry = config.geometry()?;
    let sounder = Sounder::new(&geometry, config.rate_hz, RECORD, AmbientField::Independent);
    let mut report = CsvReport::new("sea_snaps", "snr_db,a_second,weak,bearings,beyond_5,az_deg,az_ratio");
    let bar = progress::bar((SNR_DB.len() * runs) as u64, "records");
    for snr_db in SNR_DB {
        let tallies = (0..runs as u64)
            .into_par_iter()
            .map(|n| {
                bar.inc(1);
                trial(&config, &sounder, options.seed.wrapping_mul(11_000_027) + n, snr_db)
            })
            .collect::<Result<Vec<_>>>()?;
        let sum = |k: usize| tallies.iter().map(|t| t[k]).fold(Tally::default(), Tally::join);
        let rmse = |t: &Tally| (t.azimuth2 / t.bearings).sqrt();
        let without = sum(0);
        for (k, (a_second, weak)) in CASES.iter().enumerate() {
            let with = sum(k);
            let ratio = rmse(&with) / rmse(&without);
            let azimuth = rmse(&with).to_degrees();
            let of_kind = f64::from(u8::from(*weak));
            report.row(&[snr_db, *a_second, of_kind, with.bearings, with.wrong, azimuth, ratio]);
            if k > 0 {
                let kind = if *weak { "weak snaps" } else { "snaps" };
                let at = format!("{a_second} {kind} a second, vessel at {snr_db} dB:");
                options.figures.at_most(format!("{at} bearings beyond 5°"), with.wrong, 0.0);
                options.figures.at_most(format!("{at} azimuth RMSE over that without"), ratio, 1.5);
                let kept = 100.0 * with.bearings / without.bearings;
                options.figures.at_least(format!("{at} bearings of those without, %"), kept, 90.0);
            }
        }
    }
    bar.finish_and_clear();
    report.finish(options)
}
