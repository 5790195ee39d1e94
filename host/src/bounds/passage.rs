//! A straight passage of one array, and what no unbiased estimator tells of it better [M 23-29].

use super::bearing::AngleSd;
use super::network::{self, Bearings};
use crate::orientation::network_file::Network;
use seabearing_core::angle::wrap_pi;
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::kit::spd::quadratic;
use seabearing_core::motion::{Line, Medium};
use seabearing_core::passage::Config as RecorderConfig;
use seabearing_locate::motion::bound::{self, Bounds};
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{Config, Sample};
use seabearing_locate::motion::whiten::{Factorisation, Workspace};

/// Time between bearings, s [M section IV-B].
pub const STEP_S: f64 = 0.5;
/// Bearings of the longest window: 400 s.
pub const POSITIONS: usize = 801;
/// Heading of the vessel, degrees.
const HEADING_DEG: f64 = 45.0;

/// One geometry: constant speed, closest point in the middle of the window at time 0, array to starboard.
#[derive(Clone, Copy, Debug)]
pub struct StraightPass {
    /// Range of the closest point, m.
    pub range_m: f64,
    /// Length of the window, s.
    pub window_s: f64,
    /// Standard deviation of errors of the azimuth, radians.
    pub sd_rad: f64,
    /// Correlation interval, s.
    pub tau_s: f64,
    /// True speed, m/s.
    pub speed_m_s: f64,
}

impl StraightPass {
    /// The true line.
    pub fn line(&self) -> Line {
        let cpa = (HEADING_DEG - 90.0).to_radians();
        Line { p: [cpa, 0.0, (self.speed_m_s / self.range_m).ln(), self.speed_m_s.ln(), 0.0], sense: 1.0 }
    }

    /// Number of bearings.
    pub fn count(&self) -> usize {
        (self.window_s / STEP_S).round() as usize + 1
    }

    /// Bearings with these errors (radians).
    pub fn samples(&self, medium: &Medium, errors: &[f64]) -> Vec<Sample> {
        let line = self.line();
        let azimuth = |(k, e): (usize, &f64)| {
            let t = -0.5 * self.window_s + STEP_S * k as f64;
            Sample::azimuth(t, wrap_pi(line.azimuth(medium, t) + e), self.sd_rad)
        };
        errors.iter().enumerate().map(azimuth).collect()
    }
}

/// What a fit assumes: the speed is known, there are no elevations, and the travel time is left out.
pub fn config(model: Model, tau_s: f64, speed_m_s: f64) -> Config {
    Config {
        model,
        tau_s,
        white_share: 0.0,
        speed_m_s,
        speed_sd_m_s: 0.0,
        range_m: (20.0, 20_000.0),
        medium: Medium::of_sound_speed(f64::INFINITY),
        elevation_bias_sd_rad: 0.0,
        acceleration_sd_m_s2: 0.0,
    }
}

/// Cramér-Rao bounds of a pass under a fit's assumptions; `sd_elevation`: standard deviation of elevations, radians, where
/// they are measured. `None` where the geometry is singular.
pub fn limit(pass: &StraightPass, config: &Config, sd_elevation: Option<f64>) -> Option<Bounds> {
    let mut work = Box::new(Workspace::<POSITIONS>::new());
    let line = pass.line();
    let mut samples = pass.samples(&config.medium, &vec![0.0; pass.count()]);
    if let Some(sd) = sd_elevation {
        for s in &mut samples {
            s.elevation_rad = (line.expected(&config.medium, s.t_s).elevation as f32, sd as f32);
        }
    }
    let times = samples.iter().map(|s| s.t_s);
    let plan = Factorisation::new(config.model, config.tau_s, times, &mut work, &mut []).ok()?;
    bound::cramer_rao(config, &samples, &line, &plan, &mut work, &[])
}

/// Bounds of the estimator with the right (linear) model, and true spread of the one with the diagonal matrix.
pub fn limits(pass: &StraightPass) -> Option<(Bounds, Bounds)> {
    let c = config(Model::Linear, pass.tau_s, pass.speed_m_s);
    let s = pass.samples(&c.medium, &vec![0.0; pass.count()]);
    let best = limit(pass, &c, None)?;
    let diagonal = bound::sandwich(&c, &s, &pass.line(), Model::Linear, pass.tau_s)?;
    Some((best, diagonal))
}

/// Scatter of elevations beyond what a bearing states, radians: the 1° of multipath changing as the vessel moves that the recorder
/// joins to each (`core/src/traffic/heard.rs`).
const ELEVATION_SD_RAD: f64 = 0.017_453;
/// Least standard deviation of a bearing of a passage, radians (0.01°): keeps the matrices regular.
const LEAST_SD_RAD: f64 = 1.7e-4;

/// What a recorder's passages assume of their bearings: its own configuration, and what bearings state.
#[derive(Clone, Copy, Debug)]
pub struct Assumed {
    /// The recorder's.
    pub recorder: RecorderConfig,
    /// Noise of a bearing.
    pub noise: AngleSd,
    /// Error that all elevations of a passage share: the recorder's bias (multipath, refraction, tilt) and what the hydrophones'
    /// positions and the speed of sound add, radians.
    pub elevation_bias_sd: f64,
    /// Standard deviation of an elevation's own error, radians.
    pub elevation_sd: f64,
    /// Standard deviation of an azimuth's error beyond the lasting one, radians.
    pub azimuth_sd: f64,
}

/// Standard deviations to expect of a passage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// Range of the closest point, metres.
    pub cpa_range_m: f64,
    /// Time of the closest point, seconds.
    pub cpa_time_s: f64,
    /// Heading, radians.
    pub heading_rad: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
}

impl Assumed {
    /// What the recorder of a station assumes, for bearings of such noise and such a lasting error besides.
    pub fn of(station: &StationConfig, noise: AngleSd, lasting: AngleSd) -> Self {
        let recorder = RecorderConfig::of_station(station);
        Self {
            elevation_bias_sd: recorder.elevation_bias_sd_rad.hypot(lasting.elevation),
            elevation_sd: ELEVATION_SD_RAD.hypot(noise.elevation),
            azimuth_sd: recorder.extra_sd_rad.hypot(noise.azimuth).max(LEAST_SD_RAD),
            recorder,
            noise,
        }
    }

    /// Whether the recorder takes elevations for ranges: its station is deep enough.
    pub fn elevations(&self) -> bool {
        self.recorder.medium.height_m > 0.0
    }

    /// A passage whose bearings err so.
    pub fn pass(&self, range_m: f64, window_s: f64, speed_m_s: f64) -> StraightPass {
        // Noise alone has no memory.
        let tau_s = if self.recorder.extra_sd_rad > 0.0 { self.recorder.extra_tau_s } else { 0.0 };
        StraightPass { range_m, window_s, sd_rad: self.azimuth_sd, tau_s, speed_m_s }
    }

    /// What to expect of a passage, with or without its elevations, the speed as far as the recorder knows it. `None` where nothing is
    /// told.
    pub fn expected(&self, pass: &StraightPass, elevations: bool) -> Option<Expected> {
        let (recorder, relative) = (&self.recorder, self.recorder.speed_sd_m_s / pass.speed_m_s);
        let model = if pass.tau_s > 0.0 { Model::Markov } else { Model::White };
        let known = config(model, pass.tau_s, pass.speed_m_s);
        let (mut c, line) = if elevations {
            let medium = Medium { height_m: recorder.medium.height_m, ..known.medium };
            let elevation_bias_sd_rad = self.elevation_bias_sd;
            let asked =
                Config { speed_sd_m_s: recorder.speed_sd_m_s, medium, elevation_bias_sd_rad, ..known };
            let found = limit(pass, &asked, Some(self.elevation_sd)).filter(|_| self.elevations())?;
            (found.covariance, pass.line())
        } else {
            let mut c = limit(pass, &known, None)?.covariance;
            // The spread of the speed is the range's: azimuths know no scale [M 20].
            c[3][3] = relative * relative;
            (c, pass.line())
        };
        // As the recorder adds them: what all azimuths share, and a way not quite straight, turn the track and stretch it, an error of the
        // height scales it in the proportion in which elevations tell the speed. Azimuths alone are the papers' bound, of a straight way.
        let ways = if elevations { recorder.course_sd_rad } else { 0.0 };
        let turned = recorder.lasting_sd_rad * recorder.lasting_sd_rad + ways * ways;
        c[0][0] += turned;
        c[2][2] += turned;
        if elevations && relative > 0.0 {
            let told = (1.0 - c[3][3] / (relative * relative)).max(0.0);
            c[3][3] += (told * recorder.height_sd_m / recorder.medium.height_m).powi(2);
        }
        let range = [0.0, 0.0, -1.0, 1.0, 0.0];
        Some(Expected {
            cpa_range_m: line.cpa_range_m() * quadratic(&range, &c, &range).max(0.0).sqrt(),
            cpa_time_s: c[1][1].max(0.0).sqrt(),
            heading_rad: c[0][0].max(0.0).sqrt(),
            speed_m_s: line.speed_m_s() * c[3][3].max(0.0).sqrt(),
        })
    }

    /// Standard deviation of a position by one azimuth and elevation, the source at the surface or its depth below it, at a horizontal
    /// range, metres. `None` where nothing is told.
    pub fn one_bearing(&self, station: &StationConfig, range_m: f64) -> Option<f64> {
        let height_m = self.recorder.medium.height_m;
        if !self.elevations() {
            return None;
        }
        let alone = Network {
            stations: vec![station.clone()],
            arrays_m: vec![[0.0, 0.0, -station.depth_m]],
            frame: None,
            sd_orientation: vec![0.0],
            says_orientation: vec![true],
            sd_clock_s: vec![None],
        };
        let Kind::Array(array) = &station.kind else { return None };
        let bearings = Bearings {
            sd_azimuth: self.azimuth_sd.hypot(self.recorder.lasting_sd_rad),
            sd_elevation: self.elevation_sd.hypot(self.elevation_bias_sd),
            depth_m: array.vessel_depth_m,
        };
        let position_m = network::at(&alone, &bearings, 0.0, [0.0, range_m]).position_m?;
        Some(position_m.hypot(range_m * self.recorder.height_sd_m / height_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `scenarios/demo-station.toml` in what matters here.
    fn demo(position_sd_m: f64) -> StationConfig {
        let hydrophones_m =
            [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];
        let mut station = StationConfig::array(64_000.0, hydrophones_m);
        station.depth_m = 168.0;
        let Kind::Array(array) = &mut station.kind else { unreachable!() };
        array.position_sd_m = position_sd_m;
        station
    }

    fn expected(station: &StationConfig, range_m: f64, elevations: bool) -> Expected {
        let assumed = Assumed::of(station, AngleSd::default(), AngleSd::default());
        assumed.expected(&assumed.pass(range_m, 300.0, 7.0), elevations).unwrap()
    }

    /// Exact bearings with the scatter they may have, through the recorder's own passage: what it states is what is expected.
    #[test]
    fn what_is_expected_is_what_the_recorder_states() {
        use seabearing_core::passage::{Measurement, Passage};
        for (position_sd_m, range_m) in [(0.0, 500.0), (0.0, 1000.0), (0.01, 500.0)] {
            let station = demo(position_sd_m);
            let assumed = Assumed::of(&station, AngleSd::default(), AngleSd::default());
            let pass = assumed.pass(range_m, 300.0, 7.0);
            let (line, medium) = (pass.line(), assumed.recorder.medium);
            let mut passage = Passage::<64>::new();
            for k in 0..=600 {
                let t_s = 0.5 * f64::from(k) - 150.0;
                let at = line.expected(&medium, t_s);
                let elevation = Some((at.elevation, ELEVATION_SD_RAD * ELEVATION_SD_RAD));
                let azimuth = wrap_pi(line.azimuth(&medium, t_s));
                passage.push(
                    &assumed.recorder,
                    &Measurement { elevation, ..Measurement::azimuth(t_s, azimuth, 1e-8) },
                );
                passage.work(&assumed.recorder);
            }
            let stated = passage.finish(&assumed.recorder).unwrap();
            let bound = assumed.expected(&pass, true).unwrap();
            for (stated, bound) in
                [(stated.sd_cpa_range_m, bound.cpa_range_m), (stated.sd_heading_rad, bound.heading_rad)]
            {
                assert!((stated / bound - 1.0).abs() < 0.1, "{range_m}: {stated} {bound}");
            }
        }
    }

    #[test]
    fn what_is_known_worse_is_expected_worse() {
        let (known, moved) = (demo(0.0), demo(0.01));
        let (a, b) = (expected(&known, 500.0, false), expected(&moved, 500.0, false));
        // A centimetre turns the track by 0.44° and stretches it by as much.
        let lasting = Assumed::of(&moved, AngleSd::default(), AngleSd::default()).recorder.lasting_sd_rad;
        assert!((b.heading_rad - a.heading_rad.hypot(lasting)).abs() < 1e-9, "{a:?} {b:?}");
        assert!(lasting.to_degrees() > 0.4 && b.cpa_range_m > a.cpa_range_m);
        // Elevations that share more are worth less, and a shallow station has none.
        let more = AngleSd { elevation: 0.05, azimuth: 0.0 };
        let doubted = Assumed::of(&known, AngleSd::default(), more);
        let pass = doubted.pass(500.0, 300.0, 7.0);
        let (worse, plain) = (doubted.expected(&pass, true).unwrap(), expected(&known, 500.0, true));
        // A pass tells most of what its elevations share by itself, a single bearing nothing of it.
        assert!(worse.cpa_range_m > plain.cpa_range_m, "{worse:?} {plain:?}");
        let plain = Assumed::of(&known, AngleSd::default(), AngleSd::default());
        let one = |of: &Assumed| of.one_bearing(&known, 300.0).unwrap();
        assert!(one(&doubted) > 1.5 * one(&plain));
        let shallow = StationConfig { depth_m: 10.0, ..known };
        let assumed = Assumed::of(&shallow, AngleSd::default(), AngleSd::default());
        assert!(assumed.expected(&pass, true).is_none() && assumed.one_bearing(&shallow, 500.0).is_none());
    }

    /// The methods page's own check: σ 2°, 7 m/s known, 200 s, 401 bearings, linear model.
    #[test]
    fn reference_values_of_range_and_heading() {
        for (tau_s, range_m, sd_m, sd_deg) in [
            (0.0, 500.0, 2.1, 0.33),
            (0.0, 2000.0, 18.5, 2.89),
            (50.0, 500.0, 18.1, 2.23),
            (50.0, 1000.0, 43.6, 5.26),
            (150.0, 2000.0, 153.0, 14.2),
        ] {
            let sd_rad = 2f64.to_radians();
            let pass = StraightPass { range_m, window_s: 200.0, sd_rad, tau_s, speed_m_s: 7.0 };
            let (best, _) = limits(&pass).unwrap();
            let heading = best.heading_rad.to_degrees();
            assert!((best.cpa_range_m / sd_m - 1.0).abs() < 0.05, "{tau_s} {range_m}: {}", best.cpa_range_m);
            assert!((heading / sd_deg - 1.0).abs() < 0.05, "{tau_s} {range_m}: {heading}");
        }
    }

    #[test]
    fn elevations_give_the_speed() {
        let pass = StraightPass { range_m: 500.0, window_s: 200.0, sd_rad: 0.02, tau_s: 0.0, speed_m_s: 7.0 };
        let free = Config { speed_sd_m_s: f64::INFINITY, ..config(Model::White, 0.0, 7.0) };
        assert!(limit(&pass, &free, None).is_none());
        let medium = Medium { height_m: 150.0, ..free.medium };
        let known = limit(&pass, &Config { medium, ..free }, Some(0.02)).unwrap();
        assert!(known.speed_m_s > 0.0 && known.speed_m_s < 1.0, "{known:?}");
    }
}
