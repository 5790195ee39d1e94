//! The joint search: where on the sphere do the correlations of all six pairs peak together?
//!
//! Enters: whitened cross-spectra `ĝ_ij`. Leaves: the direction of the highest summed correlation
//! `Σ_p R_p(τ_p(u))`, to a sixth of the coarse lattice, for the refinement to start from.
//!
//! The six correlations come from three complex inverse transforms (two pairs share one), at half-sample lags. The coarse
//! lattice (four resolution cells apart) looks up correlations pooled by their maximum over all delays its cell can
//! hold: an upper bound for the cell, valid for any spectrum, so no peak falls between lattice points. The best few
//! cells are then searched finely on the correlations themselves.
//! Cost at 64 kHz: 280 000 instructions for the transforms, about 400 000 for the lattice, 50 000 for the cells.

use super::plan::{BINS, Band, FRAME, MAX_DELAY, Plan};
use super::spectra::Spectra;
use super::transform::Work;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::math::f32 as m;
use microfft::Complex32;

/// Lags kept: ± [`MAX_DELAY`] samples in half samples.
const LAGS: usize = 4 * MAX_DELAY + 1;
/// Lags between entries of the pooled tables.
const POOL_STRIDE: usize = 4;
/// Entries of a pooled table.
const POOLED: usize = (LAGS - 1) / POOL_STRIDE + 1;
/// Transform length: twice the frame, for half-sample lags.
const LENGTH: usize = 2 * FRAME;
/// Coarse cells searched finely. The pooled bound is loose; a true peak at the detection threshold ranks within them.
const CELLS: usize = 16;
/// Widest lattice, radians: four cells of the whole band, or what the pooled tables can hold.
const WIDEST_RAD: f32 = 0.14;
/// Fine points on each side of a cell's centre.
const FINE: i32 = 3;

/// Work space of the search beside the transform's (15 KiB).
#[derive(Clone, Debug)]
pub(crate) struct SearchWork {
    lags: [[f32; LAGS]; PAIR_COUNT],
    pooled: [[f32; POOLED]; PAIR_COUNT],
}

/// A point of the search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub(crate) score: f32,
    pub(crate) direction: Direction,
}

impl SearchWork {
    pub(crate) const fn new() -> Self {
        Self { lags: [[0.0; LAGS]; PAIR_COUNT], pooled: [[0.0; POOLED]; PAIR_COUNT] }
    }

    /// The direction of the highest summed correlation, for wavefronts of this curvature, in a band.
    pub(crate) fn best(
        &mut self,
        plan: &Plan,
        band: &Band,
        whitened: &Spectra,
        curvature: f32,
        work: &mut Work,
    ) -> Candidate {
        self.correlate(band, whitened, work);
        let spacing = (4.0 * band.resolution).clamp(0.03, WIDEST_RAD);
        self.pool(plan, spacing);
        let cells = self.coarse(plan, curvature, spacing);
        let mut best = Candidate { score: f32::MIN, direction: [0.0, 1.0, 0.0] };
        for cell in cells.iter().filter(|c| c.score > f32::MIN) {
            let fine = self.fine(plan, curvature, spacing / (2 * FINE) as f32, &cell.direction);
            if fine.score > best.score {
                best = fine;
            }
        }
        best
    }

    /// The pair's own highest correlation over all lags kept, also those longer than its distance allows (a sign of
    /// swapped channels): its delay in seconds and value.
    pub(crate) fn pair_peak(&self, plan: &Plan, pair: usize) -> (f32, f32) {
        let (mut best, mut at) = (f32::MIN, 0);
        for (n, r) in self.lags.get(pair).into_iter().flatten().enumerate() {
            if *r > best {
                (best, at) = (*r, n);
            }
        }
        ((at as f32 - (LAGS / 2) as f32) / (2.0 * plan.rate_hz), best)
    }

    /// The pair's correlation at a delay in seconds.
    pub(crate) fn pair_value(&self, plan: &Plan, pair: usize, delay: f32) -> f32 {
        self.lags.get(pair).map_or(0.0, |table| lookup(table, delay * 2.0 * plan.rate_hz))
    }

    /// Correlations at half-sample lags: `R(n) = Re Σ_k ĝ(k) e^{+2πikn/1024}`.
    fn correlate(&mut self, band: &Band, whitened: &Spectra, work: &mut Work) {
        let [r01, r02, r03, r12, r13, r23] = &whitened.re;
        let [i01, i02, i03, i12, i13, i23] = &whitened.im;
        let [l01, l02, l03, l12, l13, l23] = &mut self.lags;
        let (low, high) = (band.incoherent, band.high);
        correlate_two(work, low, high, [(r01, i01), (r02, i02)], [l01, l02]);
        correlate_two(work, low, high, [(r03, i03), (r12, i12)], [l03, l12]);
        correlate_two(work, low, high, [(r13, i13), (r23, i23)], [l13, l23]);
    }

    /// Maximum over the delays that a cell of the lattice can hold.
    fn pool(&mut self, plan: &Plan, spacing: f32) {
        for ((pooled, lags), crossing) in self.pooled.iter_mut().zip(&self.lags).zip(&plan.crossing_s) {
            // Blocks of a stride first, then windows of blocks: a fifth of the comparisons of windows of lags.
            let mut blocks = [f32::MIN; POOLED];
            for (block, lags) in blocks.iter_mut().zip(lags.chunks(POOL_STRIDE)) {
                *block = lags.iter().fold(f32::MIN, |a, b| if *b > a { *b } else { a });
            }
            let reach = 0.71 * spacing * crossing * 2.0 * plan.rate_hz;
            let half = (m::ceil(reach) as usize + POOL_STRIDE / 2).min(64) / POOL_STRIDE + 1;
            for (n, value) in pooled.iter_mut().enumerate() {
                let first = n.saturating_sub(half);
                let window = blocks.iter().skip(first).take(n + half - first);
                *value = window.fold(f32::MIN, |a, b| if *b > a { *b } else { a });
            }
        }
    }

    /// The best cells of the coarse lattice (rings of elevation, spokes of azimuth).
    fn coarse(&self, plan: &Plan, curvature: f32, spacing: f32) -> [Candidate; CELLS] {
        let mut cells = [Candidate { score: f32::MIN, direction: [0.0; 3] }; CELLS];
        let mut worst = f32::MIN;
        let scale = 2.0 * plan.rate_hz / POOL_STRIDE as f32;
        let bottom = m::asin(plan.elevation.0.clamp(-1.0, 1.0));
        let top = m::asin(plan.elevation.1.clamp(-1.0, 1.0));
        let rings = (m::ceil((top - bottom) / spacing) as u32).clamp(1, 200);
        let ring_step = (top - bottom) / rings as f32;
        for ring in 0..rings {
            let (sz, cz) = m::sin_cos(bottom + (ring as f32 + 0.5) * ring_step);
            let spokes = (m::ceil(m::TAU * cz / spacing) as u32).clamp(1, 400);
            let (ds, dc) = m::sin_cos(m::TAU / spokes as f32);
            let (mut s, mut c) = (0.0f32, 1.0f32);
            for _ in 0..spokes {
                let direction = [cz * s, cz * c, sz];
                let t = wavefront::arrivals_quick(&plan.geometry, plan.inv_c, &direction, curvature);
                let mut score = 0.0;
                for (table, tau) in self.pooled.iter().zip(&wavefront::pair_delays(&t)) {
                    let at = tau * scale + (POOLED / 2) as f32 + 0.5;
                    score += table[(at as usize).min(POOLED - 1)];
                }
                if score > worst {
                    worst = keep(&mut cells, Candidate { score, direction });
                }
                (s, c) = (s * dc + c * ds, c * dc - s * ds);
            }
        }
        cells
    }

    /// The best point of a fine grid about a cell's centre.
    fn fine(&self, plan: &Plan, curvature: f32, step: f32, centre: &Direction) -> Candidate {
        let e = wavefront::tangents(centre);
        let scale = 2.0 * plan.rate_hz;
        let mut best = Candidate { score: f32::MIN, direction: *centre };
        for a in -FINE..=FINE {
            for b in -FINE..=FINE {
                let direction = wavefront::stepped(centre, &e, a as f32 * step, b as f32 * step);
                if direction[2] < plan.elevation.0 || direction[2] > plan.elevation.1 {
                    continue;
                }
                let t = wavefront::arrivals_quick(&plan.geometry, plan.inv_c, &direction, curvature);
                let mut score = 0.0;
                for (table, tau) in self.lags.iter().zip(&wavefront::pair_delays(&t)) {
                    score += lookup(table, tau * scale);
                }
                if score > best.score {
                    best = Candidate { score, direction };
                }
            }
        }
        best
    }
}

/// Two pairs' correlations by one complex transform: `Z = ĝ_a + i ĝ_b` on both halves of the spectrum.
fn correlate_two(
    work: &mut Work,
    low: usize,
    high: usize,
    pairs: [(&[f32; BINS], &[f32; BINS]); 2],
    lags: [&mut [f32; LAGS]; 2],
) {
    work.fill(Complex32::new(0.0, 0.0));
    let [(re_a, im_a), (re_b, im_b)] = pairs;
    let (positive, negative) = work.split_at_mut(LENGTH / 2);
    let bins = positive.iter_mut().zip(re_a).zip(im_a).zip(re_b).zip(im_b).take(high).skip(low);
    for ((((z, ra), ia), rb), ib) in bins {
        // Conjugated, because the forward transform is used: it gives R(−n) of the spectrum, R(n) of its conjugate.
        *z = Complex32::new(ra + ib, rb - ia);
    }
    let bins = negative.iter_mut().rev().zip(re_a.iter().skip(1)).zip(im_a.iter().skip(1));
    let bins = bins.zip(re_b.iter().skip(1)).zip(im_b.iter().skip(1));
    for ((((z, ra), ia), rb), ib) in bins.take(high.saturating_sub(1)).skip(low.saturating_sub(1)) {
        *z = Complex32::new(ra - ib, rb + ia);
    }
    let z = microfft::complex::cfft_1024(work);
    let [lag_a, lag_b] = lags;
    let half = LAGS / 2;
    let order = z[LENGTH - half..].iter().chain(z[..=half].iter());
    for ((a, b), z) in lag_a.iter_mut().zip(lag_b.iter_mut()).zip(order) {
        // Half of R: the sum over negative frequencies equals that over positive ones.
        *a = 0.5 * z.re;
        *b = 0.5 * z.im;
    }
}

/// Linear interpolation in a lag table at `x` half samples.
#[inline]
fn lookup(table: &[f32; LAGS], x: f32) -> f32 {
    let at = x + (LAGS / 2) as f32;
    let n = (at as usize).min(LAGS - 2);
    let part = at - n as f32;
    table[n] + part * (table[n + 1] - table[n])
}

/// Puts a candidate in the place of the worst kept one; returns the lowest score still kept.
fn keep(cells: &mut [Candidate; CELLS], new: Candidate) -> f32 {
    let worst = cells
        .iter()
        .enumerate()
        .fold((f32::MAX, 0), |worst, (n, cell)| if cell.score < worst.0 { (cell.score, n) } else { worst });
    if let Some(cell) = cells.get_mut(worst.1) {
        *cell = new;
    }
    cells.iter().fold(f32::MAX, |a, c| a.min(c.score))
}
