//! The reliable link: records of a bounded store reach the other end exactly once, whatever the line does.
//!
//! [`Link`] is one state machine for both ends, without clock, allocation or panic. Enters: records ([`Link::offer`]),
//! bytes of the line ([`Link::receive`]), the time in microseconds. Leaves: frames for the line ([`Link::send`]), and what
//! came ([`Inbox`]). A recorder offers messages and takes commands, a base station the other way round. Records keep their
//! order within a class, and each carries its ordinal over all classes. `docs/wire.md`, section 5, specifies every byte.

mod budget;
pub mod flash;
mod incoming;
mod memory;
mod outgoing;
mod packet;
mod receiving;
mod sending;
mod store;

#[cfg(test)]
mod tests;

pub use memory::{ByteStore, Memory, MemoryStore, Retained, State};
pub use packet::LINK_VERSION;
pub use receiving::Progress;
pub use store::{CLASSES, Class, Kept, Ledger, PerClass, RECORD_BYTES, Store};

use crate::frame::{Decoder, DecoderCounters, Encoder, FRAME_BYTES};
use budget::Budget;
use sending::Sending;

/// A frame this many frames older than one that was heard is taken for lost, not for overtaken.
const OVERTAKE: i16 = 4;
/// Data packets that are acknowledged together, and that a half-duplex end sends in its turn.
const TOGETHER: u8 = 12;
/// Answers in a row after which a peer that did not give them is gone: some 5 s.
const GONE: u8 = 5;
/// Time a peer takes to answer, besides its line's.
const THINK_US: u64 = 20_000;

/// Whether `a` is a later number than `b`: numbers wrap, and half of them are later.
pub fn ahead(a: u32, b: u32) -> bool {
    (1..=1 << 31).contains(&a.wrapping_sub(b))
}

/// Who speaks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Session {
    /// Number of the station; of a base station 0.
    pub station: u16,
    /// Boot in which the log was begun.
    pub log: u32,
    /// Boot now, counted by the board.
    pub boot: u32,
    /// Identifies the configuration.
    pub config_hash: u64,
}

impl Session {
    /// The log's name in packets: 15 bits of a hash, and bit 0 set.
    pub fn tag(&self) -> u16 {
        let [s0, s1] = self.station.to_le_bytes();
        let [l0, l1, l2, l3] = self.log.to_le_bytes();
        // The last byte decides the lowest bits: two logs begun one after the other never have the same tag.
        ((crate::hash::fnv1a(&[s0, s1, l3, l2, l1, l0]) << 1) | 1) as u16
    }
}

/// The line and how to use it.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Bytes a second of the line: a tenth of its bits a second where it is serial.
    pub bytes_per_second: u32,
    /// Longest time a byte takes besides its sending, microseconds.
    pub delay_us: u32,
    /// Only one end may speak at a time.
    pub half_duplex: bool,
    /// This end begins, and asks whether the other is there (the recorder); the other says nothing until it has heard it,
    /// and of a half-duplex line only answers.
    pub leads: bool,
    /// Seconds without anything to send until the peer is asked whether it is there.
    pub keepalive_s: u16,
    /// Most bytes that may be sent in any hour.
    pub bytes_an_hour: Option<u32>,
}

impl Settings {
    /// A serial line of so many bits a second, full duplex, without a budget.
    pub const fn serial(baud: u32) -> Self {
        Self {
            bytes_per_second: baud / 10,
            delay_us: 100_000,
            half_duplex: false,
            leads: true,
            keepalive_s: 60,
            bytes_an_hour: None,
        }
    }
}

/// What came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival<'a> {
    /// The peer says who it is.
    Opened(Session),
    /// A record that had not come before.
    Record(Record<'a>),
    /// Records that will never come.
    Lost(Loss),
    /// The message of a frame without a link: of an old recorder, or a command of an old base station.
    Plain {
        /// Sequence number of the frame.
        sequence: u16,
        /// Its bytes.
        message: &'a [u8],
    },
}

/// A record of the peer's log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Its class.
    pub class: Class,
    /// Its number in its class.
    pub number: u32,
    /// Its place among the records of all classes.
    pub ordinal: u32,
    /// Boot in which it was written.
    pub boot: u32,
    /// What was offered.
    pub bytes: &'a [u8],
}

/// Records lost, and why: the sender's store was full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loss {
    /// Their class.
    pub class: Class,
    /// They are among the numbers from this one on
    pub first: u32,
    /// and before this one.
    pub end: u32,
    /// How many.
    pub count: u32,
    /// How many of the class the sender has dropped unacknowledged in all; more than this end misses where their
    /// acknowledgement was on its way.
    pub told: u32,
}

/// Where the receiving side leaves what comes. What was taken counts as received from the next [`Link::send`] on: until
/// then it must be where it survives.
pub trait Inbox {
    /// What has come of this log before; `None` if it was never heard of.
    fn recall(&mut self, session: &Session) -> Option<Progress>;

    /// Takes what came.
    fn take(&mut self, arrival: Arrival<'_>);
}

/// The log that the peer sends.
#[derive(Clone, Copy, Debug)]
struct Peer {
    session: Session,
    tag: u16,
    progress: Progress,
    /// The first records of it that this end might ask for.
    first: PerClass,
    /// Newest frame of it.
    heard: u16,
}

/// What this end owes the peer.
#[derive(Clone, Copy, Debug, Default)]
struct Debts {
    /// Data packets not acknowledged yet.
    packets: u8,
    /// When the acknowledgement is due.
    ack_at: Option<u64>,
    /// A tag that nobody knows.
    ask: Option<u16>,
}

/// One end of a link.
#[derive(Clone, Debug)]
pub struct Link<S> {
    settings: Settings,
    session: Session,
    store: S,
    sending: Sending,
    budget: Budget,
    encoder: Encoder,
    decoder: Decoder,
    peer: Option<Peer>,
    debts: Debts,
    /// The peer knows this end's log.
    opened: bool,
    /// When the opening may go again.
    open_at: u64,
    /// When the line has sent what it was given.
    free_at: u64,
    /// When an answer is overdue.
    overdue_at: Option<u64>,
    /// Times in a row that none came.
    unanswered: u8,
    /// This end may speak; of full-duplex lines always.
    turn: bool,
    /// Packets sent in this turn.
    in_turn: u8,
    last_sent: u64,
    /// A packet has come: the other end has a link, too.
    met: bool,
    /// Openings in a row of an earlier log.
    earlier: u8,
    /// Records refused because they are too long or empty.
    refused: u32,
    /// Classes of which nothing is acknowledged for good.
    withholds: [bool; CLASSES],
}

impl<S: Store> Link<S> {
    /// An end that has just started in this boot, with what its store kept.
    pub fn new(settings: Settings, station: u16, boot: u32, config_hash: u64, mut store: S) -> Self {
        let log = store.ledger().log.unwrap_or(boot);
        if store.ledger().log.is_none() {
            store.begin(boot);
        }
        Self {
            settings,
            session: Session { station, log, boot, config_hash },
            sending: Sending::new(store.ledger()),
            store,
            budget: Budget::new(settings.bytes_an_hour),
            encoder: Encoder::default(),
            decoder: Decoder::default(),
            peer: None,
            debts: Debts::default(),
            opened: false,
            open_at: 0,
            free_at: 0,
            overdue_at: None,
            unanswered: 0,
            turn: !settings.half_duplex || settings.leads,
            in_turn: 0,
            last_sent: 0,
            met: false,
            earlier: 0,
            refused: 0,
            withholds: [false; CLASSES],
        }
    }

    /// Takes another line, and begins a log of this name where none was written yet.
    pub fn begin(&mut self, settings: Settings, boot: u32) {
        (self.settings, self.budget) = (settings, Budget::new(settings.bytes_an_hour));
        if self.store.ledger().ordinal == 0 {
            self.store.begin(boot);
            (self.session.log, self.session.boot) = (boot, boot);
        }
        self.reconnected();
    }

    /// Who this end is.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// The store, to look at.
    pub fn store(&self) -> &S {
        &self.store
    }

    /// The store, to begin again with.
    pub fn into_store(self) -> S {
        self.store
    }

    /// What has come of which log of the peer.
    pub fn peer(&self) -> Option<(Session, Progress)> {
        self.peer.map(|p| (p.session, p.progress))
    }

    /// Goes on with a log of the peer of which so much has come, as if it had just opened it.
    pub fn resume(&mut self, session: Session, progress: Progress) {
        self.peer = Some(Peer { session, tag: session.tag(), progress, first: progress.next, heard: 0 });
    }

    /// From now on this end takes no record of these classes from the peer for good: it reads what comes, at most as many of a
    /// class as may be on their way, and leaves them in the peer's store for another that keeps them.
    pub fn withhold(&mut self, of: [bool; CLASSES]) {
        self.withholds = of;
    }

    /// Whether the peer knows this end's log and answers.
    pub fn up(&self) -> bool {
        self.opened && self.unanswered == 0
    }

    /// Whether the peer has answered before, and has not failed to so often since that it is taken for gone: one answer may be
    /// late where the peer is busy.
    pub fn reachable(&self) -> bool {
        self.opened && self.unanswered < GONE
    }

    /// Records not acknowledged yet.
    pub fn waiting(&self) -> u32 {
        Class::ALL.iter().map(|c| self.store.ledger().kept(*c)).sum()
    }

    /// What the frames received say about the line.
    pub fn line(&self) -> DecoderCounters {
        self.decoder.counters()
    }

    /// The decoder of the frames received, for the messages of an end without a link.
    pub fn decoder(&mut self) -> &mut Decoder {
        &mut self.decoder
    }

    /// Takes a record of at most [`RECORD_BYTES`]. Where the store is full, the oldest of the least urgent class goes for
    /// it, or it goes itself if it is the least urgent; both are counted in the ledger, and told to the peer.
    pub fn offer(&mut self, class: Class, record: &[u8]) {
        if record.is_empty() || record.len() > RECORD_BYTES {
            self.refused = self.refused.saturating_add(1);
            return;
        }
        while !self.store.append(class, self.session.boot, record) {
            match self.store.ledger().least_kept() {
                Some(least) if least >= class => {
                    let lost = u32::from(!self.sending.oldest_acked(least));
                    self.store.drop_oldest(least, 1, lost);
                }
                _ => {
                    self.store.pass(class);
                    break;
                }
            }
            self.sending.follow(self.store.ledger());
        }
        self.sending.follow(self.store.ledger());
    }

    /// Records refused because they were empty or too long, which no message is.
    pub fn refused(&self) -> u32 {
        self.refused
    }

    /// The line begins anew: bytes of an unfinished frame are damage, and a peer may have changed.
    pub fn reconnected(&mut self) {
        self.decoder.cut();
        self.overdue_at = None;
        self.unanswered = 0;
        self.opened = false;
        self.open_at = 0;
        self.sending.give_up();
        self.turn = !self.settings.half_duplex || self.settings.leads;
        self.debts = Debts::default();
        self.met = false;
    }
}
