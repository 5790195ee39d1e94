//! The stations file of a base station: `[[stations]]` with the keys of `[station]`, each with its line.

use super::command;
use super::origin::Origin;
use anyhow::{Result, bail};
use seabearing_core::config::StationConfig;
use seabearing_core::wire::guard::Key;
use seabearing_host::station::{Calibration, ORIENTATION_SD_DEG, Station};
use serde::Deserialize;
use std::path::Path;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// A station and the way to it.
#[derive(Clone, Debug)]
pub struct Listed {
    /// What the keys of `[station]` say.
    pub config: StationConfig,
    /// `line`, if it is given.
    pub line: Option<Origin>,
    /// What `key_file` holds.
    pub key: Option<Key>,
    /// `utc_of_sample_0`.
    pub start: Option<OffsetDateTime>,
    /// `orientation_sd_deg`: standard deviation of its orientation, degrees.
    pub sd_orientation_deg: f64,
    /// `clock_sd_s`: standard deviation of its clock, seconds, where the list says it.
    pub sd_clock_s: Option<f64>,
    /// What levels of its channels are levels of, where it names its station file.
    pub calibration: Option<[Calibration; 4]>,
}

/// The numbers that a file says: one that it leaves out is no station's.
#[derive(Deserialize)]
struct Numbers {
    stations: Vec<Number>,
}

#[derive(Deserialize)]
struct Number {
    id: Option<u16>,
}

/// Reads a stations file; files that it names stand beside it.
///
/// # Errors
/// One line: file, line, key, and what is allowed.
pub fn read(path: &Path) -> Result<Vec<Listed>> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let (source, listed) = Station::read_listed(path)?;
    let said = source.parse::<Numbers>()?.stations;
    let said: Vec<bool> = said.iter().map(|station| station.id.is_some()).collect();
    let mut out: Vec<Listed> = Vec::new();
    for (n, station) in listed.into_iter().enumerate() {
        let at = |key: &str| format!("stations.{n}.{key}");
        let id = station.config.id;
        if !said.get(n).copied().unwrap_or(false) {
            return Err(source.wrong(
                &format!("stations.{n}"),
                "it has no `id`: the number that the recorder sends of itself",
            ));
        }
        if out.iter().any(|other| other.config.id == id) {
            return Err(source.wrong(&at("id"), format!("two stations have the number {id}")));
        }
        let line = station.line.as_deref().map(Origin::parse).transpose();
        let line = match line.map_err(|e| source.wrong(&at("line"), e))? {
            Some(Origin::File { path, follow }) => Some(Origin::File { path: folder.join(path), follow }),
            line => line,
        };
        let key = station.key_file.map(|file| command::key(&folder.join(file))).transpose();
        let key = key.map_err(|e| source.wrong(&at("key_file"), format!("{e:#}")))?;
        let start = station.utc_of_sample_0.map(|text| {
            OffsetDateTime::parse(&text, &Rfc3339).map_err(|_| {
                source.wrong(&at("utc_of_sample_0"), format!("`{text}` is no time like 2024-05-01T09:00:00Z"))
            })
        });
        out.push(Listed {
            sd_orientation_deg: station.orientation_sd_deg.unwrap_or(ORIENTATION_SD_DEG),
            sd_clock_s: station.clock_sd_s,
            config: station.config,
            line,
            key,
            start: start.transpose()?,
            calibration: station.calibration,
        });
    }
    Ok(out)
}

/// The station of a number.
///
/// # Errors
/// It is not in the list.
pub fn find(listed: &[Listed], id: u16, path: &Path) -> Result<Listed> {
    if let Some(station) = listed.iter().find(|s| s.config.id == id) {
        return Ok(station.clone());
    }
    let known: Vec<String> = listed.iter().map(|s| s.config.id.to_string()).collect();
    bail!("{}: no station {id}; stations there: {}", path.display(), known.join(", "))
}
