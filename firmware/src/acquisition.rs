//! From the converter to the main loop without an instruction a sample: frames that hardware has put into a ring are
//! taken, checked and numbered.
//!
//! The number of a frame is that of the converter's edge that started its transfer. Edges are counted by hardware
//! ([`Board::edges`]) whether anybody reads or not, so an outage of any length leaves a gap of the right length and shifts
//! nothing. Only where the converter itself stood still, so that there were no edges, must a clock say how many
//! conversions there would have been; that number is told as what it is, an estimate ([`FaultCode::ConverterRestarted`]).

use crate::converter::Read;
use crate::pace::{Pace, Stamp};
use crate::phase::{Phase, Verdict};
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use seabearing_core::port::{Chunk, SampleSource};
use seabearing_core::wire::FaultCode;

/// Frames the hardware may write while some are taken; what is older is given up.
const MARGIN: u64 = 128;
/// From one attempt to set the converter up to the next.
const RETRY_US: u64 = 100_000;
/// Longer than a transfer.
const TRANSFER_US: u64 = 50;
/// Looks at a ring in that time, whatever the clock says.
const MOST_LOOKS: u32 = 10_000;
/// Of the edges counted so many less or more, and a part in so many: a converter and a clock whose rates were measured against
/// each other agree better, whatever their temperatures and however late a moment is noted. Fewer are [`Phase`]'s.
const STRAY: u64 = 3;
const STEADY: u64 = 1000;
/// So many where nothing was measured yet.
const EARLY_STRAY: u64 = 8;
/// Nothing but damaged frames for so long may be a converter that was set otherwise.
const DAMAGED_S: u32 = 120;

/// What a board's hardware does for the acquisition, its converter included.
pub trait Board {
    /// Frames the ring holds.
    const RING_FRAMES: usize;
    /// Bytes of the ring that a frame takes.
    const FRAME_BYTES: usize;
    /// Edges over which their rate is looked at, at least; two clocks that are 1 % wrong differ by less than a sixteenth.
    const LEAST_TIMED: u64;
    /// Turns of the loop from one look at a satellite receiver to the next: at 64 kHz some milliseconds, as a look costs as
    /// much as a block's care.
    const LOOK_EVERY: u8 = 8;
    /// Moments of which the least late is held against the converter's pace: one late by most of a conversion must not be taken for
    /// a conversion.
    const MOMENTS: u8 = 4;

    /// Conversions a second that are asked for.
    fn hz(&self) -> u32;

    /// From its setting up to its first edge, µs.
    fn begins_us(&self) -> u64;

    /// Without an edge for so long the converter stands still, µs.
    fn standstill_us(&self) -> u64 {
        50_000 + self.begins_us()
    }

    /// Sets the converter up; it begins to convert. Whether it answered as it must.
    fn set_up(&mut self) -> bool;

    /// From one look at the converter's settings to the next, µs, where its frames do not say how it is set. What came since
    /// the newest look is not given before the next.
    fn look_every_us(&self) -> Option<u64> {
        None
    }

    /// Looks whether the converter is still set as it was; no conversion is lost by that.
    fn is_as_set(&mut self) -> bool {
        true
    }

    /// Edges of data-ready since power-on, counted by hardware. An edge's number is the count before it.
    fn edges(&mut self) -> u64;

    /// The newest count of edges whose moment was noted, a few hundred conversions old at most.
    fn stamp(&mut self) -> Stamp;

    /// Microseconds of the board's clock.
    fn now_us(&mut self) -> u64;

    /// From now on every edge starts a transfer into the ring, from its start on. `behind`: conversions have been done
    /// that nobody read; where the converter keeps two, they are read first. The number of the edge whose frame is the
    /// ring's first; `None` where it could not be done in time.
    fn arm(&mut self, behind: bool) -> Option<u64>;

    /// No edge starts a transfer any more.
    fn disarm(&mut self);

    /// Bytes put into the ring since it was armed, modulo its length.
    fn received(&mut self) -> usize;

    /// What a frame of the ring says.
    fn frame(&mut self, slot: usize) -> Read;
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
    state: State,
    /// Index of an edge, less its number.
    shift: u64,
    /// Index after the last sample given.
    index: u64,
    /// Edges when last looked, and since when.
    seen: (u64, u64),
    /// The newest moment by which the edges' rate was looked at.
    timed: Option<Stamp>,
    /// Single edges that are wanting or too many, and a moment that waits until its frames were taken.
    phase: Phase,
    moment: Option<Stamp>,
    /// Edges that were none of the converter's.
    false_edges: u64,
    /// When the converter's settings were last looked at, and the edges before which they were right.
    looked: (u64, u64),
    /// Damaged frames in a row.
    damaged: u32,
    /// The converter's rate in the board's time.
    pace: Option<Pace>,
    /// The converter was set up anew and the shift is not yet known.
    unplaced: bool,
    /// Edges counted when that became known.
    placed: u64,
    /// About when its first edge was, and the first moment noted since.
    begun: Stamp,
    anew: Option<Stamp>,
    /// That it does not answer was told.
    told_silent: bool,
    fault: Option<(FaultCode, u64)>,
}

impl<B: Board> Acquisition<B> {
    /// A converter not yet set up.
    pub fn new(board: B) -> Self {
        Self {
            board,
            state: State::Off { retry_us: 0 },
            shift: 0,
            index: 0,
            seen: (0, 0),
            timed: None,
            phase: Phase::default(),
            moment: None,
            false_edges: 0,
            looked: (0, 0),
            damaged: 0,
            pace: None,
            unplaced: false,
            placed: 0,
            begun: Stamp::default(),
            anew: None,
            told_silent: false,
            fault: None,
        }
    }

    /// Sets the converter up and arms the hardware before the first conversion.
    fn begin(&mut self, now_us: u64) {
        self.state = State::Off { retry_us: now_us + RETRY_US };
        self.anew = None;
        if !self.board.set_up() {
            if !self.told_silent {
                self.told_silent = true;
                self.fault = Some((FaultCode::NoSamples, 0));
            }
            return;
        }
        let Some(first) = self.board.arm(false) else { return };
        self.state = State::On { first, next: first };
        self.begun = Stamp { edges: first, at_us: self.board.now_us() + self.board.begins_us() };
        self.seen = (first, now_us);
        self.timed = None;
        (self.phase, self.moment) = (Phase::default(), None);
        self.looked = (now_us, first);
        self.damaged = 0;
        if self.index == 0 {
            (self.shift, self.pace) = (0u64.wrapping_sub(first), None);
        } else {
            self.unplaced = true;
        }
    }

    /// The converter has reset itself or stands still: it is set up again.
    fn restart(&mut self, now_us: u64) {
        if !self.unplaced {
            // Before its rate was measured: when it converted is known all the same.
            self.pace.get_or_insert(Pace::new(self.known(), self.board.hz()));
        }
        self.board.disarm();
        if self.index == 0 {
            // Nothing was given yet, so nothing is missing; that it had to begin again is told all the same.
            self.fault.get_or_insert((FaultCode::ConverterRestarted, 0));
        }
        self.begin(now_us);
    }

    /// The newest moment known of a converter whose rate was not measured: the one its edges' rate was last found right by, unless
    /// edges were missing before that already.
    fn known(&self) -> Stamp {
        let Some(timed) = self.timed else { return self.begun };
        let edges = timed.edges.saturating_sub(self.begun.edges);
        let us = timed.at_us.saturating_sub(self.begun.at_us);
        let by_clock = us.saturating_mul(u64::from(self.board.hz())) / 1_000_000;
        if by_clock <= edges + edges / 32 + EARLY_STRAY { timed } else { self.begun }
    }

    /// Transfers are out of step with edges, or frames were lost: reading starts afresh, and edges go on counting.
    fn resume(&mut self, now_us: u64) {
        self.board.disarm();
        match self.board.arm(true) {
            Some(first) => self.state = State::On { first, next: first },
            None => self.restart(now_us),
        }
    }

    /// The hardware.
    pub fn board_mut(&mut self) -> &mut B {
        &mut self.board
    }

    /// Samples a second.
    pub fn rate_hz(&self) -> f64 {
        self.board.hz().into()
    }

    /// The index of an edge's sample, where the edge is of the present stretch of conversions and that has its place.
    pub fn index_of(&self, edge: u64) -> Option<u64> {
        match self.state {
            State::On { first, .. } if edge >= first && !self.unplaced => Some(edge.wrapping_add(self.shift)),
            _ => None,
        }
    }

    /// After the converter stood still: the index of its first edge, from how long that took; whether it could be said yet. By the
    /// converter's rate of before or, where it stood still before that was measured, as it is now over half a ring.
    fn place(&mut self, first: u64, stamp: Stamp) -> bool {
        let hz = self.board.hz();
        let mut pace = self.pace.unwrap_or(Pace::new(Stamp::default(), hz));
        let anew = *self.anew.get_or_insert(stamp);
        if !pace.is_measured() {
            if stamp.edges.saturating_sub(anew.edges) < B::RING_FRAMES as u64 / 2 {
                return false;
            }
            pace = pace.by(anew, stamp);
        }
        let before = pace.newest();
        let passed = pace.conversions(stamp.at_us.saturating_sub(before.at_us));
        let by_clock = before.edges.wrapping_add(self.shift).wrapping_add(passed);
        // Time does not go back, and at least one conversion is wanting.
        let index = by_clock.saturating_sub(stamp.edges.saturating_sub(first)).max(self.index + 1);
        self.fault = Some((FaultCode::ConverterRestarted, index - self.index));
        self.shift = index.wrapping_sub(first);
        self.placed = stamp.edges;
        self.pace = Some(pace.after_outage(stamp));
        (self.phase, self.moment) = (Phase::default(), None);
        self.unplaced = false;
        true
    }

    /// Whether edges come at the rate that was asked for, since they were last looked at; `None` where that is too short a
    /// time. A converter whose clock register has changed does not know.
    fn at_rate(&mut self, stamp: Stamp) -> Option<bool> {
        let before = *self.timed.get_or_insert(stamp);
        let edges = stamp.edges.saturating_sub(before.edges);
        if edges < B::LEAST_TIMED {
            return None;
        }
        let us = stamp.at_us.saturating_sub(before.at_us);
        // One that stood still for a while, unseen because nobody came, is numbered wrongly from then on. The rate of a minute ago or
        // before an outage may not be that of now.
        let within = (STRAY + edges / STEADY).min(edges / 16);
        let holds = |pace: &Pace| pace.conversions(us).abs_diff(edges) <= within;
        let right = match self.pace.filter(Pace::is_measured) {
            Some(pace) => holds(&pace) || self.phase.recent().is_some_and(holds),
            None => (us.saturating_mul(u64::from(self.board.hz())) / 1_000_000).abs_diff(edges) <= edges / 16,
        };
        if right {
            self.timed = Some(stamp);
        }
        Some(right)
    }

    /// Whether single edges are wanting or too many. Of a converter whose frames say whether they are new, false edges are left out
    /// as their frames are taken: a moment waits until those before it were. By the least late moments its pace is measured.
    fn counts_all(&mut self, stamp: Stamp, next: u64) -> bool {
        let Some(pace) = self.pace.as_mut().filter(|pace| pace.is_measured() && !self.unplaced) else {
            return true;
        };
        let moment = *self.moment.get_or_insert(stamp);
        if moment.edges > next && self.board.look_every_us().is_none() {
            return true;
        }
        self.moment = None;
        match self.phase.note(moment, pace, B::MOMENTS) {
            Verdict::Open => true,
            Verdict::Right(best) => {
                pace.note(best);
                true
            }
            Verdict::Wrong => false,
        }
    }

    /// The edge of this number was none of the converter's: it is not numbered, and those after it are one less.
    fn leave_out(&mut self, edge: u64) {
        // Those before an outage's end was placed were counted as conversions of it: one number is left out.
        if edge >= self.placed {
            self.shift = self.shift.wrapping_sub(1);
        }
        self.begun.leave_out(edge);
        self.phase.leave_out(edge);
        self.pace.iter_mut().for_each(|pace| pace.leave_out(edge));
        for stamp in [&mut self.timed, &mut self.anew, &mut self.moment].into_iter().flatten() {
            stamp.leave_out(edge);
        }
        self.false_edges += 1;
        self.fault.get_or_insert((FaultCode::FalseEdge, self.false_edges));
    }

    /// Of the edges before `end` those whose frames may be given: the converter was set right, at a later look too. `None`: it
    /// is not any more.
    fn right(&mut self, end: u64, still: bool, now_us: u64) -> Option<u64> {
        let Some(every_us) = self.board.look_every_us() else { return Some(end) };
        let (looked_us, right) = self.looked;
        if still && end > right || now_us.saturating_sub(looked_us) > every_us {
            if !self.board.is_as_set() {
                return None;
            }
            self.looked = (now_us, end);
        }
        Some(end.min(self.looked.1))
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
                && received as u64 == whole % B::RING_FRAMES as u64 * B::FRAME_BYTES as u64
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
            let slot = edge.wrapping_sub(first) as usize % B::RING_FRAMES;
            match self.board.frame(slot) {
                Read::Samples(frame) => (*to, self.damaged) = (frame, 0),
                Read::Damaged => (*to, self.damaged) = ([MISSING; CHANNELS], self.damaged.saturating_add(1)),
                read => return if taken > 0 { Ok(taken) } else { Err(read) },
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
        let still = now_us.saturating_sub(self.seen.1) > self.board.standstill_us();
        let end = first.wrapping_add(whole);
        if end.wrapping_sub(next) > B::RING_FRAMES as u64 - MARGIN {
            // Nobody came for longer than the ring lasts: half of it is still whole for a while.
            next = end.wrapping_sub(B::RING_FRAMES as u64 / 2);
        }
        let Some(mut ready) = self.right(end, still, now_us).map(|end| end.saturating_sub(next)) else {
            self.restart(now_us);
            return Chunk::Idle;
        };
        let stamp = self.board.stamp();
        let at_rate = if stamp.edges > first { self.at_rate(stamp) } else { None };
        let counts_all = stamp.edges <= first || self.counts_all(stamp, next);
        if still && ready == 0 || at_rate == Some(false) || !counts_all {
            self.restart(now_us);
            return Chunk::Idle;
        }
        // Edges of a converter that goes wrong measure nothing. Whether frames are taken at this turn does not matter: the same phase
        // may come again and again.
        if at_rate == Some(true) && !self.unplaced {
            let pace = self.pace.get_or_insert(Pace::new(stamp, self.board.hz()));
            if !pace.is_measured() {
                pace.note(stamp);
            }
        }
        if ready == 0 || (ready < frames.len() as u64 && !still) {
            return Chunk::Idle;
        }
        if self.unplaced && !(stamp.edges > first && self.place(first, stamp)) {
            if still {
                // It stands still again: what it gave meanwhile has no number.
                self.restart(now_us);
            }
            return Chunk::Idle;
        }
        let count = loop {
            match self.take(first, next, ready.min(frames.len() as u64), frames) {
                Ok(count) => break count,
                Err(Read::NotNew) => {
                    self.leave_out(next);
                    next = next.wrapping_add(1);
                    ready -= 1;
                    self.state = State::On { first, next };
                    if ready == 0 || (ready < frames.len() as u64 && !still) {
                        return Chunk::Idle;
                    }
                }
                Err(_) => {
                    self.restart(now_us);
                    return Chunk::Idle;
                }
            }
        };
        self.state = State::On { first, next: next.wrapping_add(count as u64) };
        if self.board.edges().wrapping_sub(next) >= B::RING_FRAMES as u64 {
            // Overwritten while it was taken: given up, and counted as a gap.
            return Chunk::Idle;
        }
        let first_index = next.wrapping_add(self.shift);
        self.index = first_index + count as u64;
        self.told_silent = false;
        if self.damaged >= DAMAGED_S * self.board.hz() {
            self.restart(now_us);
        }
        Chunk::Frames { first_index, count }
    }

    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        self.fault.take()
    }

    fn age_us(&mut self, index: u64) -> Option<u64> {
        let (edges, now_us) = (self.board.edges(), self.board.now_us());
        let moves = now_us.saturating_sub(self.seen.1) <= self.board.standstill_us();
        let conversions = self.index_of(edges).filter(|_| moves)?.saturating_sub(index);
        conversions.saturating_mul(1_000_000).checked_div(self.board.hz().into())
    }
}

#[cfg(test)]
mod tests;
