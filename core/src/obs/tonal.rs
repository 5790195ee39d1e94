//! Tonal directions: the wrapped-Cauchy detector of [O 7 to 13], in the log domain, with several modes.
//!
//! Enters: the azigram rows of a window (17 or 18 frames of three minutes). Leaves: modes, each with azimuth, spread and
//! its presence ratio. A tone fills one bin in every frame, so a bin's evidence for azimuth a is the product over
//! frames of `w(u, a) = WC(u; a, R) / uniform`, and a window's is the mean of that over bins [O 11] and azimuths [O 12].
//!
//! Beyond \[O\], unless paper compatibility is asked for:
//! - R is unknown: w is a mixture of three R and a little uniform, so noise costs bounded evidence. Each factor keeps
//!   mean one in noise, therefore P(ratio > x) ≤ 1/x there and the threshold x = 10⁴ bounds false detections.
//! - A second way to be no vessel: motion of the instrument along an axis, unrelated to pressure, points either way
//!   at random. The evidence is divided by 1 + that hypothesis's own ratio.
//! - A third: ambient noise with a direction, learned in each bin over hours (see `ambient`).
//! - The phase between pressure and velocity must be steady over the window as well.
//! - Bins that agree with the strongest mode are set aside and the rest searched again: several vessels give several modes.
//!
//! Cost: 0.2 M instructions a window in noise, up to 15 M when every bin carries a vessel.

use super::ambient::Ambient;
use super::azigram::{NO_DIRECTION, PHASES, Row};
use super::limits::{AZIMUTH_BINS, AZIMUTH_MODES, AZIMUTHS, CIRCLE, WINDOW_FRAMES};
use crate::math;

/// Codes of one azimuth step.
const SUB: usize = CIRCLE / AZIMUTHS;

/// Resultant lengths of the mixture and of the paper.
const RESULTANTS: [f64; 3] = [0.99, 0.95, 0.85];
/// Share of the mixture that is uniform: a frame may be spoilt.
const SPOILT: f64 = 0.02;

/// Natural logarithm of the presence ratio a mode must exceed: 10⁴, so that noise passes at most once in 10⁴ windows.
pub const LOG_THRESHOLD: f32 = 9.21;

/// Fewest frames a window needs.
const LEAST_FRAMES: usize = 8;

/// Half the width within which bins count as the same vessel, in azimuth steps (15 degrees).
const SAME_VESSEL: usize = 11;

/// Tables of the law.
#[derive(Clone, Debug)]
pub struct WrappedCauchy {
    /// ln w of the difference 4 (k − 256) − s codes, at `[s][k]`.
    log_ratio: [[f32; 2 * AZIMUTHS]; SUB],
    /// ln of the ratio of phase against uniform, by distance in phase steps.
    log_phase: [f32; PHASES],
    paper: bool,
}

/// One direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Azimuth, radians clockwise from true North.
    pub azimuth: f32,
    /// Its standard deviation, rad.
    pub sd: f32,
    /// Natural logarithm of the mode's own presence ratio.
    pub log_presence: f32,
    /// Bins that carry it.
    pub bins: u16,
    /// Azimuth step, for other detectors on the same grid.
    pub step: u16,
    /// Short sounds rich in frequency, not tones: a whale, not a vessel.
    pub impulsive: bool,
}

/// Work space.
#[derive(Clone, Debug)]
pub struct TonalScratch {
    profile: [f32; AZIMUTHS],
    /// Log evidence against azimuth of the last mode search.
    pub(super) sum: [f32; AZIMUTHS],
    peak: [f32; AZIMUTH_BINS],
    adjust: [f32; AZIMUTH_BINS],
    best: [u16; AZIMUTH_BINS],
    free: [bool; AZIMUTH_BINS],
}

impl Default for TonalScratch {
    fn default() -> Self {
        Self::new()
    }
}

impl TonalScratch {
    /// All zeros.
    pub const fn new() -> Self {
        Self {
            profile: [0.0; AZIMUTHS],
            sum: [0.0; AZIMUTHS],
            peak: [0.0; AZIMUTH_BINS],
            adjust: [0.0; AZIMUTH_BINS],
            best: [0; AZIMUTH_BINS],
            free: [false; AZIMUTH_BINS],
        }
    }
}

/// What a window says.
#[derive(Clone, Copy, Debug)]
pub struct Directions {
    /// Modes, strongest first.
    pub modes: [Option<Mode>; AZIMUTH_MODES],
    /// Natural logarithm of the presence ratio of the whole window.
    pub log_presence: f32,
    /// Frames used.
    pub frames: usize,
}

/// A call fills at least this share of the band's bins, the inverse of it; a vessel's tones fewer.
const CALL_BINS: usize = 8;

impl Directions {
    /// Gives the modes that are a call's (its direction, and many bins) to the call.
    pub fn attribute(&mut self, azimuth: f32, bins: usize) {
        for m in self.modes.iter_mut().flatten() {
            let near = math::f32::abs(crate::angle::wrap_pi_f32(m.azimuth - azimuth)) < 0.35;
            m.impulsive = near && CALL_BINS * usize::from(m.bins) >= bins;
        }
    }
}

/// Density ratio of the wrapped Cauchy law to uniform at `angle` from its centre.
fn ratio(r: f64, angle: f64) -> f64 {
    (1.0 - r * r) / (1.0 - 2.0 * r * math::f64::cos(angle) + r * r)
}

impl WrappedCauchy {
    /// No table yet; all zeros.
    pub const EMPTY: Self =
        Self { log_ratio: [[0.0; 2 * AZIMUTHS]; SUB], log_phase: [0.0; PHASES], paper: false };

    /// Tables of the mixture, or of the paper's single R = 0.99.
    pub fn fill(&mut self, paper: bool) {
        for (s, table) in self.log_ratio.iter_mut().enumerate() {
            for (k, l) in table.iter_mut().enumerate() {
                let codes = SUB as f64 * (k as f64 - AZIMUTHS as f64) - s as f64;
                let angle = math::f64::TAU * codes / CIRCLE as f64;
                let w = if paper {
                    ratio(RESULTANTS[0], angle)
                } else {
                    let mean =
                        RESULTANTS.iter().map(|r| ratio(*r, angle)).sum::<f64>() / RESULTANTS.len() as f64;
                    SPOILT + (1.0 - SPOILT) * mean
                };
                *l = math::f64::ln(w) as f32;
            }
        }
        // Phase lives on half a circle, so its law is the wrapped Cauchy of twice the angle; R = 0.6 is loose.
        let phase = |k: usize| 0.1 + 0.9 * ratio(0.6, math::f64::TAU * k as f64 / PHASES as f64);
        let mean = (0..PHASES).map(phase).sum::<f64>() / PHASES as f64;
        for (k, l) in self.log_phase.iter_mut().enumerate() {
            *l = math::f64::ln(phase(k) / mean) as f32;
        }
        self.paper = paper;
    }

    /// ln w of an observed code against azimuth step `a`.
    fn at(&self, code: u16, a: usize) -> f32 {
        let (s, q) = (usize::from(code) % SUB, usize::from(code) / SUB);
        self.log_ratio.get(s).and_then(|t| t.get(AZIMUTHS + a - q.min(AZIMUTHS))).copied().unwrap_or(0.0)
    }

    /// Adds one observation to a profile over azimuth.
    fn accumulate(&self, code: u16, profile: &mut [f32; AZIMUTHS]) {
        let (s, q) = (usize::from(code) % SUB, usize::from(code) / SUB);
        let from = AZIMUTHS - q.min(AZIMUTHS);
        if let Some(table) = self.log_ratio.get(s).and_then(|t| t.get(from..from + AZIMUTHS)) {
            profile.iter_mut().zip(table).for_each(|(p, t)| *p += t);
        }
    }

    /// Searches a window. `rows` are the frames in it, in any order.
    pub fn search<'a, I>(&self, bins: usize, ambient: &Ambient, s: &mut TonalScratch, rows: I) -> Directions
    where
        I: Iterator<Item = &'a Row> + Clone,
    {
        let none =
            Directions { modes: [None; AZIMUTH_MODES], log_presence: -60.0, frames: rows.clone().count() };
        if none.frames < LEAST_FRAMES {
            return none;
        }
        let mut out = none;
        self.weigh_bins(bins, ambient, s, rows.clone());
        for slot in &mut out.modes {
            let Some(mode) = self.next_mode(bins, s, rows.clone()) else { break };
            if out.log_presence < mode.log_presence {
                out.log_presence = mode.log_presence;
            }
            let threshold = if self.paper { 0.0 } else { LOG_THRESHOLD };
            if mode.log_presence <= threshold {
                break;
            }
            *slot = Some(mode);
        }
        out
    }

    /// Finds the bins worth a full profile, and their peak and correction.
    fn weigh_bins<'a, I>(&self, bins: usize, ambient: &Ambient, s: &mut TonalScratch, rows: I)
    where
        I: Iterator<Item = &'a Row> + Clone,
    {
        s.free = [false; AZIMUTH_BINS];
        for f in 0..bins.min(AZIMUTH_BINS) {
            let codes = rows.clone().filter_map(|r| r.azimuth.get(f).copied()).filter(|c| *c != NO_DIRECTION);
            if !worth_it(codes.clone()) {
                continue;
            }
            s.profile = [0.0; AZIMUTHS];
            codes.clone().for_each(|c| self.accumulate(c, &mut s.profile));
            let (best, peak) = top(&s.profile);
            let adjust = if self.paper {
                0.0
            } else {
                let phases = rows
                    .clone()
                    .filter_map(|r| Some((*r.azimuth.get(f)?, *r.phase.get(f)?)))
                    .filter(|(c, _)| *c != NO_DIRECTION)
                    .map(|(_, p)| p);
                let noise = ambient.log_ratio(f, codes.clone());
                let axial = self.log_axial(best, codes);
                self.log_steady_phase(phases) - log_sum(log_sum(0.0, axial), noise)
            };
            if let (Some(p), Some(a), Some(b), Some(free)) =
                (s.peak.get_mut(f), s.adjust.get_mut(f), s.best.get_mut(f), s.free.get_mut(f))
            {
                (*p, *a, *b, *free) = (peak + adjust, adjust, best as u16, true);
            }
        }
    }

    /// ln of the evidence for an axis through azimuth step `a`, either end at random in each frame.
    fn log_axial(&self, a: usize, codes: impl Iterator<Item = u16>) -> f32 {
        let other = (a + AZIMUTHS / 2) % AZIMUTHS;
        codes.map(|c| log_sum(self.at(c, a), self.at(c, other)) - core::f32::consts::LN_2).sum()
    }

    /// ln of the evidence for one steady phase between pressure and velocity, against a random one.
    fn log_steady_phase(&self, phases: impl Iterator<Item = u8> + Clone) -> f32 {
        let mut total = f32::NEG_INFINITY;
        for centre in 0..PHASES {
            let one: f32 = phases
                .clone()
                .map(|p| {
                    self.log_phase.get((usize::from(p) + PHASES - centre) % PHASES).copied().unwrap_or(0.0)
                })
                .sum();
            total = log_sum(total, one);
        }
        total - math::f32::ln(PHASES as f32)
    }

    /// The strongest direction among the bins still free; its bins are set aside.
    fn next_mode<'a, I>(&self, bins: usize, s: &mut TonalScratch, rows: I) -> Option<Mode>
    where
        I: Iterator<Item = &'a Row> + Clone,
    {
        let codes = |f: usize| {
            rows.clone().filter_map(move |r| r.azimuth.get(f).copied()).filter(|c| *c != NO_DIRECTION)
        };
        let top_peak = free_bins(s).map(|(_, p, _)| p).fold(f32::NEG_INFINITY, f32::max);
        if !top_peak.is_finite() {
            return None;
        }
        // The mean over bins and azimuths [O 11, 12]; bins e²⁰ below the best cannot change it.
        s.sum = [0.0; AZIMUTHS];
        for f in 0..bins.min(AZIMUTH_BINS) {
            let (free, peak, adjust) = (get(&s.free, f), get(&s.peak, f), get(&s.adjust, f));
            if !free || peak < top_peak - 20.0 {
                continue;
            }
            s.profile = [0.0; AZIMUTHS];
            codes(f).for_each(|c| self.accumulate(c, &mut s.profile));
            let shift = adjust - top_peak;
            for (sum, l) in s.sum.iter_mut().zip(&s.profile) {
                let x = l + shift;
                if x > -20.0 {
                    *sum += math::f32::exp(x);
                }
            }
        }
        let total: f32 = s.sum.iter().sum();
        let (best, _) = top(&s.sum);
        let log_presence = top_peak + math::f32::ln(total.max(1e-30) / (AZIMUTHS * bins.max(1)) as f32);
        // Refine with every bin that agrees, not only the best: their product.
        s.profile = [0.0; AZIMUTHS];
        let mut used = 0u16;
        for f in 0..bins.min(AZIMUTH_BINS) {
            if !get(&s.free, f) || distance(usize::from(get(&s.best, f)), best) > SAME_VESSEL {
                continue;
            }
            if let Some(free) = s.free.get_mut(f) {
                *free = false;
            }
            if get(&s.peak, f) > 0.0 || self.paper {
                used += 1;
                codes(f).for_each(|c| self.accumulate(c, &mut s.profile));
            }
        }
        let (step, place) = if self.paper { (best, best as f32) } else { refine(&s.profile, best) };
        let azimuth = place * (math::f32::TAU / AZIMUTHS as f32);
        // Spread: scatter of the observations that take part, over the number that are independent (a tone fills
        // three bins of the Hann window; half-overlapped frames share a third).
        let (mut square, mut n) = (0f32, 0u32);
        for f in 0..bins.min(AZIMUTH_BINS) {
            if get(&s.free, f)
                || get(&s.peak, f) <= 0.0
                || distance(usize::from(get(&s.best, f)), best) > SAME_VESSEL
            {
                continue;
            }
            for c in codes(f) {
                let d = crate::angle::wrap_pi_f32(f32::from(c) * (math::f32::TAU / CIRCLE as f32) - azimuth);
                if d.abs() < 0.35 {
                    square += d * d;
                    n += 1;
                }
            }
        }
        let independent = (n as f32 / 4.0).max(1.0);
        let scatter = if n > 0 { square / n as f32 } else { 0.03 };
        let sd = math::f32::sqrt(scatter / independent + LEAST_SD * LEAST_SD);
        Some(Mode {
            azimuth: crate::angle::wrap_tau_f32(azimuth),
            sd,
            log_presence,
            bins: used,
            step: step as u16,
            impulsive: false,
        })
    }
}

/// What no averaging removes: a third of a degree, the size of an orientation error, rad.
const LEAST_SD: f32 = 0.006;

fn get<T: Copy + Default, const N: usize>(xs: &[T; N], i: usize) -> T {
    xs.get(i).copied().unwrap_or_default()
}

fn free_bins(s: &TonalScratch) -> impl Iterator<Item = (usize, f32, u16)> + '_ {
    let all = s.free.iter().zip(&s.peak).zip(&s.best).enumerate();
    all.filter(|(_, ((free, _), _))| **free).map(|(f, ((_, p), b))| (f, *p, *b))
}

/// Steps between two azimuths the short way round.
pub fn distance(a: usize, b: usize) -> usize {
    let d = a.abs_diff(b) % AZIMUTHS;
    d.min(AZIMUTHS - d)
}

/// ln(eᵃ + eᵇ).
pub fn log_sum(a: f32, b: f32) -> f32 {
    let (hi, lo) = if a > b { (a, b) } else { (b, a) };
    if hi - lo < 20.0 { hi + math::f32::ln_1p(math::f32::exp(lo - hi)) } else { hi }
}

/// Index and value of the largest.
fn top(xs: &[f32; AZIMUTHS]) -> (usize, f32) {
    xs.iter().enumerate().fold((0, f32::NEG_INFINITY), |b, (i, x)| if *x > b.1 { (i, *x) } else { b })
}

/// Maximum of a joint profile near `start`, with a parabola through its neighbours.
fn refine(profile: &[f32; AZIMUTHS], start: usize) -> (usize, f32) {
    let wrap = |i: usize| i % AZIMUTHS;
    let at = |i: usize| profile.get(wrap(i)).copied().unwrap_or(f32::NEG_INFINITY);
    let first = start + AZIMUTHS - SAME_VESSEL;
    let best = (first..=first + 2 * SAME_VESSEL)
        .fold((start, f32::NEG_INFINITY), |b, i| if at(i) > b.1 { (i, at(i)) } else { b })
        .0;
    let (l, c, r) = (at(best + AZIMUTHS - 1), at(best), at(best + 1));
    let bend = l - 2.0 * c + r;
    let part = if bend < -1e-6 { (0.5 * (l - r) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    (wrap(best), wrap(best) as f32 + part)
}

/// Whether enough frames of a bin point one way: two fifths of them within 28 degrees.
fn worth_it(codes: impl Iterator<Item = u16>) -> bool {
    const SECTORS: usize = 64;
    let mut count = [0u8; SECTORS];
    let mut n = 0usize;
    for c in codes.take(WINDOW_FRAMES) {
        if let Some(slot) = count.get_mut(usize::from(c) * SECTORS / CIRCLE) {
            *slot += 1;
            n += 1;
        }
    }
    let most = (0..SECTORS)
        .map(|k| (0..5).map(|d| usize::from(get(&count, (k + d) % SECTORS))).sum::<usize>())
        .fold(0, usize::max);
    n >= LEAST_FRAMES && 5 * most >= 2 * n
}
