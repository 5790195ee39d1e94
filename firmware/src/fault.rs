//! What is kept across the reset that follows a panic or a fault of the processor, and how often the software started.
//!
//! The records stand in memory that start-up code does not touch. Error correction of that memory writes whole double words
//! late, and a reset forgets the last one: every record ends with a word that may be forgotten.

use seabearing_core::wire::FaultCode;

/// [`Record::processor`] of a panic, a fault of the processor, settings that changed, and wrong bits in memory.
const PANIC: u32 = 0;
const PROCESSOR: u32 = 1;
const SETTINGS: u32 = 2;
const MEMORY: u32 = 3;
/// The bit of [`FaultCode::MemoryError`]'s number which says that the bits could not be corrected.
const NOT_CORRECTED: i64 = 1 << 40;
/// The number of [`FaultCode::BadConfiguration`] that says so: the recorder has started again, and runs.
const CHANGED: i64 = 3;

/// Marks a record as written (power-on memory is random).
const MAGIC: u32 = 0x5ea_b0a7;

/// Why the software ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(8))]
pub struct Record {
    magic: u32,
    /// Of a panic the line in the source file; of a fault of the processor the program counter.
    pub place: u32,
    /// Of a panic the file (FNV-1a of its path, low 32 bits); of a fault its status.
    pub detail: u32,
    /// Whose doing: 0 a panic's, 1 the processor's, 2 that of settings which had changed in memory, 3 the memory's.
    pub processor: u32,
    check: u32,
    _may_be_lost: [u32; 3],
}

impl Record {
    fn new(place: u32, detail: u32, processor: u32) -> Self {
        let check = check([place, detail, processor]);
        Self { magic: MAGIC, place, detail, processor, check, _may_be_lost: [0; 3] }
    }

    /// The record of a panic at a place in the source.
    pub fn panic(file: &str, line: u32) -> Self {
        Self::new(line, seabearing_core::wire::hash::fnv1a(file.as_bytes()) as u32, PANIC)
    }

    /// The record of a fault of the processor: the program counter and the configurable fault status register.
    pub fn processor(pc: u32, status: u32) -> Self {
        Self::new(pc, status, PROCESSOR)
    }

    /// Settings or calibration had changed in memory.
    pub fn settings() -> Self {
        Self::new(0, 0, SETTINGS)
    }

    /// At this place in the memory of this number more bits were wrong than can be corrected.
    pub fn memory(place: u32, memory: u32) -> Self {
        Self::new(place, memory, MEMORY)
    }

    /// Nothing recorded.
    pub const fn none() -> Self {
        Self { magic: 0, place: 0, detail: 0, processor: 0, check: 0, _may_be_lost: [0; 3] }
    }

    /// The record as telemetry carries it: low 32 bits the place, above them 31 bits of the detail.
    pub fn told(self) -> (FaultCode, i64) {
        let (code, detail) = match self.processor {
            SETTINGS => return (FaultCode::BadConfiguration, CHANGED),
            MEMORY => {
                let memory = i64::from(self.detail) << 32;
                return (FaultCode::MemoryError, NOT_CORRECTED | memory | i64::from(self.place));
            }
            PANIC => (FaultCode::Panicked, self.detail >> 1),
            _ => (FaultCode::HardFault, self.detail & 0x7fff_ffff),
        };
        (code, i64::from(detail) << 32 | i64::from(self.place))
    }

    /// The record if it is one: magic and check word right.
    pub fn valid(self) -> Option<Self> {
        let right = self.magic == MAGIC && self.check == check([self.place, self.detail, self.processor]);
        right.then_some(self)
    }
}

fn check(words: [u32; 3]) -> u32 {
    !words.into_iter().fold(MAGIC, |sum, word| sum.rotate_left(7) ^ word)
}

#[cfg(any(feature = "mps2-an500", feature = "stm32h743"))]
mod kept {
    #![allow(unsafe_code)]

    use super::Record;
    use crate::starts::Counts;
    use core::mem::MaybeUninit;

    #[unsafe(link_section = ".uninit.fault")]
    static mut FAULT: MaybeUninit<Record> = MaybeUninit::uninit();
    #[unsafe(link_section = ".uninit.counts")]
    static mut COUNTS: MaybeUninit<Record> = MaybeUninit::uninit();

    fn exchange(
        kept: *mut MaybeUninit<Record>,
        new: impl FnOnce(Option<Record>) -> Record,
    ) -> Option<Record> {
        // SAFETY: one core, no interrupt uses it but to end everything; every bit pattern is a `Record`.
        unsafe {
            let record = kept.cast::<Record>().read_volatile().valid();
            kept.cast::<Record>().write_volatile(new(record));
            cortex_m::asm::dsb();
            record
        }
    }

    /// Takes the record of what had ended the software before this start, if there is one.
    pub fn take() -> Option<Record> {
        exchange(&raw mut FAULT, |_| Record::none())
    }

    /// Keeps the record and starts again.
    pub fn keep_and_reset(record: Record) -> ! {
        exchange(&raw mut FAULT, |_| record);
        cortex_m::peripheral::SCB::sys_reset()
    }

    /// What was counted before this start; nothing where power was off.
    pub fn counts() -> Counts {
        let kept = exchange(&raw mut COUNTS, |_| Record::none());
        kept.map_or(Counts::default(), |kept| Counts {
            starts: kept.place,
            failures: kept.detail,
            phase: kept.processor.into(),
        })
    }

    /// Keeps counts over the next reset.
    pub fn keep_counts(counts: Counts) {
        exchange(&raw mut COUNTS, |_| Record::new(counts.starts, counts.failures, counts.phase as u32));
    }

    /// Keeps the record of a panic and starts again.
    pub fn record_and_reset(info: &core::panic::PanicInfo<'_>) -> ! {
        keep_and_reset(info.location().map_or(Record::panic("?", 0), |l| Record::panic(l.file(), l.line())))
    }
}

#[cfg(any(feature = "mps2-an500", feature = "stm32h743"))]
pub use kept::{counts, keep_and_reset, keep_counts, record_and_reset, take};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_record_counts() {
        let record = Record::panic("core/src/run.rs", 77);
        assert_eq!(record.valid().map(|r| r.place), Some(77));
        assert_eq!((record.told().0, record.told().1 as u32), (FaultCode::Panicked, 77));
        assert_eq!(Record { place: 78, ..record }.valid(), None);
        assert_eq!(Record { processor: 1, ..record }.valid(), None);
        assert_eq!(Record::none().valid(), None);
        // The last double word may be lost.
        assert!(Record { _may_be_lost: [9; 3], ..record }.valid().is_some());
        let fault = Record::processor(0x0800_1234, 0x8200);
        assert_eq!(fault.valid().map(Record::told), Some((FaultCode::HardFault, 0x8200_0800_1234)));
        let memory = Record::memory(0x1238, 3).valid().map(Record::told);
        assert_eq!(memory, Some((FaultCode::MemoryError, 0x103_0000_1238)));
        assert_eq!(Record::settings().valid().map(Record::told), Some((FaultCode::BadConfiguration, 3)));
    }
}
