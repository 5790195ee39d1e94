//! Ambient directions: how often each bin points where when nothing is near, learned over hours.
//!
//! Enters: azigram rows. Leaves: for the frames of a bin, the log ratio of the learned density to uniform, the tonal
//! detector's third way of being no vessel. Distant shipping, surf and a shaking frame prefer directions; a detector
//! that believes noise uniform takes them for vessels. Sectors of 22.5 degrees, read linearly between centres; half of
//! the density stays uniform, so a passing vessel can never be learned away. Memory 1024 frames (3 h).

use super::limits::{AZIMUTH_BINS, CIRCLE};
use super::row::Row;
use crate::math;

/// Sectors of the circle.
const SECTORS: usize = 16;

/// Codes of one sector.
const WIDTH: usize = CIRCLE / SECTORS;

/// Frames after which an observation has faded to 1/e, as a power of two.
const MEMORY: u32 = 10;

/// Full scale of a stored share: a sector that is always pointed at.
const ONE: i32 = 1 << 15;

/// Learned shares of every sector in every bin.
///
/// Each share is kept as a difference from uniform, so that nothing learned is all zeros.
#[derive(Clone, Debug)]
pub struct Ambient {
    excess: [[i16; SECTORS]; AZIMUTH_BINS],
}

/// A uniform share.
const UNIFORM: i32 = ONE / SECTORS as i32;

/// Memory as a factor.
const FADE: i32 = 1 << MEMORY;

impl Ambient {
    /// Nothing learned.
    pub const fn new() -> Self {
        Self { excess: [[0; SECTORS]; AZIMUTH_BINS] }
    }

    /// Forgets everything, in place.
    pub(super) fn forget(&mut self) {
        self.excess.as_flattened_mut().fill(0);
    }

    /// Learns one frame.
    pub fn learn(&mut self, row: &Row) {
        for (excess, direction) in self.excess.iter_mut().zip(row.directions()) {
            let Some((azimuth, _)) = direction else { continue };
            let hit = usize::from(azimuth) / WIDTH;
            // Rounded to the nearest: an unvisited sector keeps a quarter of its uniform share.
            let learnt = |x: i16, target: i32| {
                let step = (target - i32::from(x) + (FADE / 2)).div_euclid(FADE);
                (i32::from(x) + step) as i16
            };
            let before = excess.get(hit).copied();
            excess.iter_mut().for_each(|x| *x = learnt(*x, -UNIFORM));
            if let (Some(x), Some(before)) = (excess.get_mut(hit), before) {
                *x = learnt(before, ONE - UNIFORM);
            }
        }
    }

    /// ln of the product over frames of (learned density / uniform).
    pub fn log_ratio(&self, bin: usize, codes: &[u16]) -> f32 {
        let Some(excess) = self.excess.get(bin) else { return 0.0 };
        let density = |k: usize| {
            (1.0 + f32::from(excess.get(k % SECTORS).copied().unwrap_or(0)) / UNIFORM as f32).max(0.0)
        };
        // Each factor lies between 1/2 and 8.5 and a window has at most 24: the product stays in range.
        let product: f32 = codes
            .iter()
            .map(|c| {
                let x = usize::from(*c) + CIRCLE - WIDTH / 2;
                let (k, part) = (x / WIDTH, (x % WIDTH) as f32 / WIDTH as f32);
                let d = density(k) * (1.0 - part) + density(k + 1) * part;
                0.5 + 0.5 * d
            })
            .product();
        math::f32::ln(product)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn learns_a_direction_and_stays_bounded() {
        let mut a = Ambient::new();
        assert!(a.log_ratio(0, &[5, 900]).abs() < 1e-3);
        let mut row = Row::EMPTY;
        for k in 0..5000u32 {
            let azimuth = if k % 2 == 0 { 100 } else { (k * 37 % 1024) as u16 };
            row.fill((0..4).map(|bin| (bin == 3).then_some((azimuth, 0))));
            a.learn(&row);
        }
        let towards = a.log_ratio(3, &[100]);
        let elsewhere = a.log_ratio(3, &[600]);
        assert!(towards > 1.0 && towards < 2.2, "{towards}");
        assert!(elsewhere < -0.1 && elsewhere > -0.7, "{elsewhere}");
        assert!(a.log_ratio(4, &[600]).abs() < 1e-3);
    }
}
