//! Which stage's bins make which cell, and when a band is wide enough to be told.
//!
//! Stage s runs at the rate over 8ˢ, so its bins are 8ˢ times as fine and its windows 8ˢ times as long. A frequency that two
//! stages show is taken from both, with weights that sum to one and change slowly against the coarser bins: so the sum over
//! neighbouring cells neither loses nor doubles a tone between them. A bin stands for half a bin to either side of it, and
//! belongs to cells by the share of that. Percentiles are of single snapshots, which the stages do not have in common:
//! there a cell is all of the stage that has more weight in its middle.

use super::bands::{self, IN_DECIDECADE, edge_hz, middle_hz};
use super::decimate::{FACTOR, Filters, PASS};
use super::lanes::Lanes;
use super::transform::{BINS, HOP, LENGTH, NOISE_BINS};
use crate::math;
use core::ops::Range;

/// Most stages.
pub const STAGES: usize = 4;

/// Most cells: four stages' span, 4.2 decades, and what aligns them to a decidecade.
pub const CELLS: usize = 176;

/// Least width of a decidecade, bins: from here on its shape is within class 1 of IEC 61260-1 (`class_tests`).
const LEAST_BINS: f64 = 4.0;

/// Where a stage begins to yield to the one before it, in units of its rate; at [`PASS`] it has.
const YIELDS: f64 = 0.2;

/// Least length of a snapshot, s.
const SNAPSHOT_S: f64 = 1.0;

/// Windows of a second from which on they stand side by side instead of overlapping: there are enough of them, and half the
/// work.
const SIDE_BY_SIDE: f64 = 10.0;

/// Longest interval, s.
const LONGEST_S: f64 = 86_400.0;

/// Why there is no plan.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The rate (Hz) is none.
    #[error("levels cannot be made of {0} samples a second")]
    Rate(f64),
    /// The interval (s) is too short for this rate, or too long; what is allowed, s.
    #[error("levels over {0} s: {1:.3} to {2} s are possible at this rate")]
    Interval(f64, f64, f64),
}

/// What follows from rate and interval.
#[derive(Clone, Debug)]
pub struct Plan {
    pub(super) rate_hz: f64,
    /// Instants of an interval.
    pub(super) interval: u64,
    /// Least magnitude of a code that is clipped.
    pub(super) clip: u32,
    /// Of codes squared to full scale squared.
    pub(super) scale: f32,
    pub(super) stages: usize,
    /// Pairs of windows of a snapshot, by stage.
    pub(super) pairs: [u32; STAGES],
    /// From one window of a pair to the other, by stage, samples.
    pub(super) apart: [usize; STAGES],
    pub(super) filters: Filters,
    first_cell: i32,
    cells: usize,
    /// Edges of the cells, Hz, from the first one's lower edge on.
    edges: [f64; CELLS + 1],
}

impl Plan {
    /// Levels over `interval_s` of a recording at `rate_hz`, whose codes are clipped at `full_scale` − 1.
    ///
    /// # Errors
    /// [`PlanError`].
    pub fn new(rate_hz: f64, full_scale: i32, interval_s: f64) -> Result<Self, PlanError> {
        if !(rate_hz > 1.0 && rate_hz < 1e6) {
            return Err(PlanError::Rate(rate_hz));
        }
        let apart = |stage_hz: f64| if stage_hz >= SIDE_BY_SIDE * LENGTH as f64 { LENGTH } else { HOP };
        // Two pairs of windows.
        let longest = |stage_hz: f64| (3 * apart(stage_hz) + LENGTH) as f64 / stage_hz;
        let shortest_s = longest(rate_hz);
        if !(shortest_s..=LONGEST_S).contains(&interval_s) {
            return Err(PlanError::Interval(interval_s, shortest_s, LONGEST_S));
        }
        let (mut stages, mut last_hz, mut pairs) = (0, rate_hz, [1; STAGES]);
        let (mut stage_hz, mut aparts) = (rate_hz, [HOP; STAGES]);
        for (pairs, own_apart) in pairs.iter_mut().zip(&mut aparts) {
            // A stage's windows begin anew with each interval.
            if longest(stage_hz) > interval_s {
                break;
            }
            *own_apart = apart(stage_hz);
            *pairs = math::f64::ceil(SNAPSHOT_S * stage_hz / (2 * *own_apart) as f64) as u32;
            (stages, last_hz, stage_hz) = (stages + 1, stage_hz, stage_hz / FACTOR as f64);
        }
        let share = edge_hz(IN_DECIDECADE) - edge_hz(0);
        let lowest_hz = LEAST_BINS * last_hz / LENGTH as f64 / (share / bands::decidecade_hz(0));
        let first_cell = IN_DECIDECADE * math::f64::ceil(10.0 * math::f64::log10(lowest_hz) - 1e-9) as i32;
        let end = math::f64::floor(40.0 * math::f64::log10(0.5 * rate_hz) + 1e-9) as i32 + 2;
        let full_scale = full_scale.max(2);
        let mut edges = [0.0; CELLS + 1];
        edges.iter_mut().zip(first_cell..).for_each(|(edge, cell)| *edge = edge_hz(cell));
        Ok(Self {
            rate_hz,
            interval: math::f64::round(interval_s * rate_hz) as u64,
            clip: full_scale.unsigned_abs() - 1,
            scale: 1.0 / (full_scale as f32 * full_scale as f32),
            stages,
            pairs,
            apart: aparts,
            filters: Filters::new(),
            first_cell,
            cells: (end.saturating_sub(first_cell).max(0) as usize).min(CELLS),
            edges,
        })
    }

    /// Cells that are measured, by their numbers.
    pub fn cells(&self) -> Range<i32> {
        self.first_cell..self.first_cell + self.cells as i32
    }

    /// Decidecades that are measured: those that are wide enough and end below half the rate.
    pub fn decidecades(&self) -> Range<i32> {
        self.first_cell / IN_DECIDECADE..self.cells().end / IN_DECIDECADE
    }

    /// Place of a cell in reports.
    pub fn place(&self, cell: i32) -> Option<usize> {
        self.cells().contains(&cell).then(|| (cell - self.first_cell) as usize)
    }

    /// Lower edge of the first and upper edge of the last of some of the cells that are measured, Hz.
    pub(super) fn edges_hz(&self, cells: &Range<i32>) -> Range<f64> {
        let edge = |cell: i32| {
            let place = usize::try_from(cell - self.first_cell).ok();
            place.and_then(|place| self.edges.get(place)).copied().unwrap_or(0.0)
        };
        edge(cells.start)..edge(cells.end)
    }

    /// Whether a cell is as wide as the noise bandwidth of the window, so that its spectral density is one.
    pub fn is_resolved(&self, cell: i32) -> bool {
        let width_hz = edge_hz(cell + 1) - edge_hz(cell);
        width_hz >= NOISE_BINS * self.bin_hz(self.stage_of(middle_hz(cell)))
    }

    /// Standard deviation that a band's level has in Gaussian noise, dB, from the transforms that each stage took: mean of n
    /// Hann windows and B bins, whose powers are correlated (Harris 1978, table 1 and equation 15): by
    /// 0.028 from window to next where they overlap by half, 0.44 and 0.028 from bin to the next two.
    pub fn sd_db(&self, band_hz: Range<f64>, transforms: &[u32; STAGES]) -> f64 {
        const DB: f64 = 10.0 / core::f64::consts::LN_10;
        let stage = self.stage_of(math::f64::sqrt(band_hz.start * band_hz.end));
        let bins = (band_hz.end - band_hz.start) / self.bin_hz(stage);
        let windows = transforms.get(stage).copied().unwrap_or(0);
        let overlapping = self.apart.get(stage).is_none_or(|apart| *apart < LENGTH);
        let of_windows = if overlapping { 1.056 } else { 1.0 };
        DB * math::f64::sqrt(of_windows * 1.944 / (bins * f64::from(windows)))
    }

    fn bin_hz(&self, stage: usize) -> f64 {
        self.stage_hz(stage) / LENGTH as f64
    }

    fn stage_hz(&self, stage: usize) -> f64 {
        self.rate_hz / f64::from(1u32 << (3 * stage.min(STAGES)))
    }

    /// The stage that has most weight at a frequency.
    pub(super) fn stage_of(&self, f_hz: f64) -> usize {
        let middle = 0.5 * (YIELDS + PASS);
        (1..self.stages).rev().find(|s| f_hz < middle * self.stage_hz(*s)).unwrap_or(0)
    }

    /// Mean square within edges of one stage's spectrum alone.
    pub(super) fn within(&self, bins: &[Lanes; BINS], stage: usize, band_hz: Range<f64>) -> Lanes {
        self.sum(bins, stage, band_hz, |_| 1.0)
    }

    /// A stage's part of the mean square within edges, and whether it has any.
    pub(super) fn part(&self, bins: &[Lanes; BINS], stage: usize, band_hz: Range<f64>) -> Option<Lanes> {
        let hz = self.stage_hz(stage);
        let fades = |f: f64, s: usize| if s == 0 { 1.0 } else { fade(f / self.stage_hz(s)) };
        let next = |f: f64| if stage + 1 < self.stages { fades(f, stage + 1) } else { 0.0 };
        if fades(band_hz.start, stage) == 0.0 || next(band_hz.end) == 1.0 {
            return None;
        }
        let weight = |k: usize| {
            let f = k as f64 * hz / LENGTH as f64;
            fades(f, stage) * (1.0 - next(f))
        };
        Some(self.sum(bins, stage, band_hz, weight))
    }

    fn sum(
        &self,
        bins: &[Lanes; BINS],
        stage: usize,
        band_hz: Range<f64>,
        weight: impl Fn(usize) -> f64,
    ) -> Lanes {
        let bin_hz = self.bin_hz(stage);
        let (from, to) = (band_hz.start / bin_hz, band_hz.end / bin_hz);
        let first = math::f64::floor(from + 0.5).max(0.0) as usize;
        let mut sum = Lanes::ZERO;
        for (k, bin) in bins.iter().enumerate().skip(first) {
            let (low, high) = (k as f64 - 0.5, k as f64 + 0.5);
            if low >= to {
                break;
            }
            sum += *bin * ((high.min(to) - low.max(from)) * weight(k)) as f32;
        }
        sum
    }
}

/// Weight of a stage against the one before it: 1 up to [`YIELDS`], 0 from [`PASS`], a cosine between.
fn fade(share: f64) -> f64 {
    let x = ((share - YIELDS) / (PASS - YIELDS)).clamp(0.0, 1.0);
    0.5 + 0.5 * math::f64::cos(math::f64::PI * x)
}
