//! Slow levels: the mean power of one channel in the bands of a [`Spectrum`] over intervals of minutes, sent unasked.
//!
//! Enters: of every frame the sums of its squared magnitudes over bands, which the chain's own transforms give. Leaves: a
//! [`Spectrum`] without token for every interval in which samples filled a frame, of the frames that could be used; without any
//! of those all bands are [`Spectrum::NOTHING`]. Intervals begin at multiples of their length from index 0, and a frame belongs
//! to the one that holds its middle (an array's to the one in which its step begins). Memory: 136 bytes.

use crate::config::StationConfig;
use crate::density::Scale;
use crate::math;
use crate::wire::{BANDS, Message, Spectrum};
use core::num::NonZeroU64;

/// What the configuration asks for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plan {
    /// Recorder channel.
    pub(crate) channel: u8,
    /// Instants of an interval; none where nothing is asked for.
    interval: Option<NonZeroU64>,
    scale: Scale,
}

impl Plan {
    /// Nothing asked for; all zeros.
    #[cfg(feature = "obs")]
    pub(crate) const EMPTY: Self = Self { channel: 0, interval: None, scale: Scale::EMPTY };

    /// Of a configuration, and of a chain that measures so.
    pub(crate) fn new(config: &StationConfig, scale: Scale) -> Self {
        let instants = math::f64::round(f64::from(config.levels.every_s) * config.rate_hz) as u64;
        Self { channel: config.levels.channel, interval: NonZeroU64::new(instants), scale }
    }

    /// Whether anything is asked for.
    #[cfg(feature = "array")]
    pub(crate) fn is_on(&self) -> bool {
        self.interval.is_some()
    }
}

/// The sums of an interval.
#[derive(Clone, Debug)]
pub(crate) struct SlowLevels {
    sums: [f32; BANDS],
    frames: u32,
    /// Indices of the middle of what was added first and last.
    first: u64,
    last: u64,
    /// Number of the interval, once something of it has come.
    interval: Option<u64>,
}

impl SlowLevels {
    /// Nothing heard; all zeros.
    pub(crate) const fn new() -> Self {
        Self { sums: [0.0; BANDS], frames: 0, first: 0, last: 0, interval: None }
    }

    /// A frame at this index has come, of use or not: the interval before is sent where another has begun.
    pub(crate) fn go_on(&mut self, plan: &Plan, index: u64, sink: &mut dyn FnMut(Message)) {
        let Some(length) = plan.interval else { return };
        let now = Some(index / length);
        if self.interval != now {
            self.end(plan, sink);
            self.interval = now;
        }
    }

    /// So many frames about an index are added to the interval that goes on: the sums of bands to which their squared magnitudes
    /// are to be added; none where no interval goes on.
    pub(crate) fn add(&mut self, frames: u32, middle: u64) -> Option<&mut [f32; BANDS]> {
        self.interval?;
        if self.frames == 0 {
            self.first = middle;
        }
        self.last = middle;
        self.frames = self.frames.saturating_add(frames);
        Some(&mut self.sums)
    }

    /// Nothing more comes of the interval: it is sent, and forgotten.
    // Apart, because its message must not take stack while samples are worked on.
    #[inline(never)]
    pub(crate) fn end(&mut self, plan: &Plan, sink: &mut dyn FnMut(Message)) {
        let Self { sums, frames, first, last, interval } = core::mem::replace(self, Self::new());
        let (Some(interval), Some(length)) = (interval, plan.interval) else { return };
        let index = match frames {
            0 => interval.saturating_mul(length.get()).saturating_add(length.get() / 2),
            _ => first + last.saturating_sub(first) / 2,
        };
        sink(Message::Spectrum(Spectrum {
            token: Spectrum::UNASKED,
            index,
            channel: plan.channel,
            of: 0,
            frames: frames.min(u32::from(u16::MAX)) as u16,
            bin_hz: plan.scale.bin_hz,
            tenth_db: plan.scale.levels(frames, &sums),
        }));
    }
}
