//! Straight motion of one vessel from bearings of several arrays over time; no speed has to be assumed.
//!
//! `x(t) = x_r + v_x (t − t_r)`, `y(t) = y_r + v_y (t − t_r)` at a known height, all bearings of all arrays in one
//! Gaussian likelihood. One array's azimuths leave range and speed scaled together [M 5, 6]; a second array, or
//! elevations with the depth known, fix the scale. Each bearing points to where the vessel was when the sound left it.
//!
//! Start: the linear least-squares solution of the bearing lines `(x − x_n) cos α = (y − y_n) sin α`, or that of the
//! positions the elevations give, whichever is likelier; then damped Gauss-Newton over four unknowns. O(1) memory
//! beside the caller's bearings.

use super::matrix::{self, Square};
use super::model::{Sighting, bearing, gradients};
use super::{NetworkError, locate};
use crate::angle::{wrap_pi, wrap_tau};
use crate::math::f64 as m;

/// Most damped steps; convergence takes about ten.
const STEPS: u32 = 100;

/// A bearing with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dated {
    /// Time of arrival, seconds.
    pub t_s: f64,
    /// The bearing and its array.
    pub sighting: Sighting,
}

/// What is assumed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSettings {
    /// Height of the source (minus its depth), metres.
    pub z_m: f64,
    /// Speed of sound, m/s; infinite neglects travel time.
    pub sound_speed_m_s: f64,
}

/// A straight track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Reference time: the mean of the bearings' times, seconds.
    pub t_ref_s: f64,
    /// x, y (metres) at the reference time, and velocity East, North (m/s).
    pub state: [f64; 4],
    /// Covariance of the state.
    pub covariance: Square<4>,
    /// Sum of squared standardised residuals.
    pub misfit: f64,
    /// Angles minus four.
    pub freedom: u32,
}

impl Motion {
    /// x, y at a time, metres.
    pub fn position_m(&self, t_s: f64) -> [f64; 2] {
        let [x, y, vx, vy] = self.state;
        let dt = t_s - self.t_ref_s;
        [x + vx * dt, y + vy * dt]
    }

    /// Speed (m/s) and its standard deviation.
    pub fn speed_m_s(&self) -> (f64, f64) {
        let [_, _, vx, vy] = self.state;
        let v = m::sqrt(vx * vx + vy * vy);
        let variance = self.velocity_form([vx / v, vy / v]);
        (v, if variance.is_finite() { m::sqrt(variance) } else { f64::INFINITY })
    }

    /// Heading, radians clockwise from North, and its standard deviation.
    pub fn heading(&self) -> (f64, f64) {
        let [_, _, vx, vy] = self.state;
        let v2 = vx * vx + vy * vy;
        let variance = self.velocity_form([vy / v2, -vx / v2]);
        let sd = if variance.is_finite() { m::sqrt(variance).min(m::PI) } else { m::PI };
        (wrap_tau(m::atan2(vx, vy)), sd)
    }

    /// Time (seconds) and distance (metres) of the closest approach to a point.
    pub fn closest(&self, point_m: [f64; 2]) -> (f64, f64) {
        let [x, y, vx, vy] = self.state;
        let [px, py] = point_m;
        let v2 = vx * vx + vy * vy;
        let dt = if v2 > 0.0 { -((x - px) * vx + (y - py) * vy) / v2 } else { 0.0 };
        let (cx, cy) = (x + vx * dt - px, y + vy * dt - py);
        (self.t_ref_s + dt, m::sqrt(cx * cx + cy * cy))
    }

    /// `gᵀ C g` over the velocity block.
    fn velocity_form(&self, g: [f64; 2]) -> f64 {
        let [_, _, [_, _, xx, xy], [_, _, _, yy]] = self.covariance;
        let [a, b] = g;
        (a * a * xx + 2.0 * a * b * xy + b * b * yy).max(0.0)
    }
}

/// Fits the motion.
///
/// # Errors
/// [`NetworkError::NoBearings`], [`NetworkError::NotFinite`]; [`NetworkError::NotObservable`] where position or
/// velocity is not determined.
pub fn fit(bearings: &[Dated], settings: &JointSettings) -> Result<Motion, NetworkError> {
    if bearings.is_empty() {
        return Err(NetworkError::NoBearings);
    }
    for b in bearings {
        super::model::check(core::slice::from_ref(&b.sighting))?;
        if !b.t_s.is_finite() {
            return Err(NetworkError::NotFinite);
        }
    }
    if !settings.z_m.is_finite() || !(settings.sound_speed_m_s > 0.0) {
        return Err(NetworkError::NotFinite);
    }
    let t_ref_s = bearings.iter().map(|b| b.t_s).sum::<f64>() / bearings.len() as f64;
    let problem = Problem { bearings, settings, t_ref_s };
    let angles: u32 = bearings.iter().map(|b| 1 + u32::from(b.sighting.elevation.is_some())).sum();
    let start = [problem.start_of_lines(), problem.start_of_elevations()]
        .into_iter()
        .flatten()
        .map(|s| (problem.cost(&s), s))
        .filter(|(c, _)| c.is_finite())
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .ok_or(NetworkError::NotObservable)?;
    let (half_misfit, state) = problem.climb(start);
    let (information, _) = problem.normal(&state);
    let covariance = matrix::inverse(&information).ok_or(NetworkError::NotObservable)?;
    let motion =
        Motion { t_ref_s, state, covariance, misfit: 2.0 * half_misfit, freedom: angles.saturating_sub(4) };
    let [[xx, xy, ..], [_, yy, ..], ..] = covariance;
    let sd = m::sqrt(matrix::largest_eigenvalue(&[[xx, xy], [xy, yy]]));
    let distance = bearings.iter().map(|b| problem.distance(&b.sighting, b.t_s, &state)).sum::<f64>()
        / bearings.len() as f64;
    let finite = state.iter().all(|x| x.is_finite());
    if finite && sd <= locate::LARGEST_RELATIVE_SD * distance && motion.freedom > 0 {
        Ok(motion)
    } else {
        Err(NetworkError::NotObservable)
    }
}

struct Problem<'a> {
    bearings: &'a [Dated],
    settings: &'a JointSettings,
    t_ref_s: f64,
}

impl Problem<'_> {
    fn place(&self, t_s: f64, state: &[f64; 4]) -> [f64; 3] {
        let [x, y, vx, vy] = *state;
        let dt = t_s - self.t_ref_s;
        [x + vx * dt, y + vy * dt, self.settings.z_m]
    }

    fn distance(&self, s: &Sighting, t_s: f64, state: &[f64; 4]) -> f64 {
        let [x, y, z] = super::model::difference(&self.place(t_s, state), &s.array_m);
        m::sqrt(x * x + y * y + z * z)
    }

    /// When the sound of a bearing left the vessel: two rounds suffice, a vessel is far slower than sound.
    fn emission(&self, b: &Dated, state: &[f64; 4]) -> f64 {
        let c = self.settings.sound_speed_m_s;
        let first = b.t_s - self.distance(&b.sighting, b.t_s, state) / c;
        b.t_s - self.distance(&b.sighting, first, state) / c
    }

    fn cost(&self, state: &[f64; 4]) -> f64 {
        let mut sum = 0.0;
        for b in self.bearings {
            let s = &b.sighting;
            let (azimuth, elevation) = bearing(&s.array_m, &self.place(self.emission(b, state), state));
            let ra = wrap_pi(s.azimuth - azimuth) / s.sd_azimuth;
            let rb = s.elevation.map_or(0.0, |e| (e - elevation) / s.sd_elevation);
            sum += ra * ra + rb * rb;
        }
        0.5 * sum
    }

    /// Information matrix and downhill gradient.
    fn normal(&self, state: &[f64; 4]) -> (Square<4>, [f64; 4]) {
        let mut h = [[0.0; 4]; 4];
        let mut g = [0.0; 4];
        for b in self.bearings {
            let s = &b.sighting;
            let t = self.emission(b, state);
            let dt = t - self.t_ref_s;
            let place = self.place(t, state);
            let (azimuth, elevation) = bearing(&s.array_m, &place);
            let (ga, gb) = gradients(&s.array_m, &place);
            let mut add = |gradient: [f64; 3], residual: f64, sd: f64| {
                let [gx, gy, _] = gradient;
                let row = [gx, gy, gx * dt, gy * dt];
                let weight = 1.0 / (sd * sd);
                matrix::add_outer(&mut h, &row, weight);
                for (x, r) in g.iter_mut().zip(&row) {
                    *x += weight * residual * r;
                }
            };
            add(ga, wrap_pi(s.azimuth - azimuth), s.sd_azimuth);
            if let Some(e) = s.elevation {
                add(gb, e - elevation, s.sd_elevation);
            }
        }
        (h, g)
    }

    /// Linear start from the bearing lines.
    fn start_of_lines(&self) -> Option<[f64; 4]> {
        let rows = self.bearings.iter().map(|b| {
            let (sa, ca) = m::sin_cos(b.sighting.azimuth);
            let [x, y, _] = b.sighting.array_m;
            let dt = b.t_s - self.t_ref_s;
            ([ca, -sa, ca * dt, -sa * dt], x * ca - y * sa)
        });
        least_squares(rows)
    }

    /// Linear start from positions by azimuth, elevation and the known height.
    fn start_of_elevations(&self) -> Option<[f64; 4]> {
        let rows = self.bearings.iter().flat_map(|b| {
            let s = &b.sighting;
            let [x, y, z] = s.array_m;
            let dt = b.t_s - self.t_ref_s;
            let (sa, ca) = m::sin_cos(s.azimuth);
            let d = s.elevation.map_or(0.0, |e| (self.settings.z_m - z) / m::tan(e));
            // Ranges from shallow elevations are worthless and would dominate squares: weight by 1/d.
            let w = if d > 0.0 && d.is_finite() { 1.0 / (1.0 + d) } else { 0.0 };
            [
                ([w, 0.0, w * dt, 0.0], w * (x + if w > 0.0 { d * sa } else { 0.0 })),
                ([0.0, w, 0.0, w * dt], w * (y + if w > 0.0 { d * ca } else { 0.0 })),
            ]
        });
        least_squares(rows)
    }

    /// Damped Gauss-Newton from a start with its cost.
    fn climb(&self, start: (f64, [f64; 4])) -> (f64, [f64; 4]) {
        let (mut value, mut state) = start;
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let (mut h, g) = self.normal(&state);
            for (i, row) in h.iter_mut().enumerate() {
                if let Some(x) = row.get_mut(i) {
                    *x = *x * (1.0 + damping) + 1e-30;
                }
            }
            let Some(factor) = matrix::cholesky(&h) else {
                damping = damping.max(1e-9) * 10.0;
                if damping > 1e6 {
                    break;
                }
                continue;
            };
            let step = matrix::solve(&factor, &g);
            let mut trial = state;
            for (t, s) in trial.iter_mut().zip(&step) {
                *t += s;
            }
            let c = self.cost(&trial);
            if c < value {
                let gain = value - c;
                value = c;
                state = trial;
                damping = (damping * 0.1).max(1e-12);
                if gain < 1e-10 * (1.0 + value) {
                    break;
                }
            } else {
                damping = damping.max(1e-9) * 10.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        (value, state)
    }
}

/// Least squares of rows `a · x = b`; `None` where they do not determine x.
fn least_squares(rows: impl Iterator<Item = ([f64; 4], f64)>) -> Option<[f64; 4]> {
    let mut h = [[0.0; 4]; 4];
    let mut g = [0.0; 4];
    for (row, value) in rows {
        matrix::add_outer(&mut h, &row, 1.0);
        for (x, r) in g.iter_mut().zip(&row) {
            *x += value * r;
        }
    }
    let factor = matrix::cholesky(&h)?;
    Some(matrix::solve(&factor, &g))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const TWO: [[f64; 3]; 2] = [[0.0, 100.0, -168.0], [0.0, -100.0, -168.0]];
    const SETTINGS: JointSettings = JointSettings { z_m: -5.0, sound_speed_m_s: 1484.0 };

    /// Exact bearings of a vessel with travel time, at different instants for each array.
    fn bearings(arrays: &[[f64; 3]], elevation: bool) -> Vec<Dated> {
        let mut out = Vec::new();
        for k in 0..100 {
            for (i, array_m) in arrays.iter().enumerate() {
                let emitted = 2.0 * f64::from(k) + 0.7 * i as f64;
                let p = [400.0 + 2.0 * emitted, -700.0 + 7.0 * emitted, -5.0];
                let (a, b) = bearing(array_m, &p);
                let d: f64 = p.iter().zip(array_m).map(|(x, y)| (x - y) * (x - y)).sum();
                let sighting = Sighting {
                    array_m: *array_m,
                    azimuth: a,
                    elevation: elevation.then_some(b),
                    sd_azimuth: 0.026,
                    sd_elevation: 0.028,
                };
                out.push(Dated { t_s: emitted + d.sqrt() / 1484.0, sighting });
            }
        }
        out
    }

    #[test]
    fn two_arrays_need_no_speed_and_one_with_depth_neither() {
        for (arrays, elevation) in [(&TWO[..], false), (&TWO[..], true), (&TWO[..1], true)] {
            let motion = fit(&bearings(arrays, elevation), &SETTINGS).unwrap();
            let (v, sd) = motion.speed_m_s();
            assert!((v - 53f64.sqrt()).abs() < 1e-4 && sd > 0.0, "{v} {sd}");
            assert!((motion.heading().0 - 2f64.atan2(7.0)).abs() < 1e-5);
            let [x, y] = motion.position_m(0.0);
            assert!((x - 400.0).abs() < 0.01 && (y + 700.0).abs() < 0.01, "{x} {y}");
        }
    }

    #[test]
    fn one_array_without_elevation_is_refused() {
        assert_eq!(fit(&bearings(&TWO[..1], false), &SETTINGS), Err(NetworkError::NotObservable));
    }

    #[test]
    fn closest_approach() {
        let motion = Motion {
            t_ref_s: 10.0,
            state: [300.0, -100.0, 0.0, 5.0],
            covariance: [[0.0; 4]; 4],
            misfit: 0.0,
            freedom: 1,
        };
        let (t, d) = motion.closest([0.0, 0.0]);
        assert!((t - 30.0).abs() < 1e-12 && (d - 300.0).abs() < 1e-12);
    }
}
