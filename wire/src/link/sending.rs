//! Which records of the store are on their way, which have come, and which are to be sent next.

use super::receiving::Progress;
use super::store::{CLASSES, Class, Ledger, PerClass};
use super::{OVERTAKE, ahead};

/// Records of a class that may be unacknowledged at a time.
const WINDOW: u32 = 64;

/// The state of the records of one class, from the oldest kept on.
#[derive(Clone, Copy, Debug)]
struct Flight {
    /// Number of bit 0: the oldest kept.
    base: u32,
    /// Has come, but an earlier one has not.
    acked: u64,
    /// Sent, and not known to have come or to be lost.
    flying: u64,
    /// Sequence number of the frame that took it, by number modulo 64.
    sent_in: [u16; WINDOW as usize],
}

/// What the sender knows of its records' fate.
#[derive(Clone, Debug)]
pub(super) struct Sending {
    flights: [Flight; CLASSES],
    /// As the peer last said.
    peer_next: PerClass,
}

impl Sending {
    /// Nothing is known of the records of a store.
    pub(super) fn new(ledger: &Ledger) -> Self {
        let flights =
            ledger.oldest.map(|base| Flight { base, acked: 0, flying: 0, sent_in: [0; WINDOW as usize] });
        Self { flights, peer_next: ledger.oldest }
    }

    /// The store has dropped its oldest.
    pub(super) fn follow(&mut self, ledger: &Ledger) {
        for (flight, oldest) in self.flights.iter_mut().zip(ledger.oldest) {
            let n = oldest.wrapping_sub(flight.base);
            flight.acked = flight.acked.checked_shr(n).unwrap_or(0);
            flight.flying = flight.flying.checked_shr(n).unwrap_or(0);
            flight.base = oldest;
        }
    }

    /// Of the most urgent class that has any, the first record that is to be sent.
    pub(super) fn first(&self, ledger: &Ledger) -> Option<(Class, u32)> {
        let of = |class: &Class| {
            let flight = self.flights.get(*class as usize)?;
            let n = (flight.acked | flight.flying).trailing_ones();
            (n < WINDOW.min(ledger.kept(*class))).then(|| (*class, flight.base.wrapping_add(n)))
        };
        Class::ALL.iter().find_map(of)
    }

    /// Whether a record is to be sent.
    pub(super) fn wants(&self, ledger: &Ledger, class: Class, number: u32) -> bool {
        let Some(flight) = self.flights.get(class as usize) else { return false };
        let n = number.wrapping_sub(flight.base);
        n < WINDOW.min(ledger.kept(class)) && (flight.acked | flight.flying) >> n & 1 == 0
    }

    /// A record leaves in a frame.
    pub(super) fn sent(&mut self, class: Class, number: u32, frame: u16) {
        let Some(flight) = self.flights.get_mut(class as usize) else { return };
        flight.flying |= 1u64.checked_shl(number.wrapping_sub(flight.base)).unwrap_or(0);
        if let Some(slot) = flight.sent_in.get_mut((number % WINDOW) as usize) {
            *slot = frame;
        }
    }

    /// Whether anything is on its way.
    pub(super) fn flying(&self) -> bool {
        self.flights.iter().any(|f| f.flying != 0)
    }

    /// What is on its way is given up, and sent again.
    pub(super) fn give_up(&mut self) {
        self.flights.iter_mut().for_each(|f| f.flying = 0);
    }

    /// Whether the oldest record of a class, and how many after it without a gap, are known to have come.
    pub(super) fn oldest_acked(&self, class: Class) -> bool {
        self.flights.get(class as usize).is_some_and(|f| f.acked & 1 != 0)
    }

    /// Whether the peer waits for records that are not kept any more.
    pub(super) fn must_skip(&self, ledger: &Ledger) -> bool {
        self.peer_next.iter().zip(ledger.oldest).any(|(next, oldest)| ahead(oldest, *next))
    }

    /// The peer's numbers of one class; the number below which it has all, if that is news.
    pub(super) fn acknowledge(&mut self, ledger: &Ledger, class: Class, progress: &Progress) -> Option<u32> {
        let at = class as usize;
        let (next, later) = (*progress.next.get(at)?, *progress.later.get(at)?);
        // What was never written cannot have come.
        if ahead(next, *ledger.next.get(at)?) {
            return None;
        }
        let peer_next = self.peer_next.get_mut(at)?;
        if ahead(next, *peer_next) {
            *peer_next = next;
        }
        let flight = self.flights.get_mut(at)?;
        let n = next.wrapping_sub(flight.base);
        // Bit k of `later` is number next + 1 + k.
        flight.acked = if ahead(flight.base, next) {
            later.checked_shr(flight.base.wrapping_sub(next) - 1).unwrap_or(0)
        } else {
            later.checked_shl(n.saturating_add(1)).unwrap_or(0)
        };
        flight.flying &= !flight.acked;
        ahead(next, flight.base).then_some(next)
    }

    /// A frame was heard: what left at least so many frames before it and has not come is lost. `in_order`: frames do
    /// not overtake each other.
    pub(super) fn heard(&mut self, frame: u16, in_order: bool) {
        let overtake = if in_order { 0 } else { OVERTAKE };
        for flight in &mut self.flights {
            let mut left = flight.flying;
            while left != 0 {
                let n = left.trailing_zeros();
                left &= left - 1;
                let number = flight.base.wrapping_add(n);
                let sent_in = flight.sent_in.get((number % WINDOW) as usize).copied().unwrap_or(frame);
                if frame.wrapping_sub(sent_in) as i16 >= overtake {
                    flight.flying &= !(1 << n);
                }
            }
        }
    }
}
