//! From halfwords to [`Instruction`]s (ARMv7-M Architecture Reference Manual, chapter A5).

mod float;
mod narrow;
mod wide;
mod wide_data;
pub(crate) use wide_data::dsp;

use crate::instruction::Instruction;

/// The instruction at an address; `second` is the halfword behind it.
pub(crate) fn decode(address: u32, first: u16, second: u16) -> Instruction {
    if first >= 0xe800 {
        wide::decode(address, u32::from(first), u32::from(second))
    } else {
        narrow::decode(address, u32::from(first))
    }
}

/// Bits `high` to `low` of a word.
fn bits(word: u32, high: u32, low: u32) -> u32 {
    word >> low & ((1u32 << (high - low + 1)) - 1)
}

/// A register's number.
fn reg(word: u32, low: u32) -> u8 {
    (word >> low & 15) as u8
}

fn sign_extend(value: u32, bits: u32) -> u32 {
    ((value << (32 - bits)) as i32 >> (32 - bits)) as u32
}
