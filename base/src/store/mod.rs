//! The store of a base station: every byte received, in an SQLite database, written before anything is made of it.
//!
//! Bytes are committed first ([`Store::keep`]); the records decoded from them, and how far links have come, follow in a
//! second transaction ([`Store::derive`]), after which they may be acknowledged. What a crash leaves between the two is
//! decoded when the store is opened. Nothing that opening does depends on how much the store holds: what came before the
//! last month has files of its own (`months.rs`).

mod check;
mod earlier;
mod epochs;
mod history;
mod lock;
mod look;
mod months;
mod read;
mod rebuild;
mod schema;
mod state;
mod tail;
mod write;

#[cfg(test)]
mod tests;

pub use check::{Soundness, check};
pub use epochs::{Logs, begin_log};
pub use history::{History, Moment, Path as TrackPath};
pub use months::Retain;
pub use read::{Wanted, newest_us, positions, read, stations};
pub use rebuild::rebuild;
pub use tail::{Numbered, Tail};

use super::record::Row;
use super::{Base, Beginning};
use anyhow::{Context, Result};
use rusqlite::{Connection, ErrorCode, params};
use schema::number;
use seabearing_core::wire::link::Settings;
use serde_json::Value;
use state::Replay;
use std::collections::BTreeSet;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Rows deleted in one go where a store keeps only so many days.
const FORGOTTEN: i64 = 5000;
/// 2020-01-01, microseconds since 1970: a computer whose clock says less has not been told the time yet.
const CLOCK_SET_US: i64 = 1_577_836_800_000_000;

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
    /// Records of other base stations have come, as [`packed`](super::relay::packed) gives them.
    Relayed(Vec<u8>),
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
            Event::Relayed(bytes) => base.relayed(bytes, out),
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
    /// The newest of which the records are written.
    decoded: i64,
    /// The newest row of `records`.
    newest_record: i64,
    next_stream: u32,
    /// Connections that have begun since it was opened, and not ended.
    open_streams: BTreeSet<u32>,
    /// The open month, as `2026-08`, once something has come.
    month: Option<String>,
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
            for name in ["store.sqlite", "store.sqlite-wal", "store.sqlite-shm", "lock", "place"] {
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
        let mut store = Self {
            _lock: lock,
            db,
            folder: folder.to_owned(),
            resumed: 0,
            newest: 0,
            decoded: 0,
            newest_record: 0,
            next_stream: 1,
            open_streams: BTreeSet::new(),
            month: None,
        };
        earlier::take_over(&mut store, folder)?;
        store.take_numbers()?;
        read::resume(&store.db, base)?;
        store.catch_up(base)?;
        store.clear(&months::months(&store.db)?)?;
        rebuild::clear(&store)?;
        epochs::note_place(&store.db, folder, store.newest_record)?;
        store.resumed = (store.newest_record + 1 - store.number("SELECT first_record FROM about")?) as u64;
        Ok(store)
    }

    /// Where its rows are.
    fn take_numbers(&mut self) -> Result<()> {
        // Rows that were moved or let go have had their numbers.
        self.newest = self.number(
            "SELECT max(ifnull((SELECT max(id) FROM bytes), 0), moved_bytes, first_kept - 1) FROM about",
        )?;
        self.newest_record = self.number(
            "SELECT max(ifnull((SELECT max(id) FROM records), 0), moved_records, first_record - 1) FROM about",
        )?;
        self.decoded = self.number("SELECT decoded FROM about")?;
        self.next_stream = self.number("SELECT ifnull(max(stream), 0) + 1 FROM streams")? as u32;
        self.month = self.db.query_row("SELECT month FROM about", [], |row| row.get(0))?;
        Ok(())
    }

    fn number(&self, query: &str) -> Result<i64> {
        Ok(self.db.query_row(query, [], |row| row.get(0))?)
    }

    /// Decodes what was kept and not decoded.
    fn catch_up(&mut self, base: &mut Base) -> Result<()> {
        let mut from = self.decoded + 1;
        // Nothing of these bytes is written yet: what is known of their connections is what it was before them.
        let known = schema::open_to_read(&self.folder)?.0;
        let mut replay = Replay::new(Some(&known));
        loop {
            let entries = read::entries(&self.db, &self.db, from, 1000)?;
            let Some((last, _)) = entries.last() else { break };
            from = last + 1;
            let mut rows = Vec::new();
            for (id, entry) in &entries {
                replay.tell(*id, entry, base, &mut rows)?;
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
        self.turn_month(entries.iter().find_map(|entry| entry.received_us))?;
        // The transaction after this one is put on the disk with this one.
        self.db.execute_batch("PRAGMA synchronous = NORMAL")?;
        let transaction = self.db.transaction()?;
        let mut newest = self.newest;
        {
            let mut insert = transaction.prepare(
                "INSERT INTO bytes(id, stream, received_us, event, data) VALUES(?1, ?2, ?3, ?4, ?5)",
            )?;
            for entry in entries {
                let note: String;
                let (event, data): (i64, Option<&[u8]>) = match &entry.event {
                    Event::Bytes(bytes) => (0, Some(bytes)),
                    Event::Began(beginning) => {
                        write::begin(&transaction, entry.stream, beginning)?;
                        (1, None)
                    }
                    Event::Silent => (2, None),
                    Event::Ended(why) => (3, why.as_deref().map(str::as_bytes)),
                    Event::Noted(station, what) => {
                        note = serde_json::json!([station, what]).to_string();
                        (4, Some(note.as_bytes()))
                    }
                    Event::Relayed(bytes) => (5, Some(bytes)),
                };
                newest += 1;
                insert.execute(params![newest, entry.stream, entry.received_us, event, data])?;
            }
        }
        transaction.commit()?;
        self.newest = newest;
        for entry in entries {
            match entry.event {
                Event::Began(_) => self.open_streams.insert(entry.stream),
                Event::Ended(_) => self.open_streams.remove(&entry.stream),
                _ => continue,
            };
        }
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
        write::rows(&transaction, rows, self.newest_record)?;
        write::state(&transaction, &self.folder, base)?;
        transaction.execute("UPDATE about SET decoded = ?1", [decoded])?;
        transaction.commit()?;
        self.newest_record += rows.len() as i64;
        self.decoded = decoded;
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
        self.forget_months(before_us)?;
        let transaction = self.db.transaction()?;
        let mut more = false;
        for (table, decoded, first) in [
            ("bytes", " WHERE id <= (SELECT decoded FROM about)", "first_kept"),
            ("records", "", "first_record"),
        ] {
            // Rows are numbered as they came. What came before something old goes; what came after something that is kept
            // stays, and so does what came while the clock was not set, whatever it said.
            let old = format!(
                "WITH oldest AS (SELECT id, received_us FROM {table}{decoded} ORDER BY id LIMIT {FORGOTTEN})
                 SELECT max(id) FROM oldest WHERE received_us >= ?2 AND received_us < ?1
                 AND id < ifnull((SELECT min(id) FROM oldest WHERE received_us >= ?1), id + 1)"
            );
            let last: Option<i64> = transaction.query_row(&old, [before_us, CLOCK_SET_US], |r| r.get(0))?;
            if let Some(last) = last {
                if table == "records" {
                    months::keep_clocks(&transaction, last)?;
                }
                let count = transaction.execute(&format!("DELETE FROM {table} WHERE id <= ?1"), [last])?;
                more |= count as i64 == FORGOTTEN;
                transaction.execute(&format!("UPDATE about SET {first} = ?1"), [last + 1])?;
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
