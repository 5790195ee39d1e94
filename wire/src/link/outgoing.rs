//! What goes over the line next: who asks, who has the turn, which records go together, and how long to wait for an answer.

use super::packet::{Packet, Writer};
use super::{Class, FRAME_BYTES, Link, Store, THINK_US, TOGETHER};

/// Longest wait between two questions to a peer that does not answer, but for slow lines and small budgets.
const ASK_AGAIN_US: u64 = 3_000_000;
/// Longest packet for its line, seconds: on slow lines fewer records go together.
const PACKET_S: u64 = 2;
/// Bytes on the line of an acknowledgement or of an opening, about.
const SMALL: usize = 60;

/// What a packet asks of the peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wants {
    Nothing,
    /// An answer at once.
    Answer,
    /// An answer once nothing more follows.
    AnswerAtEnd,
}

impl<S: Store> Link<S> {
    /// The next frame, if one may be sent now. The caller puts all of it on the line.
    pub fn send(&mut self, now: u64) -> Option<&[u8]> {
        self.budget.spend(now, 0);
        self.store.work();
        self.sending.follow(self.store.ledger());
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
                let progress = peer.progress.withheld(&peer.first, &self.withholds);
                let ack = Packet::Ack { tag: peer.tag, heard: peer.heard, progress };
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
    pub(super) fn patience(&self, full: bool) -> u64 {
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
    pub(super) fn frame_bytes(&self) -> usize {
        const OF_ONE_RECORD: usize = 110;
        let bytes = PACKET_S.saturating_mul(u64::from(self.settings.bytes_per_second)) as usize;
        bytes.clamp(OF_ONE_RECORD, FRAME_BYTES)
    }

    /// Time in which the line sends so many bytes.
    pub(super) fn line_us(&self, bytes: usize) -> u64 {
        (bytes as u64 * 1_000_000).div_ceil(u64::from(self.settings.bytes_per_second.max(1)))
    }
}
