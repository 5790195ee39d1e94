//! Floating point: FPv5, single and double precision (A6, A7.5 to A7.9).

use super::{bits, reg};
use crate::instruction::{Instruction, Op, rounding};

fn i(op: Op) -> Instruction {
    Instruction::new(op, 4)
}

/// Number of a register from its four bits and its one bit.
fn number(double: bool, four: u32, one: u32) -> u8 {
    (if double { (one & 1) << 4 | four & 15 } else { (four & 15) << 1 | one & 1 }) as u8
}

struct Fields {
    double: bool,
    d: u8,
    n: u8,
    m: u8,
}

impl Fields {
    fn of(a: u32, b: u32) -> Self {
        let double = b & 0x100 != 0;
        Self {
            double,
            d: number(double, b >> 12, a >> 6),
            n: number(double, a, b >> 7),
            m: number(double, b, b >> 5),
        }
    }

    fn op(&self, single: Op, double: Op) -> Instruction {
        Instruction { d: self.d, n: self.n, m: self.m, ..i(if self.double { double } else { single }) }
    }
}

pub(super) fn decode(a: u32, b: u32) -> Instruction {
    if bits(b, 11, 9) != 5 {
        return i(Op::Unknown);
    }
    match (a >> 8, b & 16) {
        (0xec | 0xed, _) => transfers(a, b),
        (0xee, 0) => arithmetic(a, b),
        (0xee, _) => core_transfer(a, b),
        (0xfe, 0) => fp_v5(a, b),
        _ => i(Op::Unknown),
    }
}

fn transfers(a: u32, b: u32) -> Instruction {
    let f = Fields::of(a, b);
    let (before, add, back, load) = (a & 0x100 != 0, a & 0x80 != 0, a & 0x20 != 0, a & 0x10 != 0);
    let n = reg(a, 0);
    if !before && !add && !back {
        if bits(a, 6, 6) == 0 || b & 0xd0 != 0x10 {
            return i(Op::Unknown);
        }
        let first = if f.double { f.m << 1 } else { f.m };
        let op = if load { Op::VmovTwoToCore } else { Op::VmovTwoFromCore };
        return Instruction { d: reg(b, 12), m: n, n: first, ..i(op) };
    }
    if before && !back {
        let offset = (b & 255) << 2;
        let imm = if add { offset } else { offset.wrapping_neg() };
        let op = match (load, f.double) {
            (true, false) => Op::VldrS,
            (true, true) => Op::VldrD,
            (false, false) => Op::VstrS,
            (false, true) => Op::VstrD,
        };
        return Instruction { d: f.d, n, imm, ..i(op) };
    }
    if before == add {
        return i(Op::Unknown);
    }
    let first = if f.double { f.d << 1 } else { f.d };
    let words = b & 255 & if f.double { !1 } else { !0 };
    if words == 0 || u32::from(first) + words > 32 {
        return i(Op::Unknown);
    }
    let op = if load { Op::Vldm } else { Op::Vstm };
    Instruction { d: first, n, imm: words, s: back, a: u8::from(before), ..i(op) }
}

fn arithmetic(a: u32, b: u32) -> Instruction {
    let f = Fields::of(a, b);
    let op = (b >> 6 & 1) as u8;
    match (bits(a, 7, 7) << 2 | bits(a, 5, 4), op) {
        (0, _) => Instruction { a: op, ..f.op(Op::VmlaS, Op::VmlaD) },
        (1, _) => Instruction { a: 2 | op, ..f.op(Op::VmlaS, Op::VmlaD) },
        (2, 0) => f.op(Op::VmulS, Op::VmulD),
        (2, _) => f.op(Op::VnmulS, Op::VnmulD),
        (3, 0) => f.op(Op::VaddS, Op::VaddD),
        (3, _) => f.op(Op::VsubS, Op::VsubD),
        (4, 0) => f.op(Op::VdivS, Op::VdivD),
        (5, _) => Instruction { a: 2 | op, ..f.op(Op::VfmaS, Op::VfmaD) },
        (6, _) => Instruction { a: op, ..f.op(Op::VfmaS, Op::VfmaD) },
        (7, 0) => {
            let byte = bits(a, 3, 0) << 4 | b & 15;
            let (sign, b6, rest) = (byte >> 7 << 31, byte >> 6 & 1, byte & 63);
            let imm = match (f.double, b6) {
                (false, 0) => sign | 0x4000_0000 | rest << 19,
                (false, _) => sign | 0x3e00_0000 | rest << 19,
                (true, 0) => sign | 0x4000_0000 | rest << 16,
                (true, _) => sign | 0x3fc0_0000 | rest << 16,
            };
            Instruction { imm, ..f.op(Op::VmovImmS, Op::VmovImmD) }
        }
        (7, _) => one_operand(a, b, &f),
        _ => i(Op::Unknown),
    }
}

fn one_operand(a: u32, b: u32, f: &Fields) -> Instruction {
    let high = b & 0x80 != 0;
    let single_d = number(false, b >> 12, a >> 6);
    let single_m = number(false, b, b >> 5);
    match (bits(a, 3, 0), high) {
        (0, false) => f.op(Op::VmovS, Op::VmovD),
        (0, true) => f.op(Op::VabsS, Op::VabsD),
        (1, false) => f.op(Op::VnegS, Op::VnegD),
        (1, true) => f.op(Op::VsqrtS, Op::VsqrtD),
        (2 | 3, top) => {
            let to_half = a & 1 != 0;
            let d = if f.double && to_half { single_d } else { f.d };
            let m = if f.double && !to_half { single_m } else { f.m };
            let k = u8::from(f.double);
            Instruction { d, m, a: u8::from(top) | u8::from(to_half) << 1, k, ..i(Op::VcvtHalf) }
        }
        (4, _) => f.op(Op::VcmpS, Op::VcmpD),
        (5, _) => Instruction { a: 1, ..f.op(Op::VcmpS, Op::VcmpD) },
        (6, false) | (7, false) => Instruction { k: rounding::CURRENT, ..f.op(Op::VrintS, Op::VrintD) },
        (6, true) => Instruction { k: rounding::ZERO, ..f.op(Op::VrintS, Op::VrintD) },
        (7, true) if f.double => Instruction { d: single_d, m: f.m, ..i(Op::VcvtSD) },
        (7, true) => Instruction { d: number(true, b >> 12, a >> 6), m: f.m, ..i(Op::VcvtDS) },
        (8, signed) => {
            Instruction { m: single_m, a: u8::from(signed), ..f.op(Op::VcvtIntToS, Op::VcvtIntToD) }
        }
        (12 | 13, to_zero) => {
            let k = if to_zero { rounding::ZERO } else { rounding::CURRENT };
            Instruction { d: single_d, a: (a & 1) as u8, k, ..f.op(Op::VcvtSToInt, Op::VcvtDToInt) }
        }
        (10 | 11 | 14 | 15, wide) => {
            let size = if wide { 32 } else { 16 };
            let fraction = size - (((b & 15) << 1) | (b >> 5 & 1)) as i32;
            if fraction < 0 {
                return i(Op::Unknown);
            }
            let kind = (!a & 1) as u8 | u8::from(!wide) << 1 | (a & 4) as u8;
            Instruction { a: kind, imm: fraction as u32, ..f.op(Op::VcvtFixedS, Op::VcvtFixedD) }
        }
        _ => i(Op::Unknown),
    }
}

fn fp_v5(a: u32, b: u32) -> Instruction {
    let f = Fields::of(a, b);
    let op = (b >> 6 & 1) as u8;
    // Ties away, ties to even, up, down.
    let k = bits(a, 1, 0) as u8;
    match (bits(a, 7, 7), bits(a, 5, 4), op) {
        (0, condition, 0) => Instruction { a: condition as u8, ..f.op(Op::VselS, Op::VselD) },
        (1, 0, _) => Instruction { a: op, ..f.op(Op::VmaxnmS, Op::VmaxnmD) },
        (1, 3, 1) if bits(a, 3, 2) == 2 => Instruction { k, ..f.op(Op::VrintS, Op::VrintD) },
        (1, 3, 1) if bits(a, 3, 2) == 3 => {
            let d = number(false, b >> 12, a >> 6);
            Instruction { d, a: (b >> 7 & 1) as u8, k, ..f.op(Op::VcvtSToInt, Op::VcvtDToInt) }
        }
        _ => i(Op::Unknown),
    }
}

fn core_transfer(a: u32, b: u32) -> Instruction {
    let (t, load) = (reg(b, 12), a & 16 != 0);
    match (b & 0x100 != 0, bits(a, 7, 5)) {
        (false, 0) => {
            let op = if load { Op::VmovToCore } else { Op::VmovFromCore };
            Instruction { d: t, n: number(false, a, b >> 7), ..i(op) }
        }
        (false, 7) if bits(a, 3, 0) == 1 => Instruction { d: t, ..i(if load { Op::Vmrs } else { Op::Vmsr }) },
        (true, x @ (0 | 1)) if b & 0x60 == 0 => {
            let op = if load { Op::VmovToCore } else { Op::VmovFromCore };
            Instruction { d: t, n: number(true, a, b >> 7) << 1 | x as u8, ..i(op) }
        }
        _ => i(Op::Unknown),
    }
}
