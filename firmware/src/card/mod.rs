//! Sound on an SD card that never waits for the card, and never writes to its file system.
//!
//! A computer prepares the card (`seabearing card prepare`): files of fixed length, each in one piece, with nothing in
//! them. The recorder reads the file system to find the first that is unused ([`search`]), and from then on writes sectors
//! inside it ([`writer`]) by way of a driver that is only ever asked whether it is done ([`Drive`]). What a file holds
//! ([`layout`]) is an ordinary WAV file of 24 bits after every write.
//!
//! Order makes it safe: what says that a file is used is on the card before its sound; what says that samples are missing
//! is there before the samples after them; lengths are told after the sound they count. Power may be cut between any two
//! sectors, and in the middle of one.
//!
//! Where only clips about detections are kept ([`clips`]), files without a claim are filled again, one after the other.

pub mod clips;
pub mod fat;
pub mod layout;
pub mod search;
mod sheet;
pub mod source;
pub mod writer;

/// Bytes of a sector.
pub const SECTOR: usize = 512;
/// Bytes written at a time: sound of 21 ms at 64 kHz.
pub const PAGE: usize = 16_384;
/// Sectors of it.
pub const PAGE_SECTORS: u32 = (PAGE / SECTOR) as u32;

/// Why the card takes no sound, the number that goes with the fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Trouble {
    /// No card answers.
    NoCard = 1,
    /// No FAT32 file system on it, no file that `seabearing card prepare` has made, or a card of 2 GB or less.
    NotPrepared = 2,
    /// The card or the line to it makes errors.
    Errors = 3,
    /// The card was busy for longer than sound can wait.
    Stalled = 4,
}

/// What a driver is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// The card starts, or what was begun is not done.
    Working,
    /// Nothing is under way; all that was begun is done, and what was written is on the card.
    Rests,
    /// It failed; nothing more can be begun before [`Drive::restart`].
    Failed(Trouble),
}

/// A driver of a card that never waits.
pub trait Drive {
    /// Goes on with what is under way.
    fn poll(&mut self) -> Progress;

    /// Begins to write whole sectors from this one on; only while it rests. The bytes must stay until it rests again.
    fn begin_write(&mut self, sector: u32, bytes: &[u8]);

    /// Begins to read whole sectors; only while it rests. What stands in `into` counts once it rests again.
    fn begin_read(&mut self, sector: u32, into: &mut [u8]);

    /// Starts the card from the beginning, whatever was under way.
    fn restart(&mut self);

    /// Microseconds of the board's clock.
    fn now_us(&mut self) -> u64;
}
