//! From frames to Welch cross-spectra of the six pairs and auto-spectra of the four hydrophones.
//!
//! `G_ij(f) = Σ_frames X_i*(f) X_j(f)` (docs/references.md). Window, transform and accumulation are the work done for
//! every sample: all loops run over fixed arrays, and what belongs to a bin stands together. Cost on the Cortex-M7: 50 000
//! instructions a frame for window and transforms of all four channels, 90 a bin for separation and accumulation.

use super::plan::{BINS, FRAME, Plan};
use super::transform::{self, RUN, Ring, Work};
use super::wavefront::PAIR_COUNT;
use crate::block::CHANNELS;
use crate::density::{self, Density};
use crate::wire::BANDS;
use microfft::Complex32;

/// Neighbouring bins of all pairs and hydrophones.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BinRun {
    /// Real parts of the pairs' cross-spectra.
    pub(crate) re: [[f32; RUN]; PAIR_COUNT],
    /// Imaginary parts.
    pub(crate) im: [[f32; RUN]; PAIR_COUNT],
    /// The hydrophones' auto-spectra.
    pub(crate) auto: [[f32; RUN]; CHANNELS],
}

/// Runs of a spectrum.
pub(crate) const RUNS: usize = BINS / RUN;

const NO_RUN: BinRun =
    BinRun { re: [[0.0; RUN]; PAIR_COUNT], im: [[0.0; RUN]; PAIR_COUNT], auto: [[0.0; RUN]; CHANNELS] };

/// Bins at which the spectrum's steadiness in time is watched, evenly over the band.
const WATCHED: usize = 16;
/// Of so many frames one is.
const WATCHED_EVERY: u32 = 2;
/// Factor of powers there, so that their squares are numbers.
const WATCHED_SCALE: f32 = 1.0 / (1u64 << 40) as f32;

/// Sums over frames of the powers of two hydrophones at the bins watched, and of their squares.
type Watched = [[f32; WATCHED]; 2];

/// Accumulated spectra of one step (16 KiB).
#[derive(Clone, Debug)]
pub(crate) struct Spectra {
    pub(crate) runs: [BinRun; RUNS],
    watched: Watched,
    /// What they are made of.
    pub(crate) added: Added,
}

/// The frames that spectra are made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Added {
    /// How many.
    pub(crate) frames: u32,
    /// Number of the step they belong to, or of the first.
    pub(crate) step: u64,
    /// Sum of their centres' distances from the step's start, samples.
    pub(crate) centres: u64,
    /// When the sound was loud.
    pub(crate) loudness: Loudness,
    /// Whether any held clipped samples.
    pub(crate) clipped: bool,
    /// Whether any held samples that stand for missing ones.
    pub(crate) bridged: bool,
    /// Bit h: hydrophone h was dead in a frame.
    pub(crate) dead: u8,
    /// Whether a frame was left out as a burst.
    pub(crate) burst: bool,
}

impl Added {
    /// None yet, of a step.
    const fn none(step: u64) -> Self {
        Self {
            frames: 0,
            step,
            centres: 0,
            loudness: Loudness::NONE,
            clipped: false,
            bridged: false,
            dead: 0,
            burst: false,
        }
    }

    /// Index of the middle of the frames; none without any.
    pub(crate) fn middle(&self, plan: &Plan) -> Option<u64> {
        let after = self.centres.checked_div(u64::from(self.frames))?;
        Some(self.step.saturating_mul(plan.step_samples.get()).saturating_add(after))
    }

    /// With those of a later step; steps are of so many samples.
    fn joined(self, later: Self, step_samples: u64) -> Self {
        let shift = later.step.saturating_sub(self.step).saturating_mul(step_samples);
        let moved = shift.saturating_mul(u64::from(later.frames)).saturating_add(later.centres);
        Self {
            frames: self.frames.saturating_add(later.frames),
            step: self.step,
            centres: self.centres.saturating_add(moved),
            loudness: self.loudness.joined(later.loudness, shift as f64),
            clipped: self.clipped | later.clipped,
            bridged: self.bridged | later.bridged,
            dead: self.dead | later.dead,
            burst: self.burst | later.burst,
        }
    }
}

/// When within its frames the sound was loud: a propeller's beat moves the moment a bearing is of by up to 100 ms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Loudness {
    /// Sum over frames of the power in the upper half of the band, one hydrophone.
    power: f64,
    /// The same times the distance of the frame's centre from the step's start, samples.
    moment: f64,
    /// Sum over frames of the power's square.
    square: f64,
}

impl Loudness {
    const NONE: Self = Self { power: 0.0, moment: 0.0, square: 0.0 };

    /// With what is later by so many samples.
    fn joined(self, later: Self, by: f64) -> Self {
        Self {
            power: self.power + later.power,
            moment: self.moment + (later.moment + by * later.power),
            square: self.square + later.square,
        }
    }

    /// Its centre, samples after the step's start.
    pub(crate) fn centre(&self) -> Option<f64> {
        (self.power > 0.0).then(|| self.moment / self.power)
    }

    /// Mean square of the power over the square of its mean, of so many frames: 1 for a steady sound.
    pub(crate) fn unevenness(&self, frames: u32) -> f64 {
        if self.power > 0.0 { self.square * f64::from(frames) / (self.power * self.power) } else { 1.0 }
    }
}

/// Values of a run.
const VALUES: usize = (2 * PAIR_COUNT + CHANNELS) * RUN;

/// The spectra of a step gone by, kept for the next one's segment: the upper halves of the values (8 KiB). Eight bits of
/// precision are an error of a thousandth in each value, a tenth of what noise does at 20 dB.
#[derive(Clone, Debug)]
pub(crate) struct Kept {
    runs: [[u16; VALUES]; RUNS],
    watched: [u16; 2 * WATCHED],
    added: Added,
}

impl Kept {
    pub(crate) const fn new() -> Self {
        Self { runs: [[0; VALUES]; RUNS], watched: [0; 2 * WATCHED], added: Added::none(0) }
    }

    /// Holds nothing any more.
    pub(crate) fn forget(&mut self) {
        self.added = Added::none(0);
    }

    /// Whether it holds the step before this one.
    pub(crate) fn precedes(&self, step: u64) -> bool {
        self.added.frames > 0 && self.added.step.saturating_add(1) == step
    }
}

impl Kept {
    /// Spectrum of a hydrophone.
    pub(crate) fn density(&self, plan: &Plan, hydrophone: usize) -> Option<Density> {
        let Added { frames, .. } = self.added;
        let index = self.added.middle(plan)?;
        let of_run = (2 * PAIR_COUNT + hydrophone) * RUN;
        let of_bin = |bin: usize| {
            let kept = self.runs.get(bin / RUN).and_then(|run| run.get(of_run + bin % RUN));
            kept.map_or(0.0, |kept| f32::from_bits(u32::from(*kept) << 16))
        };
        let mut sums = [0.0; BANDS];
        density::add(&mut sums, &of_bin);
        Some(Density {
            index,
            frames: frames.min(u32::from(u16::MAX)) as u16,
            bin_hz: plan.scale.bin_hz,
            tenth_db: plan.scale.levels(frames, &sums),
        })
    }
}

impl BinRun {
    /// The values in the order they are kept in.
    fn values(&mut self) -> impl Iterator<Item = &mut f32> {
        let Self { re, im, auto } = self;
        re.as_flattened_mut().iter_mut().chain(im.as_flattened_mut()).chain(auto.as_flattened_mut())
    }
}

impl Spectra {
    pub(crate) const fn new() -> Self {
        Self { runs: [NO_RUN; RUNS], watched: [[0.0; WATCHED]; 2], added: Added::none(0) }
    }

    /// Empties it for a step.
    pub(crate) fn begin(&mut self, step: u64) {
        self.runs.fill(NO_RUN);
        self.watched = [[0.0; WATCHED]; 2];
        self.added = Added::none(step);
    }

    /// Adds a hydrophone's squared magnitudes, of all frames, to the sums of bands.
    // Apart, because it is rare.
    #[inline(never)]
    pub(crate) fn add_bands(&self, hydrophone: usize, sums: &mut [f32; BANDS]) {
        let of_bin = |bin: usize| {
            let auto = self.runs.get(bin / RUN).and_then(|run| run.auto.get(hydrophone)?.get(bin % RUN));
            auto.copied().unwrap_or(0.0)
        };
        density::add(sums, &of_bin);
    }

    /// How uneven in time a source of this coherence is: mean square of the power over the square of its mean, 2 for a steady sound
    /// that both hydrophones hear alike (1.5 for noise of their own), 3.9 for one that a propeller modulates in full. A sound that sweeps through the band, or comes in strokes, has what it has at a bin in
    /// few frames. The mean over bins, weighed by the square of the source's coherence about them.
    #[inline(never)]
    pub(crate) fn unevenness(&self, plan: &Plan, coherence: &[f32; BINS]) -> f32 {
        let frames = self.added.frames.div_ceil(WATCHED_EVERY) as f32;
        let apart = plan.whole.high / WATCHED;
        let [power, square] = &self.watched;
        let (mut sum, mut of) = (0.0, f32::MIN_POSITIVE);
        for ((k, power), square) in watched(plan).zip(power).zip(square) {
            let about = coherence.iter().skip(k.saturating_sub(apart / 2)).take(apart);
            let mean = about.sum::<f32>().max(0.0) / apart.max(1) as f32;
            if *power > 0.0 {
                sum += mean * mean * frames * square / (power * power);
                of += mean * mean;
            }
        }
        sum / of
    }

    /// These of the runs.
    pub(crate) fn part(&self, runs: &core::ops::Range<usize>) -> &[BinRun] {
        self.runs.get(runs.clone()).unwrap_or(&[])
    }

    /// These of the runs, to change.
    pub(crate) fn part_mut(&mut self, runs: &core::ops::Range<usize>) -> &mut [BinRun] {
        self.runs.get_mut(runs.clone()).unwrap_or(&mut [])
    }

    /// Ends the step: its spectra are kept in place of those of the step before, and these become the segment's, of
    /// both steps where they `join`. Times count from the segment's first step, of `step_samples`.
    pub(crate) fn end_step(&mut self, before: &mut Kept, join: bool, step_samples: u64) {
        for (run, kept) in self.runs.iter_mut().zip(&mut before.runs) {
            run.values().zip(kept).for_each(|(value, kept)| keep(value, kept, join));
        }
        let watched = self.watched.as_flattened_mut().iter_mut().zip(&mut before.watched);
        watched.for_each(|(value, kept)| keep(value, kept, join));
        let earlier = core::mem::replace(&mut before.added, self.added);
        if join {
            self.added = earlier.joined(self.added, step_samples);
        }
    }

    /// Adds one frame, its centre so many samples after the step's start: `codes` in recorder order, mapped to hydrophones by
    /// the plan. The mean square (codes²) in the plan's envelope band of the
    /// first hydrophone that is not `out` (bit h).
    pub(crate) fn add(
        &mut self,
        plan: &Plan,
        codes: &[[i32; FRAME]; CHANNELS],
        centre: u64,
        out: u8,
        work: &mut Work,
    ) -> f32 {
        // The plan's channels are a permutation of 0..4.
        transform::transform(plan.channels.map(|c| &codes[usize::from(c & 3)]), work);
        let [z01, z23] = work.as_chunks_mut::<FRAME>().0 else { return 0.0 };
        without_offset(z01, plan);
        without_offset(z23, plan);
        if self.added.frames.is_multiple_of(WATCHED_EVERY) {
            watch(if out & 0b11 == 0 { z01 } else { z23 }, plan, &mut self.watched);
        }
        // Bin 0 of either has been taken out, and is not in the last place either.
        work[2 * FRAME] = Complex32::new(0.0, 0.0);
        let (Some(z01), Some(z23)) = (work.first_chunk(), work.last_chunk()) else { return 0.0 };
        let (low, upper) = (plan.envelope_low / RUN, upper(plan));
        let between = low..upper.start;
        let (power, upper) = if out & 1 == 0 {
            self.accumulate::<false>(z01, z23, 0..low);
            (self.accumulate::<false>(z01, z23, between), self.accumulate::<false>(z01, z23, upper))
        } else {
            self.accumulate::<true>(z01, z23, 0..low);
            (self.accumulate::<true>(z01, z23, between), self.accumulate::<true>(z01, z23, upper))
        };
        let loud = f64::from(upper);
        let added = &mut self.added;
        let loud = Loudness { power: loud, moment: loud * centre as f64, square: loud * loud };
        added.loudness = added.loudness.joined(loud, 0.0);
        added.centres = added.centres.saturating_add(centre);
        added.frames = added.frames.saturating_add(1);
        let power = power + upper;
        2.0 * power / plan.window_power
    }

    /// Adds the products of these runs of bins; the sum of the first (or second) hydrophone's powers. Apart:
    /// inlined into the whole chain it runs out of registers.
    #[inline(never)]
    fn accumulate<const SECOND: bool>(
        &mut self,
        z01: &Ring,
        z23: &Ring,
        runs: core::ops::Range<usize>,
    ) -> f32 {
        let mut of_one = [0.0; RUN];
        let (Some([own01, mirror01]), Some([own23, mirror23])) =
            (transform::sides(z01), transform::sides(z23))
        else {
            return 0.0;
        };
        for n in runs.start..runs.end.min(RUNS) {
            let n = n & (RUNS - 1);
            let mirror = own01.len() - 1 - n;
            let [x0, x1] = transform::separated(&own01[n], &mirror01[mirror]);
            let [x2, x3] = transform::separated(&own23[n], &mirror23[mirror]);
            let sums = &mut self.runs[n];
            let BinRun { re: [r01, r02, r03, r12, r13, r23], im: [i01, i02, i03, i12, i13, i23], auto } =
                sums;
            let [a0, a1, a2, a3] = auto;
            cross(&x0, &x1, r01, i01);
            cross(&x0, &x2, r02, i02);
            cross(&x0, &x3, r03, i03);
            cross(&x1, &x2, r12, i12);
            cross(&x1, &x3, r13, i13);
            cross(&x2, &x3, r23, i23);
            power(&x0, a0);
            power(if SECOND { &x1 } else { &x0 }, &mut of_one);
            power(&x1, a1);
            power(&x2, a2);
            power(&x3, a3);
        }
        of_one.iter().sum()
    }
}

/// The bins watched.
fn watched(plan: &Plan) -> impl Iterator<Item = usize> {
    let apart = plan.whole.high / WATCHED;
    (0..WATCHED).map(move |n| apart / 2 + n * apart)
}

/// Adds the powers of two hydrophones, twice from their common transform, at the bins watched.
#[inline(never)]
fn watch(z: &[Complex32; FRAME], plan: &Plan, sums: &mut Watched) {
    let [power, square] = sums;
    for ((k, power), square) in watched(plan).zip(power).zip(square) {
        let (a, b) = (z[k & (FRAME - 1)], z[FRAME.wrapping_sub(k) & (FRAME - 1)]);
        let own = WATCHED_SCALE * (a.re * a.re + a.im * a.im + b.re * b.re + b.im * b.im);
        *power += own;
        *square += own * own;
    }
}

/// Keeps a value, which the one kept before joins.
#[inline(always)]
fn keep(value: &mut f32, kept: &mut u16, join: bool) {
    let old = f32::from_bits(u32::from(*kept) << 16);
    // To the nearest of the upper halves.
    *kept = (value.to_bits().wrapping_add(0x8000) >> 16) as u16;
    if join {
        *value += old;
    }
}

/// The runs whose power tells when the sound was loud: the upper half of the band, where bearings come from and spectra are flat.
fn upper(plan: &Plan) -> core::ops::Range<usize> {
    let high = plan.passed.div_ceil(RUN);
    (high / 2).max(plan.envelope_low / RUN)..high
}

/// Frees a pair's transform of what a constant offset leaks into the lowest bins; bin 0 is not used.
fn without_offset(z: &mut [Complex32; FRAME], plan: &Plan) {
    let offset = core::mem::take(&mut z[0]);
    for (k, leak) in (1..).zip(&plan.offset_leak) {
        z[k] -= offset * leak;
        z[FRAME - k] -= offset * leak;
    }
}

/// Adds `X_i* X_j`, product by product: the target multiplies and adds in one instruction.
#[inline(always)]
fn cross(a: &[Complex32; RUN], b: &[Complex32; RUN], re: &mut [f32; RUN], im: &mut [f32; RUN]) {
    for (((a, b), re), im) in a.iter().zip(b).zip(re).zip(im) {
        *re = *re + a.re * b.re + a.im * b.im;
        *im = *im + a.re * b.im - a.im * b.re;
    }
}

/// Adds `|X|²`.
#[inline(always)]
fn power(x: &[Complex32; RUN], sum: &mut [f32; RUN]) {
    for (x, sum) in x.iter().zip(sum) {
        *sum = *sum + x.re * x.re + x.im * x.im;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kept_step_joins_the_next_to_a_thousandth() {
        let mut kept = Kept::new();
        let mut spectra = Spectra::new();
        for (step, scale) in [(7u64, 1.0f32), (8, 3.0)] {
            spectra.begin(step);
            for (n, value) in spectra.runs.iter_mut().flat_map(BinRun::values).enumerate() {
                *value = scale * (n as f32 - 2047.3);
            }
            (spectra.added.frames, spectra.added.centres) = (2, 100);
            spectra.end_step(&mut kept, step == 8, 1000);
        }
        assert_eq!(
            (spectra.added.frames, spectra.added.step, spectra.added.centres),
            (4, 7, 100 + 2000 + 100)
        );
        for (n, value) in spectra.runs.iter_mut().flat_map(BinRun::values).enumerate() {
            let exact = 4.0 * (n as f32 - 2047.3);
            assert!((*value / exact - 1.0).abs() < 1e-3, "{n}: {value} {exact}");
        }
        assert!(kept.precedes(9) && !kept.precedes(8));
        kept.forget();
        assert!(!kept.precedes(9));
    }
}
