//! Calls of whales, from a recording: direction and range of short notes that repeat (fin whales about 20 Hz).
//!
//! A note reaches the floor once for each path, and the delays between its arrivals are those of the propagation table, as for a vessel's
//! interference [O 16]. Each minute's three-minute window of pressure and horizontal velocities is cut to [`BAND_HZ`] and made analytic.
//!
//! - *Notes* are peaks of the smoothed power 6 dB above its median, the greatest first, none within [`APART_S`] of another.
//! - *Azimuth*: the active intensity about each note's peak; the mean of their directions, and its deviation from their scatter.
//! - *Range*: each note's strongest arrival k, cut out at its peak, is correlated with what is heard from 7 s before it to 9 s after;
//!   the sum over notes is `X(τ)`. About lag zero it is the note's own correlation `X₀`, so that for a whale at range r it is
//!   `a Σ_m A_k A_m*/|A_k|² X₀(τ − (T_m − T_k))` over the table's arrivals: travel times T, amplitudes A, and a share a that noise in the cut-out
//!   note leaves. Where notes come at equal intervals, the arrivals of the calls before and after are part of it. The log-likelihood ratio
//!   against noise, `Re⟨M,X⟩²/(⟨M,M⟩ v)` with v the variance of X where nothing is, counts for each independent sample of the band; with a
//!   prior in proportion to area it becomes a posterior over range.
//!
//! A range is told where its place holds nine tenths of the posterior; nearer than [`NEAREST_M`] and where nothing stands out
//! there is none. Calls are joined to a caller's way, apart from vessels' tracks ([`super::caller_ways`]). Not known: several whales at once whose notes
//! interleave (the louder one counts), and calls longer than a few seconds, which have no range.

use crate::propagation::{Complex, Propagation};
use crate::recording::BlockSource;
use anyhow::{Result, bail};
use seabearing_core::angle::{wrap_pi, wrap_tau};
use seabearing_core::block::{Frame, MISSING};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::kit::quantile;
use seabearing_signal::{Fft, Precision, RealToComplex};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Frequencies of the notes, Hz.
pub const BAND_HZ: (f64, f64) = (15.0, 25.0);
/// Half a window, s.
const HALF_WINDOW_S: f64 = 90.0;
/// Notes nearer to each other than this are one call's arrivals, s: longer than the longest delay of its strong paths.
pub const APART_S: f64 = 8.0;
/// Fewest notes of a window that make a call.
const LEAST_NOTES: usize = 3;
/// Peak power of a note over the median, times.
const STANDS_OUT: f64 = 4.0;
/// Half the length over which power is smoothed, s.
const SMOOTH_S: f64 = 0.4;
/// Nearest range told, m: nearer, delays hardly change with range.
pub const NEAREST_M: f64 = 2_000.0;
/// Farthest, m.
pub const FARTHEST_M: f64 = 30_000.0;
/// Step of range, m: a twentieth of what turns two arrivals by a cycle of 20 Hz against each other.
const STEP_M: f64 = 10.0;
/// Places between two steps.
const FINE: usize = 10;
/// Error of a range that the likelihood does not know of, m.
const UNSAID_M: f64 = 1.0;
/// Lags looked at before and after a note's strongest arrival, s.
const LAGS_S: (f64, f64) = (7.0, 9.0);
/// Half the length of a note, s.
const OWN_S: f64 = 0.6;
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

/// What was heard of calls in the three minutes about an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WhaleCall {
    /// The instant, s after the first sample.
    pub t_s: f64,
    /// Notes in the window.
    pub notes: usize,
    /// From note to note, s; `None` where it is not steady.
    pub interval_s: Option<f64>,
    /// True azimuth and its standard deviation, rad; `None` without the horizontal components.
    pub azimuth: Option<(f64, f64)>,
    /// Range, where the delays of the notes' arrivals are a range's.
    pub range: Option<CallRange>,
}

/// Looks for calls in one window after another.
struct Listener<'t> {
    table: &'t Propagation,
    rate_hz: f64,
    turn: f64,
    n: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn Fft<f64>>,
}

/// Calls of a recording, minute by minute.
///
/// # Errors
/// The recording cannot be read, or its rate is not between 50 and 100 Hz.
pub fn calls(
    source: &mut dyn BlockSource,
    config: &StationConfig,
    table: &Propagation,
) -> Result<Vec<WhaleCall>> {
    let rate_hz = config.rate_hz;
    if !(50.0..=100.0).contains(&rate_hz) {
        bail!("{rate_hz} Hz: notes are looked for in recordings of 50 to 100 Hz");
    }
    let Kind::Obs(obs) = &config.kind else { bail!("an ocean-bottom station is needed") };
    let away = if obs.intensity_towards { 0.0 } else { PI };
    let length = (2.0 * HALF_WINDOW_S * rate_hz) as usize;
    let n = (2 * length).next_power_of_two();
    let listener = Listener {
        table,
        rate_hz,
        turn: obs.orientation_of_north_deg.to_radians() + away,
        n,
        forward: f64::real_to_complex(n),
        inverse: f64::complex_inverse(n),
    };
    let mut held: Vec<Frame> = Vec::new();
    let mut first = 0u64;
    let mut minute = 1u64;
    let mut out = Vec::new();
    while let Some(block) = source.next_block()? {
        if first + held.len() as u64 != block.first_index {
            held.clear();
            first = block.first_index;
        }
        held.extend_from_slice(block.frames);
        loop {
            let from = ((60.0 * minute as f64 - HALF_WINDOW_S) * rate_hz).round();
            // What began after the window's beginning was lost, or never was.
            if from < first as f64 {
                minute += 1;
                continue;
            }
            let from = (from as u64 - first) as usize;
            let Some(window) = held.get(from..from + length) else { break };
            out.extend(listener.window(window, 60.0 * minute as f64));
            minute += 1;
        }
        let keep = ((60.0 * minute as f64 - HALF_WINDOW_S) * rate_hz - first as f64).max(0.0) as usize;
        let done = keep.min(held.len());
        held.drain(..done);
        first += done as u64;
    }
    Ok(out)
}

impl Listener<'_> {
    /// A channel cut to the band, as an analytic signal; `None` where a code is missing.
    fn analytic(&self, window: &[Frame], channel: usize) -> Option<Vec<Complex<f64>>> {
        if window.iter().any(|f| f[channel] == MISSING) {
            return None;
        }
        let mean = window.iter().map(|f| f64::from(f[channel])).sum::<f64>() / window.len() as f64;
        let mut samples = vec![0.0; self.n];
        for (x, f) in samples.iter_mut().zip(window) {
            *x = f64::from(f[channel]) - mean;
        }
        let mut half = self.forward.make_output_vec();
        self.forward.process(&mut samples, &mut half).ok()?;
        let mut x = vec![Complex::default(); self.n];
        x.iter_mut().zip(half).for_each(|(x, h)| *x = h);
        let (lo, hi) = BAND_HZ;
        for (k, x) in x.iter_mut().enumerate() {
            let hz = k as f64 * self.rate_hz / self.n as f64;
            // Edges of 1 Hz.
            let edge = (hz - lo + 1.0).min(hi + 1.0 - hz).clamp(0.0, 1.0);
            let inside = if 2 * k < self.n { edge * edge * (3.0 - 2.0 * edge) } else { 0.0 };
            *x *= 2.0 * inside / self.n as f64;
        }
        self.inverse.process(&mut x);
        x.truncate(window.len());
        Some(x)
    }

    fn window(&self, window: &[Frame], t_s: f64) -> Option<WhaleCall> {
        let pressure = self.analytic(window, 0)?;
        let notes = self.notes(&pressure);
        if notes.len() < LEAST_NOTES {
            return None;
        }
        let interval_s = self.interval(&notes);
        let horizontals = self.analytic(window, 1).zip(self.analytic(window, 2));
        let azimuth = horizontals.and_then(|(north, east)| self.azimuth(&pressure, &north, &east, &notes));
        let range = self.range(&pressure, &notes, interval_s);
        Some(WhaleCall { t_s, notes: notes.len(), interval_s, azimuth, range })
    }

    /// Samples at which notes peak, in order.
    fn notes(&self, pressure: &[Complex<f64>]) -> Vec<usize> {
        let half = (SMOOTH_S * self.rate_hz) as usize;
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(pressure.iter().scan(0.0, |sum, p| {
                *sum += p.norm_sqr();
                Some(*sum)
            }))
            .collect();
        let n = pressure.len();
        let power: Vec<f64> = (0..n)
            .map(|i| {
                let (a, b) = (i.saturating_sub(half), (i + half + 1).min(n));
                (sums[b] - sums[a]) / (b - a) as f64
            })
            .collect();
        let Some(median) = quantile::median(&mut power.clone()) else { return Vec::new() };
        let mut order: Vec<usize> = (0..n).filter(|i| power[*i] > STANDS_OUT * median).collect();
        order.sort_by(|a, b| power[*b].total_cmp(&power[*a]));
        let apart = (APART_S * self.rate_hz) as usize;
        let mut out: Vec<usize> = Vec::new();
        for i in order {
            if out.iter().all(|o| o.abs_diff(i) > apart) {
                out.push(i);
            }
        }
        out.sort_unstable();
        // An earthquake or a T phase stands out as well, but not as notes do: they are short and alike.
        let strongest = out.iter().map(|i| power[*i]).fold(0.0, f64::max);
        out.retain(|i| power[*i] > 0.1 * strongest);
        let long = power.iter().filter(|p| **p > 0.25 * strongest).count() as f64 / self.rate_hz;
        if long > 8.0 * out.len() as f64 { Vec::new() } else { out }
    }

    /// The interval of notes that come steadily.
    fn interval(&self, notes: &[usize]) -> Option<f64> {
        let mut steps: Vec<f64> = notes.windows(2).map(|w| (w[1] - w[0]) as f64 / self.rate_hz).collect();
        let middle = quantile::median(&mut steps)?;
        // A note may be missing between two; most steps must agree.
        let near: Vec<f64> = steps.iter().copied().filter(|s| (s - middle).abs() < 0.15).collect();
        (2 * near.len() > steps.len()).then(|| near.iter().sum::<f64>() / near.len() as f64)
    }

    fn azimuth(
        &self,
        pressure: &[Complex<f64>],
        north: &[Complex<f64>],
        east: &[Complex<f64>],
        notes: &[usize],
    ) -> Option<(f64, f64)> {
        let half = (OWN_S * self.rate_hz) as usize;
        let each: Vec<(f64, f64)> = notes
            .iter()
            .map(|i| {
                let span = i.saturating_sub(half)..(i + half + 1).min(pressure.len());
                let (mut x, mut y) = (0.0, 0.0);
                for k in span {
                    x += (pressure[k].conj() * east[k]).re;
                    y += (pressure[k].conj() * north[k]).re;
                }
                (x, y)
            })
            .collect();
        let (x, y) = each.iter().fold((0.0, 0.0), |s, d| (s.0 + d.0, s.1 + d.1));
        if x == 0.0 && y == 0.0 {
            return None;
        }
        let mean = x.atan2(y);
        // The mean weighs each note by its intensity; its deviation is that of notes about it.
        let weights: Vec<f64> = each.iter().map(|d| d.0.hypot(d.1)).collect();
        let total: f64 = weights.iter().sum();
        let square: f64 = each
            .iter()
            .zip(&weights)
            .map(|(d, w)| (w / total * wrap_pi(d.0.atan2(d.1) - mean)).powi(2))
            .sum();
        let n = each.len() as f64;
        // Of few notes their scatter is not well known either (Student's law).
        let sd = (square * n / (n - 1.0)).sqrt().max(1e-3) * (1.0 + 1.25 / (n - 1.0));
        (sd < 1.0).then(|| (wrap_tau(mean + self.turn), sd))
    }

    /// Sum over notes of the correlation of a note's strongest arrival with what is about it; lag zero stands at [`Self::zero`].
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

    fn range(
        &self,
        pressure: &[Complex<f64>],
        notes: &[usize],
        interval_s: Option<f64>,
    ) -> Option<CallRange> {
        let x = self.correlation(pressure, notes);
        let own = (OWN_S * self.rate_hz) as usize;
        let outside = |k: &usize| k.abs_diff(self.zero()) > own;
        let mut powers: Vec<f64> = (0..x.len()).filter(outside).map(|k| x[k].norm_sqr()).collect();
        // Of a complex normal variable the median power is ln 2 times the mean.
        let variance = quantile::median(&mut powers)? / std::f64::consts::LN_2;
        // Samples of the band are not independent: so many are worth one.
        let worth = (BAND_HZ.1 - BAND_HZ.0 + 1.0) / self.rate_hz;
        // Free of the carrier, so that a straight line joins two samples.
        let zero = self.zero() as f64;
        let slow: Vec<Complex<f64>> = x
            .iter()
            .enumerate()
            .map(|(k, x)| x * Complex::from_polar(1.0, -self.carrier() * (k as f64 - zero)))
            .collect();
        let steps = ((FARTHEST_M - NEAREST_M) / STEP_M) as usize + 1;
        let place = |i: usize| NEAREST_M + STEP_M * i as f64;
        let mut log_ratio = vec![f64::NEG_INFINITY; steps];
        let mut best_fit = (f64::NEG_INFINITY, variance);
        for (i, slot) in log_ratio.iter_mut().enumerate() {
            // Which arrival was cut out is not known where several are about as strong.
            for cut in 0..self.table.paths.len() {
                let Some(model) = self.model(place(i), cut, interval_s, &slow) else { continue };
                let Some((gain, fitted)) = model.fit(&x, &outside) else { continue };
                let ratio = worth * gain / variance;
                *slot = slot.max(ratio);
                if ratio > best_fit.0 {
                    best_fit = (ratio, unexplained(&x, &model.sum(fitted), &outside));
                }
            }
        }
        // A loud call tells its place to a metre: between steps the log-likelihood is read by the cubic, or the cycle of which a step comes
        // nearest the peak would be taken for the likeliest.
        let fine: Vec<f64> = (0..(steps - 1) * FINE + 1).map(|i| between(&log_ratio, i)).collect();
        let place = |i: usize| NEAREST_M + STEP_M / FINE as f64 * i as f64;
        let best = (0..fine.len()).max_by(|a, b| fine[*a].total_cmp(&fine[*b]))?;
        let top = fine[best];
        if !(top > LEAST_LOG_RATIO) {
            return None;
        }
        // Where the arrivals are not as the table has them, what differs counts as noise: it is alike at every range.
        let temper = TEMPER.min(variance / best_fit.1);
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
        let at_edge = best == 0 || best + 1 == fine.len();
        if share < SURE * all || at_edge {
            return None;
        }
        let (mean, square) = (mean / inside, square / inside);
        let variance_m2 = (square - mean * mean).max(0.0) + UNSAID_M * UNSAID_M;
        Some(CallRange { range_m: place(best) + mean, sd_m: variance_m2.sqrt(), log_ratio: top })
    }

    /// What the correlation is for a whale at a range whose arrival over path number `cut` was cut out; `None` where that is not among
    /// the strongest.
    fn model(
        &self,
        range_m: f64,
        cut: usize,
        interval_s: Option<f64>,
        slow: &[Complex<f64>],
    ) -> Option<Model> {
        let arrivals: Vec<_> =
            (0..self.table.paths.len()).filter_map(|p| self.table.arrival(p, range_m)).collect();
        let strongest = self.table.arrival(cut, range_m)?;
        let power = strongest.amplitude.norm_sqr();
        let most = arrivals.iter().map(|a| a.amplitude.norm_sqr()).fold(0.0, f64::max);
        if arrivals.len() < 2 || power < ALIKE * most {
            return None;
        }
        let own = OWN_S * self.rate_hz;
        let zero = self.zero();
        // The note's own correlation about a lag.
        let add = |out: &mut [Complex<f64>], lag_s: f64, c: Complex<f64>| {
            let middle = lag_s * self.rate_hz + zero as f64;
            let (first, last) = ((middle - own).ceil().max(0.0), (middle + own).floor());
            let step = Complex::from_polar(1.0, self.carrier());
            let fade_step = Complex::from_polar(1.0, PI / own);
            let mut turned = c * Complex::from_polar(1.0, self.carrier() * (first - middle));
            let mut fade = Complex::from_polar(0.5, PI * (first - middle) / own);
            let mut k = first;
            while k <= last && k < slow.len() as f64 {
                let off = k - middle;
                let (j, part) = (off.floor(), off - off.floor());
                let at = |j: f64| slow.get((zero as f64 + j) as usize).copied().unwrap_or_default();
                let between = at(j) * (1.0 - part) + at(j + 1.0) * part;
                out[k as usize] += between * turned * (0.5 + fade.re);
                (turned, fade) = (turned * step, fade * fade_step);
                k += 1.0;
            }
        };
        let none = || vec![Complex::default(); slow.len()];
        let mut own_arrivals = none();
        let mut others = interval_s.map(|t| [(t, none()), (-t, none())]);
        for a in &arrivals {
            let c = strongest.amplitude * a.amplitude.conj() / power;
            let lag_s = a.toa_s - strongest.toa_s;
            if lag_s != 0.0 {
                add(&mut own_arrivals, lag_s, c);
            }
            for (t, out) in others.iter_mut().flatten() {
                add(out, lag_s + *t, c);
            }
        }
        Some(Model { own: own_arrivals, others: others.map(|all| all.map(|(_, out)| out)) })
    }
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

/// What a correlation is for a whale at a range, of unit strength.
struct Model {
    /// Of the note's own arrivals.
    own: Vec<Complex<f64>>,
    /// Of those of the call after it and of the call before it, where calls come at equal intervals.
    others: Option<[Vec<Complex<f64>>; 2]>,
}

/// Factors of a model's parts: of the note's own arrivals, and of the calls after and before it.
type Factors = (f64, [Complex<f64>; 2]);

impl Model {
    /// The factors with which it is nearest to a correlation, and how much less of that is left then, power summed over samples. `None`
    /// where nothing would arrive.
    ///
    /// The share of the note's own arrivals is real: the table tells their phases. When the calls before and after come is known to some
    /// hundredths of a second, and not to a part of a cycle: their arrivals, each call's together, may be turned by anything, or a wrong
    /// interval would choose the cycle and so the range.
    fn fit(&self, x: &[Complex<f64>], outside: &dyn Fn(&usize) -> bool) -> Option<(f64, Factors)> {
        let inner = |a: &[Complex<f64>], b: &[Complex<f64>]| -> Complex<f64> {
            a.iter().zip(b).enumerate().filter(|(k, _)| outside(k)).map(|(_, (a, b))| a.conj() * b).sum()
        };
        let (mut along, mut energy) = (inner(&self.own, x).re, inner(&self.own, &self.own).re);
        let others = self.others.as_ref().map(|others| {
            others.each_ref().map(|m| (inner(m, x), inner(m, &self.own), inner(m, m).re)).map(
                |(with_x, with_own, own)| {
                    let part = 1.0 / own.max(f64::MIN_POSITIVE);
                    (with_x * part, with_own * part, own)
                },
            )
        });
        let whole = (along, energy);
        // What the other calls explain, with whatever factor, tells nothing of the note's own arrivals.
        for (with_x, with_own, own) in others.iter().flatten() {
            along -= own * (with_own.conj() * with_x).re;
            energy -= own * with_own.norm_sqr();
        }
        if energy <= HARDLY * whole.1 {
            return None;
        }
        let share = (along / energy).clamp(STRENGTHS.0, STRENGTHS.1);
        let mut gain = 2.0 * share * whole.0 - share * share * whole.1;
        let mut factors = [Complex::default(); 2];
        for (factor, (with_x, with_own, own)) in factors.iter_mut().zip(others.iter().flatten()) {
            let free = with_x - with_own * share;
            let most = STRENGTHS.1 / free.norm().max(STRENGTHS.1);
            *factor = free * most;
            gain += own * (2.0 * (factor.conj() * free).re - factor.norm_sqr());
        }
        Some((gain, (share, factors)))
    }

    /// The sum of its parts, each times its factor.
    fn sum(&self, (share, factors): Factors) -> Vec<Complex<f64>> {
        let mut out: Vec<_> = self.own.iter().map(|m| m * share).collect();
        for (other, factor) in self.others.iter().flatten().zip(factors) {
            out.iter_mut().zip(other).for_each(|(out, m)| *out += m * factor);
        }
        out
    }
}

/// Mean power that a model leaves of a correlation where it has arrivals.
fn unexplained(x: &[Complex<f64>], model: &[Complex<f64>], outside: &dyn Fn(&usize) -> bool) -> f64 {
    let greatest = model.iter().map(Complex::norm_sqr).fold(0.0, f64::max);
    let (mut sum, mut n) = (0.0, 0.0f64);
    for (_, (x, m)) in
        x.iter().zip(model).enumerate().filter(|(k, (_, m))| outside(k) && m.norm_sqr() > HARDLY * greatest)
    {
        sum += (x - m).norm_sqr();
        n += 1.0;
    }
    sum / n.max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ocean_bottom::caller_ways::ways;
    use crate::ocean_bottom::scenario::{ObsScenario, Whale};
    use crate::ocean_bottom::simulate::Simulator;
    use crate::ocean_bottom::station;
    use crate::propagation::{bottom::Bottom, profile::SpeedProfile, trace};

    fn table() -> Propagation {
        let profile = SpeedProfile::subtropical(4340.0).unwrap();
        trace::trace("t", &profile, &Bottom::default(), 70.0, 600, || ())
    }

    fn heard(whales: &[(f64, f64, f64)]) -> Vec<WhaleCall> {
        let scenario: ObsScenario = toml::from_str(
            "kind = \"obs\"\nseed = 4\nduration_s = 900.0\npropagation = \"t\"\norientation_of_north_deg = 77.0\n",
        )
        .unwrap();
        let whale = |(azimuth_deg, range_m, level_db): &(f64, f64, f64)| Whale {
            azimuth_deg: *azimuth_deg,
            range_m: *range_m,
            start_s: -60.0,
            duration_s: 900.0,
            interval_s: 13.0,
            level_db: *level_db,
        };
        let scenario = ObsScenario { fin_whale: whales.iter().map(whale).collect(), ..scenario };
        let (table, config) = (table(), station::config(&scenario, false).unwrap());
        let mut simulator = Simulator::new(scenario, table.clone(), Vec::new()).unwrap();
        calls(&mut simulator, &config, &table).unwrap()
    }

    #[test]
    fn a_fin_whale_has_azimuth_and_range() {
        for (azimuth, range) in [(200.0, 5_000.0), (340.0, 12_000.0)] {
            let found = heard(&[(azimuth, range, 18.0)]);
            assert!(found.len() >= 10, "{range}: {} windows", found.len());
            let ranges: Vec<f64> = found.iter().filter_map(|c| Some(c.range?.range_m)).collect();
            assert!(2 * ranges.len() >= found.len(), "{range}: {ranges:?}");
            assert!(ranges.iter().all(|r| (r / range - 1.0).abs() < 0.1), "{range}: {ranges:?}");
            for c in &found {
                let (a, _) = c.azimuth.unwrap();
                assert!(wrap_pi(a - f64::to_radians(azimuth)).abs() < 0.1, "{a}");
            }
            let ways = ways(&found);
            assert_eq!(ways.len(), 1);
            let off = (ways[0].place_m.0.hypot(ways[0].place_m.1) / range - 1.0).abs();
            assert!(off < 0.05, "{ways:?}");
        }
    }

    #[test]
    fn a_sea_without_calls_has_none() {
        assert!(heard(&[]).iter().all(|c| c.range.is_none()));
    }
}
