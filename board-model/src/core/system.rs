//! The core's own registers: SysTick, interrupt controller, control block, memory protection, floating point, cycle
//! counter (ARMv7-M, B3.2 to B3.5; Cortex-M7 Technical Reference Manual for the caches' registers).

use super::nvic::{Set, number};
use super::systick::SysTick;
use super::{Machine, Trouble};
use crate::board::{Board, Refusal, Width, Wish};
use crate::time::Ticks;

/// Costs in ticks.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ticked {
    pub register: Ticks,
    pub system_register: Ticks,
    pub entry: Ticks,
    pub tail_chain: Ticks,
    pub exit: Ticks,
}

/// State of the system registers.
#[derive(Clone, Debug)]
pub(super) struct System {
    pub costs: Ticked,
    pub vtor: u32,
    pub cfsr: u32,
    pub hfsr: u32,
    pub bfar: u32,
    pub fpcar: u32,
    fpccr: u32,
    fpdscr: u32,
    cpacr: u32,
    ccr: u32,
    actlr: u32,
    demcr: u32,
    cssel: u32,
    cacr: u32,
    pub sleep_on_exit: bool,
    scr: u32,
    mpu_control: u32,
    mpu_region: u32,
    mpu: [(u32, u32); 16],
    systick: SysTick,
    cycles_on: bool,
    cycles_at: u64,
    cycles_since: Ticks,
}

impl Default for System {
    fn default() -> Self {
        Self {
            costs: Ticked::default(),
            vtor: 0,
            cfsr: 0,
            hfsr: 0,
            bfar: 0,
            fpcar: 0,
            // Automatic and lazy saving are on after a reset.
            fpccr: 3 << 30,
            fpdscr: 0,
            cpacr: 0,
            // Stack alignment and branch prediction are on.
            ccr: 1 << 9 | 1 << 18,
            actlr: 0,
            demcr: 0,
            cssel: 0,
            cacr: 0,
            sleep_on_exit: false,
            scr: 0,
            mpu_control: 0,
            mpu_region: 0,
            mpu: [(0, 0); 16],
            systick: SysTick::off(),
            cycles_on: false,
            cycles_at: 0,
            cycles_since: 0,
        }
    }
}

const TRACE: u32 = 1 << 24;
const DATA_CACHE: u32 = 1 << 16;

impl System {
    pub fn lazy_stacking(&self) -> bool {
        self.fpccr & 1 << 30 != 0
    }

    pub fn automatic_stacking(&self) -> bool {
        self.fpccr & 1 << 31 != 0
    }

    pub fn default_fpscr(&self) -> u32 {
        self.fpdscr & 0x07c0_0000
    }

    pub fn float_on(&self) -> bool {
        self.cpacr >> 20 & 15 == 15
    }

    pub fn ignores_bus_faults(&self) -> bool {
        self.ccr & 1 << 8 != 0
    }

    pub fn traps_division(&self) -> bool {
        self.ccr & 16 != 0
    }

    pub fn next_event(&self) -> Ticks {
        self.systick.next()
    }

    pub fn systick_wraps(&mut self, now: Ticks) {
        self.systick.rebase(now);
        self.systick.wrapped = true;
    }

    pub fn rebase_systick(&mut self, now: Ticks, period: Ticks) {
        self.systick.rebase(now);
        self.systick.since = now;
        self.systick.period = period;
    }

    pub fn cycles(&self, now: Ticks, cycle: Ticks) -> u64 {
        if self.cycles_on {
            self.cycles_at + (now - self.cycles_since) / cycle.max(1)
        } else {
            self.cycles_at
        }
    }

    pub fn set_cycles(&mut self, cycles: u64, now: Ticks) {
        self.cycles_at = cycles;
        self.cycles_since = now;
    }

    /// Time that the cycle counter did not see.
    pub fn skip(&mut self, ticks: Ticks) {
        self.cycles_since += ticks;
    }

    /// Stretches that memory protection keeps out of the data cache, or `None` while that cache is off.
    fn uncached(&self) -> Option<Vec<(u32, u64)>> {
        (self.ccr & DATA_CACHE != 0).then(|| {
            let on = self.mpu_control & 1 != 0;
            let regions = self.mpu.iter().filter(|(_, attributes)| on && attributes & 1 != 0);
            // Normal memory without caching (TEX 1, C 0, B 0), device and strongly ordered memory (C 0).
            let plain = regions.filter(|(_, attributes)| attributes >> 17 & 1 == 0);
            plain.map(|&(base, attributes)| (base & !31, 2u64 << (attributes >> 1 & 31))).collect()
        })
    }
}

impl<B: Board> Machine<B> {
    pub(super) fn read_system(&mut self, address: u32, width: Width) -> Result<u32, Refusal> {
        if width != Width::Word
            && !(0xe000_e400..0xe000_e500).contains(&address)
            && address & !15 != 0xe000_ed10
        {
            return Refusal::stop(format!("a narrow read of system register {address:#010x}"));
        }
        let set = |set: &Set| set.shifted((address & 0x7f) >> 2);
        Ok(match address {
            0xe000_0000..=0xe000_0fff => 0,
            // Four comparators; the counter is there.
            0xe000_1000 => 4 << 28 | u32::from(self.system.cycles_on),
            0xe000_1004 => self.cycles() as u32,
            0xe000_1fb4 => 0,
            0xe000_e004 => 7,
            0xe000_e008 => self.system.actlr,
            0xe000_e010 => {
                let s = &mut self.system.systick;
                let passed = s.value > 0 && s.counts(self.now) >= u64::from(s.value);
                let wrapped = std::mem::take(&mut s.wrapped) || passed;
                s.rebase(self.now);
                u32::from(wrapped) << 16
                    | u32::from(s.core_clock) << 2
                    | u32::from(s.interrupts) << 1
                    | u32::from(s.enabled)
            }
            0xe000_e014 => self.system.systick.reload,
            0xe000_e018 => self.system.systick.now(self.now),
            0xe000_e01c => 0,
            0xe000_e100..=0xe000_e11f | 0xe000_e180..=0xe000_e19f => set(&self.nvic.enabled),
            0xe000_e200..=0xe000_e21f | 0xe000_e280..=0xe000_e29f => set(&self.nvic.pending()),
            0xe000_e300..=0xe000_e31f => set(&self.nvic.active),
            0xe000_e400..=0xe000_e4ef => self.priorities(address - 0xe000_e400 + 16, width),
            0xe000_ed00 => 0x411f_c271,
            0xe000_ed04 => {
                let pending = self.nvic.pending();
                let first = pending.numbers().find(|n| self.nvic.enabled.get(*n)).unwrap_or(0);
                u32::from(self.ipsr)
                    | u32::from(first) << 12
                    | u32::from(pending.get(number::SYSTICK)) << 26
                    | u32::from(pending.get(number::PENDSV)) << 28
                    | u32::from(pending.numbers().any(|n| n >= 16)) << 22
                    | u32::from(self.nvic.active.numbers().count() <= 1) << 11
            }
            0xe000_ed08 => self.system.vtor,
            0xe000_ed0c => 0xfa05_0000 | u32::from(self.nvic.prigroup) << 8,
            0xe000_ed10 => self.system.scr,
            0xe000_ed14 => self.system.ccr,
            0xe000_ed18..=0xe000_ed23 => self.priorities(address - 0xe000_ed18 + 4, width),
            0xe000_ed24 => self.shcsr(),
            0xe000_ed28 => self.system.cfsr,
            0xe000_ed2c => self.system.hfsr,
            0xe000_ed30 | 0xe000_ed3c => 0,
            0xe000_ed34 | 0xe000_ed38 => self.system.bfar,
            // Cortex-M7: a data cache of 16 KB in 4 ways, an instruction cache of 16 KB in 2 ways.
            0xe000_ed78 => 0x0900_0003,
            0xe000_ed7c => 0x8303_c003,
            0xe000_ed80 if self.system.cssel & 1 == 0 => 127 << 13 | 3 << 3 | 1,
            0xe000_ed80 => 255 << 13 | 1 << 3 | 1,
            0xe000_ed84 => self.system.cssel,
            0xe000_ed88 => self.system.cpacr,
            0xe000_ed90 => 16 << 8,
            0xe000_ed94 => self.system.mpu_control,
            0xe000_ed98 => self.system.mpu_region,
            0xe000_ed9c => self.system.mpu[self.system.mpu_region as usize & 15].0,
            0xe000_eda0 => self.system.mpu[self.system.mpu_region as usize & 15].1,
            // No debugger is attached.
            0xe000_edf0 => 0,
            0xe000_edfc => self.system.demcr,
            0xe000_ef34 => self.system.fpccr | u32::from(self.lazy),
            0xe000_ef38 => self.system.fpcar,
            0xe000_ef3c => self.system.fpdscr,
            0xe000_ef40 => 0x1011_0221,
            0xe000_ef44 => 0x1200_0011,
            0xe000_ef48 => 0x40,
            0xe000_ef90 | 0xe000_ef94 => 0x1,
            0xe000_ef9c => self.system.cacr,
            _ => return Refusal::stop(format!("a read of an unknown system register {address:#010x}")),
        })
    }

    pub(super) fn write_system(&mut self, address: u32, value: u32, width: Width) -> Result<(), Refusal> {
        let word = (address & 0x7f) >> 2;
        match address {
            0xe000_e400..=0xe000_e4ef => self.set_priorities(address - 0xe000_e400 + 16, value, width),
            0xe000_ed18..=0xe000_ed23 => self.set_priorities(address - 0xe000_ed18 + 4, value, width),
            _ if width != Width::Word => {
                return Refusal::stop(format!("a narrow write of system register {address:#010x}"));
            }
            0xe000_0000..=0xe000_0fff => {}
            0xe000_1000 => {
                let on = value & 1 != 0;
                if on && self.system.demcr & TRACE == 0 {
                    return Refusal::stop("the cycle counter is started before DEMCR.TRCENA");
                }
                let cycles = self.cycles();
                self.system.set_cycles(cycles, self.now);
                self.system.cycles_on = on;
            }
            0xe000_1004 => self.system.set_cycles(u64::from(value), self.now),
            0xe000_1fb0 => {}
            0xe000_e008 => self.system.actlr = value,
            0xe000_e010 => {
                let period = self.cycle * self.board.systick_cycles();
                let s = &mut self.system.systick;
                s.rebase(self.now);
                s.since = self.now;
                s.period = period;
                (s.enabled, s.interrupts, s.core_clock) = (value & 1 != 0, value & 2 != 0, value & 4 != 0);
                if s.enabled && !s.core_clock {
                    return Refusal::stop("SysTick on its reference clock, which this model does not have");
                }
            }
            0xe000_e014 => {
                self.system.systick.rebase(self.now);
                self.system.systick.reload = value & 0xff_ffff;
            }
            0xe000_e018 => {
                let s = &mut self.system.systick;
                (s.value, s.since, s.wrapped) = (0, self.now, false);
            }
            0xe000_e100..=0xe000_e11f => self.nvic.enabled.change(word, value, true),
            0xe000_e180..=0xe000_e19f => self.nvic.enabled.change(word, value, false),
            0xe000_e200..=0xe000_e21f => self.nvic.latched.change(word, value, true),
            0xe000_e280..=0xe000_e29f => self.nvic.latched.change(word, value, false),
            0xe000_ed04 => {
                for (bit, exception, pending) in [
                    (31, number::NMI, true),
                    (28, number::PENDSV, true),
                    (27, number::PENDSV, false),
                    (26, number::SYSTICK, true),
                    (25, number::SYSTICK, false),
                ] {
                    if value >> bit & 1 != 0 {
                        self.nvic.latched.put(exception, pending);
                    }
                }
            }
            0xe000_ed08 => self.system.vtor = value & !0x7f,
            0xe000_ed0c => {
                if value >> 16 != 0x05fa {
                    return Refusal::stop("AIRCR is written without its key");
                }
                self.nvic.prigroup = (value >> 8 & 7) as u8;
                if value & 4 != 0 {
                    let (board, mut bus) = self.bus();
                    board.software_reset(&mut bus);
                    self.wishes.push(Wish::Reset);
                }
            }
            0xe000_ed10 => {
                self.system.scr = value;
                self.system.sleep_on_exit = value & 2 != 0;
                self.nvic.send_event_on_pending = value & 16 != 0;
            }
            0xe000_ed14 => {
                self.system.ccr = value;
                self.memory.set_uncached(self.system.uncached());
            }
            0xe000_ed24 => {
                for (bit, exception) in [(16, number::MEMORY), (17, number::BUS), (18, number::USAGE)] {
                    self.nvic.enabled.put(exception, value >> bit & 1 != 0);
                }
            }
            0xe000_ed28 => self.system.cfsr &= !value,
            0xe000_ed2c => self.system.hfsr &= !value,
            0xe000_ed30 | 0xe000_ed34 | 0xe000_ed38 => {}
            0xe000_ed84 => self.system.cssel = value & 15,
            0xe000_ed88 => {
                self.system.cpacr = value;
                self.fp_ready = self.fp_active && self.system.float_on() && !self.lazy;
            }
            0xe000_ed94 => {
                self.system.mpu_control = value;
                self.memory.set_uncached(self.system.uncached());
            }
            0xe000_ed98 => self.system.mpu_region = value & 15,
            0xe000_ed9c..=0xe000_edb8 => {
                if address & 4 != 0 {
                    if value & 16 != 0 {
                        self.system.mpu_region = value & 15;
                    }
                    self.system.mpu[self.system.mpu_region as usize & 15].0 = value & !31;
                } else {
                    self.system.mpu[self.system.mpu_region as usize & 15].1 = value;
                }
                self.memory.set_uncached(self.system.uncached());
            }
            0xe000_edfc => self.system.demcr = value,
            0xe000_ef00 => self.nvic.latched.put((value & 0x1ff) as u16 + 16, true),
            0xe000_ef34 => self.system.fpccr = value & (3 << 30),
            0xe000_ef38 => self.system.fpcar = value & !7,
            0xe000_ef3c => self.system.fpdscr = value & 0x07c0_0000,
            // Caches are not modelled: looking after them costs what a register costs.
            0xe000_ef50..=0xe000_ef78 => {}
            0xe000_ef90 | 0xe000_ef94 => {}
            0xe000_ef9c => self.system.cacr = value,
            _ => return Refusal::stop(format!("a write of an unknown system register {address:#010x}")),
        }
        self.nvic.changed();
        Ok(())
    }

    fn priorities(&self, first: u32, width: Width) -> u32 {
        let byte = |i| u32::from(self.nvic.priority[(first + i) as usize & 255]) << (8 * i);
        (0..width.bytes()).map(byte).sum()
    }

    fn set_priorities(&mut self, first: u32, value: u32, width: Width) {
        for i in 0..width.bytes() {
            // Four bits are implemented.
            self.nvic.priority[(first + i) as usize & 255] = (value >> (8 * i)) as u8 & 0xf0;
        }
    }

    fn shcsr(&self) -> u32 {
        let enabled = |bit: u32, n| u32::from(self.nvic.enabled.get(n)) << bit;
        let active = |bit: u32, n| u32::from(self.nvic.active.get(n)) << bit;
        enabled(16, number::MEMORY)
            | enabled(17, number::BUS)
            | enabled(18, number::USAGE)
            | active(0, number::MEMORY)
            | active(1, number::BUS)
            | active(3, number::USAGE)
            | active(7, number::SVC)
            | active(10, number::PENDSV)
            | active(11, number::SYSTICK)
    }

    /// Reads a special register (B5.2.2).
    pub(super) fn special(&mut self, which: u32) -> u32 {
        let process = self.process_stack && self.ipsr == 0;
        match which {
            0..=7 => {
                let keep = [0xf800_0000 | 0xf_0000, 0xf800_01ff, 0, 0xf800_01ff, 0, 0x1ff, 0, 0x1ff];
                self.xpsr() & keep[which as usize]
            }
            8 => {
                if process {
                    self.other_sp
                } else {
                    self.r[13]
                }
            }
            9 => {
                if process {
                    self.r[13]
                } else {
                    self.other_sp
                }
            }
            16 => u32::from(self.nvic.primask),
            17 | 18 => u32::from(self.nvic.basepri),
            19 => u32::from(self.nvic.faultmask),
            20 => {
                u32::from(self.fp_active) << 2
                    | u32::from(self.process_stack) << 1
                    | u32::from(self.unprivileged)
            }
            _ => {
                let line = self.line(self.pc, &format!("an unknown special register {which}"));
                self.fail(Trouble::Stop(line));
                0
            }
        }
    }

    pub(super) fn set_special(&mut self, which: u32, value: u32, mask: u8) {
        let process = self.process_stack && self.ipsr == 0;
        match which {
            0..=3 => {
                if mask & 2 != 0 {
                    self.set_flags(value);
                }
                if mask & 1 != 0 {
                    self.ge = (value >> 16 & 15) as u8;
                }
            }
            8 if process => self.other_sp = value & !3,
            8 => self.r[13] = value & !3,
            9 if process => self.r[13] = value & !3,
            9 => self.other_sp = value & !3,
            16 => self.nvic.primask = value & 1 != 0,
            17 => self.nvic.basepri = value as u8 & 0xf0,
            18 => {
                let value = value as u8 & 0xf0;
                if value != 0 && (value < self.nvic.basepri || self.nvic.basepri == 0) {
                    self.nvic.basepri = value;
                }
            }
            19 => self.nvic.faultmask = value & 1 != 0,
            20 => {
                self.unprivileged = value & 1 != 0;
                if self.ipsr == 0 && self.process_stack != (value & 2 != 0) {
                    self.process_stack = value & 2 != 0;
                    std::mem::swap(&mut self.r[13], &mut self.other_sp);
                }
                self.fp_active = value & 4 != 0;
                self.fp_ready = self.fp_active && self.system.float_on() && !self.lazy;
            }
            _ => {
                let line = self.line(self.pc, &format!("an unknown special register {which}"));
                self.fail(Trouble::Stop(line));
            }
        }
        self.nvic.changed();
        self.look_up();
    }
}

impl Set {
    /// 32 interrupts from number 16 + 32 × word on.
    fn shifted(&self, word: u32) -> u32 {
        (0..32).filter(|bit| self.get((16 + word * 32 + bit) as u16)).map(|bit| 1 << bit).sum()
    }

    fn change(&mut self, word: u32, bits: u32, value: bool) {
        for bit in (0..32).filter(|bit| bits >> bit & 1 != 0) {
            self.put((16 + word * 32 + bit) as u16, value);
        }
    }
}
