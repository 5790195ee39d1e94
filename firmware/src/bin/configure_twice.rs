//! What stack a recorder needs to take a configuration, and how much more to take it a second time, on the emulated board.
//!
//! Configures the recorder that the blob asks for twice. Leaves in `summary.bin` two words `u64le`: bytes of stack used by
//! the first time, and by both.
#![no_std]
#![no_main]
#![allow(unsafe_code)]

use cortex_m_rt::entry;
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::recorder::Memory;
use seabearing_firmware::mps2_an500::{blob, host::fail, measurement::end};
use seabearing_firmware::stack;

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
        *used = u64::from(stack::used().1);
    }
    end(&words)
}

seabearing_firmware::fail_on_faults!();
