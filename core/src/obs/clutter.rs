//! The clutter filter: takes from each cepstrum what does not move, frame by frame.
//!
//! Enters: cepstra. Leaves: cepstra without their slowly changing part, which is the vessel's own harmonic structure and
//! the recorder's colour [O, appendix A]. In place of the paper's singular-value decomposition of three hours: a
//! forgetting mean and a subspace of two dimensions tracked by deflation (projection-approximation subspace tracking),
//! with a memory of [`MEMORY`] frames. Assumes that a branch sweeps past a quefrency faster than that memory.
//! Cost: 4 × 384 multiplications a frame; memory 4.6 KiB.

use super::cepstrum::noise_sd;
use super::limits::QUEFRENCIES;

/// Frames after which the past has faded to 1/e (85 minutes at 50 Hz).
pub const MEMORY: f32 = 500.0;

/// Dimensions tracked: one leaves a third more wrong branches, a third takes nothing more.
const DIMENSIONS: usize = 2;

/// Quefrencies below this index are not touched by any branch and carry the spectrum's smooth shape: set to zero.
pub const FIRST_QUEFRENCY: usize = 5;

/// State of the filter.
#[derive(Clone, Debug)]
pub struct Clutter {
    mean: [f32; QUEFRENCIES],
    axis: [[f32; QUEFRENCIES]; DIMENSIONS],
    power: [f32; DIMENSIONS],
    frames: u32,
}

impl Clutter {
    /// Nothing learned; all zeros.
    pub const fn new() -> Self {
        Self {
            mean: [0.0; QUEFRENCIES],
            axis: [[0.0; QUEFRENCIES]; DIMENSIONS],
            power: [0.0; DIMENSIONS],
            frames: 0,
        }
    }

    /// Forgets everything, in place.
    pub(super) fn forget(&mut self) {
        self.mean.fill(0.0);
        self.axis.as_flattened_mut().fill(0.0);
        self.power.fill(0.0);
        self.frames = 0;
    }

    /// Filters one cepstrum in place and learns from it.
    pub fn filter(&mut self, c: &mut [f32; QUEFRENCIES]) {
        if self.frames == 0 {
            self.start();
        }
        self.frames = self.frames.saturating_add(1);
        let share = (1.0 / MEMORY).max(1.0 / self.frames as f32);
        c.iter_mut().take(FIRST_QUEFRENCY).for_each(|c| *c = 0.0);
        for (c, m) in c.iter_mut().zip(&mut self.mean) {
            let e = *c - *m;
            *m += share * e;
            *c = e;
        }
        for (axis, power) in self.axis.iter_mut().zip(&mut self.power) {
            let norm: f32 = axis.iter().map(|a| a * a).sum();
            let y = axis.iter().zip(c.iter()).map(|(a, c)| a * c).sum::<f32>() / norm.max(1e-12);
            *power = (1.0 - 1.0 / MEMORY) * *power + y * y;
            let gain = if *power > 0.0 { y / *power } else { 0.0 };
            for (a, c) in axis.iter_mut().zip(c.iter_mut()) {
                let e = *c - *a * y;
                *a += e * gain;
                *c = e;
            }
        }
    }

    /// Frames seen.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// Axes that are not at right angles to everything, with the power noise would give them.
    fn start(&mut self) {
        let noise = noise_sd(QUEFRENCIES / 2);
        for (d, (axis, power)) in self.axis.iter_mut().zip(&mut self.power).enumerate() {
            for (k, a) in axis.iter_mut().enumerate().skip(FIRST_QUEFRENCY) {
                // Two deterministic, unlike sign patterns of unit length in all.
                let sign = if (k * (2 * d + 3) / 7) % 2 == 0 { 1.0 } else { -1.0 };
                *a = sign / 19.5;
            }
            *power = 0.2 * MEMORY * noise * noise;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;

    #[test]
    fn a_standing_pattern_goes_and_a_moving_pulse_stays() {
        let mut f = Clutter::new();
        let (mut standing, mut moving) = (0.0, 0.0);
        let mut seed = 1u32;
        for t in 0..1500usize {
            let level = math::f32::sin(t as f32 * 0.05);
            let mut c = [0f32; QUEFRENCIES];
            for (k, c) in c.iter_mut().enumerate() {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let noise = (seed >> 8) as f32 / 8_388_608.0 - 1.0;
                *c = 0.03 * noise + 0.2 * math::f32::cos(k as f32 * 0.3) * (1.0 + 0.5 * level);
            }
            let at = 60 + t / 10;
            c[at] += 0.1;
            f.filter(&mut c);
            if t > 1000 {
                standing += c.iter().enumerate().filter(|(k, _)| *k != at).map(|(_, c)| c * c).sum::<f32>();
                moving += c[at];
            }
        }
        let rms = math::f32::sqrt(standing / 499.0 / 378.0);
        assert!(rms < 0.021, "{rms}");
        assert!(moving / 499.0 > 0.09, "{}", moving / 499.0);
    }
}
