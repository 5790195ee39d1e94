//! The radial detector: the likelihood of range and radial speed from the cepstra of a stretch of time [O 18, 19].
//!
//! Enters: the interference model's log ratios of each frame. Leaves: their sum over the frames along
//! `r + v (t_m − t0)`, on cells of 140 m × 1 m/s. Between model ranges the ratio is read by Lagrange's cubic, since it
//! oscillates with a period of about 300 m. A cell holds the better of its two model ranges, less 0.4 (between the
//! mean and the maximum of two); where in its cell a vessel is that is there, the frames tell once more, at places 35 m apart. Cost: 27 × 716 × 6 frames × 8 instructions = 1 M a minute.

use super::interference::Interference;
use super::limits::{
    CELL_M, MAX_SPEED_M_S, MINUTE_FRAMES, MODEL_RANGES, RANGE_STEP_M, SPEED_STEP_M_S, WINDOW_FRAMES,
};
use super::presence::range_of;
use super::shared::{Envelope, Grid};
use crate::math;

/// Steps of a stored log ratio: 1/256, so that ±127 fits 16 bits (one frame never says more).
pub(super) const ROW_UNIT: f32 = 1.0 / 256.0;

/// Ranges read at a time.
const BLOCK: usize = 64;

/// These and the neighbours that the cubic needs.
const NEAR: usize = BLOCK + 3;

/// Steps of the grid: 1/32, so that ±1024 fits 16 bits.
pub const GRID_UNIT: f32 = 1.0 / 32.0;

/// Places in a range cell at which its log ratios are read to tell where in it a vessel is, and the distance between them, m.
const PLACES: usize = 4;
const PLACE_M: f32 = CELL_M / PLACES as f32;

/// Error of a place that the likelihood does not know of, m: ranges of 10 to 15 km scatter by 15 m where it says 10.
const UNSAID_M: f32 = 10.0;

/// A log ratio as the grid keeps it, rounded to the nearest step.
pub(super) fn coded(log_ratio: f32) -> i16 {
    // Counted from the least, so that what is cut to a whole number is never negative.
    math::count(log_ratio * (1.0 / GRID_UNIT) + 32_768.5).wrapping_sub(0x8000).cast_signed()
}

/// Work space.
#[derive(Clone, Debug)]
pub struct RadialScratch {
    pub(super) rows: [[i16; MODEL_RANGES]; MINUTE_FRAMES],
    /// When each frame was, s after the time the result is for.
    pub(super) window_offset_s: [f32; WINDOW_FRAMES],
    pub(super) frames: usize,
    pub(super) sum: [f32; MODEL_RANGES],
}

impl RadialScratch {
    /// All zeros.
    pub const fn new() -> Self {
        Self {
            rows: [[0; MODEL_RANGES]; MINUTE_FRAMES],
            window_offset_s: [0.0; WINDOW_FRAMES],
            frames: 0,
            sum: [0.0; MODEL_RANGES],
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
    pub fn add(
        &mut self,
        model: &Interference<'_>,
        envelope: &mut Envelope,
        cepstrum: impl Iterator<Item = f32>,
        offset_s: f32,
    ) {
        model.envelope(cepstrum, envelope);
        model.log_ratio(envelope, &mut self.sum);
        if let (Some(row), Some(t)) =
            (self.rows.get_mut(self.frames), self.window_offset_s.get_mut(self.frames))
        {
            row.iter_mut().zip(&self.sum).for_each(|(r, g)| *r = row_code(*g));
            *t = offset_s;
            self.frames += 1;
        }
    }

    /// Fills the grid from the frames added.
    pub fn fill(&mut self, grid: &mut Grid) {
        for (k, cells) in grid.iter_mut().enumerate() {
            self.sum = [0.0; MODEL_RANGES];
            for (row, t) in self.rows.iter().zip(&self.window_offset_s).take(self.frames) {
                add_shifted(row, speed_of(k) * t / RANGE_STEP_M, &mut self.sum);
            }
            for (cell, [a, b]) in cells.iter_mut().zip(self.sum.as_chunks::<2>().0) {
                *cell = coded(math::greater(*a, *b) - 0.4);
            }
        }
    }
}

impl RadialScratch {
    /// Where in a range cell a vessel is that is there, by the frames added, if its radial speed is that of row `k` and its echoes have a share of the
    /// table's strengths: m from the cell's middle, and variance, m². A cell is as wide as half a period of the likelihood, and
    /// a posterior that is one cell wide says no more than which.
    pub(super) fn within(&self, cell: usize, k: usize, share: f32) -> (f32, f32) {
        let place = |n: usize| PLACE_M * (n as f32 + 0.5) - 0.5 * CELL_M;
        let log: [f32; PLACES] =
            core::array::from_fn(|n| share * self.log_ratio(range_of(cell) + place(n), speed_of(k)));
        let most = log.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b));
        let (mut sum, mut mean, mut square) = (0f32, 0f32, 0f32);
        for (n, log) in log.iter().enumerate() {
            let (likely, place) = (math::f32::exp(log - most), place(n));
            sum += likely;
            mean += likely * place;
            square += likely * place * place;
        }
        let mean = mean / sum;
        (mean, (square / sum - mean * mean).max(0.0) + PLACE_M * PLACE_M / 12.0 + UNSAID_M * UNSAID_M)
    }

    /// The frames' log ratio of a vessel at a range and a radial speed, read by the cubic; nothing of frames that have it off the model.
    fn log_ratio(&self, range_m: f32, speed_m_s: f32) -> f32 {
        let frames = self.rows.iter().zip(&self.window_offset_s).take(self.frames);
        let of_frame = frames.map(|(row, t)| {
            let at = (range_m + speed_m_s * t) / RANGE_STEP_M;
            let whole = math::f32::floor(at);
            let first = if whole >= 1.0 { (whole - 1.0) as usize } else { usize::MAX };
            let near = row.get(first..).and_then(|row| row.first_chunk::<4>());
            near.map_or(0.0, |near| {
                cubic(at - whole).iter().zip(near).map(|(w, r)| w * f32::from(*r)).sum::<f32>()
            })
        });
        ROW_UNIT * of_frame.sum::<f32>()
    }
}

/// A frame's log ratio as a row keeps it.
pub(super) fn row_code(log_ratio: f32) -> i16 {
    math::code(log_ratio / ROW_UNIT)
}

/// Adds to `sum` at each model range what a row says `shift` ranges farther, read by the cubic.
pub(super) fn add_shifted(row: &[i16], shift: f32, sum: &mut [f32; MODEL_RANGES]) {
    let whole = math::f32::floor(shift);
    let w = cubic(shift - whole).map(|w| w * ROW_UNIT);
    // First of the four for range 0; ranges whose four are not all in the model get nothing.
    let first = whole as isize - 1;
    let (skip, from) = if first < 0 { (first.unsigned_abs(), 0) } else { (0, first.unsigned_abs()) };
    let row = row.get(from..).unwrap_or_default();
    let sum = sum.get_mut(skip..).unwrap_or_default();
    // In blocks, so that each stored value becomes a float once and not four times.
    for (n, sum) in sum.chunks_mut(BLOCK).enumerate() {
        let stored = row.get(n * BLOCK..).unwrap_or_default();
        match (sum.first_chunk_mut::<BLOCK>(), stored.first_chunk::<NEAR>()) {
            (Some(sum), Some(stored)) => add_read(&stored.map(f32::from), &w, sum),
            _ => {
                let mut near = [0f32; NEAR];
                near.iter_mut().zip(stored).for_each(|(x, r)| *x = f32::from(*r));
                let ranges = stored.len().saturating_sub(3).min(sum.len());
                add_read(&near, &w, sum.get_mut(..ranges).unwrap_or_default());
            }
        }
    }
}

/// Adds to the sums what a cubic of these weights reads about each; whole blocks are known to be that.
#[inline(always)]
fn add_read(near: &[f32; NEAR], w: &[f32; 4], sum: &mut [f32]) {
    let part = |k: usize| near.get(k..k + BLOCK).unwrap_or_default();
    let reads = part(0).iter().zip(part(1)).zip(part(2)).zip(part(3));
    for (sum, (((a, b), c), d)) in sum.iter_mut().zip(reads) {
        *sum += w[0] * a + w[1] * b + w[2] * c + w[3] * d;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_in_a_cell_a_vessel_is_shows_as_far_as_the_frames_tell() {
        let mut radial = RadialScratch::new();
        // Six frames of a likelihood that oscillates with 300 m, greatest at 20 020 m for what leaves at 5 m/s.
        let (at_m, speed_m_s) = (20_020.0f32, 5.0f32);
        for n in 0..6 {
            let t = 10.0 * n as f32 - 25.0;
            for (j, r) in radial.rows[n].iter_mut().enumerate() {
                let off = RANGE_STEP_M * j as f32 - at_m - speed_m_s * t;
                *r = row_code(3.0 * math::f32::cos(math::f32::TAU * off / 300.0));
            }
            radial.window_offset_s[n] = t;
        }
        radial.frames = 6;
        let (k, cell) = (18, 143);
        assert_eq!(speed_of(k), speed_m_s);
        let (place, spread) = radial.within(cell, k, 0.8);
        let off = range_of(cell) + place - at_m;
        assert!(off.abs() < 15.0 && math::f32::sqrt(spread) < 25.0, "{off} ± {}", math::f32::sqrt(spread));
        // Of weak echoes hardly anything, and without frames nothing: a uniform law over the cell.
        assert!(radial.within(cell, k, 0.02).1 > 0.8 * CELL_M * CELL_M / 12.0);
        radial.frames = 0;
        let (place, spread) = radial.within(cell, k, 0.8);
        let uniform = CELL_M * CELL_M / 12.0 + UNSAID_M * UNSAID_M;
        assert!(place.abs() < 1e-3 && (spread / uniform - 1.0).abs() < 1e-3, "{place} {spread}");
    }

    #[test]
    fn the_grid_keeps_log_ratios_to_half_a_step() {
        for k in -3000..3000 {
            let x = 0.0417 * k as f32;
            assert!((f32::from(coded(x)) * GRID_UNIT - x).abs() <= 0.5 * GRID_UNIT + 1e-4, "{x}");
        }
        assert_eq!((coded(-5000.0), coded(5000.0)), (i16::MIN, i16::MAX));
    }
}
