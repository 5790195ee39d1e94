//! What comes over the line: packets taken apart, records taken once, acknowledgements believed.

use super::packet::{self, Packet, Parsed};
use super::receiving::Taken;
use super::{
    Arrival, Class, Inbox, Link, Loss, Peer, PerClass, Progress, Record, Session, Store, THINK_US, TOGETHER,
    ahead,
};

/// Openings of an earlier log in a row that are needed to believe it.
const EARLIER_LOGS: u8 = 3;

impl<S: Store> Link<S> {
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
            first: *start,
            heard: sequence,
        });
        (peer.heard, peer.first) = (sequence, *start);
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
}
