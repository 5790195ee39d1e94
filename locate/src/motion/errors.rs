//! The error model itself, from a vessel of known track: standard deviation, correlation interval, constant offset.
//!
//! In: times and differences `measured − true` azimuth. Out: the maximum-likelihood `σ_α`, `τ_α` and offset (a wrong
//! orientation) for a given shape of correlation, with spreads from the curvature of the likelihood. `σ_α` and the
//! offset are solved in closed form at every `τ_α`; `ln τ_α` is searched on a grid and refined by golden section.
//! Assumes a stationary Gaussian error and a track much better known than the bearings. Cost: about 60 whitenings.

use super::covariance::Model;
use super::normal::COLUMNS;
use super::whiten::{Factorisation, WhitenError, Workspace};
use crate::kit::golden;
use crate::math::f64 as m;

/// What the errors are like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorModel {
    /// Standard deviation, radians.
    pub sd_rad: f64,
    /// Relative spread of that.
    pub sd_relative: f64,
    /// Correlation interval, s (0 for the white model).
    pub tau_s: f64,
    /// Spread of its logarithm; infinite where the record does not tell.
    pub sd_ln_tau: f64,
    /// Constant offset, radians, and its standard deviation.
    pub offset_rad: (f64, f64),
    /// Logarithm of the likelihood at the maximum, for comparing models over the same record.
    pub ln_likelihood: f64,
}

/// Grid over ln τ and golden sections after it.
const GRID: usize = 24;
const SECTIONS: u32 = 20;

/// Estimates the model. `dense` is memory for irregular times (may be empty for white and Markov).
///
/// # Errors
/// [`WhitenError`]; fewer than 8 differences are [`WhitenError::Times`].
pub fn estimate<const N: usize>(
    model: Model,
    differences: &[(f64, f64)],
    work: &mut Workspace<N>,
    dense: &mut [f64],
) -> Result<ErrorModel, WhitenError> {
    let (Some(first), Some(last)) = (differences.first(), differences.last()) else {
        return Err(WhitenError::Times);
    };
    let n = differences.len() as f64;
    let step = (last.0 - first.0) / (n - 1.0);
    if differences.len() < 8 || step.is_nan() || step <= 0.0 {
        return Err(WhitenError::Times);
    }
    // Negative twice log-likelihood, σ² and offset profiled out.
    let mut at = |tau_s: f64| -> Result<(f64, f64, f64, f64), WhitenError> {
        let times = differences.iter().map(|d| d.0);
        let factorisation = Factorisation::new(model, tau_s, times.clone(), work, dense)?;
        let mut values = differences.iter();
        let normal = factorisation
            .normal(times, work, dense, |_, _| {
                let mut row = [0.0; COLUMNS];
                row[0] = 1.0;
                row[COLUMNS - 1] = values.next().map_or(0.0, |d| d.1);
                row
            })
            .ok_or(WhitenError::Singular)?;
        let g = normal.gram();
        let offset = g[0][COLUMNS - 1] / g[0][0];
        let cost = (g[COLUMNS - 1][COLUMNS - 1] - offset * g[0][COLUMNS - 1]).max(1e-300);
        let variance = cost / (n - 1.0);
        Ok((n * m::ln(variance) + normal.ln_det(), variance, offset, 1.0 / g[0][0]))
    };
    if model == Model::White {
        let (twice, variance, offset, spread) = at(0.0)?;
        return Ok(ErrorModel {
            sd_rad: m::sqrt(variance),
            sd_relative: 1.0 / m::sqrt(2.0 * n),
            tau_s: 0.0,
            sd_ln_tau: 0.0,
            offset_rad: (offset, m::sqrt(variance * spread)),
            ln_likelihood: -0.5 * twice,
        });
    }
    let (low, high) = (m::ln(0.3 * step), m::ln(last.0 - first.0));
    let spacing = (high - low) / (GRID - 1) as f64;
    let mut best = (f64::INFINITY, low);
    for k in 0..GRID {
        let x = low + spacing * k as f64;
        let (value, ..) = at(m::exp(x))?;
        if value < best.0 {
            best = (value, x);
        }
    }
    let (a, b) = ((best.1 - spacing).max(low), (best.1 + spacing).min(high));
    let x = golden(a, b, SECTIONS, |x| at(m::exp(x)).map_or(f64::NAN, |found| found.0));
    let (twice, variance, offset, spread) = at(m::exp(x))?;
    // Curvature over a tenth of an octave; a maximum at the end of the search has none.
    let h = 0.1;
    let curvature = (at(m::exp(x - h))?.0 - 2.0 * twice + at(m::exp(x + h))?.0) / (2.0 * h * h);
    let inside = x > low + 1e-3 && x < high - 1e-3;
    let sd_ln_tau = if inside && curvature > 0.0 { 1.0 / m::sqrt(curvature) } else { f64::INFINITY };
    // Independent stretches in the record limit how well the variance is known.
    let independent = (n / (1.0 + 2.0 * m::exp(x) / step)).max(1.0);
    Ok(ErrorModel {
        sd_rad: m::sqrt(variance),
        sd_relative: 1.0 / m::sqrt(2.0 * independent),
        tau_s: m::exp(x),
        sd_ln_tau,
        offset_rad: (offset, m::sqrt(variance * spread)),
        ln_likelihood: -0.5 * twice,
    })
}
