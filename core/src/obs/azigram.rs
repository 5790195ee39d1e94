//! Spectrum of a frame, and the azigram: the direction of active acoustic intensity in every bin [O 5, 6].
//!
//! Enters: 1024 samples of pressure, north and east. Leaves: ln|P| of all bins (for the cepstrum) and, for the bins of
//! the tone band, the azimuth of `I = Re(P* V)` and the phase between pressure and the velocity along it. A plane
//! wave has that phase near zero or at least steady; pressure and a shaking instrument have it at random.
//! Assumes: equal gain and phase of north and east. Cost: three transforms (150 k instructions) and 266 × 210.

use super::background::{Background, straightened};
use super::limits::{AZIMUTH_BINS, CIRCLE, FRAME, HOP, USED_CHANNELS};
use super::plan::Plan;
use crate::math;
use microfft::Complex32;

/// Code of "no direction" in an azigram row.
pub const NO_DIRECTION: u16 = u16::MAX;

/// Steps of a stored phase over [−π/2, π/2).
pub const PHASES: usize = 16;

/// One frame's directions.
#[derive(Clone, Debug)]
pub struct Row {
    /// Azimuth in steps of 2π/[`CIRCLE`], or [`NO_DIRECTION`].
    pub azimuth: [u16; AZIMUTH_BINS],
    /// Phase between pressure and velocity in steps of π/[`PHASES`] from −π/2.
    pub phase: [u8; AZIMUTH_BINS],
    /// Greatest burst of pressure over its mean, in eighths (see `impulsive`).
    pub uneven: u8,
}

impl Row {
    /// A row without directions.
    pub const EMPTY: Self =
        Self { azimuth: [NO_DIRECTION; AZIMUTH_BINS], phase: [0; AZIMUTH_BINS], uneven: 0 };

    /// A row that is all zeros, for memory not yet used.
    pub const ZERO: Self = Self { azimuth: [0; AZIMUTH_BINS], phase: [0; AZIMUTH_BINS], uneven: 0 };
}

/// Work space of the transforms.
#[derive(Clone, Debug)]
pub struct Spectra {
    pub(super) buffer: [f32; FRAME],
    pressure: [Complex32; HOP],
    /// Velocity north, then intensity (east, north) in its place.
    north: [Complex32; AZIMUTH_BINS],
    /// ln|P| of bins 0 to 512.
    pub(super) log_pressure: [f32; HOP + 1],
}

impl Default for Spectra {
    fn default() -> Self {
        Self::new()
    }
}

impl Spectra {
    /// All zeros.
    pub const fn new() -> Self {
        let zero = Complex32 { re: 0.0, im: 0.0 };
        Self {
            buffer: [0.0; FRAME],
            pressure: [zero; HOP],
            north: [zero; AZIMUTH_BINS],
            log_pressure: [0.0; HOP + 1],
        }
    }
}

/// Windowed spectrum of two successive hops of a channel, in `buffer`.
fn transform<'a>(
    plan: &Plan,
    buffer: &'a mut [f32; FRAME],
    old: &[f32; HOP],
    new: &[f32; HOP],
) -> &'a mut [Complex32; HOP] {
    let samples = old.iter().chain(new);
    buffer.iter_mut().zip(samples).zip(&plan.window).for_each(|((b, x), w)| *b = x * w);
    microfft::real::rfft_1024(buffer)
}

/// Power below which a bin counts as empty (a thousandth of a code, squared).
const EMPTY_POWER: f32 = 1e-6;

/// Which bins of a frame give a direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sources {
    /// None: a horizontal component cannot be used.
    None,
    /// Every bin, also those with noise only: a vessel's wideband noise points to it as its tones do.
    One,
    /// Those that stand out: with two vessels about, wideband noise points between them.
    Several,
}

/// Transforms one frame.
pub fn analyse(
    plan: &Plan,
    scratch: &mut Spectra,
    old: &[[f32; HOP]; USED_CHANNELS],
    new: &[[f32; HOP]; USED_CHANNELS],
    sources: Sources,
    row: &mut Row,
) {
    let ([p0, n0, e0], [p1, n1, e1]) = (old, new);
    let pressure = transform(plan, &mut scratch.buffer, p0, p1);
    // The transform packs the real Nyquist bin into the imaginary part of the (real) zero bin.
    let (zero, nyquist) = pressure.first().map_or((0.0, 0.0), |z| (z.re, z.im));
    scratch.pressure = *pressure;
    let log = |power: f32| 0.5 * ln(power.max(EMPTY_POWER));
    for (l, z) in scratch.log_pressure.iter_mut().zip(&scratch.pressure) {
        *l = log(z.re * z.re + z.im * z.im);
    }
    let [first, .., last] = &mut scratch.log_pressure;
    *first = log(zero * zero);
    *last = log(nyquist * nyquist);
    *row = Row::EMPTY;
    if sources == Sources::None {
        return;
    }
    let north = transform(plan, &mut scratch.buffer, n0, n1);
    scratch.north.iter_mut().zip(north.iter().skip(plan.first_bin)).for_each(|(a, b)| *a = *b);
    let east = transform(plan, &mut scratch.buffer, e0, e1);
    // One turn more, so that what is cut to a whole code is never negative.
    let turn = 1.0 + plan.turn * (1.0 / math::f32::TAU);
    let band = scratch.pressure.iter().zip(east.iter()).skip(plan.first_bin).zip(&mut scratch.north);
    for (((p, e), n), phase) in band.zip(&mut row.phase).take(plan.bins) {
        let re = |v: &Complex32| p.re * v.re + p.im * v.im;
        let im = |v: &Complex32| p.re * v.im - p.im * v.re;
        let (ie, inn) = (re(e), re(n));
        let square = ie * ie + inn * inn;
        let present = square > EMPTY_POWER * EMPTY_POWER * EMPTY_POWER * EMPTY_POWER && square.is_finite();
        // Reactive over active intensity, both times the length of the active one.
        let reactive = im(e) * ie + im(n) * inn;
        let step = ((2.0 * turns(reactive, square) + 0.5) * PHASES as f32) as u8;
        *phase = if present { step.min(PHASES as u8 - 1) } else { 0 };
        *n = if present { Complex32::new(ie, inn) } else { Complex32::new(0.0, 0.0) };
    }
    let intensity = scratch.north.get(..plan.bins).unwrap_or_default();
    for ((own, around), azimuth) in intensity.iter().zip(Background::new(intensity)).zip(&mut row.azimuth) {
        let straight = if plan.paper { None } else { straightened(own, &around) };
        let counts = straight.is_some() || sources == Sources::One && (own.re != 0.0 || own.im != 0.0);
        let vector = straight.unwrap_or(*own);
        let code = ((turns(vector.re, vector.im) + turn) * CIRCLE as f32 + 0.5) as u16 % CIRCLE as u16;
        if counts {
            *azimuth = code;
        }
    }
}

/// Natural logarithm of a positive number that is not subnormal, without a branch: ln m + k ln 2 with m between √½ and √2 and
/// ln m = 2 artanh((m − 1)/(m + 1)) to the seventh power, within 2·10⁻⁷ of ln m.
fn ln(x: f32) -> f32 {
    const SQRT_HALF_BITS: i32 = 0x3f35_04f3;
    let k = (x.to_bits() as i32 - SQRT_HALF_BITS) >> 23;
    let m = f32::from_bits((x.to_bits() as i32 - (k << 23)) as u32);
    let s = (m - 1.0) / (m + 1.0);
    let q = s * s;
    let series = ((q * (1.0 / 7.0) + 0.2) * q + 1.0 / 3.0) * q;
    2.0 * (s + s * series) + k as f32 * core::f32::consts::LN_2
}

/// The angle of (x, y) clockwise from y, in turns, −½ to ½: a polynomial [Abramowitz and Stegun 4.4.49] within 2·10⁻⁶
/// turns, a five-hundredth of a stored step.
fn turns(x: f32, y: f32) -> f32 {
    let (a, b) = (math::f32::abs(x), math::f32::abs(y));
    let z = a.min(b) / a.max(b).max(f32::MIN_POSITIVE);
    let q = z * z;
    let p = ((0.020_835_1 * q - 0.085_133) * q + 0.180_141) * q - 0.330_299_5;
    let octant = (p * q + 0.999_866) * z * (1.0 / math::f32::TAU);
    let quadrant = if a > b { 0.25 - octant } else { octant };
    let half = if y < 0.0 { 0.5 - quadrant } else { quadrant };
    if x < 0.0 { -half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithms_are_those_of_the_exact_function() {
        for k in 0..20_000 {
            let x = math::f32::exp(-13.0 + 0.003 * k as f32);
            let (have, want) = (f64::from(ln(x)), math::f64::ln(f64::from(x)));
            assert!((have - want).abs() < 2e-7 + 1.2e-7 * want.abs(), "{x} {have} {want}");
        }
    }

    #[test]
    fn turns_are_those_of_the_exact_function() {
        for k in 0..4000 {
            let angle = math::f32::TAU * (k as f32 / 4000.0 - 0.4999);
            let (s, c) = math::f32::sin_cos(angle);
            let error = turns(3e-3 * s, 3e-3 * c) * math::f32::TAU - angle;
            assert!(error.abs() < 1.3e-5, "{angle} {error}");
        }
        assert_eq!(turns(0.0, 0.0), 0.0);
    }
}
