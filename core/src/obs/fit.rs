//! How well a course explains the evidence, and the course that explains it best.
//!
//! Enters: minutes of modes and a first course. Leaves: log score [O 26 with its probabilities of detection 0.9 and
//! 0.6], refined parameters and their covariance. Each minute's azimuth term is `ln(0.1 + 0.9 max_k ratio_k)` over its
//! modes, its range term the same with 0.6 and the mode's weight; a ratio is the mode's Gaussian over the uniform
//! density. The refinement is Gauss-Newton on that, each mode weighted by the chance that it is this vessel's.
//! Assumes: windows of three minutes overlap and the range posterior remembers, so a minute counts a third; the covariance
//! counts it for less where the residuals are larger than stated or alike from minute to minute (see `residuals`).
//! Cost: 700 instructions a minute of evidence and step.

use super::course::{Course, CourseCovariance};
use super::evidence::{AzimuthEvidence, Minute, RangeEvidence};
use super::residuals::{OVERLAPPED, Residuals};
use super::travel::TravelTime;
use crate::angle::wrap_pi;
use crate::kit::{Normal, reweighted, spd};
use crate::math;

/// Probabilities that a present vessel shows in azimuth and in range [O, III D].
const DETECTION: (f64, f64) = (0.9, 0.6);

/// By how much the variance of the fit exceeds that from independent errors as stated: directions, ranges.
type Excess = (f64, f64);

/// Error of direction beyond what the detector knows (propagation, interfering paths), rad.
pub(super) const EXTRA_AZIMUTH: f64 = 0.02;

/// Error of range beyond what the detector knows (table), m.
pub(super) const EXTRA_RANGE_M: f64 = 40.0;

/// Error of radial speed beyond what the detector knows, m/s.
pub(super) const EXTRA_SPEED_M_S: f64 = 0.4;

/// Extent of the uniform alternative: 50 km and 26 m/s.
const UNIFORM: (f64, f64) = (50_000.0, 26.0);

/// Ranges between which a vessel should show in range, m.
const RANGE_SHOWS_M: (f64, f64) = (7_000.0, 40_000.0);

/// A course taken as it is.
const SURE: (f64, f64) = (0.0, 0.0);

/// How a course fares.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Sum of log terms.
    pub log: f64,
    /// Minutes with a direction that is this vessel's.
    pub directions: u16,
    /// Minutes with a range that is this vessel's.
    pub distances: u16,
    /// Minutes with both.
    pub both: u16,
}

/// Standard deviation of the sum of two independent errors.
fn together(a: f64, b: f64) -> f64 {
    math::f64::sqrt(a * a + b * b)
}

/// Ratio of a direction's density at the course's to uniform, the residual, and the spread of the direction; `doubt` is the
/// standard deviation of the course's.
fn direction_ratio(d: &AzimuthEvidence, azimuth: f64, doubt: f64) -> (f64, f64, f64) {
    let sd = together(d.sd, EXTRA_AZIMUTH);
    let all = together(sd, doubt);
    let e = wrap_pi(d.azimuth - azimuth);
    let z = e / all;
    (math::f64::TAU / 2.5066 / all * math::f64::exp(-0.5 * z * z), e, sd)
}

/// Ratio of a range's density at the course's to uniform; `doubts` are the standard deviations of the course's.
fn distance_ratio(d: &RangeEvidence, range_m: f64, speed_m_s: f64, doubts: (f64, f64)) -> f64 {
    let (sr, sv) = spreads(d);
    let (sr, sv) = (together(sr, doubts.0), together(sv, doubts.1));
    let (zr, zv) = ((d.range_m - range_m) / sr, (d.speed_m_s - speed_m_s) / sv);
    let z = zr * zr + zv * zv;
    if z > 60.0 {
        return 0.0;
    }
    d.weight * UNIFORM.0 * UNIFORM.1 / (math::f64::TAU * sr * sv) * math::f64::exp(-0.5 * z)
}

fn spreads(d: &RangeEvidence) -> (f64, f64) {
    (together(d.sd_m, EXTRA_RANGE_M), together(d.sd_speed_m_s, EXTRA_SPEED_M_S))
}

/// Whether a direction is better explained by a vessel at `azimuth` than by none.
pub fn explains_direction(d: &AzimuthEvidence, azimuth: f64) -> bool {
    direction_ratio(d, azimuth, 0.0).0 > 0.3
}

/// Whether a range is better explained by a vessel at that range and radial speed than by none.
pub fn explains_distance(d: &RangeEvidence, range_m: f64, speed_m_s: f64) -> bool {
    distance_ratio(&RangeEvidence { weight: 1.0, ..*d }, range_m, speed_m_s, SURE) > 0.1
}

/// Best direction of a minute for an azimuth: ratio, residual, spread.
fn best_direction(m: &Minute, azimuth: f64, doubt: f64) -> Option<(f64, f64, f64)> {
    m.directions().map(|d| direction_ratio(&d, azimuth, doubt)).max_by(|a, b| a.0.total_cmp(&b.0))
}

/// Best range of a minute: ratio and the mode.
fn best_distance(
    m: &Minute,
    range_m: f64,
    speed_m_s: f64,
    doubts: (f64, f64),
) -> Option<(f64, RangeEvidence)> {
    let ratios = m.distances().map(|d| (distance_ratio(&d, range_m, speed_m_s, doubts), d));
    ratios.max_by(|a, b| a.0.total_cmp(&b.0))
}

/// Log terms of one minute: azimuth and range.
pub fn minute_terms(course: &Course, travel: &TravelTime, step_s: f64, m: &Minute) -> (f64, f64) {
    let s = course.seen(travel, step_s * f64::from(m.number));
    // A minute without any mode says little: the vessel may be masked, the channel dead.
    let azimuth = match best_direction(m, s.azimuth, 0.0) {
        Some((ratio, ..)) => math::f64::ln(1.0 - DETECTION.0 + DETECTION.0 * ratio),
        None => -0.3,
    };
    let shows = s.range_m > RANGE_SHOWS_M.0 && s.range_m < RANGE_SHOWS_M.1;
    let range = match best_distance(m, s.range_m, s.speed_m_s, SURE) {
        Some((ratio, _)) if ratio > 1.0 || shows => math::f64::ln(1.0 - DETECTION.1 + DETECTION.1 * ratio),
        None if shows => -0.3,
        _ => 0.0,
    };
    (azimuth, range)
}

/// Score over minutes.
pub fn score(
    course: &Course,
    travel: &TravelTime,
    step_s: f64,
    minutes: impl Iterator<Item = Minute>,
) -> Score {
    let mut out = Score::default();
    for m in minutes {
        let (a, r) = minute_terms(course, travel, step_s, &m);
        out.log += a + r;
        out.directions += u16::from(a > 0.0);
        out.distances += u16::from(r > 0.0);
        out.both += u16::from(a > 0.0 && r > 0.0);
    }
    out
}

/// Gauss-Newton steps.
const STEPS: usize = 12;

/// Speeds are kept below this, m/s, by a weak prior (mean of merchant vessels 7 m/s, spread so wide it only regularises).
const SPEED_SPREAD_M_S: f64 = 30.0;

/// Refines a course; its covariance too. `None` where the evidence does not determine it.
pub fn refine<I>(
    start: &Course,
    travel: &TravelTime,
    step_s: f64,
    minutes: I,
) -> Option<(Course, CourseCovariance)>
where
    I: Iterator<Item = Minute> + Clone,
{
    let equations = |_, course: &Course| {
        let mut normal = Normal::default();
        let weak = 1.0 / (SPEED_SPREAD_M_S * SPEED_SPREAD_M_S);
        let [_, _, vx, vy] = course.p;
        normal.observe(&[0.0, 0.0, 1.0, 0.0], -vx, weak);
        normal.observe(&[0.0, 0.0, 0.0, 1.0], -vy, weak);
        for m in minutes.clone() {
            observe(&mut normal, course, travel, step_s, &m, (OVERLAPPED, OVERLAPPED));
        }
        Some(normal)
    };
    let advance = |_, course: &mut Course, step: &[f64; 4]| {
        let mut moved = 0.0;
        for ((p, step), unit) in course.p.iter_mut().zip(step).zip([1.0, 1.0, 1e4, 1e4]) {
            *p += step;
            moved += math::f64::abs(*step) * unit;
        }
        moved >= 0.1
    };
    let (course, _) = reweighted(*start, STEPS, equations, advance)?;
    if !course.p.iter().all(|x| x.is_finite()) {
        return None;
    }
    let excess = excess(&course, travel, step_s, minutes.clone());
    let mut normal = Normal::default();
    minutes.for_each(|m| observe(&mut normal, &course, travel, step_s, &m, excess));
    spd::inverse(&normal.information(&[true; 4])).map(|covariance| (course, covariance))
}

/// What the residuals of a course say about its errors: of directions, of ranges.
pub(super) fn excess(
    course: &Course,
    travel: &TravelTime,
    step_s: f64,
    minutes: impl Iterator<Item = Minute>,
) -> Excess {
    let (mut directions, mut distances) = (Residuals::default(), Residuals::default());
    for m in minutes {
        let s = course.seen(travel, step_s * f64::from(m.number));
        if let Some((own, e, sd)) = own_direction(&m, s.azimuth, 0.0) {
            directions.take(e / sd, own);
        }
        if let Some((own, d)) = own_distance(&m, s.range_m, s.speed_m_s, SURE) {
            distances.take((d.range_m - s.range_m) / spreads(&d).0, own);
        }
    }
    (directions.excess(), distances.excess())
}

/// A minute's best direction for an azimuth: the chance that it is this vessel's, residual, spread.
pub(super) fn own_direction(m: &Minute, azimuth: f64, doubt: f64) -> Option<(f64, f64, f64)> {
    let (ratio, e, sd) = best_direction(m, azimuth, doubt)?;
    Some((DETECTION.0 * ratio / (1.0 - DETECTION.0 + DETECTION.0 * ratio), e, sd))
}

/// A minute's best range: the chance that it is this vessel's, and the mode.
pub(super) fn own_distance(
    m: &Minute,
    range_m: f64,
    speed_m_s: f64,
    doubts: (f64, f64),
) -> Option<(f64, RangeEvidence)> {
    let (ratio, d) = best_distance(m, range_m, speed_m_s, doubts)?;
    Some((DETECTION.1 * ratio / (1.0 - DETECTION.1 + DETECTION.1 * ratio), d))
}

/// Adds what a minute's best modes say, each weighted by the chance that it is this vessel's.
fn observe(
    normal: &mut Normal<4>,
    course: &Course,
    travel: &TravelTime,
    step_s: f64,
    m: &Minute,
    excess: Excess,
) {
    let [_, _, vx, vy] = course.p;
    let s = course.seen(travel, step_s * f64::from(m.number));
    let (x, y, r, t) = (s.place.0, s.place.1, s.range_m, s.since_s);
    if let Some((own, e, sd)) = own_direction(m, s.azimuth, 0.0) {
        let (jx, jy) = (y / (r * r), -x / (r * r));
        normal.observe(&[jx, jy, jx * t, jy * t], e, own / (excess.0 * sd * sd));
    }
    if let Some((own, d)) = own_distance(m, r, s.speed_m_s, SURE) {
        let (sr, sv) = spreads(&d);
        let (ux, uy) = (x / r, y / r);
        let w = own / excess.1;
        normal.observe(&[ux, uy, ux * t, uy * t], d.range_m - r, w / (sr * sr));
        // Radial speed u·v; its change with place is (v − u (u·v))/r.
        let (ax, ay) = ((vx - ux * s.speed_m_s) / r, (vy - uy * s.speed_m_s) / r);
        let j = [ax, ay, ux + ax * t, uy + ay * t];
        normal.observe(&j, d.speed_m_s - s.speed_m_s, w / (sv * sv));
    }
}
