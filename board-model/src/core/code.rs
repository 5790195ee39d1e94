//! Instructions decoded once: the code that runs, kept by halfword until its memory is written.

use super::{Machine, Trouble};
use crate::board::Board;
use crate::decode::decode;
use crate::instruction::{Instruction, Op};

/// Decoded instructions of a stretch of memory, by halfword.
#[derive(Debug, Default)]
pub(super) struct Code {
    pub(super) base: u32,
    pub(super) slots: Vec<Instruction>,
}

impl<B: Board> Machine<B> {
    #[inline(always)]
    pub(super) fn fetch(&mut self, pc: u32) -> Instruction {
        let slot = pc.wrapping_sub(self.code.base) >> 1;
        match self.code.slots.get(slot as usize) {
            Some(i) if i.op != Op::Undecoded => *i,
            _ => self.fetch_first(pc),
        }
    }

    #[cold]
    fn fetch_first(&mut self, pc: u32) -> Instruction {
        let inside = |code: &Code| ((pc.wrapping_sub(code.base) >> 1) as usize) < code.slots.len();
        if !inside(&self.code)
            && let Some(index) = self.other_code.iter().position(inside)
        {
            std::mem::swap(&mut self.code, &mut self.other_code[index]);
            return self.fetch(pc);
        }
        let half = |at| self.memory.load::<2>(at).map(|(b, _)| u16::from_le_bytes(b));
        let Some(first) = half(pc).filter(|_| pc & 1 == 0) else {
            self.fail(Trouble::Bus { address: pc, write: false });
            return Instruction { len: 0, ..Instruction::new(Op::Nop, 2) };
        };
        let i = decode(pc, first, half(pc.wrapping_add(2)).unwrap_or(0));
        if inside(&self.code) {
            self.code.slots[(pc.wrapping_sub(self.code.base) >> 1) as usize] = i;
        }
        i
    }

    /// Forgets what was decoded around an address that was written.
    pub(super) fn forget_code(&mut self, address: u32, length: u32) {
        for code in std::iter::once(&mut self.code).chain(&mut self.other_code) {
            if (address.wrapping_sub(code.base) >> 1) as usize > code.slots.len() {
                continue;
            }
            let first = (address.wrapping_sub(code.base) >> 1) as usize;
            // A long instruction may begin one halfword before.
            for slot in first.saturating_sub(1)..=first + (length as usize).div_ceil(2) {
                if let Some(slot) = code.slots.get_mut(slot) {
                    *slot = Instruction::UNDECODED;
                }
            }
        }
    }
}
