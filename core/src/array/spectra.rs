//! From frames to Welch cross-spectra of the six pairs and auto-spectra of the four hydrophones.
//!
//! `G_ij(f) = Σ_frames X_i*(f) X_j(f)` (METHODS section 1). Window, transform and accumulation are the work done for
//! every sample: all loops run over fixed arrays. Cost on the Cortex-M7: four transforms of 22 400 instructions a frame,
//! about 12 instructions a sample for conversion and window, about 100 a bin for accumulation.

use super::plan::{BINS, FRAME, Plan};
use super::wavefront::PAIR_COUNT;
use crate::block::CHANNELS;
use microfft::Complex32;

/// Values handled at a time: a fixed number, so that the loops' own work is shared among them.
const RUN: usize = 8;

/// Work space of one frame: windowed samples, transformed in place (8 KiB).
pub(crate) type FrameWork = [[f32; FRAME]; CHANNELS];

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
    pub(crate) fn add(&mut self, plan: &Plan, codes: &[[i32; FRAME]; CHANNELS], work: &mut FrameWork) {
        for (work, channel) in work.iter_mut().zip(plan.channels) {
            // The plan's channels are a permutation of 0..4; the fallback is never taken.
            let Some(codes) = codes.get(usize::from(channel)) else { continue };
            windowed(codes, &plan.window, work);
        }
        let [w0, w1, w2, w3] = work;
        let x0 = transform(w0, plan);
        let x1 = transform(w1, plan);
        let x2 = transform(w2, plan);
        let x3 = transform(w3, plan);
        let bins = plan.high.min(BINS);
        let [r01, r02, r03, r12, r13, r23] = &mut self.re;
        let [i01, i02, i03, i12, i13, i23] = &mut self.im;
        let [a0, a1, a2, a3] = &mut self.auto;
        cross(&x0[..bins], &x1[..bins], &mut r01[..bins], &mut i01[..bins]);
        cross(&x0[..bins], &x2[..bins], &mut r02[..bins], &mut i02[..bins]);
        cross(&x0[..bins], &x3[..bins], &mut r03[..bins], &mut i03[..bins]);
        cross(&x1[..bins], &x2[..bins], &mut r12[..bins], &mut i12[..bins]);
        cross(&x1[..bins], &x3[..bins], &mut r13[..bins], &mut i13[..bins]);
        cross(&x2[..bins], &x3[..bins], &mut r23[..bins], &mut i23[..bins]);
        for (x, a) in [(x0, a0), (x1, a1), (x2, a2), (x3, a3)] {
            power(&x[..bins], &mut a[..bins]);
        }
        self.frames = self.frames.saturating_add(1);
    }
}

/// Codes times window. Apart: inlined into the whole chain it runs out of registers and takes twice the instructions.
#[inline(never)]
fn windowed(codes: &[i32; FRAME], window: &[f32; FRAME], out: &mut [f32; FRAME]) {
    let (out, codes) = (out.as_chunks_mut::<RUN>().0, codes.as_chunks::<RUN>().0);
    for ((out, codes), window) in out.iter_mut().zip(codes).zip(window.as_chunks::<RUN>().0) {
        for ((x, code), w) in out.iter_mut().zip(codes).zip(window) {
            *x = *code as f32 * w;
        }
    }
}

/// The spectrum of one windowed channel, freed of what a constant offset leaks into its lowest bins.
fn transform<'a>(samples: &'a mut [f32; FRAME], plan: &Plan) -> &'a [Complex32; BINS] {
    let x = microfft::real::rfft_512(samples);
    let offset = x[0].re;
    for (x, leak) in x.iter_mut().skip(1).zip(&plan.offset_leak) {
        x.re -= offset * leak;
    }
    // Bin 0 carries the offset and, in its imaginary part, the Nyquist bin: neither is used.
    x[0] = Complex32::new(0.0, 0.0);
    x
}

/// Adds `X_i* X_j`.
#[inline]
fn cross(a: &[Complex32], b: &[Complex32], re: &mut [f32], im: &mut [f32]) {
    #[inline(always)]
    fn run(a: &[Complex32], b: &[Complex32], re: &mut [f32], im: &mut [f32]) {
        for (((a, b), re), im) in a.iter().zip(b).zip(re).zip(im) {
            *re += a.re * b.re + a.im * b.im;
            *im += a.re * b.im - a.im * b.re;
        }
    }
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<RUN>(), b.as_chunks::<RUN>());
    let ((re, re_rest), (im, im_rest)) = (re.as_chunks_mut::<RUN>(), im.as_chunks_mut::<RUN>());
    for (((a, b), re), im) in a.iter().zip(b).zip(re).zip(im) {
        run(a, b, re, im);
    }
    run(a_rest, b_rest, re_rest, im_rest);
}

/// Adds `|X|²`.
#[inline]
fn power(x: &[Complex32], sum: &mut [f32]) {
    #[inline(always)]
    fn run(x: &[Complex32], sum: &mut [f32]) {
        for (x, sum) in x.iter().zip(sum) {
            *sum += x.re * x.re + x.im * x.im;
        }
    }
    let ((x, x_rest), (sum, sum_rest)) = (x.as_chunks::<RUN>(), sum.as_chunks_mut::<RUN>());
    for (x, sum) in x.iter().zip(sum) {
        run(x, sum);
    }
    run(x_rest, sum_rest);
}
