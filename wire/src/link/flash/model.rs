//! A flash in memory whose power can be cut at any write and any erase.

use super::{ERASED, Flash, Word};
use core::cell::Cell;

/// What a cut of power leaves of the write or erase that was under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// Nothing of it was done.
    Before,
    /// Part of it.
    During,
    /// All of it.
    After,
}

/// One word: what it holds, unless it cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cell32 {
    value: Word,
    damaged: bool,
}

/// A flash of `SECTORS` sectors of `WORDS` words in memory.
#[derive(Clone, Debug)]
pub struct ModelFlash<const SECTORS: usize, const WORDS: usize> {
    words: [[Cell32; WORDS]; SECTORS],
    /// Looks at it for which an erase makes it busy.
    pub erase_looks: u32,
    looks: Cell<u32>,
    erasing: Option<usize>,
    cut: Option<(u32, Cut)>,
    off: bool,
    operations: u32,
    erases: [u32; SECTORS],
    misuses: Cell<u32>,
}

impl<const SECTORS: usize, const WORDS: usize> ModelFlash<SECTORS, WORDS> {
    /// Erased, as it comes from the factory.
    pub const fn new() -> Self {
        Self {
            words: [[Cell32 { value: ERASED, damaged: false }; WORDS]; SECTORS],
            erase_looks: 5,
            looks: Cell::new(0),
            erasing: None,
            cut: None,
            off: false,
            operations: 0,
            erases: [0; SECTORS],
            misuses: Cell::new(0),
        }
    }

    /// Power goes at the write or erase of this number, counted from the first.
    pub fn cut_at(&mut self, operation: u32, cut: Cut) {
        self.cut = Some((operation, cut));
    }

    /// Whether the power has gone.
    pub fn is_off(&self) -> bool {
        self.off
    }

    /// Power comes back.
    pub fn switch_on(&mut self) {
        (self.off, self.cut, self.erasing) = (false, None, None);
        self.looks.set(0);
    }

    /// A word cannot be read any more.
    pub fn damage(&mut self, sector: u8, word: u16) {
        let cell = self.words.get_mut(usize::from(sector)).and_then(|s| s.get_mut(usize::from(word)));
        cell.into_iter().for_each(|cell| cell.damaged = true);
    }

    /// Writes and erases so far.
    pub fn operations(&self) -> u32 {
        self.operations
    }

    /// How often each sector was erased.
    pub fn erases(&self) -> &[u32; SECTORS] {
        &self.erases
    }

    /// Times something was done that a flash does not allow: a word written twice, anything while it was busy.
    pub fn misuses(&self) -> u32 {
        self.misuses.get()
    }

    fn misused(&self) {
        self.misuses.set(self.misuses.get() + 1);
    }

    /// How the next operation ends; the power may go with it.
    fn operate(&mut self) -> Cut {
        let number = self.operations;
        self.operations += 1;
        match self.cut {
            Some((at, cut)) if at == number => {
                self.off = true;
                cut
            }
            _ => Cut::After,
        }
    }

    /// A number that has to do with the operations so far and nothing else.
    fn chance(&self, n: usize) -> u32 {
        let x = self.operations.wrapping_mul(0x9e37_79b9).wrapping_add(n as u32).wrapping_mul(0x85eb_ca6b);
        (x ^ x >> 13).wrapping_mul(0xc2b2_ae35) >> 16
    }
}

impl<const SECTORS: usize, const WORDS: usize> Default for ModelFlash<SECTORS, WORDS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const SECTORS: usize, const WORDS: usize> Flash for ModelFlash<SECTORS, WORDS> {
    const SECTORS: u8 = SECTORS as u8;
    const WORDS: u16 = WORDS as u16;

    fn read(&self, sector: u8, word: u16) -> Option<Word> {
        if self.erasing.is_some() && self.looks.get() > 0 {
            self.misused();
        }
        let cell = self.words.get(usize::from(sector))?.get(usize::from(word))?;
        (!cell.damaged).then_some(cell.value)
    }

    fn write(&mut self, sector: u8, word: u16, value: &Word) {
        if self.off {
            return;
        }
        if self.looks.get() > 0 {
            self.misused();
        }
        let (done, chance) = (self.operate(), self.chance(0));
        let cell = self.words.get_mut(usize::from(sector)).and_then(|s| s.get_mut(usize::from(word)));
        let Some(cell) = cell else { return self.misused() };
        let clean = *cell == Cell32 { value: ERASED, damaged: false };
        match done {
            Cut::Before => {}
            Cut::During => {
                // Some bits are written; mostly, the error correction notices.
                for (n, (to, from)) in cell.value.iter_mut().zip(value).enumerate() {
                    *to &= if (chance >> (n % 16)) & 1 == 0 { *from } else { 0xff };
                }
                cell.damaged = !chance.is_multiple_of(8);
            }
            Cut::After => cell.value = *value,
        }
        if !clean {
            self.misused();
        }
    }

    fn erase(&mut self, sector: u8) {
        if self.off {
            return;
        }
        if self.looks.get() > 0 {
            self.misused();
        }
        let done = self.operate();
        let chances: [u32; WORDS] = core::array::from_fn(|n| self.chance(n));
        let Some(words) = self.words.get_mut(usize::from(sector)) else { return self.misused() };
        if let Some(erases) = self.erases.get_mut(usize::from(sector)) {
            *erases += 1;
        }
        for (cell, chance) in words.iter_mut().zip(chances) {
            match (done, chance % 4) {
                (Cut::Before, _) | (Cut::During, 0) => {}
                (Cut::During, 1) => cell.damaged = true,
                _ => *cell = Cell32 { value: ERASED, damaged: false },
            }
        }
        if !self.off {
            self.erasing = Some(usize::from(sector));
            self.looks.set(self.erase_looks);
        }
    }

    fn busy(&self) -> bool {
        let looks = self.looks.get();
        self.looks.set(looks.saturating_sub(1));
        looks > 0 && !self.off
    }
}
