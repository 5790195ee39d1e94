//! Paper L: the orientation of a linear array, through MUSIC, from a simulated recording of a vessel of known track.
//!
//! 23 sensors 0.75 m apart at −35.1°, whose clock is 2 s late and whose sound arrives from a common elevation of
//! `cos ψ = 0.976`, hear a tone of 702 Hz with a wandering phase in white noise, 10 dB per sensor in the analysed band,
//! for 87 s. Every second sixteen frames of 1/16 s (Hann window) go into the covariance (forgetting 0.4, forward-backward,
//! five subarrays) and one bearing comes out, stamped with the mean time of what it rests on. The track is nine
//! positions ten seconds apart. Estimators of the table: 0 the robust fit as `seabearing orient` runs it (whole shifts
//! preferred), 1 the same with a free shift, 2 the paper's closed form over its grids.

use super::report::CsvReport;
use super::{Experiment, Options};
use crate::plot::Plot;
use anyhow::{Result, anyhow};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_locate::line::{
    Complex, LineArrival, LinePlan, MAX_SENSORS, MAX_SOURCES, MusicMethod, Scratch, State, unit,
};
use seabearing_locate::network::known_track::TrackPoint;
use seabearing_locate::orient::closed_form;
use seabearing_locate::orient::line::{LineBearing, LineSettings, orient};
use std::f64::consts::TAU;

/// The experiment.
pub const ORIENTATION: Experiment = Experiment {
    name: "line-orientation",
    about: "paper L: orientation, clock shift and eta of a linear array, from a recording through MUSIC",
    run,
};

const SENSORS: usize = 23;
const SPACING_M: f64 = 0.75;
/// Frequency of the paper's figures.
const FREQUENCY_HZ: f64 = 702.0;
const SOUND_SPEED_M_S: f64 = 1484.0;
const SUBARRAYS: usize = 5;
const FORGETTING: f64 = 0.4;
pub(super) const ORIENTATION_DEG: f64 = -35.1;
const SHIFT_S: f64 = 2.0;
pub(super) const ETA: f64 = 0.976;
const BEARINGS: u32 = 87;
/// Samples a second and in a frame.
const RATE_HZ: f64 = 2048.0;
const FRAME: usize = 128;
const FRAMES_A_SECOND: usize = 16;
const RUNS: usize = 20;

/// The vessel: 6 m/s, closest 330 m away, its bearing turning by about 50°.
pub(super) fn vessel(t_s: f64) -> [f64; 2] {
    let (s, c) = (125.0 * RAD_PER_DEG).sin_cos();
    [120.0 + 6.0 * s * t_s, 520.0 + 6.0 * c * t_s]
}

fn track() -> Vec<TrackPoint> {
    (0..9)
        .map(|k| {
            let t_s = 10.0 * f64::from(k);
            let [x, y] = vessel(t_s);
            TrackPoint { t_s, position_m: [x, y, 0.0] }
        })
        .collect()
}

/// What the array's sine is at a true time.
fn sine(t_s: f64) -> f64 {
    sine_of(vessel(t_s), ORIENTATION_DEG * RAD_PER_DEG, ETA)
}

/// Sine of the bearing of a place for a line of such orientation (radians) and η.
pub(super) fn sine_of([x, y]: [f64; 2], orientation: f64, eta: f64) -> f64 {
    eta * (x.atan2(y) - orientation).cos()
}

/// Mean age of a covariance at the end of its last second: half a second, and μ/(1 − μ) for what is remembered.
fn mean_age_s() -> f64 {
    0.5 + FORGETTING / (1.0 - FORGETTING)
}

/// Spectra of the sensors at the tone's frequency, frame by frame.
type Snapshots = Vec<[Complex; MAX_SENSORS]>;

/// One recording, second by second, as the sensors' spectra at the tone's frequency.
fn recording(seed: u64, run: usize, snr_db: f64, frequency_hz: f64) -> Vec<Snapshots> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(run as u64);
    let window: Vec<f64> = (0..FRAME).map(|k| 0.5 - 0.5 * (TAU * k as f64 / FRAME as f64).cos()).collect();
    let (sum, squares) = (window.iter().sum::<f64>(), window.iter().map(|w| w * w).sum::<f64>());
    // Power of the tone's transform over the noise's: (sum/2)² / (σ² Σ w²).
    let sigma = (0.25 * sum * sum / squares / 10f64.powf(snr_db / 10.0)).sqrt();
    let turn = |k: usize| TAU * frequency_hz * k as f64 / RATE_HZ;
    let kernel: Vec<Complex> = (0..FRAME).map(|k| unit(-turn(k)).scale(window[k])).collect();
    // The tone's own transform: of its two rotating halves, for a phase of zero.
    let half = |sign: f64| {
        kernel
            .iter()
            .enumerate()
            .fold(Complex::ZERO, |sum, (k, c)| sum + *c * unit(sign * turn(k)).scale(0.5))
    };
    let (forward, backward) = (half(1.0), half(-1.0));
    let mut phase: f64 = rng.random::<f64>() * TAU;
    let mut out = Vec::new();
    for second in 0..BEARINGS {
        let mut snapshots = vec![[Complex::ZERO; MAX_SENSORS]; FRAMES_A_SECOND];
        for (f, snapshot) in snapshots.iter_mut().enumerate() {
            let begin = f64::from(second) - 1.0 + f as f64 / FRAMES_A_SECOND as f64;
            // The machine's phase wanders by a radian a frame.
            let step: f64 = StandardNormal.sample(&mut rng);
            phase += step;
            let at = sine(begin + 0.5 * FRAME as f64 / RATE_HZ - SHIFT_S);
            for (m, x) in snapshot.iter_mut().enumerate().take(SENSORS) {
                let delay = TAU * frequency_hz * SPACING_M * m as f64 * at / SOUND_SPEED_M_S;
                let mut value = forward * unit(phase + delay) + backward * unit(-phase - delay);
                for kernel in &kernel {
                    let noise: f64 = StandardNormal.sample(&mut rng);
                    value += kernel.scale(sigma * noise);
                }
                *x = value;
            }
        }
        out.push(snapshots);
    }
    out
}

/// A recording's bearings: (as measured, true sine, standard deviation claimed).
fn heard(
    recording: &[Snapshots],
    method: MusicMethod,
    frequency_hz: f64,
) -> Result<Vec<(LineBearing, f64, f64)>> {
    let plan = LinePlan::new(SENSORS, SPACING_M, frequency_hz, SOUND_SPEED_M_S, SUBARRAYS, FORGETTING, 1)
        .map_err(|e| anyhow!("line plan: {e:?}"))?;
    let (mut state, mut scratch) = (State::new(), Scratch::new());
    let mut out = Vec::new();
    for (second, snapshots) in recording.iter().enumerate() {
        let mut arrivals = [LineArrival::default(); MAX_SOURCES];
        plan.step(&mut state, &mut scratch, snapshots, method, &mut arrivals)
            .map_err(|e| anyhow!("bearing: {e:?}"))?;
        let age = if second == 0 { 0.5 } else { mean_age_s() };
        let t_s = second as f64 - age;
        out.push((LineBearing { t_s, sine: arrivals[0].sine }, sine(t_s - SHIFT_S), arrivals[0].sd));
    }
    Ok(out)
}

/// Of one run: errors of orientation (°), shift (s), η; claimed sd (°); the same three of the closed form; mean squared
/// standardised error of the sines; the three of the fit with a free shift.
type Outcome = [f64; 11];

fn outcome(recording: &[Snapshots], method: MusicMethod) -> Result<Outcome> {
    let heard = heard(recording, method, FREQUENCY_HZ)?;
    let bearings: Vec<LineBearing> = heard.iter().map(|h| h.0).collect();
    let settings = LineSettings { shift_s: (-1.0, 7.0), eta: (0.85, 1.05), gap_s: 60.0, whole_s: 1.0 };
    let settings_free = LineSettings { whole_s: 0.0, ..settings };
    let truth = ORIENTATION_DEG * RAD_PER_DEG;
    let fit = orient(&bearings, &track(), &settings).map_err(|e| anyhow!("{e}"))?;
    let free = orient(&bearings, &track(), &settings_free).map_err(|e| anyhow!("{e}"))?;
    let grid = LineSettings { shift_s: (0.0, 6.0), ..settings };
    let closed = closed_form::search(&bearings, &track(), &grid, 1.0, 0.001).map_err(|e| anyhow!("{e}"))?;
    let squares: f64 = heard.iter().map(|(b, s, sd)| ((b.sine - s) / sd).powi(2)).sum();
    Ok([
        wrap_pi(fit.orientation - truth) / RAD_PER_DEG,
        fit.time_shift_s - SHIFT_S,
        fit.eta - ETA,
        fit.sd / RAD_PER_DEG,
        wrap_pi(closed.orientation - truth) / RAD_PER_DEG,
        closed.time_shift_s - SHIFT_S,
        closed.eta - ETA,
        squares / heard.len() as f64,
        wrap_pi(free.orientation - truth) / RAD_PER_DEG,
        free.time_shift_s - SHIFT_S,
        free.eta - ETA,
    ])
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let bar = crate::progress::bar(runs as u64, "line-orientation");
    let mut report = CsvReport::new(
        "line-orientation",
        "root_music,estimator,rmse_deg,largest_deg,claimed_sd_deg,rmse_shift_s,rmse_eta,shift_right,\
         var_sine",
    );
    let mut worst = 0.0f64;
    const METHODS: [MusicMethod; 2] = [MusicMethod::Spectrum, MusicMethod::Root];
    let outcomes = (0..runs)
        .into_par_iter()
        .map(|run| {
            let recording = recording(options.seed, run, 10.0, FREQUENCY_HZ);
            bar.inc(1);
            Ok([outcome(&recording, METHODS[0])?, outcome(&recording, METHODS[1])?])
        })
        .collect::<Result<Vec<[Outcome; 2]>>>()?;
    for (k, method) in METHODS.into_iter().enumerate() {
        let outcomes: Vec<Outcome> = outcomes.iter().map(|both| both[k]).collect();
        let rms = |i: usize| (outcomes.iter().map(|o| o[i] * o[i]).sum::<f64>() / runs as f64).sqrt();
        let largest = |i: usize| outcomes.iter().fold(0.0f64, |m, o| m.max(o[i].abs()));
        let mean = |i: usize| outcomes.iter().map(|o| o[i]).sum::<f64>() / runs as f64;
        for (estimator, form) in [(0.0, 0), (1.0, 8), (2.0, 4)] {
            let right = outcomes.iter().filter(|o| o[form + 1].abs() <= 0.5).count() as f64 / runs as f64;
            report.row(&[
                f64::from(u8::from(method == MusicMethod::Root)),
                estimator,
                rms(form),
                largest(form),
                if form != 4 { mean(3) } else { f64::NAN },
                rms(form + 1),
                rms(form + 2),
                right,
                mean(7),
            ]);
            worst = worst.max(largest(form));
        }
    }
    bar.finish_and_clear();
    report.finish(options)?;
    options.figures.at_most(format!("largest error of orientation in {runs} recordings, deg"), worst, 0.3);
    pictures(options)
}

/// One recording: its bearings, and the mean angle error over η for each shift, as the paper's figure 5.
fn pictures(options: &Options) -> Result<()> {
    let heard = heard(&recording(options.seed, 0, 10.0, FREQUENCY_HZ), MusicMethod::Root, FREQUENCY_HZ)?;
    let mut figure = Plot::new("Sine of the bearing at 702 Hz (paper L, figure 4)", "time (s)", "sine");
    figure.truth("true", &heard.iter().map(|(b, s, _)| (b.t_s, *s)).collect::<Vec<_>>());
    figure.points("root-MUSIC", &heard.iter().map(|(b, _, _)| (b.t_s, b.sine)).collect::<Vec<_>>());
    figure.write(&options.out.join("line-orientation-bearings.svg"))?;
    let bearings: Vec<LineBearing> = heard.iter().map(|h| h.0).collect();
    let mut figure = Plot::new(
        "Mean angle between true and computed positions (paper L, figure 5)",
        "η = cos(elevation)",
        "mean error (°)",
    );
    for k in 0..=6 {
        let curve: Vec<(f64, f64)> = (0..=200)
            .filter_map(|j| {
                let eta = 0.85 + 0.001 * f64::from(j);
                let found = closed_form::solve(&bearings, &track(), 60.0, f64::from(k), eta)?;
                Some((eta, found.mean_error / RAD_PER_DEG))
            })
            .collect();
        figure.line(&format!("k = {k}"), &curve);
    }
    figure.write(&options.out.join("line-orientation-search.svg"))
}

/// Several frequencies.
pub const FREQUENCIES: Experiment = Experiment {
    name: "line-frequencies",
    about: "paper L, section 5: orientation at 444, 666 and 702 Hz, and the mean over frequencies",
    run: frequencies,
};

/// Frequency (Hz), and the paper's shift (s), η and orientation (degrees): of several minima those of which it takes the mean.
const PAPER: [(f64, f64, f64, f64); 3] =
    [(444.0, 2.0, 1.020, -37.0), (666.0, 1.0, 0.956, -34.4), (702.0, 2.0, 0.976, ORIENTATION_DEG)];
/// The paper's means over frequencies, η found and η = 1, degrees.
const PAPER_MEANS_DEG: [f64; 2] = [-35.5, -35.4];

/// The paper's own closed form and grids: all shifts and η, and η = 1 alone.
fn frequencies(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let grid = LineSettings { shift_s: (0.0, 6.0), eta: (0.85, 1.05), gap_s: 60.0, whole_s: 1.0 };
    let level = LineSettings { eta: (1.0, 1.0), ..grid };
    let mut report = CsvReport::new(
        "line-frequencies",
        "frequency_hz,mean_deg,sd_deg,mean_shift_s,mean_eta,paper_deg,paper_shift_s,paper_eta",
    );
    // Of each run the orientations at the frequencies: η found, and η = 1.
    let mut all = vec![[Vec::new(), Vec::new()]; runs];
    for (k, (frequency_hz, paper_shift_s, paper_eta, paper_deg)) in PAPER.into_iter().enumerate() {
        let found = (0..runs)
            .into_par_iter()
            .map(|run| {
                // Each frequency has noise and a wandering phase of its own.
                let sound = recording(options.seed, PAPER.len() * run + k, 10.0, frequency_hz);
                let heard = heard(&sound, MusicMethod::Root, frequency_hz)?;
                let bearings: Vec<LineBearing> = heard.iter().map(|h| h.0).collect();
                let search = |settings: &LineSettings| {
                    closed_form::search(&bearings, &track(), settings, 1.0, 0.001).map_err(|e| anyhow!("{e}"))
                };
                let (free, level) = (search(&grid)?, search(&level)?);
                Ok([wrap_pi(free.orientation), free.time_shift_s, free.eta, wrap_pi(level.orientation)])
            })
            .collect::<Result<Vec<[f64; 4]>>>()?;
        let mean = |i: usize| found.iter().map(|f| f[i]).sum::<f64>() / runs as f64;
        let spread = (found.iter().map(|f| (f[0] - mean(0)).powi(2)).sum::<f64>() / runs as f64).sqrt();
        report.row(&[
            frequency_hz,
            mean(0) / RAD_PER_DEG,
            spread / RAD_PER_DEG,
            mean(1),
            mean(2),
            paper_deg,
            paper_shift_s,
            paper_eta,
        ]);
        for (run, found) in all.iter_mut().zip(&found) {
            run[0].push(found[0] / RAD_PER_DEG);
            run[1].push(found[3] / RAD_PER_DEG);
        }
    }
    report.finish(options)?;
    let figures = &options.figures;
    for (form, (name, paper)) in ["η searched", "η = 1"].into_iter().zip(PAPER_MEANS_DEG).enumerate() {
        let means: Vec<f64> =
            all.iter().map(|run| run[form].iter().sum::<f64>() / PAPER.len() as f64).collect();
        let mean = means.iter().sum::<f64>() / runs as f64;
        figures.state(format!("mean over frequencies, {name}, deg (truth {ORIENTATION_DEG})"), mean);
        figures.state(format!("the paper's, {name}, deg"), paper);
        let worst = means.iter().fold(0.0f64, |m, x| m.max((x - ORIENTATION_DEG).abs()));
        if form == 0 {
            figures.at_most("largest error of a run's mean over frequencies, η searched, deg", worst, 0.3);
        } else {
            figures.state("largest error of a run's mean over frequencies, η = 1, deg", worst);
        }
    }
    let spread = |of: &[f64]| {
        of.iter().copied().fold(f64::MIN, f64::max) - of.iter().copied().fold(f64::MAX, f64::min)
    };
    let ours = all.iter().map(|run| spread(&run[0])).sum::<f64>() / runs as f64;
    figures.state("from the least to the greatest frequency's orientation, mean of runs, deg", ours);
    figures.state("the paper's, deg", spread(&PAPER.map(|p| p.3)));
    Ok(())
}
