//! The sending end of the sample line: blocks as frames on a serial line, at the rate the converter would give them.

use anyhow::Result;
use seabearing_core::block::Block;
use seabearing_core::sample_line::{PACKET_FRAMES, Writer};
use std::io::Write;
use std::time::{Duration, Instant};

/// How often the end is said: a damaged one is followed by another.
const ENDS: usize = 3;

/// When samples are sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SendTiming {
    /// As fast as the line takes them.
    Free,
    /// Each when the converter would have it, time running so many times as fast (1: real time).
    Times(f64),
}

/// Sends samples.
pub struct Sender<'a> {
    out: &'a mut dyn Write,
    writer: Writer,
    pace: SendTiming,
    rate_hz: f64,
    begun: Option<(Instant, u64)>,
    next_index: u64,
}

impl<'a> Sender<'a> {
    /// A sender of samples at a rate.
    pub fn new(out: &'a mut dyn Write, rate_hz: f64, pace: SendTiming) -> Self {
        Self { out, writer: Writer::default(), pace, rate_hz, begun: None, next_index: 0 }
    }

    /// Sends a block, waiting for the time of its samples.
    ///
    /// # Errors
    /// The reader has gone.
    pub fn block(&mut self, block: Block<'_>) -> Result<()> {
        for (n, frames) in block.frames.chunks(PACKET_FRAMES).enumerate() {
            let first_index = block.first_index + (n * PACKET_FRAMES) as u64;
            self.next_index = first_index + frames.len() as u64;
            self.wait();
            self.out.write_all(self.writer.samples(first_index, frames))?;
        }
        Ok(())
    }

    /// Says that the input has ended.
    ///
    /// # Errors
    /// The reader has gone.
    pub fn end(mut self) -> Result<()> {
        for _ in 0..ENDS {
            self.out.write_all(self.writer.end(self.next_index))?;
        }
        Ok(self.out.flush()?)
    }

    /// Until the last sample of the next packet would have been converted.
    fn wait(&mut self) {
        let SendTiming::Times(times) = self.pace else { return };
        let (begun, first) = *self.begun.get_or_insert((Instant::now(), self.next_index));
        let due = (self.next_index - first.min(self.next_index)) as f64 / (self.rate_hz * times);
        if let Some(left) = Duration::from_secs_f64(due).checked_sub(begun.elapsed()) {
            std::thread::sleep(left);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::sample_line::Packet;
    use seabearing_core::wire::Decoder;

    #[test]
    fn a_block_becomes_packets_in_order_and_the_end_is_repeated() {
        let mut bytes = Vec::new();
        let mut sender = Sender::new(&mut bytes, 50.0, SendTiming::Times(1e6));
        sender.block(Block { first_index: 100, frames: &[[1, 2, 3, 4]; 21] }).unwrap();
        sender.end().unwrap();
        let mut decoder = Decoder::default();
        let packets: Vec<Packet> = bytes.iter().filter_map(|b| decoder.push(*b).map(|r| r.message)).collect();
        let firsts: Vec<_> = packets
            .iter()
            .map(|p| match p {
                Packet::Samples { first_index, frames } => (*first_index, frames.len()),
                Packet::End { index } => (*index, 0),
            })
            .collect();
        assert_eq!(firsts, [(100, 8), (108, 8), (116, 5), (121, 0), (121, 0), (121, 0)]);
    }
}
