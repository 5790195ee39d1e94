//! From runs of codes to half-frames of samples: decimation, state of the channels, accounting.
//!
//! Enters: [`Run`]s in recorder channel order pressure, north, east, vertical. Leaves: hops of 512 samples of the three
//! used channels, with what is wrong with them. A gap ends the hop; what is left of it is a remainder. A component without
//! codes is a dead channel while it lasts: ranges need pressure alone. A clipped sample stays as it is, at the limit, which is nearer to
//! what it was than its neighbours are, and a spike is put right (`mend`): both cost their instants, not the hop. Cost: about 100
//! instructions a sample instant.

use super::decimate::DecimatorState;
use super::first_motion::FirstMotions;
use super::impulsive::Unevenness;
use super::limits::{HOP, USED_CHANNELS};
use super::mend::{Mender, Rails};
use super::moments::{Filtered, Moments};
use super::plan::Plan;
use super::row::UNEVEN;
use crate::block::CHANNELS;
use crate::health::{Accounting, LossCause};
use crate::intake::channels::Verdict;
use crate::intake::{Channels, Intake, Levels, Look, Run, Tolerance};
use crate::wire::Message;

/// Part of a hop's instants, which are those of the recording's own rate, from which on clipped samples of a channel are told: 4 of 512.
const CLIPPING: u32 = 128;

/// The same up to which the channel is used, an eighth: noise cut at 1.53 standard deviations, which is as
/// often at its limits, gets a floor 15 dB below itself.
const CLIPPED: u32 = 8;

/// The channels that estimators use, in bits.
const USED: u8 = 0b0111;

/// Half a frame.
#[derive(Clone, Debug)]
pub struct Hop {
    /// Samples of pressure, north, east.
    pub(super) samples: [[f32; HOP]; USED_CHANNELS],
    wrong: Verdict,
    /// Instants of it that count as clipped, and as no samples, though it is used.
    spoilt: [u64; 2],
    /// Index of the instant after its last.
    pub(super) end: u64,
    /// Greatest burst of pressure over its mean, in eighths.
    pub(super) uneven: u8,
    /// Whether it is full.
    full: bool,
    /// Instants of it that are in no bucket yet.
    open: u64,
}

impl Hop {
    const NEW: Self = Self {
        samples: [[0.0; HOP]; USED_CHANNELS],
        wrong: Verdict { dead: 0, copied: 0, clipped: 0, clipped_often: 0, holed: false },
        spoilt: [0; 2],
        end: 0,
        uneven: 0,
        full: false,
        open: 0,
    };

    /// Whether a channel can be used.
    pub(super) fn usable(&self, channel: u8) -> bool {
        !self.wrong.holed && (self.wrong.dead | self.wrong.clipped_often) >> channel & 1 == 0
    }

    /// It was used in a frame: each of its instants counts once, in its bucket.
    fn used(&mut self, accounting: &mut Accounting) {
        let mut open = core::mem::take(&mut self.open);
        let [clipped, spikes] = core::mem::take(&mut self.spoilt);
        for (cause, n) in [(LossCause::Clipped, clipped), (LossCause::Invalid, spikes)] {
            let n = n.min(open);
            accounting.lose(cause, n);
            open -= n;
        }
        accounting.processed = accounting.processed.saturating_add(open);
    }

    /// Takes part in no further frame: what is in no bucket goes to the one of its trouble with pressure.
    fn retire(&mut self, accounting: &mut Accounting) {
        let cause = match self.wrong {
            Verdict { holed: true, .. } => LossCause::Invalid,
            Verdict { dead, .. } if dead & 1 != 0 => LossCause::DeadChannel,
            Verdict { clipped_often, .. } if clipped_often & 1 != 0 => LossCause::Clipped,
            _ => LossCause::Remainder,
        };
        accounting.lose(cause, core::mem::take(&mut self.open));
        self.full = false;
    }
}

/// The hop being filled and the one before.
#[derive(Clone, Debug)]
pub struct Hops {
    mender: Mender,
    rails: Rails,
    /// Spikes put right in the hop being filled.
    spikes: u64,
    decimator: DecimatorState,
    pub(super) old: Hop,
    pub(super) new: Hop,
    fill: usize,
    look: Look,
    levels: Levels,
    channels: Channels,
    unevenness: Unevenness,
    filtered: Filtered,
    pub(super) first_motions: FirstMotions,
    /// Whether the hop before was spoilt.
    rings: bool,
    /// Whether the run goes on.
    running: bool,
}

impl Hops {
    /// Nothing seen; all zeros.
    pub const fn new() -> Self {
        Self {
            mender: Mender::new(),
            rails: Rails::new(),
            spikes: 0,
            decimator: DecimatorState::new(),
            old: Hop::NEW,
            new: Hop::NEW,
            fill: 0,
            look: Look::NEW,
            levels: Levels::new(),
            channels: Channels::new(),
            unevenness: Unevenness::new(),
            filtered: Filtered::new(),
            first_motions: FirstMotions::NONE,
            rings: false,
            running: false,
        }
    }

    /// Whether a run is about to begin.
    pub fn begins(&self) -> bool {
        !self.running
    }

    /// Whether the two hops are neighbours and make a frame.
    pub fn pair(&self) -> bool {
        self.old.full && self.new.full
    }

    /// Moments of the last hop, none where a component of it was wrong, a sample was put right in it or in the one before, after which
    /// the filter rings on, or a burst stands out of it: spikes that are not put right are common to all components, and no sound.
    pub(super) fn moments(&mut self) -> Option<Moments> {
        let moments = self.filtered.end_hop();
        let spoilt = self.new.spoilt != [0; 2];
        let rings = core::mem::replace(&mut self.rings, spoilt);
        let still = !spoilt && !rings && self.new.uneven < UNEVEN;
        (still && (0..CHANNELS as u8).all(|c| self.new.usable(c))).then_some(moments)
    }

    /// Bit c: channel c dead; bit 4 + c: channel c clipped, as of the last hop.
    pub fn channel_flags(&self) -> u8 {
        self.channels.flags()
    }

    /// Level of each channel in the last hop, half decibels re full scale ([`Levels::half_db`]).
    pub fn level_half_db(&self, elapsed: u64, minute: u64) -> [i8; CHANNELS] {
        self.levels.half_db(elapsed, minute)
    }

    /// Takes instants of a run, from number `from` on, up to one that fills a hop: how many were taken, and whether the last did.
    // Its work space is not the estimators' below.
    #[inline(never)]
    pub fn take(
        &mut self,
        plan: &Plan<'_>,
        intake: &mut Intake,
        run: &Run<'_>,
        from: usize,
        sink: &mut dyn FnMut(Message),
    ) -> (usize, bool) {
        let rest = run.frames.get(from..).unwrap_or_default();
        // An instant gives one sample at most, so that only the last of these can fill the hop.
        let frames = rest.get(..HOP.saturating_sub(self.fill)).unwrap_or(rest);
        let Some(first) = frames.first() else { return (rest.len(), false) };
        if !self.running {
            self.running = true;
            self.unevenness = Unevenness::new();
            self.mender.restart();
            self.decimator.restart();
            self.filtered.begin(&plan.moments, first);
            self.first_motions.begin();
        }
        self.look.see(run, frames, plan.clip);
        if run.mended == 0 {
            self.rails.see(frames);
        }
        self.levels.extend(frames.iter().copied());
        let (mut filtered, mut unevenness) = (self.filtered.clone(), self.unevenness.clone());
        // Each filter waits for its own past: one instant through all of them.
        for frame in frames {
            let [p, n, e, _] = frame;
            let passed = filtered.push(&plan.moments, frame);
            if plan.onset_block > 0 {
                self.first_motions.push(plan.onset_block, passed);
            }
            let Some((x, spike)) = self.mender.push([p, n, e].map(|code| *code as f32)) else { continue };
            self.spikes += u64::from(spike);
            let Some(x) = plan.decimator.push(&mut self.decimator, x) else { continue };
            if self.fill == 0 {
                // The hop before becomes the older one; the one before that is done with.
                self.old.retire(&mut intake.accounting);
                core::mem::swap(&mut self.old, &mut self.new);
            }
            unevenness.push(&plan.calls, x[0]);
            for (channel, x) in self.new.samples.iter_mut().zip(x) {
                if let Some(slot) = channel.get_mut(self.fill) {
                    *slot = x;
                }
            }
            self.fill += 1;
        }
        filtered.sums.instants += frames.len() as u32;
        (self.filtered, self.unevenness) = (filtered, unevenness);
        if self.fill < HOP {
            return (frames.len(), false);
        }
        let index = run.first_index.saturating_add((from + frames.len() - 1) as u64);
        self.fill = 0;
        self.new.uneven = self.unevenness.end_hop();
        self.new.end = (index + 1).saturating_sub((plan.decimator.lag() + Mender::LAG) as u64);
        self.new.full = true;
        self.new.open = self.look.open();
        let instants = self.look.instants;
        let (missing, most_clipped) = (instants / 8, instants / CLIPPED);
        let at_rail = self.rails.end(instants);
        let clipped = self.look.clipped();
        let clipped: [u32; CHANNELS] =
            core::array::from_fn(|c| clipped.get(c).max(at_rail.get(c)).copied().unwrap_or(0));
        let over = |least: u32| clipped.iter().rev().fold(0u8, |bits, n| bits << 1 | u8::from(*n >= least));
        self.new.wrong = self.look.verdict(&Tolerance { clipped: most_clipped, missing });
        self.new.wrong.clipped_often = over(most_clipped + 1);
        // As many instants as the most clipped of the channels that can be used has samples.
        let used = clipped.iter().enumerate().filter(|(c, n)| USED >> c & 1 == 1 && **n <= most_clipped);
        let most = used.map(|(_, n)| *n).max();
        self.new.spoilt = [u64::from(most.unwrap_or(0)), core::mem::take(&mut self.spikes)];
        self.channels.see(self.new.wrong.dead, over(instants / CLIPPING), index, &mut intake.faults, sink);
        self.channels.roll();
        self.levels.close(plan.full_scale, intake.elapsed());
        self.look = Look::NEW;
        (frames.len(), true)
    }

    /// The frame of the two hops was used: each counts once.
    pub fn used(&mut self, accounting: &mut Accounting) {
        for hop in [&mut self.old, &mut self.new] {
            hop.used(accounting);
        }
    }

    /// Ends the run: its last hop and what did not fill one are accounted for.
    pub fn end(&mut self, accounting: &mut Accounting) {
        self.old.retire(accounting);
        self.new.retire(accounting);
        accounting.lose(LossCause::Remainder, self.look.open());
        self.look = Look::NEW;
        self.rails.restart();
        self.spikes = 0;
        self.fill = 0;
        self.running = false;
    }

    /// No samples have come for a minute.
    pub(super) fn silent(&mut self) {
        self.levels.forget();
    }

    /// Forgets everything, in place.
    pub(super) fn forget(&mut self) {
        self.end(&mut Accounting::default());
        self.mender = Mender::new();
        self.rails = Rails::new();
        self.levels = Levels::new();
        self.channels = Channels::new();
        self.first_motions = FirstMotions::NONE;
    }
}
