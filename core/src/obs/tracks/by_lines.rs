//! What a vessel's lines say of its track: other pairs of paths are tried where they do not fall as its course says.
//!
//! Enters: the track, and the minutes that the others leave. Leaves: the track on a course that suits its lines and ranges, or that its lines say that it is
//! another pair of paths' all the same.

use super::super::doppler::{Fall, LEVEL_SD};
use super::super::evidence::Evidence;
use super::super::plan::{Plan, STEP_S};
use super::{Live, Others, unexplained};
use crate::math;

/// How many times as far and as fast a vessel may be that is read at another pair of paths.
const OTHER_PAIRS: [f64; 6] = [1.0 / 3.0, 0.5, 2.0 / 3.0, 1.5, 2.0, 3.0];

/// Deviations from one of the ratio that lines tell from which on other pairs are tried, and from which on its course is another pair's where the ratio is
/// one's to within so many. An engine that changes its speed for half an hour about the closest point makes any ratio.
const DOUBT: f64 = 2.0;
const DENY: f64 = 3.0;
const WITHIN: f64 = 2.0;

impl Live {
    /// What its lines say, in what `others` leave.
    #[inline(never)]
    pub(super) fn fall(&self, plan: &Plan<'_>, evidence: &Evidence, others: &Others) -> Fall {
        let minutes = unexplained(plan, evidence, others, None, self.from, self.to);
        Fall::of(&self.course, &plan.travel, STEP_S, minutes)
    }

    /// Whether its lines say that its course is another pair of paths'.
    pub(super) fn is_denied(&self, plan: &Plan<'_>, evidence: &Evidence, others: &Others) -> bool {
        let fall = self.fall(plan, evidence, others);
        fall.ratio().is_some_and(|(ratio, sd)| {
            let is_of = |times: &f64| math::f64::abs(ratio - times) < WITHIN * sd.max(LEVEL_SD * times);
            fall.off() > DENY && OTHER_PAIRS.iter().any(is_of)
        })
    }

    /// Takes over the course of another pair of paths that suits its lines better, in what `stronger` tracks leave.
    pub(super) fn follow_lines(&mut self, plan: &Plan<'_>, evidence: &Evidence, stronger: &Others, now: u32) {
        let fall = self.fall(plan, evidence, stronger);
        let Some((ratio, _)) = fall.ratio().filter(|_| fall.off() > DOUBT) else { return };
        let nearer = |times: f64| math::f64::abs(ratio - times) < math::f64::abs(ratio - 1.0);
        for times in OTHER_PAIRS.into_iter().filter(|times| nearer(*times)) {
            let other = Self { course: self.course.times(times), ..*self };
            self.rather(other, plan, evidence, stronger, now);
        }
    }
}
