//! Records into files that other programs open.
//!
//! In: records as `process` and `base` print them. Out: JSON Lines, CSV or Parquet with every record (`table`); GeoJSON
//! (RFC 7946) or KML (OGC 2.3) with the tracks on a map (`map`); Raven, Audacity, PAMpal or QuakeML with what happened when
//! (`events`). A track's record gets latitude and longitude wherever
//! its station's position is known and its range observable. Files appear whole or not at all.

mod events;
mod map;
#[cfg(feature = "parquet")]
mod parquet;
mod table;

use crate::atomic;
use anyhow::{Result, bail};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// What a file is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One record a line.
    JsonLines,
    /// One record a row; a column for each key that occurs.
    Csv,
    /// The tracks, their 95 % ellipses, the stations.
    GeoJson,
    /// The same, with times that animate.
    Kml,
    /// One record a row, typed columns.
    Parquet,
    /// A selection table of Raven.
    Raven,
    /// Labels of Audacity.
    Audacity,
    /// Events by which PAMpal groups PAMGuard's detections.
    PamGuard,
    /// Picks of calls and T phases.
    QuakeMl,
}

impl Format {
    /// The format a file's name asks for.
    ///
    /// # Errors
    /// The ending is none that is known.
    pub fn of(path: &Path) -> Result<Self> {
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or("").to_ascii_lowercase();
        if name.ends_with("selections.txt") {
            return Ok(Self::Raven);
        }
        if name.ends_with("labels.txt") {
            return Ok(Self::Audacity);
        }
        let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        Ok(match ending.as_str() {
            "jsonl" => Self::JsonLines,
            "csv" => Self::Csv,
            "geojson" | "json" => Self::GeoJson,
            "kml" => Self::Kml,
            "parquet" => Self::Parquet,
            "quakeml" | "xml" => Self::QuakeMl,
            _ => bail!(
                "{}: the name of an export must end in .csv, .geojson, .jsonl, .kml, .parquet, .quakeml, \
                 selections.txt (Raven) or labels.txt (Audacity)",
                path.display()
            ),
        })
    }

    /// Whether this is a map, which needs positions.
    fn is_map(self) -> bool {
        matches!(self, Self::GeoJson | Self::Kml)
    }
}

/// Where stations are: latitude and longitude, degrees.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Positions {
    /// By the station's number.
    pub of_station: BTreeMap<u64, (f64, f64)>,
    /// Of any other, and of records that do not tell their station.
    pub otherwise: Option<(f64, f64)>,
    /// What seismologists call the station: `NET.STA`, with `.LOC` and `.CHAN` where known.
    pub seed_id: Option<String>,
}

impl Positions {
    /// Of a record's station.
    fn of(&self, record: &Value) -> Option<(f64, f64)> {
        let station = record["station"].as_u64();
        station.and_then(|s| self.of_station.get(&s)).copied().or(self.otherwise)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.of_station.is_empty() && self.otherwise.is_none()
    }
}

/// Whether [`write()`] can write this file; `option` is what gives positions on the command line.
///
/// # Errors
/// A map lacks the station's position, or the format is not built in.
pub fn check(path: &Path, format: Format, places: &Positions, option: &str) -> Result<()> {
    if format.is_map() && places.is_empty() {
        bail!(
            "{}: a map needs the station's position: give {option} with `lat_deg` and `lon_deg`",
            path.display()
        );
    }
    if format == Format::QuakeMl && places.seed_id.is_none() {
        bail!("{}: picks are of a station: give --seed-id NET.STA.LOC", path.display());
    }
    if format == Format::Parquet && cfg!(not(feature = "parquet")) {
        bail!("{}: this build has no Parquet (feature `parquet`); use .csv", path.display());
    }
    Ok(())
}

/// Writes records into a file, atomically.
///
/// # Errors
/// As [`check`], or the file cannot be written.
pub fn write(path: &Path, format: Format, records: &[Value], places: &Positions) -> Result<()> {
    check(path, format, places, "a station file")?;
    if format == Format::GeoJson {
        return atomic::write(path, format!("{:#}\n", map::geojson(records, places)).as_bytes());
    }
    if format == Format::Kml {
        return atomic::write(path, map::kml(records, places)?.as_bytes());
    }
    type ToEvents = fn(&[events::Event], &mut dyn Write) -> Result<()>;
    let to_events: Option<ToEvents> = match format {
        Format::Raven => Some(|e, mut out| events::raven(e, &mut out)),
        Format::Audacity => Some(|e, mut out| events::audacity(e, &mut out)),
        Format::PamGuard => Some(|e, mut out| events::pamguard(e, &mut out)),
        _ => None,
    };
    if let Some(to_events) = to_events {
        return atomic::write_with(path, |out| to_events(&events::events(records), out));
    }
    if let (Format::QuakeMl, Some(seed_id)) = (format, &places.seed_id) {
        return atomic::write_with(path, |out| events::quakeml(&events::events(records), seed_id, out));
    }
    atomic::write_with(path, |out| table_to(out, format, records, places))
}

/// Writes every record as CSV or Parquet, else as JSON Lines.
///
/// # Errors
/// It cannot be written.
pub fn table_to(
    out: &mut (impl Write + Send),
    format: Format,
    records: &[Value],
    places: &Positions,
) -> Result<()> {
    let records: Vec<Value> = records.iter().map(|r| placed(r, places)).collect();
    match format {
        Format::Csv => table::csv(&records, out),
        #[cfg(feature = "parquet")]
        Format::Parquet => parquet::write(&records, out),
        _ => records.iter().try_for_each(|r| Ok(writeln!(out, "{r}")?)),
    }
}

/// How many of these records [`write()`] puts into a file: a map takes those that tell a place, of stations whose position is known.
pub fn written(format: Format, records: &[Value], places: &Positions) -> usize {
    match format {
        Format::GeoJson | Format::Kml => map::written(records, places),
        Format::Raven | Format::Audacity | Format::PamGuard => events::events(records).len(),
        Format::QuakeMl => events::picks(&events::events(records)).count(),
        Format::Csv | Format::Parquet | Format::JsonLines => records.len(),
    }
}

/// What a format takes, in words.
pub fn takes(format: Format) -> &'static str {
    match format {
        Format::GeoJson | Format::Kml => {
            "reports of tracks that have a place, of stations whose position is known"
        }
        Format::Raven | Format::Audacity | Format::PamGuard => "events",
        Format::QuakeMl => "calls and T phases, which an ocean-bottom station hears",
        Format::Csv | Format::Parquet | Format::JsonLines => "all",
    }
}

/// The vessel's place in a track's record, metres East and North of the station; `None` where its range is not observable.
fn east_north(record: &Value) -> Option<(f64, f64)> {
    let is_placed = record["type"] == "track" && record["range_observable"] == true;
    is_placed.then_some(())?;
    Some((record["x_m"].as_f64()?, record["y_m"].as_f64()?))
}

/// Degrees to seven places: a centimetre.
fn degrees(x: f64) -> f64 {
    (x * 1e7).round() / 1e7
}

/// A record with the vessel's latitude and longitude where they are known.
fn placed(record: &Value, places: &Positions) -> Value {
    let mut record = record.clone();
    if let (Some(place), Some(station)) = (east_north(&record), places.of(&record)) {
        let (lat, lon) = map::lat_lon(station, place);
        record["lat_deg"] = json!(degrees(lat));
        record["lon_deg"] = json!(degrees(lon));
    }
    record
}

#[cfg(test)]
mod tests;
