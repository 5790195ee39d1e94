//! The recursive posterior over range and radial speed, with the probability that a vessel is there at all.
//!
//! Enters: one minute's likelihood grid. Leaves: the probability of presence and the weighted modes. A Bernoulli filter:
//! predict `r ← r + v · 60 s` with a little diffusion, birth from the prior (area: proportional to r [O 20]), update by
//! `(1 − Pd) + Pd ℓ(r, v)`. Carrying the posterior from minute to minute resolves most branches one minute leaves
//! ambiguous. Minutes use frames once, so successive likelihoods are independent.
//! Several vessels: the ranges about each tracked one are its own, with a posterior that sums to one there, and the rest
//! is the posterior of a vessel not yet tracked; so the stronger vessel's likelihood cannot drown the weaker one's. Where
//! an established vessel's echo would be read as another pair of paths, a minute's likelihood counts as nothing.
//! Where the table predicts too little energy to show a vessel (nearer than 6.5 km at RR03), silence does not contradict
//! one: the posterior would collect there in noise. Such ranges keep their share of it, and no range is reported there.
//! The posterior is stored as the upper halves of f32 (0.4 %): 19 KiB. Cost: 1 M instructions a minute.

mod modes;

use super::interference::Interference;
use super::limits::{CELL_M, RANGE_CELLS, RANGE_MODES, SPEED_STEP_M_S, SPEEDS, VESSELS};
use super::radial::{GRID_UNIT, speed_of};
use super::shared::{Columns, Grid};
use crate::math;
pub use modes::RangeMode;
use modes::{EXPECTED_WITHIN_M, LEAST_SUPPORT};

/// Probability that a present vessel shows in a minute's cepstra.
pub(super) const DETECTION: f32 = 0.6;

/// Probability a minute that a vessel appears, or goes: one in three hours.
const CHANGE: f32 = 1.0 / 180.0;

/// Share of the posterior spread anew over the prior each minute, so that a wrong branch is left again.
const AFRESH: f32 = 0.02;

/// Share of the posterior kept where a track expects its vessel.
const EXPECTED: f32 = 0.2;

/// Share of each speed that moves to either neighbour in a minute (turning rates near the closest point).
const SPEED_SPREAD: f32 = 0.1;

/// Which cells would show a vessel.
type Shown = [bool; RANGE_CELLS];

/// Where a track expects its vessel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// Range, m.
    pub range_m: f32,
    /// Radial speed, m/s, positive when leaving.
    pub speed_m_s: f32,
    /// Whether the track has held long enough to say what is its echo.
    pub established: bool,
}

/// What each tracked vessel is expected to show.
pub type ExpectedVessels = [Option<Expected>; VESSELS];

/// Owner of cells that are no tracked vessel's.
const UNCLAIMED: u8 = VESSELS as u8;

/// Owner of cells that an established vessel's echoes would point to.
const ECHO: u8 = UNCLAIMED + 1;

/// Posteriors kept: one a tracked vessel, and one of a vessel not tracked.
const OWNERS: usize = VESSELS + 1;

/// Outcome of a minute.
#[derive(Clone, Copy, Debug)]
pub struct RangePresence {
    /// ln of the odds that a vessel is there.
    pub log_odds: f32,
    /// ln of this minute's evidence for one against none, the chance that it does not show included: `1 − Pd + Pd M`.
    pub log_evidence: f32,
    /// Share of the posterior that approaches.
    pub approaching: f32,
    /// Modes, heaviest first.
    pub modes: [Option<RangeMode>; RANGE_MODES],
}

/// The posterior.
#[derive(Clone, Debug)]
pub struct Presence {
    density: [[u16; RANGE_CELLS]; SPEEDS],
    /// Whose each range cell is: a tracked vessel's place in the list, [`UNCLAIMED`] or [`ECHO`].
    owner: [u8; RANGE_CELLS],
    /// Which vessels of the list are tracked.
    tracked: [bool; VESSELS],
    /// Probability that each owner's vessel is there.
    present: [f32; OWNERS],
    prior_scale: f32,
    cells: usize,
}

fn pack(x: f32) -> u16 {
    (x.to_bits().saturating_add(0x8000) >> 16) as u16
}

fn unpack(x: u16) -> f32 {
    f32::from_bits(u32::from(x) << 16)
}

/// The entry of a cell's owner; an echo is a vessel's that is not tracked.
fn of<T>(all: &mut [T; OWNERS], owner: u8) -> &mut T {
    let [known @ .., unclaimed] = all;
    known.get_mut(usize::from(owner)).unwrap_or(unclaimed)
}

/// Range at the middle of a cell: it holds model ranges 2i and 2i + 1.
pub(super) fn range_of(i: usize) -> f32 {
    CELL_M * (i as f32 + 0.25)
}

impl Presence {
    /// Not yet started; all zeros.
    pub const fn new() -> Self {
        Self {
            density: [[0; RANGE_CELLS]; SPEEDS],
            owner: [0; RANGE_CELLS],
            tracked: [false; VESSELS],
            present: [0.0; OWNERS],
            prior_scale: 0.0,
            cells: 0,
        }
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
        self.present = [CHANGE; OWNERS];
        self.owner = [UNCLAIMED; RANGE_CELLS];
        self.tracked = [false; VESSELS];
        let (scale, cells) = (self.prior_scale, self.cells);
        for column in &mut self.density {
            column
                .iter_mut()
                .enumerate()
                .for_each(|(i, d)| *d = pack(if i < cells { range_of(i) * scale } else { 0.0 }));
        }
    }

    /// Moves the posterior on by one minute.
    pub fn predict(&mut self, work: &mut Columns) {
        let [.., unclaimed] = self.present;
        self.present.iter_mut().for_each(|p| *p = *p * (1.0 - CHANGE) + (1.0 - *p) * CHANGE);
        let [.., present] = self.present;
        let born = ((1.0 - unclaimed) * CHANGE / present).clamp(AFRESH, 1.0);
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

    /// Divides the ranges among the vessels expected and one not tracked, and keeps at least `EXPECTED` of each
    /// tracked vessel's posterior where its track says it is.
    pub fn claim(&mut self, model: &Interference<'_>, expected: &ExpectedVessels) {
        let inside = |e: &Expected| e.range_m < CELL_M * self.cells as f32;
        let expected = expected.map(|e| e.filter(inside));
        let tracked = expected.map(|e| e.is_some());
        if !tracked.contains(&true) && !self.tracked.contains(&true) {
            return;
        }
        let [known @ .., unclaimed] = &mut self.present;
        for (present, (now, before)) in known.iter_mut().zip(tracked.iter().zip(&self.tracked)) {
            if *now && !before {
                // A vessel just tracked is the one that was there; whether there is another is open.
                (*present, *unclaimed) = (*unclaimed, CHANGE);
            }
        }
        self.tracked = tracked;
        for (i, owner) in self.owner.iter_mut().enumerate() {
            let range_m = range_of(i);
            let nearest = expected
                .iter()
                .enumerate()
                .filter_map(|(k, e)| Some((k, math::f32::abs(e.as_ref()?.range_m - range_m))))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let echo = |e: &Expected| e.established && model.mistakes(range_m, e.range_m);
            *owner = match nearest {
                Some((k, d)) if d < EXPECTED_WITHIN_M => k as u8,
                _ if expected.iter().flatten().any(echo) => ECHO,
                _ => UNCLAIMED,
            };
        }
        let mut mass = [0f32; OWNERS];
        for column in &self.density {
            for (d, owner) in column.iter().zip(&self.owner).take(self.cells) {
                *of(&mut mass, *owner) += unpack(*d);
            }
        }
        let mut scale = mass.map(|m| 1.0 / m.max(1e-30));
        scale.iter_mut().zip(&expected).for_each(|(s, _)| *s *= 1.0 - EXPECTED);
        for column in &mut self.density {
            for (d, owner) in column.iter_mut().zip(&self.owner).take(self.cells) {
                *d = pack(unpack(*d) * *of(&mut scale, *owner));
            }
        }
        for (k, e) in expected.iter().enumerate() {
            if let Some(e) = e {
                self.keep(k as u8, e);
            }
        }
    }

    /// Adds `EXPECTED` about the place expected, in the cells of that owner.
    fn keep(&mut self, owner: u8, e: &Expected) {
        let i = (e.range_m / CELL_M) as usize;
        let k = math::f32::round((e.speed_m_s - speed_of(0)) / SPEED_STEP_M_S).max(0.0) as usize;
        let share = EXPECTED / 15.0;
        for column in self.density.iter_mut().skip(k.saturating_sub(1)).take(3) {
            let cells = column.iter_mut().zip(&self.owner).take(self.cells);
            for (d, _) in cells.skip(i.saturating_sub(2)).take(5).filter(|(_, o)| **o == owner) {
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

    /// Takes in one minute's likelihood, made from so many frames by the model.
    pub fn update(&mut self, grid: &Grid, model: &Interference<'_>, frames: usize) -> RangePresence {
        let cells = self.cells;
        let shown: Shown = core::array::from_fn(|i| model.shows(i, frames, LEAST_SUPPORT));
        let mut top = [0f32; OWNERS];
        for row in grid {
            for (g, owner) in row.iter().zip(&self.owner).take(cells).filter(|(_, o)| **o != ECHO) {
                let top = of(&mut top, *owner);
                *top = top.max(f32::from(*g) * GRID_UNIT);
            }
        }
        let mut miss = top.map(|t| (1.0 - DETECTION) * math::f32::exp(-t));
        let mut silent = top.map(|t| math::f32::exp(-t));
        let (mut total, mut approaching) = ([0f32; OWNERS], [0f32; OWNERS]);
        // Of the cells that show a vessel: what they held, and hold now. Of the others: what they held.
        let (mut before, mut after, mut hidden) = ([0f32; OWNERS], [0f32; OWNERS], [0f32; OWNERS]);
        for (k, (column, row)) in self.density.iter_mut().zip(grid).enumerate() {
            let row = row.iter().zip(&shown);
            for ((d, (g, shown)), owner) in column.iter_mut().zip(row).zip(&self.owner).take(cells) {
                let held = unpack(*d);
                let p = if *shown {
                    let log_ratio = if *owner == ECHO { 0.0 } else { f32::from(*g) * GRID_UNIT };
                    let x = log_ratio - *of(&mut top, *owner);
                    let hit = if x > -60.0 { DETECTION * math::exp_of_negative(x) } else { 0.0 };
                    let p = held * (*of(&mut miss, *owner) + hit);
                    *d = pack(p);
                    *of(&mut before, *owner) += held;
                    *of(&mut after, *owner) += p;
                    p
                } else {
                    *of(&mut hidden, *owner) += held;
                    held * *of(&mut silent, *owner)
                };
                *of(&mut total, *owner) += p;
                if k < SPEEDS / 2 {
                    *of(&mut approaching, *owner) += p;
                }
            }
        }
        let [.., unclaimed] = total;
        let usable = unclaimed > 1e-37;
        if !usable {
            self.restart();
            return RangePresence {
                log_odds: math::f32::ln(CHANGE),
                log_evidence: 0.0,
                approaching: 0.5,
                modes: [None; RANGE_MODES],
            };
        }
        // What is hidden keeps its share, unless nothing else is left.
        let mut scale = [(0f32, 0f32); OWNERS];
        for (((scale, before), after), hidden) in scale.iter_mut().zip(before).zip(after).zip(hidden) {
            *scale = if after > 1e-37 {
                let whole = before + hidden;
                (before / whole / after, 1.0 / whole)
            } else {
                (0.0, 1.0 / hidden.max(1e-37))
            };
        }
        for column in &mut self.density {
            let cells = column.iter_mut().zip(&self.owner).zip(&shown).take(cells);
            for ((d, owner), shown) in cells {
                let (seen, hidden) = *of(&mut scale, *owner);
                *d = pack(unpack(*d) * if *shown { seen } else { hidden });
            }
        }
        let mut evidence = [f32::NEG_INFINITY; OWNERS];
        let (mut log_odds, mut log_evidence) = (f32::NEG_INFINITY, f32::NEG_INFINITY);
        let (mut leaning, mut sure) = (0f32, 0f32);
        for k in 0..OWNERS {
            let (Some(total), Some(top), Some(present), Some(evidence)) =
                (total.get(k), top.get(k), self.present.get_mut(k), evidence.get_mut(k))
            else {
                continue;
            };
            if *total <= 1e-37 {
                continue;
            }
            *evidence = math::f32::ln(*total) + top;
            let odds = (math::f32::ln(*present / (1.0 - *present)) + *evidence).clamp(-12.0, 12.0);
            *present = math::f32::exp(odds) / (1.0 + math::f32::exp(odds));
            log_odds = log_odds.max(odds);
            log_evidence = log_evidence.max(*evidence);
            leaning += *present * approaching.get(k).copied().unwrap_or(0.0) / total;
            sure += *present;
        }
        let modes = self.modes(&mut evidence, grid, &shown);
        RangePresence { log_odds, log_evidence, approaching: leaning / sure.max(1e-30), modes }
    }

    /// A minute without data: only time passes.
    pub fn blind(&self) -> RangePresence {
        let [.., unclaimed] = self.present;
        let tracked = self.present.iter().zip(&self.tracked).filter(|(_, t)| **t);
        let present = tracked.fold(unclaimed, |most, (p, _)| most.max(*p));
        let log_odds = math::f32::ln(present / (1.0 - present));
        RangePresence { log_odds, log_evidence: 0.0, approaching: 0.5, modes: [None; RANGE_MODES] }
    }

    /// Share of the posterior of a vessel not tracked below a cell.
    #[cfg(test)]
    pub(super) fn share_below(&self, cell: usize) -> f32 {
        let mass =
            |n: usize| self.density.iter().flat_map(|c| c.iter().take(n)).map(|d| unpack(*d)).sum::<f32>();
        mass(cell) / mass(self.cells)
    }
}
