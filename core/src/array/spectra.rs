//! From frames to Welch cross-spectra of the six pairs and auto-spectra of the four hydrophones.
//!
//! `G_ij(f) = Σ_frames X_i*(f) X_j(f)` (METHODS section 1). Window, transform and accumulation are the work done for
//! every sample: all loops run over fixed arrays. Cost on the Cortex-M7: 59 000 instructions a frame for window and
//! transforms of all four channels, 130 a bin for separation and accumulation.

use super::plan::{BINS, FRAME, Plan};
use super::transform::{self, RUN, Work};
use super::wavefront::PAIR_COUNT;
use crate::block::CHANNELS;
use microfft::Complex32;

/// Accumulated spectra of one step (16 KiB).
#[derive(Clone, Debug)]
pub(crate) struct Spectra {
    pub(crate) re: [[f32; BINS]; PAIR_COUNT],
    pub(crate) im: [[f32; BINS]; PAIR_COUNT],
    pub(crate) auto: [[f32; BINS]; CHANNELS],
    /// Frames added.
    pub(crate) frames: u32,
    /// Number of the step the frames belong to.
    pub(crate) step: u64,
    /// Sum over frames of their centre's distance from the step's start, samples.
    pub(crate) centres: u64,
    /// Whether any frame held clipped samples.
    pub(crate) clipped: bool,
}

impl Spectra {
    pub(crate) const fn new() -> Self {
        Self {
            re: [[0.0; BINS]; PAIR_COUNT],
            im: [[0.0; BINS]; PAIR_COUNT],
            auto: [[0.0; BINS]; CHANNELS],
            frames: 0,
            step: 0,
            centres: 0,
            clipped: false,
        }
    }

    /// Empties it for a step.
    pub(crate) fn begin(&mut self, step: u64) {
        for row in self.re.iter_mut().chain(&mut self.im).chain(&mut self.auto) {
            row.fill(0.0);
        }
        self.frames = 0;
        self.step = step;
        self.centres = 0;
        self.clipped = false;
    }

    /// Adds a later step of `step_samples`; times stay relative to this step's start.
    pub(crate) fn join(&mut self, later: &Self, step_samples: u64) {
        let mine = self.re.iter_mut().chain(&mut self.im).chain(&mut self.auto);
        let theirs = later.re.iter().chain(&later.im).chain(&later.auto);
        for (a, b) in mine.zip(theirs) {
            for (a, b) in a.iter_mut().zip(b) {
                *a += b;
            }
        }
        let shift = later.step.saturating_sub(self.step).saturating_mul(step_samples);
        self.centres = self
            .centres
            .saturating_add(later.centres)
            .saturating_add(shift.saturating_mul(u64::from(later.frames)));
        self.frames = self.frames.saturating_add(later.frames);
        self.clipped |= later.clipped;
    }

    /// Adds one frame: `codes` in recorder order, mapped to hydrophones by the plan.
    pub(crate) fn add(&mut self, plan: &Plan, codes: &[[i32; FRAME]; CHANNELS], work: &mut Work) {
        // The plan's channels are a permutation of 0..4.
        transform::transform(plan.channels.map(|c| &codes[usize::from(c & 3)]), work);
        let [z01, z23] = work.as_chunks_mut::<FRAME>().0 else { return };
        without_offset(z01, plan);
        without_offset(z23, plan);
        self.accumulate(z01, z23, plan.whole.high.div_ceil(RUN).min(BINS / RUN));
        self.frames = self.frames.saturating_add(1);
    }

    /// Adds the products of the first `runs` runs of bins. Apart: inlined into the whole chain it runs out of registers.
    #[inline(never)]
    fn accumulate(&mut self, z01: &[Complex32; FRAME], z23: &[Complex32; FRAME], runs: usize) {
        let [r01, r02, r03, r12, r13, r23] = &mut self.re;
        let [i01, i02, i03, i12, i13, i23] = &mut self.im;
        let [a0, a1, a2, a3] = &mut self.auto;
        for run in 0..runs {
            let [x0, x1] = transform::separated(z01, run);
            let [x2, x3] = transform::separated(z23, run);
            cross(&x0, &x1, part(r01, run), part(i01, run));
            cross(&x0, &x2, part(r02, run), part(i02, run));
            cross(&x0, &x3, part(r03, run), part(i03, run));
            cross(&x1, &x2, part(r12, run), part(i12, run));
            cross(&x1, &x3, part(r13, run), part(i13, run));
            cross(&x2, &x3, part(r23, run), part(i23, run));
            power(&x0, part(a0, run));
            power(&x1, part(a1, run));
            power(&x2, part(a2, run));
            power(&x3, part(a3, run));
        }
    }
}

/// The bins of a run (which is below `BINS/RUN`).
#[inline(always)]
fn part(row: &mut [f32; BINS], run: usize) -> &mut [f32; RUN] {
    &mut row.as_chunks_mut().0[run & (BINS / RUN - 1)]
}

/// Frees a pair's transform of what a constant offset leaks into the lowest bins; bin 0 is not used.
fn without_offset(z: &mut [Complex32; FRAME], plan: &Plan) {
    let offset = core::mem::take(&mut z[0]);
    for (k, leak) in (1..).zip(&plan.offset_leak) {
        z[k] -= offset * leak;
        z[FRAME - k] -= offset * leak;
    }
}

/// Adds `X_i* X_j`.
#[inline(always)]
fn cross(a: &[Complex32; RUN], b: &[Complex32; RUN], re: &mut [f32; RUN], im: &mut [f32; RUN]) {
    for (((a, b), re), im) in a.iter().zip(b).zip(re).zip(im) {
        *re += a.re * b.re + a.im * b.im;
        *im += a.re * b.im - a.im * b.re;
    }
}

/// Adds `|X|²`.
#[inline(always)]
fn power(x: &[Complex32; RUN], sum: &mut [f32; RUN]) {
    for (x, sum) in x.iter().zip(sum) {
        *sum += x.re * x.re + x.im * x.im;
    }
}
