//! The recursive posterior over range and radial speed, with the probability that a vessel is there at all.
//!
//! Enters: one minute's likelihood grid. Leaves: the probability of presence and the weighted modes. A Bernoulli filter:
//! predict `r ← r + v · 60 s` with a little diffusion, birth from the prior (area: proportional to r [O 20]), update by
//! `(1 − Pd) + Pd ℓ(r, v)`. Carrying the posterior from minute to minute resolves most branches one minute leaves
//! ambiguous. Minutes use frames once, so successive likelihoods are independent.
//! The posterior is stored as the upper halves of f32 (0.4 %): 19 KiB. Cost: 1 M instructions a minute.

use super::interference::Interference;
use super::limits::{CELL_M, RANGE_CELLS, RANGE_MODES, SPEED_STEP_M_S, SPEEDS};
use super::radial::{Grid, speed_of};
use crate::math;

/// Probability that a present vessel shows in a minute's cepstra.
const DETECTION: f32 = 0.6;

/// Probability a minute that a vessel appears, or goes: one in three hours.
const CHANGE: f32 = 1.0 / 180.0;

/// Share of the posterior spread anew over the prior each minute, so that a wrong branch is left again.
const AFRESH: f32 = 0.02;

/// Share of the posterior kept where a track expects its vessel.
const EXPECTED: f32 = 0.2;

/// Share of each speed that moves to either neighbour in a minute (turning rates near the closest point).
const SPEED_SPREAD: f32 = 0.1;

/// Half width within which a mode is alone, cells (1.1 km).
const ALONE: usize = 8;

/// Half width of the moments of a mode, cells.
const MODE_HALF: usize = 4;

/// Natural logarithm of how much better than the prior a mode must be.
const MODE_LOG_RATIO: f32 = 4.0;

/// Log ratio this minute's own data must give a mode: what is only remembered, or lies where the model says nothing
/// (nearer than 7 km), is no measurement.
const LEAST_SUPPORT: f32 = 3.0;

/// The best of a minute's log ratios at and next to a cell.
fn support(grid: &Grid, i: usize, k: usize) -> f32 {
    let near = grid.iter().skip(k.saturating_sub(1)).take(3);
    near.flat_map(|g| g.iter().skip(i.saturating_sub(1)).take(3)).fold(f32::NEG_INFINITY, |a, b| a.max(*b))
}

/// One mode of the posterior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeMode {
    /// Range, m.
    pub range_m: f32,
    /// Its standard deviation, m.
    pub sd_range_m: f32,
    /// Radial speed, m/s, positive when leaving.
    pub speed_m_s: f32,
    /// Its standard deviation, m/s.
    pub sd_speed_m_s: f32,
    /// Share of the posterior.
    pub weight: f32,
}

/// Outcome of a minute.
#[derive(Clone, Copy, Debug)]
pub struct RangePresence {
    /// ln of the odds that a vessel is there.
    pub log_odds: f32,
    /// ln of this minute's evidence for one, against none.
    pub log_evidence: f32,
    /// Share of the posterior that approaches.
    pub approaching: f32,
    /// Modes, heaviest first.
    pub modes: [Option<RangeMode>; RANGE_MODES],
}

/// Range within which a mode is the vessel a track expects, m.
const EXPECTED_WITHIN_M: f32 = 1500.0;

impl RangePresence {
    /// Puts the modes of tracked vessels first and drops those that only read a tracked vessel's echoes as another
    /// pair of paths.
    pub fn prefer(&mut self, model: &Interference, expected: &[Option<(f32, f32)>]) {
        let own = |m: &RangeMode| {
            expected.iter().flatten().any(|(r, _)| math::f32::abs(m.range_m - r) < EXPECTED_WITHIN_M)
        };
        let mistaken = |m: &RangeMode| expected.iter().flatten().any(|(r, _)| model.mistakes(m.range_m, *r));
        let old = self.modes;
        let first = old.iter().flatten().filter(|m| own(m));
        let rest = old.iter().flatten().filter(|m| !own(m) && !mistaken(m));
        self.modes = [None; RANGE_MODES];
        self.modes.iter_mut().zip(first.chain(rest)).for_each(|(slot, m)| *slot = Some(*m));
    }
}

/// The posterior.
#[derive(Clone, Debug)]
pub struct Presence {
    density: [[u16; RANGE_CELLS]; SPEEDS],
    present: f32,
    prior_scale: f32,
    cells: usize,
}

fn pack(x: f32) -> u16 {
    (x.to_bits().saturating_add(0x8000) >> 16) as u16
}

fn unpack(x: u16) -> f32 {
    f32::from_bits(u32::from(x) << 16)
}

/// Range at the middle of a cell: it holds model ranges 2i and 2i + 1.
pub(super) fn range_of(i: usize) -> f32 {
    CELL_M * (i as f32 + 0.25)
}

impl Default for Presence {
    fn default() -> Self {
        Self::new()
    }
}

impl Presence {
    /// Not yet started; all zeros.
    pub const fn new() -> Self {
        Self { density: [[0; RANGE_CELLS]; SPEEDS], present: 0.0, prior_scale: 0.0, cells: 0 }
    }

    /// Nothing known, up to `max_range_m`.
    pub fn start(&mut self, max_range_m: f32) {
        self.cells = ((max_range_m / CELL_M) as usize).clamp(1, RANGE_CELLS);
        self.prior_scale = 1.0 / ((0..self.cells).map(range_of).sum::<f32>() * SPEEDS as f32);
        self.restart();
    }

    /// Its memory, for a mode of operation that carries nothing from minute to minute.
    pub(super) fn lend(&mut self) -> &mut [[u16; RANGE_CELLS]; SPEEDS] {
        &mut self.density
    }

    /// Forgets everything learned.
    fn restart(&mut self) {
        self.present = CHANGE;
        let (scale, cells) = (self.prior_scale, self.cells);
        for column in &mut self.density {
            column
                .iter_mut()
                .enumerate()
                .for_each(|(i, d)| *d = pack(if i < cells { range_of(i) * scale } else { 0.0 }));
        }
    }

    /// Moves the posterior on by one minute.
    pub fn predict(&mut self, work: &mut [[f32; RANGE_CELLS]; 3]) {
        let present = self.present * (1.0 - CHANGE) + (1.0 - self.present) * CHANGE;
        let born = ((1.0 - self.present) * CHANGE / present).clamp(AFRESH, 1.0);
        self.present = present;
        let (scale, cells) = (self.prior_scale, self.cells);
        // Three shifted columns at a time: below, here, above.
        let [below, here, above] = work;
        *below = [0.0; RANGE_CELLS];
        self.shifted(0, here);
        for k in 0..SPEEDS {
            self.shifted(k + 1, above);
            // At the ends of the speed axis the share that would leave it stays.
            let ends = if k == 0 || k + 1 == SPEEDS { SPEED_SPREAD } else { 0.0 };
            let stay = 1.0 - 2.0 * SPEED_SPREAD + ends;
            if let Some(column) = self.density.get_mut(k) {
                let moved = below.iter().zip(here.iter()).zip(above.iter());
                for (i, (d, ((b, h), a))) in column.iter_mut().zip(moved).enumerate().take(cells) {
                    let x = stay * h + SPEED_SPREAD * (b + a);
                    *d = pack((1.0 - born) * x + born * range_of(i) * scale);
                }
            }
            core::mem::swap(below, here);
            core::mem::swap(here, above);
        }
    }

    /// Keeps at least `EXPECTED` of the posterior where a track says its vessel is: `(range, radial speed)`.
    pub fn expect(&mut self, range_m: f32, speed_m_s: f32) {
        let i = (range_m / CELL_M) as usize;
        let k = math::f32::round((speed_m_s - speed_of(0)) / SPEED_STEP_M_S);
        if i >= self.cells || k < 0.0 || k as usize >= SPEEDS {
            return;
        }
        let k = k as usize;
        for d in self.density.iter_mut().flat_map(|c| c.iter_mut().take(self.cells)) {
            *d = pack((1.0 - EXPECTED) * unpack(*d));
        }
        let share = EXPECTED / 15.0;
        for column in self.density.iter_mut().skip(k.saturating_sub(1)).take(3) {
            for d in column.iter_mut().take(self.cells).skip(i.saturating_sub(2)).take(5) {
                *d = pack(unpack(*d) + share);
            }
        }
    }

    /// Column `k` after a minute at its speed.
    fn shifted(&self, k: usize, out: &mut [f32; RANGE_CELLS]) {
        *out = [0.0; RANGE_CELLS];
        let Some(column) = self.density.get(k) else { return };
        let shift = speed_of(k) * 60.0 / CELL_M;
        let whole = math::f32::floor(shift);
        let part = shift - whole;
        let n = whole as isize;
        // Out cell i comes from cell i − n (weight 1 − part) and i − n − 1 (weight part).
        let back = |from: usize| column.get(from..).unwrap_or_default();
        let add = |out: &mut [f32], n: isize, w: f32| {
            if n >= 0 {
                let o = out.iter_mut().skip(n.unsigned_abs());
                o.zip(column).for_each(|(o, d)| *o += w * unpack(*d));
            } else {
                out.iter_mut().zip(back(n.unsigned_abs())).for_each(|(o, d)| *o += w * unpack(*d));
            }
        };
        add(out, n, 1.0 - part);
        add(out, n + 1, part);
    }

    /// Takes in one minute's likelihood.
    pub fn update(&mut self, grid: &Grid) -> RangePresence {
        let cells = self.cells;
        let top = grid.iter().flat_map(|g| g.iter().take(cells)).fold(0f32, |a, b| a.max(*b));
        let miss = (1.0 - DETECTION) * math::f32::exp(-top);
        let (mut total, mut approaching) = (0f32, 0f32);
        for (k, (column, g)) in self.density.iter_mut().zip(grid).enumerate() {
            let mut sum = 0f32;
            for (d, g) in column.iter_mut().zip(g).take(cells) {
                let x = g - top;
                let hit = if x > -60.0 { DETECTION * math::f32::exp(x) } else { 0.0 };
                let p = unpack(*d) * (miss + hit);
                *d = pack(p);
                sum += p;
            }
            total += sum;
            if k < SPEEDS / 2 {
                approaching += sum;
            }
        }
        let usable = total > 1e-37;
        if !usable {
            self.restart();
            return RangePresence {
                log_odds: math::f32::ln(CHANGE),
                log_evidence: 0.0,
                approaching: 0.5,
                modes: [None; RANGE_MODES],
            };
        }
        let log_evidence = math::f32::ln(total) + top;
        let log_odds = (math::f32::ln(self.present / (1.0 - self.present)) + log_evidence).clamp(-12.0, 12.0);
        let odds = math::f32::exp(log_odds);
        self.present = odds / (1.0 + odds);
        let scale = 1.0 / total;
        for d in self.density.iter_mut().flat_map(|c| c.iter_mut().take(cells)) {
            *d = pack(unpack(*d) * scale);
        }
        let modes = self.modes(log_evidence, grid);
        RangePresence { log_odds, log_evidence, approaching: approaching * scale, modes }
    }

    /// A minute without data: only time passes.
    pub fn blind(&self) -> RangePresence {
        let log_odds = math::f32::ln(self.present / (1.0 - self.present));
        RangePresence { log_odds, log_evidence: 0.0, approaching: 0.5, modes: [None; RANGE_MODES] }
    }

    /// Best density over speed at a cell.
    fn best(&self, i: usize) -> (usize, f32) {
        self.density.iter().enumerate().fold((0, 0.0), |b, (k, c)| {
            let p = c.get(i).copied().map_or(0.0, unpack);
            if p > b.1 { (k, p) } else { b }
        })
    }

    /// The highest peaks over range that are better than the prior by [`MODE_LOG_RATIO`].
    fn modes(&self, log_evidence: f32, grid: &Grid) -> [Option<RangeMode>; RANGE_MODES] {
        let mut found = [(0usize, 0usize, 0f32); RANGE_MODES];
        for i in 0..self.cells {
            let (k, p) = self.best(i);
            let prior = range_of(i) * self.prior_scale;
            let unlikely = p <= 1e-36 || math::f32::ln(p / prior) + log_evidence < MODE_LOG_RATIO;
            if unlikely || support(grid, i, k) < LEAST_SUPPORT {
                continue;
            }
            // A peak close to a higher one already found is part of it; a lower one close by gives way.
            let near = found.iter_mut().find(|f| f.2 > 0.0 && f.0.abs_diff(i) <= ALONE);
            if let Some(f) = near {
                if p > f.2 {
                    *f = (i, k, p);
                }
                continue;
            }
            let least = found.iter_mut().min_by(|a, b| a.2.total_cmp(&b.2));
            if let Some(f) = least
                && p > f.2
            {
                *f = (i, k, p);
            }
        }
        let mut out = [None; RANGE_MODES];
        for slot in &mut out {
            let highest = found.iter_mut().max_by(|a, b| a.2.total_cmp(&b.2));
            if let Some((i, k, p)) = highest
                && *p > 0.0
            {
                *slot = Some(self.moments(*i, *k));
                *p = 0.0;
            }
        }
        out
    }

    /// Mean and spread of the posterior about a peak.
    fn moments(&self, i: usize, k: usize) -> RangeMode {
        let (r0, v0) = (range_of(i), speed_of(k));
        let (mut n, mut r, mut rr, mut v, mut vv) = (0f32, 0f32, 0f32, 0f32, 0f32);
        let first = i.saturating_sub(MODE_HALF);
        for (j, column) in self.density.iter().enumerate() {
            if j.abs_diff(k) > 3 {
                continue;
            }
            let dv = speed_of(j) - v0;
            for (d, cell) in column.iter().enumerate().skip(first).take(2 * MODE_HALF + 1) {
                let (p, dr) = (unpack(*cell), range_of(d) - r0);
                n += p;
                r += p * dr;
                rr += p * dr * dr;
                v += p * dv;
                vv += p * dv * dv;
            }
        }
        let n = n.max(1e-37);
        let (r, v) = (r / n, v / n);
        // The grid itself spreads by a twelfth of a step squared.
        let var_r = (rr / n - r * r).max(0.0) + CELL_M * CELL_M / 12.0;
        let var_v = (vv / n - v * v).max(0.0) + 1.0 / 12.0;
        RangeMode {
            range_m: r0 + r,
            sd_range_m: math::f32::sqrt(var_r),
            speed_m_s: v0 + v,
            sd_speed_m_s: math::f32::sqrt(var_v),
            weight: n.min(1.0),
        }
    }
}
