//! Whether what is left about courses is a misfit and no noise.
//!
//! In: standardised residuals of an angle of an array in order of time. Out: whether they go in runs: means of a tenth of the record each
//! that are far beyond what was stated of a single angle, and hold most of the scatter. Errors that are larger than stated, also those
//! that last for many bearings, average out within a tenth; a turn, a change of speed or a second vessel does not, and every array shows it
//! alike.
//!
//! Not seen: a misfit within what was stated; taken for one: errors that last for a tenth of the record and are as large.

use super::HUBER;
use crate::kit::{MAD_TO_SD, order_statistic};
use crate::math::f64 as m;

/// Means of a record.
const MEANS: usize = 10;
/// Fewest residuals of an angle: of fewer ones the means have a fourth of white noise.
const LEAST: usize = 4 * MEANS;
/// Root mean square of the means, in stated deviations, and their least share of all squares.
const FAR: f64 = 3.0;
const SHARE: f64 = 0.7;

/// Sums over arrays and angles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Runs {
    /// Number, sum of squares, and sum of the means' squares, of as many residuals each.
    n: f64,
    squares: f64,
    means: f64,
}

impl Runs {
    /// Takes the residuals of an angle of an array, in stated deviations.
    pub fn take(&mut self, residuals: impl Iterator<Item = f64> + Clone) {
        let n = residuals.clone().count();
        let Some(middle) = order_statistic(residuals.clone().map(m::abs), 0.5) else { return };
        if n < LEAST || !(middle > 0.0) {
            return;
        }
        let sd = MAD_TO_SD * middle;
        let mut sums = [(0.0, 0.0); MEANS];
        for (k, r) in residuals.enumerate() {
            // Single wrong bearings are no run.
            let r = sd * HUBER.clipped(r / sd);
            self.squares += r * r;
            if let Some((sum, count)) = sums.get_mut(k * MEANS / n) {
                (*sum, *count) = (*sum + r, *count + 1.0);
            }
        }
        self.n += n as f64;
        self.means += sums.iter().map(|(sum, count)| sum * sum / f64::max(*count, 1.0)).sum::<f64>();
    }

    /// Whether no noise has such runs.
    pub fn no_noise(&self) -> bool {
        self.n > 0.0 && self.means > FAR * FAR * self.n && self.means > SHARE * self.squares
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(seabearing_testkit::property(32))]

        /// Noise ten times as large as stated, white or with nine tenths in common, has none; a bend does.
        #[test]
        fn a_bend_is_told_from_noise(seed in 1u64..1_000_000, common in 0.0f64..0.9) {
            let mut x = seed;
            let mut e = 0.0;
            let mut noise = || {
                let mut sum = 0.0;
                for _ in 0..12 {
                    x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    sum += (x >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
                }
                e = common * e + (1.0 - common * common).sqrt() * sum;
                10.0 * e
            };
            let (mut plain, mut bent) = (Runs::default(), Runs::default());
            for _ in 0..3 {
                let residuals: std::vec::Vec<f64> = (0..400).map(|_| noise()).collect();
                plain.take(residuals.iter().copied());
                let bend = |k: usize| { let u = (k as f64 - 200.0) / 200.0; 90.0 * (u * u - 1.0 / 3.0) };
                bent.take(residuals.iter().enumerate().map(|(k, r)| r + bend(k)));
            }
            prop_assert!(!plain.no_noise(), "{plain:?} {common}");
            prop_assert!(bent.no_noise(), "{bent:?} {common}");
        }
    }
}
