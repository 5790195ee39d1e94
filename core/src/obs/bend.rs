//! The course of a vessel that bends, at the time of its closest point: real ways depart from a straight line by kilometres
//! within 50 km, so what a vessel did an hour away says little of where and how it passed.
//!
//! Enters: minutes of modes and the straight course that explains them. Leaves: place and velocity at the straight course's
//! closest point, or at the end of the stretch next to it, with their covariance; and those at the end of the stretch. Kalman
//! filters with velocity as a random walk run from either end of the stretch to that time, and the two are joined (the smoother
//! of Fraser and Potter 1969 at one time). How much a vessel's velocity drifts is not known: each of [`DRIFTS`] counts by the
//! likelihood of what was seen, of the present by that of the last hour. A minute's best mode is taken at the filter's own prediction, with the weight of the chance that it
//! is this vessel's; the side that tells less takes it where both sides predict, for inside 7 km a vessel shows no range, and a
//! few minutes of directions alone would follow another vessel's.
//! Cost: below 30 000 instructions a minute of evidence.

use super::course::{Course, CourseCovariance, N};
use super::evidence::{Minute, RangeEvidence};
use super::fit::{Towards, own_direction, own_distance};
use super::lasting;
use super::travel::TravelTime;
use crate::angle::wrap_pi;
use crate::kit::spd;
use crate::math;

/// Variances that each component of the velocity may gain a second, m²/s³: 0.02, 0.08 and 0.4 m/s within an hour. Some vessels keep
/// their course and speed; the speeds that merchant vessels report change by 0.15 m/s within an hour in the median and by 0.4 m/s in the root
/// of the mean square.
const DRIFTS: [f64; 3] = [1e-7, 2e-6, 4.2e-5];

/// How much of what speaks for a drift is left a minute later, where the present is told: that a small one explained hours of a straight way
/// must not hold a vessel to it that turns (forgetting, as in the dynamic model averaging of Raftery et al. 2010).
const REMEMBERED: f64 = 0.98;

/// By how much the variance of many directions, of many ranges and of many radial speeds exceeds that of independent ones of their
/// stated spreads. Measured in a month of real ways, where one vessel is heard: the mean square of errors in their stated deviations, 0.56,
/// 0.81 and 0.37, times the sum of their correlations, 3.1 (windows of directions overlap: 0.6 a minute apart, 0.3 two), 2.0 and 3.0. Of
/// directions where two are heard it is 4.2, told in part by their spread.
const DIRECTIONS: f64 = 2.0;
const RANGES: f64 = 1.6;
const SPEEDS: f64 = 1.1;

/// Error of all ranges near one place, m: of the means of ten minutes about a closest point 12 m are left, of which 10 are chance.
const TABLE_M: f64 = 6.0;

/// Error of all directions towards one place, rad: of the present told of several vessels and of real ways 20 to 60 km away, which lean
/// on each other's directions and bend, errors across are 1.2 to 2 times what independent ones leave; 0.17 degrees.
const TOWARDS: f64 = 0.003;

/// What the straight course is worth at the far ends: place, m, and velocity, m/s.
const FIRST_SD: (f64, f64) = (2_000.0, 0.6);

/// Standard deviations by which a vessel's range and radial speed may differ from those of its straight course, m and m/s: what does
/// not go with the course is another pair of paths or another vessel, however well it goes with a filter that took one for it before.
const BENDS: (f64, f64) = (2_000.0, 0.6);

/// What a prediction may add to the spread by which a mode is told to be this vessel's: rad, m, m/s.
const DOUBT: (f64, f64, f64) = (0.1, 600.0, 1.0);

/// Ranges beyond which nothing is taken from, m: vessels are hardly heard there.
const FARTHEST_M: f64 = 60_000.0;

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
    /// Logarithm of the likelihood of what it took in.
    log: f64,
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
        Self { drift, t_s, p: [x, y, vx, vy], covariance, log: 0.0 }
    }

    /// Goes to a time, before or after.
    fn go(&mut self, t_s: f64) {
        let dt = t_s - self.t_s;
        let [x, y, vx, vy] = self.p;
        self.p = [x + vx * dt, y + vy * dt, vx, vy];
        // J C Jᵀ of a step that adds the velocities' way to the places: from the rows, then from the columns.
        let c = &mut self.covariance;
        for row in &mut *c {
            let [x, y, u, w] = *row;
            *row = [x + u * dt, y + w * dt, u, w];
        }
        let [x, y, u, w] = *c;
        *c = [core::array::from_fn(|k| x[k] + dt * u[k]), core::array::from_fn(|k| y[k] + dt * w[k]), u, w];
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

    /// Takes in a number that departs by `e` from what is expected, `j` its change with the state, if it is this vessel's, as it
    /// is with that chance: the moments of both answers together [Bar-Shalom and Tse 1975], so that what may be another's does
    /// not make a vessel's place seem known.
    fn observe(&mut self, j: &[f64; N], e: f64, variance: f64, chance: f64) {
        let gain = spd::times(&self.covariance, j);
        let all = spd::dot(j, &gain) + variance;
        for (p, g) in self.p.iter_mut().zip(&gain) {
            *p += chance * g * e / all;
        }
        let moved = (1.0 - chance) * e * e / all;
        spd::add_outer(&mut self.covariance, &gain, chance * (moved - 1.0) / all);
    }

    /// Standard deviation of a number whose change with the state is `j`, at most so much.
    fn doubt(&self, j: &[f64; N], most: f64) -> f64 {
        math::f64::sqrt(spd::quadratic(j, &self.covariance, j).max(0.0)).min(most)
    }

    /// Takes in a minute in which the straight course is `course`. Where another filter knows of the vessel too, both tell which of the minute's modes are its.
    fn minute(
        &mut self,
        course: &Course,
        travel: &TravelTime,
        arrives_s: f64,
        m: &Minute,
        other: Option<&Self>,
    ) {
        let [x, y, ..] = self.p;
        self.go(arrives_s - travel.at(math::f64::hypot(x, y)));
        let both = other.and_then(|other| {
            let mut other = *other;
            other.go(self.t_s);
            join(self, &other)
        });
        let told = *both.as_ref().unwrap_or(self);
        let (own, seen) = (told.shown(), self.shown());
        let j = own.direction;
        let towards = Towards {
            azimuth: own.azimuth,
            turning_rad_s: own.turning_rad_s,
            doubt: told.doubt(&j, DOUBT.0),
        };
        if let Some((chance, e, sd)) = own_direction(m, towards) {
            self.log += log_of(chance, DIRECTIONS);
            if chance > LEAST_OWN {
                let e = wrap_pi(e + own.azimuth - seen.azimuth);
                self.observe(&seen.direction, e, DIRECTIONS * sd * sd, chance);
            }
        }
        let doubts = (told.doubt(&own.place, DOUBT.1), told.doubt(&own.motion, DOUBT.2));
        let Some((chance, d)) = own_distance(m, own.range_m, own.speed_m_s, doubts) else { return };
        // What is none by itself is none on its course.
        if chance == 0.0 {
            return;
        }
        let chance = with_course(chance, &d, course, travel, arrives_s);
        self.log += log_of(chance, RANGES);
        if chance > LEAST_OWN {
            let seen = self.shown();
            self.observe(&seen.place, d.range_m - seen.range_m, RANGES * d.sd_m * d.sd_m, chance);
            let seen = self.shown();
            let variance = SPEEDS * d.sd_speed_m_s * d.sd_speed_m_s;
            self.observe(&seen.motion, d.speed_m_s - seen.speed_m_s, variance, chance);
        }
    }

    /// What the station is shown, and its change with the state.
    fn shown(&self) -> Shown {
        let [x, y, vx, vy] = self.p;
        let range_m = math::f64::hypot(x, y).max(1.0);
        let (ux, uy) = (x / range_m, y / range_m);
        let speed_m_s = ux * vx + uy * vy;
        Shown {
            azimuth: math::f64::atan2(x, y),
            turning_rad_s: (uy * vx - ux * vy) / range_m,
            range_m,
            speed_m_s,
            direction: [uy / range_m, -ux / range_m, 0.0, 0.0],
            place: [ux, uy, 0.0, 0.0],
            motion: [(vx - ux * speed_m_s) / range_m, (vy - uy * speed_m_s) / range_m, ux, uy],
        }
    }
}

/// Azimuth and its change, range and radial speed of a state; the changes of azimuth, range and radial speed with it.
struct Shown {
    azimuth: f64,
    turning_rad_s: f64,
    range_m: f64,
    speed_m_s: f64,
    direction: [f64; N],
    place: [f64; N],
    motion: [f64; N],
}

/// The chance that a range is this vessel's, knowing where its straight course is too. Never inlined: the caller's frame lies below
/// the deepest of the recorder.
#[inline(never)]
fn with_course(chance: f64, d: &RangeEvidence, course: &Course, travel: &TravelTime, arrives_s: f64) -> f64 {
    let straight = course.seen(travel, arrives_s);
    let along = (d.range_m - straight.range_m) / BENDS.0;
    let faster = (d.speed_m_s - straight.speed_m_s) / BENDS.1;
    let own = chance * math::f64::exp(-0.5 * (along * along + faster * faster));
    own / (own + 1.0 - chance).max(1e-30)
}

/// Log likelihood of a minute of which a mode is this vessel's with that chance, against none being: `ln(1 − Pd + Pd ratio)` but
/// for a constant. A minute counts a third.
fn log_of(chance: f64, excess: f64) -> f64 {
    -math::f64::ln((1.0 - chance).max(1e-30)) / excess
}

/// The course at the end of a stretch, in the order of time, with its covariance: the drifts count as far as each explains what was seen.
pub fn present(
    course: &Course,
    travel: &TravelTime,
    step_s: f64,
    minutes: impl Iterator<Item = Minute>,
) -> Option<(Course, CourseCovariance)> {
    let mut all: [Option<Filter>; DRIFTS.len()] = [None; DRIFTS.len()];
    for m in minutes {
        let at_s = step_s * f64::from(m.number);
        for (filter, drift) in all.iter_mut().zip(DRIFTS) {
            let filter = filter.get_or_insert_with(|| Filter::new(course, drift, at_s));
            filter.log *= REMEMBERED;
            filter.minute(course, travel, at_s, &m, None);
        }
    }
    // Each drift has it at its own time of emission, some milliseconds apart.
    let mut found = mixed(&all)?;
    let place = found.shown().place;
    spd::add_outer(&mut found.covariance, &place, TABLE_M * TABLE_M);
    let mut now = (Course { t0_s: found.t_s, p: found.p }, found.covariance);
    lasting::turn(&mut now, TOWARDS);
    Some(now)
}

/// The course about its closest point. `before` are the minutes in the order of time, `after` the same from the last to the
/// first. The drifts count as far as each explains what was seen. `None` where the two do not join.
pub fn about_closest(
    course: &Course,
    travel: &TravelTime,
    step_s: f64,
    before: impl Iterator<Item = Minute> + Clone,
    after: impl Iterator<Item = Minute> + Clone,
) -> Option<(Course, CourseCovariance)> {
    let closest_s = course.closest(&[[0.0; N]; N])?.0.time_s;
    let at = |m: &Minute| step_s * f64::from(m.number);
    // What is heard from where the vessel is not heard any more may be another's for hours.
    let ranged = |m: &Minute| {
        let (x, y) = course.at(at(m));
        math::f64::hypot(x, y) < FARTHEST_M
    };
    let before = before.take_while(|m| at(m) <= closest_s).filter(ranged);
    let after = after.take_while(|m| at(m) > closest_s).filter(ranged);
    let mut all: [Option<Filter>; DRIFTS.len()] = [None; DRIFTS.len()];
    for (joined, drift) in all.iter_mut().zip(DRIFTS) {
        // One filter in one place: its frame lies below the deepest of the recorder.
        let pass = |minutes: &mut dyn Iterator<Item = Minute>, other: Option<&Filter>| {
            let mut m = minutes.next()?;
            let mut filter = Filter::new(course, drift, at(&m));
            loop {
                filter.minute(course, travel, at(&m), &m, other);
                let Some(next) = minutes.next() else { break };
                m = next;
            }
            filter.go(closest_s);
            Some(filter)
        };
        let (here, there) = (pass(&mut before.clone(), None), pass(&mut after.clone(), None));
        // The side that tells less is told again, knowing the other.
        *joined = match (here, there) {
            (Some(a), Some(b)) if a.log >= b.log => {
                pass(&mut after.clone(), Some(&a)).and_then(|b| join(&a, &b))
            }
            (Some(_), Some(b)) => pass(&mut before.clone(), Some(&b)).and_then(|a| join(&a, &b)),
            (one, None) | (None, one) => one,
        };
    }
    let joined = mixed(&all)?;
    let found = Course { t0_s: joined.t_s, p: joined.p };
    // To the closest point it drifts further.
    let mut ahead = joined;
    ahead.go(found.closest(&joined.covariance)?.0.time_s);
    // What all ranges have in common no number of them makes smaller.
    let place = ahead.shown().place;
    spd::add_outer(&mut ahead.covariance, &place, TABLE_M * TABLE_M);
    Some((Course { t0_s: ahead.t_s, p: ahead.p }, ahead.covariance))
}

/// What filters of several drifts say together, each by its likelihood: the moments of their mixture.
fn mixed(all: &[Option<Filter>]) -> Option<Filter> {
    let most = all.iter().flatten().map(|f| f.log).fold(f64::NEG_INFINITY, f64::max);
    let weight = |f: &Filter| math::f64::exp(f.log - most);
    let sum: f64 = all.iter().flatten().map(weight).sum();
    let mut out =
        Filter { drift: 0.0, p: [0.0; N], covariance: [[0.0; N]; N], ..*all.iter().flatten().next()? };
    for f in all.iter().flatten() {
        let share = weight(f) / sum;
        out.drift += share * f.drift;
        out.p.iter_mut().zip(&f.p).for_each(|(p, x)| *p += share * x);
    }
    for f in all.iter().flatten() {
        let share = weight(f) / sum;
        let mut apart = f.p;
        apart.iter_mut().zip(&out.p).for_each(|(x, p)| *x -= p);
        let of_f = f.covariance.as_flattened().iter();
        out.covariance.as_flattened_mut().iter_mut().zip(of_f).for_each(|(c, x)| *c += share * x);
        spd::add_outer(&mut out.covariance, &apart, share);
    }
    Some(out)
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
    Some(Filter { p, covariance, log: a.log + b.log, ..*a })
}

#[cfg(test)]
mod tests;
