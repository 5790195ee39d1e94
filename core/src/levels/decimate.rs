//! From one stage's samples to the next one's: decimation by eight, in three half-band filters.
//!
//! Up to [`PASS`] of the new rate the gain is 1 within 0.003 dB; what would fold into that is 75 dB down. The even taps of
//! each filter are zero; the earlier ones may be short because what they let fold lies above the pass band: the first is
//! maximally flat (Lagrange's interpolation), the others are Kaiser-windowed sincs (β = 7.86). Cost: 9 additions and 6
//! multiplications a sample.

use super::lanes::Lanes;
use crate::math;

/// By how much a stage's rate is below that of the one before.
pub(super) const FACTOR: usize = 8;

/// End of the pass band, in units of the new rate.
pub(super) const PASS: f64 = 0.375;

/// Most samples taken at once.
pub(super) const CHUNK: usize = 512;

/// Nonzero taps on either side of each filter's middle, the outermost first.
#[derive(Clone, Debug)]
pub(super) struct Filters {
    first: [f32; 3],
    second: [f32; 5],
    third: [f32; 11],
}

impl Filters {
    pub(super) fn new() -> Self {
        Self { first: FLAT, second: half_band(), third: half_band() }
    }
}

/// Weights of Lagrange's interpolation half way between the middle two of six points, halved.
const FLAT: [f32; 3] = [3.0 / 512.0, -25.0 / 512.0, 150.0 / 512.0];

/// h(n) = ½ sinc(n/2) · Kaiser's window, n odd; the sum with the middle tap ½ is 1.
fn half_band<const P: usize>() -> [f32; P] {
    const BETA: f64 = 7.86;
    let mut taps = [0.0f64; P];
    for (i, tap) in taps.iter_mut().rev().enumerate() {
        let n = (2 * i + 1) as f64;
        let share = n / (2 * P) as f64;
        let window = bessel(BETA * math::f64::sqrt(1.0 - share * share)) / bessel(BETA);
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        *tap = sign / (math::f64::PI * n) * window;
    }
    let sum: f64 = taps.iter().sum();
    taps.map(|tap| (tap * 0.25 / sum) as f32)
}

/// Modified Bessel function of order zero, by its series.
fn bessel(x: f64) -> f64 {
    let (mut sum, mut term) = (1.0, 1.0);
    for k in 1..30 {
        term *= (0.5 * x / f64::from(k)) * (0.5 * x / f64::from(k));
        sum += term;
    }
    sum
}

/// Samples that a filter still needs.
#[derive(Clone, Debug)]
struct Half<const HELD: usize> {
    buffer: [Lanes; HELD],
    held: usize,
}

impl<const HELD: usize> Half<HELD> {
    const NEW: Self = Self { buffer: [Lanes::ZERO; HELD], held: 0 };

    /// Takes samples, of which `HELD` less the filter's length are room for; gives one for two of them.
    #[inline(never)]
    fn halve<const P: usize>(&mut self, taps: &[f32; P], samples: &[Lanes], out: &mut [Lanes]) -> usize {
        if let Some(room) = self.buffer.get_mut(self.held..self.held + samples.len()) {
            room.copy_from_slice(samples);
            self.held += samples.len();
        }
        let there = self.buffer.get(..self.held).unwrap_or(&[]);
        let mut made = 0;
        // Of two samples the first meets the taps, the second the middle.
        for (window, out) in there.as_chunks::<2>().0.windows((2 * P).max(1)).zip(out) {
            let ends = window.iter().zip(window.iter().rev());
            let mut sum = window.get(P - 1).map_or(Lanes::ZERO, |[_, middle]| *middle * 0.5);
            for (([early, _], [late, _]), tap) in ends.zip(taps) {
                sum += (*early + *late) * *tap;
            }
            *out = sum;
            made += 1;
        }
        let used = (2 * made).min(self.held);
        self.buffer.copy_within(used..self.held, 0);
        self.held -= used;
        made
    }
}

/// The three filters' memory.
#[derive(Clone, Debug)]
pub(super) struct Decimator {
    first: Half<{ CHUNK + 24 }>,
    second: Half<{ CHUNK / 2 + 24 }>,
    third: Half<{ CHUNK / 4 + 48 }>,
}

/// Samples between the filters.
pub(super) type Between = [Lanes; CHUNK / 2];

impl Decimator {
    pub(super) const NEW: Self = Self { first: Half::NEW, second: Half::NEW, third: Half::NEW };

    /// Begins anew.
    pub(super) fn restart(&mut self) {
        (self.first.held, self.second.held, self.third.held) = (0, 0, 0);
    }

    /// Takes up to [`CHUNK`] samples; what they give stands at the beginning of the same place. Returns how many.
    pub(super) fn take(
        &mut self,
        filters: &Filters,
        samples: &mut [Lanes; CHUNK],
        n: usize,
        between: &mut Between,
    ) -> usize {
        let made = self.first.halve(&filters.first, samples.get(..n).unwrap_or(&[]), between);
        let made = self.second.halve(&filters.second, between.get(..made).unwrap_or(&[]), samples);
        let made = self.third.halve(&filters.third, samples.get(..made).unwrap_or(&[]), between);
        for (to, x) in samples.iter_mut().zip(between.iter().take(made)) {
            *to = *x;
        }
        made
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pass_band_is_flat_and_what_folds_into_it_is_75_db_down() {
        let filters = Filters::new();
        let gain = |taps: &[f32], f: f64| {
            let sides = taps.iter().rev().enumerate();
            let sum: f64 = sides
                .map(|(i, t)| f64::from(*t) * (std::f64::consts::TAU * f * (2 * i + 1) as f64).cos())
                .sum();
            0.5 + 2.0 * sum
        };
        let db = |f: f64| {
            let all =
                gain(&filters.first, f) * gain(&filters.second, 2.0 * f) * gain(&filters.third, 4.0 * f);
            20.0 * all.abs().max(1e-9).log10()
        };
        for k in 0..=1000 {
            let f = PASS * f64::from(k) / 1000.0;
            assert!(db(f / 8.0).abs() < 0.003, "{f}: {} dB", db(f / 8.0));
            for image in 1..=4 {
                for folded in [f64::from(image) - f, f64::from(image) + f] {
                    assert!(folded > 4.0 || db(folded / 8.0) < -75.0, "{folded}: {} dB", db(folded / 8.0));
                }
            }
        }
    }
}
