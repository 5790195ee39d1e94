//! Range of calls, by the delays of their arrivals.
//!
//! Enters: the analytic pressure of a window, its notes and their interval. Each note's strongest arrival k, cut out at its peak, is
//! correlated with what is heard from 7 s before it to 9 s after; the sum over notes is `X(τ)`. About lag zero it is the note's own correlation
//! `X₀`, so that for a whale at range r it is `a Σ_m A_k A_m*/|A_k|² X₀(τ − (T_m − T_k))` over the table's arrivals: travel times T,
//! amplitudes A, and a share a that noise in the cut-out note leaves. Where notes come at equal intervals, the arrivals of the calls before
//! and after are part of it. The log-likelihood ratio against noise is `gain/v`, with gain the power that the model explains and v the
//! variance of X where nothing is; it counts for each independent sample of the band, and with a prior in proportion to area it becomes a
//! posterior over range, as far as the table reaches.
//!
//! The likeliest place need not be the whale's: it may be beyond the table's end, or the table another water's. So a range also has to explain
//! what is heard: beyond the noise no more may be left than `UNLIKE` of what the note's own arrivals explain.

use super::calls::BAND_HZ;
use crate::propagation::{Complex, Propagation, RayArrival};
use seabearing_core::kit::quantile;
use std::f64::consts::{LN_2, PI, TAU};

/// Nearest range told, m: nearer, delays hardly change with range, and the next cycle of 20 Hz fits nearly as well.
pub const NEAREST_M: f64 = 2_700.0;
/// Farthest range looked at where the table reaches so far, m.
pub const FARTHEST_M: f64 = 60_000.0;
/// Step of range, m: a twentieth of what turns two arrivals by a cycle of 20 Hz against each other.
const STEP_M: f64 = 10.0;
/// Places between two steps.
const FINE: usize = 10;
/// Error of a range that the likelihood does not know of, m; where other calls' arrivals lie among the note's own, as many times as much as
/// all that is explained is of what the note's own explain.
const UNSAID_M: f64 = 1.0;
/// Lags looked at before and after a note's strongest arrival, s.
const LAGS_S: (f64, f64) = (7.0, 9.0);
/// Half the length of a note, s.
pub(super) const OWN_S: f64 = 0.6;
/// Least log-likelihood ratio of a range.
const LEAST_LOG_RATIO: f64 = 12.0;
/// Share of the posterior that the place told must hold.
const SURE: f64 = 0.9;
/// Power of an arrival against the strongest from which on it may be the one that was cut out.
const ALIKE: f64 = 0.5;
/// Greatest share of the log-likelihood that counts where places are weighed against each other: notes are not alike, and the table's phases are
/// not the sea's. It is less where more than noise is left unexplained.
const TEMPER: f64 = 0.25;
/// How many times as much counts for where in its place a whale is: with the cycles of 20 Hz there, ranges lie in their 95 %.
const WITHIN: f64 = 2.0;
/// Share of an arrival's power below which it is none.
const HARDLY: f64 = 0.01;
/// What is one place: this share of its range.
const ONE_PLACE: f64 = 0.1;
/// Least and greatest share of the table's strengths at which echoes count as such.
const STRENGTHS: (f64, f64) = (0.4, 1.3);
/// Power that may be left beyond the noise, of what the note's own arrivals explain: no range is told where more is left, for then the calls
/// come from where the table does not reach, or the table is not the sea's. Alone, whales at 0.6 to 45 km left 0.2 and less, two at once 0.3;
/// whales beyond the table's end 0.4 and more.
const UNLIKE: f64 = 0.3;
/// Most calls before, and as many after, whose arrivals are looked at.
const NEIGHBOURS: usize = 3;
/// Samples a second that hold the correlation, its carrier known: the band and its edges are 12 Hz wide.
const HELD_HZ: f64 = 16.0;

/// Range of a call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CallRange {
    /// Range, m.
    pub range_m: f64,
    /// Its standard deviation, m.
    pub sd_m: f64,
    /// Log-likelihood ratio against noise.
    pub log_ratio: f64,
}

/// Finds ranges with one table.
pub(super) struct Ranger<'t> {
    table: &'t Propagation,
    rate_hz: f64,
}

/// A correlation as models are fitted to it.
struct Correlation {
    /// The values, lag zero at [`Ranger::zero`].
    x: Vec<Complex<f64>>,
    /// The same free of the carrier, so that a straight line joins two samples.
    slow: Vec<Complex<f64>>,
    /// Samples, of those that hold it, that are not the note's own.
    used: Vec<usize>,
    /// Power of the used ones.
    power: f64,
    /// Variance of one where nothing is.
    variance: f64,
}

/// How a model fits.
struct Fitted {
    /// Power explained, summed over the used samples.
    gain: f64,
    /// What of it the note's own arrivals explain alone.
    own: f64,
    /// The model at the used samples.
    sum: Vec<Complex<f64>>,
}

impl<'t> Ranger<'t> {
    pub(super) fn new(table: &'t Propagation, rate_hz: f64) -> Self {
        Self { table, rate_hz }
    }

    /// Sum over notes of the correlation of a note's strongest arrival with what is about it.
    fn correlation(&self, pressure: &[Complex<f64>], notes: &[usize]) -> Vec<Complex<f64>> {
        let own = (OWN_S * self.rate_hz) as isize;
        let zero = self.zero() as isize;
        let lags = zero + (LAGS_S.1 * self.rate_hz) as isize + 1;
        let mut out = vec![Complex::default(); lags as usize];
        let at =
            |k: isize| usize::try_from(k).ok().and_then(|k| pressure.get(k)).copied().unwrap_or_default();
        for note in notes {
            let cut: Vec<Complex<f64>> = (-own..=own)
                .map(|d| at(*note as isize + d).conj() * (0.5 + 0.5 * (PI * d as f64 / own as f64).cos()))
                .collect();
            for (lag, x) in out.iter_mut().enumerate() {
                let first = *note as isize - own + lag as isize - zero;
                *x += cut.iter().enumerate().map(|(i, c)| c * at(first + i as isize)).sum::<Complex<f64>>();
            }
        }
        out
    }

    /// Turn of the band's middle from one sample to the next, rad.
    fn carrier(&self) -> f64 {
        TAU * 0.5 * (BAND_HZ.0 + BAND_HZ.1) / self.rate_hz
    }

    /// Place of lag zero.
    fn zero(&self) -> usize {
        (LAGS_S.0 * self.rate_hz) as usize
    }

    /// The correlation made ready; `None` without any.
    fn prepared(&self, pressure: &[Complex<f64>], notes: &[usize]) -> Option<Correlation> {
        let x = self.correlation(pressure, notes);
        let own = (OWN_S * self.rate_hz) as usize;
        let outside = |k: &usize| k.abs_diff(self.zero()) > own;
        let mut powers: Vec<f64> = (0..x.len()).filter(outside).map(|k| x[k].norm_sqr()).collect();
        // Of a complex normal variable the median power is ln 2 times the mean.
        let variance = quantile::median(&mut powers)? / LN_2;
        let zero = self.zero() as f64;
        let slow = x
            .iter()
            .enumerate()
            .map(|(k, x)| x * Complex::from_polar(1.0, -self.carrier() * (k as f64 - zero)))
            .collect();
        let stride = (self.rate_hz / HELD_HZ) as usize;
        let used: Vec<usize> = (0..x.len()).step_by(stride.max(1)).filter(outside).collect();
        let power = used.iter().map(|k| x[*k].norm_sqr()).sum();
        (variance > 0.0).then_some(Correlation { x, slow, used, power, variance })
    }

    /// Range of the whale that called, where its notes' arrivals are those of one range and of no other.
    pub(super) fn range(
        &self,
        pressure: &[Complex<f64>],
        notes: &[usize],
        interval_s: Option<f64>,
    ) -> Option<CallRange> {
        let c = self.prepared(pressure, notes)?;
        // Samples of the band are not independent: so many are worth one.
        let worth = (BAND_HZ.1 - BAND_HZ.0 + 1.0) / self.rate_hz * (self.rate_hz / HELD_HZ).floor().max(1.0);
        let steps = (self.table.max_range_m().min(FARTHEST_M) / STEP_M) as usize + 1;
        let mut log_ratio = vec![f64::NEG_INFINITY; steps];
        let mut best_fit = (f64::NEG_INFINITY, 0, 0);
        for (i, slot) in log_ratio.iter_mut().enumerate() {
            // Which arrival was cut out is not known where several are about as strong.
            for cut in 0..self.table.paths.len() {
                let Some(fitted) = self.fit(&c, STEP_M * i as f64, cut, interval_s) else { continue };
                let ratio = worth * fitted.gain / c.variance;
                *slot = slot.max(ratio);
                if ratio > best_fit.0 {
                    best_fit = (ratio, i, cut);
                }
            }
        }
        let fitted = self.fit(&c, STEP_M * best_fit.1 as f64, best_fit.2, interval_s)?;
        let left = unexplained(&c, &fitted.sum);
        // A loud call tells its place to a metre: between steps the log-likelihood is read by the cubic, or the cycle of which a step comes
        // nearest the peak would be taken for the likeliest.
        let fine: Vec<f64> = (0..(steps - 1) * FINE + 1).map(|i| between(&log_ratio, i)).collect();
        let place = |i: usize| STEP_M / FINE as f64 * i as f64;
        let best = (0..fine.len()).max_by(|a, b| fine[*a].total_cmp(&fine[*b]))?;
        let top = fine[best];
        if !(top > LEAST_LOG_RATIO) {
            return None;
        }
        // Where the arrivals are not as the table has them, what differs counts as noise: it is alike at every range.
        let temper = TEMPER.min(c.variance / left);
        let (mut all, mut share) = (0.0, 0.0);
        let (mut inside, mut mean, mut square) = (0.0, 0.0, 0.0);
        for (i, l) in fine.iter().enumerate() {
            let p = place(i) * ((l - top) * temper).exp();
            all += p;
            if (place(i) / place(best) - 1.0).abs() < ONE_PLACE {
                share += p;
                let (p, off) = (place(i) * ((l - top) * WITHIN * temper).exp(), place(i) - place(best));
                (inside, mean, square) = (inside + p, mean + p * off, square + p * off * off);
            }
        }
        let at_edge = best + 1 == fine.len();
        let noise = c.variance * c.used.len() as f64;
        let like = c.power - fitted.gain - noise <= UNLIKE * fitted.own;
        let heard = worth * fitted.own / c.variance > LEAST_LOG_RATIO;
        if share < SURE * all || place(best) < NEAREST_M || at_edge || !like || !heard {
            return None;
        }
        let (mean, square) = (mean / inside, square / inside);
        let unsaid_m = UNSAID_M * fitted.gain / fitted.own;
        let variance_m2 = (square - mean * mean).max(0.0) + unsaid_m * unsaid_m;
        Some(CallRange { range_m: place(best) + mean, sd_m: variance_m2.sqrt(), log_ratio: top })
    }

    /// Adds the note's own correlation about a lag, times a factor, at the used samples.
    fn add(&self, c: &Correlation, out: &mut [Complex<f64>], lag_s: f64, factor: Complex<f64>) {
        let own = OWN_S * self.rate_hz;
        let zero = self.zero() as f64;
        let middle = lag_s * self.rate_hz + zero;
        let at = |j: f64| c.slow.get((zero + j) as usize).copied().unwrap_or_default();
        let from = c.used.partition_point(|k| (*k as f64) < middle - own);
        for (out, k) in out.iter_mut().zip(&c.used).skip(from) {
            let off = *k as f64 - middle;
            if off > own {
                break;
            }
            let (j, part) = (off.floor(), off - off.floor());
            let between = at(j) * (1.0 - part) + at(j + 1.0) * part;
            let fade = 0.5 + 0.5 * (PI * off / own).cos();
            *out += between * factor * Complex::from_polar(fade, self.carrier() * off);
        }
    }

    /// What the correlation is for a whale at a range whose arrival over path number `cut` was cut out, as near as its free factors bring it;
    /// `None` where that is not among the strongest.
    ///
    /// The share of the note's own arrivals is real: the table tells their phases. When the calls before and after come is known to some
    /// hundredths of a second, and not to a part of a cycle: their arrivals, each call's together, may be turned by anything, or a wrong
    /// interval would choose the cycle and so the range.
    fn fit(&self, c: &Correlation, range_m: f64, cut: usize, interval_s: Option<f64>) -> Option<Fitted> {
        let strongest = self.table.arrival(cut, range_m)?;
        let power = strongest.amplitude.norm_sqr();
        let arrivals: Vec<RayArrival> =
            (0..self.table.paths.len()).filter_map(|p| self.table.arrival(p, range_m)).collect();
        let most = arrivals.iter().map(|a| a.amplitude.norm_sqr()).fold(0.0, f64::max);
        if arrivals.len() < 2 || power < ALIKE * most {
            return None;
        }
        let none = || vec![Complex::default(); c.used.len()];
        let lag_s = |a: &RayArrival| a.toa_s - strongest.toa_s;
        let factor = |a: &RayArrival| strongest.amplitude * a.amplitude.conj() / power;
        let mut own = none();
        for a in arrivals.iter().filter(|a| lag_s(a) != 0.0) {
            self.add(c, &mut own, lag_s(a), factor(a));
        }
        let loud = arrivals.iter().filter(|a| a.amplitude.norm_sqr() > HARDLY * power);
        let reach_s = loud.map(|a| lag_s(a).abs()).fold(0.0, f64::max) + LAGS_S.1;
        // The parts of other calls, each free of those before it and of unit power.
        let mut others: Vec<Vec<Complex<f64>>> = Vec::new();
        for (n, interval) in
            interval_s.into_iter().flat_map(|t| (1..=NEIGHBOURS).map(move |n| (n, n as f64 * t)))
        {
            if n > 1 && interval > reach_s {
                break;
            }
            for t in [interval, -interval] {
                let mut part = none();
                arrivals.iter().for_each(|a| self.add(c, &mut part, lag_s(a) + t, factor(a)));
                let whole = inner(&part, &part).re;
                for q in &others {
                    let along = inner(q, &part);
                    take(&mut part, along, q);
                }
                let rest = inner(&part, &part).re;
                if rest > HARDLY * whole {
                    part.iter_mut().for_each(|p| *p /= rest.sqrt());
                    others.push(part);
                }
            }
        }
        // What the other calls explain, with whatever factor, tells nothing of the note's own arrivals.
        let x: Vec<Complex<f64>> = c.used.iter().map(|k| c.x[*k]).collect();
        let (mut sum, mut gain) = (none(), 0.0);
        let whole = inner(&own, &own).re;
        for q in &others {
            let along = inner(q, &x);
            gain += along.norm_sqr();
            let with_own = inner(q, &own);
            take(&mut own, with_own, q);
            take(&mut sum, -along, q);
        }
        let energy = inner(&own, &own).re;
        if energy <= HARDLY * whole {
            return None;
        }
        let along = inner(&own, &x).re;
        let share = (along / energy).clamp(STRENGTHS.0, STRENGTHS.1);
        take(&mut sum, Complex::new(-share, 0.0), &own);
        let own = 2.0 * share * along - share * share * energy;
        Some(Fitted { gain: gain + own, own, sum })
    }
}

/// Sum of the products of one's conjugate with the other.
fn inner(a: &[Complex<f64>], b: &[Complex<f64>]) -> Complex<f64> {
    a.iter().zip(b).map(|(a, b)| a.conj() * b).sum()
}

/// Takes `factor` times `part` away.
fn take(from: &mut [Complex<f64>], factor: Complex<f64>, part: &[Complex<f64>]) {
    from.iter_mut().zip(part).for_each(|(x, p)| *x -= factor * p);
}

/// Values on a grid read at number `i` of [`FINE`] places a step, by the cubic through the four about it where these are numbers.
fn between(values: &[f64], i: usize) -> f64 {
    let (k, x) = (i / FINE, (i % FINE) as f64 / FINE as f64);
    let nearest = values.get(k + usize::from(x > 0.5)).copied().unwrap_or(f64::NEG_INFINITY);
    let four = k.checked_sub(1).and_then(|first| values.get(first..first + 4));
    let Some([a, b, c, d]) = four.filter(|four| four.iter().all(|v| v.is_finite())) else { return nearest };
    let (before, after, beyond) = (x + 1.0, x - 1.0, x - 2.0);
    -x * after * beyond / 6.0 * a + before * after * beyond / 2.0 * b - before * x * beyond / 2.0 * c
        + before * x * after / 6.0 * d
}

/// Mean power that a model leaves of a correlation where it has arrivals.
fn unexplained(c: &Correlation, model: &[Complex<f64>]) -> f64 {
    let greatest = model.iter().map(Complex::norm_sqr).fold(0.0, f64::max);
    let (mut sum, mut n) = (0.0, 0.0f64);
    for (k, m) in c.used.iter().zip(model).filter(|(_, m)| m.norm_sqr() > HARDLY * greatest) {
        sum += (c.x[*k] - m).norm_sqr();
        n += 1.0;
    }
    sum / n.max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_read_between_steps() {
        let values: Vec<f64> = (0..6).map(|k| f64::from(k).powi(3)).collect();
        assert!((between(&values, 25) - 2.5f64.powi(3)).abs() < 1e-9);
        assert_eq!(between(&values, 50), 125.0);
    }
}
