//! Arrival-time differences of the loudest source, pair by pair, from a compact array's samples.
//!
//! In: samples of the recorder's four channels. Out: every so many seconds (`SEGMENT_S`) the six delays, each measured by itself, so that no places of
//! hydrophones are assumed but to say how long a delay can be. Cross-spectra of Hann frames that overlap by half are divided by the root of
//! both auto-spectra, smoothed over more than the image's fringes are wide; where their correlation is highest, Newton's steps with weights `g/(1 − g²)` (g: coherence steered to the delay,
//! a mean over nine bins) find the delay. It belongs to the time about which the segment's power lies.
//!
//! Fails where two vessels are as loud as each other: pairs then tell delays of either, and contradict each other. A vessel and its image in
//! the surface are told as one, between both: where the two nearly cancel their phase swings far to one side, and a fainter image turns that
//! about, so that these frequencies must count by the little power that they have.

use seabearing_core::block::{Block, CHANNELS, Frame, MISSING};
use seabearing_core::config::{ArrayConfig, StationConfig};
use seabearing_core::geometry::PAIRS;
use seabearing_locate::orient::geometry::TimedDelays;
use seabearing_signal::{Complex, ComplexToReal, Precision, RealToComplex};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Length of one segment, seconds.
const SEGMENT_S: f64 = 0.5;
/// Least length of a frame, seconds: fifty times what sound takes across an array.
const FRAME_S: f64 = 0.05;
/// Values between two lags that are looked at.
const FINER: usize = 4;
/// Fewest frames of a segment.
const LEAST_FRAMES: usize = 6;
/// Highest correlation that noise alone may have, in its standard deviations: one of some hundred lags in a million.
const DETECTED: f64 = 6.0;
/// Frequencies on either side over which the hydrophones' own spectra are smoothed, Hz: fringes of a vessel 2 m deep are some 500 Hz apart.
const SMOOTH_HZ: f64 = 750.0;
/// Bins on either side over which coherence is averaged, and the greatest that is believed (17 dB).
const ABOUT: usize = 4;
const MOST: f64 = 0.98;
/// How much longer a delay may be than the configured places allow, and by what many of their standard deviations.
const LONGER: f64 = 1.1;
const DEVIATIONS: f64 = 5.0;

/// Measures delays as samples come.
pub struct Measurer {
    rate_hz: f64,
    channels: [usize; CHANNELS],
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
    window: Vec<f64>,
    /// First bin used and the one after the last.
    bins: (usize, usize),
    /// Longest delay of each pair, seconds.
    longest_s: [f64; 6],
    samples: Vec<Frame>,
    /// Index of the first of `samples`.
    first: u64,
    segment: Segment,
    out: Vec<TimedDelays>,
}

/// Sums over the frames of one segment.
#[derive(Default)]
struct Segment {
    number: u64,
    frames: usize,
    cross: [Vec<Complex<f64>>; 6],
    own: [Vec<f64>; CHANNELS],
    /// Middle of each frame, seconds, and its power by bin.
    moments: Vec<(f64, Vec<f64>)>,
}

impl Measurer {
    /// For a station's samples.
    pub fn new(config: &StationConfig, array: &ArrayConfig) -> Self {
        let rate_hz = config.rate_hz;
        let length = ((FRAME_S * rate_hz) as usize).next_power_of_two();
        let distance = |(i, j): (usize, usize)| {
            let square = |k: usize| (array.hydrophones_m[i][k] - array.hydrophones_m[j][k]).powi(2);
            (0..3).map(square).sum::<f64>().sqrt()
        };
        let slack = DEVIATIONS * array.position_sd_m;
        let longest_s = PAIRS.map(|p| LONGER * (distance(p) + slack) / config.sound_speed_m_s);
        let across_s = longest_s.iter().fold(0.0f64, |a, b| a.max(*b));
        let bin = |hz: f64| (hz * length as f64 / rate_hz) as usize;
        // Below half a wavelength across the array a delay is hardly told.
        let low = bin(array.band_hz.0.max(0.5 / across_s)).max(1);
        let high = bin(array.band_hz.1.min(0.45 * rate_hz)).max(low + 1);
        Self {
            rate_hz,
            channels: array.channels.map(usize::from),
            forward: f64::real_to_complex(length),
            inverse: f64::complex_to_real(FINER * length),
            window: (0..length).map(|k| 0.5 - 0.5 * (TAU * (k as f64 + 0.5) / length as f64).cos()).collect(),
            bins: (low, high),
            longest_s,
            samples: Vec::new(),
            first: 0,
            segment: Segment::default(),
            out: Vec::new(),
        }
    }

    /// Takes a block. After a gap frames begin anew.
    pub fn take(&mut self, block: &Block<'_>) {
        if block.first_index != self.first + self.samples.len() as u64 {
            self.samples.clear();
            self.first = block.first_index;
        }
        self.samples.extend_from_slice(block.frames);
        let length = self.window.len();
        let mut done = 0;
        while let Some(frame) = self.samples.get(done..done + length) {
            let middle_s = (self.first as f64 + done as f64 + 0.5 * length as f64) / self.rate_hz;
            let number = (middle_s / SEGMENT_S) as u64;
            if number != self.segment.number {
                self.out.extend(Self::measured(
                    &self.inverse,
                    self.rate_hz,
                    self.bins,
                    &self.longest_s,
                    &self.segment,
                ));
                self.segment = Segment { number, ..Segment::default() };
            }
            if frame.iter().flatten().all(|code| *code != MISSING) {
                let spectra = self.channels.map(|c| {
                    let windowed = frame.iter().zip(&self.window).map(|(f, w)| f64::from(f[c]) * w);
                    let (mut x, mut y) = (windowed.collect::<Vec<_>>(), self.forward.make_output_vec());
                    if self.forward.process(&mut x, &mut y).is_err() {
                        unreachable!("lengths are the planner's own");
                    }
                    y
                });
                self.segment.add(&spectra, self.bins, middle_s);
            }
            done += length / 2;
        }
        self.samples.drain(..done);
        self.first += done as u64;
    }

    /// What was measured. Segments in which nothing stands out of the noise are left out.
    pub fn finish(mut self) -> Vec<TimedDelays> {
        self.out.extend(Self::measured(
            &self.inverse,
            self.rate_hz,
            self.bins,
            &self.longest_s,
            &self.segment,
        ));
        self.out
    }

    fn measured(
        inverse: &Arc<dyn ComplexToReal<f64>>,
        rate_hz: f64,
        bins: (usize, usize),
        longest_s: &[f64; 6],
        segment: &Segment,
    ) -> Option<TimedDelays> {
        if segment.frames < LEAST_FRAMES {
            return None;
        }
        // Radians a second from bin to bin.
        let step = TAU * rate_hz * FINER as f64 / inverse.len() as f64;
        let width = (SMOOTH_HZ / (step / TAU)) as usize;
        let own = segment.own.each_ref().map(|own| smoothed(own, width));
        let mut tdoa_s = [f64::NAN; 6];
        for (p, (i, j)) in PAIRS.into_iter().enumerate() {
            let whole = segment.cross[p].iter().zip(own[i].iter().zip(&own[j]));
            let white: Vec<_> = whole.map(|(c, (a, b))| c / (a * b).sqrt().max(f64::MIN_POSITIVE)).collect();
            tdoa_s[p] = highest(inverse, &white, bins.0, rate_hz, longest_s[p], segment.frames)
                .and_then(|start| refined(&white, bins.0, step, start, 0.5 / rate_hz))
                .unwrap_or(f64::NAN);
        }
        let some = tdoa_s.iter().any(|x| x.is_finite());
        some.then(|| TimedDelays { t_s: segment.t_s(bins.0), tdoa_s })
    }
}

impl Segment {
    fn add(&mut self, spectra: &[Vec<Complex<f64>>; CHANNELS], (low, high): (usize, usize), middle_s: f64) {
        for (sum, (i, j)) in self.cross.iter_mut().zip(PAIRS) {
            sum.resize(high - low, Complex::default());
            for (x, (a, b)) in sum.iter_mut().zip(spectra[i][low..high].iter().zip(&spectra[j][low..high])) {
                *x += a.conj() * b;
            }
        }
        let mut powers = vec![0.0; high - low];
        for (sum, spectrum) in self.own.iter_mut().zip(spectra) {
            sum.resize(high - low, 0.0);
            for ((x, power), a) in sum.iter_mut().zip(&mut powers).zip(&spectrum[low..high]) {
                *x += a.norm_sqr();
                *power += a.norm_sqr();
            }
        }
        self.frames += 1;
        self.moments.push((middle_s, powers));
    }

    /// The time about which what tells delays lies: every bin counts by the square of its frequency, as in a delay.
    fn t_s(&self, low: usize) -> f64 {
        let whole: Vec<f64> =
            (0..self.own[0].len()).map(|k| self.own.iter().map(|own| own[k]).sum::<f64>()).collect();
        let (mut sum, mut moment) = (0.0, 0.0);
        for (middle_s, powers) in &self.moments {
            let weights = powers.iter().zip(&whole).zip(low..);
            let weight: f64 =
                weights.map(|((x, all), k)| (k * k) as f64 * x / all.max(f64::MIN_POSITIVE)).sum();
            sum += weight;
            moment += weight * middle_s;
        }
        moment / sum
    }
}

/// Means over so many values on either side, or as many as there are on the side that has fewer.
fn smoothed(values: &[f64], width: usize) -> Vec<f64> {
    let mut sums = vec![0.0];
    for x in values {
        sums.push(sums[sums.len() - 1] + x);
    }
    let last = values.len().saturating_sub(1);
    let mean = |k: usize| {
        let width = width.min(k).min(last - k);
        (sums[k + width + 1] - sums[k - width]) / (2 * width + 1) as f64
    };
    (0..values.len()).map(mean).collect()
}

/// The lag (seconds) at which the whitened cross-spectrum's correlation is highest; `None` where noise is as high.
fn highest(
    inverse: &Arc<dyn ComplexToReal<f64>>,
    white: &[Complex<f64>],
    low: usize,
    rate_hz: f64,
    longest_s: f64,
    frames: usize,
) -> Option<f64> {
    let mut spectrum = inverse.make_input_vec();
    spectrum.iter_mut().skip(low).zip(white).for_each(|(x, c)| *x = *c);
    let mut out = inverse.make_output_vec();
    inverse.process(&mut spectrum, &mut out).ok()?;
    let n = out.len();
    let most = ((longest_s * rate_hz * FINER as f64) as usize).min(n / 2 - 1);
    let value = |lag: isize| out[lag.rem_euclid(n as isize) as usize];
    let best = (-(most as isize)..=most as isize).max_by(|a, b| value(*a).total_cmp(&value(*b)))?;
    // Twice the real part of each bin, of variance ½ over the frames, of which those that overlap by half count as 0.7.
    let deviation = 2.0 * (0.5 * white.len() as f64 / (0.7 * frames as f64)).sqrt();
    (value(best) > DETECTED * deviation).then(|| best as f64 / (rate_hz * FINER as f64))
}

/// The delay near a start where the weighted correlation is highest; `None` where it runs away from there.
fn refined(white: &[Complex<f64>], low: usize, step: f64, start: f64, most_s: f64) -> Option<f64> {
    let mut delay = start;
    for _ in 0..6 {
        let steered: Vec<_> = white
            .iter()
            .zip(low..)
            .map(|(c, k)| c * Complex::from_polar(1.0, step * k as f64 * delay))
            .collect();
        let (mut first, mut second) = (0.0, 0.0);
        for (n, (x, k)) in steered.iter().zip(low..).enumerate() {
            let about = &steered[n.saturating_sub(ABOUT)..(n + ABOUT + 1).min(steered.len())];
            let g = (about.iter().map(|x| x.re).sum::<f64>() / about.len() as f64).clamp(0.0, MOST);
            let (w, omega) = (g / (1.0 - g * g), step * k as f64);
            first -= w * omega * x.im;
            second -= w * omega * omega * x.re;
        }
        if !(second < 0.0) {
            return None;
        }
        delay -= first / second;
        if !((delay - start).abs() < most_s) {
            return None;
        }
    }
    Some(delay)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn delays_of_noise_that_reaches_all_are_told_and_of_noise_of_each_are_not() {
        let h = [[0.0, 1.0, 0.0], [0.9, -0.5, 0.0], [-0.9, -0.5, 0.0], [0.0, 0.0, 1.1]];
        let config = StationConfig::array(16_000.0, h);
        let array = ArrayConfig::new(h);
        let late = [0usize, 3, 7, 1];
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut noise = || rng.random_range(-100_000i32..100_000);
        let source: Vec<i32> = (0..40_000).map(|_| noise()).collect();
        let heard: Vec<Frame> = (10..40_000).map(|n| late.map(|by| source[n - by] + noise() / 4)).collect();
        let mut measurer = Measurer::new(&config, &array);
        for (k, frames) in heard.chunks(1000).enumerate() {
            measurer.take(&Block { first_index: 1000 * k as u64, frames });
        }
        let sets = measurer.finish();
        assert!(sets.len() == 5, "{sets:?}");
        for (n, set) in sets.iter().enumerate() {
            assert!((set.t_s - 0.5 * n as f64 - 0.25).abs() < 0.1);
            for (tau, (i, j)) in set.tdoa_s.iter().zip(PAIRS) {
                let expected = (late[j] as f64 - late[i] as f64) / 16_000.0;
                assert!((tau - expected).abs() < 1e-6, "{tau} {expected}");
            }
        }
        let nothing: Vec<Frame> = (0..40_000).map(|_| [noise(), noise(), noise(), noise()]).collect();
        let mut measurer = Measurer::new(&config, &array);
        measurer.take(&Block { first_index: 0, frames: &nothing });
        assert!(measurer.finish().is_empty());
    }
}
