//! A minute's likelihood taken into the cells of a stretch that show a vessel.
//!
//! Enters: what the cells hold, their log ratios and the energy modelled. Leaves: what they hold now, `held · (miss + Pd ℓ)`, and the
//! sums of both. Likelihoods are computed some cells at a time, apart from the sums, whose terms wait for each other. Arrays of
//! known length, which a desktop processor computes four numbers of at once, are written out for it: code that the target has no
//! room for, where loops as long as the stretch are as fast. Both give the same bits. Cost: 40 instructions a cell.

use super::super::limits::RANGE_CELLS;
use super::super::radial::GRID_UNIT;
use super::{DETECTION, Share, Sums, at_share, pack, unpack};
use crate::math;

/// Cells whose likelihoods are computed at a time, in arrays and in loops.
const BLOCK: usize = 16;
const LONG: usize = 32;

/// What the cells of a stretch have in common.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alike {
    /// The share of the table's strengths.
    pub(super) share: Share,
    /// The greatest log ratio, and against its exponential the evidence of a vessel that does not show.
    pub(super) top: f32,
    pub(super) miss: f32,
}

/// Takes a stretch of cells of a column; what they hold now is added to `leaning` too.
#[inline(always)]
pub(super) fn take(
    column: &mut [u16; RANGE_CELLS],
    row: &[i16; RANGE_CELLS],
    energy: &[f32; RANGE_CELLS],
    at: core::ops::Range<usize>,
    alike: &Alike,
    sums: (&mut Sums, &mut f32),
) {
    if cfg!(target_arch = "arm") {
        in_loops(column, row, energy, at, alike, sums);
    } else {
        in_arrays(column, row, energy, at, alike, sums);
    }
}

/// In loops as long as the stretch.
#[inline(always)]
fn in_loops(
    column: &mut [u16; RANGE_CELLS],
    row: &[i16; RANGE_CELLS],
    energy: &[f32; RANGE_CELLS],
    at: core::ops::Range<usize>,
    alike: &Alike,
    (own, leaning): (&mut Sums, &mut f32),
) {
    let (column, row) = (column.get_mut(at.clone()), row.get(at.clone()));
    let (Some(column), Some(row), Some(energy)) = (column, row, energy.get(at)) else { return };
    let blocks = column.chunks_mut(LONG).zip(row.chunks(LONG)).zip(energy.chunks(LONG));
    for ((column, row), energy) in blocks {
        let (mut held, mut now) = ([0f32; LONG], [0f32; LONG]);
        held.iter_mut().zip(column.iter()).for_each(|(held, d)| *held = unpack(*d));
        for (now, (held, (g, energy))) in now.iter_mut().zip(held.iter().zip(row.iter().zip(energy))) {
            let x = at_share(f32::from(*g) * GRID_UNIT, *energy, alike.share) - alike.top;
            *now = held * (alike.miss + hit(x));
        }
        own.take(held.iter().zip(&now).take(column.len()), leaning);
        column.iter_mut().zip(&now).for_each(|(d, now)| *d = pack(*now));
    }
}

/// In arrays: cells beyond the stretch are computed and left.
#[inline(always)]
fn in_arrays(
    column: &mut [u16; RANGE_CELLS],
    row: &[i16; RANGE_CELLS],
    energy: &[f32; RANGE_CELLS],
    at: core::ops::Range<usize>,
    alike: &Alike,
    (own, leaning): (&mut Sums, &mut f32),
) {
    let (Alike { share, top, miss }, end) = (*alike, at.end);
    for from in at.step_by(BLOCK) {
        let held = block(column, from).map(unpack);
        let log_ratio = block(row, from).map(|g| f32::from(g) * GRID_UNIT);
        let energy = block(energy, from);
        // One question for all.
        let x: [f32; BLOCK] = if share.0 >= share.1 {
            core::array::from_fn(|i| at_share(log_ratio[i], energy[i], (share.0, share.0)) - top)
        } else {
            core::array::from_fn(|i| at_share(log_ratio[i], energy[i], share) - top)
        };
        let hits = x.map(hit);
        let now: [f32; BLOCK] = core::array::from_fn(|i| held[i] * (miss + hits[i]));
        let (packed, cells) = (now.map(pack), column.get_mut(from..end).unwrap_or_default());
        if let Some(cells) = cells.first_chunk_mut() {
            *cells = packed;
            own.take(held.iter().zip(&now), leaning);
        } else {
            own.take(held.iter().zip(&now).take(cells.len()), leaning);
            cells.iter_mut().zip(packed).for_each(|(d, packed)| *d = packed);
        }
    }
}

/// What cells hold from one on, nothing beyond the last.
fn block<T: Copy + Default>(cells: &[T; RANGE_CELLS], from: usize) -> [T; BLOCK] {
    let rest = cells.get(from..).unwrap_or_default();
    let some = || core::array::from_fn(|i| rest.get(i).copied().unwrap_or_default());
    rest.first_chunk().copied().unwrap_or_else(some)
}

/// The likelihood of a log ratio where the vessel shows.
#[inline(always)]
fn hit(x: f32) -> f32 {
    let exp = math::exp_of_negative(math::greater(x, -60.0));
    if x > -60.0 { DETECTION * exp } else { 0.0 }
}

impl Sums {
    /// Takes what cells held and hold now, one after the other.
    #[inline(always)]
    fn take<'a>(&mut self, cells: impl Iterator<Item = (&'a f32, &'a f32)>, leaning: &mut f32) {
        for (held, now) in cells {
            self.before += held;
            self.after += now;
            self.total += now;
            *leaning += now;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::SHARES;
    use super::*;

    #[test]
    fn loops_and_arrays_give_the_same_bits_and_leave_what_is_beside() {
        let mut seed = 17u32;
        let mut random = move || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as f32 / 16_777_216.0
        };
        let column: [u16; RANGE_CELLS] = core::array::from_fn(|_| pack(1e-3 * random()));
        let row: [i16; RANGE_CELLS] = core::array::from_fn(|_| (4000.0 * random() - 2500.0) as i16);
        let energy: [f32; RANGE_CELLS] = core::array::from_fn(|_| 30.0 * random());
        for (from, end) in [(0, RANGE_CELLS), (3, 4), (5, 21), (40, 90), (340, 358), (350, 358), (7, 7)] {
            for share in SHARES {
                let alike = Alike { share, top: 40.0, miss: 1e-4 };
                let run = |loops: bool| {
                    let (mut column, mut own, mut leaning) = (column, Sums::default(), 0f32);
                    let sums = (&mut own, &mut leaning);
                    if loops {
                        in_loops(&mut column, &row, &energy, from..end, &alike, sums);
                    } else {
                        in_arrays(&mut column, &row, &energy, from..end, &alike, sums);
                    }
                    let sums = [own.before, own.after, own.total, leaning].map(f32::to_bits);
                    (column, sums)
                };
                let (new, sums) = run(true);
                assert_eq!((new, sums), run(false), "{from} {end}");
                let beside = |k: usize| !(from..end).contains(&k);
                assert!((0..RANGE_CELLS).all(|k| !beside(k) || new[k] == column[k]));
                assert_eq!(new == column, from == end);
            }
        }
    }
}
