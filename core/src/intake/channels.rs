//! What codes show of the channels: stuck, copied from another, at the converter's limit, missing.
//!
//! Enters: runs of samples. Leaves: a [`Look`], which can be joined to the next, and a [`Verdict`] on what it covers.
//! [`Channels`] remembers the state and says when it begins and ends. A living channel costs a comparison a run.

use super::{Faults, Run};
use crate::block::{CHANNELS, Frame};
use crate::wire::{FaultCode, Message};

/// Pairs of channels.
const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
/// A bit for each of them.
const EVERY_PAIR: u8 = (1 << PAIRS.len()) - 1;

/// What some instants show.
#[derive(Clone, Copy, Debug, Default)]
pub struct Look {
    /// Instants looked at.
    pub instants: u32,
    /// Those among them that are in a bucket already.
    pub counted: u32,
    /// Those among them that stand for absent ones.
    pub bridged: u32,
    /// Bounds on the magnitudes of each channel's codes.
    pub loudest: Frame,
    first: Frame,
    /// Bit c: channel c has moved.
    moved: u8,
    /// Bit p: the channels of pair p have differed.
    apart: u8,
    /// Clipped samples of each channel.
    clipped: [u32; CHANNELS],
    /// Codes of each channel that stand for missing ones while others had theirs.
    missing: [u32; CHANNELS],
}

/// How much of what a frame may hold.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// Clipped samples of one channel.
    pub clipped: u32,
    /// Missing codes of one channel, and bridged instants.
    pub missing: u32,
}

/// What is wrong, bit c for channel c.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// Stuck, copied, or too often without a code.
    pub dead: u8,
    /// Those among them that are copies.
    pub copied: u8,
    /// Clipped at all.
    pub clipped: u8,
    /// Clipped more often than tolerated.
    pub clipped_often: u8,
    /// More instants were bridged than tolerated.
    pub holed: bool,
}

impl Look {
    /// Nothing seen.
    pub const NEW: Self = Self {
        instants: 0,
        counted: 0,
        bridged: 0,
        loudest: [0; CHANNELS],
        first: [0; CHANNELS],
        moved: 0,
        apart: 0,
        clipped: [0; CHANNELS],
        missing: [0; CHANNELS],
    };

    /// Looks at `frames`, which are some of `run`'s; codes at or beyond ± `clip` are clipped.
    pub fn see(&mut self, run: &Run<'_>, frames: &[Frame], clip: i32) {
        let Some(first) = frames.first() else { return };
        if self.instants == 0 {
            self.first = *first;
        }
        let n = frames.len() as u32;
        self.instants += n;
        self.counted += if run.counted { n } else { 0 };
        self.bridged += if run.mended == super::ALL { n } else { 0 };
        // The bound is on magnitudes, of which those of negative codes are one too small.
        let bound = clip.saturating_sub(1);
        for (c, (loudest, of_run)) in self.loudest.iter_mut().zip(&run.loudest).enumerate() {
            *loudest |= of_run;
            if *of_run >= bound {
                self.clipped[c] += frames.iter().filter(|f| f[c] >= clip || f[c] <= -clip).count() as u32;
            }
        }
        if run.mended != 0 && run.mended != super::ALL {
            for (c, missing) in self.missing.iter_mut().enumerate() {
                *missing += if run.mended >> c & 1 == 1 { n } else { 0 };
            }
        }
        // What all have shown is looked for no more.
        if self.moved != super::ALL {
            for c in 0..CHANNELS {
                let moves = self.moved >> c & 1 == 1 || frames.iter().any(|f| f[c] != self.first[c]);
                self.moved |= u8::from(moves) << c;
            }
        }
        if self.apart != EVERY_PAIR {
            for (p, (a, b)) in PAIRS.into_iter().enumerate() {
                let differ = self.apart >> p & 1 == 1 || frames.iter().any(|f| f.get(a) != f.get(b));
                self.apart |= u8::from(differ) << p;
            }
        }
    }

    /// Both together; `later` follows this.
    #[must_use]
    pub fn joined(&self, later: &Self) -> Self {
        if self.instants == 0 || later.instants == 0 {
            return if self.instants == 0 { *later } else { *self };
        }
        let mut out = *self;
        out.instants += later.instants;
        out.counted += later.counted;
        out.bridged += later.bridged;
        out.moved |= later.moved;
        out.apart |= later.apart;
        for c in 0..CHANNELS {
            out.moved |= u8::from(self.first[c] != later.first[c]) << c;
            out.loudest[c] |= later.loudest[c];
            out.clipped[c] += later.clipped[c];
            out.missing[c] += later.missing[c];
        }
        out
    }

    /// Instants that are in no bucket yet.
    pub fn open(&self) -> u64 {
        u64::from(self.instants - self.counted.min(self.instants))
    }

    /// Clipped samples of each channel.
    pub fn clipped(&self) -> &[u32; CHANNELS] {
        &self.clipped
    }

    /// What is wrong with the channels.
    pub fn verdict(&self, tolerance: &Tolerance) -> Verdict {
        let over = |counts: &[u32; CHANNELS], most: u32| {
            counts.iter().rev().fold(0u8, |bits, n| bits << 1 | u8::from(*n > most))
        };
        let stuck = !self.moved & super::ALL;
        let copies = PAIRS.into_iter().enumerate().filter(|(p, _)| self.apart >> p & 1 == 0);
        let copied =
            copies.fold(0u8, |bits, (_, (a, b))| if stuck >> a & 1 == 0 { bits | 1 << b } else { bits });
        Verdict {
            copied,
            dead: stuck | copied | over(&self.missing, tolerance.missing),
            clipped: over(&self.clipped, 0),
            clipped_often: over(&self.clipped, tolerance.clipped),
            holed: self.bridged > tolerance.missing,
        }
    }
}

/// State of the channels, as last seen.
#[derive(Clone, Copy, Debug, Default)]
pub struct Channels {
    dead: u8,
    clipping: u8,
    clipping_now: u8,
}

impl Channels {
    /// All well.
    pub const fn new() -> Self {
        Self { dead: 0, clipping: 0, clipping_now: 0 }
    }

    /// Bit c: channel c is dead, stuck or a copy of another; bit 4 + c: it is clipping.
    pub fn flags(&self) -> u8 {
        self.dead | self.clipping << CHANNELS
    }

    /// Takes what the newest frame shows (`clipped`: the channels to call clipping) and tells what begins and ends.
    pub fn see(
        &mut self,
        dead: u8,
        clipped: u8,
        index: u64,
        faults: &mut Faults,
        sink: &mut dyn FnMut(Message),
    ) {
        for c in 0..CHANNELS {
            let bit = 1u8 << c;
            if (dead ^ self.dead) & bit != 0 {
                let code = if dead & bit != 0 { FaultCode::DeadChannel } else { FaultCode::ChannelBack };
                faults.note(code, index, c as u64, sink);
            }
            if clipped & !self.clipping & bit != 0 {
                faults.note(FaultCode::Clipping, index, c as u64, sink);
            }
        }
        self.dead = dead;
        self.clipping |= clipped;
        self.clipping_now |= clipped;
    }

    /// A stretch has ended over which clipping is called lasting: what did not clip in it clips no longer.
    pub fn roll(&mut self) {
        self.clipping = core::mem::take(&mut self.clipping_now);
    }
}
