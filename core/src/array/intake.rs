//! Continuity: blocks of any length become frames of [`FRAME`] samples; every sample instant ends in one bucket.
//!
//! Enters: `Block`s. Leaves: full frames of channel-major codes, with the index of their first sample. Index jumps,
//! repeats and [`MISSING`] codes end a run; the next frame starts afresh after them, so no frame spans a break.
//! Cost: about 20 instructions a sample instant.

use super::plan::{FRAME, HOP};
use crate::block::{CHANNELS, Frame, MISSING};
use crate::health::{Accounting, LossCause};

/// An index that goes back by more than this many samples is a restart of the source's count, not a repeat.
pub(crate) const RESTART_SAMPLES: u64 = 1 << 18;

/// What aligning a block with the samples before it found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Alignment {
    /// The block continues the run, or is the first.
    Continues,
    /// So many instants are missing before the block.
    Gap(u64),
    /// So many of the block's first instants are repeats.
    Overlap(u64),
    /// The source's count went far back by so many: time starts again at the block's index.
    Restart(u64),
}

/// The run of samples being framed.
#[derive(Clone, Debug)]
pub(crate) struct Intake {
    /// Codes of the frame being filled, one row a channel (recorder order).
    pub(crate) codes: [[i32; FRAME]; CHANNELS],
    /// Instants in `codes`.
    filled: usize,
    /// Index after the last instant seen.
    next: u64,
    /// Whether any instant was seen.
    started: bool,
    /// Instants of the buffer, from its start, already in a bucket.
    settled: usize,
    /// All instants so far.
    pub(crate) accounting: Accounting,
}

impl Intake {
    pub(crate) const fn new() -> Self {
        Self {
            codes: [[0; FRAME]; CHANNELS],
            filled: 0,
            next: 0,
            started: false,
            settled: 0,
            accounting: Accounting { processed: 0, lost: [0; crate::health::LOSS_CAUSES] },
        }
    }

    /// Index after the last instant seen.
    pub(crate) fn next_index(&self) -> u64 {
        self.next
    }

    /// Index of the first sample of the buffered frame.
    pub(crate) fn frame_index(&self) -> u64 {
        self.next.saturating_sub(self.filled as u64)
    }

    /// Compares a block's index with the samples before it, ends the run where they do not join, and counts.
    pub(crate) fn align(&mut self, first_index: u64, length: usize) -> Alignment {
        if length == 0 {
            return Alignment::Continues;
        }
        if !self.started {
            self.started = true;
            self.next = first_index;
            return Alignment::Continues;
        }
        if first_index > self.next {
            let missing = first_index - self.next;
            self.end_run();
            self.accounting.lose(LossCause::Gap, missing);
            self.next = first_index;
            return Alignment::Gap(missing);
        }
        let back = self.next - first_index;
        if back == 0 {
            Alignment::Continues
        } else if back > RESTART_SAMPLES {
            self.end_run();
            self.next = first_index;
            Alignment::Restart(back)
        } else {
            let repeated = back.min(length as u64);
            self.accounting.lose(LossCause::Overlap, repeated);
            Alignment::Overlap(repeated)
        }
    }

    /// Takes instants up to the end of the frame or the first missing one; returns how many.
    pub(crate) fn take(&mut self, frames: &[Frame]) -> usize {
        let [c0, c1, c2, c3] = &mut self.codes;
        let from = self.filled.min(FRAME);
        let room = c0[from..].iter_mut().zip(&mut c1[from..]).zip(&mut c2[from..]).zip(&mut c3[from..]);
        let mut taken = 0;
        for ((((a, b), c), d), frame) in room.zip(frames) {
            let [x0, x1, x2, x3] = *frame;
            if x0 == MISSING || x1 == MISSING || x2 == MISSING || x3 == MISSING {
                break;
            }
            (*a, *b, *c, *d) = (x0, x1, x2, x3);
            taken += 1;
        }
        self.filled += taken;
        self.next = self.next.saturating_add(taken as u64);
        taken
    }

    /// Whether a frame is ready.
    pub(crate) fn full(&self) -> bool {
        self.filled >= FRAME
    }

    /// Passes over leading missing instants, which end the run; returns how many.
    pub(crate) fn skip_missing(&mut self, frames: &[Frame]) -> usize {
        let missing = frames.iter().take_while(|f| f.contains(&MISSING)).count();
        if missing > 0 {
            self.end_run();
            self.accounting.lose(LossCause::Invalid, missing as u64);
            self.next = self.next.saturating_add(missing as u64);
        }
        missing
    }

    /// Settles the full frame's instants (used, or lost to a cause) and keeps its overlap for the next.
    pub(crate) fn advance(&mut self, lost: Option<LossCause>) {
        match lost {
            None => {
                self.accounting.processed =
                    self.accounting.processed.saturating_add((FRAME - self.settled.min(FRAME)) as u64);
                self.settled = FRAME;
            }
            // The overlap still has a chance in the next frame.
            Some(cause) => {
                self.accounting.lose(cause, HOP.saturating_sub(self.settled) as u64);
                self.settled = self.settled.max(HOP);
            }
        }
        for channel in &mut self.codes {
            channel.copy_within(HOP.., 0);
        }
        self.filled = FRAME - HOP;
        self.settled = self.settled.saturating_sub(HOP);
    }

    /// Ends the run: what has not filled a frame is a remainder.
    pub(crate) fn end_run(&mut self) {
        self.accounting.lose(LossCause::Remainder, self.filled.saturating_sub(self.settled) as u64);
        self.filled = 0;
        self.settled = 0;
    }
}
