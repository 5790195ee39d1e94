//! What the recursive filter assumes: speed prior, range limits, errors, medium, gate.
//!
//! In: the station's `[tracking]` and sound speed. Out: a [`Config`] in radians.

use super::model::{Medium, PARAMETERS};
use crate::config::{StationConfig, Tracking};

/// What the filter assumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Mean speed of vessels here, or the known speed, m/s.
    pub speed_m_s: f64,
    /// Its standard deviation, m/s; 0 means known.
    pub speed_sd_m_s: f64,
    /// Nearest and farthest closest-point range considered, m.
    pub range_m: (f64, f64),
    /// Standard deviation of the bearings' error beyond the reported one, radians.
    pub extra_sd_rad: f64,
    /// Its correlation time, s (first-order Gauss-Markov; 0: independent).
    pub extra_tau_s: f64,
    /// Travel time and height of the vessel above the array.
    pub medium: Medium,
    /// Standard deviation of a bias common to all elevations (multipath), radians.
    pub elevation_bias_sd_rad: f64,
    /// Innovations beyond this many standard deviations are refused (infinite: none).
    pub gate_sd: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self::new(&Tracking::default(), 1484.0)
    }
}

impl Config {
    /// From the station's tracking settings and sound speed.
    pub fn new(t: &Tracking, sound_speed_m_s: f64) -> Self {
        Self {
            speed_m_s: t.speed_m_s,
            speed_sd_m_s: t.speed_sd_m_s,
            range_m: t.range_m,
            extra_sd_rad: t.bearing_sd_deg * crate::angle::RAD_PER_DEG,
            extra_tau_s: t.bearing_tau_s,
            medium: Medium::of_sound_speed(sound_speed_m_s),
            elevation_bias_sd_rad: 0.0,
            gate_sd: 5.0,
        }
    }

    /// From a validated station configuration.
    pub fn of_station(station: &StationConfig) -> Self {
        Self::new(&station.tracking, station.sound_speed_m_s)
    }

    pub(crate) fn free(&self) -> [bool; PARAMETERS] {
        let elevations = self.medium.height_m > 0.0;
        [true, true, true, self.speed_sd_m_s > 0.0, elevations && self.elevation_bias_sd_rad > 0.0]
    }

    /// Coloured variance, correlation time, and variance to count as white.
    pub(crate) fn errors(&self) -> (f64, f64, f64) {
        let variance = self.extra_sd_rad * self.extra_sd_rad;
        if self.extra_tau_s > 0.0 { (variance, self.extra_tau_s, 0.0) } else { (0.0, 0.0, variance) }
    }
}
