//! USART2 and USART3: both directions, FIFO, idle line (RM0433, chapter 48).

use super::clocks::unknown;
use crate::board::{Bus, Refusal};
use crate::time::{NEVER, PER_SECOND, Ticks};
use std::collections::VecDeque;

const FIFO_BYTES: usize = 16;

mod flag {
    pub const FRAMING: u32 = 1 << 1;
    pub const OVERRUN: u32 = 1 << 3;
    pub const IDLE: u32 = 1 << 4;
    pub const RX: u32 = 1 << 5;
    pub const TX_DONE: u32 = 1 << 6;
    pub const TX: u32 = 1 << 7;
    pub const TX_ACK: u32 = 1 << 21;
    pub const RX_ACK: u32 = 1 << 22;
}

/// A byte on its way to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Coming {
    /// When it has arrived.
    pub at: Ticks,
    pub byte: u8,
    /// Its stop bit is wrong.
    pub broken: bool,
}

/// Which of them: its name and its interrupt.
#[derive(Clone, Copy, Debug)]
pub(super) struct Port {
    pub name: &'static str,
    pub interrupt: u16,
}

/// Registers and what is on the line.
#[derive(Debug)]
pub(super) struct Usart {
    port: Port,
    control: [u32; 3],
    divider: u32,
    other: [u32; 2],
    prescaler: u32,
    latched: u32,
    tx: VecDeque<u8>,
    rx: VecDeque<u8>,
    sending: Option<(u8, Ticks)>,
    idle_at: Ticks,
    /// Bytes the host sends.
    pub coming: VecDeque<Coming>,
    /// Bytes that have left.
    pub sent: Vec<u8>,
    /// When each of them had left.
    pub sent_at: Vec<Ticks>,
    /// Bits a second of the line as the other side expects them.
    pub host_baud: u32,
}

impl Usart {
    pub fn new(port: Port, host_baud: u32) -> Self {
        Self {
            port,
            control: [0; 3],
            divider: 0,
            other: [0; 2],
            prescaler: 0,
            latched: flag::TX_DONE,
            tx: VecDeque::new(),
            rx: VecDeque::new(),
            sending: None,
            idle_at: NEVER,
            coming: VecDeque::new(),
            sent: Vec::new(),
            sent_at: Vec::new(),
            host_baud,
        }
    }

    /// As after a reset; what has left and what is still to come stays.
    pub fn reset(&mut self) {
        let (coming, sent) = (std::mem::take(&mut self.coming), std::mem::take(&mut self.sent));
        let sent_at = std::mem::take(&mut self.sent_at);
        *self = Self { coming, sent, sent_at, ..Self::new(self.port, self.host_baud) };
    }

    fn on(&self) -> bool {
        self.control[0] & 1 != 0
    }

    fn room(&self) -> usize {
        if self.control[0] & 1 << 29 != 0 { FIFO_BYTES } else { 1 }
    }

    fn flags(&self) -> u32 {
        let mut flags = self.latched & !flag::TX_DONE;
        if !self.rx.is_empty() {
            flags |= flag::RX;
        }
        if self.tx.len() < self.room() {
            flags |= flag::TX;
        }
        if self.tx.is_empty() && self.sending.is_none() {
            flags |= self.latched & flag::TX_DONE;
        }
        if self.on() {
            flags |= if self.control[0] & 8 != 0 { flag::TX_ACK } else { 0 };
            flags |= if self.control[0] & 4 != 0 { flag::RX_ACK } else { 0 };
        }
        flags
    }

    pub fn wants_tx_dma(&self) -> bool {
        self.on() && self.control[0] & 8 != 0 && self.control[2] & 0x80 != 0 && self.flags() & flag::TX != 0
    }

    pub fn wants_rx_dma(&self) -> bool {
        self.on() && self.control[2] & 0x40 != 0 && !self.rx.is_empty()
    }

    pub fn lines(&self, bus: &mut Bus<'_>) {
        let flags = self.flags();
        let by_own_bit = flags & self.control[0] & (flag::IDLE | flag::RX | flag::TX_DONE | flag::TX);
        let errors = flags & 0xf != 0 && (self.control[2] & 1 != 0 || self.control[0] & flag::RX != 0);
        bus.nvic.set_level(self.port.interrupt, self.on() && (by_own_bit != 0 || errors));
    }

    /// What is due does not arrive: the pin is not this port's.
    pub fn miss(&mut self, now: Ticks) {
        while self.coming.front().is_some_and(|coming| coming.at <= now) {
            self.coming.pop_front();
        }
    }

    /// Puts bytes on the line to the board, the first at `at`, one after the other; some may have a wrong stop bit.
    pub fn bring(&mut self, at: Ticks, bytes: impl IntoIterator<Item = (u8, bool)>) {
        let frame = 10 * crate::time::period(u64::from(self.host_baud));
        let mut next = self.coming.back().map_or(at, |last| at.max(last.at));
        self.coming.extend(bytes.into_iter().map(|(byte, broken)| {
            next += frame;
            Coming { at: next, byte, broken }
        }));
    }

    /// Ticks of a frame of ten bits, which must fit the other side's.
    fn frame(&self, kernel_hz: impl FnOnce() -> u64) -> Result<Ticks, Refusal> {
        const PRESCALERS: [u64; 12] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256];
        let hz = kernel_hz() / PRESCALERS[(self.prescaler as usize & 15).min(11)];
        let baud = if self.control[0] & 1 << 15 != 0 {
            let divider = self.divider & !15 | (self.divider & 7) << 1;
            2 * hz / u64::from(divider.max(1))
        } else {
            hz / u64::from(self.divider.max(1))
        };
        let wrong = baud.abs_diff(u64::from(self.host_baud)) * 50 > u64::from(self.host_baud);
        if self.divider < 16 || wrong {
            return Refusal::stop(format!(
                "{} runs at {baud} baud, the other side at {}",
                self.port.name, self.host_baud
            ));
        }
        Ok(10 * PER_SECOND / baud)
    }

    pub fn read(&mut self, offset: usize) -> Result<u32, Refusal> {
        Ok(match offset {
            0x00..=0x08 => self.control[offset / 4],
            0x0c => self.divider,
            0x10 | 0x14 => self.other[(offset - 0x10) / 4],
            0x18 | 0x20 => 0,
            0x1c => self.flags(),
            0x24 => u32::from(self.rx.pop_front().unwrap_or(0)),
            0x28 => 0,
            0x2c => self.prescaler,
            _ => return Err(unknown(self.port.name, offset)),
        })
    }

    pub fn write(&mut self, offset: usize, value: u32) -> Result<(), Refusal> {
        match offset {
            0x00 => {
                if self.on() && value & 1 != 0 && (value ^ self.control[0]) & 0x3000_9000 != 0 {
                    return Refusal::stop(format!(
                        "the frame of {} is changed while it is on",
                        self.port.name
                    ));
                }
                self.control[0] = value;
            }
            0x04 => self.control[1] = value,
            0x08 => self.control[2] = value,
            0x0c if self.on() => {
                return Refusal::stop(format!("{}_BRR is written while it is on", self.port.name));
            }
            0x0c => self.divider = value,
            0x10 | 0x14 => self.other[(offset - 0x10) / 4] = value,
            0x18 => {
                if value & 8 != 0 {
                    self.rx.clear();
                }
            }
            0x20 => self.latched &= !value,
            0x28 => {
                if !self.on() || self.control[0] & 8 == 0 {
                    return Refusal::stop(format!(
                        "{}_TDR is written with the transmitter off",
                        self.port.name
                    ));
                }
                if self.tx.len() >= self.room() {
                    return Refusal::stop(format!("{}_TDR is written while it is full", self.port.name));
                }
                self.tx.push_back(value as u8);
                self.latched &= !flag::TX_DONE;
            }
            0x2c => self.prescaler = value,
            _ => return Err(unknown(self.port.name, offset)),
        }
        Ok(())
    }

    pub fn next_event(&self) -> Ticks {
        let sending = self.sending.map_or(NEVER, |(_, end)| end);
        let coming = self.coming.front().map_or(NEVER, |c| c.at);
        sending.min(coming).min(self.idle_at)
    }

    /// Lets bytes go and come that are due.
    pub fn advance(&mut self, now: Ticks, kernel_hz: impl Fn() -> u64) -> Result<(), Refusal> {
        if let Some((byte, end)) = self.sending
            && end <= now
        {
            self.sent.push(byte);
            self.sent_at.push(end);
            self.sending = None;
            if self.tx.is_empty() {
                self.latched |= flag::TX_DONE;
            }
        }
        if self.sending.is_none()
            && self.on()
            && let Some(byte) = self.tx.pop_front()
        {
            self.sending = Some((byte, now + self.frame(&kernel_hz)?));
        }
        while let Some(Coming { at, byte, broken }) = self.coming.front().copied().filter(|c| c.at <= now) {
            self.coming.pop_front();
            if !self.on() || self.control[0] & 4 == 0 {
                continue;
            }
            if self.rx.len() >= self.room() {
                self.latched |= if self.control[2] & 1 << 12 == 0 { flag::OVERRUN } else { 0 };
            } else {
                self.rx.push_back(byte);
                self.latched |= if broken { flag::FRAMING } else { 0 };
            }
            self.idle_at = at + self.frame(&kernel_hz)?;
        }
        if self.idle_at <= now {
            self.idle_at = NEVER;
            self.latched |= flag::IDLE;
        }
        Ok(())
    }
}
