//! The recursive posterior over range and radial speed, with the probability that a vessel is there at all.
//!
//! Enters: one minute's likelihood grid. Leaves: the probability of presence and the weighted modes. A Bernoulli filter:
//! predict `r ← r + v · 60 s` with a little diffusion, birth from the prior (area: proportional to r [O 20]), update by
//! `(1 − Pd) + Pd ℓ(r, v)`. Carrying the posterior from minute to minute resolves most branches one minute leaves
//! ambiguous. Minutes use frames once, so successive likelihoods are independent.
//! A vessel's echoes may be weaker than the table's (`SHARES`): noise takes from all of them alike; and stronger: a loud vessel's are
//! taken at the share that explains a minute best. Each share has a posterior of its own, so that a vessel's share is learnt once and
//! not guessed anew each minute; the likelihood of a share a follows from that of the full strengths, `a ⟨y, μ⟩ − a² ½ ‖μ‖²` [O 19].
//! One weak echo may be another pair of paths of a vessel elsewhere, beyond the model too: a mode says whether it is sure.
//! Several vessels: the ranges about each tracked one are its own, with a posterior that sums to one there, and the rest
//! is the posterior of a vessel not yet tracked; so the stronger vessel's likelihood cannot drown the weaker one's. Ranges to
//! which a tracked vessel's echoes would point as another pair of paths are its own too: they are no other vessel, and where
//! they explain its echoes better than its track does, the posterior goes there and the track follows.
//! Where the table predicts too little energy to show a vessel (nearer than 6.5 km at RR03), silence does not contradict
//! one: the posterior would collect there in noise. Such ranges keep their share of it, a tenth at most where no vessel is
//! tracked, and no range is reported there.
//! A mode's place within its cells is that of this minute's frames (`radial`), for cells are 140 m wide.
//! The posterior is stored as the upper halves of f32 (0.4 %): 57 KiB. Cost: 3 M instructions a minute.

mod cells;
mod claims;
mod modes;

use super::interference::Interference;
use super::limits::{CELL_M, CLASSES, RANGE_CELLS, RANGE_MODES, SPEEDS, VESSELS};
use super::radial::{GRID_UNIT, RadialScratch, speed_of};
use super::shared::{Columns, Grid};
use crate::math;
use cells::Alike;
use modes::LEAST_SUPPORT;
pub use modes::RangeMode;

/// Probability that a present vessel shows in a minute's cepstra.
pub(super) const DETECTION: f32 = 0.6;

/// Probability a minute that a vessel appears, or goes: one in three hours.
const CHANGE: f32 = 1.0 / 180.0;

/// Share of the posterior spread anew over the prior each minute, so that a wrong branch is left again.
const AFRESH: f32 = 0.02;

/// Share of the posterior kept where a track expects its vessel.
const EXPECTED: f32 = 0.3;

/// Most of the posterior of a vessel not tracked where the table shows nothing; such ranges have 2 % of the prior at RR03.
const MOST_HIDDEN: f32 = 0.1;

/// Share of each speed that moves to either neighbour in a minute (turning rates near the closest point).
const SPEED_SPREAD: f32 = 0.1;

/// What share of the table's strengths a vessel's echoes may have: most of it, as noise leaves it of a strong vessel, or what
/// it leaves of a weaker one.
const SHARES: [Share; CLASSES] = [(0.8, LOUDEST), (0.4, 0.4), (0.18, 0.18)];

/// Least and greatest share.
type Share = (f32, f32);

/// How many times the table's a loud vessel's echoes may be. The table's are of vessels whose noise is as strong as the sea's 20 km away; of
/// one 10 dB louder, at 45 km, they are three to four times as strong. Taken at the table's strengths these say less than they do of
/// another pair of paths at half the range, where the table expects more.
const LOUDEST: f32 = 3.0;

/// What not knowing a loud vessel's share costs, natural logarithm: so that in noise the best of its shares is hardly likelier than one.
const UNKNOWN: f32 = 1.0;

/// How likely each is of a vessel of which nothing is known.
const LIKELY: [f32; CLASSES] = [0.6, 0.25, 0.15];

/// Probability that a vessel's share is a neighbouring one a minute later.
const FADES: f32 = 0.03;

/// Which cells would show a vessel.
type Shown = [bool; RANGE_CELLS];

/// Where a track expects its vessel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// Range, m.
    pub range_m: f32,
    /// Radial speed, m/s, positive when leaving.
    pub speed_m_s: f32,
    /// Whether the track has held long enough not to be on a wrong pair of paths any more.
    pub established: bool,
    /// Whether it has, and its echoes are nearly of the table's strengths.
    pub strong: bool,
    /// Whether it has, and it is no vessel beyond the model that is louder than the table's.
    pub placed: bool,
}

/// What each tracked vessel is expected to show.
pub type ExpectedVessels = [Option<Expected>; VESSELS];

/// Owner of cells that are no tracked vessel's.
const UNCLAIMED: u8 = VESSELS as u8;

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

/// The posterior over radial speed and range at one share.
type Density = [[u16; RANGE_CELLS]; SPEEDS];

/// The posterior.
#[derive(Clone, Debug)]
pub struct Presence {
    density: [Density; CLASSES],
    /// Whose each range cell is: a tracked vessel's place in the list, or [`UNCLAIMED`].
    owner: [u8; RANGE_CELLS],
    /// Which vessels of the list are tracked.
    tracked: [bool; VESSELS],
    /// Probability that each owner's vessel is there.
    present: [f32; OWNERS],
    prior_scale: f32,
    cells: usize,
}

/// The upper half of a probability, rounded.
fn pack(x: f32) -> u16 {
    (x.to_bits().wrapping_add(0x8000) >> 16) as u16
}

fn unpack(x: u16) -> f32 {
    f32::from_bits(u32::from(x) << 16)
}

/// The entry of a cell's owner.
fn of<T>(all: &mut [T; OWNERS], owner: u8) -> &mut T {
    let [known @ .., unclaimed] = all;
    known.get_mut(usize::from(owner)).unwrap_or(unclaimed)
}

/// Where the stretch of like cells that begins at each ends.
type Ends = [u16; RANGE_CELLS];

/// The stretches of cells that are alike.
fn ends(cells: usize, alike: impl Fn(usize, usize) -> bool) -> Ends {
    let mut out = [0; RANGE_CELLS];
    let mut end = cells as u16;
    for (i, slot) in out.iter_mut().enumerate().take(cells).rev() {
        if i + 1 < cells && !alike(i, i + 1) {
            end = i as u16 + 1;
        }
        *slot = end;
    }
    out
}

/// These stretches in order.
fn stretches(ends: &Ends) -> impl Iterator<Item = core::ops::Range<usize>> + '_ {
    let mut from = 0;
    core::iter::from_fn(move || {
        let end = usize::from(*ends.get(from)?);
        // Beyond the cells there are none.
        (end > from).then(|| core::mem::replace(&mut from, end)..end)
    })
}

/// What an owner's cells hold in a minute.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    /// Of the cells that show a vessel: what they held, and hold now.
    before: f32,
    after: f32,
    /// Of the others: what they held.
    hidden: f32,
    /// All that they hold now.
    total: f32,
}

/// The greatest of a minute's log ratios at each cell, whatever the speed.
fn best_of(grid: &Grid) -> [i16; RANGE_CELLS] {
    let mut out = [i16::MIN; RANGE_CELLS];
    for row in grid {
        out.iter_mut().zip(row).for_each(|(best, g)| *best = (*best).max(*g));
    }
    out
}

/// A log ratio of echoes at the table's strengths, for echoes at a share of them; `energy` is half the energy modelled.
/// With ⟨y, μ⟩ = log ratio + energy: `a ⟨y, μ⟩ − a² energy` [O 19], greatest at a = ⟨y, μ⟩ / (2 energy).
fn at_share(log_ratio: f32, energy: f32, (least, most): Share) -> f32 {
    let along = log_ratio + energy;
    let known = least * (along - least * energy);
    // Of a share that is known the rest says less by [`UNKNOWN`]; two of three are.
    if least >= most {
        return known;
    }
    let free = math::lesser(along / (2.0 * energy), most);
    let share = if along > 2.0 * least * energy { free } else { least };
    math::greater(share * (along - share * energy) - UNKNOWN, known)
}

/// Range at the middle of a cell: it holds model ranges 2i and 2i + 1.
pub(super) fn range_of(i: usize) -> f32 {
    CELL_M * (f32::from(i as u16) + 0.25)
}

/// Column `k` after a minute at its speed.
fn shifted(density: &Density, k: usize, out: &mut [f32; RANGE_CELLS]) {
    *out = [0.0; RANGE_CELLS];
    let Some(column) = density.get(k) else { return };
    let shift = speed_of(k) * 60.0 / CELL_M;
    let whole = math::f32::floor(shift);
    let part = shift - whole;
    // Out cell i comes from cell i − n (weight 1 − part) and i − n − 1 (weight part), as far as there are these.
    let from = |n: isize| {
        let (skip, back) = if n >= 0 { (n.unsigned_abs(), 0) } else { (0, n.unsigned_abs()) };
        (skip, column.get(back..).unwrap_or_default())
    };
    let n = whole as isize;
    let ((here, near), (next, far)) = (from(n), from(n + 1));
    let moved = |w: f32, d: &u16| w * unpack(*d);
    let mut both = |at: usize, near: &[u16], far: &[u16]| {
        let out = out.get_mut(at..).unwrap_or_default().iter_mut();
        out.zip(near.iter().zip(far)).for_each(|(o, (a, b))| *o = moved(1.0 - part, a) + moved(part, b));
    };
    if here == next {
        // Both reach to the first cell; what comes from farther ends a cell earlier.
        both(0, near, far);
        let last = far.iter().skip(near.len()).map(|b| moved(part, b));
        out.iter_mut().skip(near.len()).zip(last).for_each(|(o, x)| *o = x);
    } else {
        both(next, near.get(1..).unwrap_or_default(), far);
        if let (Some(o), Some(a)) = (out.get_mut(here), near.first()) {
            *o = moved(1.0 - part, a);
        }
    }
}

#[cfg(test)]
impl Presence {
    /// What a log ratio at the table's strengths says of the class of strong vessels.
    pub(super) fn log_ratio_of_a_strong_vessel(log_ratio: f32, energy: f32) -> f32 {
        at_share(log_ratio, energy, SHARES[0])
    }
}

impl Presence {
    /// Not yet started; all zeros.
    pub const fn new() -> Self {
        Self {
            density: [[[0; RANGE_CELLS]; SPEEDS]; CLASSES],
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
    pub(super) fn lend(&mut self) -> &mut Density {
        let [all, ..] = &mut self.density;
        all
    }

    /// Forgets everything learned.
    fn restart(&mut self) {
        self.present = [CHANGE; OWNERS];
        self.owner = [UNCLAIMED; RANGE_CELLS];
        self.tracked = [false; VESSELS];
        let (scale, cells) = (self.prior_scale, self.cells);
        for (density, likely) in self.density.iter_mut().zip(LIKELY) {
            for column in density {
                let prior = |i: usize| if i < cells { likely * range_of(i) * scale } else { 0.0 };
                column.iter_mut().enumerate().for_each(|(i, d)| *d = pack(prior(i)));
            }
        }
    }

    /// Moves the posterior on by one minute.
    pub fn predict(&mut self, work: &mut Columns) {
        let [.., unclaimed] = self.present;
        self.present.iter_mut().for_each(|p| *p = *p * (1.0 - CHANGE) + (1.0 - *p) * CHANGE);
        let [.., present] = self.present;
        let born = ((1.0 - unclaimed) * CHANGE / present).clamp(AFRESH, 1.0);
        let (scale, cells) = (self.prior_scale, self.cells);
        for (density, likely) in self.density.iter_mut().zip(LIKELY) {
            // Three shifted columns at a time: below, here, above.
            let [mut below, mut here, mut above, fresh] = work.each_mut();
            *below = [0.0; RANGE_CELLS];
            let anew = |i: usize| born * likely * range_of(i) * scale;
            fresh.iter_mut().enumerate().for_each(|(i, fresh)| *fresh = anew(i));
            shifted(density, 0, here);
            for k in 0..SPEEDS {
                shifted(density, k + 1, above);
                // At the ends of the speed axis the share that would leave it stays.
                let ends = if k == 0 || k + 1 == SPEEDS { SPEED_SPREAD } else { 0.0 };
                let stay = 1.0 - 2.0 * SPEED_SPREAD + ends;
                if let Some(column) = density.get_mut(k) {
                    let moved = below.iter().zip(here.iter()).zip(above.iter()).zip(fresh.iter());
                    for (d, (((b, h), a), fresh)) in column.iter_mut().zip(moved).take(cells) {
                        let x = stay * h + SPEED_SPREAD * (b + a);
                        *d = pack((1.0 - born) * x + fresh);
                    }
                }
                (below, here, above) = (here, above, below);
            }
        }
        self.fade();
    }

    /// What each share may have become.
    fn fade(&mut self) {
        let [all, some, little] = &mut self.density;
        let of_class =
            all.as_flattened_mut().iter_mut().zip(some.as_flattened_mut()).zip(little.as_flattened_mut());
        for ((a, b), c) in of_class {
            let [x, y, z] = [*a, *b, *c].map(unpack);
            *a = pack(x + FADES * (y - x));
            *b = pack(y + FADES * (x + z - 2.0 * y));
            *c = pack(z + FADES * (y - z));
        }
    }

    /// Takes in one minute's likelihood, made by the model from frames.
    // Called from `report`, whose stack lies below that of the tracks.
    #[inline(never)]
    pub fn update(&mut self, grid: &Grid, model: &Interference<'_>, radial: &RadialScratch) -> RangePresence {
        let frames = radial.frames();
        let cells = self.cells;
        let shown: Shown = core::array::from_fn(|i| model.shows(i, frames, LEAST_SUPPORT));
        let energy: [f32; RANGE_CELLS] = core::array::from_fn(|i| model.energy(i, frames));
        let mut top = [0f32; OWNERS];
        // A share's ratio is greatest where that of the full strengths is.
        for ((g, energy), owner) in best_of(grid).iter().zip(&energy).zip(&self.owner).take(cells) {
            let top = of(&mut top, *owner);
            let log_ratio = f32::from(*g) * GRID_UNIT;
            for share in SHARES {
                let x = at_share(log_ratio, *energy, share);
                *top = if x > *top { x } else { *top };
            }
        }
        let mut miss = top.map(|t| (1.0 - DETECTION) * math::f32::exp(-t));
        let mut silent = top.map(|t| math::f32::exp(-t));
        let mut approaching = [0f32; OWNERS];
        let mut sums = [Sums::default(); OWNERS];
        let owner = &self.owner;
        let ends = ends(cells, |i, next| owner.get(i) == owner.get(next) && shown.get(i) == shown.get(next));
        let classes = self.density.iter_mut().zip(SHARES);
        let columns =
            classes.flat_map(|(d, share)| d.iter_mut().zip(grid).enumerate().map(move |x| (share, x)));
        for (share, (k, (column, row))) in columns {
            for at in stretches(&ends) {
                let (Some(owner), Some(shown)) = (self.owner.get(at.start), shown.get(at.start)) else {
                    continue;
                };
                let (top, miss, silent) =
                    (*of(&mut top, *owner), *of(&mut miss, *owner), *of(&mut silent, *owner));
                // The sum of what approaches goes on from column to column as the others do.
                let (mut own, mut leaning) = (*of(&mut sums, *owner), *of(&mut approaching, *owner));
                if *shown {
                    cells::take(
                        column,
                        row,
                        &energy,
                        at,
                        &Alike { share, top, miss },
                        (&mut own, &mut leaning),
                    );
                } else {
                    for held in column.get(at).unwrap_or_default().iter().map(|d| unpack(*d)) {
                        own.hidden += held;
                        own.total += held * silent;
                        leaning += held * silent;
                    }
                }
                *of(&mut sums, *owner) = own;
                if k < SPEEDS / 2 {
                    *of(&mut approaching, *owner) = leaning;
                }
            }
        }
        let [.., unclaimed] = &sums;
        let usable = unclaimed.total > 1e-37;
        if !usable {
            self.restart();
            return RangePresence {
                log_odds: math::f32::ln(CHANGE),
                log_evidence: 0.0,
                approaching: 0.5,
                modes: [None; RANGE_MODES],
            };
        }
        // What is hidden keeps its share, unless nothing else is left; of a vessel not tracked only a little, or noise would
        // gather there what nothing can contradict.
        let mut scale = [(0f32, 0f32); OWNERS];
        for (owner, (scale, sums)) in scale.iter_mut().zip(&sums).enumerate() {
            let Sums { before, after, hidden, .. } = *sums;
            let most = if owner == usize::from(UNCLAIMED) { MOST_HIDDEN } else { 1.0 };
            *scale = if after > 1e-37 {
                let share = (hidden / (before + hidden)).min(most);
                ((1.0 - share) / after, share / hidden.max(1e-37))
            } else {
                (0.0, 1.0 / hidden.max(1e-37))
            };
        }
        for column in self.density.as_flattened_mut() {
            for at in stretches(&ends) {
                let (Some(owner), Some(shown)) = (self.owner.get(at.start), shown.get(at.start)) else {
                    continue;
                };
                let (seen, hidden) = *of(&mut scale, *owner);
                let scale = if *shown { seen } else { hidden };
                let cells = column.get_mut(at).unwrap_or_default();
                cells.iter_mut().for_each(|d| *d = pack(unpack(*d) * scale));
            }
        }
        let mut evidence = [f32::NEG_INFINITY; OWNERS];
        let (mut log_odds, mut log_evidence) = (f32::NEG_INFINITY, f32::NEG_INFINITY);
        let (mut leaning, mut sure) = (0f32, 0f32);
        for k in 0..OWNERS {
            let (Some(total), Some(top), Some(present), Some(evidence)) =
                (sums.get(k).map(|s| s.total), top.get(k), self.present.get_mut(k), evidence.get_mut(k))
            else {
                continue;
            };
            if total <= 1e-37 {
                continue;
            }
            *evidence = math::f32::ln(total) + top;
            let odds = (math::f32::ln(*present / (1.0 - *present)) + *evidence).clamp(-12.0, 12.0);
            *present = math::f32::exp(odds) / (1.0 + math::f32::exp(odds));
            log_odds = log_odds.max(odds);
            log_evidence = log_evidence.max(*evidence);
            leaning += *present * approaching.get(k).copied().unwrap_or(0.0) / total;
            sure += *present;
        }
        let modes = self.modes(&mut evidence, grid, &energy, &shown, radial);
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
}
