//! The chain: blocks in, bearings and faults out.

use super::estimate::{self, Memory};
use super::intake::{Alignment, Intake};
use super::places::Places;
use super::plan::{FRAME, HOP, Plan};
use super::search::SearchWork;
use super::spectra::{Kept, Spectra};
use super::transform::Work;
use crate::block::{Block, CHANNELS};
use crate::demon;
use crate::health::{Accounting, LossCause};
use crate::slot::Slot;
use crate::wire::{Fault, FaultCode, Message};
use microfft::Complex32;

/// Samples of one frame that may be clipped before the frame is left out: 1 in 50 distorts the spectrum by less than
/// the ambient noise of a usable segment.
const CLIPPED_TOLERATED: usize = FRAME / 50;

/// Everything the chain remembers (about 45 KiB).
#[derive(Clone, Debug)]
pub struct State {
    intake: Intake,
    current: Spectra,
    previous: Kept,
    memory: Memory,
    dead: u8,
    clipping: u8,
    clipping_this_step: u8,
    level: [f32; CHANNELS],
    /// Invalid instants in a row so far; told as one fault when the row ends.
    invalid: u64,
    shaft: demon::State,
    shaft_report: Slot<demon::Report>,
}

/// Work space without memory between calls (about 28 KiB).
#[derive(Clone, Debug)]
pub struct Scratch {
    pub(crate) work: Work,
    pub(crate) search: SearchWork,
    pub(crate) spectrum: estimate::SpectrumWork,
}

impl Scratch {
    /// Empty work space.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            work: [Complex32::new(0.0, 0.0); 2 * FRAME],
            search: SearchWork::new(),
            spectrum: estimate::SpectrumWork::new(),
        }
    }
}

impl Default for Scratch {
    fn default() -> Self {
        Self::new()
    }
}

impl Default for State {
    fn default() -> Self {
        Self::new()
    }
}

impl State {
    /// A chain that has seen nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            intake: Intake::new(),
            current: Spectra::new(),
            previous: Kept::new(),
            memory: Memory::new(),
            dead: 0,
            clipping: 0,
            clipping_this_step: 0,
            level: [0.0; CHANNELS],
            invalid: 0,
            shaft: demon::State::new(),
            shaft_report: Slot::Empty,
        }
    }

    /// What the newest analysis for a shaft rate said, once; one falls due every `update_s` of good samples.
    pub fn take_shaft_report(&mut self) -> Option<demon::Report> {
        match core::mem::replace(&mut self.shaft_report, Slot::Empty) {
            Slot::Full(report) => Some(report),
            Slot::Empty => None,
        }
    }

    /// The envelope that shaft rates are looked for in.
    pub fn shaft(&self) -> &demon::State {
        &self.shaft
    }

    /// Sample instants by what became of them; totals every instant seen or known missing once frames are full
    /// (up to one frame is still waiting until [`finish`]).
    #[must_use]
    pub fn accounting(&self) -> Accounting {
        self.intake.accounting
    }

    /// Index after the last sample seen.
    #[must_use]
    pub fn next_index(&self) -> u64 {
        self.intake.next_index()
    }

    /// Bit c: recorder channel c is dead, stuck or a copy of another; bit 4 + c: it is clipping.
    #[must_use]
    pub fn channels(&self) -> u8 {
        self.dead | (self.clipping << CHANNELS)
    }

    /// Mean square of each hydrophone's signal in the band over full scale squared (a power ratio), last full step.
    #[must_use]
    pub fn level(&self) -> [f32; CHANNELS] {
        self.level
    }

    /// Tells the chain the azimuth (radians) and distance along the sound's way (metres) of each vessel whose tracker knows
    /// it; sources elsewhere have the reference range. Distances that are not finite or below 5 m are taken as unknown.
    pub fn set_places(&mut self, places: impl Iterator<Item = (f32, f32)>) {
        self.memory.places = Places::of(places);
    }
}

/// Takes a block of samples; records go to the sink in the order of their time.
pub fn push(
    plan: &Plan,
    state: &mut State,
    scratch: &mut Scratch,
    block: Block<'_>,
    sink: &mut impl FnMut(Message),
) {
    let mut frames = block.frames;
    match state.intake.align(block.first_index, frames.len()) {
        Alignment::Continues => {}
        Alignment::Gap(n) => fault(sink, FaultCode::Gap, block.first_index, n as i64),
        Alignment::Overlap(n) => {
            fault(sink, FaultCode::Overlap, state.intake.next_index(), n as i64);
            frames = frames.get(n as usize..).unwrap_or(&[]);
        }
        Alignment::Restart(n) => {
            close_step(plan, state, scratch, sink);
            state.current.begin(0);
            state.previous.forget();
            state.memory.forget();
            fault(sink, FaultCode::Restarted, block.first_index, n as i64);
        }
    }
    while !frames.is_empty() {
        let index = state.intake.next_index();
        let taken = state.intake.take(frames);
        if taken > 0 {
            end_invalid(state, index, sink);
        }
        frames = frames.get(taken..).unwrap_or(&[]);
        if state.intake.full() {
            frame(plan, state, scratch, sink);
        } else {
            let missing = state.intake.skip_missing(frames);
            state.invalid = state.invalid.saturating_add(missing as u64);
            frames = frames.get(missing..).unwrap_or(&[]);
        }
    }
}

/// The end of the input: the last segment is estimated and the last samples are accounted for.
pub fn finish(plan: &Plan, state: &mut State, scratch: &mut Scratch, sink: &mut impl FnMut(Message)) {
    end_invalid(state, state.intake.next_index(), sink);
    state.intake.end_run();
    close_step(plan, state, scratch, sink);
}

/// Tells of a row of invalid instants that ended at `index`.
fn end_invalid(state: &mut State, index: u64, sink: &mut impl FnMut(Message)) {
    let n = core::mem::take(&mut state.invalid);
    if n > 0 {
        fault(sink, FaultCode::Invalid, index, n.min(i64::MAX as u64) as i64);
    }
}

fn fault(sink: &mut impl FnMut(Message), code: FaultCode, index: u64, value: i64) {
    sink(Message::Fault(Fault { code, index, value }));
}

/// Uses the full frame of the intake, or loses it to a cause.
fn frame(plan: &Plan, state: &mut State, scratch: &mut Scratch, sink: &mut impl FnMut(Message)) {
    let index = state.intake.frame_index();
    let centre = index.saturating_add(FRAME as u64 / 2);
    let step = centre / plan.step_samples;
    if state.current.step != step {
        if state.current.frames > 0 {
            close_step(plan, state, scratch, sink);
            roll_channel_flags(state);
        }
        state.current.begin(step);
    }
    let found = inspect(&state.intake.codes, plan.clip_code);
    note_channels(state, &found, index, sink);
    let lost = if found.dead != 0 {
        Some(LossCause::DeadChannel)
    } else if found.clipped.iter().any(|n| *n > CLIPPED_TOLERATED) {
        Some(LossCause::Clipped)
    } else {
        None
    };
    if lost.is_none() {
        let power = state.current.add(plan, &state.intake.codes, &mut scratch.work);
        if let Some(config) = &plan.shaft
            && let Some(report) = demon::frame(config, &mut state.shaft, &mut scratch.work, index, power)
        {
            state.shaft_report = Slot::Full(report);
        }
        let start = step.saturating_mul(plan.step_samples.get());
        state.current.centres = state.current.centres.saturating_add(centre.saturating_sub(start));
    }
    state.current.clipped |= found.clipped.iter().any(|n| *n > 0);
    state.intake.advance(lost);
}

/// What a frame's codes show of the channels.
struct Inspection {
    /// Bit per channel: constant, or the same as an earlier channel.
    dead: u8,
    /// Clipped samples of each channel.
    clipped: [usize; CHANNELS],
}

/// Looks at the codes: constant, copied, clipped. Only frames that may hold clipped codes are counted sample by sample.
#[inline(never)]
fn inspect(codes: &[[i32; FRAME]; CHANNELS], clip_code: i32) -> Inspection {
    let mut found = Inspection { dead: 0, clipped: [0; CHANNELS] };
    for (c, (channel, clipped)) in codes.iter().zip(&mut found.clipped).enumerate() {
        let first = channel[0];
        // Ends at the second sample of a living channel.
        if channel.iter().all(|x| *x == first) {
            found.dead |= 1 << c;
            continue;
        }
        let magnitude = channel.iter().fold(0i32, |bits, x| bits | (x ^ (x >> 31)));
        if magnitude >= clip_code {
            *clipped = channel.iter().filter(|x| **x >= clip_code || **x <= -clip_code).count();
        }
        let copied = codes.iter().take(c).any(|earlier| earlier[1] == channel[1] && earlier == channel);
        if copied {
            found.dead |= 1 << c;
        }
    }
    found
}

/// Turns what one frame shows into flags and faults (a fault when a state begins, not while it lasts).
fn note_channels(state: &mut State, found: &Inspection, index: u64, sink: &mut impl FnMut(Message)) {
    for (c, clipped) in found.clipped.iter().enumerate() {
        let bit = 1u8 << c;
        let was_dead = state.dead & bit != 0;
        let is_dead = found.dead & bit != 0;
        if is_dead != was_dead {
            state.dead ^= bit;
            let code = if is_dead { FaultCode::DeadChannel } else { FaultCode::ChannelBack };
            fault(sink, code, index, c as i64);
        }
        if *clipped > 0 {
            if state.clipping & bit == 0 {
                fault(sink, FaultCode::Clipping, index, c as i64);
            }
            state.clipping |= bit;
            state.clipping_this_step |= bit;
        }
    }
}

/// A channel clips no longer once a whole step went by without.
fn roll_channel_flags(state: &mut State) {
    state.clipping = state.clipping_this_step;
    state.clipping_this_step = 0;
}

/// Estimates the segment that ends with the current step, which becomes the previous one.
fn close_step(plan: &Plan, state: &mut State, scratch: &mut Scratch, sink: &mut impl FnMut(Message)) {
    if state.current.frames == 0 {
        return;
    }
    note_level(plan, state);
    let two = plan.steps_per_segment == 2;
    let shortened = two && state.memory.turns_fast(plan);
    let join = two && !shortened && state.previous.precedes(state.current.step);
    let step = state.current.step;
    state.current.end_step(&mut state.previous, join, plan.step_samples.get());
    estimate::segment(plan, &mut state.memory, &mut state.current, scratch, shortened, sink);
    state.current.begin(step);
}

/// Band level of each hydrophone by Parseval's theorem from the step's auto-spectra.
fn note_level(plan: &Plan, state: &mut State) {
    let frames = state.current.frames.max(1) as f32;
    let scale = 2.0 / (plan.window_power * frames * plan.full_scale * plan.full_scale);
    for (channel, level) in state.level.iter_mut().enumerate() {
        let auto = state.current.runs.iter().flat_map(|run| run.auto[channel]);
        *level = scale * auto.take(plan.whole.high).skip(plan.whole.low).sum::<f32>();
    }
}

const _: () = assert!(HOP < FRAME && CHANNELS == 4);
