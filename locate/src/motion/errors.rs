//! The error model itself, from a vessel of known track: standard deviation, correlation interval, constant offset, shift.
//!
//! In: times, differences `measured − true` azimuth, and how fast the true one turns. Out: the maximum-likelihood `σ_α`, `τ_α`,
//! offset (a wrong orientation) and shift (how late what is heard is: the propeller follows the antenna, and clocks differ)
//! for a given shape of correlation, with spreads from the curvature of the likelihood. `σ_α`, offset and shift are solved
//! in closed form at every `τ_α`; `ln τ_α` is searched on a grid and refined by golden section.
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
    /// How much later than was assumed what is heard is, seconds, and its standard deviation: infinite, and the shift 0, where the
    /// azimuth turns evenly, so that an offset explains as much.
    pub shift_s: (f64, f64),
    /// Logarithm of the likelihood at the maximum, for comparing models over the same record.
    pub ln_likelihood: f64,
}

/// One bearing of a vessel of known track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// When, seconds.
    pub t_s: f64,
    /// Measured less true azimuth, radians.
    pub error_rad: f64,
    /// How fast the true azimuth turns, radians a second.
    pub rate_rad_s: f64,
}

/// Least share of the turning that no offset explains for a shift to be told.
const LEAST_UNEVEN: f64 = 1e-6;
/// Grid over ln τ and golden sections after it.
const GRID: usize = 24;
const SECTIONS: u32 = 20;

/// Estimates the model. `dense` is memory for irregular times (may be empty for white and Markov).
///
/// # Errors
/// [`WhitenError`]; fewer than 8 differences are [`WhitenError::Times`].
pub fn estimate<const N: usize>(
    model: Model,
    differences: &[Difference],
    work: &mut Workspace<N>,
    dense: &mut [f64],
) -> Result<ErrorModel, WhitenError> {
    let (Some(first), Some(last)) = (differences.first(), differences.last()) else {
        return Err(WhitenError::Times);
    };
    let n = differences.len() as f64;
    let step = (last.t_s - first.t_s) / (n - 1.0);
    if differences.len() < 8 || step.is_nan() || step <= 0.0 {
        return Err(WhitenError::Times);
    }
    let mut at = |tau_s: f64| -> Result<At, WhitenError> {
        let times = differences.iter().map(|d| d.t_s);
        let factorisation = Factorisation::new(model, tau_s, times.clone(), work, dense)?;
        let mut values = differences.iter();
        let normal = factorisation
            .normal(times, work, dense, |_, _| {
                let mut row = [0.0; COLUMNS];
                if let Some(d) = values.next() {
                    row[0] = 1.0;
                    // What comes s later is behind by as much as the azimuth has turned in s.
                    row[1] = -d.rate_rad_s;
                    row[COLUMNS - 1] = d.error_rad;
                }
                row
            })
            .ok_or(WhitenError::Singular)?;
        let g = normal.gram();
        let (oo, os, ss) = (g[0][0], g[0][1], g[1][1]);
        let (o, s, all) = (g[0][COLUMNS - 1], g[1][COLUMNS - 1], g[COLUMNS - 1][COLUMNS - 1]);
        let uneven = oo * ss - os * os;
        let (offset, shift, unknowns) = if uneven > LEAST_UNEVEN * oo * ss {
            let shift = (oo * s - os * o) / uneven;
            (((ss * o - os * s) / uneven, ss / uneven), (shift, oo / uneven), 2.0)
        } else {
            ((o / oo, 1.0 / oo), (0.0, f64::INFINITY), 1.0)
        };
        let cost = (all - offset.0 * o - shift.0 * s).max(1e-300);
        let variance = cost / (n - unknowns);
        Ok(At { twice: n * m::ln(variance) + normal.ln_det(), variance, offset, shift })
    };
    if model == Model::White {
        let At { twice, variance, offset, shift } = at(0.0)?;
        return Ok(ErrorModel {
            sd_rad: m::sqrt(variance),
            sd_relative: 1.0 / m::sqrt(2.0 * n),
            tau_s: 0.0,
            sd_ln_tau: 0.0,
            offset_rad: (offset.0, m::sqrt(variance * offset.1)),
            shift_s: (shift.0, m::sqrt(variance * shift.1)),
            ln_likelihood: -0.5 * twice,
        });
    }
    let (low, high) = (m::ln(0.3 * step), m::ln(last.t_s - first.t_s));
    let spacing = (high - low) / (GRID - 1) as f64;
    let mut best = (f64::INFINITY, low);
    for k in 0..GRID {
        let x = low + spacing * k as f64;
        let value = at(m::exp(x))?.twice;
        if value < best.0 {
            best = (value, x);
        }
    }
    let (a, b) = ((best.1 - spacing).max(low), (best.1 + spacing).min(high));
    let x = golden(a, b, SECTIONS, |x| at(m::exp(x)).map_or(f64::NAN, |found| found.twice));
    let At { twice, variance, offset, shift } = at(m::exp(x))?;
    // Curvature over a tenth of an octave; a maximum at the end of the search has none.
    let h = 0.1;
    let curvature = (at(m::exp(x - h))?.twice - 2.0 * twice + at(m::exp(x + h))?.twice) / (2.0 * h * h);
    let inside = x > low + 1e-3 && x < high - 1e-3;
    let sd_ln_tau = if inside && curvature > 0.0 { 1.0 / m::sqrt(curvature) } else { f64::INFINITY };
    // Independent stretches in the record limit how well the variance is known.
    let independent = (n / (1.0 + 2.0 * m::exp(x) / step)).max(1.0);
    Ok(ErrorModel {
        sd_rad: m::sqrt(variance),
        sd_relative: 1.0 / m::sqrt(2.0 * independent),
        tau_s: m::exp(x),
        sd_ln_tau,
        offset_rad: (offset.0, m::sqrt(variance * offset.1)),
        shift_s: (shift.0, m::sqrt(variance * shift.1)),
        ln_likelihood: -0.5 * twice,
    })
}

/// What one correlation interval gives.
struct At {
    /// Negative twice log-likelihood, variance, offset and shift profiled out.
    twice: f64,
    variance: f64,
    /// Offset and shift, and their variances in units of that of a bearing.
    offset: (f64, f64),
    shift: (f64, f64),
}
