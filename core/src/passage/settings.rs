//! What a passage assumes: speed prior, range limits, errors, medium.
//!
//! In: the station's `[tracking]`, sound speed, depth of array and vessels. Out: a [`Config`] in radians.

use crate::config::{Kind, StationConfig, Tracking};
use crate::kit::Student;
use crate::math::f64 as m;
use crate::motion::model::{LN_SPEED, Limits, Medium, PARAMETERS, SPEEDS_M_S};

/// A vessel's speed measured while it is tracked, from its shaft rate for instance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredSpeed {
    mean_m_s: f32,
    sd_m_s: f32,
}

impl MeasuredSpeed {
    /// Mean and standard deviation, m/s; `None` unless the mean is one a fit considers (0.2 to 40 m/s) and the standard
    /// deviation positive and finite.
    pub fn new(mean_m_s: f32, sd_m_s: f32) -> Option<Self> {
        let ln = m::ln(f64::from(mean_m_s));
        let sane = ln >= LN_SPEED.0 && ln <= LN_SPEED.1 && sd_m_s > 0.0 && sd_m_s.is_finite();
        sane.then_some(Self { mean_m_s, sd_m_s })
    }

    /// Mean, m/s.
    pub fn mean_m_s(&self) -> f32 {
        self.mean_m_s
    }

    /// Standard deviation, m/s.
    pub fn sd_m_s(&self) -> f32 {
        self.sd_m_s
    }
}

/// Height below which the doubt about it is a large part of it, metres.
const LEAST_HEIGHT_M: f64 = 25.0;
/// Standard deviation of what multipath, refraction and a tilted array put on all elevations of a vessel, radians (1°).
const ELEVATION_BIAS_SD_RAD: f64 = 0.017_453;

/// Fastest turn at the closest point that is believed of a young passage, rad/s: 20 degrees a second, 7 m/s at 20 m. A
/// vessel that turned faster just before its first bearing, or is about to, keeps its bearing for the time between:
/// one bearing in any direction then passes for a well-known line.
const FASTEST_RAD_S: f64 = 0.35;
/// Nearest line over an array below, metres: 10 s from the closest point its bearing differs from one straight over the array
/// by a quarter of a degree.
const OVERHEAD_M: f64 = 0.3;

/// What is assumed of a vessel and its bearings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Mean speed of vessels here, or the known speed, m/s.
    pub speed_m_s: f64,
    /// Its standard deviation, m/s; 0 means known.
    pub speed_sd_m_s: f64,
    /// Nearest and farthest closest-point range considered, m.
    pub range_m: (f64, f64),
    /// Standard deviation of the bearings' error beyond the reported one, radians.
    pub extra_sd_rad: f64,
    /// Its correlation time, s (first-order Gauss-Markov; 0: independent).
    pub extra_tau_s: f64,
    /// Travel time and height of the vessel above the array.
    pub medium: Medium,
    /// Standard deviation of that height, metres.
    pub height_sd_m: f64,
    /// Standard deviation of a bias common to all elevations (multipath), radians.
    pub elevation_bias_sd_rad: f64,
    /// Tails of the errors, whose stated variance is then that of good bearings; `None`: Gaussian.
    pub tails: Option<Student>,
    /// Standard deviation of an error that all azimuths of a passage share, radians: positions of the hydrophones.
    pub lasting_sd_rad: f64,
    /// Standard deviation of what a vessel's way adds to that, radians: a way that is not quite straight. No bearing states it.
    pub course_sd_rad: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self::new(&Tracking::default(), 1484.0)
    }
}

impl Config {
    /// From the station's tracking settings and sound speed.
    pub fn new(t: &Tracking, sound_speed_m_s: f64) -> Self {
        Self {
            speed_m_s: t.speed_m_s,
            speed_sd_m_s: t.speed_sd_m_s,
            range_m: t.range_m,
            extra_sd_rad: t.bearing_sd_deg * crate::angle::RAD_PER_DEG,
            extra_tau_s: t.bearing_tau_s,
            medium: Medium::of_sound_speed(sound_speed_m_s),
            height_sd_m: 0.0,
            elevation_bias_sd_rad: 0.0,
            tails: None,
            lasting_sd_rad: 0.0,
            course_sd_rad: t.course_sd_deg * crate::angle::RAD_PER_DEG,
        }
    }

    /// From a validated station configuration: a station deep enough has a vessel's height above it from its depth, so
    /// that elevations tell range, whatever the speed.
    pub fn of_station(station: &StationConfig) -> Self {
        let mut config = Self::new(&station.tracking, station.sound_speed_m_s);
        let height_m = height_m(station);
        if height_m >= LEAST_HEIGHT_M {
            (config.medium.height_m, config.height_sd_m) = (height_m, 0.5 * vessel_depth_m(station));
            config.elevation_bias_sd_rad = ELEVATION_BIAS_SD_RAD;
        }
        config.lasting_sd_rad = lasting_sd_rad(station);
        config
    }

    /// With a measurement of this vessel's speed joined to the prior, both Gaussian and independent. A known speed stays
    /// as it is; of an unknown one (infinite spread) the measurement is all that is known.
    pub fn with_speed(&self, measured: Option<MeasuredSpeed>) -> Self {
        let Some(measured) = measured.filter(|_| self.speed_sd_m_s > 0.0) else { return *self };
        let information = |sd: f64| 1.0 / (sd * sd);
        let (prior, new) = (information(self.speed_sd_m_s), information(f64::from(measured.sd_m_s)));
        let mean = (prior * self.speed_m_s + new * f64::from(measured.mean_m_s)) / (prior + new);
        Self { speed_m_s: mean, speed_sd_m_s: 1.0 / m::sqrt(prior + new), ..*self }
    }

    /// Where a solution may lie.
    pub(super) fn limits(&self, times_s: (f64, f64)) -> Limits {
        Limits { range_m: self.range_m, ln_speed: LN_SPEED, times_s }
    }

    /// Where lines are searched: as far as any speed a fit considers brings the ranges allowed, in units of the speed
    /// assumed. Bearings know no scale [M 5, 6], so that no line may run into a limit at one speed and pass it at another.
    /// Of a `young` passage, few of whose bearings can lie in a fast turn, no line turns faster than [`FASTEST_RAD_S`], unless
    /// elevations tell how near the vessel is: it may pass over the array.
    pub(super) fn search_limits(&self, times_s: (f64, f64), young: bool) -> Limits {
        let (slowest, fastest) = SPEEDS_M_S;
        let (near, far) = self.range_m;
        let (near, far) = (near * self.speed_m_s / fastest, far * self.speed_m_s / slowest);
        let near = match (self.medium.height_m > 0.0, young) {
            (true, _) => near.min(OVERHEAD_M),
            (false, true) => near.max(self.speed_m_s / FASTEST_RAD_S),
            (false, false) => near,
        };
        Limits { range_m: (near, far.max(near)), ..self.limits(times_s) }
    }

    pub(crate) fn free(&self) -> [bool; PARAMETERS] {
        let elevations = self.medium.height_m > 0.0;
        [true, true, true, self.speed_sd_m_s > 0.0, elevations && self.elevation_bias_sd_rad > 0.0]
    }

    /// The white variance under which a Gaussian error of this residual pulls as the heavy-tailed one, and what is then
    /// left out of the cost. `coloured`: variance of the coloured error.
    pub(super) fn doubt(&self, residual: f64, white: f64, coloured: f64) -> (f64, f64) {
        let Some(tails) = self.tails else { return (white, 0.0) };
        let variance = white + coloured;
        let r = residual / m::sqrt(variance);
        let weight = tails.weight(r);
        let doubted = white + variance * (1.0 / weight - 1.0);
        (doubted.max(0.5 * white), 2.0 * tails.loss(r) - weight * r * r)
    }

    /// Variance by which a line is turned and stretched beyond what its bearings say, rad².
    pub(crate) fn turned(&self) -> f64 {
        self.lasting_sd_rad * self.lasting_sd_rad + self.course_sd_rad * self.course_sd_rad
    }

    /// What a solution's variances are multiplied by where all elevations seem to be off by this, radians: more than twice the deviation that is
    /// assumed of it says that something else is wrong, mostly that the vessel does not hold its speed.
    pub(super) fn misfit(&self, elevation_bias_rad: f64) -> f64 {
        let [.., biased] = self.free();
        let off = if biased { elevation_bias_rad / self.elevation_bias_sd_rad } else { 0.0 };
        (off * off - 3.0).max(1.0)
    }

    /// Variance of ln speed that an error of the height gives, of the variance that it has: elevations tell the scale of the track in
    /// the proportion in which they add to what is assumed of the speed.
    pub(super) fn scale_variance(&self, known: f64) -> f64 {
        let (height_m, prior) = (self.medium.height_m, self.speed_sd_m_s / self.speed_m_s);
        if height_m <= 0.0 || prior <= 0.0 {
            return 0.0;
        }
        let told = (1.0 - known / (prior * prior)).max(0.0) * self.height_sd_m / height_m;
        told * told
    }

    /// Coloured variance, correlation time, and variance to count as white.
    pub(crate) fn errors(&self) -> (f64, f64, f64) {
        let variance = self.extra_sd_rad * self.extra_sd_rad;
        if self.extra_tau_s > 0.0 { (variance, self.extra_tau_s, 0.0) } else { (0.0, 0.0, variance) }
    }
}

/// Standard deviation of an azimuth near the horizon for errors of the hydrophones' positions, in the mean over azimuths: each
/// moves its arrival by its displacement towards the vessel, and `σ²/(½ Σ (x² + y²))` about the centre is the variance.
fn lasting_sd_rad(station: &StationConfig) -> f64 {
    let (Kind::Array(array), Ok(geometry)) = (&station.kind, station.geometry()) else { return 0.0 };
    let across = |h: &[f32; 3]| f64::from(h[0] * h[0] + h[1] * h[1]);
    let spread = 0.5 * geometry.position_m.iter().map(across).sum::<f64>();
    if spread > 0.0 { array.position_sd_m / m::sqrt(spread) } else { 0.0 }
}

/// Height of the vessels listened to above the station, metres: its depth less half of theirs, at least 0. With its image in the
/// surface a vessel is heard from the surface, without it from where it is.
pub fn height_m(station: &StationConfig) -> f64 {
    (station.depth_m - 0.5 * vessel_depth_m(station)).max(0.0)
}

pub(crate) fn vessel_depth_m(station: &StationConfig) -> f64 {
    if let Kind::Array(array) = &station.kind { array.vessel_depth_m } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measured_speed_sharpens_the_prior_and_nonsense_is_none() {
        let prior = Config { speed_m_s: 7.0, speed_sd_m_s: 2.0, ..Config::default() };
        let measured = MeasuredSpeed::new(10.0, 1.0);
        let both = prior.with_speed(measured);
        assert!((both.speed_m_s - 9.4).abs() < 1e-12 && (both.speed_sd_m_s - m::sqrt(0.8)).abs() < 1e-12);
        assert_eq!(prior.with_speed(None), prior);
        let known = Config { speed_sd_m_s: 0.0, ..prior };
        assert_eq!(known.with_speed(measured), known);
        let unknown = Config { speed_sd_m_s: f64::INFINITY, ..prior }.with_speed(measured);
        assert_eq!((unknown.speed_m_s, unknown.speed_sd_m_s), (10.0, 1.0));
        for (mean, sd) in [(0.0, 1.0), (f32::NAN, 1.0), (50.0, 1.0), (7.0, 0.0), (7.0, f32::INFINITY)] {
            assert_eq!(MeasuredSpeed::new(mean, sd), None);
        }
    }

    #[test]
    fn elevations_off_by_more_than_is_assumed_widen_a_solution_by_as_much() {
        let config = Config {
            medium: Medium { height_m: 100.0, ..Config::default().medium },
            elevation_bias_sd_rad: 0.02,
            ..Config::default()
        };
        for (off_rad, times) in [(0.0, 1.0), (0.04, 1.0), (-0.05, 3.25), (0.14, 46.0)] {
            assert!((config.misfit(off_rad) - times).abs() < 1e-9, "{off_rad}");
        }
        assert_eq!(Config { elevation_bias_sd_rad: 0.0, ..config }.misfit(0.14), 1.0);
    }
}
