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
//! Where the station's file has a deviation of the table's depth, whales over floors of other depths are looked for as well, a depth counting
//! as that deviation has it: a range then has what they differ by in its deviation, and none is told where another depth explains what is
//! heard about as well at another place.
//!
//! The likeliest place need not be the whale's: it may be beyond the table's end, or the table another water's. So a range also has to explain
//! what is heard: beyond the noise no more may be left than `UNLIKE` of what the note's own arrivals explain.

use super::notes::Kind;
use crate::propagation::{Complex, Propagation, RayArrival};
use rayon::prelude::*;
use seabearing_core::kit::quantile;
use seabearing_core::obs::lasting::Lasting;
use std::f64::consts::{LN_2, PI, TAU};
use std::ops::Range;

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
/// What is one place: this share of its range, and two deviations of what the table's depth makes of it.
const ONE_PLACE: f64 = 0.1;
/// Least and greatest share of the table's strengths at which echoes count as such.
const STRENGTHS: (f64, f64) = (0.4, 1.3);
/// Power that may be left beyond the noise, of what the note's own arrivals explain: no range is told where more is left, for then the calls
/// come from where the table does not reach, or the table is not the sea's. Alone, whales at 0.6 to 45 km left 0.2 and less, two at once 0.3;
/// whales beyond the table's end 0.4 and more.
const UNLIKE: f64 = 0.3;
/// Step of the floor's depth where that is not sure, m: half of it moves the third arrival against the first two, the range that keeps these
/// given, by a tenth of a cycle of 20 Hz.
const DEPTH_STEP_M: f64 = 8.0;
/// Depths looked at on either side, standard deviations.
const DEPTH_REACH: f64 = 2.5;
/// Depths between those that count, for the range within its place.
const DEPTHS_WITHIN: usize = 32;
/// Standard deviation of the table's depth above which no range is told, m.
const MOST_DEPTH_SD_M: f64 = 150.0;
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
    /// What of it the table's depth makes, m: calls from one place share it.
    pub shared_m: f64,
    /// Log-likelihood ratio against noise.
    pub log_ratio: f64,
}

/// Finds ranges with one table.
pub(super) struct Ranger<'t> {
    table: &'t Propagation,
    rate_hz: f64,
    notes: Kind,
    /// What is not known of the station itself.
    lasting: Lasting,
    depth_sd_m: f64,
}

/// Where a whale may be.
#[derive(Clone, Copy, Debug)]
struct Place {
    range_m: f64,
    /// By how much the floor is deeper than the table's, m.
    deeper_m: f64,
    /// Number of the path whose arrival was cut out.
    cut: usize,
}

/// Log-likelihood ratios against range over a floor of one depth.
struct Scan {
    deeper_m: f64,
    /// At every place, [`FINE`] a step.
    fine: Vec<f64>,
    /// The greatest at a step, the step's number, and the path that was cut out there.
    top: (f64, usize, usize),
}

impl Scan {
    /// Number of the likeliest place.
    fn best(&self) -> Option<usize> {
        (0..self.fine.len()).max_by(|a, b| self.fine[*a].total_cmp(&self.fine[*b]))
    }

    /// Log-likelihood ratio there.
    fn greatest(&self) -> f64 {
        self.fine.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }
}

/// Range of place number `i`, m.
fn place(i: usize) -> f64 {
    STEP_M / FINE as f64 * i as f64
}

/// What one depth says of the range: its weight, and mean and mean square of what the range is beyond the likeliest, m and m².
#[derive(Clone, Copy, Debug)]
struct Moments {
    weight: f64,
    mean: f64,
    square: f64,
}

impl Moments {
    /// Of the places `near` the likeliest, at `middle_m`; a log-likelihood ratio counts by what it is above `top`, times `counts`.
    fn of(s: &Scan, near: &[usize], middle_m: f64, counts: f64, top: f64, log_prior: f64) -> Self {
        let (mut weight, mut mean, mut square) = (0.0, 0.0, 0.0);
        for (i, l) in near.iter().filter_map(|i| Some((*i, s.fine.get(*i)?))) {
            let p = place(i) * ((l - top) * counts + log_prior).exp();
            let off = place(i) - middle_m;
            (weight, mean, square) = (weight + p, mean + p * off, square + p * off * off);
        }
        if weight > 0.0 {
            Self { weight, mean: mean / weight, square: square / weight }
        } else {
            Self { weight, mean, square }
        }
    }

    /// Mean and variance over all depths, and what of the variance lies between them; `None` without any.
    fn joined(each: &[Self]) -> Option<(f64, f64, f64)> {
        let weight: f64 = each.iter().map(|m| m.weight).sum();
        let over = |f: fn(&Self) -> f64| each.iter().map(|m| m.weight * f(m)).sum::<f64>() / weight;
        let (mean, square) = (over(|m| m.mean), over(|m| m.square));
        let between = (over(|m| m.mean * m.mean) - mean * mean).max(0.0);
        (weight > 0.0).then(|| (mean, (square - mean * mean).max(0.0), between))
    }
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
    /// For a station of which so much is not known: the table's depth has a standard deviation, m.
    pub(super) fn new(
        table: &'t Propagation,
        rate_hz: f64,
        notes: Kind,
        lasting: Lasting,
        depth_sd_m: f64,
    ) -> Self {
        Self { table, rate_hz, notes, lasting, depth_sd_m }
    }

    /// Sum over notes of the correlation of a note's strongest arrival with what is about it.
    fn correlation(&self, pressure: &[Complex<f64>], notes: &[usize]) -> Vec<Complex<f64>> {
        let own = (self.notes.half_s * self.rate_hz) as isize;
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
        TAU * 0.5 * (self.notes.band_hz.0 + self.notes.band_hz.1) / self.rate_hz
    }

    /// Place of lag zero.
    fn zero(&self) -> usize {
        (LAGS_S.0 * self.rate_hz) as usize
    }

    /// The correlation made ready; `None` without any.
    fn prepared(&self, pressure: &[Complex<f64>], notes: &[usize]) -> Option<Correlation> {
        let x = self.correlation(pressure, notes);
        let own = (self.notes.half_s * self.rate_hz) as usize;
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
        if self.depth_sd_m > MOST_DEPTH_SD_M {
            return None;
        }
        let c = self.prepared(pressure, notes)?;
        let steps = (self.table.max_range_m().min(FARTHEST_M) / STEP_M) as usize + 1;
        // Where the table's depth is not sure, whales over floors of other depths are looked for as well.
        let scans: Vec<Scan> =
            self.depths().par_iter().map(|d| self.scan(&c, *d, 0..steps, interval_s)).collect();
        let prior = |s: &Scan| self.log_prior(s.deeper_m);
        let first = scans.iter().max_by(|a, b| (a.top.0 + prior(a)).total_cmp(&(b.top.0 + prior(b))))?;
        // Where the arrivals are not as the table has them, what differs counts as noise: it is alike at every range.
        let left = unexplained(&c, &self.fitted(&c, first, interval_s)?.sum);
        let temper = TEMPER.min(c.variance / left);
        let weight = |s: &Scan| s.greatest() * temper + prior(s);
        let likeliest = scans.iter().max_by(|a, b| weight(a).total_cmp(&weight(b)))?;
        let best = likeliest.best()?;
        let fitted = self.fitted(&c, likeliest, interval_s)?;
        let (top, top_prior) = (likeliest.greatest(), prior(likeliest));
        if !(top > LEAST_LOG_RATIO) {
            return None;
        }
        let by_depth_m = self.lasting.of_range(place(best), 0.0).0.sqrt();
        let one_place = ONE_PLACE.hypot(2.0 * by_depth_m / place(best).max(STEP_M));
        let at_place = |i: usize| (place(i) / place(best) - 1.0).abs() < one_place;
        let (mut all, mut share) = (0.0, 0.0);
        for s in &scans {
            let differs = prior(s) - top_prior;
            for (i, l) in s.fine.iter().enumerate() {
                let p = place(i) * ((l - top) * temper + differs).exp();
                all += p;
                share += if at_place(i) { p } else { 0.0 };
            }
        }
        let at_edge = best + 1 == likeliest.fine.len();
        let noise = c.variance * c.used.len() as f64;
        let like = c.power - fitted.gain - noise <= UNLIKE * fitted.own;
        let heard = self.worth() * fitted.own / c.variance > LEAST_LOG_RATIO;
        if share < SURE * all || place(best) < self.notes.nearest_m || at_edge || !like || !heard {
            return None;
        }
        let near: Vec<usize> = (0..likeliest.fine.len()).filter(|i| at_place(*i)).collect();
        let moments =
            |s: &Scan| Moments::of(s, &near, place(best), WITHIN * temper, top, prior(s) - top_prior);
        let mut each: Vec<Moments> = scans.iter().map(moments).collect();
        if scans.len() > 1 {
            // The coarse depths tell where to look; the range is that of depths nearer to each other.
            let greatest = each.iter().map(|m| m.weight).fold(0.0, f64::max);
            let counts = scans.iter().zip(&each).filter(|(_, m)| m.weight > HARDLY * greatest);
            let reach = counts.map(|(s, _)| s.deeper_m);
            let (from, to) = reach.fold((f64::MAX, f64::MIN), |(a, b), d| (a.min(d), b.max(d)));
            let (from, to) = (from - DEPTH_STEP_M, to + DEPTH_STEP_M);
            let rows = near.first()? / FINE..(near.last()? / FINE + 2).min(steps);
            let depth = |k: usize| from + (to - from) * k as f64 / DEPTHS_WITHIN as f64;
            each = (0..=DEPTHS_WITHIN)
                .into_par_iter()
                .map(|k| moments(&self.scan(&c, depth(k), rows.clone(), interval_s)))
                .collect();
        }
        let unsaid_m = UNSAID_M * fitted.gain / fitted.own;
        let (mean, variance, shared) = Moments::joined(&each)?;
        Some(CallRange {
            range_m: place(best) + mean,
            sd_m: (variance + unsaid_m * unsaid_m).sqrt(),
            shared_m: shared.sqrt(),
            log_ratio: top,
        })
    }

    /// How much each used sample is worth: samples of the band are not independent.
    fn worth(&self) -> f64 {
        (self.notes.band_hz.1 - self.notes.band_hz.0 + 1.0) / self.rate_hz
            * (self.rate_hz / HELD_HZ).floor().max(1.0)
    }

    /// By how much the floor may be deeper than the table's, m: all that is looked at.
    fn depths(&self) -> Vec<f64> {
        let reach = (DEPTH_REACH * self.depth_sd_m / DEPTH_STEP_M).ceil() as i32;
        (-reach..=reach).map(|k| DEPTH_STEP_M * f64::from(k)).collect()
    }

    /// Logarithm of how likely the floor is so much deeper, but for a constant.
    fn log_prior(&self, deeper_m: f64) -> f64 {
        if self.depth_sd_m > 0.0 { -0.5 * (deeper_m / self.depth_sd_m).powi(2) } else { 0.0 }
    }

    /// Log-likelihood ratios over a floor so much deeper, of those steps of range.
    fn scan(&self, c: &Correlation, deeper_m: f64, rows: Range<usize>, interval_s: Option<f64>) -> Scan {
        let mut log_ratio = vec![f64::NEG_INFINITY; rows.end];
        let mut top = (f64::NEG_INFINITY, 0, 0);
        for (i, slot) in log_ratio.iter_mut().enumerate().skip(rows.start) {
            // Which arrival was cut out is not known where several are about as strong.
            for cut in 0..self.table.paths.len() {
                let at = Place { range_m: STEP_M * i as f64, deeper_m, cut };
                let Some(fitted) = self.fit(c, at, interval_s) else { continue };
                let ratio = self.worth() * fitted.gain / c.variance;
                *slot = slot.max(ratio);
                if ratio > top.0 {
                    top = (ratio, i, cut);
                }
            }
        }
        // A loud call tells its place to a metre: between steps the log-likelihood is read by the cubic, or the cycle of which a step comes
        // nearest the peak would be taken for the likeliest.
        let fine = 0..rows.end.saturating_sub(1) * FINE + 1;
        let fine =
            fine.map(|i| if i / FINE < rows.start { f64::NEG_INFINITY } else { between(&log_ratio, i) });
        Scan { deeper_m, fine: fine.collect(), top }
    }

    /// The best of a scan again.
    fn fitted(&self, c: &Correlation, scan: &Scan, interval_s: Option<f64>) -> Option<Fitted> {
        let (_, i, cut) = scan.top;
        self.fit(c, Place { range_m: STEP_M * i as f64, deeper_m: scan.deeper_m, cut }, interval_s)
    }

    /// Arrival of a path at a range over a floor so much deeper than the table's: with lengths `Rₙ² = r² + n² h²` a path that crosses the
    /// water n times takes longer by `n² h T/Rₙ²` for each metre.
    fn arrival(&self, path: usize, range_m: f64, deeper_m: f64) -> Option<RayArrival> {
        let RayArrival { toa_s, amplitude } = self.table.arrival(path, range_m)?;
        let (n, h) = (f64::from(self.table.paths.get(path)?.crossings), self.table.depth_m);
        let longer_s = deeper_m * n * n * h * toa_s / (range_m * range_m + n * n * h * h);
        Some(RayArrival { toa_s: toa_s + longer_s, amplitude })
    }

    /// Adds the note's own correlation about a lag, times a factor, at the used samples.
    fn add(&self, c: &Correlation, out: &mut [Complex<f64>], lag_s: f64, factor: Complex<f64>) {
        let own = self.notes.half_s * self.rate_hz;
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

    /// What the correlation is for a whale at a place, as near as its free factors bring it;
    /// `None` where that is not among the strongest.
    ///
    /// The share of the note's own arrivals is real: the table tells their phases. When the calls before and after come is known to some
    /// hundredths of a second, and not to a part of a cycle: their arrivals, each call's together, may be turned by anything, or a wrong
    /// interval would choose the cycle and so the range.
    fn fit(&self, c: &Correlation, at: Place, interval_s: Option<f64>) -> Option<Fitted> {
        let arrival = |path: usize| self.arrival(path, at.range_m, at.deeper_m);
        let strongest = arrival(at.cut)?;
        let power = strongest.amplitude.norm_sqr();
        let arrivals: Vec<RayArrival> = (0..self.table.paths.len()).filter_map(arrival).collect();
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
