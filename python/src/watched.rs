//! A recording that is being read for Python: an interruption ends it, and progress is told.

use anyhow::Result;
use pyo3::prelude::*;
use seabearing_core::block::Block;
use seabearing_host::recording::BlockSource;
use std::time::{Duration, Instant};
use time::OffsetDateTime;

/// How often Python is asked whether it was interrupted, and told how far the work is.
const EVERY: Duration = Duration::from_millis(200);

/// A source, and who is told of its progress: a function of the share that is done, where that is known.
pub struct Watched {
    source: Box<dyn BlockSource>,
    progress: Option<Py<PyAny>>,
    asked: Instant,
    at: u64,
}

impl Watched {
    /// Watches a source.
    pub fn new(source: Box<dyn BlockSource>, progress: Option<Py<PyAny>>) -> Self {
        Self { source, progress, asked: Instant::now(), at: 0 }
    }

    fn tell(&self, share: Option<f64>) -> PyResult<()> {
        Python::attach(|py| {
            py.check_signals()?;
            match self.progress.as_ref().zip(share) {
                Some((progress, share)) => progress.call1(py, (share,)).map(|_| ()),
                None => Ok(()),
            }
        })
    }
}

impl BlockSource for Watched {
    fn start(&self) -> Option<OffsetDateTime> {
        self.source.start()
    }

    fn expected_end(&self) -> Option<u64> {
        self.source.expected_end()
    }

    fn left_out(&mut self) -> Result<Option<u64>> {
        self.source.left_out()
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        if self.asked.elapsed() >= EVERY {
            self.asked = Instant::now();
            let end = self.source.expected_end().filter(|end| *end > 0);
            self.tell(end.map(|end| (self.at as f64 / end as f64).min(1.0)))?;
        }
        let block = self.source.next_block()?;
        if let Some(block) = &block {
            self.at = block.first_index + block.frames.len() as u64;
        }
        Ok(block)
    }
}
