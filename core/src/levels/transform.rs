//! Power spectra of two windows of all channels at once, four channels side by side.
//!
//! Enters: samples of two windows, which may overlap. Leaves: the sum of the two windows' powers. The first window is the real part
//! of a complex signal z, the second its imaginary part; of their transforms X₁ and X₂
//! |X₁(k)|² + |X₂(k)|² = (|Z(k)|² + |Z(−k)|²)/2, so that nothing has to be taken apart. 1024 = 4⁵: five passes of radix four,
//! decimated in frequency, which leave bin k at the place of its base-four digits in reverse.
//!
//! The window is that of Hann, Σw² = 3/8 N; each window's mean is taken off it, so that the converter's offset does not
//! leak beyond bin 1. Bins are scaled so that their sum is the mean square (Parseval), of noise and of tones, whatever the
//! window's noise bandwidth of [`NOISE_BINS`] bins.

use super::lanes::Lanes;
use crate::math::constant::cos_of_turn;

/// Points of a transform.
pub const LENGTH: usize = 1024;

/// From one window to the next where they overlap by half.
pub(super) const HOP: usize = LENGTH / 2;

/// Samples of two windows side by side, the most that a pair takes.
pub(super) const ROOM: usize = 2 * LENGTH;

/// Bins of a spectrum, those of 0 and of half the rate included.
pub(super) const BINS: usize = LENGTH / 2 + 1;

/// Noise bandwidth of the window, bins: N Σw²/(Σw)².
pub const NOISE_BINS: f64 = 1.5;

/// A number of the transform, of each channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Complex {
    re: Lanes,
    im: Lanes,
}

impl Complex {
    pub(super) const ZERO: Self = Self { re: Lanes::ZERO, im: Lanes::ZERO };

    #[inline(always)]
    fn plus(self, o: Self) -> Self {
        Self { re: self.re + o.re, im: self.im + o.im }
    }

    #[inline(always)]
    fn minus(self, o: Self) -> Self {
        Self { re: self.re - o.re, im: self.im - o.im }
    }

    #[inline(always)]
    fn turned(self, [cos, sin]: [f32; 2]) -> Self {
        Self { re: self.re * cos - self.im * sin, im: self.re * sin + self.im * cos }
    }
}

/// The transform's memory, and the powers of all `LENGTH` places.
pub(super) type Work = [Complex; LENGTH];
pub(super) type Powers = [Lanes; LENGTH];

/// e^(−2πi n/N) for three quarters of a turn.
static TURNS: [[f32; 2]; 3 * LENGTH / 4] = {
    let mut table = [[0.0; 2]; 3 * LENGTH / 4];
    let mut n = 0;
    while n < table.len() {
        // −sin x is the cosine a quarter turn on.
        table[n] = [cos_of_turn(n, LENGTH) as f32, cos_of_turn(n + LENGTH / 4, LENGTH) as f32];
        n += 1;
    }
    table
};

/// Hann's window, periodic: ½ − ½ cos(2πn/N).
static WINDOW: [f32; LENGTH] = {
    let mut table = [0.0; LENGTH];
    let mut n = 0;
    while n < LENGTH {
        table[n] = (0.5 - 0.5 * cos_of_turn(n, LENGTH)) as f32;
        n += 1;
    }
    table
};

/// Adds the powers of two windows, the second `apart` samples after the first, to `powers`, of the channels whose `taken` is 1
/// (else 0).
pub(super) fn add(samples: &[Lanes; ROOM], apart: usize, taken: Lanes, work: &mut Work, powers: &mut Powers) {
    let second = samples.get(apart..).and_then(|rest| rest.first_chunk());
    let (Some(first), Some(second)) = (samples.first_chunk(), second) else { return };
    windowed(first, second, work);
    pass::<256, 1>(work);
    pass::<64, 4>(work);
    pass::<16, 16>(work);
    pass::<4, 64>(work);
    last(work, taken, powers);
}

/// The two windows, each less its mean, as real and imaginary parts.
#[inline(never)]
fn windowed(first: &[Lanes; LENGTH], second: &[Lanes; LENGTH], work: &mut Work) {
    let (mean, later_mean) = (sum(first) * (1.0 / LENGTH as f32), sum(second) * (1.0 / LENGTH as f32));
    for (((z, a), b), w) in work.iter_mut().zip(first).zip(second).zip(&WINDOW) {
        *z = Complex { re: (*a - mean) * *w, im: (*b - later_mean) * *w };
    }
}

/// Four sums side by side, so that additions need not wait for one another.
fn sum(samples: &[Lanes; LENGTH]) -> Lanes {
    let mut sums = [Lanes::ZERO; 4];
    for four in samples.as_chunks::<4>().0 {
        for (sum, x) in sums.iter_mut().zip(four) {
            *sum += *x;
        }
    }
    let [a, b, c, d] = sums;
    (a + b) + (c + d)
}

/// The last pass, whose turns are none, straight into powers.
#[inline(never)]
fn last(work: &Work, taken: Lanes, powers: &mut Powers) {
    for ([a, b, c, d], sums) in work.as_chunks::<4>().0.iter().zip(powers.as_chunks_mut::<4>().0) {
        let all = four(*a, *b, *c, *d);
        for (sum, z) in sums.iter_mut().zip(all) {
            *sum += (z.re * z.re + z.im * z.im) * taken;
        }
    }
}

/// Transform of four values.
#[inline(always)]
fn four(a: Complex, b: Complex, c: Complex, d: Complex) -> [Complex; 4] {
    let (even, odd) = (a.plus(c), a.minus(c));
    let (other, turn) = (b.plus(d), b.minus(d));
    // −i times the difference.
    let (right, left) = (
        Complex { re: odd.re + turn.im, im: odd.im - turn.re },
        Complex { re: odd.re - turn.im, im: odd.im + turn.re },
    );
    [even.plus(other), right, even.minus(other), left]
}

/// One pass over parts of 4`Q` values, whose turns are `STEP` apart in the table.
#[inline(never)]
fn pass<const Q: usize, const STEP: usize>(work: &mut Work) {
    let quarters = work.as_chunks_mut::<Q>().0;
    for part in quarters.as_chunks_mut::<4>().0 {
        let [a, b, c, d] = part;
        let turns = TURNS.iter().step_by(STEP);
        let twice = TURNS.iter().step_by(2 * STEP);
        let thrice = TURNS.iter().step_by(3 * STEP);
        let values = a.iter_mut().zip(b).zip(c).zip(d);
        for ((((((a, b), c), d), w1), w2), w3) in values.zip(turns).zip(twice).zip(thrice) {
            let [none, once, two, three] = four(*a, *b, *c, *d);
            *a = none;
            *b = once.turned(*w1);
            *c = two.turned(*w2);
            *d = three.turned(*w3);
        }
    }
}

/// The place of a bin: its five base-four digits in reverse.
fn place(bin: usize) -> usize {
    let reversed = (bin as u16).reverse_bits() >> (16 - LENGTH.trailing_zeros());
    usize::from((reversed & 0x5555) << 1 | (reversed >> 1 & 0x5555))
}

/// The sum of the bins' one-sided mean squares, a pair of windows adding the mean of the two, from `powers`.
pub(super) fn bins(powers: &Powers, bins: &mut [Lanes; BINS]) {
    const SCALE: f32 = 1.0 / (2.0 * LENGTH as f32 * (0.375 * LENGTH as f32));
    for (k, bin) in bins.iter_mut().enumerate() {
        let at = |k: usize| powers.get(place(k % LENGTH)).copied().unwrap_or(Lanes::ZERO);
        *bin = (at(k) + at(LENGTH - k)) * SCALE;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn powers_are_those_of_the_sum_written_out() {
        let mut seed = 1u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        let samples: Vec<Lanes> = (0..ROOM).map(|_| Lanes([random(), random(), random(), 1.0])).collect();
        let samples: &[Lanes; ROOM] = samples.as_slice().try_into().unwrap();
        let mut work = [Complex::ZERO; LENGTH];
        for apart in [HOP, LENGTH] {
            let mut powers = [Lanes::ZERO; LENGTH];
            add(samples, apart, Lanes([1.0, 1.0, 0.0, 1.0]), &mut work, &mut powers);
            let mut got = [Lanes::ZERO; BINS];
            bins(&powers, &mut got);
            held(samples, apart, &got);
        }
    }

    fn held(samples: &[Lanes; ROOM], apart: usize, got: &[Lanes; BINS]) {
        for k in [1, 2, 77, 300, 511] {
            for c in 0..2 {
                let mut want = 0.0;
                for start in [0, apart] {
                    let window = &samples[start..start + LENGTH];
                    let mean: f64 = window.iter().map(|x| f64::from(x.0[c])).sum::<f64>() / LENGTH as f64;
                    let (mut re, mut im, mut square) = (0.0, 0.0, 0.0);
                    for (n, x) in window.iter().enumerate() {
                        let (s, o) = (std::f64::consts::TAU * (n * k) as f64 / LENGTH as f64).sin_cos();
                        let w = 0.5 - 0.5 * (std::f64::consts::TAU * n as f64 / LENGTH as f64).cos();
                        let x = w * (f64::from(x.0[c]) - mean);
                        (re, im, square) = (re + x * o, im - x * s, square + w * w);
                    }
                    want += (re * re + im * im) / (LENGTH as f64 * square);
                }
                assert!((f64::from(got[k].0[c]) / want - 1.0).abs() < 1e-4, "{k} {c}");
            }
            assert_eq!((got[k].0[2], got[k].0[3]), (0.0, 0.0), "not taken, and a constant");
        }
    }
}
