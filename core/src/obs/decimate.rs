//! Decimation by a whole number, for recordings faster than the transforms run.
//!
//! Enters: samples of the used channels at the recording's rate. Leaves: one in `factor`, low-passed by a
//! Blackman-windowed sinc of `TAPS_PER_PHASE` × factor + 1 taps (cut-off 0.46 of the new rate, 74 dB beyond 0.54).
//! The filter is symmetric: an output stands for the middle of its taps. Cost: taps × 3 multiplications an output.

use super::limits::{MAX_DECIMATION, MAX_INNER_RATE_HZ, USED_CHANNELS};
use crate::math;

/// Taps for each sample at the low rate; sets the width of the transition band.
const TAPS_PER_PHASE: usize = 32;

/// Longest filter.
const TAPS: usize = TAPS_PER_PHASE * MAX_DECIMATION + 1;

/// By how much a recording at `rate_hz` is decimated.
pub fn factor_of(rate_hz: f64) -> usize {
    math::f64::ceil(rate_hz / MAX_INNER_RATE_HZ).max(1.0) as usize
}

/// Rate after decimation of a recording at `rate_hz`, Hz: what its propagation table is made for.
pub fn inner_rate_hz(rate_hz: f64) -> f64 {
    rate_hz / factor_of(rate_hz) as f64
}

/// The filter.
#[derive(Clone, Debug)]
pub struct Decimator {
    factor: usize,
    taps: usize,
    coefficients: [f32; TAPS],
}

/// Its memory.
#[derive(Clone, Debug)]
pub struct DecimatorState {
    history: [[f32; TAPS]; USED_CHANNELS],
    next: usize,
    filled: usize,
    phase: usize,
}

impl DecimatorState {
    /// Empty; all zeros.
    pub const fn new() -> Self {
        Self { history: [[0.0; TAPS]; USED_CHANNELS], next: 0, filled: 0, phase: 0 }
    }

    /// A new run begins: nothing of the one before is used any more.
    pub(super) fn restart(&mut self) {
        (self.next, self.filled, self.phase) = (0, 0, 0);
    }
}

impl Decimator {
    /// No filter yet; all zeros.
    pub const EMPTY: Self = Self { factor: 0, taps: 0, coefficients: [0.0; TAPS] };

    /// A filter that keeps one sample in `factor` (1: all of them, unfiltered).
    pub fn fill(&mut self, factor: usize) {
        let factor = factor.clamp(1, MAX_DECIMATION);
        let taps = TAPS_PER_PHASE * factor + 1;
        let half = (taps - 1) as f64 / 2.0;
        let coefficients = &mut self.coefficients;
        coefficients.fill(0.0);
        let cutoff = 0.5 / factor as f64;
        let mut sum = 0.0;
        for (n, c) in coefficients.iter_mut().take(taps).enumerate() {
            let x = n as f64 - half;
            let turn = math::f64::TAU * n as f64 / (taps - 1) as f64;
            let window = 0.42 - 0.5 * math::f64::cos(turn) + 0.08 * math::f64::cos(2.0 * turn);
            let arg = math::f64::TAU * cutoff * x;
            let sinc = if x == 0.0 { 1.0 } else { math::f64::sin(arg) / arg };
            *c = (window * sinc) as f32;
            sum += window * sinc;
        }
        coefficients.iter_mut().for_each(|c| *c = (f64::from(*c) / sum) as f32);
        self.factor = factor;
        self.taps = taps;
    }

    /// Samples in for one out.
    pub fn factor(&self) -> usize {
        self.factor
    }

    /// How many input samples before the newest one an output stands for.
    pub fn lag(&self) -> usize {
        if self.factor == 1 { 0 } else { (self.taps - 1) / 2 }
    }

    /// Takes one instant; gives one out of `factor`, once the filter is full.
    #[inline]
    pub fn push(&self, state: &mut DecimatorState, x: [f32; USED_CHANNELS]) -> Option<[f32; USED_CHANNELS]> {
        // One by one, so that they stay in registers.
        let [a, b, c] = x;
        if self.factor == 1 { Some([a, b, c]) } else { self.filter(state, a, b, c) }
    }

    fn filter(&self, state: &mut DecimatorState, a: f32, b: f32, c: f32) -> Option<[f32; USED_CHANNELS]> {
        for (h, x) in state.history.iter_mut().zip([a, b, c]) {
            if let Some(slot) = h.get_mut(state.next) {
                *slot = x;
            }
        }
        state.next = if state.next + 1 >= self.taps { 0 } else { state.next + 1 };
        state.filled = (state.filled + 1).min(self.taps);
        if state.filled < self.taps {
            return None;
        }
        let due = state.phase == 0;
        state.phase = if state.phase + 1 >= self.factor { 0 } else { state.phase + 1 };
        due.then(|| {
            let mut out = [0f32; USED_CHANNELS];
            for (out, h) in out.iter_mut().zip(&state.history) {
                let taps = h.get(..self.taps).unwrap_or_default();
                let (newer, older) = taps.split_at_checked(state.next).unwrap_or((taps, &[]));
                // The filter is symmetric, so oldest-first or newest-first is the same.
                let ordered = older.iter().chain(newer);
                *out = ordered.zip(&self.coefficients).map(|(x, c)| x * c).sum();
            }
            out
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gain(factor: usize, cycles_per_low_sample: f64) -> f64 {
        let mut d = Decimator::EMPTY;
        d.fill(factor);
        let mut s = DecimatorState::new();
        let (mut power, mut n) = (0.0, 0);
        for i in 0..factor * 400 {
            let x = math::f64::sin(math::f64::TAU * cycles_per_low_sample / factor as f64 * i as f64) as f32;
            if let Some(y) = d.push(&mut s, [x; 3]) {
                power += f64::from(y[0] * y[0]);
                n += 1;
            }
        }
        10.0 * math::f64::log10(2.0 * power / f64::from(n))
    }

    #[test]
    fn passes_the_band_and_stops_what_would_fold() {
        assert!(gain(4, 0.40).abs() < 0.1);
        assert!(gain(8, 0.05).abs() < 0.1);
        assert!(gain(4, 0.62) < -60.0, "{}", gain(4, 0.62));
        assert!(gain(8, 1.37) < -60.0);
    }
}
