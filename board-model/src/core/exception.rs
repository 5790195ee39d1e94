//! Exceptions taken and left, faults, resets (ARMv7-M, B1.5.6 to B1.5.14).

use super::nvic::{Nvic, THREAD, number};
use super::system::System;
use super::{Machine, Trouble};
use crate::board::Board;

/// Bits of fault status registers.
pub(super) mod fault {
    pub const PRECISE: u32 = 1 << 9;
    pub const BUS_ADDRESS_VALID: u32 = 1 << 15;
    pub const UNDEFINED: u32 = 1 << 16;
    pub const INVALID_STATE: u32 = 1 << 17;
    pub const INVALID_RETURN: u32 = 1 << 18;
    pub const NO_COPROCESSOR: u32 = 1 << 19;
    pub const UNALIGNED: u32 = 1 << 24;
    pub const DIVIDE_BY_ZERO: u32 = 1 << 25;
    pub const FORCED: u32 = 1 << 30;
}

const FRAME: u32 = 32;
const FLOAT_FRAME: u32 = 104;

impl<B: Board> Machine<B> {
    /// The core as after a reset: memories and board are not touched.
    pub(super) fn reset_core(&mut self) {
        self.attribute();
        self.memory.reset();
        let taken = self.nvic.taken;
        self.nvic = Nvic::default();
        self.nvic.taken = taken;
        let costs = self.system.costs;
        self.system = System::default();
        self.system.costs = costs;
        self.system.vtor = self.vectors;
        self.memory.set_uncached(None);
        self.set_hz(self.board.reset_hz());
        self.it = 0;
        self.ipsr = 0;
        self.process_stack = false;
        self.unprivileged = false;
        self.fp_active = false;
        self.fp_ready = false;
        self.lazy = false;
        self.fpscr = 0;
        self.exclusive = None;
        self.sleeping = None;
        self.trouble = None;
        self.r = [0; 16];
        self.r[13] = self.peek(self.vectors) & !3;
        self.r[14] = !0;
        self.pc = self.peek(self.vectors.wrapping_add(4)) & !1;
        self.counts.resets += u32::from(self.now > 0);
        self.look_up();
    }

    /// A word of memory, without cost; zero where there is none.
    fn peek(&self, address: u32) -> u32 {
        self.memory.load::<4>(address).map_or(0, |(b, _)| u32::from_le_bytes(b))
    }

    pub(super) fn xpsr(&self) -> u32 {
        u32::from(self.negative) << 31
            | u32::from(self.zero) << 30
            | u32::from(self.carry) << 29
            | u32::from(self.overflow) << 28
            | u32::from(self.saturated) << 27
            | u32::from(self.it & 3) << 25
            | 1 << 24
            | u32::from(self.ge) << 16
            | u32::from(self.it >> 2) << 10
            | u32::from(self.ipsr)
    }

    pub(super) fn set_flags(&mut self, xpsr: u32) {
        self.negative = xpsr >> 31 & 1 != 0;
        self.zero = xpsr >> 30 & 1 != 0;
        self.carry = xpsr >> 29 & 1 != 0;
        self.overflow = xpsr >> 28 & 1 != 0;
        self.saturated = xpsr >> 27 & 1 != 0;
    }

    /// Takes an exception whose handler returns to `back`.
    pub(super) fn enter(&mut self, exception: u16, back: u32) {
        self.attribute();
        let float = self.fp_active;
        let size = if float { FLOAT_FRAME } else { FRAME };
        let thread = self.ipsr == 0;
        let before = self.r[13];
        let frame = before.wrapping_sub(size) & !7;
        let aligned = before & 4;
        let words = [
            self.r[0],
            self.r[1],
            self.r[2],
            self.r[3],
            self.r[12],
            self.r[14],
            back,
            self.xpsr() | aligned << 7,
        ];
        for (at, word) in (frame..).step_by(4).zip(words) {
            self.store32(at, word);
        }
        if float {
            let context = frame + FRAME;
            if self.system.lazy_stacking() {
                self.lazy = true;
                self.system.fpcar = context;
            } else {
                self.save_float(context);
            }
            self.fp_active = false;
            self.fp_ready = false;
        }
        let process = thread && self.process_stack;
        self.r[14] = 0xffff_ffe1
            | if float { 0 } else { 0x10 }
            | if thread { 8 } else { 0 }
            | if process { 4 } else { 0 };
        self.r[13] = frame;
        if process {
            std::mem::swap(&mut self.r[13], &mut self.other_sp);
        }
        self.now += self.system.costs.entry;
        self.start_handler(exception);
    }

    fn start_handler(&mut self, exception: u16) {
        self.nvic.enter(exception);
        self.ipsr = exception;
        self.it = 0;
        self.exclusive = None;
        let handler = self.peek(self.system.vtor.wrapping_add(u32::from(exception) * 4));
        self.pc = handler & !1;
        self.next = self.pc;
        self.look_up();
        if handler & 1 == 0 {
            let line = self
                .line(self.pc, &format!("the vector of exception {exception} is {handler:#x}: no handler"));
            self.fail(Trouble::Stop(line));
        }
    }

    /// Saves the floating-point registers of an interrupted context.
    pub(super) fn save_float(&mut self, at: u32) {
        for i in 0..16 {
            let word = self.s[i];
            self.store32(at + i as u32 * 4, word);
        }
        let fpscr = self.fpscr;
        self.store32(at + 64, fpscr);
    }

    /// Leaves a handler through a value of `EXC_RETURN`.
    pub(super) fn exception_return(&mut self, value: u32) {
        self.attribute();
        let (to_thread, process, float) = (value & 8 != 0, value & 4 != 0, value & 0x10 == 0);
        if value & 0xffff_ffe2 != 0xffff_ffe0 || (process && !to_thread) {
            return self.fail(Trouble::Usage(fault::INVALID_RETURN));
        }
        self.nvic.leave(self.ipsr);
        if let Some(next) = self.nvic.next() {
            // Tail chaining: the frame stays where it is.
            self.now += self.system.costs.tail_chain;
            self.r[14] = value;
            self.start_handler(next);
            return;
        }
        if to_thread != (self.nvic.active == super::nvic::Set::default()) {
            return self.fail(Trouble::Usage(fault::INVALID_RETURN));
        }
        self.now += self.system.costs.exit;
        self.process_stack = if to_thread { process } else { self.process_stack };
        if process {
            std::mem::swap(&mut self.r[13], &mut self.other_sp);
        }
        let frame = self.r[13];
        for (i, register) in [0, 1, 2, 3, 12, 14].into_iter().enumerate() {
            self.r[register] = self.load32(frame + i as u32 * 4);
        }
        let (back, xpsr) = (self.load32(frame + 24), self.load32(frame + 28));
        if float {
            if self.lazy {
                self.lazy = false;
            } else {
                for i in 0..16 {
                    self.s[i] = self.load32(frame + FRAME + i as u32 * 4);
                }
                self.fpscr = self.load32(frame + FRAME + 64);
            }
        }
        self.fp_active = float;
        self.fp_ready = float && self.system.float_on() && !self.lazy;
        self.r[13] = (frame + if float { FLOAT_FRAME } else { FRAME }) | (xpsr >> 7 & 4);
        self.set_flags(xpsr);
        self.ge = (xpsr >> 16 & 15) as u8;
        self.it = (xpsr >> 25 & 3 | xpsr >> 8 & 0xfc) as u8;
        self.ipsr = (xpsr & 0x1ff) as u16;
        self.exclusive = None;
        self.next = back & !1;
        if self.system.sleep_on_exit && self.ipsr == 0 {
            self.sleeping = Some(super::Sleep::Interrupt);
        }
        self.look_up();
    }

    /// Turns trouble into a fault exception, or into the end of the run.
    pub(super) fn resolve(&mut self, pc: u32, trouble: Trouble) -> Result<(), String> {
        let (exception, status) = match trouble {
            Trouble::Stop(reason) => return Err(reason),
            Trouble::Bus { address, write } => {
                // A handler above all others may look whether an access fails (BFHFNMIGN, B3.2.8); not at instructions.
                if self.system.ignores_bus_faults() && self.nvic.barrier(false) <= -1 && address != pc {
                    return Ok(());
                }
                self.system.bfar = address;
                let _imprecise_stores_are_precise_here = write;
                (number::BUS, fault::PRECISE | fault::BUS_ADDRESS_VALID)
            }
            Trouble::Usage(status) => (number::USAGE, status),
            Trouble::Supervisor => (number::SVC, 0),
        };
        self.system.cfsr |= status;
        let barrier = self.nvic.barrier(true).min(THREAD);
        let can = self.nvic.enabled.get(exception) && self.nvic.group_of(exception) < barrier;
        let exception = if can {
            exception
        } else {
            if barrier <= -1 {
                let what = format!(
                    "lockup: a fault within a fault handler, status {:#010x}, address {:#010x}",
                    self.system.cfsr, self.system.bfar
                );
                return Err(self.line(pc, &what));
            }
            self.system.hfsr |= fault::FORCED;
            number::HARD_FAULT
        };
        let back = if exception == number::SVC { self.pc } else { pc };
        self.enter(exception, back);
        Ok(())
    }
}
