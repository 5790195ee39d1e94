//! A uniform line of sensors, from its recording to bearings (paper L, section 3).
//!
//! Enters: a recording of all sensors (WAV or FLAC), and what the table `[line]` of the station file says of how it is to be
//! analysed. Leaves: a [`LineBearing`] for each source and step. In the order data flows: `wide` (all sensors side by side),
//! `frames` (spectra at the frequencies), `chain` (the steps about each, weighed as [`weights`] says, and what a
//! bend does to their mean, `bend`), [`seabearing_locate::line`]
//! (covariance, number of sources, MUSIC, the frequency heard, and what several frequencies have in common).
//!
//! A line cannot tell its two sides apart, nor azimuth from elevation: a bearing is the cosine of the angle to its axis.

mod bend;
mod chain;
pub mod doubts;
mod frames;
pub mod known;
mod live;
pub mod picture;
pub mod records;
pub mod weights;
mod wide;

use crate::progress;
use crate::recording::Asked;
use crate::station::Station;
use anyhow::{Result, anyhow, bail};
use chain::Chain;
use frames::{Frames, Held, half_lobe_hz};
use live::{Run, Tally, longest, only};
use seabearing_core::config::{Kind, LineConfig};
use seabearing_locate::line::{LinePlan, MusicMethod};
use std::path::PathBuf;
use time::OffsetDateTime;
use wide::Wide;

/// How a line's recordings are analysed: the rest of the table `[line]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Analysis {
    /// Frequencies looked at, Hz; empty: none is named.
    pub frequencies_hz: Vec<f64>,
    /// Length of a transform, seconds.
    pub frame_s: f64,
    /// Time from one bearing to the next, seconds.
    pub step_s: f64,
    /// Share of the steps before and after one in its covariance.
    pub forgetting: f64,
    /// Overlapping subarrays.
    pub subarrays: usize,
    /// Most sources at once.
    pub sources: usize,
    /// How the noise subspace is searched.
    pub method: MusicMethod,
    /// Channel of the recording of each sensor; empty: the first so many.
    pub channels: Vec<u8>,
}

impl Default for Analysis {
    fn default() -> Self {
        Self {
            frequencies_hz: Vec::new(),
            frame_s: 1.0 / 16.0,
            step_s: 1.0,
            forgetting: 0.4,
            subarrays: 5,
            sources: 2,
            method: MusicMethod::Root,
            channels: Vec::new(),
        }
    }
}

/// One source at one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineBearing {
    /// Mean time of what it rests on, seconds since the first sample.
    pub t_s: f64,
    /// Number of the source at this step, the strongest first.
    pub source: usize,
    /// Cosine of the angle to the direction of rising sensor numbers: sine of the bearing from broadside.
    pub sine: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// Signal-to-noise ratio of one sensor and transform, the mean over the frequencies that heard it, decibels.
    pub snr_db: f64,
    /// How many frequencies heard it.
    pub frequencies: u8,
}

/// What is known after a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Steps with samples.
    pub steps: u64,
    /// Samples a sensor, used in whole transforms.
    pub used: u64,
    /// Samples a sensor left out: beside gaps, or missing at a sensor.
    pub lost: u64,
}

/// Whether the frequencies of `[line]` can be heard at a rate, Hz.
///
/// # Errors
/// One line: which cannot, and which are possible.
pub fn check_frequencies(analysis: &Analysis, rate_hz: f64) -> Result<()> {
    let (low, high) = (2.0 / analysis.frame_s, rate_hz / 2.0 - 2.0 / analysis.frame_s);
    let Some(frequency_hz) = analysis.frequencies_hz.iter().find(|f| !(low..=high).contains(*f)) else {
        return Ok(());
    };
    if !(low < high) {
        bail!(
            "`frame_s` is {}: too short to tell frequencies at {rate_hz} Hz; more than {} s is needed",
            analysis.frame_s,
            8.0 / rate_hz
        );
    }
    bail!(
        "`frequencies_hz` has {frequency_hz}; from {low} to {high} Hz are possible with this rate and `frame_s`"
    )
}

/// A line's recording, ready to be gone through.
pub struct Line {
    source: Wide,
    frames: Frames,
    plans: Vec<LinePlan>,
    analysis: Analysis,
    rate_hz: f64,
    spacing_m: f64,
    sound_speed_m_s: f64,
}

/// What each frequency is looked at with, of so many sensors.
fn plans(sensors: usize, spacing_m: f64, sound_speed_m_s: f64, analysis: &Analysis) -> Result<Vec<LinePlan>> {
    let plan = |frequency_hz: &f64| {
        let plan = LinePlan::new(
            sensors,
            spacing_m,
            *frequency_hz,
            sound_speed_m_s,
            analysis.subarrays,
            analysis.forgetting,
            analysis.sources,
        );
        let above = half_lobe_hz(analysis.frame_s) / frequency_hz;
        plan.map(|plan| plan.counting().hearing_above(above))
            .map_err(|e| anyhow!("[line] at {frequency_hz} Hz: {e}"))
    };
    analysis.frequencies_hz.iter().map(plan).collect()
}

impl Line {
    /// Finds a line's recordings.
    ///
    /// # Errors
    /// The station file says too little, or nothing usable was found; the line says what to do.
    pub fn find(paths: &[PathBuf], station: &Station, asked: &Asked) -> Result<Self> {
        let Kind::Line(LineConfig { sensors, spacing_m }) = station.config.kind else {
            bail!("the station is no line (kind = \"line\")");
        };
        let (config, analysis) = (&station.config, station.line.clone());
        let rate_hz = config.rate_hz;
        if !(rate_hz > 0.0) {
            bail!(
                "the station file does not say how the line samples: a table [sampling] with `rate_hz` is needed"
            );
        }
        if analysis.frequencies_hz.is_empty() {
            bail!(
                "the station file names no frequencies to look at: `frequencies_hz = [702.0]` in [line] is needed"
            );
        }
        check_frequencies(&analysis, rate_hz)?;
        let sensors = usize::from(sensors);
        let plans = plans(sensors, spacing_m, config.sound_speed_m_s, &analysis)?;
        let channels: Vec<u8> = match analysis.channels.is_empty() {
            true => (0..sensors as u8).collect(),
            false => analysis.channels.clone(),
        };
        let source = Wide::find(paths, station, asked, &channels)?;
        let frames = Frames::new(sensors, rate_hz, analysis.frame_s, &analysis.frequencies_hz);
        let sound_speed_m_s = config.sound_speed_m_s;
        Ok(Self { source, frames, plans, analysis, rate_hz, spacing_m, sound_speed_m_s })
    }

    /// UTC of the first sample, where the recording has a clock.
    pub fn start(&self) -> Option<OffsetDateTime> {
        self.source.start()
    }

    /// Goes through the recording. A gap longer than a step begins anew.
    ///
    /// # Errors
    /// The recording is lost, or `sink` fails.
    pub fn run(mut self, mut sink: impl FnMut(LineBearing) -> Result<()>) -> Result<Summary> {
        let seconds = |n: u64| (n as f64 / self.rate_hz) as u64;
        let bar = progress::bar(self.source.expected_end().map_or(0, seconds), "processing");
        let mut block = Vec::new();
        let sensors = self.frames.sensors();
        let mut steps = Steps {
            chain: Chain::new(self.plans.clone(), &self.analysis),
            run: Some((0, sensors)),
            tally: Tally::new(sensors, self.spacing_m),
            plans: |run: Run| match run.1 == sensors {
                true => Some(self.plans.clone()),
                false => plans(run.1, self.spacing_m, self.sound_speed_m_s, &self.analysis).ok(),
            },
        };
        let step_samples = (self.analysis.step_s * self.rate_hz).max(1.0);
        let step_of = |index: u64| (index as f64 / step_samples) as u64;
        let mut current: Option<u64> = None;
        let frames = &mut self.frames;
        while let Some(first) = self.source.next_block(&mut block)? {
            bar.set_position(seconds(first));
            frames.go_to(first);
            for instant in block.chunks_exact(frames.sensors()) {
                let Some(middle) = frames.take(instant) else { continue };
                let step = step_of(middle);
                if let Some(before) = current.filter(|before| *before != step) {
                    steps.take(frames.hand_over(), &mut sink)?;
                    if step > before + 1 {
                        steps.chain.end(&mut sink)?;
                    }
                }
                current = Some(step);
                frames.keep();
            }
        }
        if current.is_some() {
            steps.take(frames.hand_over(), &mut sink)?;
        }
        steps.chain.end(&mut sink)?;
        bar.finish_and_clear();
        if let Some(line) = steps.tally.said() {
            log::warn!("{line}");
        }
        Ok(Summary { steps: steps.chain.steps(), used: frames.used(), lost: frames.lost() })
    }
}

/// Steps on their way to the chain, each with the sensors that record in it.
struct Steps<'a, P> {
    chain: Chain<'a>,
    /// Sensors that the chain's plans are of; `None`: too few for any.
    run: Option<Run>,
    tally: Tally,
    /// The plans of a run.
    plans: P,
}

impl<P: Fn(Run) -> Option<Vec<LinePlan>>> Steps<'_, P> {
    /// Hands on a step. With other sensors than before it begins anew.
    fn take(&mut self, mut held: Held, sink: &mut impl FnMut(LineBearing) -> Result<()>) -> Result<()> {
        let run = longest(held.flat, self.tally.sensors());
        if self.run != Some(run) {
            self.chain.end(sink)?;
            let plans = (self.plans)(run);
            self.run = plans.is_some().then_some(run);
            if let Some(plans) = plans {
                self.chain.plan(plans);
            }
        }
        self.tally.take(held.flat, run, self.run.is_some());
        if self.run.is_none() {
            return Ok(());
        }
        only(&mut held, run);
        self.chain.step(held, sink)
    }
}

#[cfg(test)]
mod tests;
