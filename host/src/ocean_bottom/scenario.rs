//! What is to be simulated for an ocean-bottom station: the scenario file (`kind = "obs"`).
//!
//! ```toml
//! kind = "obs"
//! seed = 1
//! duration_s = 21600.0
//! start = "2013-05-21T00:00:00Z"
//! propagation = "rr03.toml"           # relative to this file
//! orientation_of_north_deg = 77.0
//! [ambient]
//! pressure_counts = 1000.0
//! [[ship]]
//! cpa_time_s = 10800.0
//! cpa_range_m = 9000.0
//! heading_deg = 60.0
//! speed_m_s = 7.0
//! ```
//! Levels: `wideband_db` is the power of a vessel's wideband noise over all paths against the ambient noise, both in
//! 5 to 25 Hz, with the vessel 20 km away. `tone_db` is the height of each line above the ambient noise in one bin of a
//! 1024-point Hann spectrum (0.073 Hz of noise bandwidth), again at 20 km.

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use std::path::PathBuf;

/// A scenario as a person writes it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Always `obs`.
    pub kind: String,
    /// Seed of everything random.
    #[serde(default = "one")]
    pub seed: u64,
    /// Length, s.
    pub duration_s: f64,
    /// UTC of the first sample, RFC 3339.
    #[serde(default = "default_start")]
    pub start: String,
    /// Samples a second; vessels and calls need 50.
    #[serde(default = "default_rate")]
    pub rate_hz: f64,
    /// The propagation table.
    pub propagation: PathBuf,
    /// Paths that carry sound, counted from the direct one (5: up to nine crossings).
    #[serde(default = "default_paths")]
    pub paths: usize,
    /// Name written into files (up to five letters or digits).
    #[serde(default = "default_name")]
    pub name: String,
    /// Latitude and longitude of the station, degrees (needed for AIS).
    pub lat_lon_deg: Option<[f64; 2]>,
    /// True azimuth of the first horizontal component, degrees.
    #[serde(default)]
    pub orientation_of_north_deg: f64,
    /// `away` or `towards`: which way active intensity points.
    #[serde(default = "default_intensity")]
    pub intensity: String,
    /// Noise of the sea and the instrument.
    #[serde(default)]
    pub ambient: AmbientTable,
    /// Vessels on straight courses.
    #[serde(default)]
    pub ship: Vec<Ship>,
    /// Vessels on real tracks.
    #[serde(default)]
    pub ais: Vec<AisShips>,
    /// Fin whales.
    #[serde(default)]
    pub fin_whale: Vec<Whale>,
    /// Blue whales.
    #[serde(default)]
    pub blue_whale: Vec<Whale>,
    /// Earthquakes: seconds of noise from below.
    #[serde(default)]
    pub earthquake: Vec<Burst>,
    /// T phases: minutes of noise from a distant place.
    #[serde(default)]
    pub t_phase: Vec<Burst>,
    /// Harmonic tremor of buoy and rope in the current.
    #[serde(default)]
    pub strumming: Vec<Strumming>,
    /// What goes wrong in the recorder.
    #[serde(default)]
    pub faults: Faults,
}

/// Ambient noise.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AmbientTable {
    /// Root-mean-square pressure of the isotropic part, counts.
    pub pressure_counts: f64,
    /// Horizontal velocities against pressure, dB.
    pub horizontal_db: f64,
    /// Vertical velocity against pressure, dB.
    pub vertical_db: f64,
    /// How much louder 0.2 Hz is than 1 Hz and above, dB.
    pub microseism_db: f64,
    /// Directional parts.
    pub directional: Vec<DirectionalTable>,
}

/// Ambient noise from one direction.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DirectionalTable {
    /// Where it comes from, degrees.
    pub azimuth_deg: f64,
    /// Level against the isotropic pressure, dB.
    pub level_db: f64,
}

/// What a vessel radiates.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Radiation {
    /// Wideband level at 20 km, dB.
    pub wideband_db: f64,
    /// Level of the lines at 20 km, dB.
    pub tone_db: f64,
    /// Lines, Hz.
    pub tones_hz: Vec<f64>,
    /// Blade rate, Hz, whose harmonics up to 24.5 Hz are lines too (0: none).
    pub blade_hz: f64,
    /// Relative wander of all lines (one standard deviation).
    pub wander: f64,
}

/// A vessel on a straight course.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ship {
    /// Name in the truth.
    #[serde(default)]
    pub name: String,
    /// Time of the closest point, s.
    pub cpa_time_s: f64,
    /// Its range, m.
    pub cpa_range_m: f64,
    /// Heading, degrees.
    pub heading_deg: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// Whether the station lies to starboard.
    #[serde(default)]
    pub starboard: bool,
    /// When it sounds, s.
    #[serde(default = "always")]
    pub active_s: [f64; 2],
    /// What it radiates.
    #[serde(default)]
    pub radiation: Radiation,
}

/// Vessels of an AIS file that pass the station.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AisShips {
    /// The file (CSV of either source, also xz), relative to the scenario.
    pub file: PathBuf,
    /// Only this vessel.
    pub mmsi: Option<u64>,
    /// What each radiates; blade rate and lines are varied from vessel to vessel.
    #[serde(default)]
    pub radiation: Radiation,
}

/// A calling whale.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Whale {
    /// Where, degrees.
    pub azimuth_deg: f64,
    /// How far, m.
    pub range_m: f64,
    /// When the bout starts, s.
    pub start_s: f64,
    /// How long it lasts, s.
    pub duration_s: f64,
    /// From call to call, s (fin about 13, blue about 65).
    pub interval_s: f64,
    /// Peak of the strongest arrival against the ambient root mean square, dB.
    pub level_db: f64,
}

/// A burst of noise.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Burst {
    /// Where it comes from, degrees.
    pub azimuth_deg: f64,
    /// Onset, s.
    pub start_s: f64,
    /// Length, s.
    pub duration_s: f64,
    /// Greatest root-mean-square pressure against the ambient, dB.
    pub level_db: f64,
}

/// Strumming of buoy and rope.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Strumming {
    /// Axis of the motion, degrees.
    pub azimuth_deg: f64,
    /// Onset, s.
    pub start_s: f64,
    /// Length, s.
    pub duration_s: f64,
    /// Fundamental, Hz.
    pub fundamental_hz: f64,
    /// Level of each line in velocity, dB above the ambient in one bin.
    pub level_db: f64,
    /// What of it reaches the hydrophone, dB.
    #[serde(default = "default_coupling")]
    pub pressure_db: f64,
}

/// Faults of the recorder. Channels: 0 pressure, 1 north, 2 east, 3 vertical; spans are `[start_s, duration_s]`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// Missing spans.
    pub gaps: Vec<[f64; 2]>,
    /// Steps of the clock: `[at_s, by_s]`.
    pub clock_steps: Vec<[f64; 2]>,
    /// Channels that do not move: `[channel, start_s, duration_s]`.
    pub dead: Vec<[f64; 3]>,
    /// Channels at full scale: `[channel, start_s, duration_s]`.
    pub saturated: Vec<[f64; 3]>,
    /// Channels without a file.
    pub missing: Vec<usize>,
}

fn one() -> u64 {
    1
}
fn default_start() -> String {
    "2013-05-21T00:00:00Z".into()
}
fn default_rate() -> f64 {
    50.0
}
fn default_paths() -> usize {
    5
}
fn default_name() -> String {
    "RR03".into()
}
fn default_intensity() -> String {
    "away".into()
}
fn always() -> [f64; 2] {
    [-1e9, 1e9]
}
fn default_coupling() -> f64 {
    -30.0
}

impl Default for AmbientTable {
    fn default() -> Self {
        Self {
            pressure_counts: 1000.0,
            horizontal_db: 0.0,
            vertical_db: 0.0,
            microseism_db: 15.0,
            directional: Vec::new(),
        }
    }
}

impl Default for Radiation {
    /// Six lines between 11 and 24 Hz and no harmonics: the test vessel of the project's own figures.
    fn default() -> Self {
        Self {
            wideband_db: 0.0,
            tone_db: 20.0,
            tones_hz: vec![12.1, 14.3, 16.9, 18.2, 20.6, 22.7],
            blade_hz: 0.0,
            wander: 1e-4,
        }
    }
}

impl Scenario {
    /// Reads and checks a scenario; relative paths become relative to the file's folder.
    ///
    /// # Errors
    /// One line: file, line, key.
    pub fn read(path: &std::path::Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read scenario {name}"))?;
        let mut s: Self = toml::from_str(&text).map_err(|e| {
            let line = e.span().map_or(0, |s| text[..s.start.min(text.len())].lines().count().max(1));
            anyhow::anyhow!("{name}, line {line}: {}", e.message())
        })?;
        let folder = path.parent().unwrap_or(std::path::Path::new("."));
        s.propagation = folder.join(&s.propagation);
        for a in &mut s.ais {
            a.file = folder.join(&a.file);
        }
        s.check().with_context(|| name)?;
        Ok(s)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first key found wrong.
    pub fn check(&self) -> Result<()> {
        if self.kind != "obs" {
            bail!("kind is `{}`, an ocean-bottom scenario has kind = \"obs\"", self.kind);
        }
        if self.rate_hz != 50.0 {
            bail!("rate_hz is {}; the ocean-bottom simulator makes 50 samples a second", self.rate_hz);
        }
        let ships = self.ship.iter();
        let within = [
            ("duration_s", self.duration_s, 1.0, 3.2e7),
            ("paths", self.paths as f64, 1.0, 7.0),
            ("pressure_counts", self.ambient.pressure_counts, 1e-3, 1e6),
        ]
        .into_iter()
        .chain(ships.clone().map(|s| ("cpa_range_m", s.cpa_range_m, 0.0, 2e5)))
        .chain(ships.clone().map(|s| ("speed_m_s", s.speed_m_s, 0.1, 40.0)))
        .chain(self.fin_whale.iter().chain(&self.blue_whale).map(|w| ("interval_s", w.interval_s, 1.0, 1e4)));
        for (key, x, lo, hi) in within {
            if !(lo..=hi).contains(&x) {
                bail!("{key} is {x}; allowed {lo} to {hi}");
            }
        }
        if !["away", "towards"].contains(&self.intensity.as_str()) {
            bail!("intensity is `{}`; away or towards", self.intensity);
        }
        if self.name.is_empty()
            || self.name.len() > 5
            || !self.name.chars().all(|c| c.is_ascii_alphanumeric())
        {
            bail!("name is `{}`; one to five letters or digits", self.name);
        }
        for c in self
            .faults
            .missing
            .iter()
            .map(|c| *c as f64)
            .chain(self.faults.dead.iter().chain(&self.faults.saturated).map(|d| d[0]))
        {
            if !(0.0..4.0).contains(&c) {
                bail!("channel {c} in faults; 0 pressure, 1 north, 2 east, 3 vertical");
            }
        }
        if !self.ais.is_empty() && self.lat_lon_deg.is_none() {
            bail!("lat_lon_deg is needed to place AIS vessels");
        }
        self.start_utc().map(|_| ())
    }

    /// UTC of the first sample.
    ///
    /// # Errors
    /// It is not RFC 3339.
    pub fn start_utc(&self) -> Result<time::OffsetDateTime> {
        time::OffsetDateTime::parse(&self.start, &time::format_description::well_known::Rfc3339).with_context(
            || format!("start is `{}`; RFC 3339 was expected, as 2013-05-21T00:00:00Z", self.start),
        )
    }
}
