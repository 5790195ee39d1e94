//! The radial detector: the likelihood of range and radial speed from the cepstra of a stretch of time [O 18, 19].
//!
//! Enters: the interference model's log ratios of each frame. Leaves: their sum over the frames along
//! `r + v (t_m − t0)`, on cells of 140 m × 1 m/s. Between model ranges the ratio is read by Lagrange's cubic, since it
//! oscillates with a period of about 300 m. A cell holds the better of its two model ranges, less 0.4 (between the
//! mean and the maximum of two). Cost: 27 × 716 × 6 frames × 8 instructions = 1 M a minute.

use super::interference::{Envelope, Interference};
use super::limits::{
    MAX_SPEED_M_S, MINUTE_FRAMES, MODEL_RANGES, RANGE_CELLS, RANGE_STEP_M, SPEED_STEP_M_S, SPEEDS,
    WINDOW_FRAMES,
};
use crate::math;

/// Steps of a stored log ratio: 1/256, so that ±127 fits 16 bits (one frame never says more).
pub(super) const ROW_UNIT: f32 = 1.0 / 256.0;

/// Ranges read at a time.
const BLOCK: usize = 64;

/// Log-likelihood ratio on the grid of radial speeds and ranges.
pub type Grid = [[f32; RANGE_CELLS]; SPEEDS];

/// Work space.
#[derive(Clone, Debug)]
pub struct RadialScratch {
    pub(super) rows: [[i16; MODEL_RANGES]; MINUTE_FRAMES],
    /// When each frame was, s after the time the result is for.
    pub(super) window_offset_s: [f32; WINDOW_FRAMES],
    pub(super) frames: usize,
    pub(super) sum: [f32; MODEL_RANGES],
    pub(super) envelope: Envelope,
    /// What [`RadialScratch::fill`] made.
    pub grid: Grid,
}

impl Default for RadialScratch {
    fn default() -> Self {
        Self::new()
    }
}

impl RadialScratch {
    /// All zeros.
    pub const fn new() -> Self {
        Self {
            rows: [[0; MODEL_RANGES]; MINUTE_FRAMES],
            window_offset_s: [0.0; WINDOW_FRAMES],
            frames: 0,
            sum: [0.0; MODEL_RANGES],
            envelope: Envelope::new(),
            grid: [[0.0; RANGE_CELLS]; SPEEDS],
        }
    }
}

/// Radial speed of grid row `k`, m/s.
pub fn speed_of(k: usize) -> f32 {
    SPEED_STEP_M_S * k as f32 - MAX_SPEED_M_S
}

/// Weights of values at −1, 0, 1, 2 for the cubic through them, read at `x` between 0 and 1.
pub(super) fn cubic(x: f32) -> [f32; 4] {
    [
        -x * (x - 1.0) * (x - 2.0) / 6.0,
        (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
        -(x + 1.0) * x * (x - 2.0) / 2.0,
        (x + 1.0) * x * (x - 1.0) / 6.0,
    ]
}

impl RadialScratch {
    /// Forgets the frames.
    pub fn clear(&mut self) {
        self.frames = 0;
    }

    /// Frames held.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Adds a frame, `offset_s` after the time the result is for.
    pub fn add(&mut self, model: &Interference, cepstrum: impl Iterator<Item = f32>, offset_s: f32) {
        model.envelope(cepstrum, &mut self.envelope);
        model.log_ratio(&self.envelope, &mut self.sum);
        if let (Some(row), Some(t)) =
            (self.rows.get_mut(self.frames), self.window_offset_s.get_mut(self.frames))
        {
            row.iter_mut()
                .zip(&self.sum)
                .for_each(|(r, g)| *r = (g / ROW_UNIT).clamp(-32_767.0, 32_767.0) as i16);
            *t = offset_s;
            self.frames += 1;
        }
    }

    /// Sum over the frames for a radial speed, at every model range, in `self.sum`.
    fn along(&mut self, speed_m_s: f32) {
        self.sum = [0.0; MODEL_RANGES];
        let mut near = [0f32; BLOCK + 3];
        for (row, t) in self.rows.iter().zip(&self.window_offset_s).take(self.frames) {
            let shift = speed_m_s * t / RANGE_STEP_M;
            let whole = math::f32::floor(shift);
            let x = shift - whole;
            let w = cubic(x).map(|w| w * ROW_UNIT);
            // First of the four for range 0; ranges whose four are not all in the model get nothing.
            let first = whole as isize - 1;
            let (skip, from) = if first < 0 { (first.unsigned_abs(), 0) } else { (0, first.unsigned_abs()) };
            let row = row.get(from..).unwrap_or_default();
            let sum = self.sum.get_mut(skip..).unwrap_or_default();
            // In blocks, so that each stored value becomes a float once and not four times.
            let blocks = sum.chunks_mut(BLOCK).zip(row.chunks(BLOCK)).enumerate();
            for (n, (sum, _)) in blocks {
                let stored = row.get(n * BLOCK..).unwrap_or_default();
                near.iter_mut().zip(stored).for_each(|(x, r)| *x = f32::from(*r));
                let ranges = stored.len().min(BLOCK + 3).saturating_sub(3);
                let part = |k: usize| near.get(k..k + ranges).unwrap_or_default();
                let reads = part(0).iter().zip(part(1)).zip(part(2)).zip(part(3));
                for (sum, (((a, b), c), d)) in sum.iter_mut().zip(reads) {
                    *sum += w[0] * a + w[1] * b + w[2] * c + w[3] * d;
                }
            }
        }
    }

    /// Fills the grid from the frames added.
    pub fn fill(&mut self) {
        for k in 0..SPEEDS {
            self.along(speed_of(k));
            if let Some(row) = self.grid.get_mut(k) {
                for (cell, pair) in row.iter_mut().zip(self.sum.chunks_exact(2)) {
                    *cell = pair.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b)) - 0.4;
                }
            }
        }
    }
}
