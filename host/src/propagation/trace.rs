//! Ray tracing from a surface source to a station on a flat floor, by ray parameter.
//!
//! A path of n crossings leaves with the ray parameter p for which one crossing spans r / n; its travel time is n
//! times that crossing's. Its amplitude is `−2 cos θ₀ · G · (1 + R) · (−R)^((n−1)/2)`: the dipole that a source makes
//! with its image just under the surface, ray-tube spreading
//! `G² = p c₀ c_b (dp/dr) / (r cos θ₀ cos θ_b)` (with r = n X(p); 1 / R² in one speed), the floor's coefficient R at
//! the receiver and at every bounce, −1 at the surface. Amplitudes are relative to 1 m and to the dipole's strength
//! straight down. Rays that turn before they cross reach no station: a path ends where its ray would leave level.

use super::bottom::Bottom;
use super::profile::SpeedProfile;
use super::{Complex, F0_HZ, Propagation, RayArrival, RayPath, WIDTH_S, strength};

/// Paths traced: 1, 3, … 13 crossings.
const PATHS: usize = 7;

/// Bisection steps: the ray parameter to the last bit of a double.
const STEPS: usize = 60;

/// Traces a table of `rows` ranges in steps of `step_m`, starting at 0. `done` is told of each finished row.
pub fn trace(
    name: &str,
    profile: &SpeedProfile,
    bottom: &Bottom,
    step_m: f64,
    rows: usize,
    mut done: impl FnMut(),
) -> Propagation {
    let over = |bottom: &Bottom, done: &mut dyn FnMut()| {
        let mut paths: Vec<RayPath> = (0..PATHS)
            .map(|i| RayPath { crossings: 2 * i as u32 + 1, arrivals: Vec::with_capacity(rows) })
            .collect();
        for j in 0..rows {
            for path in &mut paths {
                let a = arrival(profile, bottom, path.crossings, step_m * j as f64);
                path.arrivals.push(a);
            }
            done();
        }
        paths
    };
    let paths = over(bottom, &mut done);
    let mut strengths = strength::of_depth(profile.depth_m()).to_vec();
    // Those of RR03 are over its floor.
    let usual = Bottom::default();
    if *bottom != usual {
        let over_usual = over(&usual, &mut || ());
        strength::over_another_floor(&mut strengths, profile.depth_m(), step_m, &over_usual, &paths);
    }
    Propagation {
        name: name.to_owned(),
        depth_m: profile.depth_m(),
        step_m,
        f0_hz: F0_HZ,
        width_s: WIDTH_S,
        paths,
        strengths,
    }
}

/// The ray parameter whose single crossing spans a distance; `None` where every such ray turns before.
fn ray_parameter(profile: &SpeedProfile, x_m: f64) -> Option<f64> {
    // The last parameter tried keeps the steepest place of the profile just short of turning.
    let (mut low, mut high) = (0.0, (1.0 - 1e-12) / profile.greatest_m_s());
    if profile.crossing(high).x_m < x_m {
        return None;
    }
    for _ in 0..STEPS {
        let middle = 0.5 * (low + high);
        if profile.crossing(middle).x_m < x_m { low = middle } else { high = middle }
    }
    Some(0.5 * (low + high))
}

/// What the path of `crossings` brings from a range.
pub fn arrival(profile: &SpeedProfile, bottom: &Bottom, crossings: u32, range_m: f64) -> Option<RayArrival> {
    let n = f64::from(crossings);
    let p = ray_parameter(profile, range_m / n)?;
    let (c0, cb) = (profile.surface_m_s(), profile.floor_m_s());
    let cos = |c: f64| (1.0 - (p * c).powi(2)).max(0.0).sqrt();
    // Derivative of one crossing's span by the ray parameter, and span over parameter (finite at p = 0).
    let h = 1e-7 / profile.greatest_m_s();
    let (lo, hi) = ((p - h).max(0.0), (p + h).min((1.0 - 1e-12) / profile.greatest_m_s()));
    let slope = (profile.crossing(hi).x_m - profile.crossing(lo).x_m) / (hi - lo);
    let q = p.max(h);
    let x_by_p = profile.crossing(q).x_m / q;
    let spreading = (c0 * cb / (n * n * x_by_p * slope * cos(cb))).sqrt();
    // The dipole's cos θ₀ times the spreading's 1/√cos θ₀, joined so that a level ray gives zero and not 0/0.
    let r = bottom.reflection(p, cb);
    let bounces = (-r).powu((crossings - 1) / 2);
    let amplitude = (Complex::new(1.0, 0.0) + r) * bounces * (-2.0 * spreading * cos(c0).sqrt());
    let toa_s = n * profile.crossing(p).t_s;
    amplitude.is_finite().then_some(RayArrival { toa_s, amplitude })
}

/// The same in closed form for water of one speed: the image of the source n crossings up.
pub fn image(depth_m: f64, speed_m_s: f64, bottom: &Bottom, crossings: u32, range_m: f64) -> RayArrival {
    let up = f64::from(crossings) * depth_m;
    let slant = range_m.hypot(up);
    let r = bottom.reflection(range_m / slant / speed_m_s, speed_m_s);
    let bounces = (-r).powu((crossings - 1) / 2);
    let amplitude = (Complex::new(1.0, 0.0) + r) * bounces * (-2.0 * (up / slant) / slant);
    RayArrival { toa_s: slant / speed_m_s, amplitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_speed_agrees_with_the_image_solution() {
        let (profile, bottom) = (SpeedProfile::uniform(4340.0, 1505.0), Bottom::default());
        for crossings in [1, 3, 5, 7, 9, 11, 13] {
            for range_m in [0.0, 70.0, 3000.0, 5141.0, 12_000.0, 40_000.0, 99_960.0] {
                let a = arrival(&profile, &bottom, crossings, range_m).unwrap();
                let b = image(4340.0, 1505.0, &bottom, crossings, range_m);
                assert!((a.toa_s - b.toa_s).abs() < 1e-9, "{crossings} {range_m} {a:?} {b:?}");
                let off = (a.amplitude - b.amplitude).norm() / b.amplitude.norm();
                assert!(off < 2e-3, "{crossings} {range_m} {off} {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn a_flat_floor_stretches_the_direct_path() {
        let profile =
            SpeedProfile::new(vec![(0.0, 1540.0), (1000.0, 1486.0), (4340.0, 1528.0)], 4340.0).unwrap();
        let bottom = Bottom::default();
        for n in [3u32, 5, 13] {
            let one = arrival(&profile, &bottom, 1, 7000.0).unwrap();
            let many = arrival(&profile, &bottom, n, 7000.0 * f64::from(n)).unwrap();
            assert!((many.toa_s - f64::from(n) * one.toa_s).abs() < 1e-9);
        }
    }

    #[test]
    fn a_path_ends_where_its_ray_leaves_level() {
        let profile =
            SpeedProfile::new(vec![(0.0, 1540.0), (1000.0, 1486.0), (4340.0, 1528.0)], 4340.0).unwrap();
        let bottom = Bottom::default();
        let last = (0..3000)
            .map(|j| 20.0 * f64::from(j))
            .take_while(|r| arrival(&profile, &bottom, 1, *r).is_some())
            .last()
            .unwrap();
        assert!((20_000.0..30_000.0).contains(&last), "{last}");
        let near_end = arrival(&profile, &bottom, 1, last).unwrap().amplitude.norm();
        assert!(near_end < 0.2 * arrival(&profile, &bottom, 1, 0.5 * last).unwrap().amplitude.norm());
    }
}
