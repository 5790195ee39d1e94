//! Straight motion of one vessel from bearings of several arrays over time; no speed has to be assumed.
//!
//! `x(t) = x_r + v_x (t − t_r)`, `y(t) = y_r + v_y (t − t_r)` at a known height, all bearings of all arrays in one
//! Gaussian likelihood. One array's azimuths leave range and speed scaled together [M 5, 6]; a second array, or
//! elevations with the depth known, fix the scale. Each bearing points to where the vessel was when the sound left it.
//! Single wrong bearings pull no more than one of three standard deviations does (Huber's likelihood). Where the whole
//! misfit is beyond its 99.9 % point and one array is the cause, that array is set aside and named. An error that all
//! bearings of an array share (its orientation, its clock) is an unknown of that array with a Gaussian prior; at every
//! state it takes its likeliest value, and what it leaves open is in the covariance.
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
/// Steps to the likeliest shared errors.
const SHARED_STEPS: usize = 5;
/// Square of a step, in variances of what is shared, after which there is no need of another.
const SHARED_SMALL: f64 = 1e-10;
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

/// Standard deviations of what all bearings of one array share; 0: none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SharedError {
    /// Error of all azimuths, radians: the array's orientation.
    pub azimuth: f64,
    /// Error of all times, seconds: the array's clock.
    pub clock_s: f64,
}

impl SharedError {
    fn variances(&self) -> [f64; 2] {
        [self.azimuth * self.azimuth, self.clock_s * self.clock_s]
    }
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
    /// What the bearings of each array share.
    pub shared: [SharedError; MAX_ARRAYS],
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
    let shared = settings.shared.iter().flat_map(SharedError::variances).all(|v| v.is_finite());
    if !settings.z_m.is_finite() || !(settings.sound_speed_m_s > 0.0) || !shared {
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

/// One standardised angle: derivatives by state and by what its array shares, and the residual.
struct Row {
    by_state: [f64; 4],
    by_shared: [f64; 2],
    residual: f64,
}

fn unit<const N: usize>(k: usize) -> [f64; N] {
    let mut out = [0.0; N];
    out[k] = 1.0;
    out
}

/// Normal equations of the state alone, the last two parameters taking their likeliest values: Schur's complement.
fn eliminated(both: &Normal<6>) -> Normal<4> {
    let (h, g) = (both.information(&[true; 6]), both.gradient);
    let mut out = Normal::default();
    out.observe_at_cost(&[0.0; 4], 0.0, 0.0, both.cost());
    let shared = [[h[4][4], h[4][5]], [h[5][4], h[5][5]]];
    let left = spd::inverse(&shared).unwrap_or_default();
    for i in 0..4 {
        let share = spd::times(&left, &[h[i][4], h[i][5]]);
        out.gradient[i] = g[i] - spd::dot(&share, &[g[4], g[5]]);
        for j in i..4 {
            out.upper[i][j] = h[i][j] - spd::dot(&share, &[h[j][4], h[j][5]]);
        }
    }
    out
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

    /// When the sound of a bearing that came at a time left the vessel: two rounds suffice, a vessel is far slower than sound.
    fn emission(&self, s: &Sighting, t_s: f64, state: &[f64; 4]) -> f64 {
        let c = self.settings.sound_speed_m_s;
        let first = t_s - self.distance(s, t_s, state) / c;
        t_s - self.distance(s, first, state) / c
    }

    /// Misfit of all arrays, each with the shared errors that fit it best.
    fn misfit(&self, state: &[f64; 4]) -> f64 {
        let of = |array: usize| {
            let at = self.shared(array, state);
            let square = |r: f64| HUBER.clipped(r) * HUBER.clipped(r);
            let rows = self.rows(array, state, at).map(|row| square(row.residual)).sum::<f64>();
            let prior = self.shared_variances(array).into_iter().zip(at).filter(|(v, _)| *v > 0.0);
            rows + prior.map(|(v, x)| x * x / v).sum::<f64>()
        };
        (0..MAX_ARRAYS).map(of).sum()
    }

    fn shared_variances(&self, array: usize) -> [f64; 2] {
        self.settings.shared.get(array).map_or([0.0; 2], SharedError::variances)
    }

    /// Every angle of an array, standardised, its azimuths turned and its clock late by so much.
    fn rows(&self, array: usize, state: &[f64; 4], [turned, late_s]: [f64; 2]) -> impl Iterator<Item = Row> {
        self.used().filter(move |b| b.array == array).flat_map(move |b| {
            let s = &b.sighting;
            let t = self.emission(s, b.t_s - late_s, state);
            let dt = t - self.t_ref_s;
            let place = self.place(t, state);
            let (azimuth, elevation) = bearing(&s.array_m, &place);
            let (ga, gb) = gradients(&s.array_m, &place);
            let row = |[x, y, _]: [f64; 3], residual: f64, sd: f64, by_turn: f64| Row {
                by_state: [x, y, x * dt, y * dt].map(|d| d / sd),
                // A clock that is late stamps what it hears with a later time.
                by_shared: [by_turn, -(x * state[2] + y * state[3])].map(|d| d / sd),
                residual: residual / sd,
            };
            let of_azimuth = row(ga, wrap_pi(s.azimuth - turned - azimuth), s.sd_azimuth, 1.0);
            [Some(of_azimuth), s.elevation.map(|e| row(gb, e - elevation, s.sd_elevation, 0.0))]
                .into_iter()
                .flatten()
        })
    }

    /// The shared errors of an array that are likeliest for a state.
    fn shared(&self, array: usize, state: &[f64; 4]) -> [f64; 2] {
        let variances = self.shared_variances(array);
        let free = variances.map(|v| v > 0.0);
        let mut at = [0.0; 2];
        if free == [false; 2] {
            return at;
        }
        for _ in 0..SHARED_STEPS {
            let mut normal = Normal::<2>::default();
            for row in self.rows(array, state, at) {
                normal.observe(&row.by_shared, row.residual, HUBER.weight(row.residual));
            }
            for (k, v) in variances.into_iter().enumerate().filter(|(_, v)| *v > 0.0) {
                normal.observe(&unit(k), -at[k], 1.0 / v);
            }
            let Some(step) = normal.step(&free, 0.0) else { break };
            at.iter_mut().zip(step).for_each(|(x, s)| *x += s);
            if step.iter().zip(variances).all(|(s, v)| s * s <= SHARED_SMALL * v) {
                break;
            }
        }
        at
    }

    /// Normal equations of the robust likelihood, shared errors eliminated.
    fn normal(&self, state: &[f64; 4]) -> Normal<4> {
        let mut all = Normal::default();
        for array in 0..MAX_ARRAYS {
            let (at, variances) = (self.shared(array, state), self.shared_variances(array));
            let mut normal = Normal::<6>::default();
            for row in self.rows(array, state, at) {
                let r = row.residual;
                let ([a, b, c, d], [e, f]) = (row.by_state, row.by_shared);
                normal.observe_at_cost(&[a, b, c, d, e, f], r, HUBER.weight(r), 2.0 * HUBER.loss(r));
            }
            for (k, v) in variances.into_iter().enumerate() {
                if v > 0.0 {
                    normal.observe(&unit(4 + k), -at[k], 1.0 / v);
                } else {
                    normal.hold(4 + k);
                }
            }
            all.join(&eliminated(&normal));
        }
        all
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
mod tests;
