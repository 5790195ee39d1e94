//! The hardware boundary: what a board (or the host) must offer for a recorder to run.
//!
//! The estimators never call these; [`crate::run::run`] does, and it is the same code on the target and on the host.

use crate::block::Frame;
use crate::utc::Pair;
use crate::wire::{FaultCode, Margins, Time};

/// What a [`SampleSource`] has for now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chunk {
    /// The first `count` frames of the buffer were filled; the first has this sample index.
    Frames {
        /// Sample index of the first frame.
        first_index: u64,
        /// Number of frames, at most the buffer's length.
        count: usize,
    },
    /// Nothing yet; ask again after the supervisor has idled.
    Idle,
    /// The input has ended.
    End,
}

/// Samples in.
pub trait SampleSource {
    /// Fills the front of `frames` with samples that follow each other without a gap.
    fn read(&mut self, frames: &mut [Frame]) -> Chunk;

    /// Whether samples not read now come later all the same: from a file, not from a converter.
    fn waits(&self) -> bool {
        false
    }

    /// Something about the source that the samples do not tell, once: a fault and its number.
    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        None
    }

    /// These samples are not wanted.
    fn rest(&mut self, _samples: core::ops::Range<u64>) {}

    /// A vessel was heard about this sample: for a source that keeps its sound.
    fn heard(&mut self, _index: u64) {}

    /// UTC is known so from now on: for a source whose clock outlasts the recorder.
    fn told(&mut self, _time: &Time) {}

    /// How long ago this sample was heard, µs: the next to be given, or one before it; `None` while a converter stands still, so that
    /// nobody knows when the next sample will have been.
    fn age_us(&mut self, _index: u64) -> Option<u64> {
        Some(0)
    }

    /// A sample's index and its UTC, once, where the source hears a clock that knows UTC.
    fn pair(&mut self) -> Option<Pair> {
        None
    }
}

/// Telemetry out and commands in: a serial line.
pub trait Link {
    /// Sends one whole frame, or none of it: `false` if the line cannot take it now.
    fn send(&mut self, frame: &[u8]) -> bool;

    /// The next byte received, if there is one.
    fn receive(&mut self) -> Option<u8>;
}

/// The board's clock: it measures work, notices a silent source and paces a link; no result depends on it.
pub trait Clock {
    /// Ticks since some moment, wrapping.
    fn ticks(&mut self) -> u32;

    /// Whole seconds since some moment, wrapping; asked for at least once a second while no samples come (so
    /// [`Supervisor::idle`] must return that often). A clock that stands still notices nothing.
    fn seconds(&mut self) -> u32;

    /// Microseconds since some moment, as finely as the board knows them: when a link sends depends on them.
    fn micros(&mut self) -> u64 {
        u64::from(self.seconds()) * 1_000_000
    }
}

/// What the loop knows of its own margins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Sample index after the last sample seen.
    pub index: u64,
    /// Most ticks of the clock that one block took.
    pub longest_ticks: u32,
    /// Records that wait for the base station, and how many there is room for; 0 without a link.
    pub waiting: (u32, u32),
}

/// Watchdog, idling, and the reason of the last start.
pub trait Supervisor {
    /// The loop is alive: called once a block, and while idle.
    fn feed(&mut self);

    /// Waits until something may have happened, at most a second.
    fn idle(&mut self);

    /// Why the recorder last started, as in [`crate::wire::Hello::reset_cause`].
    fn reset_cause(&self) -> u8;

    /// What had ended the software before this start, if it had: [`FaultCode::Panicked`] or [`FaultCode::HardFault`], and
    /// the number that goes with it.
    fn last_fault(&mut self) -> Option<(FaultCode, i64)>;

    /// Something about the board that ends nothing, once: a fault and its number.
    fn fault(&mut self) -> Option<(FaultCode, i64)> {
        None
    }

    /// What the board has left besides `load`, where it can measure that: asked for after each [`crate::wire::Health`].
    fn margins(&mut self, _load: &Load) -> Option<Margins> {
        None
    }

    /// Whether what made the recorder wait is over, so that it may begin again without being told to.
    fn over(&mut self) -> bool {
        false
    }
}

/// A clock that stands still, for where nothing is measured.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoClock;

impl Clock for NoClock {
    fn ticks(&mut self) -> u32 {
        0
    }

    fn seconds(&mut self) -> u32 {
        0
    }
}

/// A board that nothing watches, switched on for the first time.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoBoard;

impl Supervisor for NoBoard {
    fn feed(&mut self) {}

    fn idle(&mut self) {}

    fn reset_cause(&self) -> u8 {
        0
    }

    fn last_fault(&mut self) -> Option<(FaultCode, i64)> {
        None
    }
}
