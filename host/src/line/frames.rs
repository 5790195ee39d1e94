//! Spectra of a line's sensors at some frequencies: transforms that follow one another without overlap, each with the one by
//! which the frequency that was heard is measured (`seabearing_locate::line::frequency`).

use seabearing_locate::line::{Complex, MAX_SENSORS, unit};
use std::f64::consts::TAU;

/// The transform of one frame at one frequency, a value a sensor.
pub(super) type Snapshot = [Complex; MAX_SENSORS];

/// Transforms of one frequency.
#[derive(Clone, Debug, Default)]
pub(super) struct Band {
    /// With the window.
    pub(super) values: Vec<Snapshot>,
    /// With `i h'/(2π)` for the window h, 1/s.
    pub(super) slopes: Vec<Snapshot>,
}

/// The transforms of a step.
#[derive(Clone, Debug)]
pub(super) struct Held {
    /// Sensors, one a bit, whose samples never changed in any of its frames.
    pub(super) flat: u32,
    /// Sum of the middles of its frames, seconds since the first sample.
    sum_s: f64,
    /// By frequency.
    pub(super) bands: Vec<Band>,
}

impl Held {
    /// Nothing yet, of so many frequencies.
    fn new(bands: usize) -> Self {
        Self { flat: u32::MAX, sum_s: 0.0, bands: vec![Band::default(); bands] }
    }

    /// Frames.
    pub(super) fn len(&self) -> usize {
        self.bands.first().map_or(0, |b| b.values.len())
    }

    /// Mean time of its frames, seconds since the first sample.
    pub(super) fn mean_s(&self) -> f64 {
        self.sum_s / self.len().max(1) as f64
    }
}

/// Root mean square of the frequency over the response of a Hann window of `frame_s` seconds, Hz: `(∫h'²/∫h²)^½/(2π)`.
pub(super) fn width_hz(frame_s: f64) -> f64 {
    1.0 / (3f64.sqrt() * frame_s)
}

/// Half the width of its main lobe, Hz.
pub(super) fn half_lobe_hz(frame_s: f64) -> f64 {
    2.0 / frame_s
}

/// The frame being filled, and the transforms of the step so far.
pub(super) struct Frames {
    sensors: usize,
    rate_hz: f64,
    /// Of each frequency the window times the rotation, one value an instant, and its slope likewise.
    kernels: Vec<Vec<[Complex; 2]>>,
    /// Instants one after another, `sensors` values each.
    samples: Vec<f64>,
    length: usize,
    /// Index of the next instant.
    next: u64,
    held: Held,
    /// Sensors whose samples do not change in the newest frame.
    flat: u32,
    /// The transforms of the newest frame, and its middle.
    newest: Vec<[Snapshot; 2]>,
    middle: u64,
    used: u64,
    lost: u64,
}

impl Frames {
    /// Transforms of `frame_s` seconds (Hann window) at some frequencies.
    pub(super) fn new(sensors: usize, rate_hz: f64, frame_s: f64, frequencies_hz: &[f64]) -> Self {
        let length = ((frame_s * rate_hz).round() as usize).max(4);
        let window = |k: usize| 0.5 - 0.5 * (TAU * k as f64 / length as f64).cos();
        // h'/(2π), 1/s.
        let slope = |k: usize| 0.5 * (TAU * k as f64 / length as f64).sin() * rate_hz / length as f64;
        let kernel = |f: &f64| -> Vec<[Complex; 2]> {
            let turn = |k: usize| unit(-TAU * f * k as f64 / rate_hz);
            (0..length).map(|k| [turn(k).scale(window(k)), turn(k) * Complex::new(0.0, slope(k))]).collect()
        };
        let kernels: Vec<_> = frequencies_hz.iter().map(kernel).collect();
        Self {
            sensors,
            rate_hz,
            held: Held::new(kernels.len()),
            flat: 0,
            newest: vec![[[Complex::ZERO; MAX_SENSORS]; 2]; kernels.len()],
            middle: 0,
            kernels,
            samples: Vec::with_capacity(length * sensors),
            length,
            next: 0,
            used: 0,
            lost: 0,
        }
    }

    pub(super) fn sensors(&self) -> usize {
        self.sensors
    }

    /// The next instant has this index: where that is not the one expected, the frame begins anew.
    pub(super) fn go_to(&mut self, index: u64) {
        if index != self.next {
            self.drop_frame();
            self.next = index;
        }
    }

    fn drop_frame(&mut self) {
        self.lost += (self.samples.len() / self.sensors) as u64;
        self.samples.clear();
    }

    /// Takes an instant; where a frame is complete with it, the index of the frame's middle. One in which no sensor recorded anything is lost.
    pub(super) fn take(&mut self, instant: &[f64]) -> Option<u64> {
        self.next += 1;
        if instant.iter().any(|x| x.is_nan()) {
            self.drop_frame();
            self.lost += 1;
            return None;
        }
        self.samples.extend_from_slice(instant);
        if self.samples.len() < self.length * self.sensors {
            return None;
        }
        self.flat = self.unchanged();
        if self.flat.count_ones() as usize >= self.sensors {
            self.drop_frame();
            return None;
        }
        let n = self.length as f64;
        let mut mean = [0.0f64; MAX_SENSORS];
        for instant in self.samples.chunks_exact(self.sensors) {
            for (mean, x) in mean.iter_mut().zip(instant) {
                *mean += x / n;
            }
        }
        for (out, kernel) in self.newest.iter_mut().zip(&self.kernels) {
            *out = [[Complex::ZERO; MAX_SENSORS]; 2];
            let [values, slopes] = out;
            for (instant, [value, slope]) in self.samples.chunks_exact(self.sensors).zip(kernel) {
                for (((v, s), x), mean) in values.iter_mut().zip(slopes.iter_mut()).zip(instant).zip(&mean) {
                    *v += value.scale(x - mean);
                    *s += slope.scale(x - mean);
                }
            }
        }
        self.samples.clear();
        self.used += self.length as u64;
        self.middle = self.next - self.length as u64 / 2;
        Some(self.middle)
    }

    /// Sensors whose samples are the same throughout the frame, one a bit.
    fn unchanged(&self) -> u32 {
        let mut instants = self.samples.chunks_exact(self.sensors);
        let first = instants.next().unwrap_or_default();
        let all = if self.sensors < 32 { (1u32 << self.sensors) - 1 } else { u32::MAX };
        instants.fold(all, |flat, instant| {
            let changed = instant.iter().zip(first).enumerate().filter(|(_, (a, b))| a != b);
            changed.fold(flat, |flat, (k, _)| flat & !(1 << k))
        })
    }

    /// The newest frame belongs to the current step.
    pub(super) fn keep(&mut self) {
        self.held.flat &= self.flat;
        self.held.sum_s += self.middle as f64 / self.rate_hz;
        for (band, [values, slopes]) in self.held.bands.iter_mut().zip(&self.newest) {
            band.values.push(*values);
            band.slopes.push(*slopes);
        }
    }

    /// The transforms of the step that is complete; the next begins.
    pub(super) fn hand_over(&mut self) -> Held {
        std::mem::replace(&mut self.held, Held::new(self.kernels.len()))
    }

    /// Instants used so far.
    pub(super) fn used(&self) -> u64 {
        self.used
    }

    /// Instants left out so far, those of the unfinished frame among them.
    pub(super) fn lost(&self) -> u64 {
        self.lost + (self.samples.len() / self.sensors) as u64
    }
}
