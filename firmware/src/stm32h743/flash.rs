//! The second bank of the processor's flash, written while the core executes from the first (RM0433, chapter 4).
//!
//! A flash word has 256 bits and ten of error correction: it is programmed once (4.3.9), by eight stores in a row. Where power
//! was cut meanwhile too many bits are wrong, and a load is a bus fault (4.7.7); it is looked for with faults masked. While the
//! bank works a load would hold the core, so memory protection makes the bank a device: nothing is read ahead of a load.

use crate::bank::{Controller, SECTOR_WORDS};
use core::cell::Cell;
use cortex_m::peripheral::{MPU, SCB};
use embassy_stm32::Peri;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::{self, flash::regs};
use embassy_stm32::peripherals::FLASH;
use seabearing_core::wire::link::flash::Word;

/// Where the bank begins; it has eight sectors.
const BANK_2: u32 = 0x0810_0000;
const SECTORS: u32 = 8;
/// Opens the control register (4.5.1).
const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];
/// 64 bits at once, the quickest (4.3.9).
const PARALLEL: u8 = 3;
/// `CCR.BFHFNMIGN`: with faults masked a load that fails gives no fault (ARMv7-M, B3.2.8).
const IGNORE_BUS_FAULTS: u32 = 1 << 8;
/// The bus faults among the fault status.
const BUS_FAULTS: u32 = 0xff00;

/// The controller of the second bank.
pub struct BankTwo {
    _claimed: Peri<'static, FLASH>,
    /// It was given something to do and has not been seen to rest since.
    active: Cell<bool>,
    /// Times it refused.
    errors: Cell<u32>,
}

fn bank() -> pac::flash::Bank {
    pac::FLASH.bank(1)
}

/// Whether the end of a piece of work wakes the core: an ocean-bottom recorder's loop turns too seldom to find out by itself.
const END_WAKES: bool = cfg!(feature = "seismic");
/// `CCR.CLR_EOP`.
const END: u32 = 1 << 16;

/// Called by the flash's interrupt, which ends the core's sleep.
pub fn on_end() {
    bank().ccr().write_value(regs::Ccr(END));
}

fn control(f: impl FnOnce(&mut regs::Cr)) {
    bank().cr().write(|w| {
        w.set_psize(PARALLEL);
        w.set_eopie(END_WAKES);
        f(w);
    });
}

impl BankTwo {
    /// Takes the bank.
    pub fn new(flash: Peri<'static, FLASH>, mpu: &mut MPU) -> Self {
        /// Region 0; full access, no execution, a device, 2^20 bytes, on.
        const REGION: u32 = 1 << 4;
        const DEVICE: u32 = 1 << 28 | 3 << 24 | 1 << 16 | 19 << 1 | 1;
        /// On, with the usual map elsewhere.
        const ON: u32 = 1 | 1 << 2;
        // SAFETY: what is not a part of the bank keeps its rights; nothing else uses memory protection.
        unsafe {
            mpu.rbar.write(BANK_2 | REGION);
            mpu.rasr.write(DEVICE);
            mpu.ctrl.write(ON);
        }
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        if bank().cr().read().lock() {
            KEYS.iter().for_each(|key| bank().keyr().write_value(*key));
        }
        let bank = Self { _claimed: flash, active: Cell::new(false), errors: Cell::new(0) };
        bank.clear_errors();
        if END_WAKES {
            interrupt::FLASH.set_priority(Priority::P6);
            // SAFETY: the handler only clears the flag that called it.
            unsafe { interrupt::FLASH.enable() };
        }
        bank
    }

    /// Times the controller refused to do something.
    pub fn errors(&self) -> u32 {
        self.errors.get()
    }

    /// Errors must be cleared before anything is begun (4.7).
    fn clear_errors(&self) {
        /// All error flags, their places as in the status.
        const ALL: u32 = 0x07ef_0000;
        bank().ccr().write_value(regs::Ccr(ALL));
    }

    fn place(word: u32) -> Option<*mut u32> {
        let inside = word < SECTORS * u32::from(SECTOR_WORDS);
        inside.then(|| (BANK_2 + word * size_of::<Word>() as u32) as *mut u32)
    }
}

impl Controller for BankTwo {
    fn read(&self, word: u32) -> Option<Word> {
        let at = Self::place(word)?;
        let mut value: Word = [0; 32];
        // SAFETY: loads of memory that is there; that they may fail is looked for. For a microsecond nothing interrupts.
        unsafe {
            let scb = &*SCB::PTR;
            let before = scb.ccr.read();
            core::arch::asm!("cpsid f");
            scb.ccr.write(before | IGNORE_BUS_FAULTS);
            cortex_m::asm::dsb();
            cortex_m::asm::isb();
            for (n, to) in value.as_chunks_mut::<4>().0.iter_mut().enumerate() {
                *to = at.add(n).read_volatile().to_le_bytes();
            }
            cortex_m::asm::dsb();
            scb.ccr.write(before);
            core::arch::asm!("cpsie f");
            if bank().sr().read().dbeccerr() {
                self.clear_errors();
                scb.cfsr.write(BUS_FAULTS);
                return None;
            }
        }
        Some(value)
    }

    fn program(&mut self, word: u32, value: &Word) {
        let Some(at) = Self::place(word) else { return };
        self.clear_errors();
        control(|w| w.set_pg(true));
        cortex_m::asm::dsb();
        // SAFETY: a flash word of the bank that is this controller's, in order and at once.
        unsafe {
            for (n, from) in value.as_chunks::<4>().0.iter().enumerate() {
                at.add(n).write_volatile(u32::from_le_bytes(*from));
            }
        }
        cortex_m::asm::dsb();
        self.active.set(true);
    }

    fn erase(&mut self, sector: u8) {
        self.clear_errors();
        let select = |w: &mut regs::Cr| {
            w.set_ser(true);
            w.set_snb(sector & 7);
        };
        control(select);
        control(|w| {
            select(w);
            w.set_start(true);
        });
        self.active.set(true);
    }

    fn works(&self) -> bool {
        if !self.active.get() {
            return false;
        }
        let status = bank().sr().read();
        if status.bsy() || status.qw() || status.wbne() {
            return true;
        }
        control(|_| {});
        let refused = [status.wrperr(), status.pgserr(), status.strberr(), status.incerr(), status.operr()];
        if refused.contains(&true) {
            self.errors.set(self.errors.get().saturating_add(1));
            self.clear_errors();
        }
        self.active.set(false);
        false
    }
}
