//! The host's loop over what the board's converter delivered.

use anyhow::{Result, anyhow};
use seabearing_board_model::ads131m04::Codes;
use seabearing_core::block::Frame;
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::port::{Chunk, Link, NoClock, SampleSource, Supervisor};
use seabearing_core::recorder::Memory;
use seabearing_core::run::{BLOCK_FRAMES, run};
use seabearing_core::wire::FaultCode;
use std::cell::RefCell;

/// What a run of the host has sent, and how much of it before the input's end.
#[derive(Default)]
struct Heard {
    bytes: Vec<u8>,
    at_end: Option<usize>,
}

struct Telemetry<'a>(&'a RefCell<Heard>);

impl Link for Telemetry<'_> {
    fn send(&mut self, frame: &[u8]) -> bool {
        self.0.borrow_mut().bytes.extend_from_slice(frame);
        true
    }
    fn receive(&mut self) -> Option<u8> {
        None
    }
}

/// Conversions with their numbers, from the first on.
struct Delivered<'a> {
    numbers: &'a [u64],
    codes: &'a [Codes],
    next: usize,
    heard: &'a RefCell<Heard>,
}

impl SampleSource for Delivered<'_> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let Some(first) = self.numbers.get(self.next) else {
            let mut heard = self.heard.borrow_mut();
            heard.at_end = Some(heard.bytes.len());
            return Chunk::End;
        };
        let mut count = 0;
        for slot in frames.iter_mut() {
            let at = self.next + count;
            if self.numbers.get(at) != Some(&(first + count as u64)) {
                break;
            }
            *slot = self.codes[at];
            count += 1;
        }
        self.next += count;
        Chunk::Frames { first_index: *first, count }
    }
}

/// A start for this reason.
struct Start(u8);

impl Supervisor for Start {
    fn feed(&mut self) {}
    fn idle(&mut self) {}
    fn reset_cause(&self) -> u8 {
        self.0
    }
    fn last_fault(&mut self) -> Option<(FaultCode, i64)> {
        None
    }
}

/// What the host's loop says of these conversions; what it says at their end only where the board was told to stop there.
///
/// # Errors
/// The configuration cannot be run.
pub fn host(
    blob: &[u8],
    reset_cause: u8,
    numbers: &[u64],
    codes: &[Codes],
    stopped: bool,
) -> Result<Vec<u8>> {
    let config = config_blob::station(blob).map_err(|e| anyhow!("configuration blob: {e:?}"))?;
    let table = config_blob::section(blob, PROPAGATION).ok();
    let mut memory: Box<Memory<'_>> = Box::default();
    let mut recorder = memory.configure(&config, table).map_err(|e| anyhow!("{}: {e}", config.name))?;
    let heard = RefCell::new(Heard::default());
    let mut source = Delivered { numbers, codes, next: 0, heard: &heard };
    let mut frames: [Frame; BLOCK_FRAMES] = [[0; 4]; BLOCK_FRAMES];
    let mut start = Start(reset_cause);
    run(&mut recorder, &mut source, &mut Telemetry(&heard), &mut NoClock, &mut start, &mut frames);
    let Heard { mut bytes, at_end } = heard.into_inner();
    if !stopped {
        bytes.truncate(at_end.unwrap_or(0));
    }
    Ok(bytes)
}
