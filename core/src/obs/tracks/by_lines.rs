//! What a vessel's lines say of its track: other pairs of paths are tried where they do not fall as its course says, and where none suits
//! them it is no vessel's.
//!
//! Enters: the track, and the minutes that the others leave. Leaves: the track on a course that suits its lines, or that they deny it.

use super::super::doppler::Fall;
use super::super::evidence::Evidence;
use super::super::plan::{Plan, STEP_S};
use super::{Live, Others, unexplained};
use crate::math;

/// How many times as far and as fast a vessel may be that is read at another pair of paths.
const OTHER_PAIRS: [f64; 6] = [1.0 / 3.0, 0.5, 2.0 / 3.0, 1.5, 2.0, 3.0];

/// Deviations from one of the ratio that lines tell from which on other pairs are tried, and from which on no vessel's course is told.
const DOUBT: f64 = 2.0;
const DENY: f64 = 3.0;

impl Live {
    /// What its lines say, in what `others` leave.
    #[inline(never)]
    pub(super) fn fall(&self, plan: &Plan<'_>, evidence: &Evidence, others: &Others) -> Fall {
        let minutes = unexplained(plan, evidence, others, None, self.from, self.to);
        Fall::of(&self.course, &plan.travel, STEP_S, minutes)
    }

    /// Whether its lines say that its course is no vessel's.
    pub(super) fn is_denied(&self, plan: &Plan<'_>, evidence: &Evidence, others: &Others) -> bool {
        self.fall(plan, evidence, others).off() > DENY
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
