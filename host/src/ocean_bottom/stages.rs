//! The stages of the method over a whole recording, kept for pictures and fits: spectra, azigram, cepstrogram before and
//! after the clutter filter, log-likelihoods of azimuth and range.
//!
//! The recorder keeps none of this; here it is recomputed in the paper's form ([O 5-19], corrected as docs/references.md says) from the samples,
//! with the core's own clutter filter. Frames of 20.48 s overlapped by half; 513 bins to 25 Hz whatever the rate.

use crate::propagation::Propagation;
use crate::recording::BlockSource;
use anyhow::Result;
use rayon::prelude::*;
use seabearing_core::block::{Block, Frame as Samples, MISSING};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::obs::cepstrum::noise_sd;
use seabearing_core::obs::clutter::Clutter;
use seabearing_core::obs::limits::QUEFRENCIES;
use seabearing_signal::{Complex, ComplexToReal, Precision, RealToComplex};
use std::f32::consts::{PI, TAU};

/// Bins of a spectrum, 0 to 25 Hz.
pub const BINS: usize = 513;

/// Samples of a frame at 50 Hz.
const N: usize = 1024;

/// Bins of the tone band, 11 to 24 Hz.
const TONES: std::ops::Range<usize> = 226..492;

/// Concentration of the wrapped Cauchy law [O 7].
const R: f32 = 0.99;

/// Azimuths of the likelihood.
pub const AZIMUTHS: usize = 180;

/// Step of the range likelihood, m, and its number of ranges.
pub const RANGE_STEP_M: f64 = 70.0;
/// Number of ranges of the likelihood: to 50 km.
pub const RANGES: usize = 716;

/// What one moment says about range.
#[derive(Clone, Debug, PartialEq)]
pub struct MomentEvidence {
    /// When it was heard, s.
    pub t_s: f64,
    /// Log-likelihood ratio against silence at every [`RANGE_STEP_M`].
    pub log_ratio: Vec<f32>,
}

/// One frame.
pub struct SpectralFrame {
    /// Time of its middle, s.
    pub t_s: f64,
    /// ln|P| of every bin.
    pub log_pressure: Vec<f32>,
    /// True azimuth of every bin, rad; not finite where a component is missing.
    pub azimuth: Vec<f32>,
    /// Cepstrum before the clutter filter.
    pub raw: Vec<f32>,
    /// And after.
    pub filtered: [f32; QUEFRENCIES],
}

/// Samples of a frame at a rate.
pub fn length(rate_hz: f64) -> usize {
    N * (rate_hz / 51.0).ceil().max(1.0) as usize
}

/// All frames of a recording, 8 kB each: of hours, not of weeks ([`each_frame`]).
///
/// # Errors
/// The recording is lost.
pub fn frames(source: &mut dyn BlockSource, config: &StationConfig) -> Result<Vec<SpectralFrame>> {
    let mut out = Vec::new();
    each_frame(source, config, &mut |_| (), &mut |frame| out.push(frame))?;
    Ok(out)
}

/// Hands on each frame of a recording in the order of time, and each block before its frames; keeps less than two frames of samples.
///
/// # Errors
/// The recording is lost.
pub fn each_frame(
    source: &mut dyn BlockSource,
    config: &StationConfig,
    block_came: &mut dyn FnMut(&Block<'_>),
    frame_came: &mut dyn FnMut(SpectralFrame),
) -> Result<()> {
    let n = length(config.rate_hz);
    let turn = match &config.kind {
        Kind::Obs(o) => {
            let away = if o.intensity_towards { 0.0 } else { PI };
            (o.orientation_of_north_deg.to_radians() as f32 + away).rem_euclid(TAU)
        }
        _ => 0.0,
    };
    let window: Vec<f32> = (0..n).map(|i| 0.5 - 0.5 * (TAU * i as f32 / n as f32).cos()).collect();
    let analyser = Analyser::new(n, window, turn);
    let mut held: Vec<Samples> = Vec::new();
    let mut first = 0u64;
    let mut clutter = Clutter::new();
    while let Some(block) = source.next_block()? {
        block_came(&block);
        if first + held.len() as u64 != block.first_index {
            held.clear();
        }
        if held.is_empty() {
            first = block.first_index;
        }
        held.extend_from_slice(block.frames);
        let mut used = 0;
        while held.len() - used >= n {
            let samples = &held[used..used + n];
            let t_s = (first + used as u64 + n as u64 / 2) as f64 / config.rate_hz;
            if let Some(frame) = analyser.frame(samples, t_s, &mut clutter) {
                frame_came(frame);
            }
            used += n / 2;
        }
        held.drain(..used);
        first += used as u64;
    }
    Ok(())
}

struct Analyser {
    n: usize,
    window: Vec<f32>,
    turn: f32,
    forward: std::sync::Arc<dyn RealToComplex<f32>>,
    inverse: std::sync::Arc<dyn ComplexToReal<f32>>,
}

impl Analyser {
    fn new(n: usize, window: Vec<f32>, turn: f32) -> Self {
        Self { n, window, turn, forward: f32::real_to_complex(n), inverse: f32::complex_to_real(N) }
    }

    fn spectrum(&self, samples: &[Samples], channel: usize) -> Option<Vec<Complex<f32>>> {
        if samples.iter().any(|s| s[channel] == MISSING) {
            return None;
        }
        let mean = samples.iter().map(|s| f64::from(s[channel])).sum::<f64>() / self.n as f64;
        let mut x: Vec<f32> = samples
            .iter()
            .zip(&self.window)
            .map(|(s, w)| (f64::from(s[channel]) - mean) as f32 * w)
            .collect();
        let mut out = self.forward.make_output_vec();
        self.forward.process(&mut x, &mut out).ok()?;
        out.truncate(BINS);
        Some(out)
    }

    fn frame(&self, samples: &[Samples], t_s: f64, clutter: &mut Clutter) -> Option<SpectralFrame> {
        let p = self.spectrum(samples, 0)?;
        let directions = self.spectrum(samples, 1).zip(self.spectrum(samples, 2));
        let azimuth = match directions {
            Some((north, east)) => (p.iter().zip(&north).zip(&east))
                .map(|((p, n), e)| ((p.conj() * e).re.atan2((p.conj() * n).re) + self.turn).rem_euclid(TAU))
                .collect(),
            None => vec![f32::NAN; BINS],
        };
        let log_pressure: Vec<f32> = p.iter().map(|p| 0.5 * p.norm_sqr().max(1e-6).ln()).collect();
        let mut log: Vec<Complex<f32>> =
            log_pressure.iter().map(|l| Complex::new(l / N as f32, 0.0)).collect();
        let mut raw = self.inverse.make_output_vec();
        self.inverse.process(&mut log, &mut raw).ok()?;
        raw.truncate(BINS);
        let mut filtered = [0.0; QUEFRENCIES];
        filtered.iter_mut().zip(&raw).for_each(|(f, r)| *f = *r);
        clutter.filter(&mut filtered);
        Some(SpectralFrame { t_s, log_pressure, azimuth, raw, filtered })
    }
}

/// Whole minutes of a recording.
pub fn minutes(frames: &[SpectralFrame]) -> Vec<f64> {
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else { return Vec::new() };
    let (a, b) = ((first.t_s / 60.0).ceil() as u64, (last.t_s / 60.0).floor() as u64);
    (a..=b).map(|m| 60.0 * m as f64).collect()
}

fn around(frames: &[SpectralFrame], t_s: f64) -> &[SpectralFrame] {
    let a = frames.partition_point(|f| f.t_s < t_s - 90.0);
    let b = frames.partition_point(|f| f.t_s <= t_s + 90.0);
    &frames[a..b]
}

fn log_sum(values: impl Iterator<Item = f32> + Clone) -> f32 {
    let top = values.clone().fold(f32::NEG_INFINITY, f32::max);
    if top.is_finite() { top + values.map(|v| (v - top).exp()).sum::<f32>().ln() } else { top }
}

/// Log-likelihood ratio of azimuth at each minute: [`AZIMUTHS`] values from North clockwise [O 9 to 11].
pub fn azimuth_likelihood(frames: &[SpectralFrame], minutes: &[f64]) -> Vec<Vec<f32>> {
    const FINE: usize = 720;
    let table: Vec<f32> = (0..FINE)
        .map(|i| ((1.0 - R * R) / (1.0 - 2.0 * R * (TAU * i as f32 / FINE as f32).cos() + R * R)).ln())
        .collect();
    minutes
        .par_iter()
        .map(|&t| {
            let window = around(frames, t);
            if window.is_empty() {
                return vec![f32::NAN; AZIMUTHS];
            }
            let mut sums = vec![[0f32; AZIMUTHS]; TONES.len()];
            for f in window {
                for (sum, azimuth) in sums.iter_mut().zip(&f.azimuth[TONES]) {
                    if !azimuth.is_finite() {
                        continue;
                    }
                    let at = (azimuth / TAU * FINE as f32) as usize;
                    for (a, s) in sum.iter_mut().enumerate() {
                        *s += table[(at + FINE - a * (FINE / AZIMUTHS)) % FINE];
                    }
                }
            }
            (0..AZIMUTHS)
                .map(|a| log_sum(sums.iter().map(move |s| s[a])) - (TONES.len() as f32).ln())
                .collect()
        })
        .collect()
}

/// Pulses of every branch at every range: first quefrency, heights over variance, half the energy.
type Pulses = Vec<Vec<(usize, Vec<f32>, f32)>>;

fn pulses(table: &Propagation) -> Pulses {
    (0..RANGES)
        .map(|j| {
            let range = RANGE_STEP_M * j as f64;
            let row = (range / table.step_m).round() as usize;
            (0..table.strengths.len())
                .filter_map(|b| {
                    let (tau, phase) = table.branch(b, row)?;
                    let a = table.strengths[b].at(range);
                    let middle = (tau * 50.0).round() as usize;
                    let from = middle.checked_sub(8)?;
                    let mut energy = 0.0;
                    let heights = (from..middle + 9)
                        .map(|k| {
                            let d = k as f64 / 50.0 - tau;
                            let turn = std::f64::consts::TAU * table.f0_hz * d - phase;
                            let mu = (a * turn.cos() * (-(d / table.width_s).powi(2)).exp()) as f32;
                            let variance = noise_sd(k).powi(2);
                            energy += 0.5 * mu * mu / variance;
                            mu / variance
                        })
                        .collect();
                    Some((from, heights, energy))
                })
                .collect()
        })
        .collect()
}

fn evidence(f: &SpectralFrame, pulses: &Pulses) -> MomentEvidence {
    let log_ratio = pulses
        .iter()
        .map(|branches| {
            branches
                .iter()
                .filter(|(from, heights, _)| from + heights.len() <= QUEFRENCIES)
                .map(|(from, heights, energy)| {
                    heights.iter().zip(&f.filtered[*from..]).map(|(h, c)| h * c).sum::<f32>() - energy
                })
                .sum()
        })
        .collect();
    MomentEvidence { t_s: f.t_s, log_ratio }
}

/// Log-likelihood ratio of range of each single frame: [`RANGES`] values [O 19, one frame].
pub fn range_evidence(frames: &[SpectralFrame], table: &Propagation) -> Vec<MomentEvidence> {
    let pulses = pulses(table);
    frames.par_iter().map(|f| evidence(f, &pulses)).collect()
}

/// Log-likelihood ratio of range at each minute, radial speeds from −12 to 12 m/s averaged: [`RANGES`] values [O 19].
pub fn range_likelihood(frames: &[SpectralFrame], minutes: &[f64], table: &Propagation) -> Vec<Vec<f32>> {
    // Frames that no minute is near are not looked at.
    let mut needed = vec![false; frames.len()];
    for t in minutes {
        let first = frames.partition_point(|f| f.t_s < t - 90.0);
        needed.iter_mut().skip(first).take(around(frames, *t).len()).for_each(|needed| *needed = true);
    }
    let pulses = pulses(table);
    let nothing = |f: &SpectralFrame| MomentEvidence { t_s: f.t_s, log_ratio: Vec::new() };
    let per_frame: Vec<MomentEvidence> = (frames.par_iter().zip(&needed))
        .map(|(f, needed)| if *needed { evidence(f, &pulses) } else { nothing(f) })
        .collect();
    minutes
        .par_iter()
        .map(|&t| {
            let window = around(frames, t);
            if window.is_empty() {
                return vec![f32::NAN; RANGES];
            }
            let first = frames.partition_point(|f| f.t_s < t - 90.0);
            let speeds: Vec<Vec<f32>> = (-12..=12)
                .map(|v| {
                    let mut sum = vec![0f32; RANGES];
                    for (g, f) in per_frame[first..].iter().zip(window) {
                        // So many steps farther out, rounded; nearer than the first it counts as the first.
                        let shift = (f64::from(v) * (f.t_s - t) / RANGE_STEP_M + 0.5).floor() as isize;
                        let (skipped, from) = ((-shift).max(0) as usize, shift.max(0) as usize);
                        let nearest = g.log_ratio.first().copied().unwrap_or(0.0);
                        sum.iter_mut().take(skipped).for_each(|s| *s += nearest);
                        let farther = g.log_ratio.get(from..).unwrap_or(&[]);
                        sum.iter_mut().skip(skipped).zip(farther).for_each(|(s, g)| *s += g);
                    }
                    sum
                })
                .collect();
            (0..RANGES).map(|j| log_sum(speeds.iter().map(move |s| s[j])) - 25f32.ln()).collect()
        })
        .collect()
}
