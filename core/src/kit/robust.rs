//! Robust losses and weights: measurements that are wrong altogether hardly pull.
//!
//! In: a residual in standard deviations of a good measurement. Out: its loss (½r² for a Gaussian error), and the weight
//! `ρ'(r)/r` by which its square is multiplied in reweighted least squares. P. J. Huber, Ann. Math. Statist. 35, 1964;
//! A. E. Beaton and J. W. Tukey, Technometrics 16, 1974.

use crate::math::f64 as m;

/// Standard deviation of a Gaussian over its median absolute deviation.
pub const MAD_TO_SD: f64 = 1.4826;

/// Squares up to a corner, straight beyond: no measurement pulls more than one at the corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Huber {
    /// Where squares end, standard deviations.
    pub corner: f64,
}

impl Huber {
    /// The corner with 95 % efficiency for Gaussian errors.
    pub const EFFICIENT: Self = Self { corner: 1.345 };

    /// Loss.
    pub fn loss(self, r: f64) -> f64 {
        let size = m::abs(r);
        if size <= self.corner { 0.5 * size * size } else { self.corner * (size - 0.5 * self.corner) }
    }

    /// Weight.
    pub fn weight(self, r: f64) -> f64 {
        self.corner / m::abs(r).max(self.corner)
    }

    /// The residual brought inside the corner: its square is what it counts in a misfit.
    pub fn clipped(self, r: f64) -> f64 {
        r.max(-self.corner).min(self.corner)
    }
}

/// What lies beyond a corner counts for nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tukey {
    /// Where measurements stop to count, standard deviations.
    pub corner: f64,
}

impl Tukey {
    /// The corner with 95 % efficiency for Gaussian errors.
    pub const EFFICIENT: Self = Self { corner: 4.685 };

    /// Loss, at most a sixth of the corner's square.
    pub fn loss(self, r: f64) -> f64 {
        let u = self.inside(r);
        self.corner * self.corner / 6.0 * (1.0 - u * u * u)
    }

    /// Weight.
    pub fn weight(self, r: f64) -> f64 {
        let u = self.inside(r);
        u * u
    }

    fn inside(self, r: f64) -> f64 {
        (1.0 - (r / self.corner) * (r / self.corner)).max(0.0)
    }
}

/// Errors with Student's law; one degree of freedom is Cauchy's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Student {
    /// Degrees of freedom.
    pub freedom: f64,
}

impl Student {
    /// Loss: the negative logarithm of the density over its greatest value.
    pub fn loss(self, r: f64) -> f64 {
        0.5 * (self.freedom + 1.0) * m::ln_1p(r * r / self.freedom)
    }

    /// Weight.
    pub fn weight(self, r: f64) -> f64 {
        (self.freedom + 1.0) / (self.freedom + r * r)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(seabearing_testkit::property(256))]

        /// The weight is the slope of the loss over the residual, for each of them.
        #[test]
        fn weights_are_slopes_of_losses(r in 0.01f64..20.0, corner in 0.5f64..6.0) {
            let h = 1e-5;
            let (huber, tukey, student) = (Huber { corner }, Tukey { corner }, Student { freedom: corner });
            let slope = |loss: &dyn Fn(f64) -> f64| (loss(r + h) - loss(r - h)) / (2.0 * h * r);
            prop_assert!((slope(&|x| huber.loss(x)) - huber.weight(r)).abs() < 1e-3);
            prop_assert!((slope(&|x| tukey.loss(x)) - tukey.weight(r)).abs() < 1e-3);
            prop_assert!((slope(&|x| student.loss(x)) - student.weight(r)).abs() < 1e-3);
            prop_assert_eq!(huber.weight(-r), huber.weight(r));
            prop_assert!(huber.clipped(-r) == -huber.clipped(r) && huber.clipped(r) <= corner);
        }
    }

    #[test]
    fn small_residuals_count_as_squares() {
        for r in [-0.01, 0.0, 0.02] {
            assert_eq!(Huber::EFFICIENT.loss(r), 0.5 * r * r);
            assert!((Tukey::EFFICIENT.loss(r) - 0.5 * r * r).abs() < 1e-8);
            assert!((Student { freedom: 1e9 }.loss(r) - 0.5 * r * r).abs() < 1e-8);
        }
        assert_eq!(Tukey::EFFICIENT.weight(5.0), 0.0);
        assert_eq!(Student { freedom: 1.0 }.weight(3.0), 0.2);
    }
}
