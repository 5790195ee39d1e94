//! Packets: what a link says in the messages of frames. `docs/wire.md` specifies every byte.
//!
//! The first byte has bit 7 set and the second is never zero, so that for a decoder of messages alone a packet is a
//! message of a number that no message will ever have.

use super::store::{CLASSES, Class, PerClass, RECORD_BYTES};
use super::{Progress, Session};
use crate::frame::MESSAGE_BYTES;

/// Version of the packets.
pub const LINK_VERSION: u8 = 1;

const PACKET: u8 = 0x80;
const ANSWER: u8 = 0x40;
const TYPE_AT: u32 = 4;
const DATA: u8 = 0;
const OPEN: u8 = 1;
const ACK: u8 = 2;
const ASK: u8 = 3;

/// Bytes of a data packet besides its records at most, and of each record besides its own.
const DATA_HEAD: usize = 3 + 5 + 5 + 5;
const _: () = assert!(DATA_HEAD + 1 + RECORD_BYTES <= MESSAGE_BYTES);

/// A packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packet<'a> {
    /// Records of one class and one boot that follow each other in number and in ordinal.
    Data {
        tag: u16,
        /// Boots since the log was begun.
        boots: u32,
        class: Class,
        /// Of the first record.
        number: u32,
        ordinal: u32,
        records: &'a [u8],
    },
    /// Who speaks, and from which number on of each class there are records.
    Open { session: Session, start: PerClass, lost: PerClass },
    /// What has come of the log with this tag.
    Ack { tag: u16, heard: u16, progress: Progress },
    /// Of which log is the tag?
    Ask { tag: u16 },
}

/// What a message may be.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Parsed<'a> {
    /// No packet.
    Plain,
    /// A packet that this version does not know.
    Unknown,
    /// A packet, and whether its sender wants an answer now.
    Packet(Packet<'a>, bool),
}

/// The records in a data packet, each behind its length.
pub(super) fn records(mut bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    core::iter::from_fn(move || {
        let (length, rest) = bytes.split_first()?;
        let (record, rest) = rest.split_at_checked(usize::from(*length))?;
        bytes = rest;
        Some(record)
    })
}

/// Reads a message.
pub(super) fn parse(message: &[u8]) -> Parsed<'_> {
    match message.split_first() {
        Some((first, rest)) if first & PACKET != 0 => match packet(*first, rest) {
            Some(packet) => Parsed::Packet(packet, first & ANSWER != 0),
            None => Parsed::Unknown,
        },
        _ => Parsed::Plain,
    }
}

fn packet(first: u8, rest: &[u8]) -> Option<Packet<'_>> {
    let mut r = Reader(rest);
    let tag = r.u16()?;
    let (kind, low) = ((first & !(PACKET | ANSWER)) >> TYPE_AT, first & 0x0f);
    if kind != DATA && low != 0 {
        return None;
    }
    let packet = match kind {
        DATA => {
            let class = Class::from_number(low)?;
            let (boots, number) = (r.varint32()?, r.varint32()?);
            let ordinal = number.wrapping_add(r.varint32()?);
            let bytes = core::mem::take(&mut r.0);
            let whole = |n: usize, record: &[u8]| {
                (1..=RECORD_BYTES).contains(&record.len()).then_some(n + 1 + record.len())
            };
            if records(bytes).try_fold(0, whole) != Some(bytes.len()) || bytes.is_empty() {
                return None;
            }
            Packet::Data { tag, boots, class, number, ordinal, records: bytes }
        }
        OPEN => {
            if r.u8()? != LINK_VERSION {
                return None;
            }
            let session = Session {
                station: u16::try_from(r.varint32()?).ok()?,
                log: r.varint32()?,
                boot: r.varint32()?,
                config_hash: r.u64()?,
            };
            let (mut start, mut lost) = ([0; CLASSES], [0; CLASSES]);
            for (start, lost) in start.iter_mut().zip(&mut lost) {
                (*start, *lost) = (r.varint32()?, r.varint32()?);
            }
            if session.tag() != tag {
                return None;
            }
            Packet::Open { session, start, lost }
        }
        ACK => {
            let heard = r.u16()?;
            let mut progress = Progress::default();
            for (next, later) in progress.next.iter_mut().zip(&mut progress.later) {
                (*next, *later) = (r.varint32()?, r.varint()?);
            }
            Packet::Ack { tag, heard, progress }
        }
        ASK => Packet::Ask { tag },
        _ => return None,
    };
    r.0.is_empty().then_some(packet)
}

/// Makes the bytes of a packet.
pub(super) struct Writer {
    bytes: [u8; MESSAGE_BYTES],
    used: usize,
}

impl Writer {
    /// A packet but for its records; no packet overflows the buffer.
    pub(super) fn new(packet: &Packet<'_>, answer: bool) -> Self {
        let mut w = Self { bytes: [0; MESSAGE_BYTES], used: 0 };
        let begin = |w: &mut Self, kind: u8, low: u8, tag: u16| {
            w.put(&[PACKET | if answer { ANSWER } else { 0 } | kind << TYPE_AT | low]);
            w.put(&tag.to_le_bytes());
        };
        match packet {
            Packet::Data { tag, boots, class, number, ordinal, records } => {
                begin(&mut w, DATA, *class as u8, *tag);
                w.varint(u64::from(*boots));
                w.varint(u64::from(*number));
                w.varint(u64::from(ordinal.wrapping_sub(*number)));
                w.put(records);
            }
            Packet::Open { session, start, lost } => {
                begin(&mut w, OPEN, 0, session.tag());
                w.put(&[LINK_VERSION]);
                w.varint(u64::from(session.station));
                w.varint(u64::from(session.log));
                w.varint(u64::from(session.boot));
                w.put(&session.config_hash.to_le_bytes());
                for (start, lost) in start.iter().zip(lost) {
                    w.varint(u64::from(*start));
                    w.varint(u64::from(*lost));
                }
            }
            Packet::Ack { tag, heard, progress } => {
                begin(&mut w, ACK, 0, *tag);
                w.put(&heard.to_le_bytes());
                for (next, later) in progress.next.iter().zip(&progress.later) {
                    w.varint(u64::from(*next));
                    w.varint(*later);
                }
            }
            Packet::Ask { tag } => begin(&mut w, ASK, 0, *tag),
        }
        w
    }

    /// The bytes so far.
    pub(super) fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.used).unwrap_or(&[])
    }

    /// Asks for an answer.
    pub(super) fn want_answer(&mut self) {
        if let Some(first) = self.bytes.first_mut() {
            *first |= ANSWER;
        }
    }

    /// Room for the next record; what is written there counts after [`Writer::took`].
    pub(super) fn room(&mut self) -> &mut [u8] {
        self.bytes.get_mut(self.used + 1..).unwrap_or(&mut [])
    }

    /// A record of so many bytes was written into the room.
    pub(super) fn took(&mut self, record: usize) {
        if let Some(length) = self.bytes.get_mut(self.used) {
            *length = record as u8;
            self.used += 1 + record;
        }
    }

    fn put(&mut self, bytes: &[u8]) {
        for (to, from) in self.bytes.iter_mut().skip(self.used).zip(bytes) {
            *to = *from;
        }
        self.used = (self.used + bytes.len()).min(MESSAGE_BYTES);
    }

    fn varint(&mut self, mut n: u64) {
        while n >= 0x80 {
            self.put(&[n as u8 | 0x80]);
            n >>= 7;
        }
        self.put(&[n as u8]);
    }
}

struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*head)
    }

    fn u8(&mut self) -> Option<u8> {
        self.take::<1>().map(|[b]| b)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn varint(&mut self) -> Option<u64> {
        let mut n = 0u64;
        for shift in (0..64).step_by(7) {
            let byte = self.u8()?;
            let part = u64::from(byte & 0x7f);
            // The tenth byte has room for one bit.
            if shift == 63 && part > 1 {
                return None;
            }
            n |= part << shift;
            if byte < 0x80 {
                return Some(n);
            }
        }
        None
    }

    fn varint32(&mut self) -> Option<u32> {
        u32::try_from(self.varint()?).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Command, Message};

    fn round(packet: Packet<'_>) {
        for answer in [false, true] {
            let writer = Writer::new(&packet, answer);
            assert!(writer.bytes().len() <= MESSAGE_BYTES);
            assert_eq!(parse(writer.bytes()), Parsed::Packet(packet, answer));
            // What it lacks or has too much makes it unknown, and decoders of messages never take it for one.
            for n in 1..writer.bytes().len() {
                if !matches!(packet, Packet::Data { .. }) {
                    assert_eq!(parse(&writer.bytes()[..n]), Parsed::Unknown);
                }
                let bytes = &writer.bytes()[..n];
                assert!(postcard::from_bytes::<Message>(bytes).is_err());
                assert!(postcard::from_bytes::<Command>(bytes).is_err());
            }
        }
    }

    #[test]
    fn packets_are_read_as_they_were_written() {
        let session = Session { station: 65_535, log: u32::MAX, boot: 3, config_hash: u64::MAX };
        round(Packet::Open { session, start: [u32::MAX; CLASSES], lost: [u32::MAX; CLASSES] });
        let progress = Progress { next: [u32::MAX; CLASSES], later: [u64::MAX; CLASSES] };
        round(Packet::Ack { tag: 0x101, heard: 7, progress });
        round(Packet::Ask { tag: session.tag() });
        let records = b"\x01a\x03bcd";
        round(Packet::Data { tag: 1, boots: 2, class: Class::Bearing, number: 5, ordinal: 400, records });
        round(Packet::Data { tag: 1, boots: 2, class: Class::Alarm, number: 5, ordinal: 4, records });
        assert_eq!(parse(&[8, 9, 1]), Parsed::Plain);
        assert_eq!(parse(&[]), Parsed::Plain);
    }

    proptest::proptest! {
        #![proptest_config(seabearing_testkit::property(2000))]

        #[test]
        fn any_bytes_are_read_or_refused(mut bytes in proptest::collection::vec(proptest::num::u8::ANY, 1..160)) {
            bytes[0] |= PACKET;
            if let Parsed::Packet(packet, answer) = parse(&bytes) {
                let again = Writer::new(&packet, answer);
                proptest::prop_assert_eq!(parse(again.bytes()), Parsed::Packet(packet, answer));
            }
        }
    }
}
