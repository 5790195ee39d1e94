//! What a base station knew when a month ended: a small store of its own, from which the next month's bytes can be decoded
//! without those before them.

use super::read::{CLOCKED, CLOCKS, CLOCKS_OF, LOOKED_AT, REPORTS, take_up};
use super::schema::tables_of_a_store;
use super::{Base, Entry, Event, Row};
use anyhow::{Context, Result};
use rusqlite::{Connection, params};
use std::collections::BTreeSet;
use std::path::Path;

/// Writes what is known now, whole or not at all. `open`: the connections that have not ended.
pub(super) fn write(store: &Connection, open: &BTreeSet<u32>, path: &Path) -> Result<()> {
    let made = path.with_extension("new");
    match std::fs::remove_file(&made) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            return Err(e).with_context(|| made.display().to_string());
        }
        _ => {}
    }
    fill(store, open, &made).with_context(|| path.display().to_string())?;
    std::fs::rename(&made, path).with_context(|| path.display().to_string())?;
    path.parent().map(sync);
    Ok(())
}

/// Puts the names of a folder's files on the disk.
pub(super) fn sync(folder: &Path) {
    if let Ok(folder) = std::fs::File::open(folder) {
        // Where folders cannot be opened there is no need.
        let _ = folder.sync_all();
    }
}

fn fill(store: &Connection, open: &BTreeSet<u32>, path: &Path) -> Result<()> {
    let from = store.path().context("a store in memory")?;
    let mut to = Connection::open(path)?;
    to.execute_batch("PRAGMA journal_mode = DELETE; PRAGMA synchronous = FULL;")?;
    to.execute("ATTACH ?1 AS store", [from])?;
    let db = to.transaction()?;
    tables_of_a_store(&db)?;
    db.execute_batch(
        "UPDATE about SET decoded = (SELECT decoded FROM store.about);
         INSERT INTO sessions SELECT * FROM store.sessions;
         INSERT INTO logs SELECT * FROM store.logs;
         INSERT INTO stations SELECT * FROM store.stations;
         INSERT INTO clocks SELECT * FROM store.clocks;
         INSERT INTO relayed SELECT * FROM store.relayed;
         INSERT INTO relayed_onward SELECT * FROM store.relayed_onward;
         INSERT INTO relayed_sessions SELECT * FROM store.relayed_sessions;",
    )?;
    {
        let mut streams = db.prepare("INSERT INTO streams SELECT * FROM store.streams WHERE stream = ?1")?;
        // Enough to find the last delimiter in: of a frame that was not complete.
        let mut tails = db.prepare(
            "INSERT INTO bytes SELECT * FROM (SELECT * FROM store.bytes WHERE stream = ?1 AND event = 0
             AND id > (SELECT max(id) FROM store.bytes) - 100000 ORDER BY id DESC LIMIT 400)",
        )?;
        for stream in open {
            streams.execute([stream])?;
            tails.execute([stream])?;
        }
        let mut sessions =
            db.prepare("SELECT session FROM sessions WHERE station = ?1 ORDER BY session DESC LIMIT ?2")?;
        let mut clocks = db.prepare(&format!(
            "INSERT INTO records SELECT * FROM (SELECT * FROM store.records WHERE station = ?1 AND session = ?2
             AND kind IN (7, 12) AND {CLOCKS_OF} ORDER BY id DESC LIMIT ?3)"
        ))?;
        let mut stations = db.prepare("SELECT DISTINCT station FROM sessions")?;
        let stations = stations.query_map([], |r| r.get(0))?.collect::<rusqlite::Result<Vec<i64>>>()?;
        for of in stations {
            let newest = sessions.query_map(params![of, CLOCKED as i64], |r| r.get(0))?;
            for session in newest.collect::<rusqlite::Result<Vec<u32>>>()? {
                clocks.execute(params![of, session, CLOCKS])?;
            }
        }
    }
    db.execute(
        "INSERT OR IGNORE INTO records SELECT * FROM (SELECT * FROM store.records NOT INDEXED WHERE track IS NOT NULL
         AND id > (SELECT ifnull(max(id), 0) FROM store.records) - ?1 ORDER BY id DESC LIMIT ?2)",
        [LOOKED_AT, REPORTS],
    )?;
    Ok(db.commit()?)
}

/// Decodes kept bytes again: connections of which the beginning was decoded before are gone on with from what is known of
/// them.
pub(super) struct Replay<'a> {
    known: Option<&'a Connection>,
    seen: BTreeSet<u32>,
}

impl<'a> Replay<'a> {
    /// Of what is known in these tables; all bytes are given where there are none.
    pub(super) fn new(known: Option<&'a Connection>) -> Self {
        Self { known, seen: BTreeSet::new() }
    }

    /// Tells a base station what was kept as row `id`.
    pub(super) fn tell(
        &mut self,
        id: i64,
        entry: &Entry,
        base: &mut Base,
        rows: &mut Vec<Row>,
    ) -> Result<()> {
        if self.seen.insert(entry.stream)
            && !matches!(entry.event, Event::Began(_))
            && let Some(known) = self.known
        {
            // It goes on with the frame that was not complete.
            take_up(known, entry.stream, id, base)?;
        }
        entry.tell(base, 0, None, rows);
        Ok(())
    }
}
