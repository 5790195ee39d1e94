//! The scenario file of an array pass (TOML); unknown or wrong keys are errors that name the key and the line.

use crate::recording::write::Encoding;
use crate::station::{Station, located, toml_error};
use anyhow::{Context, Result, anyhow, bail};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

/// What is simulated.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// The recorder.
    pub station: Station,
    /// Text of its station file, written beside the recording.
    pub station_text: String,
    /// Length of the recording, seconds by the recorder's clock.
    pub duration_s: f64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// UTC of the first sample.
    pub start: OffsetDateTime,
    /// The recorder's electronics and files.
    pub recorder: Recorder,
    /// The sea.
    pub water: Water,
    /// Noise of the sea.
    pub ambient: Ambient,
    /// Vessels.
    pub vessels: Vec<Vessel>,
    /// Times without samples.
    pub gaps: Vec<Gap>,
    /// Damage to channels.
    pub faults: Vec<Fault>,
    /// Step of `truth.csv`, seconds.
    pub truth_step_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[allow(dead_code)]
    kind: String,
    station: PathBuf,
    duration_s: f64,
    #[serde(default)]
    seed: u64,
    start_utc: Option<String>,
    #[serde(default)]
    recorder: Recorder,
    #[serde(default)]
    water: Water,
    #[serde(default)]
    ambient: Ambient,
    #[serde(default)]
    vessels: Vec<Vessel>,
    #[serde(default)]
    gaps: Vec<Gap>,
    #[serde(default)]
    faults: Vec<Fault>,
    #[serde(default = "half")]
    truth_step_s: f64,
}

fn half() -> f64 {
    0.5
}

/// Preamplifier, converter, clock and files.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recorder {
    /// Samples as 24-bit integers or floating point.
    pub encoding: Encoding,
    /// Gain between hydrophone and converter, dB.
    pub gain_db: f64,
    /// Voltage of full scale.
    pub full_scale_v: f64,
    /// Resolution of the converter.
    pub bits: u32,
    /// How much faster than true the sample clock runs, parts in a million.
    pub clock_drift_ppm: f64,
    /// Length of one file, seconds; 0 means one file between gaps.
    pub file_s: f64,
}

impl Default for Recorder {
    fn default() -> Self {
        Self {
            encoding: Encoding::Int24,
            gain_db: 0.0,
            full_scale_v: 2.5,
            bits: 24,
            clock_drift_ppm: 0.0,
            file_s: 0.0,
        }
    }
}

/// The sea.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Water {
    /// Amplitude of the surface's reflection: −1 pressure release, 0 none.
    pub surface_reflection: f64,
}

impl Default for Water {
    fn default() -> Self {
        Self { surface_reflection: -1.0 }
    }
}

/// Ambient noise: flat up to the knee, then falling by a slope.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ambient {
    /// Spectral density at 1 kHz, dB re 1 µPa²/Hz.
    pub level_db_1khz: f64,
    /// Instead: signal-to-noise ratio of the first vessel's direct sound at its closest point, in the station's band, dB.
    pub snr_at_cpa_db: Option<f64>,
    /// Slope above the knee, dB a decade.
    pub slope_db_per_decade: f64,
    /// Knee, Hz.
    pub knee_hz: f64,
    /// Share of the power that is a diffuse field (coherence sin(kd)/(kd) between hydrophones); the rest is
    /// independent from hydrophone to hydrophone.
    pub diffuse_share: f64,
}

impl Default for Ambient {
    // About sea state 2 with the slope of wind noise (-5 dB an octave).
    fn default() -> Self {
        Self {
            level_db_1khz: 60.0,
            snr_at_cpa_db: None,
            slope_db_per_decade: -17.0,
            knee_hz: 500.0,
            diffuse_share: 0.0,
        }
    }
}

/// One vessel.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vessel {
    /// Name in `truth.csv`.
    pub name: String,
    /// Straight course at constant speed.
    pub straight: Option<Straight>,
    /// Instead: a file with `t_s` and `x_m,y_m` (East and North of the station) or `lat,lon`.
    pub track: Option<PathBuf>,
    /// Depth of the sound source below the surface, metres.
    #[serde(default = "four")]
    pub depth_m: f64,
    /// Broadband level of the noise, dB re 1 µPa at 1 m (tones apart).
    pub source_level_db: f64,
    /// Slope of its spectrum above the knee, dB a decade.
    #[serde(default = "minus_twenty")]
    pub slope_db_per_decade: f64,
    /// Knee, Hz: the spectrum is flat below.
    #[serde(default = "hundred")]
    pub knee_hz: f64,
    /// Tones.
    #[serde(default)]
    pub tones: Vec<Tone>,
    /// Amplitude modulation of the noise by shaft and blades.
    pub modulation: Option<Modulation>,
}

fn four() -> f64 {
    4.0
}
fn minus_twenty() -> f64 {
    -20.0
}
fn hundred() -> f64 {
    100.0
}

/// A straight course.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Straight {
    /// Time of the closest point of approach, seconds of true time after the first sample.
    pub cpa_time_s: f64,
    /// Horizontal range there, metres.
    pub cpa_range_m: f64,
    /// Heading, degrees clockwise from North.
    pub heading_deg: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// The vessel's side on which the array lies.
    pub side: Side,
}

/// A side of a vessel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Left.
    Port,
    /// Right.
    Starboard,
}

/// A tone.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tone {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Level, dB re 1 µPa (rms) at 1 m.
    pub level_db: f64,
}

/// Amplitude modulation `1 + m_s cos(2π f t) + Σ_k m_b/k cos(2π k n f t)` for shaft rate f and n blades, at equal power.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Modulation {
    /// Revolutions a second.
    pub shaft_rate_hz: f64,
    /// Blades of the propeller.
    pub blades: u32,
    /// Depth at the shaft rate, 0 to 1.
    #[serde(default)]
    pub shaft_depth: f64,
    /// Depth at the blade rate, 0 to 1; harmonic k has a k-th of it.
    pub blade_depth: f64,
    /// Harmonics of the blade rate.
    #[serde(default = "one")]
    pub harmonics: u32,
}

fn one() -> u32 {
    1
}

/// A time without samples, by the recorder's clock.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gap {
    /// Start, seconds.
    pub start_s: f64,
    /// Length, seconds.
    pub duration_s: f64,
}

/// What happens to a channel.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum Fault {
    /// Zero.
    Dead(Affected),
    /// The last code before it, over and over.
    Stuck(Affected),
    /// NaN (floating-point recordings only).
    Nan(Affected),
    /// Gain by which the channel is too loud, dB: it clips.
    Loud(Loud),
    /// Two channels exchanged.
    Swap(Swap),
}

/// Channel and time of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Affected {
    /// Recorder channel.
    pub channel: usize,
    /// Start, seconds by the recorder's clock.
    #[serde(default)]
    pub from_s: f64,
    /// End, seconds.
    #[serde(default = "forever")]
    pub to_s: f64,
}

/// A channel that is too loud.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Loud {
    /// Recorder channel.
    pub channel: usize,
    /// Gain, dB.
    pub gain_db: f64,
    /// Start, seconds by the recorder's clock.
    #[serde(default)]
    pub from_s: f64,
    /// End, seconds.
    #[serde(default = "forever")]
    pub to_s: f64,
}

/// Two exchanged channels.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Swap {
    /// Recorder channels.
    pub channels: [usize; 2],
    /// Start, seconds by the recorder's clock.
    #[serde(default)]
    pub from_s: f64,
    /// End, seconds.
    #[serde(default = "forever")]
    pub to_s: f64,
}

fn forever() -> f64 {
    f64::INFINITY
}

/// The `kind` of a scenario file: `array` or `obs`.
///
/// # Errors
/// The file cannot be read or has no `kind`.
pub fn kind(path: &Path) -> Result<String> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read scenario file {name}"))?;
    let table: toml::Table = toml::from_str(&text).map_err(|e| toml_error(&e, &text, &name))?;
    match table.get("kind").and_then(toml::Value::as_str) {
        Some(kind @ ("array" | "obs")) => Ok(kind.to_owned()),
        Some(other) => bail!("{}: kind = \"{other}\"; array or obs", located(&text, &name, "kind")),
        None => bail!("{name}: missing key `kind`: array or obs"),
    }
}

impl Scenario {
    /// Reads and checks an array scenario and the station file it names (relative to its own folder).
    ///
    /// # Errors
    /// One line: file, line, key, and what is allowed.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text =
            std::fs::read_to_string(path).with_context(|| format!("cannot read scenario file {name}"))?;
        let folder = path.parent().unwrap_or(Path::new("."));
        let file: File = toml::from_str(&text).map_err(|e| toml_error(&e, &text, &name))?;
        let station_path = folder.join(&file.station);
        let station_text = std::fs::read_to_string(&station_path).with_context(|| {
            format!("{}: cannot read {}", located(&text, &name, "station"), station_path.display())
        })?;
        let station = Station::parse(
            &station_text,
            &station_path.display().to_string(),
            station_path.parent().unwrap_or(Path::new(".")),
        )?;
        let start = match &file.start_utc {
            None => OffsetDateTime::UNIX_EPOCH + time::Duration::days(19_844), // 2024-05-01
            Some(s) => {
                OffsetDateTime::parse(s, &time::format_description::well_known::Rfc3339).map_err(|_| {
                    anyhow!(
                        "{}: `{s}` is no time; 2024-05-01T00:00:00Z was expected",
                        located(&text, &name, "start_utc")
                    )
                })?
            }
        };
        let vessels = file
            .vessels
            .into_iter()
            .map(|v| Vessel { track: v.track.as_ref().map(|t| folder.join(t)), ..v })
            .collect();
        let scenario = Self {
            station,
            station_text,
            duration_s: file.duration_s,
            seed: file.seed,
            start,
            recorder: file.recorder,
            water: file.water,
            ambient: file.ambient,
            vessels,
            gaps: file.gaps,
            faults: file.faults,
            truth_step_s: file.truth_step_s,
        };
        scenario.check().map_err(|(key, what)| anyhow!("{}: {what}", located(&text, &name, key)))?;
        Ok(scenario)
    }

    /// The first key found wrong, and why.
    fn check(&self) -> Result<(), (&'static str, String)> {
        let within = |key: &'static str, x: f64, lo: f64, hi: f64| {
            if x >= lo && x <= hi {
                Ok(())
            } else {
                Err((key, format!("`{key}` is {x}; allowed {lo} to {hi}")))
            }
        };
        if !matches!(self.station.config.kind, seabearing_core::config::Kind::Array(_)) {
            return Err(("station", "the scenario is of kind array, its station is not".to_owned()));
        }
        let nyquist = self.station.config.rate_hz / 2.0;
        within("duration_s", self.duration_s, 0.01, 1e6)?;
        within("truth_step_s", self.truth_step_s, 1e-3, 1e4)?;
        within("gain_db", self.recorder.gain_db, -100.0, 200.0)?;
        within("full_scale_v", self.recorder.full_scale_v, 1e-6, 1e3)?;
        within("bits", f64::from(self.recorder.bits), 8.0, 24.0)?;
        within("clock_drift_ppm", self.recorder.clock_drift_ppm, -1000.0, 1000.0)?;
        within("file_s", self.recorder.file_s, 0.0, 1e6)?;
        within("surface_reflection", self.water.surface_reflection, -1.0, 1.0)?;
        let a = &self.ambient;
        within("level_db_1khz", a.level_db_1khz, -100.0, 200.0)?;
        within("slope_db_per_decade", a.slope_db_per_decade, -60.0, 20.0)?;
        within("knee_hz", a.knee_hz, 1.0, nyquist)?;
        within("diffuse_share", a.diffuse_share, 0.0, 1.0)?;
        if let Some(snr) = a.snr_at_cpa_db {
            within("snr_at_cpa_db", snr, -60.0, 100.0)?;
            if self.vessels.is_empty() {
                return Err(("snr_at_cpa_db", "`snr_at_cpa_db` needs a vessel".to_owned()));
            }
        }
        for v in &self.vessels {
            if v.straight.is_some() == v.track.is_some() {
                return Err(("vessels", format!("vessel `{}` needs either `straight` or `track`", v.name)));
            }
            if v.name.is_empty() || v.name.contains([',', '"', '\n']) {
                return Err(("name", format!("vessel name `{}`: no commas, quotes or line ends", v.name)));
            }
            within("depth_m", v.depth_m, 0.0, self.station.config.depth_m.max(0.0))?;
            within("source_level_db", v.source_level_db, -100.0, 260.0)?;
            within("slope_db_per_decade", v.slope_db_per_decade, -60.0, 20.0)?;
            within("knee_hz", v.knee_hz, 1.0, nyquist)?;
            if let Some(s) = v.straight {
                within("cpa_time_s", s.cpa_time_s, -1e6, 1e6)?;
                within("cpa_range_m", s.cpa_range_m, 0.0, 1e6)?;
                within("heading_deg", s.heading_deg, -360.0, 360.0)?;
                within("speed_m_s", s.speed_m_s, 0.0, 100.0)?;
            }
            for t in &v.tones {
                within("frequency_hz", t.frequency_hz, 0.1, super::source::HIGHEST * 2.0 * nyquist)?;
                within("level_db", t.level_db, -100.0, 260.0)?;
            }
            if let Some(m) = v.modulation {
                within("shaft_rate_hz", m.shaft_rate_hz, 0.01, 100.0)?;
                within("blades", f64::from(m.blades), 1.0, 12.0)?;
                within("shaft_depth", m.shaft_depth, 0.0, 1.0)?;
                within("blade_depth", m.blade_depth, 0.0, 1.0)?;
                within("harmonics", f64::from(m.harmonics), 1.0, 50.0)?;
            }
        }
        let mut end = 0.0;
        for g in &self.gaps {
            within("start_s", g.start_s, end, self.duration_s)?;
            within("duration_s", g.duration_s, 0.0, self.duration_s - g.start_s)?;
            end = g.start_s + g.duration_s;
        }
        for f in &self.faults {
            match *f {
                Fault::Dead(a) | Fault::Stuck(a) | Fault::Nan(a) => {
                    within("channel", a.channel as f64, 0.0, 3.0)?
                }
                Fault::Loud(l) => within("channel", l.channel as f64, 0.0, 3.0)?,
                Fault::Swap(s) => {
                    within("channels", s.channels[0] as f64, 0.0, 3.0)?;
                    within("channels", s.channels[1] as f64, 0.0, 3.0)?;
                }
            }
            if matches!(f, Fault::Nan(_)) && self.recorder.encoding != Encoding::Float {
                return Err(("faults", "a fault of kind nan needs `encoding = \"float\"`".to_owned()));
            }
        }
        Ok(())
    }
}
