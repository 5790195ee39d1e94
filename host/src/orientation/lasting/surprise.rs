//! What was said of orientations and clocks, where the bearings contradict it.
//!
//! In: a fit in which the errors are all but free, and what was said of each. Out: the same, and of those that are contradicted as much as they would
//! have to be. An error that is said to be next to nothing cannot move by its prior: what it does stays in the residuals, where it passes for their
//! scatter. So how much the bearings tell is taken from the free fit, and held against the priors: where a prior holds, the mean that it leaves of its
//! error has the variance `1 - C` (`C`: what is left of the prior's), in units of the prior. The one that is farthest off comes first, with those that explain as
//! much: a clock that is late by five seconds against two others makes these late against it as well, by half as much.

use super::{Fitted, N};
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_core::kit::spd::{self, Square};
use seabearing_locate::network::MAX_ARRAYS;
use seabearing_locate::network::joint::SharedError;

/// Deviations from which on it is no chance: with two stations one in a thousand passages has an error beyond it, with eight one in two hundred.
const NO_CHANCE: f64 = 3.6;
/// By how much less the misfit may be explained by another error that is taken to be as likely: odds of 20 to 1.
const AS_LIKELY: f64 = 6.0;
/// Errors that are taken to be one after the other.
const MOST: usize = 4;
/// Deviations below which nothing is said to be.
const EXACT: SharedError = SharedError { azimuth: 1e-4, clock_s: 1e-3 };
/// Deviations that leave an error all but free.
const FREE: SharedError = SharedError { azimuth: 3.0 * RAD_PER_DEG, clock_s: 5.0 };

/// What was said, but at least all but free.
pub(super) fn free(said: &[SharedError; MAX_ARRAYS]) -> [SharedError; MAX_ARRAYS] {
    said.map(|said| SharedError {
        azimuth: said.azimuth.max(FREE.azimuth),
        clock_s: said.clock_s.max(FREE.clock_s),
    })
}

/// What was said, as much larger where the bearings contradict it as they have it.
pub(super) fn surprising(free: &Fitted, said: &[SharedError; MAX_ARRAYS]) -> [SharedError; MAX_ARRAYS] {
    let held: [f64; N] = core::array::from_fn(|k| match said.get(k) {
        Some(said) => said.azimuth.max(EXACT.azimuth),
        None => said[k - MAX_ARRAYS].clock_s.max(EXACT.clock_s),
    });
    let mut prior = held;
    // Of few independent residuals, or of many that go together, the noise is not well known itself.
    let independent = (free.freedom / free.common).max(1.0);
    let no_chance = NO_CHANCE * (1.0 + NO_CHANCE * NO_CHANCE / independent).sqrt();
    for _ in 0..MOST {
        let Some(found) = held_against(free, &prior) else { break };
        let most = found.iter().map(|(off, _)| *off).fold(0.0, f64::max);
        if most <= no_chance {
            break;
        }
        for (prior, (off, size)) in prior.iter_mut().zip(found) {
            if off > no_chance && off * off > most * most - AS_LIKELY {
                *prior *= size.max(1.0);
            }
        }
    }
    let grown = |k: usize, said: f64| if prior[k] > held[k] { prior[k] } else { said };
    core::array::from_fn(|k| SharedError {
        azimuth: grown(k, said[k].azimuth),
        clock_s: grown(MAX_ARRAYS + k, said[k].clock_s),
    })
}

/// Of each error, by how many deviations it is off, and how large it would have to be in units of its prior.
fn held_against(free: &Fitted, prior: &[f64; N]) -> Option<[(f64, f64); N]> {
    let scale: [f64; N] = core::array::from_fn(|k| prior[k] / free.prior[k].max(f64::MIN_POSITIVE));
    let mut normal: Square<N> =
        core::array::from_fn(|k| core::array::from_fn(|l| scale[k] * scale[l] * free.information[k][l]));
    (0..N).for_each(|k| normal[k][k] += 1.0);
    let covariance = spd::inverse(&normal)?;
    let mean = spd::times(&covariance, &core::array::from_fn(|k| scale[k] * free.pull[k]));
    Some(core::array::from_fn(|k| {
        let told = 1.0 - covariance[k][k];
        if told > 1e-12 { (mean[k].abs() / told.sqrt(), mean[k].abs() / told) } else { (0.0, 0.0) }
    }))
}
