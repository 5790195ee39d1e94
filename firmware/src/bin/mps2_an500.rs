//! The recorder on the emulated board; with the feature `link` its records wait until the base station has them.
#![no_std]
#![no_main]
#![allow(unsafe_code)]

use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, entry, exception};
use seabearing_core::block::Frame;
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::recorder::Memory;
use seabearing_core::run::BLOCK_FRAMES;
#[cfg(not(feature = "link"))]
use seabearing_core::run::run;
#[cfg(feature = "link")]
use seabearing_core::{
    outlet::Reliable,
    run::run_over,
    snippet::MOST_CODES,
    wire::guard::{Guard, Recipient},
    wire::link::{ByteStore, Link, Retained, Settings},
};
use seabearing_firmware::mps2_an500::{Board, blob, clock::BoardClock, host, input::Input, uart::Uart};
use seabearing_firmware::stack;

#[entry]
fn main() -> ! {
    #[cfg(feature = "link")]
    static mut LINK: Option<Link<ByteStore<Retained<'static>>>> = None;
    #[cfg(feature = "link")]
    static mut SNIPPET: [i32; MOST_CODES] = [0; MOST_CODES];
    static mut FRAMES: [Frame; BLOCK_FRAMES] = [[0; 4]; BLOCK_FRAMES];
    static mut MEMORY: Memory<'static> = Memory::new();

    let Some(peripherals) = cortex_m::Peripherals::take() else { host::fail(c"started twice\n") };
    let Ok(config) = config_blob::station(blob()) else {
        host::fail(c"no valid configuration at 0x60000000\n")
    };
    let mut samples = Input::open().unwrap_or_else(|reason| host::fail(reason));
    let mut uart = Uart::telemetry();
    let mut clock = BoardClock::new(peripherals.SYST);
    let table = config_blob::section(blob(), PROPAGATION).ok();
    let Ok(mut recorder) = MEMORY.configure(&config, table) else {
        host::fail(c"this image holds no recorder for this configuration\n")
    };
    let mut board = Board::started();
    #[cfg(not(feature = "link"))]
    let summary = run(&mut recorder, &mut samples, &mut uart, &mut clock, &mut board, FRAMES);
    #[cfg(feature = "link")]
    let summary = {
        let (store, boot) = ByteStore::open(seabearing_firmware::mps2_an500::retained());
        let settings = Settings::serial(Uart::BAUD);
        let link = LINK.insert(Link::new(settings, config.id, boot, config.hash(), store));
        let recipient = Recipient { station: config.id, boot };
        let guard = host::key().map_or(Guard::open(), |key| Guard::keyed(key, recipient));
        let mut outlet = Reliable::new(&mut uart, link, guard).with_snippets(SNIPPET);
        run_over(&mut recorder, &mut samples, &mut outlet, &mut clock, &mut board, FRAMES)
    };
    uart.flush();
    if !host::leave_summary(&summary, stack::used(), samples.losses()) {
        host::fail(c"cannot write summary.bin\n");
    }
    match samples.ending() {
        Err(reason) => host::fail(reason),
        Ok(()) => host::exit(0),
    }
}

#[exception]
unsafe fn HardFault(_frame: &ExceptionFrame) -> ! {
    host::fail(c"hard fault\n")
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    seabearing_firmware::fault::record_and_reset(info)
}
