//! Whether the instrument itself is heard: it shakes where a current pulls at it, or strums its cable.
//!
//! Enters: the moments of each minute, and whether anything was heard in it. Leaves: whether what moves is the instrument.
//!
//! Sound moves the sea floor no more than its pressure does: beside a vessel the horizontal motion over pressure becomes that of sound, which is no
//! more than that of noise from all around, or little. An instrument that shakes moves, and has little pressure. What is heard of it is no vessel's: its
//! vertical motion has any sign, and its axis is no direction, though pressure be coherent with it.
//! The ratio of the sea is the lower quartile over minutes in which nothing is heard, nor is any motion coherent with
//! pressure, followed in steps so small that a tide does not move it by much; in a year sensors may grow noisier.
//!
//! Beside a hydrophone whose own noise is louder than the sea vessels are louder in motion as well. Their axis moves as they pass, which that of a current does
//! not: where it has moved in many of the minutes that would be shaking none is.
//! An instrument that shakes from the first minute on is not known for one before it has been still. Cost: 60 instructions a minute.

use super::moments::Moments;
use crate::math;

/// Horizontal power over that of pressure, above that of the sea, from which on the instrument shakes, dB: in the sea of a simulated week without vessels or currents a
/// minute's is within 0.5 dB.
const SHAKES_DB: f32 = 0.6;

/// Steps of the quartile, dB: upwards that after the first minute, which becomes smaller as minutes grow in number, and the least; downwards so many times as
/// much. Six hours of a current move it by 0.4 dB, in the first day by up to 0.7 dB.
const FIRST_DB: f32 = 0.5;
const STEP_DB: f32 = 0.001;
const DOWN: f32 = 3.0;

/// Minutes before which nothing is known.
const FEW: u16 = 30;

/// Minutes of what is heard as a vessel and would be shaking, one in so many of which the axis has moved where they are vessels'; the least of them that say so, and those
/// from which on the older half is forgotten.
const MOVES: u16 = 4;
const LEAST: u16 = 40;
const MOST: u16 = 400;

/// State.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shaking {
    /// Lower quartile of the ratio, dB, and the minutes it is of.
    usual_db: f32,
    minutes: u16,
    /// Minutes as of vessels that were louder in motion, and of these those whose axis had moved.
    louder: u16,
    moved: u16,
}

impl Shaking {
    /// Nothing known; all zeros.
    pub(super) const NONE: Self = Self { usual_db: 0.0, minutes: 0, louder: 0, moved: 0 };

    /// Takes a minute, whether nothing was heard in it and pressure has hardly anything of its horizontal motion, and of one of something like a vessel whether the axis has
    /// moved; whether the instrument shakes in it.
    pub(super) fn minute(&mut self, m: &Moments, is_still: bool, vessel: Option<bool>) -> bool {
        let [pressure, north, east, _] = m.power;
        let both = north + east;
        if !(pressure > 0.0 && both > 0.0) {
            return false;
        }
        let over_db = 10.0 * math::f32::log10(both / pressure) - self.usual_db;
        let known = self.minutes >= FEW;
        if is_still {
            // The first is taken as it is.
            let step_db = match self.minutes {
                0 => f32::INFINITY,
                minutes => (FIRST_DB / f32::from(minutes)).max(STEP_DB),
            };
            // `clamp` would check its limits, and write them out where they are wrong.
            self.usual_db += over_db.max(-DOWN * step_db).min(step_db);
            self.minutes = self.minutes.saturating_add(1);
        }
        let louder = known && over_db > SHAKES_DB;
        if let Some(moved) = vessel.filter(|_| louder) {
            self.louder += 1;
            self.moved += u16::from(moved);
            if self.louder >= MOST {
                (self.louder, self.moved) = (self.louder / 2, self.moved / 2);
            }
        }
        let are_vessels = self.louder >= LEAST && MOVES * self.moved >= self.louder;
        louder && !are_vessels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A minute of powers of pressure, north and east.
    fn minute(pressure: f32, north: f32, east: f32) -> Moments {
        Moments { power: [pressure, north, east, 1.0], instants: 3000, ..Moments::NONE }
    }

    #[test]
    fn a_vessel_does_not_shake_the_instrument_and_strumming_does() {
        let mut shaking = Shaking::NONE;
        for _ in 0..60 {
            assert!(!shaking.minute(&minute(1.0, 1.0, 1.0), true, None));
        }
        // Vessels of any strength, along a component and between; sound from above alone.
        for power in [1.0, 10.0, 1e4] {
            assert!(!shaking.minute(&minute(1.0 + power, 1.0 + power, 1.0), false, Some(false)));
            assert!(!shaking.minute(
                &minute(1.0 + power, 1.0 + 0.5 * power, 1.0 + 0.5 * power),
                false,
                Some(false)
            ));
            assert!(!shaking.minute(&minute(1.0 + power, 1.0, 1.0), false, Some(false)));
        }
        // Strumming with a tenth of it in pressure, and with a hundredth.
        assert!(shaking.minute(&minute(1.24, 3.4, 1.0), false, Some(false)));
        assert!(shaking.minute(&minute(1.02, 3.0, 1.0), true, None));
    }

    #[test]
    fn beside_a_noisy_hydrophone_what_moves_is_a_vessel() {
        let mut shaking = Shaking::NONE;
        (0..60).for_each(|_| assert!(!shaking.minute(&minute(10.0, 1.0, 1.0), true, None)));
        // Two thirds of its way a vessel's axis has moved.
        let told = |n: usize, moves: bool| Some(moves && n % 90 > 30);
        let mut strumming = shaking;
        let strums = (0..300).filter(|n| strumming.minute(&minute(14.0, 5.0, 1.0), false, told(*n, false)));
        assert_eq!(strums.count(), 300);
        let vessels =
            (0..300).filter(|n| shaking.minute(&minute(14.0, 5.0, 1.0), false, told(*n, true))).count();
        assert!(vessels < 60, "{vessels}");
    }

    #[test]
    fn a_tide_does_not_become_the_sea() {
        let mut shaking = Shaking::NONE;
        // Ten days of currents, six hours with and six without.
        for n in 0..14_400 {
            let shakes = n % 720 >= 350;
            let power = if shakes { 2.5 } else { 1.0 };
            assert_eq!(shaking.minute(&minute(1.0, power, 1.0), true, None), shakes, "{n}");
        }
        // A component that is noisier for good.
        let told = (0..5000).filter(|_| shaking.minute(&minute(1.0, 4.0, 1.0), true, None)).count();
        assert!((1440..4320).contains(&told), "{told}");
    }

    #[test]
    fn a_first_minute_that_is_not_the_seas_is_forgotten() {
        let mut shaking = Shaking::NONE;
        for _ in 0..20 {
            shaking.minute(&minute(1.0, 0.8, 0.8), true, None);
        }
        let shakes = (0..600).filter(|_| shaking.minute(&minute(1.0, 1.0, 1.0), true, None)).count();
        assert!(shakes < 100, "{shakes}");
        assert!(shaking.minute(&minute(1.0, 2.0, 1.0), true, None));
    }

    #[test]
    fn what_is_there_from_the_start_is_not_known() {
        let mut shaking = Shaking::NONE;
        assert!((0..600).all(|_| !shaking.minute(&minute(1.24, 3.4, 1.0), false, Some(false))));
        assert!(!shaking.minute(&Moments::NONE, true, None));
    }
}
