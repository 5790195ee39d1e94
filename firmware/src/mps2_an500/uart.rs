//! UART0 of the board: ARM's CMSDK APB UART, polled (the emulator's never makes the program wait for long).

use seabearing_core::port::Link;

const BASE: usize = 0x4000_4000;
const DATA: *mut u32 = BASE as *mut u32;
const STATE: *const u32 = (BASE + 0x04) as *const u32;
const CONTROL: *mut u32 = (BASE + 0x08) as *mut u32;
const BAUD_DIVIDER: *mut u32 = (BASE + 0x10) as *mut u32;
const TX_FULL: u32 = 1;
const RX_FULL: u32 = 2;
/// Transmitter and receiver on.
const ENABLE: u32 = 3;
/// 25 MHz / 16: as fast as the device goes.
const DIVIDER: u32 = 16;

/// UART0; made once, by `main`.
pub struct Uart0(());

impl Uart0 {
    /// Switches the device on.
    pub fn new() -> Self {
        // SAFETY: the device's own registers, which nothing else touches.
        unsafe {
            BAUD_DIVIDER.write_volatile(DIVIDER);
            CONTROL.write_volatile(ENABLE);
        }
        Self(())
    }

    /// Waits until the last byte has left.
    pub fn flush(&mut self) {
        // SAFETY: reads the state register.
        while unsafe { STATE.read_volatile() } & TX_FULL != 0 {}
    }
}

impl Link for Uart0 {
    fn send(&mut self, frame: &[u8]) -> bool {
        for &byte in frame {
            self.flush();
            // SAFETY: the transmit register, free now.
            unsafe { DATA.write_volatile(u32::from(byte)) };
        }
        true
    }

    fn receive(&mut self) -> Option<u8> {
        // SAFETY: the state register, and the receive register when it holds a byte.
        unsafe { (STATE.read_volatile() & RX_FULL != 0).then(|| DATA.read_volatile() as u8) }
    }
}
