//! What a vessel radiates: wideband noise and slowly wandering tones, as a complex baseband that can be read at any
//! time.
//!
//! The signal x(t) = Re[b(t) e^{2πi·12.5·t}] holds 0 to 25 Hz; b is kept at 100 samples a second (four times what its
//! ±12.5 Hz need), so that six-point interpolation errs by less than −60 dB. Noise comes from blocks of independent
//! Gaussian spectra under the shape of [O App. B] (Gaussian about 15 Hz, −6 dB at 5 and 25 Hz, unless told otherwise), overlapped by half
//! with a power-complementary window; cavitation modulates its amplitude at the blade rate. Every block depends on seed and number only.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use seabearing_signal::{Complex, Fft, Precision};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Samples of the baseband a second.
pub const RATE_HZ: f64 = 100.0;

/// Frequency the baseband is shifted by, Hz.
const CENTRE_HZ: f64 = 12.5;

const BLOCK: usize = 4096;
const HOP: usize = BLOCK / 2;

/// Samples between exact evaluations of a tone's phase: its frequency moves by microhertz in between.
const TONE_STEP: usize = 64;

/// One line of a vessel's spectrum.
#[derive(Clone, Debug, PartialEq)]
pub struct ToneLine {
    /// Mean frequency, Hz.
    pub hz: f64,
    /// Amplitude of the line at 1 m in the units of the propagation table.
    pub amplitude: f64,
}

/// Shape of wideband noise against frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseShape {
    /// Frequency of the greatest density, Hz.
    pub centre_hz: f64,
    /// From there to half the amplitude (−6 dB), Hz.
    pub half_width_hz: f64,
}

impl Default for NoiseShape {
    /// \[O App. B\].
    fn default() -> Self {
        Self { centre_hz: 15.0, half_width_hz: 10.0 }
    }
}

impl NoiseShape {
    /// Amplitude at a frequency, 1 at the greatest; cut at 0 and 25 Hz.
    pub fn at(&self, hz: f64) -> f64 {
        let spread = self.half_width_hz / (2.0 * 2f64.ln()).sqrt();
        let edge = (hz / 0.5).min((25.0 - hz) / 0.25).clamp(0.0, 1.0);
        edge * (-0.5 * ((hz - self.centre_hz) / spread).powi(2)).exp()
    }
}

/// Modulation of the wideband noise's amplitude: `1 + depth cos`, at a rate that wanders as the lines do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Modulation {
    /// Rate, Hz.
    pub hz: f64,
    /// Depth, 0 to 1.
    pub depth: f64,
}

/// A radiating vessel.
pub struct Radiator {
    noise_rms: f64,
    tones: Vec<ToneLine>,
    modulation: Option<Modulation>,
    wander: Wander,
    seed: u64,
    shape: Vec<f32>,
    window: Vec<f32>,
    fft: Arc<dyn Fft<f32>>,
    scratch: Vec<Complex<f32>>,
    /// Number of the first hop kept, and the samples kept.
    first_hop: i64,
    kept: Vec<Complex<f32>>,
    /// Second half of the newest noise block, waiting for the next one's first half.
    tail: Vec<Complex<f32>>,
}

/// Slow common wander of all lines: relative frequency δ(t) as three sinusoids.
#[derive(Clone, Debug)]
struct Wander {
    parts: [(f64, f64, f64); 3],
}

impl Wander {
    fn new(relative: f64, rng: &mut ChaCha8Rng) -> Self {
        let mut part = |period_s: f64| {
            let phase: f64 = StandardNormal.sample(rng);
            let depth: f64 = StandardNormal.sample(rng);
            (TAU / period_s, relative * depth / 3f64.sqrt(), 10.0 * phase)
        };
        Self { parts: [part(5200.0), part(1900.0), part(730.0)] }
    }

    /// ∫ (1 + δ) dt: the time that the engine's own clock shows.
    fn time(&self, t_s: f64) -> f64 {
        t_s + self.parts.iter().map(|(w, d, p)| d / w * (1.0 - (w * t_s + p).cos())).sum::<f64>()
    }
}

impl Radiator {
    /// A vessel with noise of a root-mean-square pressure at 1 m and lines that wander by `wander` (relative).
    pub fn new(noise_rms: f64, tones: Vec<ToneLine>, wander: f64, seed: u64) -> Self {
        Self::shaped(noise_rms, NoiseShape::default(), None, tones, wander, seed)
    }

    /// The same with a shape of its noise and a modulation.
    pub fn shaped(
        noise_rms: f64,
        noise: NoiseShape,
        modulation: Option<Modulation>,
        tones: Vec<ToneLine>,
        wander: f64,
        seed: u64,
    ) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let shift = (CENTRE_HZ / RATE_HZ * BLOCK as f64) as usize;
        let mut shape: Vec<f32> = vec![0.0; BLOCK];
        for k in 0..2 * shift {
            let hz = k as f64 * RATE_HZ / BLOCK as f64;
            shape[(k + BLOCK - shift) % BLOCK] = noise.at(hz) as f32;
        }
        // Re of a complex noise has half its power; a complex bin of two unit normals has power 2 a².
        let power: f64 = shape.iter().map(|a| f64::from(*a).powi(2)).sum();
        for a in &mut shape {
            *a *= (noise_rms / power.sqrt()) as f32;
        }
        let window = (0..BLOCK)
            .map(|i| ((i as f64 + 0.5) / BLOCK as f64 * std::f64::consts::PI).sin() as f32)
            .collect();
        Self {
            noise_rms,
            tones,
            modulation,
            wander: Wander::new(wander, &mut rng),
            seed,
            shape,
            window,
            fft: f32::complex_inverse(BLOCK),
            scratch: Vec::new(),
            first_hop: 0,
            kept: Vec::new(),
            tail: Vec::new(),
        }
    }

    /// Makes the baseband of a span of time readable and forgets what lies before it. Spans must not go back.
    pub fn prepare(&mut self, from_s: f64, to_s: f64) {
        let first = ((from_s * RATE_HZ - 8.0) / HOP as f64).floor() as i64;
        let last = ((to_s * RATE_HZ + 8.0) / HOP as f64).floor() as i64;
        let mut next = self.first_hop + (self.kept.len() / HOP) as i64;
        if self.kept.is_empty() || first >= next {
            self.kept.clear();
            self.first_hop = first;
            self.tail = self.noise_block(first - 1).split_off(HOP);
            next = first;
        } else if first > self.first_hop {
            self.kept.drain(..(first - self.first_hop) as usize * HOP);
            self.first_hop = first;
        }
        while next <= last {
            let mut block = self.noise_block(next);
            let tail = block.split_off(HOP);
            for (b, t) in block.iter_mut().zip(&self.tail) {
                *b += t;
            }
            self.tail = tail;
            self.modulate(next * HOP as i64, &mut block);
            self.add_tones(next * HOP as i64, &mut block);
            self.kept.append(&mut block);
            next += 1;
        }
    }

    fn noise_block(&mut self, number: i64) -> Vec<Complex<f32>> {
        if self.noise_rms == 0.0 {
            return vec![Complex::default(); BLOCK];
        }
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(number as u64);
        let mut block: Vec<Complex<f32>> = self
            .shape
            .iter()
            .map(|&a| {
                if a == 0.0 {
                    return Complex::default();
                }
                let (re, im): (f32, f32) = (StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng));
                Complex::new(a * re, a * im)
            })
            .collect();
        self.scratch.resize(self.fft.get_inplace_scratch_len(), Complex::default());
        self.fft.process_with_scratch(&mut block, &mut self.scratch);
        for (b, w) in block.iter_mut().zip(&self.window) {
            *b *= w;
        }
        block
    }

    fn modulate(&self, first: i64, out: &mut [Complex<f32>]) {
        let Some(Modulation { hz, depth }) = self.modulation else { return };
        let same_power = (1.0 + 0.5 * depth * depth).sqrt();
        for (i, x) in out.iter_mut().enumerate() {
            let turns = hz * self.wander.time((first + i as i64) as f64 / RATE_HZ);
            *x *= ((1.0 + depth * (TAU * turns.fract()).cos()) / same_power) as f32;
        }
    }

    fn add_tones(&self, first: i64, out: &mut [Complex<f32>]) {
        for tone in &self.tones {
            for (c, chunk) in out.chunks_mut(TONE_STEP).enumerate() {
                let t0 = (first + (c * TONE_STEP) as i64) as f64 / RATE_HZ;
                let t1 = t0 + chunk.len() as f64 / RATE_HZ;
                let turns = |t: f64| tone.hz * self.wander.time(t) - CENTRE_HZ * t;
                let (a, b) = (turns(t0), turns(t1));
                let step = Complex::from_polar(1.0, TAU * (b - a) / chunk.len() as f64);
                let mut now = Complex::from_polar(tone.amplitude, TAU * a.fract());
                for x in chunk {
                    *x += Complex::new(now.re as f32, now.im as f32);
                    now *= step;
                }
            }
        }
    }

    /// The analytic signal at a prepared time (six-point Lagrange interpolation of the baseband).
    pub fn at(&self, t_s: f64) -> Complex<f64> {
        let x = t_s * RATE_HZ - (self.first_hop * HOP as i64) as f64;
        let j = x.floor();
        let t = x - j;
        let Some(y) = (j as usize).checked_sub(2).and_then(|i| self.kept.get(i..i + 6)) else {
            return Complex::default();
        };
        let (p2, p1, m1, m2, m3) = (t + 2.0, t + 1.0, t - 1.0, t - 2.0, t - 3.0);
        let (a, b) = (p2 * p1, m2 * m3);
        let w = [
            -p1 * t * m1 * b / 120.0,
            p2 * t * m1 * b / 24.0,
            -a * m1 * b / 12.0,
            a * t * b / 12.0,
            -a * t * m1 * m3 / 24.0,
            a * t * m1 * m2 / 120.0,
        ];
        let (mut re, mut im) = (0.0, 0.0);
        for (y, w) in y.iter().zip(w) {
            re += f64::from(y.re) * w;
            im += f64::from(y.im) * w;
        }
        let turn = CENTRE_HZ * t_s;
        Complex::new(re, im) * Complex::from_polar(1.0, TAU * turn.fract())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_its_level_and_depends_on_time_alone() {
        let mut a = Radiator::new(3.0, vec![], 0.0, 7);
        a.prepare(100.0, 600.0);
        let n = 50_000;
        let power = (0..n).map(|i| a.at(100.0 + 0.01 * f64::from(i)).re.powi(2)).sum::<f64>() / f64::from(n);
        assert!((power / 9.0 - 1.0).abs() < 0.08, "{power}");
        let mut b = Radiator::new(3.0, vec![], 0.0, 7);
        b.prepare(0.0, 10.0);
        b.prepare(330.0, 340.0);
        assert!((a.at(333.3) - b.at(333.3)).norm() < 1e-4);
    }

    #[test]
    fn modulated_noise_has_its_power_and_beats_at_the_rate() {
        let modulation = Some(Modulation { hz: 1.7, depth: 0.8 });
        let shape = NoiseShape { centre_hz: 10.0, half_width_hz: 4.0 };
        let mut a = Radiator::shaped(3.0, shape, modulation, vec![], 0.0, 7);
        a.prepare(100.0, 600.0);
        let power: Vec<f64> = (0..50_000).map(|i| a.at(100.0 + 0.01 * f64::from(i)).norm_sqr()).collect();
        let mean = power.iter().sum::<f64>() / 5e4;
        assert!((mean / 18.0 - 1.0).abs() < 0.15, "{mean}");
        // Of (1 + d cos)² / (1 + d²/2) the first harmonic has the amplitude 2 d / (1 + d²/2).
        let beat = |hz: f64| {
            let sum: Complex<f64> = power
                .iter()
                .enumerate()
                .map(|(i, p)| Complex::from_polar(*p, -TAU * hz * (100.0 + 0.01 * i as f64)))
                .sum();
            2.0 * sum.norm() / 5e4 / mean
        };
        assert!((beat(1.7) - 1.6 / 1.32).abs() < 0.15 && beat(1.3) < 0.15, "{} {}", beat(1.7), beat(1.3));
    }

    #[test]
    fn a_tone_is_where_it_should_be() {
        let mut a = Radiator::new(0.0, vec![ToneLine { hz: 21.3, amplitude: 2.0 }], 0.0, 7);
        a.prepare(1000.0, 1010.0);
        for i in 0..100 {
            let t = 1001.0 + 0.0731 * f64::from(i);
            let want = Complex::from_polar(2.0, TAU * 21.3 * t);
            assert!((a.at(t) - want).norm() < 5e-3, "{t} {} {want}", a.at(t));
        }
    }
}
