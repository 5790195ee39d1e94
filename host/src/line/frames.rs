//! Spectra of a line's sensors at some frequencies: transforms that follow one another without overlap.

use seabearing_locate::line::{Complex, MAX_SENSORS, unit};
use std::f64::consts::TAU;

/// The transform of one frame at one frequency, a value a sensor.
pub(super) type Snapshot = [Complex; MAX_SENSORS];

/// The frame being filled, and the transforms of the step so far.
pub(super) struct Frames {
    sensors: usize,
    /// Of each frequency the window times the rotation, one value an instant.
    kernels: Vec<Vec<Complex>>,
    /// Instants one after another, `sensors` values each.
    samples: Vec<f64>,
    length: usize,
    /// Index of the next instant.
    next: u64,
    snapshots: Vec<Vec<Snapshot>>,
    /// The transform of the newest frame.
    newest: Vec<Snapshot>,
    used: u64,
    lost: u64,
}

impl Frames {
    /// Transforms of `frame_s` seconds (Hann window) at some frequencies.
    pub(super) fn new(sensors: usize, rate_hz: f64, frame_s: f64, frequencies_hz: &[f64]) -> Self {
        let length = ((frame_s * rate_hz).round() as usize).max(4);
        let window = |k: usize| 0.5 - 0.5 * (TAU * k as f64 / length as f64).cos();
        let kernel = |f: &f64| -> Vec<Complex> {
            (0..length).map(|k| unit(-TAU * f * k as f64 / rate_hz).scale(window(k))).collect()
        };
        let kernels: Vec<_> = frequencies_hz.iter().map(kernel).collect();
        Self {
            sensors,
            snapshots: vec![Vec::new(); kernels.len()],
            newest: vec![[Complex::ZERO; MAX_SENSORS]; kernels.len()],
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

    /// Takes an instant; where a frame is complete with it, the index of the frame's middle.
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
        let n = self.length as f64;
        let mut mean = [0.0f64; MAX_SENSORS];
        for instant in self.samples.chunks_exact(self.sensors) {
            for (mean, x) in mean.iter_mut().zip(instant) {
                *mean += x / n;
            }
        }
        for (out, kernel) in self.newest.iter_mut().zip(&self.kernels) {
            *out = [Complex::ZERO; MAX_SENSORS];
            for (instant, turn) in self.samples.chunks_exact(self.sensors).zip(kernel) {
                for ((sum, x), mean) in out.iter_mut().zip(instant).zip(&mean) {
                    *sum += turn.scale(x - mean);
                }
            }
        }
        self.samples.clear();
        self.used += self.length as u64;
        Some(self.next - self.length as u64 / 2)
    }

    /// The newest frame belongs to the current step.
    pub(super) fn keep(&mut self) {
        for (kept, newest) in self.snapshots.iter_mut().zip(&self.newest) {
            kept.push(*newest);
        }
    }

    /// The transforms of the step, by frequency.
    pub(super) fn kept(&self) -> &[Vec<Snapshot>] {
        &self.snapshots
    }

    pub(super) fn clear(&mut self) {
        self.snapshots.iter_mut().for_each(Vec::clear);
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
