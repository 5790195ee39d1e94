//! What an array hears of vessels that pass, made block by block in the frequency domain: a tenth of the work of the exact
//! simulator ([`crate::world::SimulatedArray`]), for experiments with many passes.
//!
//! Blocks of half a second overlap by half under sine windows, whose squares add up to one. Within a block each vessel stands
//! where the sound of the block's middle left it, and its noise reaches every hydrophone by all paths with their exact delays
//! and losses; from block to block it is another draw of the same spectrum. There is no Doppler shift and no modulation.

use super::bearing_limit_source::{AmbientField, Root, coherence_matrix, root};
use crate::course::VesselCourse;
use crate::world::ArrayScenario;
use crate::world::array::ambient_level;
use crate::world::noise::SpectrumShape;
use crate::world::source::density;
use anyhow::{Result, anyhow};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use seabearing_core::block::{CHANNELS, Frame};
use seabearing_core::geometry::Geometry;
use seabearing_signal::{Complex, ComplexToReal, Precision};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Samples of a block, and from one to the next.
const BLOCK: usize = 8192;
const HOP: usize = BLOCK / 2;
/// Converter codes for a micropascal: −165 dB re 1 V, 2.5 V full scale of 24 bits.
const CODES_PER_UPA: f32 = 0.0189;

/// A vessel at sea.
struct Sailing {
    motion: VesselCourse,
    /// Heights above the array and amplitudes of the vessel and its images.
    routes: Vec<(f64, f64)>,
    /// Standard deviation of each part of each bin, 1 m away.
    amplitude: Vec<f32>,
}

/// An iterator over frames.
pub struct MovingSea {
    rate_hz: f64,
    geometry: Geometry,
    vessels: Vec<Sailing>,
    ambient: Vec<f32>,
    /// Lower triangular mixing of the ambient noise, by bin.
    mixing: Vec<Root>,
    rng: ChaCha8Rng,
    inverse: Arc<dyn ComplexToReal<f32>>,
    scratch: Vec<Complex<f32>>,
    bins: [Vec<Complex<f32>>; CHANNELS],
    block: Vec<f32>,
    window: Vec<f32>,
    /// Second half of the block before.
    tail: [Vec<f32>; CHANNELS],
    /// Blocks so far.
    made: u64,
    left: u64,
    chunk: std::vec::IntoIter<Frame>,
}

impl MovingSea {
    /// Sets a scenario up; its recorder's faults, gaps and clock are not looked at.
    ///
    /// # Errors
    /// A course or the geometry cannot be used.
    pub fn new(scenario: &ArrayScenario) -> Result<Self> {
        let config = &scenario.station.config;
        let geometry = config.geometry().map_err(|e| anyhow!("{e:?}"))?;
        let rate_hz = config.rate_hz;
        let hz = |k: usize| k as f64 * rate_hz / BLOCK as f64;
        let amplitudes = |density: &dyn Fn(f64) -> f64| -> Vec<f32> {
            let of = |k: usize| (density(hz(k)) * rate_hz / BLOCK as f64).sqrt() as f32 / 2.0;
            (0..=HOP).map(|k| if k == 0 || k == HOP { 0.0 } else { of(k) }).collect()
        };
        let sea = &scenario.ambient;
        let shape = SpectrumShape { knee_hz: sea.knee_hz, slope_db_per_decade: sea.slope_db_per_decade };
        let courses = scenario.vessels.iter().map(|v| v.course(config.lat_lon_deg));
        let level = ambient_level(scenario, &courses.collect::<Result<Vec<_>>>()?);
        let share = sea.diffuse_share;
        let mixing = (0..=HOP).map(|k| {
            let mut m = coherence_matrix(&geometry, hz(k), AmbientField::Isotropic);
            let diagonal = m.diagonal();
            m *= Complex::from(share);
            m.set_diagonal(&diagonal);
            root(m)
        });
        let mut vessels = Vec::new();
        for vessel in &scenario.vessels {
            vessels.push(Sailing {
                motion: vessel.course(config.lat_lon_deg)?,
                routes: scenario.water.routes(config.depth_m, vessel.depth_m),
                amplitude: amplitudes(&density(vessel, rate_hz)),
            });
        }
        let inverse = f32::complex_to_real(BLOCK);
        let sine = |i: usize| ((i as f64 + 0.5) * PI / BLOCK as f64).sin() as f32;
        Ok(Self {
            rate_hz,
            geometry,
            vessels,
            ambient: amplitudes(&|f| level * shape.density(f)),
            mixing: mixing.collect(),
            rng: ChaCha8Rng::seed_from_u64(scenario.seed),
            scratch: inverse.make_scratch_vec(),
            inverse,
            bins: std::array::from_fn(|_| vec![Complex::default(); HOP + 1]),
            block: vec![0.0; BLOCK],
            window: (0..BLOCK).map(sine).collect(),
            tail: std::array::from_fn(|_| vec![0.0; HOP]),
            made: 0,
            left: (scenario.duration_s * rate_hz) as u64,
            chunk: Vec::new().into_iter(),
        })
    }

    /// The next half block of each hydrophone.
    fn make(&mut self) -> Vec<Frame> {
        let normal = |rng: &mut ChaCha8Rng| -> Complex<f32> {
            Complex::new(StandardNormal.sample(rng), StandardNormal.sample(rng))
        };
        for (k, (a, root)) in self.ambient.iter().zip(&self.mixing).enumerate() {
            let white: [Complex<f32>; CHANNELS] = std::array::from_fn(|_| normal(&mut self.rng) * *a);
            for (i, bins) in self.bins.iter_mut().enumerate() {
                bins[k] = (0..=i).map(|j| root[i][j] * white[j]).sum();
            }
        }
        // The middle of the block: the first begins half a block before the recording.
        let t_s = self.made as f64 * HOP as f64 / self.rate_hz;
        let c = f64::from(self.geometry.sound_speed_m_s);
        for vessel in &self.vessels {
            let direct = vessel.motion.emission(t_s, [0.0; 3], vessel.routes[0].0, c, t_s).1;
            let mut noise: Vec<_> = vessel.amplitude.iter().map(|a| normal(&mut self.rng) * *a).collect();
            noise[0] = Complex::default();
            for (z, gain) in &vessel.routes {
                // One wavefront: all hydrophones hear what left the vessel at the same place.
                let (emitted, _) = vessel.motion.emission(t_s, [0.0; 3], *z, c, t_s);
                let (x, y) = vessel.motion.position(emitted);
                for (h, bins) in self.geometry.position_m.iter().zip(&mut self.bins) {
                    let [east, north, up] = h.map(f64::from);
                    let distance = (x - east).hypot(y - north).hypot(z - up);
                    let delay_s = (distance - direct) / c;
                    let step = Complex::from_polar(1.0, -TAU * delay_s * self.rate_hz / BLOCK as f64);
                    let mut phase = Complex::new(gain / distance.max(1.0), 0.0);
                    for (bin, noise) in bins.iter_mut().zip(&noise) {
                        *bin += noise * Complex::new(phase.re as f32, phase.im as f32);
                        phase *= step;
                    }
                }
            }
        }
        let mut frames = vec![[0; CHANNELS]; HOP];
        for (c, (bins, tail)) in self.bins.iter_mut().zip(&mut self.tail).enumerate() {
            bins[0] = Complex::default();
            bins[HOP] = Complex::default();
            if self.inverse.process_with_scratch(bins, &mut self.block, &mut self.scratch).is_err() {
                unreachable!("lengths are the planner's own");
            }
            self.block.iter_mut().zip(&self.window).for_each(|(x, w)| *x *= w);
            let (first, second) = self.block.split_at(HOP);
            for ((frame, x), before) in frames.iter_mut().zip(first).zip(tail.iter()) {
                frame[c] = (CODES_PER_UPA * (x + before)).round() as i32;
            }
            tail.copy_from_slice(second);
        }
        self.made += 1;
        frames
    }
}

impl Iterator for MovingSea {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        self.left = self.left.checked_sub(1)?;
        if self.chunk.len() == 0 {
            // Before the first there is no block to overlap with.
            if self.made == 0 {
                self.make();
            }
            self.chunk = self.make().into_iter();
        }
        self.chunk.next()
    }
}
