//! Whether a channel was late, or channels changed places, from one moment to the next.
//!
//! Enters: the delays of each segment. Leaves: what changed, and how far to doubt what is heard since. Four arrival times have
//! three differences, so they give a vector whatever they are: the way against the sound, in units of its slowness. That of a
//! wavefront has length one, which is all that one segment can show ([`super::agreement`]); a channel that is late turns it as
//! a vessel would that stands elsewhere. But a vessel moves evenly:
//!
//! * A channel late by d moves the vector by d times the dual vector of its hydrophone, of which there are four; two exchanged
//!   channels move it to one of six places, three or four that change places at once to one of 17 more ([`super::order`]). From the track of up to [`KEPT`] segments before, all but the last, is known where
//!   it should be. What jumps to none of those places is another vessel.
//! * Where pairs hear a vessel apart from its image in the surface the vector goes up and down between the two from segment to segment:
//!   there a course is level, but for what a vessel's usual speed makes of it, and tells azimuths as sharply as elsewhere.
//! * From the first such segment on no direction is told, until [`SURE`] have said the same (a vessel that turns does not)
//!   or one has not, nor where pairs do not agree meanwhile. Then the fault `Inconsistent` says so. What may be either is taken for exchanged.
//! * Of a vessel heard for less than [`LEAST_KEPT`] segments before is known where it was and how fast vessels turn: that tells two exchanged channels, not
//!   a late one, nor (of one vessel; [`super::exchange`] does) more that change places: one of so many places is another vessel's by chance.
//! * Since then: with a late channel, bearings with an error as large as the delay; of exchanged channels none. What comes
//!   from other directions is strained by a change and not by a vessel that jumped, or jumps back: [`DECIDED`] ends it. Where a vessel and its image are
//!   heard apart they strain it as well, alike until it has turned.
//!   In a regular tetrahedron channels in another order strain nothing, and only the jump back tells.
//!
//! Where the strongest source is another one that is followed already, the course begins anew. What was wrong before anything was
//! heard is not seen here. Cost: about 2000 instructions a segment.

use super::agreement::{DEEPEST, half_apart};
use super::course::{Course, seconds};
use super::estimate::{Context, Found};
use super::jump::{
    EITHER, ELSEWHERE, EXCHANGED, JUMPED, JUMPED_SAMPLES, Jump, LATE, NOTHING, ORDERED, What, difference,
    duals, length, times, unit, vector,
};
use super::order::{heard, inverse};
use super::plan::Plan;
use super::wavefront::{self, Direction, PAIR_COUNT, Used};
use crate::block::CHANNELS;
use crate::math::f32 as m;

/// Segments kept, and least of them, without the newest, that tell where the next is.
const KEPT: usize = 8;
const LEAST_KEPT: usize = 3;
/// Longest time between two segments of one track, seconds.
const LONGEST_S: f32 = 2.5;
/// The same after a jump, of which segments may say nothing.
const LONGEST_JUMP_S: f32 = 6.0;
/// Segments that must say the same change, and most that may say another place or none after a jump.
const SURE: u8 = 3;
const STRAY: u8 = 2;
/// What multipath does to a delay at any time, samples; and where the surface's image is expected, whose fringes pull each hydrophone's
/// delay by itself, seconds: how much is the vessel's and the array's, at any rate of samples.
const FLOOR_SAMPLES: f32 = 0.05;
const FRINGED_S: f32 = 1.9e-6;
/// Standard deviation of what the vector goes up and down by where pairs hear a vessel and its image in the surface apart: upright pairs go from
/// one to the other, level ones stay half-way. In units of how far each is from there.
const HOP: f32 = 0.8;
/// From so many resolutions on they are heard apart: in 240 random passes, vessels 10 m to 2 km aside of arrays 30 to 400 m deep, at which upright pairs stay half-way.
const APART: f32 = 0.8;
/// Share of it that is in the level part of the vector, away from the array, for each unit of the vessel's height: level pairs tell that, and between the two
/// their delays differ by as much less; of a vessel high above by as much more.
const AWAY: f32 = 0.4;
/// Standard deviation of what multipath does to a delay where the vector's length is looked at, samples, and natural logarithm of the
/// likelihood ratio that ends a suspicion.
const STRAIN_SAMPLES: f32 = 0.15;
const DECIDED: f32 = 30.0;
/// Least delay of a late channel, in units of what the jump was taken for: a course of few segments, of which one may hold a part of the
/// jump, tells which channel is late, but not by how much.
const LEAST_LATE: f32 = 0.4;
/// A vessel that has turned so far is heard apart from its image by other pairs, radians.
const FRESH_RAD: f32 = 0.2;

/// What to do with a segment's direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Verdict {
    /// Nothing has changed.
    Tell,
    /// With this variance of the arrival times, s².
    Doubt(f32),
    /// Tell none.
    Withhold,
}

/// Variances of a bearing along the tangents, rad².
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Scatter {
    /// Of what is another from segment to segment; 0: nothing was told.
    pub(super) noise: [f32; 2],
    /// Of what paths put on it, for as long as the vessel is about there.
    pub(super) lasting: [f32; 2],
}

/// What the segments before showed. All zeros at the beginning.
#[derive(Clone, Copy, Debug)]
pub(super) struct Change {
    /// Newest first.
    past: [([f32; 3], u64); KEPT],
    kept: usize,
    /// What the last two bearings scatter, newest first: as in a course the last may hold the change itself, and errs by it.
    stated: [Scatter; 2],
    /// Where what was heard before a jump should be, since when.
    course: Course,
    /// How far from it the first segment was that jumped.
    jump: [f32; 3],
    since: u64,
    /// What seems to have changed, how many segments say so, and how many did not.
    seems: What,
    times: u8,
    strays: u8,
    /// What did change, by what delay (seconds), and what has been heard against that since.
    what: What,
    delay_s: f32,
    against: f32,
}

impl Change {
    pub(super) const fn new() -> Self {
        Self {
            past: [([0.0; 3], 0); KEPT],
            kept: 0,
            stated: [Scatter { noise: [0.0; 2], lasting: [0.0; 2] }; 2],
            course: Course::NONE,
            jump: [0.0; 3],
            since: 0,
            seems: NOTHING,
            times: 0,
            strays: 0,
            what: NOTHING,
            delay_s: 0.0,
            against: 0.0,
        }
    }

    /// Takes what was stated of an undoubted bearing.
    pub(super) fn stated(&mut self, scatter: Scatter) {
        if self.seems == NOTHING {
            let [last, _] = self.stated;
            self.stated = [scatter, last];
        }
    }

    /// What bearings before the last one scatter.
    #[inline(never)]
    fn usual(&self) -> Scatter {
        let [last, before] = self.stated;
        if before.noise[0] > 0.0 { before } else { last }
    }

    /// Takes a segment's delays and how much each counts, and whether they are those of an `other` source than the last one's and of one
    /// `among_others`; what to do with its direction, and whether a change has just become sure.
    #[inline(never)]
    pub(super) fn take(
        &mut self,
        context: &Context<'_>,
        found: &Found,
        (other, among_others): (bool, bool),
        delays: &[f32; PAIR_COUNT],
        weight: &[f32; PAIR_COUNT],
    ) -> (Verdict, bool) {
        let plan = context.plan;
        let duals = duals(plan);
        let arrived = times(delays, weight);
        let own = vector(plan, &duals, &arrived);
        let told = vector(plan, &duals, &times(&found.tau, weight));
        let expected = length(&told);
        self.hear(context, &duals, &own, &arrived, expected);
        let before = self.what;
        let lasted = self.past.first().map_or(f32::MAX, |(_, at)| seconds(plan, *at, context.index));
        let longest = if self.seems == NOTHING { LONGEST_S } else { LONGEST_JUMP_S };
        if other || self.kept > 0 && lasted > longest {
            (self.kept, self.seems, self.times, self.strays) = (0, NOTHING, 0, 0);
        }
        let floor_s = floor_s(plan);
        let floor = floor_s * length(&duals[0]) / plan.inv_c;
        let course = if self.seems == NOTHING {
            self.course(context, floor)
        } else {
            Some(self.course.later(seconds(plan, self.since, context.index)))
        };
        let usual = self.usual();
        // Where a vessel of which little was heard should be is uncertain by how fast it turns: that is as much as a late channel makes of it,
        // but less than most exchanged ones do.
        let few = self.kept <= LEAST_KEPT;
        let seems = match course {
            Some(course) if usual.noise[0] > 0.0 && !(few && (among_others || self.what != NOTHING)) => {
                let from = unit(&course.place);
                let across = wavefront::tangents(&from).0;
                let [c, s, _] = across;
                let late = JUMPED_SAMPLES / (plan.rate_hz * floor_s);
                let (least, most) = JUMPED;
                let jumped = if among_others || few { most } else { (late * late).clamp(least, most) };
                let turn = course.turn();
                let [a, b] = [0, 1].map(|k: usize| {
                    let paths = usual.lasting[k].max(floor * floor);
                    usual.noise[k] * (1.0 + course.factor) + paths + turn * turn + course.bent
                });
                let widest = a.max(b);
                let hop = hop(context, &from);
                let hops = hop * hop * (1.0 + course.up.0);
                let away = AWAY.max(from[2] * from[2]) * from[2];
                let exchanged = [widest, widest + hops * away * away, widest + hops];
                let [_, away, up] = exchanged;
                let jump = Jump {
                    plan,
                    duals,
                    from: course.place,
                    to: own,
                    jumped,
                    few,
                    either: if self.what < EXCHANGED { EITHER } else { -EITHER },
                    axes: [across, [-s, c, 0.0], [0.0, 0.0, 1.0]],
                    variance: [a, away, up],
                    exchanged,
                };
                let before = (self.seems != NOTHING).then_some(&self.jump);
                match jump.what(before) {
                    (ELSEWHERE, _) if few && before.is_none() => (NOTHING, 0.0),
                    // The pairs' own delays are back by chance, where what would be told of them is not.
                    (NOTHING, _) if before.is_some() => Jump { to: told, ..jump }.what(before),
                    seems => seems,
                }
            }
            _ => (NOTHING, 0.0),
        };
        self.see(course, &own, seems.0, context.index);
        if self.seems == NOTHING || self.seems == ELSEWHERE {
            if self.seems == NOTHING {
                self.keep(&own, context.index);
            }
        } else if self.times >= SURE {
            self.sure(seems.1);
            self.kept = 0;
            self.keep(&own, context.index);
        }
        let changed = self.what != before && self.what != NOTHING;
        (self.verdict(), changed)
    }

    /// The order that the channels are in, if it is another than it should be.
    pub(super) fn exchanged(&self) -> Option<u8> {
        self.what.checked_sub(ORDERED).filter(|order| *order > 0)
    }

    /// Takes in which order the channels are, as all vessels together show.
    pub(super) fn set_exchanged(&mut self, order: Option<u8>) {
        if self.exchanged().is_some() != order.is_some() {
            self.what = order.map_or(NOTHING, |order| ORDERED + order);
            (self.seems, self.times, self.strays, self.kept, self.against) = (NOTHING, 0, 0, 0, 0.0);
        }
    }

    /// Whether a change is sure.
    pub(super) fn is_told(&self) -> bool {
        self.what != NOTHING
    }

    /// Whether one seems to have come moments before sample `index`, of which nothing has been said since.
    pub(super) fn is_suspected(&self, plan: &Plan, index: u64) -> bool {
        self.times > 0 && seconds(plan, self.since, index) < LONGEST_JUMP_S
    }

    /// What to do with a direction of three hydrophones, which show no change themselves: what was known of four still is, but for a late
    /// channel that is the one left out.
    pub(super) fn verdict_of_three(&self, plan: &Plan, index: u64, used: Used) -> Verdict {
        let late = usize::from(self.what.wrapping_sub(LATE));
        match self.verdict() {
            Verdict::Doubt(_) if late < CHANNELS && !used.hydrophone(late) => Verdict::Tell,
            Verdict::Withhold if self.what < EXCHANGED && !self.is_suspected(plan, index) => Verdict::Tell,
            verdict => verdict,
        }
    }

    /// What to do with a direction, by what was seen until now.
    pub(super) fn verdict(&self) -> Verdict {
        if (self.seems != NOTHING && self.seems != ELSEWHERE) || self.what >= EXCHANGED {
            Verdict::Withhold
        } else if self.what >= LATE {
            Verdict::Doubt(0.5 * self.delay_s * self.delay_s)
        } else {
            Verdict::Tell
        }
    }

    /// Takes what a segment shows beside the course.
    #[inline(never)]
    fn see(&mut self, course: Option<Course>, own: &[f32; 3], what: What, index: u64) {
        if what == NOTHING {
            (self.seems, self.times, self.strays) = (NOTHING, 0, 0);
            return;
        }
        if self.seems == NOTHING {
            (self.course, self.since) = (course.unwrap_or(Course::NONE), index);
            self.jump = difference(own, &self.course.place);
        }
        // Near a vessel, whose image leaves heights uncertain, one change looks like another.
        if what != ELSEWHERE && self.seems != NOTHING && self.seems != ELSEWHERE {
            (self.seems, self.times) = (what, self.times + 1);
            return;
        }
        // What changes in the midst of a segment is nowhere at first.
        self.strays += 1;
        if what != ELSEWHERE || self.seems == NOTHING {
            (self.seems, self.times) = (what, 1);
        }
        if self.strays > STRAY {
            // Another vessel, or this one has turned.
            (self.seems, self.times, self.strays, self.kept) = (NOTHING, 0, 0, 0);
        }
    }

    /// A change has become sure.
    fn sure(&mut self, delay_s: f32) {
        let back = match self.exchanged() {
            Some(order) => self.seems == ORDERED + inverse(order),
            None => self.what == self.seems && m::abs(self.delay_s + delay_s) < 0.5 * m::abs(self.delay_s),
        };
        if back {
            self.what = NOTHING;
        } else if self.what < EXCHANGED {
            // Of exchanged channels the vector turns about as no vessel does.
            (self.what, self.delay_s) = (self.seems, delay_s);
        }
        (self.seems, self.times, self.strays, self.against) = (NOTHING, 0, 0, 0.0);
    }

    /// Weighs whether what is heard since a change is strained as that would have it.
    #[inline(never)]
    fn hear(
        &mut self,
        context: &Context<'_>,
        duals: &[[f32; 3]; CHANNELS],
        own: &[f32; 3],
        arrived: &[f32; CHANNELS],
        expected: f32,
    ) {
        if self.what == NOTHING || self.seems != NOTHING {
            return;
        }
        let plan = context.plan;
        let radial = length(own) - expected;
        let other = if let Some(order) = self.exchanged() {
            length(&vector(plan, duals, &heard(arrived, inverse(order)))) - expected
        } else {
            let dual = duals.get(usize::from(self.what - LATE)).unwrap_or(&[0.0; 3]);
            let late = self.delay_s / plan.inv_c;
            let most = length(&[0, 1, 2].map(|k: usize| own[k] + late * dual[k])) - expected;
            let least = radial + LEAST_LATE * (most - radial);
            if least * most < 0.0 { 0.0 } else { m::abs(least).min(m::abs(most)) }
        };
        let sd = STRAIN_SAMPLES / plan.rate_hz * length(&duals[0]) / plan.inv_c;
        let from = unit(own);
        let hop = hop(context, &from) * from[2];
        let usual = self.usual();
        let [a, b] = [0, 1].map(|k: usize| usual.noise[k] + usual.lasting[k]);
        let variance = sd * sd + a.min(b) + hop * hop;
        // What pairs hear of vessel and image stays the same until that has turned.
        let fresh = match self.past.first() {
            Some((last, _)) if hop > 0.0 => {
                (m::hypot(own[0] - last[0], own[1] - last[1]) / FRESH_RAD).min(1.0)
            }
            _ => 1.0,
        };
        let more = 0.5 * fresh * (other * other - radial * radial) / variance;
        self.against = (self.against + more).max(-DECIDED);
        if self.against > DECIDED {
            self.what = NOTHING;
        }
    }

    /// The course that the segments before the last one tell, at the segment's moment, for what paths move a vector by at least.
    #[inline(never)]
    fn course(&self, context: &Context<'_>, floor: f32) -> Option<Course> {
        // The newest may hold a part of a jump.
        let used = self.past.get(usize::from(self.kept > 1)..self.kept)?;
        let hop = hop(context, &unit(&used.first()?.0));
        Course::of(context.plan, context.index, used, (self.usual().noise[0], floor), hop)
    }

    #[inline(never)]
    fn keep(&mut self, own: &[f32; 3], index: u64) {
        self.past.rotate_right(1);
        self.past[0] = (*own, index);
        self.kept = (self.kept + 1).min(KEPT);
    }
}

/// Standard deviation of what pairs move the direction up or down by as they go from a vessel to its image and back, radians: where the two are
/// nearer to each other than the array resolves, they join (a power that fits passes 200 m to 1 km away, with depths known and not).
#[inline(never)]
fn hop(context: &Context<'_>, from: &Direction) -> f32 {
    let plan = context.plan;
    let most = half_apart(plan, from);
    let half = context.depth.map_or(most, |(depth_m, sd_m)| {
        let deepest = DEEPEST * plan.vessel_over_array_depth * plan.depth_m;
        most * ((depth_m + 2.0 * sd_m) / deepest.max(f32::MIN_POSITIVE)).min(1.0)
    });
    let resolved = half / (APART * plan.whole.resolution);
    let square = resolved * resolved;
    let fourth = square * square;
    HOP * half * (fourth * fourth).min(1.0)
}

/// What paths do to a delay at any time, seconds.
fn floor_s(plan: &Plan) -> f32 {
    if plan.vessel_over_array_depth > 0.0 { FRINGED_S } else { FLOOR_SAMPLES / plan.rate_hz }
}

#[cfg(test)]
#[path = "change_tests.rs"]
mod tests;
