//! Demodulated spectrum: detrended Hann periodogram of the ring over its local noise floor.
//!
//! The floor of each run of 32 bins is the median of the 160 bins about it, over ln 2 (the periodogram of noise is
//! exponentially distributed), interpolated between runs. Lines occupy few of 160 bins and hardly move a median.

use super::Scratch;
use super::envelope::{Envelope, Plan, WINDOW};
use crate::kit::order_statistic;
use crate::math;
use microfft::Complex32;

/// Most bins from 0 Hz to the Nyquist frequency.
const BINS: usize = WINDOW / 2;
/// Bins that share one median.
const RUN: usize = 32;
/// Runs on each side that the median covers.
const SIDE: usize = 2;
/// Bins below this one (0.25 Hz) hold the passage itself and are no noise.
const FIRST: usize = 8;
/// Limit of a value in mean deviations: three standard deviations of Gaussian ones.
const LIMIT: f32 = 3.75;
/// Rounds in which the limit is found.
const LIMIT_ROUNDS: usize = 3;
/// Effective number of independent noise powers behind a floor value. The median of n exponential values has relative
/// variance 1/(n ln²2) = 2.08/n, and the Hann window's correlation between neighbours makes 160 bins worth about 85.
pub(super) const FLOOR_DEGREES: f64 = 40.0;

/// Pairs (power over floor, power) of the bins from 0 Hz to the Nyquist frequency, half as many as the window has
/// outputs; `None` where less than four fifths was heard.
pub(super) fn demodulated<'a>(
    envelope: &Envelope,
    plan: &Plan,
    scratch: &'a mut Scratch,
) -> Option<&'a [Complex32]> {
    let window = || envelope.window(plan);
    let time = |i| time(i, plan.window);
    // Straight line through what was heard, about the middle of the window and the first value (for precision).
    let first = window().flatten().next().unwrap_or(0.0);
    let (mut n, mut st, mut stt, mut sx, mut stx) = (0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32);
    for (i, value) in window().enumerate() {
        if let Some(x) = value {
            let t = time(i);
            n += 1.0;
            st += t;
            stt += t * t;
            sx += x - first;
            stx += t * (x - first);
        }
    }
    if n < 0.8 * plan.window as f32 {
        return None;
    }
    let slope = (n * stx - st * sx) / (n * stt - st * st);
    let level = (sx - slope * st) / n;
    let residual = |i: usize, x: f32| x - first - level - slope * time(i);
    // Values beyond three standard deviations are clicks; each round's limit lets the next see what they hid.
    let mut limit = f32::MAX;
    for _ in 0..LIMIT_ROUNDS {
        let sum: f32 =
            window().enumerate().filter_map(|(i, x)| Some(math::f32::abs(residual(i, x?)).min(limit))).sum();
        limit = LIMIT * sum / n;
    }
    let bins = scratch.get_mut(..plan.window / 2)?;
    let slots = bins.iter_mut().flat_map(|z| [&mut z.re, &mut z.im]);
    for ((i, slot), value) in slots.enumerate().zip(window()) {
        let t = time(i);
        let hann = 0.5 + 0.5 * math::f32::cos(math::f32::TAU * t);
        *slot = value.map_or(0.0, |x| residual(i, x).max(-limit).min(limit) * hann);
    }
    powers(bins);
    let mut floor = [0.0f32; BINS / RUN];
    let floor = floor.get_mut(..bins.len() / RUN)?;
    for (run, value) in floor.iter_mut().enumerate() {
        let from = (run.saturating_sub(SIDE) * RUN).max(FIRST);
        let to = ((run + SIDE + 1) * RUN).min(bins.len());
        let near = bins.get(from..to).unwrap_or(&[]).iter().map(|bin| bin.im);
        *value = order_statistic(near, 0.5).unwrap_or(0.0) / core::f32::consts::LN_2;
    }
    for (run, chunk) in bins.chunks_exact_mut(RUN).enumerate() {
        let here = floor.get(run).copied().unwrap_or(0.0);
        let before = run.checked_sub(1).and_then(|r| floor.get(r)).copied().unwrap_or(here);
        let after = floor.get(run + 1).copied().unwrap_or(here);
        for (i, bin) in chunk.iter_mut().enumerate() {
            let u = (i as f32 + 0.5) / RUN as f32 - 0.5;
            let other = if u < 0.0 { before } else { after };
            let level = here + (other - here) * math::f32::abs(u);
            bin.re = if level > 0.0 { (bin.im / level).min(1e9) } else { 0.0 };
        }
    }
    Some(bins)
}

/// Powers of the spectrum of the N real values that stand two by two in `z`, into the imaginary parts; none at 0 Hz.
///
/// Even and odd values are one complex transform, `X(±k) = E ± e^{−2πik/N} O` with `2E = Z(k) + Z*(−k)` and
/// `2iO = Z(k) − Z*(−k)`.
fn powers(z: &mut [Complex32]) {
    transform(z);
    let values = 2 * z.len();
    // Powers in bins k and −k.
    let pair = |k: usize, a: Complex32, b: Complex32| {
        let (a, b) = (a, b.conj());
        let even = (a + b) * 0.5;
        let odd = (a - b) * 0.5;
        let (s, c) = math::f32::sin_cos(math::f32::TAU * k as f32 / values as f32);
        // Divided by i and turned by −2πk/N.
        let turned = Complex32::new(odd.im * c - odd.re * s, -odd.re * c - odd.im * s);
        ((even + turned).norm_sqr(), (even - turned).norm_sqr())
    };
    let Some((low, high)) = z.split_at_mut_checked(z.len() / 2) else { return };
    for ((k, a), b) in low.iter_mut().enumerate().skip(1).zip(high.iter_mut().rev()) {
        let (at_k, at_minus_k) = pair(k, *a, *b);
        (*a, *b) = (Complex32::new(0.0, at_k), Complex32::new(0.0, at_minus_k));
    }
    if let Some(middle) = high.first_mut() {
        *middle = Complex32::new(0.0, pair(low.len(), *middle, *middle).1);
    }
    // Neither 0 Hz nor the Nyquist frequency, which shares its place, is a rate.
    if let Some(zero) = low.first_mut() {
        *zero = Complex32::new(0.0, 0.0);
    }
}

/// The complex transform in place, of any length that half a window has.
fn transform(z: &mut [Complex32]) {
    use microfft::complex;
    if let Ok(z) = <&mut [Complex32; BINS]>::try_from(&mut *z) {
        let _ = complex::cfft_1024(z);
    } else if let Ok(z) = <&mut [Complex32; BINS / 2]>::try_from(&mut *z) {
        let _ = complex::cfft_512(z);
    } else if let Ok(z) = <&mut [Complex32; BINS / 4]>::try_from(z) {
        let _ = complex::cfft_256(z);
    }
}

/// Time within a window of so many outputs, −1/2 to 1/2.
fn time(i: usize, window: usize) -> f32 {
    (i as f32 + 0.5) / window as f32 - 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::f64 as m;

    #[test]
    fn powers_are_those_of_the_fourier_sum() {
        let value = |i: usize| ((i * i * 37 + i * 11) % 1009) as f64 / 500.0 - 1.0;
        for bins in [BINS, BINS / 2, BINS / 4] {
            let mut z = [Complex32::new(0.0, 0.0); BINS];
            let z = &mut z[..bins];
            for (i, z) in z.iter_mut().enumerate() {
                *z = Complex32::new(value(2 * i) as f32, value(2 * i + 1) as f32);
            }
            powers(z);
            for k in [1, 2, 100, bins / 2 - 1, bins / 2, bins / 2 + 1, bins - 1] {
                let (mut re, mut im) = (0.0, 0.0);
                for i in 0..2 * bins {
                    let (s, c) = m::sin_cos(m::TAU * (i * k % (2 * bins)) as f64 / (2 * bins) as f64);
                    re += value(i) * c;
                    im += value(i) * s;
                }
                let exact = re * re + im * im;
                assert!(
                    (f64::from(z[k].im) - exact).abs() < 1e-4 * (exact + 1.0),
                    "{k}: {} {exact}",
                    z[k].im
                );
            }
        }
    }
}
