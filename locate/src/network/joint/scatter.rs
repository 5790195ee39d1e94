//! What the bearings themselves say of their errors.
//!
//! Each array alone is fitted by a *course of its own*, free of the others: what is left about it is the array's own
//! scatter, whatever its orientation and clock. From it come the standard deviation of an angle and how much successive
//! errors have in common (`e' = ρ e + …`, which makes a mean of many uncertain by `√((1+ρ)/(1−ρ))`). The *excess* of a common
//! motion is its misfit in these units less that of the courses of their own: chi-squared of as many degrees as the courses
//! have observable parameters (three from azimuths, four with elevations) less the motion's four.

use super::bend::{Bend, Bends};
use super::problem::Problem;
use super::{HUBER, SharedError, runs};
use crate::kit::{MAD_TO_SD, order_statistic};
use crate::math::f64 as m;
use crate::network::MAX_ARRAYS;
use runs::Runs;

/// Fewest angles of an array from which its scatter is taken.
const LEAST_ANGLES: f64 = 12.0;
/// Least scatter, in stated deviations: exact bearings do not divide by zero.
pub(super) const LEAST_SCATTER: f64 = 1e-4;
/// Most that successive errors are taken to have in common.
const MOST_COMMON: f64 = 0.95;
/// Parameters of a course that azimuths and elevations determine.
pub(super) const FITTED: [f64; 2] = [3.0, 1.0];

/// The courses of their own.
#[derive(Clone, Copy)]
pub(super) struct Courses {
    /// Measured over stated deviation of each array's azimuths and elevations, successive errors taken for independent.
    pub scale: [[f64; 2]; MAX_ARRAYS],
    /// Misfit of each in measured deviations, and its observable parameters.
    misfit: [f64; MAX_ARRAYS],
    parameters: [u32; MAX_ARRAYS],
    /// What is left about them goes in runs that no noise makes: the vessel's way is no straight course.
    pub bent: bool,
    /// How it is bent, where all arrays show that alike.
    pub bend: Option<Bend>,
}

impl Courses {
    /// Of all arrays of a problem, near a state.
    pub fn near(problem: &Problem<'_>, state: &[f64; 4]) -> Self {
        let (misfit, parameters) = ([0.0; MAX_ARRAYS], [0; MAX_ARRAYS]);
        let mut out = Self { scale: problem.scale, misfit, parameters, bent: false, bend: None };
        let mut runs = Runs::default();
        let mut bends = Bends::new(problem);
        for array in problem.arrays() {
            let (alone, course) = own(problem, array, state);
            bends.take(&alone, array, &course);
            for angle in [0, 1] {
                let residuals = alone.rows(array, &course, [0.0; 2]).filter(move |r| r.angle == angle);
                runs.take(residuals.clone().map(|r| r.residual));
                if let Some(measured) = scatter(residuals.map(|r| r.residual), FITTED[angle]) {
                    out.scale[array][angle] *= measured;
                }
            }
            let (alone, course) = own(&Problem { scale: out.scale, ..*problem }, array, &course);
            out.misfit[array] = alone.misfit(&course);
            out.parameters[array] = 3 + u32::from(alone.used().any(|b| b.sighting.elevation.is_some()));
        }
        out.bent = runs.no_noise();
        out.bend = bends.found();
        out
    }

    /// Excess of a common motion of some arrays, `misfit` in measured deviations, and its degrees of freedom.
    pub fn excess(&self, problem: &Problem<'_>, misfit: f64) -> (f64, u32) {
        let own: f64 = problem.arrays().map(|k| self.misfit[k]).sum();
        let parameters: u32 = problem.arrays().map(|k| self.parameters[k]).sum();
        ((misfit - own).max(0.0), parameters.saturating_sub(4))
    }
}

/// The course of one array free of all others, from a state on.
fn own<'a>(problem: &Problem<'a>, array: usize, state: &[f64; 4]) -> (Problem<'a>, [f64; 4]) {
    let alone = Problem { used: 1 << array, shared: [SharedError::default(); MAX_ARRAYS], ..*problem };
    (alone, alone.minimum_from(*state).unwrap_or(*state))
}

/// Standard deviation of standardised residuals in order of time, `fitted` parameters taken out of them, as of
/// independent ones of which a mean is as uncertain.
fn scatter(residuals: impl Iterator<Item = f64> + Clone, fitted: f64) -> Option<f64> {
    let (variance, common) = spread(residuals, fitted)?;
    Some(m::sqrt(variance * common).max(LEAST_SCATTER))
}

/// The same: their variance, and that of a mean over that of as many independent ones.
pub(super) fn spread(residuals: impl Iterator<Item = f64> + Clone, fitted: f64) -> Option<(f64, f64)> {
    let n = residuals.clone().count() as f64;
    if n < LEAST_ANGLES {
        return None;
    }
    let middle = order_statistic(residuals.clone().map(m::abs), 0.5)?;
    let sd = (MAD_TO_SD * middle).max(LEAST_SCATTER);
    let (mut squares, mut products, mut last) = (0.0, 0.0, 0.0);
    for r in residuals {
        let r = HUBER.clipped(r / sd);
        squares += r * r;
        products += last * r;
        last = r;
    }
    let found = if squares > 0.0 { products / squares } else { 0.0 };
    // Marriott and Pope 1954: the mean of an estimate of ρ is low by (1 + 3ρ)/n; each further parameter that was fitted takes
    // (1 + ρ)/n more. Of errors with so much in common there are fewer, and each parameter takes one of those.
    let low = (fitted + (fitted + 2.0) * found.max(0.0)) / n;
    let common = (found + low).clamp(0.0, MOST_COMMON);
    let inflation = (1.0 + common) / (1.0 - common);
    Some((sd * sd * squares / (n - (fitted * inflation).min(0.5 * n)), inflation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(seabearing_testkit::property(32))]

        /// Independent errors keep their size, whatever a tenth of wrong ones; those with something in common grow.
        #[test]
        fn scatter_is_that_of_a_mean(seed in 1u64..1_000_000, size in 0.05f64..20.0) {
            let mut x = seed;
            let mut white = || {
                let mut sum = 0.0;
                for _ in 0..12 {
                    x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    sum += (x >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
                }
                sum
            };
            let independent: std::vec::Vec<f64> = (0..2000).map(|_| size * white()).collect();
            let found = scatter(independent.iter().copied(), 3.0).unwrap();
            prop_assert!((found / size - 1.0).abs() < 0.15, "{found} {size}");
            let wrong = independent.iter().enumerate().map(|(i, r)| if i % 20 == 3 { 50.0 * size } else { *r });
            let found = scatter(wrong, 3.0).unwrap();
            prop_assert!((0.8..1.8).contains(&(found / size)), "{found} {size}");
            let mut e = 0.0;
            let common: std::vec::Vec<f64> = (0..2000).map(|_| { e = 0.8 * e + 0.6 * size * white(); e }).collect();
            // √((1 + 0.8)/(1 − 0.8)) = 3.
            let found = scatter(common.into_iter(), 3.0).unwrap();
            prop_assert!((found / size / 3.0 - 1.0).abs() < 0.3, "{found} {size}");
        }
    }

    #[test]
    fn few_angles_tell_no_scatter_and_exact_ones_the_least() {
        assert_eq!(scatter([1.0; 11].into_iter(), 3.0), None);
        assert_eq!(scatter([0.0; 40].into_iter(), 3.0), Some(LEAST_SCATTER));
    }
}
