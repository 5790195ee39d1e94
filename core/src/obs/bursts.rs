//! What the bursts of a frame add to its steady sound: the direction of a call beside a vessel.
//!
//! Enters: a frame's samples of pressure, north and east. Leaves: the active intensity of the bursts that stand out, less that of as many others,
//! and how well its direction is known. Intensities add: a vessel's, which is in a call's bursts as in those between, goes out.
//! Cost: 150 k instructions, in frames that may hold a call.

use super::impulsive::{BURST, Calls};
use super::limits::{FRAME, HOP, USED_CHANNELS};
use crate::math;

/// Bursts of a frame.
const BURSTS: usize = FRAME / BURST;

/// Energy over the mean of steady bursts up to which one is steady, and from which on it stands out: a burst of noise scatters by nearly a half, and
/// those that a vessel's noise lifts over the threshold have more of it than others.
const STEADY: f32 = 2.5;
const LOUD: f32 = 4.0;

/// Rounds in which the mean of steady bursts is found.
const ROUNDS: usize = 6;

/// Fewest steady bursts that tell what is steady.
const LEAST: f32 = 6.0;

/// Steps of a stored deviation in a radian.
const STEPS: f32 = 128.0;

/// What stands out of a frame, in six bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Excess {
    /// Upper halves of its intensity to east and north.
    towards: [u16; 2],
    /// Standard deviation of its direction.
    sd: u8,
}

/// Energy, and intensity to east and north.
type Burst = [f32; 3];

impl Excess {
    /// Nothing stands out; all zeros.
    pub(super) const NONE: Self = Self { towards: [0; 2], sd: 0 };

    /// Of an intensity to east and north, and the standard deviation of its direction, rad.
    pub(super) fn new(towards: [f32; 2], sd: f32) -> Self {
        let sd = (sd * STEPS + 0.5).clamp(1.0, 255.0) as u8;
        Self { towards: towards.map(|x| (x.to_bits() >> 16) as u16), sd }
    }

    /// Intensity to east and north, and the standard deviation of its direction, rad; nothing where nothing stands out.
    pub(super) fn get(self) -> Option<([f32; 2], f32)> {
        let towards = self.towards.map(|x| f32::from_bits(u32::from(x) << 16));
        (towards != [0.0; 2]).then_some((towards, f32::from(self.sd) / STEPS))
    }

    /// Of a frame.
    // Its work space is not the frame's.
    #[inline(never)]
    pub(super) fn of(
        calls: &Calls,
        old: &[[f32; HOP]; USED_CHANNELS],
        new: &[[f32; HOP]; USED_CHANNELS],
    ) -> Self {
        let mut bursts = [[0f32; 3]; BURSTS];
        let mut past = [[[0f32; 4]; 2]; USED_CHANNELS];
        for (half, [p, n, e]) in bursts.chunks_exact_mut(BURSTS / 2).zip([old, new]) {
            for (k, ((p, n), e)) in p.iter().zip(n).zip(e).enumerate() {
                let [of_p, of_n, of_e] = &mut past;
                let [p, n, e] = [(of_p, p), (of_n, n), (of_e, e)].map(|(past, x)| in_band(calls, past, *x));
                if let Some([energy, east, north]) = half.get_mut(k / BURST) {
                    *energy += p * p;
                    *east += p * e;
                    *north += p * n;
                }
            }
        }
        // The filter begins in the first.
        Self::among(bursts.get(1..).unwrap_or_default())
    }

    fn among(bursts: &[Burst]) -> Self {
        // The mean of all, then of those not far above it.
        let (mut most, mut count, mut mean) = (f32::INFINITY, 0f32, [0f32; 3]);
        for _ in 0..ROUNDS {
            (count, mean) = sums(bursts, -1.0, most);
            mean = mean.map(|m| m / count);
            most = STEADY * mean[0];
        }
        let (loud, sum) = sums(bursts, LOUD * mean[0], f32::INFINITY);
        let [energy, east, north]: Burst = core::array::from_fn(|k| sum[k] - loud * mean[k]);
        let length = math::f32::sqrt(east * east + north * north);
        if count < LEAST || loud == 0.0 || !(length > 0.0 && length < f32::MAX) {
            return Self::NONE;
        }
        // Scatter of steady bursts across the direction; the call beats with what is steady by twice that for each part it is louder.
        let across = bursts.iter().filter(|b| b[0] <= most).map(|b| {
            let x = ((b[1] - mean[1]) * north - (b[2] - mean[2]) * east) / length;
            x * x
        });
        let variance = across.sum::<f32>() / (count - 1.0);
        let times = loud + loud * loud / count + 2.0 * energy / mean[0];
        Self::new([east, north], math::f32::sqrt(variance * times) / length)
    }
}

/// How many bursts have more energy than one and no more than another, and their sum.
#[inline(never)]
fn sums(bursts: &[Burst], above: f32, most: f32) -> (f32, Burst) {
    let (mut count, mut sum) = (0.0, [0f32; 3]);
    for b in bursts.iter().filter(|b| b[0] > above && b[0] <= most) {
        count += 1.0;
        sum.iter_mut().zip(b).for_each(|(s, x)| *s += x);
    }
    (count, sum)
}

/// A sample about the notes of whales. Once in the image: three channels share it.
#[inline(never)]
fn in_band(calls: &Calls, past: &mut [[f32; 4]; 2], x: f32) -> f32 {
    calls.notes.filter(past, x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame of a steady source at one azimuth and a note at another, both plane waves with velocities towards them, and a little sea.
    fn frame(seed: u32, steady: f32, level: f32, note: f32) -> [[[f32; HOP]; 3]; 2] {
        let mut seed = seed;
        let mut noise = || {
            let mut sum = 0.0;
            for _ in 0..6 {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum += (seed >> 8) as f32 / 8_388_608.0 - 1.0;
            }
            sum
        };
        let mut out = [[[0.0; HOP]; 3]; 2];
        for k in 0..FRAME {
            let s = level * noise();
            let c = if k % 512 < 60 { 12.0 * math::f32::sin(k as f32 * 2.4) } else { 0.0 };
            let x = [
                s + c,
                s * math::f32::cos(steady) + c * math::f32::cos(note),
                s * math::f32::sin(steady) + c * math::f32::sin(note),
            ];
            for (channel, x) in out[k / HOP].iter_mut().zip(x) {
                channel[k % HOP] = x + 0.3 * noise();
            }
        }
        out
    }

    #[test]
    fn a_steady_source_does_not_turn_a_call_and_the_deviation_holds() {
        let mut calls = Calls::EMPTY;
        calls.fill(50.0);
        for level in [0.0, 1.0, 1.5] {
            let (mut inside, mut all, mut sum) = (0, 0, 0.0);
            for seed in 0..60 {
                let [old, new] = frame(17 + 1000 * seed, 2.6, level, 1.0);
                let Some(([east, north], sd)) = Excess::of(&calls, &old, &new).get() else { continue };
                let off = crate::angle::wrap_pi_f32(math::f32::atan2(east, north) - 1.0);
                all += 1;
                sum += off;
                inside += usize::from(math::f32::abs(off) < 1.96 * sd);
                assert!(sd < 0.25, "{level}: {off} {sd}");
            }
            assert!(all >= 55 && inside * 100 >= 88 * all, "{level}: {inside} of {all}");
            assert!(math::f32::abs(sum / all as f32) < 0.03, "{level}: {}", sum / all as f32);
        }
    }

    #[test]
    fn of_steady_sound_alone_little_stands_out() {
        let mut calls = Calls::EMPTY;
        calls.fill(50.0);
        let quiet = (0..60).filter(|seed| {
            let [old, new] = frame(17 + 1000 * seed, 2.6, 1.0, 1.0).map(|half| {
                let mut half = half;
                half.iter_mut().for_each(|c| (0..60).for_each(|k| c[k] = c[k + 100]));
                half
            });
            Excess::of(&calls, &old, &new) == Excess::NONE
        });
        assert!(quiet.count() >= 40);
        assert_eq!(Excess::NONE.get(), None);
        let [east, north] = Excess::new([-3.0e9, 1.0e9], 0.1).get().unwrap().0;
        assert!(math::f32::abs(east / -3.0e9 - 1.0) < 0.01 && math::f32::abs(north / 1.0e9 - 1.0) < 0.01);
    }
}
