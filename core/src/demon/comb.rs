//! Comb search: the rate whose harmonics together are least likely to be noise.
//!
//! For a trial rate f and H harmonics, `S = Σ_{h≤H} P(h f)`, with P the power over its local floor. Noise makes S the
//! ratio of a Gamma(H) variable to the mean of n exponential ones (the floor is itself an estimate, worth n values), so
//! `Q(S) = (n/(n+S))ⁿ Σ_{j<H} C(n+j−1, j) (S/(n+S))^j` is the probability that noise reaches S (a negative-binomial
//! tail; exact for one common floor, and an upper bound for floors that differ between harmonics). The comb with the
//! least `ln Q + 3 (H − 1)` wins: the penalty keeps a single strong line from being read as a subharmonic with a lucky
//! noise line. It is a rate only if `Q` times the number of combs tried is below the allowed false-alarm probability of
//! one window: a union bound, so the true rate of false alarms is lower.
//!
//! The rate then is the weighted mean of the lines' own frequencies (two-bin interpolation, exact for a Hann window).
//! A line with power P over the floor has frequency variance 0.32/P bins²: the maximum of a Hann periodogram would
//! have `2.34 × 6/((2π)² 1.5 P) = 0.237/P`, 2.34 being the window's loss against the Cramér-Rao bound, and using two
//! bins only loses another third (`reproduce shaft-rate`). Lines that disagree widen it.

use super::periodogram::FLOOR_DEGREES;
use crate::math::f64 as m;
use microfft::Complex32;

/// Most harmonics in a comb.
const HARMONICS: usize = 8;
/// Trial rates a bin: the eighth harmonic then moves by half a bin from trial to trial.
const TRIALS_PER_BIN: u32 = 16;
/// Price of one more harmonic, nepers.
const PENALTY: f64 = 3.0;
/// Power over the floor from which a line counts as present (noise: once in 8000 bins).
const PRESENT: f32 = 9.0;
/// Frequency variance of a line of power 1 over the floor, bins².
const VAR_LINE: f64 = 0.32;
/// Highest line used as a fraction of the Nyquist frequency (the decimator's fold lies above).
const HIGHEST: f64 = 0.9;
/// Numbers of blades a propeller may have.
const BLADES: core::ops::RangeInclusive<u8> = 2..=7;
/// Lowest shaft rate told from a blade rate, bins (about 0.33 Hz: below lies the passage itself).
const LOWEST: f64 = 10.0;
/// An alternative is told when its score comes this close to the best, nepers.
const CLOSE: f64 = 6.0;

/// How the comb may be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// The rate is the shaft's; the line of this number (2 to 7) stands out as the blade rate.
    ShaftWithBlades(u8),
    /// Shaft or blade rate: the lines do not say which.
    ShaftOrBlade,
}

/// A rate found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Spacing of the comb, Hz; the shaft rate where weaker lines between the comb's show it.
    pub rate_hz: f32,
    /// Its standard deviation, Hz.
    pub sd_hz: f32,
    /// Harmonics of the winning comb.
    pub harmonics: u8,
    /// Bit h−1: line h stands above the noise on its own.
    pub present: u8,
    /// Upper bound of the natural logarithm of the probability that noise alone gives such a comb in one window.
    pub ln_false_alarm: f32,
    /// One minus that probability (0 to 1).
    pub confidence: f32,
    /// What the spacing is.
    pub reading: Reading,
    /// Multiples or fractions of the rate that explain the lines nearly as well, Hz.
    pub alternatives: [Option<f32>; 2],
}

/// The search's plan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Search {
    /// Trial rates, in 1/[`TRIALS_PER_BIN`] of a bin: first and last.
    trials: (u32, u32),
    /// Highest bin a line may be in.
    highest: usize,
    bin_hz: f64,
    /// Natural logarithm of the number of combs tried.
    ln_combs: f64,
    /// Natural logarithm of the false-alarm probability allowed in one window.
    ln_allowed: f64,
}

/// A comb on trial: where, how many lines, its score.
#[derive(Clone, Copy)]
struct Comb {
    trial: u32,
    harmonics: usize,
    ln_q: f64,
}

impl Comb {
    fn score(&self) -> f64 {
        self.ln_q + PENALTY * (self.harmonics as f64 - 1.0)
    }
}

impl Search {
    /// The search in the spectrum of a window of so many outputs.
    pub(super) fn new(search_hz: (f64, f64), output_hz: f64, window: usize, allowed: f64) -> Self {
        let bin_hz = output_hz / window as f64;
        let trial = |hz: f64| (hz / bin_hz * f64::from(TRIALS_PER_BIN)) as u32;
        let trials = (trial(search_hz.0), trial(search_hz.1));
        let highest = (HIGHEST * (window / 2) as f64) as usize;
        let mut combs = 0u32;
        for trial in trials.0..=trials.1 {
            combs += lines(trial, highest).count() as u32;
        }
        let ln_combs = m::ln(f64::from(combs.max(1)));
        Self { trials, highest, bin_hz, ln_combs, ln_allowed: m::ln(allowed) }
    }

    /// The best comb of a spectrum (pairs as [`super::periodogram::demodulated`] leaves them), if it is no noise.
    pub(super) fn best(&self, spectrum: &[Complex32]) -> Option<Rate> {
        let best = self.search(spectrum, self.trials)?;
        if best.ln_q + self.ln_combs > self.ln_allowed {
            return None;
        }
        let (rate_bins, var_bins2, present) = refine(spectrum, &best)?;
        let mut alternatives = [None; 2];
        let mut free = alternatives.iter_mut();
        for factor in [2.0, 0.5, 3.0, 1.0 / 3.0] {
            let trial = (rate_bins * factor * f64::from(TRIALS_PER_BIN)) as u32;
            if trial <= self.trials.0 || trial >= self.trials.1 {
                continue;
            }
            let other = self.search(spectrum, (trial.saturating_sub(8), trial + 8));
            if let Some(other) = other
                && other.score() < best.score() + CLOSE
                && let Some(slot) = free.next()
            {
                *slot = Some((rate_bins * factor * self.bin_hz) as f32);
            }
        }
        let ln_false_alarm = (best.ln_q + self.ln_combs).min(0.0);
        let (turns, reading) = match blades(spectrum, &best, self.highest, self.ln_allowed) {
            Some(blades) => (f64::from(blades), Reading::ShaftWithBlades(blades)),
            None => (
                1.0,
                standing_out(spectrum, &best, self.highest, present)
                    .map_or(Reading::ShaftOrBlade, Reading::ShaftWithBlades),
            ),
        };
        Some(Rate {
            rate_hz: (rate_bins / turns * self.bin_hz) as f32,
            sd_hz: (m::sqrt(var_bins2) / turns * self.bin_hz) as f32,
            harmonics: best.harmonics as u8,
            present,
            ln_false_alarm: ln_false_alarm as f32,
            confidence: (1.0 - m::exp(ln_false_alarm)) as f32,
            reading,
            alternatives,
        })
    }

    /// The comb with the least score among trial rates. For one H the score falls with S, so only the largest S of
    /// each H is turned into a probability.
    fn search(&self, spectrum: &[Complex32], trials: (u32, u32)) -> Option<Comb> {
        let mut largest = [(0.0f32, 0u32); HARMONICS];
        for trial in trials.0..=trials.1 {
            let mut sum = 0.0;
            for (bin, slot) in lines(trial, self.highest).zip(largest.iter_mut()) {
                sum += over_floor(spectrum, bin);
                if sum > slot.0 {
                    *slot = (sum, trial);
                }
            }
        }
        let mut best: Option<Comb> = None;
        for (h, &(sum, trial)) in largest.iter().enumerate() {
            let comb = Comb { trial, harmonics: h + 1, ln_q: ln_tail(f64::from(sum), h + 1) };
            if sum > 0.0 && best.is_none_or(|b| comb.score() < b.score()) {
                best = Some(comb);
            }
        }
        best
    }
}

/// Nearest bins of a trial rate's harmonics.
fn lines(trial: u32, highest: usize) -> impl Iterator<Item = usize> {
    (1..=HARMONICS as u32)
        .map(move |h| ((h * trial + TRIALS_PER_BIN / 2) / TRIALS_PER_BIN) as usize)
        .take_while(move |&bin| bin <= highest)
}

fn over_floor(spectrum: &[Complex32], bin: usize) -> f32 {
    spectrum.get(bin).map_or(0.0, |z| z.re)
}

fn amplitude(spectrum: &[Complex32], bin: usize) -> f64 {
    m::sqrt(f64::from(spectrum.get(bin).map_or(0.0, |z| z.im)))
}

/// Natural logarithm of the probability that H noise powers over a floor of [`FLOOR_DEGREES`] sum to S or more.
fn ln_tail(s: f64, harmonics: usize) -> f64 {
    let n = FLOOR_DEGREES;
    let u = s / (n + s);
    let (mut sum, mut term) = (0.0, 1.0);
    for j in 0..harmonics {
        sum += term;
        term *= u * (n + j as f64) / (j as f64 + 1.0);
    }
    (m::ln(sum) - n * m::ln_1p(s / n)).min(0.0)
}

/// Rate and its variance in bins from the lines' own frequencies, and which lines are present.
fn refine(spectrum: &[Complex32], comb: &Comb) -> Option<(f64, f64, u8)> {
    let spacing = f64::from(comb.trial) / f64::from(TRIALS_PER_BIN);
    let mut present = 0u8;
    let (mut weight, mut moment, mut square, mut count) = (0.0, 0.0, 0.0, 0u32);
    for h in 1..=comb.harmonics {
        let near = m::round(spacing * h as f64) as usize;
        let peak = (near.saturating_sub(1)..=near + 1)
            .max_by(|&a, &b| over_floor(spectrum, a).total_cmp(&over_floor(spectrum, b)))?;
        let power = over_floor(spectrum, peak);
        if power < PRESENT {
            continue;
        }
        present |= 1u8.checked_shl(h as u32 - 1).unwrap_or(0);
        let (here, left, right) = (
            amplitude(spectrum, peak),
            amplitude(spectrum, peak.saturating_sub(1)),
            amplitude(spectrum, peak + 1),
        );
        // Hann line between bins: neighbour/peak = (1 + δ)/(2 − δ).
        let ratio = left.max(right) / here;
        let delta = ((2.0 * ratio - 1.0) / (ratio + 1.0)).clamp(-0.5, 0.5);
        let line = peak as f64 + if right > left { delta } else { -delta };
        let (h, p) = (h as f64, f64::from(power));
        weight += h * h * p;
        moment += h * line * p;
        square += line * line * p;
        count += 1;
    }
    if count == 0 {
        // A comb of many faint lines: the trial itself, to within its step.
        let spread = 1.0 / comb.harmonics as f64;
        return Some((spacing, spread * spread / 12.0, 0));
    }
    let rate = moment / weight;
    let misfit = (square - rate * moment).max(0.0) / (VAR_LINE * f64::from(count.max(2) - 1));
    Some((rate, VAR_LINE / weight * misfit.max(1.0), present))
}

/// The shaft rate below a blade rate: number of blades whose other lines are no noise at `ln_allowed`.
///
/// A strong comb hides weak lines in a common sum, so the lines between the comb's own are tested by themselves.
fn blades(spectrum: &[Complex32], comb: &Comb, highest: usize, ln_allowed: f64) -> Option<u8> {
    let mut best: Option<(f64, u8)> = None;
    for blades in BLADES {
        let shaft = f64::from(comb.trial) / f64::from(TRIALS_PER_BIN) / f64::from(blades);
        let (mut sum, mut count) = (0.0, 0usize);
        for h in (1..2 * u32::from(blades)).filter(|&h| h != u32::from(blades)) {
            let bin = m::round(shaft * f64::from(h)) as usize;
            if bin <= highest {
                sum += f64::from(over_floor(spectrum, bin));
                count += 1;
            }
        }
        let ln_q = ln_tail(sum, count) + m::ln(f64::from(BLADES.end() - BLADES.start() + 1));
        if shaft >= LOWEST && ln_q < ln_allowed && best.is_none_or(|(q, _)| ln_q < q) {
            best = Some((ln_q, blades));
        }
    }
    best.map(|(_, blades)| blades)
}

/// The blade line of a comb that already has the shaft's spacing.
fn standing_out(spectrum: &[Complex32], comb: &Comb, highest: usize, present: u8) -> Option<u8> {
    let strongest = lines(comb.trial, highest)
        .take(comb.harmonics)
        .zip(1u8..)
        .max_by(|a, b| over_floor(spectrum, a.0).total_cmp(&over_floor(spectrum, b.0)))
        .map_or(1, |(_, h)| h.max(1));
    let others = (1u8..).take(comb.harmonics).any(|h| h % strongest != 0 && present >> (h - 1) & 1 == 1);
    (BLADES.contains(&strongest) && strongest > 2 && others).then_some(strongest)
}

#[cfg(test)]
mod tests {
    use super::super::{EMPTY_SCRATCH, WINDOW};
    use super::*;

    #[test]
    fn tail_probability_has_its_known_values() {
        // One line: (1 + S/n)^-n; with many floor values, Gamma(2): e^-S (1 + S).
        assert!((ln_tail(20.0, 1) + 40.0 * 1.5f64.ln()).abs() < 1e-12);
        assert_eq!(ln_tail(0.0, 3), 0.0);
        assert!(ln_tail(10.0, 2) > ln_tail(10.0, 1) && ln_tail(11.0, 2) < ln_tail(10.0, 2));
    }

    #[test]
    fn a_line_between_bins_is_found_to_a_fraction_of_a_bin() {
        let mut spectrum = EMPTY_SCRATCH;
        // Hann main lobe of a line at bin 200.3: amplitudes sinc(x)/(1 − x²).
        for bin in 190..=210 {
            let x = bin as f64 - 200.3;
            let a = m::sin(m::PI * x) / (m::PI * x) / (1.0 - x * x);
            spectrum[bin].re = (a * a * 1000.0) as f32;
            spectrum[bin].im = spectrum[bin].re;
        }
        let search = Search::new((1.0, 15.5), 68.0, WINDOW, 1e-6);
        let rate = search.best(&spectrum).unwrap();
        assert!((f64::from(rate.rate_hz) / search.bin_hz - 200.3).abs() < 1e-3);
        assert_eq!((rate.harmonics, rate.present, rate.reading), (1, 1, Reading::ShaftOrBlade));
    }

    #[test]
    fn an_unequal_comb_shows_shaft_and_blades() {
        let mut spectrum = EMPTY_SCRATCH;
        for (h, power) in [(1, 40.0), (2, 30.0), (4, 900.0), (8, 200.0)] {
            spectrum[60 * h].re = power;
            spectrum[60 * h].im = power;
        }
        let rate = Search::new((1.0, 15.5), 68.0, WINDOW, 1e-6).best(&spectrum).unwrap();
        assert_eq!(rate.reading, Reading::ShaftWithBlades(4));
        assert!((rate.rate_hz / (68.0 / 2048.0) - 60.0).abs() < 0.1);
    }
}
