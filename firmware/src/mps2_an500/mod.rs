//! The emulated board: ARM MPS2+ with the AN500 image (Cortex-M7) as QEMU models it.
//!
//! The configuration blob stands in PSRAM as it would in flash (the host loads it there before the start). Samples
//! come from the file or FIFO `samples.sbraw` of QEMU's working directory by semihosting, or over UART1 where the
//! semihosting command line says `samples=uart`; telemetry and commands go over UART0, and the work done is left in
//! `summary.bin`. The exit status is 0, or 1 with a reason on the console.

#![allow(unsafe_code)]

pub mod clock;
pub mod host;
pub mod input;
pub mod measurement;
pub mod uart;

use crate::fault::{self, Record};
use seabearing_core::port::Supervisor;
use seabearing_core::wire::FaultCode;

/// Start and size of the memory the configuration blob is loaded into.
const BLOB: (*const u8, usize) = (0x6000_0000 as *const u8, 1 << 20);

/// The configuration blob and the zeros behind it.
pub fn blob() -> &'static [u8] {
    // SAFETY: PSRAM is plain memory that nothing in this image writes.
    unsafe { core::slice::from_raw_parts(BLOB.0, BLOB.1) }
}

/// Memory of the board that start-up leaves alone, and that the emulator may keep in a file: what stands in it survives even a
/// loss of power. Taken once, by `main`.
#[cfg(feature = "link")]
pub fn retained() -> &'static mut [u8] {
    const RETAINED: (*mut u8, usize) = (0x6080_0000 as *mut u8, 1 << 15);
    // SAFETY: PSRAM far behind the blob, plain memory that nothing else names.
    unsafe { core::slice::from_raw_parts_mut(RETAINED.0, RETAINED.1) }
}

/// The emulated board has no watchdog; the reason of a start is known from the panic record.
pub struct Board(Option<Record>);

impl Board {
    /// The board as it started.
    pub fn started() -> Self {
        Self(fault::take())
    }
}

impl Supervisor for Board {
    fn feed(&mut self) {}

    fn idle(&mut self) {
        uart::sleep();
    }

    fn reset_cause(&self) -> u8 {
        const POWER: u8 = 0;
        const SOFTWARE: u8 = 2;
        if self.0.is_some() { SOFTWARE } else { POWER }
    }

    fn last_fault(&mut self) -> Option<(FaultCode, i64)> {
        self.0.map(Record::told)
    }
}
