//! A snippet of raw samples: taken at one go, sent piece by piece while the line has nothing more urgent to do.
//!
//! Enters: an order and the blocks of the source, as they come, before anything is made of them. Leaves: a
//! [`Message::Snippet`] once the instants that were asked for have followed each other without a gap (a gap begins it afresh),
//! then [`Message::Samples`]. What was taken waits in memory of the board's and not in the store of records, which must
//! have room for what is found. Cost: a copy of the codes asked for; nothing while nothing is.

use crate::block::{Block, CHANNELS};
use crate::keeper::{DONE, REFUSED, UNKNOWN};
use crate::wire::{Message, SAMPLES_BYTES, Samples, Snippet};

/// Codes (instants times channels) that boards have memory for: 256 ms of one channel at 64 kHz, 82 s of four at 50 Hz.
pub const MOST_CODES: usize = 16_384;

/// How far it is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Nothing was asked for, or all was sent.
    Rests,
    /// So many instants were taken.
    Takes(usize),
    /// All were taken; that is to be said.
    Taken,
    /// So many instants were sent.
    Sends(usize),
}

/// Takes and sends snippets, one at a time.
#[derive(Debug)]
pub struct Snippets<'a> {
    memory: &'a mut [i32],
    stage: Stage,
    token: u8,
    channels: u8,
    index: u64,
    instants: usize,
    /// Bytes of the longest code.
    width: u8,
}

impl<'a> Snippets<'a> {
    /// Of at most as many codes as there is memory for; without any, snippets are not known.
    pub fn new(memory: &'a mut [i32]) -> Self {
        Self { memory, stage: Stage::Rests, token: 0, channels: 0, index: 0, instants: 0, width: 0 }
    }

    /// Takes so many instants of these channels (bit c: channel c) from now on; the status of the reply. What was not sent of
    /// another is forgotten.
    pub fn order(&mut self, token: u8, channels: u8, instants: u32) -> u8 {
        if self.memory.is_empty() {
            return UNKNOWN;
        }
        let codes = u64::from(instants) * Samples::count(channels) as u64;
        if codes == 0 || codes > self.memory.len() as u64 || usize::from(channels) >> CHANNELS != 0 {
            return REFUSED;
        }
        (self.token, self.channels, self.instants) = (token, channels, instants as usize);
        self.stage = Stage::Takes(0);
        DONE
    }

    /// The source's newest block.
    pub fn take(&mut self, block: &Block<'_>) {
        let Stage::Takes(mut taken) = self.stage else { return };
        if block.frames.is_empty() {
            return;
        }
        if taken == 0 || self.index.saturating_add(taken as u64) != block.first_index {
            (taken, self.index, self.width) = (0, block.first_index, 1);
        }
        let count = Samples::count(self.channels).max(1);
        let room = self.memory.chunks_exact_mut(count).take(self.instants).skip(taken);
        for (to, frame) in room.zip(block.frames) {
            for (to, (_, code)) in
                to.iter_mut().zip(frame.iter().enumerate().filter(|(c, _)| self.channels >> c & 1 == 1))
            {
                *to = *code;
                self.width = self.width.max(width(*code));
            }
            taken += 1;
        }
        self.stage = if taken < self.instants { Stage::Takes(taken) } else { Stage::Taken };
    }

    /// Whether something is to be sent.
    pub fn sends(&self) -> bool {
        matches!(self.stage, Stage::Taken | Stage::Sends(_))
    }

    /// What is to be sent next.
    pub fn next_message(&mut self) -> Option<Message> {
        let Self { token, channels, index, width, .. } = *self;
        let sent = match self.stage {
            Stage::Taken => {
                self.stage = Stage::Sends(0);
                let instants = self.instants as u32;
                return Some(Message::Snippet(Snippet { token, index, instants, channels }));
            }
            Stage::Sends(sent) => sent,
            Stage::Rests | Stage::Takes(_) => return None,
        };
        let count = Samples::count(channels).max(1);
        let fit = SAMPLES_BYTES.checked_div(count * usize::from(width)).unwrap_or(0).max(1);
        let instants = fit.min(self.instants.saturating_sub(sent));
        let mut bytes = [[0; SAMPLES_BYTES / 2]; 2];
        let codes = self.memory.chunks_exact(count).skip(sent).take(instants).flatten();
        let from = codes.flat_map(|code| code.to_le_bytes().into_iter().take(usize::from(width)));
        bytes.as_flattened_mut().iter_mut().zip(from).for_each(|(to, from)| *to = from);
        let sent_now = sent + instants;
        self.stage = if sent_now < self.instants { Stage::Sends(sent_now) } else { Stage::Rests };
        let index = index.saturating_add(sent as u64);
        Some(Message::Samples(Samples { token, index, instants: instants as u8, channels, width, bytes }))
    }
}

/// Bytes of a code in two's complement.
fn width(code: i32) -> u8 {
    // Its bits without those that only repeat the sign, and the sign.
    let bits = 33 - (code ^ (code >> 31)).leading_zeros();
    bits.div_ceil(8) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block::{Frame, MISSING};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn code(index: u64, channel: usize, scale: i64) -> i32 {
        ((index as i64 * 7 + channel as i64 * 1001) % 200 * scale - 100 * scale) as i32
    }

    /// Gives blocks of these lengths from these indices on; everything that is to be sent then.
    fn sent(snippets: &mut Snippets<'_>, blocks: &[(u64, usize)], scale: i64) -> Vec<Message> {
        for (first_index, count) in blocks {
            let frame = |n: u64| -> Frame { core::array::from_fn(|c| code(first_index + n, c, scale)) };
            let frames: Vec<Frame> = (0..*count as u64).map(frame).collect();
            snippets.take(&Block { first_index: *first_index, frames: &frames });
        }
        core::iter::from_fn(|| snippets.next_message()).collect()
    }

    proptest! {
        #![proptest_config(seabearing_testkit::property(256))]

        #[test]
        fn what_is_sent_are_the_codes_that_came_whatever_the_blocks_the_channels_and_their_size(
            channels in 1u8..16,
            instants in 1u32..=150,
            scale in prop::sample::select(std::vec![1i64, 100, 40_000, 20_000_000]),
            lengths in prop::collection::vec(1usize..65, 150),
        ) {
            let mut memory = [0; 600];
            let mut snippets = Snippets::new(&mut memory);
            prop_assert_eq!(snippets.order(9, channels, instants), DONE);
            let mut next = 1000;
            let mut follow = |count: &usize| {
                next += *count as u64;
                (next - *count as u64, *count)
            };
            let blocks: Vec<(u64, usize)> = lengths.iter().map(&mut follow).collect();
            let mut messages = sent(&mut snippets, &blocks, scale).into_iter();
            let head = Snippet { token: 9, index: 1000, instants, channels };
            prop_assert_eq!(messages.next(), Some(Message::Snippet(head)));
            let mut next = 1000;
            for message in messages {
                let Message::Samples(piece) = message else { panic!("{message:?}") };
                prop_assert_eq!((piece.index, piece.token, piece.channels), (next, 9, channels));
                let wanted = (next..next + u64::from(piece.instants)).flat_map(|n| {
                    (0..4).filter(move |c| channels >> c & 1 == 1).map(move |c| code(n, c, scale))
                });
                prop_assert!(piece.codes().eq(wanted));
                next += u64::from(piece.instants);
            }
            prop_assert_eq!(next, 1000 + u64::from(instants));
            prop_assert!(!snippets.sends());
        }
    }

    #[test]
    fn a_gap_begins_it_afresh_and_a_new_order_takes_its_place() {
        let mut memory = [0; 400];
        let mut snippets = Snippets::new(&mut memory);
        assert_eq!(snippets.order(1, 0b1111, 100), DONE);
        let first = |messages: &[Message]| match messages.first() {
            Some(Message::Snippet(s)) => (s.token, s.index),
            other => panic!("{other:?}"),
        };
        // A gap, and time that starts again.
        let all = sent(&mut snippets, &[(0, 64), (65, 64), (3, 64), (67, 64)], 1);
        assert_eq!(first(&all), (1, 3));
        assert_eq!(snippets.order(2, 1, 10), DONE);
        assert_eq!(snippets.order(3, 1, 11), DONE);
        assert_eq!(first(&sent(&mut snippets, &[(500, 64)], 1)), (3, 500));
        assert!(sent(&mut snippets, &[(600, 64)], 1).is_empty());
    }

    #[test]
    fn too_much_nothing_and_no_memory_are_refused() {
        let mut memory = [0; 400];
        let mut snippets = Snippets::new(&mut memory);
        for (channels, instants) in [(0b1111, 101), (1, 401), (0, 5), (1, 0), (16, 5), (31, 5), (3, u32::MAX)]
        {
            assert_eq!(snippets.order(1, channels, instants), REFUSED, "{channels} {instants}");
        }
        assert_eq!(snippets.order(1, 0b1111, 100), DONE);
        assert_eq!(Snippets::new(&mut []).order(1, 1, 1), UNKNOWN);
    }

    #[test]
    fn a_code_has_as_many_bytes_as_it_needs() {
        for (code, bytes) in [
            (0, 1),
            (127, 1),
            (-128, 1),
            (128, 2),
            (-129, 2),
            (32_767, 2),
            (-32_769, 3),
            (8_388_607, 3),
            (MISSING, 4),
        ] {
            assert_eq!(width(code), bytes, "{code}");
        }
    }
}
