//! What scenario files of both kinds of recorder share: the file with its old spellings, the start, straight courses,
//! gaps and the times of faults.

use crate::ocean_bottom::{self, scenario::ObsScenario, simulate::Simulator};
use crate::propagation;
use crate::station::Station;
use crate::toml_file::TomlFile;
use crate::world::{self, ArrayScenario};
use anyhow::{Context, Result, bail};
use seabearing_core::config;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use std::path::{Path, PathBuf};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;
use toml::de::DeValue;

/// Which simulator a scenario is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScenarioKind {
    /// A compact array.
    Array,
    /// An ocean-bottom station.
    Obs,
}

impl ScenarioKind {
    /// As files spell it.
    pub fn name(self) -> &'static str {
        if self == Self::Array { "array" } else { "obs" }
    }
}

/// A scenario file whose kind is known.
#[derive(Debug)]
pub struct ScenarioFile {
    /// The text.
    pub source: TomlFile,
    /// Its folder, from which the paths in it are taken.
    pub folder: PathBuf,
    /// Its kind.
    pub kind: ScenarioKind,
}

/// The files a simulation wrote.
#[derive(Clone, Debug)]
pub struct Written {
    /// Recordings: in order of time (array), or one a component (ocean bottom).
    pub recordings: Vec<PathBuf>,
    /// Where vessels (and other sounds) truly were.
    pub truth: PathBuf,
    /// Closest points of vessels (ocean bottom).
    pub tracks: Option<PathBuf>,
    /// The station file.
    pub station: PathBuf,
    /// The propagation table (ocean bottom).
    pub table: Option<PathBuf>,
}

impl Written {
    /// Every file, with what it is.
    pub fn files(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        let recordings = self.recordings.iter().map(|p| ("recording", p.as_path()));
        let rest = [
            ("truth", Some(&self.truth)),
            ("tracks", self.tracks.as_ref()),
            ("station", Some(&self.station)),
            ("table", self.table.as_ref()),
        ];
        recordings.chain(rest.into_iter().filter_map(|(kind, path)| Some((kind, path?.as_path()))))
    }
}

/// Simulates a scenario of either kind into a folder.
///
/// # Errors
/// One line: the file, the key and what is allowed, or what cannot be written.
pub fn write(scenario: &Path, folder: &Path) -> Result<Written> {
    match ScenarioFile::read(scenario)?.kind {
        ScenarioKind::Array => world::write(&ArrayScenario::read(scenario)?, folder),
        ScenarioKind::Obs => {
            let scenario = ObsScenario::read(scenario)?;
            let table = propagation::file::read(&scenario.propagation)?;
            let extra = ocean_bottom::ais::extras(&scenario)?;
            ocean_bottom::write::write(&mut Simulator::new(scenario, table, extra)?, folder)
        }
    }
}

/// Keys as they once were, and what stands in their place: key, whether it was a table, words.
const OLD: [(&str, Option<bool>, &str); 3] = [
    (
        "ship",
        None,
        "`[[ship]]` is now `[[vessels]]` with `straight = { cpa_time_s, cpa_range_m, heading_deg, speed_m_s, side }`",
    ),
    ("start", None, "`start` is now `start_utc`"),
    (
        "faults",
        Some(true),
        "`[faults]` is now a list: `[[gaps]]` with `start_s` and `duration_s`, `[[faults]]` with `kind`, `channel`, \
         `from_s` and `to_s`",
    ),
];

impl ScenarioFile {
    /// Reads a file as far as its kind.
    ///
    /// # Errors
    /// One line: it cannot be read, is no TOML, has no `kind`, or has a key that is now spelt otherwise.
    pub fn read(path: &Path) -> Result<Self> {
        let source = TomlFile::read(path, "scenario file")?;
        let kind = {
            let parsed = source.table()?;
            let table = parsed.get_ref();
            for (key, as_table, now) in OLD {
                let value = table.iter().find(|(k, _)| k.get_ref() == key).map(|(_, v)| v.get_ref());
                if value.is_some_and(|v| as_table.is_none_or(|t| t == matches!(v, DeValue::Table(_)))) {
                    return Err(source.wrong(key, now));
                }
            }
            let kind = table.iter().find(|(k, _)| k.get_ref() == "kind").map(|(_, v)| v.get_ref());
            match kind.and_then(DeValue::as_str) {
                Some("array") => ScenarioKind::Array,
                Some("obs") => ScenarioKind::Obs,
                Some(other) => {
                    return Err(source.wrong("kind", format!("kind = \"{other}\"; array or obs")));
                }
                None => bail!("{}: missing key `kind`: array or obs", source.name()),
            }
        };
        Ok(Self { source, folder: path.parent().unwrap_or(Path::new(".")).to_owned(), kind })
    }

    /// Refuses a file of the other kind.
    ///
    /// # Errors
    /// It is of the other kind.
    pub fn expect(&self, kind: ScenarioKind) -> Result<()> {
        if self.kind != kind {
            let what = format!("kind = \"{}\", `{}` was expected", self.kind.name(), kind.name());
            return Err(self.source.wrong("kind", what));
        }
        Ok(())
    }
}

/// The recorder of a scenario: its station file.
#[derive(Clone, Debug)]
pub struct StationFile {
    /// What it says.
    pub station: Station,
    /// The file.
    pub source: TomlFile,
}

impl ScenarioFile {
    /// Reads the station file that the key `station` names (relative to the scenario's folder), of the scenario's kind.
    ///
    /// # Errors
    /// It cannot be used, or is of another kind.
    pub fn station(&self, path: &Path) -> Result<StationFile> {
        let path = self.folder.join(path);
        let source = TomlFile::read(&path, "station file").with_context(|| self.source.at("station"))?;
        let station = Station::of(&source, path.parent().unwrap_or(Path::new(".")))?;
        let suits = match station.config.kind {
            config::Kind::Array(_) => self.kind == ScenarioKind::Array,
            config::Kind::Obs(_) => self.kind == ScenarioKind::Obs,
            config::Kind::Line(_) => false,
        };
        if !suits {
            let what = format!("the scenario is of kind {}, its station is not", self.kind.name());
            return Err(self.source.wrong("station", what));
        }
        // Recorders may sample faster than the chain runs: such a recording is processed at a lower rate.
        if let Some(refused) = station.refused(&source) {
            log::warn!("{refused}; process what is written with a station file that says so");
        }
        Ok(StationFile { station, source })
    }
}

/// Reads a time of RFC 3339, for serde.
///
/// # Errors
/// It is none.
pub fn utc<'de, D: Deserializer<'de>>(text: D) -> Result<OffsetDateTime, D::Error> {
    let text = String::deserialize(text)?;
    OffsetDateTime::parse(&text, &Rfc3339)
        .map_err(|_| D::Error::custom(format!("`{text}` is no time; 2024-05-01T00:00:00Z was expected")))
}

/// What is wrong with a value: the path of its key, and words.
pub type Wrong = (String, String);

/// A value within its limits.
///
/// # Errors
/// It is not, or is no number.
pub fn within(key: &str, x: f64, lo: f64, hi: f64) -> Result<(), Wrong> {
    if (lo..=hi).contains(&x) {
        return Ok(());
    }
    let leaf = key.rsplit('.').next().unwrap_or(key);
    Err((key.to_owned(), format!("`{leaf}` is {x}; allowed {lo} to {hi}")))
}

/// A straight course.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
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
    /// The vessel's side on which the recorder lies.
    pub side: Side,
}

impl Straight {
    /// Checks every value; `path` is that of the table it stands in.
    ///
    /// # Errors
    /// The first value found wrong.
    pub fn check(&self, path: &str, slowest_m_s: f64) -> Result<(), Wrong> {
        within(&format!("{path}.straight.cpa_time_s"), self.cpa_time_s, -1e8, 1e8)?;
        within(&format!("{path}.straight.cpa_range_m"), self.cpa_range_m, 0.0, 1e6)?;
        within(&format!("{path}.straight.heading_deg"), self.heading_deg, -360.0, 360.0)?;
        within(&format!("{path}.straight.speed_m_s"), self.speed_m_s, slowest_m_s, 100.0)
    }
}

/// A side of a vessel.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Left.
    Port,
    /// Right.
    Starboard,
}

/// A time without samples, by the recorder's clock.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gap {
    /// Start, seconds.
    pub start_s: f64,
    /// Length, seconds.
    pub duration_s: f64,
}

/// Gaps in order, within the recording.
///
/// # Errors
/// The first value found wrong.
pub fn check_gaps(gaps: &[Gap], duration_s: f64) -> Result<(), Wrong> {
    let mut end = 0.0;
    for (i, g) in gaps.iter().enumerate() {
        within(&format!("gaps.{i}.start_s"), g.start_s, end, duration_s)?;
        within(&format!("gaps.{i}.duration_s"), g.duration_s, 0.0, duration_s - g.start_s)?;
        end = g.start_s + g.duration_s;
    }
    Ok(())
}

/// Channel and time of a fault.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Affected {
    /// Recorder channel; of an ocean-bottom station 0 pressure, 1 north, 2 east, 3 vertical.
    pub channel: usize,
    /// Start, seconds by the recorder's clock.
    #[serde(default)]
    pub from_s: f64,
    /// End, seconds.
    #[serde(default = "forever")]
    pub to_s: f64,
}

impl Affected {
    /// Whether the channel is affected at a time, seconds by the recorder's clock.
    pub fn at(&self, t_s: f64) -> bool {
        (self.from_s..self.to_s).contains(&t_s)
    }
}

/// The end of what has none, seconds.
pub fn forever() -> f64 {
    f64::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.toml");
        std::fs::write(&path, text).unwrap();
        let e = ScenarioFile::read(&path).unwrap_err().to_string();
        e.rsplit('/').next().unwrap_or(&e).to_owned()
    }

    #[test]
    fn old_spellings_name_the_new_ones_in_one_line() {
        let old = |rest: &str| refused(&format!("kind = \"obs\"\nduration_s = 60.0\n{rest}\n"));
        let ship = old("[[ship]]\ncpa_time_s = 30.0");
        assert!(ship.starts_with("s.toml, line 3, column 3: ") && ship.contains("[[vessels]]"), "{ship}");
        let start = old("start = \"2013-05-21T00:00:00Z\"");
        assert_eq!(start, "s.toml, line 3, column 1: `start` is now `start_utc`");
        let faults = old("[faults]\ndead = [[2, 0.0, 9.0]]");
        assert!(faults.starts_with("s.toml, line 3") && faults.contains("[[faults]]"), "{faults}");
        assert!([ship, start, faults].iter().all(|e| e.lines().count() == 1));
        assert!(refused("kind = \"sonar\"\n").contains("line 1, column 1: kind = \"sonar\"; array or obs"));
    }

    #[test]
    fn gaps_stay_in_order_and_within_the_recording() {
        let gap = |start_s, duration_s| Gap { start_s, duration_s };
        assert!(check_gaps(&[gap(1.0, 2.0), gap(3.0, 7.0)], 10.0).is_ok());
        let (key, what) = check_gaps(&[gap(1.0, 2.0), gap(2.5, 1.0)], 10.0).unwrap_err();
        assert_eq!((key.as_str(), what.as_str()), ("gaps.1.start_s", "`start_s` is 2.5; allowed 3 to 10"));
        assert!(check_gaps(&[gap(9.0, 2.0)], 10.0).is_err());
        assert!(check_gaps(&[gap(f64::NAN, 2.0)], 10.0).is_err());
    }
}
