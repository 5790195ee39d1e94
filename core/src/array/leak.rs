//! Whether one hydrophone hears another through its channel.
//!
//! Enters: the pairs' correlations and the vessel found. Leaves: the hydrophone that receives, if one does. Beyond what the vessel gives, the pair of
//! sender and receiver correlates at no delay at all, and the receiver has the sender's delays with the two others. A vessel's echo off the bottom
//! and its image in the surface can do the same for a while; the rest of the hydrophones hear it then ([`super::sick`] waits until the vessel has moved as well).
//! Cost: some 10 000 instructions where something stands at no delay.

use super::estimate::Context;
use super::followed::Followed;
use super::plan::{BINS, Band, MAX_DELAY};
use super::search::SearchWork;
use super::sick::{LEAKING, Sign};
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::math::f32 as m;

/// Least correlation at no delay beyond the vessel's own, standard deviations of noise and share of full coherence, and the
/// share of it, times the vessel's coherence, that the receiver's other pairs must have at the sender's delays, and how many
/// deviations, in the mean of the two.
const LEAK: f32 = 8.0;
const LEAST_LEAK: f32 = 0.04;
const RECEIVED: f32 = 0.35;
const RECEIVED_SD: f32 = 2.0;
/// Nearer than this to no delay, in samples, a sound hides what leaks, and an echo or another source passes for it.
pub(super) const APART_SAMPLES: f32 = 3.0;

/// How far below the horizon a bottom's echo comes from, at most: so many times as far as the vessel is above it, and this
/// angle more, radians. At a bottom close below the array it is as far.
const ECHO_STEEPER: f32 = 1.5;
const ECHO_RAD: f32 = 0.05;
/// Steps from the one to the other, and share of what seems to leak that an echo has in the other pairs, or an image on the other side.
const ECHOES: usize = 32;
const ECHOED: f32 = 0.4;
/// Other pairs, of five, that must hear it apart from the vessel.
const LEAST_PAIRS: f32 = 3.0;
/// Delays, of six, at which the rest must hear it apart from the vessel.
const LEAST_ECHOES: f32 = 4.0;

/// What the correlations say beyond the vessel found at these delays, of this coherence.
pub(crate) struct Beyond<'a> {
    pub(crate) search: &'a SearchWork,
    pub(crate) tau: &'a [f32; PAIR_COUNT],
    /// Where it is.
    pub(crate) direction: &'a Direction,
    pub(crate) coherence: &'a [f32; BINS],
    /// Its mean.
    pub(crate) mean: f32,
    pub(crate) deviation: f32,
    /// The other sources, and the segment.
    pub(super) context: &'a Context<'a>,
    pub(super) others: (&'a Followed, u32),
}

impl Beyond<'_> {
    /// Whether one hydrophone hears another.
    pub(crate) fn sign(&self) -> Sign {
        (0..PAIR_COUNT).find_map(|p| self.receiver(p)).map_or(Sign::Well, |h| Sign::Sick(LEAKING, h))
    }

    /// The hydrophone of pair `p` that hears the other one, if there is one.
    fn receiver(&self, p: usize) -> Option<usize> {
        let (a, b) = *PAIRS.get(p)?;
        let Band { high, incoherent, .. } = self.context.plan.whole;
        let least = (LEAK * self.deviation).max(LEAST_LEAK * high.saturating_sub(incoherent) as f32);
        let hidden = m::abs(*self.tau.get(p)?) * self.context.plan.rate_hz < APART_SAMPLES;
        let leak = self.excess(p, 0.0)?;
        let (others, segment) = self.others;
        let another = || others.explain(self.context, segment, (p, 0.0), (APART_SAMPLES, true));
        if hidden || leak < least || another() || self.echoed(p, leak) {
            return None;
        }
        // What one receives from the other stands with the remaining two at the sender's delays. A second sound from straight
        // across the pair does not.
        let least = (RECEIVED * leak * self.mean).max(RECEIVED_SD * self.deviation);
        let received = |to: usize, from: usize| {
            let (mut sum, mut both, mut mirrored) = (0.0, 0.0, 0.0);
            let mut take = |q: usize, delay: f32, excess: f32| {
                if let Some(value) = self.mirrored(q, delay) {
                    (both, mirrored) = (both + excess, mirrored + value);
                }
            };
            take(p, 0.0, leak);
            for h in (0..CHANNELS).filter(|h| *h != a && *h != b) {
                let (q, sign) = self.pair(to, h)?;
                let delay = sign * self.delay(from, h)?;
                let excess = self.excess(q, delay)?;
                sum += excess;
                take(q, delay, excess);
            }
            (sum > 2.0 * least && mirrored < ECHOED * both).then_some(to)
        };
        let receiver = received(a, b).or_else(|| received(b, a))?;
        (!self.echoes(p, receiver, leak)).then_some(receiver)
    }

    /// A pair's correlation as far on the other side of the vessel's own delay as `delay` (seconds) is on this. The image in the surface, which pairs
    /// hear whose hydrophones lie at different heights, stands on both sides, what leaks on one.
    fn mirrored(&self, pair: usize, delay: f32) -> Option<f32> {
        let mirrored = 2.0 * self.tau.get(pair)? - delay;
        let reach = MAX_DELAY as f32 - 1.0;
        (m::abs(mirrored) * self.context.plan.rate_hz < reach)
            .then(|| self.search.pair_value(self.context.plan, pair, mirrored))
    }

    /// Whether what stands at no delay between pair `p` may be the vessel's echo off the bottom, which reaches both at once. Hydrophones in a level
    /// plane hear it with the vessel's own delays, so that it looks as if the third received from them. The other pairs hear it as strongly,
    /// at its own delays; where those are too near to the vessel's, it cannot be told.
    #[inline(never)]
    fn echoed(&self, p: usize, leak: f32) -> bool {
        let mut heard = false;
        let mut most = 0.0f32;
        let mut may = false;
        for n in 0..=ECHOES {
            let echo = wavefront::pair_delays(&self.echo(n));
            let near = |a: f32, b: f32| m::abs(a - b) * self.context.plan.rate_hz < APART_SAMPLES;
            if !near(echo.get(p).copied().unwrap_or(0.0), 0.0) {
                continue;
            }
            may = true;
            let (mut sum, mut pairs) = (0.0, 0.0f32);
            for (q, (delay, own)) in echo.iter().zip(self.tau).enumerate() {
                if q != p && !near(*delay, *own) {
                    sum += self.search.pair_value(self.context.plan, q, *delay);
                    pairs += 1.0;
                }
            }
            if pairs >= LEAST_PAIRS {
                heard = true;
                most = most.max(sum / pairs);
            }
        }
        may && !(heard && most < (ECHOED * leak).max(RECEIVED_SD * self.deviation))
    }

    /// Arrival times of an echo off the bottom, of [`ECHOES`] steps from the nearest to the steepest.
    #[inline(never)]
    fn echo(&self, step: usize) -> [f32; CHANNELS] {
        let elevation = m::asin(self.direction[2].clamp(0.0, 1.0));
        let steepest = ECHO_STEEPER * elevation + ECHO_RAD;
        let below = elevation + (steepest - elevation) * step as f32 / ECHOES as f32;
        wavefront::arrivals(&self.context.plan.geometry, &self.seen_from_below(below), 0.0)
    }

    /// Whether what seems to leak into one of pair `p` is an echo of the vessel off the bottom that reaches it when the other one hears the
    /// vessel itself. Then the echo is heard by the rest as well, as strongly and as much later as its direction wants.
    #[inline(never)]
    fn echoes(&self, p: usize, receiver: usize, leak: f32) -> bool {
        let Some((a, b)) = PAIRS.get(p) else { return false };
        let sender = if receiver == *a { *b } else { *a };
        let vessel = wavefront::arrivals(&self.context.plan.geometry, self.direction, 0.0);
        let mut most = 0.0f32;
        for n in 0..=ECHOES {
            let echo = self.echo(n);
            let at = |times: &[f32; CHANNELS], h: usize| times.get(h).copied().unwrap_or(0.0);
            let late = at(&vessel, sender) - at(&echo, receiver);
            let (mut sum, mut heard) = (0.0, 0.0f32);
            for (q, (i, j)) in
                PAIRS.into_iter().enumerate().filter(|(_, (i, j))| *i != receiver && *j != receiver)
            {
                let own = self.tau.get(q).copied().unwrap_or(0.0);
                let later = at(&echo, j) + late - at(&vessel, i);
                let earlier = at(&vessel, j) - at(&echo, i) - late;
                // Near its own delay the vessel itself is heard.
                let apart = |delay: &f32| m::abs(delay - own) * self.context.plan.rate_hz > APART_SAMPLES;
                for delay in [later, earlier].into_iter().filter(apart) {
                    sum += self.search.pair_value(self.context.plan, q, delay);
                    heard += 1.0;
                }
            }
            if heard >= LEAST_ECHOES {
                most = most.max(sum / heard);
            }
        }
        most > (ECHOED * leak).max(RECEIVED_SD * self.deviation)
    }

    /// The vessel's azimuth, so far below the horizon, radians.
    fn seen_from_below(&self, below: f32) -> Direction {
        let [east, north, up] = *self.direction;
        let level = m::sqrt(1.0 - up * up).max(1e-3);
        let (s, c) = m::sin_cos(below);
        [east * c / level, north * c / level, -s]
    }

    /// The pair of two hydrophones, and 1 or −1 where it is in the other order.
    fn pair(&self, i: usize, j: usize) -> Option<(usize, f32)> {
        let at = |x: usize, y: usize| PAIRS.iter().position(|q| *q == (x, y));
        at(i, j).map(|q| (q, 1.0)).or_else(|| at(j, i).map(|q| (q, -1.0)))
    }

    fn delay(&self, i: usize, j: usize) -> Option<f32> {
        let (q, sign) = self.pair(i, j)?;
        Some(sign * self.tau.get(q)?)
    }

    /// A pair's correlation at a delay (seconds) beyond what the vessel gives there.
    fn excess(&self, pair: usize, delay: f32) -> Option<f32> {
        let step = self.context.plan.bin_rad_s * (self.tau.get(pair)? - delay);
        let Band { high, incoherent, .. } = self.context.plan.whole;
        let ((mut s, mut c), (ds, dc)) = (m::sin_cos(step * incoherent as f32), m::sin_cos(step));
        let mut own = 0.0;
        for coherence in self.coherence.get(incoherent..high)? {
            own += coherence * c;
            (s, c) = (s * dc + c * ds, c * dc - s * ds);
        }
        Some(self.search.pair_value(self.context.plan, pair, delay) - own)
    }
}
