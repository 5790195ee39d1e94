//! The way a vessel went, from AIS fixes: smooth, since fixes are only good to their times, which may be whole minutes, while
//! a vessel's speed changes slowly.
//!
//! Enters: fixes in order of time. Leaves: place and velocity at each, joined by cubics ([`VesselCourse::Smooth`]). Each
//! component is an integrated random walk, seen with an error of place that is the error of time times the speed: the
//! smoothing spline, computed by a Kalman filter and its backward pass (Rauch, Tung and Striebel 1965).

use crate::course::{Fix, Steady, VesselCourse};
use nalgebra::{Matrix2, RowVector2, Vector2};

/// Variance that a component of the velocity gains a second, m²/s³: 0.25 m/s within an hour, the median change of the speeds
/// that merchant vessels report themselves being 0.15 m/s and its root mean square 0.4 m/s.
const DRIFT: f64 = 1.7e-5;

/// Error of a fix's place itself, m.
const PLACE_M: f64 = 20.0;

/// Before the first fix nothing is known: m, m/s.
const UNKNOWN: (f64, f64) = (1e6, 1e2);

/// A component's place and velocity.
#[derive(Clone, Copy)]
struct Known {
    x: Vector2<f64>,
    covariance: Matrix2<f64>,
}

/// The way through fixes in order of time, two or more, whose times have that standard deviation, s.
pub fn way(fixes: &[Fix], sd_s: f64) -> VesselCourse {
    let sd_m = PLACE_M.hypot(sd_s * speed_m_s(fixes));
    let component = |of: fn(&Fix) -> f64| smoothed(fixes.iter().map(|f| (f.0, of(f))).collect(), sd_m);
    let (east, north) = (component(|f| f.1.0), component(|f| f.1.1));
    let moments = fixes.iter().zip(east.iter().zip(&north)).map(|(fix, (e, n))| Steady {
        at_s: fix.0,
        place_m: (e[0], n[0]),
        velocity_m_s: (e[1], n[1]),
    });
    VesselCourse::Smooth(moments.collect())
}

/// From the first fix to the last.
fn speed_m_s(fixes: &[Fix]) -> f64 {
    let [first, .., last] = fixes else { return 0.0 };
    (last.1.0 - first.1.0).hypot(last.1.1 - first.1.1) / (last.0 - first.0)
}

/// How a component goes on.
fn step(dt: f64) -> (Matrix2<f64>, Matrix2<f64>) {
    let gained = Matrix2::new(dt * dt / 3.0, dt / 2.0, dt / 2.0, 1.0) * (DRIFT * dt);
    (Matrix2::new(1.0, dt, 0.0, 1.0), gained)
}

/// Place and velocity at each of the times, from places seen with that error.
fn smoothed(seen: Vec<(f64, f64)>, sd_m: f64) -> Vec<Vector2<f64>> {
    let sees = RowVector2::new(1.0, 0.0);
    let Some(first) = seen.first() else { return Vec::new() };
    let mut now = Known {
        x: Vector2::new(first.1, 0.0),
        covariance: Matrix2::new(UNKNOWN.0.powi(2), 0.0, 0.0, UNKNOWN.1.powi(2)),
    };
    // As known at each time from what came before, and with its own fix.
    let (mut before, mut after) = (Vec::new(), Vec::<Known>::new());
    let mut last_s = first.0;
    for (t_s, place) in &seen {
        let (f, gained) = step(t_s - last_s);
        now = Known { x: f * now.x, covariance: f * now.covariance * f.transpose() + gained };
        before.push(now);
        let gain = now.covariance * sees.transpose() / (now.covariance[(0, 0)] + sd_m * sd_m);
        now.x += gain * (place - now.x[0]);
        now.covariance -= gain * sees * now.covariance;
        after.push(now);
        last_s = *t_s;
    }
    let mut out: Vec<Vector2<f64>> = after.iter().map(|k| k.x).collect();
    for k in (0..out.len().saturating_sub(1)).rev() {
        let (f, _) = step(seen[k + 1].0 - seen[k].0);
        let Some(inverse) = before[k + 1].covariance.try_inverse() else { continue };
        let back = after[k].covariance * f.transpose() * inverse;
        out[k] = after[k].x + back * (out[k + 1] - before[k + 1].x);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A vessel that slowly turns and slows down.
    fn truth(t_s: f64) -> ((f64, f64), f64) {
        let turned = t_s / 40_000.0;
        let speed = 7.0 - t_s / 36_000.0;
        (
            (-50_000.0 + 7.0 * t_s - t_s * t_s / 72_000.0, 8_000.0 + 3.5 * t_s * turned),
            speed.hypot(7.0 * turned),
        )
    }

    #[test]
    fn whole_minutes_make_no_steps_of_the_speed() {
        // Every three to five minutes, told in whole ones.
        let fixes: Vec<Fix> = (0..60)
            .map(|k| 240.0 * f64::from(k) + f64::from(k * 37 % 60))
            .map(|t| ((t / 60.0).floor() * 60.0, truth(t).0))
            .collect();
        let legs = VesselCourse::Fixes(fixes.clone());
        let worst = |c: &VesselCourse| {
            let errors = (10..220).map(|n| {
                let (vx, vy) = c.velocity(60.0 * f64::from(n));
                (vx.hypot(vy) - truth(60.0 * f64::from(n)).1).abs()
            });
            errors.fold(0.0, f64::max)
        };
        let (before, now) = (worst(&legs), worst(&way(&fixes, 17.3)));
        assert!(before > 0.8 && now < 0.25, "{before} {now}");
        for n in 10..220 {
            let (a, b) =
                (way(&fixes, 17.3).position(60.0 * f64::from(n)), truth(60.0 * f64::from(n) + 30.0).0);
            assert!((a.0 - b.0).hypot(a.1 - b.1) < 150.0, "{n}");
        }
    }

    #[test]
    fn good_times_leave_the_fixes_where_they_are() {
        let fixes: Vec<Fix> = (0..40).map(|k| 200.5 * f64::from(k) + 3.7).map(|t| (t, truth(t).0)).collect();
        let course = way(&fixes, 0.0);
        for (t, p) in &fixes {
            let q = course.position(*t);
            assert!((p.0 - q.0).hypot(p.1 - q.1) < 10.0);
        }
    }
}
