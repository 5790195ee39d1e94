//! The recorder on the emulated board.
#![no_std]
#![no_main]
#![allow(unsafe_code)]

use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, entry, exception};
use seabearing_core::block::Frame;
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::recorder::Memory;
use seabearing_core::run::{BLOCK_FRAMES, run};
use seabearing_core::sbraw::{Ending, Reader};
use seabearing_firmware::mps2_an500::{Board, blob, clock::CoreTicks, host, stack_use, uart::Uart0};

#[entry]
fn main() -> ! {
    static mut FRAMES: [Frame; BLOCK_FRAMES] = [[0; 4]; BLOCK_FRAMES];
    static mut MEMORY: Memory = Memory::new();

    let Some(peripherals) = cortex_m::Peripherals::take() else { fail(c"started twice\n") };
    let Ok(config) = config_blob::station(blob()) else { fail(c"no valid configuration at 0x60000000\n") };
    let Some(file) = host::File::read_from(c"samples.sbraw") else { fail(c"cannot open samples.sbraw\n") };
    let mut samples = Reader::new(file);
    let mut uart = Uart0::new();
    let mut clock = CoreTicks::new(peripherals.SYST);
    let table = config_blob::section(blob(), PROPAGATION).ok();
    let Ok(mut recorder) = MEMORY.configure(&config, table) else {
        fail(c"this image holds no recorder for this configuration\n")
    };
    let summary = run(&mut recorder, &mut samples, &mut uart, &mut clock, &mut Board::new(), FRAMES);
    uart.flush();
    if !host::leave_summary(&summary, stack_use()) {
        fail(c"cannot write summary.bin\n");
    }
    match samples.ending() {
        Ending::NotSbraw => fail(c"samples.sbraw is not an .sbraw stream\n"),
        Ending::Truncated => fail(c"samples.sbraw ends within a record\n"),
        Ending::Clean | Ending::Open => host::exit(0),
    }
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
fn panic(info: &PanicInfo<'_>) -> ! {
    seabearing_firmware::fault::record_and_reset(info)
}
