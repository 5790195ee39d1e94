//! A recording whose reading is watched: a progress bar moves with it, and an interruption ends it.

use crate::recording::BlockSource;
use crate::{interrupt, progress};
use anyhow::Result;
use seabearing_core::block::Block;
use time::OffsetDateTime;

/// A source that moves a progress bar.
pub(super) struct Watched {
    source: Box<dyn BlockSource>,
    pub(super) bar: progress::ProgressBar,
    rate_hz: f64,
}

impl Watched {
    /// A source of so many samples a second.
    pub(super) fn new(source: Box<dyn BlockSource>, rate_hz: f64) -> Self {
        let end_s = source.expected_end().map_or(0, |n| (n as f64 / rate_hz) as u64);
        Self { source, bar: progress::bar(end_s, "processing"), rate_hz }
    }
}

impl BlockSource for Watched {
    fn start(&self) -> Option<OffsetDateTime> {
        self.source.start()
    }

    fn expected_end(&self) -> Option<u64> {
        self.source.expected_end()
    }

    fn is_live(&self) -> bool {
        self.source.is_live()
    }

    fn left_out(&mut self) -> Result<Option<u64>> {
        self.source.left_out()
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        // What was done until an interruption is worth keeping.
        if interrupt::asked() {
            return Ok(None);
        }
        let block = self.source.next_block()?;
        if let Some(block) = &block {
            self.bar.set_position((block.first_index as f64 / self.rate_hz) as u64);
        }
        Ok(block)
    }
}
