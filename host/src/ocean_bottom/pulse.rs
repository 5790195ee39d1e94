//! The pulse that an interference draws in the cepstrum, measured from passages of known track: its centre frequency f0 and
//! its width Δτ [O 17, corrected].
//!
//! Enters: frames of a recording and the courses of its vessels. About the delay of each branch, at the range the vessel
//! had when it sent, the cepstrum is `a cos(2π f0 d − φ) exp(−d²/Δτ²)` of the distance d from the delay, with φ of the
//! table. In each cell of range of each branch the best amplitude a ≥ 0 is taken in closed form; f0 and Δτ are those with
//! which all cells together explain most, found on a grid and then by steps that halve. The deviations are the scatter of
//! the same fit among six parts of the recording, one after the other, not that of their mean: what a part of a passage, a
//! table a little off or tracks a little late make of the pulse is alike in many cells, and does not go down with their number.

use super::stages::SpectralFrame;
use super::strengths::{APART_S, CELL_M, CELLS, alone, at_emission};
use crate::course::VesselCourse;
use crate::propagation::Propagation;
use seabearing_core::obs::cepstrum::noise_sd;
use std::f64::consts::TAU;

/// Quefrencies looked at on either side of a delay: 0.16 s, beyond which the widest pulse is over.
const REACH: usize = 8;

/// Widest pulse that is looked at, s (half the recorder's kernel, 10 quefrencies, is three widths).
pub const WIDEST_S: f64 = 0.0666;
/// Narrowest that is looked at, s: below two quefrencies.
const NARROWEST_S: f64 = 0.015;
/// Centre frequencies looked at, Hz.
const CENTRES_HZ: (f64, f64) = (4.0, 24.0);

/// Fewest frames that give a pulse.
const LEAST: usize = 100;

/// Parts of a recording that are compared, and how many of them must show the pulse.
const PARTS: usize = 6;
const LEAST_PARTS: usize = 3;

/// Form of a pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PulseForm {
    /// Centre frequency, Hz.
    pub f0_hz: f64,
    /// Δτ, s.
    pub width_s: f64,
    /// How the formula is written.
    pub written: Written,
}

/// The ways in which formula 17 is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Written {
    /// `cos(2π f0 (τ − τ_b) − φ) exp(−(τ − τ_b)²/Δτ²)`: this project's, and the authors' programme's.
    Own,
    /// The same with the printed envelope, `exp(−(τ − τ_b)²/(2 Δτ²))`.
    PrintedEnvelope,
    /// As printed: `cos(2π f0 τ − φ) exp(−(τ − τ_b)²/(2 Δτ²))`.
    AsPrinted,
}

impl PulseForm {
    /// Its height, for unit strength, `off_s` after the delay `delay_s` of a branch of phase `phase`.
    pub fn at(&self, off_s: f64, delay_s: f64, phase: f64) -> f64 {
        let from = if self.written == Written::AsPrinted { delay_s + off_s } else { off_s };
        let half = if self.written == Written::Own { 1.0 } else { 0.5 };
        (TAU * self.f0_hz * from - phase).cos() * (-half * (off_s / self.width_s).powi(2)).exp()
    }
}

/// The cepstrum of one frame about one branch's delay.
struct Piece {
    cell: usize,
    delay_s: f64,
    phase: f64,
    /// Distances from the delay and values over their standard deviation.
    points: [(f64, f64); 2 * REACH + 1],
}

/// What frames of known range show of the pulse.
pub struct Pieces(Vec<Piece>);

impl Pieces {
    /// Collects the cepstra about the delays of the one vessel near, branches nearer than 0.15 s left out.
    pub fn collect(frames: &[SpectralFrame], courses: &[VesselCourse], table: &Propagation) -> Self {
        let branches = table.strengths.len();
        let mut out = Vec::new();
        for f in frames {
            let Some(course) = alone(courses, f.t_s) else { continue };
            for b in 0..branches {
                let Some((range, delay_s)) = at_emission(table, course, b, f.t_s) else { continue };
                let row = (range / table.step_m).round() as usize;
                let Some((_, phase)) = table.branch(b, row) else { continue };
                let crowded = (0..branches)
                    .filter(|c| *c != b)
                    .filter_map(|c| table.branch(c, row))
                    .any(|(other, _)| (other - delay_s).abs() < APART_S);
                let (k, cell) = ((delay_s * 50.0).round() as usize, (range / CELL_M) as usize);
                if crowded || cell >= CELLS || k < 2 * REACH || k + REACH >= f.filtered.len() {
                    continue;
                }
                let points = std::array::from_fn(|i| {
                    let q = k + i - REACH;
                    (q as f64 / 50.0 - delay_s, f64::from(f.filtered[q]) / f64::from(noise_sd(q)))
                });
                out.push(Piece { cell: b * CELLS + cell, delay_s, phase, points });
            }
        }
        Self(out)
    }

    /// Frames and branches collected.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// For each cell: the projection on a form, its energy, and the number of pieces.
    fn cells(pieces: &[Piece], form: &PulseForm) -> Vec<(f64, f64, usize)> {
        let cells = pieces.iter().map(|p| p.cell + 1).max().unwrap_or(0);
        let mut sums = vec![(0.0, 0.0, 0); cells];
        for p in pieces {
            let slot: &mut (f64, f64, usize) = &mut sums[p.cell];
            for (off_s, y) in p.points {
                let m = form.at(off_s, p.delay_s, p.phase);
                slot.0 += m * y;
                slot.1 += m * m;
            }
            slot.2 += 1;
        }
        sums
    }

    /// Twice the log-likelihood ratio that a form reaches, each cell with its best strength.
    pub fn explained(&self, form: &PulseForm) -> f64 {
        Self::part(&self.0, form)
    }

    fn part(pieces: &[Piece], form: &PulseForm) -> f64 {
        let of_cell = |(xy, xx, _): (f64, f64, usize)| if xx > 0.0 { xy.max(0.0).powi(2) / xx } else { 0.0 };
        Self::cells(pieces, form).into_iter().map(of_cell).sum()
    }

    /// What noise alone reaches: half a degree of freedom a cell, and two for the form.
    fn noise(pieces: &[Piece], form: &PulseForm) -> f64 {
        0.5 * Self::cells(pieces, form).iter().filter(|c| c.2 > 0).count() as f64 + 2.0
    }

    /// f0 (Hz), Δτ (s) and their standard deviations; `None` of fewer than a hundred pieces, or where no cell stands out.
    pub fn fit(&self) -> Option<PulseFit> {
        if self.len() < LEAST {
            return None;
        }
        let form = Self::best(&self.0);
        let explained = self.explained(&form);
        if explained < 4.0 * Self::noise(&self.0, &form) {
            return None;
        }
        // Pieces are in order of time.
        let parts = self.0.chunks(self.len().div_ceil(PARTS));
        let parts: Vec<PulseForm> = parts
            .map(|pieces| (pieces, Self::best(pieces)))
            .filter(|(pieces, form)| Self::part(pieces, form) >= 4.0 * Self::noise(pieces, form))
            .map(|(_, form)| form)
            .collect();
        let scatter = |of: fn(&PulseForm) -> f64| {
            let squares: f64 = parts.iter().map(|p| (of(p) - of(&form)).powi(2)).sum();
            (parts.len() >= LEAST_PARTS).then(|| (squares / (parts.len() - 1) as f64).sqrt())
        };
        Some(PulseFit {
            form,
            f0_sd_hz: scatter(|p| p.f0_hz),
            width_sd_s: scatter(|p| p.width_s),
            explained,
            pieces: self.len(),
        })
    }

    fn best(pieces: &[Piece]) -> PulseForm {
        let mut best = (PulseForm { f0_hz: 0.0, width_s: 0.0, written: Written::Own }, f64::NEG_INFINITY);
        let consider = |f0_hz: f64, width_s: f64, best: &mut (PulseForm, f64)| -> bool {
            let allowed =
                (CENTRES_HZ.0..=CENTRES_HZ.1).contains(&f0_hz) && (NARROWEST_S..=WIDEST_S).contains(&width_s);
            let form = PulseForm { f0_hz, width_s, written: Written::Own };
            let score = if allowed { Self::part(pieces, &form) } else { f64::NEG_INFINITY };
            let better = score > best.1;
            if better {
                *best = (form, score);
            }
            better
        };
        for f0 in 6..=23 {
            for width in 2..=6 {
                consider(f64::from(f0), 0.01 * f64::from(width), &mut best);
            }
        }
        let mut step = (0.5, 0.005);
        while step.0 > 0.01 {
            let (PulseForm { f0_hz, width_s, .. }, _) = best;
            let around = [(step.0, 0.0), (-step.0, 0.0), (0.0, step.1), (0.0, -step.1)];
            let moved = around.map(|(df, dw)| consider(f0_hz + df, width_s + dw, &mut best));
            if !moved.contains(&true) {
                step = (0.5 * step.0, 0.5 * step.1);
            }
        }
        best.0
    }

    /// Correlation of a form with the mean cepstrum: the pieces of each branch and cell averaged in steps of 5 ms about their delay,
    /// the form averaged likewise, both over all cells that the own form explains above four standard deviations; `None`
    /// where there is none. 1 is a form that leaves nothing.
    pub fn correlation(&self, form: &PulseForm, own: &PulseForm) -> Option<f64> {
        const STEPS: usize = 61;
        let strong: Vec<f64> = Self::cells(&self.0, own)
            .into_iter()
            .map(|(xy, xx, _)| if xy > 4.0 * xx.sqrt() { xy / xx } else { 0.0 })
            .collect();
        let mut means = vec![[(0.0f64, 0.0f64, 0usize); STEPS]; strong.len()];
        for p in self.0.iter().filter(|p| strong[p.cell] > 0.0) {
            for (off_s, y) in p.points {
                let step = (off_s * 200.0).round() + (STEPS / 2) as f64;
                if let Some(slot) = means[p.cell].get_mut(step as usize).filter(|_| step >= 0.0) {
                    *slot = (slot.0 + y, slot.1 + form.at(off_s, p.delay_s, p.phase), slot.2 + 1);
                }
            }
        }
        // Every cell with the strength that fits it best, so that the pulse's shape alone counts; noise of the means is taken off.
        let (mut xy, mut xx, mut yy, mut noise) = (0.0, 0.0, 0.0, 0.0);
        for cell in means {
            let (mut cxy, mut cxx) = (0.0, 0.0);
            for (y, m, n) in cell.into_iter().filter(|s| s.2 > 0) {
                let n = n as f64;
                cxy += y * m / n;
                cxx += m * m / n;
                yy += y * y / n;
                noise += 1.0;
            }
            let a = if cxx > 0.0 { (cxy / cxx).max(0.0) } else { 0.0 };
            xy += a * cxy;
            xx += a * a * cxx;
        }
        let signal = yy - noise;
        (xx > 0.0 && signal > 0.0).then(|| (xy / (xx * signal).sqrt()).min(1.0))
    }
}

/// A fitted pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PulseFit {
    /// Its form.
    pub form: PulseForm,
    /// Standard deviation of f0, Hz; `None` where too few parts of the recording show the pulse.
    pub f0_sd_hz: Option<f64>,
    /// Standard deviation of Δτ, s; likewise.
    pub width_sd_s: Option<f64>,
    /// Twice the log-likelihood ratio reached.
    pub explained: f64,
    /// Cepstra about a delay that were used.
    pub pieces: usize,
}

impl PulseFit {
    /// Whether the centre frequency ended at the limit of what is looked at: then its deviation is not known.
    pub fn f0_at_limit(&self) -> bool {
        (self.form.f0_hz - CENTRES_HZ.0).min(CENTRES_HZ.1 - self.form.f0_hz) < 0.02
    }

    /// Whether the width did.
    pub fn width_at_limit(&self) -> bool {
        (self.form.width_s - NARROWEST_S).min(WIDEST_S - self.form.width_s) < 2e-4
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pieces of a known pulse at all distances from the sampling, with noise of unit deviation.
    fn pieces(form: PulseForm, height: f64) -> Pieces {
        let mut seed = 11u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(seed >> 8) / f64::from(1 << 24)
        };
        let all = (0..4000).map(|i| {
            let (delay_s, phase) = (1.0 + random(), 0.7 * f64::from(i % 20));
            let k = (delay_s * 50.0).round();
            let points = std::array::from_fn(|j| {
                let off_s = (k + j as f64 - REACH as f64) / 50.0 - delay_s;
                let noise = (0..12).map(|_| random()).sum::<f64>() - 6.0;
                (off_s, height * form.at(off_s, delay_s, phase) + noise)
            });
            Piece { cell: i as usize % 20, delay_s, phase, points }
        });
        Pieces(all.collect())
    }

    #[test]
    fn a_known_pulse_is_found_again() {
        for (f0_hz, width_s) in [(9.0, 0.06), (16.5, 0.05), (20.0, 0.03)] {
            let truth = PulseForm { f0_hz, width_s, written: Written::Own };
            let found = pieces(truth, 0.7).fit().unwrap();
            assert!((found.form.f0_hz - f0_hz).abs() < 0.3, "{found:?}");
            assert!((found.form.width_s / width_s - 1.0).abs() < 0.08, "{found:?}");
        }
        let wide =
            pieces(PulseForm { f0_hz: 12.0, width_s: 0.09, written: Written::Own }, 0.7).fit().unwrap();
        assert!(wide.width_at_limit() && !wide.f0_at_limit(), "{wide:?}");
        assert_eq!(pieces(PulseForm { f0_hz: 15.0, width_s: 0.05, written: Written::Own }, 0.0).fit(), None);
    }

    #[test]
    fn a_pulse_that_is_not_one_all_along_is_as_uncertain_as_its_parts_differ() {
        let of = |f0_hz: f64| pieces(PulseForm { f0_hz, width_s: 0.04, written: Written::Own }, 0.7).0;
        let steady = Pieces(of(15.0)).fit().unwrap();
        assert!(steady.f0_sd_hz.unwrap() < 0.8 && steady.width_sd_s.unwrap() < 0.003, "{steady:?}");
        // As of a vessel that comes nearer: halves of the cells would agree to a hundredth.
        let other = Pieces(of(14.0).into_iter().chain(of(16.0)).collect()).fit().unwrap();
        assert!((0.7..1.8).contains(&other.f0_sd_hz.unwrap()), "{other:?}");
        let few = Pieces(of(15.0).into_iter().chain(pieces_of_nothing(16_000)).collect()).fit().unwrap();
        assert_eq!((few.f0_sd_hz, few.width_sd_s), (None, None), "{few:?}");
    }

    /// Pieces without a pulse or noise.
    fn pieces_of_nothing(count: usize) -> impl Iterator<Item = Piece> {
        (0..count).map(|i| Piece {
            cell: i % 20,
            delay_s: 1.0,
            phase: 0.0,
            points: [(0.0, 0.0); 2 * REACH + 1],
        })
    }

    #[test]
    fn the_form_it_was_made_of_correlates_best() {
        let own = PulseForm { f0_hz: 16.5, width_s: 0.05, written: Written::Own };
        let p = pieces(own, 1.0);
        let of = |written| p.correlation(&PulseForm { written, ..own }, &own).unwrap();
        let (a, b, c) = (of(Written::Own), of(Written::PrintedEnvelope), of(Written::AsPrinted));
        // Of two Gaussian envelopes whose widths are as 1 to √2 the correlation is 0.971.
        assert!(a > 0.98 && (b - 0.971).abs() < 0.015 && c < 0.7, "{a} {b} {c}");
    }
}
