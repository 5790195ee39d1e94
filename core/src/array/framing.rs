//! Frames of [`FRAME`] samples out of runs, each overlapping the one before; every instant ends in one bucket.
//!
//! Enters: [`Run`]s. Leaves: full frames of channel-major codes with the index of their first sample, and a [`Look`] at
//! them. No frame spans an event. Cost: about 9 instructions a sample instant.

use super::plan::{FRAME, HOP};
use crate::block::{CHANNELS, Frame};
use crate::health::{Accounting, LossCause};
use crate::intake::{Look, Run};

/// Instants a frame shares with the one before, and with the next.
const SHARED: usize = FRAME - HOP;

/// The frame being filled.
#[derive(Clone, Debug)]
pub(crate) struct Framing {
    /// Codes, one row a channel (recorder order).
    pub(crate) codes: [[i32; FRAME]; CHANNELS],
    /// Instants in `codes`.
    filled: usize,
    /// Index after the last instant taken.
    next: u64,
    /// What the instants show: those shared with the frame before, those of this frame alone, those shared with the next.
    looks: [Look; 3],
    /// Whether the instants shared with the frame before are in a bucket.
    settled: bool,
}

impl Framing {
    pub(crate) const fn new() -> Self {
        Self { codes: [[0; FRAME]; CHANNELS], filled: 0, next: 0, looks: [Look::NEW; 3], settled: false }
    }

    /// Forgets everything, in place.
    pub(crate) fn forget(&mut self) {
        self.filled = 0;
        self.next = 0;
        self.looks = [Look::NEW; 3];
        self.settled = false;
    }

    /// Index of the first sample of the frame.
    pub(crate) fn index(&self) -> u64 {
        self.next.saturating_sub(self.filled as u64)
    }

    /// Whether the frame is full.
    pub(crate) fn full(&self) -> bool {
        self.filled >= FRAME
    }

    /// Takes from a run's `frames` up to where a part of the frame ends; returns what is left.
    pub(crate) fn take<'a>(&mut self, run: &Run<'_>, frames: &'a [Frame], clip: i32) -> &'a [Frame] {
        let [before, own, after] = &mut self.looks;
        let (look, end) = match self.filled {
            n if n < SHARED => (before, SHARED),
            n if n < HOP => (own, HOP),
            _ => (after, FRAME),
        };
        let (now, later) = frames.split_at_checked(end.saturating_sub(self.filled)).unwrap_or((frames, &[]));
        look.see(run, now, clip);
        let from = self.filled.min(FRAME);
        let [a, b, c, d] = self.codes.each_mut().map(|channel| &mut channel[from..]);
        // Four instants at a time, which share what a turn of the loop takes.
        let (fours, rest) = now.as_chunks::<4>();
        let done = 4 * fours.len();
        let rows = a.as_chunks_mut().0.iter_mut().zip(b.as_chunks_mut().0);
        let rows = rows.zip(c.as_chunks_mut().0).zip(d.as_chunks_mut().0);
        for ((((a, b), c), d), [first, second, third, fourth]) in rows.zip(fours) {
            let ([a0, b0, c0, d0], [a1, b1, c1, d1]) = (*first, *second);
            let ([a2, b2, c2, d2], [a3, b3, c3, d3]) = (*third, *fourth);
            (*a, *b, *c, *d) = ([a0, a1, a2, a3], [b0, b1, b2, b3], [c0, c1, c2, c3], [d0, d1, d2, d3]);
        }
        for (at, frame) in (done..).zip(rest) {
            for (channel, code) in [&mut *a, b, c, d].into_iter().zip(frame) {
                if let Some(place) = channel.get_mut(at) {
                    *place = *code;
                }
            }
        }
        self.filled += now.len();
        // `frames` is the end of the run.
        self.next = run.first_index.saturating_add(run.frames.len().saturating_sub(later.len()) as u64);
        later
    }

    /// What the full frame shows.
    pub(crate) fn look(&self) -> Look {
        let [before, own, after] = &self.looks;
        before.joined(own).joined(after)
    }

    /// Settles the full frame's instants (used, or lost to a cause) and keeps what the next shares.
    pub(crate) fn advance(&mut self, lost: Option<LossCause>, accounting: &mut Accounting) {
        let [before, own, after] = self.looks;
        let open = own.open() + if self.settled { 0 } else { before.open() };
        match lost {
            None => accounting.processed = accounting.processed.saturating_add(open + after.open()),
            // What the next frame shares still has a chance there.
            Some(cause) => accounting.lose(cause, open),
        }
        self.settled = lost.is_none();
        for channel in &mut self.codes {
            channel.copy_within(HOP.., 0);
        }
        self.filled = SHARED;
        self.looks = [after, Look::NEW, Look::NEW];
    }

    /// Ends the run: what has not filled a frame is a remainder.
    pub(crate) fn end(&mut self, accounting: &mut Accounting) {
        let [before, own, after] = self.looks;
        let open = own.open() + after.open() + if self.settled { 0 } else { before.open() };
        accounting.lose(LossCause::Remainder, open);
        self.filled = 0;
        self.settled = false;
        self.looks = [Look::NEW; 3];
    }
}
