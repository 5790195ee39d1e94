//! The law of a vessel's directions in one bin: tables of the wrapped-Cauchy mixture, and what a bin's frames say by it.
//!
//! Enters: the codes of a bin, one a frame. Leaves: log evidence for azimuths against uniform, and for the alternatives to
//! a vessel that need no other knowledge: an axis pointed along either way at random, an unsteady phase. Everything is a
//! table look-up a frame. Cost: 17 × 64 additions a profile.

use super::limits::{AZIMUTHS, CIRCLE, SPAN, WINDOW_FRAMES};
use super::row::{PHASES, Row};
use crate::math;
use crate::math::constant::{cos_of_turn, ln};

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

/// Log evidence of one bin at [`SPAN`] successive azimuths.
pub type Profile = [f32; SPAN];

/// ln w of the difference 4 (k − 256) − s codes, at `[s][k]`: successive azimuths lie side by side.
type LogRatio = [[f32; 2 * AZIMUTHS]; SUB];

/// By the mixture.
static MIXTURE: LogRatio = log_ratio(false);

/// By the paper's single R = 0.99.
static PAPER: LogRatio = log_ratio(true);

/// ln of the ratio of phase against uniform, by distance in phase steps, twice round.
static LOG_PHASE: [f32; 2 * PHASES] = log_phase();

/// Density ratio by the angle between two neighbours, in [`NEAR_STEP`] codes.
static NEAR: [f32; CIRCLE / 2 / NEAR_STEP + 1] = near();

/// Density ratio of the wrapped Cauchy law to uniform, `n`/`of` turns from its centre.
const fn ratio(r: f64, n: usize, of: usize) -> f64 {
    (1.0 - r * r) / (1.0 - 2.0 * r * cos_of_turn(n, of) + r * r)
}

const fn log_ratio(paper: bool) -> LogRatio {
    // The law is even: half the circle has all its values.
    let mut half = [0f32; CIRCLE / 2 + 1];
    let mut n = 0;
    while n <= CIRCLE / 2 {
        let [a, b, c] = RESULTANTS;
        let sum = ratio(a, n, CIRCLE) + ratio(b, n, CIRCLE) + ratio(c, n, CIRCLE);
        let w = if paper { ratio(a, n, CIRCLE) } else { SPOILT + (1.0 - SPOILT) * (sum / 3.0) };
        half[n] = ln(w) as f32;
        n += 1;
    }
    let mut out = [[0f32; 2 * AZIMUTHS]; SUB];
    let mut s = 0;
    while s < SUB {
        let mut k = 0;
        while k < 2 * AZIMUTHS {
            let n = (SUB * k + CIRCLE - s) % CIRCLE;
            out[s][k] = half[if n > CIRCLE / 2 { CIRCLE - n } else { n }];
            k += 1;
        }
        s += 1;
    }
    out
}

const fn log_phase() -> [f32; 2 * PHASES] {
    // Phase lives on half a circle, so its law is the wrapped Cauchy of twice the angle; R = 0.6 is loose.
    let mut law = [0f64; PHASES];
    let (mut sum, mut k) = (0.0, 0);
    while k < PHASES {
        law[k] = 0.1 + 0.9 * ratio(0.6, k, PHASES);
        sum += law[k];
        k += 1;
    }
    let mut out = [0f32; 2 * PHASES];
    let mut k = 0;
    while k < 2 * PHASES {
        out[k] = ln(law[k % PHASES] / (sum / PHASES as f64)) as f32;
        k += 1;
    }
    out
}

const fn near() -> [f32; CIRCLE / 2 / NEAR_STEP + 1] {
    let mut out = [0f32; CIRCLE / 2 / NEAR_STEP + 1];
    let mut k = 0;
    while k < out.len() {
        out[k] = ratio(NEIGHBOURS_RESULTANT, k * NEAR_STEP, CIRCLE) as f32;
        k += 1;
    }
    out
}

/// The law of directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrappedCauchy {
    /// Whether the choices are the paper's: R = 0.99 alone.
    pub paper: bool,
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
            let Some((azimuth, phase)) = row.direction(f) else { continue };
            if let (Some(a), Some(p)) = (out.azimuth.get_mut(out.held), out.phase.get_mut(out.held)) {
                (*a, *p) = (azimuth, phase);
                out.held += 1;
            }
        }
        out
    }

    /// Azimuths, in 2π/[`CIRCLE`].
    pub fn azimuths(&self) -> &[u16] {
        self.azimuth.get(..self.held).unwrap_or_default()
    }

    /// Standard deviation, in azimuth steps, of the mean of what points within 45° of azimuth step `a`: the mean deviation
    /// over the frames that are independent, half of them.
    pub fn sd_of_mean(&self, a: usize) -> f32 {
        let (mut sum, mut n) = (0u32, 0u32);
        for code in self.azimuths() {
            let apart = (usize::from(*code) + CIRCLE - SUB * a % CIRCLE) % CIRCLE;
            let apart = apart.min(CIRCLE.saturating_sub(apart));
            if apart < CIRCLE / 8 {
                sum += apart as u32;
                n += 1;
            }
        }
        let n = n.max(1) as f32;
        // Of a normal law the standard deviation is 1.25 mean deviations.
        1.25 / SUB as f32 * sum as f32 / n / math::f32::sqrt(0.5 * n)
    }

    fn phases(&self) -> &[u8] {
        self.phase.get(..self.held).unwrap_or_default()
    }

    /// The middle, in azimuth steps, of the 28 degrees in which most frames point; none where they are fewer than `least`.
    pub fn crowd(&self, least: usize) -> Option<usize> {
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
        let mut sums = [0u8; SECTORS];
        for (sum, near) in sums.iter_mut().zip(count.windows(WIDE)) {
            *sum = near.iter().fold(0, |sum, n| sum.wrapping_add(*n));
        }
        // In columns first: a desktop processor compares sixteen at once.
        const COLUMNS: usize = if cfg!(target_arch = "arm") { 1 } else { 16 };
        let columns = sums.as_chunks::<COLUMNS>().0.iter();
        let most = columns.fold([0; COLUMNS], |most, sums| core::array::from_fn(|k| sums[k].max(most[k])));
        let most = most.iter().fold(0, |most, sum| most.max(*sum));
        if usize::from(most) < least {
            return None;
        }
        let first = sums.iter().position(|sum| *sum == most).unwrap_or(0);
        let step = AZIMUTHS / SECTORS;
        Some((first * step + WIDE * step / 2) % AZIMUTHS)
    }
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
    fn table(&self) -> &'static LogRatio {
        if self.paper { &PAPER } else { &MIXTURE }
    }

    /// ln w of an observed code against azimuth step `a`.
    fn at(&self, code: u16, a: usize) -> f32 {
        let (s, q) = (usize::from(code) % SUB, usize::from(code) / SUB);
        self.table().get(s).and_then(|t| t.get(AZIMUTHS + a - q.min(AZIMUTHS))).copied().unwrap_or(0.0)
    }

    /// Adds a bin's evidence for the azimuths about `middle` (a step).
    pub fn accumulate(&self, codes: &Codes, middle: usize, profile: &mut Profile) {
        for code in codes.azimuths() {
            let (s, q) = (usize::from(*code) % SUB, usize::from(*code) / SUB);
            let from = AZIMUTHS - (q + AZIMUTHS - first_of(middle)) % AZIMUTHS;
            if let Some(table) = self.table().get(s).and_then(|t| t.get(from..from + SPAN)) {
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

    /// ln of the evidence that short sounds rich in frequency, not a tone, give bin `f` its directions: in each frame that may hold
    /// one, the density that the bin's neighbours draw.
    pub fn log_short<'a>(&self, rows: impl Iterator<Item = &'a &'a Row>, f: usize, bins: usize) -> f32 {
        let mut product = 1f32;
        for row in rows {
            let code = |f: usize| row.azimuth(f).filter(|_| f < bins);
            let Some(own) = code(f) else { continue };
            // One more neighbour that may point anywhere.
            let (mut sum, mut n) = (1f32, 1f32);
            for d in NEIGHBOURS {
                for other in [f.checked_sub(d), Some(f + d)].into_iter().flatten().filter_map(code) {
                    let apart = usize::from(own.abs_diff(other));
                    let apart = apart.min(CIRCLE.saturating_sub(apart)) / NEAR_STEP;
                    sum += NEAR.get(apart).copied().unwrap_or(0.0);
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
            let law = LOG_PHASE.get(PHASES - centre..2 * PHASES - centre).unwrap_or_default();
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

#[cfg(test)]
mod tests {
    use super::*;
    use math::f64::{TAU, cos, ln};

    fn ratio(r: f64, angle: f64) -> f64 {
        (1.0 - r * r) / (1.0 - 2.0 * r * cos(angle) + r * r)
    }

    #[test]
    fn tables_are_the_formulas() {
        for (s, k) in (0..SUB).flat_map(|s| (0..2 * AZIMUTHS).map(move |k| (s, k))) {
            let codes = SUB as f64 * (k as f64 - AZIMUTHS as f64) - s as f64;
            let angle = TAU * codes.rem_euclid(CIRCLE as f64) / CIRCLE as f64;
            let mean = RESULTANTS.iter().map(|r| ratio(*r, angle)).sum::<f64>() / 3.0;
            assert_eq!(MIXTURE[s][k], ln(SPOILT + (1.0 - SPOILT) * mean) as f32, "{s} {k}");
            assert_eq!(PAPER[s][k], ln(ratio(0.99, angle)) as f32, "{s} {k}");
        }
        let phase = |k: usize| 0.1 + 0.9 * ratio(0.6, TAU * k as f64 / PHASES as f64);
        let mean = (0..PHASES).map(phase).sum::<f64>() / PHASES as f64;
        for (k, l) in LOG_PHASE.iter().enumerate() {
            assert_eq!(*l, ln(phase(k) / mean) as f32, "{k}");
        }
        for (k, w) in NEAR.iter().enumerate() {
            assert_eq!(*w, ratio(0.9, TAU * (k * NEAR_STEP) as f64 / CIRCLE as f64) as f32, "{k}");
        }
    }
}
