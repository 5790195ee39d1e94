//! Tracks of the vessels present: found, refined while they pass, closed with the best course over their whole stay.
//!
//! Enters: the ring of evidence, once a minute. Leaves: `Track` messages, stage 0 every five minutes while a vessel
//! passes (of several less often: `allowance`), stage 1 once when it has gone or the record ends, or stage 2 once where a track that was reported is withdrawn:
//! a truer course explains its evidence. Several vessels are several tracks: what one explains is hidden from the search for
//! the next, the best explained first. A track is abandoned for a better course whenever one is found, which undoes early
//! locks on a wrong branch. What is told of each: `told`. Cost: below 40 M instructions every five minutes, none between.

use super::allowance::Allowance;
use super::course::{Course, CourseCovariance};
use super::evidence::{Evidence, MINUTES, Minute};
use super::fit::{self, Score};
use super::gone::Gone;
use super::lasting::{Lasting, Told};
use super::limits::{MAX_SPEED_M_S, VESSELS};
use super::plan::{Plan, STEP_S};
use super::presence::{Expected, ExpectedVessels};
use super::search::search;
use crate::math;
use crate::wire::Message;
use told::Seen;

mod by_lines;
mod told;
mod turned;

/// Places for tracks.
const LIVE: usize = VESSELS;

/// Minutes with a range after which a track is not on a wrong pair of paths any more, if a share of them has echoes of the
/// table's strengths, or if they span so great a ratio of ranges that other pairs of paths would show others.
const ESTABLISHED: u16 = 40;
const SPAN: f32 = 2.0;

/// What the ranges of a vessel's minutes must say for it together, natural logarithm. Directions alone make the greatest part of a
/// score, and of hundreds of minutes with a direction some have a range of noise that lies on some course of that shape: such courses
/// differ in scale alone, of which a hundred can be told apart, so noise should get there once in two hundred of them.
const LEAST_RANGE_LOG: f32 = 10.0;

/// The least ratio of two ranges at which pairs of paths have one delay (57 as 35).
const NEAREST_PAIRS: f32 = 1.5;

/// Minutes in which another pair of paths explains its echoes better, that say nothing yet.
const FEW_RIVALS: u16 = 5;

/// Minutes with a range so near that a vessel twice as far would be in the model, after which it is not that.
const FEW_NEAR: u16 = 5;

/// Minutes between looks.
const EVERY: u32 = 5;

/// Minutes searched for a new vessel.
const SEARCHED: u32 = 120;

/// Minutes without support after which a track is closed.
const SILENCE: u32 = 45;

/// What a course must have explained to be a vessel: log score, minutes with direction, minutes with range, and of those
/// minutes with both, since directions of one vessel and ranges of another make courses too.
const ACCEPT: (f64, u16, u16, u16) = (60.0, 15, 10, 6);

/// Speeds of vessels under way, m/s. Of 4200 reports of 450 cargo vessels and tankers about RR03 (satellite AIS, status 0) 3.7 % are below
/// 1 m/s, adrift or waiting, 0.2 % from there to 2 m/s, and none is above 11.4 m/s; courses found there are mostly a vessel's at another
/// pair of paths, at twice or a part of its speed. No radial speed above the second is looked for either.
const SPEEDS_M_S: core::ops::Range<f64> = 2.0..MAX_SPEED_M_S as f64;

/// A course that is found again ends no farther than this from where it was known, m: less than a range is known to.
const ALONG_M: f64 = 20.0;

/// Log score by which another course must be better to take a track over.
const BETTER: f64 = 6.0;

/// One vessel.
#[derive(Clone, Copy, Debug)]
struct Live {
    id: u16,
    course: Course,
    covariance: CourseCovariance,
    /// Its course now, where it bends.
    now: Course,
    score: Score,
    /// First and last minute it explains.
    from: u32,
    to: u32,
    /// Records told of it, sent or not; the first is. A number, because an empty place must stay all zeros: the whole station is.
    sent: u16,
}

/// Courses of other tracks, and of which the echoes are hidden too, as another pair of paths would have them.
#[derive(Clone, Copy, Debug)]
struct Others {
    courses: [Option<Course>; LIVE],
    echoes: [bool; LIVE],
}

/// All tracks.
#[derive(Clone, Debug)]
pub struct Tracker {
    live: [Option<Live>; LIVE],
    gone: Gone,
    next_id: u16,
    /// Whether echoes may be read as another pair of paths than theirs.
    pub(super) pairs_in_doubt: bool,
    /// Standard deviation of north's gain over east's that is not told but found, dB.
    pub(super) gain_sd_db: f32,
    /// What the line has room for.
    pub(super) allowance: Allowance,
}

impl Tracker {
    /// None yet.
    pub const fn new() -> Self {
        Self {
            live: [None; LIVE],
            gone: Gone::new(),
            next_id: 0,
            pairs_in_doubt: false,
            gain_sd_db: 0.0,
            allowance: Allowance::new(),
        }
    }

    /// Looks at the evidence up to minute `now`.
    pub fn minute(
        &mut self,
        plan: &Plan<'_>,
        evidence: &mut Evidence,
        now: u32,
        sink: &mut dyn FnMut(Message),
    ) {
        if !now.is_multiple_of(EVERY) {
            return;
        }
        let (in_doubt, lasting) = (self.pairs_in_doubt, plan.lasting.with_gain_doubt(self.gain_sd_db));
        self.improve(plan, evidence, now, sink);
        let tracks = self.live.iter().flatten().count();
        for k in 0..LIVE {
            let (others, turned) = (self.others(k), self.turned(k));
            let Some(slot) = self.live.get_mut(k) else { continue };
            let Some(live) = slot else { continue };
            let wait = if turned { SILENCE } else { live.waits() };
            if now > live.to + wait {
                let seen = Seen { evidence, others, gone: &self.gone, in_doubt, lasting: &lasting };
                let told = live.end(plan, &seen, now, turned, sink);
                let (course, echoes) = (live.course, live.shows_itself());
                evidence.forget(|m| without(plan, &course, echoes, told, m));
                // Of what was no vessel's course the directions are some vessel's.
                if told {
                    self.gone.push(course);
                }
                *slot = None;
            } else {
                let seen = Seen { evidence, others, gone: &self.gone, in_doubt, lasting: &lasting };
                let now_seen = live.now(plan, &seen);
                (live.now, _) = now_seen;
                if now < live.to + EVERY + 2 {
                    // Where there is no room for all, they take turns.
                    let turn = (now / EVERY) as usize % LIVE == k;
                    let room = self.allowance.has_room_for(if turn { 1 } else { tracks });
                    live.run(plan, &seen, Some(&now_seen), &mut self.allowance, room, sink);
                }
            }
        }
        if self.live.iter().any(Option::is_none) {
            let others = self.beside(|_| true, f64::NEG_INFINITY);
            let from = now.saturating_sub(SEARCHED);
            let again = |found: &Live| {
                let ends_s = [found.from, found.to].map(|k| STEP_S * f64::from(k));
                self.gone.is_again(&found.course, &plan.travel, ends_s)
            };
            let found = find(plan, evidence, &others, (from, now), None).filter(|found| !again(found));
            if let Some(mut found) = found {
                found.id = self.next_id;
                if let Some(slot) = self.live.iter_mut().find(|s| s.is_none()) {
                    self.next_id = self.next_id.wrapping_add(1);
                    let seen = Seen { evidence, others, gone: &self.gone, in_doubt, lasting: &lasting };
                    found.run(plan, &seen, None, &mut self.allowance, true, sink);
                    *slot = Some(found);
                }
            }
        }
    }

    /// Withdraws every track and forgets what they were found in: directions were none.
    pub(super) fn withdraw(
        &mut self,
        plan: &Plan<'_>,
        evidence: &mut Evidence,
        sink: &mut dyn FnMut(Message),
    ) {
        evidence.clear();
        for slot in &mut self.live {
            if let Some(live) = slot {
                live.withdraw(plan, sink);
            }
            *slot = None;
        }
    }

    /// Closes every track.
    pub fn finish(&mut self, plan: &Plan<'_>, evidence: &Evidence, now: u32, sink: &mut dyn FnMut(Message)) {
        self.improve(plan, evidence, now, sink);
        let (in_doubt, lasting) = (self.pairs_in_doubt, plan.lasting.with_gain_doubt(self.gain_sd_db));
        for k in 0..LIVE {
            let (others, turned) = (self.others(k), self.turned(k));
            if let Some(live) = self.live.get(k).and_then(Option::as_ref) {
                live.end(
                    plan,
                    &Seen { evidence, others, gone: &self.gone, in_doubt, lasting: &lasting },
                    now,
                    turned,
                    sink,
                );
            }
        }
        self.live = [None; LIVE];
        self.gone = Gone::new();
    }

    /// Refines every track on what the others leave, then lets each, the strongest first, take over a better course
    /// in all that stronger ones leave: the directions of one vessel and the ranges of another, or one vessel at the wrong
    /// pair of paths, cannot hold on to evidence that a truer course explains better. What no longer is a vessel goes, and
    /// is withdrawn where it was reported.
    fn improve(&mut self, plan: &Plan<'_>, evidence: &Evidence, now: u32, sink: &mut dyn FnMut(Message)) {
        for k in 0..LIVE {
            let others = self.others(k);
            if let Some(live) = self.live.get_mut(k).and_then(Option::as_mut) {
                live.refine(plan, evidence, &others, now);
            }
        }
        let order = self.strongest_first();
        // Of one alone the others leave all that stronger ones leave: its bounds are known.
        let bounded = self.live.iter().flatten().count() == 1;
        for (n, k) in order.iter().enumerate() {
            let stronger = self.beside(|other| order.iter().take(n).any(|s| *s == other), f64::NEG_INFINITY);
            let Some(slot) = self.live.get_mut(*k) else { continue };
            let Some(live) = slot else { continue };
            let from = live.from.saturating_sub(30);
            if !bounded {
                // The echoes of weaker ones are theirs, and no rivals.
                let rivals = live.score.rivals;
                live.bound(plan, evidence, &stronger, now);
                live.score.rivals = live.score.rivals.min(rivals);
            }
            live.take_over(plan, evidence, &stronger, from, now);
            if !live.is_a_vessel() {
                live.withdraw(plan, sink);
                *slot = None;
            } else if live.sent > 0 && !live.is_under_way() {
                live.withdraw(plan, sink);
                (live.id, live.sent) = (self.next_id, 0);
                self.next_id = self.next_id.wrapping_add(1);
            }
        }
    }

    /// Places in the list of tracks, the best explained first, empty ones last.
    fn strongest_first(&self) -> [usize; LIVE] {
        let mut order: [usize; LIVE] = core::array::from_fn(|k| k);
        let score = |k: &usize| {
            self.live.get(*k).and_then(Option::as_ref).map_or(f64::NEG_INFINITY, |live| live.score.log)
        };
        order.sort_unstable_by(|a, b| score(b).total_cmp(&score(a)).then(a.cmp(b)));
        order
    }

    /// Where each vessel is expected to be seen in a minute.
    pub fn expected(&self, plan: &Plan<'_>, minute: u32) -> ExpectedVessels {
        self.live.map(|live| {
            let live = live?;
            // A course on a wrong pair of paths must not bend after echoes that are not its own.
            let established = live.is_established();
            let strong = established && live.score.is_sure();
            let course = if strong { &live.now } else { &live.course };
            let s = course.seen(&plan.travel, STEP_S * f64::from(minute));
            let placed = established && !live.may_be_beyond(2.0);
            Some(Expected {
                range_m: s.range_m as f32,
                speed_m_s: s.speed_m_s as f32,
                established,
                strong,
                placed,
            })
        })
    }

    /// All but one.
    fn others(&self, k: usize) -> Others {
        let least = self.live.get(k).and_then(Option::as_ref).map_or(f64::INFINITY, |live| live.score.log);
        self.beside(|other| other != k, least)
    }

    /// The tracks in the places wanted, the echoes of those too that are better explained than `least`.
    fn beside(&self, wanted: impl Fn(usize) -> bool, least: f64) -> Others {
        let echoes = |live: &Live| live.score.log > least && live.shows_itself();
        Others {
            courses: self.courses(wanted),
            echoes: self.live.each_ref().map(|live| live.as_ref().is_some_and(echoes)),
        }
    }

    /// Courses of the tracks in the places wanted.
    fn courses(&self, wanted: impl Fn(usize) -> bool) -> [Option<Course>; LIVE] {
        let mut out = [None; LIVE];
        for (k, (slot, live)) in out.iter_mut().zip(&self.live).enumerate() {
            *slot = live.as_ref().filter(|_| wanted(k)).map(|l| l.course);
        }
        out
    }
}

/// The minutes of a stretch without what other vessels explain; as they would be with one of the errors told, where one is given.
fn unexplained<'a>(
    plan: &'a Plan<'_>,
    evidence: &'a Evidence,
    others: &'a Others,
    error: Option<(&'a Lasting, Told)>,
    from: u32,
    to: u32,
) -> impl Iterator<Item = Minute> + Clone + 'a {
    evidence.between(from, to).map(move |m| shifted(error, without_all(plan, others, m)))
}

/// A minute as it would be with one of the errors told by one deviation more; the same without any.
fn shifted(error: Option<(&Lasting, Told)>, m: Minute) -> Minute {
    error.map_or(m, |(lasting, error)| lasting.shifted(error, m))
}

/// A minute without what any of these vessels explains. Wanted in many places, and large.
#[inline(never)]
fn without_all(plan: &Plan<'_>, others: &Others, m: Minute) -> Minute {
    let all = others.courses.iter().zip(others.echoes);
    all.fold(m, |m, (course, echoes)| course.as_ref().map_or(m, |c| without(plan, c, echoes, true, m)))
}

/// A minute without what one vessel explains, and with its echoes without those ranges that move along with it as these do where they
/// are read as another pair of paths: with the directions of another vessel they would make a course of nobody.
fn without(plan: &Plan<'_>, course: &Course, echoes: bool, directions: bool, m: Minute) -> Minute {
    let s = course.seen(&plan.travel, STEP_S * f64::from(m.number));
    let (known, towards) = ((s.range_m as f32, s.speed_m_s as f32), s.towards());
    m.without(
        |d| directions && fit::explains_direction(d, towards),
        |d| {
            fit::explains_distance(d, s.range_m, s.speed_m_s)
                || echoes && plan.interference.follows((d.range_m as f32, d.speed_m_s as f32), known)
        },
    )
}

/// A vessel in the minutes from `from` to `to` that no other track explains, unless its course is that of `known`.
fn find(
    plan: &Plan<'_>,
    evidence: &Evidence,
    others: &Others,
    (from, to): (u32, u32),
    known: Option<&Live>,
) -> Option<Live> {
    let travel = &plan.travel;
    let left = |m| without_all(plan, others, m);
    let (course, first) = search(travel, STEP_S, evidence.between(from, to), left)?;
    if first.directions < ACCEPT.1 / 2 || first.distances < ACCEPT.2 / 2 {
        return None;
    }
    let minutes = unexplained(plan, evidence, others, None, from, to);
    let (course, covariance) = fit::refine(&course, travel, STEP_S, minutes)?;
    if known.is_some_and(|known| known.goes_along(&course)) {
        return None;
    }
    let mut live =
        Live { id: 0, course, covariance, now: course, score: Score::default(), from, to, sent: 0 };
    live.bound(plan, evidence, others, to);
    live.is_a_vessel().then_some(live)
}

impl Live {
    /// Whether its speed is one of vessels under way. Others are followed as well, so that what they explain makes no course of a vessel at
    /// another pair of paths, but not told.
    fn is_under_way(&self) -> bool {
        SPEEDS_M_S.contains(&self.course.speed_m_s())
    }

    /// Whether the course explains enough.
    fn is_a_vessel(&self) -> bool {
        let s = &self.score;
        let explains = s.directions >= ACCEPT.1 && s.distances >= ACCEPT.2 && s.both >= ACCEPT.3;
        let rivalled = s.rivals > s.sure.max(2 * FEW_RIVALS);
        s.log >= ACCEPT.0 && s.range_log >= LEAST_RANGE_LOG && explains && !rivalled
    }

    /// Whether it is not on a wrong pair of paths any more.
    fn is_established(&self) -> bool {
        let s = &self.score;
        let far = s.span_m.1 >= SPAN * s.span_m.0;
        s.distances >= ESTABLISHED && (s.is_sure() || far) && s.rivals <= s.sure.max(FEW_RIVALS)
    }

    /// Whether a course is this vessel's all the way it is heard, and so explains no more.
    fn goes_along(&self, course: &Course) -> bool {
        [self.from, self.to].iter().all(|k| {
            let t_s = STEP_S * f64::from(*k);
            let ((x, y), (own_x, own_y)) = (course.at(t_s), self.course.at(t_s));
            math::f64::hypot(x - own_x, y - own_y) < ALONG_M
        })
    }

    /// Whether it may be a vessel beyond the model all along, so many times as far and as fast, and louder than the table's: it has not
    /// come so near that such a one would be in the model, and none is that fast.
    fn may_be_beyond(&self, times: f64) -> bool {
        self.score.near < FEW_NEAR && times * self.course.speed_m_s() < SPEEDS_M_S.end
    }

    /// Whether its range shows in so many of its minutes that what looks like one of its echoes is one, and whether it has come so much
    /// nearer or gone so much farther that it is not on a wrong pair of paths itself. A track of one vessel's directions
    /// and another's ranges as another pair of paths has ranges now and then; and two vessels of which one is a third farther off, 47
    /// and 35 km, share an echo that is read at 23 km for as long as they keep to that.
    fn shows_itself(&self) -> bool {
        let s = &self.score;
        2 * s.both >= s.directions && s.span_m.1 >= NEAREST_PAIRS * s.span_m.0
    }

    /// Finds the stretch the course explains: from where, and to where, its terms add up to most.
    fn bound(&mut self, plan: &Plan<'_>, evidence: &Evidence, others: &Others, now: u32) {
        let travel = &plan.travel;
        let minutes = || unexplained(plan, evidence, others, None, now.saturating_sub(MINUTES as u32), now);
        // Largest sum of a contiguous stretch, and its score.
        let (mut sum, mut start, mut score) = (0.0, 0, Score::default());
        let (mut best, mut of_best) = (0.0, None);
        for m in minutes() {
            if sum <= 0.0 {
                (sum, start, score) = (0.0, m.number, Score::default());
            }
            sum += score.take(&self.course, travel, STEP_S, &m);
            if sum > best {
                (best, of_best) = (sum, Some(score));
                (self.from, self.to) = (start, m.number);
            }
        }
        if let Some(score) = of_best {
            self.score = score;
            return;
        }
        let (from, to) = (self.from, self.to);
        let inside = minutes().filter(move |m| (from..=to).contains(&m.number));
        self.score = fit::score(&self.course, travel, STEP_S, inside);
    }

    /// Refines over its stretch.
    fn refine(&mut self, plan: &Plan<'_>, evidence: &Evidence, others: &Others, now: u32) {
        let minutes = unexplained(plan, evidence, others, None, self.from, now);
        if let Some((course, covariance)) = fit::refine(&self.course, &plan.travel, STEP_S, minutes) {
            (self.course, self.covariance) = (course, covariance);
        }
        self.bound(plan, evidence, others, now);
    }

    /// Takes over a better course if there is one in what `stronger` tracks leave from minute `from` on.
    fn take_over(&mut self, plan: &Plan<'_>, evidence: &Evidence, stronger: &Others, from: u32, now: u32) {
        if let Some(other) = find(plan, evidence, stronger, (from, now), Some(self)) {
            self.rather(other, plan, evidence, stronger, now);
        }
        self.follow_lines(plan, evidence, stronger, now);
        // Its echoes may be another pair of paths' all along: the course so many times as far explains those as well, and what has come into
        // the model since.
        for times in fit::READ {
            if self.may_be_beyond(times) {
                let farther = Self { course: self.course.times(times), ..*self };
                self.rather(farther, plan, evidence, stronger, now);
            }
        }
    }

    /// Takes over a course if it is better in what `stronger` tracks leave.
    fn rather(&mut self, mut other: Self, plan: &Plan<'_>, evidence: &Evidence, stronger: &Others, now: u32) {
        other.refine(plan, evidence, stronger, now);
        if !other.is_a_vessel() {
            return;
        }
        let log = |live: &Self| live.score.log + live.fall(plan, evidence, stronger).log();
        if log(&other) > log(self) + BETTER {
            *self = Self { id: self.id, sent: self.sent, ..other };
        }
    }
}

#[cfg(test)]
mod tests;
