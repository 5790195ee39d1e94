//! The paper's own estimator: closed form over the unit circle, grids over clock shift and η [L 9-11, 18, 19].
//!
//! `A = mean(ρ_i (x_i ξ_i − y_i τ_i))`, `B = mean(ρ_i (y_i ξ_i + x_i τ_i))`, `u = A/C`, `v = B/C`, `C = √(A² + B²)`,
//! least error `δ² = 2(R − C)`, `R = mean(ρ_i²)`, with `τ_i = G_i √(1 − ξ_i²)`, G = +1 for a vessel to the right of the
//! axis. The sides depend on the answer: from each of sixteen axes they are set, the form solved, and set again until
//! they stay; the least error wins. `|ξ/η| > 1` is not admissible: such a bearing is left out, and η with it if that
//! happens to more than a tenth. The robust fit of [`super::line`] is the better estimator (this one weights by range
//! and bends at |ξ| = 1); it stands here as the published method and as a check.

use super::OrientError;
use super::line::{LEAST_BEARINGS, LineBearing, LineSettings, check, computed_error};
use crate::angle::wrap_tau;
use crate::math::f64 as m;
use crate::network::known_track::{TrackPoint, position_at};

/// Axes tried for the assignment of sides: every 22.5°.
const AXES: u32 = 16;
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
    let (s0, s1) = settings.shift_s;
    let (e0, e1) = settings.eta;
    let steps = |lo: f64, hi: f64, step: f64| m::floor((hi - lo) / step + 1e-9).min(100_000.0) as u32;
    let mut best: Option<ClosedForm> = None;
    for i in 0..=steps(s0, s1, step_s) {
        for j in 0..=steps(e0, e1, step_eta) {
            let shift_s = s0 + step_s * f64::from(i);
            let eta = e0 + step_eta * f64::from(j);
            let Some(found) = solve(bearings, track, settings.gap_s, shift_s, eta) else { continue };
            if best.is_none_or(|b| found.mean_error < b.mean_error) {
                best = Some(found);
            }
        }
    }
    best.ok_or(OrientError::TooFew)
}

/// The closed form at one shift and η; `None` where too few bearings are admissible.
pub fn solve(
    bearings: &[LineBearing],
    track: &[TrackPoint],
    gap_s: f64,
    shift_s: f64,
    eta: f64,
) -> Option<ClosedForm> {
    let on_track = || {
        bearings.iter().filter_map(move |b| {
            let [x, y, _] = position_at(track, b.t_s - shift_s, gap_s)?;
            Some((x, y, b.sine / eta))
        })
    };
    let admissible = || on_track().filter(|(_, _, xi)| m::abs(*xi) <= 1.0);
    let n = admissible().count();
    if n < LEAST_BEARINGS || 10 * n < 9 * on_track().count() {
        return None;
    }
    let mut best: Option<(f64, f64)> = None;
    for axis in 0..AXES {
        let mut a = m::TAU * f64::from(axis) / f64::from(AXES);
        let mut error_m2 = f64::INFINITY;
        for _ in 0..ROUNDS {
            let (u, v) = m::sin_cos(a);
            let (mut sum_a, mut sum_b, mut sum_r) = (0.0, 0.0, 0.0);
            for (x, y, xi) in admissible() {
                let rho = m::sqrt(x * x + y * y);
                let side = if x * v - y * u >= 0.0 { 1.0 } else { -1.0 };
                let tau = side * m::sqrt((1.0 - xi * xi).max(0.0));
                sum_a += rho * (x * xi - y * tau);
                sum_b += rho * (y * xi + x * tau);
                sum_r += rho * rho;
            }
            let c = m::sqrt(sum_a * sum_a + sum_b * sum_b);
            let next = m::atan2(sum_a, sum_b);
            let settled = next == a;
            a = next;
            error_m2 = 2.0 * (sum_r - c) / n as f64;
            if settled {
                break;
            }
        }
        if best.is_none_or(|(e, _)| error_m2 < e) {
            best = Some((error_m2, a));
        }
    }
    let (error_m2, orientation) = best?;
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
    use super::super::line::tests::{SETTINGS, bearings, track};
    use super::*;
    use crate::angle::{RAD_PER_DEG, wrap_pi};

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
    fn impossible_sines_are_left_out() {
        let all_beyond: std::vec::Vec<_> =
            bearings(0.0).iter().map(|b| LineBearing { sine: 1.2, ..*b }).collect();
        assert!(solve(&all_beyond, &track(), 60.0, 2.0, 1.0).is_none());
    }
}
