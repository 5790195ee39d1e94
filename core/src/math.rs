//! The one float shim: every elementary function of the core goes through here, on the host and on the target.
//!
//! All functions are `libm`'s portable ones, so the same bits come out everywhere (`std`'s own are never used:
//! they differ between platforms in the last bit). Errors: below 1 unit in the last place for `sin`, `cos`,
//! `atan2`, `ln`, `exp`; `sqrt`, `floor` and `round` are exact in the IEEE sense. Cost on the Cortex-M7, in instructions:
//! `sin` 25, `atan2` 97, `ln` 42, `exp` 46, `sqrt` 57.

/// Single-precision functions, for the work done per sample, bin or grid point.
pub mod f32 {
    pub use core::f32::consts::{FRAC_PI_2, PI, TAU};
    pub use libm::{
        acosf as acos, asinf as asin, atan2f as atan2, atanf as atan, ceilf as ceil, cosf as cos,
        expf as exp, fabsf as abs, floorf as floor, hypotf as hypot, log1pf as ln_1p, log10f as log10,
        logf as ln, powf, roundf as round, sincosf as sin_cos, sinf as sin, sqrtf as sqrt, tanf as tan,
    };
}

/// Double-precision functions, for the few-per-second fits whose conditioning needs them (the Cortex-M7 of both
/// boards has a double-precision unit).
pub mod f64 {
    pub use core::f64::consts::{FRAC_PI_2, PI, TAU};
    pub use libm::{
        acos, asin, atan, atan2, ceil, cos, erf, erfc, exp, fabs as abs, floor, hypot, j0, log as ln,
        log1p as ln_1p, log10, pow as powf, round, sin, sincos as sin_cos, sqrt, tan, tgamma,
    };
}

/// eˣ for x from −87 to 0, without a branch and without a call, for loops over many thousands of cells:
/// 2ᵏ times Taylor's series of the rest to the sixth power, within 3·10⁻⁷ of the value.
#[inline]
pub fn exp_of_negative(x: core::primitive::f32) -> core::primitive::f32 {
    // Adding 1.5 · 2²³ leaves the nearest whole number in the lowest bits.
    const ROUND: core::primitive::f32 = 12_582_912.0;
    let rounded = x * core::f32::consts::LOG2_E + ROUND;
    let k = rounded - ROUND;
    let r = (x - k * 0.693_359_4) + k * 2.121_944_4e-4;
    let series = (((r * (1.0 / 720.0) + 1.0 / 120.0) * r + 1.0 / 24.0) * r + 1.0 / 6.0) * r + 0.5;
    let power = (rounded.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127)) << 23;
    (1.0 + (r + r * r * series)) * core::primitive::f32::from_bits(power)
}

/// Decibels of a power ratio: `10 log10(ratio)`; a ratio of zero or less gives −200 dB rather than minus infinity.
pub fn db(ratio: core::primitive::f32) -> core::primitive::f32 {
    if ratio > 1e-20 { 10.0 * f32::log10(ratio) } else { -200.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_of_negatives_is_the_exact_one() {
        for k in 0..87_000 {
            let x = -0.001 * k as core::primitive::f32;
            let want = f64::exp(core::primitive::f64::from(x));
            let error = core::primitive::f64::from(exp_of_negative(x)) / want - 1.0;
            assert!(error.abs() < 3e-7, "{x} {error}");
        }
    }
}
