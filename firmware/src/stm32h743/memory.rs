//! Wrong bits in memory. Every word of the processor's memories has seven or eight bits of error correction, and a monitor of each
//! memory tells what it found when a word was read (RM0433, "RAM ECC monitoring"; places and flags as in the maker's headers).
//!
//! One wrong bit in a word is put right as it is read: records stay right, and it is told, because a memory that fails now and
//! then will fail for good. More cannot be put right: what was worked out of that word may be wrong and look right, so the
//! recorder starts again and says why.

use super::clock;
use crate::fault::{self, Record};
use seabearing_core::wire::FaultCode;

/// The monitors of the memories that are used: AXI SRAM, tightly coupled for instructions and (two) for data, D2's SRAM 1 and
/// SRAM 2 (two each). Their place in this list is their number.
const MONITORS: [usize; 8] =
    [0x5200_9020, 0x5200_9040, 0x5200_9060, 0x5200_9080, 0x4802_3020, 0x4802_3040, 0x4802_3060, 0x4802_3080];
/// Words of a monitor: its configuration, what it found, and where.
const CONFIGURATION: usize = 0;
const FOUND: usize = 1;
const WHERE: usize = 2;
/// The configuration keeps the address of the first error.
const KEEP: u32 = 1 << 5;
/// More than one wrong bit, in a word that was read, or in one of which a part was written. Bit 0 is one, corrected.
const NOT_CORRECTED: u32 = 1 << 1 | 1 << 2;

/// From one look to the next, and at least from one corrected error told to the next: a cell that is broken is wrong at every
/// reading.
const LOOK_EVERY_US: u64 = 100_000;
const TELL_EVERY_US: u64 = 60_000_000;
/// The log's buffer is memory that nothing initialises: its first words are wrong by chance.
const LOGS: bool = cfg!(feature = "defmt");

fn register(monitor: usize, word: usize) -> *mut u32 {
    (monitor + 4 * word) as *mut u32
}

/// What could not be corrected and was not looked at yet: where the processor ends in a fault or a panic, that is the likelier cause.
/// `None` while nobody watches.
pub fn not_corrected() -> Option<Record> {
    // SAFETY: registers of a peripheral that nothing else uses.
    let read = |monitor, word| unsafe { register(monitor, word).read_volatile() };
    let wrong = |monitor: usize| {
        read(monitor, CONFIGURATION) & KEEP != 0 && read(monitor, FOUND) & NOT_CORRECTED != 0
    };
    let (memory, monitor) = (0..).zip(MONITORS).find(|(_, monitor)| !LOGS && wrong(*monitor))?;
    Some(Record::memory(read(monitor, WHERE), memory))
}

/// What the monitors tell.
#[derive(Debug)]
pub struct Errors {
    due_us: u64,
    tell_us: u64,
    found: Option<(FaultCode, i64)>,
}

impl Errors {
    /// From now on; what was found before was memory that nobody had written since power came.
    pub fn watch() -> Self {
        for monitor in MONITORS {
            // SAFETY: registers of a peripheral that nothing else uses.
            unsafe {
                register(monitor, CONFIGURATION).write_volatile(KEEP);
                register(monitor, FOUND).write_volatile(0);
            }
        }
        Self { due_us: 0, tell_us: 0, found: None }
    }

    /// Asks the monitors now and then. Where something could not be corrected a recorder that `records` starts again; one that waits
    /// tells it: a cell that is broken must not keep it from being reached.
    pub fn look(&mut self, records: bool) {
        let now_us = clock::now_us();
        if LOGS || now_us < self.due_us {
            return;
        }
        self.due_us = now_us + LOOK_EVERY_US;
        for (memory, monitor) in (0..).zip(MONITORS) {
            // SAFETY: as above.
            let (found, place) = unsafe {
                let found = register(monitor, FOUND).read_volatile();
                if found == 0 {
                    continue;
                }
                register(monitor, FOUND).write_volatile(0);
                (found, register(monitor, WHERE).read_volatile())
            };
            let record = Record::memory(place, memory);
            if found & NOT_CORRECTED != 0 && records {
                fault::keep_and_reset(record);
            }
            if now_us >= self.tell_us {
                self.tell_us = now_us + TELL_EVERY_US;
                let corrected = (FaultCode::MemoryError, i64::from(memory) << 32 | i64::from(place));
                self.found = Some(if found & NOT_CORRECTED != 0 { record.told() } else { corrected });
            }
        }
    }

    /// What was found and ended nothing, once.
    pub fn found(&mut self) -> Option<(FaultCode, i64)> {
        self.found.take()
    }
}
