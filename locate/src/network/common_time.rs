//! Bearings of arrays that share no clock tick, brought to one instant by each array's own bearing rate.
//!
//! A straight line is fitted to an array's bearings near the wanted instant (wrapped against the nearest one) and its
//! slope alone is used: the bearing at `t` is the measured one plus rate·(t − t_n). With fewer than three bearings near
//! the rate is taken as zero, and what that may err by is in the variance: any rate up to the largest is as likely.

use crate::angle::{wrap_pi, wrap_tau};
use crate::kit::straight_line::through;
use crate::math::f64 as m;

/// Bearings farther than this from the wanted instant say nothing about its rate: a vessel at 7 m/s and 100 m turns
/// through its closest point in about 14 s, seconds.
pub const WINDOW_S: f64 = 5.0;
/// Largest rate that a bearing without neighbours is held to have: that vessel's at its closest point, radians a second.
const LARGEST_RATE: f64 = 0.07;

/// One angle of one array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timed {
    /// Time, seconds.
    pub t_s: f64,
    /// Angle, radians.
    pub angle: f64,
}

/// Brings one measured angle to the instant `t_s`; `near` are the same array's angles (any order, the measured one
/// may be among them), `sd` their standard deviation in radians. Returns angle and standard deviation.
pub fn bring(measured: &Timed, near: &[Timed], t_s: f64, sd: f64) -> (f64, f64) {
    let shift = t_s - measured.t_s;
    if shift == 0.0 {
        return (measured.angle, sd);
    }
    let usable = near.iter().filter(|p| m::abs(p.t_s - measured.t_s) <= WINDOW_S && p.angle.is_finite());
    let line = usable.clone().map(|p| (p.t_s - measured.t_s, wrap_pi(p.angle - measured.angle)));
    match through(line).filter(|_| usable.count() >= 3) {
        Some(fitted) => {
            (measured.angle + fitted.slope * shift, sd * m::sqrt(1.0 + shift * shift * fitted.var_slope))
        }
        // Variance of a uniform rate in ±LARGEST_RATE: a third of its square.
        None => (measured.angle, m::hypot(sd, LARGEST_RATE / m::sqrt(3.0) * shift)),
    }
}

/// As [`bring`], for an azimuth: the result is in [0, 2π).
pub fn bring_azimuth(measured: &Timed, near: &[Timed], t_s: f64, sd: f64) -> (f64, f64) {
    let (angle, sd) = bring(measured, near, t_s, sd);
    (wrap_tau(angle), sd)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turning_bearing_is_carried_across_north() {
        let near: std::vec::Vec<Timed> = (0..9)
            .map(|k| Timed { t_s: f64::from(k), angle: wrap_tau(-0.1 + 0.03 * f64::from(k)) })
            .collect();
        let (a, sd) = bring_azimuth(&near[3], &near, 3.5, 0.02);
        assert!(wrap_pi(a - (-0.1 + 0.03 * 3.5)).abs() < 1e-12);
        assert!(sd > 0.02 && sd < 0.021);
        assert_eq!(bring(&near[3], &near, 3.0, 0.02), (near[3].angle, 0.02));
    }

    #[test]
    fn without_neighbours_the_bearing_stays_and_its_error_grows() {
        let one = Timed { t_s: 1.0, angle: 2.0 };
        let (angle, sd) = bring(&one, &[one], 1.4, 0.02);
        // A vessel at the largest rate moves 0.4 · 0.07 rad meanwhile.
        assert!(angle == 2.0 && (sd * sd - 0.02 * 0.02 - 0.028 * 0.028 / 3.0).abs() < 1e-12, "{angle} {sd}");
        // So it is with three bearings of one instant, and no further off for a rate that is known.
        assert_eq!(bring(&one, &[one; 3], 1.4, 0.02), (angle, sd));
        assert_eq!(bring(&one, &[one], 1.0, 0.02), (2.0, 0.02));
    }
}
