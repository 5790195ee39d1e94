//! How far a broker has acknowledged a store's records: a small file in the store's folder.

use anyhow::{Context, Result};
use seabearing_host::atomic;
use serde::{Deserialize, Serialize};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Name of the file.
const FILE: &str = "mqtt.json";
/// Least time between two writings.
const SAVE: Duration = Duration::from_secs(1);

#[derive(Serialize, Deserialize)]
struct Kept {
    log: String,
    acknowledged: Option<i64>,
}

/// How far it is.
#[derive(Debug)]
pub(super) struct Cursor {
    path: Option<PathBuf>,
    /// Number of the store, never another's.
    pub(super) log: u64,
    /// Number of the record up to which all are acknowledged; none where nothing was published yet.
    pub(super) acknowledged: Option<i64>,
    saved: (Option<i64>, Instant),
}

impl Cursor {
    /// Of a store whose newest record has this number, or of what is only in memory.
    ///
    /// # Errors
    /// The file cannot be read or written.
    pub(super) fn open(store: Option<&Path>, newest: i64) -> Result<Self> {
        let path = store.map(|folder| folder.join(FILE));
        let kept = match path.as_deref().map(std::fs::read) {
            Some(Ok(bytes)) => Some(read(&bytes).with_context(|| damaged(path.as_deref()))?),
            Some(Err(e)) if e.kind() != std::io::ErrorKind::NotFound => {
                return Err(e).with_context(|| damaged(path.as_deref()));
            }
            _ => None,
        };
        // A cursor ahead of its store is another store's, whose numbers say nothing here.
        let kept = kept.filter(|(_, acknowledged)| acknowledged.is_none_or(|n| n <= newest));
        let (log, acknowledged) = kept.unwrap_or_else(|| (RandomState::new().build_hasher().finish(), None));
        let mut cursor = Self { path, log, acknowledged, saved: (None, Instant::now()) };
        cursor.save()?;
        Ok(cursor)
    }

    /// Notes how far it is, now and then.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn now_and_then(&mut self) -> Result<()> {
        let (saved, at) = self.saved;
        if saved != self.acknowledged && at.elapsed() >= SAVE { self.save() } else { Ok(()) }
    }

    /// Notes how far it is.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn save(&mut self) -> Result<()> {
        self.saved = (self.acknowledged, Instant::now());
        let Some(path) = &self.path else { return Ok(()) };
        let kept = Kept { log: format!("{:016x}", self.log), acknowledged: self.acknowledged };
        atomic::write(path, serde_json::to_string(&kept)?.as_bytes())
    }
}

fn read(bytes: &[u8]) -> Result<(u64, Option<i64>)> {
    let kept: Kept = serde_json::from_slice(bytes)?;
    Ok((u64::from_str_radix(&kept.log, 16)?, kept.acknowledged))
}

fn damaged(path: Option<&Path>) -> String {
    let path = path.unwrap_or(Path::new(FILE)).display();
    format!("{path} cannot be read: without it the records of the store count as never published")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cursor_outlives_the_program_and_belongs_to_its_store() {
        let dir = tempfile::tempdir().unwrap();
        let mut cursor = Cursor::open(Some(dir.path()), 100).unwrap();
        assert_eq!(cursor.acknowledged, None);
        let log = cursor.log;
        cursor.acknowledged = Some(40);
        cursor.now_and_then().unwrap();
        cursor.save().unwrap();
        let again = Cursor::open(Some(dir.path()), 100).unwrap();
        assert_eq!((again.log, again.acknowledged), (log, Some(40)));
        // Another store has fewer records than were acknowledged.
        let other = Cursor::open(Some(dir.path()), 39).unwrap();
        assert!(other.log != log && other.acknowledged.is_none());
        std::fs::write(dir.path().join(FILE), "{").unwrap();
        let e = format!("{:#}", Cursor::open(Some(dir.path()), 100).unwrap_err());
        assert!(e.contains(FILE) && e.contains("never published"), "{e}");
        assert!(Cursor::open(None, 0).unwrap().log != Cursor::open(None, 0).unwrap().log);
    }
}
