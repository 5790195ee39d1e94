//! Whether a channel was late, or two were exchanged, from one moment to the next.
//!
//! Enters: the delays of each segment. Leaves: what changed, and how far to doubt what is heard since. Four arrival times have
//! three differences, so they give a vector whatever they are: the way against the sound, in units of its slowness. That of a
//! wavefront has length one, which is all that one segment can show ([`super::agreement`]); a channel that is late turns it as
//! a vessel would that stands elsewhere. But a vessel moves evenly:
//!
//! * A channel late by d moves the vector by d times the dual vector of its hydrophone, of which there are four; two exchanged
//!   channels move it to one of six places. From the track of up to [`KEPT`] segments before, all but the last, is known where
//!   it should be. What jumps to none of those places is another vessel.
//! * From the second such segment on no direction is told, until [`SURE`] have said the same (a vessel that turns does not)
//!   or one has not. Then the fault `Inconsistent` says so.
//! * Since then: with a late channel, bearings with an error as large as the delay; of exchanged channels none. What comes
//!   from other directions is strained by a change and not by a vessel that jumped, or jumps back: [`DECIDED`] ends it.
//!   In a regular tetrahedron two exchanged channels strain nothing, and only the jump back tells.
//!
//! What was wrong before anything was heard is not seen here. Cost: about 2000 instructions a segment.

use super::agreement::half_apart;
use super::estimate::{Context, Found};
use super::plan::Plan;
use super::wavefront::{self, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
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
/// Squared deviations beyond which the vector has jumped, within which it is back, and within which it is where a change puts
/// it; of three dimensions, and of two.
const JUMPED: f32 = 36.0;
const BACK: f32 = 12.0;
const THERE: f32 = 14.0;
/// Delays looked for, samples.
const DELAYS: (f32, f32) = (0.4, 8.0);
/// Standard deviation of what a course bends by until the newest segment, in units of the square of the angle turned: a vector that turns
/// evenly leaves a line through its past by a sixth of it, a vessel's bearing at its fastest change by as much again; six deviations are a jump.
const BEND: f32 = 0.1;
/// What multipath does to a delay at any time, samples; and where the surface's image is expected, whose fringes pull each hydrophone's
/// delay by itself.
const FLOOR_SAMPLES: f32 = 0.05;
const FRINGED_SAMPLES: f32 = 0.12;
/// Standard deviation of what the vector goes up and down by where pairs hear a vessel and its image in the surface apart: upright pairs go from
/// one to the other, level ones stay half-way. In units of how far each is from there.
const HOP: f32 = 0.8;
/// The same where the vector's length is looked at, and natural logarithm of the likelihood ratio that ends a suspicion.
const STRAIN_SAMPLES: f32 = 0.15;
const DECIDED: f32 = 30.0;

/// What changed: nothing, hydrophone `n − LATE` late, pair `n − EXCHANGED` exchanged, or it cannot be told.
type What = u8;
const NOTHING: What = 0;
const LATE: What = 1;
const EXCHANGED: What = LATE + CHANNELS as u8;
const ELSEWHERE: What = EXCHANGED + PAIR_COUNT as u8;

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

/// A track of vectors: place now, change a second, and factor of one segment's variance.
#[derive(Clone, Copy, Debug, Default)]
struct Course {
    place: [f32; 3],
    rate: [f32; 3],
    factor: f32,
    /// How long ago its first segment was, seconds.
    length_s: f32,
}

/// What the segments before showed. All zeros at the beginning.
#[derive(Clone, Copy, Debug)]
pub(super) struct Change {
    /// Newest first.
    past: [([f32; 3], u64); KEPT],
    kept: usize,
    /// Variance of the last bearing along the tangents, rad²; 0: none was told.
    stated: [f32; 2],
    /// Where what was heard before a jump should be, since when.
    course: Course,
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

/// Where a vector is, against where it should be.
struct Jump<'a> {
    plan: &'a Plan,
    duals: [[f32; 3]; CHANNELS],
    from: [f32; 3],
    to: [f32; 3],
    /// Axes, and the variance along each.
    axes: [[f32; 3]; 3],
    variance: [f32; 3],
    /// The same where channels were exchanged, which turns the axes.
    exchanged: [f32; 3],
}

impl Change {
    pub(super) const fn new() -> Self {
        Self {
            past: [([0.0; 3], 0); KEPT],
            kept: 0,
            stated: [0.0; 2],
            course: Course { place: [0.0; 3], rate: [0.0; 3], factor: 0.0, length_s: 0.0 },
            since: 0,
            seems: NOTHING,
            times: 0,
            strays: 0,
            what: NOTHING,
            delay_s: 0.0,
            against: 0.0,
        }
    }

    /// Takes what was stated of an undoubted bearing: variances along the tangents, rad².
    pub(super) fn stated(&mut self, variance: [f32; 2]) {
        if self.seems == NOTHING {
            self.stated = variance;
        }
    }

    /// Takes a segment's delays; what to do with its direction, and whether a change has just become sure.
    #[inline(never)]
    pub(super) fn take(
        &mut self,
        context: &Context<'_>,
        found: &Found,
        delays: &[f32; PAIR_COUNT],
    ) -> (Verdict, bool) {
        let plan = context.plan;
        let duals = duals(plan);
        let own = vector(plan, &duals, &times(delays));
        let expected = vector(plan, &duals, &times(&found.tau));
        let expected = length(&expected);
        self.hear(plan, &duals, &own, delays, expected);
        let before = self.what;
        let lasted = self.past.first().map_or(f32::MAX, |(_, at)| seconds(plan, *at, context.index));
        let longest = if self.seems == NOTHING { LONGEST_S } else { LONGEST_JUMP_S };
        if self.kept > 0 && lasted > longest {
            (self.kept, self.seems, self.times, self.strays) = (0, NOTHING, 0, 0);
        }
        let course = if self.seems == NOTHING {
            self.course(plan, context.index)
        } else {
            Some(self.later(plan, context.index))
        };
        let seems = match course {
            Some(course) if self.stated[0] > 0.0 => {
                let norm = length(&course.place).max(0.1);
                let from = course.place.map(|x| x / norm);
                let e = wavefront::tangents(&from);
                let [a, b] = self.stated;
                let fringed = plan.vessel_over_array_depth > 0.0;
                let floor = if fringed { FRINGED_SAMPLES } else { FLOOR_SAMPLES };
                let floor = floor / plan.rate_hz * length(&duals[0]) / plan.inv_c;
                let turn =
                    BEND * wavefront::dot(&course.rate, &course.rate) * course.length_s * course.length_s;
                let more = floor * floor + turn * turn;
                let mut variance = [a, b, a.min(b)].map(|v| v * (1.0 + course.factor) + more);
                let widest = variance[0].max(variance[1]);
                let hop = HOP * half_apart(plan, &from);
                let upright = [e.0[2], e.1[2], from[2]].map(|z| hop * hop * z * z);
                variance.iter_mut().zip(upright).for_each(|(variance, hop)| *variance += hop);
                let exchanged = upright.map(|hop| widest + hop);
                let jump = Jump {
                    plan,
                    duals,
                    from: course.place,
                    to: own,
                    axes: [e.0, e.1, from],
                    variance,
                    exchanged,
                };
                jump.what(if self.seems == NOTHING { JUMPED } else { BACK })
            }
            _ => (NOTHING, 0.0),
        };
        self.see(course, seems.0, context.index);
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

    /// Whether a change is suspected or sure.
    pub(super) fn is_told(&self) -> bool {
        self.what != NOTHING
    }

    fn verdict(&self) -> Verdict {
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
    fn see(&mut self, course: Option<Course>, what: What, index: u64) {
        if what == NOTHING {
            (self.seems, self.times, self.strays) = (NOTHING, 0, 0);
            return;
        }
        if self.seems == NOTHING {
            (self.course, self.since) = (course.unwrap_or_default(), index);
        }
        if what == self.seems && what != ELSEWHERE {
            self.times += 1;
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
        let back = self.what == self.seems
            && (self.what >= EXCHANGED || m::abs(self.delay_s + delay_s) < 0.5 * m::abs(self.delay_s));
        if back {
            self.what = NOTHING;
        } else if self.what < EXCHANGED || self.seems >= EXCHANGED {
            // Of exchanged channels the vector turns about as no vessel does.
            (self.what, self.delay_s) = (self.seems, delay_s);
        }
        (self.seems, self.times, self.strays, self.against) = (NOTHING, 0, 0, 0.0);
    }

    /// Weighs whether what is heard since a change is strained as that would have it.
    #[inline(never)]
    fn hear(
        &mut self,
        plan: &Plan,
        duals: &[[f32; 3]; CHANNELS],
        own: &[f32; 3],
        delays: &[f32; PAIR_COUNT],
        expected: f32,
    ) {
        if self.what == NOTHING || self.seems != NOTHING {
            return;
        }
        let radial = length(own) - expected;
        let other = if let Some(pair) = self.what.checked_sub(EXCHANGED) {
            let mut t = times(delays);
            if let Some((i, j)) = PAIRS.get(usize::from(pair)) {
                t.swap(*i, *j);
            }
            length(&vector(plan, duals, &t)) - expected
        } else {
            let dual = duals.get(usize::from(self.what - LATE)).unwrap_or(&[0.0; 3]);
            let late = self.delay_s / plan.inv_c;
            length(&[0, 1, 2].map(|k: usize| own[k] + late * dual[k])) - expected
        };
        let sd = STRAIN_SAMPLES / plan.rate_hz * length(&duals[0]) / plan.inv_c;
        let norm = length(own).max(0.1);
        let up = own[2] / norm;
        let hop = HOP * half_apart(plan, &own.map(|x| x / norm)) * up;
        let variance = sd * sd + self.stated[0].min(self.stated[1]) + hop * hop;
        self.against = (self.against + 0.5 * (other * other - radial * radial) / variance).max(-DECIDED);
        if self.against > DECIDED {
            self.what = NOTHING;
        }
    }

    /// The course that the segments before the last one tell, at sample `index`.
    #[inline(never)]
    fn course(&self, plan: &Plan, index: u64) -> Option<Course> {
        let used = self.past.get(1..self.kept).filter(|past| past.len() >= LEAST_KEPT)?;
        let n = used.len() as f32;
        let (mut at, mut square, mut place, mut slope) = (0.0, 0.0, [0.0f32; 3], [0.0f32; 3]);
        for (v, when) in used {
            let t = -seconds(plan, *when, index);
            at += t;
            square += t * t;
            for k in 0..3 {
                place[k] += v[k];
                slope[k] += t * v[k];
            }
        }
        let determinant = n * square - at * at;
        if !(determinant > 0.0) {
            return None;
        }
        let mut course = Course { factor: square / determinant, ..Course::default() };
        for k in 0..3 {
            course.place[k] = (square * place[k] - at * slope[k]) / determinant;
            course.rate[k] = (n * slope[k] - at * place[k]) / determinant;
        }
        course.length_s = used.last().map_or(0.0, |(_, when)| seconds(plan, *when, index));
        Some(course)
    }

    /// The course from before a jump, at sample `index`.
    #[inline(never)]
    fn later(&self, plan: &Plan, index: u64) -> Course {
        let t = seconds(plan, self.since, index);
        let mut course = self.course;
        for (place, rate) in course.place.iter_mut().zip(&course.rate) {
            *place += t * rate;
        }
        // The variance of what a line gives grows with the square of the time from its middle.
        let grown = 1.0 + t / (0.5 * course.length_s).max(0.1);
        course.factor *= grown * grown;
        course.length_s += t;
        course
    }

    #[inline(never)]
    fn keep(&mut self, own: &[f32; 3], index: u64) {
        self.past.rotate_right(1);
        self.past[0] = (*own, index);
        self.kept = (self.kept + 1).min(KEPT);
    }
}

impl Jump<'_> {
    /// Product of two vectors, each in standard deviations.
    #[inline(never)]
    fn inner(&self, a: &[f32; 3], b: &[f32; 3]) -> f32 {
        let mut sum = 0.0;
        for (axis, variance) in self.axes.iter().zip(&self.variance) {
            sum += wavefront::dot(a, axis) * wavefront::dot(b, axis) / variance;
        }
        sum
    }

    /// What takes the vector there, if it is at `least` so many squared deviations away, and the delay of a late channel.
    #[inline(never)]
    fn what(&self, least: f32) -> (What, f32) {
        let by = difference(&self.to, &self.from);
        let chi2 = |v: &[f32; 3]| self.inner(v, v);
        let jumped = chi2(&by);
        if jumped < least {
            return (NOTHING, 0.0);
        }
        let (mut best, mut least) = ((ELSEWHERE, 0.0), THERE);
        for (dual, what) in self.duals.iter().zip(LATE..) {
            let per_s = dual.map(|x| -x / self.plan.inv_c);
            let delay_s = self.inner(&per_s, &by) / self.inner(&per_s, &per_s).max(f32::MIN_POSITIVE);
            let left = difference(&by, &per_s.map(|x| delay_s * x));
            let samples = m::abs(delay_s) * self.plan.rate_hz;
            if chi2(&left) < least && samples > DELAYS.0 && samples < DELAYS.1 {
                (best, least) = ((what, delay_s), chi2(&left));
            }
        }
        let heard = arrivals(self.plan, &self.to);
        for ((i, j), what) in PAIRS.into_iter().zip(EXCHANGED..) {
            // Exchanged back: what is uncertain up and down is so in the true order alone.
            let mut t = heard;
            if let Ok([a, b]) = t.get_disjoint_mut([i, j]) {
                core::mem::swap(a, b);
            }
            let off = difference(&vector(self.plan, &self.duals, &t), &self.from);
            let mut chi2 = 0.0;
            for (axis, variance) in self.axes.iter().zip(&self.exchanged) {
                let along = wavefront::dot(&off, axis);
                chi2 += along * along / variance;
            }
            if chi2 < least {
                (best, least) = ((what, 0.0), chi2);
            }
        }
        best
    }
}

#[inline(never)]
fn difference(a: &[f32; 3], b: &[f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(never)]
fn length(v: &[f32; 3]) -> f32 {
    m::sqrt(wavefront::dot(v, v))
}

fn seconds(plan: &Plan, from: u64, to: u64) -> f32 {
    to.saturating_sub(from) as f32 / plan.rate_hz
}

/// Arrival times about their mean that fit the pairs' delays best.
#[inline(never)]
fn times(delays: &[f32; PAIR_COUNT]) -> [f32; CHANNELS] {
    let mut out = [0.0f32; CHANNELS];
    for (delay, (i, j)) in delays.iter().zip(PAIRS) {
        let part = delay / CHANNELS as f32;
        for (h, t) in out.iter_mut().enumerate() {
            *t += if h == j {
                part
            } else if h == i {
                -part
            } else {
                0.0
            };
        }
    }
    out
}

/// Arrival times (seconds) of a plane wave of this vector.
#[inline(never)]
fn arrivals(plan: &Plan, vector: &[f32; 3]) -> [f32; CHANNELS] {
    plan.geometry.position_m.map(|h| -plan.inv_c * wavefront::dot(&h, vector))
}

/// Vectors whose products with the hydrophones' places are 1 for the own one and 0 for the others', up to a constant: 1/m.
#[inline(never)]
fn duals(plan: &Plan) -> [[f32; 3]; CHANNELS] {
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
fn vector(plan: &Plan, duals: &[[f32; 3]; CHANNELS], times: &[f32; CHANNELS]) -> [f32; 3] {
    let mut out = [0.0; 3];
    for (dual, t) in duals.iter().zip(times) {
        for (x, d) in out.iter_mut().zip(dual) {
            *x -= t / plan.inv_c * d;
        }
    }
    out
}

#[cfg(test)]
#[path = "change_tests.rs"]
mod tests;
