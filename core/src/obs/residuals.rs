//! What the residuals of a fitted course say about its errors: larger than stated, and alike from minute to minute.
//!
//! Enters: residuals over their stated standard deviations, minute by minute, each with the chance that it is this vessel's.
//! Leaves: by how much the variance of the fit exceeds that from independent errors of the stated size:
//! `s² (1 + ρ) / (1 − ρ)`, with s² their mean square and ρ the correlation of one with the next (an autoregression of first
//! order). Windows overlap and the range posterior remembers, which alone makes it three; the way of a real vessel bends, and
//! then residuals lean to one side for an hour. Cost: ten operations a residual.

/// Excess of errors of the stated size, of windows that overlap and a posterior that remembers.
pub const OVERLAPPED: f64 = 3.0;

/// Greatest correlation believed: errors that last for half an hour.
const MOST_ALIKE: f64 = 0.94;

/// Residuals of one kind.
#[derive(Clone, Copy, Debug, Default)]
pub struct Residuals {
    /// Sum of weighted squares, and of weights.
    squares: (f64, f64),
    /// The same of products of one with the next.
    products: (f64, f64),
    last: (f64, f64),
}

impl Residuals {
    /// Takes the next: the residual over its standard deviation, and its weight between 0 and 1.
    pub fn take(&mut self, z: f64, weight: f64) {
        let (before, its_weight) = self.last;
        self.squares.0 += weight * z * z;
        self.squares.1 += weight;
        self.products.0 += weight * its_weight * z * before;
        self.products.1 += weight * its_weight;
        self.last = (z, weight);
    }

    /// By how much the variance exceeds that of independent errors of the stated size; never below [`OVERLAPPED`].
    pub fn excess(&self) -> f64 {
        let mean = |(sum, weight): (f64, f64)| if weight > 1.0 { sum / weight } else { 0.0 };
        let square = mean(self.squares);
        if square <= 0.0 {
            return OVERLAPPED;
        }
        let alike = (mean(self.products) / square).clamp(0.0, MOST_ALIKE);
        (square * (1.0 + alike) / (1.0 - alike)).max(OVERLAPPED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;

    /// Standard normal numbers, each the share `alike` of the one before.
    fn excess(alike: f64, sd: f64) -> f64 {
        let (mut residuals, mut seed, mut z) = (Residuals::default(), 11u32, 0.0);
        for _ in 0..20_000 {
            let mut normal = -6.0;
            for _ in 0..12 {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                normal += f64::from(seed >> 8) / 16_777_216.0;
            }
            z = alike * z + math::f64::sqrt(1.0 - alike * alike) * normal;
            residuals.take(sd * z, 1.0);
        }
        residuals.excess()
    }

    #[test]
    fn errors_that_are_larger_or_alike_count_for_less() {
        assert_eq!(Residuals::default().excess(), OVERLAPPED);
        assert_eq!(excess(0.0, 1.0), OVERLAPPED);
        let larger = excess(0.0, 3.0);
        assert!((larger - 9.0).abs() < 0.5, "{larger}");
        let alike = excess(0.8, 1.0);
        assert!((alike - 9.0).abs() < 1.0, "{alike}");
        // What never changes sign is no more than believed.
        assert!(excess(0.999, 1.0) < 40.0);
    }
}
