//! The store of a base station: every byte received, in an SQLite database, written before anything is made of it.
//!
//! Bytes are committed first ([`Store::keep`]); the records decoded from them, and how far links have come, follow in a
//! second transaction ([`Store::derive`]), after which they may be acknowledged. What a crash leaves between the two is
//! decoded when the store is opened. Nothing that opening does depends on how much the store holds.

mod check;
mod earlier;
mod history;
mod lock;
mod read;
mod schema;

#[cfg(test)]
mod tests;

pub use check::{Soundness, check, rebuild};
pub use history::{History, Moment, Path as TrackPath};
pub use read::{Wanted, newest_us, positions, read, stations};

use super::record::Row;
use super::{Base, Beginning};
use anyhow::{Context, Result, bail};
use rusqlite::{Connection, ErrorCode, OptionalExtension, Transaction, params};
use schema::number;
use seabearing_core::wire::link::{CLASSES, Progress, Settings};
use serde_json::Value;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Rows deleted in one go where a store keeps only so many days.
const FORGOTTEN: i64 = 5000;

/// Something that happened on a connection.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Number of the connection, never used again in this store.
    pub stream: u32,
    /// When, microseconds since 1970.
    pub received_us: Option<i64>,
    /// What.
    pub event: Event,
}

/// What may happen on a connection.
#[derive(Clone, Debug)]
pub enum Event {
    /// It begins.
    Began(Beginning),
    /// Bytes have come.
    Bytes(Vec<u8>),
    /// Nothing has come for long.
    Silent,
    /// It has ended, or could not be made, for this reason.
    Ended(Option<String>),
    /// Something that was found beside all connections is noted, of a station: an object with its `type`.
    Noted(Option<u16>, Value),
}

impl Entry {
    /// Lets a base station know. `line`: a connection that begins is spoken over.
    pub fn tell(&self, base: &mut Base, now_us: u64, line: Option<Settings>, out: &mut Vec<Row>) {
        match &self.event {
            Event::Began(beginning) => base.begin(self.stream, beginning.clone(), line),
            Event::Bytes(bytes) => base.push(self.stream, now_us, self.received_us, bytes, out),
            Event::Silent => base.silent(self.stream, self.received_us, out),
            Event::Ended(why) => base.end(self.stream, why.as_deref(), self.received_us, out),
            Event::Noted(station, what) => base.note(*station, what.clone(), self.received_us, out),
        }
    }
}

/// An open store.
pub struct Store {
    /// Held while the store is open; it names who holds it.
    _lock: File,
    db: Connection,
    folder: PathBuf,
    /// Records found or completed on opening.
    resumed: u64,
    /// The newest row of `bytes`.
    newest: i64,
    next_stream: u32,
}

impl Store {
    /// Opens or makes a store, and tells `base` what it has to know of what it holds.
    ///
    /// # Errors
    /// One line: the folder or its database cannot be read or written, is damaged, or is in use.
    pub fn open(folder: &Path, base: &mut Base) -> Result<Self> {
        let cannot = || format!("cannot use the store {}", folder.display());
        let new = !folder.exists();
        std::fs::create_dir_all(folder).with_context(cannot)?;
        let begun = folder.join(schema::FILE).exists();
        let lock = lock::lock(folder)?;
        let opened = Self::open_locked(folder, lock, base);
        if opened.is_err() && !begun {
            // Nothing half made is left.
            for name in ["store.sqlite", "store.sqlite-wal", "store.sqlite-shm", "lock"] {
                let _ = std::fs::remove_file(folder.join(name));
            }
            if new {
                let _ = std::fs::remove_dir(folder);
            }
        }
        opened.map_err(|e| damaged(e, folder)).with_context(cannot)
    }

    fn open_locked(folder: &Path, lock: File, base: &mut Base) -> Result<Self> {
        let db = schema::open(folder)?;
        let mut store =
            Self { _lock: lock, db, folder: folder.to_owned(), resumed: 0, newest: 0, next_stream: 1 };
        earlier::take_over(&mut store, folder)?;
        store.newest = store.number("SELECT ifnull(max(id), 0) FROM bytes")?;
        store.next_stream = store.number("SELECT ifnull(max(stream), 0) + 1 FROM streams")? as u32;
        read::resume(&store.db, base)?;
        store.catch_up(base)?;
        store.resumed = store
            .number("SELECT ifnull((SELECT max(id) FROM records) - (SELECT min(id) FROM records) + 1, 0)")?
            as u64;
        Ok(store)
    }

    fn number(&self, query: &str) -> Result<i64> {
        Ok(self.db.query_row(query, [], |row| row.get(0))?)
    }

    /// Decodes what was kept and not decoded.
    fn catch_up(&mut self, base: &mut Base) -> Result<()> {
        let decoded = self.number("SELECT decoded FROM about")?;
        let mut streams = std::collections::BTreeSet::new();
        let mut from = decoded + 1;
        loop {
            let entries = read::entries(&self.db, from, 1000)?;
            let Some((last, _)) = entries.last() else { break };
            from = last + 1;
            let mut rows = Vec::new();
            for (id, entry) in &entries {
                if streams.insert(entry.stream) && !matches!(entry.event, Event::Began(_)) {
                    // Its beginning was decoded before: it goes on with the frame that was not complete.
                    read::take_up(&self.db, entry.stream, *id, base)?;
                }
                entry.tell(base, 0, None, &mut rows);
                earlier::date(self, entry, base)?;
            }
            self.put(base, &rows, from - 1)?;
        }
        // Of whoever held these connections nothing is left.
        let mut rows = Vec::new();
        for (stream, _) in base.streams().collect::<Vec<_>>() {
            base.end(stream, None, None, &mut rows);
        }
        base.warnings();
        Ok(())
    }

    /// Records the store held when it was opened.
    pub fn resumed(&self) -> u64 {
        self.resumed
    }

    /// The number of the next connection.
    pub fn next_stream(&self) -> u32 {
        self.next_stream
    }

    /// Keeps what has happened, before anything is made of it.
    ///
    /// # Errors
    /// The disk does not take it; nothing of it is kept then.
    pub fn keep(&mut self, entries: &[Entry]) -> Result<()> {
        let kept = self.try_keep(entries);
        self.explained(kept)
    }

    fn try_keep(&mut self, entries: &[Entry]) -> Result<()> {
        // The transaction after this one is put on the disk with this one.
        self.db.execute_batch("PRAGMA synchronous = NORMAL")?;
        let transaction = self.db.transaction()?;
        let mut newest = self.newest;
        {
            let mut insert = transaction
                .prepare("INSERT INTO bytes(stream, received_us, event, data) VALUES(?1, ?2, ?3, ?4)")?;
            for entry in entries {
                let note: String;
                let (event, data): (i64, Option<&[u8]>) = match &entry.event {
                    Event::Bytes(bytes) => (0, Some(bytes)),
                    Event::Began(beginning) => {
                        begin(&transaction, entry.stream, beginning)?;
                        (1, None)
                    }
                    Event::Silent => (2, None),
                    Event::Ended(why) => (3, why.as_deref().map(str::as_bytes)),
                    Event::Noted(station, what) => {
                        note = serde_json::json!([station, what]).to_string();
                        (4, Some(note.as_bytes()))
                    }
                };
                newest = insert.insert(params![entry.stream, entry.received_us, event, data])?;
            }
        }
        transaction.commit()?;
        self.newest = newest;
        Ok(())
    }

    /// Writes the records decoded from all that was kept so far, and puts everything on the disk. Only then may it be
    /// acknowledged.
    ///
    /// # Errors
    /// The disk does not take it; nothing of it is written then, and it may be tried again.
    pub fn derive(&mut self, base: &mut Base, rows: &[Row]) -> Result<()> {
        let put = self.put(base, rows, self.newest);
        self.explained(put)
    }

    fn put(&mut self, base: &mut Base, rows: &[Row], decoded: i64) -> Result<()> {
        self.db.execute_batch("PRAGMA synchronous = FULL")?;
        let transaction = self.db.transaction()?;
        write_rows(&transaction, rows)?;
        write_state(&transaction, base)?;
        transaction.execute("UPDATE about SET decoded = ?1", [decoded])?;
        transaction.commit()?;
        base.stored();
        Ok(())
    }

    /// Notes where a station is and its rate, as a person says.
    ///
    /// # Errors
    /// The disk does not take it.
    pub fn describe(
        &mut self,
        of: Option<u16>,
        place: Option<(f64, f64)>,
        rate_hz: Option<f64>,
    ) -> Result<()> {
        let (lat, lon) = place.unzip();
        let put = self.db.execute(
            "INSERT INTO stations VALUES(?1, ?2, ?3, ?4) ON CONFLICT(station) DO UPDATE SET
             lat_deg = ifnull(excluded.lat_deg, lat_deg), lon_deg = ifnull(excluded.lon_deg, lon_deg),
             rate_hz = ifnull(excluded.rate_hz, rate_hz)",
            params![number(of), lat, lon, rate_hz],
        );
        self.explained(put.map(drop).map_err(Into::into))
    }

    /// Forgets some of what came before a time; true if there may be more.
    ///
    /// # Errors
    /// The disk does not take it.
    pub fn forget(&mut self, before_us: i64) -> Result<bool> {
        let forgotten = self.try_forget(before_us);
        self.explained(forgotten)
    }

    fn try_forget(&mut self, before_us: i64) -> Result<bool> {
        let transaction = self.db.transaction()?;
        let mut more = false;
        for table in ["bytes", "records"] {
            // Rows are numbered as they came.
            let oldest = format!("SELECT id FROM {table} ORDER BY id LIMIT {FORGOTTEN}");
            let query = format!(
                "SELECT max(id) FROM {table} WHERE id IN ({oldest}) AND received_us < ?1 AND id <= (SELECT decoded FROM about)"
            );
            let query = if table == "bytes" {
                query
            } else {
                query.replace(" AND id <= (SELECT decoded FROM about)", "")
            };
            let last: Option<i64> =
                transaction.query_row(&query, [before_us], |r| r.get(0)).optional()?.flatten();
            if let Some(last) = last {
                let count = transaction.execute(&format!("DELETE FROM {table} WHERE id <= ?1"), [last])?;
                more |= count as i64 == FORGOTTEN;
                if table == "bytes" {
                    transaction.execute("UPDATE about SET first_kept = ?1", [last + 1])?;
                }
            }
        }
        transaction.commit()?;
        Ok(more)
    }

    fn explained<T>(&self, result: Result<T>) -> Result<T> {
        result
            .map_err(|e| damaged(e, &self.folder))
            .with_context(|| format!("cannot write to the store {}", self.folder.display()))
    }
}

/// An error of the database as a person needs it.
fn damaged(error: anyhow::Error, folder: &Path) -> anyhow::Error {
    let code = error
        .chain()
        .find_map(|e| e.downcast_ref::<rusqlite::Error>())
        .and_then(rusqlite::Error::sqlite_error_code);
    let what = match code {
        Some(ErrorCode::DiskFull) => "the disk is full".to_owned(),
        Some(ErrorCode::NotADatabase | ErrorCode::DatabaseCorrupt) => format!(
            "{} is damaged: move the folder away, or mend a copy of it with `sqlite3 store.sqlite .recover`",
            folder.join(schema::FILE).display()
        ),
        _ => return error,
    };
    error.context(what)
}

fn begin(db: &Transaction<'_>, stream: u32, beginning: &Beginning) -> Result<()> {
    let Beginning { line, peer, station, lasting } = beginning;
    db.execute(
        "INSERT INTO streams(stream, line, peer, expected, lasting) VALUES(?1, ?2, ?3, ?4, ?5)",
        params![stream, line, peer, station, lasting],
    )?;
    Ok(())
}

fn write_rows(db: &Transaction<'_>, rows: &[Row]) -> Result<()> {
    let mut insert = db.prepare(
        "INSERT INTO records(station, session, sequence, kind, track, sample, utc_us, sd_s, received_us, body)
         VALUES(?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)",
    )?;
    for row in rows {
        let (kind, body) = row.stored();
        let (utc_us, sd_s) = row.utc.unzip();
        insert.execute(params![
            number(row.station),
            row.session,
            row.sequence,
            kind,
            row.track(),
            row.index().map(|index| index as i64),
            utc_us,
            sd_s.flatten(),
            row.received_us,
            body
        ])?;
    }
    Ok(())
}

/// What has changed of sessions, logs and connections; records that can be dated now are.
fn write_state(db: &Transaction<'_>, base: &mut Base) -> Result<()> {
    for (of, recorder) in &base.recorders {
        for session in &recorder.changed {
            let Some(known) = recorder.sessions.get(session) else { continue };
            db.execute(
                "INSERT INTO sessions VALUES(?1, ?2, ?3, ?4, ?5) ON CONFLICT DO UPDATE SET boot = excluded.boot,
                 rate_hz = excluded.rate_hz, start_us = excluded.start_us",
                params![number(*of), session, known.boot, known.rate_hz, known.start_us],
            )?;
        }
        for session in &recorder.dated {
            let Some(known) = recorder.sessions.get(session) else { continue };
            let mut update = db.prepare("UPDATE records SET utc_us = ?2, sd_s = ?3 WHERE id = ?1")?;
            let mut undated = db.prepare(
                "SELECT id, sample FROM records WHERE station = ?1 AND session = ?2 AND utc_us IS NULL AND sample IS NOT NULL",
            )?;
            let found = undated.query_map(params![number(*of), session], |r| Ok((r.get(0)?, r.get(1)?)))?;
            for (id, sample) in found.collect::<rusqlite::Result<Vec<(i64, i64)>>>()? {
                if let Some((utc_us, sd_s)) = known.utc(sample as u64) {
                    update.execute(params![id, utc_us, sd_s])?;
                }
            }
        }
    }
    for (of, log) in &base.changed_logs {
        let Some(progress) = base.logs.get(&(*of, *log)) else { continue };
        db.execute("INSERT OR REPLACE INTO logs VALUES(?1, ?2, ?3)", params![of, log, packed(progress)])?;
    }
    for stream in base.changed_streams.clone() {
        let Some(known) = base.halfway(stream) else { continue };
        let (replaced_us, replaced_by) = known.replaced.unzip();
        db.execute(
            "UPDATE streams SET station = ?2, session = ?3, up = ?4, silent = ?5, replaced_us = ?6, replaced_by = ?7,
             newest = ?8, log = ?9, boot = ?10, config_hash = ?11 WHERE stream = ?1",
            params![
                stream,
                known.log.map(|l| l.station).or(known.who),
                known.session,
                known.up,
                known.silent,
                replaced_us,
                replaced_by,
                known.newest,
                known.log.map(|l| l.log),
                known.log.map(|l| l.boot),
                known.log.map(|l| l.config_hash as i64)
            ],
        )?;
    }
    Ok(())
}

/// How far a log has come, as bytes: the next number of each class, then the sets of later ones.
fn packed(progress: &Progress) -> Vec<u8> {
    let next = progress.next.iter().flat_map(|n| n.to_le_bytes());
    next.chain(progress.later.iter().flat_map(|n| n.to_le_bytes())).collect()
}

/// The same back.
fn unpacked(bytes: &[u8]) -> Result<Progress> {
    let mut progress = Progress::default();
    let Some((next, later)) = bytes.split_at_checked(4 * CLASSES) else {
        bail!("a link's progress is cut short")
    };
    for (to, from) in progress.next.iter_mut().zip(next.as_chunks::<4>().0) {
        *to = u32::from_le_bytes(*from);
    }
    for (to, from) in progress.later.iter_mut().zip(later.as_chunks::<8>().0) {
        *to = u64::from_le_bytes(*from);
    }
    Ok(progress)
}

/// Whether what kept a store from being written may pass by itself, as a full disk does.
pub fn may_pass(error: &anyhow::Error) -> bool {
    let code = error
        .chain()
        .find_map(|e| e.downcast_ref::<rusqlite::Error>())
        .and_then(rusqlite::Error::sqlite_error_code);
    matches!(
        code,
        Some(
            ErrorCode::DiskFull
                | ErrorCode::SystemIoFailure
                | ErrorCode::DatabaseBusy
                | ErrorCode::DatabaseLocked
        )
    )
}
