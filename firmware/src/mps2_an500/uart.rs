//! UARTs of the board: ARM's CMSDK APB UART, polled; the emulator holds a byte back until the one before is read.
//!
//! Telemetry and commands use UART0, samples may come over UART1. Their receive interrupts are never taken: they wake the
//! core from its sleep, then the lines are polled.

use super::clock::TIMER_IRQ;
use cortex_m::peripheral::NVIC;
use seabearing_core::port::Link;
use seabearing_core::sample_line::{Arrival, ByteSource};

const UART0: usize = 0x4000_4000;
const UART1: usize = 0x4000_5000;
/// Receive interrupts of both and the timer's in the interrupt controller's first word.
const WAKE: u32 = 1 << 0 | 1 << 2 | TIMER_IRQ;
const TX_FULL: u32 = 1;
const RX_FULL: u32 = 2;
/// Transmitter, receiver and the receive interrupt on.
const ENABLE: u32 = 1 | 2 | 1 << 3;
/// Bit of the receive interrupt in the register that clears interrupts.
const CLEAR_RX: u32 = 2;
/// 25 MHz / 16: as fast as the device goes.
const DIVIDER: u32 = 16;

/// Registers of one device, in order of address.
#[repr(C)]
struct Registers {
    data: u32,
    state: u32,
    control: u32,
    clear_interrupt: u32,
    baud_divider: u32,
}

/// One UART.
pub struct Uart(*mut Registers);

impl Uart {
    /// Bits a second.
    pub const BAUD: u32 = 25_000_000 / DIVIDER;

    /// Switches the device for telemetry and commands on; made once, by `main`.
    pub fn telemetry() -> Self {
        Self::on(UART0)
    }

    /// Switches the device for samples on; made once, by `main`.
    pub fn samples() -> Self {
        Self::on(UART1)
    }

    fn on(base: usize) -> Self {
        let registers = base as *mut Registers;
        // SAFETY: the device's own registers, which nothing else touches.
        unsafe {
            (&raw mut (*registers).baud_divider).write_volatile(DIVIDER);
            (&raw mut (*registers).control).write_volatile(ENABLE);
        }
        Self(registers)
    }

    fn state(&self) -> u32 {
        // SAFETY: reads the state register.
        unsafe { (&raw const (*self.0).state).read_volatile() }
    }

    fn byte(&mut self) -> Option<u8> {
        // SAFETY: the receive register when it holds a byte.
        (self.state() & RX_FULL != 0).then(|| unsafe { (&raw const (*self.0).data).read_volatile() } as u8)
    }

    /// Waits until the last byte has left.
    pub fn flush(&mut self) {
        while self.state() & TX_FULL != 0 {}
    }
}

impl Link for Uart {
    fn send(&mut self, frame: &[u8]) -> bool {
        for &byte in frame {
            self.flush();
            // SAFETY: the transmit register, free now.
            unsafe { (&raw mut (*self.0).data).write_volatile(u32::from(byte)) };
        }
        true
    }

    fn receive(&mut self) -> Option<u8> {
        self.byte()
    }
}

impl ByteSource for Uart {
    fn next(&mut self) -> Arrival {
        self.byte().map_or(Arrival::Nothing, Arrival::Byte)
    }
}

/// Sleeps until a byte has come on either line or a second has gone by; at once if either was since the last sleep.
pub fn sleep() {
    // SAFETY: with interrupts masked none of these is taken; a pending one ends the sleep all the same. The flags are
    // cleared before the lines are polled, so that a byte that comes meanwhile ends the next sleep.
    unsafe {
        cortex_m::interrupt::disable();
        let nvic = &*NVIC::PTR;
        nvic.iser[0].write(WAKE);
        cortex_m::asm::wfi();
        for base in [UART0, UART1] {
            (&raw mut (*(base as *mut Registers)).clear_interrupt).write_volatile(CLEAR_RX);
        }
        nvic.icpr[0].write(WAKE);
    }
}
