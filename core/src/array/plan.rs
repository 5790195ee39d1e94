//! The array chain's plan: everything that follows from the configuration, computed once and never changed.

use super::chain::BRIDGE;
use super::detect;
use super::transform::{RUN, window};
use super::wavefront::{Direction, Used};
use crate::block::CHANNELS;
use crate::config::{ConfigError, Kind, StationConfig};
use crate::demon;
use crate::density::Scale;
use crate::geometry::Geometry;
use crate::intake;
use crate::math::{f32 as m, f64 as md};
use crate::slow_levels;
use core::num::NonZeroU64;

/// Least relative standard deviation of the speed of sound: what frames do not share of long delays looks like so much of it.
/// Three hydrophones take it for a direction.
const LEAST_SPEED_SD: f64 = 1e-4;
/// Relative standard deviation of a curvature of which nothing is known: from half as far as the reference to infinitely far.
const UNKNOWN_CURVATURE: f32 = 0.6;
/// Standard deviation of the sine of the elevation by which a vessel's distance is told, by what echoes do to it. A vessel heard by itself, not with its image as
/// from the surface, is nearer by its depth.
const RISE_SD: f32 = 0.02;

/// Part of the sampling rate up to which converters and resamplers pass sound as it was. What fades beyond it is heard by all hydrophones alike
/// and would pass for fringes of a surface.
const PASSED: f64 = 0.4375;

/// Phase, radians, that a hydrophone's told deviation makes at the upper end of the band. Of the three differences of four arrival times two
/// turn the direction; the third leaves the pairs √⅔ of that deviation apart, a radian here. Above it their sum has its peak by chance.
const MOST_OUT_OF_PHASE: f64 = 1.2247;
/// The band does not end below so many times the frequency from which on ambient noise is incoherent.
const LEAST_KNEES: usize = 4;

/// Length of one transform, samples. Short frames suffice: a delay of 80 samples still overlaps by 84 %, and the
/// joint estimator loses nothing against 4096 points (docs/references.md).
pub const FRAME: usize = 512;
/// Samples from one frame to the next: the tapers (64 samples each side) overlap.
pub const HOP: usize = 448;
/// Bins of one spectrum (the Nyquist bin is not used).
pub const BINS: usize = FRAME / 2;
/// Longest delay across the array, samples: a quarter of a frame, beyond which frames of two hydrophones share
/// too little of one signal.
pub const MAX_DELAY: usize = FRAME / 4;

/// Delays (samples) between entries of the table of shared signal.
pub(crate) const SHARE_STRIDE: usize = 8;
/// Entries of that table: up to [`MAX_DELAY`].
pub(crate) const SHARES: usize = FRAME / SHARE_STRIDE;

/// Why no plan can be made.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The station is not a compact array.
    #[error("the station is not a compact array (kind = \"array\")")]
    NotAnArray,
    /// The configuration is not valid.
    #[error("the configuration is not valid: {0}")]
    Config(ConfigError),
    /// `segment_s` must be `step_s` or twice `step_s`; a step must hold at least four frames.
    #[error("segment_s must be step_s or twice step_s, and step_s hold four frames")]
    Steps,
    /// The array is too large for its sampling rate: longest delay and greatest allowed, samples.
    #[error("sound needs {0:.0} samples across the array, at most {1:.0} can be handled")]
    TooLarge(f32, f32),
    /// Fewer than four bins lie in the band.
    #[error("band_hz holds fewer than four frequency bins")]
    Band,
}

/// Octaves of the sub-bands: the first is 125 to 250 Hz, each next one twice as high.
pub(crate) const OCTAVES: usize = 9;
/// Lowest frequency of the first octave, Hz.
const FIRST_OCTAVE_HZ: f64 = 125.0;
/// Fewest bins of an octave that is searched.
const LEAST_BINS: usize = 4;
/// Share of the allowed false alarms that all octaves together may take; the rest is the whole band's.
const OCTAVE_SHARE: f64 = 0.2;

/// Bins and hydrophones searched together, and what follows from them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Band {
    /// First bin.
    pub(crate) low: usize,
    /// One past the last bin.
    pub(crate) high: usize,
    /// First bin that detection and search use: ambient noise is coherent across the array below it.
    pub(crate) incoherent: usize,
    /// Standardised statistic that noise exceeds at the configured rate.
    pub(crate) threshold: f32,
    /// Angle over which the steered response falls off, radians.
    pub(crate) resolution: f32,
    /// The hydrophones.
    pub(crate) used: Used,
}

impl Band {
    /// Runs of bins that hold the band; the first and the last may hold a bin beside it.
    pub(crate) fn runs(&self) -> core::ops::Range<usize> {
        self.low / RUN..self.high.div_ceil(RUN)
    }
}

/// Mean square of the bins' numbers.
#[inline(never)]
fn mean_square(low: usize, high: usize) -> f64 {
    let sum: f64 = (low..high).map(|k| (k * k) as f64).sum();
    sum / high.saturating_sub(low).max(1) as f64
}

/// The immutable plan of the array chain (about half a KiB).
#[derive(Clone, Debug)]
pub struct Plan {
    pub(crate) intake: intake::Plan,
    pub(crate) geometry: Geometry,
    pub(crate) inv_c: f32,
    /// 1/reference range, 1/m.
    pub(crate) curvature: f32,
    pub(crate) rate_hz: f32,
    /// Transform of the window over its bin 0, bins 1 to 3: what a constant offset leaks into them.
    pub(crate) offset_leak: [f32; 3],
    /// Frames times this is the number of independent snapshots of a bin.
    pub(crate) snapshots_per_frame: f32,
    /// Autocorrelation of the window at multiples of [`SHARE_STRIDE`] samples: the share of a delayed signal that frames
    /// of two hydrophones have in common.
    pub(crate) shared: [f32; SHARES],
    /// Mean square of the window times FRAME².
    pub(crate) window_power: f32,
    /// The whole band.
    pub(crate) whole: Band,
    /// Its octaves above the frequency from which ambient noise is incoherent: octave n from 125 Hz · 2ⁿ to twice that.
    pub(crate) octaves: [Option<Band>; OCTAVES],
    /// Angular frequency of bin 1, rad/s.
    pub(crate) bin_rad_s: f32,
    pub(crate) step_samples: NonZeroU64,
    pub(crate) steps_per_segment: u8,
    /// Frames of a full segment.
    pub(crate) nominal_frames: f32,
    pub(crate) channels: [u8; CHANNELS],
    /// Codes at or beyond ± this are clipped.
    pub(crate) clip_code: i32,
    pub(crate) full_scale: f32,
    /// Sines of the elevations searched.
    pub(crate) elevation: (f32, f32),
    /// Distance of each pair over the speed of sound, seconds.
    pub(crate) crossing_s: [f32; 6],
    /// Depth of the vessels listened to over the array's own depth; 0 where there is no surface.
    pub(crate) vessel_over_array_depth: f32,
    /// The array's own depth, metres.
    pub(crate) depth_m: f32,
    /// Standard deviation of a hydrophone's position over the speed of sound, seconds.
    pub(crate) position_sd_s: f32,
    /// Share of what the pairs hear by themselves that the best direction explains where positions are off by twice what is told.
    pub(crate) in_phase: f32,
    /// Relative standard deviation of the speed of sound.
    pub(crate) sound_speed_sd: f32,
    /// What makes densities of auto-spectra.
    pub(crate) scale: Scale,
    /// Levels sent unasked.
    pub(crate) slow: slow_levels::Plan,
    /// One past the last bin whose levels are told; the band in which directions are looked for ends there or before.
    pub(crate) passed: usize,
    /// First bin of the band whose envelope gives the shaft rate.
    pub(crate) envelope_low: usize,
    /// Shaft rate; `None` where the sampling rate is too low for it.
    pub(crate) shaft: Option<demon::Config>,
}

const EACH_HOP: NonZeroU64 = NonZeroU64::new(HOP as u64).unwrap();

/// Seconds from one shaft rate to the next.
pub const SHAFT_RATE_EVERY_S: f64 = 10.0;

/// What the recorder asks of the shaft rate: an analysis in a third of its window.
const SHAFT: demon::Settings = demon::Settings {
    high_pass_hz: 3000.0,
    search_hz: (0.7, 16.0),
    update_s: SHAFT_RATE_EVERY_S,
    false_rates_per_hour: 0.01,
};

impl Plan {
    /// Makes the plan of a configuration.
    ///
    /// # Errors
    /// [`PlanError`] names what cannot be done.
    pub fn new(config: &StationConfig) -> Result<Self, PlanError> {
        let Kind::Array(array) = &config.kind else { return Err(PlanError::NotAnArray) };
        config.validate().map_err(PlanError::Config)?;
        let geometry = config.geometry().map_err(|e| PlanError::Config(ConfigError::Geometry(e)))?;
        let rate = config.rate_hz;

        let steps = md::round(array.segment_s / array.step_s);
        let exact = md::abs(steps * array.step_s - array.segment_s) < 1e-6 * array.segment_s;
        let step_samples = NonZeroU64::new(md::round(array.step_s * rate) as u64);
        let (Some(step_samples), true) = (step_samples, exact && (steps == 1.0 || steps == 2.0)) else {
            return Err(PlanError::Steps);
        };
        if step_samples.get() < (4 * FRAME) as u64 {
            return Err(PlanError::Steps);
        }

        let mut crossing_s = [0.0f32; 6];
        for (p, t) in crossing_s.iter_mut().enumerate() {
            *t = geometry.separation_m(p) / geometry.sound_speed_m_s;
        }
        let longest = crossing_s.iter().fold(0.0f32, |a, b| a.max(*b));
        let longest_samples = longest * rate as f32;
        if longest_samples > (MAX_DELAY - 4) as f32 {
            return Err(PlanError::TooLarge(longest_samples, (MAX_DELAY - 4) as f32));
        }

        let bin_hz = rate / FRAME as f64;
        let low = (md::ceil(array.band_hz.0 / bin_hz) as usize).max(1);
        let highest_hz = array.band_hz.1.min(PASSED * rate);
        let high = (md::floor(highest_hz / bin_hz) as usize + 1).min(BINS);
        if high < low + 4 {
            return Err(PlanError::Band);
        }
        // Half a wavelength across the longest pair: above it a diffuse field is nearly incoherent. A band that
        // lies mostly below keeps all its bins; the diffuse mean is subtracted in any case.
        let knee = md::ceil(0.5 / f64::from(longest) / bin_hz) as usize;
        let in_phase_hz = MOST_OUT_OF_PHASE * config.sound_speed_m_s / (md::TAU * array.position_sd_m);
        let told = md::ceil(in_phase_hz.min(rate) / bin_hz) as usize;
        let (passed, high) = (high, high.min(told.max(LEAST_KNEES * knee).max(low + LEAST_BINS)));
        let incoherent = if knee.saturating_sub(low) * 4 < high - low { knee.max(low) } else { low };

        let bin_rad_s = (md::TAU * bin_hz) as f32;
        let (mut sum2, mut sum4) = (0.0f32, 0.0f32);
        for w in (0..FRAME).map(window) {
            sum2 += w * w;
            sum4 += w * w * w * w;
        }
        // Circular correlations of windowed white noise vary FRAME·Σw⁴/(Σw²)² times more than of FRAME
        // independent samples; the overlap of frames adds their tapers' share.
        let mut overlap = 0.0f32;
        for (a, b) in (HOP..FRAME).map(|n| (window(n - HOP), window(n))) {
            overlap += a * b;
        }
        overlap /= sum2;
        let snapshots_per_frame = sum2 * sum2 / (FRAME as f32 * sum4) / (1.0 + 2.0 * overlap * overlap);

        let shape = detect::shape(&geometry, incoherent, high, bin_rad_s);
        let tests_per_hour = 3600.0 / array.step_s;
        let allowed = array.false_alarms_per_hour / tests_per_hour;
        let threshold = detect::threshold((1.0 - OCTAVE_SHARE) * allowed, shape.area_in_cells);
        let whole = Band {
            low,
            high,
            incoherent,
            threshold: threshold as f32,
            resolution: shape.resolution as f32,
            used: Used::ALL,
        };
        let mut octaves = [None; OCTAVES];
        for (n, octave) in octaves.iter_mut().enumerate() {
            let from = FIRST_OCTAVE_HZ * (1u32 << n) as f64 / bin_hz;
            let low = (md::ceil(from) as usize).max(knee).max(low);
            let high = (md::ceil(2.0 * from) as usize).min(high);
            if high < low + LEAST_BINS {
                continue;
            }
            // The response's cells shrink with the square of the frequency.
            let finer = mean_square(low, high) / mean_square(incoherent, whole.high);
            // One octave a step: together they make as many tests as the whole band.
            let threshold = detect::threshold(OCTAVE_SHARE * allowed, finer * shape.area_in_cells);
            let resolution = (shape.resolution / md::sqrt(finer)) as f32;
            *octave = Some(Band {
                low,
                high,
                incoherent: low,
                threshold: threshold as f32,
                resolution,
                used: Used::ALL,
            });
        }

        // Four times, because separation gives twice a channel's spectrum.
        let window_power = 4.0 * sum2 * FRAME as f32;
        let full_scale = config.full_scale as f32;
        let scale = Scale {
            // One-sided.
            unit: 2.0 * FRAME as f32 / (window_power * rate as f32 * full_scale * full_scale),
            bin_hz: bin_hz as f32,
            low: 1,
            high: passed as u16,
        };
        let plan = Self {
            intake: intake::Plan::new(rate, intake::ALL, BRIDGE),
            inv_c: 1.0 / geometry.sound_speed_m_s,
            curvature: (1.0 / array.reference_range_m) as f32,
            rate_hz: rate as f32,
            offset_leak: offset_leak(),
            shared: shared(),
            snapshots_per_frame,
            window_power,
            whole,
            octaves,
            bin_rad_s,
            step_samples,
            steps_per_segment: steps as u8,
            nominal_frames: (array.segment_s * rate / HOP as f64) as f32,
            channels: array.channels,
            clip_code: config.full_scale.saturating_sub(1),
            full_scale,
            elevation: (
                md::sin(array.elevation_deg.0 * crate::angle::RAD_PER_DEG) as f32,
                md::sin(array.elevation_deg.1 * crate::angle::RAD_PER_DEG) as f32,
            ),
            crossing_s,
            depth_m: config.depth_m as f32,
            vessel_over_array_depth: if config.depth_m > array.vessel_depth_m {
                (array.vessel_depth_m / config.depth_m) as f32
            } else {
                0.0
            },
            in_phase: in_phase(
                array.position_sd_m / config.sound_speed_m_s * f64::from(bin_rad_s),
                incoherent,
                high,
            ),
            position_sd_s: (array.position_sd_m / config.sound_speed_m_s) as f32,
            sound_speed_sd: (array.sound_speed_sd_m_s / config.sound_speed_m_s).max(LEAST_SPEED_SD) as f32,
            scale,
            slow: slow_levels::Plan::new(config, scale),
            passed,
            envelope_low: passed,
            shaft: None,
            geometry,
        };
        // A band that ends below four times the usual corner gives its upper three quarters.
        let corner = SHAFT.high_pass_hz.min(0.25 * (passed - 1) as f64 * bin_hz);
        Ok(plan.clone().with_shaft(&demon::Settings { high_pass_hz: corner, ..SHAFT }).unwrap_or(plan))
    }

    /// The same plan with other settings of the shaft rate.
    ///
    /// # Errors
    /// Names the setting that cannot work here; the corner must leave some of the plan's band.
    pub fn with_shaft(mut self, settings: &demon::Settings) -> Result<Self, demon::SettingError> {
        let config = demon::Config::new(settings, f64::from(self.rate_hz), EACH_HOP)?;
        let low = md::ceil(settings.high_pass_hz * FRAME as f64 / f64::from(self.rate_hz)) as usize;
        if low + LEAST_BINS > self.passed {
            return Err(demon::SettingError("high_pass_hz"));
        }
        self.envelope_low = low.max(self.whole.low);
        self.shaft = Some(config);
        Ok(self)
    }

    /// What the shaft rate is made with; `None` where the sampling rate is too low for it.
    pub fn shaft(&self) -> Option<&demon::Config> {
        self.shaft.as_ref()
    }

    /// Curvature of the wavefront from a direction and its standard deviation, 1/m: of what is where the direction meets the surface, as vessels are; under
    /// none, or from below, of the reference range.
    pub(crate) fn curvature_from(&self, direction: &Direction) -> (f32, f32) {
        let up = direction[2];
        if self.vessel_over_array_depth > 0.0 && up > 0.0 {
            let rise = RISE_SD + self.vessel_over_array_depth * up * up * up;
            (up / self.depth_m, rise / self.depth_m)
        } else {
            (self.curvature, UNKNOWN_CURVATURE * self.curvature)
        }
    }

    /// Bit h: hydrophone h is on one of these recorder channels (bit c: channel c).
    pub(crate) fn hydrophones(&self, channels: u8) -> u8 {
        let on = |c: &u8| channels >> (c & 7) & 1;
        self.channels.iter().rev().fold(0, |bits, c| bits << 1 | on(c))
    }

    /// The recorder channels (bit c: channel c) of these hydrophones (bit h: hydrophone h).
    pub(crate) fn recorder_channels(&self, hydrophones: u8) -> u8 {
        let on = |(h, c): (usize, &u8)| (hydrophones >> h & 1) << (c & 7);
        self.channels.iter().enumerate().map(on).fold(0, |bits, bit| bits | bit)
    }

    /// The array in the true frame.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Samples a second.
    pub fn rate_hz(&self) -> f32 {
        self.rate_hz
    }

    /// The standardised detection statistic that noise alone exceeds at the configured rate.
    pub fn threshold(&self) -> f32 {
        self.whole.threshold
    }

    /// The angle (radians) over which the response to a broadband source falls off: one radian of phase at the
    /// band's root-mean-square frequency.
    pub fn resolution_rad(&self) -> f32 {
        self.whole.resolution
    }

    /// Lowest and highest frequency used, Hz.
    pub fn band_hz(&self) -> (f32, f32) {
        let bin = self.rate_hz / FRAME as f32;
        (self.whole.low as f32 * bin, (self.whole.high - 1) as f32 * bin)
    }
}

/// Mean over bins of what is left of a sum whose terms are out of phase by two deviations of √⅔ `sd_rad` a bin ([`MOST_OUT_OF_PHASE`]).
#[inline(never)]
fn in_phase(sd_rad: f64, low: usize, high: usize) -> f32 {
    let left = |k: usize| md::exp(-4.0 / 3.0 * sd_rad * sd_rad * (k * k) as f64);
    ((low..high).map(left).sum::<f64>() / high.saturating_sub(low).max(1) as f64) as f32
}

/// Transform of the window at bins 1 to 3 over that at bin 0; real, because the periodic window is even about FRAME/2.
fn offset_leak() -> [f32; 3] {
    let total: f32 = (0..FRAME).map(window).sum();
    let mut leak = [0.0f32; 3];
    for (k, leak) in (1..).zip(&mut leak) {
        let mut sum = 0.0;
        for (n, w) in (0..FRAME).map(window).enumerate() {
            sum += w * m::cos(m::TAU * (k as f32) * (n as f32) / FRAME as f32);
        }
        *leak = sum / total;
    }
    leak
}

/// Autocorrelation of the window over its power, at multiples of [`SHARE_STRIDE`] samples.
fn shared() -> [f32; SHARES] {
    let power: f32 = (0..FRAME).map(window).map(|w| w * w).sum();
    let mut shared = [0.0f32; SHARES];
    for (n, share) in shared.iter_mut().enumerate() {
        let products = (n * SHARE_STRIDE..FRAME).map(|k| window(k - n * SHARE_STRIDE) * window(k));
        *share = products.sum::<f32>() / power;
    }
    shared
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::planned;

    #[test]
    fn the_band_ends_where_converters_let_sound_fade() {
        for (rate_hz, ends_hz) in [(16_000.0, 7_000.0), (32_000.0, 14_000.0), (64_000.0, 25_000.0)] {
            let plan = planned(rate_hz, |array| array.band_hz.1 = (rate_hz / 2.0).min(25_000.0));
            let bin_hz = rate_hz as f32 / super::FRAME as f32;
            let high_hz = plan.band_hz().1;
            assert!((high_hz - ends_hz).abs() <= bin_hz, "{rate_hz}: {high_hz}");
        }
    }

    #[test]
    fn the_band_ends_where_positions_told_uncertain_put_the_pairs_out_of_phase() {
        // A radian between pairs: 1500 m/s · 1.2247 / (2π · 3 cm) = 9.75 kHz; what is known to 1 cm stays in phase to 29 kHz.
        for (sd_m, ends_hz) in [(0.0, 25_000.0), (0.01, 25_000.0), (0.03, 9_750.0)] {
            let plan = planned(64_000.0, |array| (array.band_hz.1, array.position_sd_m) = (25_000.0, sd_m));
            let high_hz = plan.band_hz().1;
            assert!((high_hz - ends_hz).abs() <= 125.0, "{sd_m}: {high_hz}");
            // Levels, fringes and the shaft rate go on to the end.
            let whole = planned(64_000.0, |array| array.band_hz.1 = 25_000.0);
            assert_eq!((plan.passed, plan.scale.high), (whole.whole.high, whole.scale.high));
        }
        // Some band is left whatever is told.
        for (rate_hz, sd_m) in [(64_000.0, 1.0), (8_000.0, 0.3)] {
            let plan = planned(rate_hz, |array| array.position_sd_m = sd_m);
            assert!(plan.band_hz().1 > 2.0 * plan.band_hz().0, "{:?}", plan.band_hz());
        }
    }
}
