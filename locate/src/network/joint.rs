//! Straight motion of one vessel from bearings of several arrays over time; no speed has to be assumed.
//!
//! `x(t) = x_r + v_x (t − t_r)`, `y(t) = y_r + v_y (t − t_r)` at a known height, all bearings of all arrays in one
//! Gaussian likelihood. One array's azimuths leave range and speed scaled together [M 5, 6]; a second array, or
//! elevations with the depth known, fix the scale. Each bearing points to where the vessel was when the sound left it.
//! Single wrong bearings pull no more than one of three standard deviations does (Huber's likelihood). Where the whole
//! misfit is beyond its 99.9 % point and one array is the cause, that array is set aside and named.
//!
//! Start: the linear least-squares solution of the bearing lines `(x − x_n) cos α = (y − y_n) sin α`, or that of the
//! positions the elevations give, whichever is likelier; then damped Gauss-Newton over four unknowns. O(1) memory
//! beside the caller's bearings.

use super::matrix::{self, Square};
use super::model::{Sighting, bearing, gradients};
use super::{MAX_ARRAYS, NetworkError, locate};
use crate::angle::{wrap_pi, wrap_tau};
use crate::math::f64 as m;

/// Most damped steps; convergence takes about ten.
const STEPS: u32 = 100;
/// Where a standardised residual stops to count squared: 0.3 % of Gaussian ones are beyond.
const CORNER: f64 = 3.0;

/// A bearing with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dated {
    /// Time of arrival, seconds.
    pub t_s: f64,
    /// Number of the array, below [`MAX_ARRAYS`].
    pub array: usize,
    /// The bearing and its array's position.
    pub sighting: Sighting,
}

/// What is assumed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSettings {
    /// Height of the source (minus its depth), metres.
    pub z_m: f64,
    /// Speed of sound, m/s; infinite neglects travel time.
    pub sound_speed_m_s: f64,
    /// Set one array aside where it contradicts the others; needs three.
    pub robust: bool,
}

/// A straight track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Reference time: the mean of the bearings' times, seconds.
    pub t_ref_s: f64,
    /// x, y (metres) at the reference time, and velocity East, North (m/s).
    pub state: [f64; 4],
    /// Covariance of the state; grown by misfit over freedom where the bearings scatter more than they claim.
    pub covariance: Square<4>,
    /// Sum of squared standardised residuals, those beyond three counted as three.
    pub misfit: f64,
    /// Angles minus four.
    pub freedom: u32,
    /// The array that was set aside.
    pub rejected: Option<usize>,
}

/// Closest approach of a track to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Approach {
    /// When, seconds, and its standard deviation.
    pub t_s: (f64, f64),
    /// Horizontal distance, metres, and its standard deviation.
    pub range_m: (f64, f64),
    /// The point is to the right of the vessel's way.
    pub to_starboard: bool,
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

    /// Closest approach to a point; `None` for a vessel that does not move.
    ///
    /// With `p` the way from the point to the vessel at the reference time and `w = v/|v|`: `t = −p·w/|v|` later, at the
    /// signed distance `c = p × w`. Their errors follow from the state's to first order.
    pub fn closest(&self, point_m: [f64; 2]) -> Option<Approach> {
        let [x, y, vx, vy] = self.state;
        let [px, py] = point_m;
        let (dx, dy) = (x - px, y - py);
        let v = m::sqrt(vx * vx + vy * vy);
        if !(v > 0.0) {
            return None;
        }
        let (wx, wy) = (vx / v, vy / v);
        let along = dx * wx + dy * wy;
        let across = dx * wy - dy * wx;
        let time = [-wx / v, -wy / v, (2.0 * along * wx - dx) / (v * v), (2.0 * along * wy - dy) / (v * v)];
        let range = [wy, -wx, -along * wy / v, along * wx / v];
        Some(Approach {
            t_s: (self.t_ref_s - along / v, self.sd_of(&time)),
            range_m: (m::abs(across), self.sd_of(&range)),
            to_starboard: across < 0.0,
        })
    }

    /// `√(gᵀ C g)`.
    fn sd_of(&self, gradient: &[f64; 4]) -> f64 {
        let mut sum = 0.0;
        for (row, a) in self.covariance.iter().zip(gradient) {
            for (c, b) in row.iter().zip(gradient) {
                sum += a * c * b;
            }
        }
        m::sqrt(sum.max(0.0))
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
        if b.array >= MAX_ARRAYS {
            return Err(NetworkError::TooManyArrays);
        }
    }
    if !settings.z_m.is_finite() || !(settings.sound_speed_m_s > 0.0) {
        return Err(NetworkError::NotFinite);
    }
    let all = fit_without(bearings, settings, None);
    let arrays = (0..MAX_ARRAYS).filter(|i| bearings.iter().any(|b| b.array == *i));
    let doubtful = all.is_ok_and(|m| m.misfit > locate::misfit_limit(m.freedom));
    if !(settings.robust && doubtful && arrays.clone().count() >= 3) {
        return all;
    }
    // The others agree without the culprit, and without it alone.
    let agreeing = |i: &usize| {
        let motion = fit_without(bearings, settings, Some(*i)).ok()?;
        (motion.misfit <= locate::misfit_limit(motion.freedom)).then_some(motion)
    };
    let mut found = arrays.filter_map(|i| agreeing(&i));
    match (found.next(), found.next()) {
        (Some(only), None) => Ok(only),
        _ => all,
    }
}

/// The fit without one array.
fn fit_without(
    bearings: &[Dated],
    settings: &JointSettings,
    rejected: Option<usize>,
) -> Result<Motion, NetworkError> {
    let used = || bearings.iter().filter(move |b| Some(b.array) != rejected);
    let n = used().count().max(1) as f64;
    let t_ref_s = used().map(|b| b.t_s).sum::<f64>() / n;
    let problem = Problem { bearings, settings, t_ref_s, rejected };
    let angles: u32 = used().map(|b| 1 + u32::from(b.sighting.elevation.is_some())).sum();
    let start = [problem.start_of_lines(), problem.start_of_elevations()]
        .into_iter()
        .flatten()
        .map(|s| (problem.cost(&s), s))
        .filter(|(c, _)| c.is_finite())
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .ok_or(NetworkError::NotObservable)?;
    let state = problem.climb(start);
    let (information, _) = problem.normal(&state);
    let mut covariance = matrix::inverse(&information).ok_or(NetworkError::NotObservable)?;
    let (misfit, freedom) = (problem.misfit(&state), angles.saturating_sub(4));
    let growth = (misfit / f64::from(freedom.max(1))).max(1.0);
    for x in covariance.iter_mut().flatten() {
        *x *= growth;
    }
    let motion = Motion { t_ref_s, state, covariance, misfit, freedom, rejected };
    let [[xx, xy, ..], [_, yy, ..], ..] = covariance;
    let sd = m::sqrt(matrix::largest_eigenvalue(&[[xx, xy], [xy, yy]]));
    let distance = used().map(|b| problem.distance(&b.sighting, b.t_s, &state)).sum::<f64>() / n;
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
    rejected: Option<usize>,
}

/// Huber's loss of a standardised residual, and the weight that makes it squares.
fn huber(residual: f64) -> (f64, f64) {
    let size = m::abs(residual);
    if size <= CORNER { (0.5 * size * size, 1.0) } else { (CORNER * (size - 0.5 * CORNER), CORNER / size) }
}

impl Problem<'_> {
    fn used(&self) -> impl Iterator<Item = &Dated> + '_ {
        self.bearings.iter().filter(|b| Some(b.array) != self.rejected)
    }

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
        self.residuals(state).map(|[a, b]| huber(a).0 + huber(b).0).sum()
    }

    fn misfit(&self, state: &[f64; 4]) -> f64 {
        let clipped = |r: f64| m::abs(r).min(CORNER);
        self.residuals(state).map(|[a, b]| clipped(a) * clipped(a) + clipped(b) * clipped(b)).sum()
    }

    /// Standardised residuals of azimuth and elevation (zero where there is none).
    fn residuals(&self, state: &[f64; 4]) -> impl Iterator<Item = [f64; 2]> {
        self.used().map(move |b| {
            let s = &b.sighting;
            let (azimuth, elevation) = bearing(&s.array_m, &self.place(self.emission(b, state), state));
            let a = wrap_pi(s.azimuth - azimuth) / s.sd_azimuth;
            [a, s.elevation.map_or(0.0, |e| (e - elevation) / s.sd_elevation)]
        })
    }

    /// Information matrix and downhill gradient.
    fn normal(&self, state: &[f64; 4]) -> (Square<4>, [f64; 4]) {
        let mut h = [[0.0; 4]; 4];
        let mut g = [0.0; 4];
        for b in self.used() {
            let s = &b.sighting;
            let t = self.emission(b, state);
            let dt = t - self.t_ref_s;
            let place = self.place(t, state);
            let (azimuth, elevation) = bearing(&s.array_m, &place);
            let (ga, gb) = gradients(&s.array_m, &place);
            let mut add = |gradient: [f64; 3], residual: f64, sd: f64| {
                let [gx, gy, _] = gradient;
                let row = [gx, gy, gx * dt, gy * dt];
                let weight = huber(residual / sd).1 / (sd * sd);
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
        let rows = self.used().map(|b| {
            let (sa, ca) = m::sin_cos(b.sighting.azimuth);
            let [x, y, _] = b.sighting.array_m;
            let dt = b.t_s - self.t_ref_s;
            ([ca, -sa, ca * dt, -sa * dt], x * ca - y * sa)
        });
        least_squares(rows)
    }

    /// Linear start from positions by azimuth, elevation and the known height.
    fn start_of_elevations(&self) -> Option<[f64; 4]> {
        let rows = self.used().flat_map(|b| {
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
    fn climb(&self, start: (f64, [f64; 4])) -> [f64; 4] {
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
        state
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
    const SETTINGS: JointSettings = JointSettings { z_m: -5.0, sound_speed_m_s: 1484.0, robust: true };

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
                out.push(Dated { t_s: emitted + d.sqrt() / 1484.0, array: i, sighting });
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
    fn a_turned_array_is_set_aside_and_single_wrong_bearings_hardly_pull() {
        let three = [TWO[0], TWO[1], [150.0, 0.0, -168.0]];
        let mut turned = bearings(&three, false);
        for b in turned.iter_mut().filter(|b| b.array == 2) {
            b.sighting.azimuth += 0.4;
        }
        let motion = fit(&turned, &SETTINGS).unwrap();
        assert_eq!(motion.rejected, Some(2));
        assert!((motion.speed_m_s().0 - 53f64.sqrt()).abs() < 1e-3, "{motion:?}");
        let mut wrong = bearings(&TWO, false);
        for b in wrong.iter_mut().step_by(17) {
            b.sighting.azimuth += 2.0;
        }
        let motion = fit(&wrong, &SETTINGS).unwrap();
        let (v, sd) = motion.speed_m_s();
        assert!((v - 53f64.sqrt()).abs() < 2.0 * sd && sd < 0.2, "{v} {sd}");
    }

    #[test]
    fn closest_approach() {
        let motion = Motion {
            t_ref_s: 10.0,
            state: [300.0, -100.0, 0.0, 5.0],
            covariance: [
                [4.0, 0.0, 0.0, 0.0],
                [0.0, 9.0, 0.0, 0.0],
                [0.0, 0.0, 0.01, 0.0],
                [0.0, 0.0, 0.0, 0.0],
            ],
            misfit: 0.0,
            freedom: 1,
            rejected: None,
        };
        let a = motion.closest([0.0, 0.0]).unwrap();
        assert!((a.t_s.0 - 30.0).abs() < 1e-12 && (a.range_m.0 - 300.0).abs() < 1e-12);
        // A vessel heading North at x = 300: the origin is to port. The range moves with x and, 20 s later, with v_x.
        assert!(!a.to_starboard && (a.range_m.1 - (4.0f64 + 400.0 * 0.01).sqrt()).abs() < 1e-9, "{a:?}");
        // The time: σ_y/v, and the turn of the way by δv_x/v at 300 m.
        let turned = (9.0f64 / 25.0 + (300.0f64 / 25.0).powi(2) * 0.01).sqrt();
        assert!((a.t_s.1 - turned).abs() < 1e-9, "{a:?}");
    }
}
