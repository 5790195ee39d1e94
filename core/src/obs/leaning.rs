//! Directions of several vessels lean on each other: two that are near to each other may be heard as one between them, for hours.
//!
//! Enters: a vessel's course, those of the others that may be heard. Leaves: by how much its directions may be off, all to one side.
//! Cost: a thousand instructions another vessel.

use super::course::Course;
use crate::angle::wrap_pi;
use crate::math;

/// Directions of vessels less than this apart lean on each other, rad, and by how much those of one do for an hour: the means of an hour's
/// are 0.6 to 1.2 degrees off in the root of the mean square (three weeks of real ways).
const BESIDE: f64 = 1.0;
const LEANING: f64 = 0.01;

/// Nearer to each other than this two vessels may be heard as one between them, rad, and what share of the angle between them the means of an
/// hour are off then: a quarter of it from 5 to 11 degrees, nothing above 15 (the same weeks).
const MERGED: f64 = 0.21;
const SHARE: f64 = 0.25;

/// Range to which a vessel's directions are heard, m.
const HEARD_M: f64 = 80_000.0;

/// Times before that at which a place is told in which directions bent the way to it: so many, so many seconds apart.
const BEFORE: u8 = 4;
const EVERY_S: f64 = 1_800.0;

/// By how much the directions of a course may lean on those of others, up to the time of its place and from an hour and a half before it: the
/// greatest, a standard deviation, rad.
pub(super) fn leaning<'a>(course: &Course, others: impl Iterator<Item = &'a Course>) -> f64 {
    let mut most = 0.0f64;
    for other in others {
        for k in 0..BEFORE {
            let t_s = course.t0_s - EVERY_S * f64::from(k);
            let ((x, y), (east, north)) = (course.at(t_s), other.at(t_s));
            let apart = math::f64::abs(wrap_pi(math::f64::atan2(east, north) - math::f64::atan2(x, y)));
            if math::f64::hypot(east, north) < HEARD_M && apart < BESIDE {
                let merged = if apart < MERGED { SHARE * apart } else { 0.0 };
                most = most.max(merged).max(LEANING);
            }
        }
    }
    most
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A course straight away from the station, where it is after four hours.
    fn away(azimuth: f64, range_m: f64) -> Course {
        let (s, c) = math::f64::sin_cos(azimuth);
        Course { t0_s: 14_400.0, p: [range_m * s, range_m * c, 6.0 * s, 6.0 * c] }
    }

    #[test]
    fn two_in_one_direction_are_off_by_a_share_of_what_is_between_them() {
        let of = |others: &[Course]| leaning(&away(4.0, 60_000.0), others.iter());
        assert_eq!(of(&[]), 0.0);
        assert!((of(&[away(4.15, 50_000.0)]) - SHARE * 0.15).abs() < 1e-6, "{}", of(&[away(4.15, 50_000.0)]));
        // The nearer of two; over north as well.
        assert_eq!(of(&[away(4.5, 50_000.0), away(1.0, 50_000.0)]), LEANING);
        assert!((of(&[away(4.5, 50_000.0), away(3.8, 40_000.0)]) - SHARE * 0.2).abs() < 1e-6);
        let north = leaning(&away(6.2, 60_000.0), [away(0.05, 50_000.0)].iter());
        assert!((north - SHARE * (0.05 + core::f64::consts::TAU - 6.2)).abs() < 1e-6, "{north}");
        // What is in another direction, or not heard any more for as long as that.
        assert_eq!(of(&[away(1.0, 50_000.0)]), 0.0);
        assert_eq!(of(&[away(4.1, 120_000.0)]), 0.0);
    }

    #[test]
    fn what_leant_on_it_before_counts() {
        let course = away(4.0, 60_000.0);
        // Beside it an hour ago, across the station now.
        let (x, y) = course.at(14_400.0 - 3_600.0);
        let other = Course { t0_s: 10_800.0, p: [1.1 * x, 0.9 * y, -30.0 * x / 3_600.0, 0.0] };
        assert!(leaning(&course, [other].iter()) > LEANING);
    }
}
