//! Archives through the recorder: every day of every station a unit of work with an output of its own.
//!
//! Enters: stations with their recordings. Leaves: in one folder, for each station and day (UTC) that something was recorded
//! on, `NAME.DAY.jsonl`, its records, and `NAME.DAY.manifest.json`, what they were made of. Each unit is what a recorder
//! started at midnight would have said; so units may be processed in any order, at once or on several machines, with the
//! same bytes. A file appears whole or not at all, and the manifest last: a run that ended anywhere is gone on with by
//! running it again, for what has a manifest that still holds is passed over.

use crate::atomic::{self, Unfinished};
use crate::interrupt;
use crate::levels::Meter;
use crate::record::{self, RecordFormat};
use crate::recording::{Asked, BlockSource, Recording, Span};
use crate::replay::{Said, with_levels};
use crate::station::Station;
use anyhow::{Context, Result, bail};
use seabearing_core::block::Block;
use seabearing_core::wire::Message;
use seabearing_core::wire::hash::fnv1a;
use serde_json::{Value, json};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use time::{Date, OffsetDateTime};

/// A station and its recordings.
pub struct Member {
    station: Station,
    table: Option<Vec<u8>>,
    recording: Recording,
    /// Length of the intervals whose levels are measured, s.
    levels_s: Option<f64>,
}

impl Member {
    /// What was recorded.
    pub fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Looks for a station's recordings.
    ///
    /// # Errors
    /// As [`Recording::find`], or its propagation table cannot be used.
    pub fn find(station: Station, input: &[PathBuf], asked: &Asked, levels_s: Option<f64>) -> Result<Self> {
        let table = crate::ocean_bottom::table::of_station(&station)?;
        let recording = Recording::find(input, &station, asked)?;
        if recording.is_live() {
            bail!("--out keeps whole days of recordings that are there: process a live station without it");
        }
        Ok(Self { station, table, recording, levels_s })
    }

    /// What its files are called by.
    fn name(&self) -> String {
        let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
        self.station.config.name.chars().map(plain).collect()
    }
}

/// A day of a station, or all of it where its recordings do not tell when they were.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// How its files' names begin.
    pub name: String,
    member: usize,
    day: Option<Date>,
    span: Span,
}

/// The units of some stations within a span of time, by name.
///
/// # Errors
/// Two stations of one name.
pub fn units(members: &[Member], within: Span) -> Result<Vec<Unit>> {
    let mut units = Vec::new();
    for (number, member) in members.iter().enumerate() {
        let name = member.name();
        if members[..number].iter().any(|m| m.name() == name) {
            bail!("two stations are called {name}: their files would be, too; name them apart");
        }
        let Some(days) = member.recording.days() else {
            units.push(Unit { name, member: number, day: None, span: within });
            continue;
        };
        for day in days {
            let from = day.midnight().assume_utc();
            let to = from + time::Duration::DAY;
            let span = Span {
                from: Some(within.from.map_or(from, |f| f.max(from))),
                to: Some(within.to.map_or(to, |t| t.min(to))),
            };
            if span.from < span.to {
                units.push(Unit { name: format!("{name}.{day}"), member: number, day: Some(day), span });
            }
        }
    }
    units.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(units)
}

/// What became of a unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// It was processed: so many seconds of recording.
    Done(f64),
    /// It had been before.
    There,
    /// The command was interrupted before its end; nothing is left of it.
    Interrupted,
}

/// Processes a unit into a folder.
///
/// # Errors
/// Nothing usable was recorded, or the folder cannot be written.
pub fn process(unit: &Unit, members: &[Member], folder: &Path) -> Result<Outcome> {
    let Some(member) = members.get(unit.member) else { bail!("{}: no such station", unit.name) };
    let station = &member.station;
    let manifest = folder.join(format!("{}.manifest.json", unit.name));
    let made_of = made_of(unit, member)?;
    if is_done(&manifest, &made_of, folder) {
        return Ok(Outcome::There);
    }
    if interrupt::asked() {
        return Ok(Outcome::Interrupted);
    }
    let mut source = Interruptible(member.recording.source(unit.span)?);
    let format =
        RecordFormat { rate_hz: station.config.rate_hz, start: source.start(), times: Default::default() };
    let name = format!("{}.jsonl", unit.name);
    let records = Unfinished::beside(&folder.join(&name))?;
    let mut processed = 0;
    let summary = {
        let mut out = BufWriter::new(records.as_file());
        let mut meter = member.levels_s.map(|s| Meter::new(station, s, false)).transpose()?;
        let table = member.table.as_deref();
        let summary = with_levels(&station.config, table, &mut source, meter.as_mut(), |said| {
            if let Said::Message(Message::Health(health)) = said {
                processed = health.processed;
            }
            let mut record = format.said(said);
            record::calibrate(&mut record, &station.calibration);
            serde_json::to_writer(&mut out, &record)?;
            Ok(out.write_all(b"\n")?)
        })?;
        out.flush()?;
        summary
    };
    if interrupt::asked() {
        return Ok(Outcome::Interrupted);
    }
    if processed == 0 {
        bail!("no sample could be used of {} recorded", summary.instants);
    }
    let bytes = records.as_file().metadata()?.len();
    records.finish()?;
    let mut told = made_of;
    told["samples"] = json!(summary.instants);
    told["output"] = json!({ "file": name, "bytes": bytes });
    atomic::write(&manifest, format!("{told:#}\n").as_bytes())?;
    Ok(Outcome::Done(summary.instants as f64 / station.config.rate_hz))
}

/// Everything that a unit's output depends on.
fn made_of(unit: &Unit, member: &Member) -> Result<Value> {
    let time = |at: Option<OffsetDateTime>| at.map(record::utc);
    let mut inputs = Vec::new();
    for path in member.recording.files(unit.span) {
        let about = std::fs::metadata(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let modified = about.modified().ok().map(|m| record::utc(m.into()));
        inputs
            .push(json!({ "path": path.display().to_string(), "bytes": about.len(), "modified": modified }));
    }
    let mut made_of = json!({
        "unit": unit.name, "station": member.station.config.name.as_str(), "day": unit.day.map(|d| d.to_string()),
        "from": time(unit.span.from), "to": time(unit.span.to), "software": env!("CARGO_PKG_VERSION"),
        "config_hash": format!("{:016x}", member.station.config.hash()),
        "table_hash": member.table.as_deref().map(|t| format!("{:016x}", fnv1a(t))),
        "inputs": inputs,
    });
    // How samples are made of files, beyond what the recorder itself is told.
    let Station { gains, responses, components, seed_id, file_channels, line, .. } = &member.station;
    let reading = format!(
        "{gains:?} {responses:?} {components:?} {seed_id:?} {file_channels:?} {line:?} {:?}",
        member.recording.name_offset()
    );
    made_of["reading_hash"] = json!(format!("{:016x}", fnv1a(reading.as_bytes())));
    if let Some(seconds) = member.levels_s {
        made_of["levels_s"] = json!(seconds);
    }
    if member.levels_s.is_some() || member.station.config.levels.every_s > 0 {
        let calibration = format!("{:?}", member.station.calibration);
        made_of["calibration_hash"] = json!(format!("{:016x}", fnv1a(calibration.as_bytes())));
    }
    Ok(made_of)
}

/// Whether a manifest says that this was done, and its outputs are there.
fn is_done(manifest: &Path, made_of: &Value, folder: &Path) -> bool {
    let Ok(bytes) = std::fs::read(manifest) else { return false };
    let Ok(Value::Object(mut told)) = serde_json::from_slice::<Value>(&bytes) else { return false };
    let output = told.remove("output").unwrap_or_default();
    told.remove("samples");
    let length =
        output["file"].as_str().and_then(|f| std::fs::metadata(folder.join(f)).ok()).map(|m| m.len());
    Value::Object(told) == *made_of && length.is_some() && length == output["bytes"].as_u64()
}

/// A source that ends when the command is interrupted.
struct Interruptible(Box<dyn BlockSource>);

impl BlockSource for Interruptible {
    fn start(&self) -> Option<OffsetDateTime> {
        self.0.start()
    }

    fn expected_end(&self) -> Option<u64> {
        self.0.expected_end()
    }

    fn left_out(&mut self) -> Result<Option<u64>> {
        self.0.left_out()
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        if interrupt::asked() { Ok(None) } else { self.0.next_block() }
    }
}
