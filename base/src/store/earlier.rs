//! Stores of the version before: `raw.bin` with the bytes, `records.jsonl` with the records, `about.json` with what a
//! person said. They are read as they are; a base station that goes on with one takes its bytes over and leaves the files.

use super::super::record::micros;
use super::super::{Base, Beginning};
use super::read::Wanted;
use super::write::begin;
use super::{Entry, Event, Store};
use anyhow::{Context, Result, ensure};
use rusqlite::params;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// The bytes, which is also the name of the line they came over.
const BYTES: &str = "raw.bin";
/// The records.
const RECORDS: &str = "records.jsonl";
/// What was said.
const ABOUT: &str = "about.json";

/// Whether a folder holds such a store, and none of this version.
pub(super) fn is_one(folder: &Path) -> bool {
    folder.join(RECORDS).exists() && !folder.join(super::schema::FILE).exists()
}

/// Facts about a recorder.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct About {
    /// Sample rate until the recorder tells it, Hz.
    pub(super) rate_hz: Option<f64>,
    /// UTC of sample 0, by session.
    pub(super) starts: BTreeMap<u32, OffsetDateTime>,
    /// Latitude and longitude, degrees.
    pub(super) place: Option<(f64, f64)>,
}

impl About {
    /// What a store says; nothing where it has no such file.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(ABOUT);
        let name = || path.display().to_string();
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(e) => return Err(e).with_context(name),
        };
        let said: Value = serde_json::from_str(&text).with_context(name)?;
        let starts = said["utc_of_sample_0"].as_object().into_iter().flatten();
        let start = |(session, utc): (&String, &Value)| -> Result<(u32, OffsetDateTime)> {
            Ok((session.parse()?, OffsetDateTime::parse(utc.as_str().unwrap_or_default(), &Rfc3339)?))
        };
        Ok(Self {
            rate_hz: said["rate_hz"].as_f64(),
            starts: starts.map(start).collect::<Result<_>>().with_context(name)?,
            place: said["lat_deg"].as_f64().zip(said["lon_deg"].as_f64()),
        })
    }
}

/// Takes the bytes of such a store into an empty one, all or none.
pub(super) fn take_over(store: &mut Store, folder: &Path) -> Result<()> {
    let path = folder.join(BYTES);
    if !path.exists() || store.number("SELECT EXISTS(SELECT 1 FROM streams)")? > 0 {
        return Ok(());
    }
    let about = About::read(folder)?;
    let mut file = File::open(&path).with_context(|| path.display().to_string())?;
    let transaction = store.db.transaction()?;
    let beginning = Beginning { line: BYTES.into(), ..Beginning::default() };
    begin(&transaction, 1, &beginning)?;
    {
        let mut insert = transaction.prepare("INSERT INTO bytes(stream, event, data) VALUES(1, ?1, ?2)")?;
        insert.execute(params![1, None::<&[u8]>])?;
        let mut buffer = vec![0; 1 << 14];
        loop {
            let n = file.read(&mut buffer).with_context(|| path.display().to_string())?;
            if n == 0 {
                break;
            }
            insert.execute(params![0, Some(&buffer[..n])])?;
        }
        insert.execute(params![3, None::<&[u8]>])?;
    }
    let (lat, lon) = about.place.unzip();
    let of = super::schema::NOBODY;
    transaction
        .execute("INSERT INTO stations VALUES(?1, ?2, ?3, ?4)", params![of, lat, lon, about.rate_hz])?;
    transaction.commit()?;
    Ok(())
}

/// Once all that was taken over is decoded: when its sessions began, as a person said it then.
pub(super) fn date(store: &Store, entry: &Entry, base: &mut Base) -> Result<()> {
    if entry.stream != 1 || !matches!(entry.event, Event::Ended(_)) {
        return Ok(());
    }
    let line: String = store.db.query_row("SELECT line FROM streams WHERE stream = 1", [], |r| r.get(0))?;
    if line == BYTES {
        for (session, at) in About::read(&store.folder)?.starts {
            base.date_earlier(session, micros(at));
        }
    }
    Ok(())
}

/// Hands out the records, oldest first, as they stand there.
pub(super) fn read(folder: &Path, wanted: &Wanted, mut take: impl FnMut(Value)) -> Result<u64> {
    let mut undated = 0;
    lines(folder, |record| {
        let is = |key: &str, wanted: Option<u32>| wanted.is_none_or(|w| record[key] == w);
        let (session, track) = wanted.track.unzip();
        let of_track = wanted.track.is_none() || record["type"] == "track";
        if !(is("station", wanted.station.map(Into::into)) && of_track && is("session", session)) {
            return;
        }
        if !is("id", track.map(Into::into)) {
            return;
        }
        if wanted.from.or(wanted.to).is_some() {
            let utc = record["utc"].as_str().and_then(|t| OffsetDateTime::parse(t, &Rfc3339).ok());
            let Some(utc) = utc else {
                undated += 1;
                return;
            };
            if wanted.from.is_some_and(|from| utc < from) || wanted.to.is_some_and(|to| utc >= to) {
                return;
            }
        }
        take(record);
    })?;
    Ok(undated)
}

/// The stations that have records.
pub(super) fn stations(folder: &Path) -> Result<BTreeSet<u16>> {
    let mut found = BTreeSet::new();
    lines(folder, |record| {
        found.extend(record["station"].as_u64().and_then(|s| u16::try_from(s).ok()));
    })?;
    Ok(found)
}

fn lines(folder: &Path, mut take: impl FnMut(Value)) -> Result<()> {
    let path = folder.join(RECORDS);
    let unreadable = || format!("{}: cannot read the store of a base station", path.display());
    let mut reader = BufReader::new(File::open(&path).with_context(unreadable)?);
    let mut line = Vec::new();
    let mut number = 0;
    loop {
        line.clear();
        number += 1;
        // A last line without its end was not finished.
        if reader.read_until(b'\n', &mut line).with_context(unreadable)? == 0 || !line.ends_with(b"\n") {
            return Ok(());
        }
        let record: Value =
            serde_json::from_slice(&line).with_context(|| format!("{}, line {number}", path.display()))?;
        ensure!(record.is_object(), "{}, line {number}: no record", path.display());
        take(record);
    }
}
