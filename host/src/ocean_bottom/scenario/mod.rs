//! What is to be simulated for an ocean-bottom station: the scenario file (`kind = "obs"`).
//!
//! ```toml
//! kind = "obs"
//! seed = 1
//! duration_s = 21600.0
//! start_utc = "2013-05-21T00:00:00Z"
//! station = "station.toml"            # relative to this file; it names the propagation table
//! [ambient]
//! pressure_counts = 1000.0
//! [[vessels]]
//! straight = { cpa_time_s = 10800.0, cpa_range_m = 9000.0, heading_deg = 60.0, speed_m_s = 7.0, side = "port" }
//! [[gaps]]
//! start_s = 3600.0
//! duration_s = 30.0
//! [[faults]]
//! kind = "dead"                       # dead, saturated, missing (all along), clock_step with at_s, by_s,
//!                                     # spikes with every_s, counts, or clipped with counts
//! channel = 2
//! from_s = 7200.0
//! to_s = 7260.0
//! ```
//! Without `station` the recorder is stated here: `propagation`, `rate_hz`, `name`, `lat_lon_deg`,
//! `orientation_of_north_deg` and `intensity`.
//!
//! Levels: `wideband_db` is the power of a vessel's wideband noise over all paths against the ambient noise, both in
//! 5 to 25 Hz, with the vessel 20 km away. `tone_db` is the height of each line above the ambient noise in one bin of a
//! 1024-point Hann spectrum (0.073 Hz of noise bandwidth), again at 20 km.

mod ambient;
mod faults;

pub use crate::scenario::{Affected, Gap, Side, Straight};
use crate::scenario::{ScenarioFile, ScenarioKind, StationFile, Wrong, check_gaps, utc, within};
pub use ambient::{AmbientTable, DirectionalTable, ShakingTable};
use anyhow::{Result, anyhow, bail};
pub use faults::{Channel, Clip, ClockStep, ObsFault, Spikes};
use seabearing_core::config;
use serde::Deserialize;
use std::path::PathBuf;
use time::OffsetDateTime;

/// A scenario as a person writes it.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObsScenario {
    /// Always `obs`.
    #[cfg_attr(feature = "schema", schemars(extend("const" = "obs")))]
    pub kind: String,
    /// Seed of everything random.
    #[serde(default = "one")]
    pub seed: u64,
    /// Length, s.
    pub duration_s: f64,
    /// UTC of the first sample.
    #[serde(rename = "start_utc", default = "default_start", deserialize_with = "utc")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub start: OffsetDateTime,
    /// The recorder's station file, from which the fields from `rate_hz` to `intensity` then come.
    pub station: Option<PathBuf>,
    /// That file.
    #[serde(skip)]
    pub station_file: Option<StationFile>,
    /// Samples a second; vessels and calls need 50.
    #[serde(default = "default_rate")]
    pub rate_hz: f64,
    /// The propagation table.
    #[serde(default)]
    pub propagation: PathBuf,
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
    /// Paths that carry sound, counted from the direct one (5: up to nine crossings).
    #[serde(default = "default_paths")]
    pub paths: usize,
    /// Noise of the sea and the instrument.
    #[serde(default)]
    pub ambient: AmbientTable,
    /// Vessels on straight courses.
    #[serde(default)]
    pub vessels: Vec<ObsVessel>,
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
    /// Times without samples.
    #[serde(default)]
    pub gaps: Vec<Gap>,
    /// What goes wrong in the recorder.
    #[serde(default)]
    pub faults: Vec<ObsFault>,
}

/// What a vessel radiates.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
    /// Firing rate of the engine's cylinders, Hz, whose harmonics are lines as well (0: none).
    pub engine_hz: f64,
    /// By how much a comb's harmonics fall with frequency, dB an octave; `tone_db` is that of the first.
    pub comb_fall_db: f64,
    /// Frequency of the wideband noise's greatest density, Hz.
    pub centre_hz: f64,
    /// From there to half its amplitude (−6 dB), Hz.
    pub half_width_hz: f64,
    /// Depth to which cavitation modulates the wideband noise's amplitude at the blade rate, 0 to 1.
    pub modulation: f64,
    /// Relative wander of all lines (one standard deviation).
    pub wander: f64,
}

/// A vessel on a straight course.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObsVessel {
    /// Name in the truth.
    #[serde(default)]
    pub name: String,
    /// Its course.
    pub straight: Straight,
    /// When it sounds, s.
    #[serde(default = "always")]
    pub active_s: [f64; 2],
    /// What it radiates.
    #[serde(default)]
    pub radiation: Radiation,
}

/// Vessels of an AIS file that pass the station.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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

/// What a station file states, and no scenario that names one.
const OF_THE_STATION: [&str; 6] =
    ["propagation", "rate_hz", "name", "lat_lon_deg", "orientation_of_north_deg", "intensity"];

fn one() -> u64 {
    1
}
/// The first day of the recordings of \[O\].
pub fn default_start() -> OffsetDateTime {
    time::macros::datetime!(2013-05-21 00:00 UTC)
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

impl Default for Radiation {
    /// Six lines between 11 and 24 Hz and no harmonics: the test vessel of the project's own figures.
    fn default() -> Self {
        Self {
            wideband_db: 0.0,
            tone_db: 20.0,
            tones_hz: vec![12.1, 14.3, 16.9, 18.2, 20.6, 22.7],
            blade_hz: 0.0,
            engine_hz: 0.0,
            comb_fall_db: 0.0,
            centre_hz: 15.0,
            half_width_hz: 10.0,
            modulation: 0.0,
            wander: 1e-4,
        }
    }
}

impl ObsScenario {
    /// Reads and checks a scenario; relative paths become relative to the file's folder.
    ///
    /// # Errors
    /// One line: file, line, key.
    pub fn read(path: &std::path::Path) -> Result<Self> {
        let file = ScenarioFile::read(path)?;
        file.expect(ScenarioKind::Obs)?;
        let mut s: Self = file.source.parse()?;
        match &s.station {
            Some(path) => {
                if let Some(key) = OF_THE_STATION.into_iter().find(|key| file.source.has(key)) {
                    return Err(file.source.wrong(key, format!("`{key}` stands in the station file")));
                }
                let read = file.station(path)?;
                s.take(read).map_err(|what| file.source.wrong("station", what))?;
            }
            None if s.propagation.as_os_str().is_empty() => {
                bail!(
                    "{}: missing key `station` (or `propagation`, without a station file)",
                    file.source.name()
                )
            }
            None => s.propagation = file.folder.join(&s.propagation),
        }
        for a in &mut s.ais {
            a.file = file.folder.join(&a.file);
        }
        s.wrong().map_err(|(key, what)| file.source.wrong(&key, what))?;
        Ok(s)
    }

    /// Takes the recorder from its station file.
    fn take(&mut self, file: StationFile) -> Result<(), String> {
        let config = &file.station.config;
        let Some(table) = &file.station.propagation else {
            return Err("the station file names no propagation table (key `propagation`)".to_owned());
        };
        self.propagation.clone_from(table);
        self.rate_hz = config.rate_hz;
        self.lat_lon_deg = config.lat_lon_deg.map(|(lat, lon)| [lat, lon]);
        // miniSEED names a station by five letters or digits.
        let name: String = config.name.chars().filter(char::is_ascii_alphanumeric).take(5).collect();
        self.name = if name.is_empty() { "OBS".to_owned() } else { name.to_uppercase() };
        if let config::Kind::Obs(o) = &config.kind {
            self.orientation_of_north_deg = o.orientation_of_north_deg;
            self.intensity = if o.intensity_towards { "towards" } else { "away" }.to_owned();
        }
        self.station_file = Some(file);
        Ok(())
    }

    /// Channel codes of the components, in the order of a frame.
    pub fn codes(&self) -> [String; 4] {
        let c = self.station_file.as_ref().map(|f| f.station.components.clone()).unwrap_or_default();
        [c.pressure, c.north, c.east, c.vertical]
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first key found wrong.
    pub fn check(&self) -> Result<()> {
        self.wrong().map_err(|(key, what)| anyhow!("{key}: {what}"))
    }

    fn wrong(&self) -> Result<(), Wrong> {
        let wrong = |key: &str, what: String| Err((key.to_owned(), what));
        within("rate_hz", self.rate_hz, 50.0, 50.0)?;
        within("duration_s", self.duration_s, 1.0, 3.2e7)?;
        within("paths", self.paths as f64, 1.0, 7.0)?;
        self.ambient.wrong()?;
        for (i, v) in self.vessels.iter().enumerate() {
            v.straight.check(&format!("vessels.{i}"), 0.1)?;
            let [from_s, to_s] = v.active_s;
            if !(from_s < to_s) {
                let what = format!(
                    "active_s is [{from_s}, {to_s}]; when it begins to sound and, later, when it ends"
                );
                return wrong(&format!("vessels.{i}.active_s"), what);
            }
        }
        for (list, whales) in [("fin_whale", &self.fin_whale), ("blue_whale", &self.blue_whale)] {
            for (i, w) in whales.iter().enumerate() {
                within(&format!("{list}.{i}.interval_s"), w.interval_s, 1.0, 1e4)?;
            }
        }
        if !["away", "towards"].contains(&self.intensity.as_str()) {
            return wrong("intensity", format!("intensity is `{}`; away or towards", self.intensity));
        }
        if self.name.is_empty()
            || self.name.len() > 5
            || !self.name.chars().all(|c| c.is_ascii_alphanumeric())
        {
            return wrong("name", format!("name is `{}`; one to five letters or digits", self.name));
        }
        check_gaps(&self.gaps, self.duration_s)?;
        let own = self.vessels.iter().enumerate().map(|(i, v)| (format!("vessels.{i}"), &v.radiation));
        let ais = self.ais.iter().enumerate().map(|(i, a)| (format!("ais.{i}"), &a.radiation));
        for (of, r) in own.chain(ais) {
            for (key, x, lo, hi) in [
                ("blade_hz", r.blade_hz, 0.0, 25.0),
                ("engine_hz", r.engine_hz, 0.0, 25.0),
                ("comb_fall_db", r.comb_fall_db, -60.0, 60.0),
                ("centre_hz", r.centre_hz, 0.0, 25.0),
                ("half_width_hz", r.half_width_hz, 0.5, 100.0),
                ("modulation", r.modulation, 0.0, 1.0),
            ] {
                within(&format!("{of}.radiation.{key}"), x, lo, hi)?;
            }
            if r.modulation > 0.0 && r.blade_hz == 0.0 {
                return wrong(
                    &format!("{of}.radiation.modulation"),
                    "`modulation` needs `blade_hz`, the rate it goes on at".to_owned(),
                );
            }
        }
        faults::wrong(&self.faults)?;
        if !self.ais.is_empty() && self.lat_lon_deg.is_none() {
            return wrong("lat_lon_deg", "`lat_lon_deg` is needed to place AIS vessels".to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "kind = \"obs\"\nduration_s = 600.0\nstart_utc = \"2024-01-31T12:00:00Z\"\n\
        propagation = \"t.toml\"\n\n[[vessels]]\nstraight = { cpa_time_s = 300.0, cpa_range_m = 9000.0, \
        heading_deg = 60.0, speed_m_s = 7.0, side = \"port\" }\n\n[[gaps]]\nstart_s = 10.0\nduration_s = 5.0\n\n\
        [[faults]]\nkind = \"dead\"\nchannel = 2\nfrom_s = 60.0\nto_s = 90.0\n\n\
        [[faults]]\nkind = \"clock_step\"\nat_s = 400.0\nby_s = 12.0\n";

    fn read(text: &str) -> Result<ObsScenario> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("s.toml");
        std::fs::write(&path, text)?;
        ObsScenario::read(&path)
    }

    #[test]
    fn reads_what_both_kinds_of_scenario_share() {
        let s = read(GOOD).unwrap();
        assert_eq!(s.start, time::macros::datetime!(2024-01-31 12:00 UTC));
        assert_eq!(s.vessels[0].straight.side, Side::Port);
        assert_eq!(s.gaps, [Gap { start_s: 10.0, duration_s: 5.0 }]);
        assert_eq!(s.faults[0], ObsFault::Dead(Affected { channel: 2, from_s: 60.0, to_s: 90.0 }));
        assert_eq!(s.faults[1], ObsFault::ClockStep(ClockStep { at_s: 400.0, by_s: 12.0 }));
    }

    #[test]
    fn a_station_file_is_referred_to_as_an_array_s_is() {
        let dir = tempfile::tempdir().unwrap();
        let station = "[station]\nid = 7\nname = \"deep-one\"\nkind = \"obs\"\nposition = { lat_deg = 1.0, lon_deg = 2.0 \
                       }\n[sampling]\nrate_hz = 50\n[obs]\ncomponents = { pressure = \"EDH\", north = \"EH1\", east = \
                       \"EH2\", vertical = \"EHZ\" }\norientation_of_north_deg = 30.0\nintensity = \"towards\"\n\
                       propagation = \"t.toml\"\n";
        std::fs::write(dir.path().join("station.toml"), station).unwrap();
        let read = |text: &str| {
            let path = dir.path().join("s.toml");
            std::fs::write(&path, text).unwrap();
            ObsScenario::read(&path)
        };
        let text = GOOD.replace("propagation = \"t.toml\"", "station = \"station.toml\"");
        let s = read(&text).unwrap();
        assert_eq!((s.name.as_str(), s.rate_hz, s.orientation_of_north_deg), ("DEEPO", 50.0, 30.0));
        assert_eq!((s.intensity.as_str(), s.lat_lon_deg), ("towards", Some([1.0, 2.0])));
        assert_eq!((s.propagation.clone(), s.codes()[0].as_str()), (dir.path().join("t.toml"), "EDH"));
        let written = crate::ocean_bottom::station::text(&s, "table.toml");
        assert_eq!(written, station.replace("t.toml", "table.toml"));
        let e = read(&format!("rate_hz = 50.0\n{text}")).unwrap_err().to_string();
        assert!(e.contains("line 1, ") && e.contains("`rate_hz` stands in the station file"), "{e}");
        let e = read(&text.replace("station = \"station.toml\"\n", "")).unwrap_err().to_string();
        assert!(e.contains("missing key `station`"), "{e}");
        std::fs::write(dir.path().join("station.toml"), station.replace("propagation", "# ")).unwrap();
        let e = read(&text).unwrap_err().to_string();
        assert!(e.contains("line 4, ") && e.contains("names no propagation table"), "{e}");
    }

    #[test]
    fn what_is_wrong_is_named_with_line_and_key() {
        let refused = |from: &str, to: &str| read(&GOOD.replace(from, to)).unwrap_err().to_string();
        let e = refused("speed_m_s = 7.0", "speed_m_s = 700.0");
        assert!(e.contains("line 7, ") && e.contains("`speed_m_s` is 700"), "{e}");
        let e = refused("channel = 2", "channel = 4");
        assert!(e.contains("line 15, ") && e.contains("`channel` is 4"), "{e}");
        let e = refused("2024-01-31T12:00:00Z", "yesterday");
        assert!(e.contains("line 3, ") && e.contains("yesterday"), "{e}");
        let e = refused("at_s = 400.0", "at = 400.0");
        assert!(e.contains("line 1") && e.contains("`at"), "{e}");
    }
}
