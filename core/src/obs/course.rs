//! A straight course at constant speed, what the station sees of it, and its closest point of approach.
//!
//! Parameters: East, North (m) and velocity (m/s) at a reference time, which stay well conditioned for slow vessels and
//! for records without a closest point. Seen at t: the vessel at its time of emission t − toa(r). Closest point: time
//! t0 − x·v/v², signed range c = (y vx − x vy)/v, positive where the station lies to starboard [O 26, METHODS-OBS 8].

use super::travel::TravelTime;
use crate::angle::wrap_tau;
use crate::math;

/// Number of parameters.
pub const N: usize = 4;

/// A square matrix of that size.
pub type Matrix = [[f64; N]; N];

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
    /// Azimuth, rad.
    pub azimuth: f64,
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

    /// The same course with another reference time.
    pub fn moved_to(&self, t0_s: f64) -> Self {
        let (x, y) = self.at(t0_s);
        let [_, _, vx, vy] = self.p;
        Self { t0_s, p: [x, y, vx, vy] }
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
            azimuth: math::f64::atan2(x, y),
            speed_m_s: (x * vx + y * vy) / range_m,
        }
    }

    /// Speed, m/s.
    pub fn speed_m_s(&self) -> f64 {
        let [_, _, vx, vy] = self.p;
        math::f64::hypot(vx, vy)
    }

    /// Its closest point and the covariance of (time, range, heading, speed) that follows from `cov` of the parameters;
    /// `None` for a vessel that does not move.
    pub fn closest(&self, cov: &Matrix) -> Option<(Closest, Matrix)> {
        let [x, y, vx, vy] = self.p;
        let vv = vx * vx + vy * vy;
        if vv < 1e-4 {
            return None;
        }
        let v = math::f64::sqrt(vv);
        let along = x * vx + y * vy;
        let c = (y * vx - x * vy) / v;
        let closest = Closest {
            time_s: self.t0_s - along / vv,
            range_m: c,
            heading: wrap_tau(math::f64::atan2(vx, vy)),
            speed_m_s: v,
        };
        let j: Matrix = [
            [
                -vx / vv,
                -vy / vv,
                -x / vv + 2.0 * along * vx / (vv * vv),
                -y / vv + 2.0 * along * vy / (vv * vv),
            ],
            [-vy / v, vx / v, y / v - c * vx / vv, -x / v - c * vy / vv],
            [0.0, 0.0, vy / vv, -vx / vv],
            [0.0, 0.0, vx / v, vy / v],
        ];
        Some((closest, sandwich(&j, cov)))
    }

    /// Covariance of the place at a time.
    pub fn place_covariance(&self, cov: &Matrix, t_s: f64) -> (f64, f64, f64) {
        let dt = t_s - self.t0_s;
        let j: Matrix = [[1.0, 0.0, dt, 0.0], [0.0, 1.0, 0.0, dt], [0.0; N], [0.0; N]];
        let [[xx, xy, ..], [_, yy, ..], ..] = sandwich(&j, cov);
        (xx, yy, xy)
    }
}

/// `J C Jᵀ`.
fn sandwich(j: &Matrix, c: &Matrix) -> Matrix {
    let mut out = [[0.0; N]; N];
    for (row, a) in out.iter_mut().zip(j) {
        for (cell, b) in row.iter_mut().zip(j) {
            for (x, cx) in a.iter().zip(c) {
                for (y, cxy) in b.iter().zip(cx) {
                    *cell += x * cxy * y;
                }
            }
        }
    }
    out
}

/// Inverse of a symmetric positive definite matrix by Gauss-Jordan with a floor on the pivots; `None` if singular.
pub fn inverse(m: &Matrix) -> Option<Matrix> {
    let mut a = *m;
    let mut out = [[0.0; N]; N];
    out.iter_mut().enumerate().for_each(|(i, r)| r.iter_mut().skip(i).take(1).for_each(|x| *x = 1.0));
    for k in 0..N {
        let (pivot_a, pivot_out) = (*a.get(k)?, *out.get(k)?);
        let pivot = *pivot_a.get(k)?;
        // A positive definite matrix keeps positive pivots without exchange of rows.
        let usable = pivot > 1e-300 && pivot.is_finite();
        if !usable {
            return None;
        }
        for (i, (row, orow)) in a.iter_mut().zip(out.iter_mut()).enumerate() {
            let factor = if i == k { 1.0 - 1.0 / pivot } else { *row.get(k)? / pivot };
            row.iter_mut().zip(&pivot_a).for_each(|(x, p)| *x -= factor * p);
            orow.iter_mut().zip(&pivot_out).for_each(|(x, p)| *x -= factor * p);
        }
    }
    out.iter().flatten().all(|x| x.is_finite()).then_some(out)
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

    #[test]
    fn inverse_undoes() {
        let m = [[4.0, 1.0, 0.5, 0.0], [1.0, 3.0, 0.2, 0.1], [0.5, 0.2, 2.0, 0.3], [0.0, 0.1, 0.3, 1.0]];
        let i = inverse(&m).unwrap();
        for a in 0..N {
            for b in 0..N {
                let x: f64 = (0..N).map(|k| m[a][k] * i[k][b]).sum();
                assert!((x - f64::from(u8::from(a == b))).abs() < 1e-12);
            }
        }
        assert_eq!(inverse(&[[0.0; N]; N]), None);
    }
}
