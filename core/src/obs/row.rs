//! What is kept of a frame's azigram: a direction and a phase a bin, in one word.
//!
//! A word holds the azimuth in steps of 2π/[`CIRCLE`] in its lower bits and above them the phase between pressure and
//! velocity in steps of π/[`PHASES`] from −π/2.

use super::bursts::Excess;
use super::limits::{AZIMUTH_BINS, CIRCLE};

/// Steps of a stored phase over [−π/2, π/2).
pub const PHASES: usize = 16;

/// The word of a bin without a direction.
const NO_DIRECTION: u16 = u16::MAX;

/// Greatest burst energy over the mean, in eighths, from which on a frame may hold a call: noise alone
/// exceeds it in one half-frame of twelve, which costs work but no false call.
pub(super) const UNEVEN: u8 = 22;

/// One frame's directions.
#[derive(Clone, Debug)]
pub struct Row {
    words: [u16; AZIMUTH_BINS],
    /// Greatest burst of pressure over its mean, in eighths (see `impulsive`).
    pub uneven: u8,
    /// What its bursts add to the steady sound.
    pub(super) excess: Excess,
}

impl Row {
    /// A row without directions.
    pub const EMPTY: Self = Self { words: [NO_DIRECTION; AZIMUTH_BINS], uneven: 0, excess: Excess::NONE };

    /// A row that is all zeros, for memory not yet used.
    pub const ZERO: Self = Self { words: [0; AZIMUTH_BINS], uneven: 0, excess: Excess::NONE };

    /// Forgets every direction.
    pub fn clear(&mut self) {
        self.words.fill(NO_DIRECTION);
    }

    /// Words of the first bins, each made by [`word`].
    pub(super) fn first_mut(&mut self, bins: usize) -> &mut [u16] {
        self.words.get_mut(..bins).unwrap_or_default()
    }

    /// Gives the first bins the directions of an iterator: azimuth and phase, in steps, or none.
    #[cfg(test)]
    pub fn fill(&mut self, directions: impl Iterator<Item = Option<(u16, u8)>>) {
        for (word, direction) in self.words.iter_mut().zip(directions) {
            let (azimuth, phase) = direction.unwrap_or_default();
            *word = self::word(direction.is_some(), azimuth.into(), phase.into());
        }
    }

    /// Azimuth and phase of every bin, in steps.
    pub fn directions(&self) -> impl Iterator<Item = Option<(u16, u8)>> {
        self.words.iter().map(|word| split(*word))
    }

    /// Azimuth and phase of a bin, in steps.
    pub fn direction(&self, bin: usize) -> Option<(u16, u8)> {
        self.words.get(bin).and_then(|word| split(*word))
    }

    /// Azimuth of a bin, in steps.
    pub fn azimuth(&self, bin: usize) -> Option<u16> {
        self.direction(bin).map(|(azimuth, _)| azimuth)
    }

    /// Whether the frame's pressure was so uneven in time that it may hold a call.
    pub fn may_hold_a_call(&self) -> bool {
        self.uneven >= UNEVEN
    }
}

/// The word of an azimuth and a phase in steps, if there is a direction.
#[inline(always)]
pub(super) fn word(any: bool, azimuth: u32, phase: u32) -> u16 {
    let word = azimuth % CIRCLE as u32 + phase % PHASES as u32 * CIRCLE as u32;
    if any { word as u16 } else { NO_DIRECTION }
}

fn split(word: u16) -> Option<(u16, u8)> {
    (word != NO_DIRECTION).then_some((word % CIRCLE as u16, (word / CIRCLE as u16) as u8))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_gives_back_what_it_was_given() {
        let mut row = Row::EMPTY;
        assert!(row.directions().all(|d| d.is_none()));
        let given =
            |k: usize| (!k.is_multiple_of(5)).then_some(((k * 37 % CIRCLE) as u16, (k % PHASES) as u8));
        row.fill((0..200).map(given));
        assert!((0..200).all(|k| row.direction(k) == given(k)) && row.direction(200).is_none());
        // The greatest word is not the one that means none.
        row.fill([Some((CIRCLE as u16 - 1, PHASES as u8 - 1))].into_iter());
        assert_eq!(row.direction(0), Some((CIRCLE as u16 - 1, PHASES as u8 - 1)));
    }
}
