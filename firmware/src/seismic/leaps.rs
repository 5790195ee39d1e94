//! A code that leaps out and back in one conversion: a bit that went wrong on the line, for the chips' words have no checksum.
//!
//! The chips' own filter lets nothing through above 0.41 of the rate, so that sound, a click too, rings: the bend of the signal
//! (twice a sample less its neighbours) about the greatest of a click is a quarter of its own, turned round; about a single wrong
//! code it is half, turned round, on both sides. Integers only: target and host judge alike.

use super::chips::FULL_SCALE;
use seabearing_core::block::MISSING;

/// A leap is so many times the usual bend at least: a smaller one is among the signal's own.
const LEAST: u64 = 24;
/// A bend counts as this much more than usual at most, so that leaps do not hide each other.
const MOST: u64 = 4;
/// Conversions over which the usual bend is averaged.
const OVER: u64 = 64;

/// One channel's newest codes and how much it bends.
#[derive(Clone, Copy, Debug)]
pub struct Leaps {
    codes: [i32; 4],
    /// How many of them follow each other.
    known: usize,
    /// Mean magnitude of the bend, times [`OVER`]; beyond any at first.
    usual: u64,
}

impl Default for Leaps {
    fn default() -> Self {
        Self { codes: [0; 4], known: 0, usual: OVER * 4 * FULL_SCALE as u64 }
    }
}

fn bend(before: i32, at: i32, after: i32) -> i64 {
    2 * i64::from(at) - i64::from(before) - i64::from(after)
}

impl Leaps {
    /// Takes a code; whether the one two before it leapt.
    pub fn take(&mut self, code: i32) -> bool {
        let [a, b, c, d] = self.codes;
        self.codes = [b, c, d, code];
        if code == MISSING {
            self.known = 0;
            return false;
        }
        self.known = (self.known + 1).min(5);
        if self.known < 5 {
            return false;
        }
        let (before, here, after) = (bend(a, b, c), bend(b, c, d), bend(c, d, code));
        let usual = self.usual / OVER;
        let size = here.unsigned_abs();
        self.usual = self.usual - usual + size.min(MOST * usual + 1);
        let half = |side: i64| 8 * (2 * side + here).unsigned_abs() <= size;
        size > LEAST * usual && half(before) && half(after)
    }

    /// A gap: what comes next does not follow.
    pub fn begin(&mut self) {
        self.known = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Noise, and with it what a chip's filter makes of a click at conversion 2000: a sinc of cut-off 0.41.
    fn signal(n: u64, click: f64) -> i32 {
        let noise = ((n.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 / 16_777_216.0 - 0.5) * 4000.0;
        let swell = 3e6 * (n as f64 * 0.07).sin();
        let x = core::f64::consts::PI * 0.82 * (n as f64 - 2000.3);
        (noise + swell + click * x.sin() / x) as i32
    }

    fn leaps(signal: impl Fn(u64) -> i32) -> Vec<u64> {
        let mut leaps = Leaps::default();
        (0..4000).filter(|n| leaps.take(signal(*n))).map(|n| n - 2).collect()
    }

    #[test]
    fn sound_and_clicks_are_no_leaps_and_a_flipped_bit_is_one() {
        for click in [0.0, 1e5, 1e7, 5e8] {
            assert_eq!(leaps(|n| signal(n, click)), []);
        }
        for bit in [20, 24, 29] {
            let flipped = |n: u64| signal(n, 1e7) ^ i32::from(n == 1500 || n == 3000) << bit;
            assert_eq!(leaps(flipped), [1500, 3000], "bit {bit}");
        }
        // Beside a missing one nothing is known.
        assert_eq!(
            leaps(|n| if n == 1501 { MISSING } else { signal(n, 0.0) ^ i32::from(n == 1500) << 24 }),
            []
        );
    }
}
