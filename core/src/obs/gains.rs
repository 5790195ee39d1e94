//! Whether the horizontal components are of one gain: by their noise, and by the vessels that both have heard.
//!
//! Enters: moments of minutes with and without a vessel. Leaves: north over east in decibels, where both say so.
//!
//! - Noise. What of a horizontal component's power is not coherent with pressure is noise without a direction. The median of its
//!   ratio over minutes without a vessel is followed in small steps, larger ones where it is far off: an hour of a shaking
//!   instrument moves it by a third of a decibel. Noise of several directions at once makes 1.5 dB of difference; its minutes are
//!   told by their horizontal components, which go together, unless its axis is one of theirs.
//! - Vessels. A sensor or its place may be noisier than the other and as true. What of pressure is found in a component is that
//!   part of the sound along it, times its gain, and at some time of a passage nearly all: the greatest of either over 360 to 720
//!   minutes of vessels. In a month of real ways these are within 1 dB in the median and 3 dB in 95 % of all orientations.
//!
//! Assumes: vessels that were heard along both components. Cost: 60 instructions a minute.

use super::moments::Moments;
use crate::math;

/// Step of the medians, dB a minute; after so many minutes it becomes smaller as they grow in number, to that share of it, for
/// hours of an instrument that shakes less than is noticed must not move them.
const STEP_DB: f32 = 0.01;
const SETTLED: u16 = 400;
const LEAST_STEP: f32 = 0.3;

/// Distance from the median at which the step of the ratio is twice as large, dB; it grows with its square.
const FAR_DB: f32 = 3.0;

/// A minute is no measure of the gain where the horizontal motion is this much above its median against pressure, dB.
const SHAKING_DB: f32 = 1.0;

/// What is left of the horizontal components has a direction of its own where they go together by more than this, twice what
/// chance makes of a minute: noise of several directions at once.
const TOGETHER: f32 = 0.08;

/// Least squared coherence with pressure of one component in a minute whose vessel counts, and of one whose share of pressure is known.
const STRONG: f32 = 0.15;
const KNOWN: f32 = 0.0144;

/// Such minutes before vessels say anything of components that differ by [`FAR_APART_DB`] or more, and of others; and those after which the greatest before them are forgotten in turn.
const LEAST: u16 = 90;
const LEAST_NEAR: u16 = 300;
const TURN: u16 = 360;

/// Ratio from which on few minutes of vessels tell, at which horizontal components are unequal, and below which they are equal again, dB.
const FAR_APART_DB: f32 = 10.0;
const UNEQUAL_DB: f32 = 2.0;
const EQUAL_DB: f32 = 1.5;

/// Share of the noise's ratio that vessels must show of it, and below which they deny it; both less what vessels err by, dB.
const SHOWN: f32 = 0.75;
const DENIED: f32 = 0.5;
const ERROR_DB: f32 = 0.5;

/// State.
#[derive(Clone, Debug)]
pub(super) struct Gains {
    /// Medians of north over east, and of both over pressure, dB.
    ratio_db: f32,
    motion_db: Option<f32>,
    /// Minutes they are of.
    compared: u16,
    /// Greatest shares of pressure's power in north and east, of the turn before and of this one, and minutes of this one.
    greatest: [[f32; 2]; 2],
    minutes: u16,
    said: bool,
}

/// A ratio of powers in decibels.
fn decibels(ratio: f32) -> f32 {
    10.0 * math::f32::log10(ratio)
}

impl Gains {
    /// Nothing known; all zeros.
    pub(super) const fn new() -> Self {
        Self { ratio_db: 0.0, motion_db: None, compared: 0, greatest: [[0.0; 2]; 2], minutes: 0, said: false }
    }

    /// Takes a minute without a vessel.
    pub(super) fn noise(&mut self, m: &Moments) {
        let Some([north, east, together]) = m.own_of_horizontals() else { return };
        let [pressure, ..] = m.power;
        if math::f32::abs(together) > TOGETHER * math::f32::sqrt(north * east) {
            return;
        }
        let motion_db = decibels((north + east) / pressure);
        let usual_db = self.motion_db.get_or_insert(motion_db);
        self.compared = self.compared.saturating_add(1);
        let step_db = STEP_DB * (f32::from(SETTLED) / f32::from(self.compared)).clamp(LEAST_STEP, 1.0);
        *usual_db += step_db * (motion_db - *usual_db).signum();
        // A shaking instrument says nothing of its gain.
        if motion_db < *usual_db + SHAKING_DB {
            let off_db = decibels(north / east) - self.ratio_db;
            let far = off_db / FAR_DB;
            self.ratio_db += step_db * (1.0 + far * far) * off_db.signum();
        }
    }

    /// Takes a minute with a vessel.
    pub(super) fn vessel(&mut self, m: &Moments) {
        let ([pressure, north, east, _], [_, of_north, of_east, _]) = (m.power, m.with_pressure);
        let squared = [(north, of_north), (east, of_east)]
            .map(|(power, product)| product * product / (power * pressure).max(f32::MIN_POSITIVE));
        let [a, b] = squared;
        if a.max(b) < STRONG {
            return;
        }
        if self.minutes >= TURN {
            let [before, now] = &mut self.greatest;
            (*before, *now, self.minutes) = (*now, [0.0; 2], 0);
        }
        self.minutes += 1;
        let [_, now] = &mut self.greatest;
        for ((greatest, product), squared) in now.iter_mut().zip([of_north, of_east]).zip(squared) {
            if squared > KNOWN {
                let share = product / pressure;
                *greatest = greatest.max(share * share);
            }
        }
    }

    /// North over east by what both heard of vessels, dB.
    fn by_vessels_db(&self) -> Option<f32> {
        let [before, now] = self.greatest;
        let [[north, east], [north_now, east_now]] = [before, now];
        let (north, east) = (north.max(north_now), east.max(east_now));
        let least = if math::f32::abs(self.ratio_db) < FAR_APART_DB { LEAST_NEAR } else { LEAST };
        let enough = before != [0.0; 2] || self.minutes >= least;
        (enough && north > 0.0 && east > 0.0).then(|| decibels(north / east))
    }

    /// North over east, dB, where it is found that they are unequal; none where that is over.
    pub(super) fn news(&mut self) -> Option<Option<f32>> {
        let off_db = math::f32::abs(self.ratio_db);
        let seen_db = self.by_vessels_db()? * self.ratio_db.signum();
        let shown = |share: f32| seen_db >= share * off_db - ERROR_DB;
        if !self.said && off_db >= UNEQUAL_DB && shown(SHOWN) {
            self.said = true;
            return Some(Some(self.ratio_db));
        }
        if self.said && (off_db < EQUAL_DB || !shown(DENIED)) {
            self.said = false;
            return Some(None);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Noise of which north has so much.
    fn noise(north: f32) -> Moments {
        Moments {
            power: [1.0, north, 1.0, 1.0],
            with_pressure: [1.0, 0.0, 0.0, 0.0],
            instants: 3000,
            ..Moments::NONE
        }
    }

    /// Minutes of vessels from all around as heard with that gain of north, then so many without one; what is said of it, tenths of a decibel.
    fn said(gain: f32, minutes: usize, quiet: impl Fn(usize) -> Moments) -> Vec<Option<i32>> {
        let mut gains = Gains::new();
        let vessels = (0..310).map(|n| {
            let (s, c) = math::f32::sin_cos(n as f32 / 19.0);
            let amplitude = math::f32::sqrt(gain);
            let m = Moments {
                power: [1.0, gain * (c * c + 0.2), s * s + 0.2, 1.0],
                with_pressure: [1.0, amplitude * c, s, 0.0],
                instants: 3000,
                ..Moments::NONE
            };
            (true, m)
        });
        let quiet = (0..minutes).map(|n| (false, quiet(n)));
        vessels
            .chain(quiet)
            .filter_map(|(vessel, m)| {
                if vessel {
                    gains.vessel(&m)
                } else {
                    gains.noise(&m)
                }
                gains.news().map(|news| news.map(|db| math::f32::round(10.0 * db) as i32))
            })
            .collect()
    }

    #[test]
    fn unequal_components_are_named_and_a_shaking_instrument_is_not() {
        assert_eq!(said(2.0, 400, |_| noise(2.0)), [Some(20)]);
        assert_eq!(said(0.5, 400, |_| noise(0.5)), [Some(-20)]);
        assert_eq!(said(1.3, 400, |_| noise(1.3)), []);
        // Twenty decibels within minutes.
        assert!(said(100.0, 15, |_| noise(100.0)).first().is_some_and(|db| *db >= Some(20)));
        // Four hours of strumming along north, 10 dB above the noise.
        assert_eq!(said(10.0, 1440, |n| noise(if n % 720 > 480 { 10.0 } else { 1.0 })), []);
        // Noise from north that goes with pressure is no gain.
        let coherent = Moments { with_pressure: [1.0, 0.7, 0.0, 0.0], ..noise(1.49) };
        assert_eq!(said(1.5, 1000, |_| coherent), []);
        // Noise of two directions at once, whose difference points between north and east, or stronger.
        let two = Moments { north_east: 0.2, ..noise(2.0) };
        assert_eq!(said(2.0, 1000, |_| two), []);
        // As it would be without that.
        assert_eq!(said(1.7, 1000, |_| noise(1.7)), [Some(20)]);
    }

    #[test]
    fn a_component_that_is_noisier_but_hears_vessels_as_the_other_does_is_of_its_gain() {
        for north in [0.01, 0.25, 4.0, 100.0] {
            assert_eq!(said(1.0, 3000, |_| noise(north)), []);
        }
        // Nor is anything said before vessels were heard.
        let mut gains = Gains::new();
        assert!((0..3000).all(|_| {
            gains.noise(&noise(4.0));
            gains.news().is_none()
        }));
    }
}
