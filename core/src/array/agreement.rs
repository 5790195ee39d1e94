//! Whether the pairs' own delays agree with the common direction.
//!
//! Enters: a segment's direction and what each pair shows by itself. Leaves: by how much to doubt the bearing, and the fault
//! `Inconsistent` where the doubt lasts: channels exchanged or late, hydrophones elsewhere than told, a sound that comes from no
//! direction at all.
//!
//! * Contradicted: three pairs at least have their highest correlations elsewhere than the direction, or another source that is known, wants
//!   them. Nothing is
//!   said of directions then; where it lasts, not until [`AGREEING`] segments have agreed.
//! * Strained: four arrival times have one degree of freedom beyond level and direction (how fast the sound crosses the array).
//!   What is left in it is noise and multipath, which change from segment to segment, or an error that stays ([`super::strain`]), beyond what was told uncertain; the fault also wants delays that close
//!   their triangles better than that, as another vessel's beside this one does not leave them. An error that shows so
//!   much in this one direction has as much in the two that turn the bearing, and nothing says how much: the bearing is
//!   stated with [`UNSEEN`] times it. A vessel heard apart from its image strains the pairs by itself, but not where it is found
//!   without it: that shows a late channel in a few segments. A late channel that the direction hides is not seen until the vessel has moved.
//!
//! Of exchanged channels nothing is told either, until they are heard to be in order again; or the vessels that showed it are gone and others have been
//! heard without contradiction for two minutes: then bearings are told again, with a flag that they may be mirrored.
//!
//! Cost: about 300 instructions a segment.

use super::change::{Change, Scatter, Verdict};
use super::estimate::{Context, Found};
use super::exchange::Exchange;
use super::followed::Followed;
use super::plan::Plan;
use super::report;
use super::search::{PairPeaks, SearchWork};
use super::strain::{self, Strain, TOLD_SD};
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::math::f32 as m;
use crate::wire::{Fault, FaultCode, Message};

/// Segments in a row whose pairs contradict the direction before the fault is raised: 2 s at the usual step.
const CONTRADICTING: u16 = 4;
/// Pairs that contradict a direction.
const CONTRADICTING_PAIRS: usize = 3;
/// Segments that agree until directions are told again.
const AGREEING: u16 = 8;
/// Segments that agree, without the vessels that showed an exchange, until it is given up: two minutes at the usual step.
const GIVEN_UP: u8 = 240;
/// A pair's peak farther than this from where the direction wants it is another one, samples, beyond what positions told uncertain
/// may make of it, and how far from half-way vessel and image are ([`split`]).
const ELSEWHERE_SAMPLES: f32 = 0.8;
/// Uncertainty of a pair's delay beside that, samples: pairs that lie level tell more than those that may go from the one to the other.
const JOINED: f32 = 0.3;
/// A single step of `refine` goes no farther than half a sample: beyond this the peak itself tells a pair's delay, samples.
const BESIDE_SAMPLES: f32 = 0.45;
/// A strain below this many samples is left to multipath and the wavefront's curvature.
const LEAST_SAMPLES: f32 = 0.12;
/// The same of a vessel found without its image: all passes have less than 0.071, 99 in 100 less than 0.044.
const LEAST_OF_VESSEL_SAMPLES: f32 = 0.08;
/// Half of the angle between vessel and image from which on pairs hear now the one and now the other, resolutions: of 9000 segments of known depth that are
/// nearer strains are below a tenth of what such would make, or of 0.03 samples.
const APART_RESOLUTIONS: f32 = 1.3;
/// Error assumed in the bearing's own arrival times for a lasting strain, in units of it: the ratio of two such errors to the
/// third is within this in nine of ten directions.
const UNSEEN: f32 = 4.0;

/// By how much a bearing is doubted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Doubt {
    /// Factor of its quality.
    pub(super) quality: f32,
    /// Variance of the arrival times that noise does not explain, times the hydrophones, s².
    pub(super) unexplained_s2: f32,
}

impl Doubt {
    pub(super) const NONE: Self = Self { quality: 1.0, unexplained_s2: 0.0 };

    /// The greater of two.
    pub(super) fn or(self, other: Self) -> Self {
        Self {
            quality: self.quality.min(other.quality),
            unexplained_s2: self.unexplained_s2.max(other.unexplained_s2),
        }
    }

    /// Of arrival times of which noise leaves so much unexplained, s².
    fn strained(s2: f32) -> Self {
        Self { quality: 0.1, unexplained_s2: CHANNELS as f32 * s2 }
    }
}

/// What the segments before showed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    /// Of what is heard, and of vessels without their image.
    strain: Strain,
    of_vessel: Strain,
    /// Whether the last segment's vessel strains as much as a fault does.
    vessel_strains: bool,
    /// Segments in a row that contradict, or are strained.
    doubted: u16,
    /// Segments that must agree until directions are told again.
    withheld: u16,
    /// Segments since a vessel was heard that has shown an exchange, in which what is heard agreed.
    unseen: u8,
    /// Whether an exchange was given up that nobody saw end.
    given_up: bool,
    /// Whether channels changed, by the strongest source.
    change: Change,
    /// Whether two were exchanged, by all that are known.
    exchange: Exchange,
}

/// Most depth of vessels, in units of the one assumed.
pub(super) const DEEPEST: f32 = 2.0;

/// How far a vessel is, at most, from half-way between it and its image in the surface, radians.
#[inline(never)]
pub(super) fn half_apart(plan: &Plan, direction: &Direction) -> f32 {
    let up = direction[2].min(1.0);
    m::abs(up) * m::sqrt(1.0 - up * up) * DEEPEST * plan.vessel_over_array_depth
}

/// How far a vessel's own delay of each pair may lie from that half-way between it and its image, samples: close by they are two peaks with
/// a valley between them, and the common direction may be that of either.
#[inline(never)]
fn split(context: &Context<'_>, direction: &Direction) -> [f32; PAIR_COUNT] {
    let plan = context.plan;
    let up = wavefront::tangents(direction).1;
    let half = half_apart(plan, direction);
    let gradient = wavefront::pair_delays(&wavefront::gradient(&plan.geometry, direction, &up, 0.0));
    gradient.map(|g| m::abs(g) * half * plan.rate_hz)
}

impl Agreement {
    pub(super) const fn new() -> Self {
        Self {
            strain: Strain::NONE,
            of_vessel: Strain::NONE,
            vessel_strains: false,
            doubted: 0,
            withheld: 0,
            unseen: 0,
            given_up: false,
            change: Change::new(),
            exchange: Exchange::NEW,
        }
    }

    /// Whether channels may be exchanged, and nothing that is heard could tell.
    pub(super) fn given_up(&self) -> bool {
        self.given_up
    }

    /// Takes that samples are missing.
    pub(super) fn gap(&mut self) {
        self.exchange.gap();
    }

    /// Takes what was stated of a bearing that was not doubted.
    pub(super) fn stated(&mut self, scatter: Scatter) {
        self.change.stated(scatter);
    }

    /// How much to doubt what three hydrophones tell, by what four told before.
    pub(super) fn of_three(&self, context: &Context<'_>) -> Option<Doubt> {
        match self.change.verdict_of_three(context.plan, context.index, context.band.used) {
            Verdict::Withhold => None,
            Verdict::Doubt(s2) => Some(Doubt::strained(s2)),
            Verdict::Tell => Some(Doubt::NONE),
        }
    }

    /// Takes a segment, whether its direction is of an `other` source that is followed or `away` from where the strongest was moments ago, and
    /// those that it is not of; how much to doubt it, `None` where the pairs let none be told. All four hydrophones are used.
    pub(super) fn take(
        &mut self,
        context: &Context<'_>,
        found: &Found,
        (other, away, others, segment): (bool, bool, &Followed, u32),
        peaks: &[PairPeaks; PAIR_COUNT],
        search: &SearchWork,
        sink: &mut impl FnMut(Message),
    ) -> Option<Doubt> {
        let plan = context.plan;
        let strong = 8.0 * context.deviation(context.bins());
        let elsewhere = ELSEWHERE_SAMPLES + TOLD_SD * plan.position_sd_s * plan.rate_hz;
        let split = split(context, &found.refined.direction);
        let clear = peaks.iter().all(|own| own.peak > strong);
        let told = self.change.is_told();
        if clear {
            let before = self.exchange.sure();
            self.exchange.take(context, (peaks, search), &found.refined.direction, (others, segment));
            if self.exchange.sure() != before {
                // What was exchanged unseen by all is exchanged back.
                if before.is_none() && self.change.exchanged().is_some() {
                    self.exchange.forget();
                }
                self.change.set_exchanged(self.exchange.sure());
            }
        }
        let weight = split.map(|apart| 1.0 / (JOINED * JOINED + apart * apart));
        let mut delays = found.refined.pair_delay;
        let mut contradicting = 0;
        for (p, ((tau, own), delay)) in found.tau.iter().zip(peaks).zip(&mut delays).enumerate() {
            let aside = m::abs(own.delay_s - tau) * plan.rate_hz;
            let apart = split.get(p).copied().unwrap_or(0.0);
            if own.peak <= strong || aside <= BESIDE_SAMPLES {
                continue;
            }
            // Another source, whose peak says nothing of this one.
            if others.explain(context, segment, (p, own.delay_s), (elsewhere + apart, false)) {
                continue;
            }
            if aside > BESIDE_SAMPLES + 2.0 * apart {
                *delay = own.delay_s;
            }
            if aside > elsewhere + apart {
                contradicting += usize::from(own.peak > 1.5 * search.pair_value(plan, p, *tau));
            }
        }
        // Peaks of several sources are of no arrival times at all: what was sure before still is.
        let apart = split.iter().fold(elsewhere, |most, apart| most.max(elsewhere + apart));
        let closure = report::closure(&delays);
        let closed = closure * plan.rate_hz < apart;
        // Of three pairs that a late hydrophone is in, one may be at the edge of what contradicts.
        let enough = CONTRADICTING_PAIRS - usize::from(self.doubted > 0 && !closed);
        let contradicted = contradicting >= enough;
        let strain = if clear && !contradicted { self.strained(context, found, &delays) } else { None };
        let (verdict, mut changed) = match (clear, closed) {
            (true, true) => self.change.take(context, found, (other, others.any()), &delays, &weight),
            (true, false) if self.change.is_told() || self.change.is_suspected(plan, context.index) => {
                (self.change.verdict(), false)
            }
            // What is suddenly elsewhere, and the pairs do not agree of it, may be channels that were exchanged near a vessel.
            (true, false) if away && !other => (Verdict::Withhold, false),
            _ => (Verdict::Tell, false),
        };
        // Another vessel that becomes the strongest may look like an exchange.
        if changed && self.change.exchanged().is_some_and(|order| self.exchange.denies(order)) {
            self.change.set_exchanged(None);
            changed = false;
        }
        if changed || self.exchange.sure().is_some() && self.change.exchanged().is_none() {
            self.exchange.agree(self.change.exchanged());
            self.change.set_exchanged(self.exchange.sure().or(self.change.exchanged()));
        }
        if self.change.exchanged().is_none() || self.exchange.witnessed() {
            self.unseen = 0;
        } else if clear && closed && !contradicted {
            self.unseen += 1;
            if self.unseen >= GIVEN_UP {
                self.exchange.forget();
                self.change.set_exchanged(None);
                (self.unseen, self.given_up) = (0, true);
            }
        }
        // What strains delays that are of no arrival times as much is another vessel, which some pairs hear with this one and some apart.
        let strains = strain
            .is_some_and(|(s2, lasts)| lasts && CHANNELS as f32 * UNSEEN * UNSEEN * closure * closure < s2);
        let vessel_strains = core::mem::take(&mut self.vessel_strains);
        let doubtful = contradicted || (strains && self.strain.is_of_many()) || vessel_strains;
        let lasts = doubtful && self.doubted.saturating_add(1) == CONTRADICTING && !self.change.is_told();
        if changed || !told && self.exchange.sure().is_some() || lasts {
            let value = i64::from(CONTRADICTING);
            sink(Message::Fault(Fault { code: FaultCode::Inconsistent, index: context.index, value }));
        }
        if doubtful {
            self.doubted = self.doubted.saturating_add(1);
            if contradicted && self.doubted >= CONTRADICTING {
                self.withheld = AGREEING;
            }
        } else {
            self.doubted = 0;
            self.withheld = self.withheld.saturating_sub(1);
        }
        let changed = match verdict {
            _ if contradicted || self.withheld > 0 || self.exchange.seems() => return None,
            Verdict::Withhold => return None,
            Verdict::Doubt(s2) => Some(s2),
            Verdict::Tell => None,
        };
        let s2 = strain.map(|(s2, _)| s2).into_iter().chain(changed).reduce(f32::max);
        Some(s2.map_or(Doubt::NONE, Doubt::strained))
    }

    /// Takes the arrivals' strain into the means; the variance to assume for it, and whether it may be a fault.
    fn strained(
        &mut self,
        context: &Context<'_>,
        found: &Found,
        delays: &[f32; PAIR_COUNT],
    ) -> Option<(f32, bool)> {
        let plan = context.plan;
        let direction = &found.refined.direction;
        let rise = m::abs(direction[2]);
        // Share of what vessel and image strain where pairs hear the one or the other: two that all hear as one strain nothing.
        let (depth, share) = match context.depth {
            Some((depth_m, _)) => {
                let level = m::sqrt((1.0 - rise * rise).max(0.0));
                let depth = depth_m / plan.depth_m;
                let half = depth * rise * level / (APART_RESOLUTIONS * plan.whole.resolution);
                (depth, (half * half * half * half).min(1.0))
            }
            None => (plan.vessel_over_array_depth, 1.0),
        };
        let (now, lasting) = self.strain.take(plan, (delays, &found.tau));
        let least = LEAST_SAMPLES / plan.rate_hz;
        let limit = |image: f32| least * least + strain::explained(context, direction, image * rise * rise);
        let known = limit(share * depth);
        let lasting = lasting.filter(|s2| *s2 > known);
        let once = (share < 1.0 && now > known).then_some(now);
        let s2 = lasting.into_iter().chain(once).reduce(f32::max)?;
        // A fault is none of a depth that is not as told.
        let lasts = lasting.is_some_and(|s2| s2 > limit(plan.vessel_over_array_depth));
        Some((UNSEEN * UNSEEN * s2, lasts))
    }

    /// Takes the delays of a vessel found without its image and those that its direction has; how much to doubt it as well. A strain that what was told
    /// uncertain explains turns a bearing that an image was taken out of by as much as it is.
    #[inline(never)]
    pub(super) fn of_vessel(
        &mut self,
        context: &Context<'_>,
        direction: &Direction,
        delays: (&[f32; PAIR_COUNT], &[f32; PAIR_COUNT]),
    ) -> Doubt {
        let plan = context.plan;
        let (now, lasting) = self.of_vessel.take(plan, delays);
        let explained = strain::explained(context, direction, 0.0);
        let floor = |samples: f32| samples * samples / (plan.rate_hz * plan.rate_hz);
        let fault = floor(LEAST_SAMPLES) + explained + strain::untold(plan, direction);
        self.vessel_strains = lasting.is_some_and(|s2| s2 > fault) && self.of_vessel.is_of_many();
        let most = lasting.map_or(now, |s2| s2.max(now));
        let least = floor(LEAST_OF_VESSEL_SAMPLES);
        if most > least + explained {
            Doubt::strained(UNSEEN * UNSEEN * most)
        } else if most > least {
            Doubt { unexplained_s2: CHANNELS as f32 * most, ..Doubt::NONE }
        } else {
            Doubt::NONE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{hear, noisy, plan, source};
    use crate::wire::FaultCode;

    #[test]
    fn two_vessels_that_pairs_hear_now_apart_now_together_are_no_fault_of_channels() {
        let plan = plan(16_000.0);
        let mut said = 0;
        for n in 0..24u64 {
            let azimuth = 0.55 * n as f64;
            let apart = 0.12 + 0.02 * (n % 8) as f64;
            let mut sea = noisy(source(&plan, (azimuth, 0.35), 3.0, None, 16, 500 + n), n);
            for (sum, x) in sea.iter_mut().zip(source(&plan, (azimuth + apart, 0.3), 2.7, None, 16, 600 + n))
            {
                sum.iter_mut().zip(x).for_each(|(sum, x)| *sum += x);
            }
            let faults = hear(&plan, &sea).faults;
            said += faults.iter().filter(|f| f.0 == FaultCode::Inconsistent).count();
        }
        assert_eq!(said, 0);
    }
}
