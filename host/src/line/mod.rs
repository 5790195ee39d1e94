//! A uniform line of sensors, from its recording to bearings (paper L, section 3).
//!
//! Enters: a recording of all sensors (WAV or FLAC), and what the table `[line]` of the station file says of how it is to be
//! analysed. Leaves: a [`LineBearing`] for each source and step. In the order data flows: `wide` (all sensors side by side),
//! `frames` (spectra at the frequencies), [`seabearing_locate::line`] (covariance, number of sources, MUSIC, and what several
//! frequencies have in common).
//!
//! A line cannot tell its two sides apart, nor azimuth from elevation: a bearing is the cosine of the angle to its axis.

mod frames;
pub mod known;
pub mod picture;
pub mod records;
mod wide;

use crate::progress;
use crate::recording::Asked;
use crate::station::Station;
use anyhow::{Result, anyhow, bail};
use frames::Frames;
use seabearing_core::config::{Kind, LineConfig};
use seabearing_locate::line::{
    JoinedArrival, LineArrival, LinePlan, MAX_FREQUENCIES, MAX_SOURCES, MusicMethod, Scratch, State, join,
};
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
    /// Share of the past in the covariance.
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
        let plan = |frequency_hz: &f64| {
            let plan = LinePlan::new(
                sensors,
                spacing_m,
                *frequency_hz,
                config.sound_speed_m_s,
                analysis.subarrays,
                analysis.forgetting,
                analysis.sources,
            );
            plan.map(LinePlan::counting).map_err(|e| anyhow!("[line] at {frequency_hz} Hz: {e}"))
        };
        let plans = analysis.frequencies_hz.iter().map(plan).collect::<Result<Vec<_>>>()?;
        let channels: Vec<u8> = match analysis.channels.is_empty() {
            true => (0..sensors as u8).collect(),
            false => analysis.channels.clone(),
        };
        let source = Wide::find(paths, station, asked, &channels)?;
        let frames = Frames::new(sensors, rate_hz, analysis.frame_s, &analysis.frequencies_hz);
        Ok(Self { source, frames, plans, analysis, rate_hz })
    }

    /// UTC of the first sample, where the recording has a clock.
    pub fn start(&self) -> Option<OffsetDateTime> {
        self.source.start()
    }

    /// Goes through the recording. A gap longer than a step begins a new covariance.
    ///
    /// # Errors
    /// The recording is lost, or `sink` fails.
    pub fn run(mut self, mut sink: impl FnMut(LineBearing) -> Result<()>) -> Result<Summary> {
        let seconds = |n: u64| (n as f64 / self.rate_hz) as u64;
        let bar = progress::bar(self.source.expected_end().map_or(0, seconds), "processing");
        let (mut block, mut states) = (Vec::new(), Vec::new());
        let mut chain = Chain {
            plans: &self.plans,
            states: &mut states,
            scratch: Box::new(Scratch::new()),
            analysis: &self.analysis,
            mean_s: None,
            steps: 0,
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
                    chain.step(before, frames, &mut sink)?;
                    if step > before + 1 {
                        chain.forget();
                    }
                }
                current = Some(step);
                frames.keep();
            }
        }
        if let Some(step) = current {
            chain.step(step, frames, &mut sink)?;
        }
        bar.finish_and_clear();
        let steps = chain.steps;
        Ok(Summary { steps, used: frames.used(), lost: frames.lost() })
    }
}

/// Covariances of all frequencies over time.
struct Chain<'a> {
    plans: &'a [LinePlan],
    states: &'a mut Vec<State>,
    scratch: Box<Scratch>,
    analysis: &'a Analysis,
    /// Mean time of what the covariances hold.
    mean_s: Option<f64>,
    steps: u64,
}

impl Chain<'_> {
    /// Nothing of the past counts any more.
    fn forget(&mut self) {
        self.states.clear();
        self.mean_s = None;
    }

    /// The transforms of a step are complete.
    fn step(
        &mut self,
        step: u64,
        frames: &mut Frames,
        sink: &mut impl FnMut(LineBearing) -> Result<()>,
    ) -> Result<()> {
        self.states.resize_with(self.plans.len(), State::new);
        let centre_s = (step as f64 + 0.5) * self.analysis.step_s;
        let share = self.analysis.forgetting;
        let t_s = self.mean_s.map_or(centre_s, |past| share * past + (1.0 - share) * centre_s);
        self.mean_s = Some(t_s);
        self.steps += 1;
        let mut heard = [([LineArrival::default(); MAX_SOURCES], 0); MAX_FREQUENCIES];
        let of_each = heard.iter_mut().zip(self.plans).zip(self.states.iter_mut()).zip(frames.kept());
        for ((((arrivals, count), plan), state), snapshots) in of_each {
            // A step without usable snapshots has no bearing.
            let found = plan.step(state, &mut self.scratch, snapshots, self.analysis.method, arrivals);
            *count = found.unwrap_or(0);
        }
        frames.clear();
        let mut joined = [JoinedArrival::default(); MAX_SOURCES];
        let beam = self.plans.iter().map(LinePlan::beam).fold(0.0, f64::max);
        let n = join(heard.get(..self.plans.len()).unwrap_or_default(), beam, &mut joined)
            .min(self.analysis.sources);
        for (source, JoinedArrival { arrival, frequencies }) in joined.iter().take(n).enumerate() {
            let snr_db = 10.0 * (arrival.snr / f64::from((*frequencies).max(1))).max(1e-12).log10();
            let LineArrival { sine, sd, .. } = *arrival;
            sink(LineBearing { t_s, source, sine, sd, snr_db, frequencies: *frequencies })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
