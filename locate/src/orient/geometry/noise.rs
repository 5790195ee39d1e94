//! How far measured differences are off, as far as that moves hydrophones.
//!
//! A vessel is louder near by, so that each part of a pass has a scatter of its own. Six differences of four arrival times have three
//! parts that are differences of times, and three that no times explain: a model of places explains times only, so that errors of the
//! first kind count, and how long they last.

use super::model::{Model, UNKNOWNS};
use super::{LEAST_SCALE_S, TimedDelays};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::kit::{Huber, MAD_TO_SD, Square, Tukey, spd};
use crate::math::f64 as m;
use crate::orient::quantile;

/// Parts of a pass that have scatters of their own, at most, and fewest sets of one.
const PARTS: usize = 64;
const LEAST_PART: usize = 16;
/// Fewest complete sets from which is told what their errors have in common.
const LEAST_SETS: usize = 20;
/// Sets over which errors may last, and what they have in common that is no more than chance.
const LAGS: usize = 40;
const CHANCE: f64 = 0.05;
/// Blocks of sets that tell how scores scatter, of a pass that has as many sets; half of them must do.
const LEAST_BLOCKS: usize = 60;

/// The scatter about a model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    /// Sets of a part, and the robust standard deviation of a difference in each, seconds.
    length: usize,
    scale_s: [f64; PARTS],
    /// Variance, in squares of the scale, for which independent differences tell as much as these do.
    factor: f64,
    /// How many successive sets share one error.
    pub correlated: f64,
    /// Wrong differences are left out; before, they pull less.
    pub strict: bool,
}

impl Noise {
    pub(super) fn of(model: &Model<'_>, sets: &[TimedDelays], strict: bool) -> Self {
        let length = LEAST_PART.max(sets.len().div_ceil(PARTS));
        let mut noise =
            Self { length, scale_s: [LEAST_SCALE_S; PARTS], factor: 2.0, correlated: 1.0, strict };
        for (scale, part) in noise.scale_s.iter_mut().zip(sets.chunks(length)) {
            let residuals =
                part.iter().flat_map(|set| model.residuals(set)).filter(|r| r.is_finite()).map(m::abs);
            *scale = (MAD_TO_SD * quantile(residuals, 0.5)).max(LEAST_SCALE_S);
        }
        noise.in_common(model, sets);
        noise
    }

    /// Robust standard deviation of a difference of a set, seconds.
    pub(super) fn scale_s(&self, set: usize) -> f64 {
        self.scale_s.get(set / self.length).copied().unwrap_or(LEAST_SCALE_S)
    }

    /// Median over the sets of the same.
    pub(super) fn median_s(&self, sets: usize) -> f64 {
        quantile((0..sets).map(|n| self.scale_s(n)), 0.5)
    }

    /// Weight of a residual (s⁻²), and of its slope: how the pull changes with it.
    pub(super) fn weights(&self, set: usize, residual: f64) -> (f64, f64) {
        let scale = self.scale_s(set);
        let unit = 1.0 / (self.factor * self.correlated * scale * scale);
        let r = residual / scale;
        if !self.strict {
            let w = Huber::EFFICIENT.weight(r);
            return (w * unit, w * unit);
        }
        let w = Tukey::EFFICIENT.weight(r);
        // w = (1 − u²)², so that the slope of w·r is (1 − u²)(1 − 5u²).
        let left = m::sqrt(w);
        (w * unit, left * (5.0 * left - 4.0) * unit)
    }

    /// Square of the angle by which the image pulls the vessel, rad²: a mean over the pass, each set as its scatter lets it count.
    pub(super) fn pulled_square(&self, model: &Model<'_>, sets: &[TimedDelays]) -> f64 {
        let (mut sum, mut all) = (0.0, 0.0);
        for (k, set) in sets.iter().enumerate() {
            let Some(angle) = model.pulled(set.t_s) else { continue };
            let weight = 1.0 / (self.scale_s(k) * self.scale_s(k));
            (sum, all) = (sum + weight * angle * angle, all + weight);
        }
        if all > 0.0 { sum / all } else { 0.0 }
    }

    /// What complete sets show of the parts that are differences of times, and of their order.
    fn in_common(&mut self, model: &Model<'_>, sets: &[TimedDelays]) {
        let mut products = [0.0f64; LAGS + 1];
        let mut past = [None; LAGS];
        let mut n = 0usize;
        for (k, set) in sets.iter().enumerate() {
            let scale = self.scale_s(k);
            let times = times(&model.residuals(set).map(|r| r / scale));
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
        let [squares, later @ ..] = products;
        if n < LEAST_SETS || !(squares > 0.0) {
            return;
        }
        let share = later.iter().map(|x| x / squares).take_while(|x| *x > CHANCE).sum::<f64>();
        // What the pairs err by is twice the times', squared and summed; three parts of six.
        (self.factor, self.correlated) = (4.0 * squares / (3.0 * n as f64), 1.0 + 2.0 * share);
    }

    /// Covariance of the unknowns (in their units): the inverse of the information with what the sets' scores scatter by, so that it
    /// holds whatever the errors' law is. Scores of successive sets are summed first, of as many as have errors in common and of no fewer
    /// than make [`LEAST_BLOCKS`] of the pass, so that slow errors count; as many of the blocks as numbers are told by the pass show no
    /// scatter any more. As `inverse` has it, where sets are few.
    pub(super) fn covariance(
        &self,
        model: &Model<'_>,
        sets: &[TimedDelays],
        inverse: &Square<UNKNOWNS>,
    ) -> Option<Square<UNKNOWNS>> {
        let length = (m::ceil(2.0 * self.correlated) as usize).max(sets.len() / LEAST_BLOCKS);
        let blocks = sets.chunks(length.max(1));
        let left = (0..UNKNOWNS).map(|k| inverse[k][k]).sum::<f64>();
        let free = blocks.len() as f64 - (UNKNOWNS as f64 - left);
        if blocks.len() < LEAST_BLOCKS / 2 || !(free > 0.0) {
            return Some(*inverse);
        }
        // What was known before has a variance of one in each.
        let mut information = [[0.0; UNKNOWNS]; UNKNOWNS];
        for (k, row) in information.iter_mut().enumerate() {
            row[k] = 1.0;
        }
        let mut scatter = information;
        let widen = blocks.len() as f64 / free;
        for (n, block) in blocks.enumerate() {
            let mut score = [0.0; UNKNOWNS];
            for (k, set) in block.iter().enumerate() {
                model.rows(set, |_, row, residual| {
                    let (weight, slope) = self.weights(n * length.max(1) + k, residual);
                    score.iter_mut().zip(row).for_each(|(x, d)| *x += weight * residual * d);
                    spd::add_outer(&mut information, row, slope);
                });
            }
            spd::add_outer(&mut scatter, &score, widen);
        }
        let inverse = spd::inverse(&information)?;
        Some(spd::propagated(&inverse, &scatter))
    }
}

/// Errors of the arrival times about their mean, in the residuals' units of scale, where all six pairs are right.
fn times(residuals: &[f64; 6]) -> Option<[f64; CHANNELS]> {
    let mut out = [0.0; CHANNELS];
    for ((i, j), r) in PAIRS.into_iter().zip(residuals) {
        if !(Tukey::EFFICIENT.weight(*r) > 0.0) {
            return None;
        }
        out[i] -= r / CHANNELS as f64;
        out[j] += r / CHANNELS as f64;
    }
    Some(out)
}
