//! What is not known of the station itself, in what is stated: orientation, gain of the horizontals, depth of the table.
//!
//! Enters: deviations told in the station file, directions and ranges, a course with its minutes. Leaves: variances of a
//! direction, a range and a radial speed, evidence whose spreads hold what of these errors bends a course, and courses'
//! covariances with the errors that all minutes share: no number of minutes makes these smaller. An error of orientation turns
//! a course as it is; one of gain turns each direction otherwise, one of depth puts pairs of paths at ranges of their own.
//! Cost: each that is told takes as much as a fit and a smoothing more when a track is sent.

use super::course::{Course, CourseCovariance};
use super::evidence::Minute;
use super::presence::RangePresence;
use super::tonal::Directions;
use crate::angle::RAD_PER_DEG;
use crate::config::Doubts;
use crate::kit::spd;
use crate::math;

/// Shallowest water of which a depth is an error of ranges, m.
const LEAST_DEPTH_M: f64 = 10.0;

/// By how much the pairs of paths disagree about a range, of the error that a wrong depth makes of it: the pairs 13 and 35 at
/// 20 km say 1030 and 1510 m too much where a table is 100 m too deep.
const APART: f64 = 0.5;

/// Deviation of the table's depth from which a range may be another pair of paths', m: the pulses of the pairs 13 and 35 are then a
/// quarter of their period apart. At 20 km over 4800 m the range that keeps the delay of the one pair as it is leaves that of the other,
/// `(R₅ − R₃)/c`, 55 ms off for 100 m, and a period is 1/15 s.
const OUT_OF_PHASE_M: f64 = 30.0;

/// Relative deviation of a course's ranges and speeds where its pair of paths is in doubt: other pairs of like delay put a vessel at 0.52 to
/// 1.94 of its range, with a table 100 m off at 0.43 to 2.0 (measured in a month of real ways), and with this both ends lie in the 95 %.
const OTHER_PAIR: f64 = 0.68;

/// The same of one that seems near, on few ranges yet: a pair 57 or 79 read as 13 puts a vessel at a third or a quarter of its range.
const FAR_PAIR: f64 = 1.2;

/// At how many deviations of range more the same error of direction is that much longer.
const FARTHER: f64 = 1.5;

/// Natural logarithm of an amplitude's ratio of one decibel.
const LN_DB: f64 = core::f64::consts::LN_10 / 20.0;

/// Step over which the change of a range's error with range is taken, m.
const STEP_M: f64 = 50.0;

/// A standard deviation with that of an error that lasts, whose variance is given.
pub(super) fn widened(sd: f32, lasting: f64) -> f32 {
    if lasting > 0.0 { math::f32::sqrt(sd * sd + lasting as f32) } else { sd }
}

/// An error that bends a course.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Told {
    /// Of north's gain over east's.
    Gain,
    /// Of the depth for which the table was made.
    Depth,
}

/// Standard deviations of errors that last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lasting {
    /// Of the orientation, rad.
    orientation: f64,
    /// Of the logarithm of north's gain over east's.
    gain: f64,
    /// Of the depth for which the table was made, m.
    depth_m: f64,
    /// Azimuth of the north component, rad.
    north: f64,
    /// Depth of the water for which the table was made, m.
    water_m: f64,
}

impl Lasting {
    /// All zeros.
    pub(super) const EMPTY: Self =
        Self { orientation: 0.0, gain: 0.0, depth_m: 0.0, north: 0.0, water_m: 0.0 };

    /// As told, of a station whose table is for `water_m` and whose north component points towards `north_deg`.
    pub fn new(doubts: Doubts, north_deg: f64, water_m: f64) -> Self {
        Self {
            orientation: f64::from(doubts.orientation_deg) * RAD_PER_DEG,
            gain: f64::from(doubts.gain_db) * LN_DB,
            depth_m: f64::from(doubts.table_depth_m),
            north: north_deg * RAD_PER_DEG,
            water_m: water_m.max(LEAST_DEPTH_M),
        }
    }

    /// The same where north's gain over east's is uncertain by so much more, dB.
    pub(super) fn with_gain_doubt(self, sd_db: f32) -> Self {
        Self { gain: math::f64::hypot(self.gain, f64::from(sd_db) * LN_DB), ..self }
    }

    /// Variance of a direction, rad².
    pub fn of_direction(&self, azimuth: f64) -> f64 {
        self.orientation * self.orientation + self.of_gain(azimuth)
    }

    /// That part of it which gain makes, rad².
    fn of_gain(&self, azimuth: f64) -> f64 {
        let by_gain = self.gain * self.by_gain(azimuth);
        by_gain * by_gain
    }

    /// What a minute says of courses, whose evidence must not be taken for another vessel's where an error told bends it.
    pub(super) fn as_evidence(
        &self,
        mut directions: Directions,
        mut ranges: RangePresence,
    ) -> (Directions, RangePresence) {
        if self.gain > 0.0 {
            for m in directions.modes.iter_mut().flatten() {
                m.sd = widened(m.sd, self.of_gain(f64::from(m.azimuth)));
            }
        }
        if self.depth_m > 0.0 {
            for m in ranges.modes.iter_mut().flatten() {
                let (range, speed) = self.of_range(f64::from(m.range_m), f64::from(m.speed_m_s));
                m.sd_range_m = widened(m.sd_range_m, APART * APART * range);
                m.sd_speed_m_s = widened(m.sd_speed_m_s, APART * APART * speed);
            }
        }
        (directions, ranges)
    }

    /// Variances of a range and of a radial speed there, m² and m²/s².
    pub fn of_range(&self, range_m: f64, speed_m_s: f64) -> (f64, f64) {
        if self.depth_m <= 0.0 {
            return (0.0, 0.0);
        }
        let [_, range, speed] = self.by_depth(range_m, speed_m_s).map(|by| self.depth_m * by);
        (range * range, speed * speed)
    }

    /// Change of a direction with the logarithm of north's gain: in the components' frame the tangent of the azimuth is east over
    /// north, so it changes by −½ sin 2a.
    fn by_gain(&self, azimuth: f64) -> f64 {
        -0.5 * math::f64::sin(2.0 * (azimuth - self.north))
    }

    /// Change of direction, range and radial speed with the depth for which the table is made.
    fn by_depth(&self, range_m: f64, speed_m_s: f64) -> [f64; 3] {
        let slope =
            (self.range_by_depth(range_m + STEP_M) - self.range_by_depth(range_m - STEP_M)) / (2.0 * STEP_M);
        [0.0, self.range_by_depth(range_m), slope * speed_m_s]
    }

    /// Change of range with depth at which the paths that cross the water once and three times keep their delay: with lengths
    /// `Rₙ² = r² + n² h²`, `dr/dh = (h/r) (9 R₁ − R₃)/(R₃ − R₁)`; `2r/h` far away.
    fn range_by_depth(&self, range_m: f64) -> f64 {
        let (r, h) = (range_m.max(STEP_M), self.water_m);
        let (once, thrice) = (math::f64::hypot(r, h), math::f64::hypot(r, 3.0 * h));
        h / r * (9.0 * once - thrice) / (thrice - once)
    }

    /// Whether the depth told is so uncertain that echoes may be read as another pair of paths.
    pub(super) fn parts_pairs(&self) -> bool {
        self.depth_m > OUT_OF_PHASE_M
    }

    /// Which of the errors that bend a course are told.
    fn told(&self) -> impl Iterator<Item = Told> {
        let (gain, depth) = (self.gain > 0.0, self.depth_m > 0.0);
        gain.then_some(Told::Gain).into_iter().chain(depth.then_some(Told::Depth))
    }

    /// A minute as it would be with one such error by one deviation more.
    pub(super) fn shifted(&self, error: Told, m: Minute) -> Minute {
        match error {
            Told::Gain => m.shifted(|d| self.gain * self.by_gain(d.azimuth), |_| (0.0, 0.0)),
            Told::Depth => m.shifted(
                |_| 0.0,
                |d| {
                    let [_, range, speed] = self.by_depth(d.range_m, d.speed_m_s);
                    (self.depth_m * range, self.depth_m * speed)
                },
            ),
        }
    }

    /// Adds to the covariance of a course what all its minutes share: `with` is the course that follows where they have one of the errors.
    pub(super) fn widen(
        &self,
        known: &mut (Course, CourseCovariance),
        with: impl Fn(Told) -> Option<Course>,
    ) {
        if self.orientation > 0.0 {
            turn(known, self.orientation);
        }
        let (course, covariance) = known;
        let [x, y, vx, vy] = course.p;
        for other in self.told().filter_map(with) {
            let (ox, oy) = other.at(course.t0_s);
            let [_, _, ovx, ovy] = other.p;
            spd::add_outer(covariance, &[ox - x, oy - y, ovx - vx, ovy - vy], 1.0);
        }
    }
}

/// Adds to the covariance of a course that all its directions may be turned by a deviation, rad.
pub(super) fn turn((course, covariance): &mut (Course, CourseCovariance), deviation: f64) {
    let [x, y, vx, vy] = course.p;
    spd::add_outer(covariance, &[y, -x, vy, -vx], deviation * deviation);
}

/// Which other pairs of paths the ranges of a course may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pairs {
    /// The next one, either way.
    Next,
    /// Any of one farther away.
    Farther,
}

impl Pairs {
    fn deviation(self) -> f64 {
        match self {
            Self::Next => OTHER_PAIR,
            Self::Farther => FAR_PAIR,
        }
    }

    /// Adds to the covariance of a course that all its ranges, and with them its speed, may be another pair of paths'; heading and time
    /// of the closest point stay as they are.
    pub(super) fn widen(self, (course, covariance): &mut (Course, CourseCovariance)) {
        spd::add_outer(covariance, &course.p, self.deviation() * self.deviation());
    }

    /// The same of a course where its vessel is now: farther away the same error of direction is longer.
    pub(super) fn widen_place(self, now: &mut (Course, CourseCovariance)) {
        let longer = 1.0 + FARTHER * self.deviation();
        now.1.as_flattened_mut().iter_mut().for_each(|c| *c *= longer * longer);
        self.widen(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOLD: Doubts = Doubts { orientation_deg: 5.0, gain_db: 3.0, table_depth_m: 100.0 };

    #[test]
    fn ranges_follow_the_depth_of_the_table() {
        let lasting = Lasting::new(TOLD, 0.0, 4800.0);
        let delay = |r: f64, h: f64| (r * r + 9.0 * h * h).sqrt() - (r * r + h * h).sqrt();
        for r in [4_000.0f64, 8_000.0, 20_000.0, 45_000.0] {
            // The range at which another depth gives the same delay.
            let (mut near, mut far) = (0.5 * r, 2.0 * r);
            for _ in 0..60 {
                let middle = 0.5 * (near + far);
                if delay(middle, 4801.0) > delay(r, 4800.0) { near = middle } else { far = middle }
            }
            let moved = near - r;
            assert!((lasting.range_by_depth(r) / moved - 1.0).abs() < 1e-3, "{r}: {moved}");
        }
    }

    #[test]
    fn directions_follow_gain_and_orientation() {
        let lasting = Lasting::new(TOLD, 30.0, 4800.0);
        let at = |deg: f64| lasting.of_direction(deg.to_radians()).sqrt().to_degrees();
        assert!((at(30.0) - 5.0).abs() < 1e-6 && (at(120.0) - 5.0).abs() < 1e-6);
        // Between the components 3 dB turn by half of ln 1.41.
        let by_gain = (0.5 * 1.412_537_5f64.ln()).to_degrees();
        assert!((at(75.0) - 5.0f64.hypot(by_gain)).abs() < 1e-4, "{}", at(75.0));
        assert_eq!(Lasting::new(Doubts::default(), 30.0, 4800.0).of_direction(1.0), 0.0);
    }

    #[test]
    fn a_course_is_as_uncertain_as_what_told_errors_make_of_it() {
        let lasting = Lasting::new(Doubts { gain_db: 0.0, ..TOLD }, 0.0, 4800.0);
        let course = Course { t0_s: 0.0, p: [3_000.0, 4_000.0, 6.0, 0.0] };
        let mut with = (course, [[0.0; 4]; 4]);
        let other = Course { t0_s: 10.0, p: [3_200.0, 4_100.0, 7.0, 0.0] };
        lasting.widen(&mut with, |error| (error == Told::Depth).then_some(other));
        // Orientation: 5° across; the other course is 130 m and 100 m off at the same time.
        let turn = 5f64.to_radians();
        let want = (4_000.0 * turn).powi(2) + 130f64.powi(2);
        assert!((with.1[0][0] / want - 1.0).abs() < 1e-9, "{} {want}", with.1[0][0]);
        assert!((with.1[2][2] - 1.0).abs() < 1e-9);
        let mut exact = (course, [[0.0; 4]; 4]);
        assert!(lasting.parts_pairs() && !Lasting::EMPTY.parts_pairs());
        Lasting::EMPTY.widen(&mut exact, |_| Some(other));
        assert_eq!(exact.1, [[0.0; 4]; 4]);
    }

    #[test]
    fn another_pair_of_paths_leaves_heading_and_time_as_they_are() {
        let course = Course { t0_s: 0.0, p: [3_000.0, 4_000.0, 6.0, -1.0] };
        let mut with = (course, [[0.0; 4]; 4]);
        Pairs::Next.widen(&mut with);
        let (closest, covariance) = with.0.closest(&with.1).unwrap();
        let sd = |k: usize| covariance[k][k].max(0.0).sqrt();
        assert!((sd(1) / closest.range_m.abs() - OTHER_PAIR).abs() < 1e-6, "{}", sd(1));
        assert!((sd(3) / closest.speed_m_s - OTHER_PAIR).abs() < 1e-6, "{}", sd(3));
        assert!(sd(0) < 1e-2 && sd(2) < 1e-6, "{} {}", sd(0), sd(2));
        // Read at 0.43 or twice its range the truth is inside the 95 % of what is stated.
        for read in [0.43f64, 2.0] {
            assert!((read - 1.0).abs() / read <= 1.96 * OTHER_PAIR);
        }
    }
}
