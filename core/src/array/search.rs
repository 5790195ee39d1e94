//! The joint search: where on the sphere do the correlations of all six pairs peak together?
//!
//! Enters: whitened cross-spectra `ĝ_ij`. Leaves: the direction of the highest summed correlation
//! `Σ_p R_p(τ_p(u))`, to a sixth of the coarse lattice, for the refinement to start from.
//!
//! The six correlations come from three complex inverse transforms (two pairs share one), at half-sample lags, and are kept
//! in 16 bits. The coarse lattice (four resolution cells apart) looks up correlations pooled by their maximum over all
//! delays its cell can hold: an upper bound for the cell, valid for any spectrum, so no peak falls between lattice points.
//! The best few cells are then searched finely on the correlations themselves. Delays are numbers with a fixed point, so
//! that a lookup takes four instructions.
//! Cost at 64 kHz: 190 000 instructions for the transforms, about 260 000 for the lattice, 90 000 for the cells.

use super::plan::{Band, FRAME, MAX_DELAY, Plan};
use super::spectra::{RUNS, Spectra};
use super::transform::{self, RUN, Work};
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::math::f32 as m;
use core::cell::Cell;
use microfft::Complex32;

/// Lags kept: ± [`MAX_DELAY`] samples in half samples, without the last.
const LAGS: usize = 4 * MAX_DELAY;
/// Lags of an entry of the pooled tables.
const POOL_STRIDE: usize = 4;
/// Entries of a pooled table.
const POOLED: usize = LAGS / POOL_STRIDE;
/// Coarse cells searched finely. The pooled bound is loose; a true peak at the detection threshold ranks within them.
const CELLS: usize = 16;
/// Widest lattice, radians: four cells of the whole band, or what the pooled tables can hold.
const WIDEST_RAD: f32 = 0.14;
/// Fine points on each side of a cell's centre.
const FINE: i32 = 3;
/// Fine points across a cell.
const FINE_SPAN: usize = 2 * FINE as usize + 1;
/// A kept correlation of 1 in every bin. Whitened values are at most 1, twice that once a source is taken out of them.
const FULL: f32 = 16_000.0;
/// Bits behind the point of a delay: pooled entries on the lattice, half samples in a cell.
const COARSE_BITS: u32 = 16;
const FINE_BITS: u32 = 12;

/// Most places between two delays.
const MOST_STEPS: f32 = 64.0;

/// Share of the time that sound takes between two hydrophones within which they hear it at once.
const AT_ONCE: f32 = 0.05;

/// `e^{−2πik/1024}` of every bin: what half a sample turns it.
const HALF_SAMPLE: [Complex32; FRAME / 2] = transform::turns_of(2 * FRAME);

/// Work space of the search beside the transform's (8 KiB).
#[derive(Clone, Debug)]
pub(crate) struct SearchWork {
    /// Correlations in [`Self::unit`], and one more entry for the interpolation.
    lags: [[i16; LAGS + 1]; PAIR_COUNT],
    pooled: [[i16; POOLED]; PAIR_COUNT],
    unit: f32,
}

/// A pair's own extremes over all lags kept, also those longer than its distance allows (a sign of swapped channels).
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PairPeaks {
    /// Delay of the highest correlation, seconds.
    pub(crate) delay_s: f32,
    /// The highest correlation, summed over the band's bins (1 each where the pair is fully coherent).
    pub(crate) peak: f32,
    /// The lowest.
    pub(crate) trough: f32,
    /// Whether the two hear it at once.
    pub(crate) at_once: bool,
}

/// A point of the search; its score is the sum of kept correlations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    score: i32,
    pub(crate) direction: Direction,
}

/// Arrival time at one hydrophone, in parts of a delay's unit, against the position along the direction:
/// `t = at − along (slope + bend · along)`.
#[derive(Clone, Copy)]
struct Arrival {
    at: f32,
    slope: f32,
    bend: f32,
}

impl Arrival {
    /// Those of the four hydrophones, to second order in size over range ([`wavefront::arrivals`]).
    fn all(plan: &Plan, curvature: f32, units_per_s: f32) -> [Self; CHANNELS] {
        let slope = plan.inv_c * units_per_s;
        let bend = 0.5 * curvature * slope;
        plan.geometry.position_m.map(|h| Self { at: bend * wavefront::dot(&h, &h), slope, bend })
    }

    #[inline(always)]
    fn time(&self, along: f32) -> i32 {
        (self.at - along * (self.slope + self.bend * along)) as i32
    }
}

impl SearchWork {
    pub(crate) const fn new() -> Self {
        Self { lags: [[0; LAGS + 1]; PAIR_COUNT], pooled: [[0; POOLED]; PAIR_COUNT], unit: 0.0 }
    }

    /// The direction of the highest summed correlation ([`Self::correlate`]), for wavefronts of this curvature, in a band.
    #[inline(never)]
    pub(crate) fn best(&mut self, plan: &Plan, band: &Band, curvature: f32) -> Direction {
        let spacing = (4.0 * band.resolution).clamp(0.03, WIDEST_RAD);
        self.pool(plan, spacing);
        let cells = self.coarse(plan, curvature, spacing);
        let grid = Grid::new(plan, curvature, spacing / (2 * FINE) as f32);
        let mut best = Candidate { score: i32::MIN, direction: [0.0, 1.0, 0.0] };
        for cell in cells.iter().filter(|c| c.score > i32::MIN) {
            let fine = self.fine(plan, &grid, &cell.direction);
            if fine.score > best.score {
                best = fine;
            }
        }
        best.direction
    }

    /// What each pair's correlation shows by itself.
    pub(crate) fn pairs(&self, plan: &Plan) -> [PairPeaks; PAIR_COUNT] {
        let mut out = [PairPeaks::default(); PAIR_COUNT];
        let half_sample_s = 0.5 / plan.rate_hz;
        for ((out, lags), crossing_s) in out.iter_mut().zip(&self.lags).zip(&plan.crossing_s) {
            let (mut best, mut least, mut at) = (i16::MIN, i16::MAX, 0);
            for (n, r) in lags.iter().enumerate() {
                if *r > best {
                    (best, at) = (*r, n);
                }
                least = least.min(*r);
            }
            // A parabola through the peak and its neighbours.
            let beside = |n: usize| lags.get(n).map_or(f32::from(i16::MIN), |r| f32::from(*r));
            let (before, after) = (beside(at.wrapping_sub(1)), beside(at + 1));
            let bend = before - 2.0 * f32::from(best) + after;
            let shift = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
            let delay_s = (at as f32 + shift - (LAGS / 2) as f32) * half_sample_s;
            *out = PairPeaks {
                delay_s,
                peak: f32::from(best) * self.unit,
                trough: f32::from(least) * self.unit,
                at_once: m::abs(delay_s) < AT_ONCE * crossing_s,
            };
        }
        out
    }

    /// Leaves out the pairs with hydrophones not used.
    pub(crate) fn leave_out(&mut self, used: wavefront::Used) {
        for (p, lags) in self.lags.iter_mut().enumerate() {
            if !used.pair(p) {
                lags.fill(0);
            }
        }
    }

    /// Takes a hydrophone the other way round.
    #[inline(never)]
    pub(crate) fn turn(&mut self, hydrophone: usize) {
        for ((a, b), lags) in PAIRS.into_iter().zip(&mut self.lags) {
            if a == hydrophone || b == hydrophone {
                negate(lags);
            }
        }
    }

    /// The pair's correlation at a delay in seconds.
    #[inline(never)]
    pub(crate) fn pair_value(&self, plan: &Plan, pair: usize, delay: f32) -> f32 {
        let parts = (1u32 << FINE_BITS) as f32;
        let value =
            self.lags.get(pair).map_or(0, |table| lookup(table, (delay * 2.0 * plan.rate_hz * parts) as i32));
        value as f32 * self.unit / parts
    }

    /// The pair's highest correlation from one delay to another (seconds), looked at every half sample at least.
    #[inline(never)]
    pub(crate) fn most_between(&self, plan: &Plan, pair: usize, from: f32, to: f32) -> f32 {
        let steps = m::ceil(m::abs(to - from) * 2.0 * plan.rate_hz).clamp(1.0, MOST_STEPS);
        let mut most = f32::MIN;
        for n in 0..=steps as u32 {
            most = most.max(self.pair_value(plan, pair, from + (to - from) * (n as f32 / steps)));
        }
        most
    }

    /// Correlations at half-sample lags: `R(n) = Re Σ_k ĝ(k) e^{+2πikn/1024}`.
    pub(crate) fn correlate(&mut self, band: &Band, whitened: &Spectra, work: &mut Work) {
        let [l01, l02, l03, l12, l13, l23] = &mut self.lags;
        self.unit = band.high.saturating_sub(band.incoherent).max(1) as f32 / FULL;
        correlate_two::<0, 1>(work, band, whitened, self.unit, [l01, l02]);
        correlate_two::<2, 3>(work, band, whitened, self.unit, [l03, l12]);
        correlate_two::<4, 5>(work, band, whitened, self.unit, [l13, l23]);
    }

    /// Maximum over the delays that a cell of the lattice can hold.
    fn pool(&mut self, plan: &Plan, spacing: f32) {
        for ((pooled, lags), crossing) in self.pooled.iter_mut().zip(&self.lags).zip(&plan.crossing_s) {
            // Blocks of a stride first, then windows of 2, 4, 8 ... blocks; two of the widest that fits cover a window.
            let mut windows = [i16::MIN; POOLED];
            for (block, [a, b, c, d]) in windows.iter_mut().zip(lags.as_chunks::<POOL_STRIDE>().0) {
                *block = (*a).max(*b).max((*c).max(*d));
            }
            let reach = m::ceil(0.71 * spacing * crossing * 2.0 * plan.rate_hz);
            let each_side = (reach as usize).div_ceil(POOL_STRIDE).min(POOLED / 2);
            let mut width = 1;
            while 2 * width <= 2 * each_side + 1 {
                // Beyond the table's end there is nothing higher.
                let later = Cell::from_mut(&mut windows[..]).as_slice_of_cells();
                for (window, next) in later.iter().zip(later.iter().skip(width)) {
                    window.set(window.get().max(next.get()));
                }
                width *= 2;
            }
            for (n, value) in pooled.iter_mut().enumerate() {
                let first = windows[n.saturating_sub(each_side) & (POOLED - 1)];
                let last = windows[(n + each_side + 1).saturating_sub(width) & (POOLED - 1)];
                *value = first.max(last);
            }
        }
    }

    /// The best cells of the coarse lattice (rings of elevation, spokes of azimuth).
    #[inline(never)]
    fn coarse(&self, plan: &Plan, curvature: f32, spacing: f32) -> [Candidate; CELLS] {
        let mut cells = [Candidate { score: i32::MIN, direction: [0.0; 3] }; CELLS];
        let mut worst = i32::MIN;
        let parts = (1u32 << COARSE_BITS) as f32;
        let [a0, a1, a2, a3] = Arrival::all(plan, curvature, 2.0 * plan.rate_hz / POOL_STRIDE as f32 * parts);
        let [p01, p02, p03, p12, p13, p23] = &self.pooled;
        let bottom = m::asin(plan.elevation.0.clamp(-1.0, 1.0));
        let top = m::asin(plan.elevation.1.clamp(-1.0, 1.0));
        let rings = (m::ceil((top - bottom) / spacing) as u32).clamp(1, 200);
        let ring_step = (top - bottom) / rings as f32;
        for ring in 0..rings {
            let (sz, cz) = m::sin_cos(bottom + (ring as f32 + 0.5) * ring_step);
            let spokes = (m::ceil(m::TAU * cz / spacing) as u32).clamp(1, 400);
            let (ds, dc) = m::sin_cos(m::TAU / spokes as f32);
            let (mut s, mut c) = (0.0f32, 1.0f32);
            let [h0, h1, h2, h3] = plan.geometry.position_m.map(|h| [cz * h[0], cz * h[1], sz * h[2]]);
            let along = |h: &[f32; 3], s: f32, c: f32| h[2] + h[0] * s + h[1] * c;
            for _ in 0..spokes {
                let t0 = a0.time(along(&h0, s, c));
                let t1 = a1.time(along(&h1, s, c));
                let t2 = a2.time(along(&h2, s, c));
                let t3 = a3.time(along(&h3, s, c));
                let score = pooled(p01, t1 - t0)
                    + pooled(p02, t2 - t0)
                    + pooled(p03, t3 - t0)
                    + pooled(p12, t2 - t1)
                    + pooled(p13, t3 - t1)
                    + pooled(p23, t3 - t2);
                if score > worst {
                    worst = keep(&mut cells, Candidate { score, direction: [cz * s, cz * c, sz] });
                }
                (s, c) = (s * dc + c * ds, c * dc - s * ds);
            }
        }
        cells
    }

    /// The best point of a fine grid about a cell's centre.
    fn fine(&self, plan: &Plan, grid: &Grid, centre: &Direction) -> Candidate {
        let e = wavefront::tangents(centre);
        let position = &plan.geometry.position_m;
        let along = |u: &[f32; 3]| position.map(|h| wavefront::dot(u, &h));
        let (to_centre, first, second) = (along(centre), along(&e.0), along(&e.1));
        let mut best = (i32::MIN, 0.0, 0.0);
        for (a, lengths) in (-FINE..=FINE).zip(&grid.inverse_length) {
            let a = a as f32 * grid.step;
            for (b, inverse) in (-FINE..=FINE).zip(lengths) {
                let b = b as f32 * grid.step;
                let up = (centre[2] + a * e.0[2] + b * e.1[2]) * inverse;
                if up < plan.elevation.0 || up > plan.elevation.1 {
                    continue;
                }
                let mut t = [0i32; CHANNELS];
                for i in 0..CHANNELS {
                    t[i] = grid.arrivals[i].time((to_centre[i] + a * first[i] + b * second[i]) * inverse);
                }
                let [t0, t1, t2, t3] = t;
                let delays = [t1 - t0, t2 - t0, t3 - t0, t2 - t1, t3 - t1, t3 - t2];
                let score = self.lags.iter().zip(delays).map(|(table, delay)| lookup(table, delay)).sum();
                if score > best.0 {
                    best = (score, a, b);
                }
            }
        }
        let (score, a, b) = best;
        Candidate { score, direction: wavefront::stepped(centre, &e, a, b) }
    }
}

/// The other sign. Apart: six copies are 2 kB.
#[inline(never)]
fn negate(lags: &mut [i16; LAGS + 1]) {
    lags.iter_mut().for_each(|r| *r = r.saturating_neg());
}

/// The fine grid that all cells share.
struct Grid {
    arrivals: [Arrival; CHANNELS],
    /// Radians between points.
    step: f32,
    /// One over the length of centre and steps together.
    inverse_length: [[f32; FINE_SPAN]; FINE_SPAN],
}

impl Grid {
    fn new(plan: &Plan, curvature: f32, step: f32) -> Self {
        let mut inverse_length = [[1.0; FINE_SPAN]; FINE_SPAN];
        for (a, row) in (-FINE..=FINE).zip(&mut inverse_length) {
            for (b, inverse) in (-FINE..=FINE).zip(row) {
                *inverse = m::inverse_sqrt(1.0 + step * step * (a * a + b * b) as f32);
            }
        }
        let parts = (1u32 << FINE_BITS) as f32;
        Self { arrivals: Arrival::all(plan, curvature, 2.0 * plan.rate_hz * parts), step, inverse_length }
    }
}

/// Two pairs' correlations by one complex transform: `Z = ĝ_a + i ĝ_b` on both halves of the spectrum. Whole samples are a
/// transform of 512 points, the half samples between them another one of bins turned by half a sample.
fn correlate_two<const A: usize, const B: usize>(
    work: &mut Work,
    band: &Band,
    whitened: &Spectra,
    unit: f32,
    lags: [&mut [i16; LAGS + 1]; 2],
) {
    work.fill(Complex32::new(0.0, 0.0));
    let [whole, half] = work.as_chunks_mut::<FRAME>().0 else { return };
    for (k, turn) in HALF_SAMPLE.iter().enumerate().take(band.high).skip(band.incoherent) {
        let (run, i) = (&whitened.runs[(k / RUN) & (RUNS - 1)], k % RUN);
        let (ra, ia, rb, ib) = (run.re[A][i], run.im[A][i], run.re[B][i], run.im[B][i]);
        // Conjugated, because the forward transform is used: it gives R(−n) of the spectrum, R(n) of its conjugate.
        let positive = Complex32::new(ra + ib, rb - ia);
        let negative = Complex32::new(ra - ib, rb + ia);
        let (at, mirrored) = (transform::reversed(k), transform::reversed(FRAME - k));
        (whole[at], whole[mirrored]) = (positive, negative);
        (half[at], half[mirrored]) = (positive * turn, negative * turn.conj());
    }
    transform::transform_reversed(whole);
    transform::transform_reversed(half);
    // Half of R: the sum over negative frequencies equals that over positive ones.
    let scale = 0.5 / unit;
    let [lag_a, lag_b] = lags;
    let earliest = FRAME - MAX_DELAY;
    let order = whole.iter().zip(half.iter());
    let order = order.clone().skip(earliest).chain(order.take(MAX_DELAY));
    let places = lag_a.as_chunks_mut::<2>().0.iter_mut().zip(lag_b.as_chunks_mut::<2>().0);
    for ((a, b), (whole, half)) in places.zip(order) {
        *a = [rounded(scale * whole.re), rounded(scale * half.re)];
        *b = [rounded(scale * whole.im), rounded(scale * half.im)];
    }
    lag_a[LAGS] = lag_a[LAGS - 1];
    lag_b[LAGS] = lag_b[LAGS - 1];
}

/// To the nearest whole number, for values that fit.
#[inline(always)]
fn rounded(x: f32) -> i16 {
    // Adding 1.5 · 2²³ leaves the number in the lowest bits.
    (x + 12_582_912.0).to_bits() as i16
}

/// The pooled correlation at a delay.
#[inline(always)]
fn pooled(table: &[i16; POOLED], delay: i32) -> i32 {
    const MIDDLE: i32 = POOLED as i32 / 2;
    i32::from(table[((delay >> COARSE_BITS).clamp(-MIDDLE, MIDDLE - 1) + MIDDLE) as usize])
}

/// Linear interpolation in a lag table, times 2 to the [`FINE_BITS`]; delays reach no farther than the table.
#[inline(always)]
fn lookup(table: &[i16; LAGS + 1], delay: i32) -> i32 {
    let n = ((delay >> FINE_BITS) + LAGS as i32 / 2) as usize & (LAGS - 1);
    let (here, next) = (i32::from(table[n]), i32::from(table[n + 1]));
    (here << FINE_BITS) + (next - here) * (delay & ((1 << FINE_BITS) - 1))
}

/// Puts a candidate in the place of the worst kept one; returns the lowest score still kept.
fn keep(cells: &mut [Candidate; CELLS], new: Candidate) -> i32 {
    let worst = cells
        .iter()
        .enumerate()
        .fold((i32::MAX, 0), |worst, (n, cell)| if cell.score < worst.0 { (cell.score, n) } else { worst });
    if let Some(cell) = cells.get_mut(worst.1) {
        *cell = new;
    }
    cells.iter().fold(i32::MAX, |a, c| a.min(c.score))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::f64 as md;

    #[test]
    fn correlations_are_fourier_sums_at_half_samples() {
        let mut whitened = Spectra::new();
        let mut x = 7u32;
        for run in &mut whitened.runs {
            for value in run.re.as_flattened_mut().iter_mut().chain(run.im.as_flattened_mut()) {
                x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *value = (x >> 8) as f32 / (1u32 << 24) as f32 - 0.5;
            }
        }
        let band = Band {
            low: 3,
            high: 201,
            incoherent: 4,
            threshold: 6.0,
            resolution: 0.02,
            used: wavefront::Used::ALL,
        };
        let (mut search, mut work) = (SearchWork::new(), [Complex32::new(0.0, 0.0); 2 * FRAME + 1]);
        search.correlate(&band, &whitened, &mut work);
        for (pair, lags) in search.lags.iter().enumerate() {
            for n in [-256i32, -255, -80, -1, 0, 1, 2, 77, 255] {
                let mut exact = 0.0;
                for k in 4..201usize {
                    let (s, c) = md::sin_cos(md::TAU * k as f64 * f64::from(n) / 1024.0);
                    let run = &whitened.runs[k / RUN];
                    exact += f64::from(run.re[pair][k % RUN]) * c - f64::from(run.im[pair][k % RUN]) * s;
                }
                let got = f64::from(f32::from(lags[(n + 256) as usize]) * search.unit);
                assert!((got - exact).abs() < 0.01, "pair {pair} lag {n}: {got} {exact}");
            }
        }
    }
}
