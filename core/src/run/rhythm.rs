//! How the loop keeps the recorder's schedule: what of each block is heard, and the seconds of a pause.

use super::{Application, MOST_AT_ONCE_S};
use crate::block::Block;
use crate::config::Schedule;
use crate::port::SampleSource;
use crate::schedule::Stretches;
use crate::wire::Message;

/// The recorder's schedule as the loop keeps it.
pub(super) struct Rhythm {
    pub stretches: Stretches,
    /// Index after the last sample that came.
    pub index: u64,
    /// Seconds of a pause that were told.
    told_s: u32,
    /// First index of the pause, where it pauses.
    since: Option<u64>,
}

impl Rhythm {
    /// Of a schedule, at so many samples a second; nothing has come yet.
    pub fn new((schedule, rate_hz): (Schedule, f64)) -> Self {
        Self { stretches: Stretches::new(schedule, rate_hz), index: 0, told_s: 0, since: None }
    }

    /// The front of a block, which is heard or left out as a whole, and the rest.
    pub fn part<'a>(&mut self, block: Block<'a>) -> (Option<Block<'a>>, Block<'a>) {
        let Block { first_index, frames } = block;
        let (count, listens) = self.stretches.next(first_index, frames.len());
        let (front, rest) = frames.split_at_checked(count).unwrap_or((frames, &[]));
        self.index = first_index.saturating_add(front.len() as u64);
        if listens {
            (self.told_s, self.since) = (0, None);
        } else {
            self.since.get_or_insert(first_index);
        }
        (
            listens.then_some(Block { first_index, frames: front }),
            Block { first_index: self.index, frames: rest },
        )
    }

    /// Tells the recorder and its source of a pause that begins, goes on for longer, or ends before its time.
    pub fn tell(
        &mut self,
        application: &mut impl Application,
        source: &mut impl SampleSource,
        sink: &mut impl FnMut(&Message),
    ) {
        if let Some(until) = self.stretches.begun() {
            application.pause(until, sink);
            source.rest(self.since.unwrap_or(until)..until);
        }
    }

    /// The next second of a pause that has gone by and was not told.
    pub fn second(&mut self, index: u64) -> Option<u32> {
        let paused_s = self.stretches.paused_s(index);
        (self.told_s < paused_s).then(|| {
            // An index that leaps is no long pause.
            self.told_s = self.told_s.max(paused_s.saturating_sub(MOST_AT_ONCE_S)) + 1;
            self.told_s
        })
    }
}
