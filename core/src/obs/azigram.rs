//! Spectrum of a frame, and the azigram: the direction of active acoustic intensity in every bin [O 5, 6].
//!
//! Enters: 1024 samples of pressure, north and east. Leaves: ln|P| of all bins (for the cepstrum) and, for the bins of
//! the tone band, the azimuth of `I = Re(P* V)` and the phase between pressure and the velocity along it. A plane
//! wave has that phase near zero or at least steady; pressure and a shaking instrument have it at random.
//! Assumes: equal gain and phase of north and east; their noise is evened, and what is found is
//! turned back when it is told (`evened`). Cost: three transforms (150 k instructions) and 266 × 210.

use super::averages::Averages;
use super::background::{Background, straightened};
use super::evened::Evened;
use super::limits::{AZIMUTH_BINS, CIRCLE, FRAME, HOP, USED_CHANNELS};
use super::row::{self, PHASES, Row};
use super::shared::Spectra;
use super::steady::Steady;
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

/// The rising half of a periodic Hann window divided by its sum, its middle included; the falling half is the same from the end.
static WINDOW: [f32; HOP + 1] = hann();

const fn hann() -> [f32; HOP + 1] {
    let mut out = [0.0; HOP + 1];
    let mut n = 0;
    while n <= HOP {
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
    let (rising, falling) = buffer.split_at_mut(HOP);
    rising.iter_mut().zip(old).zip(&WINDOW).for_each(|((b, x), w)| *b = x * w);
    falling.iter_mut().zip(new).zip(WINDOW.iter().rev()).for_each(|((b, x), w)| *b = x * w);
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
// Its work space is not the minute's below.
#[inline(never)]
pub fn analyse(
    band: &Band,
    scratch: &mut Spectra,
    old: &[[f32; HOP]; USED_CHANNELS],
    new: &[[f32; HOP]; USED_CHANNELS],
    sources: Sources,
    evened: &Evened,
    row: &mut Row,
    averages: &mut Averages,
    steady: &mut Steady,
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
    let of_band = band.first_bin..band.first_bin + band.bins;
    let pressure = scratch.pressure.get(of_band.clone()).unwrap_or_default();
    let east = east.get(of_band).unwrap_or_default();
    let bins = pressure.len().min(AZIMUTH_BINS);
    let north = scratch.intensity.get_mut(..bins).unwrap_or_default();
    let phase = scratch.phase.get_mut(..bins).unwrap_or_default();
    let ((pressure, last_p), (east, last_e)) = (pressure.as_chunks(), east.as_chunks());
    let ((north, last_n), (phase, last_phase)) = (north.as_chunks_mut(), phase.as_chunks_mut());
    for (((p, e), n), phase) in pressure.iter().zip(east).zip(north).zip(phase) {
        intensities::<TOGETHER>(evened, p, e, n, phase);
    }
    let (last_n, last_phase) = (last_n.as_chunks_mut().0, last_phase.as_chunks_mut().0);
    for (((p, e), n), phase) in
        last_p.as_chunks().0.iter().zip(last_e.as_chunks().0).zip(last_n).zip(last_phase)
    {
        intensities::<1>(evened, p, e, n, phase);
    }
    let intensity = scratch.intensity.get(..band.bins).unwrap_or_default();
    // What is transformed is done with: directions in its place, none where there is none to tell.
    let (directions, _) = scratch.buffer.as_chunks_mut::<2>();
    let directions = directions.get_mut(..band.bins).unwrap_or_default();
    let bins = directions.iter_mut().zip(intensity).zip(Background::new(intensity));
    for (bin, ((direction, own), around)) in bins.enumerate() {
        let straight = if band.paper { None } else { straightened(own, &around) };
        steady.see(bin, around);
        let own = if sources == Sources::One { steady.without(bin, own) } else { [0.0, 0.0] };
        *direction = straight.unwrap_or(own);
    }
    // One turn more, so that what is cut to a whole code is never negative.
    let turn = 1.0 + band.turn * (1.0 / math::f32::TAU);
    let (phase, words) = (scratch.phase.get(..band.bins).unwrap_or_default(), row.first_mut(band.bins));
    let ((directions, last), (phase, last_phase)) = (directions.as_chunks(), phase.as_chunks());
    let (words, last_words) = words.as_chunks_mut();
    for ((directions, phase), words) in directions.iter().zip(phase).zip(words) {
        *words = coded::<TOGETHER>(directions, phase, turn);
    }
    for ((directions, phase), words) in
        last.as_chunks().0.iter().zip(last_phase.as_chunks().0).zip(last_words.as_chunks_mut().0)
    {
        *words = coded::<1>(directions, phase, turn);
    }
}

/// Words of a row for some directions and phases.
#[inline(always)]
fn coded<const N: usize>(directions: &[[f32; 2]; N], phase: &[u32; N], turn: f32) -> [u16; N] {
    let (x, y): ([f32; N], [f32; N]) =
        (core::array::from_fn(|k| directions[k][0]), core::array::from_fn(|k| directions[k][1]));
    let code: [f32; N] = core::array::from_fn(|k| (turns(x[k], y[k]) + turn) * CIRCLE as f32 + 0.5);
    let code = code.map(math::whole);
    core::array::from_fn(|k| row::word((x[k] != 0.0) | (y[k] != 0.0), code[k], phase[k]))
}

/// Bins whose intensities are made together: a desktop processor does four at once.
const TOGETHER: usize = if cfg!(target_arch = "arm") { 1 } else { 4 };

/// Of some bins the active intensity, east and north, in the place of the velocity north, and the step of the phase between pressure
/// and velocity.
#[inline(always)]
fn intensities<const N: usize>(
    evened: &Evened,
    pressure: &[[f32; 2]; N],
    east: &[Complex32; N],
    north: &mut [[f32; 2]; N],
    phase: &mut [u32; N],
) {
    let (pre, pim): ([f32; N], [f32; N]) =
        (core::array::from_fn(|k| pressure[k][0]), core::array::from_fn(|k| pressure[k][1]));
    let [nn, ne, ee] = evened.matrix;
    let weighed = |n: f32, e: f32| [nn * n + ne * e, ne * n + ee * e];
    let re: [[f32; 2]; N] = core::array::from_fn(|k| weighed(north[k][0], east[k].re));
    let im: [[f32; 2]; N] = core::array::from_fn(|k| weighed(north[k][1], east[k].im));
    let (nre, nim) = (re.map(|[n, _]| n), im.map(|[n, _]| n));
    let (ere, eim) = (re.map(|[_, e]| e), im.map(|[_, e]| e));
    let active = |re: &[f32; N], im: &[f32; N]| -> [f32; N] {
        core::array::from_fn(|k| pre[k] * re[k] + pim[k] * im[k])
    };
    let reactive = |re: &[f32; N], im: &[f32; N]| -> [f32; N] {
        core::array::from_fn(|k| pre[k] * im[k] - pim[k] * re[k])
    };
    let (to_east, to_north) = (active(&ere, &eim), active(&nre, &nim));
    let square: [f32; N] = core::array::from_fn(|k| to_east[k] * to_east[k] + to_north[k] * to_north[k]);
    // Reactive over active intensity, both times the length of the active one.
    let (of_east, of_north) = (reactive(&ere, &eim), reactive(&nre, &nim));
    let across: [f32; N] = core::array::from_fn(|k| of_east[k] * to_east[k] + of_north[k] * to_north[k]);
    let step: [f32; N] = core::array::from_fn(|k| (2.0 * turns(across[k], square[k]) + 0.5) * PHASES as f32);
    let step: [u32; N] =
        step.map(|step| math::whole(math::lesser(math::greater(step, 0.0), (PHASES - 1) as f32)));
    let present = |k: usize| (square[k] > LEAST_SQUARE) & (square[k] <= f32::MAX);
    *phase = core::array::from_fn(|k| if present(k) { step[k] } else { 0 });
    let to_east: [f32; N] = core::array::from_fn(|k| if present(k) { to_east[k] } else { 0.0 });
    let to_north: [f32; N] = core::array::from_fn(|k| if present(k) { to_north[k] } else { 0.0 });
    *north = core::array::from_fn(|k| [to_east[k], to_north[k]]);
}

/// Squared intensity up to which there is none.
const LEAST_SQUARE: f32 = EMPTY_POWER * EMPTY_POWER * EMPTY_POWER * EMPTY_POWER;

/// Natural logarithm of a positive number that is not subnormal, without a branch: ln m + k ln 2 with m between √½ and √2 and
/// ln m = 2 artanh((m − 1)/(m + 1)) to the seventh power, within 2·10⁻⁷ of ln m.
// Copied for each use it would be long; a desktop processor makes several at once.
#[cfg_attr(target_arch = "arm", inline(never))]
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
#[cfg_attr(target_arch = "arm", inline(never))]
pub(super) fn turns(x: f32, y: f32) -> f32 {
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
        let falling = WINDOW.iter().rev().take(HOP);
        for (n, w) in WINDOW.iter().take(HOP).chain(falling).enumerate() {
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
