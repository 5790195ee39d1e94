//! Power of pressure and horizontal motion in bands, averaged over frames: the answer to the command `Spectrum`.
//!
//! Enters: the transforms of every frame, by the way. Leaves: the [`Density`] of the last [`FRAMES`] frames that were
//! complete (overlapping by half under a Hann window; a minute at 50 Hz). Cost: 512 × 6 instructions a channel and frame.

use super::limits::{HOP, USED_CHANNELS};
use super::plan::Plan;
use crate::density::Density;
use crate::wire::{BANDS, EDGES};
use microfft::Complex32;

/// Frames of an average.
const FRAMES: u16 = 6;

/// Sums over frames.
#[derive(Clone, Copy, Debug)]
struct Sums {
    power: [[f32; BANDS]; USED_CHANNELS],
    frames: [u16; USED_CHANNELS],
    /// Indices of the middle of the first frame and of the last.
    first: u64,
    last: u64,
}

impl Sums {
    const NONE: Self =
        Self { power: [[0.0; BANDS]; USED_CHANNELS], frames: [0; USED_CHANNELS], first: 0, last: 0 };

    fn full(&self) -> bool {
        let [pressure, ..] = self.frames;
        pressure >= FRAMES
    }
}

/// The sums being made, and those made before.
#[derive(Clone, Debug)]
pub struct Averages {
    now: Sums,
    before: Sums,
    /// Of the newest frame's pressure.
    newest: [f32; BANDS],
}

impl Averages {
    /// Nothing yet; all zeros.
    pub const fn new() -> Self {
        Self { now: Sums::NONE, before: Sums::NONE, newest: [0.0; BANDS] }
    }

    /// A frame about this index begins, with the transform of pressure.
    pub fn begin(&mut self, middle: u64) {
        if self.now.full() {
            self.before = core::mem::replace(&mut self.now, Sums::NONE);
        }
        if self.now.frames == [0; USED_CHANNELS] {
            self.now.first = middle;
        }
        self.now.last = middle;
    }

    /// The frame's transform of a channel, by a window whose sum is 1.
    pub fn add(&mut self, channel: usize, transform: &[Complex32; HOP]) {
        let (Some(power), Some(frames)) = (self.now.power.get_mut(channel), self.now.frames.get_mut(channel))
        else {
            return;
        };
        *frames += 1;
        let mut sums = [0.0; BANDS];
        for ((sum, from), to) in sums.iter_mut().zip(&EDGES).zip(EDGES.iter().skip(1)) {
            let bins = transform.get(usize::from(*from)..usize::from(*to)).unwrap_or_default();
            *sum = bins.iter().map(|z| z.re * z.re + z.im * z.im).sum();
        }
        power.iter_mut().zip(&sums).for_each(|(all, sum)| *all += sum);
        if channel == 0 {
            self.newest = sums;
        }
    }

    /// Squared magnitudes of the newest frame's pressure, summed over the bins of each band.
    pub fn newest(&self) -> &[f32; BANDS] {
        &self.newest
    }

    /// Spectrum of a recorder channel; of fewer frames where there were no more.
    pub fn density(&self, plan: &Plan<'_>, channel: u8) -> Option<Density> {
        let of = if self.before.full() && !self.now.full() { &self.before } else { &self.now };
        let frames = *of.frames.get(usize::from(channel)).filter(|n| **n > 0)?;
        let power = of.power.get(usize::from(channel))?;
        Some(Density {
            index: of.first + (of.last - of.first) / 2,
            frames,
            bin_hz: plan.scale.bin_hz,
            tenth_db: plan.scale.levels(u32::from(frames), power),
        })
    }
}
