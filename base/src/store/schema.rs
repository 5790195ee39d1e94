//! The tables of a store, and how they are opened.
//!
//! `bytes` is all that came, as it came, and what became of the lines; it alone matters. Everything else follows from it,
//! but for what a person said (`stations`, and `start_us` of `sessions`). Rows are numbered as they came, and numbers are
//! never used again: those up to `moved_bytes` and `moved_records` of `about` are in the files of their months
//! ([`super::months`]), those before `first_kept` and `first_record` were let go.

use anyhow::{Context, Result, bail};
use rusqlite::{Connection, OpenFlags};
use std::path::Path;
use std::time::Duration;

/// The file in a store's folder.
pub(super) const FILE: &str = "store.sqlite";
/// Number of this layout.
const VERSION: i64 = 2;

const TABLES: &str = "
CREATE TABLE about(layout INTEGER NOT NULL, decoded INTEGER NOT NULL, first_kept INTEGER NOT NULL);
INSERT INTO about VALUES(1, 0, 1);
CREATE TABLE streams(stream INTEGER PRIMARY KEY, line TEXT NOT NULL, peer TEXT, expected INTEGER, lasting INTEGER NOT NULL,
    station INTEGER, session INTEGER, up INTEGER NOT NULL DEFAULT 0, silent INTEGER NOT NULL DEFAULT 0,
    replaced_us INTEGER, replaced_by INTEGER, newest INTEGER, log INTEGER, boot INTEGER, config_hash INTEGER);
CREATE TABLE stations(station INTEGER PRIMARY KEY, lat_deg REAL, lon_deg REAL, rate_hz REAL);
CREATE TABLE sessions(station INTEGER NOT NULL, session INTEGER NOT NULL, boot INTEGER, rate_hz REAL, start_us INTEGER,
    PRIMARY KEY(station, session)) WITHOUT ROWID;
CREATE TABLE logs(station INTEGER NOT NULL, log INTEGER NOT NULL, progress BLOB NOT NULL,
    PRIMARY KEY(station, log)) WITHOUT ROWID;
CREATE INDEX records_of_clocks ON records(station, session) WHERE kind IN (7, 12);
";

/// The bytes, here and in the files of months.
const BYTES: &str = "
CREATE TABLE IF NOT EXISTS bytes(id INTEGER PRIMARY KEY, stream INTEGER NOT NULL, received_us INTEGER,
    event INTEGER NOT NULL, data BLOB);
";

/// The records, here and in the files of months.
const RECORDS: &str = "
CREATE TABLE IF NOT EXISTS records(id INTEGER PRIMARY KEY, station INTEGER NOT NULL, session INTEGER, sequence INTEGER,
    kind INTEGER NOT NULL, track INTEGER, sample INTEGER, utc_us INTEGER, sd_s REAL, received_us INTEGER,
    body BLOB NOT NULL);
CREATE INDEX IF NOT EXISTS records_by_utc ON records(utc_us) WHERE utc_us IS NOT NULL;
CREATE INDEX IF NOT EXISTS records_by_track ON records(station, session, track) WHERE track IS NOT NULL;
CREATE INDEX IF NOT EXISTS records_undated ON records(station, session) WHERE utc_us IS NULL;
CREATE INDEX IF NOT EXISTS records_by_station ON records(station, kind, utc_us) WHERE utc_us IS NOT NULL;
";

/// What is known of records that come from other base stations: which have come, in runs of their numbers, directly or by way of
/// others, and the sessions that they are of here. And the logs of this store ([`super::epochs`]).
const RELAYED: &str = "
CREATE TABLE IF NOT EXISTS epochs(first INTEGER PRIMARY KEY, log INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS relayed_onward(log INTEGER NOT NULL, first INTEGER NOT NULL, last INTEGER NOT NULL,
    PRIMARY KEY(log, first)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS relayed(log INTEGER NOT NULL, first INTEGER NOT NULL, last INTEGER NOT NULL,
    PRIMARY KEY(log, first)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS relayed_sessions(log INTEGER NOT NULL, station INTEGER NOT NULL, session INTEGER NOT NULL,
    here INTEGER NOT NULL, PRIMARY KEY(log, station, session)) WITHOUT ROWID;
";

/// What makes the second layout of the first: months. Those that a store of the first layout holds become months of their
/// own, whose beginnings were not kept.
const SECOND: &str = "
ALTER TABLE about ADD COLUMN moved_bytes INTEGER NOT NULL DEFAULT 0;
ALTER TABLE about ADD COLUMN moved_records INTEGER NOT NULL DEFAULT 0;
ALTER TABLE about ADD COLUMN first_record INTEGER NOT NULL DEFAULT 1;
ALTER TABLE about ADD COLUMN month TEXT;
ALTER TABLE about ADD COLUMN folder TEXT NOT NULL DEFAULT 'months';
CREATE TABLE clocks(id INTEGER PRIMARY KEY, station INTEGER NOT NULL, session INTEGER, body BLOB NOT NULL);
CREATE INDEX clocks_of_sessions ON clocks(station, session);
CREATE TABLE months(number INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, bytes INTEGER NOT NULL,
    records INTEGER NOT NULL, whole INTEGER NOT NULL DEFAULT 0, first_us INTEGER, last_us INTEGER,
    undated INTEGER NOT NULL DEFAULT 0);
INSERT INTO months(name, bytes, records)
    SELECT strftime('%Y-%m', received_us / 1000000, 'unixepoch') AS month, max(id), 0 FROM bytes
    WHERE received_us >= 1577836800000000 GROUP BY month ORDER BY max(id);
UPDATE months SET records = ifnull((SELECT id FROM records
    WHERE received_us >= 1577836800000000
    AND received_us <= (SELECT received_us FROM bytes WHERE id = months.bytes) ORDER BY id DESC LIMIT 1), 0);
UPDATE months SET records = (SELECT max(records) FROM months m WHERE m.number <= months.number);
UPDATE about SET layout = 2, month = (SELECT name FROM months ORDER BY number DESC LIMIT 1),
    first_record = ifnull((SELECT min(id) FROM records), 1);
DELETE FROM months WHERE number = (SELECT max(number) FROM months);
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
        tables_of_a_store(&made)?;
        made.commit()?;
    }
    if known(&db)? < 2 {
        let made = db.transaction()?;
        made.execute_batch(RECORDS)?;
        made.execute_batch(SECOND)?;
        made.commit()?;
    }
    db.execute_batch(RELAYED)?;
    Ok(db)
}

/// Makes the tables of an empty store.
pub(super) fn tables_of_a_store(db: &Connection) -> Result<()> {
    [BYTES, RECORDS, TABLES, SECOND, RELAYED].iter().try_for_each(|tables| Ok(db.execute_batch(tables)?))
}

/// Opens a month's file to write into it; makes it where there is none.
pub(super) fn open_month(path: &Path) -> Result<Connection> {
    let db = Connection::open(path)?;
    db.busy_timeout(Duration::from_secs(10))?;
    // With a log of its own no reader holds up who writes.
    db.execute_batch("PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA cache_size = -8000;")?;
    let of = if path.to_string_lossy().ends_with(".bytes.sqlite") { BYTES } else { RECORDS };
    db.execute_batch(of)?;
    Ok(db)
}

/// Opens a store to read it, while a base station may be writing; gives its layout too.
pub(super) fn open_to_read(folder: &Path) -> Result<(Connection, i64)> {
    let db = open_file_to_read(&folder.join(FILE))?;
    let layout = known(&db)?;
    Ok((db, layout))
}

/// Opens a file of a store to read it.
pub(super) fn open_file_to_read(path: &Path) -> Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let db = Connection::open_with_flags(path, flags)?;
    db.busy_timeout(Duration::from_secs(10))?;
    db.execute_batch("PRAGMA cache_size = -16000;")?;
    Ok(db)
}

/// The layout, which this program must know.
fn known(db: &Connection) -> Result<i64> {
    let layout: i64 =
        db.query_row("SELECT layout FROM about", [], |r| r.get(0)).context("no base station's store")?;
    if layout > VERSION {
        bail!("it was written by a later version (layout {layout}, this program knows {VERSION})");
    }
    Ok(layout)
}

/// Whether a file of a store has the tables of records of other base stations, which those of earlier versions have not.
pub(super) fn knows_relayed(db: &Connection, file: &str) -> Result<bool> {
    let query = format!("SELECT EXISTS(SELECT 1 FROM {file}.sqlite_schema WHERE name = 'relayed_onward')");
    Ok(db.query_row(&query, [], |r| r.get(0))?)
}
