//! How a component's counts depend on frequency beside its sensitivity: poles and zeros of what is analogue before the converter.
//!
//! A geophone of 4.5 Hz turns the phase of what it hears by 90° there; the hydrophone beside it does not. Active intensity is the
//! product of the two, so its sign is wrong below that and its size too small about it. [`Response::departs`] says where that
//! matters, and `recording::equalise` takes it out of recordings.

use serde::Deserialize;
use std::f64::consts::{PI, TAU};

/// Poles and zeros of a component.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Response {
    /// Poles, real and imaginary part, rad/s.
    pub poles: Vec<[f64; 2]>,
    /// Zeros, real and imaginary part, rad/s.
    #[serde(default)]
    pub zeros: Vec<[f64; 2]>,
    /// Frequency at which the sensitivity is told, Hz.
    pub at_hz: f64,
    /// The factor before poles and zeros is negative.
    #[serde(default)]
    pub reversed: bool,
}

/// Where the methods for the ocean bottom listen, Hz: tones from 2 Hz on, noise up to half the recorder's 50 samples a second.
pub const LISTENED_HZ: (f64, f64) = (2.0, 24.0);

/// What is flat enough: half a decibel between two horizontals is 1.7° of azimuth at worst.
const FLAT_DB: f64 = 0.5;
const FLAT_RAD: f64 = 5.0 / 180.0 * PI;

impl Response {
    /// Size against that at `at_hz`, and phase, rad in ±π, at a frequency, Hz. Cost: a square root and an arc tangent a root.
    pub fn at(&self, hz: f64) -> (f64, f64) {
        let size = |hz: f64| {
            let product =
                |roots: &[[f64; 2]]| roots.iter().map(|[re, im]| re.hypot(TAU * hz - im)).product::<f64>();
            product(&self.zeros) / product(&self.poles)
        };
        let phase = |roots: &[[f64; 2]]| roots.iter().map(|[re, im]| (TAU * hz - im).atan2(-re)).sum::<f64>();
        let turned = phase(&self.zeros) - phase(&self.poles) + if self.reversed { PI } else { 0.0 };
        (size(hz) / size(self.at_hz), turned - TAU * (turned / TAU).round())
    }

    /// Whether it can be used: numbers, stable, and something at the sensitivity's frequency.
    pub fn is_sound(&self) -> bool {
        let finite = |roots: &[[f64; 2]]| roots.len() <= 64 && roots.iter().flatten().all(|x| x.is_finite());
        finite(&self.poles)
            && finite(&self.zeros)
            && self.poles.iter().all(|[re, _]| *re < 0.0)
            && self.at_hz > 0.0
            && self.at(self.at_hz).0.is_finite()
    }

    /// Frequency below which it is smaller than a share of what it is where the sensitivity is told, Hz; 0 where it is nowhere so.
    pub fn falls_below(&self, share: f64) -> f64 {
        let small = |hz: f64| self.at(hz).0 < share;
        // A thirtieth of a decade from frequency to frequency.
        let mut looked_at =
            (0..=120).map(|k| 10f64.powf(f64::from(k) / 30.0 - 2.0)).take_while(|hz| *hz < self.at_hz);
        if !small(0.01) {
            return 0.0;
        }
        looked_at.find(|hz| !small(*hz)).unwrap_or(self.at_hz)
    }

    /// By how much it departs where the methods listen, up to a frequency: dB, degrees, and whether that is more than is flat.
    pub fn departs(&self, to_hz: f64) -> (f64, f64, bool) {
        let (from, to) = (LISTENED_HZ.0, LISTENED_HZ.1.min(to_hz));
        let (mut db, mut rad) = (0f64, 0f64);
        for k in 0..=64 {
            let (size, phase) = self.at(from * (to / from).powf(f64::from(k) / 64.0));
            db = db.max((20.0 * size.log10()).abs());
            rad = rad.max(phase.abs());
        }
        (db, rad.to_degrees(), !(db <= FLAT_DB && rad <= FLAT_RAD))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A geophone: natural frequency, Hz, and damping. Size (f/f0)² / |1 − (f/f0)² + 2ih f/f0|.
    pub(crate) fn geophone(f0: f64, h: f64) -> Response {
        let w = TAU * f0;
        let im = w * (1.0 - h * h).sqrt();
        Response {
            poles: vec![[-h * w, im], [-h * w, -im]],
            zeros: vec![[0.0; 2]; 2],
            at_hz: 20.0,
            reversed: false,
        }
    }

    #[test]
    fn a_geophone_turns_by_a_right_angle_at_its_frequency() {
        let g = geophone(4.5, 0.56);
        let (size, phase) = g.at(4.5);
        assert!((phase - PI / 2.0).abs() < 1e-9, "{phase}");
        // 1 / 2h there, against that at 20 Hz.
        let ratio: f64 = 20.0 / 4.5;
        let at_20 = ratio.powi(2) / (1.0 - ratio.powi(2)).hypot(2.0 * 0.56 * ratio);
        assert!((size - 1.0 / 1.12 / at_20).abs() < 1e-9, "{size}");
        assert!(g.is_sound() && g.departs(25.0).2);
        // A seismometer of 120 s is flat where ships are heard.
        let (db, deg, departs) = geophone(1.0 / 120.0, 0.707).departs(25.0);
        assert!(db < 0.01 && deg < 0.5 && !departs, "{db} {deg}");
        // A zero in the right half plane before a negative factor, as velocity sensors have that tell it so: no reversal.
        let w = TAU * 150.0;
        let guralp = Response {
            zeros: vec![[0.0; 2], [0.0; 2], [w, 0.0]],
            reversed: true,
            ..geophone(1.0 / 30.0, 0.707)
        };
        let phase = guralp.at(5.0).1;
        assert!((phase + (5f64 / 150.0).atan()).abs() < 0.02, "{phase}");
        // A tenth of what it is at 20 Hz: (f/4.5)² = 0.1 · 1.06 or so.
        assert!((1.2..1.6).contains(&g.falls_below(0.1)), "{}", g.falls_below(0.1));
        assert_eq!(
            Response { poles: vec![[-1e4, 0.0]], zeros: Vec::new(), ..g.clone() }.falls_below(0.1),
            0.0
        );
        assert!(!Response { poles: vec![[1.0, 0.0]], ..g }.is_sound());
    }
}
