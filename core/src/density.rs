//! Power spectral density in the bands of a [`Spectrum`], as either chain has it at hand.

use crate::keeper::{DONE, REFUSED};
use crate::math;
use crate::wire::{BANDS, EDGES, Message, Spectrum};
use core::ops::Range;

/// What one channel's spectrum says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Density {
    /// Index of the middle of the data used.
    pub(crate) index: u64,
    /// Frames averaged.
    pub(crate) frames: u16,
    /// Distance of two bins, Hz.
    pub(crate) bin_hz: f32,
    /// As [`Spectrum::tenth_db`].
    pub(crate) tenth_db: [i16; BANDS],
}

/// Levels of the bands that lie in bins `low` up to before `high`; `sum` of the densities of a band's bins, full scale squared
/// a hertz.
pub(crate) fn levels(
    low: usize,
    high: usize,
    mut sum: impl FnMut(usize, Range<usize>) -> f32,
) -> [i16; BANDS] {
    let mut out = [Spectrum::NOTHING; BANDS];
    for (band, ((out, from), to)) in out.iter_mut().zip(&EDGES).zip(EDGES.iter().skip(1)).enumerate() {
        let bins = usize::from(*from)..usize::from(*to);
        if bins.start >= low && bins.end <= high {
            let n = bins.len() as f32;
            *out = tenth_db(sum(band, bins) / n);
        }
    }
    out
}

/// A density's level, tenths of a decibel.
pub(crate) fn tenth_db(density: f32) -> i16 {
    if density > 0.0 {
        // Saturates.
        math::f32::floor(100.0 * math::f32::log10(density) + 0.5) as i16
    } else {
        Spectrum::NOTHING
    }
}

/// Answers with the spectra of the channels that were asked for, of those that have one; the status of the reply.
pub(crate) fn tell(
    token: u8,
    channels: u8,
    of_channel: impl Fn(u8) -> Option<Density>,
    sink: &mut impl FnMut(&Message),
) -> u8 {
    let asked = (0..4u8).filter(|c| channels >> c & 1 == 1);
    let of = asked.clone().filter(|c| of_channel(*c).is_some()).fold(0, |of, c| of | 1 << c);
    for channel in asked {
        if let Some(Density { index, frames, bin_hz, tenth_db }) = of_channel(channel) {
            sink(&Message::Spectrum(Spectrum { token, index, channel, of, frames, bin_hz, tenth_db }));
        }
    }
    if of == 0 { REFUSED } else { DONE }
}
