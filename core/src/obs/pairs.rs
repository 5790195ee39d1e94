//! Whether the propagation table fits: two pairs of paths must put a vessel at one range.
//!
//! Enters: the envelopes of a minute's cepstra, and where a track expects its vessel. Leaves: by how much farther the pair 35
//! puts vessels than the pair 13, m, over an hour of minutes in which both show. A table for water of another depth errs unlike
//! for each: 100 m too deep, pair 13 says 1030 m too much at 20 km and pair 35 1510 m. Of each pair the power of the envelope is
//! read along the ranges about the expected one; how the two are correlated, one shifted against the other, is summed over
//! minutes. An error of the track shifts both alike. Minutes in which two vessels are tracked do not count; assumes that
//! the echoes of none that is not tracked move along for an hour.
//! Cost: 20 k instructions a frame of such a minute.

use super::interference::Interference;
use super::limits::RANGE_STEP_M;
use super::presence::Expected;
use super::shared::Envelope;
use crate::math;

/// Ranges at which both pairs show, m over the water of RR03.
const SHOWN_M: core::ops::Range<f32> = 11_000.0..22_000.0;

/// Ranges read: 2.1 km to either side of the expected one.
const HALF: usize = 30;
const READ: usize = 2 * HALF + 1;

/// Shifts tried: 1.4 km to either side.
const MOST: usize = 20;
const SHIFTS: usize = 2 * MOST + 1;

/// Minutes before anything is said, and those from which on the older half counts no more.
const LEAST: u16 = 45;
const FORGOTTEN: u16 = 180;

/// Least mean correlation at the best shift, and by how much it must be beyond that of no shift, over the root of the minutes, where the two are apart: of
/// tables 100 m off it is 0.8 to 1.7, of right ones whose vessels are 7 and 10 dB down 0.45 at most.
const CORRELATED: f32 = 0.15;
const BEYOND: f32 = 0.7;
/// Shifts that are none, and as many at the ends of those tried, where noise alone may be highest.
const NEXT: usize = 2;

/// Power along the ranges about the expected one of the pairs 13 and 35, of the minute that goes on.
#[derive(Clone, Debug)]
pub(super) struct Profiles {
    power: [[f32; READ]; 2],
    frames: u16,
}

impl Profiles {
    /// All zeros.
    pub(super) const fn new() -> Self {
        Self { power: [[0.0; READ]; 2], frames: 0 }
    }

    /// A minute begins.
    pub(super) fn clear(&mut self) {
        self.power = [[0.0; READ]; 2];
        self.frames = 0;
    }

    /// Adds a frame, `offset_s` after the minute, of a vessel that a track expects.
    pub(super) fn add(
        &mut self,
        model: &Interference<'_>,
        envelope: &Envelope,
        expected: &Expected,
        offset_s: f32,
    ) {
        if !SHOWN_M.contains(&(expected.range_m / model.depth_ratio())) {
            return;
        }
        let first_m = expected.range_m + expected.speed_m_s * offset_s - HALF as f32 * RANGE_STEP_M;
        let first = math::f32::round(first_m / RANGE_STEP_M) as usize;
        for (branch, power) in self.power.iter_mut().enumerate() {
            model.powers(envelope, branch, first, power);
        }
        self.frames += 1;
    }
}

/// Sums over minutes.
#[derive(Clone, Debug)]
pub(super) struct Pairs {
    correlation: [f32; SHIFTS],
    minutes: u16,
}

impl Pairs {
    /// Nothing seen; all zeros.
    pub(super) const fn new() -> Self {
        Self { correlation: [0.0; SHIFTS], minutes: 0 }
    }

    /// Takes a minute's profiles; by how much farther the pair 35 puts vessels, m, where that is known.
    pub(super) fn take(&mut self, profiles: &mut Profiles) -> Option<f32> {
        if profiles.frames == 0 {
            return None;
        }
        let [near, far] = &mut profiles.power;
        standardised(near)?;
        standardised(far)?;
        for (k, sum) in self.correlation.iter_mut().enumerate() {
            // The far pair is read k − MOST ranges farther.
            let (skip_near, skip_far) = (MOST.saturating_sub(k), k.saturating_sub(MOST));
            let both = near.iter().skip(skip_near).zip(far.iter().skip(skip_far));
            let n = READ - k.abs_diff(MOST);
            *sum += both.map(|(a, b)| a * b).sum::<f32>() / n as f32;
        }
        self.minutes += 1;
        if self.minutes >= FORGOTTEN {
            self.minutes /= 2;
            self.correlation.iter_mut().for_each(|c| *c *= 0.5);
        }
        self.apart_m()
    }

    fn apart_m(&self) -> Option<f32> {
        let at = |k: usize| self.correlation.get(k).copied().unwrap_or(f32::NEG_INFINITY);
        let best = (1..SHIFTS - 1).fold(MOST, |best, k| if at(k) > at(best) { k } else { best });
        let (before, top, after) = (at(best - 1), at(best), at(best + 1));
        if self.minutes < LEAST || top < CORRELATED * f32::from(self.minutes) {
            return None;
        }
        let shifted = best.abs_diff(MOST);
        let sure = top - at(MOST) >= BEYOND * math::f32::sqrt(f32::from(self.minutes));
        if shifted >= MOST - NEXT || shifted > NEXT && !sure {
            return None;
        }
        let bend = before - 2.0 * top + after;
        let part = if bend < 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
        Some((best as f32 - MOST as f32 + part) * RANGE_STEP_M)
    }
}

/// Makes a profile's mean 0 and its variance 1; none of a flat one.
fn standardised(profile: &mut [f32; READ]) -> Option<()> {
    let n = READ as f32;
    let mean = profile.iter().sum::<f32>() / n;
    profile.iter_mut().for_each(|x| *x -= mean);
    let variance = profile.iter().map(|x| x * x).sum::<f32>() / n;
    let scale = 1.0 / math::f32::sqrt(variance);
    profile.iter_mut().for_each(|x| *x *= scale);
    scale.is_finite().then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Minutes of a vessel that the pair 35 puts `shift` ranges farther than the pair 13, in noise.
    fn apart_m(shift: usize, strength: f32) -> Option<f32> {
        let (mut pairs, mut profiles, mut seed) = (Pairs::new(), Profiles::new(), 7u32);
        let mut last = None;
        for minute in 0..120 {
            profiles.clear();
            for (branch, power) in profiles.power.iter_mut().enumerate() {
                for (k, x) in power.iter_mut().enumerate() {
                    seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    let z = (k as f32 - (20 + minute % 9 + branch * shift) as f32) / 5.0;
                    *x = strength * math::f32::exp(-z * z) + (seed >> 8) as f32 / 16_777_216.0;
                }
            }
            profiles.frames = 6;
            last = pairs.take(&mut profiles);
        }
        last
    }

    #[test]
    fn the_difference_of_two_pairs_is_found_and_noise_has_none() {
        for shift in [0, 7, 13] {
            let found = apart_m(shift, 2.0).unwrap();
            assert!((found - shift as f32 * RANGE_STEP_M).abs() < 40.0, "{shift}: {found}");
        }
        assert_eq!(apart_m(7, 0.0), None);
    }
}
