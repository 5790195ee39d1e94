//! Complex numbers: those of `num-complex`, with the elementary functions of the project's one float shim.

use crate::math::f64 as m;

/// A complex number.
pub type Complex = num_complex::Complex<f64>;

/// `e^{i angle}`.
pub fn unit(angle: f64) -> Complex {
    let (s, c) = m::sin_cos(angle);
    Complex::new(c, s)
}

/// Size.
pub fn norm(z: Complex) -> f64 {
    m::hypot(z.re, z.im)
}

/// Phase, radians.
pub fn phase(z: Complex) -> f64 {
    m::atan2(z.im, z.re)
}

/// Reciprocal; zero for zero.
pub fn recip(z: Complex) -> Complex {
    let n = z.norm_sqr();
    if n > 0.0 { z.conj().scale(1.0 / n) } else { Complex::ZERO }
}
