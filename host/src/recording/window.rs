//! A span of time, and the part of a recording that lies in it.

use super::BlockSource;
use anyhow::Result;
use seabearing_core::block::{Block, Frame};
use time::{Duration, OffsetDateTime};

/// From a moment to before another; open where there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// The first moment.
    pub from: Option<OffsetDateTime>,
    /// The first moment after.
    pub to: Option<OffsetDateTime>,
}

impl Span {
    /// Whether something recorded between two moments is in it in part.
    pub fn meets(self, (begins, ends): (OffsetDateTime, OffsetDateTime)) -> bool {
        self.from.is_none_or(|from| ends > from) && self.to.is_none_or(|to| begins < to)
    }

    /// Whether it has no bounds.
    pub fn is_all(self) -> bool {
        self == Self::default()
    }
}

impl std::fmt::Display for Span {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let time = crate::record::utc;
        match (self.from, self.to) {
            (Some(from), Some(to)) => write!(f, "from {} to {}", time(from), time(to)),
            (Some(from), None) => write!(f, "from {} on", time(from)),
            (None, Some(to)) => write!(f, "before {}", time(to)),
            (None, None) => Ok(()),
        }
    }
}

/// What a source gives between two of its indices; the first becomes index 0.
pub(super) struct Window {
    source: Box<dyn BlockSource>,
    from: u64,
    to: u64,
    start: Option<OffsetDateTime>,
    frames: Vec<Frame>,
}

/// The first index at or after a moment.
pub(super) fn index_at(start: OffsetDateTime, at: OffsetDateTime, rate_hz: f64) -> u64 {
    // Times are told to a nanosecond; what is closer to a sample than a thousandth of one is that sample.
    ((at - start).as_seconds_f64() * rate_hz - 1e-3).ceil().max(0.0) as u64
}

impl Window {
    /// The part of a source, whose sample 0 was at `start`, that lies in a span.
    pub(super) fn new(source: Box<dyn BlockSource>, start: OffsetDateTime, rate_hz: f64, span: Span) -> Self {
        let from = span.from.map_or(0, |at| index_at(start, at, rate_hz));
        let to = span.to.map_or(u64::MAX, |at| index_at(start, at, rate_hz));
        let since = Duration::checked_seconds_f64(from as f64 / rate_hz).unwrap_or_default();
        Self { source, from, to, start: start.checked_add(since), frames: Vec::new() }
    }
}

impl BlockSource for Window {
    fn start(&self) -> Option<OffsetDateTime> {
        self.start
    }

    fn expected_end(&self) -> Option<u64> {
        self.source.expected_end().map(|end| end.min(self.to).saturating_sub(self.from))
    }

    fn is_live(&self) -> bool {
        self.source.is_live()
    }

    fn left_out(&mut self) -> Result<Option<u64>> {
        let until = self.source.left_out()?.map(|until| until.min(self.to));
        Ok(until.filter(|until| *until > self.from).map(|until| until - self.from))
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        loop {
            let Some(block) = self.source.next_block()? else { return Ok(None) };
            let (first, n) = (block.first_index, block.frames.len() as u64);
            if first >= self.to {
                return Ok(None);
            }
            let (a, b) = (self.from.saturating_sub(first).min(n), (self.to - first).min(n));
            if a < b {
                self.frames.clear();
                self.frames.extend_from_slice(block.frames.get(a as usize..b as usize).unwrap_or(&[]));
                return Ok(Some(Block { first_index: first + a - self.from, frames: &self.frames }));
            }
        }
    }
}
