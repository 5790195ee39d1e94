//! What of four arrival times no direction explains, and whether it lasts.
//!
//! Enters: the pairs' own delays of each segment and those that its direction has. Leaves: the square of their strain, and of its mean where that is most
//! of it. A sound that crosses the array at its speed has two degrees of freedom, its arrival times have three. Cost: 1500 instructions a segment.

use super::estimate::Context;
use super::jump::times;
use super::plan::Plan;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;

/// Segments over which it is averaged, after which one that lasts is in what is stated, and from which on it may be a fault.
const AVERAGED: f32 = 12.0;
const EARLY: f32 = 4.0;
/// A strain farther from the mean than so many times either of them, and this many samples, is another.
const STRAY: f32 = 3.0;
const LEAST_CHANGE_SAMPLES: f32 = 0.3;
/// Share of the mean square that the squared mean of a lasting strain has.
const LASTING: f32 = 0.75;
/// Standard deviations of what was told uncertain that are no news.
pub(super) const TOLD_SD: f32 = 3.0;
/// By how much a speed of sound that is told as certain may be off, of itself: 7 m/s.
const UNTOLD_SPEED: f32 = 0.005;

/// Means over segments.
#[derive(Clone, Copy, Debug)]
pub(super) struct Strain {
    /// Of each arrival, seconds, and of the square of all four.
    mean: [f32; CHANNELS],
    square: f32,
    /// Segments in the means.
    averaged: f32,
    /// Whether the last one was left out of them.
    strayed: bool,
}

impl Strain {
    pub(super) const NONE: Self = Self { mean: [0.0; CHANNELS], square: 0.0, averaged: 0.0, strayed: false };

    /// Whether as many segments as a fault wants are in it.
    pub(super) fn is_of_many(&self) -> bool {
        self.averaged >= AVERAGED
    }

    /// Takes a segment's pair delays and those of its direction, seconds; the square of the strain, s²: this segment's, and of the mean where it lasts.
    #[inline(never)]
    pub(super) fn take(
        &mut self,
        plan: &Plan,
        (delays, tau): (&[f32; PAIR_COUNT], &[f32; PAIR_COUNT]),
    ) -> (f32, Option<f32>) {
        let mut off = *delays;
        off.iter_mut().zip(tau).for_each(|(off, tau)| *off -= tau);
        let strain = times(&off, &[1.0; PAIR_COUNT]);
        // What comes once is no change; what comes twice is, and what was before says nothing of it. A segment in which a
        // channel changes is strained by any amount: it would hide what follows.
        let mut change = strain;
        change.iter_mut().zip(&self.mean).for_each(|(x, mean)| *x -= mean);
        let least = LEAST_CHANGE_SAMPLES / plan.rate_hz;
        let now = square(&strain);
        let stray = square(&change) > STRAY * STRAY * now.min(self.square) + least * least;
        let again = core::mem::replace(&mut self.strayed, stray);
        if stray && self.averaged > 0.0 {
            if !again {
                return (now, None);
            }
            (self.averaged, self.strayed) = (0.0, false);
        }
        self.averaged = (self.averaged + 1.0).min(AVERAGED);
        let part = 1.0 / self.averaged;
        self.square += part * (now - self.square);
        for (mean, new) in self.mean.iter_mut().zip(&strain) {
            *mean += part * (new - *mean);
        }
        let lasting = square(&self.mean);
        (now, (self.averaged >= EARLY && lasting > LASTING * self.square).then_some(lasting))
    }
}

fn square(x: &[f32; CHANNELS]) -> f32 {
    x.iter().map(|x| x * x).sum()
}

/// Square of what a speed of sound that is off by its own length would make of it, s².
fn of_speed(plan: &Plan, direction: &Direction) -> f32 {
    square(&wavefront::arrivals(&plan.geometry, direction, 0.0))
}

/// What was told uncertain makes of it at most, s²: positions, how far away the vessel is, and the speed at which a sound of this direction crosses,
/// which the image makes another by that share.
pub(super) fn explained(context: &Context<'_>, direction: &Direction, image: f32) -> f32 {
    let plan = context.plan;
    let speed = plan.sound_speed_sd * plan.sound_speed_sd + image * image;
    let (curvature, sd) = context.curvature(direction);
    let at = |curvature: f32| wavefront::arrivals(&plan.geometry, direction, curvature);
    let mut bent = at(curvature + sd);
    bent.iter_mut().zip(at(curvature)).for_each(|(bent, usual)| *bent -= usual);
    let positions = plan.position_sd_s * plan.position_sd_s;
    TOLD_SD * TOLD_SD * (positions + speed * of_speed(plan, direction) + square(&bent))
}

/// What a speed of sound that was not told uncertain makes of it at most, s².
pub(super) fn untold(plan: &Plan, direction: &Direction) -> f32 {
    UNTOLD_SPEED * UNTOLD_SPEED * of_speed(plan, direction)
}
