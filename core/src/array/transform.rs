//! Spectra of one frame of all four channels, two channels to one complex transform of 512 points.
//!
//! Enters: converter codes and the window. Leaves: `Z = X_a + i X_b` for two pairs of channels, bins in order, and from them
//! twice the channels' own spectra a few bins at a time: `2 X_a(k) = Z(k) + Z*(−k)`, `2 X_b(k) = (Z(k) − Z*(−k))/i`.
//!
//! 512 = 8³: with `n = 64a + 8b + c` and `k = p + 8q + 64r` three stages of transforms of eight (over a, b, c) with
//! turns `e^{−2πi bp/64}` and `e^{−2πi c(p+8q)/512}` between them. The first stage reads codes and window, so nothing is
//! copied or reordered; each later one works in place. This is the work done for every sample: 25 000 instructions a pair of
//! channels, against 45 000 for two real transforms of radix two.

use super::plan::FRAME;
use crate::block::CHANNELS;
use microfft::Complex32;

/// Bins handled at a time: two bins of four channels fit the registers.
pub(crate) const RUN: usize = 2;

/// Work space: two transforms of a frame, or one of twice its length (8 KiB), and one more value, so that either has its first again
/// after its last ([`Ring`]).
pub(crate) type Work = [Complex32; 2 * FRAME + 1];
/// The bins of a transform in order and the first again, in which those that mirror others stand one before the other.
pub(crate) type Ring = [Complex32; FRAME + 1];

/// Points of one stage's transforms.
const RADIX: usize = 8;
/// One transform, its index cut into three digits; between stages the places of b and c come to hold q and r.
type Cube = [[[Complex32; RADIX]; RADIX]; RADIX];
/// Half a channel's codes, and a quarter of a transform: a stage gets what it reads in such pieces, each with an address of its own. From
/// one address, places beyond a kilobyte take an addition each.
type Half = [i32; FRAME / 2];
type Quarter = [[[Complex32; RADIX]; RADIX]; RADIX / 4];
/// A bin's turns, one for each digit summed over but for the first, which needs none.
type Turns = [Complex32; RADIX - 1];

/// `e^{−2πi bp/64}`, by p and b.
const INNER: [Turns; RADIX] = turns(64);
/// `e^{−2πi cm/512}`, by m = p + 8q and c.
const OUTER: [Turns; RADIX * RADIX] = turns(512);

/// `e^{−2πi mj/n}` for m below `M` and j from one to seven.
const fn turns<const M: usize>(n: usize) -> [Turns; M] {
    let mut table = [[Complex32::new(1.0, 0.0); RADIX - 1]; M];
    let mut m = 0;
    while m < M {
        let mut j = 1;
        while j < RADIX {
            // From −π to π, where the series is short; the half turn changes both signs.
            let angle = core::f64::consts::TAU * ((m * j % n) as f64 / n as f64 - 0.5);
            table[m][j - 1] = Complex32::new(-series(angle, 0) as f32, series(angle, 1) as f32);
            j += 1;
        }
        m += 1;
    }
    table
}

/// `e^{−2πik/n}` for k below `M` (at most n/2).
pub(crate) const fn turns_of<const M: usize>(n: usize) -> [Complex32; M] {
    let mut table = [Complex32::new(1.0, 0.0); M];
    let mut k = 0;
    while k < M {
        let angle = core::f64::consts::TAU * (k as f64 / n as f64);
        table[k] = Complex32::new(series(angle, 0) as f32, -series(angle, 1) as f32);
        k += 1;
    }
    table
}

/// Power series of cosine (`first` 0) or sine (1), at compile time: 30 terms leave 10⁻¹⁵ for angles up to π.
const fn series(angle: f64, first: u32) -> f64 {
    let (mut sum, mut term) = (0.0, 1.0);
    let mut n = 0;
    while n < 30 {
        if n % 2 == first {
            sum += if (n / 2) % 2 == 0 { term } else { -term };
        }
        n += 1;
        term *= angle / n as f64;
    }
    sum
}

/// Samples of each of the window's tapers: one of the eight parts of a frame.
const TAPER: usize = FRAME / RADIX;

/// The Tukey window whose tapers take a quarter of its length (periodic form): its rising and its falling taper, value by value.
static TAPERS: [[f32; 2]; TAPER] = tapers();

const fn tapers() -> [[f32; 2]; TAPER] {
    let mut tapers = [[1.0f32; 2]; TAPER];
    let mut n = 0;
    while n < TAPER {
        let w = 0.5 - 0.5 * series(core::f64::consts::PI * n as f64 / TAPER as f64, 0);
        tapers[n][0] = w as f32;
        if n > 0 {
            tapers[TAPER - n][1] = w as f32;
        }
        n += 1;
    }
    tapers
}

/// The window at sample n of a frame: 1 between its tapers.
#[inline(never)]
pub(crate) fn window(n: usize) -> f32 {
    match (TAPERS.get(n), n.checked_sub(FRAME - TAPER).and_then(|n| TAPERS.get(n))) {
        (Some([rising, _]), _) => *rising,
        (_, Some([_, falling])) => *falling,
        _ => 1.0,
    }
}

/// Transforms of channel pairs (0, 1) and (2, 3) of `codes` under the window, in the two halves of `work`.
pub(crate) fn transform(codes: [&[i32; FRAME]; CHANNELS], work: &mut Work) {
    let cubes = work.as_chunks_mut().0.as_chunks_mut().0.as_chunks_mut().0;
    let [c0, c1, c2, c3] = codes.map(|c| c.as_chunks().0);
    for ([a, b], cube) in [[c0, c1], [c2, c3]].into_iter().zip(cubes) {
        let ([a0, a1], [b0, b1]) = (a, b) else { return };
        first(a0, a1, b0, b1, &TAPERS, cube);
        second(cube);
        third(cube);
    }
}

/// Transforms in place what stands in the order of [`reversed`].
pub(crate) fn transform_reversed(values: &mut [Complex32; FRAME]) {
    for cube in values.as_chunks_mut().0.as_chunks_mut().0.as_chunks_mut().0 {
        rows(cube);
        second(cube);
        third(cube);
    }
}

/// The place of value n before [`transform_reversed`]: its three digits in reverse.
#[inline(always)]
pub(crate) fn reversed(n: usize) -> usize {
    (n % RADIX) * RADIX * RADIX + (n / RADIX % RADIX) * RADIX + n / (RADIX * RADIX) % RADIX
}

/// Over a, whose values stand together.
#[inline(never)]
fn rows(cube: &mut Cube) {
    for row in cube.as_flattened_mut() {
        *row = eight(*row);
    }
}

/// Over a: `Σ_a x(64a + 8b + c) e^{−2πi ap/8}` to place (c, b, p). Apart, like the others, to have all registers. Samples
/// 64 apart are summed, so each sum has one in either taper and six that the window leaves as they are.
#[inline(never)]
fn first(a0: &Half, a1: &Half, b0: &Half, b1: &Half, tapers: &[[f32; 2]; TAPER], cube: &mut Cube) {
    for (c, plane) in cube.iter_mut().enumerate() {
        for (by_b, out) in plane.iter_mut().enumerate() {
            let low = (RADIX * by_b + c) & (TAPER - 1);
            let of = |a: &Half, b: &Half, high: usize| {
                let n = high * TAPER + low;
                Complex32::new(a[n] as f32, b[n] as f32)
            };
            let [x0, x1, x2, x3] = [0, 1, 2, 3].map(|high| of(a0, b0, high));
            let [x4, x5, x6, x7] = [0, 1, 2, 3].map(|high| of(a1, b1, high));
            let [rising, falling] = tapers[low];
            *out = eight([x0 * rising, x1, x2, x3, x4, x5, x6, x7 * falling]);
        }
    }
}

/// Over b: `Σ_b A(c, b, p) e^{−2πi bp/64} e^{−2πi bq/8}` to place (c, q, p).
#[inline(never)]
fn second(cube: &mut Cube) {
    for plane in cube {
        across(plane.each_mut().map(|row| row.as_mut_slice()), &INNER);
    }
}

/// Over c: `Σ_c B(c, p, q) e^{−2πi c(p+8q)/512} e^{−2πi cr/8}` to place (r, q, p), which is bin p + 8q + 64r.
fn third(cube: &mut Cube) {
    if let [a, b, c, d] = cube.as_chunks_mut().0 {
        quarters(a, b, c, d);
    }
}

#[inline(never)]
fn quarters(a: &mut Quarter, b: &mut Quarter, c: &mut Quarter, d: &mut Quarter) {
    let [[x0, x1], [x2, x3], [x4, x5], [x6, x7]] = [a, b, c, d].map(|quarter| quarter.each_mut());
    across([x0, x1, x2, x3, x4, x5, x6, x7].map(|plane| plane.as_flattened_mut()), &OUTER);
}

/// Transforms of one value out of each row, which are turned before. Written out: what a loop does with the registers is slower
/// by half.
#[inline(always)]
fn across(rows: [&mut [Complex32]; RADIX], turns: &[Turns]) {
    let [r0, r1, r2, r3, r4, r5, r6, r7] = rows.map(|row| row.iter_mut());
    let places = r0.zip(r1).zip(r2).zip(r3).zip(r4).zip(r5).zip(r6).zip(r7);
    for ((((((((x0, x1), x2), x3), x4), x5), x6), x7), turns) in places.zip(turns) {
        let [t1, t2, t3, t4, t5, t6, t7] = *turns;
        let (y1, y2, y3, y4) = (turned(*x1, t1), turned(*x2, t2), turned(*x3, t3), turned(*x4, t4));
        let (y5, y6, y7) = (turned(*x5, t5), turned(*x6, t6), turned(*x7, t7));
        [*x0, *x1, *x2, *x3, *x4, *x5, *x6, *x7] = eight([*x0, y1, y2, y3, y4, y5, y6, y7]);
    }
}

#[inline(always)]
fn turned(x: Complex32, turn: Complex32) -> Complex32 {
    Complex32::new(x.re * turn.re - x.im * turn.im, x.re * turn.im + x.im * turn.re)
}

/// Transform of four: `Σ_j x_j e^{−2πi jk/4}`.
#[inline(always)]
fn four(x: [Complex32; 4]) -> [Complex32; 4] {
    let [x0, x1, x2, x3] = x;
    let (s02, d02, s13, d13) = (x0 + x2, x0 - x2, x1 + x3, x1 - x3);
    [
        s02 + s13,
        Complex32::new(d02.re + d13.im, d02.im - d13.re),
        s02 - s13,
        Complex32::new(d02.re - d13.im, d02.im + d13.re),
    ]
}

/// Transform of eight: `Σ_j x_j e^{−2πi jk/8}`.
#[inline(always)]
fn eight(x: [Complex32; RADIX]) -> [Complex32; RADIX] {
    const H: f32 = core::f32::consts::FRAC_1_SQRT_2;
    let [x0, x1, x2, x3, x4, x5, x6, x7] = x;
    let [e0, e1, e2, e3] = four([x0, x2, x4, x6]);
    let [o0, o1, o2, o3] = four([x1, x3, x5, x7]);
    let o1 = Complex32::new(H * (o1.re + o1.im), H * (o1.im - o1.re));
    let o2 = Complex32::new(o2.im, -o2.re);
    let o3 = Complex32::new(H * (o3.im - o3.re), -(H * (o3.re + o3.im)));
    [e0 + o0, e1 + o1, e2 + o2, e3 + o3, e0 - o0, e1 - o1, e2 - o2, e3 - o3]
}

/// All bins of a transform, a few at a time, and those that mirror each, in which the last mirrors the first: the last of them the first ones'.
#[inline(always)]
pub(crate) fn sides(z: &Ring) -> Option<[&[[Complex32; RUN]; FRAME / RUN]; 2]> {
    Some([z.as_chunks().0.first_chunk()?, z.as_rchunks().1.first_chunk()?])
}

/// Twice two channels' bins, from a few bins of their common transform and those that mirror them ([`sides`]).
#[inline(always)]
pub(crate) fn separated(own: &[Complex32; RUN], mirror: &[Complex32; RUN]) -> [[Complex32; RUN]; 2] {
    let mut out = [[Complex32::new(0.0, 0.0); RUN]; 2];
    let [a, b] = &mut out;
    for (((a, b), z), w) in a.iter_mut().zip(b).zip(own).zip(mirror.iter().rev()) {
        *a = Complex32::new(z.re + w.re, z.im - w.im);
        *b = Complex32::new(z.im + w.im, w.re - z.re);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::f64 as m;

    #[test]
    fn the_window_is_a_raised_cosine_at_its_ends() {
        for (n, w) in (0..FRAME).map(window).enumerate() {
            let edge = n.min(FRAME - n).min(64) as f64;
            let exact = 0.5 - 0.5 * m::cos(m::PI * edge / 64.0);
            assert!((f64::from(w) - exact).abs() < 6e-8, "{n}");
        }
    }

    #[test]
    fn values_in_reversed_order_give_their_fourier_sums() {
        let value = |n: usize| ((n * n * 37 + n * 11) % 1009) as f64 / 500.0 - 1.0;
        let mut z = [Complex32::new(0.0, 0.0); FRAME];
        for n in 0..FRAME {
            z[reversed(n)] = Complex32::new(value(n) as f32, value(n + 77) as f32);
        }
        transform_reversed(&mut z);
        for k in [0usize, 1, 63, 64, 255, 511] {
            let (mut re, mut im) = (0.0, 0.0);
            for n in 0..FRAME {
                let (s, c) = m::sin_cos(-m::TAU * (n * k % FRAME) as f64 / FRAME as f64);
                re += value(n) * c - value(n + 77) * s;
                im += value(n) * s + value(n + 77) * c;
            }
            let error = m::hypot(f64::from(z[k].re) - re, f64::from(z[k].im) - im);
            assert!(error < 1e-4, "{k}: {error}");
        }
    }

    #[test]
    fn channels_come_apart_as_their_own_fourier_sums() {
        let mut codes = [[0i32; FRAME]; CHANNELS];
        let mut x = 1u32;
        for code in codes.iter_mut().flatten() {
            x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *code = (x >> 9) as i32 - (1 << 22);
        }
        let mut work = [Complex32::new(0.0, 0.0); 2 * FRAME + 1];
        let [c0, c1, c2, c3] = &codes;
        transform([c0, c1, c2, c3], &mut work);
        let halves = work.as_chunks::<FRAME>().0;
        for bin in [0usize, 1, 7, 8, 63, 100, 255] {
            let exact = |channel: usize| {
                let (mut re, mut im) = (0.0, 0.0);
                for (n, w) in (0..FRAME).map(window).enumerate() {
                    let (s, c) = m::sin_cos(-m::TAU * (n * bin % FRAME) as f64 / FRAME as f64);
                    let x = 2.0 * f64::from(codes[channel][n]) * f64::from(w);
                    re += x * c;
                    im += x * s;
                }
                (re, im)
            };
            for (half, z) in halves.iter().enumerate() {
                let first = bin / RUN * RUN;
                let pair =
                    separated(&[z[first], z[first + 1]], &[z[FRAME - 1 - first], z[(FRAME - first) % FRAME]]);
                for (side, spectrum) in pair.iter().enumerate() {
                    let (got, want) = (spectrum[bin % RUN], exact(2 * half + side));
                    let error = m::hypot(f64::from(got.re) - want.0, f64::from(got.im) - want.1);
                    // Amplitudes are about 10⁸; single precision over nine levels keeps 1 in 10⁶.
                    assert!(error < 120.0, "bin {bin} channel {}: {error}", 2 * half + side);
                }
            }
        }
    }
}
