//! Is a store sound? And its records made anew from its bytes.

use super::super::Base;
use super::super::record::rfc3339;
use super::read::{COLUMNS, entries, row};
use super::schema::{FILE, open_to_read, station};
use super::{Event, Store, damaged};
use anyhow::{Context, Result, bail};
use rusqlite::{Connection, params};
use serde_json::{Value, json};
use std::path::Path;

/// What was found.
#[derive(Clone, Debug)]
pub struct Soundness {
    /// What is in it, as a record.
    pub contents: Value,
    /// What is wrong; nothing if it is sound.
    pub faults: Vec<String>,
}

/// Looks through a whole store: whether the database is whole, and whether its records are those that its bytes give. A
/// base station may be writing into it.
///
/// # Errors
/// There is no store, or it is damaged so much that it cannot be opened.
pub fn check(folder: &Path) -> Result<Soundness> {
    let unreadable = || format!("{}: cannot read the store of a base station", folder.display());
    let found = open_to_read(folder).and_then(|mut db| {
        // One look at it, whatever is written meanwhile.
        let look = db.transaction()?;
        let mut faults = whole(&look)?;
        if faults.is_empty() {
            faults.extend(as_the_bytes_say(&look)?);
        }
        Ok(Soundness { contents: contents(&look)?, faults })
    });
    found.map_err(|e| damaged(e, folder)).with_context(unreadable)
}

/// What the database says of itself.
fn whole(db: &Connection) -> Result<Vec<String>> {
    let mut rows = db.prepare("PRAGMA integrity_check(5)")?;
    let said = rows.query_map([], |r| r.get::<_, String>(0))?;
    let said = said.collect::<rusqlite::Result<Vec<_>>>().unwrap_or_else(|e| vec![e.to_string()]);
    Ok(said.into_iter().filter(|line| line != "ok").map(|line| line.replace('\n', " ")).collect())
}

/// Decodes all bytes again and compares.
fn as_the_bytes_say(db: &Connection) -> Result<Option<String>> {
    let (decoded, first): (i64, i64) =
        db.query_row("SELECT decoded, first_kept FROM about", [], |r| Ok((r.get(0)?, r.get(1)?)))?;
    if first > 1 {
        // The rule of retention has taken the beginnings of what is there.
        return Ok(None);
    }
    let mut base = Base::new(None);
    let mut kept = db.prepare(&format!("SELECT {COLUMNS} FROM records ORDER BY id"))?;
    let mut kept = kept.query_map([], row)?;
    let (mut from, mut n) = (1, 0u64);
    loop {
        let found = entries(db, from, 1000)?;
        let Some((last, _)) = found.last() else { break };
        from = last + 1;
        let mut rows = Vec::new();
        for (_, entry) in found.iter().filter(|(id, _)| *id <= decoded) {
            entry.tell(&mut base, 0, None, &mut rows);
        }
        for made in rows {
            n += 1;
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
    Ok(kept.next().is_some().then(|| format!("there are more records than the {n} that the bytes give")))
}

fn contents(db: &Connection) -> Result<Value> {
    let number = |query: &str| db.query_row(query, [], |r| r.get::<_, Option<i64>>(0));
    let mut stations = db.prepare(
        "SELECT station, count(*), count(utc_us), min(received_us), max(received_us),
         (SELECT count(*) FROM sessions s WHERE s.station = r.station) FROM records r GROUP BY station",
    )?;
    let stations = stations.query_map([], |r| {
        let time = |us: Option<i64>| us.map_or(Value::Null, rfc3339);
        Ok(json!({
            "station": station(r.get(0)?), "records": r.get::<_, i64>(1)?, "with_utc": r.get::<_, i64>(2)?,
            "sessions": r.get::<_, i64>(5)?, "first_received_utc": time(r.get(3)?), "last_received_utc": time(r.get(4)?),
        }))
    })?;
    Ok(json!({
        "type": "store",
        "bytes": number("SELECT sum(length(data)) FROM bytes WHERE event = 0")?.unwrap_or(0),
        "connections": number("SELECT count(*) FROM streams")?,
        "not_decoded": number("SELECT count(*) FROM bytes WHERE id > (SELECT decoded FROM about)")?,
        "stations": stations.collect::<rusqlite::Result<Vec<_>>>()?,
    }))
}

/// Makes all records anew from the bytes. Gives how many there are.
///
/// # Errors
/// The store is in use, cannot be read, or the rule of retention has taken some of its bytes; it is as it was then.
pub fn rebuild(folder: &Path) -> Result<u64> {
    let cannot = || format!("cannot rebuild the store {}", folder.display());
    let rebuilt = folder.join("rebuilt");
    let _lock = super::lock::lock(folder)?;
    let made = (|| {
        let old = super::schema::open(folder)?;
        if old.query_row("SELECT first_kept FROM about", [], |r| r.get::<_, i64>(0))? > 1 {
            bail!(
                "its oldest bytes were dropped by the rule of retention, and some of the rest cannot be read without them"
            );
        }
        let _ = std::fs::remove_dir_all(&rebuilt);
        let mut base = Base::new(None);
        let mut store = Store::open(&rebuilt, &mut base)?;
        let mut from = 1;
        loop {
            let found = entries(&old, from, 1000)?;
            let Some((last, _)) = found.last() else { break };
            from = last + 1;
            let all: Vec<_> = found.into_iter().map(|(_, entry)| entry).collect();
            store.keep(&all)?;
            let mut rows = Vec::new();
            all.iter().for_each(|entry| entry.tell(&mut base, 0, None, &mut rows));
            store.derive(&mut base, &rows)?;
            if all.iter().any(|entry| matches!(entry.event, Event::Began(_))) {
                base.warnings();
            }
        }
        // What a person said does not follow from the bytes.
        let mut starts =
            old.prepare("SELECT station, session, start_us FROM sessions WHERE start_us IS NOT NULL")?;
        for said in
            starts.query_map([], |r| Ok((r.get::<_, i64>(0)?, r.get::<_, u32>(1)?, r.get::<_, i64>(2)?)))?
        {
            let (of, session, start_us) = said?;
            base.date(station(of), session, start_us);
        }
        store.derive(&mut base, &[])?;
        store.db.execute("ATTACH ?1 AS old", params![folder.join(FILE).display().to_string()])?;
        store.db.execute_batch("INSERT INTO stations SELECT * FROM old.stations; DETACH old;")?;
        let records = store.number("SELECT count(*) FROM records")? as u64;
        store.db.execute_batch("PRAGMA wal_checkpoint(TRUNCATE); PRAGMA journal_mode = DELETE")?;
        drop(starts);
        old.execute_batch("PRAGMA wal_checkpoint(TRUNCATE); PRAGMA journal_mode = DELETE")?;
        Ok(records)
    })();
    let made = made
        .and_then(|records| Ok(std::fs::rename(rebuilt.join(FILE), folder.join(FILE)).map(|()| records)?));
    let _ = std::fs::remove_dir_all(&rebuilt);
    made.map_err(|e| damaged(e, folder)).with_context(cannot)
}
