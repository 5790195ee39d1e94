//! The sound a vessel makes, as pressure 1 m from it: noise of a ship-like spectrum, modulated, and tones.

use super::noise::{NoiseStream, SpectrumShape};
use super::scenario::{ArrayVessel, HIGHEST};
use seabearing_signal::interpolate::TAPS;
use std::f64::consts::TAU;

/// Lowest frequency of the noise, Hz.
pub const LOWEST_HZ: f64 = 5.0;
/// Samples made at a time.
const HOP: usize = 8192;

/// A cosine that runs on: amplitude and phase per sample.
struct Oscillator {
    amplitude: f64,
    cycles_per_sample: f64,
    phase: f64,
}

impl Oscillator {
    /// Adds the oscillation to samples `first..`. Each run starts from the exact phase; within it a rotation is
    /// applied sample by sample (error 10⁻¹² over a run).
    fn add(&self, first: u64, out: &mut [f32]) {
        let at = (self.cycles_per_sample * first as f64).fract() * TAU + self.phase;
        let (mut s, mut c) = at.sin_cos();
        let (ds, dc) = (self.cycles_per_sample * TAU).sin_cos();
        for x in out {
            *x += (self.amplitude * c) as f32;
            (s, c) = (s * dc + c * ds, c * dc - s * ds);
        }
    }
}

/// A stretch of one vessel's sound that moves along as time goes on.
pub struct VesselSound {
    noise: NoiseStream<1>,
    tones: Vec<Oscillator>,
    modulation: Vec<Oscillator>,
    rate_hz: f64,
    start_s: f64,
    /// Samples kept, and the index of the first of them.
    kept: Vec<f32>,
    first: u64,
    fresh: [Vec<f32>; 1],
    envelope: Vec<f32>,
}

impl VesselSound {
    /// The sound of a vessel from `start_s` on. `stream` separates vessels of one seed.
    pub fn new(vessel: &ArrayVessel, rate_hz: f64, start_s: f64, seed: u64, stream: u64) -> Self {
        let highest = HIGHEST * rate_hz;
        let density = density(vessel, rate_hz);
        let noise = NoiseStream::new(
            rate_hz,
            HOP,
            |f| if (LOWEST_HZ..=highest).contains(&f) { density(f) } else { 0.0 },
            seed,
            stream,
        );
        // Phases that do not line up, from the golden ratio; they matter to nothing but crest factor.
        let phase = |i: usize| ((i + 1) as f64 * 0.618_033_988_75).fract() * TAU;
        let tones = vessel
            .tones
            .iter()
            .enumerate()
            .map(|(i, t)| Oscillator {
                amplitude: std::f64::consts::SQRT_2 * 10f64.powf(t.level_db / 20.0),
                cycles_per_sample: t.frequency_hz / rate_hz,
                phase: phase(i),
            })
            .collect();
        let mut modulation = Vec::new();
        if let Some(m) = vessel.modulation {
            let mut add = |depth: f64, hz: f64| {
                let phase = phase(modulation.len());
                modulation.push(Oscillator { amplitude: depth, cycles_per_sample: hz / rate_hz, phase });
            };
            add(m.shaft_depth, m.shaft_rate_hz);
            for k in 1..=m.harmonics {
                let k = f64::from(k);
                add(m.blade_depth / k, k * f64::from(m.blades) * m.shaft_rate_hz);
            }
        }
        Self {
            noise,
            tones,
            modulation,
            rate_hz,
            start_s,
            kept: Vec::new(),
            first: 0,
            fresh: [Vec::new()],
            envelope: Vec::new(),
        }
    }

    /// Place of a time in the signal, in samples.
    pub fn place(&self, t_s: f64) -> f64 {
        (t_s - self.start_s) * self.rate_hz
    }

    /// Makes the signal known up to a place, and forgets what lies before another.
    pub fn cover(&mut self, from: f64, to: f64) {
        let from = (from.floor().max(0.0) as u64).saturating_sub(TAPS as u64);
        if from > self.first {
            let gone = ((from - self.first) as usize).min(self.kept.len());
            self.kept.drain(..gone);
            self.first += gone as u64;
        }
        let to = to.ceil().max(0.0) as u64 + TAPS as u64;
        while self.first + (self.kept.len() as u64) < to {
            self.grow();
        }
    }

    fn grow(&mut self) {
        let at = self.first + self.kept.len() as u64;
        let [fresh] = &mut self.fresh;
        fresh.clear();
        self.noise.extend(&mut self.fresh);
        let [fresh] = &mut self.fresh;
        if !self.modulation.is_empty() {
            // Mean square of 1 + Σ a cos is 1 + Σ a²/2.
            let power: f64 =
                1.0 + self.modulation.iter().map(|m| m.amplitude * m.amplitude / 2.0).sum::<f64>();
            self.envelope.clear();
            self.envelope.resize(fresh.len(), 1.0);
            for m in &self.modulation {
                m.add(at, &mut self.envelope);
            }
            for (x, e) in fresh.iter_mut().zip(&self.envelope) {
                *x *= e / power.sqrt() as f32;
            }
        }
        for tone in &self.tones {
            tone.add(at, fresh);
        }
        self.kept.extend_from_slice(fresh);
    }

    /// The `TAPS` samples about a place, for [`seabearing_signal::interpolate::Kernel::at`], and the fraction. Silence where the
    /// place is not covered.
    #[inline]
    pub fn about(&self, place: f64) -> (&[f32; TAPS], f64) {
        const SILENCE: [f32; TAPS] = [0.0; TAPS];
        let whole = place.floor();
        let start = whole as i64 - (TAPS as i64 / 2 - 1) - self.first as i64;
        let samples = usize::try_from(start)
            .ok()
            .and_then(|s| self.kept.get(s..))
            .and_then(|rest| rest.first_chunk::<TAPS>())
            .unwrap_or(&SILENCE);
        (samples, place - whole)
    }
}

/// Spectral density of a vessel's noise 1 m from it, µPa²/Hz, as a function of frequency.
pub fn density(vessel: &ArrayVessel, rate_hz: f64) -> impl Fn(f64) -> f64 + Copy + use<> {
    let shape = SpectrumShape { knee_hz: vessel.knee_hz, slope_db_per_decade: vessel.slope_db_per_decade };
    let scale = 10f64.powf(vessel.source_level_db / 10.0) / shape.power(LOWEST_HZ, HIGHEST * rate_hz);
    move |f| scale * shape.density(f)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::scenario::{Modulation, Tone};

    fn vessel() -> ArrayVessel {
        ArrayVessel {
            name: "v".into(),
            straight: None,
            track: None,
            depth_m: 4.0,
            source_level_db: 170.0,
            slope_db_per_decade: -20.0,
            knee_hz: 100.0,
            tones: Vec::new(),
            modulation: None,
        }
    }

    fn level_db(v: &ArrayVessel) -> f64 {
        let mut s = VesselSound::new(v, 16_000.0, 0.0, 3, 1);
        s.cover(0.0, 800_000.0);
        let power: f64 = s.kept.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>() / s.kept.len() as f64;
        10.0 * power.log10()
    }

    #[test]
    fn the_level_is_the_source_level_with_and_without_modulation() {
        let mut v = vessel();
        assert!((level_db(&v) - 170.0).abs() < 0.1);
        v.modulation = Some(Modulation {
            shaft_rate_hz: 2.0,
            blades: 4,
            shaft_depth: 0.1,
            blade_depth: 0.5,
            harmonics: 3,
        });
        assert!((level_db(&v) - 170.0).abs() < 0.15, "{}", level_db(&v));
        v.modulation = None;
        v.tones = vec![Tone { frequency_hz: 440.0, level_db: 180.0 }];
        assert!((level_db(&v) - 180.41).abs() < 0.05, "{}", level_db(&v));
    }

    #[test]
    fn what_is_covered_does_not_depend_on_the_order_of_asking() {
        let at = |spans: &[(f64, f64)]| {
            let mut s = VesselSound::new(&vessel(), 16_000.0, -2.0, 3, 1);
            for (a, b) in spans {
                s.cover(*a, *b);
            }
            *s.about(30_000.5).0
        };
        assert_eq!(at(&[(0.0, 40_000.0)]), at(&[(0.0, 9000.0), (8000.0, 20_000.0), (29_000.0, 31_000.0)]));
        assert!(at(&[(0.0, 40_000.0)]).iter().all(|x| *x != 0.0));
    }
}
