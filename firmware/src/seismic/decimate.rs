//! From the converter's rate to the recorder's: a filter of linear phase whose delay is taken out of the numbers.
//!
//! Every fifth sample of the converter's makes one of the recorder's: 121 taps, symmetrical, a windowed sinc (Kaiser, β 7.4)
//! of cut-off a half of the lower rate. At 50 Hz: flat within 0.003 dB up to 20 Hz, −0.7 dB at 22.5 Hz, −6 dB at 25 Hz, and
//! from 30 Hz on 76 dB down, so that what folds into the band below 20 Hz is 76 dB down. All in integers: target and host give
//! the same codes.
//!
//! Enters: codes of 31 bits with their numbers. Leaves: codes of 24 bits; the sample `n` is that of the converter's sample
//! `FACTOR n + HALF`, no later and no earlier.

use super::chips::FULL_SCALE;
use seabearing_core::block::{CHANNELS, Frame, MISSING};

/// Samples of the converter's for one of the recorder's.
pub const FACTOR: u64 = 5;
/// Samples before and after the middle one that the filter reaches.
pub const HALF: u64 = 60;
/// Bits after the point of the taps.
const POINT: u32 = 24;
/// Bits that a code of the converter's has more than one of the recorder's.
const FINER: u32 = 7;
/// Samples kept: a power of two, no less than the filter's length.
const KEPT: usize = 128;

/// The filter from its middle on, 2²⁴ for one.
#[rustfmt::skip]
const TAPS: [i32; HALF as usize + 1] = [
    3355708, 3136329, 2530313, 1679090, 773273, 0, -506041, -693392, -598304, -323515,
    0, 254964, 370074, 333648, 186647, 0, -154253, -227600, -207841, -117417,
    0, 98270, 145497, 133115, 75239, 0, -62805, -92719, -84503, -47537,
    0, 39208, 57468, 51960, 28976, 0, -23430, -33963, -30343, -16706,
    0, 13130, 18734, 16457, 8898, 0, -6715, -9367, -8028, -4226,
    0, 2998, 4035, 3323, 1672, 0, -1062, -1332, -1008, -457,
    0,
];

/// The filter at a distance from its middle, as what makes the converter's samples of the recorder's: a sample between them is the
/// sum of theirs, each times this.
pub fn between(distance: u64) -> f64 {
    let tap = usize::try_from(distance).ok().and_then(|n| TAPS.get(n));
    tap.map_or(0.0, |tap| FACTOR as f64 * f64::from(*tap) / f64::from(1 << POINT))
}

/// A code of 24 bits; what is above that is at the limit.
fn narrow(code: i64, bits: u32) -> i32 {
    const LIMIT: i64 = (1 << 23) - 1;
    ((code + (1 << (bits - 1))) >> bits).clamp(-LIMIT - 1, LIMIT) as i32
}

/// A frame as it is, in codes of 24 bits.
pub fn as_is(frame: &Frame) -> Frame {
    frame.map(|code| match code {
        MISSING => MISSING,
        code => narrow(i64::from(code), FINER),
    })
}

/// The newest samples, and how many of them follow each other.
#[derive(Clone, Debug)]
pub struct Decimator {
    kept: [Frame; KEPT],
    whole: u64,
    next: u64,
}

impl Default for Decimator {
    fn default() -> Self {
        Self { kept: [[MISSING; CHANNELS]; KEPT], whole: 0, next: 0 }
    }
}

impl Decimator {
    fn at(&self, number: u64) -> &Frame {
        &self.kept[number as usize % KEPT]
    }

    /// Takes the converter's sample of this number; the recorder's that is complete with it. A number that does not follow
    /// begins anew: nothing is made over a gap.
    pub fn push(&mut self, number: u64, frame: &Frame) -> Option<(u64, Frame)> {
        if number != self.next {
            self.whole = 0;
        }
        self.next = number.wrapping_add(1);
        self.kept[number as usize % KEPT] = *frame;
        self.whole = (self.whole + 1).min(KEPT as u64);
        let middle = number.checked_sub(HALF)?;
        let complete = self.whole > 2 * HALF && middle >= HALF && middle.is_multiple_of(FACTOR);
        complete
            .then(|| ((middle - HALF) / FACTOR, core::array::from_fn(|channel| self.sum(middle, channel))))
    }

    /// These samples of a channel, of the newest, turn out to be none.
    pub fn strike(&mut self, channel: usize, numbers: core::ops::Range<u64>) {
        for number in numbers.filter(|n| (1..=self.whole).contains(&self.next.wrapping_sub(*n))) {
            if let Some(code) = self.kept[number as usize % KEPT].get_mut(channel) {
                *code = MISSING;
            }
        }
    }

    /// The filter about a sample: missing where any is, at the limit where one of the nearest is.
    fn sum(&self, middle: u64, channel: usize) -> i32 {
        let code = |number: u64| self.at(number).get(channel).copied().unwrap_or(MISSING);
        let mut sum = 0i64;
        let mut limited = 0i64;
        for (n, tap) in (0..).zip(&TAPS) {
            let (after, before) = (code(middle + n), code(middle - n));
            if after == MISSING || before == MISSING {
                return MISSING;
            }
            // The middle one counts once.
            let pair = if n == 0 { i64::from(after) } else { i64::from(after) + i64::from(before) };
            sum += i64::from(*tap) * pair;
            if n <= FACTOR {
                limited += [before, after].into_iter().map(limit).sum::<i64>();
            }
        }
        match limited {
            0 => narrow(sum, POINT + FINER),
            // Beyond what a code can say.
            limited => narrow(limited.signum() << 32, FINER),
        }
    }
}

/// Whether a code is at the converter's limit: 1, −1 or 0.
fn limit(code: i32) -> i64 {
    i64::from(code >= FULL_SCALE) - i64::from(code < -FULL_SCALE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// All that comes of a signal on every channel.
    fn decimated(signal: impl Fn(u64) -> i32, count: u64) -> Vec<(u64, Frame)> {
        let mut decimator = Decimator::default();
        (0..count).filter_map(|n| decimator.push(n, &[signal(n); CHANNELS])).collect()
    }

    /// Gain of the filter at a frequency, in cycles a sample of the converter's.
    fn gain(frequency: f64) -> f64 {
        let of = |(n, tap): (i32, &i32)| {
            let both = if n == 0 { 1.0 } else { 2.0 };
            both * f64::from(*tap) * (std::f64::consts::TAU * frequency * f64::from(n)).cos()
        };
        (0..).zip(&TAPS).map(of).sum::<f64>() / f64::from(1 << POINT)
    }

    #[test]
    fn the_band_is_flat_to_two_fifths_of_the_rate_and_nothing_folds_into_it() {
        let db = |f: f64| 20.0 * gain(f).abs().log10();
        assert_eq!(gain(0.0), 1.0);
        for n in 0..=400 {
            assert!(db(f64::from(n) / 5000.0).abs() < 0.003, "{n}: {}", db(f64::from(n) / 5000.0));
        }
        for n in 600..=2500 {
            assert!(db(f64::from(n) / 5000.0) < -76.0, "{n}: {}", db(f64::from(n) / 5000.0));
        }
        assert!((db(0.09) + 0.68).abs() < 0.01 && (db(0.1) + 6.02).abs() < 0.01);
    }

    #[test]
    fn a_sample_is_that_of_the_instant_its_number_says() {
        // A tone of 7 Hz at 250 a second, of half the range.
        let tone = |n: u64| {
            (0.5 * f64::from(FULL_SCALE) * (std::f64::consts::TAU * 7.0 * n as f64 / 250.0).sin()) as i32
        };
        let made = decimated(tone, 2000);
        assert_eq!(made.first().map(|(n, _)| *n), Some(0));
        assert_eq!(made.len() as u64, (2000 - 2 * HALF).div_ceil(FACTOR));
        for (n, frame) in made {
            let expected = f64::from(tone(FACTOR * n + HALF)) / 128.0;
            assert!(
                (f64::from(frame[3]) - expected).abs() < 1e-3 * 4_194_304.0,
                "{n}: {} {expected}",
                frame[3]
            );
        }
    }

    #[test]
    fn nothing_is_made_over_a_gap_or_of_what_is_missing_and_a_limit_stays_one() {
        let mut decimator = Decimator::default();
        let mut made = Vec::new();
        for n in (0..300).chain(301..900) {
            let code = match n {
                600 => MISSING,
                750 => FULL_SCALE,
                _ => 1 << 20,
            };
            made.extend(decimator.push(n, &[5 << 7, code, -FULL_SCALE - 1, 0]));
        }
        let numbers: Vec<u64> = made.iter().map(|(n, _)| *n).collect();
        // Of 301 on again from the first whole window.
        assert!(numbers.iter().eq((0..=35).chain(61..=155).collect::<Vec<_>>().iter()), "{numbers:?}");
        for (n, frame) in made {
            let (middle, [a, b, c, d]) = (FACTOR * n + HALF, frame);
            assert_eq!((a, c, d), (5, -8_388_608, 0), "{n}");
            let expected = match middle {
                540..=660 => MISSING,
                745..=755 => 8_388_607,
                690..=810 => b,
                _ => 1 << 13,
            };
            assert_eq!(b, expected, "{n}");
        }
    }

    #[test]
    fn what_turns_out_to_be_none_is_missing_in_all_that_is_still_to_come() {
        let mut decimator = Decimator::default();
        (0..200).for_each(|n| _ = decimator.push(n, &[7 << 7; CHANNELS]));
        decimator.strike(2, 192..200);
        let next = decimator.push(200, &[7 << 7; CHANNELS]).unwrap();
        assert_eq!(next, (16, [7, 7, MISSING, 7]));
        assert_eq!(
            as_is(&[7 << 7, MISSING, FULL_SCALE, -FULL_SCALE - 1]),
            [7, MISSING, 8_388_607, -8_388_608]
        );
    }
}
