//! Ambient noise of the four components: isotropic, directional, and the microseism below 1 Hz.
//!
//! Gaussian, white from 1 to 25 Hz, rising towards low frequencies below 1 Hz. Pressure and the three velocities of
//! isotropic noise are uncorrelated; directional noise comes as plane waves from azimuths and is coherent between
//! them. Blocks of spectra overlapped by half with a power-complementary window; each block depends on seed and number.

use super::passage::Field;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use seabearing_signal::{Complex, ComplexToReal, Precision};
use std::sync::Arc;

const BLOCK: usize = 4096;

/// Samples made at a time.
pub const HOP: usize = BLOCK / 2;

/// Noise from one direction.
#[derive(Clone, Copy, Debug)]
pub struct Directional {
    /// Where it comes from, rad clockwise from North.
    pub azimuth: f64,
    /// Root-mean-square pressure.
    pub rms: f64,
    /// Angle of arrival above the horizontal, rad.
    pub elevation: f64,
}

/// Noise of the horizontal velocities along an axis.
#[derive(Clone, Copy, Debug)]
pub struct Shaking {
    /// True azimuth of the axis, rad.
    pub axis: f64,
    /// Root-mean-square velocity, in the units of pressure.
    pub rms: f64,
}

/// The noise of one station.
pub struct AmbientNoise {
    rms: [f64; 4],
    directional: Vec<Directional>,
    shaking: Vec<Shaking>,
    seed: u64,
    shape: Vec<f32>,
    window: Vec<f32>,
    fft: Arc<dyn ComplexToReal<f32>>,
    scratch: Vec<Complex<f32>>,
    next_hop: u64,
    tail: Vec<Field>,
}

impl AmbientNoise {
    /// Noise of root-mean-square values for pressure, East, North and Up (white part), `low_db` louder at 0.2 Hz.
    pub fn new(
        rate_hz: f64,
        rms: [f64; 4],
        low_db: f64,
        directional: Vec<Directional>,
        shaking: Vec<Shaking>,
        seed: u64,
    ) -> Self {
        let slope = low_db / 20.0 / 5f64.log10();
        let shape = (0..=BLOCK / 2)
            .map(|k| {
                let hz = k as f64 * rate_hz / BLOCK as f64;
                if hz < 0.05 { 0.0 } else { hz.clamp(0.2, 1.0).powf(-slope) as f32 }
            })
            .collect();
        let fft = f32::complex_to_real(BLOCK);
        Self {
            rms,
            directional,
            shaking,
            seed,
            shape,
            window: (0..BLOCK)
                .map(|i| ((i as f64 + 0.5) / BLOCK as f64 * std::f64::consts::PI).sin() as f32)
                .collect(),
            scratch: fft.make_scratch_vec(),
            fft,
            next_hop: 0,
            tail: Vec::new(),
        }
    }

    /// The next [`HOP`] samples.
    pub fn next_hop(&mut self) -> Vec<Field> {
        if self.next_hop == 0 {
            self.tail = self.block(0).split_off(HOP);
        }
        self.next_hop += 1;
        let mut block = self.block(self.next_hop);
        let tail = block.split_off(HOP);
        for (b, t) in block.iter_mut().zip(&self.tail) {
            for (x, y) in b.iter_mut().zip(t) {
                *x += y;
            }
        }
        self.tail = tail;
        block
    }

    fn block(&mut self, number: u64) -> Vec<Field> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(number);
        let bins = self.shape.len();
        // The unnormalised inverse transform of N bins of unit power has variance N.
        let unit = 1.0 / (BLOCK as f64).sqrt();
        let mut draw = |level: f64, shape: &[f32]| -> Vec<Complex<f32>> {
            let level = (level * unit) as f32;
            shape
                .iter()
                .map(|s| {
                    let (re, im): (f32, f32) =
                        (StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng));
                    Complex::new(re, im) * (level * s * std::f32::consts::FRAC_1_SQRT_2)
                })
                .collect()
        };
        let mut spectra: [Vec<Complex<f32>>; 4] = self.rms.map(|level| draw(level, &self.shape));
        for d in &self.directional {
            let wave = draw(d.rms, &self.shape);
            let (s, c) = d.azimuth.sin_cos();
            let (up, flat) = d.elevation.sin_cos();
            for (spectrum, part) in spectra.iter_mut().zip([1.0, -flat * s, -flat * c, -up]) {
                for (x, w) in spectrum.iter_mut().zip(&wave) {
                    *x += w * part as f32;
                }
            }
        }
        for along in &self.shaking {
            let motion = draw(along.rms, &self.shape);
            let (s, c) = along.axis.sin_cos();
            for (spectrum, part) in spectra.iter_mut().zip([0.0, s, c, 0.0]) {
                for (x, w) in spectrum.iter_mut().zip(&motion) {
                    *x += w * part as f32;
                }
            }
        }
        let mut out = vec![[0.0f32; 4]; BLOCK];
        let mut time = vec![0.0f32; BLOCK];
        for (channel, spectrum) in spectra.iter_mut().enumerate() {
            spectrum[0] = Complex::default();
            spectrum[bins - 1].im = 0.0;
            // Lengths and the two real bins are right by construction, which is all this call can complain about.
            if self.fft.process_with_scratch(spectrum, &mut time, &mut self.scratch).is_err() {
                continue;
            }
            for ((field, x), w) in out.iter_mut().zip(&time).zip(&self.window) {
                field[channel] = x * w;
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_and_coherence() {
        let west = Directional { azimuth: 1.5 * std::f64::consts::PI, rms: 2.0, elevation: 0.0 };
        let mut a = AmbientNoise::new(50.0, [1.0, 1.5, 1.0, 0.5], 0.0, vec![west], Vec::new(), 5);
        let samples: Vec<Field> = (0..40).flat_map(|_| a.next_hop()).collect();
        let n = samples.len() as f32;
        let mean = |f: &dyn Fn(&Field) -> f32| samples.iter().map(f).sum::<f32>() / n;
        assert!((mean(&|f| f[0] * f[0]) - 5.0).abs() < 0.2, "{}", mean(&|f| f[0] * f[0]));
        assert!((mean(&|f| f[1] * f[1]) - 6.25).abs() < 0.25);
        assert!((mean(&|f| f[3] * f[3]) - 0.25).abs() < 0.02);
        // From the west the wave moves east: pressure and East go together.
        assert!((mean(&|f| f[0] * f[1]) - 4.0).abs() < 0.2, "{}", mean(&|f| f[0] * f[1]));
        assert!(mean(&|f| f[0] * f[2]).abs() < 0.1);
    }
}
