//! Shaft rate from envelope modulation: error, detection and false rates of [`seabearing_core::demon`].
//!
//! A vessel's noise, its *power* swinging by 20 % (the harder reading of "modulation depth 20 %": its amplitude swings
//! by 10 %), in ambient noise of equal power (0 dB) and equal spectrum; one channel at 64 kHz, 30 s a trial. Then one
//! hour of unmodulated noise whose level rises and falls by 20 dB as a passing vessel's does.

use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::plot::{Plot, write_panels};
use crate::progress;
use anyhow::{Result, bail};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::array::{self, Plan};
use seabearing_core::block::{Block, Frame};
use seabearing_core::config::Kind;
use seabearing_core::demon::{EMPTY_SCRATCH, NoRate, Rate, RateReport, Settings};

/// `seabearing reproduce shaft-rate`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "shaft-rate",
    about: "rate of a propeller from envelope modulation: error, detection, false rates",
    run,
};

const RATE_HZ: f64 = 64_000.0;
const DEPTH: f64 = 0.2;
const TRIAL_S: f64 = 31.0;
/// Rates tried, Hz, each moved by a random part of a bin.
const RATES: std::ops::RangeInclusive<u32> = 1..=15;
/// Independent streams that make up the hour, and the start of each that fills its first window.
const STREAMS: u64 = 12;
const WARM_UP_S: f64 = 31.0;

/// Power of a recording at a time: vessel and ambient.
type Powers<'a> = &'a dyn Fn(f64) -> (f64, f64);

/// Runs the array recorder's chain over `seconds` of Gaussian noise made on the fly. The rate is that of the first hydrophone; the
/// others hear something of their own, because a dead one would silence the chain.
fn listen(
    plan: &Plan,
    seconds: f64,
    powers: Powers<'_>,
    rng: &mut ChaCha8Rng,
    sink: &mut dyn FnMut(RateReport),
) -> Box<array::State> {
    let (mut state, mut scratch) = (Box::new(array::State::new()), Box::new(array::Scratch::new()));
    let mut frames = vec![[0; 4] as Frame; 640];
    for block in 0..(seconds * RATE_HZ / 640.0) as u64 {
        let first_index = block * 640;
        for (i, frame) in frames.iter_mut().enumerate() {
            let (vessel, ambient) = powers((first_index + i as u64) as f64 / RATE_HZ);
            let (a, b): (f64, f64) = (StandardNormal.sample(rng), StandardNormal.sample(rng));
            let others = rng.random::<[i16; 3]>().map(i32::from);
            *frame =
                [(2e4 * (vessel.sqrt() * a + ambient.sqrt() * b)) as i32, others[0], others[1], others[2]];
        }
        array::push(plan, &mut state, &mut scratch, Block { first_index, frames: &frames }, &mut |_| {});
        state.take_shaft_report().into_iter().for_each(&mut *sink);
    }
    state
}

/// One trial: what was true and what the last window said.
struct Trial {
    truth_hz: f64,
    seed: u64,
    found: Option<Rate>,
}

impl Trial {
    /// Error of the rate as read from the comb.
    fn error_hz(&self) -> Option<f64> {
        self.found.map(|r| f64::from(r.rate_hz) - self.truth_hz)
    }
}

fn trials(config: &Plan, options: &Options, runs: u64) -> Vec<Trial> {
    let all: Vec<(u32, u64)> = RATES.flat_map(|rate| (0..runs).map(move |run| (rate, run))).collect();
    let bar = progress::bar(all.len() as u64, "shaft rates");
    all.into_par_iter()
        .map(|(rate, run)| {
            let seed = options.seed.wrapping_mul(1_000_003).wrapping_add(u64::from(rate) * 1000 + run);
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let truth_hz = f64::from(rate) + 0.4 * (rng.random::<f64>() - 0.5);
            let phase = std::f64::consts::TAU * rng.random::<f64>();
            let swing = |t: f64| (1.0 + DEPTH * (std::f64::consts::TAU * truth_hz * t + phase).sin(), 1.0);
            let mut found = None;
            listen(config, TRIAL_S, &swing, &mut rng, &mut |r| found = r.rate.ok());
            bar.inc(1);
            Trial { truth_hz, seed, found }
        })
        .collect()
}

/// Rates reported in an hour of unmodulated noise, and the number of reports.
fn false_rates(allowed_per_hour: f64, options: &Options) -> Result<(usize, usize)> {
    let config = plan(Settings { false_rates_per_hour: allowed_per_hour, ..Settings::default() })?;
    let stream_s = 3600.0 / STREAMS as f64 + WARM_UP_S;
    let bar = progress::bar(STREAMS, "unmodulated noise");
    let counts: Vec<(usize, usize)> = (0..STREAMS)
        .into_par_iter()
        .map(|stream| {
            let seed = options.seed.wrapping_mul(7919).wrapping_add(stream);
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            // A passage: 20 dB above ambient at the closest point, falling with the square of the distance.
            let passage = |t: f64| (100.0 / (1.0 + ((t - stream_s / 2.0) / 20.0).powi(2)), 1.0);
            let (mut rates, mut reports) = (0, 0);
            listen(&config, stream_s, &passage, &mut rng, &mut |r| match r.rate {
                Ok(_) => (rates, reports) = (rates + 1, reports + 1),
                Err(NoRate::Unmodulated) => reports += 1,
                Err(NoRate::NotEnoughData) => {}
            });
            bar.inc(1);
            (rates, reports)
        })
        .collect();
    Ok(counts.into_iter().fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1)))
}

/// The recorder's plan with these settings; bearings are sought every ten seconds only, for they are not looked at.
fn plan(settings: Settings) -> Result<Plan> {
    let mut config = super::bearing_limit::station();
    if let Kind::Array(array) = &mut config.kind {
        (array.step_s, array.segment_s) = (10.0, 10.0);
    }
    match Plan::new(&config)?.with_shaft(&settings) {
        Ok(plan) => Ok(plan),
        Err(e) => bail!("setting {} is out of range", e.0),
    }
}

fn run(options: &Options) -> Result<()> {
    let config = plan(Settings { update_s: 1.0, ..Settings::default() })?;
    let runs = options.runs.unwrap_or(6) as u64;
    let trials = trials(&config, options, runs);
    let mut csv = CsvText::new("truth_hz,seed,detected,rate_hz,sd_hz,error_hz,ln_false_alarm");
    for t in &trials {
        let error = t.error_hz().unwrap_or(f64::NAN);
        let [rate, sd, ln] =
            t.found.map_or([f32::NAN; 3], |r| [r.rate_hz, r.sd_hz, r.ln_false_alarm]).map(f64::from);
        let (truth, detected) = (Fixed(t.truth_hz, 5), t.found.is_some());
        csv.row(&[
            &truth,
            &t.seed,
            &detected,
            &Fixed(rate, 5),
            &Fixed(sd, 6),
            &Fixed(error, 6),
            &Fixed(ln, 2),
        ]);
    }
    crate::atomic::write(&options.out.join("shaft_rate.csv"), csv.finish().as_bytes())?;

    let errors: Vec<f64> = trials.iter().filter_map(Trial::error_hz).collect();
    let rms = |x: &[f64]| (x.iter().map(|e| e * e).sum::<f64>() / x.len().max(1) as f64).sqrt();
    let standardised: Vec<f64> =
        trials.iter().filter_map(|t| Some(t.error_hz()? / f64::from(t.found?.sd_hz))).collect();
    let detected = errors.len() as f64 / trials.len() as f64;
    let worst = errors.iter().fold(0.0f64, |m, e| m.max(e.abs()));
    let (false_strict, reports) = false_rates(Settings::default().false_rates_per_hour, options)?;
    let (false_loose, _) = false_rates(20.0, options)?;
    picture(options)?;
    let figures = &options.figures;
    figures
        .state(format!("detected of {} trials at 1 to 15 Hz, 0 dB, 30 s, %", trials.len()), 100.0 * detected);
    figures.state("RMSE, Hz", rms(&errors));
    figures.at_most("worst error, Hz", worst, 0.05);
    figures.state("variance of standardised errors", rms(&standardised).powi(2));
    figures.at_most("false rates in an hour of noise, 0.01 allowed", false_strict as f64, 0.0);
    figures.state("false rates in an hour of noise, 20 allowed", false_loose as f64);
    figures.state("reports in that hour", reports as f64);
    Ok(())
}

/// Two demodulated spectra with their combs: one line at the bar's conditions, and a propeller of four unequal blades.
fn picture(options: &Options) -> Result<()> {
    let config = plan(Settings { update_s: 1.0, ..Settings::default() })?;
    let tau = std::f64::consts::TAU;
    let one = |t: f64| (1.0 + DEPTH * (tau * 6.3 * t).sin(), 1.0);
    let four = |t: f64| {
        let x = tau * 2.15 * t;
        (1.0 + 0.05 * x.sin() + 0.04 * (2.0 * x).sin() + 0.2 * (4.0 * x).sin() + 0.08 * (8.0 * x).sin(), 1.0)
    };
    let cases: [(&str, Powers<'_>); 2] = [
        ("One line: power modulated by 20 % at 6.3 Hz, 0 dB", &one),
        ("Four blades, no two alike: shaft at 2.15 Hz, 0 dB", &four),
    ];
    let mut figures = Vec::new();
    for (title, powers) in cases {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let mut found = None;
        let state = listen(&config, TRIAL_S, powers, &mut rng, &mut |r| found = r.rate.ok());
        let bin_hz = config.shaft().map_or(0.0, |c| c.bin_hz());
        let mut scratch = EMPTY_SCRATCH;
        let spectrum: Vec<(f64, f64)> = config
            .shaft()
            .and_then(|c| state.shaft().spectrum(c, &mut scratch))
            .into_iter()
            .flatten()
            .enumerate()
            .skip(4)
            .map(|(k, p)| (k as f64 * bin_hz, 10.0 * f64::from(p).max(1e-2).log10()))
            .filter(|(f, _)| *f <= 30.0)
            .collect();
        let mut figure = Plot::new(title, "modulation frequency (Hz)", "power over noise floor (dB)");
        figure.size(900, 360).y_range(-15.0, 45.0).line("demodulated spectrum, 30 s", &spectrum);
        if let Some(rate) = found {
            let comb = (1..=8u32)
                .map(|h| f64::from(rate.rate_hz) * f64::from(h))
                .take_while(|f| *f <= 30.0)
                .flat_map(|f| [(f, -15.0), (f, 42.0), (f, f64::NAN)]);
            let name = format!("comb of {:.3} ± {:.3} Hz", rate.rate_hz, rate.sd_hz);
            figure.dashed(&name, &comb.collect::<Vec<_>>());
        }
        figures.push(figure);
    }
    write_panels(&options.out.join("shaft_rate.svg"), &figures.iter().collect::<Vec<_>>(), 1)
}
