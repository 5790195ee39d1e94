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

/// Decibels of a power ratio: `10 log10(ratio)`; a ratio of zero or less gives −200 dB rather than minus infinity.
pub fn db(ratio: core::primitive::f32) -> core::primitive::f32 {
    if ratio > 1e-20 { 10.0 * f32::log10(ratio) } else { -200.0 }
}
