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
        let file = seabearing_core::config::fnv1a(file.as_bytes()) as u32;
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
