//! The cepstrum of a frame of pressure [O 14]: the inverse transform of ln|P| along frequency.
//!
//! Enters: ln|P| of bins 0 to 512. Leaves: C at quefrency k/fs. Noise alone gives a Gaussian of standard deviation
//! σ(q) = (0.625 + 0.2 cos(π q / q_max)) / √1024 [O 15]; paths that interfere draw a pulse at the delay between them.
//! ln|P| is real and even, so its inverse transform is the real part of the forward one over 1024. Cost: one transform.

use super::limits::{FRAME, HOP, QUEFRENCIES};
use crate::math;

/// Standard deviation of the cepstrum of noise at quefrency index `k` [O 15]; not valid at k = 0.
pub fn noise_sd(k: usize) -> f32 {
    let x = core::f32::consts::PI * k as f32 / HOP as f32;
    (0.625 + 0.2 * math::f32::cos(x)) / 32.0
}

/// Bins on either side with which a line is compared (1 Hz at 50 Hz).
const AROUND: usize = 20;

/// ln|P| over the mean about it from which on a bin is a line: noise alone has a standard deviation of 0.64 and its long
/// tail below the mean, paths that interfere a ripple of half that.
const LINE: f32 = 1.2;

/// Bins with all their neighbours whose means are made together: each sum waits for itself alone. A desktop processor adds four at once.
const TOGETHER: usize = if cfg!(target_arch = "arm") { 8 } else { 16 };

/// These bins and all their neighbours.
const NEAR: usize = 2 * AROUND + TOGETHER;

/// Cuts lines down to the top of what surrounds them: a near vessel's tones, and their comb above all, ripple through every
/// quefrency and stand still where echoes move.
pub fn without_lines(log_pressure: &mut [f32; HOP + 1], work: &mut [f32; FRAME]) {
    work.iter_mut().zip(log_pressure.iter()).for_each(|(w, l)| *w = *l);
    let old = work.get(..=HOP).unwrap_or_default();
    let inner = log_pressure.get_mut(AROUND..=HOP - AROUND).unwrap_or_default();
    let (blocks, _) = inner.as_chunks_mut::<TOGETHER>();
    let done = AROUND + blocks.len() * TOGETHER;
    for (n, block) in blocks.iter_mut().enumerate() {
        let near = old.get(n * TOGETHER..).and_then(|near| near.first_chunk()).unwrap_or(&[0.0; NEAR]);
        let most = means(near, |_, x| x).map(|mean| mean + LINE);
        // The target has more time than room for code.
        if cfg!(target_arch = "arm") || any_above(near, &most) {
            let most = means(near, |n, x| math::lesser(x, most[n])).map(|mean| mean + LINE);
            block.iter_mut().zip(most).for_each(|(l, most)| *l = l.min(most));
        }
    }
    let (from, to) = log_pressure.split_at_mut(done);
    let ends = [(0, from.get_mut(..AROUND).unwrap_or_default()), (done, to)];
    for (first, bins) in ends {
        for (n, block) in bins.chunks_mut(TOGETHER).enumerate() {
            let first = first + n * TOGETHER;
            let most = means_at_end(old, first, &[f32::INFINITY; TOGETHER]).map(|mean| mean + LINE);
            let near = old.get(first.saturating_sub(AROUND)..).unwrap_or_default();
            if cfg!(target_arch = "arm") || any_above(near.get(..NEAR).unwrap_or(near), &most) {
                let most = means_at_end(old, first, &most).map(|mean| mean + LINE);
                block.iter_mut().zip(most).for_each(|(l, most)| *l = l.min(most));
            }
        }
    }
}

/// Whether any number is above any limit: where none is, nothing is cut, and the second mean is the first. So it is with nine of ten
/// blocks of noise.
fn any_above(near: &[f32], most: &[f32; TOGETHER]) -> bool {
    let least = most.iter().fold(f32::INFINITY, |a, b| math::lesser(a, *b));
    near.iter().fold(false, |any, x| any | (*x > least))
}

/// The same about bins from number `first` on that have fewer on one side. Each has its own first and last; what all have is added
/// together.
fn means_at_end(old: &[f32], first: usize, most: &[f32; TOGETHER]) -> [f32; TOGETHER] {
    let near: [(usize, usize); TOGETHER] = core::array::from_fn(|n| {
        let k = (first + n).min(HOP);
        (k.saturating_sub(AROUND), (k + AROUND + 1).min(old.len()))
    });
    let from = near.iter().fold(0, |most, (from, _)| most.max(*from));
    let to = near.iter().fold(old.len(), |least, (_, to)| least.min(*to));
    let some = |at: core::ops::Range<usize>| old.get(at).unwrap_or_default();
    let mut sums = [0f32; TOGETHER];
    let own = |sum: &mut f32, most: &f32, x: &[f32]| x.iter().for_each(|x| *sum += math::lesser(*x, *most));
    for ((sum, most), (first, _)) in sums.iter_mut().zip(most).zip(&near) {
        own(sum, most, some(*first..from));
    }
    for x in some(from..to) {
        sums.iter_mut().zip(most).for_each(|(sum, most)| *sum += math::lesser(*x, *most));
    }
    for ((sum, most), (_, end)) in sums.iter_mut().zip(most).zip(&near) {
        own(sum, most, some(to..*end));
    }
    sums.iter_mut().zip(&near).for_each(|(sum, (first, end))| *sum /= (end - first) as f32);
    sums
}

/// Means about bins that follow each other, over the bins on either side, each number counted for what is made of it for the bin of that
/// number. `near` begins with the first of the first bin's.
#[inline(always)]
fn means(near: &[f32; NEAR], counted: impl Fn(usize, f32) -> f32) -> [f32; TOGETHER] {
    let mut sums = [0f32; TOGETHER];
    for k in 0..2 * AROUND + 1 {
        let x: [f32; TOGETHER] = core::array::from_fn(|n| near[k + n]);
        sums = core::array::from_fn(|n| sums[n] + counted(n, x[n]));
    }
    sums.map(|sum| sum / (2 * AROUND + 1) as f32)
}

/// Transforms ln|P| (bins 0 to 512), using `buffer`; `out` receives quefrencies 0 to [`QUEFRENCIES`] − 1.
pub fn transform(log_pressure: &[f32; HOP + 1], buffer: &mut [f32; FRAME], out: &mut [f32; QUEFRENCIES]) {
    buffer.iter_mut().zip(log_pressure).for_each(|(b, l)| *b = *l);
    // Bin 1024 − k mirrors bin k; bins 0 and 512 stand alone.
    buffer.iter_mut().rev().zip(log_pressure.iter().skip(1)).take(HOP - 1).for_each(|(b, l)| *b = *l);
    let spectrum = microfft::real::rfft_1024(buffer);
    out.iter_mut().zip(spectrum.iter()).for_each(|(c, z)| *c = z.re * (1.0 / FRAME as f32));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ripple_in_the_spectrum_becomes_a_pulse_at_its_quefrency() {
        let mut log = [0f32; HOP + 1];
        for (k, l) in log.iter_mut().enumerate() {
            *l = 2.0 + 0.3 * math::f32::cos(math::f32::TAU * 100.0 * k as f32 / FRAME as f32);
        }
        let (mut buffer, mut out) = ([0f32; FRAME], [0f32; QUEFRENCIES]);
        transform(&log, &mut buffer, &mut out);
        assert!((out[0] - 2.0).abs() < 1e-5);
        assert!((out[100] - 0.15).abs() < 1e-5);
        assert!(out.iter().enumerate().all(|(k, c)| k == 0 || k == 100 || c.abs() < 1e-5));
    }

    #[test]
    fn each_bin_is_cut_to_what_surrounds_it_however_many_are_done_together() {
        let mut seed = 4u32;
        let mut log: [f32; HOP + 1] = core::array::from_fn(|k| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let line = if k % 37 < 2 { 3.0 } else { 0.0 };
            (seed >> 8) as f32 / 8_388_608.0 - 1.0 + line
        });
        let want: [f32; HOP + 1] = core::array::from_fn(|k| {
            let near = &log[k.saturating_sub(AROUND)..(k + AROUND + 1).min(HOP + 1)];
            let mean = |most: f32| near.iter().map(|x| x.min(most)).sum::<f32>() / near.len() as f32;
            log[k].min(mean(mean(f32::INFINITY) + LINE) + LINE)
        });
        let old = log;
        without_lines(&mut log, &mut [0.0; FRAME]);
        assert_eq!(log, want);
        assert!(log.iter().zip(&old).filter(|(new, old)| new < old).count() > 20);
    }

    #[test]
    fn noise_sd_is_the_paper_s() {
        assert!((noise_sd(1) - 0.825 / 32.0).abs() < 1e-5);
        assert!((noise_sd(256) - 0.625 / 32.0).abs() < 1e-6);
    }
}
