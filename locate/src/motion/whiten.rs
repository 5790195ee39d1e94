//! Whitening of batches of bearings under any of the five error models, in memory that grows with their number only.
//!
//! In: times, an error model, rows `[∂α/∂θ | α̂ − α]` divided by each bearing's standard deviation. Out: the normal
//! equations `[J|r]ᵀ C⁻¹ [J|r]` and `ln det C`. Chosen by what the times allow:
//!
//! - white and Markov: sample by sample, any times ([`super::chain`]);
//! - linear, regular times, `τ_α` a whole number `m` of steps: exact in O(K). The model is the sum of `m` equal white
//!   impulses, so differences of neighbours are correlated only at lag `m`, which falls into `m` chains with the
//!   tridiagonal covariance `(2, −1)/m` and a closed-form factor; the first bearing is conditioned on them at the end;
//! - regular times: Levinson-Durbin predictors, O(K²) operations and O(K) memory; up to [`MISSING`] missing bearings are
//!   extra unknowns (the whitened unit vector of a missing position is the predictor itself, read backwards), which is
//!   exact;
//! - any other times: Cholesky factor in memory the caller lends (n(n+1)/2 numbers).
//!
//! Prediction-error variances tell how near to singular the model is: where one falls below `CONDITION` of the first,
//! a white part of that size is added and the fit says so. Cost at K = 401 of Levinson: about 1.5 million
//! multiplications a call.

use super::chain::{Chain, Colour};
use super::covariance::Model;
use super::factor::{Levinson, differences, factorise, substitute};
use super::normal::{COLUMNS, Normal};
use crate::math::f64 as m;

/// Missing positions of a regular record handled exactly in fixed memory (one in eight of a full record).
pub const MISSING: usize = 48;
/// Least prediction-error variance, relative: below it the errors would be predictable to a hundredth of their size,
/// which no model of the sea is good enough to claim.
const CONDITION: f64 = 1e-4;
/// Times are regular if each lies within this part of a step from its place.
const REGULAR: f64 = 1e-3;

const AUGMENTED: usize = MISSING + COLUMNS;
/// Upper triangle of a Gram matrix of so many columns, row by row.
const TRIANGLE: usize = AUGMENTED * (AUGMENTED + 1) / 2;

/// Memory of a fit over up to `N` regular positions. `N = 401` (200 s, two a second) takes 37 KiB.
#[derive(Clone, Debug)]
pub struct Workspace<const N: usize> {
    rows: [[f64; COLUMNS]; N],
    predictor: [f64; N],
    lags: [f64; N],
    missing: [u16; MISSING],
    gram: [f64; TRIANGLE],
}

impl<const N: usize> Workspace<N> {
    /// Cleared memory.
    pub const fn new() -> Self {
        Self {
            rows: [[0.0; COLUMNS]; N],
            predictor: [0.0; N],
            lags: [0.0; N],
            missing: [0; MISSING],
            gram: [0.0; TRIANGLE],
        }
    }
}

/// How a batch is whitened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhitenMethod {
    /// Sample by sample, exact for any times.
    Chain,
    /// Linear model as interleaved chains of differences.
    Differences,
    /// Levinson-Durbin on the regular grid; how many positions are missing.
    Levinson {
        /// Positions without a bearing.
        missing: u16,
    },
    /// Cholesky factor in lent memory.
    Dense,
}

/// Why a batch cannot be whitened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WhitenError {
    /// Times go back or are not finite.
    #[error("times go back or are not numbers")]
    Times,
    /// Times fit no grid of this many positions and the lent memory is too small: numbers needed.
    #[error("times fit no grid; memory for {0} numbers is needed")]
    Memory(usize),
    /// The model is singular even with the white part added.
    #[error("the error model is singular at these times")]
    Singular,
}

/// The chosen factorisation.
#[derive(Clone, Copy, Debug)]
pub struct Factorisation {
    /// The error model.
    pub model: Model,
    /// Correlation interval, s.
    pub tau_s: f64,
    /// How it is done.
    pub method: WhitenMethod,
    /// White part added to the unit variance (0 where the model is regular enough).
    pub nugget: f64,
    /// Least prediction-error variance over the first, before anything was added.
    pub condition: f64,
    /// Share of each bearing's variance that no other shares (Markov).
    pub(super) white: f64,
    pub(super) first_s: f64,
    pub(super) step_s: f64,
    pub(super) positions: usize,
    pub(super) lag: usize,
}

impl Factorisation {
    /// Chooses and prepares. `times` in order; `dense` is memory for irregular times (may be empty).
    ///
    /// # Errors
    /// [`WhitenError`].
    pub fn new<const N: usize>(
        model: Model,
        tau_s: f64,
        times: impl Iterator<Item = f64> + Clone,
        work: &mut Workspace<N>,
        dense: &mut [f64],
    ) -> Result<Self, WhitenError> {
        let n = times.clone().count();
        let (mut first_s, mut last, mut step_s) = (0.0, f64::NEG_INFINITY, f64::INFINITY);
        for (i, t) in times.clone().enumerate() {
            if !t.is_finite() || t < last {
                return Err(WhitenError::Times);
            }
            if i == 0 {
                first_s = t;
            } else if t > last {
                step_s = step_s.min(t - last);
            }
            last = t;
        }
        let model = if tau_s > 0.0 { model } else { Model::White };
        let mut factorisation = Self {
            model,
            tau_s,
            method: WhitenMethod::Chain,
            nugget: 0.0,
            condition: 1.0,
            white: 0.0,
            first_s,
            step_s,
            positions: n,
            lag: 0,
        };
        if matches!(model, Model::White | Model::Markov) || n < 2 {
            return Ok(factorisation);
        }
        // The mean step over the whole record is known better than the smallest one.
        let whole = m::round((last - first_s) / step_s);
        if whole >= 1.0 && whole < N as f64 {
            factorisation.step_s = (last - first_s) / whole;
            factorisation.positions = whole as usize + 1;
        }
        let positions = factorisation.positions;
        let regular = whole < N as f64 && factorisation.find_missing(times.clone(), &mut work.missing);
        let missing = positions.saturating_sub(n);
        if regular && missing <= MISSING {
            let steps = tau_s / factorisation.step_s;
            let whole = m::round(steps);
            if model == Model::Linear && missing == 0 && (steps - whole).abs() < 1e-6 * steps && whole < 1e6 {
                factorisation.method = WhitenMethod::Differences;
                factorisation.lag = whole as usize;
                factorisation.condition = 1.0 / whole;
                return Ok(factorisation);
            }
            factorisation.method = WhitenMethod::Levinson { missing: missing as u16 };
            factorisation.condition = factorisation.worst_prediction(work);
            if factorisation.condition < CONDITION {
                factorisation.nugget = CONDITION;
                if factorisation.worst_prediction(work) < 0.5 * CONDITION {
                    return Err(WhitenError::Singular);
                }
            }
            return Ok(factorisation);
        }
        factorisation.method = WhitenMethod::Dense;
        let needed = n * (n + 1) / 2;
        let Some(memory) = dense.get_mut(..needed) else { return Err(WhitenError::Memory(needed)) };
        factorisation.condition = factorise(model, tau_s, 0.0, times.clone(), memory);
        if factorisation.condition < CONDITION {
            factorisation.nugget = CONDITION;
            if factorise(model, tau_s, CONDITION, times, memory) < 0.5 * CONDITION {
                return Err(WhitenError::Singular);
            }
        }
        Ok(factorisation)
    }

    /// The same where `share` (0 to 1) of each bearing's variance is its own: of the Markov model only, the others have none.
    pub fn with_white(self, share: f64) -> Self {
        Self { white: if self.model == Model::Markov { share } else { 0.0 }, ..self }
    }

    /// Place of a time on the grid, if it lies on one.
    fn position(&self, t_s: f64) -> Option<usize> {
        let x = (t_s - self.first_s) / self.step_s;
        let k = m::round(x);
        ((x - k).abs() <= REGULAR && k >= 0.0 && k < self.positions as f64).then_some(k as usize)
    }

    /// Lists the grid positions without a bearing; false if some time is off the grid or there are too many.
    fn find_missing(&self, times: impl Iterator<Item = f64>, missing: &mut [u16; MISSING]) -> bool {
        let (mut next, mut found) = (0usize, 0usize);
        for t in times {
            let Some(k) = self.position(t) else { return false };
            if k < next {
                return false;
            }
            for gap in next..k {
                let Some(slot) = missing.get_mut(found) else { return false };
                *slot = gap as u16;
                found += 1;
            }
            next = k + 1;
        }
        next == self.positions
    }

    /// Runs the Levinson recursion alone: least prediction-error variance over the first.
    fn worst_prediction<const N: usize>(&self, work: &mut Workspace<N>) -> f64 {
        self.fill_lags(&mut work.lags);
        let Workspace { predictor, lags, .. } = work;
        let mut least = 1.0f64;
        let mut levinson = Levinson::new(lags);
        for k in 1..self.positions {
            if !levinson.extend(k, predictor, lags) {
                return 0.0;
            }
            least = least.min(levinson.variance);
        }
        least
    }

    fn fill_lags(&self, lags: &mut [f64]) {
        for (k, r) in lags.iter_mut().enumerate().take(self.positions) {
            *r = self.model.rho(k as f64 * self.step_s, self.tau_s);
        }
        if let Some(r) = lags.first_mut() {
            *r = 1.0 + self.nugget;
        }
    }

    /// Normal equations of the rows that `fill` gives for each bearing's index and time: derivatives and residual,
    /// each divided by that bearing's standard deviation.
    pub fn normal<const N: usize>(
        &self,
        times: impl Iterator<Item = f64>,
        work: &mut Workspace<N>,
        dense: &[f64],
        mut fill: impl FnMut(usize, f64) -> [f64; COLUMNS],
    ) -> Option<Normal> {
        if self.method == WhitenMethod::Chain {
            let white = if self.model == Model::Markov { self.white } else { 1.0 };
            let mut chain = Chain::new(1.0 - white, self.tau_s);
            let colour = Colour::single(1.0, white);
            for (i, t) in times.enumerate() {
                chain.push(t, &colour, &fill(i, t));
            }
            return Some(chain.normal);
        }
        let grid = matches!(self.method, WhitenMethod::Levinson { missing: 1.. });
        if grid {
            for row in work.rows.iter_mut().take(self.positions) {
                *row = [0.0; COLUMNS];
            }
        }
        let mut count = 0usize;
        for (i, t) in times.enumerate() {
            let place = if grid { self.position(t)? } else { i };
            *work.rows.get_mut(place)? = fill(i, t);
            count += 1;
        }
        match self.method {
            WhitenMethod::Differences => Some(differences(work.rows.get_mut(..count)?, self.lag)),
            WhitenMethod::Levinson { missing } => self.levinson(usize::from(missing), work),
            _ => substitute(work.rows.get_mut(..count)?, dense),
        }
    }

    fn levinson<const N: usize>(&self, missing: usize, work: &mut Workspace<N>) -> Option<Normal> {
        self.fill_lags(&mut work.lags);
        let Workspace { rows, predictor, lags, missing: places, gram } = work;
        let rows = rows.get(..self.positions)?;
        let places = places.get(..missing)?;
        let size = missing + COLUMNS;
        let gram = gram.get_mut(..size * (size + 1) / 2)?;
        gram.fill(0.0);
        let mut levinson = Levinson::new(lags);
        let mut out = Normal::default();
        let mut z = [0.0; AUGMENTED];
        for (k, row) in rows.iter().enumerate() {
            if k > 0 && !levinson.extend(k, predictor, lags) {
                return None;
            }
            let a = predictor.get(..k)?;
            let (heads, tail) = z.split_at_mut_checked(missing)?;
            for (z, place) in heads.iter_mut().zip(places) {
                let place = usize::from(*place);
                *z = match k.cmp(&place) {
                    core::cmp::Ordering::Less => 0.0,
                    core::cmp::Ordering::Equal => 1.0,
                    core::cmp::Ordering::Greater => -a.get(k - place - 1).copied().unwrap_or(0.0),
                };
            }
            let mut sum = *row;
            for (a, past) in a.iter().zip(rows.get(..k)?.iter().rev()) {
                for (s, x) in sum.iter_mut().zip(past) {
                    *s -= a * x;
                }
            }
            for (z, s) in tail.iter_mut().zip(sum) {
                *z = s;
            }
            let weight = 1.0 / levinson.variance;
            let mut rest = &mut *gram;
            for i in 0..size {
                let (line, next) = core::mem::take(&mut rest).split_at_mut_checked(size - i)?;
                rest = next;
                let columns = z.get(i..size)?;
                let wi = weight * columns.first()?;
                for (g, z) in line.iter_mut().zip(columns) {
                    *g += wi * z;
                }
            }
            out.note(levinson.variance);
        }
        // Missing bearings are unknowns of their own: eliminated one by one, pivot by pivot.
        let mut rest = gram;
        for i in 0..missing {
            let (line, below) = rest.split_at_mut_checked(size - i)?;
            let (pivot, others) = line.split_first()?;
            if pivot.is_nan() || *pivot <= 0.0 {
                return None;
            }
            // A marginal, not a conditional, density of what was seen.
            out.note(*pivot);
            let mut left = &mut *below;
            for j in 0..others.len() {
                let others = others.get(j..)?;
                let (line, next) = core::mem::take(&mut left).split_at_mut_checked(others.len())?;
                left = next;
                let factor = others.first()? / pivot;
                for (g, p) in line.iter_mut().zip(others) {
                    *g -= factor * p;
                }
            }
            rest = below;
        }
        for i in 0..COLUMNS {
            let (from, next) = rest.split_at_mut_checked(COLUMNS - i)?;
            rest = next;
            let (last, products) = from.split_last()?;
            match (out.upper.get_mut(i), out.gradient.get_mut(i)) {
                (Some(row), Some(gradient)) => {
                    row.iter_mut().skip(i).zip(products).for_each(|(g, x)| *g = *x);
                    *gradient = *last;
                }
                _ => out.observe_at_cost(&[0.0; COLUMNS - 1], 0.0, 0.0, *last),
            }
        }
        Some(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    fn rows(t: f64) -> [f64; COLUMNS] {
        [1.0, t, t * t / 100.0, m::sin(t), m::cos(0.3 * t), m::sin(0.1 * t + 1.0)]
    }

    fn dense(model: Model, tau: f64, nugget: f64, times: &[f64]) -> Normal {
        let mut memory = vec![0.0; times.len() * (times.len() + 1) / 2];
        assert!(factorise(model, tau, nugget, times.iter().copied(), &mut memory) > 0.0);
        let mut r: Vec<_> = times.iter().map(|t| rows(*t)).collect();
        substitute(&mut r, &memory).unwrap()
    }

    fn same(a: &Normal, b: &Normal, tolerance: f64) {
        for i in 0..COLUMNS {
            for j in i..COLUMNS {
                let (x, y) = (a.gram(), b.gram());
                let scale = m::sqrt(y[i][i] * y[j][j]);
                assert!((x[i][j] - y[i][j]).abs() < tolerance * scale, "{i} {j} {a:?} {b:?}");
            }
        }
        assert!(
            (a.ln_det() - b.ln_det()).abs() < tolerance * b.ln_det().abs().max(1.0),
            "{} {}",
            a.ln_det(),
            b.ln_det()
        );
    }

    #[test]
    fn every_method_equals_the_dense_factor() {
        let mut work = Workspace::<64>::new();
        let regular: Vec<f64> = (0..60).map(|k| 5.0 + 0.5 * f64::from(k)).collect();
        let holes: Vec<f64> = regular
            .iter()
            .enumerate()
            .filter(|(k, _)| ![3, 17, 18, 19, 44].contains(k))
            .map(|(_, t)| *t)
            .collect();
        let odd: Vec<f64> = regular.iter().enumerate().map(|(k, t)| t + 0.1 * m::sin(k as f64)).collect();
        for (model, tau) in [
            (Model::White, 3.0),
            (Model::Linear, 4.0),
            (Model::Linear, 100.0),
            (Model::Linear, 4.3),
            (Model::Sinc, 0.15),
            (Model::Gaussian, 2.0),
            (Model::Gaussian, 40.0),
            (Model::Sinc, 40.0),
            (Model::Markov, 7.0),
        ] {
            for times in [&regular, &holes, &odd] {
                let mut memory = vec![0.0; 2000];
                let factorisation =
                    Factorisation::new(model, tau, times.iter().copied(), &mut work, &mut memory).unwrap();
                let normal =
                    factorisation.normal(times.iter().copied(), &mut work, &memory, |_, t| rows(t)).unwrap();
                let tolerance = if factorisation.nugget > 0.0 { 1e-6 } else { 1e-8 };
                same(&normal, &dense(model, tau, factorisation.nugget, times), tolerance);
                assert_eq!(factorisation.nugget > 0.0, tau == 40.0, "{factorisation:?}");
            }
        }
    }

    #[test]
    fn linear_model_on_the_grid_takes_the_short_way() {
        let mut work = Workspace::<401>::new();
        let times = (0..401).map(|k| 0.5 * f64::from(k));
        let factorisation =
            Factorisation::new(Model::Linear, 50.0, times.clone(), &mut work, &mut []).unwrap();
        assert_eq!(factorisation.method, WhitenMethod::Differences);
        let fast = factorisation.normal(times.clone(), &mut work, &[], |_, t| rows(t)).unwrap();
        let slow = Factorisation { method: WhitenMethod::Levinson { missing: 0 }, ..factorisation };
        same(&fast, &slow.normal(times, &mut work, &[], |_, t| rows(t)).unwrap(), 1e-8);
    }

    #[test]
    fn memory_of_a_full_record_fits_the_target() {
        assert!(size_of::<Workspace<401>>() <= 38 * 1024);
    }

    #[test]
    fn bad_times_and_too_little_memory_are_named() {
        let mut work = Workspace::<16>::new();
        let back = [0.0, 1.0, 0.5];
        assert_eq!(
            Factorisation::new(Model::Linear, 5.0, back.into_iter(), &mut work, &mut []).unwrap_err(),
            WhitenError::Times
        );
        let odd = [0.0, 1.0, 2.5, 2.7];
        assert_eq!(
            Factorisation::new(Model::Linear, 5.0, odd.into_iter(), &mut work, &mut []).unwrap_err(),
            WhitenError::Memory(10)
        );
    }
}
