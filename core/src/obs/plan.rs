//! The immutable plan of an ocean-bottom station: everything computed once from configuration and table.
//!
//! Enters: [`StationConfig`] and [`Table`]. Leaves: band, orientation, filters, travel times, and a view of the
//! interference model in the table's own bytes. Cost: 2 KiB.

use super::azigram::Band;
use super::cauchy::WrappedCauchy;
use super::decimate::{Decimator, factor_of, inner_rate_hz};
use super::first_motion;
use super::impulsive::Calls;
use super::interference::Interference;
use super::lasting::Lasting;
use super::limits::{AZIMUTH_BINS, FRAME, HOP};
use super::moments::BandPass;
use super::table::{Table, TableError};
use super::travel::TravelTime;
use crate::angle::RAD_PER_DEG;
use crate::config::{Compatibility, ConfigError, Kind, StationConfig};
use crate::density::Scale;
use crate::intake;
use crate::math;
use crate::slow_levels;

/// Why a station cannot be planned.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The configuration is of another kind of recorder.
    #[error("the station is not of kind \"obs\"")]
    NotAnOceanBottomStation,
    /// The configuration is wrong.
    #[error("the configuration is not valid: {0}")]
    Config(ConfigError),
    /// The propagation table is wrong.
    #[error(transparent)]
    Table(TableError),
    /// The table ends before the nearest range worth searching: its last range, and the range wanted, m.
    #[error("propagation table ends at {0} m, at least {1} m is needed")]
    TableTooShort(f32, f32),
    /// The table was made for transforms at another rate: its rate and the station's, Hz.
    #[error(
        "propagation table was made for transforms at {0} Hz, this station's run at {1} Hz: write the blob anew with `seabearing blob`"
    )]
    TableRate(f32, f64),
    /// The sampling rate leaves nothing of the band of vessels' tones (11 Hz and up): the rate, Hz.
    #[error("rate_hz = {0} leaves no band above 11 Hz; at least 24 Hz")]
    RateTooLow(f64),
}

/// Least range a table must reach, m: nearer than that there is hardly any interference to range with.
const LEAST_TABLE_RANGE_M: f32 = 15_000.0;

/// Band of tones, Hz [O, III B]: outside it the direction of an ocean-bottom seismometer is poor.
const TONE_BAND_HZ: (f64, f64) = (11.0, 24.0);

/// Seconds from one record set to the next.
pub const STEP_S: f64 = 60.0;

/// Half the length of the azimuth window, seconds.
pub const HALF_WINDOW_S: f64 = 90.0;

/// Without pressure there is neither azimuth nor range; the other channels are only needed for azimuth.
const NEEDED: u8 = 0b0001;

/// Longest absence that is bridged, in this part of a hop: 0.64 s at 50 Hz, four lost frames of a sample line.
const BRIDGED: usize = 16;

/// The first bin of spectra: one that a constant offset does not reach through the window.
const FIRST_MEASURED: u16 = 2;

/// Everything computed once.
#[derive(Clone, Debug)]
pub struct Plan<'t> {
    pub(crate) intake: intake::Plan,
    /// Rate of the recording, Hz.
    pub(super) rate_hz: f64,
    /// Rate after decimation, Hz.
    pub(super) inner_rate_hz: f64,
    pub(super) decimator: Decimator,
    pub(super) band: Band,
    /// Codes at or beyond this are clipped.
    pub(super) clip: i32,
    pub(super) full_scale: f32,
    /// What makes densities of transforms.
    pub(super) scale: Scale,
    /// Levels sent unasked.
    pub(super) slow: slow_levels::Plan,
    /// Whose choices, and whether they are not ours.
    pub(super) choices: Compatibility,
    pub(super) paper: bool,
    /// Whether azigrams are sent.
    pub(super) azigram: bool,
    pub(super) tones: WrappedCauchy,
    pub(super) calls: Calls,
    pub(super) moments: BandPass,
    /// Instants over which sounds that set in are summed; 0: the water is too shallow ([`super::first_motion`]).
    pub(super) onset_block: u16,
    /// Whether the vertical component and pressure of sound from above have one sign.
    pub(super) towards: bool,
    pub(super) interference: Interference<'t>,
    pub(super) travel: TravelTime,
    /// What is not known of the station itself.
    pub(super) lasting: Lasting,
}

impl<'t> Plan<'t> {
    /// Nothing computed; all zeros.
    pub const EMPTY: Self = Self {
        intake: intake::Plan::EMPTY,
        rate_hz: 0.0,
        inner_rate_hz: 0.0,
        decimator: Decimator::EMPTY,
        band: Band::EMPTY,
        clip: 0,
        full_scale: 0.0,
        scale: Scale::EMPTY,
        slow: slow_levels::Plan::EMPTY,
        choices: Compatibility::None,
        paper: false,
        azigram: false,
        tones: WrappedCauchy { paper: false },
        calls: Calls::EMPTY,
        moments: BandPass::EMPTY,
        onset_block: 0,
        towards: false,
        interference: Interference::EMPTY,
        travel: TravelTime::EMPTY,
        lasting: Lasting::EMPTY,
    };

    /// Validates and computes.
    ///
    /// # Errors
    /// The first thing found wrong.
    pub fn new(config: &StationConfig, table: &Table<'t>) -> Result<Self, PlanError> {
        let mut plan = Self::EMPTY;
        plan.fill(config, table)?;
        Ok(plan)
    }

    /// Validates, and computes in place. Nothing is changed where something is wrong.
    ///
    /// # Errors
    /// The first thing found wrong.
    pub fn fill(&mut self, config: &StationConfig, table: &Table<'t>) -> Result<(), PlanError> {
        let Kind::Obs(obs) = &config.kind else { return Err(PlanError::NotAnOceanBottomStation) };
        config.validate().map_err(PlanError::Config)?;
        if table.max_range_m() < LEAST_TABLE_RANGE_M {
            return Err(PlanError::TableTooShort(table.max_range_m(), LEAST_TABLE_RANGE_M));
        }
        let rate_hz = config.rate_hz;
        let factor = factor_of(rate_hz);
        let inner_rate_hz = inner_rate_hz(rate_hz);
        let per_hz = FRAME as f64 / inner_rate_hz;
        // The top 4 % of the band below Nyquist belongs to the recorder's anti-alias filter.
        let top_hz = TONE_BAND_HZ.1.min(0.48 * inner_rate_hz);
        let first_bin = math::f64::ceil(TONE_BAND_HZ.0 * per_hz - 1e-9) as usize;
        let last_bin = math::f64::floor(top_hz * per_hz + 1e-9) as usize;
        if last_bin < first_bin + 16 {
            return Err(PlanError::RateTooLow(rate_hz));
        }
        if table.rate_hz() != inner_rate_hz as f32 {
            return Err(PlanError::TableRate(table.rate_hz(), inner_rate_hz));
        }
        let paper = obs.compatibility != Compatibility::None;
        let away = if obs.intensity_towards { 0.0 } else { math::f64::PI };
        self.intake = intake::Plan::new(rate_hz, NEEDED, (HOP * factor / BRIDGED) as u32);
        self.rate_hz = rate_hz;
        self.inner_rate_hz = inner_rate_hz;
        self.decimator.fill(factor);
        self.band = Band {
            first_bin,
            bins: (last_bin - first_bin + 1).min(AZIMUTH_BINS),
            turn: crate::angle::wrap_tau(obs.orientation_of_north_deg * RAD_PER_DEG + away) as f32,
            paper,
        };
        self.clip = config.full_scale.saturating_sub(1);
        self.full_scale = config.full_scale as f32;
        self.scale = Scale {
            // One-sided; the sum of squares of a Hann window of N points that sums to 1 is 3/(2N).
            unit: 4.0 * FRAME as f32 / (3.0 * inner_rate_hz as f32 * self.full_scale * self.full_scale),
            bin_hz: (inner_rate_hz / FRAME as f64) as f32,
            low: FIRST_MEASURED,
            high: HOP as u16,
        };
        self.slow = slow_levels::Plan::new(config, self.scale);
        self.choices = obs.compatibility;
        self.paper = paper;
        self.azigram = obs.azigram;
        self.tones = WrappedCauchy { paper };
        self.calls.fill(inner_rate_hz);
        self.moments = BandPass::new(rate_hz as f32);
        self.towards = obs.intensity_towards;
        self.interference = Interference::new(table);
        self.travel.fill(table, paper);
        let straight_up_s = table.travel_times_s().next().unwrap_or_default();
        self.onset_block = first_motion::block(rate_hz, straight_up_s);
        let water_m = f64::from(straight_up_s) * config.sound_speed_m_s;
        self.lasting = Lasting::new(config.doubts, obs.orientation_of_north_deg, water_m);
        Ok(())
    }

    /// Samples a second of the recording.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Rate the transforms run at, Hz.
    pub fn inner_rate_hz(&self) -> f64 {
        self.inner_rate_hz
    }

    /// Farthest range the interference model covers, m.
    pub fn max_range_m(&self) -> f32 {
        self.interference.max_range_m()
    }

    /// The interference model made from the table.
    pub fn interference(&self) -> &Interference<'t> {
        &self.interference
    }

    /// Samples of the recording in a hop.
    pub(super) fn hop(&self) -> u64 {
        (HOP * self.decimator.factor()) as u64
    }

    /// Travel times made from the table.
    pub fn travel(&self) -> &TravelTime {
        &self.travel
    }
}
