//! All roots of a complex polynomial by simultaneous iteration (Aberth and Ehrlich), in fixed memory.

use super::MAX_SENSORS;
use super::complex::{Complex, recip, unit};

/// Most coefficients: the noise polynomial of m sensors has 2m − 1.
pub const MAX_COEFFICIENTS: usize = 2 * MAX_SENSORS - 1;

/// Most rounds; well separated roots take ten, the near-double ones on the unit circle some forty.
const ROUNDS: u32 = 200;

/// Roots of `Σ c_k z^k`; the first `coefficients.len() − 1` of `roots` are set. Returns how many, zero where the leading
/// coefficient vanishes or something is not finite.
pub fn roots(coefficients: &[Complex], roots: &mut [Complex; MAX_COEFFICIENTS]) -> usize {
    let degree = coefficients.len().saturating_sub(1);
    let Some(lead) = coefficients.last() else { return 0 };
    if degree == 0 || degree > MAX_COEFFICIENTS || !(lead.norm_sqr() > 0.0) {
        return 0;
    }
    // Start: two rings near the unit circle at angles without symmetry, so that no two move alike.
    for (k, z) in roots.iter_mut().take(degree).enumerate() {
        let radius = if k % 2 == 0 { 0.8 } else { 1.25 };
        let angle = crate::math::f64::TAU * k as f64 / degree as f64 + 0.4;
        *z = unit(angle).scale(radius);
    }
    for _ in 0..ROUNDS {
        let before = *roots;
        let mut largest = 0.0f64;
        for (k, z) in roots.iter_mut().take(degree).enumerate() {
            let (value, slope) = horner(coefficients, *z);
            let newton = value * recip(slope);
            let mut push = Complex::ZERO;
            for (_, other) in before.iter().take(degree).enumerate().filter(|(j, _)| *j != k) {
                push += recip(*z - *other);
            }
            let step = newton * recip(Complex::new(1.0, 0.0) - newton * push);
            *z -= step;
            largest = largest.max(step.norm_sqr());
        }
        if !largest.is_finite() {
            return 0;
        }
        if largest < 1e-26 {
            break;
        }
    }
    degree
}

/// Value and derivative.
fn horner(coefficients: &[Complex], z: Complex) -> (Complex, Complex) {
    let (mut value, mut slope) = (Complex::ZERO, Complex::ZERO);
    for c in coefficients.iter().rev() {
        slope = slope * z + value;
        value = value * z + *c;
    }
    (value, slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_of_unity() {
        let mut c = [Complex::ZERO; 37];
        c[0] = Complex::new(-1.0, 0.0);
        c[36] = Complex::new(1.0, 0.0);
        let mut found = [Complex::ZERO; MAX_COEFFICIENTS];
        assert_eq!(roots(&c, &mut found), 36);
        for k in 0..36 {
            let z = unit(core::f64::consts::TAU * f64::from(k) / 36.0);
            assert!(found[..36].iter().any(|r| super::super::complex::norm(*r - z) < 1e-9), "{k}");
        }
        assert_eq!(roots(&c[..1], &mut found), 0);
        assert_eq!(roots(&[Complex::ZERO; 4], &mut found), 0);
    }
}
