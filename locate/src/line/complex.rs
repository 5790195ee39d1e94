//! Complex numbers, the few operations subspace methods need.

use crate::math::f64 as m;
use core::ops::{Add, Mul, Sub};

/// A complex number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Complex {
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
}

impl Complex {
    /// Zero.
    pub const ZERO: Self = Self { re: 0.0, im: 0.0 };

    /// From its parts.
    pub const fn new(re: f64, im: f64) -> Self {
        Self { re, im }
    }

    /// `e^{i angle}`.
    pub fn unit(angle: f64) -> Self {
        let (s, c) = m::sin_cos(angle);
        Self::new(c, s)
    }

    /// Complex conjugate.
    pub fn conj(self) -> Self {
        Self::new(self.re, -self.im)
    }

    /// Squared size.
    pub fn norm_squared(self) -> f64 {
        self.re * self.re + self.im * self.im
    }

    /// Size.
    pub fn norm(self) -> f64 {
        m::hypot(self.re, self.im)
    }

    /// Phase, radians.
    pub fn phase(self) -> f64 {
        m::atan2(self.im, self.re)
    }

    /// Times a real number.
    pub fn scale(self, k: f64) -> Self {
        Self::new(self.re * k, self.im * k)
    }

    /// Reciprocal; zero for zero.
    pub fn recip(self) -> Self {
        let n = self.norm_squared();
        if n > 0.0 { self.conj().scale(1.0 / n) } else { Self::ZERO }
    }
}

impl Add for Complex {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self::new(self.re + o.re, self.im + o.im)
    }
}

impl Sub for Complex {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self::new(self.re - o.re, self.im - o.im)
    }
}

impl Mul for Complex {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self::new(self.re * o.re - self.im * o.im, self.re * o.im + self.im * o.re)
    }
}
