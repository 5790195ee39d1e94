//! Signals for the bearing experiments: a static source with exact fractional delays, and ambient noise with a given
//! coherence between hydrophones. Everything is made in the frequency domain as one period of a long record.

use nalgebra::Matrix4;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use seabearing_core::block::Frame;
use seabearing_core::geometry::{Geometry, PAIRS};
use seabearing_core::math::f64::j0;
use seabearing_signal::{Complex, ComplexToReal, Precision};
use std::array;
use std::f64::consts::TAU;
use std::sync::Arc;

/// How ambient noise is related between hydrophones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AmbientField {
    /// Independent at every hydrophone.
    Independent,
    /// Isotropic: plane waves from all directions, coherence `sinc(2fd/c)`.
    Isotropic,
    /// Made at the surface: density `4 sin⁺β` over elevation (dipoles on a plane; Cron and Sherman 1962).
    Surface,
}

/// One way from a source to the hydrophones: gain (amplitude, with sign) and arrival times in seconds.
pub type SignalPath = (f64, [f64; 4]);

/// A lower triangle by row.
pub type Root = [[Complex<f32>; 4]; 4];

/// Memory for making records.
pub struct Desk {
    spectra: [Vec<Complex<f32>>; 4],
    signal: Vec<f32>,
    scratch: Vec<Complex<f32>>,
    frames: Vec<Frame>,
}

/// Makes records of one length for one array.
pub struct Sounder {
    samples: usize,
    rate_hz: f64,
    geometry: Geometry,
    inverse: Arc<dyn ComplexToReal<f32>>,
    /// Root of the spectral density shared by source and noise, per bin (mean square one over the band).
    shape: Vec<f32>,
    /// Lower triangles (by row) of the noise's coherence roots, per bin group.
    mixing: Option<(usize, Vec<Root>)>,
}

impl Sounder {
    /// A maker of records of `samples` (a power of two) at a rate. The spectrum falls as a ship's: by 6 dB per octave
    /// above 300 Hz, level below.
    pub fn new(geometry: &Geometry, rate_hz: f64, samples: usize, ambient: AmbientField) -> Self {
        let bins = samples / 2 + 1;
        let mut shape: Vec<f32> = (0..bins)
            .map(|k| {
                let f = k as f64 * rate_hz / samples as f64;
                if f < 10.0 { 0.0 } else { (1.0 / (1.0 + (f / 300.0).powi(2))).sqrt() as f32 }
            })
            .collect();
        // Two normal numbers a bin, and both halves of the spectrum.
        let power: f32 = shape.iter().map(|a| a * a).sum::<f32>() * 4.0;
        for a in &mut shape {
            *a /= power.sqrt();
        }
        let inverse = f32::complex_to_real(samples);
        let mixing = (ambient != AmbientField::Independent).then(|| {
            // Coherence varies over hundreds of hertz (the time across the array is about a millisecond).
            let group = ((8.0 * samples as f64 / rate_hz) as usize).max(1);
            let roots = (0..=bins / group)
                .into_par_iter()
                .map(|g| {
                    let f = ((g * group) as f64 + 0.5 * group as f64) * rate_hz / samples as f64;
                    root(coherence_matrix(geometry, f, ambient))
                })
                .collect();
            (group, roots)
        });
        Self { samples, rate_hz, geometry: *geometry, inverse, shape, mixing }
    }

    /// The same with sources and noise between two frequencies only; levels stay those of the whole band.
    pub fn within(mut self, low_hz: f64, high_hz: f64) -> Self {
        for (k, a) in self.shape.iter_mut().enumerate() {
            let f = k as f64 * self.rate_hz / self.samples as f64;
            if !(low_hz..high_hz).contains(&f) {
                *a = 0.0;
            }
        }
        self
    }

    /// The same with a flat spectrum.
    pub fn white(mut self) -> Self {
        let bins = self.shape.len();
        self.shape.iter_mut().for_each(|a| *a = (0.25 / bins as f32).sqrt());
        self
    }

    /// Power of noise about a frequency (Hz), in any one unit that sounders of one length share.
    pub fn density(&self, f_hz: f64) -> f64 {
        let bin = (f_hz * self.samples as f64 / self.rate_hz) as usize;
        self.shape.get(bin).map_or(0.0, |a| f64::from(a * a))
    }

    /// Seconds of one record.
    pub fn seconds(&self) -> f64 {
        self.samples as f64 / self.rate_hz
    }

    /// Memory for records of this length.
    pub fn desk(&self) -> Desk {
        Desk {
            spectra: array::from_fn(|_| vec![Complex::new(0.0, 0.0); self.shape.len()]),
            signal: vec![0.0; self.samples],
            scratch: self.inverse.make_scratch_vec(),
            frames: vec![[0; 4]; self.samples],
        }
    }

    /// One record as converter codes: noise of `rms_codes`, and a source stronger by `snr_db` with the given arrival
    /// times in seconds.
    pub fn record(&self, seed: u64, rms_codes: f64, source: Option<(f64, [f64; 4])>) -> Vec<Frame> {
        let mut desk = self.desk();
        self.record_on(&mut desk, seed, rms_codes, source);
        desk.frames
    }

    /// [`Sounder::record`] in memory used again and again: fresh pages of memory cost as much as a transform.
    pub fn record_on<'a>(
        &self,
        desk: &'a mut Desk,
        seed: u64,
        rms_codes: f64,
        source: Option<(f64, [f64; 4])>,
    ) -> &'a [Frame] {
        let sources: Vec<_> =
            source.map(|(snr_db, arrivals)| (snr_db, vec![(1.0, arrivals)])).into_iter().collect();
        self.record_paths(desk, seed, rms_codes, &sources)
    }

    /// The same with any number of sources, each with any number of paths: gain and arrival times.
    pub fn record_paths<'a>(
        &self,
        desk: &'a mut Desk,
        seed: u64,
        rms_codes: f64,
        sources: &[(f64, Vec<SignalPath>)],
    ) -> &'a [Frame] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let bins = self.shape.len();
        let Desk { spectra, signal, scratch, frames } = desk;
        for spectrum in spectra.iter_mut() {
            // The ends carry nothing, whatever the last transform left there.
            spectrum[0] = Complex::new(0.0, 0.0);
            spectrum[bins - 1] = Complex::new(0.0, 0.0);
        }
        let amplitude = rms_codes as f32;
        for k in 1..bins - 1 {
            let a = self.shape[k] * amplitude;
            let mut white = [Complex::new(0.0f32, 0.0); 4];
            for w in &mut white {
                *w = normal_pair(&mut rng) * a;
            }
            match &self.mixing {
                None => {
                    for (s, w) in spectra.iter_mut().zip(white) {
                        s[k] = w;
                    }
                }
                Some((group, roots)) => {
                    let root = &roots[k / group];
                    for (i, s) in spectra.iter_mut().enumerate() {
                        s[k] = (0..=i).map(|j| root[i][j] * white[j]).sum();
                    }
                }
            }
        }
        for (snr_db, paths) in sources {
            let gain = amplitude * 10f64.powf(snr_db / 20.0) as f32;
            let turn = |t: &f64| Complex::from_polar(1.0, -TAU * t * self.rate_hz / self.samples as f64);
            let turns: Vec<[Complex<f64>; 4]> = paths.iter().map(|p| p.1.each_ref().map(turn)).collect();
            let mut phases: Vec<_> = paths.iter().map(|p| [Complex::new(p.0, 0.0); 4]).collect();
            for k in 1..bins - 1 {
                let s = normal_pair(&mut rng) * (self.shape[k] * gain);
                for (phase, turn) in phases.iter_mut().zip(&turns) {
                    for (c, spectrum) in spectra.iter_mut().enumerate() {
                        phase[c] *= turn[c];
                        spectrum[k] += s * Complex::new(phase[c].re as f32, phase[c].im as f32);
                    }
                }
            }
        }
        for (c, spectrum) in spectra.iter_mut().enumerate() {
            if self.inverse.process_with_scratch(spectrum, signal, scratch).is_err() {
                unreachable!("lengths are the planner's own");
            }
            for (frame, x) in frames.iter_mut().zip(signal.iter()) {
                frame[c] = x.round().clamp(-8_388_607.0, 8_388_607.0) as i32;
            }
        }
        frames
    }

    /// The array the records are for.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }
}

/// Exact arrival times (seconds) of a spherical wave from azimuth, elevation (radians) and range.
pub fn exact_arrivals(geometry: &Geometry, azimuth: f64, elevation: f64, range_m: f64) -> [f64; 4] {
    let source = [
        range_m * azimuth.sin() * elevation.cos(),
        range_m * azimuth.cos() * elevation.cos(),
        range_m * elevation.sin(),
    ];
    geometry.position_m.map(|h| {
        let d: f64 = (0..3).map(|k| (source[k] - f64::from(h[k])).powi(2)).sum();
        (d.sqrt() - range_m) / f64::from(geometry.sound_speed_m_s)
    })
}

/// Elevation (radians) of a vessel 4 m deep at a horizontal range, seen by an array 168 m deep, and its two paths: direct and
/// off the surface, which turns the sign and keeps 95 % of the amplitude.
pub fn surfaced(geometry: &Geometry, azimuth: f64, horizontal_m: f64) -> (f64, Vec<SignalPath>) {
    let (direct_m, image_m) = (horizontal_m.hypot(164.0), horizontal_m.hypot(172.0));
    let elevation = 164f64.atan2(horizontal_m);
    let direct = exact_arrivals(geometry, azimuth, elevation, direct_m);
    let later = (image_m - direct_m) / f64::from(geometry.sound_speed_m_s);
    let image = exact_arrivals(geometry, azimuth, 172f64.atan2(horizontal_m), image_m).map(|t| t + later);
    (elevation, vec![(1.0, direct), (-0.95 * direct_m / image_m, image)])
}

/// Two independent normal numbers (Box-Muller), as one complex of mean square two.
fn normal_pair(rng: &mut ChaCha8Rng) -> Complex<f32> {
    let u: f32 = 1.0 - rng.random::<f32>();
    let (s, c) = (std::f32::consts::TAU * rng.random::<f32>()).sin_cos();
    let r = (-2.0 * u.ln()).sqrt();
    Complex::new(r * c, r * s)
}

/// Coherence `E X_i X_j*` of the ambient noise at a frequency.
pub fn coherence_matrix(geometry: &Geometry, f: f64, ambient: AmbientField) -> Matrix4<Complex<f64>> {
    let k = TAU * f / f64::from(geometry.sound_speed_m_s);
    let mut m = Matrix4::from_diagonal_element(Complex::new(1.0 + 1e-6, 0.0));
    for (i, j) in PAIRS {
        let d: Vec<f64> = (0..3)
            .map(|a| f64::from(geometry.position_m[j][a]) - f64::from(geometry.position_m[i][a]))
            .collect();
        let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        // γ = E X_i* X_j.
        let gamma = match ambient {
            AmbientField::Independent => Complex::new(0.0, 0.0),
            AmbientField::Isotropic => {
                let x = k * length;
                Complex::new(if x > 1e-9 { x.sin() / x } else { 1.0 }, 0.0)
            }
            AmbientField::Surface => {
                // Integral over the sine of elevation; the azimuths give a Bessel function, here a ring sum.
                let horizontal = d[0].hypot(d[1]);
                let n = 64 + (k * length) as usize * 2;
                (0..n)
                    .map(|step| {
                        let z = (step as f64 + 0.5) / n as f64;
                        let ring = j0(k * horizontal * (1.0 - z * z).sqrt());
                        Complex::from_polar(2.0 * z * ring / n as f64, k * d[2] * z)
                    })
                    .sum()
            }
        };
        m[(j, i)] = gamma;
        m[(i, j)] = gamma.conj();
    }
    m
}

/// Lower root L of a coherence matrix, `L Lᴴ = M`.
pub fn root(m: Matrix4<Complex<f64>>) -> Root {
    let l = m.cholesky().expect("fields of independent directions have a positive definite coherence").l();
    array::from_fn(|i| array::from_fn(|j| Complex::new(l[(i, j)].re as f32, l[(i, j)].im as f32)))
}
