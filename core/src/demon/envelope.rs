//! Envelope: high-pass, square, cell sums, logarithm, decimation; kept as a ring of 30 s.
//!
//! In: samples. Out: natural logarithm of the band's power at about 68 Hz. The second stage is a 100-tap Hamming
//! low-pass at half the output rate, computed with five running accumulators (one for each output a cell belongs to):
//! −6 dB at the output's Nyquist frequency, −50 dB from 1.7 times it, so that the 50 and 60 Hz of mains do not fold
//! into the rates. Its droop acts on line and floor alike and cancels in their ratio.

use super::Settings;
use crate::block::{Block, CHANNELS, MISSING};
use crate::math;

/// Values in the window of one spectrum: the largest real FFT that leaves [`super::Scratch`] at 8 KiB.
pub const WINDOW: usize = 2048;
/// Cells from one output to the next.
pub const CELLS_PER_OUTPUT: usize = 20;
/// Outputs a cell takes part in.
const OVERLAP: usize = 5;
/// Length of the window aimed at, seconds; sets the output rate.
const WINDOW_S: f64 = 30.0;
/// Steps of the stored logarithm a neper: ±32 000 steps span more than any 32-bit power (±36 nepers).
const STEPS: f32 = 900.0;
/// "Not heard". Values are stored with its bit turned over, so that an empty ring is all zeros and costs no flash.
const UNHEARD: i16 = i16::MIN;
/// Added to the power so that silence has a logarithm, codes².
const SILENCE: f32 = 1e-3;

/// Filters and sizes.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    cell: u32,
    channels: u8,
    high_pass: f32,
    /// Row j weighs a cell for the output that began j outputs ago.
    taps: [[f32; CELLS_PER_OUTPUT]; OVERLAP],
}

impl Plan {
    pub(super) fn new(s: &Settings) -> Self {
        use math::f64 as m;
        let cells_hz = WINDOW as f64 / WINDOW_S * CELLS_PER_OUTPUT as f64;
        let cell = m::round(s.rate_hz / cells_hz).max(1.0);
        let n = (CELLS_PER_OUTPUT * OVERLAP) as f64;
        let mut taps = [[0.0f32; CELLS_PER_OUTPUT]; OVERLAP];
        let mut sum = 0.0;
        for (i, tap) in taps.iter_mut().flatten().enumerate() {
            let t = (i as f64 + 0.5 - n / 2.0) / CELLS_PER_OUTPUT as f64;
            let sinc = m::sin(m::PI * t) / (m::PI * t);
            let hamming = 0.54 + 0.46 * m::cos(m::TAU * t * CELLS_PER_OUTPUT as f64 / n);
            *tap = (sinc * hamming) as f32;
            sum += sinc * hamming;
        }
        for tap in taps.iter_mut().flatten() {
            *tap /= sum as f32;
        }
        let high_pass = 1.0 - m::exp(-m::TAU * s.high_pass_hz / s.rate_hz);
        Self { cell: cell as u32, channels: s.channels, high_pass: high_pass as f32, taps }
    }

    /// Outputs a second.
    pub(super) fn output_hz(&self, rate_hz: f64) -> f64 {
        rate_hz / (f64::from(self.cell) * CELLS_PER_OUTPUT as f64)
    }

    /// Samples of a whole window.
    fn window_samples(&self) -> u64 {
        u64::from(self.cell) * (CELLS_PER_OUTPUT * WINDOW) as u64
    }
}

/// One output being summed up.
#[derive(Clone, Copy, Debug)]
struct Accumulator {
    sum: f32,
    whole: bool,
}

/// Filter memory and the ring of outputs.
#[derive(Clone, Debug)]
pub(super) struct Envelope {
    /// Values with the bit of [`UNHEARD`] turned over.
    ring: [i16; WINDOW],
    /// Where the next output goes (the oldest value).
    next: usize,
    outputs: [Accumulator; OVERLAP],
    low: [f32; CHANNELS],
    power: f32,
    broken: bool,
    filled: u32,
    phase: usize,
    index: Option<u64>,
}

impl Envelope {
    pub(super) const fn new() -> Self {
        Self {
            ring: [0; WINDOW],
            next: 0,
            outputs: [Accumulator { sum: 0.0, whole: false }; OVERLAP],
            low: [0.0; CHANNELS],
            power: 0.0,
            broken: false,
            filled: 0,
            phase: 0,
            index: None,
        }
    }

    /// The window, oldest first: natural logarithm of power, `None` where not heard.
    pub(super) fn window(&self) -> impl Iterator<Item = Option<f32>> + '_ {
        let (newer, older) = self.ring.split_at_checked(self.next).unwrap_or((&[], &self.ring));
        older.iter().chain(newer).map(|v| v ^ UNHEARD).map(|v| (v != UNHEARD).then_some(f32::from(v) / STEPS))
    }

    /// Takes a block and calls `output` after each new value of the ring, with the sample index behind it.
    pub(super) fn process(&mut self, plan: &Plan, block: &Block<'_>, output: &mut dyn FnMut(&Self, u64)) {
        let mut index = self.index.unwrap_or(block.first_index);
        if block.first_index.abs_diff(index) > plan.window_samples() {
            *self = Self::new();
            index = block.first_index;
        }
        let gap = block.first_index.saturating_sub(index);
        let heard = usize::try_from(index.saturating_sub(block.first_index)).unwrap_or(usize::MAX);
        if gap > 0 {
            self.low = [0.0; CHANNELS];
        }
        let mut left = gap;
        while left > 0 {
            let take = left.min(u64::from(plan.cell.saturating_sub(self.filled)).max(1));
            self.broken = true;
            left -= take;
            index += take;
            self.advance(plan, take as u32, index, output);
        }
        let mut frames = block.frames.get(heard..).unwrap_or(&[]);
        while !frames.is_empty() {
            let take = (plan.cell.saturating_sub(self.filled) as usize).max(1).min(frames.len());
            let (now, rest) = frames.split_at_checked(take).unwrap_or((frames, &[]));
            for (c, low) in self.low.iter_mut().enumerate() {
                if plan.channels >> c & 1 == 0 {
                    continue;
                }
                let (mut l, mut power) = (*low, 0.0f32);
                for frame in now {
                    let code = frame.get(c).copied().unwrap_or(MISSING);
                    if code == MISSING {
                        self.broken = true;
                        continue;
                    }
                    let high = code as f32 - l;
                    l += plan.high_pass * high;
                    power += high * high;
                }
                *low = l;
                self.power += power;
            }
            frames = rest;
            index += take as u64;
            self.advance(plan, take as u32, index, output);
        }
        self.index = Some(index);
    }

    /// `samples` more are in the cell (never beyond its end).
    fn advance(&mut self, plan: &Plan, samples: u32, index: u64, output: &mut dyn FnMut(&Self, u64)) {
        self.filled += samples;
        if self.filled < plan.cell {
            return;
        }
        let broken = self.broken;
        let log = math::f32::ln(self.power / plan.cell as f32 + SILENCE);
        (self.filled, self.power, self.broken) = (0, 0.0, false);
        for (out, taps) in self.outputs.iter_mut().zip(&plan.taps) {
            out.sum += taps.get(self.phase).copied().unwrap_or(0.0) * log;
            out.whole &= !broken;
        }
        self.phase += 1;
        if self.phase < CELLS_PER_OUTPUT {
            return;
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
        self.next = (self.next + 1) % WINDOW;
        output(self, index);
    }
}
