//! The paper's own estimator: closed form over the unit circle, grids over clock shift and η [L 9-11, 18, 19].
//!
//! `A = mean(ρ_i (x_i ξ_i − y_i τ_i))`, `B = mean(ρ_i (y_i ξ_i + x_i τ_i))`, `u = A/C`, `v = B/C`, `C = √(A² + B²)`,
//! least error `δ² = 2(R − C)`, `R = mean(ρ_i²)`, with `τ_i = G_i √(1 − ξ_i²)`, G = +1 for a vessel to the right of the
//! axis. The sides depend on the answer: from each of sixteen axes they are set, the form solved, and set again until
//! they stay; the least error wins. `|ξ/η| > 1` is not admissible: such a bearing is left out, and η with it if that
//! happens to more than a tenth. The robust fit of [`super::line`] is the better estimator (this one weights by range
//! and bends at |ξ| = 1); it stands here as the published method and as a check.

use super::line::{LEAST_BEARINGS, LineBearing, LineSettings, check, computed_error};
use super::{BLOCKS, OrientError, block_of, jackknife};
use crate::angle::{wrap_pi, wrap_tau};
use crate::math::f64 as m;
use crate::network::known_track::{TrackPoint, position_at};

/// Axes tried for the assignment of sides: every 22.5°.
const AXES: usize = 16;
/// Rounds of side assignment from each.
const ROUNDS: u32 = 6;

/// Result of the closed form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosedForm {
    /// Azimuth of the direction of rising sensor numbers, radians in [0, 2π).
    pub orientation: f64,
    /// Time shift, seconds.
    pub time_shift_s: f64,
    /// η.
    pub eta: f64,
    /// Mean angle between true and computed positions Δ [L 13], radians, which the grids minimise.
    pub mean_error: f64,
    /// Least mean squared distance δ² [L 11], square metres.
    pub error_m2: f64,
    /// Bearings used.
    pub n: usize,
}

/// Searches shift in steps of `step_s` and η in steps of `step_eta` over the limits of the settings.
///
/// # Errors
/// [`OrientError::TooFew`], [`OrientError::NotFinite`].
pub fn search(
    bearings: &[LineBearing],
    track: &[TrackPoint],
    settings: &LineSettings,
    step_s: f64,
    step_eta: f64,
) -> Result<ClosedForm, OrientError> {
    check(bearings, settings)?;
    if !(step_s > 0.0 && step_eta > 0.0) {
        return Err(OrientError::NotFinite);
    }
    grids(bearings, track, settings, (step_s, step_eta), None).ok_or(OrientError::TooFew)
}

/// Standard deviation of the orientation that [`search`] found, radians: a jackknife over blocks in time. The grids are
/// searched again about the answer, two shifts and twenty values of η either way. `None` where leaving a block out leaves
/// too few bearings.
pub fn spread(
    bearings: &[LineBearing],
    track: &[TrackPoint],
    settings: &LineSettings,
    step_s: f64,
    step_eta: f64,
    found: &ClosedForm,
) -> Option<f64> {
    let about = |x: f64, reach: f64, (lo, hi): (f64, f64)| ((x - reach).max(lo), (x + reach).min(hi));
    let near = LineSettings {
        shift_s: about(found.time_shift_s, 2.0 * step_s, settings.shift_s),
        eta: about(found.eta, 20.0 * step_eta, settings.eta),
        ..*settings
    };
    let [sd] = jackknife(BLOCKS, |block| {
        let part = grids(bearings, track, &near, (step_s, step_eta), Some(block))?;
        Some([wrap_pi(part.orientation - found.orientation)])
    })?;
    Some(sd)
}

/// The best of the grids, one block of bearings left out or none.
fn grids(
    bearings: &[LineBearing],
    track: &[TrackPoint],
    settings: &LineSettings,
    (step_s, step_eta): (f64, f64),
    skip: Option<usize>,
) -> Option<ClosedForm> {
    let (s0, s1) = settings.shift_s;
    let (e0, e1) = settings.eta;
    let steps = |lo: f64, hi: f64, step: f64| m::floor((hi - lo) / step + 1e-9).min(100_000.0) as u32;
    let mut best: Option<ClosedForm> = None;
    for i in 0..=steps(s0, s1, step_s) {
        for j in 0..=steps(e0, e1, step_eta) {
            let shift_s = s0 + step_s * f64::from(i);
            let eta = e0 + step_eta * f64::from(j);
            let Some(found) = without(skip, bearings, track, settings.gap_s, shift_s, eta) else { continue };
            if best.is_none_or(|b| found.mean_error < b.mean_error) {
                best = Some(found);
            }
        }
    }
    best
}

/// An axis tried: its azimuth, sine and cosine, the form's sums A and B, and δ² with the sides it sets.
#[derive(Clone, Copy, Default)]
struct Axis {
    azimuth: f64,
    u: f64,
    v: f64,
    sum_a: f64,
    sum_b: f64,
    error_m2: f64,
    settled: bool,
}

impl Axis {
    /// A new azimuth, sums cleared.
    fn turn_to(&mut self, azimuth: f64) {
        let (u, v) = m::sin_cos(azimuth);
        *self = Self { azimuth, u, v, sum_a: 0.0, sum_b: 0.0, ..*self };
    }
}

/// The closed form at one shift and η; `None` where too few bearings are admissible.
pub fn solve(
    bearings: &[LineBearing],
    track: &[TrackPoint],
    gap_s: f64,
    shift_s: f64,
    eta: f64,
) -> Option<ClosedForm> {
    without(None, bearings, track, gap_s, shift_s, eta)
}

/// As [`solve`], one block of bearings left out or none.
fn without(
    skip: Option<usize>,
    bearings: &[LineBearing],
    track: &[TrackPoint],
    gap_s: f64,
    shift_s: f64,
    eta: f64,
) -> Option<ClosedForm> {
    let on_track = || {
        bearings.iter().enumerate().filter_map(move |(i, b)| {
            if Some(block_of(i, bearings.len())) == skip {
                return None;
            }
            let [x, y, _] = position_at(track, b.t_s - shift_s, gap_s)?;
            Some((x, y, b.sine / eta))
        })
    };
    let admissible = || on_track().filter(|(_, _, xi)| m::abs(*xi) <= 1.0);
    let n = admissible().count();
    if n < LEAST_BEARINGS || 10 * n < 9 * on_track().count() {
        return None;
    }
    // All axes go round together, so that each bearing's part in the form is worked out once a round.
    let mut axes = [Axis::default(); AXES];
    for (k, axis) in axes.iter_mut().enumerate() {
        axis.turn_to(m::TAU * k as f64 / AXES as f64);
    }
    for _ in 0..ROUNDS {
        let mut sum_r = 0.0;
        for (x, y, xi) in admissible() {
            let rho = m::sqrt(x * x + y * y);
            let tau = m::sqrt((1.0 - xi * xi).max(0.0));
            sum_r += rho * rho;
            for axis in axes.iter_mut().filter(|a| !a.settled) {
                let tau = if x * axis.v - y * axis.u >= 0.0 { tau } else { -tau };
                axis.sum_a += rho * (x * xi - y * tau);
                axis.sum_b += rho * (y * xi + x * tau);
            }
        }
        for axis in axes.iter_mut().filter(|a| !a.settled) {
            let c = m::sqrt(axis.sum_a * axis.sum_a + axis.sum_b * axis.sum_b);
            let next = m::atan2(axis.sum_a, axis.sum_b);
            axis.error_m2 = 2.0 * (sum_r - c) / n as f64;
            axis.settled = next == axis.azimuth;
            axis.turn_to(next);
        }
        if axes.iter().all(|a| a.settled) {
            break;
        }
    }
    let best = axes.iter().min_by(|a, b| a.error_m2.total_cmp(&b.error_m2));
    let (error_m2, orientation) = best.map(|a| (a.error_m2, a.azimuth))?;
    let sum: f64 = admissible().map(|(x, y, xi)| computed_error(m::atan2(x, y), xi, orientation)).sum();
    Some(ClosedForm {
        orientation: wrap_tau(orientation),
        time_shift_s: shift_s,
        eta,
        mean_error: sum / n as f64,
        error_m2,
        n,
    })
}

#[cfg(test)]
mod tests {
    use super::super::line::orient;
    use super::super::line::tests::{SETTINGS, bearings, track};
    use super::*;
    use crate::angle::RAD_PER_DEG;

    #[test]
    fn the_papers_search_finds_shift_and_eta() {
        let settings = LineSettings { shift_s: (0.0, 6.0), ..SETTINGS };
        let found = search(&bearings(0.0), &track(), &settings, 1.0, 0.001).unwrap();
        assert_eq!(found.time_shift_s, 2.0);
        assert!((found.eta - 0.976).abs() < 1e-9, "{found:?}");
        assert!(wrap_pi(found.orientation + 35.1 * RAD_PER_DEG).abs() < 1e-6);
        assert!(found.error_m2 < 1e-6);
    }

    #[test]
    fn the_stated_spread_is_this_estimator_s_own() {
        let settings = LineSettings { shift_s: (0.0, 4.0), ..SETTINGS };
        // Wrong bearings, which the robust fit leaves out and this one takes in.
        let mut b = bearings(0.004);
        for x in b.iter_mut().skip(3).step_by(11) {
            x.sine = 0.9 - x.sine;
        }
        let found = search(&b, &track(), &settings, 1.0, 0.001).unwrap();
        let sd = spread(&b, &track(), &settings, 1.0, 0.001, &found).unwrap();
        let error = wrap_pi(found.orientation + 35.1 * RAD_PER_DEG).abs();
        let robust = orient(&b, &track(), &settings).unwrap().sd;
        assert!(error < 3.0 * sd && sd > 3.0 * robust, "{error} {sd} {robust}");
    }

    #[test]
    fn impossible_sines_are_left_out() {
        let all_beyond: std::vec::Vec<_> =
            bearings(0.0).iter().map(|b| LineBearing { sine: 1.2, ..*b }).collect();
        assert!(solve(&all_beyond, &track(), 60.0, 2.0, 1.0).is_none());
    }
}
