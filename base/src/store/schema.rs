//! The tables of a store, and how they are opened.
//!
//! `bytes` is all that came, as it came, and what became of the lines; it alone matters. Everything else follows from it,
//! but for what a person said (`stations`, and `start_us` of `sessions`).

use anyhow::{Context, Result, bail};
use rusqlite::{Connection, OpenFlags};
use std::path::Path;
use std::time::Duration;

/// The file in a store's folder.
pub(super) const FILE: &str = "store.sqlite";
/// Number of this layout.
const VERSION: i64 = 1;

const TABLES: &str = "
CREATE TABLE about(layout INTEGER NOT NULL, decoded INTEGER NOT NULL, first_kept INTEGER NOT NULL);
INSERT INTO about VALUES(1, 0, 1);
CREATE TABLE bytes(id INTEGER PRIMARY KEY, stream INTEGER NOT NULL, received_us INTEGER, event INTEGER NOT NULL, data BLOB);
CREATE TABLE streams(stream INTEGER PRIMARY KEY, line TEXT NOT NULL, peer TEXT, expected INTEGER, lasting INTEGER NOT NULL,
    station INTEGER, session INTEGER, up INTEGER NOT NULL DEFAULT 0, silent INTEGER NOT NULL DEFAULT 0,
    replaced_us INTEGER, replaced_by INTEGER, newest INTEGER, log INTEGER, boot INTEGER, config_hash INTEGER);
CREATE TABLE stations(station INTEGER PRIMARY KEY, lat_deg REAL, lon_deg REAL, rate_hz REAL);
CREATE TABLE sessions(station INTEGER NOT NULL, session INTEGER NOT NULL, boot INTEGER, rate_hz REAL, start_us INTEGER,
    PRIMARY KEY(station, session)) WITHOUT ROWID;
CREATE TABLE logs(station INTEGER NOT NULL, log INTEGER NOT NULL, progress BLOB NOT NULL,
    PRIMARY KEY(station, log)) WITHOUT ROWID;
CREATE TABLE records(id INTEGER PRIMARY KEY, station INTEGER NOT NULL, session INTEGER, sequence INTEGER, kind INTEGER NOT NULL,
    track INTEGER, sample INTEGER, utc_us INTEGER, sd_s REAL, received_us INTEGER, body BLOB NOT NULL);
CREATE INDEX records_by_utc ON records(utc_us) WHERE utc_us IS NOT NULL;
CREATE INDEX records_by_track ON records(station, session, track) WHERE track IS NOT NULL;
CREATE INDEX records_undated ON records(station, session) WHERE utc_us IS NULL;
CREATE INDEX records_of_clocks ON records(station, session) WHERE kind IN (7, 12);
";

/// What came after the first stores of this layout; made where it is missing, once, a second for a million records.
const LATER: &str = "
CREATE INDEX IF NOT EXISTS records_by_station ON records(station, kind, utc_us) WHERE utc_us IS NOT NULL;
";

/// The number under which stations that have not said theirs stand in tables.
pub(super) const NOBODY: i64 = -1;

/// A station as a table has it.
pub(super) fn number(station: Option<u16>) -> i64 {
    station.map_or(NOBODY, i64::from)
}

/// A station from a table.
pub(super) fn station(number: i64) -> Option<u16> {
    u16::try_from(number).ok()
}

/// Opens a store to write into it; makes it where there is none.
pub(super) fn open(folder: &Path) -> Result<Connection> {
    let mut db = Connection::open(folder.join(FILE))?;
    // A reader may hold the file for a moment.
    db.busy_timeout(Duration::from_secs(10))?;
    db.execute_batch(
        "PRAGMA journal_mode = WAL; PRAGMA cache_size = -16000; PRAGMA journal_size_limit = 16777216;",
    )?;
    let tables: i64 = db.query_row("SELECT count(*) FROM sqlite_schema", [], |r| r.get(0))?;
    if tables == 0 {
        let made = db.transaction()?;
        made.execute_batch(TABLES)?;
        made.commit()?;
    }
    known(&db)?;
    db.execute_batch(LATER)?;
    Ok(db)
}

/// Opens a store to read it, while a base station may be writing.
pub(super) fn open_to_read(folder: &Path) -> Result<Connection> {
    let path = folder.join(FILE);
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let db = Connection::open_with_flags(&path, flags)?;
    db.busy_timeout(Duration::from_secs(10))?;
    db.execute_batch("PRAGMA cache_size = -16000;")?;
    known(&db)?;
    Ok(db)
}

/// Whether this program knows the layout.
fn known(db: &Connection) -> Result<()> {
    let layout: i64 =
        db.query_row("SELECT layout FROM about", [], |r| r.get(0)).context("no base station's store")?;
    if layout > VERSION {
        bail!("it was written by a later version (layout {layout}, this program knows {VERSION})");
    }
    Ok(())
}
