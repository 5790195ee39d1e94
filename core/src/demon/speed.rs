//! Speed of a vessel from its shaft or blade rate, by a curve that the fleet's operator supplies.
//!
//! `speed = intercept + slope · rate`, with a standard deviation for the fleet's spread. The rate's own error is added.
//! Where the comb does not say whether it is the shaft or the blade rate, both readings are answered, each with its
//! speed, as far as the speed is plausible: the caller then has two hypotheses, not a guess.

use super::comb::{Rate, Reading};
use crate::math::f64 as m;
use serde::{Deserialize, Serialize};

/// Speeds a vessel can have, m/s: readings of a rate that mean others are left out.
pub const VESSEL_SPEEDS_M_S: (f64, f64) = (0.2, 30.0);

/// Speed against the shaft rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpeedCurve {
    /// Speed at rate zero, m/s (not physical; of the straight line).
    pub intercept_m_s: f64,
    /// Metres a second for each hertz of shaft rate, i.e. metres a turn.
    pub slope_m: f64,
    /// Standard deviation of speeds about the line, m/s.
    pub sd_m_s: f64,
    /// Blades of the fleet's propellers, where they are known to be alike.
    pub blades: Option<u8>,
    /// Slowest and fastest speed the curve holds for, m/s.
    pub valid_m_s: (f64, f64),
}

/// A speed by one reading of the rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speed {
    /// The shaft rate that this reading means, Hz.
    pub shaft_hz: f64,
    /// Speed, m/s.
    pub mean_m_s: f64,
    /// Its standard deviation, m/s.
    pub sd_m_s: f64,
}

impl SpeedCurve {
    /// The speeds a rate may mean: first the reading as shaft rate, then as blade rate; `None` where the reading is
    /// excluded by the comb, by an unknown number of blades, or by the curve's range. One `Some` is a measured speed;
    /// two are an ambiguity; none says that the curve does not cover this vessel.
    pub fn speeds(&self, rate: &Rate) -> [Option<Speed>; 2] {
        let shaft = self.at(rate, 1);
        let blade = match (rate.reading, self.blades) {
            (Reading::ShaftOrBlade, Some(blades)) => self.at(rate, blades),
            _ => None,
        };
        [shaft, blade]
    }

    fn at(&self, rate: &Rate, lines_a_turn: u8) -> Option<Speed> {
        let turns = f64::from(lines_a_turn.max(1));
        let shaft_hz = f64::from(rate.rate_hz) / turns;
        let mean_m_s = self.intercept_m_s + self.slope_m * shaft_hz;
        let from_rate = self.slope_m * f64::from(rate.sd_hz) / turns;
        let sd_m_s = m::sqrt(self.sd_m_s * self.sd_m_s + from_rate * from_rate);
        let valid = mean_m_s >= self.valid_m_s.0 && mean_m_s <= self.valid_m_s.1 && sd_m_s.is_finite();
        valid.then_some(Speed { shaft_hz, mean_m_s, sd_m_s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rate(rate_hz: f32, reading: Reading) -> Rate {
        Rate {
            rate_hz,
            sd_hz: 0.1,
            harmonics: 1,
            present: 1,
            ln_false_alarm: -30.0,
            confidence: 1.0,
            reading,
            alternatives: [None; 2],
        }
    }

    #[test]
    fn an_ambiguous_rate_gives_both_plausible_speeds_and_a_clear_one_gives_one() {
        let curve = SpeedCurve {
            intercept_m_s: 0.0,
            slope_m: 4.0,
            sd_m_s: 0.3,
            blades: Some(4),
            valid_m_s: (1.0, 15.0),
        };
        let [shaft, blade] = curve.speeds(&rate(3.0, Reading::ShaftOrBlade));
        assert!((shaft.unwrap().mean_m_s - 12.0).abs() < 1e-6);
        assert!((shaft.unwrap().sd_m_s - 0.5).abs() < 1e-6);
        assert!((blade.unwrap().mean_m_s - 3.0).abs() < 1e-6);
        let [shaft, blade] = curve.speeds(&rate(8.0, Reading::ShaftOrBlade));
        assert!(shaft.is_none() && (blade.unwrap().mean_m_s - 8.0).abs() < 1e-6);
        assert_eq!(curve.speeds(&rate(2.0, Reading::ShaftWithBlades(4)))[1], None);
    }
}
