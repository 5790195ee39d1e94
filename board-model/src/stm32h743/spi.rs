//! SPI1 as master: FIFOs, transfer size, hardware chip select (RM0433, chapter 50). SPI2 to 4 as slaves that only hear, selected
//! by software.
//!
//! A transfer of a set size may be started again by CSTART alone, as the manual's text allows; only silicon can tell
//! whether the flag of the one before must be cleared first.

use super::clocks::unknown;
use crate::board::{Bus, Refusal};
use crate::time::{NEVER, PER_SECOND, Ticks};
use std::collections::VecDeque;

const FIFO_BYTES: usize = 16;
const ENABLE: u32 = 1;
const START: u32 = 1 << 9;

mod flag {
    pub const RX: u32 = 1;
    pub const TX: u32 = 1 << 1;
    pub const END: u32 = 1 << 3;
    pub const TX_FILLED: u32 = 1 << 4;
    pub const OVERRUN: u32 = 1 << 6;
    pub const SUSPENDED: u32 = 1 << 11;
    pub const TX_DONE: u32 = 1 << 12;
}

/// Registers and the transfer under way.
#[derive(Debug)]
pub(super) struct Spi {
    name: &'static str,
    /// Wired as a slave.
    slave: bool,
    cr1: u32,
    cr2: u32,
    cfg1: u32,
    cfg2: u32,
    interrupts: u32,
    latched: u32,
    other: [u32; 4],
    tx: VecDeque<u8>,
    rx: VecDeque<u8>,
    /// Words of the transfer still to be shifted, and still to be written to the FIFO.
    to_shift: u32,
    to_write: u32,
    running: bool,
    /// When the word being shifted is complete.
    done_at: Ticks,
    shifting: u8,
    /// Hardware chip select is active.
    pub selected: bool,
    /// Frequency of the line when last used.
    pub line_hz: u64,
}

impl Spi {
    /// SPI1.
    pub fn new() -> Self {
        Self::named("SPI1", false)
    }

    /// One that is wired as a slave.
    pub fn slave(name: &'static str) -> Self {
        Self::named(name, true)
    }

    fn named(name: &'static str, slave: bool) -> Self {
        Self {
            name,
            slave,
            cr1: 0,
            cr2: 0,
            cfg1: 0x0007_0007,
            cfg2: 0,
            interrupts: 0,
            latched: 0,
            other: [0x107, 0, 0, 0],
            tx: VecDeque::new(),
            rx: VecDeque::new(),
            to_shift: 0,
            to_write: 0,
            running: false,
            done_at: NEVER,
            shifting: 0,
            selected: false,
            line_hz: 0,
        }
    }

    fn word_bytes(&self) -> usize {
        (self.cfg1 as usize & 31).div_ceil(8).max(1)
    }

    /// Bytes of a packet: what the FIFO thresholds count.
    fn packet(&self) -> usize {
        self.word_bytes() * ((self.cfg1 as usize >> 5 & 15) + 1)
    }

    fn receives_only(&self) -> bool {
        self.cfg2 >> 17 & 3 == 2
    }

    /// Mode 0 to 3.
    pub fn mode(&self) -> u32 {
        self.cfg2 >> 24 & 3
    }

    fn flags(&self) -> u32 {
        let mut flags = self.latched;
        if self.cr1 & ENABLE == 0 {
            return flags | flag::TX_DONE;
        }
        let limited = self.cr2 & 0xffff != 0;
        if self.rx.len() >= self.packet() || (limited && self.to_shift == 0 && !self.rx.is_empty()) {
            flags |= flag::RX;
        }
        if FIFO_BYTES - self.tx.len() >= self.packet() && !(limited && self.to_write == 0) {
            flags |= flag::TX;
        }
        if self.tx.is_empty() && self.done_at == NEVER {
            flags |= flag::TX_DONE;
        }
        flags | (self.rx.len().min(3) as u32) << 13 | self.to_shift << 16
    }

    pub fn wants_rx_dma(&self) -> bool {
        self.cfg1 & 1 << 14 != 0 && self.flags() & flag::RX != 0
    }

    pub fn wants_tx_dma(&self) -> bool {
        self.cfg1 & 1 << 15 != 0 && self.flags() & flag::TX != 0
    }

    pub fn lines(&self, bus: &mut Bus<'_>) {
        // Both directions ready is the third enable.
        let flags = self.flags();
        let both = u32::from(flags & 3 == 3) << 2;
        bus.nvic.set_level(35, (flags | both) & self.interrupts & 0x7ff != 0);
    }

    pub fn read(&mut self, offset: usize, bytes: usize) -> Result<u32, Refusal> {
        Ok(match offset {
            0x00 => self.cr1,
            0x04 => self.cr2,
            0x08 => self.cfg1,
            0x0c => self.cfg2,
            0x10 => self.interrupts,
            0x14 => self.flags(),
            0x18 => 0,
            0x30 => {
                if self.rx.len() < bytes {
                    return Refusal::stop("SPI_RXDR is read with nothing received");
                }
                (0..bytes).map(|i| u32::from(self.rx.pop_front().unwrap_or(0)) << (8 * i)).sum()
            }
            0x40..=0x4c => self.other[(offset - 0x40) / 4],
            0x50 => 0,
            _ => return Err(unknown(self.name, offset)),
        })
    }

    pub fn write(&mut self, offset: usize, value: u32, bytes: usize) -> Result<(), Refusal> {
        let on = self.cr1 & ENABLE != 0;
        match offset {
            0x00 => self.control(value)?,
            0x04 => {
                if on && self.running {
                    return Refusal::stop("SPI_CR2 is written during a transfer");
                }
                self.cr2 = value;
            }
            // While on, only the DMA requests may change.
            0x08 if on && (value ^ self.cfg1) & !0xc000 != 0 => {
                return Refusal::stop("SPI_CFG1 is changed while the peripheral is on");
            }
            0x08 => self.cfg1 = value,
            0x0c if on && value != self.cfg2 => {
                return Refusal::stop("SPI_CFG2 is changed while the peripheral is on");
            }
            0x0c => self.cfg2 = value,
            0x10 => self.interrupts = value,
            0x18 => self.latched &= !(value & 0xff8),
            0x20 => {
                if !on {
                    return Refusal::stop("SPI_TXDR is written while the peripheral is off");
                }
                if self.tx.len() + bytes > FIFO_BYTES {
                    return Refusal::stop("SPI_TXDR is written with the FIFO full");
                }
                self.tx.extend(&value.to_le_bytes()[..bytes]);
                self.to_write = self.to_write.saturating_sub((bytes / self.word_bytes()) as u32);
                if self.cr2 & 0xffff != 0 && self.to_write == 0 {
                    self.latched |= flag::TX_FILLED;
                }
            }
            0x40..=0x4c => self.other[(offset - 0x40) / 4] = value,
            0x50 if value & 1 == 0 => {}
            0x50 => return Refusal::stop("I2S is not modelled"),
            _ => return Err(unknown(self.name, offset)),
        }
        Ok(())
    }

    fn control(&mut self, value: u32) -> Result<(), Refusal> {
        let was_on = self.cr1 & ENABLE != 0;
        let on = value & ENABLE != 0;
        if value & START != 0 && !on && !was_on {
            return Refusal::stop("a transfer is started while SPI1 is off");
        }
        if on && !was_on {
            let master = self.cfg2 & 1 << 22 != 0;
            if master == self.slave {
                return Refusal::stop(format!("{} is a master or a slave against its wires", self.name));
            }
            if self.slave && (!self.receives_only() || self.cfg2 & 1 << 26 == 0 || value & 1 << 12 != 0) {
                return Refusal::stop(format!(
                    "{} as a slave must only hear, selected by software",
                    self.name
                ));
            }
            self.to_write = self.cr2 & 0xffff;
            self.to_shift = self.to_write;
        }
        if !on {
            // Off: FIFOs are emptied, what is shifted is cut short.
            self.tx.clear();
            self.rx.clear();
            self.running = false;
            self.done_at = NEVER;
            self.selected = false;
        }
        if value & 1 << 10 != 0 && self.running {
            // Suspended after the word under way.
            self.running = false;
            self.latched |= flag::SUSPENDED;
        }
        self.cr1 = value & !(1 << 10) & !START | self.cr1 & START;
        if on && value & START != 0 && !self.running {
            self.running = true;
            self.cr1 |= START;
            if self.cr2 & 0xffff != 0 && self.to_shift == 0 {
                self.to_shift = self.cr2 & 0xffff;
                self.to_write = self.to_shift - (self.tx.len() / self.word_bytes()) as u32;
            }
            self.selected = self.cfg2 & 1 << 29 != 0 && self.cfg2 & 1 << 26 == 0;
        }
        if !on {
            self.cr1 &= !START;
        }
        Ok(())
    }

    /// Starts to shift the next word if there is one and the line is free.
    pub fn start(&mut self, now: Ticks, kernel_hz: impl FnOnce() -> u64) -> Result<bool, Refusal> {
        let limited = self.cr2 & 0xffff != 0;
        let bytes = self.word_bytes();
        if !self.running || self.done_at != NEVER || (limited && self.to_shift == 0) {
            return Ok(false);
        }
        if !self.receives_only() && self.tx.len() < bytes {
            return Ok(false);
        }
        let kernel_hz = kernel_hz();
        if kernel_hz == 0 {
            return Refusal::stop("SPI1 is used without a kernel clock");
        }
        self.line_hz = kernel_hz >> ((self.cfg1 >> 28 & 7) + 1);
        let bits = u64::from(self.cfg1 & 31) + 1;
        let first = limited && self.to_shift == self.cr2 & 0xffff;
        let pause = if first { u64::from(self.cfg2 & 15) } else { u64::from(self.cfg2 >> 4 & 15) };
        self.done_at = now + (bits + pause) * PER_SECOND / self.line_hz.max(1);
        Ok(true)
    }

    pub fn next_event(&self) -> Ticks {
        self.done_at
    }

    /// A byte has come over the line whose clock another one makes.
    pub fn hear(&mut self, byte: u8) {
        if self.cr1 & ENABLE == 0 {
            return;
        }
        if self.rx.len() < FIFO_BYTES { self.rx.push_back(byte) } else { self.latched |= flag::OVERRUN }
    }

    /// The word under way is complete: `exchange` gives the other side's byte for ours.
    pub fn shifted(&mut self, mut exchange: impl FnMut(u8) -> u8) {
        self.done_at = NEVER;
        let bytes = self.word_bytes();
        if self.rx.len() + bytes > FIFO_BYTES {
            self.latched |= flag::OVERRUN;
        }
        // Most significant byte first on the line, least significant first in the FIFO.
        let mut word = [0u8; 4];
        let word = word.get_mut(..bytes).unwrap_or_default();
        word.fill_with(|| self.tx.pop_front().unwrap_or(self.shifting));
        word.iter_mut().rev().for_each(|byte| *byte = exchange(*byte));
        if self.cfg2 >> 17 & 3 != 1 && self.rx.len() + bytes <= FIFO_BYTES {
            self.rx.extend(word.iter());
        }
        if self.cr2 & 0xffff != 0 {
            self.to_shift = self.to_shift.saturating_sub(1);
            if self.to_shift == 0 {
                self.latched |= flag::END;
                self.running = false;
                self.cr1 &= !START;
                self.selected = false;
            }
        }
    }
}
