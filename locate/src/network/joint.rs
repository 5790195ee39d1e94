//! Straight motion of one vessel from bearings of several arrays over time; no speed has to be assumed.
//!
//! `x(t) = x_r + v_x (t − t_r)`, `y(t) = y_r + v_y (t − t_r)` at a known height, all bearings of all arrays in one
//! Gaussian likelihood. One array's azimuths leave range and speed scaled together [M 5, 6]; a second array, or
//! elevations with the depth known, fix the scale. Each bearing points to where the vessel was when the sound left it.
//! Single wrong bearings pull no more than one of three standard deviations does (Huber's likelihood). Where the whole
//! misfit is beyond its 99.9 % point and one array is the cause, that array is set aside and named.
//!
//! Start: the linear least-squares solution of the bearing lines `(x − x_n) cos α = (y − y_n) sin α`, or that of the
//! positions the elevations give, whichever is likelier; then Levenberg-Marquardt over four unknowns. O(1) memory
//! beside the caller's bearings.

use super::model::{Sighting, bearing, gradients};
use super::{MAX_ARRAYS, NetworkError, locate};
use crate::angle::wrap_pi;
use crate::kit::normal::least_squares;
use crate::kit::spd::{self, Square};
use crate::kit::{Huber, Normal, minimise};
use crate::math::f64 as m;

/// Most damped steps; convergence takes about ten.
const STEPS: usize = 100;
/// Fall of the cost that is not worth a step.
const LEAST_FALL: f64 = 1e-11;
/// Where a standardised residual stops to count squared: 0.3 % of Gaussian ones are beyond.
const HUBER: Huber = Huber { corner: 3.0 };

/// A bearing with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DatedSighting {
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
pub struct JointTrack {
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
pub struct ClosestApproach {
    /// When, seconds, and its standard deviation.
    pub t_s: (f64, f64),
    /// Horizontal distance, metres, and its standard deviation.
    pub range_m: (f64, f64),
    /// The point is to the right of the vessel's way.
    pub to_starboard: bool,
}

impl JointTrack {
    /// x, y at a time, metres.
    pub fn position_m(&self, t_s: f64) -> [f64; 2] {
        let [x, y, vx, vy] = self.state;
        let dt = t_s - self.t_ref_s;
        [x + vx * dt, y + vy * dt]
    }

    /// Speed (m/s) and its standard deviation; that of a vessel that does not move is infinite.
    pub fn speed_m_s(&self) -> (f64, f64) {
        let of_origin = self.seen_from([0.0, 0.0]);
        of_origin.map_or((0.0, f64::INFINITY), |(a, c)| (a.speed_m_s, m::sqrt(c[3][3].max(0.0))))
    }

    /// Heading, radians clockwise from North, and its standard deviation (at most π).
    pub fn heading(&self) -> (f64, f64) {
        let of_origin = self.seen_from([0.0, 0.0]);
        of_origin.map_or((0.0, m::PI), |(a, c)| (a.heading, m::sqrt(c[2][2].max(0.0)).min(m::PI)))
    }

    /// Closest approach to a point; `None` for a vessel that does not move. Errors follow from the state's to first
    /// order.
    pub fn closest(&self, point_m: [f64; 2]) -> Option<ClosestApproach> {
        let (a, c) = self.seen_from(point_m)?;
        let sd = |k: usize| m::sqrt(c[k][k].max(0.0));
        Some(ClosestApproach {
            t_s: (self.t_ref_s + a.after_s, sd(0)),
            range_m: (m::abs(a.range_m), sd(1)),
            to_starboard: a.range_m > 0.0,
        })
    }

    /// The motion as seen from a point, and the covariance of (time, range, heading, speed).
    fn seen_from(&self, [px, py]: [f64; 2]) -> Option<(crate::kit::Approach, Square<4>)> {
        let [x, y, vx, vy] = self.state;
        let approach = crate::kit::closest([x - px, y - py, vx, vy])?;
        Some((approach, approach.covariance(&self.covariance)))
    }
}

/// Fits the motion.
///
/// # Errors
/// [`NetworkError::NoBearings`], [`NetworkError::NotFinite`]; [`NetworkError::NotObservable`] where position or
/// velocity is not determined.
pub fn fit(bearings: &[DatedSighting], settings: &JointSettings) -> Result<JointTrack, NetworkError> {
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
    bearings: &[DatedSighting],
    settings: &JointSettings,
    rejected: Option<usize>,
) -> Result<JointTrack, NetworkError> {
    let used = || bearings.iter().filter(move |b| Some(b.array) != rejected);
    let n = used().count().max(1) as f64;
    let t_ref_s = used().map(|b| b.t_s).sum::<f64>() / n;
    let problem = Problem { bearings, settings, t_ref_s, rejected };
    let angles: u32 = used().map(|b| 1 + u32::from(b.sighting.elevation.is_some())).sum();
    let start = [problem.start_of_lines(), problem.start_of_elevations()]
        .into_iter()
        .flatten()
        .map(|s| (problem.normal(&s).cost(), s))
        .filter(|(c, _)| c.is_finite())
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .ok_or(NetworkError::NotObservable)?;
    let moved = |state: &[f64; 4], step: &[f64; 4]| {
        let mut to = *state;
        to.iter_mut().zip(step).for_each(|(x, s)| *x += s);
        to
    };
    let end = minimise(start.1, &[true; 4], STEPS, LEAST_FALL, moved, |state| Some(problem.normal(state)));
    let end = end.ok_or(NetworkError::NotObservable)?;
    let state = end.at;
    let mut covariance =
        spd::inverse(&end.normal.information(&[true; 4])).ok_or(NetworkError::NotObservable)?;
    let (misfit, freedom) = (problem.misfit(&state), angles.saturating_sub(4));
    let growth = (misfit / f64::from(freedom.max(1))).max(1.0);
    for x in covariance.iter_mut().flatten() {
        *x *= growth;
    }
    let motion = JointTrack { t_ref_s, state, covariance, misfit, freedom, rejected };
    let [[xx, xy, ..], [_, yy, ..], ..] = covariance;
    let sd = m::sqrt(spd::largest_eigenvalue(&[[xx, xy], [xy, yy]]));
    let distance = used().map(|b| problem.distance(&b.sighting, b.t_s, &state)).sum::<f64>() / n;
    let finite = state.iter().all(|x| x.is_finite());
    if finite && sd <= locate::LARGEST_RELATIVE_SD * distance && motion.freedom > 0 {
        Ok(motion)
    } else {
        Err(NetworkError::NotObservable)
    }
}

struct Problem<'a> {
    bearings: &'a [DatedSighting],
    settings: &'a JointSettings,
    t_ref_s: f64,
    rejected: Option<usize>,
}

impl Problem<'_> {
    fn used(&self) -> impl Iterator<Item = &DatedSighting> + '_ {
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
    fn emission(&self, b: &DatedSighting, state: &[f64; 4]) -> f64 {
        let c = self.settings.sound_speed_m_s;
        let first = b.t_s - self.distance(&b.sighting, b.t_s, state) / c;
        b.t_s - self.distance(&b.sighting, first, state) / c
    }

    fn misfit(&self, state: &[f64; 4]) -> f64 {
        self.rows(state).map(|(_, r)| HUBER.clipped(r) * HUBER.clipped(r)).sum()
    }

    /// Derivatives and residual of every angle, standardised.
    fn rows(&self, state: &[f64; 4]) -> impl Iterator<Item = ([f64; 4], f64)> {
        self.used().flat_map(move |b| {
            let s = &b.sighting;
            let t = self.emission(b, state);
            let dt = t - self.t_ref_s;
            let place = self.place(t, state);
            let (azimuth, elevation) = bearing(&s.array_m, &place);
            let (ga, gb) = gradients(&s.array_m, &place);
            let row = |[x, y, _]: [f64; 3], residual: f64, sd: f64| {
                ([x, y, x * dt, y * dt].map(|d| d / sd), residual / sd)
            };
            let of_azimuth = row(ga, wrap_pi(s.azimuth - azimuth), s.sd_azimuth);
            [Some(of_azimuth), s.elevation.map(|e| row(gb, e - elevation, s.sd_elevation))]
                .into_iter()
                .flatten()
        })
    }

    /// Normal equations of the robust likelihood.
    fn normal(&self, state: &[f64; 4]) -> Normal<4> {
        let mut normal = Normal::default();
        for (row, r) in self.rows(state) {
            normal.observe_at_cost(&row, r, HUBER.weight(r), 2.0 * HUBER.loss(r));
        }
        normal
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const TWO: [[f64; 3]; 2] = [[0.0, 100.0, -168.0], [0.0, -100.0, -168.0]];
    const SETTINGS: JointSettings = JointSettings { z_m: -5.0, sound_speed_m_s: 1484.0, robust: true };

    /// Exact bearings of a vessel with travel time, at different instants for each array.
    fn bearings(arrays: &[[f64; 3]], elevation: bool) -> Vec<DatedSighting> {
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
                out.push(DatedSighting { t_s: emitted + d.sqrt() / 1484.0, array: i, sighting });
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
        let motion = JointTrack {
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
