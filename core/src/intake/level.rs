//! Level of each channel: mean square about the mean, over full scale squared.

use crate::block::{CHANNELS, Frame};
use crate::math;

/// Sums since the last level, and the last level.
#[derive(Clone, Debug)]
pub struct Levels {
    origin: Frame,
    sum: [f32; CHANNELS],
    square: [f32; CHANNELS],
    n: u32,
    half_db: [i8; CHANNELS],
    /// [`super::Intake::elapsed`] when the level was made; `None` before the first.
    made: Option<u64>,
}

impl Levels {
    /// Nothing heard; all zeros.
    pub const fn new() -> Self {
        Self {
            origin: [0; CHANNELS],
            sum: [0.0; CHANNELS],
            square: [0.0; CHANNELS],
            n: 0,
            half_db: [0; CHANNELS],
            made: None,
        }
    }

    /// Nothing has come for so long that the last level says nothing of now.
    pub fn forget(&mut self) {
        self.made = None;
    }

    /// Takes an instant.
    #[inline]
    pub fn add(&mut self, frame: &Frame) {
        if self.n == 0 {
            self.origin = *frame;
        }
        self.n += 1;
        for c in 0..CHANNELS {
            let x = frame[c].wrapping_sub(self.origin[c]) as f32;
            self.sum[c] += x;
            self.square[c] += x * x;
        }
    }

    /// Takes instants, the sums in registers meanwhile.
    #[cfg(any(feature = "array", feature = "obs"))]
    #[inline]
    pub(crate) fn extend(&mut self, mut frames: impl Iterator<Item = Frame>) {
        if self.n == 0
            && let Some(first) = frames.next()
        {
            self.add(&first);
        }
        let (origin, mut sum, mut square, mut n) = (self.origin, self.sum, self.square, self.n);
        for frame in frames {
            n += 1;
            for c in 0..CHANNELS {
                let x = frame[c].wrapping_sub(origin[c]) as f32;
                sum[c] += x;
                square[c] += x * x;
            }
        }
        (self.sum, self.square, self.n) = (sum, square, n);
    }

    /// What was taken since the level, to find out what comes after: sums about the origin, of squares, number.
    #[cfg(feature = "array")]
    #[inline]
    pub(crate) fn sums(&self) -> ([f32; CHANNELS], [f32; CHANNELS], u32) {
        (self.sum, self.square, self.n)
    }

    /// Mean and mean square about it of each channel over what was taken since `before`, codes and codes².
    #[cfg(feature = "array")]
    pub(crate) fn since(&self, before: &([f32; CHANNELS], [f32; CHANNELS], u32)) -> [(f32, f32); CHANNELS] {
        let part = 1.0 / (self.n.saturating_sub(before.2)).max(1) as f32;
        let mut out = [(0.0, 0.0); CHANNELS];
        for c in 0..CHANNELS {
            let mean = part * (self.sum[c] - before.0[c]);
            let power = part * (self.square[c] - before.1[c]) - mean * mean;
            out[c] = (self.origin[c] as f32 + mean, power.max(0.0));
        }
        out
    }

    /// Makes the level of what was taken since the last; `elapsed` as of [`super::Intake::elapsed`].
    pub fn close(&mut self, full_scale: f32, elapsed: u64) {
        if self.n == 0 {
            return;
        }
        let n = self.n as f32;
        for c in 0..CHANNELS {
            let mean = self.sum[c] / n;
            let power = (self.square[c] / n - mean * mean).max(0.0) / (full_scale * full_scale);
            self.half_db[c] =
                if power > 0.0 { (2.0 * math::db(power)).clamp(-127.0, 0.0) as i8 } else { i8::MIN };
        }
        self.made = Some(elapsed);
        (self.sum, self.square, self.n) = ([0.0; CHANNELS], [0.0; CHANNELS], 0);
    }

    /// Half decibels re full scale; −128 where a channel does not move, and where nothing was heard for `minute` instants
    /// up to `elapsed`.
    pub fn half_db(&self, elapsed: u64, minute: u64) -> [i8; CHANNELS] {
        match self.made {
            Some(made) if elapsed.saturating_sub(made) <= minute => self.half_db,
            _ => [i8::MIN; CHANNELS],
        }
    }
}
