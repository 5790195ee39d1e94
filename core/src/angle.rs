//! Angles: radians inside, wrapped differences only, degrees at a person's side.
//!
//! Azimuth is clockwise from true North in [0, 2π), elevation up from the horizontal in [−π/2, π/2].

use crate::math;

/// Radians in one degree.
pub const RAD_PER_DEG: f64 = core::f64::consts::PI / 180.0;

/// An angle brought into [0, 2π). Non-finite input gives 0.
#[inline(never)]
pub fn wrap_tau(a: f64) -> f64 {
    if !math::f64::abs(a).is_finite() {
        return 0.0;
    }
    let t = a - math::f64::TAU * math::f64::floor(a / math::f64::TAU);
    if (0.0..math::f64::TAU).contains(&t) { t } else { 0.0 }
}

/// An angle brought into (−π, π]. Non-finite input gives 0.
pub fn wrap_pi(a: f64) -> f64 {
    if a > -math::f64::PI && a <= math::f64::PI {
        return a;
    }
    let t = wrap_tau(a);
    if t > math::f64::PI { t - math::f64::TAU } else { t }
}

/// Single-precision [`wrap_tau`].
#[inline(never)]
pub fn wrap_tau_f32(a: f32) -> f32 {
    if !a.is_finite() {
        return 0.0;
    }
    let t = a - math::f32::TAU * math::f32::floor(a / math::f32::TAU);
    if (0.0..math::f32::TAU).contains(&t) { t } else { 0.0 }
}

/// Single-precision [`wrap_pi`].
#[inline(never)]
pub fn wrap_pi_f32(a: f32) -> f32 {
    let t = wrap_tau_f32(a);
    if t > math::f32::PI { t - math::f32::TAU } else { t }
}

/// Unit vector (East, North, Up) of an azimuth and an elevation, both in radians.
pub fn unit_vector(azimuth: f32, elevation: f32) -> [f32; 3] {
    let (sa, ca) = math::f32::sin_cos(azimuth);
    let (se, ce) = math::f32::sin_cos(elevation);
    [sa * ce, ca * ce, se]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrapping_covers_the_circle_and_rejects_nonsense() {
        assert_eq!(wrap_tau(-0.5), math::f64::TAU - 0.5);
        assert!((wrap_pi(3.5 * math::f64::PI) + 0.5 * math::f64::PI).abs() < 1e-12);
        assert_eq!(wrap_pi(f64::NAN), 0.0);
        assert_eq!(wrap_tau_f32(f32::INFINITY), 0.0);
        assert!(wrap_tau(-1e-20) < math::f64::TAU);
        assert!(wrap_tau_f32(-1e-12) < math::f32::TAU);
    }

    #[test]
    fn east_is_ninety_degrees() {
        let u = unit_vector(math::f32::FRAC_PI_2, 0.0);
        assert!((u[0] - 1.0).abs() < 1e-6 && u[1].abs() < 1e-6 && u[2].abs() < 1e-6);
    }
}
