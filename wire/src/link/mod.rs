//! The reliable link: records of a bounded store reach the other end exactly once, whatever the line does.
//!
//! [`Link`] is one state machine for both ends, without clock, allocation or panic. Enters: records ([`Link::offer`]),
//! bytes of the line ([`Link::receive`]), the time in microseconds. Leaves: frames for the line ([`Link::send`]), and what
//! came ([`Inbox`]). A recorder offers messages and takes commands, a base station the other way round. Records keep their
//! order within a class, and each carries its ordinal over all classes. `docs/wire.md`, section 5, specifies every byte.

mod budget;
mod packet;
mod receiving;
mod sending;
mod store;

#[cfg(test)]
mod tests;

pub use packet::LINK_VERSION;
pub use receiving::Progress;
pub use store::{CLASSES, Class, Kept, Ledger, MemoryStore, PerClass, RECORD_BYTES, Store};

use crate::frame::{Decoder, DecoderCounters, Encoder, FRAME_BYTES};
use budget::Budget;
use packet::{Packet, Parsed, Writer};
use receiving::Taken;
use sending::Sending;

/// A frame this many frames older than one that was heard is taken for lost, not for overtaken.
const OVERTAKE: i16 = 4;
/// Data packets that are acknowledged together, and that a half-duplex end sends in its turn.
const TOGETHER: u8 = 12;
/// Longest wait between two questions to a peer that does not answer, but for slow lines and small budgets.
const ASK_AGAIN_US: u64 = 3_000_000;
/// Longest packet for its line, seconds: on slow lines fewer records go together.
const PACKET_S: u64 = 2;
/// Time a peer takes to answer, besides its line's.
const THINK_US: u64 = 20_000;
/// Bytes on the line of an acknowledgement or of an opening, about.
const SMALL: usize = 60;

/// Openings of an earlier log in a row that are needed to believe it.
const EARLIER_LOGS: u8 = 3;

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
        self.peer = Some(Peer { session, tag: session.tag(), progress, heard: 0 });
    }

    /// Whether the peer knows this end's log and answers.
    pub fn up(&self) -> bool {
        self.opened && self.unanswered == 0
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
            let kept = |c: &&Class| self.store.ledger().kept(**c) > 0;
            match Class::ALL.iter().rev().find(kept) {
                Some(least) if *least >= class => {
                    let lost = u32::from(!self.sending.oldest_acked(*least));
                    self.store.drop_oldest(*least, 1, lost);
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

    /// Takes a byte of the line.
    pub fn receive(&mut self, now: u64, byte: u8, inbox: &mut impl Inbox) {
        let Some(sequence) = self.decoder.push_frame(byte) else { return };
        match packet::parse(self.decoder.message()) {
            Parsed::Plain => inbox.take(Arrival::Plain { sequence, message: self.decoder.message() }),
            Parsed::Unknown => self.decoder.unknown(),
            Parsed::Packet(Packet::Data { tag, boots, class, number, ordinal, records }, answer) => {
                let ack_delay = self.line_us(usize::from(TOGETHER / 2) * self.frame_bytes()) + THINK_US;
                match &mut self.peer {
                    Some(peer) if peer.tag == tag => {
                        peer.heard = sequence;
                        let boot = peer.session.log.wrapping_add(boots);
                        for (n, bytes) in (0u32..).zip(packet::records(records)) {
                            let number = number.wrapping_add(n);
                            if peer.progress.take(class as usize, number) == Taken::Fresh {
                                let ordinal = ordinal.wrapping_add(n);
                                inbox.take(Arrival::Record(Record { class, number, ordinal, boot, bytes }));
                            }
                        }
                        self.debts.packets = self.debts.packets.saturating_add(1);
                        let due = if self.debts.packets >= TOGETHER { now } else { now + ack_delay };
                        self.debts.ack_at = Some(self.debts.ack_at.unwrap_or(due).min(due));
                    }
                    _ => self.debts.ask = Some(tag),
                }
                self.heard(now, answer);
            }
            Parsed::Packet(Packet::Open { session, start, lost }, answer) => {
                self.open(sequence, session, &start, &lost, inbox);
                self.heard(now, answer);
            }
            Parsed::Packet(Packet::Ack { tag, heard, progress }, answer) => {
                if tag == self.session.tag() {
                    self.acknowledged(now, heard, &progress);
                }
                self.heard(now, answer);
            }
            Parsed::Packet(Packet::Ask { tag }, answer) => {
                // One who does not know this log, or one who asks for another that is not here any more.
                if tag == self.session.tag() || !self.opened {
                    self.opened = false;
                    self.open_at = now;
                    self.answered();
                }
                self.heard(now, answer);
            }
        }
    }

    /// The peer says who it is, and from where on it has records.
    fn open(
        &mut self,
        sequence: u16,
        session: Session,
        start: &PerClass,
        lost: &PerClass,
        inbox: &mut impl Inbox,
    ) {
        let known =
            self.peer.filter(|p| (p.session.station, p.session.log) == (session.station, session.log));
        if let Some(peer) = self.peer.filter(|p| known.is_none() && p.session.station == session.station)
            && ahead(peer.session.log, session.log)
        {
            // A late frame of a log before; or a board whose count of boots has begun again, which says so again.
            self.earlier = self.earlier.saturating_add(1);
            if self.earlier < EARLIER_LOGS {
                return;
            }
        }
        self.earlier = 0;
        let mut peer = known.unwrap_or_else(|| Peer {
            session,
            tag: session.tag(),
            // Of a log that was never heard of, what went before is not missed.
            progress: inbox.recall(&session).unwrap_or(Progress { next: *start, ..Progress::default() }),
            heard: sequence,
        });
        peer.heard = sequence;
        if known.is_none_or(|p| ahead(session.boot, p.session.boot)) {
            peer.session = session;
            inbox.take(Arrival::Opened(session));
        }
        for (class, (start, told)) in Class::ALL.into_iter().zip(start.iter().zip(lost)) {
            let first = peer.progress.next.get(class as usize).copied().unwrap_or(*start);
            let count = peer.progress.skip(class as usize, *start);
            if count > 0 {
                inbox.take(Arrival::Lost(Loss { class, first, end: *start, count, told: *told }));
            }
        }
        self.peer = Some(peer);
        self.debts.ack_at = Some(0);
    }

    fn acknowledged(&mut self, now: u64, heard: u16, progress: &Progress) {
        for class in Class::ALL {
            let ledger = self.store.ledger();
            if let Some(below) = self.sending.acknowledge(ledger, class, progress) {
                let oldest = ledger.oldest.get(class as usize).copied().unwrap_or(below);
                self.store.drop_oldest(class, below.wrapping_sub(oldest), 0);
            }
        }
        self.sending.follow(self.store.ledger());
        // A frame that was not sent yet is one of before a reset.
        if (self.encoder.sequence().wrapping_sub(heard) as i16) > 0 {
            self.sending.heard(heard, self.settings.half_duplex);
        }
        self.opened = true;
        self.answered();
        if self.sending.flying() {
            self.overdue_at = Some(now.max(self.free_at) + self.patience(true));
        }
    }

    /// The peer lives.
    fn answered(&mut self) {
        self.unanswered = 0;
        self.overdue_at = None;
    }

    /// A packet came, which gives the turn or not.
    fn heard(&mut self, now: u64, answer: bool) {
        self.met = true;
        if answer {
            // The peer listens now.
            if self.settings.half_duplex {
                (self.turn, self.in_turn) = (true, 0);
            }
            if !self.settings.leads || !self.settings.half_duplex {
                self.debts.ack_at = Some(now);
            }
        } else if self.settings.half_duplex && self.settings.leads && !self.turn {
            // It speaks on.
            self.overdue_at = Some(now + self.patience(true));
        }
    }

    /// The next frame, if one may be sent now. The caller puts all of it on the line.
    pub fn send(&mut self, now: u64) -> Option<&[u8]> {
        self.budget.spend(now, 0);
        if now < self.free_at {
            return None;
        }
        if self.overdue_at.is_some_and(|at| now >= at) {
            self.overdue_at = None;
            self.unanswered = self.unanswered.saturating_add(1);
            self.sending.give_up();
            if self.settings.leads {
                (self.turn, self.in_turn) = (true, 0);
            }
        }
        if !self.turn {
            return None;
        }
        let (mut writer, wants) = self.compose(now)?;
        let listen = if self.settings.half_duplex {
            // A follower's last word gives the turn back; the leader's asks for an answer.
            self.in_turn = self.in_turn.saturating_add(1);
            let more = self.debts.ack_at.is_some() || self.has_more(now);
            wants == Wants::Answer || self.in_turn >= TOGETHER || !more
        } else {
            wants == Wants::Answer || (wants == Wants::AnswerAtEnd && !self.has_more(now))
        };
        if listen {
            writer.want_answer();
        }
        let bytes = self.encoder.frame_of(writer.bytes()).len();
        self.budget.spend(now, bytes);
        self.free_at = now + self.line_us(bytes);
        self.last_sent = now;
        let expects = wants != Wants::Nothing || (listen && self.settings.half_duplex && self.settings.leads);
        if expects {
            let at = self.free_at + self.patience(!listen);
            self.overdue_at = Some(self.overdue_at.map_or(at, |earlier| earlier.min(at)));
        }
        if self.settings.half_duplex && listen {
            self.turn = false;
        }
        Some(self.encoder.last())
    }

    /// What to say now.
    fn compose(&mut self, now: u64) -> Option<(Writer, Wants)> {
        if let Some(tag) = self.debts.ask.take() {
            return Some((Writer::new(&Packet::Ask { tag }, false), Wants::Nothing));
        }
        if self.debts.ack_at.is_some_and(|at| now >= at || self.settings.half_duplex) {
            (self.debts.ack_at, self.debts.packets) = (None, 0);
            if let Some(peer) = &self.peer {
                let ack = Packet::Ack { tag: peer.tag, heard: peer.heard, progress: peer.progress };
                return Some((Writer::new(&ack, false), Wants::Nothing));
            }
        }
        // While the peer does not answer it is asked now and then, by few bytes.
        let asking = self.unanswered > 0 || !self.opened;
        let speaks = self.settings.leads || (self.met && self.waiting() > 0);
        if !speaks || (asking && self.overdue_at.is_some()) {
            return None;
        }
        let quiet = now.saturating_sub(self.last_sent) >= u64::from(self.settings.keepalive_s) * 1_000_000;
        // Where bytes are scarce, what was dropped is told when something else can go as well.
        let next = self.sending.first(self.store.ledger());
        let skip = self.sending.must_skip(self.store.ledger())
            && now >= self.open_at
            && next.is_none_or(|(class, _)| self.budget.allows(now, FRAME_BYTES + SMALL, class));
        if asking || quiet || skip {
            if !self.budget.allows(now, SMALL, Class::Alarm) {
                return None;
            }
            self.open_at = now + self.patience(false);
            let ledger = self.store.ledger();
            let open = Packet::Open { session: self.session, start: ledger.oldest, lost: ledger.lost };
            return Some((Writer::new(&open, false), Wants::Answer));
        }
        self.data(now).map(|writer| (writer, Wants::AnswerAtEnd))
    }

    /// A packet of the most urgent records.
    fn data(&mut self, now: u64) -> Option<Writer> {
        let ledger = *self.store.ledger();
        let (class, first) = self.sending.first(&ledger)?;
        if !self.budget.allows(now, FRAME_BYTES, class) {
            return None;
        }
        let head = self.store.read(class, first, &mut [])?;
        let boots = head.boot.wrapping_sub(self.session.log);
        let (tag, ordinal) = (self.session.tag(), head.ordinal);
        let packet = Packet::Data { tag, boots, class, number: first, ordinal, records: &[] };
        let mut writer = Writer::new(&packet, false);
        let most = self.frame_bytes();
        let mut n = 0u32;
        loop {
            let number = first.wrapping_add(n);
            if !self.sending.wants(&ledger, class, number) {
                break;
            }
            let used = writer.bytes().len();
            let room = writer.room();
            let Some(kept) = self.store.read(class, number, room) else { break };
            let follows = (kept.boot, kept.ordinal) == (head.boot, ordinal.wrapping_add(n));
            if kept.bytes > room.len() || !follows || (n > 0 && used + kept.bytes > most) {
                break;
            }
            writer.took(kept.bytes);
            self.sending.sent(class, number, self.encoder.sequence());
            n += 1;
        }
        (n > 0).then_some(writer)
    }

    /// Whether there are records that may go at once.
    fn has_more(&self, now: u64) -> bool {
        let may = |(class, _)| self.budget.allows(now, 2 * FRAME_BYTES, class);
        let asking = self.unanswered > 0 || !self.opened;
        let next = self.sending.first(self.store.ledger());
        next.is_some_and(may) && !(asking && self.overdue_at.is_some())
    }

    /// How long to wait for an answer; `full`: the peer was not asked for one, and takes its time.
    fn patience(&self, full: bool) -> u64 {
        let delay = 2 * u64::from(self.settings.delay_us) + 2 * THINK_US;
        // The peer may be in the middle of a frame of its own.
        let soon = delay + self.line_us(self.frame_bytes() + 2 * SMALL);
        let wait =
            if full { soon + self.line_us((usize::from(TOGETHER) + 3) * self.frame_bytes()) } else { soon };
        let most = ASK_AGAIN_US.max(2 * self.budget.earns(SMALL)).max(wait);
        let shift = u32::from(self.unanswered.min(16));
        wait.checked_shl(shift).unwrap_or(most).min(most)
    }

    /// Bytes of a frame of several records at most: what the line sends in two seconds, where that is less than the most.
    fn frame_bytes(&self) -> usize {
        const OF_ONE_RECORD: usize = 110;
        let bytes = PACKET_S.saturating_mul(u64::from(self.settings.bytes_per_second)) as usize;
        bytes.clamp(OF_ONE_RECORD, FRAME_BYTES)
    }

    /// Time in which the line sends so many bytes.
    fn line_us(&self, bytes: usize) -> u64 {
        (bytes as u64 * 1_000_000).div_ceil(u64::from(self.settings.bytes_per_second.max(1)))
    }
}

/// What a packet asks of the peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wants {
    Nothing,
    /// An answer at once.
    Answer,
    /// An answer once nothing more follows.
    AnswerAtEnd,
}
