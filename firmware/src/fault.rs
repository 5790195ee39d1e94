//! What is kept of a panic across the reset that follows it.
//!
//! The record stands in memory that start-up code does not touch. A panic writes it and resets; the next start takes
//! it, once, and reports it.

/// Marks a record as written (power-on memory is random).
const MAGIC: u32 = 0x5ea_b0a7;

/// Where a panic was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Record {
    magic: u32,
    /// Line in the source file.
    pub line: u32,
    /// Identifies the file: FNV-1a of its path, low 32 bits.
    pub file: u32,
    check: u32,
}

impl Record {
    /// The record of a panic at a place in the source.
    pub fn new(file: &str, line: u32) -> Self {
        let file = seabearing_core::wire::hash::fnv1a(file.as_bytes()) as u32;
        Self { magic: MAGIC, line, file, check: check(line, file) }
    }

    /// Nothing recorded.
    pub const fn none() -> Self {
        Self { magic: 0, line: 0, file: 0, check: 0 }
    }

    /// The record as telemetry carries it: low 32 bits the line, above them 31 bits of the file's hash.
    pub fn value(self) -> i64 {
        i64::from(self.file >> 1) << 32 | i64::from(self.line)
    }

    /// The record if it is one: magic and check word right.
    pub fn valid(self) -> Option<Self> {
        (self.magic == MAGIC && self.check == check(self.line, self.file)).then_some(self)
    }
}

fn check(line: u32, file: u32) -> u32 {
    !(MAGIC ^ line.rotate_left(7) ^ file.rotate_left(13))
}

#[cfg(any(feature = "mps2-an500", feature = "stm32h743"))]
mod kept {
    #![allow(unsafe_code)]

    use super::Record;
    use core::mem::MaybeUninit;

    #[unsafe(link_section = ".uninit.fault")]
    static mut FAULT: MaybeUninit<Record> = MaybeUninit::uninit();

    /// Takes the record of the panic before this start, if there was one.
    pub fn take() -> Option<Record> {
        let kept = &raw mut FAULT;
        // SAFETY: one core, no interrupt uses it; every bit pattern is a `Record`.
        unsafe {
            let record = kept.cast::<Record>().read_volatile();
            kept.cast::<Record>().write_volatile(Record::none());
            record.valid()
        }
    }

    /// Keeps the record of a panic and starts again.
    pub fn record_and_reset(info: &core::panic::PanicInfo<'_>) -> ! {
        let place = info.location();
        let record = place.map_or(Record::new("?", 0), |l| Record::new(l.file(), l.line()));
        let kept = &raw mut FAULT;
        // SAFETY: as in `take`; nothing runs after it.
        unsafe { kept.cast::<Record>().write_volatile(record) };
        cortex_m::peripheral::SCB::sys_reset()
    }
}

#[cfg(any(feature = "mps2-an500", feature = "stm32h743"))]
pub use kept::{record_and_reset, take};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_record_counts() {
        let record = Record::new("core/src/run.rs", 77);
        assert_eq!(record.valid().map(|r| r.line), Some(77));
        assert_eq!(record.value() as u32, 77);
        assert_eq!(Record { line: 78, ..record }.valid(), None);
        assert_eq!(Record::none().valid(), None);
    }
}
