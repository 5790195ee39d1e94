//! What stack a recorder needs to take a configuration, and how much more to take it a second time, on the emulated board.
//!
//! Configures the recorder that the blob asks for twice. Leaves in `summary.bin` two words `u64le`: bytes of stack used by
//! the first time, and by both.
#![no_std]
#![no_main]
#![allow(unsafe_code)]

use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, entry, exception};
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::recorder::Memory;
use seabearing_firmware::mps2_an500::{blob, host, stack_use};

#[entry]
fn main() -> ! {
    static mut MEMORY: Memory<'static> = Memory::new();

    let mut words = [0u64; 2];
    for used in &mut words {
        let Ok(config) = config_blob::station(blob()) else {
            fail(c"no valid configuration at 0x60000000\n")
        };
        let table = config_blob::section(blob(), PROPAGATION).ok();
        if MEMORY.configure(&config, table).is_err() {
            fail(c"this image holds no recorder for this configuration\n");
        }
        *used = u64::from(stack_use().1);
    }
    let Some(mut file) = host::File::write_to(c"summary.bin") else { fail(c"cannot write summary.bin\n") };
    if !words.iter().all(|w| file.write(&w.to_le_bytes())) {
        fail(c"cannot write summary.bin\n");
    }
    host::exit(0)
}

fn fail(line: &core::ffi::CStr) -> ! {
    host::say(line);
    host::exit(1)
}

#[exception]
unsafe fn HardFault(_frame: &ExceptionFrame) -> ! {
    fail(c"hard fault\n")
}

#[panic_handler]
fn panic(_info: &PanicInfo<'_>) -> ! {
    fail(c"panicked\n")
}
