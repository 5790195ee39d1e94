//! What a base station hears of the sound itself: raw samples in pieces, and spectra.

use serde::{Deserialize, Serialize};

/// Raw samples that a command asked for: contiguous, taken, and about to be sent as [`Samples`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Snippet {
    /// The command's.
    pub token: u8,
    /// Index of the first instant.
    pub index: u64,
    /// How many there are.
    pub instants: u32,
    /// Bit c: channel c is in it.
    pub channels: u8,
}

/// Bytes of samples in one [`Samples`]: two of these are one frame of a link.
pub const SAMPLES_BYTES: usize = 60;

/// Instants of a [`Snippet`] that follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Samples {
    /// The command's.
    pub token: u8,
    /// Index of the first instant.
    pub index: u64,
    /// How many there are.
    pub instants: u8,
    /// Bit c: channel c is in it.
    pub channels: u8,
    /// Bytes of one code, 1 to 4.
    pub width: u8,
    /// The codes, two's complement, little-endian: instant after instant, in each the channels in order; zeros behind them.
    pub bytes: [[u8; SAMPLES_BYTES / 2]; 2],
}

impl Samples {
    /// Channels in it.
    pub fn count(channels: u8) -> usize {
        (channels & 0b1111).count_ones() as usize
    }

    /// The codes in order; fewer than its fields say where they do not fit.
    pub fn codes(&self) -> impl Iterator<Item = i32> + '_ {
        let width = usize::from(self.width).clamp(1, 4);
        let codes = self.bytes.as_flattened().chunks_exact(width).map(move |bytes| {
            let word = bytes.iter().rev().fold(0u32, |word, byte| word << 8 | u32::from(*byte));
            let unused = 32 - 8 * width as u32;
            (word << unused) as i32 >> unused
        });
        codes.take(usize::from(self.instants) * Self::count(self.channels))
    }
}

/// Edges of the bands of a [`Spectrum`], bins: band n holds those from edge n up to before edge n + 1. One-third octaves,
/// and where these are narrower single bins; bin 0, a constant offset, is in none.
pub const EDGES: [u16; BANDS + 1] =
    [1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 31, 39, 49, 62, 78, 98, 123, 155, 195, 245, 308, 388, 488, 512];

/// Bands of a [`Spectrum`].
pub const BANDS: usize = 25;

/// Power spectral density of one channel, averaged over frames and the bins of each band.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spectrum {
    /// The command's, or [`Spectrum::UNASKED`].
    pub token: u8,
    /// Index of the middle of the data used.
    pub index: u64,
    /// Recorder channel.
    pub channel: u8,
    /// Bit c: the answer to the command holds channel c. 0 of what no command has asked for.
    pub of: u8,
    /// Frames averaged; 65535 also where they were more.
    pub frames: u16,
    /// Distance of two bins, Hz.
    pub bin_hz: f32,
    /// Level of the one-sided density in each band ([`EDGES`]), tenths of a decibel re full scale squared in a hertz;
    /// [`Spectrum::NOTHING`] where nothing was measured.
    pub tenth_db: [i16; BANDS],
}

impl Spectrum {
    /// Level of a band that was not measured, or in which there was nothing.
    pub const NOTHING: i16 = i16::MIN;

    /// Token of a spectrum that a recorder sends of itself, every so many seconds as its configuration says.
    pub const UNASKED: u8 = 0;

    /// Whether no command has asked for it.
    pub const fn is_unasked(&self) -> bool {
        self.of == 0
    }
}

/// Bands of an [`Azigram`].
pub const AZIGRAM_BANDS: usize = 24;

/// Directions of the active acoustic intensity at an ocean-bottom station over a minute, in bands of frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Azigram {
    /// Sample index of the minute's centre.
    pub index: u64,
    /// Frames of the minute.
    pub frames: u8,
    /// Distance of two bins, Hz.
    pub bin_hz: f32,
    /// The first bin of the first band.
    pub first_bin: u16,
    /// Bins of all bands together ([`Azigram::edge`]).
    pub bins: u16,
    /// Direction in which the bins of a band agree best, in steps of 1/256 of a turn clockwise from true North.
    pub azimuth: [u8; AZIGRAM_BANDS],
    /// How far they agree, in steps of 1/255: 1 where all bins of all frames point to one side.
    pub coherence: [u8; AZIGRAM_BANDS],
}

impl Azigram {
    /// The bin with which a band begins, counted from the first; `edge(band + 1)` ends it.
    pub const fn edge(bins: usize, band: usize) -> usize {
        bins * band / AZIGRAM_BANDS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_of_every_width_are_read_with_their_sign() {
        for width in 1..=4u8 {
            let most = (1i64 << (8 * width - 1)) as i32;
            let codes = [most.wrapping_sub(1), 0, -1, most.wrapping_neg(), 5, 1];
            let mut samples =
                Samples { token: 1, index: 0, instants: 3, channels: 0b1010, width, bytes: [[0; 30]; 2] };
            let into = samples.bytes.as_flattened_mut().chunks_exact_mut(usize::from(width));
            into.zip(codes).for_each(|(to, code)| to.copy_from_slice(&code.to_le_bytes()[..to.len()]));
            assert!(samples.codes().eq(codes), "{width}");
        }
        let hostile =
            Samples { token: 0, index: 0, instants: 255, channels: 255, width: 0, bytes: [[1; 30]; 2] };
        assert_eq!(hostile.codes().count(), SAMPLES_BYTES);
    }

    #[test]
    fn bands_are_third_octaves_where_bins_are_fine_enough() {
        for pair in EDGES.windows(2) {
            let ratio = f64::from(pair[1]) / f64::from(pair[0]);
            assert!(
                pair[1] == pair[0] + 1 || pair[1] == 512 || (ratio / 10f64.powf(0.1) - 1.0).abs() < 0.07,
                "{pair:?}"
            );
        }
    }
}
