//! The chain: blocks in, bearings and faults out.

use super::estimate;
use super::framing::Framing;
use super::impulses::Impulses;
use super::memory::Memory;
use super::places::Places;
use super::plan::{FRAME, HOP, Plan};
use super::search::SearchWork;
use super::spectra::{Kept, Spectra};
use super::transform::Work;
use super::transients::Transients;
use crate::block::{Block, CHANNELS};
use crate::demon;
use crate::density::Density;
use crate::health::{Accounting, LossCause};
use crate::intake::{Channels, Event, Intake, Levels, Run, Step, Tolerance};
use crate::slot::Slot;
use crate::slow_levels::SlowLevels;
use crate::wire::{FaultCode, Message};
use microfft::Complex32;

/// Samples of one frame that may be clipped or stand for missing ones before the frame is left out: 1 in 50 distorts the
/// spectrum by less than the ambient noise of a usable segment.
const TOLERANCE: Tolerance = Tolerance { clipped: BRIDGE, missing: BRIDGE };

/// Longest absence that is bridged, instants.
pub(super) const BRIDGE: u32 = FRAME as u32 / 50;

/// Frames in a row for which a channel must be dead before the three others go on without it: half a second at 64 kHz. A
/// shorter silence costs its own frames, not the fourth hydrophone of the whole segment.
const DEAD_FRAMES: u8 = 71;

/// Of so many instants one goes into the level: 2000 of half a second at 64 kHz.
const LEVEL_EVERY: usize = 16;

/// Everything the chain remembers; `docs/budget.txt` has the recorder's memory.
#[derive(Clone, Debug)]
pub struct State {
    pub(crate) intake: Intake,
    framing: Framing,
    channels: Channels,
    levels: Levels,
    slow: SlowLevels,
    impulses: Impulses,
    transients: Transients,
    /// Number of the step the newest frame belongs to.
    step: u64,
    current: Spectra,
    previous: Kept,
    memory: Memory,
    shaft: demon::State,
    shaft_report: Slot<demon::RateReport>,
    /// Frames in a row with a dead channel.
    dead_for: u8,
}

/// Work space without memory between calls.
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
            work: [Complex32::new(0.0, 0.0); 2 * FRAME + 1],
            search: SearchWork::new(),
            spectrum: estimate::SpectrumWork::new(),
        }
    }
}

impl State {
    /// A chain that has seen nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            intake: Intake::new(),
            framing: Framing::new(),
            channels: Channels::new(),
            levels: Levels::new(),
            slow: SlowLevels::new(),
            impulses: Impulses::new(),
            transients: Transients::new(),
            step: 0,
            current: Spectra::new(),
            previous: Kept::new(),
            memory: Memory::new(),
            shaft: demon::State::new(),
            shaft_report: Slot::Empty,
            dead_for: 0,
        }
    }

    /// What the newest analysis for a shaft rate said, once; one falls due every `update_s` of good samples.
    pub fn take_shaft_report(&mut self) -> Option<demon::RateReport> {
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

    /// Bit c: recorder channel c is dead, stuck or a copy of another, or left out; bit 4 + c: it is clipping.
    #[must_use]
    pub fn channels(&self, plan: &Plan) -> u8 {
        self.channels.flags() | plan.recorder_channels(self.memory.sick.out())
    }

    /// Whether a frame can be used in which these channels are dead (bit c: channel c), those among them `copied` from
    /// another: none, or one that has been stuck for a while. Which of two equal ones is the copy nobody can say.
    fn lasting_dead(&mut self, dead: u8, copied: u8) -> bool {
        if dead == 0 {
            self.dead_for = 0;
        } else {
            self.dead_for = self.dead_for.saturating_add(1);
        }
        dead == 0 || (copied == 0 && dead.is_power_of_two() && self.dead_for > DEAD_FRAMES)
    }

    /// Level of each channel over the last full step, half decibels re full scale ([`Levels::half_db`]).
    #[must_use]
    pub fn level_half_db(&self, plan: &Plan) -> [i8; CHANNELS] {
        self.levels.half_db(self.intake.elapsed(), plan.intake.minute())
    }

    /// Spectrum of a recorder channel over the last step in which frames could be used.
    // Apart, because it is asked for in two places.
    #[inline(never)]
    pub(crate) fn density(&self, plan: &Plan, channel: u8) -> Option<Density> {
        let hydrophone = plan.channels.iter().position(|c| *c == channel)?;
        self.previous.density(plan, hydrophone)
    }

    /// No samples have come for a minute.
    pub(crate) fn silent(&mut self) {
        self.levels.forget();
    }

    /// Forgets everything, in place.
    pub(crate) fn forget(&mut self) {
        self.intake = Intake::new();
        self.framing.forget();
        self.channels = Channels::new();
        self.levels = Levels::new();
        self.slow = SlowLevels::new();
        self.impulses = Impulses::new();
        self.transients = Transients::new();
        self.step = 0;
        self.current.begin(0);
        self.previous.forget();
        self.memory = Memory::new();
        self.shaft = demon::State::new();
        self.shaft_report = Slot::Empty;
        self.dead_for = 0;
    }

    /// Tells the chain the azimuth (radians), distance along the sound's way and its standard deviation (metres) of each vessel
    /// whose tracker knows it; sources elsewhere have the reference range. Distances that are not finite or below 5 m are taken as unknown.
    pub fn set_places(&mut self, places: impl Iterator<Item = (f32, f32, f32)>) {
        self.memory.places = Places::of(places);
    }

    /// Whether an echo off the bottom is known.
    #[cfg(test)]
    pub(super) fn hears_echo(&self) -> bool {
        self.memory.echo.heard()
    }

    /// Azimuth (radians) and depth (metres) of the strongest source, where fringes tell its depth: its elevations are told
    /// by that, others' by the depth assumed of vessels.
    pub fn depth_known(&self) -> Option<(f32, f32)> {
        self.memory.depth_known()
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
    let mut rest = block;
    while let Some(step) = state.intake.next(&plan.intake, &mut rest, sink) {
        match step {
            Step::Samples(run) => samples(plan, state, scratch, &run, sink),
            Step::Mended(instant) => samples(plan, state, scratch, &instant.run(), sink),
            Step::Event(is) => event(plan, state, scratch, is, sink),
            Step::Time(_) => {}
        }
    }
}

/// Takes samples that follow those before.
pub(crate) fn samples(
    plan: &Plan,
    state: &mut State,
    scratch: &mut Scratch,
    run: &Run<'_>,
    sink: &mut impl FnMut(Message),
) {
    let mut frames = run.frames;
    while !frames.is_empty() {
        frames = state.framing.take(run, frames, plan.clip_code);
        if state.framing.full() {
            frame(plan, state, scratch, sink);
        }
    }
}

/// Takes a break: a gap ends the frame; before time starts again the open segment is estimated, and nothing stays of it.
pub(crate) fn event(
    plan: &Plan,
    state: &mut State,
    scratch: &mut Scratch,
    event: Event,
    sink: &mut impl FnMut(Message),
) {
    state.framing.end(&mut state.intake.accounting);
    state.memory.agreement.gap();
    if let Event::Restart(_) = event {
        close_step(plan, state, scratch, sink);
        end_transients(plan, state, sink);
        state.slow.end(&plan.slow, sink);
        state.current.begin(0);
        state.previous.forget();
        state.memory.forget();
        state.levels = Levels::new();
        state.step = 0;
        state.shaft = demon::State::new();
    }
}

/// No samples come: the open segment is estimated, and samples that wait for a full frame are accounted for.
pub(crate) fn pause(plan: &Plan, state: &mut State, scratch: &mut Scratch, sink: &mut impl FnMut(Message)) {
    state.framing.end(&mut state.intake.accounting);
    close_step(plan, state, scratch, sink);
    end_transients(plan, state, sink);
}

/// Tells of transients whatever waits.
#[inline(never)]
fn end_transients(plan: &Plan, state: &mut State, sink: &mut impl FnMut(Message)) {
    let out = plan.recorder_channels(state.memory.sick.out());
    state.transients.end(plan, out, state.intake.elapsed(), sink);
}

/// The end of the input: the last segment is estimated and the last samples are accounted for.
pub fn finish(plan: &Plan, state: &mut State, scratch: &mut Scratch, sink: &mut impl FnMut(Message)) {
    pause(plan, state, scratch, sink);
    state.slow.end(&plan.slow, sink);
    state.intake.finish(&plan.intake, sink);
}

/// Uses the full frame, or loses it to a cause. Inlined into the loop over blocks, each of these would reckon hundreds of addresses
/// that only a full frame needs.
#[inline(never)]
fn frame(plan: &Plan, state: &mut State, scratch: &mut Scratch, sink: &mut impl FnMut(Message)) {
    let index = state.framing.index();
    let centre = index.saturating_add(FRAME as u64 / 2);
    let step = centre / plan.step_samples;
    if state.step != step {
        end_step(plan, state, scratch, sink);
        state.current.begin(step);
        state.step = step;
        state.slow.go_on(&plan.slow, step.saturating_mul(plan.step_samples.get()), sink);
    }
    let look = state.framing.look();
    let found = look.verdict(&TOLERANCE);
    state.channels.see(found.dead, found.clipped, index, &mut state.intake.faults, sink);
    let left = state.lasting_dead(found.dead, found.copied);
    let before = state.levels.sums();
    let [c0, c1, c2, c3] = &state.framing.codes;
    // One in so many, as whole pieces: stepping through all four at once would visit every instant.
    let [c0, c1, c2, c3] = [c0, c1, c2, c3].map(|c| c.as_chunks::<LEVEL_EVERY>().0);
    let some = c0.iter().zip(c1).zip(c2).zip(c3).take(HOP / LEVEL_EVERY);
    state.levels.extend(some.map(|((([a, ..], [b, ..]), [c, ..]), [d, ..])| [*a, *b, *c, *d]));
    let lost = if found.holed {
        Some(LossCause::Invalid)
    } else if !left {
        Some(LossCause::DeadChannel)
    } else if found.clipped_often != 0 {
        Some(LossCause::Clipped)
    } else {
        None
    };
    let rough = state.levels.since(&before);
    let elapsed = state.intake.elapsed();
    let State { framing, impulses, transients, memory, .. } = state;
    let codes = &mut framing.codes;
    // A sound that clips gives no bearing, and is a transient all the same.
    let burst = matches!(lost, None | Some(LossCause::Clipped))
        && impulses.take(plan, codes, &rough, &look.loudest, found.dead, |codes, outstanding| {
            let out = found.dead | plan.recorder_channels(memory.sick.out());
            transients.take(plan, (index, codes), outstanding, out, elapsed, sink);
        });
    let burst = burst && lost.is_none();
    state.current.added.burst |= burst;
    if lost.is_none() && !burst {
        let start = step.saturating_mul(plan.step_samples.get());
        state.current.added.dead |= plan.hydrophones(found.dead);
        let out = state.current.added.dead | state.memory.sick.out();
        let power = state.current.add(plan, codes, centre.saturating_sub(start), out, &mut scratch.work);
        if let Some(config) = &plan.shaft
            && let Some(work) = scratch.work.first_chunk_mut()
            && let Some(report) = demon::frame(config, &mut state.shaft, work, index, power)
        {
            state.shaft_report = Slot::Full(report);
        }
        state.current.added.bridged |= look.counted > 0;
    }
    state.current.added.clipped |= found.clipped != 0;
    state.framing.advance(lost, &mut state.intake.accounting);
}

/// The frames of a step are complete: its segment is estimated, its level made.
fn end_step(plan: &Plan, state: &mut State, scratch: &mut Scratch, sink: &mut impl FnMut(Message)) {
    let elapsed = state.intake.elapsed();
    state.levels.close(plan.full_scale, elapsed);
    state.channels.roll();
    state.transients.due(elapsed, plan.intake.minute(), false, sink);
    if let Some(frames) = state.impulses.due(elapsed, plan.intake.minute()) {
        let index = state.framing.index();
        state.intake.faults.note(FaultCode::Impulses, index, u64::from(frames), sink);
    }
    close_step(plan, state, scratch, sink);
}

/// Estimates the segment that ends with the current step, which becomes the previous one.
fn close_step(plan: &Plan, state: &mut State, scratch: &mut Scratch, sink: &mut impl FnMut(Message)) {
    if state.current.added.frames == 0 {
        return;
    }
    if plan.slow.is_on() {
        loudness(plan, state, sink);
    }
    let two = plan.steps_per_segment == 2;
    let shortened = two && state.memory.turns_fast(plan);
    let join = two && !shortened && state.previous.precedes(state.current.added.step);
    let step = state.current.added.step;
    let State { intake, memory, current, previous, .. } = state;
    current.end_step(previous, join, plan.step_samples.get());
    let sink = &mut |message| intake.faults.pass(message, sink);
    estimate::segment(plan, memory, current, scratch, shortened, sink);
    current.begin(step);
}

/// The step's frames into the slow levels, unless their hydrophone was dead.
fn loudness(plan: &Plan, state: &mut State, sink: &mut impl FnMut(Message)) {
    let added = &state.current.added;
    let hydrophone = plan.channels.iter().position(|c| *c == plan.slow.channel);
    let (Some(hydrophone), Some(middle)) = (hydrophone, added.middle(plan)) else { return };
    state.slow.go_on(&plan.slow, added.step.saturating_mul(plan.step_samples.get()), sink);
    if added.dead >> hydrophone & 1 == 0
        && let Some(sums) = state.slow.add(added.frames, middle)
    {
        state.current.add_bands(hydrophone, sums);
    }
}

const _: () = assert!(HOP < FRAME && CHANNELS == 4);
