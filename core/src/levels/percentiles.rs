//! Percentiles of the levels of cells and decidecades over snapshots, by counting them in steps of half a decibel.

use super::bands::IN_DECIDECADE;
use super::cells::CELLS;
use super::lanes::Lanes;
use crate::block::CHANNELS;
use crate::math;

/// Which are told: the levels that so many of a hundred snapshots are below.
pub const PERCENT: [u8; 3] = [5, 50, 95];

/// The lowest level that is counted, dB re full scale squared; what is lower is counted as this.
const LOWEST_DB: f32 = -190.0;
const STEP_DB: f32 = 0.5;
const STEPS: usize = 400;

/// How often a cell or decidecade had each level, by channel.
pub type Row = [[u32; CHANNELS]; STEPS];

/// Nothing counted.
pub const EMPTY_ROW: Row = [[0; CHANNELS]; STEPS];

/// A row for each cell, at its place ([`super::Plan::place`]), then one for each decidecade: 1.4 MB.
pub const ROWS: usize = CELLS + CELLS / IN_DECIDECADE as usize;

/// The row of the decidecade whose first cell is at `place`.
pub fn row_of_decidecade(place: usize) -> usize {
    CELLS + place / IN_DECIDECADE as usize
}

/// Forgets everything.
pub(super) fn clear(counts: &mut [Row]) {
    counts.as_flattened_mut().fill([0; CHANNELS]);
}

/// Counts a snapshot's mean square, of the channels that took part.
pub(super) fn note(counts: &mut [Row], row: usize, mean_square: Lanes, taken: [bool; CHANNELS]) {
    let Some(steps) = counts.get_mut(row) else { return };
    for (c, (power, taken)) in mean_square.0.into_iter().zip(taken).enumerate() {
        let step = ((math::db(power) - LOWEST_DB) / STEP_DB).max(0.0) as usize;
        let count = steps.get_mut(step.min(STEPS - 1)).and_then(|s| s.get_mut(c));
        if let Some(count) = count.filter(|_| taken) {
            *count = count.saturating_add(1);
        }
    }
}

/// Levels of a row that [`PERCENT`] of the snapshots of a channel are below, dB re full scale squared, within half a decibel;
/// `None` without snapshots and below −189.5 dB.
pub fn percentiles_db(counts: &[Row], row: usize, channel: usize) -> [Option<f32>; PERCENT.len()] {
    let row = || counts.get(row).into_iter().flatten().filter_map(|s| s.get(channel)).copied();
    let all: u64 = row().map(u64::from).sum();
    let mut wanted = PERCENT.map(|percent| (all as f32 * f32::from(percent) / 100.0, None));
    let mut below = 0.0;
    for (step, count) in row().enumerate().filter(|(_, n)| *n > 0) {
        let count = count as f32;
        for (wanted, level) in &mut wanted {
            if level.is_none() && below + count >= *wanted {
                let share = (*wanted - below) / count;
                *level = Some((step > 0).then_some(LOWEST_DB + STEP_DB * (step as f32 + share)));
            }
        }
        below += count;
    }
    wanted.map(|(_, level)| level.flatten())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_known_levels_are_within_half_a_decibel() {
        let mut all = std::vec![EMPTY_ROW; 5];
        for n in 0..1000 {
            let power = math::f32::powf(10.0, (-100.0 + 0.02 * n as f32) / 10.0);
            note(&mut all, 3, Lanes([power, 0.0, power, 1.0]), [true, true, false, true]);
        }
        for (got, want) in percentiles_db(&all, 3, 0).into_iter().zip([-99.0f32, -90.0, -81.0]) {
            assert!((got.unwrap() - want).abs() < 0.5);
        }
        let at = |row, channel| percentiles_db(&all, row, channel)[1];
        assert_eq!((at(3, 1), at(3, 2), at(4, 0)), (None, None, None));
        assert!(at(3, 3).unwrap().abs() < 0.5);
        clear(&mut all);
        assert_eq!(percentiles_db(&all, 3, 0), [None; 3]);
    }
}
