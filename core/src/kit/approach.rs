//! Closest point of approach of a straight motion to a point, heading and speed, with their derivatives.
//!
//! In: where the vessel is, seen from the point (East, North, m), and its velocity (m/s). Out: when it is closest, how far
//! away and on which side. With `p` the place, `v` the velocity and `w = v/|v|`: closest at `−p·w/|v|` from now, at the
//! signed distance `c = y w_x − x w_y`.

use super::spd::{Square, propagated};
use crate::angle::wrap_tau;
use crate::math::f64 as m;

/// Parameters of a straight motion: East, North, velocity East, velocity North.
pub const STATE: usize = 4;

/// Slowest motion that has a closest point, m/s.
const LEAST_SPEED_M_S: f64 = 0.01;

/// The closest point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Approach {
    /// When, seconds from now.
    pub after_s: f64,
    /// Distance, metres: positive where the point lies to starboard of the vessel's way, negative to port.
    pub range_m: f64,
    /// Heading, radians clockwise from North, in [0, 2π).
    pub heading: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// Derivatives of these four by East, North and velocities.
    pub derivatives: [[f64; STATE]; 4],
}

/// The closest point of a motion; `None` for a vessel that does not move (slower than 1 cm/s).
pub fn closest([x, y, vx, vy]: [f64; STATE]) -> Option<Approach> {
    let vv = vx * vx + vy * vy;
    if !(vv >= LEAST_SPEED_M_S * LEAST_SPEED_M_S) || !vv.is_finite() {
        return None;
    }
    let v = m::sqrt(vv);
    let (wx, wy) = (vx / v, vy / v);
    let along = x * wx + y * wy;
    let range_m = y * wx - x * wy;
    let derivatives = [
        [-wx / v, -wy / v, (2.0 * along * wx - x) / vv, (2.0 * along * wy - y) / vv],
        [-wy, wx, along * wy / v, -along * wx / v],
        [0.0, 0.0, wy / v, -wx / v],
        [0.0, 0.0, wx, wy],
    ];
    Some(Approach {
        after_s: -along / v,
        range_m,
        heading: wrap_tau(m::atan2(vx, vy)),
        speed_m_s: v,
        derivatives,
    })
}

impl Approach {
    /// Covariance of (time, range, heading, speed) that follows, to first order, from that of the motion.
    pub fn covariance(&self, of_motion: &Square<STATE>) -> Square<4> {
        propagated(&self.derivatives, of_motion)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::wrap_pi;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(seabearing_testkit::property(256))]

        #[test]
        fn nowhere_on_the_way_is_it_closer(
            x in -5e3f64..5e3, y in -5e3f64..5e3, vx in 0.5f64..10.0, vy in -10.0f64..10.0, other in -900.0f64..900.0
        ) {
            let a = closest([x, y, vx, vy]).unwrap();
            let distance = |t: f64| m::hypot(x + vx * t, y + vy * t);
            prop_assert!((distance(a.after_s) - a.range_m.abs()).abs() < 1e-6);
            prop_assert!(distance(a.after_s + other) >= a.range_m.abs() - 1e-6);
        }

        #[test]
        fn derivatives_are_those_of_differences(
            x in -5e3f64..5e3, y in -5e3f64..5e3, vx in 1.0f64..10.0, vy in -10.0f64..10.0
        ) {
            let state = [x, y, vx, vy];
            let at = closest(state).unwrap();
            for k in 0..STATE {
                let h = 1e-5;
                let (mut up, mut down) = (state, state);
                up[k] += h;
                down[k] -= h;
                let (a, b) = (closest(up).unwrap(), closest(down).unwrap());
                let differences = [
                    a.after_s - b.after_s,
                    a.range_m - b.range_m,
                    wrap_pi(a.heading - b.heading),
                    a.speed_m_s - b.speed_m_s,
                ];
                for (row, difference) in at.derivatives.iter().zip(differences) {
                    let slope = difference / (2.0 * h);
                    prop_assert!((row[k] - slope).abs() < 1e-5 * (1.0 + slope.abs()), "{k} {row:?} {slope}");
                }
            }
        }
    }

    #[test]
    fn sides_and_times_of_a_known_motion() {
        // Heading north, 300 m east of the point, which is to port; 100 m before the closest point.
        let a = closest([300.0, -100.0, 0.0, 5.0]).unwrap();
        assert_eq!((a.after_s, a.range_m, a.heading, a.speed_m_s), (20.0, -300.0, 0.0, 5.0));
        // Heading east, 6 km north of it: to starboard.
        let a = closest([-4000.0, 6000.0, 8.0, 0.0]).unwrap();
        assert_eq!((a.after_s, a.range_m), (500.0, 6000.0));
        assert_eq!(closest([1.0, 2.0, 0.0, 0.0]), None);
        assert_eq!(closest([1.0, 2.0, f64::NAN, 0.0]), None);
    }
}
