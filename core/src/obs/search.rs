//! The first guess of a course: pairs of minutes whose modes make it.
//!
//! Enters: minutes of modes. Leaves: the course with the best score among those that pass through a direction and a range
//! of one minute and a direction and a range of another. Any speed and any part of a passage can be found, which a grid
//! about an assumed closest point cannot; the radial speeds of both modes reject most pairs before they are scored.
//! A candidate is left as soon as what it has not been looked at with cannot make it the best.
//! Cost: at most 45 pairs × (12 × 12) cheap tests, a few hundred scores, of which most end after a third.

use super::course::Course;
use super::evidence::{AzimuthEvidence, Minute, RangeEvidence};
use super::fit::{self, Score, score};
use super::travel::TravelTime;
use crate::math;

/// Minutes used as ends of a pair.
const ANCHORS: usize = 10;

/// Least and greatest speed of a vessel, m/s.
const SPEED_M_S: (f64, f64) = (0.3, 18.0);

/// Least time between the two minutes of a pair, minutes: below it the velocity is too uncertain.
const APART: u32 = 12;

/// Minutes that a candidate is looked at with.
const LOOKS: usize = 60;

/// Steps of a log term's bound.
const STEPS: f64 = 8.0;

/// The best course through two minutes, with its score over all `minutes`, of each of which only what `left` leaves counts.
pub fn search<I>(
    travel: &TravelTime,
    step_s: f64,
    minutes: I,
    left: impl Fn(Minute) -> Minute + Copy,
) -> Option<(Course, Score)>
where
    I: Iterator<Item = Minute> + Clone,
{
    let usable = |m: &Minute| m.directions().next().is_some() && m.distances().next().is_some();
    let usable = minutes.clone().map(left).filter(usable);
    let count = usable.clone().count();
    if count < 2 {
        return None;
    }
    let mut anchors: [Option<Minute>; ANCHORS] = [None; ANCHORS];
    let mut wanted = 0;
    for (n, m) in usable.enumerate() {
        // Of few minutes one may be wanted several times.
        while wanted < ANCHORS && n == wanted * (count - 1) / (ANCHORS - 1) {
            if let Some(slot) = anchors.get_mut(wanted) {
                *slot = Some(m);
            }
            wanted += 1;
        }
    }
    // Scores of candidates look at every nth minute only, at most LOOKS of them.
    let stride = minutes.clone().count() / LOOKS + 1;
    let looks = minutes.clone().step_by(stride).map(left);
    let mut most = [0u8; LOOKS];
    for (most, m) in most.iter_mut().zip(looks.clone()) {
        // Rounded up, and a step more than any rounding of sums.
        *most = ((fit::most(&m) * STEPS) as u8).saturating_add(2);
    }
    let all: u32 = most.iter().map(|most| u32::from(*most)).sum();
    let scored = |course: &Course, least: f64| {
        let (mut score, mut open) = (Score::default(), all);
        for (m, most) in looks.clone().zip(most) {
            score.take(course, travel, step_s, &m);
            open = open.saturating_sub(u32::from(most));
            if score.log + f64::from(open) / STEPS < least {
                return None;
            }
        }
        (score.log > least).then_some(score)
    };
    let mut best: Option<(Course, Score)> = None;
    for (i, a) in anchors.iter().flatten().enumerate() {
        for b in anchors.iter().flatten().skip(i + 1) {
            if b.number < a.number + APART {
                continue;
            }
            for (first, second) in ends(a).flat_map(|x| ends(b).map(move |y| (x, y))) {
                let Some(course) = join(travel, step_s, a, &first, b, &second) else { continue };
                let least = best.as_ref().map_or(f64::NEG_INFINITY, |(_, best)| best.log);
                if let Some(score) = scored(&course, least) {
                    best = Some((course, score));
                }
            }
        }
    }
    best.map(|(course, _)| (course, score(&course, travel, step_s, minutes.map(left))))
}

/// Every direction with every range of a minute.
fn ends(m: &Minute) -> impl Iterator<Item = (AzimuthEvidence, RangeEvidence)> + '_ {
    m.directions().flat_map(|d| m.distances().map(move |r| (d, r)))
}

/// The course through two ends, if its speeds are possible.
fn join(
    travel: &TravelTime,
    step_s: f64,
    a: &Minute,
    first: &(AzimuthEvidence, RangeEvidence),
    b: &Minute,
    second: &(AzimuthEvidence, RangeEvidence),
) -> Option<Course> {
    let place = |m: &Minute, (d, r): &(AzimuthEvidence, RangeEvidence)| {
        let (s, c) = math::f64::sin_cos(d.azimuth);
        (step_s * f64::from(m.number) - travel.at(r.range_m), (r.range_m * s, r.range_m * c))
    };
    let course = Course::through(place(a, first), place(b, second))?;
    let v = course.speed_m_s();
    let fits = |m: &Minute, r: &RangeEvidence| {
        let seen = course.seen(travel, step_s * f64::from(m.number));
        math::f64::abs(seen.speed_m_s - r.speed_m_s) < 1.0 + 2.5 * r.sd_speed_m_s
    };
    ((SPEED_M_S.0..SPEED_M_S.1).contains(&v) && fits(a, &first.1) && fits(b, &second.1)).then_some(course)
}
