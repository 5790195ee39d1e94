//! Envelope: powers of frames, their logarithm, decimation; kept as a ring of about 30 s.
//!
//! In: the band's power of each frame (one in 7 ms at 64 kHz). Out: its natural logarithm at about 68 Hz, or once a frame
//! where frames come slower (36 Hz at 16 kHz); the window then holds fewer outputs and lasts as long. The decimating low-pass is five
//! outputs long, a Hamming window at half the output rate, computed with five running accumulators (one for each output
//! a frame belongs to): −6 dB at the output's Nyquist frequency. Its droop acts on line and floor alike and cancels in their
//! ratio. A frame's own window is the low-pass before it: a modulation within 16 Hz of the frames' rate (127 to 159 Hz at 64 kHz) folds
//! into the rates at a sixth of its depth or less.
//!
//! Frames are numbered by their sample index, so a frame that is missing is an output not heard.

use crate::math;
use core::num::NonZeroU64;

/// Most values in the window of one spectrum: the largest real FFT that leaves [`super::Scratch`] at 8 KiB.
pub const WINDOW: usize = 2048;
/// Outputs a frame takes part in.
const OVERLAP: usize = 5;
/// Most frames of an output: six at 192 kHz.
const MOST_FRAMES: usize = 8;
/// Windows there are, in values.
const WINDOWS: [usize; 3] = [WINDOW / 4, WINDOW / 2, WINDOW];
/// Length of the window aimed at, seconds.
const WINDOW_S: f64 = 30.0;
/// Outputs a second aimed at: the largest window lasts that long.
const OUTPUT_HZ: f64 = WINDOW as f64 / WINDOW_S;
/// Steps of the stored logarithm a neper: ±32 000 steps span more than any 32-bit power (±36 nepers).
const STEPS: f32 = 900.0;
/// "Not heard". Values are stored with its bit turned over, so that an empty ring is all zeros and costs no flash.
const UNHEARD: i16 = i16::MIN;
/// Added to the power so that silence has a logarithm, codes².
const SILENCE: f32 = 1e-3;

/// Filters and sizes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    /// Samples from one frame to the next.
    hop: NonZeroU64,
    frames_per_output: usize,
    /// Outputs in the window of one spectrum: of [`WINDOWS`] the one nearest to [`WINDOW_S`].
    pub(super) window: usize,
    /// Row j weighs a frame for the output that began j outputs ago.
    taps: [[f32; MOST_FRAMES]; OVERLAP],
}

impl Plan {
    pub(super) fn new(rate_hz: f64, hop: NonZeroU64) -> Self {
        use math::f64 as m;
        let frames = m::round(rate_hz / (hop.get() as f64 * OUTPUT_HZ)).clamp(1.0, MOST_FRAMES as f64);
        let frames_per_output = frames as usize;
        let n = (frames_per_output * OVERLAP) as f64;
        let mut taps = [[0.0f32; MOST_FRAMES]; OVERLAP];
        let mut sum = 0.0;
        let each = taps.iter_mut().flat_map(|row| row.iter_mut().take(frames_per_output));
        for (i, tap) in each.enumerate() {
            let t = (i as f64 + 0.5 - n / 2.0) / frames;
            let sinc = if m::abs(t) < 1e-9 { 1.0 } else { m::sin(m::PI * t) / (m::PI * t) };
            let value = sinc * (0.54 + 0.46 * m::cos(m::TAU * t * frames / n));
            *tap = value as f32;
            sum += value;
        }
        for tap in taps.iter_mut().flatten() {
            *tap /= sum as f32;
        }
        let output_hz = rate_hz / (hop.get() as f64 * frames);
        let off = |window: usize| m::abs(window as f64 / output_hz - WINDOW_S);
        let window = WINDOWS.into_iter().min_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or(WINDOW);
        Self { hop, frames_per_output, window, taps }
    }

    /// Outputs a second.
    pub(super) fn output_hz(&self, rate_hz: f64) -> f64 {
        rate_hz / (self.hop.get() as f64 * self.frames_per_output as f64)
    }
}

/// One output being summed up.
#[derive(Clone, Copy, Debug)]
struct Accumulator {
    sum: f32,
    whole: bool,
}

/// Filter memory and the ring of outputs; every call takes the same plan.
#[derive(Clone, Debug)]
pub(super) struct Envelope {
    /// Values with the bit of [`UNHEARD`] turned over, in the first [`Plan::window`] places.
    ring: [i16; WINDOW],
    /// Where the next output goes (the oldest value).
    next: usize,
    outputs: [Accumulator; OVERLAP],
    phase: usize,
    /// Number of the frame expected next.
    expected: Option<u64>,
}

impl Envelope {
    pub(super) const fn new() -> Self {
        Self {
            ring: [0; WINDOW],
            next: 0,
            outputs: [Accumulator { sum: 0.0, whole: false }; OVERLAP],
            phase: 0,
            expected: None,
        }
    }

    /// The window, oldest first: natural logarithm of power, `None` where not heard.
    pub(super) fn window(&self, plan: &Plan) -> impl Iterator<Item = Option<f32>> + '_ {
        let ring = self.ring.get(..plan.window).unwrap_or(&self.ring);
        let (newer, older) = ring.split_at_checked(self.next).unwrap_or((&[], ring));
        older.iter().chain(newer).map(|v| v ^ UNHEARD).map(|v| (v != UNHEARD).then_some(f32::from(v) / STEPS))
    }

    /// Takes the power (codes²) of the frame whose first sample is `index`; how many outputs that completed. Frames left
    /// out before it are unheard; of a whole window of them nothing is left.
    pub(super) fn take(&mut self, plan: &Plan, index: u64, power: f32) -> u32 {
        let number = index.saturating_add(plan.hop.get() / 2) / plan.hop;
        let mut missing = number.saturating_sub(self.expected.unwrap_or(number));
        if missing > (plan.window * plan.frames_per_output) as u64 {
            *self = Self::new();
            missing = 0;
        }
        self.expected = Some(number.saturating_add(1));
        let mut outputs = 0;
        for _ in 0..missing {
            outputs += self.advance(plan, None);
        }
        outputs + self.advance(plan, Some(math::f32::ln(power + SILENCE)))
    }

    /// Takes the next frame's logarithm, `None` if it is missing; outputs completed.
    fn advance(&mut self, plan: &Plan, log: Option<f32>) -> u32 {
        for (out, taps) in self.outputs.iter_mut().zip(&plan.taps) {
            out.sum += taps.get(self.phase).copied().unwrap_or(0.0) * log.unwrap_or(0.0);
            out.whole &= log.is_some();
        }
        self.phase += 1;
        if self.phase < plan.frames_per_output {
            return 0;
        }
        self.phase = 0;
        let done = self.outputs[OVERLAP - 1];
        self.outputs.copy_within(..OVERLAP - 1, 1);
        self.outputs[0] = Accumulator { sum: 0.0, whole: true };
        if let Some(slot) = self.ring.get_mut(self.next) {
            // Float to integer saturates: no value can become UNHEARD by overflow before −36 nepers.
            let value = math::f32::round(done.sum * STEPS).max(-32_000.0) as i16;
            *slot = (if done.whole { value } else { UNHEARD }) ^ UNHEARD;
        }
        self.next += 1;
        if self.next >= plan.window {
            self.next = 0;
        }
        1
    }
}
