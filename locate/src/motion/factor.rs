//! The three factorisations behind [`super::whiten`]: Levinson-Durbin (docs/references.md), chains of differences, Cholesky.
//!
//! In: correlations by lag, or times. Out: one-step predictors and their error variances. Each is exact for its case;
//! costs are O(K²), O(K) and O(K³).

use super::covariance::Model;
use super::normal::{COLUMNS, Normal};
use crate::math::f64 as m;

/// The Durbin recursion: best linear prediction of a sample from those before it, nearest first.
pub(super) struct Levinson {
    pub(super) variance: f64,
}

impl Levinson {
    pub(super) fn new(lags: &[f64]) -> Self {
        Self { variance: lags.first().copied().unwrap_or(1.0) }
    }

    /// From order `k − 1` to order `k`; false if the model is singular there.
    pub(super) fn extend(&mut self, k: usize, a: &mut [f64], lags: &[f64]) -> bool {
        let (Some(old), Some(past), Some(lag)) = (a.get(..k - 1), lags.get(1..k), lags.get(k)) else {
            return false;
        };
        let predicted: f64 = old.iter().zip(past.iter().rev()).map(|(a, r)| a * r).sum();
        let reflection = (lag - predicted) / self.variance;
        let Some(old) = a.get_mut(..k - 1) else { return false };
        let half = old.len() / 2;
        let middle = old.len() % 2;
        let (front, back) = old.split_at_mut(half);
        for (x, y) in front.iter_mut().zip(back.iter_mut().skip(middle).rev()) {
            (*x, *y) = (*x - reflection * *y, *y - reflection * *x);
        }
        if middle == 1
            && let Some(x) = back.first_mut()
        {
            *x -= reflection * *x;
        }
        if let Some(slot) = a.get_mut(k - 1) {
            *slot = reflection;
        }
        self.variance *= 1.0 - reflection * reflection;
        self.variance > 1e-15
    }
}

/// The linear model with `τ_α` of `lag` steps, rows replaced by innovations of their differences.
pub(super) fn differences(rows: &mut [[f64; COLUMNS]], lag: usize) -> Normal {
    let mut out = Normal::default();
    let mut rest = rows.first().copied().unwrap_or([0.0; COLUMNS]);
    let mut left = 1.0;
    let mut before = rest;
    for k in 1..rows.len() {
        // The j-th difference of its chain: variance (j + 1)/(j m), regression on the one `lag` before −(j − 1)/j.
        let j = ((k - 1) / lag + 1) as f64;
        let past = if k > lag { rows.get(k - lag).copied() } else { None };
        let Some(row) = rows.get_mut(k) else { break };
        let here = *row;
        for c in 0..COLUMNS {
            row[c] -= before[c];
            if let Some(past) = past {
                row[c] += (j - 1.0) / j * past[c];
            }
            rest[c] += row[c] / (j + 1.0);
        }
        before = here;
        let variance = (j + 1.0) / (j * lag as f64);
        out.add(row, 1.0 / variance);
        out.note(variance);
        left -= 1.0 / (lag as f64 * j * (j + 1.0));
    }
    let left = left.max(1e-12);
    out.add(&rest, 1.0 / left);
    out.note(left);
    out
}

/// Packed lower Cholesky factor of the correlation of irregular times; least pivot over the first, 0 if singular.
pub(super) fn factorise(
    model: Model,
    tau_s: f64,
    nugget: f64,
    times: impl Iterator<Item = f64> + Clone,
    memory: &mut [f64],
) -> f64 {
    let mut least = 1.0f64;
    for (i, t_i) in times.clone().enumerate() {
        let Some((done, rest)) = memory.split_at_mut_checked(i * (i + 1) / 2) else { return 0.0 };
        let Some(row) = rest.get_mut(..=i) else { return 0.0 };
        let mut start = 0usize;
        for (j, t_j) in times.clone().enumerate().take(i) {
            let Some(other) = done.get(start..=start + j) else { return 0.0 };
            start += j + 1;
            let Some((pivot, other)) = other.split_last() else { return 0.0 };
            let dot: f64 = row.iter().zip(other).map(|(a, b)| a * b).sum();
            if let Some(x) = row.get_mut(j) {
                *x = (model.rho(t_i - t_j, tau_s) - dot) / pivot;
            }
        }
        let Some((last, row)) = row.split_last_mut() else { return 0.0 };
        let variance = 1.0 + nugget - row.iter().map(|x| x * x).sum::<f64>();
        if variance.is_nan() || variance < 1e-13 {
            return 0.0;
        }
        least = least.min(variance);
        *last = m::sqrt(variance);
    }
    least
}

/// Forward substitution of all rows at once.
pub(super) fn substitute(rows: &mut [[f64; COLUMNS]], factor: &[f64]) -> Option<Normal> {
    let mut out = Normal::default();
    let mut start = 0usize;
    for i in 0..rows.len() {
        let (pivot, left) = factor.get(start..=start + i)?.split_last()?;
        start += i + 1;
        let (done, rest) = rows.split_at_mut_checked(i)?;
        let row = rest.first_mut()?;
        for (l, past) in left.iter().zip(done.iter()) {
            for (x, p) in row.iter_mut().zip(past) {
                *x -= l * p;
            }
        }
        for x in row.iter_mut() {
            *x /= pivot;
        }
        out.add(row, 1.0);
        out.note(pivot * pivot);
    }
    Some(out)
}
