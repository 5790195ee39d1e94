//! A meter on a thread of its own, a few blocks behind what else is done with them.
//!
//! Enters: blocks, and what the recorder said of each. Leaves: what was said and measured, in the order of the blocks, so
//! that nothing hangs on which thread is the faster one.

use super::Meter;
use crate::record::Level;
use anyhow::{Context, Result};
use seabearing_core::block::{Block, Frame};
use seabearing_core::wire::Message;
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::Scope;

/// Most blocks on their way: a block of 16 384 instants is 256 KiB, and what is on its way should stay in the cache.
const AHEAD: usize = 3;

/// A block's samples: index of the first, and all.
type Samples = (u64, Vec<Frame>);

/// Levels measured, each with the index at which its interval begins.
type Levels = Vec<(u64, Level)>;

/// A meter at work.
pub struct Beside {
    to: Sender<Samples>,
    from: Receiver<(Levels, Vec<Frame>)>,
    /// What was measured and not asked for yet.
    measured: VecDeque<Levels>,
    /// What was said of the blocks that are not measured yet.
    said: VecDeque<Vec<Message>>,
    on_its_way: usize,
    spare: Vec<Vec<Frame>>,
}

impl Beside {
    /// Puts a meter to work, until the last block was measured.
    pub fn begin<'scope>(scope: &'scope Scope<'scope, '_>, meter: &'scope mut Meter) -> Self {
        let ((to, blocks), (done, from)) = (channel::<Samples>(), channel());
        scope.spawn(move || {
            for (first_index, frames) in blocks {
                meter.push(Block { first_index, frames: &frames });
                // Nobody listens any more where the work was given up.
                if done.send((meter.take(), frames)).is_err() {
                    return;
                }
            }
            meter.finish();
            let _ = done.send((meter.take(), Vec::new()));
        });
        let (measured, said) = (VecDeque::new(), VecDeque::new());
        Self { to, from, measured, said, on_its_way: 0, spare: Vec::new() }
    }

    /// Takes a block; waits where too many are on their way.
    ///
    /// # Errors
    /// The thread has ended.
    pub fn measure(&mut self, block: Block<'_>) -> Result<()> {
        while self.on_its_way >= AHEAD {
            let done = self.from.recv().context("levels are measured no longer")?;
            self.take(done);
        }
        let mut frames = self.spare.pop().unwrap_or_default();
        frames.clear();
        frames.extend_from_slice(block.frames);
        self.on_its_way += 1;
        self.to.send((block.first_index, frames)).context("levels are measured no longer")
    }

    /// Takes what was said of the newest block; delivers what is complete.
    ///
    /// # Errors
    /// What `deliver` says.
    pub fn said(
        &mut self,
        messages: &mut Vec<Message>,
        deliver: &mut impl FnMut(&mut Vec<Message>, Levels) -> Result<()>,
    ) -> Result<()> {
        self.said.push_back(std::mem::take(messages));
        while let Ok(done) = self.from.try_recv() {
            self.take(done);
        }
        self.deliver(deliver)
    }

    /// The last block was measured: delivers all that was said; returns the levels of the interval that has begun.
    ///
    /// # Errors
    /// What `deliver` says.
    pub fn end(
        mut self,
        deliver: &mut impl FnMut(&mut Vec<Message>, Levels) -> Result<()>,
    ) -> Result<Levels> {
        drop(std::mem::replace(&mut self.to, channel().0));
        while let Ok(done) = self.from.recv() {
            self.take(done);
        }
        self.deliver(deliver)?;
        Ok(self.measured.pop_front().unwrap_or_default())
    }

    fn take(&mut self, (levels, frames): (Levels, Vec<Frame>)) {
        self.measured.push_back(levels);
        self.spare.push(frames);
        self.on_its_way = self.on_its_way.saturating_sub(1);
    }

    fn deliver(&mut self, deliver: &mut impl FnMut(&mut Vec<Message>, Levels) -> Result<()>) -> Result<()> {
        while !self.said.is_empty() && !self.measured.is_empty() {
            let (messages, levels) = (self.said.pop_front(), self.measured.pop_front());
            deliver(&mut messages.unwrap_or_default(), levels.unwrap_or_default())?;
        }
        Ok(())
    }
}
