//! A look at a store at one moment: which files of months hold what of it.

use super::months::{Holds, Month, folder, months};
use super::schema::open_file_to_read;
use anyhow::{Context, Result};
use rusqlite::Connection;
use std::path::{Path, PathBuf};

/// What counts of the files of months.
pub(super) struct Look {
    folder: PathBuf,
    /// The months that have ended, oldest first.
    pub(super) months: Vec<Month>,
    /// Numbers of the rows in files: of bytes, and of records, from the first kept to the last moved.
    bytes: (i64, i64),
    records: (i64, i64),
}

/// From where on bytes can be decoded.
#[derive(Debug, Default)]
pub(super) struct Start {
    /// The row of bytes before.
    pub(super) bytes: i64,
    /// The record before.
    pub(super) records: i64,
    /// The file of what was known then; nothing was, where there is none.
    pub(super) state: Option<PathBuf>,
}

impl Look {
    /// Of a store's own file, within a transaction: as long as it lasts, what is in files stays as it is.
    pub(super) fn at(live: &Connection, store: &Path) -> Result<Self> {
        if live.query_row("SELECT layout FROM about", [], |r| r.get::<_, i64>(0))? < 2 {
            // No base station of this version has opened it yet.
            let first = live.query_row("SELECT first_kept FROM about", [], |r| r.get(0))?;
            return Ok(Self {
                folder: PathBuf::new(),
                months: Vec::new(),
                bytes: (first, 0),
                records: (1, 0),
            });
        }
        let query = "SELECT first_kept, moved_bytes, first_record, moved_records FROM about";
        let (bytes, records) =
            live.query_row(query, [], |r| Ok(((r.get(0)?, r.get(1)?), (r.get(2)?, r.get(3)?))))?;
        Ok(Self { folder: folder(live, store)?, months: months(live)?, bytes, records })
    }

    /// From where on the bytes can be decoded; not at all if some were let go, and not by whole months.
    pub(super) fn start(&self) -> Option<Start> {
        let before = self.bytes.0 - 1;
        if before <= 0 {
            return Some(Start::default());
        }
        let ended = self.months.iter().rfind(|m| m.bytes == before)?;
        let state = Some(ended.file(&self.folder, Holds::State)).filter(|path| path.exists())?;
        Some(Start { bytes: before, records: ended.records, state: Some(state) })
    }

    /// The files with the records of these months from a number on.
    pub(super) fn kept(&self, months: &[Month], first_record: i64) -> Vec<PathBuf> {
        let files = months.iter().filter(|m| m.records >= first_record);
        files.map(|m| m.file(&self.folder, Holds::Records)).filter(|path| path.exists()).collect()
    }

    /// The files with records that count, oldest first; of an interval of UTC only those that may have some of it.
    ///
    /// # Errors
    /// A file is missing or cannot be opened.
    pub(super) fn records(&self, span_us: Option<(i64, i64)>) -> Result<Vec<Connection>> {
        self.files(Holds::Records, |month| match (span_us, month.whole, month.span_us) {
            (Some((from, to)), true, Some((first, last))) => first < to && last >= from,
            (Some(_), true, None) => false,
            _ => true,
        })
    }

    /// The files with bytes that count, oldest first.
    ///
    /// # Errors
    /// A file is missing or cannot be opened.
    pub(super) fn bytes(&self) -> Result<Vec<Connection>> {
        self.files(Holds::Bytes, |_| true)
    }

    fn files(&self, holds: Holds, some: impl Fn(&Month) -> bool) -> Result<Vec<Connection>> {
        let (first, moved) = if holds == Holds::Bytes { self.bytes } else { self.records };
        let mut before = 0;
        let mut files = Vec::new();
        for month in &self.months {
            let last = if holds == Holds::Bytes { month.bytes } else { month.records };
            let begins = std::mem::replace(&mut before, last);
            if begins >= moved || last < first || last == begins || !some(month) {
                continue;
            }
            let path = month.file(&self.folder, holds);
            let name = || path.display().to_string();
            let file = open_file_to_read(&path).with_context(name)?;
            if begins + 1 < first || last > moved {
                // Rows beyond are in the store still; those before were let go. (The sign keeps the indices in use.)
                let table = if holds == Holds::Bytes { "bytes" } else { "records" };
                let counts = format!(
                    "CREATE TEMP VIEW {table} AS SELECT * FROM main.{table} WHERE +id >= {first} AND +id <= {moved}"
                );
                file.execute_batch(&counts).with_context(name)?;
            }
            files.push(file);
        }
        Ok(files)
    }
}
