//! The one float shim: every elementary function of the core goes through here, on the host and on the target.
//!
//! All functions are `libm`'s portable ones, so the same bits come out everywhere (`std`'s own are never used:
//! they differ between platforms in the last bit), but for sine and cosine, which are the same without what reduces angles of any
//! size. Errors: below 1 unit in the last place for `sin`, `cos`,
//! `atan2`, `ln`, `exp`; `sqrt`, `floor` and `round` are exact in the IEEE sense. Cost on the Cortex-M7, in instructions:
//! `sin` 25, `atan2` 97, `ln` 42, `exp` 46, `sqrt` 57.

/// Single-precision functions, for the work done per sample, bin or grid point.
pub mod f32 {
    pub use core::f32::consts::{FRAC_PI_2, PI, TAU};
    pub use libm::{
        acosf as acos, asinf as asin, atan2f as atan2, atanf as atan, ceilf as ceil, expf as exp,
        fabsf as abs, floorf as floor, hypotf as hypot, log1pf as ln_1p, logf as ln, powf, roundf as round,
        sqrtf as sqrt, tanf as tan,
    };

    /// Sine and cosine; of more than 4·10⁸, which is no angle any more, 0 and 1. The bits are `libm`'s, whose kernels and constants these are
    /// (FreeBSD's msun: `k_sinf`, `k_cosf`, `e_rem_pio2f`), without 2 kB that reduce any angle at all.
    #[inline(never)]
    #[must_use]
    pub fn sin_cos(x: f32) -> (f32, f32) {
        let bits = x.to_bits() & 0x7fff_ffff;
        if bits >= 0x4dc9_0fdb {
            return (0.0 * x, 1.0 + 0.0 * x);
        }
        if bits < 0x3980_0000 {
            return (x, 1.0);
        }
        let x = f64::from(x);
        let (quarters, far) = (super::f64::quarters(x), bits > 0x40e2_31d5);
        let y = if far {
            x - quarters * 1.570_796_310_901_641_8 - quarters * 1.589_325_477_352_819_6e-8
        } else {
            x - quarters * core::f64::consts::FRAC_PI_2
        };
        let z = y * y;
        let (w, v) = (z * z, z * y);
        let s = (y + v * (-0.166_666_666_416_265_24 + z * 0.008_333_329_385_889_463))
            + v * w * (-0.000_198_393_348_360_966_32 + z * 2.718_311_493_989_822e-6);
        let c = ((1.0 + z * -0.499_999_997_251_031) + w * 0.041_666_623_323_739_06)
            + (w * z) * (-0.001_388_676_377_460_993 + z * 2.439_044_879_627_741e-5);
        super::f64::turned(quarters, (s as f32, c as f32))
    }

    /// By the function that gives both: the same bits, and one function less in flash.
    #[inline]
    #[must_use]
    pub fn cos(x: f32) -> f32 {
        sin_cos(x).1
    }

    /// By the function that gives both, as [`cos`].
    #[inline]
    #[must_use]
    pub fn sin(x: f32) -> f32 {
        sin_cos(x).0
    }

    /// Logarithm to base ten: rare, and long.
    #[inline(never)]
    pub fn log10(x: f32) -> f32 {
        libm::log10f(x)
    }

    /// One over the square root of a positive normal number, within 3 units in the last place: 20 instructions where the exact
    /// root and its inverse take 75. Half the exponent, negated (Lomont, Fast inverse square root, 2003: within 3.5 %), and three
    /// of Newton's steps, each of which takes three halves of the error's square.
    #[inline]
    #[must_use]
    pub fn inverse_sqrt(x: f32) -> f32 {
        let half = 0.5 * x;
        let step = |y: f32| y * (1.5 - half * y * y);
        step(step(step(f32::from_bits(0x5f37_5a86_u32.wrapping_sub(x.to_bits() >> 1)))))
    }
}

/// Double-precision functions, for the few-per-second fits whose conditioning needs them (the Cortex-M7 of both
/// boards has a double-precision unit).
pub mod f64 {
    pub use core::f64::consts::{FRAC_PI_2, PI, TAU};
    pub use libm::{
        acos, asin, atan, atan2, ceil, erf, erfc, exp, fabs as abs, floor, j0, log as ln, log1p as ln_1p,
        log10, pow as powf, round, sqrt, tgamma,
    };

    /// Sine and cosine; of more than 1.6·10⁶ 0 and 1, as in single precision. The bits are `libm`'s, whose kernels and constants these are
    /// (FreeBSD's msun: `k_sin`, `k_cos`, `e_rem_pio2`), without what reduces any angle at all.
    #[inline(never)]
    #[must_use]
    pub fn sin_cos(x: f64) -> (f64, f64) {
        let high = (x.to_bits() >> 32) as u32 & 0x7fff_ffff;
        if high < 0x3e46_a09e {
            return (x, 1.0);
        }
        if high <= 0x3fe9_21fb {
            return (sin_within(x, 0.0, true), cos_within(x, 0.0));
        }
        if high >= 0x4139_21fb {
            return (0.0 * x, 1.0 + 0.0 * x);
        }
        // π/2 in parts of 33 bits, and what each leaves.
        const PARTS: [(f64, f64, i32); 3] = [
            (1.570_796_326_734_125_6, 6.077_100_506_506_192e-11, 16),
            (6.077_100_506_303_966e-11, 2.022_266_248_795_950_6e-21, 49),
            (2.022_266_248_711_166_5e-21, 8.478_427_660_368_9e-32, i32::MAX),
        ];
        let quarters = quarters(x);
        let (mut left, mut tail, mut near) = (x, 0.0, 0.0);
        for (part, rest, most) in PARTS {
            let (before, by) = (left, quarters * part);
            left = before - by;
            // What the difference has lost; of the first, whose bits are few, nothing.
            tail = quarters * rest - ((before - left) - by);
            near = left - tail;
            // Enough, unless most of it has cancelled.
            if (high >> 20) as i32 - ((near.to_bits() >> 52) as i32 & 0x7ff) <= most {
                break;
            }
        }
        let rest = (left - near) - tail;
        turned(quarters, (sin_within(near, rest, false), cos_within(near, rest)))
    }

    /// The nearest whole number of quarter turns: adding 1.5 · 2⁵² leaves whole numbers.
    #[inline]
    pub(super) fn quarters(x: f64) -> f64 {
        const ROUND: f64 = 6_755_399_441_055_744.0;
        (x * core::f64::consts::FRAC_2_PI + ROUND) - ROUND
    }

    /// Sine and cosine of an angle turned by so many quarters.
    #[inline]
    pub(super) fn turned<T: core::ops::Neg<Output = T>>(quarters: f64, (s, c): (T, T)) -> (T, T) {
        match quarters as i32 & 3 {
            0 => (s, c),
            1 => (c, -s),
            2 => (-s, -c),
            _ => (-c, s),
        }
    }

    /// Sine of at most π/4, in two parts, or one `alone`.
    fn sin_within(x: f64, rest: f64, alone: bool) -> f64 {
        let z = x * x;
        let r = 0.008_333_333_333_322_49
            + z * (-0.000_198_412_698_298_579_5 + z * 2.755_731_370_707_006_8e-6)
            + z * (z * z) * (-2.505_076_025_340_686_3e-8 + z * 1.589_690_995_211_55e-10);
        const FIRST: f64 = -0.166_666_666_666_666_32;
        let v = z * x;
        if alone { x + v * (FIRST + z * r) } else { x - ((z * (0.5 * rest - v * r) - rest) - v * FIRST) }
    }

    /// Cosine of the same.
    fn cos_within(x: f64, rest: f64) -> f64 {
        let z = x * x;
        let w = z * z;
        let r = z
            * (0.041_666_666_666_666_6 + z * (-0.001_388_888_888_887_411 + z * 2.480_158_728_947_673e-5))
            + w * w
                * (-2.755_731_435_139_066_3e-7
                    + z * (2.087_572_321_298_175e-9 + z * -1.135_964_755_778_819_5e-11));
        let half = 0.5 * z;
        let w = 1.0 - half;
        w + (((1.0 - w) - half) + (z * r - x * rest))
    }

    /// By the function that gives both: the same bits, and one function less in flash.
    #[inline]
    #[must_use]
    pub fn sin(x: f64) -> f64 {
        sin_cos(x).0
    }

    /// By the function that gives both, as [`sin`].
    #[inline]
    #[must_use]
    pub fn cos(x: f64) -> f64 {
        sin_cos(x).1
    }

    /// Within 2 units in the last place where sine and cosine are within one.
    #[inline]
    #[must_use]
    pub fn tan(x: f64) -> f64 {
        let (s, c) = sin_cos(x);
        s / c
    }

    /// Of lengths, of which none is so long or short that its square would be no number (10^154, 10^-154). Wanted in many places.
    #[inline(never)]
    #[must_use]
    pub fn hypot(x: f64, y: f64) -> f64 {
        sqrt(x * x + y * y)
    }
}

/// Functions for tables computed when the program is compiled, so that they lie in flash and not in memory. Within
/// 2·10⁻¹⁶ of the exact value, whatever compiles them: tables of `f32` made from them are those the functions above give.
pub mod constant {
    use core::f64::consts::{LN_2, PI, SQRT_2};

    /// cos(2π `n`/`of`), by Taylor's series after reduction to a quarter turn.
    pub const fn cos_of_turn(n: usize, of: usize) -> f64 {
        let n = n % of;
        let half_turns = if 2 * n > of { 2 * (of - n) } else { 2 * n };
        let (half_turns, sign) =
            if 2 * half_turns > of { (of - half_turns, -1.0) } else { (half_turns, 1.0) };
        let x = PI * half_turns as f64 / of as f64;
        let (mut term, mut sum, mut k) = (1.0, 1.0, 1.0);
        while k < 24.0 {
            term *= -x * x / (k * (k + 1.0));
            sum += term;
            k += 2.0;
        }
        sign * sum
    }

    /// Natural logarithm of a positive number that is not subnormal: k ln 2 + 2 artanh((m − 1)/(m + 1)) with m between
    /// √½ and √2.
    pub const fn ln(x: f64) -> f64 {
        let bits = x.to_bits();
        let (mut k, mut m) =
            ((bits >> 52) as i64 - 1023, f64::from_bits((bits & ((1 << 52) - 1)) | (1023 << 52)));
        if m > SQRT_2 {
            (k, m) = (k + 1, 0.5 * m);
        }
        let s = (m - 1.0) / (m + 1.0);
        let (mut power, mut sum, mut n) = (s, s, 3.0);
        while n < 24.0 {
            power *= s * s;
            sum += power / n;
            n += 2.0;
        }
        k as f64 * LN_2 + 2.0 * sum
    }
}

/// ln(eᵃ + eᵇ).
pub fn log_sum(a: core::primitive::f32, b: core::primitive::f32) -> core::primitive::f32 {
    let (hi, lo) = if a > b { (a, b) } else { (b, a) };
    if hi - lo < 20.0 { hi + f32::ln_1p(f32::exp(lo - hi)) } else { hi }
}

/// The lesser of two numbers. Where one is none it is the second: `min` must look for that, which takes a desktop processor four
/// instructions and the target none.
#[inline]
pub fn lesser(a: core::primitive::f32, b: core::primitive::f32) -> core::primitive::f32 {
    if cfg!(target_arch = "arm") {
        a.min(b)
    } else if a < b {
        a
    } else {
        b
    }
}

/// The greater of two numbers, as [`lesser`].
#[inline]
pub fn greater(a: core::primitive::f32, b: core::primitive::f32) -> core::primitive::f32 {
    if cfg!(target_arch = "arm") {
        a.max(b)
    } else if a > b {
        a
    } else {
        b
    }
}

/// The whole part of a number from 0 to below 2²². A conversion ends at the limits of what it makes, for which a desktop processor must
/// look one number after another; where the nearest whole number is greater than the number, the whole part is one less.
#[inline]
pub fn whole(x: core::primitive::f32) -> u32 {
    // Added to this a number leaves the nearest whole one in the lowest bits.
    const ROUND: core::primitive::f32 = 8_388_608.0;
    if cfg!(target_arch = "arm") {
        return x as u32;
    }
    let rounded = x + ROUND;
    rounded.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_sub(u32::from(rounded - ROUND > x))
}

/// The whole part of a number from 0 on as 16 bits, those beyond either end at that end; nought for what is none.
#[inline]
pub fn count(x: core::primitive::f32) -> u16 {
    if cfg!(target_arch = "arm") { x as u16 } else { whole(lesser(greater(x, 0.0), 65_535.0)) as u16 }
}

/// A number cut to a whole one, at most 32 767 to either side; nought for what is none.
#[inline]
pub fn code(x: core::primitive::f32) -> i16 {
    if cfg!(target_arch = "arm") {
        return x.clamp(-32_767.0, 32_767.0) as i16;
    }
    let whole = whole(lesser(greater(f32::abs(x), 0.0), 32_767.0)).cast_signed();
    (if x < 0.0 { -whole } else { whole }) as i16
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
#[inline(never)]
pub fn db(ratio: core::primitive::f32) -> core::primitive::f32 {
    if ratio > 1e-20 { 10.0 * f32::log10(ratio) } else { -200.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_of_two_functions_is_that_function() {
        for n in 0..2_000_000 {
            let x = (n - 1_000_000) as f32 * 1.37e-3;
            assert_eq!(f32::cos(x).to_bits(), libm::cosf(x).to_bits(), "{x}");
            assert_eq!(f32::sin(x).to_bits(), libm::sinf(x).to_bits(), "{x}");
            let x = f64::from(x) * 1.000_000_1;
            assert_eq!(f64::sin(x).to_bits(), libm::sin(x).to_bits(), "{x}");
            assert_eq!(f64::cos(x).to_bits(), libm::cos(x).to_bits(), "{x}");
        }
    }

    #[test]
    fn sine_and_cosine_are_those_of_the_library_as_far_as_angles_go() {
        for n in 0..1_000_000u32 {
            // Of every size, and those that cancel against quarter turns.
            let x = core::primitive::f32::from_bits(n.wrapping_mul(4_294_967));
            if f32::abs(x) < 4e8 {
                assert_eq!(f32::sin_cos(x), libm::sincosf(x), "{x}");
            }
            let quarter = core::primitive::f64::from(n) * f64::FRAC_PI_2;
            for x in [quarter, -quarter, core::primitive::f64::from(x)] {
                if f64::abs(x) < 1.6e6 {
                    assert_eq!(f64::sin_cos(x), libm::sincos(x), "{x}");
                }
            }
        }
        assert_eq!((f32::sin_cos(1e9), f64::sin_cos(-1e9)), ((0.0, 1.0), (0.0, 1.0)));
        assert!(
            f32::sin(core::primitive::f32::NAN).is_nan() && f64::cos(core::primitive::f64::INFINITY).is_nan()
        );
    }

    #[test]
    fn functions_of_the_compiler_are_the_exact_ones() {
        for of in [7, 16, 1024] {
            for n in 0..3 * of {
                // The reference takes the nearest eighth of a turn apart in whole numbers: the rounding of a large angle
                // would alone be more than what is allowed.
                let eighths = (8 * (n % of) + of / 2) / of;
                let rest = (8 * (n % of)) as core::primitive::f64 - (eighths * of) as core::primitive::f64;
                let angle = f64::TAU / 8.0 * rest / of as core::primitive::f64;
                let (sin, cos) = (f64::sin(angle), f64::cos(angle));
                let half = core::f64::consts::FRAC_1_SQRT_2;
                let want = match eighths % 8 {
                    0 => cos,
                    1 => (cos - sin) * half,
                    2 => -sin,
                    3 => -(cos + sin) * half,
                    4 => -cos,
                    5 => (sin - cos) * half,
                    6 => sin,
                    _ => (cos + sin) * half,
                };
                assert!((constant::cos_of_turn(n, of) - want).abs() < 5e-16, "{n}/{of}");
            }
        }
        for k in 0..20_000 {
            let x = f64::exp(-12.0 + 0.0013 * core::primitive::f64::from(k));
            let want = f64::ln(x);
            assert!((constant::ln(x) - want).abs() < 3e-16 * (1.0 + want.abs()), "{x}");
        }
    }

    #[test]
    fn the_inverse_root_is_the_exact_one() {
        for k in 0..200_000 {
            let x = f32::exp(-87.0 + 8.7e-4 * k as core::primitive::f32);
            let exact = 1.0 / f64::sqrt(core::primitive::f64::from(x));
            let error = core::primitive::f64::from(f32::inverse_sqrt(x)) / exact - 1.0;
            assert!(error.abs() < 3.0 * 6e-8, "{x} {error}");
        }
    }

    #[test]
    fn whole_parts_are_those_of_the_conversions() {
        for n in 0..4_000_000 {
            let x = n as core::primitive::f32 * 0.017;
            assert_eq!(whole(x), x as u32, "{x}");
            let x = x - 34_000.0;
            assert_eq!(code(x), x.clamp(-32_767.0, 32_767.0) as i16, "{x}");
            assert_eq!(count(2.3 * x), (2.3 * x) as u16, "{x}");
        }
        for n in 0..=4_194_303u32 {
            assert_eq!(whole(n as core::primitive::f32), n);
        }
        type F = core::primitive::f32;
        for x in [F::NAN, F::INFINITY, F::NEG_INFINITY, 0.999_999_94, -0.5, 32_767.5, -40_000.0] {
            assert_eq!((code(x), count(x)), (x.clamp(-32_767.0, 32_767.0) as i16, x as u16), "{x}");
        }
    }

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
