//! The recorder linked with a panic handler that cannot be linked: the link fails while any panic is reachable.
//!
//! Samples come from a register the optimiser knows nothing about and telemetry goes to another, so that no path is
//! optimised away. The image is linked, never run. With the feature `seeded-panic` one panic is reachable, and the
//! link must fail: that the check notices is checked too.
#![no_std]
#![no_main]
#![allow(unsafe_code)]

use core::panic::PanicInfo;
use cortex_m_rt::entry;
use seabearing_core::block::Frame;
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::outlet::Reliable;
use seabearing_core::port::{Chunk, Clock, Link, SampleSource, Supervisor};
use seabearing_core::recorder::{Memory, configuration};
use seabearing_core::run::{BLOCK_FRAMES, run, run_over};
use seabearing_core::sample_line::{self, Arrival, ByteSource};
use seabearing_core::sbraw::{ReadBytes, Reader};
use seabearing_core::slots::Slots;
use seabearing_core::snippet::MOST_CODES;
use seabearing_core::utc::Pair;
use seabearing_core::wait::wait;
use seabearing_core::wire::FaultCode;
use seabearing_core::wire::guard::{Guard, Recipient};
use seabearing_core::wire::link::flash::{FlashStore, Word};
use seabearing_core::wire::link::{ByteStore, Link as Reliably, Retained, Settings};
use seabearing_firmware::bank::{Bank, Controller, Part, Ring};
use seabearing_firmware::receiver::{Labels, Pulse};

/// A device register: whatever is read there, the optimiser cannot know.
const REGISTER: *mut u32 = 0x4000_0000 as *mut u32;

struct Device;

impl Device {
    fn word(&self) -> u32 {
        // SAFETY: this image is never run.
        unsafe { REGISTER.read_volatile() }
    }
}

impl ReadBytes for Device {
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        bytes.fill_with(|| self.word() as u8);
        self.word() as usize
    }
}

impl ByteSource for Device {
    fn next(&mut self) -> Arrival {
        match self.word() {
            0 => Arrival::Nothing,
            1 => Arrival::Closed,
            _ => Arrival::Byte(self.word() as u8),
        }
    }
}

/// Either source, as the optimiser cannot know.
struct Samples {
    file: Reader<Device>,
    line: sample_line::Reader<Device>,
    labels: Labels,
}

impl SampleSource for Samples {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        if Device.word() == 0 { self.file.read(frames) } else { self.line.read(frames) }
    }

    fn pair(&mut self) -> Option<Pair> {
        let word = || u64::from(Device.word()) << 32 | u64::from(Device.word());
        self.labels.pulse(Pulse { edge: word(), late_ns: Device.word().cast_signed(), at_us: word() });
        let (index, utc_us) = self.labels.byte(Device.word() as u8, word())?;
        Some(Pair { index, utc_us, sd_s: f64::from(Device.word()) })
    }
}

impl Link for Device {
    fn send(&mut self, frame: &[u8]) -> bool {
        for byte in frame {
            // SAFETY: this image is never run.
            unsafe { REGISTER.write_volatile(u32::from(*byte)) };
        }
        self.word() != 0
    }

    fn receive(&mut self) -> Option<u8> {
        (self.word() != 0).then(|| self.word() as u8)
    }
}

impl Controller for Device {
    fn read(&self, _: u32) -> Option<Word> {
        (self.word() != 0).then(|| [self.word() as u8; 32])
    }

    fn program(&mut self, word: u32, value: &Word) {
        self.send(value);
        self.send(&word.to_le_bytes());
    }

    fn erase(&mut self, sector: u8) {
        self.send(&[sector]);
    }

    fn works(&self) -> bool {
        self.word() != 0
    }
}

impl Clock for Device {
    fn ticks(&mut self) -> u32 {
        self.word()
    }

    fn seconds(&mut self) -> u32 {
        self.word()
    }
}

impl Supervisor for Device {
    fn feed(&mut self) {}

    fn idle(&mut self) {}

    fn reset_cause(&self) -> u8 {
        self.word() as u8
    }

    fn last_fault(&mut self) -> Option<(FaultCode, i64)> {
        (self.word() != 0).then(|| (FaultCode::Panicked, i64::from(self.word())))
    }
}

#[entry]
fn main() -> ! {
    static mut FRAMES: [Frame; BLOCK_FRAMES] = [[0; 4]; BLOCK_FRAMES];
    static mut MEMORY: Memory<'static> = Memory::new();
    static mut LINK: Option<Reliably<ByteStore<Retained<'static>>>> = None;
    static mut RECORDS: [u8; 6400] = [0; 6400];
    static mut RING: Ring = Ring::new();
    static mut SCRATCH: [u8; 4096] = [0; 4096];
    static mut SNIPPET: [i32; MOST_CODES] = [0; MOST_CODES];

    let mut line = Device;
    // SAFETY: this image is never run.
    let blob = unsafe { core::slice::from_raw_parts(0x6000_0000 as *const u8, 1 << 20) };
    if let Ok(config) = config_blob::station(blob) {
        let table = config_blob::section(blob, PROPAGATION).ok();
        if let Ok(mut recorder) = MEMORY.configure(&config, table) {
            let mut samples = Samples {
                file: Reader::new(Device),
                line: sample_line::Reader::new(Device),
                labels: Labels::default(),
            };
            run(&mut recorder, &mut samples, &mut Device, &mut Device, &mut Device, FRAMES);
            let settings = Settings {
                bytes_per_second: Device.word(),
                delay_us: Device.word(),
                half_duplex: Device.word() != 0,
                leads: Device.word() != 0,
                keepalive_s: Device.word() as u16,
                bytes_an_hour: (Device.word() != 0).then(|| Device.word()),
            };
            RECORDS.fill_with(|| Device.word() as u8);
            let (store, boot) = ByteStore::open(RECORDS);
            let link = LINK.insert(Reliably::new(settings, config.id, boot, config.hash(), store));
            let recipient = Recipient { station: config.id, boot };
            let guard = Guard::keyed([Device.word() as u8; 32], recipient);
            let mut outlet = Reliable::new(&mut line, link, guard).with_snippets(SNIPPET);
            run_over(&mut recorder, &mut samples, &mut outlet, &mut Device, &mut Device, FRAMES);
            wait(config.id, None, &mut outlet, &mut Device, &mut Device);
            let bank = Bank::new(Device, RING);
            let store = FlashStore::<_, 64>::open(Part::<_, 2, 6>::of(&bank));
            let boot = store.starts();
            let mut link = Reliably::new(settings, config.id, boot, config.hash(), store);
            let guard = Guard::keyed([Device.word() as u8; 32], Recipient { station: config.id, boot });
            let usable = |blob: &[u8]| configuration(blob, config.id).is_some();
            let mut slots = Slots::new(Part::<_, 0, 2>::of(&bank), SCRATCH, usable);
            slots.choose(&mut [0; 4096]);
            slots.give_up();
            let mut outlet = Reliable::with(&mut line, &mut link, guard, slots);
            run_over(&mut recorder, &mut samples, &mut outlet, &mut Device, &mut Device, FRAMES);
            wait(config.id, None, &mut outlet, &mut Device, &mut Device);
        }
    }
    #[cfg(feature = "seeded-panic")]
    {
        let at = Device.word() as usize;
        FRAMES[at][0] = 1;
        Device.send(&[FRAMES[at / 2][1] as u8]);
    }
    loop {
        Device.word();
    }
}

unsafe extern "C" {
    /// Defined nowhere.
    fn a_panic_is_reachable() -> !;
}

#[panic_handler]
fn panic(_info: &PanicInfo<'_>) -> ! {
    // SAFETY: cannot be linked.
    unsafe { a_panic_is_reachable() }
}
