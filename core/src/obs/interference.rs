//! The interference model: the log-likelihood ratio of a vessel at each range, from one cepstrum.
//!
//! Enters: a clutter-filtered cepstrum y. Leaves, for each model range r, `Σ_q μ(r,q)/σ²(q) · (y(q) − μ(r,q)/2)`
//! [O 19] with μ the sum of all branches [O 17], cross terms included. The second term does not depend on data and is
//! computed once. The first is linear in y: one complex envelope Z(τ), the correlation of y/σ² with a pulse at delay
//! τ, is computed on a fine grid of delays and read by every branch at every range:
//! `a Re(exp(−i(2π f0 τ + φ)) Z(τ))`. Cost: 90 k instructions a cepstrum; memory 24 KiB.

use super::cepstrum::noise_sd;
use super::limits::{MODEL_RANGES, QUEFRENCIES, RANGE_STEP_M};
use super::table::{MAX_BRANCHES, Table};
use crate::math;
use microfft::Complex32;

/// Delays between two quefrencies at which the envelope is computed: the envelope then bends so little between
/// them that a straight line errs by less than 0.5 %.
const FINE: usize = 4;

/// Longest half pulse in quefrencies: 3 Δτ fs at 62.5 Hz.
const HALF: usize = 10;

/// Number of fine delays.
const DELAYS: usize = FINE * QUEFRENCIES;

/// Steps between two fine delays in which the place of a pulse is stored: 0.16 ms at 50 Hz.
const PARTS: usize = 32;

/// Plain delays are stored in steps of this, s.
const DELAY_UNIT_S: f32 = 1e-4;

/// Strengths are stored in steps of this.
const STRENGTH_UNIT: f32 = 1.0 / 32_768.0;

/// Delays shorter than this (s) lie under the spectrum's smooth shape and are left out.
const SHORTEST_DELAY_S: f32 = 0.25;

/// Ranges at which the plain delays are kept, beyond the model too: 0 to 100 km.
const FAR_RANGES: usize = 201;

/// Step of those, m; delays bend so slowly that a straight line between them errs by less than a millisecond.
const FAR_STEP_M: f32 = 500.0;

/// Delays closer than this draw pulses that cannot be told apart, s.
const SAME_DELAY_S: f32 = 0.07;

/// Share of a vessel's modelled energy that, drawn by another vessel, makes it doubtful.
const SHARED_ENERGY: f32 = 0.1;

/// Ranges closer than this are one place, m.
const SAME_PLACE_M: f32 = 1500.0;

/// A branch at a range: where its pulse lies, in fine delays over [`PARTS`] (0: no pulse), and how the envelope
/// projects on it.
#[derive(Clone, Copy, Debug)]
struct Pulse {
    delay: u16,
    re: i16,
    im: i16,
}

impl Pulse {
    const NONE: Self = Self { delay: 0, re: 0, im: 0 };

    /// Where it lies, in quefrencies.
    fn centre(self) -> f32 {
        f32::from(self.delay) * (1.0 / (FINE * PARTS) as f32)
    }
}

/// The model.
#[derive(Clone, Debug)]
pub struct Interference {
    pulses: [[Pulse; MODEL_RANGES]; MAX_BRANCHES],
    /// Half the energy of the summed μ over σ².
    half_energy: [f32; MODEL_RANGES],
    /// Delays of each branch against range in [`DELAY_UNIT_S`]; 0: none.
    far_delay: [[u16; FAR_RANGES]; MAX_BRANCHES],
    /// The pulse by distance in quefrencies and by fine delay.
    kernel: [[f32; FINE]; 2 * HALF + 1],
    /// First quefrency with a pulse, and how many there are to the last.
    span: (usize, usize),
    carrier: [Complex32; QUEFRENCIES],
    inverse_variance: [f32; QUEFRENCIES],
    branches: usize,
    max_range_m: f32,
}

/// Envelope of one cepstrum.
#[derive(Clone, Debug)]
pub struct Envelope {
    weighted: [Complex32; QUEFRENCIES],
    z: [Complex32; DELAYS],
}

impl Default for Envelope {
    fn default() -> Self {
        Self::new()
    }
}

impl Envelope {
    /// All zeros.
    pub const fn new() -> Self {
        let zero = Complex32 { re: 0.0, im: 0.0 };
        Self { weighted: [zero; QUEFRENCIES], z: [zero; DELAYS] }
    }
}

impl Envelope {
    /// Projection on a pulse.
    fn along(&self, p: Pulse) -> f32 {
        let (i, part) = (usize::from(p.delay) / PARTS, usize::from(p.delay) % PARTS);
        let part = part as f32 * (1.0 / PARTS as f32);
        self.z.get(i..).and_then(|z| z.first_chunk::<2>()).map_or(0.0, |[a, b]| {
            let re = a.re + (b.re - a.re) * part;
            let im = a.im + (b.im - a.im) * part;
            STRENGTH_UNIT * (f32::from(p.re) * re + f32::from(p.im) * im)
        })
    }
}

impl Interference {
    /// Nothing known; all zeros.
    pub const EMPTY: Self = Self {
        pulses: [[Pulse::NONE; MODEL_RANGES]; MAX_BRANCHES],
        half_energy: [0.0; MODEL_RANGES],
        far_delay: [[0; FAR_RANGES]; MAX_BRANCHES],
        kernel: [[0.0; FINE]; 2 * HALF + 1],
        span: (0, 0),
        carrier: [Complex32 { re: 0.0, im: 0.0 }; QUEFRENCIES],
        inverse_variance: [0.0; QUEFRENCIES],
        branches: 0,
        max_range_m: 0.0,
    };

    /// Takes what it needs from the table, for quefrencies in steps of 1/`rate_hz`.
    pub fn fill(&mut self, table: &Table<'_>, rate_hz: f32) {
        let header = table.header();
        let out = self;
        out.branches = table.branches();
        out.max_range_m = table.max_range_m().min(RANGE_STEP_M * (MODEL_RANGES - 1) as f32);
        out.pulses.iter_mut().flatten().for_each(|p| *p = Pulse::NONE);
        for (k, (c, v)) in out.carrier.iter_mut().zip(&mut out.inverse_variance).enumerate() {
            let turn = math::f32::TAU * header.f0_hz * k as f32 / rate_hz;
            *c = Complex32::new(math::f32::cos(turn), math::f32::sin(turn));
            *v = 1.0 / (noise_sd(k) * noise_sd(k));
        }
        for (d, kernel) in out.kernel.iter_mut().enumerate() {
            for (s, w) in kernel.iter_mut().enumerate() {
                let q = (d as f32 - HALF as f32 - s as f32 / FINE as f32) / rate_hz / header.width_s;
                *w = if q.abs() < 3.0 { math::f32::exp(-q * q) } else { 0.0 };
            }
        }
        let longest = (QUEFRENCIES - 2 * HALF) as f32 / rate_hz;
        for (b, pulses) in out.pulses.iter_mut().enumerate().take(table.branches()) {
            for (j, pulse) in pulses.iter_mut().enumerate() {
                let Some((delay, phase, strength)) = table.branch(b, RANGE_STEP_M * j as f32) else {
                    continue;
                };
                if !(SHORTEST_DELAY_S..=longest).contains(&delay) {
                    continue;
                }
                let angle = math::f32::TAU * header.f0_hz * delay + phase;
                let code = |x: f32| (strength.min(0.99) * x / STRENGTH_UNIT) as i16;
                *pulse = Pulse {
                    delay: math::f32::round(delay * rate_hz * (FINE * PARTS) as f32) as u16,
                    re: code(math::f32::cos(angle)),
                    im: code(math::f32::sin(angle)),
                };
            }
        }
        let drawn = out.pulses.iter().flatten().map(|p| usize::from(p.delay) / (FINE * PARTS));
        let drawn = drawn.filter(|k| *k > 0);
        let (first, last) = (drawn.clone().min().unwrap_or(0).max(HALF), drawn.max().unwrap_or(0));
        out.span = (first, (last + 2).saturating_sub(first));
        for (b, delays) in out.far_delay.iter_mut().enumerate() {
            for (j, d) in delays.iter_mut().enumerate() {
                let known = table.branch(b, FAR_STEP_M * j as f32);
                *d = known.map_or(0, |(delay, ..)| {
                    math::f32::round(delay / DELAY_UNIT_S).clamp(0.0, 65_535.0) as u16
                });
            }
        }
        for j in 0..MODEL_RANGES {
            let energy = out.energy(j, header.f0_hz, header.width_s, rate_hz);
            if let Some(e) = out.half_energy.get_mut(j) {
                *e = 0.5 * energy;
            }
        }
    }

    /// `Σ_q μ²/σ²` at model range `j`, all branches summed before squaring.
    fn energy(&self, j: usize, f0_hz: f32, width_s: f32, rate_hz: f32) -> f32 {
        let pulse = |b: usize| self.pulses.get(b).and_then(|p| p.get(j)).copied().filter(|p| p.delay > 0);
        let mut total = 0.0;
        for b in 0..self.branches {
            let Some(p) = pulse(b) else { continue };
            let first = (p.centre() as usize).saturating_sub(HALF);
            for k in first..first + 2 * HALF + 2 {
                let own = mu(p, k, f0_hz, width_s, rate_hz);
                // Every pair is met twice, once from either pulse.
                let all: f32 =
                    (0..self.branches).filter_map(pulse).map(|p| mu(p, k, f0_hz, width_s, rate_hz)).sum();
                total += own * all * self.inverse_variance.get(k).copied().unwrap_or(0.0);
            }
        }
        total.max(0.0)
    }

    /// Farthest range modelled, m.
    pub fn max_range_m(&self) -> f32 {
        self.max_range_m
    }

    /// Delay of a branch at any range up to 100 km, s.
    fn delay_s(&self, branch: usize, range_m: f32) -> Option<f32> {
        let x = (range_m / FAR_STEP_M).max(0.0);
        let j = x as usize;
        let delays = self.far_delay.get(branch)?;
        let (a, b) = (*delays.get(j)?, *delays.get(j + 1)?);
        if a == 0 || b == 0 {
            return None;
        }
        Some(DELAY_UNIT_S * (f32::from(a) + (f32::from(b) - f32::from(a)) * (x - j as f32)))
    }

    /// Whether the strongest pulse of a vessel at `range_m` would lie where a vessel known to be at `known_m` draws one:
    /// the same echo read as another pair of paths.
    pub fn mistakes(&self, range_m: f32, known_m: f32) -> bool {
        let (strongest, _) = self.shared(range_m, known_m);
        strongest
    }

    /// Whether any notable part of what a vessel at `range_m` would draw may be a known vessel's: enough not to report
    /// it as another vessel, too little to disregard it as evidence.
    pub fn doubtful(&self, range_m: f32, known_m: f32) -> bool {
        let (strongest, share) = self.shared(range_m, known_m);
        strongest || share > SHARED_ENERGY
    }

    /// Whether the strongest pulse, and what share of the energy, of a vessel at `range_m` lies where one at `known_m`
    /// draws pulses.
    fn shared(&self, range_m: f32, known_m: f32) -> (bool, f32) {
        if math::f32::abs(range_m - known_m) < SAME_PLACE_M {
            return (false, 0.0);
        }
        let j = (range_m / RANGE_STEP_M) as usize;
        let (mut strongest, mut most, mut all, mut shared) = (false, f32::NEG_INFINITY, 0f32, 0f32);
        for (b, pulses) in self.pulses.iter().enumerate().take(self.branches) {
            let p = pulses.get(j).copied().unwrap_or(Pulse::NONE);
            let energy = f32::from(p.re) * f32::from(p.re) + f32::from(p.im) * f32::from(p.im);
            let delay = self.delay_s(b, range_m);
            let near = |b: usize| {
                let known = self.delay_s(b, known_m).zip(delay);
                known.is_some_and(|(d, delay)| math::f32::abs(d - delay) < SAME_DELAY_S)
            };
            let drawn = (0..self.branches).any(near);
            if energy > most {
                (strongest, most) = (drawn, energy);
            }
            all += energy;
            shared += if drawn { energy } else { 0.0 };
        }
        (strongest, shared / all.max(1.0))
    }

    /// Number of branches.
    pub fn branches(&self) -> usize {
        self.branches
    }

    /// Computes the envelope of a cepstrum.
    pub fn envelope(&self, y: impl Iterator<Item = f32>, out: &mut Envelope) {
        let weights = self.carrier.iter().zip(&self.inverse_variance);
        for ((w, y), (c, v)) in out.weighted.iter_mut().zip(y).zip(weights) {
            let x = y * v;
            *w = Complex32::new(c.re * x, c.im * x);
        }
        let (first, count) = self.span;
        let centres = out.weighted.windows(2 * HALF + 1).skip(first.saturating_sub(HALF)).take(count);
        for (span, z) in centres.zip(out.z.as_chunks_mut::<FINE>().0.iter_mut().skip(first)) {
            let (mut re, mut im) = ([0f32; FINE], [0f32; FINE]);
            for (w, kernel) in span.iter().zip(&self.kernel) {
                re.iter_mut().zip(kernel).for_each(|(x, k)| *x += w.re * k);
                im.iter_mut().zip(kernel).for_each(|(x, k)| *x += w.im * k);
            }
            z.iter_mut().zip(re.iter().zip(&im)).for_each(|(z, (re, im))| *z = Complex32::new(*re, *im));
        }
    }

    /// Writes the log-likelihood ratio at every range to `out`, all branches summed.
    pub fn log_ratio(&self, envelope: &Envelope, out: &mut [f32; MODEL_RANGES]) {
        out.iter_mut().for_each(|g| *g = 0.0);
        for pulses in self.pulses.iter().take(self.branches) {
            // Where there is no pulse, `re` and `im` are 0.
            out.iter_mut().zip(pulses).for_each(|(g, p)| *g += envelope.along(*p));
        }
        out.iter_mut().zip(&self.half_energy).for_each(|(g, e)| *g -= e);
    }

    /// Writes the log-likelihood ratio of one branch alone at every range to `out`: 0 where it does not exist [O 19].
    pub(super) fn branch_log_ratio(&self, branch: usize, envelope: &Envelope, out: &mut [f32; MODEL_RANGES]) {
        let pulses = self.pulses.get(branch).unwrap_or(&[Pulse::NONE; MODEL_RANGES]);
        for (g, p) in out.iter_mut().zip(pulses) {
            let (fine, first) = (usize::from(p.delay) / PARTS, usize::from(p.delay) / (PARTS * FINE));
            let known = self.carrier.iter().zip(&self.inverse_variance).skip(first.saturating_sub(HALF));
            let (re, im) = (f32::from(p.re) * STRENGTH_UNIT, f32::from(p.im) * STRENGTH_UNIT);
            let energy: f32 = known
                .zip(&self.kernel)
                .map(|((c, v), k)| {
                    let mu = (re * c.re + im * c.im) * k.get(fine % FINE).copied().unwrap_or(0.0);
                    mu * mu * v
                })
                .sum();
            *g = envelope.along(*p) - 0.5 * energy;
        }
    }
}

/// The pulse's value at quefrency index `k`.
fn mu(p: Pulse, k: usize, f0_hz: f32, width_s: f32, rate_hz: f32) -> f32 {
    let q = k as f32 / rate_hz;
    let x = (q - p.centre() / rate_hz) / width_s;
    if x.abs() >= 3.0 {
        return 0.0;
    }
    let turn = math::f32::TAU * f0_hz * q;
    let (re, im) = (f32::from(p.re) * STRENGTH_UNIT, f32::from(p.im) * STRENGTH_UNIT);
    (re * math::f32::cos(turn) + im * math::f32::sin(turn)) * math::f32::exp(-x * x)
}
