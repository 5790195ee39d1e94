//! The law of a vessel's directions in one bin: tables of the wrapped-Cauchy mixture, and what a bin's frames say by it.
//!
//! Enters: the codes of a bin, one a frame. Leaves: log evidence for azimuths against uniform, and for the alternatives to
//! a vessel that need no other knowledge: an axis pointed along either way at random, an unsteady phase. Everything is a
//! table look-up a frame. Cost: 17 × 64 additions a profile.

use super::azigram::{NO_DIRECTION, PHASES, Row};
use super::impulsive::UNEVEN;
use super::limits::{AZIMUTHS, CIRCLE, WINDOW_FRAMES};
use crate::math;

/// Codes of one azimuth step.
const SUB: usize = CIRCLE / AZIMUTHS;

/// Resultant lengths of the mixture and of the paper.
const RESULTANTS: [f64; 3] = [0.99, 0.95, 0.85];
/// Share of the mixture that is uniform: a frame may be spoilt.
const SPOILT: f64 = 0.02;

/// Resultant length of the directions of a short sound in neighbouring bins.
const NEIGHBOURS_RESULTANT: f64 = 0.9;
/// Distances, in bins, of neighbours that a tone in the middle does not reach and a call does (0.2 to 0.6 Hz).
const NEIGHBOURS: core::ops::RangeInclusive<usize> = 4..=12;
/// Codes of one step of the table of neighbours.
const NEAR_STEP: usize = 8;

/// Azimuths of a profile, a quarter of the circle about where most frames point: the peak and all that counts beside it.
pub const SPAN: usize = AZIMUTHS / 4;

/// Log evidence of one bin at [`SPAN`] successive azimuths.
pub type Profile = [f32; SPAN];

/// Tables of the law.
#[derive(Clone, Debug)]
pub struct WrappedCauchy {
    /// ln w of the difference 4 (k − 256) − s codes, at `[s][k]`.
    log_ratio: [[f32; 2 * AZIMUTHS]; SUB],
    /// ln of the ratio of phase against uniform, by distance in phase steps, twice round.
    log_phase: [f32; 2 * PHASES],
    /// Density ratio by the angle between two neighbours, in [`NEAR_STEP`] codes.
    near: [f32; CIRCLE / 2 / NEAR_STEP + 1],
    /// Whether the choices are the paper's.
    pub(super) paper: bool,
}

/// What the frames of a window hold in one bin.
pub struct Codes {
    azimuth: [u16; WINDOW_FRAMES],
    phase: [u8; WINDOW_FRAMES],
    held: usize,
}

impl Codes {
    /// Of bin `f`, frames without a direction left out.
    pub fn of(rows: &[&Row], f: usize) -> Self {
        let mut out = Self { azimuth: [0; WINDOW_FRAMES], phase: [0; WINDOW_FRAMES], held: 0 };
        for row in rows {
            let (Some(code), Some(phase)) = (row.azimuth.get(f), row.phase.get(f)) else { continue };
            if *code == NO_DIRECTION {
                continue;
            }
            if let (Some(a), Some(p)) = (out.azimuth.get_mut(out.held), out.phase.get_mut(out.held)) {
                (*a, *p) = (*code, *phase);
                out.held += 1;
            }
        }
        out
    }

    /// Azimuths, in 2π/[`CIRCLE`].
    pub fn azimuths(&self) -> &[u16] {
        self.azimuth.get(..self.held).unwrap_or_default()
    }

    fn phases(&self) -> &[u8] {
        self.phase.get(..self.held).unwrap_or_default()
    }

    /// The middle, in azimuth steps, of the 28 degrees in which most frames point, and how many do.
    pub fn crowd(&self) -> (usize, usize) {
        const SECTORS: usize = 64;
        const WIDE: usize = 5;
        let mut count = [0u8; SECTORS + WIDE - 1];
        for c in self.azimuths() {
            if let Some(slot) = count.get_mut(usize::from(*c) * SECTORS / CIRCLE) {
                *slot += 1;
            }
        }
        let (head, tail) = count.split_at_mut(SECTORS);
        tail.iter_mut().zip(head).for_each(|(t, h)| *t = *h);
        let sums = count.windows(WIDE).map(|w| w.iter().sum::<u8>());
        let (first, most) = sums.enumerate().fold((0, 0), |b, (k, n)| if n > b.1 { (k, n) } else { b });
        let step = AZIMUTHS / SECTORS;
        ((first * step + WIDE * step / 2) % AZIMUTHS, usize::from(most))
    }
}

/// Density ratio of the wrapped Cauchy law to uniform at `angle` from its centre.
fn ratio(r: f64, angle: f64) -> f64 {
    (1.0 - r * r) / (1.0 - 2.0 * r * math::f64::cos(angle) + r * r)
}

/// The first azimuth of a profile about `middle`.
fn first_of(middle: usize) -> usize {
    (middle + AZIMUTHS - SPAN / 2) % AZIMUTHS
}

/// Azimuth step of the `k`th value of a profile about `middle`.
pub fn step_of(middle: usize, k: usize) -> usize {
    (first_of(middle) + k) % AZIMUTHS
}

impl WrappedCauchy {
    /// No table yet; all zeros.
    pub const EMPTY: Self = Self {
        log_ratio: [[0.0; 2 * AZIMUTHS]; SUB],
        log_phase: [0.0; 2 * PHASES],
        near: [0.0; CIRCLE / 2 / NEAR_STEP + 1],
        paper: false,
    };

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
        for (k, w) in self.near.iter_mut().enumerate() {
            let angle = math::f64::TAU * (k * NEAR_STEP) as f64 / CIRCLE as f64;
            *w = ratio(NEIGHBOURS_RESULTANT, angle) as f32;
        }
        self.paper = paper;
    }

    /// ln w of an observed code against azimuth step `a`.
    fn at(&self, code: u16, a: usize) -> f32 {
        let (s, q) = (usize::from(code) % SUB, usize::from(code) / SUB);
        self.log_ratio.get(s).and_then(|t| t.get(AZIMUTHS + a - q.min(AZIMUTHS))).copied().unwrap_or(0.0)
    }

    /// Adds a bin's evidence for the azimuths about `middle` (a step).
    pub fn accumulate(&self, codes: &Codes, middle: usize, profile: &mut Profile) {
        for code in codes.azimuths() {
            let (s, q) = (usize::from(*code) % SUB, usize::from(*code) / SUB);
            let from = AZIMUTHS - (q + AZIMUTHS - first_of(middle)) % AZIMUTHS;
            if let Some(table) = self.log_ratio.get(s).and_then(|t| t.get(from..from + SPAN)) {
                profile.iter_mut().zip(table).for_each(|(p, t)| *p += t);
            }
        }
    }

    /// ln of the evidence for an axis through azimuth step `a`, either end at random in each frame.
    pub fn log_axial(&self, a: usize, codes: &Codes) -> f32 {
        let other = (a + AZIMUTHS / 2) % AZIMUTHS;
        let (mut sum, mut product) = (0f32, 1f32);
        for c in codes.azimuths() {
            let (x, y) = (self.at(*c, a), self.at(*c, other));
            sum += x.max(y) - core::f32::consts::LN_2;
            product *= 1.0 + math::f32::exp(-math::f32::abs(x - y));
        }
        sum + math::f32::ln(product)
    }

    /// ln of the evidence that short sounds rich in frequency, not a tone, give bin `f` its directions: in a frame whose
    /// pressure is uneven in time, the density that the bin's neighbours draw.
    pub fn log_short(&self, rows: &[&Row], f: usize, bins: usize) -> f32 {
        let mut product = 1f32;
        for row in rows.iter().filter(|r| r.uneven >= UNEVEN) {
            let code = |f: usize| row.azimuth.get(f).filter(|c| f < bins && **c != NO_DIRECTION);
            let Some(own) = code(f) else { continue };
            // One more neighbour that may point anywhere.
            let (mut sum, mut n) = (1f32, 1f32);
            for d in NEIGHBOURS {
                for other in [f.checked_sub(d), Some(f + d)].into_iter().flatten().filter_map(code) {
                    let apart = usize::from(own.abs_diff(*other));
                    let apart = apart.min(CIRCLE.saturating_sub(apart)) / NEAR_STEP;
                    sum += self.near.get(apart).copied().unwrap_or(0.0);
                    n += 1.0;
                }
            }
            product *= sum / n;
        }
        math::f32::ln(product)
    }

    /// ln of the evidence for one steady phase between pressure and velocity, against a random one.
    pub fn log_steady_phase(&self, codes: &Codes) -> f32 {
        let mut count = [0f32; PHASES];
        for p in codes.phases() {
            if let Some(slot) = count.get_mut(usize::from(*p)) {
                *slot += 1.0;
            }
        }
        let mut sums = [0f32; PHASES];
        for (centre, sum) in sums.iter_mut().enumerate() {
            let law = self.log_phase.get(PHASES - centre..2 * PHASES - centre).unwrap_or_default();
            *sum = count.iter().zip(law).map(|(n, l)| n * l).sum();
        }
        let top = sums.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b));
        let total: f32 = sums.iter().map(|s| math::f32::exp(s - top)).sum();
        top + math::f32::ln(total / PHASES as f32)
    }
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
