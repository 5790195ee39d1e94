//! Samples over a serial line, for a recorder whose converter is another computer: the frames of telemetry
//! ([`crate::wire::frame`]: sequence number, CRC, COBS) with samples in them.
//!
//! Enters: bytes as they come. Leaves: samples with their indices. A frame that is damaged or lost is counted and leaves
//! a gap of its samples, because every frame says where it begins; [`Packet::End`] says where the last one ends, so
//! that frames lost at the end are accounted for too. `docs/firmware.md` specifies every byte. Cost: about 60
//! instructions a byte; 18.5 bytes a sample instant, so 925 bytes a second at 50 Hz.

use crate::block::{CHANNELS, Frame, MISSING};
use crate::port::{Chunk, SampleSource};
use crate::wire::{Decoder, DecoderCounters, Encoder};
use serde::{Deserialize, Serialize};

/// Most sample instants of one packet: what fits into a frame of telemetry, and 160 ms at 50 Hz.
pub const PACKET_FRAMES: usize = 8;

/// What one frame of the line carries.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Packet {
    /// Samples that follow each other without a gap.
    Samples {
        /// Sample index of the first.
        first_index: u64,
        /// Codes of the channels in recorder order, `i32` little-endian; `i32::MIN` is a missing sample.
        frames: heapless::Vec<[u8; CHANNELS * 4], PACKET_FRAMES>,
    },
    /// The input has ended.
    End {
        /// Sample index after the last sample.
        index: u64,
    },
}

/// What a line has for now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// A byte.
    Byte(u8),
    /// Nothing yet.
    Nothing,
    /// Nothing any more.
    Closed,
}

/// Bytes in, one by one.
pub trait ByteSource {
    /// The next byte, if one has come.
    fn next(&mut self) -> Arrival;
}

/// Makes the frames of the line.
#[derive(Clone, Debug, Default)]
pub struct Writer(Encoder);

impl Writer {
    /// The frame of at most [`PACKET_FRAMES`] sample instants; more are left out.
    pub fn samples(&mut self, first_index: u64, frames: &[Frame]) -> &[u8] {
        let frames = frames.iter().take(PACKET_FRAMES).map(crate::sbraw::frame_bytes).collect();
        self.0.frame(&Packet::Samples { first_index, frames })
    }

    /// The frame that ends the input; a sender repeats it, as it may be damaged too.
    pub fn end(&mut self, index: u64) -> &[u8] {
        self.0.frame(&Packet::End { index })
    }
}

/// Reads a line.
#[derive(Debug)]
pub struct Reader<B> {
    bytes: B,
    decoder: Decoder,
    next_index: u64,
    ended: bool,
}

impl<B: ByteSource> Reader<B> {
    /// A reader that has heard nothing yet.
    pub fn new(bytes: B) -> Self {
        Self { bytes, decoder: Decoder::default(), next_index: 0, ended: false }
    }

    /// Frames received, damaged and lost.
    pub fn counters(&self) -> DecoderCounters {
        self.decoder.counters()
    }

    fn take(&mut self, packet: &Packet, frames: &mut [Frame]) -> Option<Chunk> {
        match packet {
            Packet::Samples { first_index, frames: codes } => {
                let mut count = 0;
                for (frame, bytes) in frames.iter_mut().zip(codes) {
                    for (code, bytes) in frame.iter_mut().zip(bytes.as_chunks::<4>().0) {
                        *code = i32::from_le_bytes(*bytes);
                    }
                    count += 1;
                }
                self.next_index = first_index.saturating_add(count as u64);
                (count > 0).then_some(Chunk::Frames { first_index: *first_index, count })
            }
            Packet::End { index } => {
                self.ended = true;
                // Samples lost at the end: the last one is said to be missing, so that the others leave a gap.
                let last = index.checked_sub(1).filter(|last| *last >= self.next_index)?;
                *frames.first_mut()? = [MISSING; CHANNELS];
                Some(Chunk::Frames { first_index: last, count: 1 })
            }
        }
    }
}

impl<B: ByteSource> SampleSource for Reader<B> {
    /// `frames` has room for [`PACKET_FRAMES`] at least.
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        while !self.ended {
            match self.bytes.next() {
                Arrival::Nothing => return Chunk::Idle,
                Arrival::Closed => self.ended = true,
                Arrival::Byte(byte) => {
                    let packet = self.decoder.push::<Packet>(byte);
                    if let Some(chunk) = packet.and_then(|p| self.take(&p.message, frames)) {
                        return chunk;
                    }
                }
            }
        }
        Chunk::End
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Bytes with a pause before each eleventh.
    struct Slice<'a>(&'a [u8], usize);

    impl ByteSource for Slice<'_> {
        fn next(&mut self) -> Arrival {
            self.1 += 1;
            if self.1.is_multiple_of(11) {
                return Arrival::Nothing;
            }
            let Some((byte, rest)) = self.0.split_first() else { return Arrival::Closed };
            self.0 = rest;
            Arrival::Byte(*byte)
        }
    }

    fn line(n: u64) -> (Vec<u8>, Vec<usize>) {
        let mut writer = Writer::default();
        let (mut bytes, mut ends) = (Vec::new(), Vec::new());
        for first in (0..n).step_by(PACKET_FRAMES) {
            let frames: Vec<Frame> =
                (first..n).take(PACKET_FRAMES).map(|i| [i as i32, -(i as i32), 1 << 23, MISSING]).collect();
            bytes.extend_from_slice(writer.samples(first, &frames));
            ends.push(bytes.len());
        }
        for _ in 0..3 {
            bytes.extend_from_slice(writer.end(n));
        }
        (bytes, ends)
    }

    fn read(bytes: &[u8]) -> (Vec<(u64, Frame)>, DecoderCounters) {
        let mut reader = Reader::new(Slice(bytes, 0));
        let mut frames = [[0; 4]; 32];
        let mut out = Vec::new();
        loop {
            match reader.read(&mut frames) {
                Chunk::Frames { first_index, count } => out.extend((first_index..).zip(frames).take(count)),
                Chunk::Idle => {}
                Chunk::End => return (out, reader.counters()),
            }
        }
    }

    #[test]
    fn golden_bytes() {
        // The examples of docs/firmware.md, computed by an independent implementation of that page.
        let mut writer = Writer::default();
        let samples = [
            1, 1, 1, 5, 172, 2, 1, 1, 1, 1, 8, 255, 255, 255, 255, 255, 255, 127, 1, 1, 1, 6, 128, 224, 119,
            244, 255, 0,
        ];
        assert_eq!(writer.samples(300, &[[1, -1, 8_388_607, MISSING]]), samples);
        assert_eq!(writer.end(301), [2, 1, 8, 1, 173, 2, 18, 23, 39, 15, 0]);
    }

    #[test]
    fn samples_come_back_and_a_rate_of_50_hz_takes_less_than_a_kilobyte_a_second() {
        let (bytes, ends) = line(500);
        let (got, counters) = read(&bytes);
        assert!(got.iter().map(|g| g.0).eq(0..500));
        assert!(got.iter().all(|(i, f)| *f == [*i as i32, -(*i as i32), 1 << 23, MISSING]));
        assert_eq!((counters.damaged, counters.lost), (0, 0));
        assert!(ends.last().unwrap() / 10 < 960, "{ends:?}");
    }

    #[test]
    fn a_damaged_frame_costs_its_samples_and_is_counted() {
        let (mut bytes, ends) = line(500);
        bytes[ends[9] + 70] ^= 0x10;
        let (got, counters) = read(&bytes);
        assert!(got.iter().map(|g| g.0).eq((0..80).chain(88..500)));
        assert_eq!((counters.damaged, counters.lost), (1, 1));
        // A whole frame gone, its delimiter included.
        let (mut bytes, ends) = line(500);
        bytes.drain(ends[9]..ends[10]);
        let (got, counters) = read(&bytes);
        assert!(got.iter().map(|g| g.0).eq((0..80).chain(88..500)));
        assert_eq!((counters.damaged, counters.lost), (0, 1));
    }

    #[test]
    fn what_is_lost_at_the_end_is_told_by_the_end() {
        let (mut bytes, ends) = line(500);
        bytes.drain(ends[60]..ends[62]);
        let (got, _) = read(&bytes);
        assert_eq!(got.last(), Some(&(499, [MISSING; 4])));
        assert_eq!(got[got.len() - 2].0, 487);
        // The line closed before any end: what came, came.
        let (got, counters) = read(&bytes[..ends[20] + 50]);
        assert_eq!((got.len(), counters.damaged), (168, 0));
    }

    proptest::proptest! {
        #![proptest_config(seabearing_testkit::property(256))]

        #[test]
        fn noise_on_the_line_invents_nothing(at in 0usize..9000, noise in proptest::collection::vec(proptest::num::u8::ANY, 1..40)) {
            let (mut bytes, _) = line(400);
            let at = at.min(bytes.len() - 40);
            for (b, n) in bytes[at..].iter_mut().zip(&noise) {
                *b ^= n;
            }
            let (got, _) = read(&bytes);
            for (i, f) in &got {
                proptest::prop_assert!(*f == [*i as i32, -(*i as i32), 1 << 23, MISSING] || (*i == 399 && *f == [MISSING; 4]));
            }
            // At most the frames that the noise touches, and the one it may have joined to the next.
            proptest::prop_assert!(got.len() >= 400 - 3 * PACKET_FRAMES);
        }
    }
}
