//! Faults of one kind are gathered: at most three a minute are sent, the first at once; the others are counted and told
//! together when the minute ends.
//!
//! A minute is as many sample instants that have come, whatever their index: the telemetry does not depend on how they are
//! cut into blocks, and an index that leaps or starts again does not end it. While none come the board's clock does.

use crate::wire::{Fault, FaultCode, FaultsHeld, Message};

/// Faults of one kind sent a minute one by one; the others of the minute make one record.
pub const A_MINUTE: u32 = 3;

/// Kinds there are.
const KINDS: usize = FaultCode::ALL.len();

/// What came in this minute, by kind.
#[derive(Clone, Debug)]
pub struct Faults {
    minute: u64,
    /// How many, those sent included.
    came: [u32; KINDS],
    /// The number of what was held back.
    values: [i64; KINDS],
}

impl Faults {
    /// Nothing went wrong; all zeros.
    pub const fn new() -> Self {
        Self { minute: 0, came: [0; KINDS], values: [0; KINDS] }
    }

    /// Sends a fault, or holds it back.
    pub fn note(&mut self, code: FaultCode, index: u64, value: u64, sink: &mut dyn FnMut(Message)) {
        self.gather(Fault { code, index, value: i64::try_from(value).unwrap_or(i64::MAX) }, sink);
    }

    /// The same of a fault as it is.
    pub(crate) fn gather(&mut self, fault: Fault, sink: &mut dyn FnMut(Message)) {
        let Fault { code, value, .. } = fault;
        let kind = code as usize;
        let (Some(came), Some(held)) = (self.came.get_mut(kind), self.values.get_mut(kind)) else { return };
        *came = came.saturating_add(1);
        if *came <= A_MINUTE {
            sink(Message::Fault(fault));
        } else {
            *held = match code {
                FaultCode::Gap | FaultCode::Overlap | FaultCode::Invalid | FaultCode::Impulses => {
                    held.saturating_add(value)
                }
                FaultCode::DeadChannel
                | FaultCode::ChannelBack
                | FaultCode::Clipping
                | FaultCode::OwnNoise
                | FaultCode::Inverted
                | FaultCode::Leaking => *held | 1 << value.clamp(0, 7),
                _ => value,
            };
        }
    }

    /// Gathers a chain's message where it is a fault, and sends every other.
    pub fn pass(&mut self, message: Message, sink: &mut dyn FnMut(Message)) {
        match message {
            Message::Fault(fault) => self.gather(fault, sink),
            other => sink(other),
        }
    }

    /// So many minutes of instants have come; the recording is at `index`.
    pub(super) fn time(&mut self, minute: u64, index: u64, sink: &mut dyn FnMut(Message)) {
        if minute != self.minute {
            self.minute = minute;
            self.tell(index, sink);
        }
    }

    /// A minute has ended: tells what was held back.
    pub fn tell(&mut self, index: u64, sink: &mut dyn FnMut(Message)) {
        for ((came, held), code) in self.came.iter_mut().zip(&mut self.values).zip(FaultCode::ALL) {
            let (count, value) = (came.saturating_sub(A_MINUTE), *held);
            (*came, *held) = (0, 0);
            if count > 0 {
                sink(Message::FaultsHeld(FaultsHeld { code, index, count, value }));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn three_a_minute_of_each_kind_and_the_rest_as_one_number() {
        let (mut faults, mut out) = (Faults::new(), Vec::new());
        for n in 0..10 {
            faults.note(FaultCode::Gap, n, 5, &mut |m| out.push(m));
        }
        for channel in [2, 2, 2, 0, 3] {
            faults.note(FaultCode::Clipping, 20, channel, &mut |m| out.push(m));
        }
        assert_eq!(out.len(), 6);
        faults.time(0, 30, &mut |_| panic!("the minute has not ended"));
        out.clear();
        faults.time(1, 60, &mut |m| out.push(m));
        let held = |code, count, value| Message::FaultsHeld(FaultsHeld { code, index: 60, count, value });
        assert_eq!(out, [held(FaultCode::Gap, 7, 35), held(FaultCode::Clipping, 2, 0b1001)]);
        out.clear();
        faults.note(FaultCode::Gap, 70, u64::MAX, &mut |m| out.push(m));
        faults.tell(80, &mut |m| out.push(m));
        assert_eq!(out, [Message::Fault(Fault { code: FaultCode::Gap, index: 70, value: i64::MAX })]);
    }
}
