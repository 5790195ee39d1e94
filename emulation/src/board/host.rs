//! The host's loop over what the board's converter delivered.

use anyhow::{Result, anyhow};
use seabearing_board_model::ads131m04::Codes;
use seabearing_core::block::Frame;
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::port::{Chunk, Link, Load, NoClock, SampleSource, Supervisor};
use seabearing_core::recorder::Memory;
use seabearing_core::run::{BLOCK_FRAMES, run};
use seabearing_core::wire::{FaultCode, Margins};
use seabearing_firmware::seismic::{Conversion, Seismic, chips};
use std::cell::RefCell;

/// What a run of the host has sent, and whether more is wanted.
struct Heard<'a> {
    bytes: Vec<u8>,
    wanted: &'a mut dyn FnMut(&[u8]) -> bool,
    goes_on: bool,
}

struct Telemetry<'a, 'w>(&'a RefCell<Heard<'w>>);

impl Link for Telemetry<'_, '_> {
    fn send(&mut self, frame: &[u8]) -> bool {
        let mut heard = self.0.borrow_mut();
        if heard.goes_on {
            heard.bytes.extend_from_slice(frame);
            heard.goes_on = (heard.wanted)(frame);
        }
        true
    }
    fn receive(&mut self) -> Option<u8> {
        None
    }
}

/// Conversions with their numbers, from the first on.
struct Delivered<'a, 'w> {
    numbers: &'a [u64],
    codes: &'a [Codes],
    /// Codes are words of seismic converters.
    words: bool,
    next: usize,
    stopped: bool,
    heard: &'a RefCell<Heard<'w>>,
}

impl SampleSource for Delivered<'_, '_> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let mut heard = self.heard.borrow_mut();
        let Some(first) = self.numbers.get(self.next).filter(|_| heard.goes_on) else {
            heard.goes_on &= self.stopped;
            return Chunk::End;
        };
        let mut count = 0;
        for slot in frames.iter_mut() {
            let at = self.next + count;
            if self.numbers.get(at) != Some(&(first + count as u64)) {
                break;
            }
            *slot = match self.words {
                true => chips::parse(self.codes[at].map(|word| word as u32)),
                false => self.codes[at],
            };
            count += 1;
        }
        self.next += count;
        Chunk::Frames { first_index: *first, count }
    }
}

/// A start for this reason, and what the board measured of itself: the host has none of its own.
struct Start<'a>(u8, std::slice::Iter<'a, Margins>);

impl Supervisor for Start<'_> {
    fn feed(&mut self) {}
    fn idle(&mut self) {}
    fn reset_cause(&self) -> u8 {
        self.0
    }
    fn last_fault(&mut self) -> Option<(FaultCode, i64)> {
        None
    }
    fn margins(&mut self, _: &Load) -> Option<Margins> {
        self.1.next().copied()
    }
}

/// What the host's loop says of these conversions, which of seismic converters are words and become samples here, with the
/// margins that a board has measured; what it says at their end only where the board was told to stop there.
/// It ends early where `wanted` says of a frame that no more is.
///
/// # Errors
/// The configuration cannot be run.
pub fn host(
    blob: &[u8],
    seismic: Option<Conversion>,
    (reset_cause, margins): (u8, &[Margins]),
    numbers: &[u64],
    codes: &[Codes],
    stopped: bool,
    wanted: &mut dyn FnMut(&[u8]) -> bool,
) -> Result<Vec<u8>> {
    let config = config_blob::station(blob).map_err(|e| anyhow!("configuration blob: {e:?}"))?;
    let table = config_blob::section(blob, PROPAGATION).ok();
    let mut memory: Box<Memory<'_>> = Box::default();
    let mut recorder = memory.configure(&config, table).map_err(|e| anyhow!("{}: {e}", config.name))?;
    let heard = RefCell::new(Heard { bytes: Vec::new(), wanted, goes_on: true });
    let words = seismic.is_some();
    let mut source = Delivered { numbers, codes, words, next: 0, stopped, heard: &heard };
    let mut frames: [Frame; BLOCK_FRAMES] = [[0; 4]; BLOCK_FRAMES];
    let (mut line, mut start) = (Telemetry(&heard), Start(reset_cause, margins.iter()));
    match seismic {
        Some(conversion) => {
            let mut source = Seismic::new(source, conversion);
            run(&mut recorder, &mut source, &mut line, &mut NoClock, &mut start, &mut frames)
        }
        None => run(&mut recorder, &mut source, &mut line, &mut NoClock, &mut start, &mut frames),
    };
    Ok(heard.into_inner().bytes)
}
