//! An SD card of high capacity as a controller sees it: the commands that move sectors, in the states in which the
//! specification allows them (SD Physical Layer Simplified Specification, 4.8), busy times, and what goes wrong with cards.
//!
//! Strict where software would be wrong with some card: a command that its state does not allow, or too fast a clock
//! while it is identified, stops the run. Times are a slow card's, from experience and not from a standard: 0.2 ms of
//! programming a page of 16 KiB, and 2 ms of work each 4 MiB.

use crate::board::Refusal;
use crate::time::{PER_SECOND, Ticks};
use std::collections::HashMap;

/// Bytes of a sector.
pub const SECTOR: usize = 512;
const MILLISECOND: Ticks = PER_SECOND / 1000;
/// From the first question for its conditions to a card that is ready.
const STARTS: Ticks = 150 * MILLISECOND;
/// Programming after a stop, and after every so many sectors.
const PROGRAMS: Ticks = MILLISECOND / 5;
const WORKS: (u64, Ticks) = (8192, 2 * MILLISECOND);
/// Fastest clock while a card is identified, and afterwards without another timing, Hz.
const SLOW_HZ: u64 = 400_000;
const FAST_HZ: u64 = 25_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    Ready,
    Identified,
    Standby,
    Transfer,
    /// Gives sectors from this one on.
    Sends(u32),
    /// Takes them.
    Receives(u32),
    Programs,
}

/// What a card answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Nothing.
    None,
    /// 48 bits with a checksum.
    Short(u32),
    /// 48 bits without one.
    Unchecked(u32),
    /// 136 bits.
    Long([u32; 4]),
}

/// A write that a cut of power ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Sectors written before.
    pub sector: u64,
    /// Bytes of the next that were.
    pub bytes: usize,
}

/// The card.
#[derive(Debug)]
pub struct SdCard {
    sectors: HashMap<u32, [u8; SECTOR]>,
    count: u32,
    state: State,
    /// The next command is an application's.
    application: bool,
    ready_at: Option<Ticks>,
    wide: bool,
    busy_until: Ticks,
    /// Whether it is in its holder.
    pub present: bool,
    /// It refuses what it is sent.
    pub errs: bool,
    /// From then on the next sector keeps it busy for so long: once each.
    pub stalls: Vec<(Ticks, Ticks)>,
    /// Power fails in the middle of this write.
    pub cut: Option<Cut>,
    /// Sectors written.
    pub written: u64,
}

/// A relative address.
const ADDRESS: u32 = 0x4567;

impl SdCard {
    /// A card of so many sectors, in its holder; those not given hold zeros.
    pub fn new(count: u32, sectors: HashMap<u32, [u8; SECTOR]>) -> Self {
        Self {
            sectors,
            count,
            state: State::Idle,
            application: false,
            ready_at: None,
            wide: false,
            busy_until: 0,
            present: true,
            errs: false,
            stalls: Vec::new(),
            cut: None,
            written: 0,
        }
    }

    /// None in the holder.
    pub fn none() -> Self {
        Self { present: false, ..Self::new(0, HashMap::new()) }
    }

    /// Its sectors that do not hold zeros only by having never been written.
    pub fn sectors(&self) -> &HashMap<u32, [u8; SECTOR]> {
        &self.sectors
    }

    /// It loses its power, and has it again.
    pub fn power(&mut self) {
        (self.state, self.application, self.ready_at) = (State::Idle, false, None);
        (self.wide, self.busy_until) = (false, 0);
    }

    /// Whether it holds the first data line low.
    pub fn busy(&self, now: Ticks) -> bool {
        self.present && now < self.busy_until
    }

    /// When it is done with what it programs.
    pub fn busy_until(&self) -> Ticks {
        self.busy_until
    }

    /// Whether it moves four bits at a time.
    pub fn wide(&self) -> bool {
        self.wide
    }

    fn status(&self, now: Ticks) -> u32 {
        let state = match self.state {
            State::Idle => 0,
            State::Ready => 1,
            State::Identified => 2,
            State::Standby => 3,
            State::Transfer => 4,
            State::Sends(_) => 5,
            State::Receives(_) => 6,
            State::Programs => 7,
        };
        let ready = u32::from(!self.busy(now));
        state << 9 | ready << 8 | u32::from(self.application) << 5
    }

    /// A command.
    ///
    /// # Errors
    /// Software that sends this now would be wrong.
    pub fn command(&mut self, index: u8, argument: u32, hz: u64, now: Ticks) -> Result<Answer, Refusal> {
        if !self.present {
            return Ok(Answer::None);
        }
        if self.state == State::Programs && !self.busy(now) {
            self.state = State::Transfer;
        }
        let identified = matches!(
            self.state,
            State::Standby | State::Transfer | State::Sends(_) | State::Receives(_) | State::Programs
        );
        if hz > if identified { FAST_HZ } else { SLOW_HZ } {
            return Refusal::stop(format!("the card's clock of {hz} Hz is too fast for command {index}"));
        }
        let application = std::mem::take(&mut self.application);
        let status = self.status(now);
        let ours = argument >> 16 == ADDRESS;
        let answer = match (index, self.state) {
            (0, _) => {
                self.power();
                Answer::None
            }
            (8, State::Idle) => Answer::Short(argument & 0xfff),
            (55, State::Idle) if argument == 0 => {
                self.application = true;
                Answer::Short(status | 1 << 5)
            }
            (55, State::Transfer) if ours => {
                self.application = true;
                Answer::Short(status | 1 << 5)
            }
            (41, State::Idle) if application => {
                let at = *self.ready_at.get_or_insert(now + STARTS);
                let ready = now >= at;
                if ready {
                    self.state = State::Ready;
                }
                let high = ready && argument & 1 << 30 != 0;
                Answer::Unchecked(u32::from(ready) << 31 | u32::from(high) << 30 | 0x00ff_8000)
            }
            (2, State::Ready) => {
                self.state = State::Identified;
                Answer::Long([0x0353_4253, 0x4433_3247, 0x8000_0000, 0x0001_0001])
            }
            (3, State::Identified) => {
                self.state = State::Standby;
                Answer::Short(ADDRESS << 16 | 2 << 9)
            }
            (7, State::Standby) if ours => {
                self.state = State::Transfer;
                Answer::Short(status)
            }
            (6, State::Transfer) if application && argument <= 2 => {
                self.wide = argument == 2;
                Answer::Short(status)
            }
            (13, _) if ours && identified => Answer::Short(status),
            (18 | 25, State::Transfer) if argument < self.count => {
                self.state = if index == 18 { State::Sends(argument) } else { State::Receives(argument) };
                Answer::Short(status)
            }
            (12, State::Sends(_)) => {
                self.state = State::Transfer;
                Answer::Short(status)
            }
            (12, State::Receives(_)) => {
                self.busy_until = self.busy_until.max(now + PROGRAMS);
                self.state = State::Programs;
                Answer::Short(status)
            }
            (index, state) => {
                return Refusal::stop(format!(
                    "command {index} ({argument:#x}) is sent to a card that is in the state {state:?}"
                ));
            }
        };
        Ok(answer)
    }

    /// The next sector of a reading; `None` where it gives none.
    pub fn send(&mut self) -> Option<[u8; SECTOR]> {
        let State::Sends(sector) = self.state else { return None };
        self.state = State::Sends(sector + 1);
        let there = self.present && !self.errs && sector < self.count;
        there.then(|| self.sectors.get(&sector).copied().unwrap_or([0; SECTOR]))
    }

    /// Takes the next sector of a writing: whether it accepts it, and whether power fails in the middle of it.
    pub fn receive(&mut self, bytes: &[u8; SECTOR], now: Ticks) -> (bool, bool) {
        let State::Receives(sector) = self.state else { return (false, false) };
        if !self.present || self.errs || sector >= self.count {
            return (false, false);
        }
        self.state = State::Receives(sector + 1);
        let to = self.sectors.entry(sector).or_insert([0; SECTOR]);
        if let Some(cut) = self.cut.filter(|cut| cut.sector == self.written) {
            self.cut = None;
            to[..cut.bytes].copy_from_slice(&bytes[..cut.bytes]);
            return (false, true);
        }
        to.copy_from_slice(bytes);
        self.written += 1;
        if self.written.is_multiple_of(WORKS.0) {
            self.busy_until = now + WORKS.1;
        }
        if let Some(due) = self.stalls.iter().position(|stall| stall.0 <= now) {
            self.busy_until = now + self.stalls.remove(due).1;
        }
        (true, false)
    }
}
