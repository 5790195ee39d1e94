//! Spectrum of a frame, and the azigram: the direction of active acoustic intensity in every bin [O 5, 6].
//!
//! Enters: 1024 samples of pressure, north and east. Leaves: ln|P| of all bins (for the cepstrum) and, for the bins of
//! the tone band, the azimuth of `I = Re(P* V)` and the phase between pressure and the velocity along it. A plane
//! wave has that phase near zero or at least steady; pressure and a shaking instrument have it at random.
//! Assumes: equal gain and phase of north and east. Cost: three transforms (150 k instructions) and 266 × 210.

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

/// Transforms one frame. `directional` is false where a horizontal component cannot be used: the row is then empty.
pub fn analyse(
    plan: &Plan,
    scratch: &mut Spectra,
    old: &[[f32; HOP]; USED_CHANNELS],
    new: &[[f32; HOP]; USED_CHANNELS],
    directional: bool,
    row: &mut Row,
) {
    let ([p0, n0, e0], [p1, n1, e1]) = (old, new);
    let pressure = transform(plan, &mut scratch.buffer, p0, p1);
    // The transform packs the real Nyquist bin into the imaginary part of the (real) zero bin.
    let (zero, nyquist) = pressure.first().map_or((0.0, 0.0), |z| (z.re, z.im));
    scratch.pressure = *pressure;
    let log = |power: f32| 0.5 * math::f32::ln(power.max(EMPTY_POWER));
    for (l, z) in scratch.log_pressure.iter_mut().zip(&scratch.pressure) {
        *l = log(z.re * z.re + z.im * z.im);
    }
    let [first, .., last] = &mut scratch.log_pressure;
    *first = log(zero * zero);
    *last = log(nyquist * nyquist);
    *row = Row::EMPTY;
    if !directional {
        return;
    }
    let north = transform(plan, &mut scratch.buffer, n0, n1);
    scratch.north.iter_mut().zip(north.iter().skip(plan.first_bin)).for_each(|(a, b)| *a = *b);
    let east = transform(plan, &mut scratch.buffer, e0, e1);
    let band = scratch.pressure.iter().zip(east.iter()).skip(plan.first_bin).zip(&scratch.north);
    let out = row.azimuth.iter_mut().zip(&mut row.phase).take(plan.bins);
    for (((p, e), n), (azimuth, phase)) in band.zip(out) {
        let re = |v: &Complex32| p.re * v.re + p.im * v.im;
        let im = |v: &Complex32| p.re * v.im - p.im * v.re;
        let (ie, inn) = (re(e), re(n));
        let intensity = math::f32::sqrt(ie * ie + inn * inn);
        let present = intensity > EMPTY_POWER * EMPTY_POWER && intensity.is_finite();
        if !present {
            continue;
        }
        let turns = (math::f32::atan2(ie, inn) + plan.turn) * (1.0 / math::f32::TAU);
        let wrapped = turns - math::f32::floor(turns);
        *azimuth = (wrapped * CIRCLE as f32 + 0.5) as u16 % CIRCLE as u16;
        let reactive = (im(e) * ie + im(n) * inn) / intensity;
        let angle = math::f32::atan2(reactive, intensity) * (1.0 / math::f32::PI) + 0.5;
        *phase = ((angle * PHASES as f32) as u8).min(PHASES as u8 - 1);
    }
}
