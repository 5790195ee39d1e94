//! ARM's MPS2+ with the AN500 image, as far as the project's images use it: two serial lines and semihosting.
//!
//! QEMU models the same board, so that both must give the same bytes and count the same work: one instruction is 1 ns,
//! and SysTick counts every 40 ns, as QEMU does it with `-icount shift=0`.

use crate::board::{Board, Bus, Refusal, Width, Wish};
use crate::core::Machine;
use crate::costs::Costs;
use crate::elf::Image;
use crate::memory::{Kind, Memory};
use crate::time::{NEVER, Ticks};
use std::collections::VecDeque;
use std::io::Read;

const UARTS: [u32; 2] = [0x4000_4000, 0x4000_5000];
const BLOB: u32 = 0x6000_0000;
const INSTRUCTION_HZ: u64 = 1_000_000_000;
const INSTRUCTIONS_PER_TICK: u64 = 40;
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

/// The board: what the software sent is in `telemetry`.
pub struct Mps2An500 {
    uarts: [Uart; 2],
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
        f.debug_struct("Mps2An500").field("uarts", &self.uarts).finish_non_exhaustive()
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

    /// Bytes to come on UART0 (commands).
    pub fn send_commands(&mut self, bytes: impl IntoIterator<Item = u8>) {
        self.uarts[0].coming.extend(bytes);
    }

    fn uart(address: u32) -> Option<(usize, u32)> {
        UARTS.iter().position(|base| address & !0xfff == *base).map(|uart| (uart, address & 0xfff))
    }

    fn lines(&mut self, bus: &mut Bus<'_>) {
        for (uart, interrupt) in self.uarts.iter_mut().zip([0, 2]) {
            uart.receive();
            bus.nvic.set_level(interrupt, uart.interrupt & 2 != 0);
        }
    }
}

impl Board for Mps2An500 {
    fn read(&mut self, bus: &mut Bus<'_>, address: u32, _width: Width) -> Result<u32, Refusal> {
        let Some((index, register)) = Self::uart(address) else { return Err(Refusal::BusFault) };
        self.lines(bus);
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

    fn advance(&mut self, _bus: &mut Bus<'_>) -> Result<(), Refusal> {
        Ok(())
    }

    fn next_event(&self) -> Ticks {
        NEVER
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
