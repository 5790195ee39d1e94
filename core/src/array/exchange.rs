//! Whether channels have changed places, by all vessels that are known.
//!
//! Enters: each segment's correlations of the pairs, and where vessels are heard. Leaves: whether they are heard where they should be, or where channels
//! in another order put them: two exchanged, or three or four that change places at once ([`super::order`]). An exchange moves every vessel, and where several are heard it may put one near to where another was, or let
//! another be the strongest: of that one alone ([`super::change`]) it would look like a vessel that takes another's turn. All of them together jump as
//! nothing else does.
//!
//! * Up to [`KNOWN`] vessels are known, the strongest and those that are followed beside it, with how fast each turns or, high above, moves. The correlations at the
//!   delays that they should have are summed, for the channels in each of their 24 orders, in units of the pairs' own peaks.
//! * Where an exchange explains [`MORE`] beyond what they do as they are, no direction is told; the [`SURE`]th time in a row it is sure, and said by
//!   the fault `Inconsistent`.
//! * From then on no direction is told. The vessels are followed through the exchange, by each pair's own delays, until they are
//!   heard as they were for as long, or what else is heard contradicts it ([`super::change`]).
//! * It is believed for as long as one of the vessels is heard that showed it. What comes later cannot tell it from a sea that is the mirror image, and
//!   channels are more likely in order than not ([`super::agreement`]).
//! * While several are heard where they were, no exchange is believed that the strongest alone shows.
//! * What is heard elsewhere than expected, and explained by no exchange, is new the [`STRAY`]th time: in a segment in the midst of which channels
//!   are exchanged it may be anywhere.
//!
//! Vessels in the plane that is half-way between two hydrophones are heard where they were when those are exchanged: where all are, it shows when
//! one leaves it, if it is still remembered as it was then. Cost: about 9000 instructions a segment for each vessel known.

use super::agreement::half_apart;
use super::estimate::Context;
use super::followed::{Followed, Known};
use super::jump::{duals, times, unit, vector};
use super::order::{ORDERS, SWAPS, heard, held, inverse};
use super::plan::Plan;
use super::report;
use super::search::{PairPeaks, SearchWork};
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::math::f32 as m;

/// Vessels known at once.
const KNOWN: usize = 4;
/// Least share of the pairs' peaks that an exchange explains, and how much more than is explained without: 17 500 segments in which one to three
/// vessels are heard by well channels have at most 0.1.
const FOUND: f32 = 0.3;
const MORE: f32 = 0.2;
/// How much more three or four channels that change places must explain than two: where the sound reaches two hydrophones at about the same time,
/// several orders explain it alike, and through the wrong one a vessel is followed astray.
const RARER: f32 = 0.1;
/// Segments in a row that must say so, and those elsewhere than expected after which what is heard there is new.
const SURE: u8 = 3;
const STRAY: u8 = 3;
/// A vessel so near to where one is expected is that one, in resolution cells, and radians for each step since that was heard.
const SAME_CELLS: f32 = 0.5;
const DRIFT_RAD: f32 = 0.01;
const TURNING_RAD: f32 = 0.03;
/// Steps after which a vessel that was not heard is forgotten.
const LASTS: u32 = 20;
/// Through exchanged channels, how near to its expected delay a pair hears a vessel, samples, how many pairs do so at least, and how much an expected delay
/// counts where none is heard.
const ABOUT_SAMPLES: f32 = 0.4;
const HEARD: f32 = 3.0;
const EXPECTED: f32 = 0.1;
/// Delays of one source close their triangles to this, samples.
const CLOSED_SAMPLES: f32 = 0.8;

/// The vessels that are known, and whether channels are exchanged. All zeros at the beginning.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exchange {
    /// The strongest first; segments are steps here.
    known: [Known; KNOWN],
    /// In which order the channels are ([`super::order`]); 0: as they should be.
    order: u8,
    /// Segments in a row that say another, and that hear the strongest where none is expected.
    times: u8,
    strays: u8,
    /// Whether the vessels known explain what the pairs hear.
    explains: bool,
    /// Whether the first vessel to be known is one that has shown an exchange.
    shown: bool,
    /// Orders, a bit each, that the channels are not in: the vessels known are heard where they were, and not where that would put them.
    denied: u32,
}

impl Exchange {
    pub(super) const NEW: Self = Self {
        known: [Known::NONE; KNOWN],
        order: 0,
        times: 0,
        strays: 0,
        explains: false,
        shown: false,
        denied: 0,
    };

    /// The order of the channels, where it is sure that it is another than it should be.
    pub(super) fn sure(&self) -> Option<u8> {
        (self.order > 0).then_some(self.order)
    }

    /// Whether an exchange seems to have begun or ended.
    pub(super) fn seems(&self) -> bool {
        self.times > 0
    }

    /// Whether several vessels are heard where they were, and not where channels in this order would put them.
    pub(super) fn denies(&self, order: u8) -> bool {
        self.order == 0
            && !self.seems()
            && self.explains
            && self.denied & 1 << order.min(31) != 0
            && self.known.iter().filter(|k| k.lasts()).count() > 1
    }

    /// Takes that the strongest source shows an exchange, or one that has ended. What the vessels known explain is not ended by that; what they do not show
    /// has begun unseen: they are known anew.
    pub(super) fn agree(&mut self, order: Option<u8>) {
        match order {
            Some(order) if self.seems() => (self.order, self.times) = (order, 0),
            None if self.explains => {}
            _ => {
                self.forget();
                self.shown = order.is_some();
            }
        }
    }

    /// Whether a vessel is still heard that has shown an exchange.
    pub(super) fn witnessed(&self) -> bool {
        self.shown || self.known.iter().any(|k| k.found > 0 && k.led)
    }

    /// Takes that samples are missing: where vessels are after it nobody knows, and one that was heard at the mirrored place would look like an
    /// exchange. What is sure stays so.
    pub(super) fn gap(&mut self) {
        if self.order == 0 {
            self.forget();
        }
    }

    /// Forgets what is known.
    #[inline(never)]
    pub(super) fn forget(&mut self) {
        (self.order, self.times, self.strays, self.explains, self.shown) = (0, 0, 0, false, false);
        for known in &mut self.known {
            known.found = 0;
        }
    }

    /// Takes a segment: what the pairs hear, where the strongest source seems to be, and those beside it. All pairs hear something.
    #[inline(never)]
    pub(super) fn take(
        &mut self,
        context: &Context<'_>,
        (peaks, search): (&[PairPeaks; PAIR_COUNT], &SearchWork),
        strongest: &Direction,
        (others, segment): (&Followed, u32),
    ) {
        let plan = context.plan;
        // The middle of a segment lies where a step ends, but for what is left out of it.
        let step = (context.index.saturating_add(plan.step_samples.get() / 4) / plan.step_samples) as u32;
        let scores = self.scores(context, (peaks, search), step);
        let before = scores.get(usize::from(self.order)).copied().unwrap_or(0.0);
        // Of exchanged ones it is asked whether they are as they were, not whether others are exchanged as well.
        let asked = if self.order > 0 { 1 } else { scores.len() };
        let (mut best, mut most) = (self.order, before);
        for (score, order) in scores.iter().zip(0u8..).take(asked) {
            let score = if usize::from(order) > SWAPS { score - RARER } else { *score };
            if score > most {
                (best, most) = (order, score);
            }
        }
        self.explains = before >= FOUND;
        self.denied = 0;
        for (score, order) in scores.iter().zip(0u8..) {
            if before >= *score + MORE {
                self.denied |= 1 << order;
            }
        }
        if most >= FOUND && most >= before + MORE {
            self.times = self.times.saturating_add(1);
            if self.times >= SURE {
                (self.order, self.times, self.strays) = (best, 0, 0);
                for known in &mut self.known {
                    known.led = known.lasts();
                }
            }
            return;
        }
        self.times = 0;
        let at = match self.order {
            0 => Some(*strongest),
            // What may be either is no place to follow vessels from.
            order if best == order => self.through(plan, peaks, step),
            _ => None,
        };
        let Some(at) = at else { return };
        let near = self.near(plan, &at, step);
        if near.is_none() {
            self.strays = self.strays.saturating_add(1);
            if self.strays < STRAY {
                return;
            }
        }
        self.strays = 0;
        let place = near.unwrap_or_else(|| self.stalest(step, 0));
        let [first, rest @ ..] = &mut self.known;
        if let Some(other) = place.checked_sub(1).and_then(|n| rest.get_mut(n)) {
            core::mem::swap(first, other);
        }
        if near.is_some() {
            first.take(at, step);
        } else {
            *first = Known::at(at, step, 1);
            first.led = core::mem::take(&mut self.shown);
        }
        if self.order == 0 {
            for other in others.known.iter().filter(|k| k.lasts()) {
                let at = other.expected(segment);
                let place = self.near(plan, &at, step).unwrap_or_else(|| self.stalest(step, 1));
                let [_, rest @ ..] = &mut self.known;
                if let Some(known) = place.checked_sub(1).and_then(|n| rest.get_mut(n)) {
                    *known = Known::at(at, step, 2);
                    (known.turning, known.moving) = (other.turning, other.moving);
                }
            }
        }
    }

    /// What the vessels known explain of the pairs' peaks, with the channels in each order.
    #[inline(never)]
    fn scores(
        &mut self,
        context: &Context<'_>,
        (peaks, search): (&[PairPeaks; PAIR_COUNT], &SearchWork),
        step: u32,
    ) -> [f32; ORDERS] {
        let plan = context.plan;
        let all: f32 = peaks.iter().map(|p| p.peak).sum();
        let mut scores = [0.0; ORDERS];
        for known in self.known.iter_mut().filter(|k| k.found > 0) {
            if step.wrapping_sub(known.segment) > LASTS {
                known.found = 0;
            }
            if !known.lasts() {
                continue;
            }
            let at = known.expected(step);
            let (e, half) = (wavefront::tangents(&at), half_apart(plan, &at));
            let (curvature, _) = plan.curvature_from(&at);
            let [low, high] = [-half, half].map(|up| {
                wavefront::arrivals(&plan.geometry, &wavefront::stepped(&at, &e, 0.0, up), curvature)
            });
            for (p, (i, j)) in PAIRS.into_iter().enumerate() {
                // The pair may hold any two hydrophones, and orders share them.
                let between = |from: usize, to: usize| {
                    let [low, high] =
                        [&low, &high].map(|t| t.get(to).zip(t.get(from)).map_or(0.0, |(b, a)| b - a));
                    if from == to { 0.0 } else { search.most_between(plan, p, low, high) / all }
                };
                let value: [[f32; CHANNELS]; CHANNELS] =
                    core::array::from_fn(|from| core::array::from_fn(|to| between(from, to)));
                for (score, order) in scores.iter_mut().zip(0u8..) {
                    let (from, to) = (held(order, i), held(order, j));
                    *score += value.get(from).and_then(|of| of.get(to)).unwrap_or(&0.0);
                }
            }
        }
        scores
    }

    /// Follows the vessels known through exchanged channels, by what each pair hears about where it should hear them: no direction has such
    /// delays. Where another one is that the pairs hear alone, if they hear none of these.
    #[inline(never)]
    fn through(&mut self, plan: &Plan, peaks: &[PairPeaks; PAIR_COUNT], step: u32) -> Option<Direction> {
        let mut any = false;
        for known in self.known.iter_mut().filter(|k| k.found > 0) {
            let at = known.expected(step);
            let arrivals = wavefront::arrivals(&plan.geometry, &at, plan.curvature_from(&at).0);
            let mut delays = wavefront::pair_delays(&heard(&arrivals, self.order));
            let mut weight = [EXPECTED; PAIR_COUNT];
            let drift = DRIFT_RAD * step.wrapping_sub(known.segment) as f32;
            let each = delays.iter_mut().zip(&mut weight).zip(peaks).zip(&plan.crossing_s);
            for (((delay, weight), own), crossing_s) in each {
                if m::abs(own.delay_s - *delay) < ABOUT_SAMPLES / plan.rate_hz + drift * crossing_s {
                    (*delay, *weight) = (own.delay_s, 1.0);
                }
            }
            if weight.iter().sum::<f32>() >= HEARD {
                known.take(seen(plan, &delays, &weight, self.order), step);
                any = true;
            }
        }
        let delays = peaks.map(|p| p.delay_s);
        let alone = !any && report::closure(&delays) * plan.rate_hz < CLOSED_SAMPLES;
        alone.then(|| seen(plan, &delays, &[1.0; PAIR_COUNT], self.order))
    }

    /// The place of the vessel that is expected in a direction.
    #[inline(never)]
    fn near(&self, plan: &Plan, at: &Direction, step: u32) -> Option<usize> {
        let (mut place, mut nearest) = (None, 1.0);
        for (n, known) in self.known.iter().enumerate().filter(|(_, k)| k.found > 0) {
            let drift = if known.lasts() { DRIFT_RAD } else { TURNING_RAD };
            let within = SAME_CELLS * plan.whole.resolution
                + 2.0 * half_apart(plan, at)
                + drift * step.wrapping_sub(known.segment) as f32;
            let away = m::acos(wavefront::dot(&known.expected(step), at).clamp(-1.0, 1.0)) / within;
            if away < nearest {
                (place, nearest) = (Some(n), away);
            }
        }
        place
    }

    /// Of the places from one on, a free one, or that of the vessel heard longest ago.
    #[inline(never)]
    fn stalest(&self, step: u32, from: usize) -> usize {
        let age = |known: &Known| if known.found > 0 { step.wrapping_sub(known.segment) } else { u32::MAX };
        let places = self.known.iter().enumerate().skip(from);
        places.max_by_key(|(_, known)| age(known)).map_or(from, |(place, _)| place)
    }
}

/// The direction of delays that the pairs hear with the channels in this order, each with its weight.
#[inline(never)]
fn seen(plan: &Plan, delays: &[f32; PAIR_COUNT], weight: &[f32; PAIR_COUNT], order: u8) -> Direction {
    unit(&vector(plan, &duals(plan), &heard(&times(delays, weight), inverse(order))))
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{error_from, hear, noisy, plan, source};
    use super::*;
    use crate::angle::unit_vector;
    use crate::wire::FaultCode;
    use std::vec::Vec;

    const RATE_HZ: f32 = 16_000.0;
    const FIRST: (f64, f64) = (1.9, 0.27);

    /// Where a vessel is heard when the channels are in an order, of a regular tetrahedron.
    fn image(plan: &Plan, (azimuth, elevation): (f64, f64), order: u8) -> (f64, f64) {
        let u = unit_vector(azimuth as f32, elevation as f32);
        let t = wavefront::arrivals(&plan.geometry, &u, 0.0);
        let (azimuth, elevation) = wavefront::angles(&unit(&vector(plan, &duals(plan), &heard(&t, order))));
        (f64::from(azimuth), f64::from(elevation))
    }

    /// Two vessels, the second 0.2 rad beside where an order of the channels puts the first, for half a minute.
    fn two(plan: &Plan, order: u8, seed: u64) -> (Vec<[f64; CHANNELS]>, (f64, f64)) {
        let (azimuth, _) = image(plan, FIRST, order);
        let second = (azimuth + 0.2, 0.2);
        let mut sea = noisy(source(plan, FIRST, 3.0, None, 30, seed), seed ^ 1);
        for (sum, x) in sea.iter_mut().zip(source(plan, second, 2.0, None, 30, seed ^ 2)) {
            sum.iter_mut().zip(x).for_each(|(sum, x)| *sum += x);
        }
        (sea, second)
    }

    #[test]
    fn an_exchange_that_puts_a_vessel_beside_another_is_said_and_nothing_told_until_it_ends() {
        let plan = plan(f64::from(RATE_HZ));
        // Two exchanged, two and two, three, and a slip by one.
        let orders = [
            (1u8, [1, 0, 2, 3]),
            (4, [0, 2, 1, 3]),
            (8, [2, 3, 0, 1]),
            (12, [1, 3, 2, 0]),
            (18, [1, 2, 3, 0]),
        ];
        for (seed, (order, held)) in (21..).zip(orders) {
            let (mut sea, second) = two(&plan, order, seed);
            let at = |seconds: f32| (seconds * RATE_HZ) as usize;
            sea[at(14.3)..at(21.3)].iter_mut().for_each(|x| *x = held.map(|h: usize| x[h]));
            let heard = hear(&plan, &sea);
            let told: Vec<_> = heard.faults.iter().filter(|f| f.0 == FaultCode::Inconsistent).collect();
            assert!(matches!(told[..], [(_, _, s)] if (14.0..18.0).contains(s)), "{order}: {told:?}");
            let seconds = |b: &crate::wire::Bearing| b.index as f32 / RATE_HZ;
            let meanwhile = |b: &&crate::wire::Bearing| (15.0..21.0).contains(&seconds(b));
            assert_eq!(heard.bearings.iter().filter(meanwhile).count(), 0, "{order}");
            let back = heard.bearings.iter().filter(|b| seconds(b) > 25.0);
            let right = back.clone().filter(|b| {
                let near = |of| error_from(b, of).0.abs() < 0.05;
                near(FIRST) || near(second)
            });
            let (back, right) = (back.count(), right.count());
            assert!(back >= 8 && right == back, "{order}: {right} of {back}");
        }
    }

    #[test]
    fn an_exchange_that_nobody_saw_end_is_given_up_and_what_is_told_then_is_marked() {
        let plan = plan(f64::from(RATE_HZ));
        let at = |seconds: f32| (seconds * RATE_HZ) as usize;
        // What showed it falls silent, the channels are put right, and another vessel comes for longer than two minutes.
        let mut sea = source(&plan, FIRST, 3.0, None, 26, 41);
        sea[at(14.3)..].iter_mut().for_each(|x| x.swap(0, 3));
        sea.extend(std::vec![[0.0; CHANNELS]; at(13.0)]);
        let from_s = sea.len() as f32 / RATE_HZ;
        let other = (FIRST.0 + 2.0, 0.2);
        sea.extend(source(&plan, other, 3.0, None, 140, 42));
        let heard = hear(&plan, &noisy(sea, 43));
        let told = heard.faults.iter().filter(|f| f.0 == FaultCode::Inconsistent).count();
        assert_eq!(told, 1, "{:?}", heard.faults);
        let seconds = |b: &&crate::wire::Bearing| b.index as f32 / RATE_HZ;
        let until = |s: f32, t: f32| heard.bearings.iter().filter(move |b| (s..t).contains(&seconds(b)));
        assert!(until(0.0, 14.0).count() > 20 && until(0.0, 14.0).all(|b| b.flags & 16 == 0));
        assert_eq!(until(16.0, from_s + 110.0).count(), 0);
        let again: Vec<_> = until(from_s + 125.0, f32::INFINITY).collect();
        assert!(again.len() > 20, "{}", again.len());
        assert!(again.iter().all(|b| b.flags & 16 != 0 && error_from(b, other).0.abs() < 0.05));
    }

    #[test]
    fn a_vessel_that_passes_over_the_array_is_no_exchange() {
        let plan = plan(64_000.0);
        // 7 m/s, 300 m above, half a metre aside or less, an eighth of a second each.
        for (heading, aside_m, seed) in [(0.5f64, 0.5f64, 31u64), (2.6, 0.1, 32)] {
            let mut sea = Vec::new();
            for n in -48..48i32 {
                let along_m = 7.0 / 8.0 * f64::from(n);
                let (east, north) = (
                    along_m * heading.sin() + aside_m * heading.cos(),
                    along_m * heading.cos() - aside_m * heading.sin(),
                );
                let at = (east.atan2(north), 300f64.atan2(east.hypot(north)));
                sea.extend(source(&plan, at, 3.0, None, 1, 1000 * seed + (n + 48) as u64).drain(..8000));
            }
            let heard = hear(&plan, &noisy(sea, seed));
            assert!(heard.faults.iter().all(|f| f.0 == FaultCode::Impulses), "{:?}", heard.faults);
            let later = heard.bearings.iter().filter(|b| b.index > 7 * 64_000).count();
            assert!(later >= 9, "{later}");
        }
    }

    #[test]
    fn where_nothing_is_exchanged_two_vessels_are_told_all_the_time() {
        let plan = plan(f64::from(RATE_HZ));
        let (sea, _) = two(&plan, 1, 23);
        let heard = hear(&plan, &sea);
        assert!(heard.faults.iter().all(|f| f.0 == FaultCode::Impulses), "{:?}", heard.faults);
        assert!(heard.bearings.iter().filter(|b| b.band == 0).count() > 55, "{}", heard.bearings.len());
    }
}
