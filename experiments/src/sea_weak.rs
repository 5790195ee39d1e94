//! `reproduce sea-weak`: faint vessels: error and its statement in white noise, share of seconds missed in noise of the
//! vessel's own spectrum, and whether a vessel too faint for single seconds becomes a track.
//!
//! Still vessels 500 m away in random directions, the spectrum falling by 6 dB an octave above 300 Hz; the ratio is that of
//! total power. In white noise at 64 kHz, the error is held against the physical limit of an estimator that knows signal and
//! noise. Seconds missed are counted at 16 kHz, where the band up to 7 kHz gives a faint vessel the less to be heard by; a
//! fainter one still, for two minutes, is to become a track.

use super::bearing_limit::{bearings, station as tetrahedron};
use super::bearing_limit_source::{AmbientField, Desk, Sounder, exact_arrivals};
use super::figure::Bar;
use super::report::CsvReport;
use super::sea::{ELLIPSE, Held, RATE_HZ, hear, miss, station};
use super::{Experiment, Options};
use crate::progress;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
use seabearing_core::array::{Plan, limit};
use seabearing_core::wire::Track;
use std::f64::consts::TAU;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-weak",
    about: "faint vessels: error and its statement in white noise, seconds missed near the limit of detection",
    run,
};

/// Samples of one record: 8.2 s.
const RECORD: usize = 1 << 19;
const RANGE_M: f64 = 500.0;
const NOISE_CODES: f64 = 2e4;
/// Ratios in white noise, dB.
const WHITE_DB: [f64; 3] = [-6.0, -8.0, -12.0];
/// Ratios in noise of the vessel's spectrum, dB, and the share of seconds that may be missed, %.
const ALIKE_DB: [(f64, Option<f64>); 3] = [(-10.0, None), (-11.0, Some(20.0)), (-12.0, None)];
/// Ratio of a vessel heard along a track, dB.
const TRACK_DB: f64 = -13.0;

/// One direction's record.
#[derive(Clone, Copy, Default)]
struct Tally {
    expected: f64,
    found: f64,
    azimuth2: f64,
    stated2: f64,
    limit2: f64,
    wrong: f64,
    ellipse: Held,
}

impl Tally {
    fn join(mut self, o: Self) -> Self {
        self.expected += o.expected;
        self.found += o.found;
        self.azimuth2 += o.azimuth2;
        self.stated2 += o.stated2;
        self.limit2 += o.limit2;
        self.wrong += o.wrong;
        self.ellipse.join(o.ellipse);
        self
    }

    fn deg(&self, sum: f64) -> f64 {
        (sum / self.found).sqrt().to_degrees()
    }
}

/// Vessels of a falling spectrum, and the noise they are heard in.
struct Bench<'a> {
    plan: &'a Plan,
    vessel: &'a Sounder,
    noise: &'a Sounder,
}

impl Bench<'_> {
    fn trial(&self, desks: &mut (Desk, Desk), seed: u64, snr_db: f64) -> Tally {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let at = (rng.random_range(0.0..TAU), rng.random_range(-0.3..1.0));
        let arrivals = exact_arrivals(self.plan.geometry(), at.0, at.1, RANGE_M);
        // The vessel's own record holds noise 60 dB below the sea's.
        let faint = Some((snr_db + 60.0, arrivals));
        let vessel = self.vessel.record_on(&mut desks.0, seed ^ 0x5eab_0000, 1e-3 * NOISE_CODES, faint);
        let noise = self.noise.record_on(&mut desks.1, seed ^ 0x0bad_0000, NOISE_CODES, None);
        let frames: Vec<_> =
            noise.iter().zip(vessel).map(|(a, b)| std::array::from_fn(|c| a[c] + b[c])).collect();
        let band = self.plan.band_hz();
        let band = (f64::from(band.0), f64::from(band.1));
        let ratio = |f: f64| 10f64.powf(snr_db / 10.0) * self.vessel.density(f) / self.noise.density(f);
        let information = limit::arrival_information(4, band, 1.0, ratio, 400);
        let bound = limit::angle_limit(self.plan.geometry(), at.0, at.1, 1.0 / RANGE_M, information);
        let mut tally = Tally { expected: (self.noise.seconds() / 0.5).floor() - 1.0, ..Tally::default() };
        for b in bearings(self.plan, &frames).iter().filter(|b| b.band == 0 && b.flags & 2 == 0) {
            let (chi2, off) = miss(b, at);
            tally.ellipse.take(chi2 <= ELLIPSE);
            tally.found += 1.0;
            tally.azimuth2 += wrap_pi(f64::from(b.azimuth) - at.0).powi(2);
            tally.stated2 += f64::from(b.var_azimuth);
            tally.limit2 += bound.map_or(0.0, |l| l.var_azimuth);
            tally.wrong += f64::from(u8::from(off > 5f64.to_radians()));
        }
        tally
    }

    fn all(&self, options: &Options, runs: usize, snr_db: f64) -> Tally {
        let bar = progress::bar(runs as u64, "records");
        let sum = (0..runs as u64)
            .into_par_iter()
            .map_init(
                || (self.vessel.desk(), self.noise.desk()),
                |desks, n| {
                    bar.inc(1);
                    self.trial(desks, options.seed.wrapping_mul(19_000_013) + n, snr_db)
                },
            )
            .reduce(Tally::default, Tally::join);
        bar.finish_and_clear();
        sum
    }
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(6);
    let figures = &options.figures;
    let mut report = CsvReport::new(
        "sea_weak",
        "rate_hz,white,snr_db,segments,found,beyond_5,az_deg,az_stated,az_limit,ellipse_%",
    );
    let mut line = |rate_hz: f64, white: bool, snr_db: f64, t: &Tally| {
        report.row(&[
            rate_hz,
            f64::from(u8::from(white)),
            snr_db,
            t.expected,
            t.found,
            t.wrong,
            t.deg(t.azimuth2),
            t.deg(t.stated2),
            t.deg(t.limit2),
            t.ellipse.percent(),
        ]);
    };
    let config = tetrahedron();
    let plan = Plan::new(&config)?;
    let sounder = || Sounder::new(plan.geometry(), config.rate_hz, RECORD, AmbientField::Independent);
    let (vessel, white) = (sounder(), sounder().white());
    let in_white = Bench { plan: &plan, vessel: &vessel, noise: &white };
    for snr_db in WHITE_DB {
        let t = in_white.all(options, runs, snr_db);
        line(config.rate_hz, true, snr_db, &t);
        let at = format!("white noise, {snr_db} dB:");
        figures.at_most(format!("{at} azimuth RMSE over the limit"), (t.azimuth2 / t.limit2).sqrt(), 1.3);
        let bar = Bar::Within(90.0, 97.0);
        figures.report(format!("{at} truth in the 95 % ellipse, %"), t.ellipse.percent(), bar);
    }
    let config = station(RATE_HZ, 168.0, |array| array.vessel_depth_m = 0.0);
    let plan = Plan::new(&config)?;
    let sounder = |n| Sounder::new(plan.geometry(), config.rate_hz, n, AmbientField::Independent);
    let vessel = sounder(RECORD / 4);
    let alike = Bench { plan: &plan, vessel: &vessel, noise: &vessel };
    for (snr_db, most) in ALIKE_DB {
        let t = alike.all(options, 2 * runs, snr_db);
        line(config.rate_hz, false, snr_db, &t);
        let missed = 100.0 * (1.0 - (t.found - t.wrong) / t.expected);
        let name = format!("noise of the vessel's spectrum, {snr_db} dB: seconds missed, %");
        figures.report(name, missed, most.map_or(Bar::None, Bar::AtMost));
        figures.state(format!("the same: bearings beyond 5°, of {}", t.found), t.wrong);
    }
    report.finish(options)?;
    let long = sounder(4 * RECORD);
    let mut found = Held::default();
    for n in 0..runs.div_ceil(2) as u64 {
        let seed = options.seed.wrapping_mul(23_000_009) + n;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let at = (rng.random_range(0.0..TAU), rng.random_range(0.0..0.5));
        let arrivals = exact_arrivals(plan.geometry(), at.0, at.1, RANGE_M);
        let said = hear(&config, long.record(seed, NOISE_CODES, Some((TRACK_DB, arrivals))).into_iter())?;
        let near =
            |t: &Track| wrap_pi(f64::from(t.x_m).atan2(f64::from(t.y_m)) - at.0).abs() < 3f64.to_radians();
        found.take(said.tracks.iter().any(near));
    }
    figures.at_least(format!("{TRACK_DB} dB for two minutes: vessels tracked, %"), found.percent(), 80.0);
    Ok(())
}
