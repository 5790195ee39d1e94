//! Spectral density of a channel against time, in decibels per hertz re its reference.
//!
//! Enters: blocks. Each column is the mean of Hann windows that overlap by half, as many as fall into it; a window with a
//! missing sample is left out. Rows are even at low rates (the ocean bottom), else a twentieth of an octave or wider.

use super::times::Times;
use super::{ColourMap, HeatMap, Plot, Scale};
use crate::station::Calibration;
use seabearing_core::block::{Block, MISSING};
use seabearing_core::kit::quantile;
use seabearing_signal::{Precision, RealToComplex};
use std::sync::Arc;

/// Columns, where there is time for so many.
const COLUMNS: f64 = 240.0;

/// Rows of a logarithmic axis.
const ROWS: usize = 160;

/// Below this rate frequencies run evenly, samples a second.
const SLOW_HZ: f64 = 1000.0;

/// A spectrogram being made.
pub(super) struct Spectrogram {
    rate_hz: f64,
    calibration: Calibration,
    /// Index of the first sample, samples of a column.
    first: u64,
    column: f64,
    /// Sums of powers by column, bin by bin, and windows in them.
    sums: Vec<(Vec<f64>, u32)>,
    /// Index of the first sample held.
    begins: u64,
    held: Vec<i32>,
    window: Vec<f32>,
    transform: Arc<dyn RealToComplex<f32>>,
}

impl Spectrogram {
    pub(super) fn new(rate_hz: f64, (from_s, to_s): (f64, f64), calibration: &Calibration) -> Self {
        // Windows of 32 ms at 64 kHz, of 10 s at 50 Hz.
        let n = if rate_hz < SLOW_HZ { 512 } else { ((rate_hz * 0.032) as usize).next_power_of_two() };
        let column = ((to_s - from_s) * rate_hz / COLUMNS).max(n as f64 / 2.0);
        let columns = ((to_s - from_s) * rate_hz / column).ceil().max(1.0) as usize;
        let hann = |k: usize| 0.5 - 0.5 * (std::f32::consts::TAU * k as f32 / n as f32).cos();
        Self {
            rate_hz,
            calibration: calibration.clone(),
            first: (from_s * rate_hz) as u64,
            column,
            sums: vec![(vec![0.0; n / 2 + 1], 0); columns],
            begins: 0,
            held: Vec::new(),
            window: (0..n).map(hann).collect(),
            transform: f32::real_to_complex(n),
        }
    }

    /// Takes a block of the recording.
    pub(super) fn take(&mut self, block: &Block<'_>) {
        let end = self.first + (self.column * self.sums.len() as f64) as u64;
        let (from, to) = (block.first_index, block.first_index + block.frames.len() as u64);
        if to <= self.first || from >= end {
            return;
        }
        if from != self.begins + self.held.len() as u64 {
            self.held.clear();
            self.begins = from;
        }
        self.held.extend(block.frames.iter().map(|frame| frame[0]));
        let n = self.window.len();
        let mut used = 0;
        while let Some(samples) = self.held.get(used..used + n) {
            let middle = self.begins + (used + n / 2) as u64;
            let column = middle.checked_sub(self.first).map(|since| (since as f64 / self.column) as usize);
            if let Some((sum, count)) = column.and_then(|c| self.sums.get_mut(c))
                && !samples.contains(&MISSING)
            {
                let mean = samples.iter().map(|x| f64::from(*x)).sum::<f64>() / n as f64;
                let mut input: Vec<f32> = (samples.iter().zip(&self.window))
                    .map(|(x, w)| (f64::from(*x) - mean) as f32 * w)
                    .collect();
                let mut spectrum = self.transform.make_output_vec();
                if self.transform.process(&mut input, &mut spectrum).is_ok() {
                    sum.iter_mut().zip(&spectrum).for_each(|(s, z)| *s += f64::from(z.norm_sqr()));
                    *count += 1;
                }
            }
            used += n / 2;
        }
        self.held.drain(..used);
        self.begins += used as u64;
    }

    /// Draws it; codes are of this full scale.
    pub(super) fn plot(&self, times: &Times, full_scale: f64) -> Plot {
        let n = self.window.len();
        let (bins, bin_hz) = (n / 2, self.rate_hz / n as f64);
        let slow = self.rate_hz < SLOW_HZ;
        // Edges of the rows, bins.
        let edges: Vec<f64> = if slow {
            (0..=bins).map(|k| k as f64).collect()
        } else {
            let ratio: f64 = bins as f64 / 2.0;
            (0..=ROWS).map(|r| 2.0 * ratio.powf(r as f64 / ROWS as f64)).collect()
        };
        // One-sided density of full scale squared: |X|² 2/(rate Σw²).
        let squares: f64 = self.window.iter().map(|w| f64::from(*w).powi(2)).sum();
        let scale = 2.0 / (self.rate_hz * squares * full_scale * full_scale);
        let mut values = Vec::new();
        for pair in edges.windows(2) {
            let (from, to) = (pair[0].floor() as usize, (pair[1].ceil() as usize).max(pair[0] as usize + 1));
            let more = self.calibration.db(0.5 * (pair[0] + pair[1]) * bin_hz).unwrap_or(f64::NAN);
            values.extend(self.sums.iter().map(|(sum, count)| {
                let part = sum.get(from..to.min(sum.len())).unwrap_or(&[]);
                let mean = part.iter().sum::<f64>() / part.len().max(1) as f64 / f64::from(*count);
                10.0 * (scale * mean).log10() + more
            }));
        }
        let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        let mut at = |share: f64| quantile(&mut sorted, share).unwrap_or(0.0);
        let (low, high) = (at(0.02).floor(), at(0.995).ceil());
        let begins_s = self.first as f64 / self.rate_hz;
        let ends_s = begins_s + self.column * self.sums.len() as f64 / self.rate_hz;
        let unit = match self.calibration.reference {
            "1 µPa" => "dB re 1 µPa²/Hz".to_owned(),
            other => format!("dB re {other}²/Hz"),
        };
        let title = format!("Spectrogram of {}", self.calibration.quantity.replace('_', " "));
        let mut figure = Plot::new(&title, "", "frequency (Hz)");
        figure.size(super::passage::LEFT, 440);
        if !slow {
            figure.y_scale(Scale::Log);
        }
        let (lowest, highest) = (edges.first().copied().unwrap_or(0.0), edges.last().copied().unwrap_or(1.0));
        figure.heat(HeatMap {
            x: (times.at(begins_s), times.at(ends_s)),
            y: (lowest * bin_hz, highest * bin_hz),
            columns: self.sums.len(),
            values,
            strength: Vec::new(),
            range: Some((low, high.max(low + 1.0))),
            map: ColourMap::Amount,
            label: format!("spectral density ({unit})"),
        });
        times.along(&mut figure);
        figure
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_noise_of_known_level_has_its_density() {
        let rate_hz = 64_000.0;
        let mut made = Spectrogram::new(rate_hz, (0.5, 2.5), &Calibration::default());
        let mut seed = 1u32;
        let mut code = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((seed >> 8) as i32 >> 4) - (1 << 19)
        };
        let frames: Vec<[i32; 4]> = (0..200_000).map(|_| [code(); 4]).collect();
        for (k, part) in frames.chunks(10_000).enumerate() {
            made.take(&Block { first_index: 10_000 * k as u64, frames: part });
        }
        let square = frames.iter().map(|f| f64::from(f[0]).powi(2)).sum::<f64>() / frames.len() as f64;
        let full_scale = 8_388_608.0f64;
        let want = 10.0 * (square / full_scale.powi(2) / (rate_hz / 2.0)).log10();
        let plot = made.plot(&Times::new(None, 3.0), full_scale);
        let heat = plot.heat.as_ref().unwrap();
        let finite: Vec<f64> = heat.values.iter().copied().filter(|v| v.is_finite()).collect();
        let power = finite.iter().map(|v| 10f64.powf(v / 10.0)).sum::<f64>() / finite.len() as f64;
        assert!((10.0 * power.log10() - want).abs() < 0.3, "{} {want}", 10.0 * power.log10());
        assert!(finite.len() > heat.values.len() / 2);
    }
}
