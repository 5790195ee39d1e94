//! Frames: `COBS( sequence:u16le | postcard(message) | crc32le ) 0x00`.
//!
//! The CRC is CRC-32/ISO-HDLC over sequence and message. The sequence number counts every frame of a session, so a
//! receiver counts what it lost. COBS (Cheshire & Baker, IEEE/ACM Trans. Networking 7(2), 1999) leaves 0x00 for the
//! delimiter only, so the next zero byte always ends the damage. The decoder is our own: the crate's keeps a panic path.

use super::message::Message;
use serde::{Serialize, de::DeserializeOwned};

/// Longest message in postcard bytes.
pub const MESSAGE_BYTES: usize = 160;
/// Longest frame before COBS.
const PLAIN_BYTES: usize = MESSAGE_BYTES + 6;
/// Longest frame on the wire, its delimiter included (COBS adds one byte in 254, and one).
pub const FRAME_BYTES: usize = PLAIN_BYTES + PLAIN_BYTES / 254 + 2;

pub(crate) static CRC: crc::Crc<u32, crc::Table<1>> =
    crc::Crc::<u32, crc::Table<1>>::new(&crc::CRC_32_ISO_HDLC);

/// Makes frames; the state is the sequence number.
#[derive(Clone, Debug)]
pub struct Encoder {
    sequence: u16,
    frames: u32,
    /// Length of the newest frame.
    length: usize,
    buffer: [u8; FRAME_BYTES],
}

impl Default for Encoder {
    fn default() -> Self {
        Self { sequence: 0, frames: 0, length: 0, buffer: [0; FRAME_BYTES] }
    }
}

impl Encoder {
    /// Frames made so far.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// The frame of one message (or command), delimiter included. Empty if it does not fit, which no message of
    /// this version does (tested).
    pub fn frame<T: Serialize>(&mut self, message: &T) -> &[u8] {
        let mut body = [0u8; MESSAGE_BYTES];
        match crate::room::written(message, &mut body) {
            Some(bytes) => self.frame_of(bytes),
            None => &[],
        }
    }

    /// The frame of a message whose bytes were made elsewhere. Empty if they do not fit.
    pub fn frame_of(&mut self, message: &[u8]) -> &[u8] {
        let mut plain = [0u8; PLAIN_BYTES];
        if message.len() > MESSAGE_BYTES {
            return &[];
        }
        for (to, from) in plain.iter_mut().zip(self.sequence.to_le_bytes().iter().chain(message)) {
            *to = *from;
        }
        let used = 2 + message.len();
        let Some(crc) = plain.get(..used).map(|b| CRC.checksum(b)) else { return &[] };
        for (to, from) in plain.iter_mut().skip(used).zip(crc.to_le_bytes()) {
            *to = from;
        }
        self.sequence = self.sequence.wrapping_add(1);
        self.frames = self.frames.wrapping_add(1);
        self.length = stuff(plain.get(..used + 4).unwrap_or(&[]), &mut self.buffer);
        self.last()
    }

    /// The newest frame again.
    pub fn last(&self) -> &[u8] {
        self.buffer.get(..self.length).unwrap_or(&[])
    }

    /// The sequence number of the next frame.
    pub fn sequence(&self) -> u16 {
        self.sequence
    }
}

/// COBS with its closing zero; returns the length written (0 if it does not fit).
fn stuff(plain: &[u8], out: &mut [u8]) -> usize {
    let mut code_at = 0usize;
    let mut code = 1u8;
    let mut at = 1usize;
    for &byte in plain {
        if byte != 0 {
            match out.get_mut(at) {
                Some(o) => *o = byte,
                None => return 0,
            }
            at += 1;
            code += 1;
        }
        if byte == 0 || code == 0xff {
            match out.get_mut(code_at) {
                Some(o) => *o = code,
                None => return 0,
            }
            code = 1;
            code_at = at;
            at += 1;
        }
    }
    match out.get_mut(code_at) {
        Some(o) => *o = code,
        None => return 0,
    }
    match out.get_mut(at) {
        Some(o) => *o = 0,
        None => return 0,
    }
    at + 1
}

/// What the decoder counted. Every byte received is in a good frame or in `bytes_discarded`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderCounters {
    /// Frames decoded.
    pub frames: u64,
    /// Frames that the sequence numbers say were lost (damaged ones included). More than 32 768 lost in a row cannot be
    /// told from a sender that has started again, and count none.
    pub lost: u64,
    /// Frames that came twice (their messages are given twice).
    pub repeated: u64,
    /// Frames discarded as damaged: too long, bad COBS, bad CRC, unknown message.
    pub damaged: u64,
    /// Frames whose CRC was right and whose message this version does not know.
    pub unknown: u64,
    /// Bytes that belonged to no good frame.
    pub bytes_discarded: u64,
}

/// One frame received.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Received<T = Message> {
    /// Its sequence number.
    pub sequence: u16,
    /// Its message.
    pub message: T,
}

/// Sequence numbers up to so many ahead of the newest are later frames, the others earlier ones.
const HALF: u16 = 1 << 15;

/// Which of the newest 64 sequence numbers have come.
#[derive(Clone, Copy, Debug)]
struct Order {
    newest: u16,
    /// Bit n: the frame n before the newest.
    seen: u64,
}

impl Order {
    /// Frames before the first are none that were missed.
    fn begun(sequence: u16) -> Self {
        Self { newest: sequence, seen: u64::MAX }
    }

    /// Counts what the sequence number of a whole frame says about the frames before it.
    fn count(order: &mut Option<Self>, counters: &mut DecoderCounters, sequence: u16) {
        let Some(Self { newest, seen }) = order else {
            *order = Some(Self::begun(sequence));
            return;
        };
        let (ahead, behind) = (sequence.wrapping_sub(*newest), newest.wrapping_sub(sequence));
        if (1..=HALF).contains(&ahead) {
            counters.lost += u64::from(ahead - 1);
            *newest = sequence;
            *seen = seen.checked_shl(u32::from(ahead)).unwrap_or(0) | 1;
        } else if let Some(bit) = 1u64.checked_shl(u32::from(behind)) {
            if *seen & bit != 0 {
                counters.repeated += 1;
            } else {
                // Overtaken by a later one, which counted it as lost.
                counters.lost = counters.lost.saturating_sub(1);
            }
            *seen |= bit;
        } else {
            // Too old to be late: the sender has started again.
            *order = Some(Self::begun(sequence));
        }
    }
}

/// Turns bytes into messages; resynchronises at the next delimiter whatever happened before.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; FRAME_BYTES],
    used: usize,
    overlong: bool,
    raw: u64,
    /// Of the whole frame before: its bytes on the wire, and those of its message, which stand after the sequence number.
    whole: (u16, u16),
    order: Option<Order>,
    counters: DecoderCounters,
}

impl Default for Decoder {
    fn default() -> Self {
        Self {
            buffer: [0; FRAME_BYTES],
            used: 0,
            overlong: false,
            raw: 0,
            whole: (0, 0),
            order: None,
            counters: DecoderCounters::default(),
        }
    }
}

impl Decoder {
    /// What was counted so far.
    pub fn counters(&self) -> DecoderCounters {
        self.counters
    }

    /// Frames that gave no message, damaged or unknown, modulo 2³².
    pub fn bad(&self) -> u32 {
        self.counters.damaged.wrapping_add(self.counters.unknown) as u32
    }

    /// The newest sequence number so far.
    pub fn newest(&self) -> Option<u16> {
        self.order.map(|order| order.newest)
    }

    /// The stream has ended: bytes of an unfinished frame are damage.
    pub fn cut(&mut self) {
        if self.raw > 0 {
            self.counters.damaged += 1;
            self.counters.bytes_discarded += self.raw;
        }
        (self.raw, self.used, self.overlong) = (0, 0, false);
    }

    /// The frame just given is the first of a sender that has started again. `before`: the counters before that frame;
    /// nothing counts as lost or repeated between them.
    pub fn begin_again(&mut self, sequence: u16, before: DecoderCounters) {
        (self.counters.lost, self.counters.repeated) = (before.lost, before.repeated);
        self.order = Some(Order::begun(sequence));
    }

    /// Takes one byte; a message when it completes a good frame.
    pub fn push<T: DeserializeOwned>(&mut self, byte: u8) -> Option<Received<T>> {
        let sequence = self.push_frame(byte)?;
        match postcard::take_from_bytes::<T>(self.message()) {
            Ok((message, [])) => Some(Received { sequence, message }),
            _ => {
                self.unknown();
                None
            }
        }
    }

    /// Takes one byte; the sequence number when it completes a whole frame, whose message is [`Decoder::message`] until
    /// the next byte.
    pub fn push_frame(&mut self, byte: u8) -> Option<u16> {
        self.raw += 1;
        if byte != 0 {
            match self.buffer.get_mut(self.used) {
                Some(slot) => {
                    *slot = byte;
                    self.used += 1;
                }
                None => self.overlong = true,
            }
            return None;
        }
        let (raw, used, overlong) = (self.raw, self.used, self.overlong);
        self.raw = 0;
        self.used = 0;
        self.overlong = false;
        if used == 0 && !overlong {
            // A lone delimiter is allowed anywhere: senders use it to flush line noise.
            self.counters.bytes_discarded += raw;
            return None;
        }
        let plain = if overlong { None } else { self.unstuff(used) };
        let Some((sequence, message)) = plain.and_then(|n| self.open(n)) else {
            self.counters.damaged += 1;
            self.counters.bytes_discarded += raw;
            return None;
        };
        self.whole = (raw as u16, message);
        self.counters.frames += 1;
        Some(sequence)
    }

    /// The message of the whole frame before.
    pub fn message(&self) -> &[u8] {
        self.buffer.get(2..2 + usize::from(self.whole.1)).unwrap_or(&[])
    }

    /// The message of the whole frame before is none that the receiver knows.
    pub fn unknown(&mut self) {
        self.counters.frames = self.counters.frames.saturating_sub(1);
        self.counters.unknown += 1;
        self.counters.bytes_discarded += u64::from(self.whole.0);
    }

    /// Undoes COBS in place; the plain length.
    fn unstuff(&mut self, used: usize) -> Option<usize> {
        let mut read = 0usize;
        let mut write = 0usize;
        while read < used {
            let code = usize::from(*self.buffer.get(read)?);
            read += 1;
            if code == 0 || read + code - 1 > used {
                return None;
            }
            for _ in 1..code {
                let byte = *self.buffer.get(read)?;
                *self.buffer.get_mut(write)? = byte;
                read += 1;
                write += 1;
            }
            if code != 0xff && read < used {
                *self.buffer.get_mut(write)? = 0;
                write += 1;
            }
        }
        Some(write)
    }

    /// Checks a plain frame: its sequence number and the length of its message; `None` if damaged.
    fn open(&mut self, n: usize) -> Option<(u16, u16)> {
        let (body, tail) = self.buffer.get(..n)?.split_last_chunk::<4>()?;
        if CRC.checksum(body) != u32::from_le_bytes(*tail) {
            return None;
        }
        let (head, message) = body.split_first_chunk::<2>()?;
        let (sequence, length) = (u16::from_le_bytes(*head), message.len() as u16);
        Order::count(&mut self.order, &mut self.counters, sequence);
        Some((sequence, length))
    }
}

#[cfg(test)]
mod tests {
    use super::super::message::{End, Reply};
    use super::*;
    use std::vec::Vec;

    fn decode(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Received> {
        bytes.iter().filter_map(|b| decoder.push(*b)).collect()
    }

    #[test]
    fn golden_bytes() {
        // Sequence 0, message 8, token 9, status 1, CRC-32 (computed independently), COBS, delimiter.
        let mut encoder = Encoder::default();
        let frame = encoder.frame(&Message::Reply(Reply { token: 9, status: 1 })).to_vec();
        assert_eq!(frame, [1, 1, 8, 8, 9, 1, 122, 45, 244, 110, 0]);
    }

    #[test]
    fn damage_costs_only_the_frames_it_hits_and_is_counted() {
        let mut encoder = Encoder::default();
        let mut stream = Vec::new();
        for i in 0..50u64 {
            stream.extend_from_slice(encoder.frame(&Message::End(End { index: i * 1000, frames: 3 })));
        }
        let clean = stream.len();
        stream[clean / 2] ^= 0x40;
        let mut decoder = Decoder::default();
        let got = decode(&mut decoder, &stream);
        let c = decoder.counters();
        assert!(got.len() >= 48, "{c:?}");
        assert_eq!(c.frames + c.lost, 50, "{c:?}");
        assert!(c.damaged >= 1 && c.bytes_discarded > 0);
    }

    #[test]
    fn frames_that_come_twice_or_late_are_not_lost() {
        let mut encoder = Encoder { sequence: 65_500, ..Encoder::default() };
        let frames: Vec<Vec<u8>> = (0..200u64)
            .map(|i| encoder.frame(&Message::End(End { index: i * 1000, frames: 3 })).to_vec())
            .collect();
        let counted = |order: &[usize]| {
            let mut decoder = Decoder::default();
            order.iter().for_each(|n| drop(decode(&mut decoder, &frames[*n])));
            let c = decoder.counters();
            (c.frames, c.lost, c.repeated)
        };
        assert_eq!(counted(&[0, 1, 1, 2, 3]), (5, 0, 1), "one came twice");
        assert_eq!(counted(&[0, 2, 1, 3]), (4, 0, 0), "two changed places");
        assert_eq!(counted(&[0, 2, 3]), (3, 1, 0), "one was dropped");
        // Across the wrap of the number, at frame 36.
        assert_eq!(counted(&[34, 37, 36, 35, 35, 38, 40]), (7, 1, 1));
        assert_eq!(counted(&[0, 150, 100, 199]), (4, 149 + 48 - 1, 0));
        // The sender starts again: what it lost meanwhile nobody knows, and nothing is made up.
        let mut decoder = Decoder::default();
        for frame in &frames {
            decode(&mut decoder, frame);
        }
        let mut again = Encoder::default();
        for i in 0..300u64 {
            decode(&mut decoder, again.frame(&Message::End(End { index: i, frames: 0 })));
        }
        assert_eq!(decoder.counters().lost, 0);
    }

    #[test]
    fn noise_yields_nothing_and_the_next_frame_is_found() {
        let mut decoder = Decoder::default();
        let noise: Vec<u8> = (0..5000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        assert!(decode(&mut decoder, &noise).is_empty());
        let mut encoder = Encoder::default();
        let mut stream = std::vec![0u8];
        stream.extend_from_slice(encoder.frame(&Message::End(End { index: 5, frames: 0 })));
        assert_eq!(decode(&mut decoder, &stream).len(), 1);
    }

    proptest::proptest! {
        #![proptest_config(seabearing_testkit::property(256))]

        #[test]
        fn cobs_round_trip(plain in proptest::collection::vec(proptest::num::u8::ANY, 1..160)) {
            let mut d = Decoder::default();
            let n = stuff(&plain, &mut d.buffer);
            proptest::prop_assert!(d.buffer[..n - 1].iter().all(|b| *b != 0));
            let m = d.unstuff(n - 1).unwrap();
            proptest::prop_assert_eq!(&d.buffer[..m], &plain[..]);
        }
    }
}
