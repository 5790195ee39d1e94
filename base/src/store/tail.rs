//! The records of a store in the order in which they came, from a number on, while a base station goes on writing.

use super::super::record::Row;
use super::damaged;
use super::look::Look;
use super::read::{COLUMNS, row};
use super::schema::{number, open_to_read};
use anyhow::{Context, Result};
use rusqlite::{Connection, OptionalExtension, Transaction, params};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A record with its number in the store, which is never another's.
#[derive(Clone, Debug, PartialEq)]
pub struct Numbered {
    /// From 1, one more for every record.
    pub number: i64,
    /// The record.
    pub row: Row,
    /// Samples a second of its session.
    pub rate_hz: Option<f64>,
}

/// Follows a store.
pub struct Tail {
    folder: PathBuf,
    live: Connection,
}

impl Tail {
    /// Opens a store to read it.
    ///
    /// # Errors
    /// There is none, or it cannot be read.
    pub fn open(folder: &Path) -> Result<Self> {
        let opened = open_to_read(folder).map_err(|e| damaged(e, folder));
        let (live, _) = opened.with_context(|| unreadable(folder))?;
        Ok(Self { folder: folder.to_owned(), live })
    }

    /// Number of the newest record, 0 where there was none yet.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn newest(&self) -> Result<i64> {
        let query = "SELECT max(ifnull((SELECT max(id) FROM records), 0), moved_records, first_record - 1) FROM about";
        self.live.query_row(query, [], |r| r.get(0)).with_context(|| unreadable(&self.folder))
    }

    /// The records after a number, at most so many. Where the store has let go of some the first is a later one.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn after(&mut self, after: i64, most: usize) -> Result<Vec<Numbered>> {
        let Self { folder, live } = self;
        let found = live.transaction().map_err(Into::into).and_then(|look| read(&look, folder, after, most));
        found.map_err(|e| damaged(e, folder)).with_context(|| unreadable(folder))
    }
}

fn unreadable(folder: &Path) -> String {
    format!("{}: cannot read the store of a base station", folder.display())
}

fn read(live: &Transaction<'_>, folder: &Path, after: i64, most: usize) -> Result<Vec<Numbered>> {
    let moved: i64 = live.query_row("SELECT moved_records FROM about", [], |r| r.get(0))?;
    let mut found = Vec::new();
    if after < moved {
        for file in Look::at(live, folder)?.records(None)? {
            take(&file, after, most, &mut found)?;
        }
    }
    take(live, after, most, &mut found)?;
    let mut rates: BTreeMap<(i64, u32), Option<f64>> = BTreeMap::new();
    let mut rate = live.prepare_cached("SELECT rate_hz FROM sessions WHERE station = ?1 AND session = ?2")?;
    for record in &mut found {
        let Some(session) = record.row.session else { continue };
        let of = (number(record.row.station), session);
        let known = rates.get(&of).copied();
        let rate_hz = match known {
            Some(rate_hz) => rate_hz,
            None => rate.query_row(params![of.0, of.1], |r| r.get(0)).optional()?.flatten(),
        };
        rates.insert(of, rate_hz);
        record.rate_hz = rate_hz;
    }
    Ok(found)
}

/// Appends what a file has of them.
fn take(db: &Connection, after: i64, most: usize, found: &mut Vec<Numbered>) -> Result<()> {
    if found.len() >= most {
        return Ok(());
    }
    let query = format!("SELECT {COLUMNS}, id FROM records WHERE id > ?1 ORDER BY id LIMIT ?2");
    let mut rows = db.prepare_cached(&query)?;
    let rows = rows.query_map(params![after, (most - found.len()) as i64], |r| Ok((row(r)?, r.get(8)?)))?;
    for taken in rows {
        let (row, number) = taken?;
        found.push(Numbered { number, row: row?, rate_hz: None });
    }
    Ok(())
}
