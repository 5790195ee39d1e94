//! What is told of a track: its record while the vessel passes, its last one, and that it was none.
//!
//! Enters: the track, the evidence and the courses of the others. Leaves: `Track` messages. The place is that of the way as it bends now, the closest
//! point that of the way about it; what lasts of the errors ([`lasting`]) is counted in both, and other pairs of paths where its ranges may be those.

use super::super::allowance::Allowance;
use super::super::bend;
use super::super::course::{Closest, Course, CourseCovariance};
use super::super::evidence::Evidence;
use super::super::gone::Gone;
use super::super::lasting::{self, Lasting, Pairs, Told};
use super::super::leaning::leaning;
use super::super::plan::{Plan, STEP_S};
use super::{ESTABLISHED, Live, Others, SPAN, shifted, unexplained, without_all};
use crate::angle::wrap_tau;
use crate::math;
use crate::wire::{Message, Track};

/// A slow vessel that came no nearer than this may be one twice as far that is louder than the table's, m over the water of RR03; nearer its
/// own pairs of paths are much the stronger ones.
const MAY_BE_DOUBLE_M: f32 = 17_000.0;

/// Speeds above which a vessel is seldom, and above which none is twice as fast as it seems, m/s (21 and 25 knots).
const FAST_M_S: f64 = 11.0;
const FASTEST_M_S: f64 = 13.0;

/// A vessel is heard leaving as far as it was heard coming. One that falls silent before or about its closest point is none: the course is
/// that of another pair of paths, or of the directions of several vessels, which it kept to for a while. How long after its closest
/// point it must be heard if it is silent for as long, minutes.
pub(super) const LEAVING: u32 = 10;

/// Records that are told of a track while its vessel is heard, before it may have a last one: what is found in what was heard long ago, and
/// not heard again, is what others left.
const FEW_SENT: u16 = 3;

/// Depth of the water over that of RR03 below which all pairs of paths are in doubt (1900 m). The table's strengths go with ranges in depths, but
/// a vessel at so many depths is nearer there and louder than the table has it: over 800 and 1200 m most are tracked at half their range.
const SHALLOW: f64 = 0.44;

/// Most times the standard deviation of the closest range may exceed the range searched, m, for a track to be sent.
const LEAST_KNOWN_M: f32 = 5_000.0;

/// What a track is told from: the evidence, and the courses of the other tracks.
pub(super) struct Seen<'a> {
    pub(super) evidence: &'a Evidence,
    pub(super) others: Others,
    /// Vessels whose tracks are closed, of which directions may be heard on.
    pub(super) gone: &'a Gone,
    /// As in [`super::Tracker`]'s `pairs_in_doubt`.
    pub(super) in_doubt: bool,
    /// What is not known of the station itself.
    pub(super) lasting: &'a Lasting,
}

impl Live {
    /// Whether the vessel may as well be half or twice as far, at half or twice the speed: a fast one may be half as far where its
    /// ranges do not span so much that other pairs of paths would show others, a slow one twice as far where it did not come near.
    fn pair_is_in_doubt(&self, depth_ratio: f64) -> bool {
        let (nearest_m, farthest_m) = self.score.span_m;
        let speed_m_s = self.course.speed_m_s();
        speed_m_s > FAST_M_S && farthest_m < SPAN * nearest_m
            || speed_m_s < 0.5 * FASTEST_M_S && nearest_m > MAY_BE_DOUBLE_M * depth_ratio as f32
    }

    /// Which other pairs of paths its ranges may be. While a vessel passes, few ranges may be any farther one's, and so may many of a slow one
    /// whose echoes are not of the table's strengths.
    fn other_pairs(&self, plan: &Plan<'_>, seen: &Seen<'_>, stage: u8) -> Option<Pairs> {
        let depth_ratio = plan.travel.depth_ratio();
        if seen.in_doubt || depth_ratio < SHALLOW || self.pair_is_in_doubt(depth_ratio) {
            Some(Pairs::Next)
        } else {
            let slow = self.course.speed_m_s() < 0.5 * FASTEST_M_S;
            let few = !self.is_established() || slow && !self.score.is_sure();
            (stage == Track::RUNNING && few).then_some(Pairs::Farther)
        }
    }

    /// Its course about the closest point, with one of the errors told by one deviation more where one is given. `None` where that
    /// cannot be told. Never inlined: it is large and wanted more than once.
    #[inline(never)]
    fn bent(
        &self,
        plan: &Plan<'_>,
        seen: &Seen<'_>,
        error: Option<Told>,
    ) -> Option<(Course, CourseCovariance)> {
        let travel = &plan.travel;
        let error = error.map(|error| (seen.lasting, error));
        let left = |m| shifted(error, without_all(plan, &seen.others, m));
        let (before, after) = (
            seen.evidence.between(self.from, self.to).map(left),
            seen.evidence.between_back(self.from, self.to).map(left),
        );
        bend::about_closest(&self.course, travel, STEP_S, before, after)
    }

    /// Its course where it was last heard, told as [`Self::bent`] is.
    #[inline(never)]
    fn present(
        &self,
        plan: &Plan<'_>,
        seen: &Seen<'_>,
        error: Option<Told>,
    ) -> Option<(Course, CourseCovariance)> {
        let error = error.map(|error| (seen.lasting, error));
        let minutes = unexplained(plan, seen.evidence, &seen.others, error, self.from, self.to);
        bend::present(&self.course, &plan.travel, STEP_S, minutes)
    }

    /// The same without an error told; straight on where it does not bend.
    pub(super) fn now(&self, plan: &Plan<'_>, seen: &Seen<'_>) -> (Course, CourseCovariance) {
        self.present(plan, seen, None).unwrap_or((self.course, self.covariance))
    }

    /// Sends the running estimate, of which `now` is [`Self::now`] where that is known, where it says anything: the first in any case, others where there is room.
    pub(super) fn run(
        &mut self,
        plan: &Plan<'_>,
        seen: &Seen<'_>,
        now: Option<&(Course, CourseCovariance)>,
        allowance: &mut Allowance,
        room: bool,
        sink: &mut dyn FnMut(Message),
    ) {
        let Some(track) = self.told(plan, seen, now, Track::RUNNING) else { return };
        if room || self.sent == 0 {
            allowance.track();
            sink(Message::Track(track));
        }
        self.sent = self.sent.saturating_add(1);
    }

    /// Sends the solution at the passage's end; where there is none, what was reported is withdrawn. Whether there is one.
    pub(super) fn end(
        &self,
        plan: &Plan<'_>,
        seen: &Seen<'_>,
        now: u32,
        turned: bool,
        sink: &mut dyn FnMut(Message),
    ) -> bool {
        let leaving_s = STEP_S * f64::from(self.to.saturating_sub(LEAVING));
        let silent = now > self.to + LEAVING;
        let left = |track: &Track| turned || track.cpa_time_s < leaving_s;
        let is_one = |track: &Track| !silent || left(track) && self.sent >= FEW_SENT;
        let track = self.told(plan, seen, None, Track::FINAL).filter(is_one);
        match track {
            Some(track) => sink(Message::Track(track)),
            None => self.withdraw(plan, sink),
        }
        track.is_some()
    }

    /// Says that what was reported is no vessel's course.
    pub(super) fn withdraw(&self, plan: &Plan<'_>, sink: &mut dyn FnMut(Message)) {
        if self.sent > 0 {
            let straight = (self.course, self.covariance);
            let track = self.as_sent(plan, Track::WITHDRAWN, &straight, &straight);
            sink(Message::Track(Track { range_observable: false, ..track }));
        }
    }

    /// The track as known now, which is looked for where it is not known yet; `None` where it is not under way, where its range is as good as unknown, or where it would be final and may be no vessel's, or its lines deny a course that its ranges do not assure.
    pub(super) fn told(
        &self,
        plan: &Plan<'_>,
        seen: &Seen<'_>,
        now: Option<&(Course, CourseCovariance)>,
        stage: u8,
    ) -> Option<Track> {
        if !self.is_under_way() {
            return None;
        }
        let denied = self.is_denied(plan, seen.evidence, &seen.others);
        if stage == Track::FINAL && denied && !self.is_established() {
            return None;
        }
        // Where each echo may be read as several pairs of paths, ranges of some minutes lie on many more courses.
        if stage == Track::FINAL && seen.in_doubt && self.score.both < ESTABLISHED {
            return None;
        }
        let straight = (self.course, self.covariance);
        let mut now = now.copied().unwrap_or_else(|| self.now(plan, seen));
        let beside = seen.others.courses.iter().flatten().chain(seen.gone.courses());
        let leaning = leaning(&now.0, beside);
        lasting::turn(&mut now, leaning);
        let mut bent = self.bent(plan, seen, None).unwrap_or(straight);
        seen.lasting.widen(&mut now, |error| self.present(plan, seen, Some(error)).map(|(course, _)| course));
        seen.lasting.widen(&mut bent, |error| self.bent(plan, seen, Some(error)).map(|(course, _)| course));
        let track = self.as_sent(plan, stage, &now, &bent);
        let known = track.sd_cpa_range_m < LEAST_KNOWN_M;
        let pairs = if denied { Some(Pairs::Farther) } else { self.other_pairs(plan, seen, stage) };
        let Some(pairs) = pairs.filter(|_| known) else {
            return known.then_some(track);
        };
        pairs.widen_place(&mut now);
        pairs.widen(&mut bent);
        Some(self.as_sent(plan, stage, &now, &bent))
    }

    /// Its record, its place that of its course now and its closest point that of the course about it; of a vessel that does not move the
    /// closest point is unknown.
    fn as_sent(
        &self,
        plan: &Plan<'_>,
        stage: u8,
        now: &(Course, CourseCovariance),
        bent: &(Course, CourseCovariance),
    ) -> Track {
        const UNKNOWN: f64 = f64::NAN;
        let still = Closest { time_s: UNKNOWN, range_m: UNKNOWN, heading: UNKNOWN, speed_m_s: 0.0 };
        let (c, s) = bent.0.closest(&bent.1).unwrap_or((still, [[UNKNOWN; 4]; 4]));
        let [[tt, ..], [_, rr, ..], [_, _, hh, _], [.., vv]] = s;
        let sd = |x: f64| if x >= 0.0 { math::f64::sqrt(x) as f32 } else { f32::INFINITY };
        let t_s = STEP_S * f64::from(self.to);
        let (x, y) = now.0.at(t_s);
        let (xx, yy, xy) = now.0.place_covariance(&now.1, t_s);
        let side = if c.range_m > 0.0 { -math::f64::FRAC_PI_2 } else { math::f64::FRAC_PI_2 };
        Track {
            id: self.id,
            stage,
            index: math::f64::round(t_s * plan.rate_hz) as u64,
            cpa_time_s: c.time_s,
            cpa_range_m: math::f64::abs(c.range_m) as f32,
            cpa_azimuth: wrap_tau(c.heading + side) as f32,
            heading: c.heading as f32,
            speed_m_s: c.speed_m_s as f32,
            starboard: c.range_m > 0.0,
            sd_cpa_time_s: sd(tt),
            sd_cpa_range_m: sd(rr),
            sd_heading: sd(hh),
            sd_speed_m_s: sd(vv),
            x_m: x as f32,
            y_m: y as f32,
            var_x_m2: xx as f32,
            var_y_m2: yy as f32,
            cov_xy_m2: xy as f32,
            range_observable: true,
            n: self.score.directions + self.score.distances,
        }
    }
}
