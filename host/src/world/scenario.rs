//! The scenario file of an array pass (TOML); unknown or wrong keys are errors that name the key and the line.

use crate::course::{VesselCourse, fixes};
use crate::csv::{CsvTable, good_rows};
use crate::recording::write::Encoding;
pub use crate::scenario::{Affected, Gap, Side, Straight};
use crate::scenario::{ScenarioFile, ScenarioKind, StationFile, Wrong, check_gaps, forever, utc, within};
use crate::station::Station;
use anyhow::{Result, anyhow, bail};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

/// Highest frequency of a source signal, as a share of the sample rate: what [`seabearing_signal::interpolate`] needs.
pub const HIGHEST: f64 = 0.44;

/// What is simulated: a recorder, and everything else.
#[derive(Clone, Debug)]
pub struct ArrayScenario {
    /// The recorder.
    pub station: Station,
    /// Text of its station file, written beside the recording.
    pub station_text: String,
    /// What the scenario file says.
    pub scene: Scene,
}

/// What a scenario file says, but for the station file's content.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Always `array`.
    #[cfg_attr(feature = "schema", schemars(extend("const" = "array")))]
    pub kind: String,
    /// The recorder's station file, relative to the scenario.
    pub station: PathBuf,
    /// Length of the recording, seconds by the recorder's clock.
    pub duration_s: f64,
    /// Seed of all random numbers.
    #[serde(default)]
    pub seed: u64,
    /// UTC of the first sample.
    #[serde(rename = "start_utc", default = "default_start", deserialize_with = "utc")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub start: OffsetDateTime,
    /// The recorder's electronics and files.
    #[serde(default)]
    pub recorder: RecorderModel,
    /// The sea.
    #[serde(default)]
    pub water: Water,
    /// Noise of the sea.
    #[serde(default)]
    pub ambient: AmbientSpectrum,
    /// Vessels.
    #[serde(default)]
    pub vessels: Vec<ArrayVessel>,
    /// Times without samples.
    #[serde(default)]
    pub gaps: Vec<Gap>,
    /// Damage to channels.
    #[serde(default)]
    pub faults: Vec<ArrayFault>,
    /// Step of `truth.csv`, seconds.
    #[serde(default = "half")]
    pub truth_step_s: f64,
}

impl std::ops::Deref for ArrayScenario {
    type Target = Scene;

    fn deref(&self) -> &Scene {
        &self.scene
    }
}

/// 2024-05-01.
fn default_start() -> OffsetDateTime {
    OffsetDateTime::UNIX_EPOCH + time::Duration::days(19_844)
}

fn half() -> f64 {
    0.5
}

/// Preamplifier, converter, clock and files.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecorderModel {
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

impl Default for RecorderModel {
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Water {
    /// Amplitude of the surface's reflection: −1 pressure release, 0 none.
    pub surface_reflection: f64,
    /// Amplitude of the bottom's reflection: 0 none.
    pub bottom_reflection: f64,
    /// Height of the array over the bottom, metres.
    pub bottom_below_m: f64,
}

impl Default for Water {
    fn default() -> Self {
        Self { surface_reflection: -1.0, bottom_reflection: 0.0, bottom_below_m: 10.0 }
    }
}

impl Water {
    /// Height above an array of this depth and amplitude: of a vessel, of its image in the surface, and of the images of both
    /// in the bottom, as far as they are heard.
    pub fn routes(&self, depth_m: f64, vessel_depth_m: f64) -> Vec<(f64, f64)> {
        let above = [(depth_m - vessel_depth_m, 1.0), (depth_m + vessel_depth_m, self.surface_reflection)];
        let below = above.map(|(z, gain)| (-2.0 * self.bottom_below_m - z, gain * self.bottom_reflection));
        above.into_iter().chain(below).filter(|route| route.1 != 0.0).collect()
    }
}

/// Ambient noise: flat up to the knee, then falling by a slope.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AmbientSpectrum {
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

impl Default for AmbientSpectrum {
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArrayVessel {
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

impl ArrayVessel {
    /// Its course; `lat_lon_deg` is the station's place, for tracks in degrees. Bad rows of a track are named and left out.
    ///
    /// # Errors
    /// The track file cannot be used.
    pub fn course(&self, lat_lon_deg: Option<(f64, f64)>) -> Result<VesselCourse> {
        match (&self.straight, &self.track) {
            (Some(s), _) => Ok(VesselCourse::straight(s)),
            (None, Some(path)) => {
                let table = CsvTable::read(path)?;
                let rows = good_rows(table.name(), fixes(&table, lat_lon_deg, (0.0, 0.0))?)?;
                VesselCourse::smooth(&rows).map_err(|e| anyhow!("{}: {e}", table.name()))
            }
            (None, None) => bail!("vessel `{}` has no course", self.name),
        }
    }
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

/// A tone.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tone {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Level, dB re 1 µPa (rms) at 1 m.
    pub level_db: f64,
}

/// Amplitude modulation `1 + m_s cos(2π f t) + Σ_k m_b/k cos(2π k n f t)` for shaft rate f and n blades, at equal power.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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

/// What happens to a channel.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum ArrayFault {
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

impl ArrayFault {
    /// When it begins and ends, s.
    fn lasts_s(&self) -> (f64, f64) {
        match *self {
            Self::Dead(a) | Self::Stuck(a) | Self::Nan(a) => (a.from_s, a.to_s),
            Self::Loud(l) => (l.from_s, l.to_s),
            Self::Swap(s) => (s.from_s, s.to_s),
        }
    }
}

/// A channel that is too loud.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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

impl ArrayScenario {
    /// Reads and checks an array scenario and the station file it names (relative to its own folder).
    ///
    /// # Errors
    /// One line: file, line, key, and what is allowed.
    pub fn read(path: &Path) -> Result<Self> {
        let scenario = ScenarioFile::read(path)?;
        scenario.expect(ScenarioKind::Array)?;
        let (source, folder) = (&scenario.source, &scenario.folder);
        let mut scene: Scene = source.parse()?;
        let StationFile { station, source: station_file } = scenario.station(&scene.station)?;
        for track in scene.vessels.iter_mut().filter_map(|v| v.track.as_mut()) {
            *track = folder.join(&*track);
        }
        let made = Self { station, station_text: station_file.text().to_owned(), scene };
        made.check().map_err(|(key, what)| source.wrong(&key, what))?;
        Ok(made)
    }

    /// The first key found wrong, and why.
    fn check(&self) -> Result<(), Wrong> {
        let nyquist = self.station.config.rate_hz / 2.0;
        within("duration_s", self.duration_s, 0.01, 1e6)?;
        within("truth_step_s", self.truth_step_s, 1e-3, 1e4)?;
        within("recorder.gain_db", self.recorder.gain_db, -100.0, 200.0)?;
        within("recorder.full_scale_v", self.recorder.full_scale_v, 1e-6, 1e3)?;
        within("recorder.bits", f64::from(self.recorder.bits), 8.0, 24.0)?;
        within("recorder.clock_drift_ppm", self.recorder.clock_drift_ppm, -1000.0, 1000.0)?;
        within("recorder.file_s", self.recorder.file_s, 0.0, 1e6)?;
        within("water.surface_reflection", self.water.surface_reflection, -1.0, 1.0)?;
        within("water.bottom_reflection", self.water.bottom_reflection, -1.0, 1.0)?;
        within("water.bottom_below_m", self.water.bottom_below_m, 0.0, 1e4)?;
        let a = &self.ambient;
        within("ambient.level_db_1khz", a.level_db_1khz, -100.0, 200.0)?;
        within("ambient.slope_db_per_decade", a.slope_db_per_decade, -60.0, 20.0)?;
        within("ambient.knee_hz", a.knee_hz, 1.0, nyquist)?;
        within("ambient.diffuse_share", a.diffuse_share, 0.0, 1.0)?;
        if let Some(snr) = a.snr_at_cpa_db {
            within("ambient.snr_at_cpa_db", snr, -60.0, 100.0)?;
            if self.vessels.is_empty() {
                return Err((
                    "ambient.snr_at_cpa_db".to_owned(),
                    "`snr_at_cpa_db` needs a vessel".to_owned(),
                ));
            }
        }
        for (i, v) in self.vessels.iter().enumerate() {
            let path = format!("vessels.{i}");
            let key = |k: &str| format!("{path}.{k}");
            if v.straight.is_some() == v.track.is_some() {
                return Err((path, format!("vessel `{}` needs either `straight` or `track`", v.name)));
            }
            if v.name.is_empty() || v.name.contains([',', '"', '\n']) {
                return Err((
                    key("name"),
                    format!("vessel name `{}`: no commas, quotes or line ends", v.name),
                ));
            }
            within(&key("depth_m"), v.depth_m, 0.0, self.station.config.depth_m.max(0.0))?;
            within(&key("source_level_db"), v.source_level_db, -100.0, 260.0)?;
            within(&key("slope_db_per_decade"), v.slope_db_per_decade, -60.0, 20.0)?;
            within(&key("knee_hz"), v.knee_hz, 1.0, nyquist)?;
            if let Some(s) = v.straight {
                s.check(&path, 0.0)?;
            }
            for (k, t) in v.tones.iter().enumerate() {
                let highest = HIGHEST * 2.0 * nyquist;
                within(&key(&format!("tones.{k}.frequency_hz")), t.frequency_hz, 0.1, highest)?;
                within(&key(&format!("tones.{k}.level_db")), t.level_db, -100.0, 260.0)?;
            }
            if let Some(m) = v.modulation {
                within(&key("modulation.shaft_rate_hz"), m.shaft_rate_hz, 0.01, 100.0)?;
                within(&key("modulation.blades"), f64::from(m.blades), 1.0, 12.0)?;
                within(&key("modulation.shaft_depth"), m.shaft_depth, 0.0, 1.0)?;
                within(&key("modulation.blade_depth"), m.blade_depth, 0.0, 1.0)?;
                within(&key("modulation.harmonics"), f64::from(m.harmonics), 1.0, 50.0)?;
            }
        }
        check_gaps(&self.gaps, self.duration_s)?;
        for (i, f) in self.faults.iter().enumerate() {
            let channel = |c: usize| within(&format!("faults.{i}.channel"), c as f64, 0.0, 3.0);
            match *f {
                ArrayFault::Dead(a) | ArrayFault::Stuck(a) | ArrayFault::Nan(a) => channel(a.channel)?,
                ArrayFault::Loud(l) => {
                    channel(l.channel)?;
                    within(&format!("faults.{i}.gain_db"), l.gain_db, -200.0, 200.0)?;
                }
                ArrayFault::Swap(s) => {
                    let key = format!("faults.{i}.channels");
                    for c in s.channels {
                        within(&key, c as f64, 0.0, 3.0)?;
                    }
                    if s.channels[0] == s.channels[1] {
                        return Err((key, format!("channel {} is exchanged with itself", s.channels[0])));
                    }
                }
            }
            let (from_s, to_s) = f.lasts_s();
            if !(from_s < to_s) {
                let what = format!("lasts from {from_s} to {to_s} s; `to_s` must come after `from_s`");
                return Err((format!("faults.{i}.to_s"), what));
            }
            if matches!(f, ArrayFault::Nan(_)) && self.recorder.encoding != Encoding::Float {
                return Err((
                    format!("faults.{i}"),
                    "a fault of kind nan needs `encoding = \"float\"`".to_owned(),
                ));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_as_long_as_their_reflections() {
        // A vessel 300 m aside and 4 m deep, an array 60 m deep, 10 m over the bottom.
        let water = Water { surface_reflection: -1.0, bottom_reflection: 0.4, bottom_below_m: 10.0 };
        let lengths: Vec<f64> = water.routes(60.0, 4.0).iter().map(|r| r.0.hypot(300.0)).collect();
        let legs: [f64; 4] = [60.0 - 4.0, 60.0 + 4.0, 66.0 + 10.0, 4.0 + 70.0 + 10.0];
        for (length, leg) in lengths.iter().zip(legs) {
            assert!((length - leg.hypot(300.0)).abs() < 1e-9, "{length} {leg}");
        }
        let gains: Vec<f64> = water.routes(60.0, 4.0).iter().map(|r| r.1).collect();
        assert_eq!(gains, [1.0, -1.0, 0.4, -0.4]);
        assert_eq!(Water::default().routes(60.0, 4.0).len(), 2);
    }
}
