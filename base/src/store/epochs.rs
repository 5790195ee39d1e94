//! The number by which a store's records are known elsewhere, its *log*, and that a copy of it gets another.
//!
//! A record is known by the log and its own number. A copy that goes on by itself gives new records numbers that the other
//! store gives, too; so every store notes in a file (`place`) where it is, and one that finds itself elsewhere, or without that
//! file, goes on with another log: what it has from before stays known by the old one.

use super::schema::{FILE, open, open_to_read};
use anyhow::{Context, Result};
use rusqlite::{Connection, params};
use seabearing_core::wire::hash::fnv1a;
use seabearing_host::atomic;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::path::Path;
use std::time::UNIX_EPOCH;

/// The file in a store's folder that says where it is.
const PLACE: &str = "place";

/// The logs of a store, oldest first: the number of the first record of each, and the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Logs(Vec<(i64, u64)>);

impl Logs {
    /// One of its own, of what is in memory only.
    pub fn new() -> Self {
        Self(vec![(1, RandomState::new().build_hasher().finish())])
    }

    /// Those of a store that a base station has opened before.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn of(folder: &Path) -> Result<Self> {
        let unreadable = || format!("cannot read the store {}", folder.display());
        Self::read(&open_to_read(folder).with_context(unreadable)?.0).with_context(unreadable)
    }

    fn read(db: &Connection) -> Result<Self> {
        let mut logs = db.prepare("SELECT first, log FROM epochs ORDER BY first")?;
        let logs = logs.query_map([], |r| Ok((r.get(0)?, r.get::<_, i64>(1)? as u64)))?;
        Ok(Self(logs.collect::<rusqlite::Result<_>>()?))
    }

    /// The log of a record.
    pub fn log(&self, number: i64) -> u64 {
        let earlier = self.0.iter().rev().find(|(first, _)| *first <= number);
        earlier.or(self.0.first()).map_or(0, |(_, log)| *log)
    }

    /// The log of the records to come.
    pub fn newest(&self) -> u64 {
        self.log(i64::MAX)
    }

    /// Whether it is one of these.
    pub fn has(&self, log: u64) -> bool {
        self.0.iter().any(|(_, known)| *known == log)
    }
}

impl Default for Logs {
    fn default() -> Self {
        Self::new()
    }
}

/// Begins another log where a store is not where it was; `newest` is the number of its newest record.
pub(super) fn note_place(db: &Connection, folder: &Path, newest: i64) -> Result<()> {
    let (here, path) = (place(folder), folder.join(PLACE));
    if !Logs::read(db)?.0.is_empty() && std::fs::read_to_string(&path).is_ok_and(|before| before == here) {
        return Ok(());
    }
    begin(db, newest)?;
    // Where that fails the next start begins a log again, and nothing is lost.
    atomic::write(&path, here.as_bytes())
}

/// From now on the records of a store get another log: it is older than what is known of it elsewhere.
///
/// # Errors
/// It cannot be written.
pub fn begin_log(folder: &Path, newest: i64) -> Result<()> {
    begin(&open(folder)?, newest).with_context(|| format!("cannot write the store {}", folder.display()))
}

fn begin(db: &Connection, newest: i64) -> Result<()> {
    db.execute(
        "INSERT OR REPLACE INTO epochs VALUES(?1, ?2)",
        params![newest + 1, Logs::new().newest() as i64],
    )?;
    Ok(())
}

/// What tells a store from a copy of it: the computer, and the file itself.
fn place(folder: &Path) -> String {
    let mut told = Vec::new();
    for id in ["/etc/machine-id", "/var/lib/dbus/machine-id"] {
        told.extend(std::fs::read(id).unwrap_or_default());
    }
    // A card that was cloned has the same number of its machine in another computer.
    let mut cards: Vec<_> =
        std::fs::read_dir("/sys/class/net").into_iter().flatten().flatten().map(|e| e.path()).collect();
    cards.sort();
    for card in cards.iter().filter(|card| card.join("device").exists()) {
        told.extend(std::fs::read(card.join("address")).unwrap_or_default());
    }
    if let Ok(file) = std::fs::metadata(folder.join(FILE)) {
        #[cfg(unix)]
        told.extend(std::os::unix::fs::MetadataExt::ino(&file).to_le_bytes());
        let made = file.created().ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok());
        told.extend(made.map_or(0, |made| made.as_nanos()).to_le_bytes());
    }
    format!("{:016x}\n", fnv1a(&told))
}
