//! Whether one hydrophone hears another through its channel.
//!
//! Enters: the pairs' correlations and the vessel found. Leaves: the hydrophone that receives, if one does. Beyond what the vessel gives, the pair of
//! sender and receiver correlates at no delay at all, and the receiver has the sender's delays with the two others. A vessel's echo off the bottom
//! ([`super::echo`]) and its image in the surface can do the same for a while: what is no louder than the echo is none, an image stands on both sides of
//! the vessel, and the pairs without the receiver hear either, of a leak nothing; where they do hear something [`super::sick`] waits until the vessel has moved.
//! Cost: some 2000 instructions where something stands at no delay.

use super::estimate::Context;
use super::followed::Followed;
use super::plan::{BINS, Band, MAX_DELAY};
use super::search::SearchWork;
use super::sick::{LEAKING, Sign};
use super::wavefront::PAIR_COUNT;
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

/// Standard deviation of the arrival times which a leak moves that the vessel hides, samples.
pub(super) const LEAKED_SAMPLES: f32 = 0.15;

/// Share of what seems to leak below which the pairs that the receiver is not in hear nothing that could explain it, and the steps in which that is
/// looked for, samples.
const ALONE: f32 = 0.5;
const STEP_SAMPLES: f32 = 0.5;
/// Share of the array's height from which on a pair is upright enough to hear such an echo apart.
const UPRIGHT: f32 = 0.5;

/// Share of what seems to leak that an image has on the other side of the vessel's own delay.
const MIRRORED: f32 = 0.4;

/// What the correlations say beyond the vessel found at these delays, of this coherence.
pub(crate) struct Beyond<'a> {
    pub(crate) search: &'a SearchWork,
    pub(crate) tau: &'a [f32; PAIR_COUNT],
    pub(crate) coherence: &'a [f32; BINS],
    /// Its mean.
    pub(crate) mean: f32,
    pub(crate) deviation: f32,
    /// The other sources, and the segment.
    pub(super) context: &'a Context<'a>,
    pub(super) others: (&'a Followed, u32),
    /// Share of full coherence that the vessel's echo may have at any delay.
    pub(super) echo: f32,
}

/// What is known of a leak beside the hydrophone that receives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Nothing that the other pairs hear explains it.
    pub(crate) alone: bool,
    /// The hydrophone that it hears, where that hears it as well.
    pub(crate) other: Option<usize>,
}

impl Seen {
    /// No leak.
    pub(crate) const NONE: Self = Self { alone: false, other: None };
}

impl Beyond<'_> {
    /// Whether one hydrophone hears another, and what else is known of that.
    pub(crate) fn sign(&self) -> (Sign, Seen) {
        let leak = (0..PAIR_COUNT).find_map(|p| self.receiver(p));
        leak.map_or((Sign::Well, Seen::NONE), |(h, leak, other)| {
            (Sign::Sick(LEAKING, h), Seen { alone: self.alone(h, leak), other })
        })
    }

    /// Whether the pairs that hydrophone `h` is not in hear nothing beside the vessel that comes near to this correlation; false where they lie level, for
    /// those hear an echo from below or above together with the vessel. The vessel's own, which is the highest, is taken away only where there is something.
    #[inline(never)]
    fn alone(&self, h: usize, leak: f32) -> bool {
        let position_m = &self.context.plan.geometry.position_m;
        let rise = |(a, b): &(usize, usize)| match (position_m.get(*a), position_m.get(*b)) {
            (Some([.., a]), Some([.., b])) => m::abs(a - b),
            _ => 0.0,
        };
        let highest = PAIRS.iter().map(rise).fold(0.0, f32::max);
        let upright =
            PAIRS.iter().filter(|pair| pair.0 != h && pair.1 != h && rise(pair) > UPRIGHT * highest).count();
        if upright < 2 {
            return false;
        }
        let least = ALONE * leak;
        let rate_hz = self.context.plan.rate_hz;
        let reach = MAX_DELAY as f32 - 1.0;
        (0..(2.0 * reach / STEP_SAMPLES) as usize).all(|step| {
            let delay = (step as f32 * STEP_SAMPLES - reach) / rate_hz;
            PAIRS.iter().zip(self.tau).enumerate().all(|(q, ((a, b), tau))| {
                *a == h
                    || *b == h
                    || m::abs(delay - tau) * rate_hz < APART_SAMPLES
                    || self.search.pair_value(self.context.plan, q, delay) < least
                    || self.excess(q, delay).is_none_or(|excess| excess < least)
            })
        })
    }

    /// Whether the vessel hides what one of the hydrophones `suspected` (bit h: hydrophone h) hears of another.
    pub(crate) fn hides_of(&self, suspected: u8) -> bool {
        let of = |(a, b): &(usize, usize)| (suspected >> a | suspected >> b) & 1 == 1;
        PAIRS.iter().zip(self.tau).any(|(pair, tau)| of(pair) && self.hides(*tau))
    }

    /// Whether a vessel of this delay hides what leaks between a pair.
    fn hides(&self, tau: f32) -> bool {
        m::abs(tau) * self.context.plan.rate_hz < APART_SAMPLES
    }

    /// The hydrophone of pair `p` that hears the other one, if there is one, how much of it, and that other one where both hear each other.
    fn receiver(&self, p: usize) -> Option<(usize, f32, Option<usize>)> {
        let (a, b) = *PAIRS.get(p)?;
        let Band { high, incoherent, .. } = self.context.plan.whole;
        let least = LEAST_LEAK.max(self.echo) * high.saturating_sub(incoherent) as f32;
        let least = least.max(LEAK * self.deviation);
        let hidden = self.hides(*self.tau.get(p)?);
        let leak = self.excess(p, 0.0)?;
        let (others, segment) = self.others;
        if hidden || leak < least || others.explain(self.context, segment, (p, 0.0), (APART_SAMPLES, true)) {
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
            (mirrored < MIRRORED * both).then_some(sum)
        };
        let of = |to: usize, from: usize| received(to, from).unwrap_or(0.0);
        let (to_a, to_b) = (of(a, b), of(b, a));
        let (h, other, more, less) = if to_b > to_a { (b, a, to_b, to_a) } else { (a, b, to_a, to_b) };
        // Of two that hear each other the one that hears more is left out. At no delay they have what both hear.
        let other = (less > least).then_some(other);
        (more > 2.0 * least && !self.another(p, h, leak)).then_some((h, leak, other))
    }

    /// Whether another known source stands at no delay of pair `p` and is heard by the pairs without hydrophone `h` as well, which hear nothing of what that
    /// one receives.
    #[inline(never)]
    fn another(&self, p: usize, h: usize, leak: f32) -> bool {
        let (others, segment) = self.others;
        let rate_hz = self.context.plan.rate_hz;
        others.expected(self.context, segment).any(|delays| {
            let heard = |q: usize, (a, b): &(usize, usize)| {
                let (Some(delay), Some(tau)) = (delays.get(q), self.tau.get(q)) else { return false };
                *a == h
                    || *b == h
                    || m::abs(delay - tau) * rate_hz < APART_SAMPLES
                    || self.excess(q, *delay).is_some_and(|excess| excess > ALONE * leak)
            };
            delays.get(p).is_some_and(|delay| m::abs(*delay) * rate_hz < APART_SAMPLES)
                && PAIRS.iter().enumerate().all(|(q, pair)| heard(q, pair))
        })
    }

    /// A pair's correlation as far on the other side of the vessel's own delay as `delay` (seconds) is on this. The image in the surface, which pairs
    /// hear whose hydrophones lie at different heights, stands on both sides, what leaks on one.
    fn mirrored(&self, pair: usize, delay: f32) -> Option<f32> {
        let mirrored = 2.0 * self.tau.get(pair)? - delay;
        let reach = MAX_DELAY as f32 - 1.0;
        (m::abs(mirrored) * self.context.plan.rate_hz < reach)
            .then(|| self.search.pair_value(self.context.plan, pair, mirrored))
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
