//! The paper's batch clutter filter, as the reference for the core's streaming one [O, appendix A].
//!
//! Enters: cepstra of a whole recording. Leaves: the same without the first singular vectors of every three hours.
//! How many: the knee of the singular values, the index where `1 − y − x` is greatest with both axes scaled to one.

use nalgebra::DMatrix;
use seabearing_core::obs::cepstrum;
use seabearing_core::obs::limits::{FRAME, HOP, QUEFRENCIES};

/// Frames of three hours, both ends included.
pub const CHUNK: usize = 1055;

/// One filtered or unfiltered cepstrum, as the core keeps it.
pub type Cepstrum = [f32; QUEFRENCIES];

/// Cepstra of a gapless pressure record at the transforms' own rate.
pub fn cepstrogram(pressure: &[f32]) -> Vec<Cepstrum> {
    let fft = <f32 as seabearing_signal::Precision>::real_to_complex(FRAME);
    let window: Vec<f32> =
        (0..FRAME).map(|n| 0.5 - 0.5 * (std::f32::consts::TAU * n as f32 / FRAME as f32).cos()).collect();
    let (mut spectrum, mut buffer) = (fft.make_output_vec(), fft.make_input_vec());
    let frames = (pressure.len() / HOP).saturating_sub(1);
    let mut out = vec![[0.0; QUEFRENCIES]; frames];
    for (m, c) in out.iter_mut().enumerate() {
        let samples = &pressure[m * HOP..m * HOP + FRAME];
        buffer.iter_mut().zip(samples).zip(&window).for_each(|((b, x), w)| *b = x * w);
        fft.process(&mut buffer, &mut spectrum).expect("the planner made buffers of matching length");
        let mut log = [0f32; HOP + 1];
        log.iter_mut().zip(&spectrum).for_each(|(l, z)| *l = 0.5 * z.norm_sqr().max(1e-6).ln());
        let mut work = [0f32; FRAME];
        cepstrum::transform(&log, &mut work, c);
    }
    out
}

/// Removes the clutter of each three hours by singular-value decomposition; returns how many vectors went, per chunk.
pub fn filter(cepstra: &mut [Cepstrum], first_quefrency: usize) -> Vec<usize> {
    cepstra.chunks_mut(CHUNK).map(|chunk| filter_chunk(chunk, first_quefrency)).collect()
}

fn filter_chunk(chunk: &mut [Cepstrum], first_quefrency: usize) -> usize {
    let n = QUEFRENCIES - first_quefrency;
    let matrix = DMatrix::from_fn(n, chunk.len(), |q, m| f64::from(chunk[m][q + first_quefrency]));
    let mut svd = matrix.svd(true, true);
    let count = knee(svd.singular_values.as_slice());
    for s in svd.singular_values.iter_mut().take(count) {
        *s = 0.0;
    }
    let Ok(rest) = svd.recompose() else { return 0 };
    for (m, c) in chunk.iter_mut().enumerate() {
        c[..first_quefrency].fill(0.0);
        for (q, c) in c.iter_mut().skip(first_quefrency).enumerate() {
            *c = rest[(q, m)] as f32;
        }
    }
    count
}

/// Index of the knee of a falling curve: the greatest distance below the straight line between its ends.
pub fn knee(values: &[f64]) -> usize {
    let top = values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let last = (values.len().max(2) - 1) as f64;
    let depth = |j: usize| 1.0 - values[j] / top - j as f64 / last;
    (0..values.len()).fold(0, |best, j| if depth(j) > depth(best) { j } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_knee_of_an_elbow() {
        let values = [100.0, 40.0, 5.0, 4.5, 4.0, 3.5, 3.0, 2.5, 2.0, 1.5];
        assert_eq!(knee(&values), 2);
        assert_eq!(knee(&[1.0]), 0);
    }

    #[test]
    fn a_standing_pattern_is_taken_out() {
        let mut cepstra: Vec<Cepstrum> = (0..200)
            .map(|m| {
                let mut c = [0f32; QUEFRENCIES];
                for (q, c) in c.iter_mut().enumerate() {
                    *c = (q as f32 * 0.3).cos() * (1.0 + 0.3 * (m as f32 * 0.1).sin());
                }
                c[100 + m] += 0.5;
                c
            })
            .collect();
        let taken = filter(&mut cepstra, 5);
        assert_eq!(taken, [1]);
        assert!((cepstra[100][200] - 0.5).abs() < 0.05, "{}", cepstra[100][200]);
        assert!(cepstra[100][50].abs() < 0.05);
    }
}
