//! How far measured differences are off, as far as that moves hydrophones.
//!
//! Six differences of four arrival times have three parts that are differences of times, and three that no times explain. A model of
//! places explains times only, so that errors of the first kind count, and how long they last.

use super::TimedDelays;
use super::model::Model;
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::kit::Tukey;

/// Fewest complete sets from which that is told.
const LEAST_SETS: usize = 20;
/// Sets over which errors may last, and what they have in common that is no more than chance.
const LAGS: usize = 40;
const CHANCE: f64 = 0.05;

/// Variance of a difference (s²) for which independent differences tell as much as these do, and how many successive sets share
/// one error.
pub(super) fn of(model: &Model<'_>, sets: &[TimedDelays], scale_s: f64) -> (f64, f64) {
    let mut products = [0.0f64; LAGS + 1];
    let mut past = [None; LAGS];
    let mut n = 0usize;
    for set in sets {
        let times = times(&model.residuals(set), scale_s);
        if let Some(now) = &times {
            n += 1;
            let dot = |other: &[f64; CHANNELS]| now.iter().zip(other).map(|(a, b)| a * b).sum::<f64>();
            products[0] += dot(now);
            for (sum, before) in products.iter_mut().skip(1).zip(&past) {
                *sum += before.as_ref().map_or(0.0, dot);
            }
        }
        past.rotate_right(1);
        past[0] = times;
    }
    if n < LEAST_SETS || !(products[0] > 0.0) {
        return (2.0 * scale_s * scale_s, 1.0);
    }
    let share = products.iter().skip(1).map(|x| x / products[0]).take_while(|x| *x > CHANCE).sum::<f64>();
    let [squares, ..] = products;
    // What the pairs err by is twice the times', squared and summed; three parts of six.
    (4.0 * squares / (3.0 * n as f64), 1.0 + 2.0 * share)
}

/// Errors of the arrival times about their mean, where all six pairs are right.
fn times(residuals: &[f64; 6], scale_s: f64) -> Option<[f64; CHANNELS]> {
    let mut out = [0.0; CHANNELS];
    for ((i, j), r) in PAIRS.into_iter().zip(residuals) {
        if !(Tukey::EFFICIENT.weight(r / scale_s) > 0.0) {
            return None;
        }
        out[i] -= r / CHANNELS as f64;
        out[j] += r / CHANNELS as f64;
    }
    Some(out)
}
