//! What takes the vector of four arrival times from where it should be to where it is: nothing, a late hydrophone, channels in another order.
//!
//! Enters: both vectors and how certain each is ([`super::change`]). Leaves: what explains the way between them, if something does.
//! Cost: about 3000 instructions where it is far.

use super::order::{ORDERS, SWAPS, heard, inverse};
use super::plan::Plan;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::math::f32 as m;

/// Least and most of the squared deviations, of three dimensions, beyond which the vector has jumped: between the two, what so large a part of a
/// sample is in units of the least a delay errs by, so that one late at the highest rates is seen from most sides. The most also where other
/// sources are heard, which come and go and pull each pair by itself. Passes of one vessel have up to 10.
pub(super) const JUMPED: (f32, f32) = (11.0, 36.0);
pub(super) const JUMPED_SAMPLES: f32 = 0.41;
/// Within which it is back, and within which it is where a change puts it.
const BACK: f32 = 12.0;
const THERE: f32 = 14.0;
/// The same where it should be is hardly known: nine in ten are within.
const THERE_OF_FEW: f32 = 6.0;
/// By so much less well may two exchanged channels explain it and still be taken for what it is, where a late one explains it too: bearings of a late channel are
/// told, of exchanged ones they are not. By so much better must they where they were exchanged before, and at any time three or four that
/// change places, of which there are 17.
pub(super) const EITHER: f32 = 4.0;
/// How often arrival times are fitted to the pairs': each time leaves a quarter of what was missing.
const ROUNDS: usize = 4;
/// Delays looked for, samples.
const DELAYS: (f32, f32) = (0.4, 8.0);

/// What changed: nothing, hydrophone `n − LATE` late, channels in the order `n − ORDERED` ([`super::order`]; from [`EXCHANGED`] on), or it cannot be told.
pub(super) type What = u8;
pub(super) const NOTHING: What = 0;
pub(super) const LATE: What = 1;
pub(super) const EXCHANGED: What = LATE + CHANNELS as u8;
pub(super) const ORDERED: What = EXCHANGED - 1;
pub(super) const ELSEWHERE: What = ORDERED + ORDERS as u8;

/// Where a vector is, against where it should be.
pub(super) struct Jump<'a> {
    pub(super) plan: &'a Plan,
    pub(super) duals: [[f32; 3]; CHANNELS],
    pub(super) from: [f32; 3],
    pub(super) to: [f32; 3],
    /// Squared deviations beyond which it has jumped.
    pub(super) jumped: f32,
    /// Whether `from` is known by how fast vessels turn alone: no late channel would show, and as much is explained by chance as may be.
    pub(super) few: bool,
    /// By how much less well exchanged channels may explain it than a late one.
    pub(super) either: f32,
    /// Axes, and the variance along each.
    pub(super) axes: [[f32; 3]; 3],
    pub(super) variance: [f32; 3],
    /// The same where channels were exchanged, which turns the axes.
    pub(super) exchanged: [f32; 3],
}

/// How well pairs' own delays are found where they are of no common direction, as with a channel late or exchanged, samples.
const CHANGED_SAMPLES: f32 = 0.12;

impl Jump<'_> {
    /// Product of two vectors, each in standard deviations.
    #[inline(never)]
    fn inner(&self, a: &[f32; 3], b: &[f32; 3], variance: &[f32; 3]) -> f32 {
        let mut sum = 0.0;
        for (axis, variance) in self.axes.iter().zip(variance) {
            sum += wavefront::dot(a, axis) * wavefront::dot(b, axis) / variance;
        }
        sum
    }

    /// What takes the vector there, if it is elsewhere than it should be, and the delay of a late channel. Once it has jumped, by what is
    /// `before`, it is back when it is nearer to its course than to that way from it: the course is the less certain the longer ago it was.
    #[inline(never)]
    pub(super) fn what(&self, before: Option<&[f32; 3]>) -> (What, f32) {
        let by = difference(&self.to, &self.from);
        let jumped = self.inner(&by, &by, &self.variance);
        let there = match before {
            Some(before) => {
                let left = difference(&by, before);
                jumped < BACK && jumped <= self.inner(&left, &left, &self.variance)
            }
            None => jumped < self.jumped,
        };
        if there {
            return (NOTHING, 0.0);
        }
        let found = CHANGED_SAMPLES / self.plan.rate_hz * length(&self.duals[0]) / self.plan.inv_c;
        let late = self.variance.map(|v| v + found * found);
        let exchanged = self.exchanged.map(|v| v + found * found);
        let (mut best, mut least) = ((ELSEWHERE, 0.0), THERE);
        for (dual, what) in self.duals.iter().zip(LATE..).filter(|_| !self.few) {
            let per_s = dual.map(|x| -x / self.plan.inv_c);
            let delay_s =
                self.inner(&per_s, &by, &late) / self.inner(&per_s, &per_s, &late).max(f32::MIN_POSITIVE);
            let left = difference(&by, &per_s.map(|x| delay_s * x));
            let samples = m::abs(delay_s) * self.plan.rate_hz;
            let chi2 = self.inner(&left, &left, &late);
            if chi2 < least && samples > DELAYS.0 && samples < DELAYS.1 {
                (best, least) = ((what, delay_s), chi2);
            }
        }
        let told = arrivals(self.plan, &self.to);
        let orders = if self.few { 1 + SWAPS } else { ORDERS };
        for order in 1..orders as u8 {
            // In order again: what is uncertain up and down is so in the true order alone.
            let t = heard(&told, inverse(order));
            let off = difference(&vector(self.plan, &self.duals, &t), &self.from);
            let either = if usize::from(order) > SWAPS { -EITHER } else { self.either };
            let chi2 = self.inner(&off, &off, &exchanged);
            let there = if self.few { THERE_OF_FEW } else { THERE };
            if chi2 < there && chi2 < least + either {
                (best, least) = ((ORDERED + order, 0.0), chi2 - either);
            }
        }
        best
    }
}

#[inline(never)]
pub(super) fn difference(a: &[f32; 3], b: &[f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(never)]
pub(super) fn unit(v: &[f32; 3]) -> Direction {
    let norm = length(v).max(0.1);
    v.map(|x| x / norm)
}

#[inline(never)]
pub(super) fn length(v: &[f32; 3]) -> f32 {
    m::sqrt(wavefront::dot(v, v))
}

/// Arrival times (seconds) about their mean that fit the pairs' delays best, where each pair counts by its weight: each hydrophone's in turn from
/// the others' (Gauss and Seidel), from those that delays of one wavefront have.
#[inline(never)]
pub(super) fn times(delays: &[f32; PAIR_COUNT], weight: &[f32; PAIR_COUNT]) -> [f32; CHANNELS] {
    let [first, second, third, ..] = *delays;
    let mut out = [0.0, first, second, third];
    for h in (0..CHANNELS).cycle().take(ROUNDS * CHANNELS) {
        let (mut sum, mut of) = (0.0, 0.0);
        for ((delay, weight), (i, j)) in delays.iter().zip(weight).zip(PAIRS) {
            let (other, later) = if h == j {
                (i, *delay)
            } else if h == i {
                (j, -delay)
            } else {
                continue;
            };
            sum += weight * (out.get(other).unwrap_or(&0.0) + later);
            of += weight;
        }
        if let Some(t) = out.get_mut(h) {
            *t = sum / of;
        }
    }
    let mean = out.iter().sum::<f32>() / CHANNELS as f32;
    out.map(|t| t - mean)
}

/// Arrival times (seconds) of a plane wave of this vector.
#[inline(never)]
pub(super) fn arrivals(plan: &Plan, vector: &[f32; 3]) -> [f32; CHANNELS] {
    plan.geometry.position_m.map(|h| -plan.inv_c * wavefront::dot(&h, vector))
}

/// Vectors whose products with the hydrophones' places are 1 for the own one and 0 for the others', up to a constant: 1/m.
#[inline(never)]
pub(super) fn duals(plan: &Plan) -> [[f32; 3]; CHANNELS] {
    let [o, a, b, c] = &plan.geometry.position_m;
    let (a, b, c) = (difference(a, o), difference(b, o), difference(c, o));
    let cross = |x: &[f32; 3], y: &[f32; 3]| {
        [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
    };
    let (bc, ca, ab) = (cross(&b, &c), cross(&c, &a), cross(&a, &b));
    // No station's hydrophones are in a plane.
    let volume = wavefront::dot(&a, &bc);
    let [a, b, c] = [bc, ca, ab].map(|x| x.map(|x| x / volume));
    [[0, 1, 2].map(|k: usize| -(a[k] + b[k] + c[k])), a, b, c]
}

/// The vector that arrival times (seconds) are of: the direction, where they are of a plane wave.
#[inline(never)]
pub(super) fn vector(plan: &Plan, duals: &[[f32; 3]; CHANNELS], times: &[f32; CHANNELS]) -> [f32; 3] {
    let mut out = [0.0; 3];
    for (dual, t) in duals.iter().zip(times) {
        for (x, d) in out.iter_mut().zip(dual) {
            *x -= t / plan.inv_c * d;
        }
    }
    out
}
