//! Vessels whose tracks are closed and that are heard on: each must not be found once more.
//!
//! A track is closed when nothing supports it for three quarters of an hour, as where the directions of two vessels that leave one way are heard as one.
//! What is heard of such a vessel later makes a course again, at its own range or, beyond the model's end, where another pair of paths reads
//! its echoes. Enters: the course of each track that is closed, and courses found. Leaves: whether a found course is one of these
//! vessels'. Cost: five hundred instructions a course found.

use super::course::Course;
use super::travel::TravelTime;
use crate::angle::wrap_pi;
use crate::math;

/// How near a found course's direction is to that of the vessel gone, rad (7 degrees): a straight course is a few degrees off hours later, and
/// so is a direction heard of two vessels as one.
const TOWARDS: f64 = 0.12;

/// By how much of its range it may be farther or nearer than expected.
const WITHIN: f64 = 0.1;

/// How many times nearer than it is a vessel is read, and the range that it has reached by then: itself anywhere, another pair of paths' where the
/// model ends (35 as 13, 57 as 35), m. What is read there makes a course that goes back along the directions heard on the way.
const READ: [(f64, f64); 3] = [(1.0, 0.0), (2.0, 47_000.0), (1.5, 47_000.0)];

/// How many are kept.
const GONE: usize = 3;

/// The newest of the vessels gone.
#[derive(Clone, Debug)]
pub(super) struct Gone {
    courses: [Option<Course>; GONE],
}

impl Gone {
    /// None; all zeros.
    pub(super) const fn new() -> Self {
        Self { courses: [None; GONE] }
    }

    /// One more; the oldest is forgotten.
    pub(super) fn push(&mut self, course: Course) {
        self.courses.rotate_right(1);
        if let Some(first) = self.courses.first_mut() {
            *first = Some(course);
        }
    }

    /// Their courses.
    pub(super) fn courses(&self) -> impl Iterator<Item = &Course> {
        self.courses.iter().flatten()
    }

    /// Whether a course seen at both times, s, is one of these vessels'.
    pub(super) fn is_again(&self, found: &Course, travel: &TravelTime, times_s: [f64; 2]) -> bool {
        let same = |known: &Course, t_s: f64, farthest_m: f64| {
            let (known, found) = (known.seen(travel, t_s), found.seen(travel, t_s));
            let read = |(nearer, from_m): &(f64, f64)| {
                farthest_m >= *from_m
                    && math::f64::abs(nearer * found.range_m - known.range_m) < WITHIN * known.range_m
            };
            math::f64::abs(wrap_pi(found.azimuth() - known.azimuth())) < TOWARDS && READ.iter().any(read)
        };
        self.courses.iter().flatten().any(|known| {
            let farthest_m =
                times_s.map(|t_s| known.seen(travel, t_s).range_m).into_iter().fold(0.0, f64::max);
            times_s.iter().all(|t_s| same(known, *t_s, farthest_m))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vessel_gone_is_known_again_and_another_is_not() {
        let mut gone = Gone::new();
        let course = |scale: f64, turn: f64| {
            let (s, c) = math::f64::sin_cos(turn);
            let p = [scale * 1_000.0, scale * 10_000.0, scale * 5.0 * c, scale * 5.0 * s];
            Course { t0_s: 0.0, p }
        };
        let travel = TravelTime::EMPTY;
        let (near, far) = ([4_000.0, 6_000.0], [11_000.0, 13_000.0]);
        assert!(!gone.is_again(&course(1.0, 0.0), &travel, near));
        gone.push(course(1.0, 0.0));
        // Itself, somewhat turned; at half the range only where it is beyond the model; not another.
        assert!(gone.is_again(&course(1.03, 0.02), &travel, near));
        assert!(!gone.is_again(&course(0.5, 0.0), &travel, near));
        assert!(gone.is_again(&course(0.5, 0.0), &travel, far));
        // There at the end, and read so since it was nearer.
        assert!(gone.is_again(&course(0.5, 0.0), &travel, [4_000.0, 13_000.0]));
        assert!(gone.is_again(&course(0.66, 0.0), &travel, far));
        assert!(!gone.is_again(&course(0.8, 0.0), &travel, far));
        assert!(!gone.is_again(&course(1.0, 0.4), &travel, near));
        // So many are kept.
        (0..GONE).for_each(|_| gone.push(course(1.0, 3.0)));
        assert!(!gone.is_again(&course(1.0, 0.0), &travel, near));
    }
}
