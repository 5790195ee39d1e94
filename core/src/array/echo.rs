//! The strongest vessel's echo off the bottom, and what it does to the azimuth.
//!
//! Enters: the correlations that are left once the strongest source is taken out. Leaves: by how much the echo turns that source's azimuth. What comes from
//! below the horizon in the vessel's own direction is no vessel. Pairs that stand upright hear the two apart; level ones hear them
//! together, at the mean of their delays, each by its power. No pair is quite level where an array is not quite regular: of hydrophones that lie
//! in a slanting plane the mean's direction is turned aside, by what the echo is below the vessel, times its share, times the slant (2 cm in 1.6 m:
//! 0.04°), and all pairs agree.
//!
//! Cost: 2000 instructions a segment, and 18 000 at each search for another source.

use super::estimate::{Context, Found};
use super::patterns::Pairs;
use super::search::SearchWork;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::math::f32 as m;

/// So many resolution cells from the vessel's azimuth, an echo's may lie.
const SAME_CELLS: f32 = 2.0;
/// How far below the horizon it comes from: as far as the vessel is above it where the bottom is close below the array, at most so many times as far and
/// this angle more, radians; in steps.
const STEEPER: f32 = 2.5;
const STEEPER_RAD: f32 = 0.05;
const STEPS: usize = 32;
/// Pairs beside the loudest that must hear it apart from the vessel, by how many samples, and standard deviations of noise.
const LEAST_PAIRS: f32 = 2.0;
const LEAST_SAMPLES: f32 = 1.5;
const SURE: f32 = 2.5;
/// So many times what the pairs hear as far from the vessel's delays on their other side. The image's fringes are not quite the same to two hydrophones: what is left of them
/// is as late as the image and as early. Of echoes 1 in 20 have less, of what else seems to be one 7 in 10.
const ONE_SIDED: f32 = 3.0;
/// Looks over which it is averaged, and how much fainter it is taken to be for each that does not find it.
const AVERAGED: f32 = 4.0;
const FADES: f32 = 0.7;
/// Least share that is heard.
const LEAST: f32 = 0.02;
/// Delays as far apart as this are heard apart, samples: a law that fits irregular arrays over bottoms 2 to 30 m below.
const APART_SAMPLES: f32 = 1.0;

/// An echo. All zeros where there is none, as the recorder's memory begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct Echo {
    /// Sine of its elevation, below 0.
    sine: f32,
    /// Its power in units of the vessel's and its own.
    share: f32,
    looks: f32,
    /// Whether the last look was without the vessel's image.
    bare: bool,
}

impl Echo {
    /// Nothing.
    pub(super) const NONE: Self = Self { sine: 0.0, share: 0.0, looks: 0.0, bare: false };

    /// Looks for the first source's in the correlations that are left once it is taken out, and its image where that is heard apart (`bare`).
    #[inline(never)]
    pub(super) fn look(&mut self, context: &Context<'_>, first: &Found, left: &SearchWork, bare: bool) {
        // What was heard beside both may have been what they leave.
        if bare && !self.bare {
            *self = Self::NONE;
        }
        self.bare = bare;
        let vessel = &first.refined.direction;
        let elevation = m::asin(vessel[2].clamp(0.0, 1.0));
        let steepest = STEEPER * elevation + STEEPER_RAD;
        let least = SURE * context.deviation(context.bins()) / context.bins();
        let (mut most, mut sine) = (0.0, 0.0);
        for step in 0..=STEPS {
            let below = elevation + (steepest - elevation) * step as f32 / STEPS as f32;
            let at = Self { sine: -m::sin_cos(below).0, ..*self };
            let tau = context.delays(&at.direction(vessel), 0.0);
            let (coherence, heard) = coherence(context, left, &first.tau, &tau);
            let is_most = heard >= LEAST_PAIRS && coherence * m::sqrt(heard) > least && coherence > most;
            if is_most && coherence > ONE_SIDED * mirrored(context, left, &first.tau, &tau) {
                (most, sine) = (coherence, at.sine);
            }
        }
        if most > 0.0 {
            self.looks = (self.looks + 1.0).min(AVERAGED);
            let part = 1.0 / self.looks;
            self.sine += part * (sine - self.sine);
            self.share += part * (most / (most + first.mean) - self.share);
        } else {
            self.share *= FADES;
        }
    }

    /// Whether a source found beside the first one is its echo.
    pub(super) fn is(context: &Context<'_>, first: &Found, other: &Found) -> bool {
        let (vessel, direction) = (&first.refined.direction, &other.refined.direction);
        let across = wavefront::dot(direction, &wavefront::tangents(vessel).0);
        direction[2] < 0.0
            && vessel[2] > 0.0
            && m::abs(across) < SAME_CELLS * context.plan.whole.resolution
            && wavefront::dot(direction, vessel) > 0.0
    }

    /// Whether there is one.
    pub(super) fn heard(&self) -> bool {
        self.share > LEAST
    }

    /// Its amplitude in units of both together: what a pair may show where one hears the echo and one the vessel.
    pub(super) fn amplitude(&self) -> f32 {
        m::sqrt(self.share)
    }

    /// By how much the direction found is turned across by it, radians, for the changes of the pairs' delays along the tangents (s/rad) and the inverse of
    /// their products.
    #[inline(never)]
    pub(super) fn turns(
        &self,
        context: &Context<'_>,
        found: &Found,
        (across, up): (&Pairs, &Pairs),
        inverse: (f32, f32, f32),
    ) -> f32 {
        let echo = context.delays(&self.direction(&found.refined.direction), 0.0);
        let (mut b1, mut b2) = (0.0, 0.0);
        for ((echo, own), (a, b)) in echo.iter().zip(&found.tau).zip(across.iter().zip(up)) {
            let apart = echo - own;
            let samples = apart * context.plan.rate_hz / APART_SAMPLES;
            let square = samples * samples;
            let pulled = self.share * apart / (1.0 + square * square);
            (b1, b2) = (b1 + a * pulled, b2 + b * pulled);
        }
        inverse.0 * b1 + inverse.1 * b2
    }

    /// Where it is expected of a vessel in this direction.
    fn direction(&self, vessel: &Direction) -> Direction {
        let [east, north, up] = *vessel;
        let level = m::sqrt((1.0 - self.sine * self.sine) / (1.0 - up * up).max(1e-6));
        [east * level, north * level, self.sine]
    }
}

/// Mean coherence of what is left at these delays, over the pairs that hear it apart from the vessel's `own` delays but the loudest, and how many those are. What one pair
/// hears alone is no echo, as of a hydrophone that hears another through its channel.
#[inline(never)]
fn coherence(
    context: &Context<'_>,
    left: &SearchWork,
    own: &[f32; PAIR_COUNT],
    tau: &[f32; PAIR_COUNT],
) -> (f32, f32) {
    let (mut sum, mut highest, mut heard) = (0.0, 0.0f32, -1.0f32);
    for (p, (tau, own)) in tau.iter().zip(own).enumerate() {
        if m::abs(tau - own) * context.plan.rate_hz > LEAST_SAMPLES {
            let value = left.pair_value(context.plan, p, *tau);
            sum += value;
            highest = highest.max(value);
            heard += 1.0;
        }
    }
    ((sum - highest) / (heard * context.bins()), heard)
}

/// The same as far from the vessel's delays on their other side.
fn mirrored(
    context: &Context<'_>,
    left: &SearchWork,
    own: &[f32; PAIR_COUNT],
    tau: &[f32; PAIR_COUNT],
) -> f32 {
    let mut other = *own;
    for (other, tau) in other.iter_mut().zip(tau) {
        *other += *other - tau;
    }
    coherence(context, left, own, &other).0
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{error_from, hear, noisy, planned, source};
    use crate::config::ArrayConfig;
    use std::vec::Vec;

    /// Error of the azimuths and what is stated of it, root mean square, degrees, and how many, of a vessel and its echo as loud as `amplitude`.
    fn heard(change: impl FnOnce(&mut ArrayConfig), amplitude: f64) -> (f64, f64, usize) {
        const LATER: usize = 53;
        let plan = planned(16_000.0, change);
        let (vessel, echo) = ((1.3, 0.11), (1.3, -0.16));
        let mut sea = source(&plan, vessel, 4.0, None, 14, 3);
        let below = source(&plan, echo, 4.0 * amplitude, None, 14, 3);
        for (x, y) in sea.iter_mut().skip(LATER).flatten().zip(below.into_iter().flatten()) {
            *x += y;
        }
        let settled = |b: &crate::wire::Bearing| b.band == 0 && b.index > 6 * 16_000;
        let bearings: Vec<_> = hear(&plan, &noisy(sea, 9)).bearings.into_iter().filter(settled).collect();
        let rms = |f: &dyn Fn(&crate::wire::Bearing) -> f64| {
            (bearings.iter().map(f).sum::<f64>() / bearings.len() as f64).sqrt().to_degrees()
        };
        (rms(&|b| error_from(b, vessel).0.powi(2)), rms(&|b| f64::from(b.var_azimuth)), bearings.len())
    }

    fn slanted(array: &mut ArrayConfig) {
        if let Some([_, _, up]) = array.hydrophones_m.first_mut() {
            *up += 0.05;
        }
        if let Some([_, _, up]) = array.hydrophones_m.get_mut(1) {
            *up -= 0.05;
        }
        array.vessel_depth_m = 4.0;
    }

    #[test]
    fn what_an_image_leaves_is_no_echo_and_an_echo_beside_it_is_one() {
        const RATE_HZ: f64 = 64_000.0;
        let plan = planned(RATE_HZ, |array| array.vessel_depth_m = 4.0);
        // A vessel whose image comes from 1.2° higher, 54 samples later, and from 2.6° higher, 368 later: heard as one and apart.
        for (n, (at, up, late)) in [(0.26, 0.0207, 54), (0.5, 0.045, 368)].into_iter().enumerate() {
            for (m, amplitude) in [0.0, 0.4].into_iter().enumerate() {
                let sources = [(at - 0.5 * up, 1.0, 0), (at + 0.5 * up, -0.95, late), (-at, amplitude, 60)];
                let mut sea = std::vec![[0.0; 4]; 8 * RATE_HZ as usize];
                for (elevation, amplitude, late) in sources {
                    let heard = source(&plan, (1.3 + n as f64, elevation), 8.0 * amplitude, None, 8, 3);
                    for (x, y) in sea.iter_mut().skip(late).flatten().zip(heard.into_iter().flatten()) {
                        *x += y;
                    }
                }
                let heard = hear(&plan, &noisy(sea, 9));
                assert!(heard.bearings.len() > 12, "{n} {m}: {}", heard.bearings.len());
                assert_eq!(heard.echo, m == 1, "{n} {m}");
            }
        }
    }

    #[test]
    fn an_echo_turns_no_azimuth_aside_though_the_array_slants() {
        for amplitude in [0.0, 0.3, 0.5] {
            for (name, slant) in [("even", false), ("slanted", true)] {
                let (error, stated, of) =
                    heard(|array| if slant { slanted(array) } else { array.vessel_depth_m = 4.0 }, amplitude);
                std::println!("{name} {amplitude}: {error:.4} of {stated:.4} degrees, {of}");
                assert!(
                    of > 10 && error < 2.0 * stated && error < 0.01 && stated < 0.3,
                    "{name} {amplitude}: {error} of {stated}"
                );
            }
        }
    }
}
