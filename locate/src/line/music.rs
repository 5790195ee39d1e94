//! MUSIC and root-MUSIC: plan, state, scratch and one step from snapshots to bearings.
//!
//! Null spectrum `D(z) = aᴴ(z) E_n E_nᴴ a(z)`, `a(z) = [1, z, …, z^{m−1}]ᵀ`, `z = e^{iω}`, `ω = 2π d f ξ/c`. As a Laurent
//! polynomial its coefficients are the sums of the diagonals of the noise projector; MUSIC takes its minima on the unit
//! circle, root-MUSIC the roots inside it that lie closest to it.
//!
//! Error of ω for a source of signal-to-noise ratio S per sensor and N independent snapshots, to first order: the phase
//! errors of the sensors (variance 1/(2NS)) pass through the weights `v = c ∗ 1_K / (K Σ c²)`, c the centred sensor numbers
//! of a subarray: `var ω = Σ v²/(2NS) · (1 + 1/(mS)) · h₁/h`, where `h₁/h` is what other sources take away (h = the noise
//! part of the steering vector's derivative, h₁ = m(m²−1)/12 for a single source).
//! A source that turns meanwhile: `turning`.

use super::complex::{Complex, norm, phase, unit};
use super::covariance::{smooth, update};
use super::hermitian::{HermitianMatrix, eigen, noise_power, signal_columns};
use super::roots::{MAX_COEFFICIENTS, roots};
use super::turning::{LASTING, excess, moments, relative_variance};
use super::{MAX_SENSORS, MAX_SOURCES};
use crate::kit::golden;
use crate::math::f64 as m;

/// Points of the search on the unit circle: a subarray of 32 has a main lobe of 2π/16, sixteen points wide.
const GRID: usize = 512;

/// Share of a steering vector outside the signal subspace from which it is no source's.
const OUTSIDE: f64 = 0.5;

/// How the noise subspace is searched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MusicMethod {
    /// Minima of the null spectrum.
    Spectrum,
    /// Roots of its polynomial.
    Root,
}

/// What is wrong with a line's settings, or why there is no bearing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LineError {
    /// 3 to 32 sensors, subarrays longer than the number of sources, 1 to 4 sources, positive lengths.
    #[error("3 to 32 sensors, 1 to 4 sources, subarrays longer than these and positive lengths are needed")]
    Settings,
    /// Sensors more than half a wavelength apart: bearings would be ambiguous.
    #[error("sensors are more than half a wavelength apart: bearings would be ambiguous")]
    Aliased,
    /// No usable snapshot yet.
    #[error("no usable snapshot yet")]
    NoSnapshot,
    /// The covariance could not be decomposed.
    #[error("the covariance could not be decomposed")]
    Singular,
}

/// Settings of a line in one band, checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePlan {
    pub(super) sensors: usize,
    subarrays: usize,
    sources: usize,
    /// Whether the number of sources is estimated, `sources` at most.
    counted: bool,
    forgetting: f64,
    /// `ω/ξ`, radians: the phase from one sensor to the next at endfire.
    pub(super) phase: f64,
    /// Largest sine looked at: above one where tones above the band's frequency may be heard.
    widest: f64,
}

/// Covariance so far.
#[derive(Clone, Debug)]
pub struct State {
    covariance: HermitianMatrix,
    /// Effective number of independent snapshots in it.
    snapshots: f64,
    /// Mean and mean square of a snapshot's power over all sensors, as the covariance remembers it.
    power: (f64, f64),
}

/// Working memory of a step.
#[derive(Clone, Debug)]
pub struct Scratch {
    matrix: HermitianMatrix,
    vectors: HermitianMatrix,
    roots: [Complex; MAX_COEFFICIENTS],
}

/// One source.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineArrival {
    /// Sine of the bearing from broadside, positive towards rising sensor numbers.
    pub sine: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// Signal-to-noise ratio of one sensor and snapshot, a power ratio.
    pub snr: f64,
}

impl State {
    /// Nothing seen yet.
    pub const fn new() -> Self {
        Self { covariance: [[Complex::ZERO; MAX_SENSORS]; MAX_SENSORS], snapshots: 0.0, power: (0.0, 0.0) }
    }

    /// Effective number of independent snapshots.
    pub const fn snapshots(&self) -> f64 {
        self.snapshots
    }
}

impl Scratch {
    /// Empty.
    pub const fn new() -> Self {
        let empty = [[Complex::ZERO; MAX_SENSORS]; MAX_SENSORS];
        Self { matrix: empty, vectors: empty, roots: [Complex::ZERO; MAX_COEFFICIENTS] }
    }
}

impl LinePlan {
    /// Checks settings: number of sensors, their spacing (m), the band's frequency (Hz), sound speed (m/s), number of
    /// overlapping subarrays (paper L: 5), share of the past in the covariance (paper L: 0.4), number of sources.
    ///
    /// # Errors
    /// [`LineError::Settings`], [`LineError::Aliased`].
    pub fn new(
        sensors: usize,
        spacing_m: f64,
        frequency_hz: f64,
        sound_speed_m_s: f64,
        subarrays: usize,
        forgetting: f64,
        sources: usize,
    ) -> Result<Self, LineError> {
        let phase = m::TAU * spacing_m * frequency_hz / sound_speed_m_s;
        let lengths = spacing_m > 0.0 && frequency_hz > 0.0 && sound_speed_m_s > 0.0 && phase.is_finite();
        let counts = (3..=MAX_SENSORS).contains(&sensors)
            && (1..=MAX_SOURCES).contains(&sources)
            && subarrays >= 1
            && subarrays < sensors
            && sensors + 1 - subarrays > sources + 1;
        if !lengths || !counts || !(0.0..1.0).contains(&forgetting) {
            return Err(LineError::Settings);
        }
        if phase > m::PI {
            return Err(LineError::Aliased);
        }
        Ok(Self { sensors, subarrays, sources, counted: false, forgetting, phase, widest: 1.0 })
    }

    /// The same, with as many sources at each step as the covariance shows, at most those it was made for: the shortest
    /// description of the data (Wax and Kailath 1985) by as many snapshots as went into it. Two within half a beam are one.
    #[must_use]
    pub fn counting(self) -> Self {
        Self { counted: true, ..self }
    }

    /// The same, where tones up to this share above the band's frequency may be heard: from endfire such a tone's sine, read at
    /// the band's frequency, is above one by as much. No farther than half a wavelength from sensor to sensor.
    #[must_use]
    pub fn hearing_above(self, share: f64) -> Self {
        Self { widest: (1.0 + share.max(0.0)).min(m::PI / self.phase).max(1.0), ..self }
    }

    /// A beam: the distance of two sines that the subarrays of all sensors just tell apart, `λ/(md)`.
    pub fn beam(&self) -> f64 {
        m::TAU / (self.phase * (self.sensors + 1 - self.subarrays) as f64)
    }

    /// Standard deviation of the sine of a single source to expect, by the module's error formula: signal-to-noise ratio of one sensor
    /// and snapshot (power), independent snapshots.
    pub fn sine_sd(&self, snr: f64, snapshots: f64) -> f64 {
        let length = self.sensors + 1 - self.subarrays;
        let noise = 1.0 + 1.0 / (length as f64 * snr);
        m::sqrt(self.weight_sum(length) / (2.0 * snapshots * snr) * noise) / self.phase
    }

    /// Takes in snapshots with the plan's share of the past, and finds the bearings as [`Self::find`].
    ///
    /// # Errors
    /// [`LineError::NoSnapshot`], [`LineError::Singular`].
    pub fn step(
        &self,
        state: &mut State,
        scratch: &mut Scratch,
        snapshots: &[[Complex; MAX_SENSORS]],
        method: MusicMethod,
        arrivals: &mut [LineArrival; MAX_SOURCES],
    ) -> Result<usize, LineError> {
        self.take(state, self.forgetting, snapshots);
        self.find(state, scratch, snapshots, method, arrivals)
    }

    /// Takes in snapshots; `share`, 0 to 1, is that of what is known already, where something is.
    pub fn take(&self, state: &mut State, share: f64, snapshots: &[[Complex; MAX_SENSORS]]) {
        let share = if state.snapshots > 0.0 { share } else { 0.0 };
        let used = update(&mut state.covariance, self.sensors, share, snapshots) as f64;
        if used > 0.0 {
            // Weights s and 1 − s of independent snapshots: 1/N = s²/N_old + (1 − s)²/n.
            let past = if share > 0.0 { share * share / state.snapshots } else { 0.0 };
            state.snapshots = 1.0 / (past + (1.0 - share) * (1.0 - share) / used);
            let power = |x: &[Complex; MAX_SENSORS]| x.iter().take(self.sensors).map(|v| v.norm_sqr()).sum();
            let (mean, square) = moments(snapshots, power);
            let (old, old_square) = state.power;
            state.power = (share * old + (1.0 - share) * mean, share * old_square + (1.0 - share) * square);
        }
    }

    /// Finds the bearings of what was taken in; the first so many of `arrivals` are set, strongest match first. `snapshots`: some
    /// of those taken in, by which the steadiness of a source is judged.
    ///
    /// # Errors
    /// [`LineError::NoSnapshot`], [`LineError::Singular`].
    pub fn find(
        &self,
        state: &State,
        scratch: &mut Scratch,
        snapshots: &[[Complex; MAX_SENSORS]],
        method: MusicMethod,
        arrivals: &mut [LineArrival; MAX_SOURCES],
    ) -> Result<usize, LineError> {
        if !(state.snapshots > 0.0) {
            return Err(LineError::NoSnapshot);
        }
        let length = smooth(&state.covariance, self.sensors, self.subarrays, &mut scratch.matrix);
        if !eigen(&mut scratch.matrix, length, &mut scratch.vectors) {
            return Err(LineError::Singular);
        }
        let most =
            if self.counted { self.count(&scratch.matrix, length, state.snapshots) } else { self.sources };
        for sources in (1..=most).rev() {
            let signal = signal_columns(&scratch.matrix, length, sources);
            let noise = noise_power(&scratch.matrix, length, &signal);
            let coefficients = projector(&scratch.vectors, length, &signal);
            let count = match method {
                MusicMethod::Spectrum => self.minima(&coefficients, length, arrivals, sources),
                MusicMethod::Root => {
                    self.nearest_roots(&coefficients, length, &mut scratch.roots, arrivals, sources)
                }
            };
            let found = arrivals.get_mut(..count).unwrap_or_default();
            let nobody = method == MusicMethod::Spectrum && count < sources;
            if self.counted && sources > 1 && (nobody || self.one_in_two(found)) {
                continue;
            }
            for arrival in found {
                let wander =
                    self.wander(arrival.sine, snapshots).max(relative_variance(state.power)).min(1.0);
                let independent = (state.snapshots, state.snapshots / (LASTING * wander));
                let (sd, snr) = self.accuracy(arrival.sine, scratch, length, &signal, noise, independent);
                arrival.sd = sd;
                arrival.snr = snr;
            }
            return Ok(count);
        }
        Ok(0)
    }

    /// Whether two of the arrivals are nearer to each other than half a beam (`λ/(2md)` in sine): a source that moves while the
    /// covariance averages looks like two beside it.
    fn one_in_two(&self, arrivals: &[LineArrival]) -> bool {
        let least = 0.5 * self.beam();
        let near = |(i, a): (usize, &LineArrival)| {
            arrivals.iter().skip(i + 1).any(|b| m::abs(a.sine - b.sine) < least)
        };
        arrivals.iter().enumerate().any(near)
    }

    /// How many sources the eigenvalues show: the number k with the shortest description
    /// `N (m − k) ln(arithmetic/geometric mean of the m − k least) + ½ k (2m − k) ln N`.
    fn count(&self, values: &HermitianMatrix, length: usize, snapshots: f64) -> usize {
        let mut sorted = [0.0f64; MAX_SENSORS];
        for (k, (slot, row)) in sorted.iter_mut().zip(values).enumerate().take(length) {
            *slot = row.get(k).map_or(0.0, |x| x.re);
        }
        let sorted = sorted.get_mut(..length).unwrap_or_default();
        sorted.sort_unstable_by(|a, b| b.total_cmp(a));
        // What rounding makes of nothing.
        let floor = 1e-12 * sorted.first().copied().unwrap_or(0.0);
        let description = |k: usize| {
            let noise = sorted.get(k..).unwrap_or_default();
            let n = noise.len() as f64;
            let mean = noise.iter().map(|x| x.max(floor)).sum::<f64>() / n;
            let ln_mean = noise.iter().map(|x| m::ln(x.max(floor))).sum::<f64>() / n;
            let free = 0.5 * (k * (2 * length - k)) as f64;
            snapshots * n * (m::ln(mean) - ln_mean) + free * m::ln(snapshots.max(1.0))
        };
        (0..=self.sources)
            .min_by(|a, b| description(*a).total_cmp(&description(*b)))
            .filter(|_| floor > 0.0)
            .unwrap_or(0)
    }

    /// Deepest minima of the null spectrum on the unit circle. Of several sources that are counted those alone that lie more in the signal
    /// subspace than outside: two of a source that moves share one minimum, and the next is of nobody.
    fn minima(
        &self,
        coefficients: &[Complex; MAX_SENSORS],
        length: usize,
        arrivals: &mut [LineArrival; MAX_SOURCES],
        sources: usize,
    ) -> usize {
        let at = |k: usize| self.phase * self.widest * (2.0 * k as f64 / GRID as f64 - 1.0);
        let mut found: [(f64, f64); MAX_SOURCES] = [(f64::INFINITY, 0.0); MAX_SOURCES];
        let (mut before, mut here) = (f64::INFINITY, null(coefficients, length, at(0)));
        for k in 0..=GRID {
            let after = if k < GRID { null(coefficients, length, at(k + 1)) } else { f64::INFINITY };
            if here <= before && here < after {
                let w = golden(at(k.saturating_sub(1)), at((k + 1).min(GRID)), 60, |w| {
                    null(coefficients, length, w)
                });
                let mut entry = (null(coefficients, length, w), w);
                for slot in &mut found {
                    if entry.0 < slot.0 {
                        core::mem::swap(slot, &mut entry);
                    }
                }
            }
            (before, here) = (here, after);
        }
        let mut count = 0;
        let most = if self.counted && sources > 1 { OUTSIDE * length as f64 } else { f64::MAX };
        for (arrival, (depth, w)) in arrivals.iter_mut().zip(&found).take(sources) {
            if *depth < most {
                *arrival = LineArrival { sine: w / self.phase, sd: 0.0, snr: 0.0 };
                count += 1;
            }
        }
        count
    }

    /// Roots inside the unit circle closest to it, among those a direction can give.
    fn nearest_roots(
        &self,
        coefficients: &[Complex; MAX_SENSORS],
        length: usize,
        found: &mut [Complex; MAX_COEFFICIENTS],
        arrivals: &mut [LineArrival; MAX_SOURCES],
        sources: usize,
    ) -> usize {
        let mut polynomial = [Complex::ZERO; MAX_COEFFICIENTS];
        let centre = length - 1;
        for (k, c) in coefficients.iter().enumerate().take(length) {
            if let Some(x) = polynomial.get_mut(centre + k) {
                *x = *c;
            }
            if let Some(x) = polynomial.get_mut(centre - k) {
                *x = c.conj();
            }
        }
        let used = polynomial.get(..2 * length - 1).unwrap_or(&[]);
        let n = roots(used, found);
        let mut best: [(f64, f64); MAX_SOURCES] = [(f64::INFINITY, 0.0); MAX_SOURCES];
        for z in found.iter().take(n) {
            let size = norm(*z);
            let sine = phase(*z) / self.phase;
            // The pair 1/z* outside is the same direction; a root on the circle is both.
            if size <= 1.0 + 1e-9 && m::abs(sine) <= self.widest {
                let mut entry = (m::abs(1.0 - size), sine);
                for slot in &mut best {
                    if entry.0 < slot.0 {
                        core::mem::swap(slot, &mut entry);
                    }
                }
            }
        }
        let mut count = 0;
        for (arrival, (distance, sine)) in arrivals.iter_mut().zip(&best).take(sources) {
            if distance.is_finite() {
                *arrival = LineArrival { sine: *sine, sd: 0.0, snr: 0.0 };
                count += 1;
            }
        }
        count
    }

    /// Relative variance of a source's power over snapshots.
    fn wander(&self, sine: f64, snapshots: &[[Complex; MAX_SENSORS]]) -> f64 {
        let w = self.phase * sine;
        let towards = |x: &[Complex; MAX_SENSORS]| {
            let steered = x.iter().take(self.sensors).enumerate();
            steered.fold(Complex::ZERO, |sum, (k, v)| sum + *v * unit(-w * k as f64)).norm_sqr()
        };
        relative_variance(moments(snapshots, towards))
    }

    /// Standard deviation of the sine, and signal-to-noise ratio; the numbers are those of independent snapshots, and of those in which
    /// a source's loudness is new.
    fn accuracy(
        &self,
        sine: f64,
        scratch: &Scratch,
        length: usize,
        signal: &[bool; MAX_SENSORS],
        noise: f64,
        (snapshots, of_loudness): (f64, f64),
    ) -> (f64, f64) {
        let w = self.phase * sine;
        let middle = 0.5 * (length as f64 - 1.0);
        let (mut inverse_power, mut lost) = (0.0, 0.0);
        for (column, _) in signal.iter().enumerate().filter(|(_, s)| **s) {
            let value = scratch.matrix.get(column).and_then(|r| r.get(column)).map_or(0.0, |x| x.re);
            // Projections of the steering vector and its centred derivative on the signal eigenvector.
            let (mut a, mut d) = (Complex::ZERO, Complex::ZERO);
            for (k, row) in scratch.vectors.iter().enumerate().take(length) {
                let e = row.get(column).copied().unwrap_or(Complex::ZERO);
                let x = unit(w * k as f64).conj() * e;
                a += x;
                d += x.scale(k as f64 - middle);
            }
            inverse_power += a.norm_sqr() / (value - noise).max(1e-300);
            lost += d.norm_sqr();
        }
        let n = length as f64;
        let alone = n * (n * n - 1.0) / 12.0;
        let left = (alone - lost).max(1e-9 * alone);
        let power = if inverse_power > 0.0 { 1.0 / inverse_power } else { 0.0 };
        if !(noise > 0.0) {
            return (0.0, f64::MAX);
        }
        let snr = power / noise;
        let variance =
            self.weight_sum(length) / (2.0 * snapshots * snr) * (1.0 + 1.0 / (n * snr)) * alone / left;
        let turned = excess(&scratch.matrix, length, signal) / (power * alone);
        let sd = m::sqrt(variance + turned / of_loudness) / self.phase;
        (if sd.is_finite() { sd.min(1.0) } else { 1.0 }, snr)
    }

    /// `Σ v²` of the module's error formula.
    fn weight_sum(&self, length: usize) -> f64 {
        let n = length as f64;
        let squares = n * (n * n - 1.0) / 12.0;
        let (middle, mut sum) = (0.5 * (n - 1.0), 0.0);
        for sensor in 0..self.sensors {
            let mut v = 0.0;
            for k in 0..self.subarrays {
                if let Some(place) = sensor.checked_sub(k)
                    && place < length
                {
                    v += place as f64 - middle;
                }
            }
            v /= self.subarrays as f64 * squares;
            sum += v * v;
        }
        sum
    }
}

/// Sums of the diagonals of the noise projector `I − E_s E_sᴴ`: coefficients 0 to m − 1 of the Laurent polynomial (the
/// negative ones are conjugates).
fn projector(
    vectors: &HermitianMatrix,
    length: usize,
    signal: &[bool; MAX_SENSORS],
) -> [Complex; MAX_SENSORS] {
    let mut out = [Complex::ZERO; MAX_SENSORS];
    if let Some(first) = out.first_mut() {
        first.re = length as f64;
    }
    for (column, _) in signal.iter().enumerate().filter(|(_, s)| **s) {
        for (lag, c) in out.iter_mut().enumerate().take(length) {
            for (low, high) in vectors.iter().zip(vectors.iter().skip(lag)).take(length - lag) {
                let (Some(a), Some(b)) = (low.get(column), high.get(column)) else { continue };
                // aᴴ P a = Σ P_ij z^{j−i}: the element (i, i + lag) goes with z^lag.
                *c -= *a * b.conj();
            }
        }
    }
    out
}

/// Null spectrum at a phase.
fn null(coefficients: &[Complex; MAX_SENSORS], length: usize, w: f64) -> f64 {
    let z = unit(w);
    let mut sum = Complex::ZERO;
    for c in coefficients.iter().take(length).skip(1).rev() {
        sum = (sum + *c) * z;
    }
    coefficients.first().map_or(0.0, |c| c.re) + 2.0 * sum.re
}

#[cfg(test)]
#[path = "music_tests.rs"]
mod tests;
