//! Lines of a recording's spectra, each with its direction, and chains of them that are one vessel's.
//!
//! About each whole minute the spectra of three minutes (Hann, 0.008 Hz wide) are made of pressure and both horizontals. A line is a peak of
//! pressure that stands out of the median about it; the active intensity over it gives its direction.

use super::course::Course;
use super::curves::Curve;
use super::doppler::moves;
use crate::recording::BlockSource;
use anyhow::{Result, bail};
use seabearing_core::angle::{wrap_pi, wrap_tau};
use seabearing_core::block::{Block, Frame, MISSING};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::kit::quantile;
use seabearing_signal::{Complex, Precision, RealToComplex};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Half a window, s.
const HALF_WINDOW_S: f64 = 90.0;
/// Frequencies of lines, Hz: those of vessels' engines and propellers that a station at 50 Hz hears.
pub(crate) const BAND_HZ: (f64, f64) = (5.0, 24.5);
/// Power of a line over the median about it, times: noise alone has a peak as high once in a window or two.
const STANDS_OUT: f64 = 12.0;
/// Width over which that median is taken, Hz.
const ABOUT_HZ: f64 = 1.0;
/// Beside a line there is none so near, Hz: its window's lobes are.
const BESIDE_HZ: f64 = 0.08;
/// Half the width over which a line's direction is taken, Hz.
const LINE_HZ: f64 = 0.011;
/// A line is a curve's if its direction is no farther off, rad.
const TOWARDS: f64 = 0.35;
/// By how much a line may move within a minute, of itself, and Hz beside; and by how much its vessel may move it (`doppler.rs`).
const MOVES: (f64, f64) = (2e-4, 0.004);
/// Longest silence of a line, s.
const SILENCE_S: f64 = 900.0;
/// Fewest minutes of a chain, and its shortest span, s.
const LEAST: (usize, f64) = (20, 2_400.0);

/// A line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Frequency, Hz.
    pub hz: f64,
    /// Direction, rad.
    pub azimuth: f64,
    /// Power over the median about it.
    pub stands_out: f64,
}

/// Lines of three minutes.
#[derive(Clone, Debug, PartialEq)]
pub struct Minute {
    /// Their middle, s.
    pub t_s: f64,
    /// The lines.
    pub lines: Vec<Line>,
}

/// Listens to a recording for lines, block by block.
pub struct Listener {
    rate_hz: f64,
    turn: f64,
    length: usize,
    window: Vec<f64>,
    forward: Arc<dyn RealToComplex<f64>>,
    held: Vec<Frame>,
    first: u64,
    minute: u64,
    /// What was found.
    pub minutes: Vec<Minute>,
}

impl Listener {
    /// For an ocean-bottom station's recording.
    ///
    /// # Errors
    /// It is another kind of station's.
    pub fn new(config: &StationConfig) -> Result<Self> {
        let Kind::Obs(obs) = &config.kind else { bail!("an ocean-bottom station is needed") };
        let away = if obs.intensity_towards { 0.0 } else { PI };
        let length = (2.0 * HALF_WINDOW_S * config.rate_hz) as usize;
        Ok(Self {
            rate_hz: config.rate_hz,
            turn: obs.orientation_of_north_deg.to_radians() + away,
            length,
            window: (0..length).map(|i| 0.5 - 0.5 * (TAU * i as f64 / length as f64).cos()).collect(),
            forward: f64::real_to_complex((2 * length).next_power_of_two()),
            held: Vec::new(),
            first: 0,
            minute: 2,
            minutes: Vec::new(),
        })
    }

    /// Takes a block.
    pub fn push(&mut self, block: &Block<'_>) {
        if self.first + self.held.len() as u64 != block.first_index {
            self.held.clear();
            self.first = block.first_index;
        }
        self.held.extend_from_slice(block.frames);
        let from = |minute: u64| ((60.0 * minute as f64 - HALF_WINDOW_S) * self.rate_hz).round() as u64;
        loop {
            let begin = from(self.minute);
            // What began after the window's beginning was lost, or never was.
            let Some(before) = begin.checked_sub(self.first) else {
                self.minute += 1;
                continue;
            };
            let before = before as usize;
            let Some(window) = self.held.get(before..before + self.length) else { break };
            let lines = self.lines(window);
            self.minutes.push(Minute { t_s: 60.0 * self.minute as f64, lines });
            self.minute += 1;
        }
        let keep = from(self.minute).saturating_sub(self.first) as usize;
        let done = keep.min(self.held.len());
        self.held.drain(..done);
        self.first += done as u64;
    }

    fn spectrum(&self, window: &[Frame], channel: usize) -> Option<Vec<Complex<f64>>> {
        if window.iter().any(|f| f[channel] == MISSING) {
            return None;
        }
        let mean = window.iter().map(|f| f64::from(f[channel])).sum::<f64>() / window.len() as f64;
        let mut samples = self.forward.make_input_vec();
        for ((x, f), w) in samples.iter_mut().zip(window).zip(&self.window) {
            *x = (f64::from(f[channel]) - mean) * w;
        }
        let mut out = self.forward.make_output_vec();
        self.forward.process(&mut samples, &mut out).ok()?;
        Some(out)
    }

    fn lines(&self, window: &[Frame]) -> Vec<Line> {
        let spectra = (0..3).map(|c| self.spectrum(window, c)).collect::<Option<Vec<_>>>();
        let Some([pressure, north, east]) = spectra.and_then(|s| <[Vec<_>; 3]>::try_from(s).ok()) else {
            return Vec::new();
        };
        let step_hz = self.rate_hz / (2 * (pressure.len() - 1)) as f64;
        let bins = |hz: f64| (hz / step_hz).round() as usize;
        let (first, last) = (bins(BAND_HZ.0), bins(BAND_HZ.1.min(0.49 * self.rate_hz)));
        let power: Vec<f64> = pressure.iter().map(Complex::norm_sqr).collect();
        let mut out = Vec::new();
        for from in (first..last).step_by(bins(ABOUT_HZ)) {
            let to = (from + bins(ABOUT_HZ)).min(last);
            let Some(median) = quantile::median(&mut power[from..to].to_vec()) else { continue };
            for k in from..to {
                let (a, b, c) = (power[k - 1], power[k], power[k + 1]);
                let beside = k.saturating_sub(bins(BESIDE_HZ))..(k + bins(BESIDE_HZ)).min(power.len());
                if b < STANDS_OUT * median || b <= a || b < c || power[beside].iter().any(|p| *p > b) {
                    continue;
                }
                // The top of a Hann window's line is a parabola of its logarithm, nearly.
                let (a, b, c) = (a.max(1e-300).ln(), b.ln(), c.max(1e-300).ln());
                let part = (0.5 * (a - c) / (a - 2.0 * b + c)).clamp(-0.5, 0.5);
                let half = bins(LINE_HZ);
                let (x, y) = (k - half..=k + half).fold((0.0, 0.0), |(x, y), i| {
                    (x + (pressure[i].conj() * east[i]).re, y + (pressure[i].conj() * north[i]).re)
                });
                out.push(Line {
                    hz: (k as f64 + part) * step_hz,
                    azimuth: wrap_tau(x.atan2(y) + self.turn),
                    stands_out: power[k] / median,
                });
            }
        }
        out
    }
}

/// A recording that is listened to for lines while another reads it.
pub struct Tapped<'a> {
    /// The recording.
    pub source: &'a mut dyn BlockSource,
    /// Who listens.
    pub listener: Listener,
}

impl BlockSource for Tapped<'_> {
    fn start(&self) -> Option<time::OffsetDateTime> {
        self.source.start()
    }

    fn expected_end(&self) -> Option<u64> {
        self.source.expected_end()
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        let block = self.source.next_block()?;
        if let Some(block) = &block {
            self.listener.push(block);
        }
        Ok(block)
    }

    fn left_out(&mut self) -> Result<Option<u64>> {
        self.source.left_out()
    }

    fn is_live(&self) -> bool {
        self.source.is_live()
    }
}

/// One line over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// Times, s, and frequencies, Hz, in order.
    pub points: Vec<(f64, f64)>,
}

impl Chain {
    /// Its frequency in the middle of its time, Hz.
    pub fn middle_hz(&self) -> f64 {
        self.points.get(self.points.len() / 2).map_or(f64::NAN, |p| p.1)
    }
}

/// Chains of the lines that come from where a curve points, the longest first.
pub fn chains(curve: &Curve, course: &Course, minutes: &[Minute]) -> Vec<Chain> {
    let mut out: Vec<Chain> = Vec::new();
    for minute in minutes {
        let Some(direction) = curve.near(minute.t_s, HALF_WINDOW_S) else { continue };
        let mut lines: Vec<&Line> =
            minute.lines.iter().filter(|l| wrap_pi(l.azimuth - direction.azimuth).abs() < TOWARDS).collect();
        lines.sort_by(|a, b| b.stands_out.total_cmp(&a.stands_out));
        let mut taken: Vec<usize> = Vec::new();
        for line in lines {
            let near = out.iter().enumerate().filter(|(k, _)| !taken.contains(k)).filter_map(|(k, c)| {
                let (t_s, hz) = *c.points.last()?;
                let silent = minute.t_s - t_s;
                let (moved, unknown) = moves(course, t_s, minute.t_s);
                let most = MOVES.0 * hz * (silent / 60.0).sqrt() + MOVES.1 + hz * unknown;
                let off = (line.hz - hz * (1.0 + moved)).abs();
                (silent < SILENCE_S && off < most).then_some((off, k))
            });
            let k = match near.min_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((_, k)) => k,
                None => {
                    out.push(Chain { points: Vec::new() });
                    out.len() - 1
                }
            };
            out[k].points.push((minute.t_s, line.hz));
            taken.push(k);
        }
    }
    out.retain(|c| {
        let (first, last) = (c.points[0].0, c.points[c.points.len() - 1].0);
        c.points.len() >= LEAST.0 && last - first >= LEAST.1
    });
    out.sort_by_key(|c| std::cmp::Reverse(c.points.len()));
    out
}
