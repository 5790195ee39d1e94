//! 16-bit instructions (A5.2).

use super::{bits, sign_extend};
use crate::instruction::{Instruction, Op, alu, shift};

fn low(word: u32, at: u32) -> u8 {
    (word >> at & 7) as u8
}

pub(super) fn decode(address: u32, w: u32) -> Instruction {
    let i = |op| Instruction::new(op, 2);
    let pc = address.wrapping_add(4);
    match w >> 11 {
        0b00000..=0b00010 => shift_immediate(w),
        0b00011 => {
            let (d, n, m) = (low(w, 0), low(w, 3), low(w, 6));
            match bits(w, 10, 9) {
                0 => Instruction { d, n, m, ..i(Op::AddRegS) },
                1 => Instruction { d, n, m, ..i(Op::SubRegS) },
                2 => Instruction { d, n, imm: u32::from(m), ..i(Op::AddImmS) },
                _ => Instruction { d, n, imm: u32::from(m), ..i(Op::SubImmS) },
            }
        }
        0b00100 => Instruction { d: low(w, 8), imm: w & 255, ..i(Op::MovImmS) },
        0b00101 => Instruction { n: low(w, 8), imm: w & 255, ..i(Op::CmpImm) },
        0b00110 => Instruction { d: low(w, 8), n: low(w, 8), imm: w & 255, ..i(Op::AddImmS) },
        0b00111 => Instruction { d: low(w, 8), n: low(w, 8), imm: w & 255, ..i(Op::SubImmS) },
        0b01000 if w & 0x400 == 0 => data_processing(w),
        0b01000 => special(w),
        0b01001 => {
            let imm = (pc & !3).wrapping_add((w & 255) << 2);
            Instruction { d: low(w, 8), imm, ..i(Op::LdrLiteral) }
        }
        0b01010 | 0b01011 => {
            let op = [
                Op::StrReg,
                Op::StrhReg,
                Op::StrbReg,
                Op::LdrsbReg,
                Op::LdrReg,
                Op::LdrhReg,
                Op::LdrbReg,
                Op::LdrshReg,
            ][bits(w, 11, 9) as usize];
            Instruction { d: low(w, 0), n: low(w, 3), m: low(w, 6), ..i(op) }
        }
        0b01100..=0b10001 => {
            let (op, scale) = match w >> 11 {
                0b01100 => (Op::Str, 2),
                0b01101 => (Op::Ldr, 2),
                0b01110 => (Op::Strb, 0),
                0b01111 => (Op::Ldrb, 0),
                0b10000 => (Op::Strh, 1),
                _ => (Op::Ldrh, 1),
            };
            Instruction { d: low(w, 0), n: low(w, 3), imm: bits(w, 10, 6) << scale, ..i(op) }
        }
        0b10010 => Instruction { d: low(w, 8), n: 13, imm: (w & 255) << 2, ..i(Op::Str) },
        0b10011 => Instruction { d: low(w, 8), n: 13, imm: (w & 255) << 2, ..i(Op::Ldr) },
        0b10100 => Instruction { d: low(w, 8), imm: (pc & !3).wrapping_add((w & 255) << 2), ..i(Op::MovImm) },
        0b10101 => Instruction { d: low(w, 8), n: 13, imm: (w & 255) << 2, ..i(Op::AddImm) },
        0b10110 | 0b10111 => miscellaneous(pc, w),
        0b11000 => Instruction { n: low(w, 8), imm: w & 255, s: true, ..i(Op::Stm) },
        0b11001 => {
            let n = low(w, 8);
            Instruction { n, imm: w & 255, s: w >> n & 1 == 0, ..i(Op::Ldm) }
        }
        0b11010 | 0b11011 => match bits(w, 11, 8) {
            14 => i(Op::Udf),
            15 => Instruction { imm: w & 255, ..i(Op::Svc) },
            condition => {
                let imm = pc.wrapping_add(sign_extend(w & 255, 8) << 1);
                Instruction { a: condition as u8, imm, ..i(Op::BCond) }
            }
        },
        _ => Instruction { imm: pc.wrapping_add(sign_extend(w & 0x7ff, 11) << 1), ..i(Op::B) },
    }
}

fn shift_immediate(w: u32) -> Instruction {
    let (kind, amount) = ((w >> 11) as u8, bits(w, 10, 6));
    let amount = if amount == 0 && kind != shift::LSL { 32 } else { amount };
    let i =
        Instruction { d: low(w, 0), m: low(w, 3), a: alu::MOV, s: true, ..Instruction::new(Op::DpShift, 2) };
    if amount == 0 {
        return Instruction { op: Op::DpReg, ..i };
    }
    Instruction { k: kind, imm: amount, ..i }
}

fn data_processing(w: u32) -> Instruction {
    let (d, m) = (low(w, 0), low(w, 3));
    let i = Instruction { d, n: d, m, s: true, ..Instruction::new(Op::DpReg, 2) };
    let dp = |a| Instruction { a, ..i };
    let by = |k| Instruction { op: Op::ShiftReg, k, ..i };
    match bits(w, 9, 6) {
        0 => dp(alu::AND),
        1 => dp(alu::EOR),
        2 => by(shift::LSL),
        3 => by(shift::LSR),
        4 => by(shift::ASR),
        5 => dp(alu::ADC),
        6 => dp(alu::SBC),
        7 => by(shift::ROR),
        8 => dp(alu::TST),
        9 => Instruction { op: Op::DpImm, n: m, a: alu::RSB, imm: 0, ..i },
        10 => Instruction { op: Op::CmpReg, ..i },
        11 => dp(alu::CMN),
        12 => dp(alu::ORR),
        13 => Instruction { op: Op::Mul, n: m, m: d, ..i },
        14 => dp(alu::BIC),
        _ => dp(alu::MVN),
    }
}

fn special(w: u32) -> Instruction {
    let (d, m) = ((w >> 4 & 8 | w & 7) as u8, (w >> 3 & 15) as u8);
    let i = |op| Instruction { d, n: d, m, ..Instruction::new(op, 2) };
    match bits(w, 9, 7) {
        0 | 1 => i(Op::AddReg),
        2 | 3 => i(Op::CmpReg),
        4 | 5 => i(Op::MovReg),
        6 => i(Op::Bx),
        _ => i(Op::Blx),
    }
}

fn miscellaneous(pc: u32, w: u32) -> Instruction {
    let i = |op| Instruction::new(op, 2);
    let (d, m) = (low(w, 0), low(w, 3));
    match bits(w, 11, 5) {
        0b0000000..=0b0000011 => Instruction { d: 13, n: 13, imm: (w & 127) << 2, ..i(Op::AddImm) },
        0b0000100..=0b0000111 => Instruction { d: 13, n: 13, imm: (w & 127) << 2, ..i(Op::SubImm) },
        x if x & 0b0101000 == 0b0001000 => {
            let imm = pc.wrapping_add((w >> 3 & 64) | bits(w, 7, 3) << 1);
            Instruction { n: d, imm, s: w & 0x800 != 0, ..i(Op::Cbz) }
        }
        0b0010000..=0b0010111 => {
            let op = [Op::Sxth, Op::Sxtb, Op::Uxth, Op::Uxtb][bits(w, 7, 6) as usize];
            Instruction { d, m, ..i(op) }
        }
        0b0100000..=0b0101111 => {
            Instruction { n: 13, imm: w & 255 | (w & 256) << 6, s: true, a: 1, ..i(Op::Stm) }
        }
        0b0110011 => Instruction { imm: w & 3, s: w & 16 != 0, ..i(Op::Cps) },
        0b1010000..=0b1010011 => Instruction { d, m, ..i(if w & 64 == 0 { Op::Rev } else { Op::Rev16 }) },
        0b1010110 | 0b1010111 => Instruction { d, m, ..i(Op::Revsh) },
        0b1100000..=0b1101111 => Instruction { n: 13, imm: w & 255 | (w & 256) << 7, s: true, ..i(Op::Ldm) },
        0b1110000..=0b1110111 => Instruction { imm: w & 255, ..i(Op::Bkpt) },
        0b1111000..=0b1111111 if w & 15 != 0 => Instruction { imm: w & 255, ..i(Op::It) },
        0b1111000..=0b1111111 => i(match bits(w, 7, 4) {
            2 => Op::Wfe,
            3 => Op::Wfi,
            4 => Op::Sev,
            _ => Op::Nop,
        }),
        _ => i(Op::Unknown),
    }
}
