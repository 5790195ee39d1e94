//! From the converter to the main loop without an instruction a sample: frames that hardware has put into a ring are
//! taken, checked and numbered.
//!
//! The number of a frame is that of the converter's edge that started its transfer. Edges are counted by hardware
//! ([`Board::edges`]) whether anybody reads or not, so an outage of any length leaves a gap of the right length and shifts
//! nothing. Only where the converter itself stood still, so that there were no edges, must a clock say how many
//! conversions there would have been; that number is told as what it is, an estimate ([`FaultCode::ConverterRestarted`]).

use crate::converter::{self, Bus, FRAME_BYTES, Rate, Read};
use crate::pace::{Pace, Stamp};
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use seabearing_core::port::{Chunk, SampleSource};
use seabearing_core::wire::FaultCode;

/// Frames the ring holds: 64 ms at 64 kHz, three times the recorder's longest block of work.
pub const RING_FRAMES: usize = 4096;
/// Its length in bytes.
pub const RING_BYTES: usize = RING_FRAMES * FRAME_BYTES;
/// Frames the hardware may write while some are taken; what is older is given up.
const MARGIN: u64 = 128;
/// Without an edge for so long the converter stands still.
const STANDSTILL_US: u64 = 50_000;
/// From one attempt to set the converter up to the next.
const RETRY_US: u64 = 100_000;
/// Longer than a transfer and the time to the next.
const TRANSFER_US: u64 = 50;
/// Looks at a ring in that time, whatever the clock says.
const MOST_LOOKS: u32 = 10_000;
/// Edges over which their rate is looked at, at least; two clocks that are 1 % wrong differ by less than a sixteenth.
const LEAST_TIMED: u64 = 200;
/// Nothing but damaged frames for so long may be a converter that was set otherwise.
const DAMAGED_S: u32 = 120;

/// What a board's hardware does for the acquisition.
pub trait Board: Bus {
    /// Edges of data-ready since power-on, counted by hardware. An edge's number is the count before it.
    fn edges(&mut self) -> u64;

    /// The newest count of edges whose moment was noted, a few hundred conversions old at most.
    fn stamp(&mut self) -> Stamp;

    /// Microseconds of the board's clock.
    fn now_us(&mut self) -> u64;

    /// From now on every edge starts a transfer into the ring, from its start on. `behind`: conversions have been done
    /// that nobody read, so the converter's output of two is read first. The number of the edge whose frame is the
    /// ring's first; `None` where it could not be done in time.
    fn arm(&mut self, behind: bool) -> Option<u64>;

    /// No edge starts a transfer any more.
    fn disarm(&mut self);

    /// Bytes put into the ring since it was armed, modulo its length.
    fn received(&mut self) -> usize;

    /// A frame of the ring.
    fn frame(&mut self, slot: usize) -> [u8; FRAME_BYTES];
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Not set up: tried again at this moment.
    Off { retry_us: u64 },
    /// The ring's first frame is that of edge `first`; `next` is to be taken.
    On { first: u64, next: u64 },
}

/// The converter as a source of samples.
#[derive(Debug)]
pub struct Acquisition<B> {
    board: B,
    rate: Rate,
    gain_log2: u8,
    state: State,
    /// Index of an edge, less its number.
    shift: u64,
    /// Index after the last sample given.
    index: u64,
    /// Edges when last looked, and since when.
    seen: (u64, u64),
    /// The newest moment by which the edges' rate was looked at.
    timed: Option<Stamp>,
    /// Damaged frames in a row.
    damaged: u32,
    /// The converter's rate in the board's time.
    pace: Option<Pace>,
    /// The converter was set up anew and the shift is not yet known.
    unplaced: bool,
    /// That it does not answer was told.
    told_silent: bool,
    fault: Option<(FaultCode, u64)>,
}

impl<B: Board> Acquisition<B> {
    /// A converter not yet set up.
    pub fn new(board: B, rate: Rate, gain_log2: u8) -> Self {
        Self {
            board,
            rate,
            gain_log2,
            state: State::Off { retry_us: 0 },
            shift: 0,
            index: 0,
            seen: (0, 0),
            timed: None,
            damaged: 0,
            pace: None,
            unplaced: false,
            told_silent: false,
            fault: None,
        }
    }

    /// Sets the converter up and arms the hardware before the first conversion.
    fn begin(&mut self, now_us: u64) {
        self.state = State::Off { retry_us: now_us + RETRY_US };
        if converter::set_up(&mut self.board, self.rate, self.gain_log2).is_err() {
            if !self.told_silent {
                self.told_silent = true;
                self.fault = Some((FaultCode::NoSamples, 0));
            }
            return;
        }
        converter::wake_up(&mut self.board);
        let Some(first) = self.board.arm(false) else { return };
        self.state = State::On { first, next: first };
        self.seen = (first, now_us);
        self.timed = None;
        self.damaged = 0;
        if self.index == 0 {
            self.shift = 0u64.wrapping_sub(first);
        } else {
            self.unplaced = true;
        }
    }

    /// The converter has reset itself or stands still: it is set up again.
    fn restart(&mut self, now_us: u64) {
        self.board.disarm();
        self.begin(now_us);
    }

    /// Transfers are out of step with edges, or frames were lost: reading starts afresh, and edges go on counting.
    fn resume(&mut self, now_us: u64) {
        self.board.disarm();
        match self.board.arm(true) {
            Some(first) => self.state = State::On { first, next: first },
            None => self.restart(now_us),
        }
    }

    /// The index of an edge's sample, where the edge is of the present stretch of conversions and that has its place.
    pub fn index_of(&self, edge: u64) -> Option<u64> {
        match self.state {
            State::On { first, .. } if edge >= first && !self.unplaced => Some(edge.wrapping_add(self.shift)),
            _ => None,
        }
    }

    /// After the converter stood still: the index of its first edge, from how long that took.
    fn place(&mut self, first: u64, stamp: Stamp) {
        // Time does not go back, and at least one conversion is wanting.
        let mut index = self.index + 1;
        if let Some(pace) = self.pace {
            let before = pace.newest();
            let passed = pace.conversions(stamp.at_us.saturating_sub(before.at_us), self.rate.hz());
            let by_clock = before.edges.wrapping_add(self.shift).wrapping_add(passed);
            index = index.max(by_clock.saturating_sub(stamp.edges.saturating_sub(first)));
        }
        self.fault = Some((FaultCode::ConverterRestarted, index - self.index));
        self.shift = index.wrapping_sub(first);
        self.pace = Some(Pace::new(stamp));
        self.unplaced = false;
    }

    /// Whether edges come at the rate that was asked for: a converter whose clock register has changed does not know.
    fn at_rate(&mut self, stamp: Stamp) -> bool {
        let before = *self.timed.get_or_insert(stamp);
        let edges = stamp.edges.saturating_sub(before.edges);
        if edges < LEAST_TIMED {
            return true;
        }
        self.timed = Some(stamp);
        let us = stamp.at_us.saturating_sub(before.at_us);
        let by_clock = us.saturating_mul(u64::from(self.rate.hz())) / 1_000_000;
        by_clock.abs_diff(edges) <= edges / 16
    }

    /// Frames in the ring since it was armed, of which the first was that of edge `first`, and the number of edges: at a
    /// moment between two transfers they must agree. `None` where they never do: a transfer was lost or cut short.
    fn whole(&mut self, first: u64) -> Option<(u64, u64)> {
        let begun_us = self.board.now_us();
        for _ in 0..MOST_LOOKS {
            let before = self.board.edges();
            let received = self.board.received();
            let whole = before.saturating_sub(first);
            if self.board.edges() == before
                && received as u64 == whole % RING_FRAMES as u64 * FRAME_BYTES as u64
            {
                return Some((whole, before));
            }
            if self.board.now_us().saturating_sub(begun_us) > TRANSFER_US {
                break;
            }
        }
        None
    }

    /// Takes frames that follow each other.
    fn take(&mut self, first: u64, next: u64, count: u64, frames: &mut [Frame]) -> Result<usize, Read> {
        let mut taken = 0;
        for (edge, to) in (next..next.wrapping_add(count)).zip(frames) {
            let slot = edge.wrapping_sub(first) as usize % RING_FRAMES;
            match converter::parse(&self.board.frame(slot)) {
                Read::Samples(frame) => (*to, self.damaged) = (frame, 0),
                Read::Damaged => (*to, self.damaged) = ([MISSING; CHANNELS], self.damaged.saturating_add(1)),
                Read::Reset => return if taken > 0 { Ok(taken) } else { Err(Read::Reset) },
            }
            taken += 1;
        }
        Ok(taken)
    }
}

impl<B: Board> SampleSource for Acquisition<B> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let now_us = self.board.now_us();
        let (first, mut next) = match self.state {
            State::Off { retry_us } => {
                if now_us >= retry_us {
                    self.begin(now_us);
                }
                return Chunk::Idle;
            }
            State::On { first, next } => (first, next),
        };
        let Some((whole, edges)) = self.whole(first) else {
            self.resume(now_us);
            return Chunk::Idle;
        };
        if edges != self.seen.0 {
            self.seen = (edges, now_us);
        }
        let still = now_us.saturating_sub(self.seen.1) > STANDSTILL_US;
        let end = first.wrapping_add(whole);
        let mut ready = end.wrapping_sub(next);
        if ready > RING_FRAMES as u64 - MARGIN {
            // Nobody came for longer than the ring lasts: half of it is still whole for a while.
            next = end.wrapping_sub(RING_FRAMES as u64 / 2);
            ready = RING_FRAMES as u64 / 2;
        }
        let stamp = self.board.stamp();
        if still && ready == 0 || stamp.edges > first && !self.at_rate(stamp) {
            self.restart(now_us);
            return Chunk::Idle;
        }
        if ready == 0 || (ready < frames.len() as u64 && !still) {
            return Chunk::Idle;
        }
        if self.unplaced {
            if stamp.edges <= first && !still {
                return Chunk::Idle;
            }
            self.place(first, stamp);
        } else if stamp.edges > first {
            self.pace.get_or_insert(Pace::new(stamp)).note(stamp);
        }
        let count = match self.take(first, next, ready.min(frames.len() as u64), frames) {
            Ok(count) => count,
            Err(_) => {
                self.restart(now_us);
                return Chunk::Idle;
            }
        };
        self.state = State::On { first, next: next.wrapping_add(count as u64) };
        if self.board.edges().wrapping_sub(next) >= RING_FRAMES as u64 {
            // Overwritten while it was taken: given up, and counted as a gap.
            return Chunk::Idle;
        }
        let first_index = next.wrapping_add(self.shift);
        self.index = first_index + count as u64;
        self.told_silent = false;
        if self.damaged >= DAMAGED_S * self.rate.hz() {
            self.restart(now_us);
        }
        Chunk::Frames { first_index, count }
    }

    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        self.fault.take()
    }
}

#[cfg(test)]
mod tests;
