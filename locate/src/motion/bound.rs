//! What no estimator of motion beats, and what a wrong error model costs [M 20-29].
//!
//! In: a true line, the times and errors of the bearings. Out: the Cramér-Rao bounds of position, heading, range and
//! time of CPA: from the full matrix, and in the paper's form, which inverts only the 2×2 block of position [M 28]
//! (they agree when the window is centred on CPA); the covariance of an estimator that takes errors for independent
//! while they are not: `(JᵀJ)⁻¹ Jᵀ C J (JᵀJ)⁻¹`.

use super::covariance::Model;
use super::ml::{Config, Sample, evaluate};
use super::model::{Line, PARAMETERS};
use super::normal::{COLUMNS, Matrix, Normal};
use super::solution::position;
use super::whiten::{Factorisation, Workspace};
use crate::kit::spd::{inverse, quadratic};
use crate::math::f64 as m;

/// Bounds (standard deviations) for one geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Of the line's parameters.
    pub covariance: Matrix,
    /// Range of CPA, m.
    pub cpa_range_m: f64,
    /// Time of CPA, s.
    pub cpa_time_s: f64,
    /// Heading, radians.
    pub heading_rad: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// East and North at the first bearing: `[xx, yy, xy]`, m².
    pub position_m2: [f64; 3],
}

impl Bounds {
    /// Adds the spread a speed assumed as `v̄` leaves: `x0² σ_k²` with `σ_k² = E{(v̄/v0 − 1)²}` [M 20, 22].
    pub fn cpa_range_with_speed_error(&self, cpa_range_m: f64, sigma_k: f64) -> f64 {
        m::sqrt(self.cpa_range_m * self.cpa_range_m + cpa_range_m * cpa_range_m * sigma_k * sigma_k)
    }
}

fn free(config: &Config) -> [bool; PARAMETERS] {
    let bias = config.medium.height_m > 0.0 && config.elevation_bias_sd_rad > 0.0;
    [true, true, true, config.speed_sd_m_s > 0.0, bias]
}

fn bounds(line: &Line, covariance: Matrix, t0_s: f64) -> Bounds {
    let range = [0.0, 0.0, -1.0, 1.0, 0.0];
    let sd = |k: usize| m::sqrt(covariance[k][k].max(0.0));
    Bounds {
        cpa_range_m: line.cpa_range_m() * m::sqrt(quadratic(&range, &covariance, &range).max(0.0)),
        cpa_time_s: sd(1),
        heading_rad: sd(0),
        speed_m_s: line.speed_m_s() * sd(3),
        position_m2: position(line, &covariance, t0_s).1,
        covariance,
    }
}

/// Cramér-Rao bounds at `line`; `None` where the geometry is singular.
pub fn cramer_rao<const N: usize>(
    config: &Config,
    samples: &[Sample],
    line: &Line,
    factorisation: &Factorisation,
    work: &mut Workspace<N>,
    dense: &[f64],
) -> Option<Bounds> {
    let normal = evaluate(config, factorisation, samples.iter(), line, work, dense)?;
    let covariance = normal.covariance(&free(config), &[0.0; PARAMETERS])?;
    Some(bounds(line, covariance, samples.first()?.t_s))
}

/// The paper's bounds for a known speed and no travel time: East, North at `t0_s` from the 2×2 block of the information
/// about `(x0, y0, γ)` [M 26-29], heading from the 3×3 matrix. Standard deviations (m, m, rad).
pub fn paper<const N: usize>(
    samples: &[Sample],
    line: &Line,
    t0_s: f64,
    factorisation: &Factorisation,
    work: &mut Workspace<N>,
    dense: &[f64],
) -> Option<[f64; 3]> {
    let v = line.speed_m_s();
    let (sin, cos) = m::sin_cos(line.heading_rad());
    let mut rows = samples.iter();
    let normal = factorisation.normal(samples.iter().map(|s| s.t_s), work, dense, |_, t| {
        let scale = rows.next().map_or(0.0, |s| 1.0 / f64::from(s.sd_rad));
        let ([x, y], _) = line.position(t);
        let d2 = x * x + y * y;
        let mut row = [0.0; COLUMNS];
        row[0] = y / d2 * scale;
        row[1] = -x / d2 * scale;
        row[2] = v * (t - t0_s) * (y * cos + x * sin) / d2 * scale;
        row
    })?;
    let block = inverse(&normal.information(&[true, true, false, false, false]))?;
    let full = inverse(&normal.information(&[true, true, true, false, false]))?;
    Some([m::sqrt(block[0][0]), m::sqrt(block[1][1]), m::sqrt(full[2][2])])
}

/// True spread of an estimator that takes the azimuths' errors for independent while they follow `truth` with
/// correlation interval `tau_s`. O(K²) evaluations of the model.
pub fn sandwich(
    config: &Config,
    samples: &[Sample],
    line: &Line,
    truth: Model,
    tau_s: f64,
) -> Option<Bounds> {
    let mut bread = Normal::default();
    let mut filling = [[0.0; PARAMETERS]; PARAMETERS];
    let scaled = |s: &Sample| {
        let e = line.expected(&config.medium, s.t_s);
        e.d_azimuth.map(|d| d / f64::from(s.sd_rad))
    };
    for (i, a) in samples.iter().enumerate() {
        let ja = scaled(a);
        let mut row = [0.0; COLUMNS];
        for (x, j) in row.iter_mut().zip(&ja) {
            *x = *j;
        }
        bread.add(&row, 1.0);
        // Σ_j C_ij J_j for this row, by symmetry from the earlier ones.
        let mut sum = ja;
        for b in samples.iter().take(i) {
            let rho = truth.rho(a.t_s - b.t_s, tau_s);
            if rho != 0.0 {
                for (x, j) in sum.iter_mut().zip(scaled(b)) {
                    *x += 2.0 * rho * j;
                }
            }
        }
        for k in 0..PARAMETERS {
            for l in 0..PARAMETERS {
                filling[k][l] += 0.5 * (ja[k] * sum[l] + ja[l] * sum[k]);
            }
        }
    }
    let free = [true, true, true, false, false];
    let outer = bread.covariance(&free, &[0.0; PARAMETERS])?;
    let mut covariance = [[0.0; PARAMETERS]; PARAMETERS];
    for k in 0..PARAMETERS {
        for l in 0..PARAMETERS {
            covariance[k][l] = quadratic(&outer[k], &filling, &outer[l]);
        }
    }
    if config.speed_sd_m_s > 0.0 && config.speed_sd_m_s.is_finite() {
        let relative = config.speed_sd_m_s / line.speed_m_s();
        covariance[3][3] = relative * relative;
    }
    Some(bounds(line, covariance, samples.first()?.t_s))
}
