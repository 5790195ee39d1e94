//! The ocean-bottom recorder's estimators in order: blocks in, one set of records a minute out.
//!
//! Enters: [`Block`]s in channel order pressure, north, east, vertical. Leaves, through the sink: `Azimuth`, `Range`,
//! `Segment`, `Track` and `Fault` messages. Frame m of a run covers samples 512 m to 512 m + 1023 and carries the time
//! of sample 512 (m + 1). Records stand on whole minutes t0 of the sample count; a window holds the frames within 90 s of
//! t0, a minute's range those within 30 s. Records of t0 leave when the first frame beyond t0 + 90 s is complete.
//! Directions and ranges are those of the vessel when its sound left it.

use super::ambient::Ambient;
use super::averages::Averages;
use super::azigram::{self, Sources};
use super::bands;
use super::bursts::Excess;
use super::cepstrum;
use super::checks::{Checks, Heard, Minute as Checked};
use super::clutter::Clutter;
use super::evened::Evened;
use super::evidence::{Evidence, Minute};
use super::hops::Hops;
use super::impulsive;
use super::limits::{MINUTE_FRAMES, QUEFRENCIES, WINDOW_FRAMES};
use super::lines::Lines;
use super::minute_records::{clear_speed_m_s, is_sudden, send};
use super::pairs::Profiles;
use super::paper;
use super::plan::{HALF_WINDOW_S, Plan, STEP_S};
use super::presence::{ExpectedVessels, Presence};
use super::radial::RadialScratch;
use super::row::Row;
use super::segment::Segmenter;
use super::shared::Shared;
use super::steady::{self, Steady};
use super::tracks::Tracker;
use crate::block::{Block, CHANNELS};
use crate::health::Accounting;
use crate::intake::{Event, Intake, Run, Step};
use crate::math;
use crate::slow_levels::SlowLevels;
use crate::wire::Message;
use core::num::NonZeroU64;

/// Steps of a stored cepstrum.
const CEPSTRUM_UNIT: f32 = 1.0 / 32_768.0;

/// Longest silence worked through minute by minute, minutes; after a longer one the station starts afresh.
const LONGEST_SILENCE: u8 = 30;

/// The same where the board's clock alone counts it, seconds.
pub(crate) const CLOSED_AFTER_S: u32 = 60 * LONGEST_SILENCE as u32;

/// One frame, kept for a window.
#[derive(Clone, Debug)]
struct Kept {
    /// Sample index of the frame's time label; 0 frames are told by `used`.
    label: u64,
    used: bool,
    row: Row,
    cepstrum: [i16; QUEFRENCIES],
}

/// Stands where a window has no more frames.
static NO_ROW: Row = Row::EMPTY;

const NOT_KEPT: Kept = Kept { label: 0, used: false, row: Row::ZERO, cepstrum: [0; QUEFRENCIES] };

/// Everything that persists.
#[derive(Clone, Debug)]
pub struct State {
    pub(crate) intake: Intake,
    hops: Hops,
    kept: [Kept; WINDOW_FRAMES],
    next_kept: usize,
    ambient: Ambient,
    lines: Lines,
    clutter: Clutter,
    steady: Steady,
    pub(crate) averages: Averages,
    slow: SlowLevels,
    presence: Presence,
    evidence: Evidence,
    segmenter: Segmenter,
    tracker: Tracker,
    checks: Checks,
    /// Whether more than one vessel was heard in the last minute.
    several: bool,
    /// Minutes in a row without anything to hear.
    silent: u8,
    /// Number of the next minute to report, the first being 1; `None` before the first sample.
    minute: Option<NonZeroU64>,
    /// Index after the last sample taken.
    end: u64,
}

/// Work space; its content means nothing between calls.
#[derive(Clone, Debug)]
pub struct Scratch {
    shared: Shared,
    radial: RadialScratch,
    profiles: Profiles,
}

impl Scratch {
    /// All zeros.
    pub const fn new() -> Self {
        Self { shared: Shared::new(), radial: RadialScratch::new(), profiles: Profiles::new() }
    }
}

impl State {
    /// A station that has heard nothing yet; all zeros, so that a static costs no flash.
    pub const fn new() -> Self {
        Self {
            intake: Intake::new(),
            hops: Hops::new(),
            kept: [NOT_KEPT; WINDOW_FRAMES],
            next_kept: 0,
            ambient: Ambient::new(),
            lines: Lines::new(),
            clutter: Clutter::new(),
            steady: Steady::new(),
            averages: Averages::new(),
            slow: SlowLevels::new(),
            presence: Presence::new(),
            evidence: Evidence::new(),
            segmenter: Segmenter::new(),
            tracker: Tracker::new(),
            checks: Checks::new(),
            several: false,
            silent: 0,
            minute: None,
            end: 0,
        }
    }

    /// Every instant seen or missed so far.
    pub fn accounting(&self) -> Accounting {
        self.intake.accounting
    }

    /// Index of the instant after the last seen.
    pub fn next_index(&self) -> u64 {
        self.intake.next_index()
    }

    /// Bit c: channel c dead; bit 4 + c: channel c clipped, as of the last half-frame.
    pub fn channel_flags(&self) -> u8 {
        self.hops.channel_flags()
    }

    /// Level of each channel in the last half-frame, half decibels re full scale; −128 where nothing was heard.
    pub fn level_half_db(&self, plan: &Plan<'_>) -> [i8; CHANNELS] {
        self.hops.level_half_db(self.intake.elapsed(), plan.intake.minute())
    }

    /// No samples have come for a minute.
    pub(crate) fn silent(&mut self) {
        self.hops.silent();
    }

    /// Forgets everything, in place.
    pub(crate) fn forget(&mut self) {
        self.intake = Intake::new();
        self.hops.forget();
        self.ambient.forget();
        self.clutter.forget();
        self.steady = Steady::new();
        self.slow = SlowLevels::new();
        self.segmenter = Segmenter::new();
        self.tracker = Tracker::new();
        self.checks = Checks::new();
        self.clear();
    }
}

/// Takes a block.
pub fn push(
    plan: &Plan<'_>,
    state: &mut State,
    scratch: &mut Scratch,
    block: Block<'_>,
    sink: &mut dyn FnMut(Message),
) {
    let mut rest = block;
    while let Some(step) = state.intake.next(&plan.intake, &mut rest, sink) {
        take(plan, state, scratch, &step, sink);
    }
}

/// Takes what the intake hands on.
pub(crate) fn take(
    plan: &Plan<'_>,
    state: &mut State,
    scratch: &mut Scratch,
    step: &Step<'_>,
    sink: &mut dyn FnMut(Message),
) {
    match step {
        Step::Samples(run) => state.samples(plan, scratch, run, sink),
        Step::Mended(instant) => state.samples(plan, scratch, &instant.run(), sink),
        Step::Event(Event::Gap) => {
            state.checks.interrupted();
            state.hops.end(&mut state.intake.accounting);
        }
        Step::Event(Event::Restart(_)) => close(plan, state, scratch, sink),
        // While no run goes on nothing else says that minutes pass.
        Step::Time(index) if state.hops.begins() => state.catch_up(plan, scratch, *index, sink),
        Step::Time(_) => {}
    }
}

/// Nothing more comes of this time, or not for long ([`CLOSED_AFTER_S`]): what is open is reported and forgotten.
pub(crate) fn close(
    plan: &Plan<'_>,
    state: &mut State,
    scratch: &mut Scratch,
    sink: &mut dyn FnMut(Message),
) {
    state.conclude(plan, scratch, sink);
    state.presence.start(plan.max_range_m());
    state.clear();
}

/// The end of the recording: what is still pending is reported.
pub fn finish(plan: &Plan<'_>, state: &mut State, scratch: &mut Scratch, sink: &mut dyn FnMut(Message)) {
    state.conclude(plan, scratch, sink);
    state.intake.finish(&plan.intake, sink);
}

/// Sample index of minute `k`.
fn centre(plan: &Plan<'_>, k: u64) -> u64 {
    math::f64::round(STEP_S * k as f64 * plan.rate_hz) as u64
}

/// The first whole minute after a sample.
fn minute_after(plan: &Plan<'_>, index: u64) -> u64 {
    math::f64::floor(index as f64 / plan.rate_hz / STEP_S) as u64 + 1
}

impl State {
    /// Takes samples that follow those before.
    fn samples(
        &mut self,
        plan: &Plan<'_>,
        scratch: &mut Scratch,
        run: &Run<'_>,
        sink: &mut dyn FnMut(Message),
    ) {
        if self.minute.is_none() {
            self.begin(plan, run.first_index);
        }
        // Within a run the frames themselves say when a minute is complete, whatever the blocks' lengths.
        if self.hops.begins() {
            self.catch_up(plan, scratch, run.first_index, sink);
        }
        let mut taken = 0;
        while taken < run.frames.len() {
            let (some, filled) = self.hops.take(plan, &mut self.intake, run, taken, sink);
            taken += some;
            if !filled {
                continue;
            }
            self.checks.hop(self.hops.moments().as_ref());
            if self.hops.pair() {
                // Records of a minute must not contain a frame later than its window.
                self.catch_up(plan, scratch, self.hops.old.end, sink);
                self.slow.go_on(&plan.slow, self.hops.old.end, sink);
                self.frame(plan, scratch);
            }
        }
        self.end = run.first_index.saturating_add(run.frames.len() as u64);
    }

    /// Nothing is known of what is heard; the next minute to report is the first after `index`.
    fn begin(&mut self, plan: &Plan<'_>, index: u64) {
        self.presence.start(plan.max_range_m());
        self.clear();
        self.minute = NonZeroU64::new(minute_after(plan, index));
    }

    /// Drops frames and minutes.
    fn clear(&mut self) {
        for k in &mut self.kept {
            k.used = false;
        }
        // Sums run over places: the same from any beginning.
        self.next_kept = 0;
        self.averages = Averages::new();
        self.lines.interrupted();
        self.checks.interrupted();
        self.evidence.clear();
        self.several = false;
        self.silent = 0;
        self.minute = None;
    }

    /// Nothing more comes of this time: what is open is reported and closed.
    // Called from several places, and large.
    #[inline(never)]
    fn conclude(&mut self, plan: &Plan<'_>, scratch: &mut Scratch, sink: &mut dyn FnMut(Message)) {
        let end = self.end;
        self.catch_up(plan, scratch, end, sink);
        // Minutes whose window the end cuts are reported while their centre was recorded.
        while let Some(k) = self.minute.map(NonZeroU64::get)
            && centre(plan, k) <= end
        {
            self.minute = NonZeroU64::new(k + 1);
            self.report(plan, scratch, k, sink);
        }
        if let Some(k) = self.minute.map(NonZeroU64::get) {
            self.close(plan, k.saturating_sub(1), sink);
        }
        self.slow.end(&plan.slow, sink);
        self.hops.end(&mut self.intake.accounting);
    }

    /// Closes segments and tracks as of minute `k`.
    fn close(&mut self, plan: &Plan<'_>, k: u64, sink: &mut dyn FnMut(Message)) {
        self.segmenter.close(&|k| centre(plan, u64::from(k)), sink);
        self.tracker.finish(plan, &self.evidence, k as u32, sink);
    }

    /// Reports every minute whose window ends before `index`.
    fn catch_up(
        &mut self,
        plan: &Plan<'_>,
        scratch: &mut Scratch,
        index: u64,
        sink: &mut dyn FnMut(Message),
    ) {
        let half = (HALF_WINDOW_S * plan.rate_hz) as u64;
        while let Some(k) = self.minute.map(NonZeroU64::get)
            && centre(plan, k) + half < index
        {
            if self.silent > LONGEST_SILENCE {
                // As of when anything was recorded: who was heard then is not known to have fallen silent.
                self.close(plan, k.saturating_sub(u64::from(self.silent)), sink);
                self.begin(plan, index);
                return;
            }
            self.minute = NonZeroU64::new(k + 1);
            let heard = self.report(plan, scratch, k, sink);
            self.silent = if heard { 0 } else { self.silent + 1 };
        }
    }

    /// Analyses the frame of the two newest hops.
    fn frame(&mut self, plan: &Plan<'_>, scratch: &mut Scratch) {
        let (old, new) = (&self.hops.old, &self.hops.new);
        let usable = |c: u8| old.usable(c) && new.usable(c);
        if !usable(0) {
            return;
        }
        let sources = match (usable(1) && usable(2), self.several) {
            (false, _) => Sources::None,
            (true, false) => Sources::One,
            (true, true) => Sources::Several,
        };
        let evened = self.evened(plan);
        let last = self.kept.get((self.next_kept + WINDOW_FRAMES - 1) % WINDOW_FRAMES);
        let follows = last.is_some_and(|last| last.used && last.label + plan.hop() == old.end);
        let Some(kept) = self.kept.get_mut(self.next_kept) else { return };
        self.averages.begin(old.end);
        let spectra = scratch.shared.spectra();
        azigram::analyse(
            &plan.band,
            spectra,
            &old.samples,
            &new.samples,
            sources,
            &evened,
            &mut kept.row,
            &mut self.averages,
            &mut self.steady,
        );
        if !plan.paper {
            let of_band = plan.band.first_bin..plan.band.first_bin + plan.band.bins;
            self.lines.frame(&plan.band, spectra.pressure.get(of_band).unwrap_or_default(), follows);
        }
        if let Some(sums) = self.slow.add(1, old.end) {
            sums.iter_mut().zip(self.averages.newest()).for_each(|(all, newest)| *all += newest);
        }
        kept.row.uneven = old.uneven.max(new.uneven);
        let bursts = sources != Sources::None && kept.row.may_hold_a_call();
        kept.row.excess =
            if bursts { Excess::of(&plan.calls, &old.samples, &new.samples) } else { Excess::NONE };
        kept.label = old.end;
        kept.used = true;
        self.ambient.learn(&kept.row);
        let mut c = [0f32; QUEFRENCIES];
        if !plan.paper {
            cepstrum::without_lines(&mut spectra.log_pressure, &mut spectra.buffer);
        }
        cepstrum::transform(&spectra.log_pressure, &mut spectra.buffer, &mut c);
        self.clutter.filter(&mut c);
        kept.cepstrum.iter_mut().zip(&c).for_each(|(k, c)| *k = math::code(c / CEPSTRUM_UNIT));
        self.next_kept = (self.next_kept + 1) % WINDOW_FRAMES;
        self.hops.used(&mut self.intake.accounting);
    }

    /// How noise of the horizontal components is evened.
    fn evened(&self, plan: &Plan<'_>) -> Evened {
        if plan.paper { Evened::NONE } else { self.checks.own_noise.evened(plan.band.turn) }
    }

    /// Makes the records of minute `k`; whether there was anything to hear.
    // Called from several places, and large.
    #[inline(never)]
    fn report(
        &mut self,
        plan: &Plan<'_>,
        scratch: &mut Scratch,
        k: u64,
        sink: &mut dyn FnMut(Message),
    ) -> bool {
        let index = centre(plan, k);
        let offset_s = |label: u64| (label as f64 - index as f64) / plan.rate_hz;
        let within = |half_s: f64| {
            move |kept: &&Kept| kept.used && math::f64::abs(offset_s(kept.label)) <= half_s + 1e-6
        };
        let mut rows = [&NO_ROW; WINDOW_FRAMES];
        let mut held = 0;
        for (slot, kept) in rows.iter_mut().zip(self.kept.iter().filter(within(HALF_WINDOW_S))) {
            *slot = &kept.row;
            held += 1;
        }
        let rows = rows.get(..held).unwrap_or_default();
        let mut call =
            if plan.paper { None } else { impulsive::search(plan.band.bins, plan.band.turn, rows) };
        let mut directions = plan.tones.search(plan.band.bins, &self.ambient, scratch.shared.tonal(), rows);
        if !plan.paper {
            self.lines.minute(&plan.band, scratch.shared.tonal(), &mut directions);
        }
        self.steady.widen(&mut directions);
        self.checks.listen(plan.intake.minute());
        let gain = self.checks.gain();
        let (evened, lasting) = if plan.paper {
            (Evened::NONE, plan.lasting)
        } else {
            (self.evened(plan).of_gain(gain.db), plan.lasting.with_gain_doubt(gain.sd_db))
        };
        self.tracker.gain_sd_db = if plan.paper { 0.0 } else { gain.sd_db };
        if let Some(call) = &mut call {
            directions.attribute(call.leaning, plan.band.bins);
            call.turn_back(&evened);
        }
        directions.turn_back(&evened);
        let expected =
            if plan.paper { ExpectedVessels::default() } else { self.tracker.expected(plan, k as u32) };
        let frames = || {
            let used = self.kept.iter().filter(|k| k.used);
            used.map(|k| (offset_s(k.label) as f32, k.cepstrum.iter().map(|c| f32::from(*c) * CEPSTRUM_UNIT)))
        };
        let Scratch { shared, radial, profiles } = scratch;
        profiles.clear();
        // Of two vessels the echoes of one may lie where the other's are looked for.
        let mut vessels = expected.iter().flatten();
        let alone = vessels.next().filter(|vessel| vessel.established && vessels.next().is_none());
        let mut ranges = if plan.paper {
            let window = frames().filter(|(t, _)| math::f32::abs(*t) <= HALF_WINDOW_S as f32);
            paper::window(plan.choices, &plan.interference, radial, self.presence.lend(), shared, window)
        } else {
            self.presence.predict(shared.columns());
            self.presence.claim(&plan.interference, &expected);
            radial.clear();
            // A frame exactly between two minutes belongs to the later one.
            let half_s = 0.5 * STEP_S as f32;
            for (t, cepstrum) in frames().filter(|(t, _)| (-half_s..half_s).contains(t)) {
                radial.add(&plan.interference, shared.envelope(), cepstrum, t);
                if let Some(vessel) = alone {
                    profiles.add(&plan.interference, shared.envelope(), vessel, t);
                }
            }
            if radial.frames() > 0 {
                radial.fill(shared.grid());
                self.presence.update(shared.grid(), &plan.interference, radial)
            } else {
                self.presence.blind()
            }
        };
        let heard = directions.frames > 0;
        let tones = directions.modes.iter().flatten().filter(|m| !m.impulsive).count();
        let noticed = match tones {
            0 if call.is_some() => Heard::Other,
            0 if expected.iter().any(Option::is_some) => Heard::Expected,
            0 => Heard::Nothing,
            _ => Heard::Vessel,
        };
        self.steady.minute(match noticed {
            _ if plan.paper => steady::Minute::Other,
            Heard::Vessel | Heard::Expected => steady::Minute::Vessel,
            Heard::Other => steady::Minute::Other,
            // One that is heard by its echoes alone.
            Heard::Nothing if ranges.log_odds > 0.0 => steady::Minute::Vessel,
            Heard::Nothing => steady::Minute::Silence,
        });
        self.checks.ranges(profiles, index, &mut self.intake.faults, sink);
        let (misplaced, no_pressure) = (self.checks.are_misplaced(), self.checks.no_pressure());
        let pairs_in_doubt =
            no_pressure || !plan.paper && (plan.lasting.parts_pairs() || self.checks.table_is_off());
        self.tracker.pairs_in_doubt = pairs_in_doubt;
        // Of the noise of one that is deaf, or may be, of components that are not what they are called, and of noise that hides one, directions are made all the same.
        let hidden = !plan.paper && (self.checks.own_noise.hides_directions() || self.checks.may_be_deaf());
        let mute = misplaced || hidden || self.checks.deaf();
        let call = if mute { None } else { call };
        if mute {
            directions.withhold();
        }
        self.several = !plan.paper && (tones > 1 || expected.iter().flatten().count() > 1);
        if heard {
            if !plan.paper {
                ranges.without_odd_speeds(&expected);
            }
            ranges.without_echoes(&plan.interference, &expected);
            let (towards, apart) = lasting.as_evidence(directions, ranges);
            let minute = Minute::new(k as u32, &towards, &apart);
            ranges.prefer(&plan.interference, &expected);
            let allowance = &mut self.tracker.allowance;
            // A range, or a track, tells of a vessel by itself.
            let of_vessel = clear_speed_m_s(&ranges).is_some() || expected.iter().any(Option::is_some);
            let modes = if allowance.has_room_for_more() { 2 } else { 1 };
            allowance.minute(send(
                plan,
                &lasting,
                index,
                &directions,
                |m| !of_vessel && is_sudden(m, plan.band.bins, &self.evidence, k as u32),
                call,
                &ranges,
                pairs_in_doubt,
                modes,
                sink,
            ));
            self.evidence.push(minute);
            let index_of = |k: u32| centre(plan, u64::from(k));
            self.segmenter.minute(k as u32, &directions, &ranges, index_of, sink);
            if plan.azigram && !mute && self.tracker.allowance.azigram() {
                let half_s = 0.5 * STEP_S;
                let of_minute = |kept: &&Kept| kept.used && (-half_s..half_s).contains(&offset_s(kept.label));
                let (mut minute, mut held) = ([&NO_ROW; MINUTE_FRAMES], 0);
                for (slot, kept) in minute.iter_mut().zip(self.kept.iter().filter(of_minute)) {
                    (*slot, held) = (&kept.row, held + 1);
                }
                let azigram = bands::azigram(plan, &evened, index, minute.get(..held).unwrap_or_default());
                azigram.into_iter().for_each(|azigram| sink(Message::Azigram(azigram)));
            }
        }
        if misplaced {
            self.tracker.withdraw(plan, &mut self.evidence, sink);
        }
        self.tracker.minute(plan, &mut self.evidence, k as u32, sink);
        let (speed_m_s, towards, whole) = (clear_speed_m_s(&ranges), plan.towards, plan.intake.minute());
        let from_below = self.hops.first_motions.together();
        let checked =
            Checked { index, heard: noticed, several: tones > 1, speed_m_s, towards, from_below, whole };
        self.checks.minute(&checked, &mut self.intake.faults, sink);
        heard
    }
}
