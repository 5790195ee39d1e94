//! A vessel that turned: its track falls silent where that of its new course begins.
//!
//! Tracks are straight, so one that turns is two of them. Enters: all tracks. Leaves: whether the vessel of one goes on as another's. Two vessels
//! would have to be in one place at one speed when the one falls silent and the other is heard first. Cost: a thousand instructions a track that
//! falls silent.

use super::told::LEAVING;
use super::{LIVE, Live, SILENCE, STEP_S, Tracker};
use crate::math;

/// How near the two courses come, m: a ship that turns by a right angle in ten minutes is 700 m off the corner of its straight courses, which
/// are known to some hundred metres there.
const MEET_M: f64 = 2_000.0;

/// By what part of its speed it may be slower or faster: a ship loses speed in a turn, for minutes.
const AS_FAST: f64 = 0.15;

/// How long before its track ends it may turn, and be heard on its new course, minutes: a straight course goes on to explain directions.
const BEFORE: u32 = 20;

/// Minutes with a direction and a range on its course that make it some vessel's: weak ones never have echoes of the table's strengths.
const KNOWN_WELL: u16 = 20;

impl Live {
    /// Whether it is surely some vessel's, of which a track that falls silent says that it turned.
    fn may_have_turned(&self) -> bool {
        self.score.both >= KNOWN_WELL
    }

    /// Whether its vessel goes on as the other's.
    fn goes_on_as(&self, other: &Self) -> bool {
        let heard = self.to.saturating_sub(BEFORE)..self.to + SILENCE;
        let speed_m_s = self.course.speed_m_s();
        let as_fast = math::f64::abs(other.course.speed_m_s() - speed_m_s) < AS_FAST * speed_m_s;
        let meets = |minute: u32| {
            let t_s = STEP_S * f64::from(minute);
            let ((x, y), (ox, oy)) = (self.course.at(t_s), other.course.at(t_s));
            math::f64::hypot(x - ox, y - oy) < MEET_M
        };
        self.may_have_turned() && heard.contains(&other.from) && as_fast && heard.into_iter().any(meets)
    }

    /// After how many minutes without support its track is closed: one that fell silent where a vessel that goes on does not waits for a new
    /// course of it, of which no range is heard while it is near.
    pub(super) fn waits(&self) -> u32 {
        let [x, y, vx, vy] = self.course.p;
        let t_s = STEP_S * f64::from(self.to.saturating_sub(LEAVING)) - self.course.t0_s;
        let comes = (x + vx * t_s) * vx + (y + vy * t_s) * vy < 0.0;
        if comes && self.may_have_turned() { 2 * SILENCE } else { SILENCE }
    }
}

impl Tracker {
    /// Whether the vessel of track `k` turned, and is tracked on.
    pub(super) fn turned(&self, k: usize) -> bool {
        let Some(live) = self.live.get(k).and_then(Option::as_ref) else { return false };
        (0..LIVE).filter(|other| *other != k).any(|other| {
            self.live.get(other).and_then(Option::as_ref).is_some_and(|other| live.goes_on_as(other))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{NO_RANGES, directions, mode};
    use super::super::{EVERY, Evidence, Message, Minute, Plan};
    use super::*;
    use crate::obs::course::Course;
    use crate::obs::presence::RangePresence;
    use crate::obs::travel::TravelTime;
    use crate::wire::Track;
    use std::boxed::Box;
    use std::vec::Vec;

    /// East, North and velocity at time 0 of a vessel whose closest point is in minute 103, in which it turns.
    const FIRST: [f64; 4] = [-30_000.0, 8_000.0, 5.0, 0.5];
    const TURNS: u32 = 103;

    /// What stages the tracks of a vessel have that goes on north from where the first course ends, or from a place so far off, at so many times its speed.
    fn told(aside_m: f64, faster: f64) -> Vec<(u16, u8)> {
        let turn_s = STEP_S * f64::from(TURNS);
        let (x, y) = Course { t0_s: 0.0, p: FIRST }.at(turn_s);
        let second = Course { t0_s: turn_s, p: [x + aside_m, y, 0.5 * faster, 5.0 * faster] };
        let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
        let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
        let mut last = Vec::new();
        for n in 1..=TURNS + 2 * SILENCE + 2 * EVERY {
            let course = if n <= TURNS { Course { t0_s: 0.0, p: FIRST } } else { second };
            let s = course.seen(&TravelTime::EMPTY, STEP_S * f64::from(n));
            let ranges =
                RangePresence { modes: [mode(s.range_m, s.speed_m_s), None, None, None], ..NO_RANGES };
            evidence.push(Minute::new(n, &directions([&s, &s]), &ranges));
            tracker.minute(&plan, &mut evidence, n, &mut |m| {
                if let Message::Track(t) = m {
                    last.retain(|(id, _)| *id != t.id);
                    last.push((t.id, t.stage));
                }
            });
        }
        last.sort_unstable();
        last
    }

    #[test]
    fn both_courses_of_a_vessel_that_turns_are_told() {
        assert_eq!(told(0.0, 1.0), [(0, Track::FINAL), (1, Track::RUNNING)]);
    }

    #[test]
    fn a_vessel_elsewhere_or_faster_is_not_the_one_that_fell_silent() {
        assert_eq!(told(5_000.0, 1.0).first(), Some(&(0, Track::WITHDRAWN)));
        assert_eq!(told(0.0, 1.5).first(), Some(&(0, Track::WITHDRAWN)));
    }
}
