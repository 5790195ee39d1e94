//! 32-bit data processing (A5.3.1, A5.3.3, A5.3.11 to A5.3.17).

use super::{bits, reg};
use crate::instruction::{Instruction, Op, alu, shift};

fn i(op: Op) -> Instruction {
    Instruction::new(op, 4)
}

/// ThumbExpandImm (A5.3.2) and whether the constant was rotated, which sets carry.
fn expand(imm12: u32) -> (u32, bool) {
    let byte = imm12 & 255;
    match (imm12 >> 10, imm12 >> 8 & 3) {
        (0, 0) => (byte, false),
        (0, 1) => (byte << 16 | byte, false),
        (0, 2) => (byte << 24 | byte << 8, false),
        (0, _) => (byte * 0x0101_0101, false),
        _ => ((byte & 127 | 128).rotate_right(imm12 >> 7), true),
    }
}

/// The operation of a data-processing encoding with its special cases, and its destination.
fn operation(code: u32, d: u8, n: u8, s: bool) -> Option<u8> {
    let compare = d == 15 && s;
    Some(match code {
        0 if compare => alu::TST,
        0 => alu::AND,
        1 => alu::BIC,
        2 if n == 15 => alu::MOV,
        2 => alu::ORR,
        3 if n == 15 => alu::MVN,
        3 => alu::ORN,
        4 if compare => alu::TEQ,
        4 => alu::EOR,
        8 if compare => alu::CMN,
        8 => alu::ADD,
        10 => alu::ADC,
        11 => alu::SBC,
        13 if compare => alu::CMP,
        13 => alu::SUB,
        14 => alu::RSB,
        _ => return None,
    })
}

pub(super) fn modified_immediate(a: u32, b: u32) -> Instruction {
    let (imm, rotated) = expand(bits(a, 10, 10) << 11 | bits(b, 14, 12) << 8 | b & 255);
    let (d, n, s) = (reg(b, 8), reg(a, 0), a & 16 != 0);
    let Some(a) = operation(bits(a, 8, 5), d, n, s) else { return i(Op::Unknown) };
    let op = match (a, s) {
        (alu::ADD, false) => Op::AddImm,
        (alu::ADD, true) => Op::AddImmS,
        (alu::SUB, false) => Op::SubImm,
        (alu::SUB, true) => Op::SubImmS,
        (alu::CMP, _) => Op::CmpImm,
        (alu::MOV, false) => Op::MovImm,
        _ => Op::DpImm,
    };
    Instruction { d, n, imm, a, s, k: u8::from(rotated), ..i(op) }
}

pub(super) fn shifted_register(a: u32, b: u32) -> Instruction {
    let (d, n, m, s) = (reg(b, 8), reg(a, 0), reg(b, 0), a & 16 != 0);
    let (kind, amount) = (bits(b, 5, 4) as u8, bits(b, 14, 12) << 2 | bits(b, 7, 6));
    let (kind, amount) = match (kind, amount) {
        (shift::ROR, 0) => (shift::RRX, 1),
        (shift::LSR | shift::ASR, 0) => (kind, 32),
        other => other,
    };
    let x = Instruction { d, n, m, k: kind, imm: amount, s, ..i(Op::DpShift) };
    let code = bits(a, 8, 5);
    if code == 6 {
        // PKHBT shifts left, PKHTB arithmetically right.
        return Instruction { op: Op::Pkh, s: b & 0x20 != 0, ..x };
    }
    let Some(a) = operation(code, d, n, s) else { return i(Op::Unknown) };
    let x = Instruction { a, ..x };
    if amount != 0 {
        return if a == alu::ADD && !s && kind == shift::LSL {
            Instruction { op: Op::AddLsl, ..x }
        } else {
            x
        };
    }
    let op = match (a, s) {
        (alu::ADD, false) => Op::AddReg,
        (alu::ADD, true) => Op::AddRegS,
        (alu::SUB, false) => Op::SubReg,
        (alu::SUB, true) => Op::SubRegS,
        (alu::CMP, _) => Op::CmpReg,
        (alu::MOV, false) => Op::MovReg,
        _ => Op::DpReg,
    };
    Instruction { op, ..x }
}

pub(super) fn plain_immediate(address: u32, a: u32, b: u32) -> Instruction {
    let (d, n) = (reg(b, 8), reg(a, 0));
    let imm = bits(a, 10, 10) << 11 | bits(b, 14, 12) << 8 | b & 255;
    let (lsb, last) = (bits(b, 14, 12) << 2 | bits(b, 7, 6), b & 31);
    let pc = address.wrapping_add(4) & !3;
    match bits(a, 8, 4) {
        0 if n == 15 => Instruction { d, imm: pc.wrapping_add(imm), ..i(Op::MovImm) },
        0 => Instruction { d, n, imm, ..i(Op::AddImm) },
        0b01010 if n == 15 => Instruction { d, imm: pc.wrapping_sub(imm), ..i(Op::MovImm) },
        0b01010 => Instruction { d, n, imm, ..i(Op::SubImm) },
        0b00100 => Instruction { d, imm: u32::from(n) << 12 | imm, ..i(Op::MovImm) },
        0b01100 => Instruction { d, imm: u32::from(n) << 12 | imm, ..i(Op::MovT) },
        0b10010 if lsb == 0 => Instruction { d, n, a: last as u8 + 1, s: true, ..i(Op::Sat16) },
        0b11010 if lsb == 0 => Instruction { d, n, a: last as u8, ..i(Op::Sat16) },
        0b10000 | 0b10010 => {
            let k = (a >> 4 & 2) as u8;
            Instruction { d, n, imm: lsb, k, a: last as u8 + 1, s: true, ..i(Op::Sat) }
        }
        0b11000 | 0b11010 => {
            let k = (a >> 4 & 2) as u8;
            Instruction { d, n, imm: lsb, k, a: last as u8, ..i(Op::Sat) }
        }
        0b10100 => Instruction { d, n, imm: lsb, k: last as u8 + 1, ..i(Op::Sbfx) },
        0b11100 => Instruction { d, n, imm: lsb, k: last as u8 + 1, ..i(Op::Ubfx) },
        // n 15: clears the field
        0b10110 if last >= lsb => Instruction { d, n, imm: lsb, k: (last - lsb) as u8 + 1, ..i(Op::Bfi) },
        _ => i(Op::Unknown),
    }
}

pub(super) fn register(a: u32, b: u32) -> Instruction {
    let (d, n, m) = (reg(b, 8), reg(a, 0), reg(b, 0));
    let x = |op| Instruction { d, n, m, ..i(op) };
    if b & 0xf000 != 0xf000 {
        return i(Op::Unknown);
    }
    let (code, kind) = (bits(a, 7, 4), bits(b, 7, 4));
    match (code, kind) {
        (0..=7, 0) => Instruction { k: (code >> 1) as u8, s: a & 16 != 0, ..x(Op::ShiftReg) },
        (0..=5, 8..) => {
            let imm = bits(b, 5, 4) * 8;
            let short = [Op::Sxth, Op::Uxth, Op::Extend, Op::Extend, Op::Sxtb, Op::Uxtb][code as usize];
            let op = if n == 15 && imm == 0 { short } else { Op::Extend };
            Instruction { imm, a: code as u8, ..x(op) }
        }
        (8.., 0..=7) => Instruction { a: bits(a, 6, 4) as u8, k: kind as u8, ..x(Op::Parallel) },
        (8, 8..=11) => Instruction { a: (kind & 3) as u8, ..x(Op::Qadd) },
        (9, 8..=11) => x([Op::Rev, Op::Rev16, Op::Rbit, Op::Revsh][kind as usize & 3]),
        (10, 8) => x(Op::Sel),
        (11, 8) => x(Op::Clz),
        _ => i(Op::Unknown),
    }
}

/// Kinds of DSP multiplications, with halves chosen by bits 8 (n) and 9 (m) of the field.
pub(crate) mod dsp {
    pub const HALVES: u32 = 1;
    pub const WORD_HALF: u32 = 2;
    /// Sum of the products of both halves; bit 8: halves of m exchanged.
    pub const DUAL_ADD: u32 = 3;
    pub const DUAL_SUB: u32 = 4;
    /// Most significant word; bit 8: rounded.
    pub const TOP: u32 = 5;
    pub const TOP_SUB: u32 = 6;
    /// Sum of absolute differences.
    pub const ABSOLUTE: u32 = 7;
}

pub(super) fn multiply(a: u32, b: u32) -> Instruction {
    let (d, n, m, acc) = (reg(b, 8), reg(a, 0), reg(b, 0), reg(b, 12));
    let x = |op| Instruction { d, n, m, a: acc, ..i(op) };
    let kind = bits(b, 7, 4);
    let dsp = |imm| Instruction { imm, ..x(Op::DspMul) };
    let flag = (kind & 1) << 8;
    match (bits(a, 6, 4), kind) {
        (0, 0) if acc == 15 => x(Op::Mul),
        (0, 0) => x(Op::Mla),
        (0, 1) => x(Op::Mls),
        (1, 0..=3) => dsp(dsp::HALVES | (kind >> 1) << 8 | (kind & 1) << 9),
        (2, 0 | 1) => dsp(dsp::DUAL_ADD | flag),
        (3, 0 | 1) => dsp(dsp::WORD_HALF | (kind & 1) << 9),
        (4, 0 | 1) => dsp(dsp::DUAL_SUB | flag),
        (5, 0 | 1) => dsp(dsp::TOP | flag),
        (6, 0 | 1) => dsp(dsp::TOP_SUB | flag),
        (7, 0) => dsp(dsp::ABSOLUTE),
        _ => i(Op::Unknown),
    }
}

pub(super) fn long_multiply(a: u32, b: u32) -> Instruction {
    let (n, m, low, high) = (reg(a, 0), reg(b, 0), reg(b, 12), reg(b, 8));
    let x = |op| Instruction { d: low, a: high, n, m, ..i(op) };
    let kind = bits(b, 7, 4);
    let long = |imm| Instruction { imm, ..x(Op::DspLong) };
    match (bits(a, 6, 4), kind) {
        (0, 0) => x(Op::Smull),
        (1, 15) => Instruction { d: high, n, m, ..i(Op::Sdiv) },
        (2, 0) => x(Op::Umull),
        (3, 15) => Instruction { d: high, n, m, ..i(Op::Udiv) },
        (4, 0) => x(Op::Smlal),
        (4, 8..=11) => long(dsp::HALVES | (kind >> 1 & 1) << 8 | (kind & 1) << 9),
        (4, 12 | 13) => long(dsp::DUAL_ADD | (kind & 1) << 8),
        (5, 12 | 13) => long(dsp::DUAL_SUB | (kind & 1) << 8),
        (6, 0) => x(Op::Umlal),
        (6, 6) => x(Op::Umaal),
        _ => i(Op::Unknown),
    }
}
