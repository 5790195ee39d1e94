//! 32-bit instructions but for data processing and floating point (A5.3).

use super::{bits, float, reg, sign_extend, wide_data};
use crate::instruction::{Instruction, Op, access};

pub(super) fn decode(address: u32, a: u32, b: u32) -> Instruction {
    match (bits(a, 12, 11), bits(a, 10, 9)) {
        (1, 0) if a & 0x40 == 0 => multiple(a, b),
        (1, 0) => dual(address, a, b),
        (1, 1) => wide_data::shifted_register(a, b),
        (1, _) | (3, 2..) => float::decode(a, b),
        (2, _) if b & 0x8000 != 0 => branches(address, a, b),
        (2, _) if a & 0x200 == 0 => wide_data::modified_immediate(a, b),
        (2, _) => wide_data::plain_immediate(address, a, b),
        (3, 0) => single(address, a, b),
        (3, _) if a & 0x180 == 0x100 => wide_data::multiply(a, b),
        (3, _) if a & 0x180 == 0x180 => wide_data::long_multiply(a, b),
        (3, _) => wide_data::register(a, b),
        _ => i(Op::Unknown),
    }
}

fn i(op: Op) -> Instruction {
    Instruction::new(op, 4)
}

fn multiple(a: u32, b: u32) -> Instruction {
    let (n, s, before) = (reg(a, 0), a & 0x20 != 0, bits(a, 8, 7) == 2);
    if !matches!(bits(a, 8, 7), 1 | 2) || b == 0 {
        return i(Op::Unknown);
    }
    let op = if a & 0x10 != 0 { Op::Ldm } else { Op::Stm };
    Instruction { n, imm: b, s, a: u8::from(before), ..i(op) }
}

fn dual(address: u32, a: u32, b: u32) -> Instruction {
    let (n, load) = (reg(a, 0), a & 0x10 != 0);
    let (add, before, back) = (a & 0x80 != 0, a & 0x100 != 0, a & 0x20 != 0);
    if before || back {
        let offset = (b & 255) << 2;
        let imm = if add { offset } else { offset.wrapping_neg() };
        let x =
            Instruction { d: reg(b, 12), m: reg(b, 8), n, imm, a: u8::from(before), s: back, ..i(Op::Ldrd) };
        if n == 15 {
            // A literal: its address is known.
            let imm = (address.wrapping_add(4) & !3).wrapping_add(imm);
            return if load && !back { Instruction { imm, ..x } } else { i(Op::Unknown) };
        }
        return if load { x } else { Instruction { op: Op::Strd, ..x } };
    }
    match (add, load) {
        (false, false) => Instruction { d: reg(b, 12), m: reg(b, 8), n, imm: (b & 255) << 2, ..i(Op::Strex) },
        (false, true) => Instruction { d: reg(b, 12), n, imm: (b & 255) << 2, ..i(Op::Ldrex) },
        (true, _) => match (bits(b, 7, 4), load) {
            (0, true) => Instruction { n, m: reg(b, 0), ..i(Op::TableBranch) },
            (1, true) => Instruction { n, m: reg(b, 0), s: true, ..i(Op::TableBranch) },
            (4 | 5, true) => Instruction { d: reg(b, 12), n, a: (b >> 4 & 1) as u8, ..i(Op::LdrexShort) },
            (4 | 5, false) => {
                Instruction { d: reg(b, 12), m: reg(b, 0), n, a: (b >> 4 & 1) as u8, ..i(Op::StrexShort) }
            }
            _ => i(Op::Unknown),
        },
    }
}

fn branches(address: u32, a: u32, b: u32) -> Instruction {
    let pc = address.wrapping_add(4);
    let sign = bits(a, 10, 10);
    let (j1, j2) = (bits(b, 13, 13), bits(b, 11, 11));
    let far = || {
        let (i1, i2) = (!(j1 ^ sign) & 1, !(j2 ^ sign) & 1);
        let offset = sign << 24 | i1 << 23 | i2 << 22 | bits(a, 9, 0) << 12 | bits(b, 10, 0) << 1;
        pc.wrapping_add(sign_extend(offset, 25))
    };
    match (bits(b, 14, 14), bits(b, 12, 12)) {
        (1, 1) => Instruction { imm: far(), ..i(Op::Bl) },
        (0, 1) => Instruction { imm: far(), ..i(Op::B) },
        (0, 0) if bits(a, 9, 7) != 7 => {
            let offset = sign << 20 | j2 << 19 | j1 << 18 | bits(a, 5, 0) << 12 | bits(b, 10, 0) << 1;
            Instruction { a: reg(a, 6), imm: pc.wrapping_add(sign_extend(offset, 21)), ..i(Op::BCond) }
        }
        (0, 0) => match bits(a, 10, 4) {
            0b0111000 | 0b0111001 => {
                Instruction { n: reg(a, 0), imm: b & 255, a: bits(b, 11, 10) as u8, ..i(Op::Msr) }
            }
            0b0111010 => i(match b & 255 {
                2 => Op::Wfe,
                3 => Op::Wfi,
                4 => Op::Sev,
                _ => Op::Nop,
            }),
            0b0111011 => i(match bits(b, 7, 4) {
                2 => Op::Clrex,
                4..=6 => Op::Nop,
                _ => Op::Unknown,
            }),
            0b0111110 | 0b0111111 => Instruction { d: reg(b, 8), imm: b & 255, ..i(Op::Mrs) },
            0b1111111 => i(Op::Udf),
            _ => i(Op::Unknown),
        },
        _ => i(Op::Unknown),
    }
}

fn single(address: u32, a: u32, b: u32) -> Instruction {
    let (d, n) = (reg(b, 12), reg(a, 0));
    let (load, size, signed) = (a & 0x10 != 0, bits(a, 6, 5), a & 0x100 != 0);
    if size == 3 || (signed && (!load || size == 2)) {
        return i(Op::Unknown);
    }
    // A load of the program counter by narrower ones is a hint that memory will be wanted.
    if load && d == 15 && size != 2 {
        return i(Op::Nop);
    }
    let pick = |ops: [Op; 8]| match (load, signed) {
        (false, _) => ops[size as usize],
        (true, false) => ops[3 + size as usize],
        (true, true) => ops[6 + size as usize],
    };
    let plain = pick([Op::Strb, Op::Strh, Op::Str, Op::Ldrb, Op::Ldrh, Op::Ldr, Op::Ldrsb, Op::Ldrsh]);
    if n == 15 {
        if !load {
            return i(Op::Unknown);
        }
        let offset = b & 0xfff;
        let offset = if a & 0x80 != 0 { offset } else { offset.wrapping_neg() };
        let imm = (address.wrapping_add(4) & !3).wrapping_add(offset);
        let op = if plain == Op::Ldr { Op::LdrLiteral } else { plain };
        // Narrow literals have no base: the address stands in the offset, and the base is marked as none.
        return if op == Op::LdrLiteral { Instruction { d, imm, ..i(op) } } else { i(Op::Unknown) };
    }
    if a & 0x80 != 0 {
        return Instruction { d, n, imm: b & 0xfff, ..i(plain) };
    }
    if b & 0x800 == 0 {
        if b & 0x7c0 != 0 {
            return i(Op::Unknown);
        }
        let op = pick([
            Op::StrbReg,
            Op::StrhReg,
            Op::StrReg,
            Op::LdrbReg,
            Op::LdrhReg,
            Op::LdrReg,
            Op::LdrsbReg,
            Op::LdrshReg,
        ]);
        return Instruction { d, n, m: reg(b, 0), imm: bits(b, 5, 4), ..i(op) };
    }
    let (before, add, back) = (b & 0x400 != 0, b & 0x200 != 0, b & 0x100 != 0);
    let offset = b & 255;
    let imm = if add { offset } else { offset.wrapping_neg() };
    match (before, back) {
        // Without write-back the offset is subtracted, or this is an unprivileged access, which is plain here.
        (true, false) => Instruction { d, n, imm, ..i(plain) },
        (false, false) => i(Op::Unknown),
        (_, true) => {
            let kind = match (size, signed) {
                (0, true) => access::SIGNED_BYTE,
                (1, true) => access::SIGNED_HALF,
                (size, _) => size as u8,
            };
            let kind = if load { kind } else { kind + access::STORE };
            Instruction { d, n, imm, a: kind, s: before, ..i(Op::Indexed) }
        }
    }
}
