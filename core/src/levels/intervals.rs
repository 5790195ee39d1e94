//! From blocks to reports: where intervals end, what is missing or clipped, and which transforms are taken.
//!
//! Intervals begin at multiples of their length, counted from index 0. Samples go on through the stages in chunks whose ends
//! hang on the index alone, so reports do not depend on how samples are cut into blocks.

use super::bands::of_decidecade;
use super::cells::{CELLS, Plan, STAGES};
use super::decimate::{Between, CHUNK, Decimator, FACTOR};
use super::lanes::Lanes;
use super::percentiles::{self, Row, row_of_decidecade};
use super::transform::{self, BINS, Complex, LENGTH, Powers, ROOM, Work};
use crate::block::{Block, CHANNELS, Frame, MISSING};

/// Further back than this is time starting again, s (as [`crate::intake`] has it).
const RESTART_S: f64 = 30.0;

/// The levels of an interval.
#[derive(Clone, Debug)]
pub struct Report {
    /// Index at which the interval begins.
    pub first_index: u64,
    /// Its length, instants; the recording's last may be shorter.
    pub instants: u64,
    /// Codes of each channel that were there and not clipped.
    pub good: [u64; CHANNELS],
    /// Codes of each channel that were clipped.
    pub clipped: [u64; CHANNELS],
    /// Share of the interval, 0 to 1, that the spectra of the highest stage are of: those without a missing or clipped code.
    pub used: [f32; CHANNELS],
    /// Mean square in each cell, full scale squared, from [`Plan::cells`]' first on; NaN where nothing was measured.
    pub mean_square: [[f32; CHANNELS]; CELLS],
    /// Windows taken of each channel, by stage.
    pub transforms: [[u32; STAGES]; CHANNELS],
}

/// One stage: samples of two windows, and sums of spectra.
#[derive(Clone, Debug)]
struct Stage {
    samples: [Lanes; ROOM],
    filled: usize,
    /// Samples of this stage since the run began that were before `samples`.
    before: u64,
    /// The snapshot: powers, pairs, and pairs taken of each channel.
    powers: Powers,
    pairs: u32,
    taken: [u32; CHANNELS],
    /// The interval: bins, and pairs taken of each channel.
    total: [Lanes; BINS],
    all_taken: [u32; CHANNELS],
}

impl Stage {
    const NEW: Self = Self {
        samples: [Lanes::ZERO; ROOM],
        filled: 0,
        before: 0,
        powers: [Lanes::ZERO; LENGTH],
        pairs: 0,
        taken: [0; CHANNELS],
        total: [Lanes::ZERO; BINS],
        all_taken: [0; CHANNELS],
    };
}

/// Everything that lasts from sample to sample.
#[derive(Clone, Debug)]
pub struct State {
    /// Index after the last instant, once there was one.
    next: Option<u64>,
    /// Index at which the interval begins.
    begun: u64,
    /// Instants of this run that went on, and the newest bad one of each channel (one more; 0: none).
    passed: u64,
    bad: [u64; CHANNELS],
    /// Instants that have not gone on.
    chunk: [Lanes; CHUNK],
    waiting: usize,
    good: [u64; CHANNELS],
    clipped: [u64; CHANNELS],
    stages: [Stage; STAGES],
    decimators: [Decimator; STAGES],
}

impl State {
    /// Nothing heard.
    pub const fn new() -> Self {
        Self {
            next: None,
            begun: 0,
            passed: 0,
            bad: [0; CHANNELS],
            chunk: [Lanes::ZERO; CHUNK],
            waiting: 0,
            good: [0; CHANNELS],
            clipped: [0; CHANNELS],
            stages: [Stage::NEW; STAGES],
            decimators: [Decimator::NEW; STAGES],
        }
    }
}

/// What is needed only while working.
#[derive(Clone, Debug)]
pub struct Scratch {
    work: Work,
    between: Between,
    bins: [Lanes; BINS],
    report: Report,
}

impl Scratch {
    /// All zeros.
    pub const fn new() -> Self {
        Self {
            work: [Complex::ZERO; LENGTH],
            between: [Lanes::ZERO; CHUNK / 2],
            bins: [Lanes::ZERO; BINS],
            report: Report {
                first_index: 0,
                instants: 0,
                good: [0; CHANNELS],
                clipped: [0; CHANNELS],
                used: [0.0; CHANNELS],
                mean_square: [[0.0; CHANNELS]; CELLS],
                transforms: [[0; STAGES]; CHANNELS],
            },
        }
    }
}

/// The parts of one measurement.
struct Levels<'a> {
    plan: &'a Plan,
    state: &'a mut State,
    scratch: &'a mut Scratch,
    counts: &'a mut [Row],
}

/// Takes a block; `sink` gets the report of each interval that it ends, with how often
/// each level was there: `counts` are [`super::ROWS`] rows, or none where no percentiles are wanted.
pub fn push(
    plan: &Plan,
    state: &mut State,
    scratch: &mut Scratch,
    counts: &mut [Row],
    block: Block<'_>,
    sink: &mut impl FnMut(&Report, &[Row]),
) {
    let mut levels = Levels { plan, state, scratch, counts };
    let Some(mut frames) = levels.align(&block, sink) else { return };
    while !frames.is_empty() {
        let State { next: Some(next), begun, waiting, .. } = levels.state else { return };
        let until_end = begun.saturating_add(plan.interval).saturating_sub(*next);
        let n = until_end.min((CHUNK - (*waiting).min(CHUNK)) as u64).min(frames.len() as u64) as usize;
        let (now, later) = frames.split_at_checked(n).unwrap_or((frames, &[]));
        *next += n as u64;
        let ends = n as u64 == until_end;
        levels.convert(now);
        if levels.state.waiting >= CHUNK {
            levels.pass_on();
        }
        if ends {
            levels.close(sink);
            levels.state.begun = levels.state.begun.saturating_add(plan.interval);
        }
        frames = later;
    }
}

/// Ends the recording: reports the interval that has begun, as far as it went.
pub fn finish(
    plan: &Plan,
    state: &mut State,
    scratch: &mut Scratch,
    counts: &mut [Row],
    sink: &mut impl FnMut(&Report, &[Row]),
) {
    let mut levels = Levels { plan, state, scratch, counts };
    if levels.state.next.is_some_and(|next| next > levels.state.begun) {
        levels.close(sink);
    }
    levels.state.next = None;
}

impl Levels<'_> {
    /// What of a block is new; takes the gap before it.
    fn align<'b>(
        &mut self,
        block: &Block<'b>,
        sink: &mut impl FnMut(&Report, &[Row]),
    ) -> Option<&'b [Frame]> {
        let index = block.first_index;
        let begins = index - index % self.plan.interval.max(1);
        let Some(next) = self.state.next else {
            self.restart();
            (self.state.next, self.state.begun) = (Some(index), begins);
            return Some(block.frames);
        };
        let back = next.saturating_sub(index);
        if back > 0 && back as f64 <= RESTART_S * self.plan.rate_hz {
            return block.frames.get(back as usize..);
        }
        if index != next {
            self.pass_on();
            if begins != self.state.begun {
                if next > self.state.begun {
                    self.close(sink);
                }
                self.state.begun = begins;
            }
            self.restart();
            self.state.next = Some(index);
        }
        Some(block.frames)
    }

    /// A run begins: what the stages hold of the one before is not continued.
    fn restart(&mut self) {
        let State { passed, bad, waiting, stages, decimators, .. } = &mut *self.state;
        (*passed, *bad, *waiting) = (0, [0; CHANNELS], 0);
        stages.iter_mut().for_each(|stage| (stage.filled, stage.before) = (0, 0));
        decimators.iter_mut().for_each(Decimator::restart);
    }

    /// Codes to numbers; bad ones become 0.
    fn convert(&mut self, frames: &[Frame]) {
        let State { chunk, waiting, passed, bad, good, clipped, .. } = &mut *self.state;
        let room = chunk.iter_mut().skip(*waiting);
        let mut peak = Lanes::ZERO;
        for (to, frame) in room.zip(frames) {
            *to = Lanes(frame.map(|code| code as f32));
            peak = peak.greater(to.magnitude());
        }
        // A code that rounds to a clipped one is looked at, too.
        let clip = self.plan.clip as f32;
        good.iter_mut().for_each(|good| *good += frames.len() as u64);
        let first = *passed + *waiting as u64;
        for c in (0..CHANNELS).filter(|c| peak.0.get(*c).is_some_and(|p| *p >= clip)) {
            let room = chunk.iter_mut().skip(*waiting);
            let (Some(bad), Some(good), Some(clipped)) =
                (bad.get_mut(c), good.get_mut(c), clipped.get_mut(c))
            else {
                continue;
            };
            for ((to, frame), at) in room.zip(frames).zip(first..) {
                let (Some(to), Some(code)) = (to.0.get_mut(c), frame.get(c)) else { continue };
                if code.unsigned_abs() >= self.plan.clip {
                    (*to, *bad) = (0.0, at + 1);
                    *good -= 1;
                    *clipped += u64::from(*code != MISSING);
                }
            }
        }
        *waiting = (*waiting + frames.len()).min(CHUNK);
    }

    /// The chunk through all stages.
    fn pass_on(&mut self) {
        let mut n = self.state.waiting;
        for stage in 0..self.plan.stages.min(STAGES) {
            self.take(stage, n);
            let State { decimators, chunk, .. } = &mut *self.state;
            if let Some(decimator) = decimators.get_mut(stage).filter(|_| stage + 1 < self.plan.stages) {
                n = decimator.take(&self.plan.filters, chunk, n, &mut self.scratch.between);
            }
        }
        self.state.passed += self.state.waiting as u64;
        self.state.waiting = 0;
    }

    /// The first `n` samples of the chunk into a stage; transforms what is whole.
    fn take(&mut self, number: usize, n: usize) {
        let mut done = 0;
        while done < n {
            let State { stages, chunk, bad, .. } = &mut *self.state;
            let Some(stage) = stages.get_mut(number) else { return };
            let part = chunk.iter().take(n).skip(done);
            let apart = self.plan.apart.get(number).copied().unwrap_or(LENGTH);
            let pair = LENGTH + apart;
            let m = (pair - stage.filled.min(pair)).min(n - done);
            for (to, x) in stage.samples.iter_mut().skip(stage.filled).zip(part.take(m)) {
                *to = *x;
            }
            (stage.filled, done) = (stage.filled + m, done + m);
            if stage.filled < pair {
                continue;
            }
            let begins = stage.before.saturating_mul(power_of(FACTOR as u64, number));
            let whole = bad.map(|bad| bad <= begins);
            let weights = Lanes(whole.map(|whole| f32::from(u8::from(whole))));
            transform::add(&stage.samples, apart, weights, &mut self.scratch.work, &mut stage.powers);
            stage.pairs += 1;
            for (taken, whole) in stage.taken.iter_mut().zip(whole) {
                *taken += u32::from(whole);
            }
            // What the next pair begins with: nothing, or half of the last window.
            let kept = LENGTH - apart;
            stage.samples.copy_within(pair - kept..pair, 0);
            (stage.filled, stage.before) = (kept, stage.before + 2 * apart as u64);
            if self.plan.pairs.get(number).is_some_and(|pairs| stage.pairs >= *pairs) {
                self.snapshot(number);
            }
        }
    }

    /// Ends a snapshot of a stage.
    fn snapshot(&mut self, number: usize) {
        let Some(stage) = self.state.stages.get_mut(number) else { return };
        let bins = &mut self.scratch.bins;
        transform::bins(&stage.powers, bins);
        for (total, bin) in stage.total.iter_mut().zip(bins.iter()) {
            *total += *bin;
        }
        for (all, taken) in stage.all_taken.iter_mut().zip(stage.taken) {
            *all += taken;
        }
        if !self.counts.is_empty() {
            // One that has less than half of what it should have tells little.
            let least = self.plan.pairs.get(number).copied().unwrap_or(1);
            let taken = stage.taken.map(|taken| 2 * taken >= least);
            let mean = Lanes(stage.taken.map(|taken| self.plan.scale / taken.max(1) as f32));
            let mut note = |row: usize, cells: core::ops::Range<i32>| {
                let band_hz = self.plan.edges_hz(&cells);
                let middle = crate::math::f64::sqrt(band_hz.start * band_hz.end);
                if self.plan.stage_of(middle) == number {
                    percentiles::note(
                        self.counts,
                        row,
                        self.plan.within(bins, number, band_hz) * mean,
                        taken,
                    );
                }
            };
            for (place, cell) in self.plan.cells().enumerate() {
                note(place, cell..cell + 1);
            }
            for decidecade in self.plan.decidecades() {
                let cells = of_decidecade(decidecade);
                let row = self.plan.place(cells.start).map(row_of_decidecade);
                note(row.unwrap_or(usize::MAX), cells);
            }
        }
        stage.powers = [Lanes::ZERO; LENGTH];
        (stage.pairs, stage.taken) = (0, [0; CHANNELS]);
    }

    /// Ends the interval.
    fn close(&mut self, sink: &mut impl FnMut(&Report, &[Row])) {
        self.pass_on();
        for number in 0..self.plan.stages.min(STAGES) {
            if self.state.stages.get(number).is_some_and(|stage| stage.pairs > 0) {
                self.snapshot(number);
            }
        }
        self.report();
        sink(&self.scratch.report, self.counts);
        percentiles::clear(self.counts);
        let State { stages, good, clipped, .. } = &mut *self.state;
        (*good, *clipped) = ([0; CHANNELS], [0; CHANNELS]);
        for stage in stages {
            stage.before += stage.filled as u64;
            stage.filled = 0;
            stage.total = [Lanes::ZERO; BINS];
            stage.all_taken = [0; CHANNELS];
        }
    }

    fn report(&mut self) {
        let State { next, begun, good, clipped, stages, .. } = &*self.state;
        let report = &mut self.scratch.report;
        let instants = next.unwrap_or(0).saturating_sub(*begun);
        (report.first_index, report.instants) = (*begun, instants);
        (report.good, report.clipped) = (*good, *clipped);
        report.mean_square = [[0.0; CHANNELS]; CELLS];
        for (number, stage) in stages.iter().enumerate().take(self.plan.stages) {
            // Nothing over nothing is NaN: not measured.
            let mean =
                Lanes(stage.all_taken.map(
                    |taken| {
                        if taken > 0 { self.plan.scale / taken as f32 } else { f32::NAN }
                    },
                ));
            for (cell, out) in self.plan.cells().zip(&mut report.mean_square) {
                if let Some(part) =
                    self.plan.part(&stage.total, number, self.plan.edges_hz(&(cell..cell + 1)))
                {
                    *out = (Lanes(*out) + part * mean).0;
                }
            }
            for (all, taken) in report.transforms.iter_mut().zip(stage.all_taken) {
                if let Some(of_stage) = all.get_mut(number) {
                    *of_stage = 2 * taken;
                }
            }
        }
        // Of an interval without a break a part of a pair is left at its end.
        let apart = self.plan.apart.first().copied().unwrap_or(LENGTH);
        let possible = (instants.saturating_sub((LENGTH - apart) as u64) / (2 * apart) as u64).max(1);
        let taken = stages.first().map_or([0; CHANNELS], |stage| stage.all_taken);
        report.used = taken.map(|taken| (taken as f32 / possible as f32).min(1.0));
    }
}

fn power_of(base: u64, exponent: usize) -> u64 {
    (0..exponent).fold(1, |power, _| power.saturating_mul(base))
}
