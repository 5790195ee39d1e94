//! The records a link has to bring over, kept until they are acknowledged.
//!
//! A *log* is what one store wrote since it was empty for the first time: it is named by the boot in which that was, its
//! records are numbered by class and, over all classes, by ordinal. A store that survives a reset goes on with its log.

use crate::message::Message;

/// Number of classes.
pub const CLASSES: usize = 5;
/// Longest record, in bytes.
pub const RECORD_BYTES: usize = 140;

/// What goes first when not everything can go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Class {
    /// Faults, and who speaks.
    Alarm = 0,
    /// End-of-passage tracks and segments.
    Final = 1,
    /// Counters, answers to commands.
    Health = 2,
    /// Bearings, azimuths, ranges, running tracks.
    Bearing = 3,
    /// Spectra and samples.
    Spectrum = 4,
}

impl Class {
    /// All, the most urgent first.
    pub const ALL: [Self; CLASSES] = [Self::Alarm, Self::Final, Self::Health, Self::Bearing, Self::Spectrum];

    /// The class of a recorder's message.
    pub fn of(message: &Message) -> Self {
        match message {
            Message::Hello(_) | Message::Fault(_) | Message::FaultsHeld(_) => Self::Alarm,
            Message::Track(track) if track.stage == 1 => Self::Final,
            Message::Segment(_) => Self::Final,
            Message::Health(_) | Message::Time(_) | Message::Reply(_) | Message::End(_) => Self::Health,
            Message::Bearing(_)
            | Message::Track(_)
            | Message::Azimuth(_)
            | Message::Range(_)
            | Message::ShaftRate(_) => Self::Bearing,
        }
    }

    pub(super) fn from_number(n: u8) -> Option<Self> {
        Self::ALL.get(usize::from(n)).copied()
    }
}

/// One number of each class.
pub type PerClass = [u32; CLASSES];

/// What a log has come to. Numbers wrap, and are compared by windows ([`super::ahead`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ledger {
    /// Boot in which the log was begun; `None` before.
    pub log: Option<u32>,
    /// Ordinal of the next record.
    pub ordinal: u32,
    /// Number of the next record of each class.
    pub next: PerClass,
    /// Number of the oldest record kept; the next one's where none is.
    pub oldest: PerClass,
    /// Records that were dropped unacknowledged because the store was full.
    pub lost: PerClass,
}

impl Ledger {
    /// Takes note of a record of a class written: its number and ordinal.
    pub fn written(&mut self, class: Class) -> (u32, u32) {
        let at = (self.next.get(class as usize).copied().unwrap_or(0), self.ordinal);
        if let Some(next) = self.next.get_mut(class as usize) {
            *next = next.wrapping_add(1);
        }
        self.ordinal = self.ordinal.wrapping_add(1);
        at
    }

    /// Records of a class kept.
    pub fn kept(&self, class: Class) -> u32 {
        match (self.next.get(class as usize), self.oldest.get(class as usize)) {
            (Some(next), Some(oldest)) => next.wrapping_sub(*oldest),
            _ => 0,
        }
    }

    /// Takes note that the oldest `count` of a class are not kept any more, `lost` of them unacknowledged.
    pub fn dropped(&mut self, class: Class, count: u32, lost: u32) {
        let count = count.min(self.kept(class));
        if let Some(oldest) = self.oldest.get_mut(class as usize) {
            *oldest = oldest.wrapping_add(count);
        }
        if let Some(n) = self.lost.get_mut(class as usize) {
            *n = n.saturating_add(lost);
        }
    }
}

/// A record as it is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kept {
    /// Its place among the records of all classes.
    pub ordinal: u32,
    /// Boot in which it was written.
    pub boot: u32,
    /// Its length.
    pub bytes: usize,
}

/// Keeps records of all classes, each class first in, first out.
pub trait Store {
    /// What the log has come to.
    fn ledger(&self) -> &Ledger;

    /// Begins the log, of a store that never had one.
    fn begin(&mut self, log: u32);

    /// Writes a record of at most [`RECORD_BYTES`]; `false`, and nothing done, where there is no room.
    fn append(&mut self, class: Class, boot: u32, record: &[u8]) -> bool;

    /// Gives a number to a record that is not kept: a loss. None of its class is kept then.
    fn pass(&mut self, class: Class);

    /// Drops the oldest `count` records of a class, `lost` of them unacknowledged.
    fn drop_oldest(&mut self, class: Class, count: u32, lost: u32);

    /// Copies a record that is kept, as far as `into` is long.
    fn read(&self, class: Class, number: u32, into: &mut [u8]) -> Option<Kept>;
}

/// Bytes before each record: length, class, ordinal, boot.
const HEAD: usize = 10;

/// Records in memory, one after the other as they were written.
#[derive(Clone, Debug)]
pub struct MemoryStore<const BYTES: usize> {
    ledger: Ledger,
    used: usize,
    bytes: [u8; BYTES],
}

impl<const BYTES: usize> MemoryStore<BYTES> {
    /// An empty store.
    pub const fn new() -> Self {
        let none = [0; CLASSES];
        Self {
            ledger: Ledger { log: None, ordinal: 0, next: none, oldest: none, lost: none },
            used: 0,
            bytes: [0; BYTES],
        }
    }

    /// The records kept, in the order of writing: class, head, and where the bytes begin.
    fn records(&self) -> impl Iterator<Item = (u8, Kept, usize)> + '_ {
        let mut at = 0;
        core::iter::from_fn(move || {
            let head = self.bytes.get(..self.used)?.get(at..)?.first_chunk::<HEAD>()?;
            let [length, class, ordinal @ .., b0, b1, b2, b3] = *head;
            let bytes = usize::from(length);
            let begin = at + HEAD;
            at = begin + bytes;
            let kept = Kept {
                ordinal: u32::from_le_bytes(ordinal),
                boot: u32::from_le_bytes([b0, b1, b2, b3]),
                bytes,
            };
            Some((class, kept, begin))
        })
    }
}

impl<const BYTES: usize> Default for MemoryStore<BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const BYTES: usize> Store for MemoryStore<BYTES> {
    fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    fn begin(&mut self, log: u32) {
        self.ledger.log = Some(log);
    }

    fn append(&mut self, class: Class, boot: u32, record: &[u8]) -> bool {
        let Some(free) = self.bytes.get_mut(self.used..) else { return false };
        if record.len() > RECORD_BYTES || free.len() < HEAD + record.len() {
            return false;
        }
        let (_, ordinal) = self.ledger.written(class);
        let [o0, o1, o2, o3] = ordinal.to_le_bytes();
        let [b0, b1, b2, b3] = boot.to_le_bytes();
        let head = [record.len() as u8, class as u8, o0, o1, o2, o3, b0, b1, b2, b3];
        for (to, from) in free.iter_mut().zip(head.iter().chain(record)) {
            *to = *from;
        }
        self.used += HEAD + record.len();
        true
    }

    fn pass(&mut self, class: Class) {
        self.ledger.written(class);
        self.ledger.dropped(class, 1, 1);
    }

    fn drop_oldest(&mut self, class: Class, count: u32, lost: u32) {
        let mut left = count.min(self.ledger.kept(class));
        self.ledger.dropped(class, left, lost);
        let (mut read, mut write) = (0, 0);
        while read < self.used {
            let head = self.bytes.get(read..).and_then(<[u8]>::first_chunk::<2>);
            let Some(&[length, of]) = head else { break };
            let record = HEAD + usize::from(length);
            if left > 0 && of == class as u8 {
                left -= 1;
            } else {
                // What is kept moves down; nothing did before the first that went.
                if write < read {
                    for i in 0..record {
                        let byte = self.bytes.get(read + i).copied().unwrap_or(0);
                        if let Some(to) = self.bytes.get_mut(write + i) {
                            *to = byte;
                        }
                    }
                }
                write += record;
            }
            read += record;
        }
        self.used = write;
    }

    fn read(&self, class: Class, number: u32, into: &mut [u8]) -> Option<Kept> {
        let oldest = self.ledger.oldest.get(class as usize)?;
        let place = number.wrapping_sub(*oldest);
        if place >= self.ledger.kept(class) {
            return None;
        }
        let (_, kept, begin) = self.records().filter(|r| r.0 == class as u8).nth(place as usize)?;
        let from = self.bytes.get(begin..begin + kept.bytes)?;
        for (to, from) in into.iter_mut().zip(from) {
            *to = *from;
        }
        Some(kept)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_dropped_leaves_room_and_the_rest_stays_as_it_was() {
        let mut store = MemoryStore::<60>::new();
        assert!(store.append(Class::Bearing, 3, b"first bearing"));
        assert!(store.append(Class::Alarm, 3, b"alarm"));
        assert!(store.append(Class::Bearing, 4, b"b2"));
        assert!(!store.append(Class::Bearing, 4, b"no room"));
        store.drop_oldest(Class::Bearing, 1, 1);
        assert!(store.append(Class::Bearing, 4, b"b3, longer"));
        let mut bytes = [0; 16];
        let read = |class, number, bytes: &mut [u8]| store.read(class, number, bytes);
        assert_eq!(read(Class::Alarm, 0, &mut bytes), Some(Kept { ordinal: 1, boot: 3, bytes: 5 }));
        assert_eq!(&bytes[..5], b"alarm");
        assert_eq!(read(Class::Bearing, 0, &mut bytes), None);
        assert_eq!(read(Class::Bearing, 2, &mut bytes), Some(Kept { ordinal: 3, boot: 4, bytes: 10 }));
        assert_eq!(&bytes[..10], b"b3, longer");
        assert_eq!(read(Class::Bearing, 3, &mut bytes), None);
        assert_eq!(store.ledger().lost, [0, 0, 0, 1, 0]);
    }

    #[test]
    fn numbers_go_on_over_their_wrap() {
        let mut store = MemoryStore::<200>::new();
        store.ledger.next[0] = u32::MAX;
        store.ledger.oldest[0] = u32::MAX;
        for text in [b"a", b"b", b"c"] {
            assert!(store.append(Class::Alarm, 0, text));
        }
        let mut byte = [0];
        assert!(store.read(Class::Alarm, 1, &mut byte).is_some() && byte == *b"c");
        store.drop_oldest(Class::Alarm, 2, 0);
        assert!(store.read(Class::Alarm, 0, &mut byte).is_none());
        assert!(store.read(Class::Alarm, 1, &mut byte).is_some() && byte == *b"c");
        store.drop_oldest(Class::Alarm, 9, 0);
        store.pass(Class::Alarm);
        assert_eq!((store.ledger.kept(Class::Alarm), store.ledger.next[0], store.ledger.lost[0]), (0, 3, 1));
    }
}
