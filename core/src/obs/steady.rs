//! Steady noise from one side: what it adds to the intensity of every bin, learned while no vessel is heard.
//!
//! Enters: the mean intensity about the middle of each part of the band, frame by frame ([`Background`](super::background)). Leaves: a bin's
//! intensity without that of the steady noise, and by how much more than stated directions scatter where much of what is heard is such
//! noise. Distant shipping or surf on one side goes with a vessel's sound in every bin and turns its directions towards itself, by degrees
//! where it is as loud; intensities add, so what was there before the vessel is taken out. A line that stands out of the bins about it is
//! straightened by these and left as it is.
//! Assumes: noise that changes slowly against 1.5 h. A vessel that is there from the first minute leaves nothing to learn from.

use super::limits::AZIMUTH_BINS;
use super::tonal::Directions;
use crate::math;

/// Intensity of a bin, east and north.
type Vector = [f32; 2];

/// Parts of the band, each with a mean: 3.3 Hz at 50 Hz, of which a frame's mean is.
const PARTS: usize = 4;

/// Bins of a part.
const BINS: usize = AZIMUTH_BINS.div_ceil(PARTS);

/// Frames of silence that a mean counts for from the first: that of a few frames is chance.
const BEFORE: u16 = 16;

/// Frames that a mean is of in the long run (1.5 h at 50 Hz).
const MEMORY: u16 = 512;

/// Share that a part of a frame has in [`Steady::share`]: three minutes' parts.
const NEWEST: f32 = 1.0 / (18 * PARTS) as f32;

/// Power of a bin over that of the noise about it up to which the noise is not in this bin: one that a filter has cut off before the recorder,
/// at the band's upper end, would point away from the noise.
const ABSENT: f32 = 1.0 / 16.0;

/// What is known of the steady noise.
#[derive(Clone, Debug)]
pub struct Steady {
    mean: [Vector; PARTS],
    /// Its part of the power of the mean intensities of late, 0 to 1.
    share: f32,
    frames: u16,
    /// No vessel and no call was heard in the last minute: its frames are those of the noise.
    pub(super) learns: bool,
}

fn power([x, y]: Vector) -> f32 {
    x * x + y * y
}

impl Steady {
    /// Nothing learned; all zeros.
    pub const fn new() -> Self {
        Self { mean: [[0.0; 2]; PARTS], share: 0.0, frames: 0, learns: false }
    }

    /// A frame's mean intensity about a bin.
    #[inline(never)]
    pub(super) fn see(&mut self, bin: usize, around: Vector) {
        if bin % BINS != BINS / 2 {
            return;
        }
        let Some(mean) = self.mean.get_mut(bin / BINS) else { return };
        let (own, all) = (power(*mean), power(around));
        let part = if own < all { own / all } else { 1.0 };
        self.share += NEWEST * (if own > 0.0 { part } else { 0.0 } - self.share);
        if self.learns {
            // The first part counts the frame.
            self.frames = (self.frames + u16::from(bin < BINS)).min(MEMORY - BEFORE);
            let newest = 1.0 / f32::from(BEFORE + self.frames);
            mean.iter_mut().zip(around).for_each(|(m, x)| *m += newest * (x - *m));
        }
    }

    /// A bin's intensity without that of the noise; none stays none.
    #[inline(never)]
    pub(super) fn without(&self, bin: usize, own: &Vector) -> Vector {
        let ([x, y], Some([bx, by])) = (*own, self.mean.get(bin / BINS)) else { return *own };
        if power(*own) > ABSENT * power([*bx, *by]) { [x - bx, y - by] } else { *own }
    }

    /// Noise taken out in the mean is there from frame to frame, and what of a bin's directions it throws beyond the limit of a vessel's does not
    /// show in their scatter: with nearly all of it noise directions err by 1.4 times what they would state (measured, a vessel 11 dB below it),
    /// with half of it as they state.
    #[inline(never)]
    pub(super) fn widen(&self, directions: &mut Directions) {
        let factor = math::f32::sqrt(1.0 + self.share * self.share);
        directions.modes.iter_mut().flatten().for_each(|m| m.sd *= factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn gaussian(seed: &mut u32) -> f32 {
        let mut sum = -6.0;
        for _ in 0..12 {
            *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum += (*seed >> 8) as f32 / 16_777_216.0;
        }
        sum
    }

    /// Intensities of a frame: noise of power 2 from the east, a vessel of some power from the north, a sea without a direction of power 1.
    fn frame(vessel: f32, seed: &mut u32) -> Vec<Vector> {
        let bin = |_| {
            let mut wave = |power: f32| [(); 2].map(|()| gaussian(seed) * math::f32::sqrt(0.5 * power));
            let (noise, ship) = (wave(2.0), wave(vessel));
            let own = [wave(1.0), wave(1.0), wave(1.0)];
            let pressure = [0, 1].map(|k| noise[k] + ship[k] + own[0][k]);
            let with =
                |w: [f32; 2], own: [f32; 2]| pressure[0] * (w[0] + own[0]) + pressure[1] * (w[1] + own[1]);
            [with(noise, own[1]), with(ship, own[2])]
        };
        (0..AZIMUTH_BINS).map(bin).collect()
    }

    fn see(steady: &mut Steady, bins: &[Vector]) {
        let mut mean = [0.0; 2];
        bins.iter().for_each(|z| mean.iter_mut().zip(z).for_each(|(m, x)| *m += x / bins.len() as f32));
        (0..bins.len()).for_each(|bin| steady.see(bin, mean));
    }

    /// Angle from north of the mean intensity of a vessel's bins in a hundred frames, degrees.
    fn towards(steady: &Steady, seed: &mut u32) -> f32 {
        let frames = (0..100).flat_map(|_| frame(4.0, seed).into_iter().enumerate());
        let all = frames.map(|(bin, own)| steady.without(bin, &own));
        let [x, y] = all.fold([0.0; 2], |[a, b], [x, y]| [a + x, b + y]);
        math::f32::atan2(x, y).to_degrees()
    }

    #[test]
    fn noise_that_was_there_before_a_vessel_bends_its_directions_no_more() {
        let (mut steady, mut seed) = (Steady::new(), 5);
        assert!(towards(&steady, &mut seed) > 20.0);
        steady.learns = true;
        (0..400).for_each(|_| see(&mut steady, &frame(0.0, &mut seed)));
        assert!(steady.share > 0.9, "{}", steady.share);
        steady.learns = false;
        (0..100).for_each(|_| see(&mut steady, &frame(4.0, &mut seed)));
        assert!(towards(&steady, &mut seed).abs() < 3.0, "{}", towards(&steady, &mut seed));
        // Of what is heard a fifth is the noise's: 2² of 2² + 4².
        assert!((steady.share - 0.2).abs() < 0.1, "{}", steady.share);
    }

    #[test]
    fn of_a_sea_without_sides_nothing_is_taken_and_nothing_stays_nothing() {
        let (mut steady, mut seed) = (Steady::new(), 8);
        assert_eq!(steady.without(3, &[1.0, 2.0]), [1.0, 2.0]);
        steady.learns = true;
        for _ in 0..500 {
            let sea: Vec<Vector> =
                (0..AZIMUTH_BINS).map(|_| [gaussian(&mut seed), gaussian(&mut seed)]).collect();
            see(&mut steady, &sea);
        }
        assert!(steady.mean.iter().all(|m| power(*m) < 1e-4) && steady.share < 0.05, "{steady:?}");
        assert_eq!(steady.without(3, &[0.0; 2]), [0.0; 2]);
        // Of a bin that hardly has anything neither.
        steady.mean = [[1.0, 0.0]; PARTS];
        assert_eq!(steady.without(260, &[0.0, 0.2]), [0.0, 0.2]);
        assert_eq!(steady.without(260, &[2.0, 1.0]), [1.0, 1.0]);
        let mode = crate::obs::tonal::Mode {
            azimuth: 1.0,
            sd: 0.02,
            log_presence: 20.0,
            bins: 9,
            step: 3,
            impulsive: false,
        };
        let mut directions =
            Directions { modes: [Some(mode), None, None], log_presence: 20.0, log_below: 0.0, frames: 17 };
        steady.share = 1.0;
        steady.widen(&mut directions);
        assert!((directions.modes[0].unwrap().sd - 0.028_28).abs() < 1e-4);
    }
}
