//! Spectrum of a frame, and the azigram: the direction of active acoustic intensity in every bin [O 5, 6].
//!
//! Enters: 1024 samples of pressure, north and east. Leaves: ln|P| of all bins (for the cepstrum) and, for the bins of
//! the tone band, the azimuth of `I = Re(P* V)` and the phase between pressure and the velocity along it. A plane
//! wave has that phase near zero or at least steady; pressure and a shaking instrument have it at random.
//! Assumes: equal gain and phase of north and east. Cost: three transforms (150 k instructions) and 266 × 210.

use super::averages::Averages;
use super::background::{Background, straightened};
use super::limits::{CIRCLE, FRAME, HOP, USED_CHANNELS};
use super::row::{PHASES, Row};
use super::shared::Spectra;
use crate::math;
use crate::math::constant::cos_of_turn;
use microfft::Complex32;

/// The tone band, and how directions in it are turned.
#[derive(Clone, Copy, Debug)]
pub struct Band {
    /// Its first bin.
    pub first_bin: usize,
    /// Number of its bins.
    pub bins: usize,
    /// True azimuth of the north component, plus half a turn where intensity points away from the source, radians.
    pub turn: f32,
    /// Whether directions are the intensity's own (paper O), not straightened.
    pub paper: bool,
}

impl Band {
    /// No bins.
    pub const EMPTY: Self = Self { first_bin: 0, bins: 0, turn: 0.0, paper: false };
}

/// Periodic Hann divided by its sum.
static WINDOW: [f32; FRAME] = hann();

const fn hann() -> [f32; FRAME] {
    let mut out = [0.0; FRAME];
    let mut n = 0;
    while n < FRAME {
        out[n] = ((0.5 - 0.5 * cos_of_turn(n, FRAME)) / (FRAME as f64 / 2.0)) as f32;
        n += 1;
    }
    out
}

/// Windowed spectrum of two successive hops of a channel, in `buffer`.
fn transform<'a>(
    buffer: &'a mut [f32; FRAME],
    old: &[f32; HOP],
    new: &[f32; HOP],
) -> &'a mut [Complex32; HOP] {
    let halves = buffer.chunks_exact_mut(HOP).zip(WINDOW.chunks_exact(HOP));
    for ((half, window), samples) in halves.zip([old, new]) {
        half.iter_mut().zip(samples).zip(window).for_each(|((b, x), w)| *b = x * w);
    }
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
    band: &Band,
    scratch: &mut Spectra,
    old: &[[f32; HOP]; USED_CHANNELS],
    new: &[[f32; HOP]; USED_CHANNELS],
    sources: Sources,
    row: &mut Row,
    averages: &mut Averages,
) {
    let ([p0, n0, e0], [p1, n1, e1]) = (old, new);
    let pressure = transform(&mut scratch.buffer, p0, p1);
    averages.add(0, pressure);
    // The transform packs the real Nyquist bin into the imaginary part of the (real) zero bin.
    let (zero, nyquist) = pressure.first().map_or((0.0, 0.0), |z| (z.re, z.im));
    let log = |power: f32| 0.5 * ln(math::greater(power, EMPTY_POWER));
    for ((kept, l), z) in scratch.pressure.iter_mut().zip(&mut scratch.log_pressure).zip(pressure) {
        *kept = [z.re, z.im];
        *l = log(z.re * z.re + z.im * z.im);
    }
    let [first, .., last] = &mut scratch.log_pressure;
    *first = log(zero * zero);
    *last = log(nyquist * nyquist);
    row.clear();
    if sources == Sources::None {
        return;
    }
    let north = transform(&mut scratch.buffer, n0, n1);
    averages.add(1, north);
    let skipped = north.iter().skip(band.first_bin);
    scratch.intensity.iter_mut().zip(skipped).for_each(|(a, b)| *a = [b.re, b.im]);
    let east = transform(&mut scratch.buffer, e0, e1);
    averages.add(2, east);
    let components = scratch.pressure.iter().zip(east.iter()).skip(band.first_bin);
    let bins = components.zip(&mut scratch.intensity).zip(&mut scratch.phase).take(band.bins);
    for ((([pre, pim], e), north), phase) in bins {
        let re = |vre: f32, vim: f32| pre * vre + pim * vim;
        let im = |vre: f32, vim: f32| pre * vim - pim * vre;
        let [nre, nim] = *north;
        let (ie, inn) = (re(e.re, e.im), re(nre, nim));
        let square = ie * ie + inn * inn;
        let present = square > EMPTY_POWER * EMPTY_POWER * EMPTY_POWER * EMPTY_POWER && square.is_finite();
        // Reactive over active intensity, both times the length of the active one.
        let reactive = im(e.re, e.im) * ie + im(nre, nim) * inn;
        let step = ((2.0 * turns(reactive, square) + 0.5) * PHASES as f32) as i32;
        *phase = if present { step.clamp(0, PHASES as i32 - 1).cast_unsigned() } else { 0 };
        *north = if present { [ie, inn] } else { [0.0, 0.0] };
    }
    // One turn more, so that what is cut to a whole code is never negative.
    let turn = 1.0 + band.turn * (1.0 / math::f32::TAU);
    let intensity = scratch.intensity.get(..band.bins).unwrap_or_default();
    let all = intensity.iter().zip(Background::new(intensity)).zip(&scratch.phase);
    row.fill(all.map(|((own, around), phase)| {
        let straight = if band.paper { None } else { straightened(own, &around) };
        let counts = straight.is_some() || sources == Sources::One && *own != [0.0, 0.0];
        let [x, y] = straight.unwrap_or(*own);
        let code = ((turns(x, y) + turn) * CIRCLE as f32 + 0.5) as u16 % CIRCLE as u16;
        counts.then_some((code, *phase as u8))
    }));
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
    let z = math::lesser(a, b) / math::greater(math::greater(a, b), f32::MIN_POSITIVE);
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
    fn the_window_is_a_hann_window() {
        for (n, w) in WINDOW.iter().enumerate() {
            let turn = math::f64::TAU * n as f64 / FRAME as f64;
            assert_eq!(*w, ((0.5 - 0.5 * math::f64::cos(turn)) / (FRAME as f64 / 2.0)) as f32, "{n}");
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
