//! Power spectral density in the bands of a [`Spectrum`], as either chain has it at hand.

use crate::keeper::{DONE, REFUSED};
use crate::math;
use crate::wire::{BANDS, EDGES, Message, Spectrum};

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

/// What makes densities of a chain's transforms.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale {
    /// One-sided density that a squared magnitude of 1 stands for, full scale squared a hertz.
    pub(crate) unit: f32,
    /// Distance of two bins, Hz.
    pub(crate) bin_hz: f32,
    /// The first bin that is measured.
    pub(crate) low: u16,
    /// The one after the last.
    pub(crate) high: u16,
}

impl Scale {
    /// Nothing measured; all zeros.
    #[cfg(feature = "obs")]
    pub(crate) const EMPTY: Self = Self { unit: 0.0, bin_hz: 0.0, low: 0, high: 0 };

    /// Levels of the bands that are measured as a whole of sums over its bins and so many frames.
    #[inline(never)]
    pub(crate) fn levels(&self, frames: u32, sums: &[f32; BANDS]) -> [i16; BANDS] {
        let mut out = [Spectrum::NOTHING; BANDS];
        for (((out, sum), from), to) in out.iter_mut().zip(sums).zip(&EDGES).zip(EDGES.iter().skip(1)) {
            if *from >= self.low && *to <= self.high {
                *out = tenth_db(self.unit * sum / (frames as f32 * f32::from(to - from)));
            }
        }
        out
    }
}

/// Adds to each band's sum what its bins have.
// One loop for all: it is rare, and code is dear.
#[cfg(feature = "array")]
#[inline(never)]
pub(crate) fn add(sums: &mut [f32; BANDS], of_bin: &dyn Fn(usize) -> f32) {
    for ((sum, from), to) in sums.iter_mut().zip(&EDGES).zip(EDGES.iter().skip(1)) {
        *sum += (usize::from(*from)..usize::from(*to)).map(of_bin).sum::<f32>();
    }
}

/// A density's level, tenths of a decibel.
fn tenth_db(density: f32) -> i16 {
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
