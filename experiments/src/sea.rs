//! Scenes of the sea for the experiments about a real one: made in memory, heard by the recorder's own software.
//!
//! The station is the tetrahedron of the examples; scenes whose figures hang on the rate are heard at 16 and at 64 kHz ([`RATES`]), the
//! others at 16 kHz: more scenes say more than more samples.

use super::figure::{Bar, Figures};
use super::sea_moving::MovingSea;
use crate::recording::BlockSource;
use crate::replay::replay;
use crate::scenario::{Side, Straight};
use crate::station::{Components, Station};
use crate::world::ArrayScenario;
use crate::world::scenario::{AmbientSpectrum, ArrayVessel, RecorderModel, Scene, Water};
use anyhow::Result;
use seabearing_core::angle::wrap_pi;
use seabearing_core::block::{Block, Frame};
use seabearing_core::config::{ArrayConfig, Kind, StationConfig};
use seabearing_core::wire::{Bearing, Fault, Message, Track, Transient};
use time::OffsetDateTime;

/// Samples a second, where nothing hangs on it.
pub const RATE_HZ: f64 = 16_000.0;
/// Samples a second of recorders, and what figures call them: a frame of as many samples is a quarter as long at the usual
/// rate, and echoes are four times as late in it.
pub const RATES: [(f64, &str); 2] = [(RATE_HZ, "16 kHz"), (64_000.0, "64 kHz")];

/// The tetrahedron of the examples at a rate (Hz) and depth (m), as the caller changes it.
pub fn station(rate_hz: f64, depth_m: f64, change: impl FnOnce(&mut ArrayConfig)) -> StationConfig {
    let hydrophones_m =
        [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];
    let mut config = StationConfig::array(rate_hz, hydrophones_m);
    config.depth_m = depth_m;
    if let Kind::Array(array) = &mut config.kind {
        array.band_hz.1 = array.band_hz.1.min(0.4375 * rate_hz);
        change(array);
    }
    config
}

/// A vessel like the ferry of the demo on a straight course.
pub fn ferry(straight: Straight) -> ArrayVessel {
    ArrayVessel {
        name: "ferry".into(),
        straight: Some(straight),
        track: None,
        depth_m: 4.0,
        source_level_db: 172.0,
        slope_db_per_decade: -20.0,
        knee_hz: 100.0,
        tones: Vec::new(),
        modulation: None,
    }
}

/// Which side of two.
pub fn side(port: bool) -> Side {
    if port { Side::Port } else { Side::Starboard }
}

/// A scene of vessels in the demo's noise.
pub fn scenario(
    config: StationConfig,
    water: Water,
    vessels: Vec<ArrayVessel>,
    duration_s: f64,
    seed: u64,
) -> ArrayScenario {
    let station = Station {
        config,
        components: Components::default(),
        propagation: None,
        seed_id: None,
        gains: [1.0; 4],
        responses: [const { None }; 4],
        file_channels: None,
        name_offset: None,
        line: Default::default(),
        calibration: Default::default(),
    };
    let ambient = AmbientSpectrum { level_db_1khz: 65.0, diffuse_share: 0.5, ..AmbientSpectrum::default() };
    let scene = Scene {
        kind: "array".into(),
        station: Default::default(),
        duration_s,
        seed,
        start: OffsetDateTime::UNIX_EPOCH,
        recorder: RecorderModel::default(),
        water,
        ambient,
        vessels,
        gaps: Vec::new(),
        faults: Vec::new(),
        truth_step_s: 0.5,
    };
    ArrayScenario { station, station_text: String::new(), scene }
}

/// What a recorder said.
#[derive(Clone, Debug, Default)]
pub struct Said {
    /// Bearings.
    pub bearings: Vec<Bearing>,
    /// Tracks, running and final.
    pub tracks: Vec<Track>,
    /// Faults.
    pub faults: Vec<Fault>,
    /// Transients.
    pub transients: Vec<Transient>,
}

impl Said {
    /// End-of-passage solutions.
    pub fn passages(&self) -> impl Iterator<Item = &Track> {
        self.tracks.iter().filter(|t| t.stage == 1)
    }
}

/// Runs the recorder over frames.
///
/// # Errors
/// The configuration cannot be run.
pub fn hear(config: &StationConfig, frames: impl Iterator<Item = Frame>) -> Result<Said> {
    let mut said = Said::default();
    for message in messages(config, frames)? {
        match message {
            Message::Bearing(b) => said.bearings.push(b),
            Message::Track(t) => said.tracks.push(t),
            Message::Fault(f) => said.faults.push(f),
            Message::Transient(t) => said.transients.push(t),
            _ => {}
        }
    }
    Ok(said)
}

/// Everything that the recorder sends of frames.
///
/// # Errors
/// The configuration cannot be run.
pub fn messages(config: &StationConfig, frames: impl Iterator<Item = Frame>) -> Result<Vec<Message>> {
    let mut all = Vec::new();
    let mut source = FrameSource { frames, block: Vec::new(), next: 0 };
    replay(config, None, &mut source, |message| {
        all.push(*message);
        Ok(())
    })?;
    Ok(all)
}

/// A scene, made and heard.
///
/// # Errors
/// As [`hear`].
pub fn play(scenario: &ArrayScenario) -> Result<Said> {
    hear(&scenario.station.config, MovingSea::new(scenario)?)
}

/// Frames without a break.
struct FrameSource<I> {
    frames: I,
    block: Vec<Frame>,
    next: u64,
}

impl<I: Iterator<Item = Frame>> BlockSource for FrameSource<I> {
    fn start(&self) -> Option<OffsetDateTime> {
        None
    }

    fn expected_end(&self) -> Option<u64> {
        None
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        self.block.clear();
        self.block.extend(self.frames.by_ref().take(4096));
        let first_index = self.next;
        self.next += self.block.len() as u64;
        Ok((!self.block.is_empty()).then_some(Block { first_index, frames: &self.block }))
    }
}

/// Azimuth and elevation (radians) from which a vessel of a scene is heard at a time.
///
/// # Errors
/// Its course cannot be used.
pub fn arrival(scenario: &ArrayScenario, vessel: &ArrayVessel, t_s: f64) -> Result<(f64, f64)> {
    let config = &scenario.station.config;
    let motion = vessel.course(None)?;
    let height = config.depth_m - vessel.depth_m;
    let (emitted, _) = motion.emission(t_s, [0.0; 3], height, config.sound_speed_m_s, t_s);
    let (x, y) = motion.position(emitted);
    Ok((x.atan2(y), height.atan2(x.hypot(y))))
}

/// How far a bearing is off in units of its covariance, squared (5.991: 95 % of a two-dimensional normal lie within), and in
/// space, radians.
pub fn miss(b: &Bearing, (azimuth, elevation): (f64, f64)) -> (f64, f64) {
    let (da, de) = (wrap_pi(f64::from(b.azimuth) - azimuth), f64::from(b.elevation) - elevation);
    let (va, ve, c) = (f64::from(b.var_azimuth), f64::from(b.var_elevation), f64::from(b.cov));
    let chi2 = (ve * da * da - 2.0 * c * da * de + va * de * de) / (va * ve - c * c);
    (chi2, (da * elevation.cos()).hypot(de))
}

/// Bound of [`miss`] that 95 % stay below.
pub const ELLIPSE: f64 = 5.991;

/// Whether a vessel's azimuth (radians) lies in the 95 % that a bearing states of it.
pub fn holds_azimuth(b: &Bearing, azimuth: f64) -> bool {
    wrap_pi(f64::from(b.azimuth) - azimuth).abs() <= 1.96 * f64::from(b.var_azimuth).sqrt()
}

/// Trials of which so many should hold.
#[derive(Clone, Copy, Debug, Default)]
pub struct Held {
    /// Those that did.
    pub held: usize,
    /// All.
    pub of: usize,
}

impl Held {
    /// Takes a trial.
    pub fn take(&mut self, held: bool) {
        self.held += usize::from(held);
        self.of += 1;
    }

    /// Joins another count.
    pub fn join(&mut self, other: Self) {
        self.held += other.held;
        self.of += other.of;
    }

    /// Their share, %.
    pub fn percent(self) -> f64 {
        100.0 * self.held as f64 / self.of as f64
    }

    /// Reports the share of independent trials that lay in their stated 95 %: 92 to 97 %, and no nearer than so many trials
    /// can tell (95 % limits of the binomial law).
    pub fn report(self, figures: &Figures, name: &str) {
        let (low, high) = binomial_limits(self.of, 0.95);
        let n = self.of as f64;
        let bar = Bar::Within((100.0 * low as f64 / n).min(92.0), (100.0 * high as f64 / n).max(97.0));
        figures.report(format!("{name}, % of {}", self.of), self.percent(), bar);
    }
}

/// The numbers of successes below and above which 2.5 % of `n` trials of probability `p` stay at most.
fn binomial_limits(n: usize, p: f64) -> (usize, usize) {
    // By logarithms: (1 − p)ⁿ is 0 beyond some 240 trials.
    let mut logarithm = n as f64 * (1.0 - p).ln();
    let (mut sum, mut low, mut high) = (0.0, None, n);
    for k in 0..=n {
        sum += logarithm.exp();
        if sum > 0.025 && low.is_none() {
            low = Some(k);
        }
        if sum >= 0.975 {
            high = k;
            break;
        }
        logarithm += ((n - k) as f64 / (k + 1) as f64 * p / (1.0 - p)).ln();
    }
    (low.unwrap_or(n), high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_of_few_trials_are_wide_and_of_many_narrow() {
        assert_eq!(binomial_limits(1, 0.95), (0, 1));
        assert_eq!(binomial_limits(10, 0.95), (8, 10));
        assert_eq!(binomial_limits(200, 0.95), (184, 196));
        // Where 0.05ⁿ is no number any more: the normal law's 950 ± 13.5.
        assert_eq!(binomial_limits(1000, 0.95), (936, 963));
    }
}
