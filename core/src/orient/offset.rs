//! One constant azimuth offset of a station (ocean-bottom station, DIFAR buoy) from passes of vessels with known
//! positions.
//!
//! The residual `true − measured` azimuth is the offset plus an error whose tails are far from Gaussian (wrong peaks,
//! other vessels, 180° flips). Per pass the offset is the maximum of a Student-t likelihood on the circle (three
//! degrees of freedom: the heaviest tails that still have a variance), its scale from the median absolute deviation;
//! found on a grid of 1°, so that a wrong mode cannot capture it, then refined by reweighting. Over several passes
//! the median of the passes, with the error of their scatter: the errors of one pass have a common part. With fewer
//! than three passes, the pooled fit and a jackknife over blocks in time.

use super::{MAD_TO_SD, OrientError, quantile};
use crate::angle::{wrap_pi, wrap_tau};
use crate::math::f64 as m;

/// Fewest residuals of a pass.
pub const LEAST_RESIDUALS: usize = 5;
/// Most passes kept apart; later ones are left to the next call.
pub const MAX_PASSES: usize = 64;
/// Degrees of freedom of the Student-t errors.
const FREEDOM: f64 = 3.0;
/// Least scale, radians: bearings come in whole degrees, and a handful may agree by chance.
const LEAST_SCALE: f64 = 1.0 * crate::angle::RAD_PER_DEG;
/// Blocks of the jackknife.
const BLOCKS: usize = 10;
/// Share of the residuals that must lie within three scales for the offset to mean something.
const LEAST_SUPPORT: f64 = 0.5;

/// One azimuth residual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// True minus measured azimuth, radians (any branch).
    pub angle: f64,
    /// Which pass it belongs to; passes are numbered in rising order.
    pub pass: u32,
}

/// A constant offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// What to add to measured azimuths, radians in [0, 2π).
    pub offset: f64,
    /// Its standard deviation, radians.
    pub sd: f64,
    /// Scale of single residuals (1.4826 × median absolute deviation), radians.
    pub scale: f64,
    /// Share of residuals within three scales.
    pub support: f64,
    /// Residuals used.
    pub n: usize,
    /// Passes used.
    pub passes: usize,
}

/// Finds the offset.
///
/// # Errors
/// [`OrientError::TooFew`], [`OrientError::NotFinite`]; [`OrientError::Inconsistent`] where fewer than half of the
/// residuals support any one offset.
pub fn offset(residuals: &[Residual]) -> Result<Offset, OrientError> {
    if residuals.iter().any(|r| !r.angle.is_finite()) {
        return Err(OrientError::NotFinite);
    }
    let n = residuals.len();
    if n < LEAST_RESIDUALS {
        return Err(OrientError::TooFew);
    }
    let all = residuals.iter().map(|r| r.angle);
    let (pooled, scale) = fit(all.clone());
    let support =
        all.clone().filter(|a| m::abs(wrap_pi(a - pooled)) <= 3.0 * scale).count() as f64 / n as f64;
    // A circle of evenly spread residuals has a scale of 67° (1.4826 × 45°...): a scale beyond 45° is no direction.
    if !(support >= LEAST_SUPPORT) || scale > 0.25 * m::PI {
        return Err(OrientError::Inconsistent);
    }
    let mut of_pass: heapless::Vec<f64, MAX_PASSES> = heapless::Vec::new();
    let mut rest = residuals;
    while let Some(first) = rest.first() {
        let length = rest.iter().take_while(|r| r.pass == first.pass).count();
        let (pass, later) = rest.split_at_checked(length.max(1)).unwrap_or((rest, &[]));
        rest = later;
        if pass.len() >= LEAST_RESIDUALS {
            let (a, _) = fit(pass.iter().map(|r| r.angle));
            if of_pass.push(wrap_pi(a - pooled)).is_err() {
                break;
            }
        }
    }
    let passes = of_pass.len();
    let (correction, sd) = if passes >= 3 {
        let middle = quantile(of_pass.iter().copied(), 0.5);
        let spread = MAD_TO_SD * quantile(of_pass.iter().map(|a| m::abs(a - middle)), 0.5);
        // The median of Gaussian values has √(π/2) of the mean's standard deviation.
        (middle, m::sqrt(m::FRAC_PI_2 / passes as f64) * spread.max(jackknife(residuals, pooled)))
    } else {
        (0.0, jackknife(residuals, pooled))
    };
    // Even without visible scatter an offset is not better known than its residuals' scale allows.
    let least = scale / m::sqrt(n as f64);
    Ok(Offset {
        offset: wrap_tau(pooled + correction),
        sd: sd.max(least),
        scale,
        support,
        n,
        passes: passes.max(1),
    })
}

/// Student-t location and scale of angles.
fn fit(angles: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    // Coarse: the grid point with the greatest likelihood at a broad scale (10°).
    const COARSE_SCALE: f64 = 10.0 * crate::angle::RAD_PER_DEG;
    let mut best = (f64::INFINITY, 0.0);
    for k in 0..360 {
        let a = f64::from(k) * crate::angle::RAD_PER_DEG;
        let cost: f64 = angles
            .clone()
            .map(|x| {
                let r = wrap_pi(x - a) / COARSE_SCALE;
                m::ln_1p(r * r / FREEDOM)
            })
            .sum();
        if cost < best.0 {
            best = (cost, a);
        }
    }
    let mut a = best.1;
    let mut scale = COARSE_SCALE;
    for _ in 0..50 {
        let deviations = angles.clone().map(|x| m::abs(wrap_pi(x - a)));
        scale = (MAD_TO_SD * quantile(deviations, 0.5)).max(LEAST_SCALE);
        let (mut sum, mut weights) = (0.0, 0.0);
        for x in angles.clone() {
            let d = wrap_pi(x - a);
            let w = (FREEDOM + 1.0) / (FREEDOM + d * d / (scale * scale));
            sum += w * d;
            weights += w;
        }
        if !(weights > 0.0) {
            break;
        }
        let step = sum / weights;
        a += step;
        if m::abs(step) < 1e-10 {
            break;
        }
    }
    (a, scale)
}

/// Delete-a-block jackknife of the pooled offset.
fn jackknife(residuals: &[Residual], pooled: f64) -> f64 {
    let n = residuals.len();
    let blocks = BLOCKS.min(n);
    let (mut sum, mut squares) = (0.0, 0.0);
    for block in 0..blocks {
        let part =
            residuals.iter().enumerate().filter(move |(i, _)| i * blocks / n != block).map(|(_, r)| r.angle);
        let d = wrap_pi(fit(part).0 - pooled);
        sum += d;
        squares += d * d;
    }
    let b = blocks as f64;
    m::sqrt(((b - 1.0) / b * (squares - sum * sum / b)).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::RAD_PER_DEG;
    use std::vec::Vec;

    /// Errors of ±2°, one in six wrong altogether, one in nine turned by 180°.
    fn residuals(offset: f64, passes: u32) -> Vec<Residual> {
        (0..40 * passes)
            .map(|k| {
                let t = f64::from(k);
                let wrong = if k % 6 == 2 { t * 2.4 } else { 0.0 } + if k % 9 == 5 { m::PI } else { 0.0 };
                Residual { angle: offset + 0.05 * (3.7 * t).sin() + wrong, pass: k / 40 }
            })
            .collect()
    }

    #[test]
    fn the_offset_survives_wrong_bearings_across_north() {
        for degrees in [-12.8, 0.4, 179.0] {
            for passes in [1, 5] {
                let found = offset(&residuals(degrees * RAD_PER_DEG, passes)).unwrap();
                let error = wrap_pi(found.offset - degrees * RAD_PER_DEG).abs();
                assert!(error < 1.0 * RAD_PER_DEG && error < 4.0 * found.sd, "{degrees} {found:?}");
                assert_eq!(found.passes, passes as usize);
            }
        }
    }

    #[test]
    fn directions_all_around_are_refused() {
        let spread: Vec<_> = (0..100).map(|k| Residual { angle: 0.628 * f64::from(k), pass: 0 }).collect();
        assert_eq!(offset(&spread), Err(OrientError::Inconsistent));
        assert_eq!(offset(&spread[..3]), Err(OrientError::TooFew));
    }
}
