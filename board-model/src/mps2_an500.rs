//! ARM's MPS2+ with the AN500 image, as far as the project's images use it: two serial lines, a timer and semihosting.
//!
//! QEMU models the same board, so that both must give the same bytes and count the same work: one instruction is 1 ns,
//! and SysTick counts every 40 ns, as QEMU does it with `-icount shift=0`.

use crate::board::{Board, Bus, Refusal, Width, Wish};
use crate::core::Machine;
use crate::costs::Costs;
use crate::elf::Image;
use crate::memory::{Kind, Memory};
use crate::time::{NEVER, PER_SECOND, Ticks};
use std::collections::VecDeque;
use std::io::Read;

const UARTS: [u32; 2] = [0x4000_4000, 0x4000_5000];
const BLOB: u32 = 0x6000_0000;
const INSTRUCTION_HZ: u64 = 1_000_000_000;
const INSTRUCTIONS_PER_TICK: u64 = 40;
const TIMER: u32 = 0x4000_0000;
const TIMER_INTERRUPT: u16 = 8;
/// Model time of one count of the timer: that of the board's 25 MHz.
const COUNT: Ticks = PER_SECOND / (INSTRUCTION_HZ / INSTRUCTIONS_PER_TICK);
/// Handles of files of the host.
const SAMPLES: u32 = 3;
const SUMMARY: u32 = 4;

/// A serial line.
#[derive(Debug, Default)]
struct Uart {
    control: u32,
    divider: u32,
    interrupt: u32,
    /// Bytes still to come.
    coming: VecDeque<u8>,
    received: Option<u8>,
}

impl Uart {
    /// Lets the next byte in where the last was read and the receiver is on.
    fn receive(&mut self) {
        if self.control & 2 != 0 && self.received.is_none() {
            self.received = self.coming.pop_front();
            if self.received.is_some() && self.control & 8 != 0 {
                self.interrupt |= 2;
            }
        }
    }
}

/// Timer 0 (CMSDK): counts down, stays at zero for one count, raises its interrupt there and begins again at `reload`.
#[derive(Debug, Default)]
struct Timer {
    control: u32,
    /// What stands in the counter while it does not count.
    value: u32,
    reload: u32,
    interrupt: u32,
    /// When the counter is next at zero; while it counts.
    zero_at: Ticks,
}

impl Timer {
    fn on(&self) -> bool {
        self.control & 1 != 0
    }

    fn value(&self, now: Ticks) -> u32 {
        // In the count that follows a zero the next zero is `reload + 1` counts away.
        let left = self.zero_at.saturating_sub(now).div_ceil(COUNT);
        if !self.on() {
            self.value
        } else if left > u64::from(self.reload) {
            0
        } else {
            left as u32
        }
    }

    fn set_value(&mut self, value: u32, now: Ticks) {
        self.value = value;
        self.zero_at = now + u64::from(value) * COUNT;
    }

    /// Carries out the zeros up to now.
    fn advance(&mut self, now: Ticks) {
        while self.on() && self.zero_at <= now {
            self.interrupt |= self.control >> 3 & 1;
            self.zero_at += (u64::from(self.reload) + 1) * COUNT;
        }
    }

    fn read(&self, register: u32, now: Ticks) -> Result<u32, Refusal> {
        Ok(match register {
            0 => self.control,
            4 => self.value(now),
            8 => self.reload,
            12 => self.interrupt,
            _ => return Refusal::stop(format!("an unknown register of the timer, {register:#x}")),
        })
    }

    fn write(&mut self, register: u32, value: u32, now: Ticks) -> Result<(), Refusal> {
        match register {
            0 if value & !9 != 0 => return Refusal::stop("the timer's external input is not modelled"),
            0 if value & 1 != 0 && self.reload == 0 => {
                return Refusal::stop("the timer is started without a reload");
            }
            0 => {
                self.set_value(self.value(now), now);
                self.control = value;
            }
            4 if value > self.reload => return Refusal::stop("the timer's value is above its reload"),
            4 => self.set_value(value, now),
            // A new reload is the value as well.
            8 => {
                self.reload = value;
                self.set_value(value, now);
            }
            12 => self.interrupt &= !value,
            _ => return Refusal::stop(format!("an unknown register of the timer, {register:#x}")),
        }
        Ok(())
    }
}

/// The board: what the software sent is in `telemetry`.
pub struct Mps2An500 {
    uarts: [Uart; 2],
    timer: Timer,
    samples: Box<dyn Read + Send>,
    command_line: String,
    /// Bytes that left on UART0.
    pub telemetry: Vec<u8>,
    /// What was written to `summary.bin`.
    pub summary: Vec<u8>,
    /// Lines on the host's console.
    pub console: String,
}

impl std::fmt::Debug for Mps2An500 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut f = f.debug_struct("Mps2An500");
        f.field("uarts", &self.uarts).field("timer", &self.timer).finish_non_exhaustive()
    }
}

/// The board with an image, a configuration blob, and a stream of samples for `samples.sbraw`.
///
/// # Errors
/// The image or the blob does not fit.
pub fn machine(
    image: Image,
    blob: &[u8],
    samples: Box<dyn Read + Send>,
) -> Result<Machine<Mps2An500>, String> {
    let mut memory = Memory::default();
    memory.add(0, 4 << 20, Kind::TightlyCoupled, 0);
    memory.add(0x2000_0000, 4 << 20, Kind::TightlyCoupled, 0);
    memory.add(BLOB, 16 << 20, Kind::Sram, 0);
    let place = memory.bytes_mut(BLOB, blob.len() as u32);
    place.ok_or("the configuration blob is larger than the board's memory")?.copy_from_slice(blob);
    let board = Mps2An500 {
        uarts: Default::default(),
        timer: Timer::default(),
        samples,
        command_line: String::new(),
        telemetry: Vec::new(),
        summary: Vec::new(),
        console: String::new(),
    };
    Machine::new(board, memory, image, Costs::IDEAL, &[(0, 2 << 20)])
}

impl Mps2An500 {
    /// The semihosting command line, and bytes to come on UART1 (the sample line).
    pub fn set_sample_line(&mut self, bytes: impl IntoIterator<Item = u8>) {
        self.command_line = "samples=uart".to_owned();
        self.uarts[1].coming.extend(bytes);
    }

    fn uart(address: u32) -> Option<(usize, u32)> {
        UARTS.iter().position(|base| address & !0xfff == *base).map(|uart| (uart, address & 0xfff))
    }

    fn lines(&mut self, bus: &mut Bus<'_>) {
        for (uart, interrupt) in self.uarts.iter_mut().zip([0, 2]) {
            uart.receive();
            bus.nvic.set_level(interrupt, uart.interrupt & 2 != 0);
        }
        self.timer.advance(bus.now);
        bus.nvic.set_level(TIMER_INTERRUPT, self.timer.interrupt != 0);
    }

    fn timer(address: u32) -> Option<u32> {
        (address & !0xfff == TIMER).then_some(address & 0xfff)
    }
}

impl Board for Mps2An500 {
    fn read(&mut self, bus: &mut Bus<'_>, address: u32, _width: Width) -> Result<u32, Refusal> {
        self.lines(bus);
        if let Some(register) = Self::timer(address) {
            return self.timer.read(register, bus.now);
        }
        let Some((index, register)) = Self::uart(address) else { return Err(Refusal::BusFault) };
        let uart = &mut self.uarts[index];
        let value = match register {
            0 => u32::from(uart.received.take().unwrap_or(0)),
            // What is written has left at once.
            4 => u32::from(uart.received.is_some()) << 1,
            8 => uart.control,
            12 => uart.interrupt,
            16 => uart.divider,
            _ => return Refusal::stop(format!("an unknown register of a serial line, {address:#010x}")),
        };
        self.lines(bus);
        Ok(value)
    }

    fn write(&mut self, bus: &mut Bus<'_>, address: u32, value: u32, _width: Width) -> Result<(), Refusal> {
        if let Some(register) = Self::timer(address) {
            self.lines(bus);
            self.timer.write(register, value, bus.now)?;
            self.lines(bus);
            return Ok(());
        }
        let Some((index, register)) = Self::uart(address) else { return Err(Refusal::BusFault) };
        let uart = &mut self.uarts[index];
        match register {
            0 if uart.control & 1 == 0 => return Refusal::stop("a byte is sent with the transmitter off"),
            0 if index == 0 => self.telemetry.push(value as u8),
            0 | 4 => {}
            8 => uart.control = value,
            12 => uart.interrupt &= !value,
            16 => uart.divider = value,
            _ => return Refusal::stop(format!("an unknown register of a serial line, {address:#010x}")),
        }
        self.lines(bus);
        Ok(())
    }

    fn advance(&mut self, bus: &mut Bus<'_>) -> Result<(), Refusal> {
        self.lines(bus);
        Ok(())
    }

    fn next_event(&self) -> Ticks {
        if self.timer.on() { self.timer.zero_at } else { NEVER }
    }

    fn semihosting(&mut self, bus: &mut Bus<'_>, operation: u32, argument: u32) -> Option<u32> {
        const FAILED: u32 = u32::MAX;
        let word = |bus: &Bus<'_>, index: u32| {
            let bytes = bus.memory.bytes(argument.wrapping_add(4 * index), 4)?;
            Some(u32::from_le_bytes(bytes.try_into().ok()?))
        };
        let text = |bus: &Bus<'_>, at: u32, length: u32| {
            bus.memory.bytes(at, length).map(|b| String::from_utf8_lossy(b).into_owned())
        };
        Some(match operation {
            1 => match text(bus, word(bus, 0)?, word(bus, 2)?)?.as_str() {
                "samples.sbraw" => SAMPLES,
                "summary.bin" => SUMMARY,
                _ => FAILED,
            },
            4 => {
                let zero = (0..4096).find(|i| bus.memory.bytes(argument + i, 1) == Some(&[0]))?;
                self.console += &text(bus, argument, zero)?;
                0
            }
            5 if word(bus, 0)? == SUMMARY => {
                self.summary.extend(bus.memory.bytes(word(bus, 1)?, word(bus, 2)?)?);
                0
            }
            6 if word(bus, 0)? == SAMPLES => {
                let (at, length) = (word(bus, 1)?, word(bus, 2)?);
                let to = bus.memory.bytes_mut(at, length)?;
                let mut got = 0;
                while got < to.len() {
                    match self.samples.read(&mut to[got..]) {
                        Ok(0) => break,
                        Ok(n) => got += n,
                        Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                        Err(_) => break,
                    }
                }
                length - got as u32
            }
            0x15 => {
                let (at, room) = (word(bus, 0)?, word(bus, 1)?);
                let line = self.command_line.as_bytes();
                if line.len() as u32 >= room {
                    return Some(FAILED);
                }
                let to = bus.memory.bytes_mut(at, line.len() as u32 + 1)?;
                to[..line.len()].copy_from_slice(line);
                to[line.len()] = 0;
                let length = (line.len() as u32).to_le_bytes();
                bus.memory.bytes_mut(argument + 4, 4)?.copy_from_slice(&length);
                0
            }
            0x20 => {
                let status = word(bus, 1)?;
                bus.wishes.push(Wish::Exit(status));
                0
            }
            _ => return None,
        })
    }

    fn software_reset(&mut self, _bus: &mut Bus<'_>) {}

    fn reset_hz(&self) -> u64 {
        INSTRUCTION_HZ
    }

    fn systick_cycles(&self) -> u64 {
        INSTRUCTIONS_PER_TICK
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_timer_ends_once_a_second_by_the_boards_clock() {
        let mut timer = Timer::default();
        let (reload, start) = (25_000_000 - 1, 12_345);
        timer.write(8, reload, 0).unwrap();
        timer.write(4, reload, 0).unwrap();
        assert_eq!(timer.value(PER_SECOND), reload, "it does not count while it is off");
        timer.write(0, 9, start).unwrap();
        for second in 1..4 {
            let zero = start + second * PER_SECOND - COUNT;
            timer.advance(zero - 1);
            assert_eq!((timer.interrupt, timer.value(zero - 1)), (0, 1));
            timer.advance(zero);
            assert_eq!((timer.interrupt, timer.value(zero)), (1, 0));
            assert_eq!(timer.value(zero + COUNT), reload);
            timer.write(12, 1, zero).unwrap();
            assert_eq!(timer.read(12, zero), Ok(0));
        }
    }

    #[test]
    fn the_timer_stands_when_stopped_and_is_silent_without_its_interrupt() {
        let mut timer = Timer::default();
        assert!(timer.write(0, 1, 0).is_err(), "no reload");
        timer.write(8, 9, 0).unwrap();
        timer.write(0, 1, 0).unwrap();
        timer.write(0, 0, 4 * COUNT).unwrap();
        assert_eq!(timer.value(100 * COUNT), 5);
        timer.write(0, 1, 100 * COUNT).unwrap();
        timer.advance(1000 * COUNT);
        assert_eq!(timer.interrupt, 0);
        assert!(timer.write(0, 2, 0).is_err(), "an external input");
        assert!(timer.write(4, 10, 0).is_err(), "above the reload");
    }
}
