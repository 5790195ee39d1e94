//! Normal equations of a line's parameters, and the descent over lines: [`crate::kit`] with the line's own rows and limits.
//!
//! In: whitened rows `[∂h/∂θ | y − h]`. Out: what [`crate::kit::normal`] and [`crate::kit::descent`] give.

use super::model::{Limits, Line, PARAMETERS};
use crate::kit::descent::LEAST_FALL;
use crate::kit::{self, Square};

/// Columns of a row: derivatives by the parameters, then the residual.
pub const COLUMNS: usize = PARAMETERS + 1;

/// Symmetric matrix of the parameters.
pub type Matrix = Square<PARAMETERS>;

/// Normal equations of the parameters.
pub type Normal = kit::Normal<PARAMETERS>;

/// A place of the descent.
pub type Point = kit::Point<Line, PARAMETERS>;

impl Normal {
    /// Adds a row whose error has been made white with variance `1 / weight`.
    #[inline]
    pub fn add(&mut self, row: &[f64; COLUMNS], weight: f64) {
        let [a, b, c, d, e, residual] = *row;
        self.observe(&[a, b, c, d, e], residual, weight);
    }

    /// Products of the rows' columns, upper triangle: the last column holds the gradient and, last, the cost.
    pub fn gram(&self) -> [[f64; COLUMNS]; COLUMNS] {
        let mut gram = [[0.0; COLUMNS]; COLUMNS];
        for i in 0..PARAMETERS {
            gram[i][..PARAMETERS].copy_from_slice(&self.upper[i]);
            gram[i][PARAMETERS] = self.gradient[i];
        }
        gram[PARAMETERS][PARAMETERS] = self.cost();
        gram
    }
}

/// The line of least cost that up to so many damped Gauss-Newton steps inside the limits lead to; `None` where the start has no normal equations.
pub fn minimise(
    line: &Line,
    free: &[bool; PARAMETERS],
    limits: &Limits,
    steps: usize,
    evaluate: impl FnMut(&Line) -> Option<Normal>,
) -> Option<Point> {
    let moved = |line: &Line, step: &[f64; PARAMETERS]| line.moved(&bounded(step), limits);
    kit::minimise(line.moved(&[0.0; PARAMETERS], limits), free, steps, LEAST_FALL, moved, evaluate)
}

/// A step no longer than one radian in bearing and a factor e in `|q|` and `v`, direction kept.
fn bounded(step: &[f64; PARAMETERS]) -> [f64; PARAMETERS] {
    let longest = step[0].abs().max(step[2].abs()).max(step[3].abs()).max(step[4].abs());
    let scale = if longest > 1.0 { 1.0 / longest } else { 1.0 };
    step.map(|x| x * scale)
}
