//! Straight motion of one vessel from bearings of several arrays over time; no speed has to be assumed.
//!
//! `x(t) = x_r + v_x (t − t_r)`, `y(t) = y_r + v_y (t − t_r)` at a known height, all bearings of all arrays in one
//! Gaussian likelihood. One array's azimuths leave range and speed scaled together [M 5, 6]; a second array, or
//! elevations with the depth known, fix the scale. Each bearing points to where the vessel was when the sound left it.
//! Single wrong bearings pull no more than one of three standard deviations does (Huber's likelihood). An error that all
//! bearings of an array share (its orientation, its clock) is an unknown of that array with a Gaussian prior; at every
//! state it takes its likeliest value, and what it leaves open is in the covariance.
//!
//! Whether the arrays contradict each other is told by the deviations that were stated ([`Scatter::Told`]: where the whole
//! misfit is beyond its 99.9 % point and one array is the cause, that array is set aside and named) or by those that the
//! bearings show ([`Scatter::Measured`]: `scatter`, `blame`). What is left of a contradiction makes the covariance grow.
//!
//! - `problem`: the likelihood, its maximum (Levenberg-Marquardt over four unknowns from the linear least-squares solution
//!   of the bearing lines `(x − x_n) cos α = (y − y_n) sin α`, or of the positions the elevations give), its information;
//! - `scatter`: each array's own course, and the errors about it;
//! - `bend`, `runs`: whether these are errors, or the way is no straight one;
//! - `blame`: whose orientation or clock is wrong, or which array is to be set aside.
//!
//! O(1) memory beside the caller's bearings.

mod bend;
mod blame;
mod problem;
mod runs;
mod scatter;

use super::model::Sighting;
use super::{MAX_ARRAYS, NetworkError, locate};
use crate::kit::Huber;
use crate::kit::spd::{self, Square};
use crate::math::f64 as m;
use problem::Problem;
use scatter::Courses;

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

/// By which errors arrays contradict each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scatter {
    /// Those stated with the bearings.
    #[default]
    Told,
    /// Those that the bearings of each array show about a course of its own; the bearings are in order of time. What is
    /// stated of the motion rests on the larger of both.
    Measured,
}

/// What the bearings of one array are found to share, each with its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Offset {
    /// By how much all azimuths are too large, radians.
    pub azimuth: (f64, f64),
    /// How late the clock is against that of [`JointTrack::clock_of`], seconds.
    pub clock_s: (f64, f64),
}

/// What is wrong by more than was assumed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wrong {
    /// The array whose orientation is.
    pub orientation: Option<usize>,
    /// The array whose clock is; the second of two, either of which it may be.
    pub clock: Option<usize>,
}

impl Wrong {
    /// How many errors.
    fn count(&self) -> u32 {
        u32::from(self.orientation.is_some()) + u32::from(self.clock.is_some())
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
    /// By which errors they contradict each other.
    pub scatter: Scatter,
    /// What the bearings of each array share.
    pub shared: [SharedError; MAX_ARRAYS],
    /// How many successive bearings of each array are told to share one error, which their deviations count; 1: none; infinite:
    /// errors that last for the whole record, which nothing tells from a bend.
    pub alike: [f64; MAX_ARRAYS],
}

/// A straight track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointTrack {
    /// Reference time, in the middle of the bearings, seconds.
    pub t_ref_s: f64,
    /// x, y (metres) at the reference time, and velocity East, North (m/s).
    pub state: [f64; 4],
    /// Covariance of the state, grown.
    pub covariance: Square<4>,
    /// Factor by which the covariance has grown, 1 or more: misfit over freedom where the bearings scatter more than they
    /// claim, and what is left of a contradiction between arrays.
    pub growth: f64,
    /// Sum of squared standardised residuals, those beyond three counted as three.
    pub misfit: f64,
    /// Angles minus four.
    pub freedom: u32,
    /// The array that was set aside.
    pub rejected: Option<usize>,
    /// What of one array is wrong by more than was assumed, where that explains a contradiction and nothing else does; its
    /// value is in `offsets`.
    pub wrong: Wrong,
    /// Whether the arrays agree, those set aside and what is `wrong` apart, and the way is straight.
    pub consistent: bool,
    /// What the bearings are off is a bend that all arrays show, beyond what is stated of a straight course, or goes in runs that no noise
    /// makes ([`Scatter::Measured`]): the vessel turns or changes its speed, or there are two. The covariance has grown by a bend;
    /// by runs it does not hold.
    pub bent: bool,
    /// The array against whose clock the others' are told: the first that was heard whose clock is not `wrong`.
    pub clock_of: usize,
    /// What the bearings of each array share, as far as they and what was assumed tell it.
    pub offsets: [Offset; MAX_ARRAYS],
    /// Measured over stated deviation of each array's azimuths and elevations, successive errors counted for what they have
    /// in common; 1 where it was not measured.
    pub scatter: [[f64; 2]; MAX_ARRAYS],
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
/// velocity is not determined, [`NetworkError::Contradictory`] where it is not because the arrays contradict each other.
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
    let used = bearings.iter().fold(0, |used, b| used | 1 << b.array);
    let told = Problem::new(bearings, settings, used);
    match settings.scatter {
        Scatter::Told => by_told(&told, settings.robust),
        Scatter::Measured => by_measured(&told, settings.robust),
    }
}

/// What no unbiased estimator of the state beats: its covariance at a true state, of bearings whose angles are those of the
/// truth. What arrays share counts as in [`fit`]. `None` where the state is not determined.
pub fn bound(
    bearings: &[DatedSighting],
    settings: &JointSettings,
    t_ref_s: f64,
    state: &[f64; 4],
) -> Option<Square<4>> {
    let used = bearings.iter().filter(|b| b.array < MAX_ARRAYS).fold(0, |used, b| used | 1 << b.array);
    let problem = Problem { t_ref_s, ..Problem::new(bearings, settings, used) };
    problem.covariance(state)
}

/// The fit where stated deviations decide.
fn by_told(told: &Problem<'_>, robust: bool) -> Result<JointTrack, NetworkError> {
    let agrees = |motion: &JointTrack| motion.misfit <= locate::misfit_limit(motion.freedom);
    let of = |problem: &Problem<'_>| {
        let state = problem.minimum().ok_or(NetworkError::NotObservable)?;
        let least = problem.covariance(&state).ok_or(NetworkError::NotObservable)?;
        let motion = stated(problem, &state, least, 1.0, Wrong::default())?;
        Ok(JointTrack { consistent: agrees(&motion), ..motion })
    };
    let all = of(told);
    let doubtful = all.is_ok_and(|motion| !motion.consistent);
    if !(robust && doubtful && told.arrays().count() >= 3) {
        return all;
    }
    // The others agree without the culprit, and without it alone.
    let agreeing = |k: usize| {
        let motion = of(&told.of_arrays(told.used & !(1 << k))).ok()?;
        motion.consistent.then_some(JointTrack { rejected: Some(k), ..motion })
    };
    let mut found = told.arrays().filter_map(agreeing);
    match (found.next(), found.next()) {
        (Some(only), None) => Ok(only),
        _ => all,
    }
}

/// The fit where measured deviations decide.
fn by_measured(told: &Problem<'_>, robust: bool) -> Result<JointTrack, NetworkError> {
    let start = told.minimum().ok_or(NetworkError::NotObservable)?;
    let courses = Courses::near(told, &start);
    let measured = Problem { scale: courses.scale, ..*told };
    let verdict = blame::judge(measured, &courses, &start, robust).ok_or(NetworkError::NotObservable)?;
    // What is measured says where the vessel is; how well that is known rests on the larger deviations.
    let scale = courses.scale.map(|of| of.map(|x| x.max(1.0)));
    let (likeliest, state) = (verdict.problem, verdict.state);
    let larger = Problem { scale, ..likeliest };
    let untold = if verdict.consistent { NetworkError::NotObservable } else { NetworkError::Contradictory };
    let least = larger.covariance(&state).ok_or(untold)?;
    let averaged = larger.averaged(&state, &least);
    let motion = stated(&larger, &state, averaged, verdict.growth, verdict.wrong).map_err(|_| untold)?;
    let mut offsets = motion.offsets;
    let [_, reference_s] = likeliest.likeliest(motion.clock_of, &state);
    for array in likeliest.arrays() {
        let [turned, late_s] = likeliest.likeliest(array, &state);
        offsets[array].azimuth.0 = turned;
        offsets[array].clock_s.0 = late_s - reference_s;
    }
    let beyond = courses.bend.and_then(|bend| bend.beyond(&motion.covariance));
    let bent = courses.bent || beyond.is_some();
    let grown = beyond.unwrap_or(1.0);
    for offset in &mut offsets {
        offset.azimuth.1 *= m::sqrt(grown);
        offset.clock_s.1 *= m::sqrt(grown);
    }
    Ok(JointTrack {
        covariance: motion.covariance.map(|row| row.map(|x| x * grown)),
        growth: motion.growth * grown,
        offsets,
        rejected: verdict.rejected,
        consistent: verdict.consistent && !bent,
        bent,
        scatter: courses.scale,
        ..motion
    })
}

/// The track of a state with its covariance; `growth`: what a contradiction makes of that.
fn stated(
    problem: &Problem<'_>,
    state: &[f64; 4],
    least: Square<4>,
    growth: f64,
    wrong: Wrong,
) -> Result<JointTrack, NetworkError> {
    let state = *state;
    let (misfit, freedom) = (problem.misfit(&state), problem.angles().saturating_sub(4));
    let growth = growth.max(1.0) * (misfit / f64::from(freedom.max(1))).max(1.0);
    let covariance = least.map(|row| row.map(|x| x * growth));
    let mut arrays = problem.arrays();
    let first = arrays.clone().next().unwrap_or(0);
    let clock_of = arrays.find(|k| wrong.clock != Some(*k)).unwrap_or(first);
    let offsets = problem.offsets(&state, &covariance, growth, clock_of);
    let [[xx, xy, ..], [_, yy, ..], ..] = covariance;
    let sd = m::sqrt(spd::largest_eigenvalue(&[[xx, xy], [xy, yy]]));
    let finite = state.iter().all(|x| x.is_finite());
    if !(finite && sd <= locate::LARGEST_RELATIVE_SD * problem.mean_distance(&state) && freedom > 0) {
        return Err(NetworkError::NotObservable);
    }
    Ok(JointTrack {
        t_ref_s: problem.t_ref_s,
        state,
        covariance,
        growth,
        misfit,
        freedom,
        rejected: None,
        wrong,
        consistent: true,
        bent: false,
        clock_of,
        offsets,
        scatter: [[1.0; 2]; MAX_ARRAYS],
    })
}

#[cfg(test)]
mod tests;
