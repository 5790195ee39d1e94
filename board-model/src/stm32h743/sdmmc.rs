//! SDMMC1 with its own DMA, and the card behind it (RM0433, chapter 55, from memory).
//!
//! Strict: registers written while the state machines run, flags not cleared before a command, a transfer without its
//! length, time-out or buffer, buffers out of AXI SRAM, and what the card refuses stop the run. Data move in whole sectors.

use crate::board::{Bus, Refusal};
use crate::memory::Kind;
use crate::sd_card::{Answer, SECTOR, SdCard};
use crate::time::{NEVER, Ticks, period};

mod at {
    pub const POWER: usize = 0;
    pub const CLOCK: usize = 0x04;
    pub const ARGUMENT: usize = 0x08;
    pub const COMMAND: usize = 0x0c;
    pub const RESPONSE: usize = 0x14;
    pub const DATA_TIMER: usize = 0x24;
    pub const DATA_LENGTH: usize = 0x28;
    pub const DATA_CONTROL: usize = 0x2c;
    pub const DATA_COUNT: usize = 0x30;
    pub const STATUS: usize = 0x34;
    pub const CLEAR: usize = 0x38;
    pub const MASK: usize = 0x3c;
    pub const DMA_CONTROL: usize = 0x50;
    pub const DMA_BASE: usize = 0x58;
}

mod flag {
    pub const COMMAND_CRC: u32 = 1;
    pub const DATA_CRC: u32 = 1 << 1;
    pub const COMMAND_TIMEOUT: u32 = 1 << 2;
    pub const DATA_TIMEOUT: u32 = 1 << 3;
    pub const ANSWERED: u32 = 1 << 6;
    pub const SENT: u32 = 1 << 7;
    pub const DATA_END: u32 = 1 << 8;
    pub const DATA_ACTIVE: u32 = 1 << 12;
    pub const COMMAND_ACTIVE: u32 = 1 << 13;
    pub const BUSY: u32 = 1 << 20;
    pub const KEPT: u32 = 0x1fe0_0fff;
}

/// Bits of the command register.
const TRANSFERS: u32 = 1 << 6;
const STOPS: u32 = 1 << 7;
const ENABLED: u32 = 1 << 12;
/// Periods of the clock that a card needs after power, before its first command.
const WARM_UP: u64 = 74;
/// Periods of a sector over four lines: data, checksum, the card's status.
const SECTOR_PERIODS: u64 = 1024 + 16 + 12;

#[derive(Clone, Copy, Debug)]
struct Command {
    index: u8,
    waits: u32,
    transfers: bool,
    ends: Ticks,
}

/// A transfer: bytes left, where in memory, when the next sector is through.
#[derive(Clone, Copy, Debug)]
struct Transfer {
    left: u32,
    memory: u32,
    reads: bool,
    next: Ticks,
    gives_up: Ticks,
}

/// The controller.
#[derive(Debug)]
pub(super) struct Sdmmc {
    power: u32,
    powered_at: Ticks,
    clock: u32,
    argument: u32,
    responses: [u32; 4],
    responded: u32,
    data_timer: u32,
    data_length: u32,
    data_control: u32,
    dma_control: u32,
    dma_base: u32,
    flags: u32,
    command: Option<Command>,
    transfer: Option<Transfer>,
}

impl Sdmmc {
    pub fn new() -> Self {
        Self {
            power: 0,
            powered_at: 0,
            clock: 0,
            argument: 0,
            responses: [0; 4],
            responded: 0,
            data_timer: 0,
            data_length: 0,
            data_control: 0,
            dma_control: 0,
            dma_base: 0,
            flags: 0,
            command: None,
            transfer: None,
        }
    }

    pub fn next_event(&self) -> Ticks {
        let command = self.command.map_or(NEVER, |command| command.ends);
        command.min(self.transfer.map_or(NEVER, |transfer| transfer.next.min(transfer.gives_up)))
    }

    /// Frequency of the card's clock.
    fn hz(&self, kernel_hz: u64) -> u64 {
        kernel_hz / u64::from(2 * (self.clock & 0x3ff)).max(1)
    }

    pub fn read(&self, offset: usize, card: &SdCard, now: Ticks) -> Result<u32, Refusal> {
        Ok(match offset {
            at::POWER => self.power,
            at::CLOCK => self.clock,
            0x10 => self.responded,
            at::RESPONSE..0x24 => self.responses[(offset - at::RESPONSE) / 4],
            at::DATA_TIMER => self.data_timer,
            at::DATA_LENGTH => self.data_length,
            at::DATA_CONTROL => self.data_control,
            at::DATA_COUNT => self.transfer.map_or(0, |transfer| transfer.left),
            at::STATUS => {
                let active = |on, flag| if on { flag } else { 0 };
                self.flags
                    | active(self.transfer.is_some(), flag::DATA_ACTIVE)
                    | active(self.command.is_some(), flag::COMMAND_ACTIVE)
                    | active(card.busy(now), flag::BUSY)
            }
            at::MASK => 0,
            at::DMA_CONTROL => self.dma_control,
            at::DMA_BASE => self.dma_base,
            _ => return Refusal::stop(format!("register {offset:#x} of SDMMC1 is not modelled")),
        })
    }

    pub fn write(&mut self, offset: usize, value: u32, now: Ticks, kernel_hz: u64) -> Result<(), Refusal> {
        let runs = self.command.is_some() || self.transfer.is_some();
        if runs && !matches!(offset, at::CLEAR | at::ARGUMENT | at::COMMAND) {
            return Refusal::stop(format!("register {offset:#x} of SDMMC1 is written while it runs"));
        }
        match offset {
            at::POWER if value & 3 == 3 && self.clock & 0x3ff == 0 => {
                return Refusal::stop("SDMMC1 is switched on without a divider of its clock");
            }
            at::POWER => (self.power, self.powered_at) = (value & 3, now),
            at::CLOCK => self.clock = value,
            at::ARGUMENT => self.argument = value,
            at::COMMAND if value & ENABLED != 0 => return self.begin(value, now, self.hz(kernel_hz)),
            at::COMMAND => {}
            at::DATA_TIMER => self.data_timer = value,
            at::DATA_LENGTH => self.data_length = value,
            at::DATA_CONTROL if value & 1 != 0 => {
                return Refusal::stop("SDMMC1's data path is switched on by DTEN, not by a command");
            }
            at::DATA_CONTROL => self.data_control = value,
            at::CLEAR => self.flags &= !(value & flag::KEPT),
            at::MASK if value == 0 => {}
            at::DMA_CONTROL if value & !1 == 0 => self.dma_control = value,
            at::DMA_BASE => self.dma_base = value,
            _ => {
                return Refusal::stop(format!("SDMMC1: {value:#x} for register {offset:#x} is not modelled"));
            }
        }
        Ok(())
    }

    fn begin(&mut self, value: u32, now: Ticks, hz: u64) -> Result<(), Refusal> {
        let (index, waits, transfers) = ((value & 0x3f) as u8, value >> 8 & 3, value & TRANSFERS != 0);
        let wrong = if self.power != 3 {
            "while SDMMC1 is not powered on"
        } else if self.command.is_some() {
            "while the one before runs"
        } else if self.flags & (flag::ANSWERED | flag::SENT | flag::COMMAND_TIMEOUT | flag::COMMAND_CRC) != 0
        {
            "with flags of the one before"
        } else if now < self.powered_at + WARM_UP * period(hz) {
            "before the card had 74 periods of its clock"
        } else if self.transfer.is_some() && (index != 12 || value & STOPS == 0) {
            "in the middle of a transfer"
        } else {
            ""
        };
        if !wrong.is_empty() {
            return Refusal::stop(format!("command {index} is sent {wrong}"));
        }
        let answer = [8, 64 + 48, 64 + 48, 64 + 136][waits as usize];
        let ends = now + (48 + answer) * period(hz);
        self.command = Some(Command { index, waits, transfers, ends });
        self.responded = u32::from(index);
        Ok(())
    }

    /// Does what is due; whether power fails now.
    pub fn advance(&mut self, bus: &mut Bus<'_>, card: &mut SdCard, kernel_hz: u64) -> Result<bool, Refusal> {
        let hz = self.hz(kernel_hz);
        if let Some(command) = self.command.filter(|command| command.ends <= bus.now) {
            self.command = None;
            self.answer(command, card, hz, bus.now)?;
        }
        match self.transfer {
            Some(transfer) if transfer.next <= bus.now => self.sector(transfer, bus, card, hz),
            Some(transfer) if transfer.gives_up <= bus.now => {
                self.transfer = None;
                self.flags |= flag::DATA_TIMEOUT;
                Ok(false)
            }
            _ => Ok(false),
        }
    }

    fn answer(&mut self, command: Command, card: &mut SdCard, hz: u64, now: Ticks) -> Result<(), Refusal> {
        let answer = card.command(command.index, self.argument, hz, now)?;
        self.flags |= match (answer, command.waits) {
            (Answer::None, 0) => flag::SENT,
            (Answer::None, _) => flag::COMMAND_TIMEOUT,
            (Answer::Short(word), 1 | 2) | (Answer::Unchecked(word), 2) => {
                self.responses[0] = word;
                flag::ANSWERED
            }
            (Answer::Unchecked(word), 1) => {
                self.responses[0] = word;
                flag::COMMAND_CRC
            }
            (Answer::Long(words), 3) => {
                self.responses = words;
                flag::ANSWERED
            }
            _ => {
                return Refusal::stop(format!(
                    "command {} waits for another answer than comes",
                    command.index
                ));
            }
        };
        if command.transfers && answer != Answer::None {
            self.begin_transfer(card, hz, now)?;
        }
        Ok(())
    }

    fn begin_transfer(&mut self, card: &SdCard, hz: u64, now: Ticks) -> Result<(), Refusal> {
        let wrong = if self.data_length == 0 || !(self.data_length as usize).is_multiple_of(SECTOR) {
            "without whole sectors to move"
        } else if self.data_control >> 4 & 15 != 9 || self.data_control & 0xc != 0 {
            "in other blocks than of 512 bytes"
        } else if self.dma_control & 1 == 0 || !self.dma_base.is_multiple_of(4) {
            "without a buffer"
        } else if self.data_timer == 0 {
            "without a time-out"
        } else if card.wide() != (self.clock >> 14 & 3 == 1) || !card.wide() {
            "over another number of lines than the card's four"
        } else {
            ""
        };
        if !wrong.is_empty() {
            return Refusal::stop(format!("SDMMC1 begins a transfer {wrong}"));
        }
        self.transfer = Some(Transfer {
            left: self.data_length,
            memory: self.dma_base,
            reads: self.data_control & 2 != 0,
            next: now + SECTOR_PERIODS * period(hz),
            gives_up: now + u64::from(self.data_timer) * period(hz),
        });
        Ok(())
    }

    /// A sector is through.
    fn sector(
        &mut self,
        transfer: Transfer,
        bus: &mut Bus<'_>,
        card: &mut SdCard,
        hz: u64,
    ) -> Result<bool, Refusal> {
        let memory = transfer.memory;
        if !matches!(bus.memory.extent(memory), Some((_, _, Kind::Axi))) {
            return Refusal::stop(format!("SDMMC1's DMA does not reach {memory:#010x}: only AXI SRAM"));
        }
        if bus.memory.may_be_cached(memory) {
            return Refusal::stop(format!(
                "SDMMC1's DMA moves {memory:#010x}, which the data cache may hold"
            ));
        }
        let none = || Refusal::Stop(format!("SDMMC1's DMA finds no memory at {memory:#010x}"));
        let place = bus.memory.bytes_mut(memory, SECTOR as u32).ok_or_else(none)?;
        let (good, cut) = if transfer.reads {
            let sector = card.send();
            if let Some(sector) = sector {
                place.copy_from_slice(&sector);
            }
            (sector.is_some(), false)
        } else {
            let mut sector = [0; SECTOR];
            sector.copy_from_slice(place);
            card.receive(&sector, bus.now)
        };
        let left = transfer.left - SECTOR as u32;
        self.transfer = None;
        if !good {
            self.flags |= flag::DATA_CRC;
        } else if left == 0 {
            self.flags |= flag::DATA_END;
        } else {
            let next = bus.now.max(card.busy_until()) + SECTOR_PERIODS * period(hz);
            let gives_up = bus.now + u64::from(self.data_timer) * period(hz);
            self.transfer =
                Some(Transfer { left, memory: memory + SECTOR as u32, next, gives_up, ..transfer });
        }
        Ok(cut)
    }
}
