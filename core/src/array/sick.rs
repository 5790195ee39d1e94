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
//!   sender's delays with the two others, and both stay while the vessel's own delays change: an echo off the bottom that
//!   reaches one when the other hears the vessel looks the same for a while.
//!
//! Two inverted hydrophones correlate with each other and negatively with the rest, who are as many: which of them they are
//! is not observable, and no direction is told.
//!
//! One segment proves nothing: [`NAMED`] must say so more often than not. A sea in which nothing is heard proves nothing
//! either way. With one left out the remaining three are looked at; with two, no direction can be told. One of three that is
//! late, or exchanged with another, is not observable: their delays always fit some direction. Cost: about 2000 instructions
//! a segment beside the search for the peaks.

use super::plan::{BINS, Band, Plan};
use super::search::{PairPeaks, SearchWork};
use super::wavefront::{self, Direction, PAIR_COUNT, Used};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::math::f32 as m;
use crate::wire::{Fault, FaultCode, Message};

/// Segments that must say that a channel is sick, beyond those that say the opposite: 4 s at the usual step.
const NAMED: u8 = 8;
/// Segments in a row in which two hydrophones are against two, after which that is told.
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
/// Share of the pairs' highest magnitudes below which a direction explains little, what it explains at least with a hydrophone the other
/// way round that is inverted, and how much more than without.
const LITTLE: f32 = 0.7;
const EXPLAINED: f32 = 0.6;
const TURNED: f32 = 1.25;
/// Least correlation at no delay beyond the vessel's own, standard deviations of noise and share of full coherence, and the
/// share of it, times the vessel's coherence, that the receiver's other pairs must have at the sender's delays, and how many
/// deviations, in the mean of the two.
const LEAK: f32 = 8.0;
const LEAST_LEAK: f32 = 0.04;
const RECEIVED: f32 = 0.35;
const RECEIVED_SD: f32 = 2.0;
/// Nearer than this to no delay, in samples, a sound hides what leaks, and an echo passes for it.
const APART_SAMPLES: f32 = 3.0;

/// How far below the horizon a bottom's echo comes from, at most: so many times as far as the vessel is above it, and this
/// angle more, radians. At a bottom close below the array it is as far.
const ECHO_STEEPER: f32 = 1.5;
const ECHO_RAD: f32 = 0.05;
/// Steps from the one to the other, and share of what seems to leak that an echo has in the other pairs.
const ECHOES: usize = 32;
const ECHOED: f32 = 0.4;
/// Other pairs, of five, that must hear it apart from the vessel.
const LEAST_PAIRS: f32 = 3.0;
/// Delays, of six, at which the rest must hear it apart from the vessel.
const LEAST_ECHOES: f32 = 4.0;
/// How much the delays of a vessel change, in samples, until no echo of it passes for a leak any more.
const MOVED_SAMPLES: f32 = 2.0 * APART_SAMPLES;

/// All hydrophones.
const ALL: u8 = (1 << CHANNELS) - 1;

/// What can be wrong, and the fault that says so.
const KINDS: [FaultCode; 3] = [FaultCode::OwnNoise, FaultCode::Inverted, FaultCode::Leaking];
const INVERTED_KIND: usize = 1;
const LEAKING: usize = 2;

/// What one segment says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sign {
    /// Too little is heard.
    Nothing,
    /// All is well.
    Well,
    /// Place in [`KINDS`], and hydrophone.
    Sick(usize, usize),
    /// Two hydrophones hear the opposite of what two others hear.
    Divided,
}

/// What the segments so far say.
#[derive(Clone, Debug)]
pub(crate) struct Sick {
    /// For and against, by kind and hydrophone.
    counts: [[u8; CHANNELS]; KINDS.len()],
    well: u8,
    /// Segments in a row in which two are against two.
    divided: u8,
    /// Bit h: hydrophone h is left out.
    out: u8,
    /// Where the vessel was when a leak was first seen.
    seen_from: Option<Direction>,
    /// Hydrophone that is tried the other way round next.
    tried: u8,
}

impl Sick {
    pub(crate) const fn new() -> Self {
        Self { counts: [[0; CHANNELS]; KINDS.len()], well: 0, divided: 0, out: 0, seen_from: None, tried: 0 }
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

    /// Bit h: hydrophone h is left out.
    pub(crate) fn out(&self) -> u8 {
        self.out
    }

    /// Takes what a segment says; `vessel` is where it is, where that is known.
    #[inline(never)]
    pub(crate) fn take(
        &mut self,
        plan: &Plan,
        sign: Sign,
        vessel: Option<&Direction>,
        index: u64,
        sink: &mut impl FnMut(Message),
    ) {
        if sign == Sign::Nothing {
            return;
        }
        let moved = self.moved(plan, sign, vessel);
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
        self.found < LITTLE * self.most
    }

    /// Tries hydrophone `h`. The correlations are used up.
    #[inline(never)]
    pub(crate) fn is(&self, search: &mut SearchWork, h: usize) -> bool {
        search.turn(h);
        let u = search.best(self.plan, self.band, self.plan.curvature);
        let tau = wavefront::pair_delays(&wavefront::arrivals(&self.plan.geometry, &u, self.plan.curvature));
        let turned: f32 = tau.iter().enumerate().map(|(p, tau)| search.pair_value(self.plan, p, *tau)).sum();
        turned > TURNED * self.found && turned > EXPLAINED * self.most
    }
}

/// What the correlations say beyond the vessel found at these delays, of this coherence.
pub(crate) struct Beyond<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) search: &'a SearchWork,
    pub(crate) tau: &'a [f32; PAIR_COUNT],
    /// Where it is.
    pub(crate) direction: &'a Direction,
    pub(crate) coherence: &'a [f32; BINS],
    /// Its mean.
    pub(crate) mean: f32,
    pub(crate) deviation: f32,
}

impl Beyond<'_> {
    /// Whether one hydrophone hears another.
    pub(crate) fn sign(&self) -> Sign {
        (0..PAIR_COUNT).find_map(|p| self.receiver(p)).map_or(Sign::Well, |h| Sign::Sick(LEAKING, h))
    }

    /// The hydrophone of pair `p` that hears the other one, if there is one.
    fn receiver(&self, p: usize) -> Option<usize> {
        let (a, b) = *PAIRS.get(p)?;
        let Band { high, incoherent, .. } = self.plan.whole;
        let least = (LEAK * self.deviation).max(LEAST_LEAK * high.saturating_sub(incoherent) as f32);
        let hidden = m::abs(*self.tau.get(p)?) * self.plan.rate_hz < APART_SAMPLES;
        let leak = self.excess(p, 0.0)?;
        if hidden || leak < least || self.echoed(p, leak) {
            return None;
        }
        // What one receives from the other stands with the remaining two at the sender's delays. A second sound from straight
        // across the pair does not.
        let least = (RECEIVED * leak * self.mean).max(RECEIVED_SD * self.deviation);
        let received = |to: usize, from: usize| {
            let others = (0..CHANNELS).filter(|h| *h != a && *h != b);
            let excess = others.filter_map(|h| {
                let (q, sign) = self.pair(to, h)?;
                self.excess(q, sign * self.delay(from, h)?)
            });
            excess.sum::<f32>() > 2.0 * least
        };
        let receiver =
            [(a, b), (b, a)].into_iter().find(|(to, from)| received(*to, *from)).map(|(to, _)| to)?;
        (!self.echoes(p, receiver, leak)).then_some(receiver)
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
            let near = |a: f32, b: f32| m::abs(a - b) * self.plan.rate_hz < APART_SAMPLES;
            if !near(echo.get(p).copied().unwrap_or(0.0), 0.0) {
                continue;
            }
            may = true;
            let (mut sum, mut pairs) = (0.0, 0.0f32);
            for (q, (delay, own)) in echo.iter().zip(self.tau).enumerate() {
                if q != p && !near(*delay, *own) {
                    sum += self.search.pair_value(self.plan, q, *delay);
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
    fn echo(&self, step: usize) -> [f32; CHANNELS] {
        let elevation = m::asin(self.direction[2].clamp(0.0, 1.0));
        let steepest = ECHO_STEEPER * elevation + ECHO_RAD;
        let below = elevation + (steepest - elevation) * step as f32 / ECHOES as f32;
        wavefront::arrivals(&self.plan.geometry, &self.seen_from_below(below), 0.0)
    }

    /// Whether what seems to leak into one of pair `p` is an echo of the vessel off the bottom that reaches it when the other one hears the
    /// vessel itself. Then the echo is heard by the rest as well, as strongly and as much later as its direction wants.
    #[inline(never)]
    fn echoes(&self, p: usize, receiver: usize, leak: f32) -> bool {
        let Some((a, b)) = PAIRS.get(p) else { return false };
        let sender = if receiver == *a { *b } else { *a };
        let vessel = wavefront::arrivals(&self.plan.geometry, self.direction, 0.0);
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
                let apart = |delay: &f32| m::abs(delay - own) * self.plan.rate_hz > APART_SAMPLES;
                for delay in [later, earlier].into_iter().filter(apart) {
                    sum += self.search.pair_value(self.plan, q, delay);
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
        let step = self.plan.bin_rad_s * (self.tau.get(pair)? - delay);
        let Band { high, incoherent, .. } = self.plan.whole;
        let ((mut s, mut c), (ds, dc)) = (m::sin_cos(step * incoherent as f32), m::sin_cos(step));
        let mut own = 0.0;
        for coherence in self.coherence.get(incoherent..high)? {
            own += coherence * c;
            (s, c) = (s * dc + c * ds, c * dc - s * ds);
        }
        Some(self.search.pair_value(self.plan, pair, delay) - own)
    }
}

/// The hydrophones to listen to, where there are enough.
pub(crate) fn used(sick: &Sick, dead: u8) -> Option<Used> {
    Used::without(sick.out | dead)
}

#[cfg(test)]
#[path = "sick_tests.rs"]
mod tests;
