//! From blocks of codes to half-frames of samples: index continuity, invalid, clipped and dead channels, accounting.
//!
//! Enters: [`Block`]s in recorder channel order pressure, north, east, vertical. Leaves: hops of 512 samples of the three
//! used channels, with what is wrong with them, and faults. A gap or an invalid pressure sample ends the run: what is left
//! of its hop is counted as remainder and frames begin anew after it. Another component without samples is a dead channel
//! while it lasts: ranges need pressure alone. Cost: about 40 instructions a sample instant.

use super::decimate::DecimatorState;
use super::impulsive::Unevenness;
use super::limits::{HOP, USED_CHANNELS};
use super::plan::Plan;
use crate::block::{Block, CHANNELS, Frame, MISSING};
use crate::health::{Accounting, LossCause};
use crate::math;
use crate::wire::{Fault, FaultCode, Message};

/// Clipped samples in a hop from which on it is not used: fewer hardly raise the noise floor.
const CLIPPED_TOO_OFTEN: u16 = 4;

/// Index jumps back by more than this many seconds: the recorder's clock was set back, not a block repeated.
const CLOCK_SET_BACK_S: f64 = 600.0;

/// What is wrong with one channel of a hop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Condition {
    /// At the converter's limit too often.
    pub clipped: bool,
    /// The same code throughout, or no valid sample somewhere.
    pub dead: bool,
}

impl Condition {
    /// Whether the channel can be used.
    pub fn usable(self) -> bool {
        !self.clipped && !self.dead
    }
}

/// Running look at one channel of the hop being filled.
#[derive(Clone, Copy, Debug)]
struct Watch {
    low: i32,
    high: i32,
    clipped: u16,
    square: f32,
    n: u32,
    /// Last valid code, which stands in for missing ones: no step where they begin.
    last: i32,
    missing: bool,
}

impl Watch {
    const NEW: Self =
        Self { low: i32::MAX, high: i32::MIN, clipped: 0, square: 0.0, n: 0, last: 0, missing: false };
    const ZERO: Self = Self { low: 0, high: 0, clipped: 0, square: 0.0, n: 0, last: 0, missing: false };

    /// Looks at one code; what to use for it.
    fn see(&mut self, code: i32, clip: i32) -> i32 {
        if code == MISSING {
            self.missing = true;
            return self.last;
        }
        self.last = code;
        self.low = self.low.min(code);
        self.high = self.high.max(code);
        self.clipped = self.clipped.saturating_add(u16::from(code >= clip || code <= -clip));
        self.square += code as f32 * code as f32;
        self.n += 1;
        code
    }

    /// Ready for the next hop.
    fn renew(&mut self) {
        *self = Self { last: self.last, ..Self::NEW };
    }
}

/// What the caller must do after a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Nothing.
    None,
    /// A hop is full: `Intake::old` and `new` make a frame if `Intake::pair`.
    Hop,
}

/// State of the intake.
#[derive(Clone, Debug)]
pub struct Intake {
    decimator: DecimatorState,
    /// The hop before the newest.
    pub(super) old: Hop,
    /// The newest hop.
    pub(super) new: Hop,
    fill: usize,
    watch: [Watch; CHANNELS],
    unevenness: Unevenness,
    /// Condition of each channel, last known.
    pub(super) condition: [Condition; CHANNELS],
    /// Level of each channel in the last hop, half decibels re full scale.
    pub(super) level_half_db: [i8; CHANNELS],
    next_index: Option<u64>,
    /// Instants taken since the run began.
    run_length: u64,
    /// Instants since the last hop ended.
    since_hop: u64,
    /// Account of all instants.
    pub accounting: Accounting,
    /// Faults already reported this minute; beyond [`FAULTS_A_MINUTE`] they are only counted.
    pub(super) reported: u8,
}

/// Faults reported a minute, so that a broken link or channel cannot fill the telemetry.
pub const FAULTS_A_MINUTE: u8 = 3;

/// Half a frame.
#[derive(Clone, Debug)]
pub struct Hop {
    /// Samples of pressure, north, east.
    pub(super) samples: [[f32; HOP]; USED_CHANNELS],
    pub(super) condition: [Condition; CHANNELS],
    /// Index of the instant after its last.
    pub(super) end: u64,
    /// Greatest burst of pressure over its mean, in eighths.
    pub(super) uneven: u8,
    /// Instants it stands for; 0 where there is no hop.
    instants: u64,
    counted: bool,
}

impl Hop {
    const NEW: Self = Self {
        samples: [[0.0; HOP]; USED_CHANNELS],
        condition: [Condition { clipped: false, dead: false }; CHANNELS],
        end: 0,
        uneven: 0,
        instants: 0,
        counted: false,
    };
}

impl Default for Intake {
    fn default() -> Self {
        Self::new()
    }
}

impl Intake {
    /// Nothing seen; all zeros.
    pub const fn new() -> Self {
        Self {
            decimator: DecimatorState::new(),
            old: Hop::NEW,
            new: Hop::NEW,
            fill: 0,
            watch: [Watch::ZERO; CHANNELS],
            unevenness: Unevenness::new(),
            condition: [Condition { clipped: false, dead: false }; CHANNELS],
            level_half_db: [0; CHANNELS],
            next_index: None,
            run_length: 0,
            since_hop: 0,
            accounting: Accounting { processed: 0, lost: [0; crate::health::LOSS_CAUSES] },
            reported: 0,
        }
    }

    /// Index of the instant after the last seen.
    pub fn next_index(&self) -> u64 {
        self.next_index.unwrap_or(0)
    }

    /// Whether a run is about to begin.
    pub fn begins(&self) -> bool {
        self.run_length == 0
    }

    /// Whether the two hops are neighbours and make a frame.
    pub fn pair(&self) -> bool {
        self.old.instants > 0 && self.new.instants > 0
    }

    /// Looks at where a block begins. Gives how many of its first samples to leave out, and whether time went back
    /// so far that everything learned about time is void.
    pub fn arrive(
        &mut self,
        plan: &Plan<'_>,
        block: &Block<'_>,
        sink: &mut dyn FnMut(Message),
    ) -> (usize, bool) {
        let first = block.first_index;
        let Some(expected) = self.next_index else {
            self.begin(first);
            return (0, false);
        };
        if first == expected {
            return (0, false);
        }
        let mut reported = self.reported;
        let mut fault =
            |code, n: u64| report(&mut reported, sink, Fault { code, index: first, value: n as i64 });
        if first > expected {
            let n = first - expected;
            fault(FaultCode::Gap, n);
            self.reported = reported;
            self.accounting.lose(LossCause::Gap, n);
            self.end_run();
            self.begin(first);
            return (0, false);
        }
        let back = expected - first;
        fault(FaultCode::Overlap, back);
        self.reported = reported;
        if back as f64 > CLOCK_SET_BACK_S * plan.rate_hz {
            self.end_run();
            self.begin(first);
            return (0, true);
        }
        let repeated = (back as usize).min(block.frames.len());
        self.accounting.lose(LossCause::Overlap, repeated as u64);
        (repeated, false)
    }

    fn begin(&mut self, index: u64) {
        self.next_index = Some(index);
        self.run_length = 0;
        self.since_hop = 0;
        self.fill = 0;
        self.watch = [Watch::NEW; CHANNELS];
        self.unevenness = Unevenness::new();
        self.decimator = DecimatorState::new();
    }

    /// Closes the run: its last hop and what did not fill one are accounted for.
    pub fn end_run(&mut self) {
        self.retire(LossCause::Remainder);
        self.old.instants = 0;
        core::mem::swap(&mut self.old, &mut self.new);
        self.retire(LossCause::Remainder);
        self.old.instants = 0;
        self.new.instants = 0;
        self.accounting.lose(LossCause::Remainder, self.since_hop);
        self.since_hop = 0;
        self.fill = 0;
    }

    /// Accounts for the older hop, which takes part in no further frame.
    fn retire(&mut self, otherwise: LossCause) {
        if self.old.instants > 0 && !self.old.counted {
            let pressure = self.old.condition.first().copied().unwrap_or_default();
            let cause = match pressure {
                Condition { dead: true, .. } => LossCause::DeadChannel,
                Condition { clipped: true, .. } => LossCause::Clipped,
                _ => otherwise,
            };
            self.accounting.lose(cause, self.old.instants);
        }
        self.old.counted = true;
    }

    /// The frame of the two hops was used: each counts once.
    pub fn used(&mut self) {
        for hop in [&mut self.old, &mut self.new] {
            if !hop.counted {
                self.accounting.processed = self.accounting.processed.saturating_add(hop.instants);
                hop.counted = true;
            }
        }
    }

    /// Takes one instant.
    pub fn take(&mut self, plan: &Plan<'_>, frame: &Frame, sink: &mut dyn FnMut(Message)) -> Event {
        let index = self.next_index();
        self.next_index = Some(index + 1);
        let [pressure, ..] = *frame;
        if pressure == MISSING {
            if self.run_length > 0 {
                report(&mut self.reported, sink, Fault { code: FaultCode::Invalid, index, value: 1 });
            }
            self.accounting.lose(LossCause::Invalid, 1);
            self.end_run();
            self.begin(index + 1);
            return Event::None;
        }
        self.run_length += 1;
        self.since_hop += 1;
        let mut used = [0.0; CHANNELS];
        for ((used, watch), code) in used.iter_mut().zip(&mut self.watch).zip(frame) {
            *used = watch.see(*code, plan.clip) as f32;
        }
        let [p, n, e, _] = used;
        let Some(x) = plan.decimator.push(&mut self.decimator, [p, n, e]) else {
            return Event::None;
        };
        let [pressure, ..] = x;
        self.unevenness.push(&plan.calls, pressure);
        if self.fill == 0 {
            // The hop before becomes the older one; the one before that is done with.
            self.retire(LossCause::Remainder);
            core::mem::swap(&mut self.old, &mut self.new);
            self.new.instants = 0;
        }
        for (channel, x) in self.new.samples.iter_mut().zip(x) {
            if let Some(slot) = channel.get_mut(self.fill) {
                *slot = x;
            }
        }
        self.fill += 1;
        if self.fill < HOP {
            return Event::None;
        }
        self.fill = 0;
        self.new.uneven = self.unevenness.end_hop();
        self.new.instants = self.since_hop;
        self.new.counted = false;
        self.new.end = index + 1 - (plan.decimator.lag() as u64).min(index);
        self.since_hop = 0;
        self.judge(plan, index, sink);
        Event::Hop
    }

    /// Decides what is wrong with the hop just filled and reports changes.
    fn judge(&mut self, plan: &Plan<'_>, index: u64, sink: &mut dyn FnMut(Message)) {
        let watched = self.watch.iter_mut().zip(&mut self.condition).zip(&mut self.level_half_db);
        let reported = &mut self.reported;
        for (c, ((w, condition), level)) in watched.enumerate() {
            let now =
                Condition { clipped: w.clipped >= CLIPPED_TOO_OFTEN, dead: w.missing || w.low >= w.high };
            let mut fault = |code| report(reported, sink, Fault { code, index, value: c as i64 });
            match (condition.dead, now.dead) {
                (false, true) => fault(FaultCode::DeadChannel),
                (true, false) => fault(FaultCode::ChannelBack),
                _ => {}
            }
            if now.clipped && !condition.clipped {
                fault(FaultCode::Clipping);
            }
            *condition = now;
            let full = plan.clip as f32;
            let db = math::db(w.square / (w.n.max(1) as f32 * full * full));
            *level = (2.0 * db).clamp(-128.0, 0.0) as i8;
            w.renew();
        }
        self.new.condition = self.condition;
    }
}

/// Reports a fault while the minute's allowance lasts.
fn report(reported: &mut u8, sink: &mut dyn FnMut(Message), fault: Fault) {
    if *reported < FAULTS_A_MINUTE {
        *reported += 1;
        sink(Message::Fault(fault));
    }
}
