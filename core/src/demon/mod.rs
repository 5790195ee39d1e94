//! Shaft or blade rate from the envelope of broadband noise (DEMON: detection of envelope modulation on noise).
//!
//! Propeller cavitation is louder each time a blade passes the hull's wake, so the *power* of a vessel's broadband
//! noise swings at the blade rate (and, as no two blades are alike, at the shaft rate). In: the band's power of each frame of
//! the array chain, one hydrophone. Out: every few seconds a [`RateReport`]: a [`Rate`] with its uncertainty and false-alarm
//! bound, or the reason why not.
//!
//! Chain: power of a frame's bins above the corner → logarithm (a modulation of the power becomes a sum) → decimating low-pass to
//! about 68 Hz (the frames' own rate below 46 kHz of samples) → values far off the window's own scatter limited (a click cannot dominate) → 30 s Hann periodogram → local noise
//! floor → comb search ([`comb`]).
//!
//! Assumptions: the rate is steady within about 1/30 Hz over 30 s; the modulated band lies above the corner. Anything else
//! that repeats (a pinging sonar, a pump) is a comb as well. When it fails: `docs/shaft-rate.md`.
//!
//! Cost: five multiply-adds and a logarithm a frame (0.02 M instructions a second); a 2048-point FFT and the comb search a report
//! (about 1.6 M instructions). Memory: [`State`] 4.2 KiB, [`Scratch`] 8 KiB (lives only within a call; the array chain
//! lends its own), [`Config`] 0.3 KiB; at the slower outputs of low sampling rates the window has fewer of them, and costs less.

pub mod comb;
mod envelope;
mod periodogram;
pub mod speed;

pub use comb::{Rate, Reading};
pub use envelope::WINDOW;
pub use speed::{Speed, SpeedCurve, VESSEL_SPEEDS_M_S};

use comb::Search;
use core::num::NonZeroU64;
use envelope::Envelope;

/// What a person chooses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Lowest frequency of the band whose power is taken, Hz.
    pub high_pass_hz: f64,
    /// Lowest and highest rate searched, Hz (0.5 to 25, and at most two fifths of the envelope's own rate).
    pub search_hz: (f64, f64),
    /// Time between reports, seconds (0.5 to 600).
    pub update_s: f64,
    /// Rates allowed from unmodulated noise, per hour (an upper bound, see [`comb`]).
    pub false_rates_per_hour: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { high_pass_hz: 3000.0, search_hz: (0.7, 16.0), update_s: 5.0, false_rates_per_hour: 0.01 }
    }
}

/// A setting that cannot work: its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is outside what can be demodulated")]
pub struct SettingError(pub &'static str);

/// The immutable plan made from [`Settings`].
#[derive(Clone, Debug)]
pub struct Config {
    envelope: envelope::Plan,
    search: Search,
    update: u32,
    output_hz: f64,
}

impl Config {
    /// Checks the settings and works out filters and thresholds, for frames `hop` samples apart at `rate_hz` samples a
    /// second.
    ///
    /// # Errors
    /// [`SettingError`] names the first setting outside its range.
    pub fn new(settings: &Settings, rate_hz: f64, hop: NonZeroU64) -> Result<Self, SettingError> {
        let s = settings;
        let within = |name, x: f64, lo: f64, hi: f64| {
            if x >= lo && x <= hi { Ok(()) } else { Err(SettingError(name)) }
        };
        within("rate_hz", rate_hz, 1000.0, 1e6)?;
        within("high_pass_hz", s.high_pass_hz, 1.0, 0.45 * rate_hz)?;
        within("update_s", s.update_s, 0.5, 600.0)?;
        within("search_hz[0]", s.search_hz.0, 0.5, 24.0)?;
        within("search_hz[1]", s.search_hz.1, s.search_hz.0 + 0.1, 25.0)?;
        within("false_rates_per_hour", s.false_rates_per_hour, 1e-6, 100.0)?;
        let envelope = envelope::Plan::new(rate_hz, hop);
        let output_hz = envelope.output_hz(rate_hz);
        let search_hz = (s.search_hz.0, s.search_hz.1.min(0.4 * output_hz));
        within("rate_hz", search_hz.1, search_hz.0 + 0.1, 25.0)?;
        let tests_per_hour = 3600.0 / s.update_s;
        Ok(Self {
            search: Search::new(
                search_hz,
                output_hz,
                envelope.window,
                s.false_rates_per_hour / tests_per_hour,
            ),
            update: (s.update_s * output_hz) as u32,
            envelope,
            output_hz,
        })
    }

    /// Spacing of the demodulated spectrum's bins, Hz (about 1/30).
    pub fn bin_hz(&self) -> f64 {
        self.output_hz / self.envelope.window as f64
    }
}

/// What is remembered between blocks.
#[derive(Clone, Debug)]
pub struct State {
    envelope: Envelope,
    since_report: u32,
}

impl State {
    /// Nothing heard yet.
    pub const fn new() -> Self {
        Self { envelope: Envelope::new(), since_report: 0 }
    }

    /// Power over the local noise floor of the window heard last (1 = noise), from 0 Hz up in steps of [`Config::bin_hz`];
    /// `None` where too little was heard.
    pub fn spectrum<'a>(
        &self,
        config: &Config,
        scratch: &'a mut Scratch,
    ) -> Option<impl Iterator<Item = f32> + use<'a>> {
        let bins = periodogram::demodulated(&self.envelope, &config.envelope, scratch)?;
        Some(bins.iter().map(|bin| bin.re))
    }
}

/// Working memory of one report (8 KiB; may be shared, nothing in it lives from call to call).
pub type Scratch = [microfft::Complex32; WINDOW / 2];

/// Empty working memory.
pub const EMPTY_SCRATCH: Scratch = [microfft::Complex32::new(0.0, 0.0); WINDOW / 2];

/// Why there is no rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoRate {
    /// Less than four fifths of the window is there (start, gaps).
    NotEnoughData,
    /// No comb rises above the noise at the stated false-alarm bound.
    Unmodulated,
}

/// The answer for the 30 s up to the frame at `index`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateReport {
    /// Sample index of the newest frame's first sample.
    pub index: u64,
    /// The rate, or why there is none.
    pub rate: Result<Rate, NoRate>,
}

/// Takes the power (codes²) of the frame whose first sample is `index`; a report where one falls due with it.
///
/// A jump of the index forward leaves outputs out of the spectrum. Where it starts again, so does the caller, with a new
/// [`State`].
pub fn frame(
    config: &Config,
    state: &mut State,
    scratch: &mut Scratch,
    index: u64,
    power: f32,
) -> Option<RateReport> {
    state.since_report += state.envelope.take(&config.envelope, index, power);
    if state.since_report < config.update {
        return None;
    }
    state.since_report = 0;
    let rate = match periodogram::demodulated(&state.envelope, &config.envelope, scratch) {
        Some(spectrum) => config.search.best(spectrum).ok_or(NoRate::Unmodulated),
        None => Err(NoRate::NotEnoughData),
    };
    Some(RateReport { index, rate })
}

#[cfg(test)]
mod tests;
