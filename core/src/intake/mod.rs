//! The one entrance: what the sample index says, what is missing, and which runs of samples the estimators get.
//!
//! Enters: [`Block`]s. Leaves, by [`Intake::next`], one [`Step`] after the other: good samples, single instants mended where
//! a few codes were missing, [`Event`]s every stage must take, and the moments at which a recorder looks at the time. Both
//! chains, the shaft rate, tracks and reports hang on this; none of them compares indices itself. In the order a sample
//! meets them: this file (index, missing instants), `channels` (dead, copied, clipped), `level`; beside them `faults`, which
//! keeps what goes wrong often from filling the telemetry.
//!
//! * The index jumps ahead: a gap. It falls behind by up to `RESTART_S`: repeats, left out. Further, or back to where this
//!   time began, and it goes on from there for `BELIEVED` instants: time starts again, and those are left out. So it does
//!   after `RESTART_S` of repeats.
//! * An instant without a code on any needed channel is *absent*. A few absent instants, or a gap as short, are bridged by
//!   straight lines ([`Plan::new`]); more end the run. A code missing on one channel alone is that channel's last one again.
//! * Whatever the index does, a recorder looks at the time at least once in [`PATIENCE`] instants that come.
//! * Every instant is in one bucket of [`Accounting`]: gaps, repeats, and instants without all needed codes are counted here,
//!   all others by the chain that used them or could not.
//!
//! What happens depends on the sequence of instants alone, never on how it is cut into blocks. Cost on the Cortex-M7: 10
//! instructions a sample instant.

pub mod channels;
pub mod faults;
pub mod level;

pub use channels::{Channels, Look, Tolerance};
pub use faults::Faults;
pub use level::Levels;

use crate::block::{Block, CHANNELS, Frame, MISSING};
use crate::health::{Accounting, LossCause};
use crate::wire::{FaultCode, Message};

/// An index that falls back by more than this, or repeats for longer, is time starting again, seconds: longer than a block
/// sent twice, shorter than any report may be late.
const RESTART_S: f64 = 30.0;

/// Instants that must follow each other in what may be a new time before it is believed: more than a packet that strayed.
const BELIEVED: u64 = GRID / 2;

/// An index beyond this is damage, not time: a hundred years, seconds.
const LAST_S: f64 = 3.2e9;

/// Sample instants between the moments at which a recorder looks at the time: 8 ms at 64 kHz, 10 s at 50 Hz.
pub const GRID: u64 = 512;

/// Most sample instants that come between two of these moments, where the index does not reach multiples of [`GRID`].
pub const PATIENCE: u64 = 2 * GRID;

/// Needed channels of a recorder that uses all.
pub const ALL: u8 = 0b1111;

/// What follows from the configuration.
#[derive(Clone, Debug)]
pub struct Plan {
    needed: u8,
    bridge: u64,
    restart: u64,
    last: u64,
    second: u64,
    minute: u64,
}

impl Plan {
    /// Nothing planned; all zeros.
    pub const EMPTY: Self = Self { needed: 0, bridge: 0, restart: 0, last: 0, second: 0, minute: 0 };

    /// For a sample rate in Hz, the channels that must have a code for an instant to be of use (bit c: channel c), and the
    /// longest absence that is bridged, instants.
    pub fn new(rate_hz: f64, needed: u8, bridge: u32) -> Self {
        let instants = |seconds: f64| (seconds * rate_hz) as u64;
        Self {
            needed,
            bridge: u64::from(bridge),
            restart: instants(RESTART_S).max(1),
            last: instants(LAST_S),
            second: instants(1.0).max(1),
            minute: instants(60.0).max(1),
        }
    }

    /// Sample instants of a minute.
    pub fn minute(&self) -> u64 {
        self.minute
    }
}

/// Samples that follow each other, and those of the run before unless an event came between.
#[derive(Clone, Copy, Debug)]
pub struct Run<'a> {
    /// Index of the first.
    pub first_index: u64,
    /// The codes; none is missing.
    pub frames: &'a [Frame],
    /// No magnitude of a channel's codes exceeds this.
    pub loudest: [i32; CHANNELS],
    /// Channels whose code here stands for a missing one; if any, the run is of one instant.
    pub mended: u8,
    /// Whether the instants are in a bucket already.
    pub counted: bool,
}

impl<'a> Run<'a> {
    /// A block in which no code is missing.
    pub fn whole(block: Block<'a>) -> Self {
        let Block { first_index, frames } = block;
        Self { first_index, frames, loudest: magnitudes(frames), mended: 0, counted: false }
    }
}

/// Something that every stage must take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The run of samples has ended; the next begins at a later index.
    Gap,
    /// Time starts again at this index: what is open is finished as of the time before, then forgotten. The fault that
    /// tells it comes after what the stages say now.
    Restart(u64),
}

/// What the intake hands on.
#[derive(Clone, Copy, Debug)]
pub enum Step<'a> {
    /// Good samples.
    Samples(Run<'a>),
    /// One instant with codes that stand for missing ones.
    Mended(Mended),
    /// A break.
    Event(Event),
    /// The index is this: a multiple of [`GRID`], or [`PATIENCE`] instants have come since the last look.
    Time(u64),
}

/// One instant with codes that stand for missing ones.
#[derive(Clone, Copy, Debug)]
pub struct Mended {
    index: u64,
    frame: [Frame; 1],
    channels: u8,
    counted: bool,
}

impl Mended {
    /// The instant as a run.
    pub fn run(&self) -> Run<'_> {
        let loudest = magnitudes(&self.frame);
        let Self { index: first_index, frame, channels: mended, counted } = self;
        Run { first_index: *first_index, frames: frame, loudest, mended: *mended, counted: *counted }
    }
}

/// Where the samples are, what is wrong with them, and what became of them.
#[derive(Clone, Debug)]
pub struct Intake {
    /// Where every instant went.
    pub accounting: Accounting,
    /// What is said about it.
    pub faults: Faults,
    started: bool,
    /// Index at which this time began.
    first: u64,
    /// Index after the last instant seen.
    next: u64,
    /// What may be a new time: the index that continues it, and how many instants of it have come.
    fallen: Option<(u64, u64)>,
    /// Whether the last instants belong to a run that may go on.
    running: bool,
    /// Newest code of each channel.
    newest: Frame,
    /// Absent instants at the end of the run, and how many of them are bridged already.
    absent: u64,
    bridged: u64,
    /// Repeats in a row.
    repeated: u64,
    /// Instants without all needed codes, in a row and not yet told; how many are told of at once.
    invalid: u64,
    telling: u64,
    /// A multiple of [`GRID`] was reached.
    due: bool,
    /// Instants that have come, and how many had at the last look at the time.
    arrived: u64,
    looked: u64,
    /// Time has started again, by how many instants; not yet told.
    restarted: Option<u64>,
    /// Up to this index instants are left out on purpose.
    rests_until: u64,
}

impl Intake {
    /// Nothing seen; all zeros.
    pub const fn new() -> Self {
        Self {
            accounting: Accounting { processed: 0, lost: [0; crate::health::LOSS_CAUSES] },
            faults: Faults::new(),
            started: false,
            first: 0,
            next: 0,
            fallen: None,
            running: false,
            newest: [0; CHANNELS],
            absent: 0,
            bridged: 0,
            repeated: 0,
            invalid: 0,
            telling: 0,
            due: false,
            arrived: 0,
            looked: 0,
            restarted: None,
            rests_until: 0,
        }
    }

    /// Instants up to this index are left out on purpose: they are in the bucket of gaps, and no fault. That it is for longer than was
    /// said is told, that it is for shorter not.
    pub fn rest(&mut self, until: u64, sink: &mut dyn FnMut(Message)) {
        let before = core::mem::replace(&mut self.rests_until, until);
        if until <= before {
            return;
        }
        self.faults.note(FaultCode::Paused, self.next, until.saturating_sub(self.next), sink);
    }

    /// Instants that have come so far, good ones or not.
    pub fn arrived(&self) -> u64 {
        self.arrived
    }

    /// Instants that have come or should have: time that goes on whatever the index does.
    pub fn elapsed(&self) -> u64 {
        self.arrived.saturating_add(self.accounting.lost[LossCause::Gap as usize])
    }

    /// Index after the last instant seen.
    pub fn next_index(&self) -> u64 {
        self.next
    }

    /// The next step through a block, which shrinks to what is left of it; `None` once nothing is.
    pub fn next<'a>(
        &mut self,
        plan: &Plan,
        rest: &mut Block<'a>,
        sink: &mut dyn FnMut(Message),
    ) -> Option<Step<'a>> {
        if let Some(back) = self.restarted.take() {
            self.faults.note(FaultCode::Restarted, self.next, back, sink);
        }
        loop {
            if core::mem::take(&mut self.due) || self.patience() == 0 {
                self.looked = self.arrived;
                self.faults.time(self.arrived.checked_div(plan.minute).unwrap_or(0), self.next, sink);
                return Some(Step::Time(self.next));
            }
            if rest.frames.is_empty() {
                return None;
            }
            if rest.first_index >= plan.last {
                let n = self.patience().min(rest.frames.len() as u64);
                self.pass_over(rest, n);
                self.invalid(plan, n, sink);
                continue;
            }
            if let Some(event) = self.align(plan, rest, sink) {
                return Some(Step::Event(event));
            }
            let Some(first) = rest.frames.first().filter(|_| rest.first_index == self.next) else { continue };
            self.tell_repeats(sink);
            let missing = missing(first);
            if missing & plan.needed == plan.needed {
                self.advance(rest, 1);
                self.invalid(plan, 1, sink);
                match self.lack(plan, 1) {
                    Some(event) => return Some(Step::Event(event)),
                    None => continue,
                }
            }
            if self.absent > 0 {
                return Some(Step::Mended(self.bridge(first)));
            }
            self.running = true;
            if missing != 0 {
                return Some(Step::Mended(self.mend(plan, rest, first, missing, sink)));
            }
            self.tell_invalid(plan, sink);
            return Some(Step::Samples(self.good(rest)));
        }
    }

    /// Compares a block's index with what was seen, and passes over what is not new.
    fn align(&mut self, plan: &Plan, rest: &mut Block<'_>, sink: &mut dyn FnMut(Message)) -> Option<Event> {
        if !self.started {
            self.started = true;
            (self.first, self.next) = (rest.first_index, rest.first_index);
        }
        let Some(back) = self.next.checked_sub(rest.first_index) else {
            self.tell_repeats(sink);
            self.fallen = None;
            let n = rest.first_index - self.next;
            let wanting = rest.first_index.saturating_sub(self.next.max(self.rests_until));
            self.next = rest.first_index;
            self.accounting.lose(LossCause::Gap, n);
            if wanting > 0 {
                self.faults.note(FaultCode::Gap, self.next, wanting, sink);
            }
            return self.lack(plan, n);
        };
        if back == 0 {
            self.fallen = None;
            return None;
        }
        let begins = back > plan.restart || rest.first_index <= self.first;
        let fallen = match self.fallen {
            Some((next, seen)) if next == rest.first_index => Some(seen),
            _ if begins => Some(0),
            _ => None,
        };
        if fallen.is_some_and(|seen| seen >= BELIEVED) || self.repeated >= plan.restart {
            return Some(self.restart(plan, rest.first_index, fallen.unwrap_or(0), sink));
        }
        let unsure = fallen.map_or(back, |seen| BELIEVED - seen);
        let most = self.patience().min(rest.frames.len() as u64);
        let n = back.min(plan.restart - self.repeated).min(unsure).min(most);
        self.fallen = fallen.map(|seen| (rest.first_index.saturating_add(n), seen + n));
        self.accounting.lose(LossCause::Overlap, n);
        self.repeated += n;
        self.pass_over(rest, n);
        None
    }

    /// Time starts again; so many instants of it have gone by unused.
    fn restart(&mut self, plan: &Plan, index: u64, unused: u64, sink: &mut dyn FnMut(Message)) -> Event {
        self.tell_repeats(sink);
        self.tell_invalid(plan, sink);
        let back = self.next.saturating_sub(index).saturating_add(unused);
        (self.first, self.next, self.fallen) = (index.saturating_sub(unused), index, None);
        (self.running, self.absent, self.bridged) = (false, 0, 0);
        (self.restarted, self.rests_until) = (Some(back), 0);
        Event::Restart(index)
    }

    /// So many instants are not there.
    fn lack(&mut self, plan: &Plan, n: u64) -> Option<Event> {
        if !self.running {
            return None;
        }
        self.absent = self.absent.saturating_add(n);
        if self.absent <= plan.bridge {
            return None;
        }
        (self.running, self.absent) = (false, 0);
        Some(Event::Gap)
    }

    /// The next of the absent instants, on a straight line to the first code after them.
    fn bridge(&mut self, after: &Frame) -> Mended {
        self.bridged += 1;
        let (k, n) = (self.bridged as i64, self.absent as i64 + 1);
        let mut frame = self.newest;
        for (code, after) in frame.iter_mut().zip(after) {
            if *after != MISSING {
                let step = (i64::from(*after) - i64::from(*code)) * k;
                *code = (i64::from(*code) + step.checked_div(n).unwrap_or(0)) as i32;
            }
        }
        let index = self.next.saturating_sub(self.absent).saturating_add(self.bridged - 1);
        if self.bridged >= self.absent {
            (self.absent, self.bridged) = (0, 0);
        }
        Mended { index, frame: [frame], channels: ALL, counted: true }
    }

    /// An instant with some codes missing: the channel's newest again.
    fn mend(
        &mut self,
        plan: &Plan,
        rest: &mut Block<'_>,
        frame: &Frame,
        channels: u8,
        sink: &mut dyn FnMut(Message),
    ) -> Mended {
        let index = self.next;
        self.advance(rest, 1);
        let counted = channels & plan.needed != 0;
        if counted {
            self.invalid(plan, 1, sink);
        } else {
            self.tell_invalid(plan, sink);
        }
        for (newest, code) in self.newest.iter_mut().zip(frame).filter(|(_, code)| **code != MISSING) {
            *newest = *code;
        }
        Mended { index, frame: [self.newest], channels, counted }
    }

    /// The good samples from here, at most up to the next multiple of [`GRID`].
    fn good<'a>(&mut self, rest: &mut Block<'a>) -> Run<'a> {
        let first_index = self.next;
        let room = (GRID - self.next % GRID).min(self.patience()) as usize;
        let mut frames = rest.frames.get(..room).unwrap_or(rest.frames);
        let mut loudest = magnitudes(frames);
        if loudest.contains(&magnitude(MISSING)) {
            let n = frames.iter().take_while(|f| !f.contains(&MISSING)).count();
            frames = frames.get(..n).unwrap_or(frames);
            loudest = magnitudes(frames);
        }
        if let Some(newest) = frames.last() {
            self.newest = *newest;
        }
        self.advance(rest, frames.len());
        Run { first_index, frames, loudest, mended: 0, counted: false }
    }

    /// Instants that may come until the next look at the time.
    fn patience(&self) -> u64 {
        PATIENCE.saturating_sub(self.arrived.saturating_sub(self.looked))
    }

    /// So many instants came that change nothing.
    fn pass_over(&mut self, rest: &mut Block<'_>, n: u64) {
        self.arrived = self.arrived.saturating_add(n);
        skip(rest, n as usize);
    }

    fn advance(&mut self, rest: &mut Block<'_>, n: usize) {
        self.pass_over(rest, n as u64);
        self.next = self.next.saturating_add(n as u64);
        self.due = self.next.is_multiple_of(GRID);
    }

    /// Counts instants without all needed codes. They are told of when they end, after the first second, and every minute.
    fn invalid(&mut self, plan: &Plan, n: u64, sink: &mut dyn FnMut(Message)) {
        self.accounting.lose(LossCause::Invalid, n);
        self.invalid = self.invalid.saturating_add(n);
        while self.invalid >= self.telling.max(plan.second) {
            let told = self.telling.max(plan.second);
            self.faults.note(FaultCode::Invalid, self.next, told, sink);
            self.invalid -= told;
            self.telling = plan.minute;
        }
    }

    fn tell_invalid(&mut self, plan: &Plan, sink: &mut dyn FnMut(Message)) {
        let n = core::mem::take(&mut self.invalid);
        self.telling = plan.second;
        if n > 0 {
            self.faults.note(FaultCode::Invalid, self.next, n, sink);
        }
    }

    fn tell_repeats(&mut self, sink: &mut dyn FnMut(Message)) {
        let n = core::mem::take(&mut self.repeated);
        if n > 0 {
            self.faults.note(FaultCode::Overlap, self.next, n, sink);
        }
    }

    /// The input has ended: what was held back is told.
    pub fn finish(&mut self, plan: &Plan, sink: &mut dyn FnMut(Message)) {
        self.tell_repeats(sink);
        self.tell_invalid(plan, sink);
        self.faults.tell(self.next, sink);
    }
}

fn skip(rest: &mut Block<'_>, n: usize) {
    rest.first_index = rest.first_index.saturating_add(n as u64);
    rest.frames = rest.frames.get(n..).unwrap_or(&[]);
}

/// Bit c: channel c has no code.
fn missing(frame: &Frame) -> u8 {
    frame.iter().rev().fold(0, |bits, code| bits << 1 | u8::from(*code == MISSING))
}

/// `|x|`, or one less where x is negative: one instruction.
#[inline(always)]
fn magnitude(code: i32) -> i32 {
    code ^ (code >> 31)
}

/// A bound on the magnitudes of each channel's codes: their bits together.
#[inline(never)]
fn magnitudes(frames: &[Frame]) -> [i32; CHANNELS] {
    let mut bits = [0; CHANNELS];
    for frame in frames {
        for (bits, code) in bits.iter_mut().zip(frame) {
            *bits |= magnitude(*code);
        }
    }
    bits
}

#[cfg(test)]
mod tests;
