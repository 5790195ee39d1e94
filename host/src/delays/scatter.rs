//! How the sets scatter about the surface on which their vectors lie: each by itself, and all those of one direction alike.
//!
//! Sets are gathered in cells of directions. The mean over a cell's n sets has variance `σ²/n + s²`: σ is a set's own, s what
//! the cell's sets share (multipath, delays in steps), which more sets from there do not average out. Both are estimated, and how many
//! cells that follow each other in time share one error.

use super::late::UNKNOWNS;
use seabearing_core::kit::{MAD_TO_SD, Normal, median};
use std::collections::BTreeMap;

/// Side of a cell, degrees.
const CELL_DEG: f64 = 3.0;
/// Smallest scatter of a length assumed, so that exact sets do not divide by zero.
const LEAST: f64 = 1e-4;
/// Cells are looked at for correlation up to this part of them away.
const MOST_LAG: usize = 4;

/// Weighted sums over the sets of one cell.
#[derive(Clone, Copy)]
struct Cell {
    weight: f64,
    row: [f64; UNKNOWNS],
    residual: f64,
}

/// Sets by direction.
#[derive(Default)]
pub(super) struct Cells {
    /// In order of their first sets.
    cells: Vec<Cell>,
    /// Where each is, by band of elevation and place along it.
    places: BTreeMap<(i32, i32), usize>,
}

/// What is known of the scatter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scatter {
    /// Standard deviation of a set's residual.
    pub(super) scale: f64,
    /// Standard deviation of what a cell's sets share.
    shared: f64,
    /// How many cells share one error.
    correlated: f64,
}

impl Default for Scatter {
    /// Before the first fit.
    fn default() -> Self {
        Self { scale: 0.02, shared: 0.02, correlated: 1.0 }
    }
}

impl Cells {
    /// Takes a set.
    pub(super) fn take(&mut self, u: &[f64; 3], row: &[f64; UNKNOWNS], residual: f64, weight: f64) {
        let elevation = u[2].clamp(-1.0, 1.0).asin().to_degrees();
        let band = (elevation / CELL_DEG).floor();
        let middle = ((band + 0.5) * CELL_DEG).to_radians();
        let around = (360.0 / CELL_DEG * middle.cos()).round().max(1.0);
        let along = (u[0].atan2(u[1]) / std::f64::consts::TAU * around).floor();
        let place = (band as i32, along as i32);
        let new = Cell { weight: 0.0, row: [0.0; UNKNOWNS], residual: 0.0 };
        let next = self.cells.len();
        let at = *self.places.entry(place).or_insert(next);
        if at == next {
            self.cells.push(new);
        }
        let cell = &mut self.cells[at];
        cell.weight += weight;
        cell.residual += weight * residual;
        cell.row.iter_mut().zip(row).for_each(|(x, y)| *x += weight * y);
    }

    /// Cells in which at least half a set counts.
    fn used(&self) -> impl Iterator<Item = &Cell> {
        self.cells.iter().filter(|c| c.weight > 0.5)
    }

    /// How many cells hold sets.
    pub(super) fn len(&self) -> usize {
        self.used().count()
    }

    /// Sets in them, by their weights.
    pub(super) fn sets(&self) -> f64 {
        self.used().map(|c| c.weight).sum()
    }

    /// The equations of the cells' means.
    pub(super) fn normal(&self, scatter: &Scatter) -> Normal<UNKNOWNS> {
        let mut normal = Normal::default();
        for cell in self.used() {
            let row = cell.row.map(|x| x / cell.weight);
            normal.observe(&row, cell.residual / cell.weight, 1.0 / scatter.variance(cell.weight));
        }
        normal
    }
}

impl Scatter {
    /// Robust standard deviation of residuals (absolute) about a fit of so many unknowns.
    pub(super) fn scale_of(mut residuals: Vec<f64>, fitted: f64) -> f64 {
        let n = residuals.len() as f64;
        let half = median(&mut residuals).unwrap_or(f64::INFINITY);
        (MAD_TO_SD * half * (n / (n - fitted).max(1.0)).sqrt()).max(LEAST)
    }

    /// Variance of the mean over so many sets of a cell.
    fn variance(&self, sets: f64) -> f64 {
        self.correlated * (self.scale * self.scale / sets + self.shared * self.shared)
    }

    /// Degrees of freedom that a fit of so many unknowns leaves.
    pub(super) fn freedom(&self, cells: usize, fitted: f64) -> f64 {
        (cells as f64 - fitted) / self.correlated
    }

    /// Takes what the cells' means show: the shared part is what their squares have beyond a set's own, by their degrees of freedom.
    pub(super) fn take(&mut self, cells: &Cells, fitted: f64) {
        let freedom = (cells.len() as f64 - fitted).max(1.0);
        let squares = |shared: f64| -> f64 {
            let own = Self { shared, ..*self };
            cells.used().map(|c| (c.residual / c.weight).powi(2) / own.variance(c.weight)).sum()
        };
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if squares(middle) > freedom { low = middle } else { high = middle }
        }
        self.shared = high;
    }

    /// The same, with as many cells to one error as their means show in the order in which they were heard.
    pub(super) fn in_order(self, cells: &Cells, fitted: f64) -> Self {
        let means = cells.used().map(|c| c.residual / c.weight / self.variance(c.weight).sqrt());
        let residuals: Vec<f64> = means.collect();
        Self { correlated: correlated(&residuals, fitted), ..self }
    }
}

/// How many numbers that follow each other share one error: the sum over their correlations up to the first that is none. A fit of so many
/// unknowns takes from each correlation, in the mean, as many as there are in units of the numbers.
pub(crate) fn correlated(residuals: &[f64], fitted: f64) -> f64 {
    let n = residuals.len();
    let taken = fitted / n.max(1) as f64;
    let power: f64 = residuals.iter().map(|x| x * x).sum();
    let mut sum = 1.0;
    for lag in 1..=n / MOST_LAG {
        let products = residuals.iter().zip(residuals.iter().skip(lag)).map(|(a, b)| a * b);
        let correlation = products.sum::<f64>() / power.max(f64::MIN_POSITIVE) + taken;
        if !(correlation > 0.0) {
            break;
        }
        sum += 2.0 * correlation;
    }
    sum
}
