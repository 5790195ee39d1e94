//! Data processing: arithmetic, logic, shifts, multiplications, saturation, SIMD in registers (A7.7).

use super::{Machine, Trouble, exception::fault};
use crate::board::Board;
use crate::decode::dsp;
use crate::instruction::{Instruction, alu, shift};

/// Sum, carry and overflow (AddWithCarry).
#[inline(always)]
fn add_with_carry(x: u32, y: u32, carry: bool) -> (u32, bool, bool) {
    let sum = u64::from(x) + u64::from(y) + u64::from(carry);
    let result = sum as u32;
    (result, sum >> 32 != 0, (x ^ result) & (y ^ result) & 1 << 31 != 0)
}

/// A shifted value and the bit shifted out last; amounts of 1 to 255.
#[inline(always)]
fn shifted(value: u32, kind: u8, amount: u32, carry: bool) -> (u32, bool) {
    match kind {
        _ if amount == 0 => (value, carry),
        shift::LSL if amount < 32 => (value << amount, value >> (32 - amount) & 1 != 0),
        shift::LSL => (0, amount == 32 && value & 1 != 0),
        shift::LSR if amount < 32 => (value >> amount, value >> (amount - 1) & 1 != 0),
        shift::LSR => (0, amount == 32 && value >> 31 != 0),
        shift::ASR if amount < 32 => ((value as i32 >> amount) as u32, value as i32 >> (amount - 1) & 1 != 0),
        shift::ASR => ((value as i32 >> 31) as u32, value >> 31 != 0),
        shift::ROR => {
            let result = value.rotate_right(amount & 31);
            (result, result >> 31 != 0)
        }
        _ => (value >> 1 | u32::from(carry) << 31, value & 1 != 0),
    }
}

fn saturate(value: i64, bits: u32) -> (i32, bool) {
    let (low, high) = (-(1i64 << (bits - 1)), (1i64 << (bits - 1)) - 1);
    (value.clamp(low, high) as i32, value < low || value > high)
}

fn saturate_unsigned(value: i64, bits: u32) -> (u32, bool) {
    let high = (1i64 << bits) - 1;
    (value.clamp(0, high) as u32, value < 0 || value > high)
}

fn half(value: u32, top: bool) -> i32 {
    if top { value as i32 >> 16 } else { i32::from(value as i16) }
}

impl<B: Board> Machine<B> {
    #[inline(always)]
    pub(super) fn set_nz(&mut self, result: u32) {
        self.negative = result >> 31 != 0;
        self.zero = result == 0;
    }

    /// x + y + carry with all flags.
    #[inline(always)]
    pub(super) fn add_flags(&mut self, x: u32, y: u32, carry: bool) -> u32 {
        let (result, carry, overflow) = add_with_carry(x, y, carry);
        self.set_nz(result);
        self.carry = carry;
        self.overflow = overflow;
        result
    }

    /// One operation of data processing; `carry` is the shifter's.
    #[inline(always)]
    pub(super) fn data_processing(&mut self, i: Instruction, y: u32, carry: bool) {
        let x = self.r[usize::from(i.n & 15)];
        let d = usize::from(i.d & 15);
        let logic = match i.a {
            alu::AND | alu::TST => x & y,
            alu::BIC => x & !y,
            alu::ORR => x | y,
            alu::ORN => x | !y,
            alu::EOR | alu::TEQ => x ^ y,
            alu::MOV => y,
            alu::MVN => !y,
            _ => {
                let (a, b, c) = match i.a {
                    alu::ADD | alu::CMN => (x, y, false),
                    alu::ADC => (x, y, self.carry),
                    alu::SBC => (x, !y, self.carry),
                    alu::SUB | alu::CMP => (x, !y, true),
                    _ => (!x, y, true),
                };
                if i.s || i.a >= alu::TST {
                    let result = self.add_flags(a, b, c);
                    if i.a < alu::TST {
                        self.r[d] = result;
                    }
                } else {
                    self.r[d] = add_with_carry(a, b, c).0;
                }
                return;
            }
        };
        if i.s || i.a >= alu::TST {
            self.set_nz(logic);
            self.carry = carry;
        }
        if i.a < alu::TST {
            self.r[d] = logic;
        }
    }

    /// The shifted register m and the shifter's carry.
    #[inline(always)]
    pub(super) fn shifter(&self, i: Instruction) -> (u32, bool) {
        shifted(self.r[usize::from(i.m & 15)], i.k, i.imm, self.carry)
    }

    pub(super) fn shift_register(&mut self, i: Instruction) {
        let amount = self.r[usize::from(i.m & 15)] & 255;
        let (result, carry) = shifted(self.r[usize::from(i.n & 15)], i.k, amount, self.carry);
        self.r[usize::from(i.d & 15)] = result;
        if i.s {
            self.set_nz(result);
            self.carry = carry;
        }
    }

    pub(super) fn divide(&mut self, i: Instruction, signed: bool) {
        let (n, m) = (self.r[usize::from(i.n & 15)], self.r[usize::from(i.m & 15)]);
        self.r[usize::from(i.d & 15)] = match (m, signed) {
            (0, _) => {
                if self.system.traps_division() {
                    self.fail(Trouble::Usage(fault::DIVIDE_BY_ZERO));
                }
                0
            }
            (_, true) => (n as i32).wrapping_div(m as i32) as u32,
            (_, false) => n / m,
        };
    }

    pub(super) fn extend(&mut self, i: Instruction) {
        let value = self.r[usize::from(i.m & 15)].rotate_right(i.imm);
        let pair = |low: u32, high: u32| low & 0xffff | high << 16;
        let base = if i.n == 15 { 0 } else { self.r[usize::from(i.n & 15)] };
        let sum_of_halves =
            |low: u32, high: u32| pair(base.wrapping_add(low), (base >> 16).wrapping_add(high));
        self.r[usize::from(i.d & 15)] = match i.a {
            0 => base.wrapping_add(i32::from(value as i16) as u32),
            1 => base.wrapping_add(value & 0xffff),
            2 => sum_of_halves(i32::from(value as i8) as u32, i32::from((value >> 16) as i8) as u32),
            3 => sum_of_halves(value & 255, value >> 16 & 255),
            4 => base.wrapping_add(i32::from(value as i8) as u32),
            _ => base.wrapping_add(value & 255),
        };
    }

    pub(super) fn saturation(&mut self, i: Instruction) {
        let value = self.r[usize::from(i.n & 15)];
        let (value, _) = shifted(value, i.k, if i.k == shift::ASR && i.imm == 0 { 32 } else { i.imm }, false);
        let value = i64::from(value as i32);
        let (result, hit) = if i.s {
            let (result, hit) = saturate(value, u32::from(i.a));
            (result as u32, hit)
        } else {
            saturate_unsigned(value, u32::from(i.a))
        };
        self.saturated |= hit;
        self.r[usize::from(i.d & 15)] = result;
    }

    pub(super) fn saturation_16(&mut self, i: Instruction) {
        let n = self.r[usize::from(i.n & 15)];
        let mut result = 0;
        for top in [false, true] {
            let value = i64::from(half(n, top));
            let (part, hit) = if i.s {
                let (part, hit) = saturate(value, u32::from(i.a));
                (part as u32, hit)
            } else {
                saturate_unsigned(value, u32::from(i.a))
            };
            self.saturated |= hit;
            result |= (part & 0xffff) << (16 * u32::from(top));
        }
        self.r[usize::from(i.d & 15)] = result;
    }

    pub(super) fn q_add(&mut self, i: Instruction) {
        let (n, m) = (self.r[usize::from(i.n & 15)] as i32, self.r[usize::from(i.m & 15)] as i32);
        let n = if i.a & 1 != 0 {
            let (doubled, hit) = saturate(2 * i64::from(n), 32);
            self.saturated |= hit;
            doubled
        } else {
            n
        };
        let n = i64::from(n);
        let (result, hit) = saturate(i64::from(m) + if i.a & 2 != 0 { -n } else { n }, 32);
        self.saturated |= hit;
        self.r[usize::from(i.d & 15)] = result as u32;
    }

    pub(super) fn pack(&mut self, i: Instruction) {
        let n = self.r[usize::from(i.n & 15)];
        let y = self.shifter(i).0;
        let (low, high) = if i.s { (y, n) } else { (n, y) };
        self.r[usize::from(i.d & 15)] = low & 0xffff | high & 0xffff_0000;
    }

    pub(super) fn select(&mut self, i: Instruction) {
        let (n, m) = (self.r[usize::from(i.n & 15)], self.r[usize::from(i.m & 15)]);
        let mask: u32 = (0..4).filter(|byte| self.ge >> byte & 1 != 0).map(|byte| 255 << (8 * byte)).sum();
        self.r[usize::from(i.d & 15)] = n & mask | m & !mask;
    }

    /// Additions and subtractions of halves or bytes side by side.
    pub(super) fn parallel(&mut self, i: Instruction) {
        let (n, m) = (self.r[usize::from(i.n & 15)], self.r[usize::from(i.m & 15)]);
        let unsigned = i.k & 4 != 0;
        let wide = !matches!(i.a, 0 | 4);
        let bits: u32 = if wide { 16 } else { 8 };
        let lane = |word: u32, index: u32| {
            let value = i64::from(word >> (index * bits) & ((1 << bits) - 1));
            if unsigned || value < 1 << (bits - 1) { value } else { value - (1 << bits) }
        };
        let (mut result, mut ge) = (0u32, 0u8);
        for index in 0..32 / bits {
            // Exchanging forms take the other half, and add in one and subtract in the other.
            let crossed = matches!(i.a, 2 | 6);
            let other = lane(m, if crossed { 1 - index } else { index });
            let subtract = match i.a {
                4 | 5 => true,
                2 => index == 0,
                6 => index == 1,
                _ => false,
            };
            let sum = lane(n, index) + if subtract { -other } else { other };
            let part = match i.k & 3 {
                1 if unsigned => i64::from(saturate_unsigned(sum, bits).0),
                1 => i64::from(saturate(sum, bits).0),
                2 => sum >> 1,
                _ => {
                    let set = if unsigned && !subtract { sum >> bits != 0 } else { sum >= 0 };
                    let lanes = if wide { 3 << (2 * index) } else { 1 << index };
                    ge |= if set { lanes } else { 0 };
                    sum
                }
            };
            result |= ((part as u32) & (((1u64 << bits) - 1) as u32)) << (index * bits);
        }
        if i.k & 3 == 0 {
            self.ge = ge;
        }
        self.r[usize::from(i.d & 15)] = result;
    }

    pub(super) fn dsp_multiply(&mut self, i: Instruction) {
        let (n, m) = (self.r[usize::from(i.n & 15)], self.r[usize::from(i.m & 15)]);
        let acc = if i.a == 15 { 0 } else { i64::from(self.r[usize::from(i.a & 15)] as i32) };
        let (n_top, m_top) = (i.imm & 0x100 != 0, i.imm & 0x200 != 0);
        let result = match i.imm & 255 {
            dsp::HALVES => acc + i64::from(half(n, n_top)) * i64::from(half(m, m_top)),
            dsp::WORD_HALF => acc + ((i64::from(n as i32) * i64::from(half(m, m_top))) >> 16),
            dsp::DUAL_ADD | dsp::DUAL_SUB => {
                let m = if n_top { m.rotate_right(16) } else { m };
                let low = i64::from(half(n, false)) * i64::from(half(m, false));
                let high = i64::from(half(n, true)) * i64::from(half(m, true));
                acc + low + if i.imm & 255 == dsp::DUAL_SUB { -high } else { high }
            }
            kind @ (dsp::TOP | dsp::TOP_SUB) => {
                let product = i64::from(n as i32) * i64::from(m as i32);
                let sum = if kind == dsp::TOP {
                    (acc << 32).wrapping_add(product)
                } else {
                    (acc << 32).wrapping_sub(product)
                };
                let rounded = if n_top { sum.wrapping_add(0x8000_0000) } else { sum };
                self.r[usize::from(i.d & 15)] = (rounded >> 32) as u32;
                return;
            }
            _ => {
                let byte = |word: u32, at: u32| i64::from(word >> (8 * at) & 255);
                acc + (0..4).map(|at| (byte(n, at) - byte(m, at)).abs()).sum::<i64>()
            }
        };
        // Absolute differences do not saturate; a sum without accumulator cannot but for the dual products.
        if i.imm & 255 != dsp::ABSOLUTE && i64::from(result as i32) != result {
            self.saturated = true;
        }
        self.r[usize::from(i.d & 15)] = result as u32;
    }

    pub(super) fn dsp_long(&mut self, i: Instruction) {
        let (n, m) = (self.r[usize::from(i.n & 15)], self.r[usize::from(i.m & 15)]);
        let (n_top, m_top) = (i.imm & 0x100 != 0, i.imm & 0x200 != 0);
        let product = if i.imm & 255 == dsp::HALVES {
            i64::from(half(n, n_top)) * i64::from(half(m, m_top))
        } else {
            let m = if n_top { m.rotate_right(16) } else { m };
            let low = i64::from(half(n, false)) * i64::from(half(m, false));
            let high = i64::from(half(n, true)) * i64::from(half(m, true));
            low + if i.imm & 255 == dsp::DUAL_SUB { -high } else { high }
        };
        let sum = self.long(i).wrapping_add(product as u64);
        self.set_long(i, sum);
    }

    pub(super) fn long(&self, i: Instruction) -> u64 {
        u64::from(self.r[usize::from(i.a & 15)]) << 32 | u64::from(self.r[usize::from(i.d & 15)])
    }

    pub(super) fn set_long(&mut self, i: Instruction, value: u64) {
        self.r[usize::from(i.d & 15)] = value as u32;
        self.r[usize::from(i.a & 15)] = (value >> 32) as u32;
    }

    /// Whether a condition of an instruction holds (A7.3).
    #[inline(always)]
    pub(super) fn condition(&self, condition: u8) -> bool {
        let holds = match condition >> 1 {
            0 => self.zero,
            1 => self.carry,
            2 => self.negative,
            3 => self.overflow,
            4 => self.carry && !self.zero,
            5 => self.negative == self.overflow,
            6 => self.negative == self.overflow && !self.zero,
            _ => return true,
        };
        holds != (condition & 1 != 0)
    }
}
