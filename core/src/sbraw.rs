//! The `.sbraw` stream: raw converter codes with their sample indices, so that gaps can be expressed.
//!
//! ```text
//! stream = "SBRAW1\0\0" record*
//! record = first_index:u64le count:u32le frame[count]
//! frame  = code:i32le × 4, in recorder channel order
//! ```
//! It may be a file or a FIFO; it ends where the bytes end. The reader turns it into the [`SampleSource`] of the
//! emulated firmware and of the host's twin alike.

use crate::block::{CHANNELS, Frame};
use crate::port::{Chunk, SampleSource};

/// First bytes of every stream.
pub const MAGIC: [u8; 8] = *b"SBRAW1\0\0";
/// Bytes of a frame.
pub const FRAME_BYTES: usize = CHANNELS * 4;
/// Bytes of a record before its frames.
pub const RECORD_HEAD: usize = 12;
/// Frames converted at a time: 1 KiB of the emulated recorder's stack.
const BATCH: usize = 64;

/// Bytes in: a file or a FIFO.
pub trait ReadBytes {
    /// Fills as much of `bytes` as there is before the end of the stream; the number of bytes filled.
    fn read(&mut self, bytes: &mut [u8]) -> usize;
}

/// How a stream ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Still running.
    Open,
    /// At a record's end.
    Clean,
    /// The stream does not begin with [`MAGIC`].
    NotSbraw,
    /// Within a record: whole frames before the cut were delivered.
    Truncated,
}

/// Reads a stream.
#[derive(Debug)]
pub struct Reader<R> {
    bytes: R,
    started: bool,
    next_index: u64,
    left: u32,
    ending: Ending,
    batch: [u8; BATCH * FRAME_BYTES],
}

impl<R: ReadBytes> Reader<R> {
    /// A reader at the start of a stream.
    pub const fn new(bytes: R) -> Self {
        Self {
            bytes,
            started: false,
            next_index: 0,
            left: 0,
            ending: Ending::Open,
            batch: [0; BATCH * FRAME_BYTES],
        }
    }

    /// How the stream ended, once [`Chunk::End`] was returned.
    pub fn ending(&self) -> Ending {
        self.ending
    }

    /// Where the bytes come from.
    pub fn bytes(&mut self) -> &mut R {
        &mut self.bytes
    }

    fn start_record(&mut self) {
        let mut head = [0u8; RECORD_HEAD];
        let n = self.bytes.read(&mut head);
        match (n, head.split_first_chunk::<8>()) {
            (0, _) => self.ending = Ending::Clean,
            (RECORD_HEAD, Some((index, count))) => {
                self.next_index = u64::from_le_bytes(*index);
                self.left = count.first_chunk::<4>().map_or(0, |c| u32::from_le_bytes(*c));
            }
            _ => self.ending = Ending::Truncated,
        }
    }
}

impl<R: ReadBytes> SampleSource for Reader<R> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        if !self.started {
            self.started = true;
            let mut magic = [0u8; MAGIC.len()];
            if self.bytes.read(&mut magic) != magic.len() || magic != MAGIC {
                self.ending = Ending::NotSbraw;
            }
        }
        while self.left == 0 && self.ending == Ending::Open {
            self.start_record();
        }
        if self.ending != Ending::Open {
            return Chunk::End;
        }
        let first_index = self.next_index;
        let mut count = 0usize;
        for part in frames.chunks_mut(BATCH) {
            let want = part.len().min(self.left as usize);
            let Some(bytes) = self.batch.get_mut(..want * FRAME_BYTES) else { break };
            let got = self.bytes.read(bytes) / FRAME_BYTES;
            let (frames_read, _) = bytes.as_chunks::<FRAME_BYTES>();
            for (frame, bytes) in part.iter_mut().zip(frames_read).take(got) {
                let (codes, _) = bytes.as_chunks::<4>();
                for (code, bytes) in frame.iter_mut().zip(codes) {
                    *code = i32::from_le_bytes(*bytes);
                }
            }
            count += got;
            self.left = self.left.saturating_sub(got as u32);
            self.next_index = self.next_index.wrapping_add(got as u64);
            if got < want {
                self.ending = Ending::Truncated;
            }
            if got < BATCH {
                break;
            }
        }
        if count == 0 { Chunk::End } else { Chunk::Frames { first_index, count } }
    }
}

/// The head of a stream's record of `count` frames.
pub fn record_head(first_index: u64, count: u32) -> [u8; RECORD_HEAD] {
    let mut head = [0u8; RECORD_HEAD];
    let bytes = first_index.to_le_bytes().into_iter().chain(count.to_le_bytes());
    for (to, from) in head.iter_mut().zip(bytes) {
        *to = from;
    }
    head
}

/// One frame as it stands in a record.
pub fn frame_bytes(frame: &Frame) -> [u8; FRAME_BYTES] {
    let mut out = [0u8; FRAME_BYTES];
    for (to, code) in out.as_chunks_mut::<4>().0.iter_mut().zip(frame) {
        *to = code.to_le_bytes();
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    struct Slice<'a>(&'a [u8]);

    impl ReadBytes for Slice<'_> {
        fn read(&mut self, bytes: &mut [u8]) -> usize {
            let n = bytes.len().min(self.0.len());
            bytes[..n].copy_from_slice(&self.0[..n]);
            self.0 = &self.0[n..];
            n
        }
    }

    fn stream(records: &[(u64, u32)]) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        for &(first, count) in records {
            out.extend(record_head(first, count));
            for i in first..first + u64::from(count) {
                out.extend(frame_bytes(&[i as i32, -(i as i32), 7, i32::MIN]));
            }
        }
        out
    }

    fn read_all(bytes: &[u8], buffer: usize) -> (Vec<u64>, Ending) {
        let mut reader = Reader::new(Slice(bytes));
        let mut frames = std::vec![[0; 4]; buffer];
        let mut indices = Vec::new();
        while let Chunk::Frames { first_index, count } = reader.read(&mut frames) {
            for (i, f) in frames[..count].iter().enumerate() {
                let index = first_index + i as u64;
                assert_eq!(*f, [index as i32, -(index as i32), 7, i32::MIN]);
                indices.push(index);
            }
        }
        (indices, reader.ending())
    }

    #[test]
    fn records_gaps_and_batches_come_back() {
        let bytes = stream(&[(0, 700), (0, 0), (1000, 3)]);
        for buffer in [1, 3, 256, 300, 512, 4096] {
            let (indices, ending) = read_all(&bytes, buffer);
            assert_eq!(ending, Ending::Clean);
            assert!(indices.into_iter().eq((0..700).chain(1000..1003)), "buffer {buffer}");
        }
    }

    #[test]
    fn a_cut_keeps_the_whole_frames_before_it() {
        let bytes = stream(&[(5, 40)]);
        let (indices, ending) = read_all(&bytes[..bytes.len() - 20], 16);
        assert_eq!(ending, Ending::Truncated);
        assert!(indices.into_iter().eq(5..43));
        assert_eq!(read_all(&bytes[..15], 16).1, Ending::Truncated);
        assert_eq!(read_all(b"RIFFxxxxxxxx", 16).1, Ending::NotSbraw);
        assert_eq!(read_all(b"", 16).1, Ending::NotSbraw);
    }
}
