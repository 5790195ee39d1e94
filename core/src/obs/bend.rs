//! The course of a vessel that bends, at the time of its closest point: real ways depart from a straight line by kilometres
//! within 50 km, so what a vessel did an hour away says little of where and how it passed.
//!
//! Enters: minutes of modes and the straight course that explains them. Leaves: place and velocity at the straight course's
//! closest point, or at the end of the stretch next to it, with their covariance. A Kalman filter with velocity as a random
//! walk ([`DRIFT`]; less where the straight course leaves little unexplained) runs from either end of the stretch to that time, and the two are joined (the smoother of Fraser and
//! Potter 1969 at one time). A minute's best mode is taken at the filter's own prediction, with the weight of the chance that
//! it is this vessel's. Assumes as the straight fit that a minute counts a third.
//! Cost: 3000 instructions a minute of evidence.

use super::course::{Course, CourseCovariance, N};
use super::evidence::Minute;
use super::fit::{EXTRA_RANGE_M, EXTRA_SPEED_M_S, excess, own_direction, own_distance};
use super::residuals::OVERLAPPED;
use super::travel::TravelTime;
use crate::kit::spd;
use crate::math;

/// Variance that each component of the velocity gains a second, m²/s³: 0.25 m/s within an hour, 500 m of place. Merchant ships
/// on passage bend by 0.5 to 2.5 km within the two hours about their closest point.
const DRIFT: f64 = 1.7e-5;

/// By how much the residuals of the straight course exceed errors of the stated size where the whole of [`DRIFT`] is believed,
/// and the share of it where they do not: no vessel goes quite straight.
const BENT_EXCESS: f64 = 2.0 * OVERLAPPED;
const LEAST_BENT: f64 = 0.02;

/// What the straight course is worth at the far ends: place, m, and velocity, m/s.
const FIRST_SD: (f64, f64) = (3_000.0, 1.5);

/// What a prediction may add to the spread by which a mode is told to be this vessel's: rad, m, m/s.
const DOUBT: (f64, f64, f64) = (0.1, 600.0, 1.0);

/// Least chance that a mode is this vessel's for it to be used.
const LEAST_OWN: f64 = 0.05;

/// The filter: East, North, velocity at a time of emission.
#[derive(Clone, Copy, Debug)]
struct Filter {
    /// Variance that each component of the velocity gains a second, m²/s³.
    drift: f64,
    t_s: f64,
    p: [f64; N],
    covariance: CourseCovariance,
}

impl Filter {
    /// At a time, with what the straight course says.
    fn new(course: &Course, drift: f64, t_s: f64) -> Self {
        let (x, y) = course.at(t_s);
        let [_, _, vx, vy] = course.p;
        let (place, velocity) = (FIRST_SD.0 * FIRST_SD.0, FIRST_SD.1 * FIRST_SD.1);
        let mut covariance = [[0.0; N]; N];
        for (i, (row, v)) in covariance.iter_mut().zip([place, place, velocity, velocity]).enumerate() {
            row[i] = v;
        }
        Self { drift, t_s, p: [x, y, vx, vy], covariance }
    }

    /// Goes to a time, before or after.
    fn go(&mut self, t_s: f64) {
        let dt = t_s - self.t_s;
        let [x, y, vx, vy] = self.p;
        self.p = [x + vx * dt, y + vy * dt, vx, vy];
        let step = [[1.0, 0.0, dt, 0.0], [0.0, 1.0, 0.0, dt], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        self.covariance = spd::propagated(&step, &self.covariance);
        let (gained, sign) = (self.drift * math::f64::abs(dt), dt.signum());
        let [[xx, _, xu, _], [_, yy, _, yw], [ux, _, uu, _], [_, wy, _, ww]] = &mut self.covariance;
        for (place, cross, other, velocity) in [(xx, xu, ux, uu), (yy, yw, wy, ww)] {
            *place += gained * dt * dt / 3.0;
            *cross += sign * gained * math::f64::abs(dt) / 2.0;
            *other += sign * gained * math::f64::abs(dt) / 2.0;
            *velocity += gained;
        }
        self.t_s = t_s;
    }

    /// Takes in a number that departs by `e` from what is expected, `j` its change with the state.
    fn observe(&mut self, j: &[f64; N], e: f64, variance: f64) {
        let gain = spd::times(&self.covariance, j);
        let all = spd::dot(j, &gain) + variance;
        for (p, g) in self.p.iter_mut().zip(&gain) {
            *p += g * e / all;
        }
        spd::add_outer(&mut self.covariance, &gain, -1.0 / all);
    }

    /// Standard deviation of a number whose change with the state is `j`, at most so much.
    fn doubt(&self, j: &[f64; N], most: f64) -> f64 {
        math::f64::sqrt(spd::quadratic(j, &self.covariance, j).max(0.0)).min(most)
    }

    /// Takes in a minute.
    fn minute(&mut self, travel: &TravelTime, arrives_s: f64, m: &Minute) {
        let [x, y, ..] = self.p;
        self.go(arrives_s - travel.at(math::f64::hypot(x, y)));
        let [x, y, ..] = self.p;
        let r = math::f64::hypot(x, y).max(1.0);
        let j = [y / (r * r), -x / (r * r), 0.0, 0.0];
        let azimuth = math::f64::atan2(x, y);
        if let Some((own, e, sd)) = own_direction(m, azimuth, self.doubt(&j, DOUBT.0))
            && own > LEAST_OWN
        {
            self.observe(&j, e, OVERLAPPED * sd * sd / own);
        }
        let [x, y, vx, vy] = self.p;
        let r = math::f64::hypot(x, y).max(1.0);
        let (ux, uy) = (x / r, y / r);
        let speed = ux * vx + uy * vy;
        let (place, motion) = ([ux, uy, 0.0, 0.0], [(vx - ux * speed) / r, (vy - uy * speed) / r, ux, uy]);
        let doubts = (self.doubt(&place, DOUBT.1), self.doubt(&motion, DOUBT.2));
        if let Some((own, d)) = own_distance(m, r, speed, doubts)
            && own > LEAST_OWN
        {
            let variance = |sd: f64, extra: f64| OVERLAPPED * (sd * sd + extra * extra) / own;
            self.observe(&place, d.range_m - r, variance(d.sd_m, EXTRA_RANGE_M));
            let [x, y, vx, vy] = self.p;
            let r = math::f64::hypot(x, y).max(1.0);
            let e = d.speed_m_s - (x * vx + y * vy) / r;
            self.observe(&motion, e, variance(d.sd_speed_m_s, EXTRA_SPEED_M_S));
        }
    }
}

/// The course about its closest point. `before` are the minutes in the order of time, `after` the same from the last to the
/// first. `None` where the two do not join.
pub fn about_closest(
    course: &Course,
    travel: &TravelTime,
    step_s: f64,
    before: impl Iterator<Item = Minute> + Clone,
    after: impl Iterator<Item = Minute>,
) -> Option<(Course, CourseCovariance)> {
    let closest_s = course.closest(&[[0.0; N]; N])?.0.time_s;
    let at = |m: &Minute| step_s * f64::from(m.number);
    let (directions, ranges) = excess(course, travel, step_s, before.clone());
    let unexplained = (directions.max(ranges) - OVERLAPPED) / (BENT_EXCESS - OVERLAPPED);
    let drift = DRIFT * unexplained.clamp(LEAST_BENT, 1.0);
    let (mut here, mut there): (Option<Filter>, Option<Filter>) = (None, None);
    for m in before.take_while(|m| at(m) <= closest_s) {
        here.get_or_insert_with(|| Filter::new(course, drift, at(&m))).minute(travel, at(&m), &m);
    }
    for m in after.take_while(|m| at(m) > closest_s) {
        there.get_or_insert_with(|| Filter::new(course, drift, at(&m))).minute(travel, at(&m), &m);
    }
    let joined = match (here, there) {
        (Some(mut a), Some(mut b)) => {
            a.go(closest_s);
            b.go(closest_s);
            join(&a, &b)?
        }
        (Some(one), None) | (None, Some(one)) => one,
        (None, None) => return None,
    };
    let found = Course { t0_s: joined.t_s, p: joined.p };
    // To the closest point it drifts further.
    let mut ahead = joined;
    ahead.go(found.closest(&joined.covariance)?.0.time_s);
    Some((Course { t0_s: ahead.t_s, p: ahead.p }, ahead.covariance))
}

/// What two independent filters know together.
fn join(a: &Filter, b: &Filter) -> Option<Filter> {
    let (of_a, of_b) = (spd::inverse(&a.covariance)?, spd::inverse(&b.covariance)?);
    let mut information = of_a;
    for (row, other) in information.iter_mut().zip(&of_b) {
        row.iter_mut().zip(other).for_each(|(x, y)| *x += y);
    }
    let covariance = spd::inverse(&information)?;
    // p = a + C B (b − a).
    let mut apart = b.p;
    apart.iter_mut().zip(&a.p).for_each(|(b, a)| *b -= a);
    let moved = spd::times(&covariance, &spd::times(&of_b, &apart));
    let mut p = a.p;
    p.iter_mut().zip(&moved).for_each(|(p, m)| *p += m);
    Some(Filter { p, covariance, ..*a })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::wrap_pi;
    use crate::obs::presence::{RangeMode, RangePresence};
    use crate::obs::tonal::{Directions, Mode};
    use std::vec::Vec;

    /// A vessel that turns by 17° within four hours; what it shows each minute, with errors of the stated size.
    fn seen() -> (Vec<Minute>, Course) {
        let (mut x, mut y, mut heading) = (-60_000.0f64, 6_000.0f64, 1.35f64);
        let (mut seed, mut out) = (5u32, Vec::new());
        let mut closest = Course { t0_s: 0.0, p: [x, y, 0.0, 0.0] };
        let mut normal = || {
            (0..12).fold(-6.0, |sum, _| {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum + f64::from(seed >> 8) / 16_777_216.0
            })
        };
        for n in 1..=240u32 {
            heading += 0.3 / 240.0;
            let (vx, vy) = (8.0 * math::f64::sin(heading), 8.0 * math::f64::cos(heading));
            (x, y) = (x + 60.0 * vx, y + 60.0 * vy);
            let r = math::f64::hypot(x, y);
            if r < math::f64::hypot(closest.p[0], closest.p[1]) {
                closest = Course { t0_s: 60.0 * f64::from(n), p: [x, y, vx, vy] };
            }
            let mut directions =
                Directions { modes: [None; 3], log_presence: 20.0, log_below: f32::NEG_INFINITY, frames: 17 };
            directions.modes[0] = Some(Mode {
                azimuth: (math::f64::atan2(x, y) + 0.03 * normal()) as f32,
                sd: 0.022,
                log_presence: 20.0,
                bins: 5,
                step: 0,
                impulsive: false,
            });
            let mut modes = [None; 4];
            modes[0] = (r < 45_000.0).then(|| RangeMode {
                range_m: (r + 90.0 * normal()) as f32,
                sd_range_m: 80.0,
                speed_m_s: ((x * vx + y * vy) / r + 0.5 * normal()) as f32,
                sd_speed_m_s: 0.3,
                weight: 0.9,
                detected: true,
                tracked: false,
                sure: true,
            });
            let ranges = RangePresence { log_odds: 5.0, log_evidence: 5.0, approaching: 0.5, modes };
            out.push(Minute::new(n, &directions, &ranges));
        }
        (out, closest)
    }

    #[test]
    fn a_way_that_bends_is_known_where_it_passes() {
        let (minutes, want) = seen();
        let travel = TravelTime::EMPTY;
        let start = Course { t0_s: 0.0, p: [-60_000.0, 6_000.0, 8.0, 0.5] };
        let (straight, _) =
            super::super::fit::refine(&start, &travel, 60.0, minutes.iter().copied()).unwrap();
        let error = |c: &Course| {
            let (k, _) = c.closest(&[[0.0; N]; N]).unwrap();
            let (w, _) = want.closest(&[[0.0; N]; N]).unwrap();
            [
                k.time_s - w.time_s,
                math::f64::abs(k.range_m) - math::f64::abs(w.range_m),
                wrap_pi(k.heading - w.heading),
                k.speed_m_s - w.speed_m_s,
            ]
        };
        let (bent, covariance) =
            about_closest(&straight, &travel, 60.0, minutes.iter().copied(), minutes.iter().rev().copied())
                .unwrap();
        let (before, after) = (error(&straight), error(&bent));
        assert!(after[1].abs() < 0.5 * before[1].abs(), "{before:?} {after:?}");
        let (_, s) = bent.closest(&covariance).unwrap();
        for k in 0..N {
            let sd = math::f64::sqrt(s[k][k]);
            assert!(after[k].abs() < 3.0 * sd, "{k}: {} ± {sd}", after[k]);
        }
    }
}
