//! Samples that are in memory already, as a recording: what a notebook has at hand.

use super::BlockSource;
use anyhow::Result;
use seabearing_core::block::{Block, Frame};
use std::sync::Arc;
use time::OffsetDateTime;

/// Frames of a block.
const FRAMES: usize = 16_384;

/// Frames, and how far they have been read.
pub(super) struct Memory {
    frames: Arc<[Frame]>,
    at: usize,
    start: Option<OffsetDateTime>,
}

impl Memory {
    /// Frames of which the first was at `start`, where that is known.
    pub(super) fn new(frames: Arc<[Frame]>, start: Option<OffsetDateTime>) -> Self {
        Self { frames, at: 0, start }
    }
}

impl BlockSource for Memory {
    fn start(&self) -> Option<OffsetDateTime> {
        self.start
    }

    fn expected_end(&self) -> Option<u64> {
        Some(self.frames.len() as u64)
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        let (first, end) = (self.at, (self.at + FRAMES).min(self.frames.len()));
        self.at = end;
        let block = |frames| Block { first_index: first as u64, frames };
        Ok(self.frames.get(first..end).filter(|frames| !frames.is_empty()).map(block))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_frames_come_once_and_in_order() {
        let frames: Arc<[Frame]> = (0..40_000).map(|n| [n, -n, 1, 2]).collect();
        let mut memory = Memory::new(Arc::clone(&frames), None);
        let mut came = Vec::new();
        while let Some(block) = memory.next_block().unwrap() {
            assert_eq!(block.first_index, came.len() as u64);
            came.extend_from_slice(block.frames);
        }
        assert_eq!(came[..], frames[..]);
        assert!(Memory::new(Arc::new([]), None).next_block().unwrap().is_none());
    }
}
