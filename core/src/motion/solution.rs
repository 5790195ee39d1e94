//! What a fit says about the vessel: closest point, heading, speed, side, positions, each with its spread.
//!
//! In: a fitted line and the covariance of its parameters. Out: a [`Solution`] by first-order propagation. Range
//! inherits the spread of speed, `σ_r²/r² = var(ln v − ln|q|)`, which is the speed-error term `x0² σ_k²` of [M 20, 22].

use super::model::{Limits, Line, Medium, PARAMETERS};
use super::normal::{Matrix, Normal};
use crate::angle::wrap_tau;
use crate::kit::spd::quadratic;
use crate::math::f64 as m;

/// The range counts as observable while its own relative spread (speed aside) is below this; beyond it the Gaussian
/// spread no longer describes the long tail towards infinity.
const OBSERVABLE_RELATIVE_SD: f64 = 0.5;
/// A heading spread beyond this (radians) is no knowledge: a uniform circle has 1.8.
const OBSERVABLE_HEADING_SD: f64 = 1.2;
/// The bearing has turned if it did so by more than this many standard deviations of the turn (chance of less: 0.3 %).
const TURN_SD: f64 = 3.0;

/// A vessel's motion as estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// The fitted line.
    pub line: Line,
    /// Covariance of its parameters.
    pub covariance: Matrix,
    /// Time of the closest point of approach, s (may lie ahead).
    pub cpa_time_s: f64,
    /// Its range, m (meaningful only with `range_observable`).
    pub cpa_range_m: f64,
    /// Azimuth of the closest point, radians.
    pub cpa_azimuth_rad: f64,
    /// Heading, radians.
    pub heading_rad: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// True if the array lies on the vessel's starboard side.
    pub starboard: bool,
    /// Standard deviation of the time of closest approach, s.
    pub sd_cpa_time_s: f64,
    /// Standard deviation of its range, m, spread of speed included; infinite where not observable.
    pub sd_cpa_range_m: f64,
    /// Standard deviation of its azimuth, radians.
    pub sd_cpa_azimuth_rad: f64,
    /// Standard deviation of heading, radians; infinite where the bearings do not turn.
    pub sd_heading_rad: f64,
    /// Standard deviation of speed, m/s.
    pub sd_speed_m_s: f64,
    /// Time of the first bearing, s.
    pub t0_s: f64,
    /// East and North at `t0_s`, m.
    pub position0_m: [f64; 2],
    /// Variances of both and covariance, m²: `[xx, yy, xy]`.
    pub covariance0_m2: [f64; 3],
    /// Time of the newest bearing, s.
    pub t1_s: f64,
    /// East and North at `t1_s`, m.
    pub position1_m: [f64; 2],
    /// Variances of both and covariance, m²: `[xx, yy, xy]`.
    pub covariance1_m2: [f64; 3],
    /// Whether the bearings say anything about range (given speed).
    pub range_observable: bool,
    /// Bearings used.
    pub n: u32,
    /// Weighted squared residual per degree of freedom: near 1 when the error model and the straight track hold.
    pub consistency: f64,
}

/// Position at `t_s` and its covariance `[xx, yy, xy]`.
pub fn position(line: &Line, covariance: &Matrix, t_s: f64) -> ([f64; 2], [f64; 3]) {
    let (at, d) = line.position(t_s);
    let c = |a: usize, b: usize| quadratic(&d[a], covariance, &d[b]);
    (at, [c(0, 0), c(1, 1), c(0, 1)])
}

/// Information every fit has from its limits alone: a uniform spread over the searched interval.
pub fn floor(limits: &Limits, speed_m_s: f64) -> [f64; PARAMETERS] {
    let uniform = |width: f64| 12.0 / (width * width).max(1e-12);
    let times = limits.times_s.1 - limits.times_s.0 + 2.0 * limits.range_m.1 / speed_m_s;
    [uniform(m::TAU), uniform(times), uniform(m::ln(limits.range_m.1 / limits.range_m.0)), 1e-3, 1e-3]
}

/// Builds the solution of a converged fit over `n` bearings; `None` if its matrix has no inverse.
pub fn solution(
    line: &Line,
    normal: &Normal,
    free: &[bool; PARAMETERS],
    limits: &Limits,
    n: u32,
    measurements: f64,
) -> Option<Solution> {
    let covariance = covariance(line, normal, free, limits)?;
    from_covariance(line, &covariance, limits, n, consistency(normal, free, measurements))
}

/// Covariance of a converged fit's parameters, its limits known; `None` if its matrix has no inverse.
pub fn covariance(
    line: &Line,
    normal: &Normal,
    free: &[bool; PARAMETERS],
    limits: &Limits,
) -> Option<Matrix> {
    normal.covariance(free, &floor(limits, line.speed_m_s()))
}

/// Weighted squared residual of a converged fit per degree of freedom.
pub fn consistency(normal: &Normal, free: &[bool; PARAMETERS], measurements: f64) -> f64 {
    let unknowns = free.iter().filter(|f| **f).count() as f64;
    normal.cost() / (measurements - unknowns).max(1.0)
}

/// Builds the solution from a line and any covariance of its parameters (the sandwich one, for a wrong error model).
pub fn from_covariance(
    line: &Line,
    covariance: &Matrix,
    limits: &Limits,
    n: u32,
    consistency: f64,
) -> Option<Solution> {
    let sd = |k: usize| m::sqrt(covariance[k][k].max(0.0));
    let (position0_m, covariance0_m2) = position(line, covariance, limits.times_s.0);
    let (position1_m, covariance1_m2) = position(line, covariance, limits.times_s.1);
    let by_range = [0.0, 0.0, -1.0, 1.0, 0.0];
    let relative = m::sqrt(quadratic(&by_range, covariance, &by_range).max(0.0));
    let range_m = line.cpa_range_m();
    // Speed's own spread is known and reported; the flag is about what the measurements add.
    let own = if covariance[2][3] == 0.0 { sd(2) } else { relative.min(sd(2)) };
    let limit = line.at_limit(limits);
    let far = limit > 0;
    // At the near limit the vessel may have passed anywhere inside it.
    let sd_range_m = (range_m * relative).max(if limit < 0 { limits.range_m.0 } else { 0.0 });
    // A bearing that stands still fits a vessel coming straight on as well as one going straight away.
    let still = Medium { slowness_s_m: 0.0, height_m: 0.0 };
    let first = line.expected(&still, limits.times_s.0);
    let last = line.expected(&still, limits.times_s.1);
    let mut by_turn = last.d_azimuth;
    for (d, f) in by_turn.iter_mut().zip(&first.d_azimuth) {
        *d -= f;
    }
    let turn = last.azimuth - first.azimuth;
    let turning = turn * turn > TURN_SD * TURN_SD * quadratic(&by_turn, covariance, &by_turn);
    let range_observable = own < OBSERVABLE_RELATIVE_SD && !far && turning;
    let heading_known = turning && sd(0) < OBSERVABLE_HEADING_SD;
    let out = Solution {
        line: *line,
        covariance: *covariance,
        cpa_time_s: line.p[1],
        cpa_range_m: range_m,
        cpa_azimuth_rad: wrap_tau(line.p[0]),
        heading_rad: line.heading_rad(),
        speed_m_s: line.speed_m_s(),
        starboard: line.sense > 0.0,
        sd_cpa_time_s: sd(1),
        sd_cpa_range_m: if range_observable { sd_range_m } else { f64::INFINITY },
        sd_cpa_azimuth_rad: sd(0),
        sd_heading_rad: if heading_known { sd(0) } else { f64::INFINITY },
        sd_speed_m_s: line.speed_m_s() * sd(3),
        t0_s: limits.times_s.0,
        position0_m,
        covariance0_m2,
        t1_s: limits.times_s.1,
        position1_m,
        covariance1_m2,
        range_observable,
        n,
        consistency,
    };
    let finite = position0_m.iter().chain(&position1_m).chain(&covariance0_m2).chain(&covariance1_m2);
    (finite.chain(&[out.cpa_time_s, range_m, consistency]).all(|x| x.is_finite())).then_some(out)
}
