//! Which hydrophone does not hear what the others hear.
//!
//! Enters: what the pairs' correlations of each segment show by themselves ([`PairPeaks`]). Leaves: faults that name a
//! channel, and the hydrophones to leave out. Four hydrophones have six pairs; one that is sick lowers or turns the three
//! it is in and leaves the three others as they are; of three hydrophones, two of three pairs:
//!
//! * Its own noise, or deaf: its pairs' highest correlations are less than [`DEAF`] of the others'. A hydrophone whose noise
//!   is k times the sound it hears has `1/√(1+k)` of the others' coherence: 9 dB above are named.
//! * Inverted: its pairs correlate negatively and the others positively; or, near a vessel whose image in the surface turns some
//!   correlations round by itself, no direction explains what the pairs show until one hydrophone is taken the other way round
//!   ([`Turned`]): one is tried a segment.
//! * Leaking: beyond what the vessel found gives, a pair correlates at no delay at all, and the one that receives has the
//!   sender's delays with the two others, while the pairs without it hear the vessel alone, or both stay while the vessel's own
//!   delays change: an echo off the bottom that reaches one when the other hears the vessel looks the same for a while.
//!
//! Two inverted hydrophones correlate with each other and negatively with the rest, who are as many: which of them they are
//! is not observable, and no direction is told. Nor is one of what all four hear at once, as they do their amplifiers' hum: no sound
//! crosses a solid array along none of its sides.
//!
//! One segment proves nothing: [`NAMED`] must say so more often than not. A sea in which nothing is heard proves nothing
//! either way. With one left out the remaining three are looked at; with two, no direction can be told. One of three that is
//! late, or exchanged with another, is not observable: their delays always fit some direction. Cost: about 2000 instructions
//! a segment beside the search for the peaks.

use super::leak::{self, Seen};
use super::plan::{Band, Plan};
use super::search::{PairPeaks, SearchWork};
use super::wavefront::{self, Direction, PAIR_COUNT, Used};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::wire::{Fault, FaultCode, Message};

/// Segments that must say that a channel is sick, beyond those that say the opposite: 4 s at the usual step.
const NAMED: u8 = 8;
/// Segments that must say that a channel leaks for its bearings to be doubted where a vessel hides that.
const SUSPECTED: u8 = 3;
/// Segments in a row in which two hydrophones are against two, or all hear the same at once, after which that is told.
const DIVIDED: u8 = 4;
/// Segments in a row in which nothing is wrong, after which a channel is well again.
const WELL: u8 = 16;
/// Correlations below so many standard deviations of noise say nothing (the highest of 500 lags of noise is 3).
const STRONG: f32 = 10.0;
/// Least share of the other pairs' correlation that a healthy hydrophone's pairs have. The image in the surface leaves half
/// of it to pairs that lie upright.
const DEAF: f32 = 0.35;
/// How much deeper than high a correlation is that is called negative.
const INVERTED: f32 = 1.5;
/// Share of the pairs' highest magnitudes below which a direction explains little (the three pairs of an inverted hydrophone hear up to half of
/// theirs beside a trough: three quarters in all; passes of one vessel have 0.88 and more), what it explains at least with a hydrophone the
/// other way round that is inverted, and how much more than without.
const LITTLE: f32 = 0.78;
const EXPLAINED: f32 = 0.6;
const TURNED: f32 = 1.25;
/// Segments in a row in which nothing but a leak explains what seems to be one, after which it need not stay.
const ALONE: u8 = 4;
/// How much the delays of a vessel change, in samples, until no echo of it passes for a leak any more.
const MOVED_SAMPLES: f32 = 2.0 * leak::APART_SAMPLES;

/// All hydrophones.
const ALL: u8 = (1 << CHANNELS) - 1;

/// What can be wrong, and the fault that says so.
const KINDS: [FaultCode; 3] = [FaultCode::OwnNoise, FaultCode::Inverted, FaultCode::Leaking];
const INVERTED_KIND: usize = 1;
pub(super) const LEAKING: usize = 2;

/// What one segment says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sign {
    /// Too little is heard.
    Nothing,
    /// All is well.
    Well,
    /// Place in [`KINDS`], and hydrophone.
    Sick(usize, usize),
    /// Two hydrophones hear the opposite of what two others hear, or all hear the same at once.
    Divided,
}

/// What the segments so far say.
#[derive(Clone, Debug)]
pub(crate) struct Sick {
    /// For and against, by kind and hydrophone.
    counts: [[u8; CHANNELS]; KINDS.len()],
    well: u8,
    /// Segments in a row that say [`Sign::Divided`].
    divided: u8,
    /// Bit h: hydrophone h is left out.
    out: u8,
    /// Segments in a row that saw a leak which nothing else explains.
    alone: u8,
    /// Where the vessel was when a leak was first seen.
    seen_from: Option<Direction>,
    /// Hydrophone that is tried the other way round next.
    tried: u8,
    /// Bit h: hydrophone h seemed to hear another through its channel, and nothing has denied it since.
    suspected: u8,
    /// Segments that saw two hear each other, beyond those that saw one hear the other.
    mutual: u8,
    /// Bit h: hydrophone h hears one that is left out, and is listened to all the same.
    tainted: u8,
}

impl Sick {
    pub(crate) const fn new() -> Self {
        Self {
            counts: [[0; CHANNELS]; KINDS.len()],
            well: 0,
            divided: 0,
            out: 0,
            alone: 0,
            seen_from: None,
            tried: 0,
            suspected: 0,
            mutual: 0,
            tainted: 0,
        }
    }

    /// Whether a hydrophone that is listened to hears one that is left out through its channel.
    pub(super) fn is_tainted(&self) -> bool {
        self.tainted & !self.out != 0
    }

    /// Hydrophone to try the other way round.
    pub(crate) fn tried(&self) -> usize {
        usize::from(self.tried) % CHANNELS
    }

    /// What a segment says in which a direction explains little: whether the one tried is inverted. If not, the next one is tried.
    pub(crate) fn turned(&mut self, is: bool) -> Sign {
        if is {
            return Sign::Sick(INVERTED_KIND, self.tried());
        }
        self.tried = self.tried.wrapping_add(1);
        Sign::Nothing
    }

    /// Bit h: hydrophone h seemed to hear another through its channel, until [`Self::deny`].
    pub(super) fn suspected(&self) -> u8 {
        self.suspected
    }

    /// No hydrophone hears another where that would show.
    pub(super) fn deny(&mut self) {
        self.suspected = 0;
    }

    /// Bit h: hydrophone h is left out.
    pub(crate) fn out(&self) -> u8 {
        self.out
    }

    /// Takes what a segment says; `vessel` is where it is, where that is known, `seen` what is known of a leak.
    #[inline(never)]
    pub(crate) fn take(
        &mut self,
        plan: &Plan,
        sign: Sign,
        vessel: Option<&Direction>,
        seen: Seen,
        index: u64,
        sink: &mut impl FnMut(Message),
    ) {
        if sign == Sign::Nothing {
            return;
        }
        if let Sign::Sick(LEAKING, _) = sign {
            self.alone = if seen.alone { self.alone.saturating_add(1) } else { 0 };
            let mutual = seen.other.is_some();
            self.mutual = if mutual { (self.mutual + 1).min(NAMED) } else { self.mutual.saturating_sub(1) };
        }
        // Both are asked: the second takes note of where the vessel is.
        let moved = self.moved(plan, sign, vessel) | (self.alone >= ALONE);
        let channel = |h: usize| i64::from(plan.channels.get(h).copied().unwrap_or(0));
        self.well = if sign == Sign::Well { self.well.saturating_add(1) } else { 0 };
        self.divided = if sign == Sign::Divided { self.divided.saturating_add(1) } else { 0 };
        if self.divided == DIVIDED {
            sink(Message::Fault(Fault { code: FaultCode::Inconsistent, index, value: i64::from(DIVIDED) }));
        }
        for (kind, code) in KINDS.into_iter().enumerate() {
            for h in 0..CHANNELS {
                if self.counted(sign, kind, h, moved) {
                    sink(Message::Fault(Fault { code, index, value: channel(h) }));
                    // The one that it hears is no better, but three are needed.
                    if let Some(other) = seen.other.filter(|_| kind == LEAKING && self.mutual >= SUSPECTED) {
                        self.tainted |= 1 << other;
                        sink(Message::Fault(Fault { code, index, value: channel(other) }));
                    }
                }
            }
        }
        if self.well >= WELL {
            let [.., leaking] = self.counts;
            // A leak is not looked for while its receiver is left out.
            let back = |h: usize| self.out >> h & 1 == 1 && leaking.get(h) != Some(&NAMED);
            for h in (0..CHANNELS).filter(|h| back(*h)) {
                sink(Message::Fault(Fault { code: FaultCode::ChannelBack, index, value: channel(h) }));
            }
            self.out = (0..CHANNELS).filter(|h| !back(*h)).fold(0, |out, h| out | self.out & 1 << h);
        }
    }
}

impl Sick {
    /// Counts a sign for one kind and hydrophone; whether that is left out from now on. Apart: twelve copies are 2 kB.
    #[inline(never)]
    fn counted(&mut self, sign: Sign, kind: usize, h: usize, moved: bool) -> bool {
        let Some(count) = self.counts.get_mut(kind).and_then(|counts| counts.get_mut(h)) else {
            return false;
        };
        if sign == Sign::Sick(kind, h) {
            *count = (*count + 1).min(NAMED);
            if kind == LEAKING && *count >= SUSPECTED {
                self.suspected |= 1 << h;
            }
        } else if kind != LEAKING || self.out >> h & 1 == 0 {
            *count = count.saturating_sub(1);
        }
        let named = *count == NAMED && self.out >> h & 1 == 0 && (kind != LEAKING || moved);
        if named {
            self.out |= 1 << h;
        }
        named
    }

    /// Whether the vessel has moved since a leak was first seen.
    fn moved(&mut self, plan: &Plan, sign: Sign, vessel: Option<&Direction>) -> bool {
        let [.., leaking] = &self.counts;
        if leaking.iter().all(|n| *n == 0) {
            self.seen_from = None;
        }
        let (Sign::Sick(LEAKING, _), Some(u)) = (sign, vessel) else { return false };
        let from = self.seen_from.get_or_insert(*u);
        let by = [u[0] - from[0], u[1] - from[1], u[2] - from[2]];
        let longest = plan.crossing_s.iter().fold(0.0f32, |a, b| a.max(*b)) * plan.rate_hz;
        wavefront::dot(&by, &by) * longest * longest > MOVED_SAMPLES * MOVED_SAMPLES
    }
}

/// What the extremes of the pairs of the hydrophones `used` (bit h: hydrophone h; three or four of them) say; `deviation` is
/// that of a summed correlation under noise alone.
pub(crate) fn sign(peaks: &[PairPeaks; PAIR_COUNT], deviation: f32, used: u8) -> Sign {
    let strong = STRONG * deviation;
    let pairs = || PAIRS.iter().zip(peaks).filter(|((a, b), _)| used >> a & used >> b & 1 == 1);
    let height = |p: &PairPeaks| p.peak.max(-p.trough);
    let mean = |h: usize, with: bool| {
        let of = |((a, b), _): &(&(usize, usize), &PairPeaks)| (*a == h || *b == h) == with;
        let (sum, n) = pairs().filter(of).fold((0.0, 0.0f32), |(sum, n), (_, p)| (sum + height(p), n + 1.0));
        sum / n.max(1.0)
    };
    let each = || (0..CHANNELS).filter(|h| used >> h & 1 == 1);
    // By chance never, however weak.
    if used == ALL && peaks.iter().all(|p| p.at_once) {
        return Sign::Divided;
    }
    for h in each() {
        let (own, others) = (mean(h, true), mean(h, false));
        if others > strong && own < DEAF * others {
            return Sign::Sick(0, h);
        }
    }
    if pairs().any(|(_, p)| height(p) < strong) {
        return Sign::Nothing;
    }
    let negative = |p: &PairPeaks| -p.trough > INVERTED * p.peak;
    let positive = |p: &PairPeaks| p.peak > INVERTED * -p.trough;
    // Whether those of the set hear the opposite of what the rest hears.
    let against = |set: u8| {
        pairs().all(|((a, b), p)| if set >> a & 1 == set >> b & 1 { positive(p) } else { negative(p) })
    };
    if let Some(h) = each().find(|h| against(1 << h)) {
        return Sign::Sick(1, h);
    }
    // Hydrophone 0 with each of the others; with two left out there is nothing to be against.
    if used == ALL && (1..CHANNELS).any(|h| against(1 | 1 << h)) {
        return Sign::Divided;
    }
    Sign::Well
}

/// What the pairs of a segment say with what is left out already, and the channels `dead`, of which nothing can be said.
#[inline(never)]
pub(crate) fn heard(sick: &Sick, dead: u8, peaks: &[PairPeaks; PAIR_COUNT], deviation: f32) -> Sign {
    let all = if dead == 0 { sign(peaks, deviation, ALL) } else { Sign::Nothing };
    // Where a vessel and its image in the surface correlate both ways, a channel that was left out has not come back.
    let unclear = |h: usize| {
        let of = PAIRS.iter().zip(peaks).filter(|((a, b), _)| *a == h || *b == h);
        sick.out() >> h & 1 == 1 && !of.into_iter().all(|(_, p)| p.peak > INVERTED * -p.trough)
    };
    let all = if all == Sign::Well && (0..CHANNELS).any(unclear) { Sign::Nothing } else { all };
    let rest = ALL & !(sick.out() | dead);
    let known = match all {
        Sign::Sick(_, h) => sick.out() >> h & 1 == 1,
        Sign::Nothing => rest != ALL,
        Sign::Well | Sign::Divided => false,
    };
    if !known || rest.count_ones() < 3 {
        return all;
    }
    match sign(peaks, deviation, rest) {
        another @ Sign::Sick(..) => another,
        _ => all,
    }
}

/// Whether a hydrophone taken the other way round explains what none else does.
pub(crate) struct Turned<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) band: &'a Band,
    /// Summed correlation of the direction found; 0 where there is none.
    pub(crate) found: f32,
    /// The same if each pair had its highest magnitude.
    pub(crate) most: f32,
}

impl Turned<'_> {
    /// Sum of the pairs' highest magnitudes.
    pub(crate) fn most(peaks: &[PairPeaks; PAIR_COUNT]) -> f32 {
        peaks.iter().map(|p| p.peak.max(-p.trough)).sum()
    }

    /// Whether to try: the direction found explains little.
    pub(crate) fn doubtful(&self) -> bool {
        self.found < LITTLE * self.plan.in_phase * self.most
    }

    /// Tries hydrophone `h`. The correlations are used up.
    #[inline(never)]
    pub(crate) fn is(&self, search: &mut SearchWork, h: usize) -> bool {
        search.turn(h);
        let u = search.best(self.plan, self.band, self.plan.curvature);
        let (curvature, _) = self.plan.curvature_from(&u);
        let tau = wavefront::pair_delays(&wavefront::arrivals(&self.plan.geometry, &u, curvature));
        let turned: f32 = tau.iter().enumerate().map(|(p, tau)| search.pair_value(self.plan, p, *tau)).sum();
        turned > TURNED * self.found && turned > EXPLAINED * self.most
    }
}

/// The hydrophones to listen to, where there are enough.
pub(crate) fn used(sick: &Sick, dead: u8) -> Option<Used> {
    Used::without(sick.out | dead)
}

#[cfg(test)]
#[path = "sick_tests.rs"]
mod tests;
