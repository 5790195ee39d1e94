//! Impulsive directions: calls of whales, short and rich in frequency, kept apart from vessels.
//!
//! Enters: the azigram rows of a window and how uneven in time each frame's pressure was. Leaves: at most one direction.
//! A call fills many bins of a few frames, so a frame's evidence for azimuth a is the product of w(u, a) over frequency
//! (square root, since Hann's bins go in pairs; R = 0.9; whole band or either half), and a window's is the product over
//! frames of `1 − Pd + Pd · evidence`: a call need not be in every frame. A vessel's noise near by is also rich in
//! frequency but steady; only frames whose energy in 0.64 s bursts stands out of its mean may hold a call.
//! That tells that there is a call, and who else is none. Its azimuth is that of what such bursts add to the sound between them (`bursts.rs`): a
//! vessel's noise is in a frame's bins too. Cost: 80 k instructions for each frame that may.

use super::evened::Evened;
use super::limits::{CIRCLE, HOP, WINDOW_FRAMES};
use super::row::Row;
use crate::math;
use crate::math::constant::{cos_of_turn, ln};

/// Azimuths searched.
const AZIMUTHS: usize = 64;

/// Codes of one azimuth step.
const STEP: usize = CIRCLE / AZIMUTHS;

/// Resultant length of a call's directions across frequency.
const RESULTANT: f64 = 0.9;

/// Probability that a frame which may hold a call does.
const DETECTION: f32 = 0.3;

/// One frame cannot say more than this.
const MOST: f32 = 15.0;

/// Directions nearer than this to the best are the same caller's, rad.
const ONE_CALLER: f32 = 0.6;

/// Its cosine.
const SAME_CALLER: f32 = 0.825;

/// Natural logarithm of the presence ratio wanted, as for tones.
const LOG_THRESHOLD: f32 = 9.21;

/// Samples of a burst.
pub(super) const BURST: usize = 32;

/// Half of ln w by difference of codes.
static HALF_LOG_RATIO: [f32; CIRCLE] = half_log_ratio();

const fn half_log_ratio() -> [f32; CIRCLE] {
    let mut out = [0f32; CIRCLE];
    let mut d = 0;
    while d < CIRCLE {
        let r = RESULTANT;
        let w = (1.0 - r * r) / (1.0 - 2.0 * r * cos_of_turn(d, CIRCLE) + r * r);
        out[d] = (0.5 * ln(w)) as f32;
        d += 1;
    }
    out
}

/// The bands in which bursts are looked for.
#[derive(Clone, Debug)]
pub struct Calls {
    /// About the tone band: whether a frame may hold a call.
    wide: Resonance,
    /// About the notes of whales, where vessels give least beside them: what bursts add.
    pub(super) notes: Resonance,
}

/// Second-order band-pass: gain, and the two recursive coefficients.
#[derive(Clone, Debug)]
pub(super) struct Resonance {
    gain: f32,
    feedback: [f32; 2],
}

impl Resonance {
    const EMPTY: Self = Self { gain: 0.0, feedback: [0.0; 2] };

    /// Of a centre and a centre over width, by the bilinear transform (constant 0 dB peak).
    fn fill(&mut self, rate_hz: f64, centre_hz: f64, quality: f64) {
        let centre = math::f64::TAU * centre_hz.min(0.4 * rate_hz) / rate_hz;
        let alpha = math::f64::sin(centre) / (2.0 * quality);
        let norm = 1.0 / (1.0 + alpha);
        self.feedback = [-2.0 * math::f64::cos(centre) * norm, (1.0 - alpha) * norm].map(|x| x as f32);
        self.gain = (alpha * norm) as f32;
    }

    /// A sample in the band, by what was before it.
    #[inline(always)]
    pub(super) fn filter(&self, past: &mut [[f32; 4]; 2], mut x: f32) -> f32 {
        let [a1, a2] = self.feedback;
        for [x1, x2, y1, y2] in past {
            let y = self.gain * (x - *x2) - a1 * *y1 - a2 * *y2;
            (*x2, *x1, *y2, *y1) = (*x1, x, *y1, y);
            x = y;
        }
        x
    }
}

/// One direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Call {
    /// Where most bins of its frames point, rad: between it and a vessel where they have both.
    pub leaning: f32,
    /// Azimuth, rad, and its standard deviation; without bursts that tell it, that of its bins, as uncertain as can be.
    pub azimuth: f32,
    pub sd: f32,
    /// Natural logarithm of the presence ratio.
    pub log_presence: f32,
}

impl Call {
    /// Gives what its bins tell its true azimuth, where noise along an axis was weighed.
    pub(super) fn turn_back(&mut self, evened: &Evened) {
        let of_bins = self.azimuth == self.leaning;
        (self.leaning, _) = evened.told(self.leaning);
        if of_bins {
            self.azimuth = self.leaning;
        }
    }
}

/// Filter memory and burst energies of the hop being filled.
#[derive(Clone, Debug)]
pub struct Unevenness {
    /// Two sections: two past inputs and outputs each.
    past: [[f32; 4]; 2],
    energy: f32,
    samples: usize,
    most: f32,
    total: f32,
}

impl Unevenness {
    /// All zeros.
    pub const fn new() -> Self {
        Self { past: [[0.0; 4]; 2], energy: 0.0, samples: 0, most: 0.0, total: 0.0 }
    }

    /// Takes a sample of pressure.
    #[inline(always)]
    pub fn push(&mut self, calls: &Calls, x: f32) {
        let x = calls.wide.filter(&mut self.past, x);
        self.energy += x * x;
        self.samples += 1;
        if self.samples == BURST {
            self.most = self.most.max(self.energy);
            self.total += self.energy;
            self.energy = 0.0;
            self.samples = 0;
        }
    }

    /// Greatest burst over the mean of the hop that just ended, in eighths; the next begins.
    pub fn end_hop(&mut self) -> u8 {
        let mean = self.total / (HOP / BURST) as f32;
        let ratio = if mean > 0.0 { 8.0 * self.most / mean } else { 0.0 };
        self.most = 0.0;
        self.total = 0.0;
        ratio.clamp(0.0, 255.0) as u8
    }
}

impl Calls {
    /// No filters yet; all zeros.
    pub const EMPTY: Self = Self { wide: Resonance::EMPTY, notes: Resonance::EMPTY };

    /// The filters for samples at `rate_hz`.
    pub fn fill(&mut self, rate_hz: f64) {
        self.wide.fill(rate_hz, 16.2, 1.25);
        self.notes.fill(rate_hz, 20.5, 2.0);
    }
}

/// Searches the frames of a window; `turn`: true azimuth of the north component, as the band's.
pub fn search(bins: usize, turn: f32, rows: &[&Row]) -> Option<Call> {
    let mut total = [0f32; AZIMUTHS];
    let mut frames = 0;
    for row in rows.iter().filter(|r| r.may_hold_a_call()) {
        frames += 1;
        let (mut low, mut high) = ([0f32; AZIMUTHS], [0f32; AZIMUTHS]);
        for (f, direction) in row.directions().enumerate().take(bins) {
            let Some((code, _)) = direction else { continue };
            let half = if 2 * f < bins { &mut low } else { &mut high };
            let first = CIRCLE - usize::from(code);
            for (a, sum) in half.iter_mut().enumerate() {
                *sum += HALF_LOG_RATIO.get((first + a * STEP) % CIRCLE).copied().unwrap_or(0.0);
            }
        }
        for (t, (l, h)) in total.iter_mut().zip(low.iter().zip(&high)) {
            // The mean over the three bands a call may fill is near its greatest term.
            let evidence = (l.max(*h).max(l + h) - 1.1).min(MOST);
            *t += math::log_sum(math::f32::ln(1.0 - DETECTION), math::f32::ln(DETECTION) + evidence);
        }
    }
    if frames == 0 {
        return None;
    }
    let (best, top) =
        total.iter().enumerate().fold((0, f32::NEG_INFINITY), |b, (i, x)| if *x > b.1 { (i, *x) } else { b });
    let sum: f32 = total.iter().map(|t| math::f32::exp(t - top)).sum();
    let log_presence = top + math::f32::ln(sum / AZIMUTHS as f32);
    if log_presence <= LOG_THRESHOLD {
        return None;
    }
    // Mean of the posterior about its top: a second caller elsewhere must not draw the mean between both.
    let step = math::f32::TAU / AZIMUTHS as f32;
    let (mut mean, mut share) = (0f32, 0f32);
    for (i, t) in total.iter().enumerate() {
        let d = crate::angle::wrap_pi_f32((i as f32 - best as f32) * step);
        if math::f32::abs(d) < ONE_CALLER {
            let p = math::f32::exp(t - top);
            share += p;
            mean += p * d;
        }
    }
    let leaning = crate::angle::wrap_tau_f32(best as f32 * step + mean / share);
    let (azimuth, sd) =
        of_bursts(rows).map_or((leaning, f32::INFINITY), |(azimuth, sd)| (azimuth + turn, sd));
    Some(Call { leaning, azimuth: crate::angle::wrap_tau_f32(azimuth), sd, log_presence })
}

/// Azimuth, clockwise from the north component, of what bursts add in the frames that may hold a call, and its standard deviation, rad. The
/// loudest frame tells whose call counts.
#[inline(never)]
fn of_bursts(rows: &[&Row]) -> Option<(f32, f32)> {
    let mut heard = [([0f32; 2], 0f32); WINDOW_FRAMES];
    let (mut loudest, mut most) = ([0f32; 2], 0f32);
    for (slot, row) in heard.iter_mut().zip(rows.iter().filter(|r| r.may_hold_a_call())) {
        let Some((towards, sd)) = row.excess.get() else { continue };
        let length = math::f32::sqrt(along(towards, towards));
        *slot = (towards, sd * length);
        if length > most {
            (loudest, most) = (towards, length);
        }
    }
    let (mut frames, mut sum) = (0f32, [0f32; 2]);
    for (towards, sd) in &mut heard {
        let length = math::f32::sqrt(along(*towards, *towards));
        if along(*towards, loudest) > SAME_CALLER * length * most {
            frames += 1.0;
            sum = [sum[0] + towards[0], sum[1] + towards[1]];
        } else {
            (*towards, *sd) = ([0.0; 2], 0.0);
        }
    }
    let length = math::f32::sqrt(along(sum, sum));
    if !(length > 0.0 && length < f32::MAX) {
        return None;
    }
    let (mut scatter, mut own) = (0f32, 0f32);
    for (towards, sd) in heard {
        let across = along(towards, [sum[1], -sum[0]]) / length;
        scatter += across * across;
        own += sd * sd;
    }
    // Frames overlap by half: two are worth one. Of few the scatter is not well known either (Student's law).
    let worth = math::greater(0.5 * frames - 1.0, 0.5);
    let few = 1.0 + 0.6 / worth;
    let variance = math::greater(own, scatter * (1.0 + 1.0 / worth) * few * few) * math::lesser(frames, 2.0);
    Some((math::f32::atan2(sum[0], sum[1]), math::f32::sqrt(variance) / length))
}

/// Product of two vectors.
fn along([x, y]: [f32; 2], [u, v]: [f32; 2]) -> f32 {
    x * u + y * v
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::obs::bursts::Excess;
    use crate::obs::row::UNEVEN;

    #[test]
    fn the_table_is_the_formula() {
        for (d, l) in HALF_LOG_RATIO.iter().enumerate() {
            let cos = math::f64::cos(math::f64::TAU * d as f64 / CIRCLE as f64);
            let w = (1.0 - RESULTANT * RESULTANT) / (1.0 - 2.0 * RESULTANT * cos + RESULTANT * RESULTANT);
            assert_eq!(*l, (0.5 * math::f64::ln(w)) as f32, "{d}");
        }
    }

    #[test]
    fn a_call_in_few_frames_is_found_and_a_steady_source_is_not() {
        let mut seed = 7u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 22) as u16
        };
        let mut rows: std::vec::Vec<Row> = (0..18)
            .map(|_| {
                let mut row = Row::EMPTY;
                row.fill((0..266).map(|_| Some((random(), 0))));
                row.uneven = 40;
                row
            })
            .collect();
        assert_eq!(search(266, 0.0, &rows.iter().collect::<std::vec::Vec<_>>()), None);
        for k in [3, 9, 15] {
            let old: std::vec::Vec<_> = rows[k].directions().take(140).collect();
            rows[k].fill(old.into_iter().chain((140..266).map(|_| Some((300 + random() / 20, 0)))));
        }
        let call = search(266, 0.0, &rows.iter().collect::<std::vec::Vec<_>>()).unwrap();
        let degrees = call.leaning.to_degrees();
        assert!((degrees - 114.5).abs() < 5.0 && call.sd == f32::INFINITY, "{degrees}");
        // Its azimuth is that of its bursts, from the north component's on; one weaker call from elsewhere does not draw it.
        for (k, (east, north)) in [(3, (1.0, 0.05)), (9, (1.0, -0.05)), (15, (-0.5, 0.0))] {
            rows[k].excess = Excess::new([1e9 * east, 1e9 * north], 0.02);
        }
        let call = search(266, 0.5, &rows.iter().collect::<std::vec::Vec<_>>()).unwrap();
        assert!(math::f32::abs(call.azimuth - 0.5 - math::f32::TAU / 4.0) < 0.01, "{call:?}");
        assert!((0.05..0.4).contains(&call.sd), "{call:?}");
        rows.iter_mut().for_each(|r| r.uneven = 14);
        assert_eq!(search(266, 0.0, &rows.iter().collect::<std::vec::Vec<_>>()), None);
    }

    #[test]
    fn a_burst_is_uneven_and_noise_is_not() {
        let mut calls = Calls::EMPTY;
        calls.fill(50.0);
        let mut u = Unevenness::new();
        let mut seed = 3u32;
        let mut noise = || {
            let mut sum = 0.0;
            for _ in 0..6 {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum += (seed >> 8) as f32 / 8_388_608.0 - 1.0;
            }
            sum
        };
        let mut steady = 0;
        for _ in 0..200 {
            (0..HOP).for_each(|_| u.push(&calls, noise()));
            steady += usize::from(u.end_hop() >= UNEVEN);
        }
        assert!(steady <= 30, "{steady}");
        (0..HOP).for_each(|i| {
            let tone = if (100..150).contains(&i) { 6.0 * math::f32::sin(i as f32 * 2.4) } else { 0.0 };
            u.push(&calls, noise() + tone);
        });
        assert!(u.end_hop() >= UNEVEN);
    }
}
