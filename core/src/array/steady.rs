//! How much the strongest source's bearings scatter, against what noise is said to do.
//!
//! Enters: its directions, one segment after the other, each with the variances that its coherence gives. Leaves: a factor of either
//! variance, at most 1. Each angle has its own: where vessel and image stand apart, the elevation is noisier than the coherence of both
//! says and the azimuth quieter. The coherence is held to be at most that of 17 dB, and averaged over bins between which an image's
//! fringes rise and fall, so that a loud vessel's variance is up to three times what it is. A vessel's direction changes evenly,
//! noise does not: of three directions in a row the second difference is noise, and the vessel's own (`v²/r²` a second squared at
//! most, 0.03° at 12 m/s and 200 m) makes it larger, so that the factor is 1 where it counts. What lasts, errors of positions,
//! echoes, other vessels, the second difference does not show: those variances are not multiplied.
//!
//! Cost: about 200 instructions a segment.

use super::plan::Plan;
use super::wavefront::{self, Direction};

/// Segments over which the scatter is averaged, and how many count as scattering as much as is said before the first is seen.
const AVERAGED: f32 = 48.0;
const SAID: f32 = 16.0;
/// Longest time between two directions of one line, seconds.
const LONGEST_S: f32 = 1.5;
/// What noise of neighbouring segments, which share a half, has in common: a little less than the half, because each is whitened by itself.
const SHARED: f32 = 0.45;
/// Most that one second difference counts, and least factor: errors that last longer than a second are not seen.
const MOST: f32 = 6.0;
const LEAST: f32 = 0.3;

/// What the segments so far showed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Steady {
    last: Option<(Direction, u64)>,
    /// Turn rate to the last direction along both tangents (radians a second) and the time it took, seconds.
    rate: Option<([f32; 2], f32)>,
    /// By how much the mean square second difference over the expected one is less than 1: zeros at the beginning, so that the
    /// recorder's memory costs no flash.
    less: [f32; 2],
    /// Second differences in the mean.
    taken: f32,
}

impl Steady {
    /// Nothing seen.
    pub(super) const NEW: Self = Self { last: None, rate: None, less: [0.0; 2], taken: 0.0 };

    /// Takes the direction of sample `index` with its variances along the tangents (rad²); whether its segment shares samples with
    /// the one before. The factors of the variances.
    pub(super) fn take(
        &mut self,
        plan: &Plan,
        direction: &Direction,
        index: u64,
        variance: [f32; 2],
        shares: bool,
    ) -> [f32; 2] {
        let before = self.last.replace((*direction, index));
        let dt = before.map_or(f32::MAX, |(_, at)| index.saturating_sub(at) as f32 / plan.rate_hz);
        let (Some((last, _)), true) = (before, dt > 0.0 && dt < LONGEST_S) else {
            *self = Self { last: self.last, ..Self::NEW };
            return [1.0; 2];
        };
        let e = wavefront::tangents(&last);
        let rate = [&e.0, &e.1].map(|tangent| wavefront::dot(direction, tangent) / dt);
        if let Some((older, span)) = self.rate.replace((rate, dt)) {
            let q = dt / span;
            let shared = if shares { SHARED } else { 0.0 };
            let expected = 1.0 + (1.0 + q) * (1.0 + q) + q * q - 2.0 * shared * (1.0 + q) * (1.0 + q);
            self.taken = (self.taken + 1.0).min(AVERAGED);
            for (((less, new), old), variance) in self.less.iter_mut().zip(rate).zip(older).zip(variance) {
                let second = (new - old) * dt;
                let square = second * second / (variance * expected).max(f32::MIN_POSITIVE);
                *less += (1.0 - square.min(MOST) - *less) / (self.taken + SAID);
            }
        }
        self.less.map(|less| (1.0 - less).clamp(LEAST, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{Normal, plan};
    use super::*;
    use crate::angle::unit_vector;

    /// Last factors for a vessel whose azimuth turns at 0.01 rad/s (by `bend` more each second) in noise of `sd` where 0.001 is said; `jump`:
    /// one azimuth in eight is elsewhere.
    fn factors(sd: f64, bend: f64, jump: bool, seed: u64) -> [f32; 2] {
        let plan = plan(16_000.0);
        let mut random = Normal(seed);
        let mut steady = Steady::NEW;
        let (mut old, mut factors) = ([random.next(), random.next()], [1.0; 2]);
        for n in 0..160u64 {
            let t = 0.5 * n as f64;
            let new = [random.next(), random.next()];
            // As much in common as segments have: 0.861 · 0.508 = 0.44.
            let noise = [0, 1].map(|k| sd * (0.861 * new[k] + 0.508 * old[k]));
            old = new;
            let aside = if jump && n % 8 == 7 { 0.5 } else { 0.0 };
            let azimuth = 1.0 + 0.01 * t + 0.5 * bend * t * t + noise[0] / 0.3f64.cos() + aside;
            let direction = unit_vector(azimuth as f32, (0.3 + noise[1]) as f32);
            factors = steady.take(&plan, &direction, 8000 * n, [1e-6; 2], true);
        }
        factors
    }

    #[test]
    fn scatter_that_is_smaller_than_said_shrinks_the_variance_and_nothing_else_does() {
        let mean = |sd, bend, jump| {
            let all = (0..40).map(|n| factors(sd, bend, jump, 7 + n));
            let [across, up] = all.fold([0.0; 2], |sum, [a, b]| [sum[0] + a, sum[1] + b]);
            [across / 40.0, up / 40.0]
        };
        for of in 0..2 {
            let [said, half, none] = [0.001, 0.0007, 0.0001].map(|sd| mean(sd, 0.0, false)[of]);
            assert!((0.85..=1.0).contains(&said), "as said: {said}");
            assert!((0.42..=0.58).contains(&half), "half: {half}");
            assert!((none - LEAST).abs() < 1e-3, "{none}");
        }
        // What one angle does says nothing of the other.
        let [across, up] = mean(0.0001, 0.02, false);
        assert!(across == 1.0, "a vessel that turns evenly by more than noise does is no noise: {across}");
        assert!((up - LEAST).abs() < 1e-3, "{up}");
        let [across, _] = mean(0.0001, 0.0, true);
        assert!(across > 0.9, "two sources in turn: {across}");
    }
}
