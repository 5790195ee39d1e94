//! The records a link has to bring over, kept until they are acknowledged.
//!
//! A *log* is what one store wrote since it was empty for the first time: it is named by the boot in which that was, its
//! records are numbered by class and, over all classes, by ordinal. A store that survives a reset goes on with its log.

use crate::message::{Message, Track};

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
    /// Spectra, azigrams and samples.
    Spectrum = 4,
}

impl Class {
    /// All, the most urgent first.
    pub const ALL: [Self; CLASSES] = [Self::Alarm, Self::Final, Self::Health, Self::Bearing, Self::Spectrum];

    /// The class of a recorder's message.
    pub fn of(message: &Message) -> Self {
        match message {
            Message::Hello(_) | Message::Fault(_) | Message::FaultsHeld(_) => Self::Alarm,
            Message::Track(track) if track.stage != Track::RUNNING => Self::Final,
            Message::Segment(_) => Self::Final,
            Message::Health(_)
            | Message::Margins(_)
            | Message::Time(_)
            | Message::Reply(_)
            | Message::End(_) => Self::Health,
            // What says that samples come must not go for them.
            Message::Snippet(_) => Self::Health,
            Message::Samples(_) | Message::Spectrum(_) | Message::Azigram(_) => Self::Spectrum,
            Message::Bearing(_)
            | Message::Track(_)
            | Message::Azimuth(_)
            | Message::Range(_)
            | Message::ShaftRate(_)
            | Message::Transient(_) => Self::Bearing,
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

    /// The least urgent class of which a record is kept. Every class is looked at, in a function that is compiled here: a search that ends at the
    /// first one is, where a caller of LLVM 22 is optimised at level 1 for x86-64, taken for one that always ends at the last class
    /// (its comparisons are merged, which forgets where they end), and a full store then waits for room for ever.
    pub fn least_kept(&self) -> Option<Class> {
        Class::ALL
            .into_iter()
            .fold(None, |least, class| if self.kept(class) > 0 { Some(class) } else { least })
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

    /// Copies a record that is kept, as far as `into` is long; `None` too where it cannot be read yet.
    fn read(&self, class: Class, number: u32, into: &mut [u8]) -> Option<Kept>;

    /// How many records of the usual length fill half of it, about.
    fn half(&self) -> u32;

    /// Does what is due: called whenever the link may send.
    fn work(&mut self) {}
}

/// A store that stands elsewhere.
impl<S: Store> Store for &mut S {
    fn ledger(&self) -> &Ledger {
        (**self).ledger()
    }

    fn begin(&mut self, log: u32) {
        (**self).begin(log);
    }

    fn append(&mut self, class: Class, boot: u32, record: &[u8]) -> bool {
        (**self).append(class, boot, record)
    }

    fn pass(&mut self, class: Class) {
        (**self).pass(class);
    }

    fn drop_oldest(&mut self, class: Class, count: u32, lost: u32) {
        (**self).drop_oldest(class, count, lost);
    }

    fn read(&self, class: Class, number: u32, into: &mut [u8]) -> Option<Kept> {
        (**self).read(class, number, into)
    }

    fn half(&self) -> u32 {
        (**self).half()
    }

    fn work(&mut self) {
        (**self).work();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_urgent_class_kept_is_found_wherever_it_is() {
        let mut ledger = Ledger::default();
        assert_eq!(ledger.least_kept(), None);
        for class in Class::ALL {
            ledger.written(class);
            assert_eq!(ledger.least_kept(), Some(class));
        }
        for (class, next) in Class::ALL.into_iter().rev().zip(Class::ALL.into_iter().rev().skip(1)) {
            ledger.dropped(class, 1, 0);
            assert_eq!(ledger.least_kept(), Some(next));
        }
    }
}
