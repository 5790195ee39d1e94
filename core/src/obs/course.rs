//! A straight course at constant speed, what the station sees of it, and its closest point of approach.
//!
//! Parameters: East, North (m) and velocity (m/s) at a reference time, which stay well conditioned for slow vessels and
//! for records without a closest point. Seen at t: the vessel at its time of emission t − toa(r). Closest point: time
//! t0 − x·v/v², signed range c = (y vx − x vy)/v, positive where the station lies to starboard [O 26].

use super::fit::Towards;
use super::travel::TravelTime;
use crate::kit;
use crate::kit::approach::STATE;
use crate::kit::spd::{Square, propagated};
use crate::math;

/// Number of parameters.
pub const N: usize = STATE;

/// A square matrix of that size.
pub type CourseCovariance = Square<N>;

/// A course.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// Reference time, s.
    pub t0_s: f64,
    /// East and North at `t0_s`, m; velocity east and north, m/s.
    pub p: [f64; N],
}

/// What the station sees at a time.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Time of emission minus the course's reference time, s.
    pub since_s: f64,
    /// East and North then, m.
    pub place: (f64, f64),
    /// Range, m.
    pub range_m: f64,
    /// Change of its azimuth, rad/s.
    pub turning_rad_s: f64,
    /// Radial speed, m/s, positive when leaving.
    pub speed_m_s: f64,
}

/// Closest point of approach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Its time, s.
    pub time_s: f64,
    /// Its range, m, positive where the station lies to starboard.
    pub range_m: f64,
    /// Heading, rad.
    pub heading: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
}

/// How long before or after its straight course a vessel is at a place, s: real ways bend by 340 to 1100 m within 50 km. A vessel that
/// passes at 3 km is then seen six degrees beside its course, and is the same vessel; one that passes twice as far and as fast, as
/// another pair of paths has it, no less.
const BENDS_S: f64 = 45.0;

impl Seen {
    /// Azimuth, rad.
    pub fn azimuth(&self) -> f64 {
        let (x, y) = self.place;
        math::f64::atan2(x, y)
    }

    /// Its direction, as surely as a straight course tells it.
    pub fn towards(&self) -> Towards {
        let doubt = BENDS_S * math::f64::abs(self.turning_rad_s);
        Towards { azimuth: self.azimuth(), turning_rad_s: self.turning_rad_s, doubt }
    }
}

impl Course {
    /// East and North at a time.
    pub fn at(&self, t_s: f64) -> (f64, f64) {
        let [x, y, vx, vy] = self.p;
        let dt = t_s - self.t0_s;
        (x + vx * dt, y + vy * dt)
    }

    /// The course through two places seen at two times (of emission).
    pub fn through(a: (f64, (f64, f64)), b: (f64, (f64, f64))) -> Option<Self> {
        let dt = b.0 - a.0;
        if math::f64::abs(dt) < 1.0 {
            return None;
        }
        let (vx, vy) = ((b.1.0 - a.1.0) / dt, (b.1.1 - a.1.1) / dt);
        Some(Self { t0_s: a.0, p: [a.1.0, a.1.1, vx, vy] })
    }

    /// What arrives at `t_s`. Two steps of the fixed point leave less than a centimetre at 15 m/s.
    pub fn seen(&self, travel: &TravelTime, t_s: f64) -> Seen {
        let mut left = t_s;
        for _ in 0..2 {
            let (x, y) = self.at(left);
            left = t_s - travel.at(math::f64::sqrt(x * x + y * y));
        }
        let (x, y) = self.at(left);
        let [_, _, vx, vy] = self.p;
        let range_m = math::f64::sqrt(x * x + y * y).max(1.0);
        Seen {
            since_s: left - self.t0_s,
            place: (x, y),
            range_m,
            turning_rad_s: (y * vx - x * vy) / (range_m * range_m),
            speed_m_s: (x * vx + y * vy) / range_m,
        }
    }

    /// The course so many times as far and as fast: seen in the same directions.
    pub fn times(&self, factor: f64) -> Self {
        Self { t0_s: self.t0_s, p: self.p.map(|p| factor * p) }
    }

    /// Speed, m/s.
    pub fn speed_m_s(&self) -> f64 {
        let [_, _, vx, vy] = self.p;
        math::f64::hypot(vx, vy)
    }

    /// Its closest point and the covariance of (time, range, heading, speed) that follows from `cov` of the parameters;
    /// `None` for a vessel that does not move.
    pub fn closest(&self, cov: &CourseCovariance) -> Option<(Closest, CourseCovariance)> {
        let a = kit::closest(self.p)?;
        let time_s = self.t0_s + a.after_s;
        let closest = Closest { time_s, range_m: a.range_m, heading: a.heading, speed_m_s: a.speed_m_s };
        Some((closest, a.covariance(cov)))
    }

    /// Covariance of the place at a time.
    pub fn place_covariance(&self, cov: &CourseCovariance, t_s: f64) -> (f64, f64, f64) {
        let dt = t_s - self.t0_s;
        let [[xx, xy], [_, yy]] = propagated(&[[1.0, 0.0, dt, 0.0], [0.0, 1.0, 0.0, dt]], cov);
        (xx, yy, xy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closest_point_of_a_known_course() {
        // Heading east at 8 m/s, passing 6 km north of the station: station to starboard.
        let c = Course { t0_s: 100.0, p: [-4000.0, 6000.0, 8.0, 0.0] };
        let mut cov = [[0.0; N]; N];
        cov[1][1] = 25.0;
        let (k, s) = c.closest(&cov).unwrap();
        assert!((k.time_s - 600.0).abs() < 1e-9 && (k.range_m - 6000.0).abs() < 1e-9);
        assert!((k.heading - math::f64::FRAC_PI_2).abs() < 1e-12 && (k.speed_m_s - 8.0).abs() < 1e-12);
        assert!((s[1][1] - 25.0).abs() < 1e-9 && s[0][0].abs() < 1e-9);
        assert_eq!(Course { t0_s: 0.0, p: [1.0, 2.0, 0.0, 0.0] }.closest(&cov), None);
    }

    #[test]
    fn covariance_follows_finite_differences() {
        let base = Course { t0_s: 0.0, p: [-9000.0, 5000.0, 6.0, -2.0] };
        for k in 0..N {
            let mut cov = [[0.0; N]; N];
            cov[k][k] = 1.0;
            let (c0, s) = base.closest(&cov).unwrap();
            let mut moved = base;
            moved.p[k] += 1e-4;
            let (c1, _) = moved.closest(&cov).unwrap();
            let d = [
                c1.time_s - c0.time_s,
                c1.range_m - c0.range_m,
                c1.heading - c0.heading,
                c1.speed_m_s - c0.speed_m_s,
            ];
            for i in 0..N {
                assert!((s[i][i] - (d[i] / 1e-4).powi(2)).abs() < 1e-3 * (1.0 + s[i][i]), "{k} {i}");
            }
        }
    }
}
