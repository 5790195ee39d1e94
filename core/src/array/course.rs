//! Where a vessel should be by what was heard of it, and how certain that is.
//!
//! Enters: the vectors of the segments before, newest first. Leaves: a line through them at the segment's moment, and what it errs by beside
//! noise:
//!
//! * A vessel that comes nearer turns the faster the nearer it is, which bends a course: 100 m away at 7 m/s by 0.4° in 4 s, more than what one sample
//!   does at 64 kHz is sharp. Its height tells how near it is; where that bends it too much, the course is that of fewer segments.
//! * Where pairs hear a vessel apart from its image in the surface they go from the one to the other, and stay there for some segments. That moves the
//!   vector up and down, by as much as its past shows at least, and aside as far as hydrophones stand at several heights.
//!
//! Cost: about 1000 instructions for each length tried, and 4000 for what goes aside.

use super::agreement::{DEEPEST, half_apart};
use super::estimate::Context;
use super::jump::{times, unit, vector};
use super::plan::Plan;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::math::f32 as m;

/// Least segments kept, the newest included, of a vessel that comes nearer: fewer tell too little of how it turns.
const LEAST_BENT: usize = 5;
/// Standard deviation of how fast a vessel turns whose past does not tell it, rad/s: 7 m/s 200 m away.
const TURNING_RAD_S: f32 = 0.035;
/// Standard deviation of what the course of a vessel bends by that comes nearer or goes away, in units of the angle turned and the part of the
/// distance by which it does: what turns at a
/// rate that grows by twice that part of itself leaves a line by a sixth of it.
const NEARING: f32 = 1.0 / 3.0;
/// Standard deviation of what the vector goes up and down by where pairs hear a vessel and its image in the surface apart: upright pairs go from
/// one to the other, level ones stay half-way. In units of how far each is from there.
const HOP: f32 = 0.8;
/// Standard deviation of the speed with which a vessel comes nearer or goes away, m/s: with the depth it tells how fast its elevation changes.
const RISING_M_S: f32 = 5.0;
/// What a segment was heard as: its vector, and at which sample.
pub(super) type Heard = ([f32; 3], u64);

/// A track of vectors: place now, change a second, and factor of one segment's variance.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Course {
    pub(super) place: [f32; 3],
    pub(super) rate: [f32; 3],
    pub(super) factor: f32,
    /// The same of a hop's variance, upwards: now, and for the squared seconds later.
    pub(super) up: (f32, f32),
    /// Variance of what its segments go up and down by.
    pub(super) scatter: f32,
    /// How long ago its first segment was, seconds.
    pub(super) length_s: f32,
    /// How far from it the first segment was that jumped.
    pub(super) jump: [f32; 3],
}

impl Course {
    /// Standard deviation of what it bends by until now, radians: a vessel that comes nearer turns the faster the nearer it is, which its height
    /// tells.
    #[inline(never)]
    pub(super) fn bend(&self, plan: &Plan) -> f32 {
        let nearing = RISING_M_S * m::abs(self.place[2]) / plan.depth_m;
        NEARING * m::hypot(self.rate[0], self.rate[1]) * nearing * self.length_s * self.length_s
    }

    /// The course that the segments before the last one tell (newest first, each of which `noise` scatters by that variance), at the segment's
    /// moment: of as many as one of a vessel that comes nearer bends by less than `most` (radians).
    pub(super) fn of(past: &[Heard], context: &Context<'_>, noise: f32, most: f32) -> Option<Self> {
        let mut kept = past.len();
        loop {
            let course = Self::of_all(past.get(..kept)?, context, noise)?;
            if context.plan.vessel_over_array_depth <= 0.0
                || course.bend(context.plan) <= most
                || kept <= LEAST_BENT
            {
                return Some(course);
            }
            kept -= 1;
        }
    }

    /// The same of all of them.
    #[inline(never)]
    fn of_all(past: &[Heard], context: &Context<'_>, noise: f32) -> Option<Self> {
        let (plan, index) = (context.plan, context.index);
        // The newest may hold a part of a jump.
        let used = past.get(usize::from(past.len() > 1)..)?;
        let (newest, _) = used.first()?;
        let n = used.len() as f32;
        let (mut mean, mut middle) = ([0.0f32; 3], 0.0);
        for (v, when) in used {
            middle -= seconds(plan, *when, index) / n;
            for k in 0..3 {
                mean[k] += v[k] / n;
            }
        }
        let (mut square, mut slope) = (0.0, [0.0f32; 3]);
        for (v, when) in used {
            let t = -seconds(plan, *when, index) - middle;
            square += t * t;
            for k in 0..3 {
                slope[k] += t * v[k];
            }
        }
        // A few segments tell less of its turning than a vessel's usual speed does, and where pairs go from vessel to image and back, less of its rise or fall.
        let level = square + noise / (TURNING_RAD_S * TURNING_RAD_S);
        let from = unit(newest);
        let known =
            hop(context, &from) / (RISING_M_S * from[2] * from[2] / plan.depth_m).max(f32::MIN_POSITIVE);
        let upright = (square + known * known).max(level);
        if !(level > 0.0) {
            return None;
        }
        let factor = |square: f32| 1.0 / n + middle * middle / square;
        let mut course = Self { factor: factor(level), ..Self::default() };
        for (k, square) in [level, level, upright].into_iter().enumerate() {
            course.rate[k] = slope[k] / square;
            course.place[k] = mean[k] - middle * course.rate[k];
        }
        course.up = (factor(upright), 1.0 / upright);
        for (v, when) in used {
            let off = v[2] - course.place[2] + seconds(plan, *when, index) * course.rate[2];
            course.scatter += off * off / n;
        }
        course.length_s = used.last().map_or(0.0, |(_, when)| seconds(plan, *when, index));
        Some(course)
    }

    /// The same so many seconds later.
    #[inline(never)]
    pub(super) fn later(&self, t: f32) -> Self {
        let mut course = *self;
        for (place, rate) in course.place.iter_mut().zip(&course.rate) {
            *place += t * rate;
        }
        // The variance of what a line gives grows with the square of the time from its middle.
        let grown = 1.0 + t / (0.5 * course.length_s).max(0.1);
        course.factor *= grown * grown;
        let (now, rate) = course.up;
        let sum = m::sqrt(now) + t * m::sqrt(rate);
        course.up.0 = sum * sum;
        course.length_s += t;
        course
    }
}

/// Standard deviation of what pairs move the direction up or down by as they go from a vessel to its image and back, radians: where the two are
/// nearer to each other than the array resolves, they join (a power that fits passes 200 m to 1 km away, with depths known and not).
#[inline(never)]
pub(super) fn hop(context: &Context<'_>, from: &Direction) -> f32 {
    let plan = context.plan;
    let most = half_apart(plan, from);
    let half = context.depth.map_or(most, |(depth_m, sd_m)| {
        let deepest = DEEPEST * plan.vessel_over_array_depth * plan.depth_m;
        most * ((depth_m + 2.0 * sd_m) / deepest.max(f32::MIN_POSITIVE)).min(1.0)
    });
    let resolved = half / plan.whole.resolution;
    let square = resolved * resolved;
    let fourth = square * square;
    HOP * half * (fourth * fourth).min(1.0)
}

/// Variance of what hydrophones at several heights move the direction aside by, as the pairs of each for itself go from a vessel to its image
/// and back by a `hop`, rad².
#[inline(never)]
pub(super) fn sway(
    plan: &Plan,
    duals: &[[f32; 3]; CHANNELS],
    weight: &[f32; PAIR_COUNT],
    (from, across): (&Direction, &[f32; 3]),
    hop: f32,
) -> f32 {
    let heights = wavefront::pair_delays(&wavefront::gradient(&plan.geometry, from, &[0.0, 0.0, 1.0], 0.0));
    let mut sum = 0.0;
    for h in 0..CHANNELS {
        let mut gone = heights;
        for (gone, (i, j)) in gone.iter_mut().zip(PAIRS) {
            *gone *= if i == h || j == h { hop } else { 0.0 };
        }
        let aside = wavefront::dot(&vector(plan, duals, &times(&gone, weight)), across);
        sum += aside * aside;
    }
    sum
}

/// From one sample to another.
#[inline(never)]
pub(super) fn seconds(plan: &Plan, from: u64, to: u64) -> f32 {
    to.saturating_sub(from) as f32 / plan.rate_hz
}
