//! One constant azimuth offset of a station (ocean-bottom station, DIFAR buoy) from passes of vessels with known
//! positions.
//!
//! The residual `true − measured` azimuth is the offset plus an error whose tails are far from Gaussian (wrong peaks,
//! other vessels, 180° flips). Per pass the mode is found on a grid of 1° under a Student-t likelihood (three degrees of
//! freedom, 10° wide), so that a wrong mode cannot capture it; about it the offset is the maximum of Huber's likelihood
//! (P. J. Huber, Ann. Math. Statist. 35, 1964): Gaussian within `CORNER` (1.5°), exponential beyond, as the errors of real
//! buoys are (`seabearing reproduce difar`). It never lies farther than the corner from the median residual. Over
//! several passes the median of the passes, with the error of their scatter: the errors of one pass have a common part.
//! With fewer than three passes, the pooled fit and a jackknife over blocks in time.

use super::{OrientError, quantile};
use crate::angle::{wrap_pi, wrap_tau};
use crate::kit::{Huber, MAD_TO_SD, Student};
use crate::math::f64 as m;

/// Fewest residuals of a pass: two that agree say nothing of their error.
pub const LEAST_RESIDUALS: usize = 3;
/// Most passes kept apart; later ones are left to the next call.
const MAX_PASSES: usize = 64;
/// Degrees of freedom of the Student-t errors of the grid.
const FREEDOM: f64 = 3.0;
/// Where the Gaussian core of the errors ends and the exponential tails begin, radians: the median error of real buoys,
/// whose bearings come in whole degrees.
const CORNER: f64 = 1.5 * crate::angle::RAD_PER_DEG;
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
    // Even without visible scatter an offset is not better known than its residuals' scale allows, and a scale from a
    // handful of residuals is itself uncertain: n/(n − 2) as the variance of a Student-t variable.
    let few = n as f64 / (n as f64 - 2.0);
    let least = m::sqrt(m::FRAC_PI_2 / n as f64) * scale;
    let sd = m::sqrt(few) * sd.max(least);
    Ok(Offset { offset: wrap_tau(pooled + correction), sd, scale, support, n, passes: passes.max(1) })
}

/// Huber location and scale (1.4826 × median absolute deviation) of angles.
fn fit(angles: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    // Coarse: the grid point with the greatest Student-t likelihood at a broad scale (10°).
    const COARSE_SCALE: f64 = 10.0 * crate::angle::RAD_PER_DEG;
    let mut best = (f64::INFINITY, 0.0);
    for k in 0..360 {
        let a = f64::from(k) * crate::angle::RAD_PER_DEG;
        let cost: f64 =
            angles.clone().map(|x| Student { freedom: FREEDOM }.loss(wrap_pi(x - a) / COARSE_SCALE)).sum();
        if cost < best.0 {
            best = (cost, a);
        }
    }
    let mode = best.1;
    let from_mode = angles.map(|x| wrap_pi(x - mode));
    // Of an even number the middle of both medians: where the two halves are far apart the likelihood is flat between.
    let above = -quantile(from_mode.clone().map(|x| -x), 0.5);
    let mut a = 0.5 * (quantile(from_mode.clone(), 0.5) + above);
    let scale = (MAD_TO_SD * quantile(from_mode.clone().map(|x| m::abs(x - a)), 0.5)).max(LEAST_SCALE);
    // Reweighting converges by a constant factor a step, slowest where nearly all residuals are in the tails.
    for _ in 0..500 {
        let (mut sum, mut weights) = (0.0, 0.0);
        for x in from_mode.clone() {
            let d = x - a;
            let w = Huber { corner: CORNER }.weight(d);
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
    (mode + a, scale)
}

/// Delete-a-block jackknife of the pooled offset.
fn jackknife(residuals: &[Residual], pooled: f64) -> f64 {
    let n = residuals.len();
    let blocks = BLOCKS.min(n);
    let [sd] = super::jackknife(blocks, |block| {
        let part =
            residuals.iter().enumerate().filter(move |(i, _)| i * blocks / n != block).map(|(_, r)| r.angle);
        Some([wrap_pi(fit(part).0 - pooled)])
    })
    .unwrap_or([f64::INFINITY]);
    sd
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
    fn the_offset_stays_by_the_median_and_its_error_is_honest_for_a_handful() {
        // Errors of exponential size either way (median 1.5°), from a linear congruential generator.
        let mut state = 1_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
        };
        for n in [3, 5, 8, 20] {
            let (mut within, runs) = (0, 400);
            for _ in 0..runs {
                let mut degrees: Vec<f64> = (0..n)
                    .map(|_| -1.5 / 2.0_f64.ln() * uniform().ln() * if uniform() < 0.5 { -1.0 } else { 1.0 })
                    .collect();
                let r: Vec<_> =
                    degrees.iter().map(|d| Residual { angle: (d - 170.0) * RAD_PER_DEG, pass: 0 }).collect();
                let Ok(found) = offset(&r) else { continue };
                let error = wrap_pi(found.offset + 170.0 * RAD_PER_DEG);
                degrees.sort_by(f64::total_cmp);
                let middle = [degrees[(n - 1) / 2] - 1.5, degrees[n / 2] + 1.5].map(|d| d * RAD_PER_DEG);
                assert!(error > middle[0] - 1e-6 && error < middle[1] + 1e-6, "{n} {error} {middle:?}");
                within += u32::from(error.abs() < 2.0 * found.sd);
            }
            let share = f64::from(within) / f64::from(runs);
            std::println!("{n} {share}");
            assert!((0.90..=0.99).contains(&share), "{n} residuals: {share} within two standard deviations");
        }
    }

    #[test]
    fn directions_all_around_are_refused() {
        let spread: Vec<_> = (0..100).map(|k| Residual { angle: 0.628 * f64::from(k), pass: 0 }).collect();
        assert_eq!(offset(&spread), Err(OrientError::Inconsistent));
        assert_eq!(offset(&spread[..2]), Err(OrientError::TooFew));
    }
}
