//! How well a course explains the evidence, and the course that explains it best.
//!
//! Enters: minutes of modes and a first course. Leaves: log score [O 26 with its probabilities of detection 0.9 and
//! 0.6], refined parameters and their covariance. Each minute's azimuth term is `ln(0.1 + 0.9 max_k ratio_k)` over its
//! modes, its range term the same with 0.6 and the mode's weight; a ratio is the mode's Gaussian over the uniform
//! density. The refinement is Gauss-Newton on that, each mode weighted by the chance that it is this vessel's.
//! Assumes: windows of three minutes overlap and the range posterior remembers, so a minute counts a third; the covariance
//! counts it for less where the residuals are larger than stated or alike from minute to minute (see `residuals`).
//! Cost: 700 instructions a minute of evidence and step.

use super::course::{Course, CourseCovariance, Seen};
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
const EXTRA_AZIMUTH: f64 = 0.02;

/// A window's direction is that of a time known to so much, s: it holds frames of three minutes that show the vessel more or
/// less clearly, and near its closest point a vessel's azimuth turns by degrees a minute. Measured: where an azimuth turns by 0.1° a
/// second and more its error is 1.6 to 4 times the spread the detector knows, as if its time were known to 4 to 5 s; below, the
/// spread holds alone.
const TIMING_S: f64 = 5.0;

/// Error of range beyond what the detector knows (table), m.
pub(super) const EXTRA_RANGE_M: f64 = 40.0;

/// Error of radial speed beyond what the detector knows, m/s.
pub(super) const EXTRA_SPEED_M_S: f64 = 0.4;

/// Extent of the uniform alternative: 50 km and 26 m/s.
const UNIFORM: (f64, f64) = (50_000.0, 26.0);

/// Ranges between which a vessel should show in range over the water of RR03, m.
const RANGE_SHOWS_M: (f64, f64) = (7_000.0, 40_000.0);

/// A course taken as it is.
const SURE: (f64, f64) = (0.0, 0.0);

/// Where a course has its vessel.
#[derive(Clone, Copy, Debug)]
pub struct Towards {
    /// Azimuth, rad.
    pub azimuth: f64,
    /// Its change, rad/s.
    pub turning_rad_s: f64,
    /// Standard deviation of the course's own, rad.
    pub doubt: f64,
}

/// How a course fares.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Sum of log terms.
    pub log: f64,
    /// Of these the terms of range alone.
    pub range_log: f32,
    /// Minutes with a direction that is this vessel's.
    pub directions: u16,
    /// Minutes with a range that is this vessel's.
    pub distances: u16,
    /// Minutes with both.
    pub both: u16,
    /// Minutes with a range whose echoes are nearly of the table's strengths.
    pub sure: u16,
    /// Minutes in which another pair of paths explains the echoes with the table's strengths.
    pub rivals: u16,
    /// Minutes with a range that no vessel beyond the model is read at: it would be in the model by then.
    pub near: u16,
    /// Nearest and farthest of the ranges, m; zero where there is none. (An option in here would make a static that holds no
    /// vessel one that is not zeros.)
    pub span_m: (f32, f32),
}

/// Range below which one twice as far is well inside the model, m: were the vessel there, its echoes would be read there.
const NEAR_M: f32 = 20_000.0;

/// Share of the ranges that have echoes of nearly the table's strengths from which on those are a vessel's strengths.
const SURE_SHARE: f32 = 0.33;

impl Score {
    /// Takes one more minute of a course; what it adds to the log score.
    pub fn take(&mut self, course: &Course, travel: &TravelTime, step_s: f64, m: &Minute) -> f64 {
        let Terms { azimuth, range, distance, rival } = minute_terms(course, travel, step_s, m);
        self.log += azimuth + range;
        self.range_log += range as f32;
        self.directions += u16::from(azimuth > 0.0);
        self.rivals += u16::from(rival);
        self.both += u16::from(azimuth > 0.0 && distance.is_some());
        if let Some(d) = distance {
            self.distances += 1;
            self.sure += u16::from(d.sure);
            let range_m = d.range_m as f32;
            self.near += u16::from(range_m < NEAR_M);
            let (least, most) = if self.distances > 1 { self.span_m } else { (range_m, range_m) };
            self.span_m = (least.min(range_m), most.max(range_m));
        }
        azimuth + range
    }

    /// Whether its echoes have nearly the table's strengths.
    pub fn is_sure(&self) -> bool {
        f32::from(self.sure) >= SURE_SHARE * f32::from(self.distances)
    }
}

/// Standard deviation of the sum of two independent errors; of one alone itself, which is the root of its square to the last bit.
fn together(a: f64, b: f64) -> f64 {
    if b == 0.0 { a } else { math::f64::sqrt(a * a + b * b) }
}

/// Ratio of a direction's density at the course's to uniform, the residual, and the spread of the direction as detected.
fn direction_ratio(d: &AzimuthEvidence, towards: Towards) -> (f64, f64, f64) {
    let sd = together(d.sd, TIMING_S * towards.turning_rad_s);
    let all = together(together(sd, EXTRA_AZIMUTH), towards.doubt);
    let e = wrap_pi(d.azimuth - towards.azimuth);
    let z = e / all;
    // Of most the ratio is so small that nothing is left of it beside the chance that the vessel does not show.
    let ratio =
        if z * z > MOST_SQUARE_AZIMUTH { 0.0 } else { direction_density(all) * math::f64::exp(-0.5 * z * z) };
    (ratio, e, sd)
}

/// Ratio of the density of a direction of such a spread, where it is greatest, to uniform.
fn direction_density(sd: f64) -> f64 {
    math::f64::TAU / 2.5066 / sd
}

/// Ratio to the uniform density from which on a direction's lines are taken for the course's vessel's.
const OWN_RATIO: f64 = 3.0;

/// Squared distance, in spreads, beyond which a range is none of this vessel's, and beyond which a direction is none: e⁻⁵⁰ of a density of
/// 125 times the uniform one at most.
const MOST_SQUARE: f64 = 60.0;
const MOST_SQUARE_AZIMUTH: f64 = 100.0;

/// Ratio of a range's density at the course's to uniform; `doubts` are the standard deviations of the course's.
fn distance_ratio(d: &RangeEvidence, range_m: f64, speed_m_s: f64, doubts: (f64, f64)) -> f64 {
    let (farther, faster) = (d.range_m - range_m, d.speed_m_s - speed_m_s);
    // Most are so far off in one of them that it is told without a root.
    let variance = |sd: f64, extra: f64, doubt: f64| sd * sd + extra * extra + doubt * doubt;
    let most = (MOST_SQUARE + 1.0) * variance(d.sd_m, EXTRA_RANGE_M, doubts.0);
    let most_faster = (MOST_SQUARE + 1.0) * variance(d.sd_speed_m_s, EXTRA_SPEED_M_S, doubts.1);
    if farther * farther > most || faster * faster > most_faster {
        return 0.0;
    }
    let (sr, sv) = spreads(d);
    let (sr, sv) = (together(sr, doubts.0), together(sv, doubts.1));
    let (zr, zv) = (farther / sr, faster / sv);
    let z = zr * zr + zv * zv;
    if z > MOST_SQUARE {
        return 0.0;
    }
    distance_density(d, (sr, sv)) * math::f64::exp(-0.5 * z)
}

/// Ratio of the density of a range with such spreads of it and of its radial speed, where it is greatest, to uniform.
fn distance_density(d: &RangeEvidence, (sr, sv): (f64, f64)) -> f64 {
    d.weight * UNIFORM.0 * UNIFORM.1 / (math::f64::TAU * sr * sv)
}

fn spreads(d: &RangeEvidence) -> (f64, f64) {
    (together(d.sd_m, EXTRA_RANGE_M), together(d.sd_speed_m_s, EXTRA_SPEED_M_S))
}

/// Whether a direction is better explained by a vessel there than by none.
pub fn explains_direction(d: &AzimuthEvidence, towards: Towards) -> bool {
    direction_ratio(d, towards).0 > 0.3
}

/// Whether a range is better explained by a vessel at that range and radial speed than by none.
pub fn explains_distance(d: &RangeEvidence, range_m: f64, speed_m_s: f64) -> bool {
    distance_ratio(&RangeEvidence { weight: 1.0, ..*d }, range_m, speed_m_s, SURE) > 0.1
}

/// Where a course has its vessel, if the minute has a direction to compare with that: an angle is long to find.
fn towards(m: &Minute, s: &Seen) -> Option<Towards> {
    m.directions().next().map(|_| s.towards())
}

/// Best direction of a minute: ratio, residual, spread.
fn best_direction(m: &Minute, towards: Towards) -> Option<(f64, f64, f64)> {
    m.directions().map(|d| direction_ratio(&d, towards)).max_by(|a, b| a.0.total_cmp(&b.0))
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

/// Log terms of one minute.
struct Terms {
    /// Of its direction.
    azimuth: f64,
    /// Of its range.
    range: f64,
    /// Its range, where that is this vessel's.
    distance: Option<RangeEvidence>,
    /// Whether another pair of paths explains the echoes with the table's strengths.
    rival: bool,
}

/// Range from which on a vessel's own echoes do not look like those of another pair of paths of one farther away, m over the water of RR03:
/// nearer, the pair 13 is so strong that read as 35 it has the strength of that.
const RIVALS_M: f64 = 17_000.0;

/// A vessel read as another pair of paths seems nearer by about this: 35 as 13, 57 as 35. How far from that it may be, and
/// by how much the speeds may differ, m/s.
const RIVALS: [f64; 2] = [2.0, 1.5];
const RIVAL_WITHIN: (f64, f64) = (0.06, 1.0);

/// Whether a vessel at that range would be a mode's, read as another pair of paths.
fn is_rival(d: &RangeEvidence, s: &Seen, depth_ratio: f64) -> bool {
    let like = |factor: f64| {
        math::f64::abs(d.range_m / factor - s.range_m) < RIVAL_WITHIN.0 * s.range_m
            && math::f64::abs(d.speed_m_s / factor - s.speed_m_s) < RIVAL_WITHIN.1
    };
    d.sure && d.weight > 0.5 && s.range_m > RIVALS_M * depth_ratio && RIVALS.into_iter().any(like)
}

/// Range from which on a vessel has no place in the model, m.
const BEYOND_M: f64 = 47_000.0;

/// How many times nearer another pair of paths reads its echoes (79 as 35, 57 as 35; delays do not go quite as one over range).
pub const READ: [f64; 2] = [2.01, 1.51];

/// By what share of its range such a reading may be off, and its radial speed, m/s. This lasts: it makes no minute less likely.
const READ_WITHIN: (f64, f64) = (0.006, 0.3);

/// Ratio of the density of a minute's best range, as one of a vessel beyond the model that is louder than the table's, to uniform; 0 of one within.
fn reading_ratio(m: &Minute, s: &Seen) -> f64 {
    if s.range_m < BEYOND_M {
        return 0.0;
    }
    let ratio = |d: &RangeEvidence, times: f64| {
        let (range_m, speed_m_s) = (s.range_m / times, s.speed_m_s / times);
        let (sr, sv) = spreads(d);
        let zr = (d.range_m - range_m) / together(sr, READ_WITHIN.0 * range_m);
        let zv = (d.speed_m_s - speed_m_s) / together(sv, READ_WITHIN.1);
        let z = zr * zr + zv * zv;
        if z > MOST_SQUARE { 0.0 } else { distance_density(d, (sr, sv)) * math::f64::exp(-0.5 * z) }
    };
    let all = m.distances().flat_map(|d| READ.map(|times| ratio(&d, times)));
    all.fold(0.0, f64::max)
}

/// Log terms of one minute. Wanted in several places, and large.
#[inline(never)]
fn minute_terms(course: &Course, travel: &TravelTime, step_s: f64, m: &Minute) -> Terms {
    let s = course.seen(travel, step_s * f64::from(m.number));
    // A minute without any mode says little: the vessel may be masked, the channel dead.
    let azimuth = match towards(m, &s).and_then(|towards| best_direction(m, towards)) {
        Some((ratio, ..)) => math::f64::ln(1.0 - DETECTION.0 + DETECTION.0 * ratio),
        None => -0.3,
    };
    let depth_ratio = travel.depth_ratio();
    // In deeper water no vessel is heard farther.
    let (near_m, far_m) = (RANGE_SHOWS_M.0 * depth_ratio, RANGE_SHOWS_M.1 * depth_ratio.min(1.0));
    let shows = s.range_m > near_m && s.range_m < far_m;
    let (range, distance) = match best_distance(m, s.range_m, s.speed_m_s, SURE) {
        Some((ratio, d)) if ratio > 1.0 || shows => {
            (math::f64::ln(1.0 - DETECTION.1 + DETECTION.1 * ratio), (ratio > 1.0).then_some(d))
        }
        None if shows => (-0.3, None),
        _ => {
            let ratio = reading_ratio(m, &s);
            let log = if ratio > 1.0 { math::f64::ln(1.0 - DETECTION.1 + DETECTION.1 * ratio) } else { 0.0 };
            (log, None)
        }
    };
    Terms { azimuth, range, distance, rival: m.distances().any(|d| is_rival(&d, &s, depth_ratio)) }
}

/// The greatest that a minute's log terms can be, whatever the course.
pub fn most(m: &Minute) -> f64 {
    let direction = m.directions().map(|d| direction_density(together(d.sd, EXTRA_AZIMUTH)));
    let distance = m.distances().map(|d| distance_density(&d, spreads(&d)));
    let term = |best: f64, detection: f64| math::f64::ln(1.0 - detection + detection * best).max(0.0);
    term(direction.fold(0.0, f64::max), DETECTION.0) + term(distance.fold(0.0, f64::max), DETECTION.1)
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
        out.take(course, travel, step_s, &m);
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
fn excess(
    course: &Course,
    travel: &TravelTime,
    step_s: f64,
    minutes: impl Iterator<Item = Minute>,
) -> Excess {
    let (mut directions, mut distances) = (Residuals::default(), Residuals::default());
    for m in minutes {
        let s = course.seen(travel, step_s * f64::from(m.number));
        if let Some((own, e, sd)) = towards(&m, &s).and_then(|towards| own_direction(&m, towards)) {
            directions.take(e / together(sd, EXTRA_AZIMUTH), own);
        }
        if let Some((own, d)) = own_distance(&m, s.range_m, s.speed_m_s, SURE) {
            distances.take((d.range_m - s.range_m) / spreads(&d).0, own);
        }
    }
    (directions.excess(), distances.excess())
}

/// By how much the lines of a minute's best direction moved, where that is more likely the course's than none's, which has its vessel at `s`.
pub(super) fn own_move(m: &Minute, s: &Seen) -> Option<f64> {
    let towards = towards(m, s)?;
    let ratios = m.directions().map(|d| (direction_ratio(&d, towards).0, d));
    let (ratio, best) = ratios.max_by(|a, b| a.0.total_cmp(&b.0))?;
    if ratio > OWN_RATIO { best.moved } else { None }
}

/// A minute's best direction: the chance that it is this vessel's, residual, spread.
pub(super) fn own_direction(m: &Minute, towards: Towards) -> Option<(f64, f64, f64)> {
    let (ratio, e, sd) = best_direction(m, towards)?;
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
    let s = course.seen(travel, step_s * f64::from(m.number));
    for (j, e, weight) in rows(course, &s, m, excess).iter().flatten() {
        normal.observe(j, *e, *weight);
    }
}

/// What a minute's best direction, range and radial speed say: change with the course, residual, weight.
type Row = ([f64; 4], f64, f64);

/// These of a minute in which the course is `s`.
fn rows(course: &Course, s: &Seen, m: &Minute, excess: Excess) -> [Option<Row>; 3] {
    let [_, _, vx, vy] = course.p;
    let (x, y, r, t) = (s.place.0, s.place.1, s.range_m, s.since_s);
    let direction = towards(m, s).and_then(|towards| own_direction(m, towards)).map(|(own, e, sd)| {
        let (jx, jy) = (y / (r * r), -x / (r * r));
        let sd = together(sd, EXTRA_AZIMUTH);
        ([jx, jy, jx * t, jy * t], e, own / (excess.0 * sd * sd))
    });
    let Some((own, d)) = own_distance(m, r, s.speed_m_s, SURE) else { return [direction, None, None] };
    let (sr, sv) = spreads(&d);
    let (ux, uy) = (x / r, y / r);
    let w = own / excess.1;
    let range = ([ux, uy, ux * t, uy * t], d.range_m - r, w / (sr * sr));
    // Radial speed u·v; its change with place is (v − u (u·v))/r.
    let (ax, ay) = ((vx - ux * s.speed_m_s) / r, (vy - uy * s.speed_m_s) / r);
    let speed = ([ax, ay, ux + ax * t, uy + ay * t], d.speed_m_s - s.speed_m_s, w / (sv * sv));
    [direction, Some(range), Some(speed)]
}
