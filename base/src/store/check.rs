//! Is a store sound?

use super::super::Base;
use super::super::record::rfc3339;
use super::super::relay::RelayCounters;
use super::damaged;
use super::look::Look;
use super::read::{COLUMNS, entries, resume, row};
use super::schema::{open_file_to_read, open_to_read, station};
use super::state::Replay;
use anyhow::{Context, Result};
use rusqlite::Connection;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// What was found.
#[derive(Clone, Debug)]
pub struct Soundness {
    /// What is in it, as a record.
    pub contents: Value,
    /// What is wrong; nothing if it is sound.
    pub faults: Vec<String>,
}

/// Looks through a whole store: whether its databases are whole, and whether its records are those that its bytes give. A
/// base station may be writing into it.
///
/// # Errors
/// There is no store, or it is damaged so much that it cannot be opened.
pub fn check(folder: &Path) -> Result<Soundness> {
    let unreadable = || format!("{}: cannot read the store of a base station", folder.display());
    let found = open_to_read(folder).and_then(|(mut db, _)| {
        // One look at it, whatever is written meanwhile.
        let live = db.transaction()?;
        let look = Look::at(&live, folder)?;
        let mut faults = whole(&live)?;
        // A month's file that cannot be opened is a fault like another.
        let files = look.bytes().and_then(|bytes| Ok((bytes, look.records(None)?)));
        let (bytes, records) = match files {
            Ok(files) => files,
            Err(e) => {
                faults.push(format!("{e:#}").replace('\n', " "));
                Default::default()
            }
        };
        for file in bytes.iter().chain(&records) {
            let name = file.path().and_then(|p| Path::new(p).file_name()?.to_str()).unwrap_or_default();
            faults.extend(whole(file)?.into_iter().map(|fault| format!("{name}: {fault}")));
        }
        let all = |files: &mut Vec<Connection>| {
            files.drain(..).map(Part::File).chain([Part::Live(&live)]).collect()
        };
        let (mut bytes, mut records) = (bytes, records);
        let (bytes, records): (Vec<Part<'_>>, Vec<Part<'_>>) = (all(&mut bytes), all(&mut records));
        let mut relayed = RelayCounters::default();
        if faults.is_empty() {
            faults.extend(as_the_bytes_say(&live, &look, &bytes, &records, &mut relayed)?);
        }
        let mut contents = contents(&live, &look, &bytes, &records)?;
        if relayed.logs > 0 {
            let RelayCounters { taken, again, missing, logs, refused } = relayed;
            contents["relayed"] =
                json!({ "records": taken, "again": again, "missing": missing, "base_stations": logs, "refused": refused });
        }
        Ok(Soundness { contents, faults })
    });
    found.map_err(|e| damaged(e, folder)).with_context(unreadable)
}

/// A database with some of a store.
enum Part<'a> {
    File(Connection),
    Live(&'a Connection),
}

impl Part<'_> {
    fn db(&self) -> &Connection {
        match self {
            Self::File(db) => db,
            Self::Live(db) => db,
        }
    }
}

/// What a database says of itself.
fn whole(db: &Connection) -> Result<Vec<String>> {
    let mut rows = db.prepare("PRAGMA integrity_check(5)")?;
    let said = rows.query_map([], |r| r.get::<_, String>(0))?;
    let said = said.collect::<rusqlite::Result<Vec<_>>>().unwrap_or_else(|e| vec![e.to_string()]);
    Ok(said.into_iter().filter(|line| line != "ok").map(|line| line.replace('\n', " ")).collect())
}

/// Decodes all bytes again and compares; `relayed` becomes what has come of other base stations.
fn as_the_bytes_say(
    live: &Connection,
    look: &Look,
    bytes: &[Part<'_>],
    records: &[Part<'_>],
    relayed: &mut RelayCounters,
) -> Result<Option<String>> {
    let (decoded, first_record): (i64, i64) = live
        .query_row("SELECT decoded, first_record FROM about", [], |r| Ok((r.get(0)?, r.get(1)?)))
        .or_else(|_| live.query_row("SELECT decoded, 1 FROM about", [], |r| Ok((r.get(0)?, r.get(1)?))))?;
    let Some(start) = look.start() else {
        // The rule of retention has taken the beginnings of what is there.
        return Ok(None);
    };
    let known = start.state.as_deref().map(open_file_to_read).transpose()?;
    let mut base = Base::new(None);
    if let Some(known) = &known {
        resume(known, &mut base)?;
    }
    let mut replay = Replay::new(known.as_ref());
    let query = format!("SELECT {COLUMNS} FROM records WHERE id > ?1 ORDER BY id");
    let mut kept = records.iter().map(|p| Ok(p.db().prepare(&query)?)).collect::<Result<Vec<_>>>()?;
    let kept = kept.iter_mut().map(|p| Ok(p.query_map([start.records], row)?)).collect::<Result<Vec<_>>>()?;
    let mut kept = kept.into_iter().flatten();
    let mut n = start.records;
    for part in bytes {
        let mut from = 0;
        loop {
            let found = entries(part.db(), live, from, 1000)?;
            let Some((last, _)) = found.last() else { break };
            from = last + 1;
            let mut rows = Vec::new();
            for (id, entry) in found.iter().filter(|(id, _)| *id <= decoded) {
                replay.tell(*id, entry, &mut base, &mut rows)?;
            }
            for made in rows {
                n += 1;
                if n < first_record {
                    continue;
                }
                let Some(kept) = kept.next() else {
                    return Ok(Some(format!("record {n} is missing, which the bytes give")));
                };
                let kept = kept??;
                let of = |row: &super::Row| (row.station, row.session, row.sequence, row.stored());
                if of(&kept) != of(&made) {
                    return Ok(Some(format!(
                        "record {n} is not what the bytes give: {} instead of {}",
                        kept.json(None),
                        made.json(None)
                    )));
                }
            }
        }
    }
    *relayed = base.relay_counters();
    Ok(kept.next().is_some().then(|| format!("there are more records than the {n} that the bytes give")))
}

fn contents(live: &Connection, look: &Look, bytes: &[Part<'_>], records: &[Part<'_>]) -> Result<Value> {
    let number = |db: &Connection, query: &str| db.query_row(query, [], |r| r.get::<_, Option<i64>>(0));
    /// Records, those with UTC, when the first and the last came.
    type Of = (i64, i64, Option<i64>, Option<i64>);
    let mut of_stations = BTreeMap::<i64, Of>::new();
    for part in records {
        let mut stations = part.db().prepare(
            "SELECT station, count(*), count(utc_us), min(received_us), max(received_us) FROM records GROUP BY station",
        )?;
        let found =
            stations.query_map([], |r| Ok((r.get(0)?, (r.get(1)?, r.get(2)?, r.get(3)?, r.get(4)?))))?;
        for found in found {
            let (of, part): (i64, Of) = found?;
            let sum = of_stations.entry(of).or_default();
            let first = sum.2.into_iter().chain(part.2).min();
            *sum = (sum.0 + part.0, sum.1 + part.1, first, sum.3.max(part.3));
        }
    }
    let mut sessions = live.prepare("SELECT count(*) FROM sessions WHERE station = ?1")?;
    let mut stations = Vec::new();
    for (of, (records, dated, first, last)) in of_stations {
        let time = |us: Option<i64>| us.map_or(Value::Null, rfc3339);
        stations.push(json!({
            "station": station(of), "records": records, "with_utc": dated,
            "sessions": sessions.query_row([of], |r| r.get::<_, i64>(0))?,
            "first_received_utc": time(first), "last_received_utc": time(last),
        }));
    }
    let size = "SELECT sum(length(data)) FROM bytes WHERE event = 0";
    let mut sum = 0;
    for part in bytes {
        sum += number(part.db(), size)?.unwrap_or(0);
    }
    let not_decoded = "SELECT count(*) FROM bytes WHERE id > (SELECT decoded FROM about)";
    Ok(json!({
        "type": "store",
        "bytes": sum,
        "connections": number(live, "SELECT count(*) FROM streams")?,
        "not_decoded": number(live, not_decoded)?,
        "months": look.months.iter().map(|m| m.name.as_str()).collect::<Vec<_>>(),
        "stations": stations,
    }))
}
