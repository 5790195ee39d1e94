//! Floating point: results as IEEE 754 and A2.5 say; NaNs as the architecture makes and passes them on. Rounding is to
//! the nearest; the cumulative exception flags of FPSCR are not kept.

use super::{Machine, Trouble, exception::fault};
use crate::board::Board;
use crate::instruction::{Instruction, Op, rounding};

const DEFAULT_NAN_S: u32 = 0x7fc0_0000;
const DEFAULT_NAN_D: u64 = 0x7ff8_0000_0000_0000;
const QUIET_S: u32 = 1 << 22;
const QUIET_D: u64 = 1 << 51;

/// What a NaN result is: the first signalling operand made quiet, else the first quiet one, else the default.
#[cold]
fn nan_s(operands: &[u32]) -> u32 {
    let nan = |x: &&u32| **x & 0x7fff_ffff > 0x7f80_0000;
    let signalling = operands.iter().filter(nan).find(|x| **x & QUIET_S == 0);
    signalling.or(operands.iter().find(nan)).map_or(DEFAULT_NAN_S, |x| x | QUIET_S)
}

#[cold]
fn nan_d(operands: &[u64]) -> u64 {
    let nan = |x: &&u64| **x & !(1 << 63) > 0x7ff0_0000_0000_0000;
    let signalling = operands.iter().filter(nan).find(|x| **x & QUIET_D == 0);
    signalling.or(operands.iter().find(nan)).map_or(DEFAULT_NAN_D, |x| x | QUIET_D)
}

macro_rules! round {
    ($value:expr, $mode:expr) => {
        match $mode {
            rounding::TIES_AWAY => $value.round(),
            rounding::TIES_EVEN => $value.round_ties_even(),
            rounding::UP => $value.ceil(),
            rounding::DOWN => $value.floor(),
            _ => $value.trunc(),
        }
    };
}

fn half_to_single(h: u32) -> u32 {
    let (sign, exponent, fraction) = ((h >> 15 & 1) << 31, h >> 10 & 31, h & 0x3ff);
    match (exponent, fraction) {
        (0, _) => sign | (fraction as f32 / 16_777_216.0).to_bits(),
        (31, 0) => sign | 0x7f80_0000,
        (31, _) => sign | 0x7fc0_0000 | fraction << 13,
        _ => sign | (exponent + 112) << 23 | fraction << 13,
    }
}

fn double_to_half(value: f64) -> u32 {
    let sign = u32::from(value.is_sign_negative()) << 15;
    if value.is_nan() {
        return sign | 0x7e00 | (value.to_bits() >> 42) as u32 & 0x1ff;
    }
    let x = value.abs();
    let exponent = if x < 6.103_515_625e-5 { -14 } else { ((x.to_bits() >> 52) as i32) - 1023 };
    if exponent > 15 {
        return sign | 0x7c00;
    }
    let steps = (x * 2f64.powi(10 - exponent)).round_ties_even() as u32;
    // 1024 steps are the implied bit; one carried over is the next exponent's.
    sign | ((exponent + 14) as u32 * 1024 + steps).min(0x7c00)
}

impl<B: Board> Machine<B> {
    /// Before a floating-point instruction: the context is saved or made as needed (ExecuteFPCheck, B1.5.7).
    #[cold]
    pub(super) fn prepare_float(&mut self) -> bool {
        if !self.system.float_on() {
            self.fail(Trouble::Usage(fault::NO_COPROCESSOR));
            return false;
        }
        if self.lazy {
            self.lazy = false;
            self.save_float(self.system.fpcar);
        }
        if self.system.automatic_stacking() && !self.fp_active {
            self.fpscr = self.fpscr & !0x07c0_0000 | self.system.default_fpscr();
            self.fp_active = true;
        }
        self.fp_ready = self.fp_active;
        true
    }

    #[inline(always)]
    pub(super) fn s(&self, register: u8) -> f32 {
        f32::from_bits(self.s[usize::from(register & 31)])
    }

    #[inline(always)]
    pub(super) fn d_bits(&self, register: u8) -> u64 {
        let low = usize::from(register & 15) * 2;
        u64::from(self.s[low]) | u64::from(self.s[low + 1]) << 32
    }

    #[inline(always)]
    pub(super) fn d(&self, register: u8) -> f64 {
        f64::from_bits(self.d_bits(register))
    }

    #[inline(always)]
    pub(super) fn set_d_bits(&mut self, register: u8, bits: u64) {
        let low = usize::from(register & 15) * 2;
        self.s[low] = bits as u32;
        self.s[low + 1] = (bits >> 32) as u32;
    }

    /// Keeps a result; NaNs come out of the operands.
    #[inline(always)]
    pub(super) fn put_s(&mut self, register: u8, result: f32, operands: &[u32]) {
        let bits = if result.is_nan() { nan_s(operands) } else { result.to_bits() };
        self.s[usize::from(register & 31)] = bits;
    }

    #[inline(always)]
    pub(super) fn put_d(&mut self, register: u8, result: f64, operands: &[u64]) {
        let bits = if result.is_nan() { nan_d(operands) } else { result.to_bits() };
        self.set_d_bits(register, bits);
    }

    /// An operation of two operands.
    #[inline(always)]
    pub(super) fn two_s(&mut self, i: Instruction, f: impl Fn(f32, f32) -> f32) {
        let (n, m) = (self.s(i.n), self.s(i.m));
        self.put_s(i.d, f(n, m), &[n.to_bits(), m.to_bits()]);
    }

    #[inline(always)]
    pub(super) fn two_d(&mut self, i: Instruction, f: impl Fn(f64, f64) -> f64) {
        let (n, m) = (self.d(i.n), self.d(i.m));
        self.put_d(i.d, f(n, m), &[n.to_bits(), m.to_bits()]);
    }

    /// A product rounded, then added.
    #[inline(always)]
    pub(super) fn chained_s(&mut self, i: Instruction) {
        let (n, m, acc) = (self.s(i.n), self.s(i.m), self.s(i.d));
        let product = n * m;
        let product =
            if product.is_nan() { f32::from_bits(nan_s(&[n.to_bits(), m.to_bits()])) } else { product };
        let product = if i.a & 1 != 0 { -product } else { product };
        let acc = if i.a & 2 != 0 { -acc } else { acc };
        self.put_s(i.d, acc + product, &[acc.to_bits(), product.to_bits()]);
    }

    pub(super) fn chained_d(&mut self, i: Instruction) {
        let (n, m, acc) = (self.d(i.n), self.d(i.m), self.d(i.d));
        let product = n * m;
        let product =
            if product.is_nan() { f64::from_bits(nan_d(&[n.to_bits(), m.to_bits()])) } else { product };
        let product = if i.a & 1 != 0 { -product } else { product };
        let acc = if i.a & 2 != 0 { -acc } else { acc };
        self.put_d(i.d, acc + product, &[acc.to_bits(), product.to_bits()]);
    }

    #[inline(always)]
    pub(super) fn fused_s(&mut self, i: Instruction) {
        let (n, m, acc) = (self.s(i.n), self.s(i.m), self.s(i.d));
        let n = if i.a & 1 != 0 { -n } else { n };
        let acc = if i.a & 2 != 0 { -acc } else { acc };
        // Of 0 × infinity the sum is the default NaN even where the addend is a quiet one.
        self.put_s(i.d, n.mul_add(m, acc), &[acc.to_bits(), n.to_bits(), m.to_bits()]);
    }

    pub(super) fn fused_d(&mut self, i: Instruction) {
        let (n, m, acc) = (self.d(i.n), self.d(i.m), self.d(i.d));
        let n = if i.a & 1 != 0 { -n } else { n };
        let acc = if i.a & 2 != 0 { -acc } else { acc };
        self.put_d(i.d, n.mul_add(m, acc), &[acc.to_bits(), n.to_bits(), m.to_bits()]);
    }

    fn compared(&mut self, order: Option<std::cmp::Ordering>) {
        use std::cmp::Ordering::{Equal, Greater, Less};
        let flags = match order {
            Some(Less) => 8,
            Some(Equal) => 6,
            Some(Greater) => 2,
            None => 3,
        };
        self.fpscr = self.fpscr & 0x0fff_ffff | flags << 28;
    }

    pub(super) fn compare_s(&mut self, i: Instruction) {
        let other = if i.a != 0 { 0.0 } else { self.s(i.m) };
        self.compared(self.s(i.d).partial_cmp(&other));
    }

    pub(super) fn compare_d(&mut self, i: Instruction) {
        let other = if i.a != 0 { 0.0 } else { self.d(i.m) };
        self.compared(self.d(i.d).partial_cmp(&other));
    }

    pub(super) fn read_fpscr(&mut self, i: Instruction) {
        if i.d == 15 {
            self.set_float_flags();
        } else {
            self.r[usize::from(i.d & 15)] = self.fpscr;
        }
    }

    fn set_float_flags(&mut self) {
        self.negative = self.fpscr >> 31 & 1 != 0;
        self.zero = self.fpscr >> 30 & 1 != 0;
        self.carry = self.fpscr >> 29 & 1 != 0;
        self.overflow = self.fpscr >> 28 & 1 != 0;
    }

    pub(super) fn write_fpscr(&mut self, i: Instruction) {
        let value = self.r[usize::from(i.d & 15)];
        if value & 0x07c0_0000 != 0 {
            let what = format!(
                "FPSCR is set to {value:#010x}: only rounding to the nearest with subnormals is modelled"
            );
            let line = self.line(self.pc, &what);
            self.fail(Trouble::Stop(line));
        }
        self.fpscr = value;
    }

    /// What the main loop does not carry out itself.
    pub(super) fn float_rest(&mut self, i: Instruction) {
        match i.op {
            Op::VnmulS => {
                let (n, m) = (self.s(i.n), self.s(i.m));
                self.put_s(i.d, n * m, &[n.to_bits(), m.to_bits()]);
                self.s[usize::from(i.d & 31)] ^= 1 << 31;
            }
            Op::VnmulD => {
                let (n, m) = (self.d(i.n), self.d(i.m));
                self.put_d(i.d, n * m, &[n.to_bits(), m.to_bits()]);
                let bits = self.d_bits(i.d) ^ 1 << 63;
                self.set_d_bits(i.d, bits);
            }
            Op::VsqrtS => {
                let m = self.s(i.m);
                self.put_s(i.d, m.sqrt(), &[m.to_bits()]);
            }
            Op::VsqrtD => {
                let m = self.d(i.m);
                self.put_d(i.d, m.sqrt(), &[m.to_bits()]);
            }
            Op::VcvtDS => {
                let m = self.s(i.m);
                let bits = m.to_bits();
                let payload = DEFAULT_NAN_D | u64::from(bits >> 31) << 63 | u64::from(bits & 0x3f_ffff) << 29;
                self.set_d_bits(i.d, if m.is_nan() { payload } else { f64::from(m).to_bits() });
            }
            Op::VcvtSD => {
                let m = self.d(i.m);
                let bits = m.to_bits();
                let payload = DEFAULT_NAN_S | ((bits >> 63) as u32) << 31 | (bits >> 29) as u32 & 0x3f_ffff;
                self.s[usize::from(i.d & 31)] = if m.is_nan() { payload } else { (m as f32).to_bits() };
            }
            Op::VcvtHalf => self.convert_half(i),
            Op::VcvtFixedS | Op::VcvtFixedD => self.convert_fixed(i),
            Op::VrintS => {
                let m = self.s(i.m);
                self.put_s(i.d, round!(m, i.k), &[m.to_bits()]);
            }
            Op::VrintD => {
                let m = self.d(i.m);
                self.put_d(i.d, round!(m, i.k), &[m.to_bits()]);
            }
            Op::VcvtSToInt => {
                let m = round!(self.s(i.m), i.k);
                self.s[usize::from(i.d & 31)] = if i.a != 0 { m as i32 as u32 } else { m as u32 };
            }
            Op::VcvtDToInt => {
                let m = round!(self.d(i.m), i.k);
                self.s[usize::from(i.d & 31)] = if i.a != 0 { m as i32 as u32 } else { m as u32 };
            }
            Op::VcvtIntToD => {
                let m = self.s[usize::from(i.m & 31)];
                let value = if i.a != 0 { f64::from(m as i32) } else { f64::from(m) };
                self.set_d_bits(i.d, value.to_bits());
            }
            Op::VselS | Op::VselD => {
                let first = match i.a {
                    0 => self.zero,
                    1 => self.overflow,
                    2 => self.negative == self.overflow,
                    _ => !self.zero && self.negative == self.overflow,
                };
                let from = if first { i.n } else { i.m };
                if i.op == Op::VselS {
                    self.s[usize::from(i.d & 31)] = self.s[usize::from(from & 31)];
                } else {
                    let bits = self.d_bits(from);
                    self.set_d_bits(i.d, bits);
                }
            }
            Op::VmaxnmS => {
                let (n, m) = (self.s(i.n), self.s(i.m));
                let less = n < m || (n == m && n.is_sign_negative());
                let result = match (n.is_nan(), m.is_nan()) {
                    (false, true) => n,
                    (true, false) => m,
                    (true, true) => n + m,
                    _ if less == (i.a != 0) => n,
                    _ => m,
                };
                self.put_s(i.d, result, &[n.to_bits(), m.to_bits()]);
            }
            Op::VmaxnmD => {
                let (n, m) = (self.d(i.n), self.d(i.m));
                let less = n < m || (n == m && n.is_sign_negative());
                let result = match (n.is_nan(), m.is_nan()) {
                    (false, true) => n,
                    (true, false) => m,
                    (true, true) => n + m,
                    _ if less == (i.a != 0) => n,
                    _ => m,
                };
                self.put_d(i.d, result, &[n.to_bits(), m.to_bits()]);
            }
            _ => {
                let line =
                    self.line(self.pc, &format!("an instruction this model does not carry out: {:?}", i.op));
                self.fail(Trouble::Stop(line));
            }
        }
    }

    fn convert_half(&mut self, i: Instruction) {
        let (top, to_half, double) = (i.a & 1 != 0, i.a & 2 != 0, i.k != 0);
        if to_half {
            let value = if double { self.d(i.m) } else { f64::from(self.s(i.m)) };
            let half = double_to_half(value);
            let d = &mut self.s[usize::from(i.d & 31)];
            *d = if top { *d & 0xffff | half << 16 } else { *d & 0xffff_0000 | half };
            return;
        }
        let word = self.s[usize::from(i.m & 31)];
        let single = half_to_single(if top { word >> 16 } else { word & 0xffff });
        if double {
            self.set_d_bits(i.d, f64::from(f32::from_bits(single)).to_bits());
        } else {
            self.s[usize::from(i.d & 31)] = single;
        }
    }

    fn convert_fixed(&mut self, i: Instruction) {
        let double = i.op == Op::VcvtFixedD;
        let (signed, short, to_fixed) = (i.a & 1 != 0, i.a & 2 != 0, i.a & 4 != 0);
        let scale = 2f64.powi(i.imm as i32);
        let low = if double { usize::from(i.d & 15) * 2 } else { usize::from(i.d & 31) };
        if to_fixed {
            let value = if double { self.d(i.d) } else { f64::from(self.s(i.d)) } * scale;
            let word = match (signed, short) {
                (true, false) => value as i32 as u32,
                (false, false) => value as u32,
                (true, true) => i32::from(value as i16) as u32,
                (false, true) => u32::from(value as u16),
            };
            self.s[low] = word;
            if double {
                self.s[low + 1] = if signed { (word as i32 >> 31) as u32 } else { 0 };
            }
            return;
        }
        let word = self.s[low];
        let value = match (signed, short) {
            (true, false) => f64::from(word as i32),
            (false, false) => f64::from(word),
            (true, true) => f64::from(word as i16),
            (false, true) => f64::from(word as u16),
        } / scale;
        if double {
            self.set_d_bits(i.d, value.to_bits());
        } else {
            self.s[low] = (value as f32).to_bits();
        }
    }
}
