//! Carries decoded instructions out.

use super::{Machine, Sleep, Trouble, exception::fault};
use crate::board::Board;
use crate::instruction::{Instruction, Op};

impl<B: Board> Machine<B> {
    /// Writes a register; the program counter is a jump.
    #[inline(always)]
    pub(super) fn set_or_branch(&mut self, d: u8, value: u32) {
        if d == 15 {
            self.branch_exchange(value);
        } else {
            self.r[usize::from(d & 15)] = value;
        }
    }

    /// A jump to an address with the Thumb bit, or out of a handler.
    #[inline(always)]
    pub(super) fn branch_exchange(&mut self, target: u32) {
        if self.ipsr != 0 && target >= 0xffff_ff00 {
            self.exception_return(target);
        } else if target & 1 == 0 {
            self.fail(Trouble::Usage(fault::INVALID_STATE));
        } else {
            self.next = target & !1;
        }
    }

    /// Sign-extends and such: d from m.
    #[inline(always)]
    fn unary(&mut self, i: Instruction, f: impl Fn(u32) -> u32) {
        self.r[usize::from(i.d & 15)] = f(self.r[usize::from(i.m & 15)]);
    }

    #[inline(always)]
    fn at_offset(&self, i: Instruction) -> u32 {
        self.r[usize::from(i.n & 15)].wrapping_add(i.imm)
    }

    #[inline(always)]
    fn at_register(&self, i: Instruction) -> u32 {
        self.r[usize::from(i.n & 15)].wrapping_add(self.r[usize::from(i.m & 15)] << (i.imm & 3))
    }

    #[inline(always)]
    pub(super) fn execute(&mut self, i: Instruction) {
        let (d, n, m) = (usize::from(i.d & 15), usize::from(i.n & 15), usize::from(i.m & 15));
        match i.op {
            Op::AddImm => self.r[d] = self.r[n].wrapping_add(i.imm),
            Op::SubImm => self.r[d] = self.r[n].wrapping_sub(i.imm),
            Op::AddImmS => self.r[d] = self.add_flags(self.r[n], i.imm, false),
            Op::SubImmS => self.r[d] = self.add_flags(self.r[n], !i.imm, true),
            Op::CmpImm => {
                self.add_flags(self.r[n], !i.imm, true);
            }
            Op::MovImm => self.r[d] = i.imm,
            Op::MovImmS => {
                self.r[d] = i.imm;
                self.set_nz(i.imm);
            }
            Op::AddReg => {
                let sum = self.r[n].wrapping_add(self.r[m]);
                if i.d == 15 { self.next = sum & !1 } else { self.r[d] = sum }
            }
            Op::AddLsl => self.r[d] = self.r[n].wrapping_add(self.r[m] << (i.imm & 31)),
            Op::SubReg => self.r[d] = self.r[n].wrapping_sub(self.r[m]),
            Op::AddRegS => self.r[d] = self.add_flags(self.r[n], self.r[m], false),
            Op::SubRegS => self.r[d] = self.add_flags(self.r[n], !self.r[m], true),
            Op::CmpReg => {
                self.add_flags(self.r[n], !self.r[m], true);
            }
            Op::MovReg => {
                let value = self.r[m];
                if i.d == 15 { self.next = value & !1 } else { self.r[d] = value }
            }
            Op::DpImm => {
                let carry = if i.k != 0 { i.imm >> 31 != 0 } else { self.carry };
                self.data_processing(i, i.imm, carry);
            }
            Op::DpReg => self.data_processing(i, self.r[m], self.carry),
            Op::DpShift => {
                let (y, carry) = self.shifter(i);
                self.data_processing(i, y, carry);
            }
            Op::ShiftReg => self.shift_register(i),
            Op::MovT => self.r[d] = self.r[d] & 0xffff | i.imm << 16,
            Op::Mul => {
                self.r[d] = self.r[n].wrapping_mul(self.r[m]);
                if i.s {
                    self.set_nz(self.r[d]);
                }
            }
            Op::Mla => {
                let acc = self.r[usize::from(i.a & 15)];
                self.r[d] = self.r[n].wrapping_mul(self.r[m]).wrapping_add(acc);
            }
            Op::Mls => {
                let acc = self.r[usize::from(i.a & 15)];
                self.r[d] = acc.wrapping_sub(self.r[n].wrapping_mul(self.r[m]));
            }
            Op::Umull => self.set_long(i, u64::from(self.r[n]) * u64::from(self.r[m])),
            Op::Smull => {
                let product = i64::from(self.r[n] as i32) * i64::from(self.r[m] as i32);
                self.set_long(i, product as u64);
            }
            Op::Umlal => {
                let product = u64::from(self.r[n]) * u64::from(self.r[m]);
                self.set_long(i, self.long(i).wrapping_add(product));
            }
            Op::Smlal => {
                let product = i64::from(self.r[n] as i32) * i64::from(self.r[m] as i32);
                self.set_long(i, self.long(i).wrapping_add(product as u64));
            }
            Op::Umaal => {
                let (low, high) = (self.r[d], self.r[usize::from(i.a & 15)]);
                let product = u64::from(self.r[n]) * u64::from(self.r[m]);
                self.set_long(i, product + u64::from(low) + u64::from(high));
            }
            Op::Sdiv => self.divide(i, true),
            Op::Udiv => self.divide(i, false),
            Op::DspMul => self.dsp_multiply(i),
            Op::DspLong => self.dsp_long(i),
            Op::Bfi => {
                let mask = (((1u64 << i.k) - 1) as u32) << i.imm;
                let field = if i.n == 15 { 0 } else { self.r[n] << i.imm };
                self.r[d] = self.r[d] & !mask | field & mask;
            }
            Op::Sbfx => {
                let up = 32u32.saturating_sub(i.imm + u32::from(i.k));
                self.r[d] = ((self.r[n] << up) as i32 >> (32 - u32::from(i.k))) as u32;
            }
            Op::Ubfx => self.r[d] = self.r[n] >> i.imm & ((1u64 << i.k) - 1) as u32,
            Op::Sat => self.saturation(i),
            Op::Sat16 => self.saturation_16(i),
            Op::Extend => self.extend(i),
            Op::Sxtb => self.unary(i, |x| i32::from(x as i8) as u32),
            Op::Sxth => self.unary(i, |x| i32::from(x as i16) as u32),
            Op::Uxtb => self.unary(i, |x| x & 0xff),
            Op::Uxth => self.unary(i, |x| x & 0xffff),
            Op::Rev => self.unary(i, u32::swap_bytes),
            Op::Rev16 => self.unary(i, |x| x.swap_bytes().rotate_left(16)),
            Op::Revsh => self.unary(i, |x| i32::from((x as u16).swap_bytes() as i16) as u32),
            Op::Rbit => self.unary(i, u32::reverse_bits),
            Op::Clz => self.unary(i, u32::leading_zeros),
            Op::Sel => self.select(i),
            Op::Qadd => self.q_add(i),
            Op::Pkh => self.pack(i),
            Op::Parallel => self.parallel(i),
            Op::B => self.next = i.imm,
            Op::BCond => {
                if self.condition(i.a) {
                    self.next = i.imm;
                }
            }
            Op::Bl => {
                self.r[14] = self.next | 1;
                self.next = i.imm;
            }
            Op::Bx => self.branch_exchange(self.r[m]),
            Op::Blx => {
                let target = self.r[m];
                self.r[14] = self.next | 1;
                self.branch_exchange(target);
            }
            Op::Cbz => {
                if (self.r[n] == 0) != i.s {
                    self.next = i.imm;
                }
            }
            Op::TableBranch => {
                let offset = if i.s {
                    self.load16(self.r[n].wrapping_add(self.r[m] << 1))
                } else {
                    self.load8(self.r[n].wrapping_add(self.r[m]))
                };
                self.next = self.r[15].wrapping_add(offset * 2);
            }
            Op::Ldr => {
                let value = self.load32(self.at_offset(i));
                self.set_or_branch(i.d, value);
            }
            Op::Ldrb => self.r[d] = self.load8(self.at_offset(i)),
            Op::Ldrh => self.r[d] = self.load16(self.at_offset(i)),
            Op::Ldrsb => self.r[d] = i32::from(self.load8(self.at_offset(i)) as i8) as u32,
            Op::Ldrsh => self.r[d] = i32::from(self.load16(self.at_offset(i)) as i16) as u32,
            Op::Str => self.store32(self.at_offset(i), self.r[d]),
            Op::Strb => self.store8(self.at_offset(i), self.r[d]),
            Op::Strh => self.store16(self.at_offset(i), self.r[d]),
            Op::LdrLiteral => {
                let value = self.load32(i.imm);
                self.set_or_branch(i.d, value);
            }
            Op::LdrReg => {
                let value = self.load32(self.at_register(i));
                self.set_or_branch(i.d, value);
            }
            Op::LdrbReg => self.r[d] = self.load8(self.at_register(i)),
            Op::LdrhReg => self.r[d] = self.load16(self.at_register(i)),
            Op::LdrsbReg => self.r[d] = i32::from(self.load8(self.at_register(i)) as i8) as u32,
            Op::LdrshReg => self.r[d] = i32::from(self.load16(self.at_register(i)) as i16) as u32,
            Op::StrReg => self.store32(self.at_register(i), self.r[d]),
            Op::StrbReg => self.store8(self.at_register(i), self.r[d]),
            Op::StrhReg => self.store16(self.at_register(i), self.r[d]),
            Op::Indexed => self.indexed(i),
            Op::Ldrd => self.load_pair(i),
            Op::Strd => self.store_pair(i),
            Op::Ldm => self.load_multiple(i),
            Op::Stm => self.store_multiple(i),
            Op::Ldrex => self.load_exclusive(i, false),
            Op::Strex => self.store_exclusive(i, false),
            Op::LdrexShort => self.load_exclusive(i, true),
            Op::StrexShort => self.store_exclusive(i, true),
            Op::Clrex => self.exclusive = None,
            Op::It => self.it = i.imm as u8,
            Op::Nop => {}
            Op::VldrS
            | Op::VldrD
            | Op::VstrS
            | Op::VstrD
            | Op::Vldm
            | Op::Vstm
            | Op::VmovToCore
            | Op::VmovFromCore
            | Op::VmovTwoToCore
            | Op::VmovTwoFromCore
            | Op::Vmrs
            | Op::Vmsr => {
                if self.fp_ready || self.prepare_float() {
                    self.float_transfer(i);
                }
            }
            Op::Undecoded
            | Op::Unknown
            | Op::Wfi
            | Op::Wfe
            | Op::Sev
            | Op::Cps
            | Op::Mrs
            | Op::Msr
            | Op::Svc
            | Op::Bkpt
            | Op::Udf => self.system_instruction(i),
            _ => {
                if self.fp_ready || self.prepare_float() {
                    self.float(i);
                }
            }
        }
    }

    #[inline(always)]
    fn float_transfer(&mut self, i: Instruction) {
        let single = usize::from(i.n & 31);
        match i.op {
            Op::VldrS => {
                let base = if i.n == 15 { self.r[15] & !3 } else { self.r[usize::from(i.n & 15)] };
                self.s[usize::from(i.d & 31)] = self.load32(base.wrapping_add(i.imm));
            }
            Op::VldrD => {
                let base = if i.n == 15 { self.r[15] & !3 } else { self.r[usize::from(i.n & 15)] };
                let at = base.wrapping_add(i.imm);
                let low = usize::from(i.d & 15) * 2;
                self.s[low] = self.load32(at);
                self.s[low + 1] = self.load32(at.wrapping_add(4));
            }
            Op::VstrS => self.store32(self.at_offset(i), self.s[usize::from(i.d & 31)]),
            Op::VstrD => {
                let (at, low) = (self.at_offset(i), usize::from(i.d & 15) * 2);
                self.store32(at, self.s[low]);
                self.store32(at.wrapping_add(4), self.s[low + 1]);
            }
            Op::Vldm => self.float_multiple(i, true),
            Op::Vstm => self.float_multiple(i, false),
            Op::VmovToCore => self.r[usize::from(i.d & 15)] = self.s[single],
            Op::VmovFromCore => self.s[single] = self.r[usize::from(i.d & 15)],
            Op::VmovTwoToCore => {
                self.r[usize::from(i.d & 15)] = self.s[single];
                self.r[usize::from(i.m & 15)] = self.s[(single + 1) & 31];
            }
            Op::VmovTwoFromCore => {
                self.s[single] = self.r[usize::from(i.d & 15)];
                self.s[(single + 1) & 31] = self.r[usize::from(i.m & 15)];
            }
            Op::Vmrs => self.read_fpscr(i),
            _ => self.write_fpscr(i),
        }
    }

    #[inline(always)]
    fn float(&mut self, i: Instruction) {
        let (d, m) = (usize::from(i.d & 31), usize::from(i.m & 31));
        match i.op {
            Op::VaddS => self.two_s(i, |n, m| n + m),
            Op::VsubS => self.two_s(i, |n, m| n - m),
            Op::VmulS => self.two_s(i, |n, m| n * m),
            Op::VdivS => self.two_s(i, |n, m| n / m),
            Op::VaddD => self.two_d(i, |n, m| n + m),
            Op::VsubD => self.two_d(i, |n, m| n - m),
            Op::VmulD => self.two_d(i, |n, m| n * m),
            Op::VdivD => self.two_d(i, |n, m| n / m),
            Op::VmlaS => self.chained_s(i),
            Op::VmlaD => self.chained_d(i),
            Op::VfmaS => self.fused_s(i),
            Op::VfmaD => self.fused_d(i),
            Op::VmovS => self.s[d] = self.s[m],
            Op::VmovD => self.set_d_bits(i.d, self.d_bits(i.m)),
            Op::VabsS => self.s[d] = self.s[m] & !(1 << 31),
            Op::VabsD => self.set_d_bits(i.d, self.d_bits(i.m) & !(1 << 63)),
            Op::VnegS => self.s[d] = self.s[m] ^ 1 << 31,
            Op::VnegD => self.set_d_bits(i.d, self.d_bits(i.m) ^ 1 << 63),
            Op::VmovImmS => self.s[d] = i.imm,
            Op::VmovImmD => self.set_d_bits(i.d, u64::from(i.imm) << 32),
            Op::VcmpS => self.compare_s(i),
            Op::VcmpD => self.compare_d(i),
            Op::VcvtIntToS => {
                let word = self.s[m];
                self.s[d] = if i.a != 0 { word as i32 as f32 } else { word as f32 }.to_bits();
            }
            _ => self.float_rest(i),
        }
    }

    #[inline(never)]
    fn system_instruction(&mut self, i: Instruction) {
        match i.op {
            Op::Wfi => {
                self.sleeping = Some(Sleep::Interrupt);
                self.look_up();
            }
            Op::Wfe => {
                if self.nvic.event {
                    self.nvic.event = false;
                } else {
                    self.sleeping = Some(Sleep::Event);
                    self.look_up();
                }
            }
            Op::Sev => self.nvic.event = true,
            Op::Cps => {
                if i.imm & 2 != 0 {
                    self.nvic.primask = i.s;
                }
                if i.imm & 1 != 0 {
                    self.nvic.faultmask = i.s;
                }
                self.look_up();
            }
            Op::Mrs => self.r[usize::from(i.d & 15)] = self.special(i.imm),
            Op::Msr => self.set_special(i.imm, self.r[usize::from(i.n & 15)], i.a),
            Op::Svc => self.fail(Trouble::Supervisor),
            Op::Bkpt if i.imm == 0xab => {
                let (operation, argument) = (self.r[0], self.r[1]);
                let (board, mut bus) = self.bus();
                match board.semihosting(&mut bus, operation, argument) {
                    Some(answer) => self.r[0] = answer,
                    None => self.stop_here("a semihosting call on a board without a host"),
                }
                self.look_up();
            }
            Op::Bkpt => self.stop_here(&format!("a breakpoint instruction, {}", i.imm)),
            Op::Udf => self.fail(Trouble::Usage(fault::UNDEFINED)),
            _ => {
                let half = |at| self.memory.load::<2>(at).map_or(0, |(b, _)| u16::from_le_bytes(b));
                let (first, second) = (half(self.pc), half(self.pc.wrapping_add(2)));
                self.stop_here(&format!("an instruction this model does not know: {first:04x} {second:04x}"));
            }
        }
    }

    fn stop_here(&mut self, what: &str) {
        let line = self.line(self.pc, what);
        self.fail(Trouble::Stop(line));
    }
}
