//! Sounds that are no vessels: whale calls, earthquakes, T phases, strumming of the buoy.

use super::passage::{Field, add_event, emission};
use super::scenario::{Burst, Strumming, Whale};
use super::source::{Radiator, ToneLine};
use crate::course::VesselCourse;
use crate::propagation::{Complex, Propagation};
use std::f64::consts::{PI, TAU};

/// A sound with a place or direction, as the truth names it.
#[derive(Clone, Debug, PartialEq)]
pub struct HeardEvent {
    /// When the first of it arrives, s.
    pub from_s: f64,
    /// When the last has gone, s.
    pub to_s: f64,
    /// What.
    pub kind: &'static str,
    /// Azimuth it comes from, rad.
    pub azimuth: f64,
    /// Range, m (infinite where it is none).
    pub range_m: f64,
}

/// Fin and blue whales.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Species {
    /// One-second downsweeps about 20 Hz.
    Fin,
    /// Antarctic blue whale: the three-part Z call, as much of it as lies below 25 Hz.
    Blue,
}

/// A whale that calls at intervals from one place.
pub struct Caller {
    species: Species,
    place: (f64, f64),
    whale: Whale,
    /// Amplitude at 1 m.
    amplitude: f64,
}

impl Species {
    fn duration_s(self) -> f64 {
        match self {
            Self::Fin => 1.2,
            Self::Blue => 22.0,
        }
    }

    /// The call as an analytic signal of unit peak.
    fn form(self, t: f64) -> Complex<f64> {
        match self {
            Self::Fin => {
                let envelope = (-0.5 * ((t - 0.6) / 0.22).powi(2)).exp();
                Complex::from_polar(envelope, TAU * (23.5 * t - 3.0 * t * t))
            }
            Self::Blue => {
                let edge = (t / 0.8).min((22.0 - t) / 1.5).clamp(0.0, 1.0);
                // 24.3 Hz for 9 s, down to 18.8 Hz within 2 s, then slowly to 18.2 Hz.
                let turns = match t {
                    t if t < 9.0 => 24.3 * t,
                    t if t < 11.0 => 24.3 * t - 1.375 * (t - 9.0).powi(2),
                    t => 24.3 * 11.0 - 5.5 + 18.8 * (t - 11.0) - 0.027 * (t - 11.0).powi(2),
                };
                Complex::from_polar(edge * edge * (3.0 - 2.0 * edge), TAU * turns)
            }
        }
    }
}

impl Caller {
    /// A whale whose strongest arrival peaks at `level_db` over `ambient` (root mean square); `None` where nothing
    /// can arrive.
    pub fn new(
        species: Species,
        whale: &Whale,
        ambient: f64,
        table: &Propagation,
        paths: usize,
    ) -> Option<Self> {
        let strongest = (0..paths)
            .filter_map(|n| table.arrival(n, whale.range_m))
            .map(|a| a.amplitude.norm())
            .fold(0.0, f64::max);
        let (s, c) = whale.azimuth_deg.to_radians().sin_cos();
        (strongest > 0.0).then(|| Self {
            species,
            place: (whale.range_m * s, whale.range_m * c),
            whale: whale.clone(),
            amplitude: ambient * 10f64.powf(whale.level_db / 20.0) / strongest,
        })
    }

    /// Adds what arrives in samples `first..`.
    pub fn add(&self, table: &Propagation, paths: usize, rate_hz: f64, first: u64, out: &mut [Field]) {
        let (from, to) = (first as f64 / rate_hz, (first as f64 + out.len() as f64) / rate_hz);
        let w = &self.whale;
        // The slowest of nine crossings from 100 km takes 70 s.
        let k0 = ((from - 100.0 - w.start_s) / w.interval_s).floor().max(0.0) as u64;
        for k in k0.. {
            let at = w.start_s + k as f64 * w.interval_s;
            if at > to || at > w.start_s + w.duration_s {
                break;
            }
            // Every fifteenth interval is a breath.
            if k % 15 == 14 {
                continue;
            }
            let form = |t: f64| self.species.form(t) * self.amplitude;
            add_event(table, paths, rate_hz, first, out, self.place, at, self.species.duration_s(), form);
        }
    }

    /// For the truth.
    pub fn heard(&self, table: &Propagation) -> HeardEvent {
        let here = VesselCourse::Fixes(vec![(-1e12, self.place), (1e12, self.place)]);
        let delay = |n| emission(table, &here, n, 0.0).map_or(0.0, |(left, _, _)| -left);
        HeardEvent {
            from_s: self.whale.start_s + delay(0).min(delay(1)),
            to_s: self.whale.start_s + self.whale.duration_s + delay(2) + self.species.duration_s(),
            kind: if self.species == Species::Fin { "fin_whale" } else { "blue_whale" },
            azimuth: self.whale.azimuth_deg.to_radians().rem_euclid(TAU),
            range_m: self.whale.range_m,
        }
    }
}

/// A sound from a direction with an envelope: earthquake, T phase or strumming.
pub struct Wave {
    kind: &'static str,
    radiator: Radiator,
    start_s: f64,
    duration_s: f64,
    azimuth: f64,
    /// Factors of pressure, East, North and Up.
    factors: [f64; 4],
    envelope: fn(f64) -> f64,
    /// When the surface gives it back, s after it came from below; `None`: it does not.
    answered_s: Option<f64>,
}

/// Elevation of what an earthquake sends through the floor.
const STEEP_DEG: f64 = 75.0;

impl Wave {
    /// An earthquake: a sudden onset that decays, coming steeply from below, and back from the surface, to which sound takes so long straight up (s).
    pub fn earthquake(b: &Burst, ambient: f64, seed: u64, straight_up_s: f64) -> Self {
        // Rises in a fiftieth of its length and decays four-fold.
        let envelope = |x: f64| if x < 0.02 { x / 0.02 } else { (-4.0 * x).exp() };
        let steep = STEEP_DEG.to_radians();
        let answered_s = Some(2.0 * straight_up_s * steep.sin());
        Self { answered_s, ..Self::burst("earthquake", b, ambient, seed, steep, envelope) }
    }

    /// A T phase: swells and fades over minutes, almost level.
    pub fn t_phase(b: &Burst, ambient: f64, seed: u64) -> Self {
        Self::burst("t_phase", b, ambient, seed, 12f64.to_radians(), |x| (PI * x).sin().powi(2))
    }

    fn burst(
        kind: &'static str,
        b: &Burst,
        ambient: f64,
        seed: u64,
        elevation: f64,
        envelope: fn(f64) -> f64,
    ) -> Self {
        let azimuth = b.azimuth_deg.to_radians();
        let (up, flat) = elevation.sin_cos();
        let up = if kind == "earthquake" { up } else { -up };
        Self {
            kind,
            radiator: Radiator::new(ambient * 10f64.powf(b.level_db / 20.0), Vec::new(), 0.0, seed),
            start_s: b.start_s,
            duration_s: b.duration_s,
            azimuth,
            factors: [1.0, -flat * azimuth.sin(), -flat * azimuth.cos(), up],
            envelope,
            answered_s: None,
        }
    }

    /// Strumming: a fundamental and its harmonics on the horizontals, hardly any on the hydrophone. `bin` is the
    /// ambient root mean square in one bin of the 1024-point spectrum.
    pub fn strumming(s: &Strumming, bin: f64, seed: u64) -> Self {
        let azimuth = s.azimuth_deg.to_radians();
        let amplitude = 2f64.sqrt() * bin * 10f64.powf(s.level_db / 20.0);
        let tones = (1..)
            .map(|k| ToneLine { hz: s.fundamental_hz * f64::from(k), amplitude })
            .take_while(|t| t.hz < 24.0)
            .collect();
        Self {
            kind: "strumming",
            // Vortex shedding follows the current: several percent of wander.
            radiator: Radiator::new(0.0, tones, 0.03, seed),
            start_s: s.start_s,
            duration_s: s.duration_s,
            azimuth,
            factors: [10f64.powf(s.pressure_db / 20.0), azimuth.sin(), azimuth.cos(), 0.2],
            envelope: |x| (PI * x).sin().sqrt(),
            answered_s: None,
        }
    }

    /// Adds what arrives in samples `first..`.
    pub fn add(&mut self, rate_hz: f64, first: u64, out: &mut [Field]) {
        let (from, to) = (first as f64 / rate_hz, (first as f64 + out.len() as f64) / rate_hz);
        let later = self.answered_s.unwrap_or(0.0);
        if to < self.start_s || from > self.start_s + self.duration_s + later {
            return;
        }
        self.radiator.prepare(from - later, to);
        let pressure = |t: f64| {
            let x = (t - self.start_s) / self.duration_s;
            if (0.0..=1.0).contains(&x) { self.radiator.at(t).re * (self.envelope)(x) } else { 0.0 }
        };
        for (i, field) in out.iter_mut().enumerate() {
            let t = from + i as f64 / rate_hz;
            let p = pressure(t);
            // From the surface pressure comes back turned round, and goes down: level motion is turned round as well, vertical motion is not.
            let back = self.answered_s.map_or(0.0, |later| pressure(t - later));
            let [of_p, east, north, up] = self.factors;
            let values = [(p - back) * of_p, (p - back) * east, (p - back) * north, (p + back) * up];
            for (slot, value) in field.iter_mut().zip(values) {
                *slot += value as f32;
            }
        }
    }

    /// For the truth.
    pub fn heard(&self) -> HeardEvent {
        HeardEvent {
            from_s: self.start_s,
            to_s: self.start_s + self.duration_s + self.answered_s.unwrap_or(0.0),
            kind: self.kind,
            azimuth: self.azimuth.rem_euclid(TAU),
            range_m: f64::INFINITY,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_have_continuous_phase_and_unit_peak() {
        for species in [Species::Fin, Species::Blue] {
            let mut before = species.form(0.0);
            let mut peak = 0.0f64;
            for i in 1..(species.duration_s() * 1000.0) as u32 {
                let now = species.form(f64::from(i) * 1e-3);
                // 25 Hz turn by 0.16 rad in a millisecond.
                assert!((now - before).norm() < 0.17, "{species:?} {i}");
                peak = peak.max(now.norm());
                before = now;
            }
            assert!((peak - 1.0).abs() < 0.01);
        }
    }
}
