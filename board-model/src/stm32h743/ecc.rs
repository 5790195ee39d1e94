//! Monitors of the memories' error correction (RM0433, "RAM ECC monitoring"; places and flags as in the maker's headers).
//!
//! A wrong bit is told at once, and not when the word is next read.

use super::clocks::unknown;
use crate::board::Refusal;

/// Words of a monitor, the first of the block is the interrupts'.
const STEP: usize = 0x20;
const FOUND: usize = 1;
const WHERE: usize = 2;
const CORRECTED: u32 = 1;
const NOT_CORRECTED: u32 = 2;
/// The configuration's bit that keeps the first error's address.
const KEEP: u32 = 1 << 5;

/// The blocks of the domains D1 and D2, five monitors each.
#[derive(Debug, Default)]
pub(super) struct Ecc {
    monitors: [[[u32; 3]; 5]; 2],
}

/// Block, monitor and offset of an address in one of the memories that have a monitor.
fn monitor(address: u32) -> Option<(usize, usize, u32)> {
    /// Where a memory begins, its length, its block and its monitor.
    const MEMORIES: [(u32, u32, usize, usize); 7] = [
        (0x2400_0000, 512 << 10, 0, 0),
        (0, 64 << 10, 0, 1),
        (0x2000_0000, 128 << 10, 0, 2),
        (0x3000_0000, 64 << 10, 1, 0),
        (0x3001_0000, 64 << 10, 1, 1),
        (0x3002_0000, 64 << 10, 1, 2),
        (0x3003_0000, 64 << 10, 1, 3),
    ];
    let found = MEMORIES.into_iter().find(|(base, length, ..)| address.wrapping_sub(*base) < *length)?;
    // The two halves of the data's tightly coupled memory are words by turns.
    let half = if found.0 == 0x2000_0000 { address as usize >> 2 & 1 } else { 0 };
    Some((found.2, found.3 + half, address - found.0))
}

impl Ecc {
    /// A word at this address had one wrong bit, which is corrected, or more. Whether a monitor sees it.
    pub fn tell(&mut self, address: u32, corrected: bool) -> bool {
        let Some((block, monitor, offset)) = monitor(address) else { return false };
        let [configuration, found, place] = &mut self.monitors[block][monitor];
        if *configuration & KEEP != 0 && *found == 0 {
            *place = offset;
        }
        *found |= if corrected { CORRECTED } else { NOT_CORRECTED };
        true
    }

    fn word(&mut self, block: usize, offset: usize) -> Result<&mut u32, Refusal> {
        let unknown = || unknown("RAMECC", offset);
        let monitor = (offset / STEP).checked_sub(1).ok_or_else(unknown)?;
        let monitor = self.monitors[block].get_mut(monitor).ok_or_else(unknown)?;
        monitor.get_mut(offset % STEP / 4).ok_or_else(unknown)
    }

    pub fn read(&mut self, block: usize, offset: usize) -> Result<u32, Refusal> {
        Ok(*self.word(block, offset)?)
    }

    pub fn write(&mut self, block: usize, offset: usize, value: u32) -> Result<(), Refusal> {
        let word = self.word(block, offset)?;
        match offset % STEP / 4 {
            // Flags are cleared and not set by the software.
            FOUND => *word &= value,
            WHERE => {}
            _ => *word = value,
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_bit_is_told_with_its_place_until_the_flag_is_cleared() {
        let mut ecc = Ecc::default();
        assert_eq!(ecc.write(0, 0x20, KEEP), Ok(()));
        assert!(ecc.tell(0x2400_1230, true) && ecc.tell(0x2400_4568, false));
        assert_eq!((ecc.read(0, 0x24), ecc.read(0, 0x28)), (Ok(CORRECTED | NOT_CORRECTED), Ok(0x1230)));
        assert_eq!(ecc.write(0, 0x24, 0), Ok(()));
        assert_eq!(ecc.read(0, 0x24), Ok(0));
        assert!(ecc.tell(0x3001_0008, true), "the second half of D2's first memory");
        assert_eq!(ecc.read(1, 0x44), Ok(CORRECTED));
        assert!(!ecc.tell(0x0800_0000, true), "flash has its own");
        assert!(ecc.read(0, 0).is_err() && ecc.read(1, 0xc0).is_err());
    }
}
