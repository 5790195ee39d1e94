//! How far a broker has acknowledged a store's records: a small file in the store's folder.

use anyhow::{Context, Result};
use seabearing_base::store::{Logs, begin_log};
use seabearing_host::atomic;
use serde::{Deserialize, Serialize};
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
    /// The logs of the store, never another's.
    pub(super) logs: Logs,
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
        let mut logs = store.map_or_else(|| Ok(Logs::new()), Logs::of)?;
        // A store that was rebuilt has other numbers.
        let kept = kept.filter(|(log, _)| logs.has(*log));
        let mut acknowledged = kept.and_then(|(_, acknowledged)| acknowledged);
        // One that is behind what was published was put back from a copy, and its next numbers have been given already.
        if let (Some(folder), true) = (store, acknowledged.is_some_and(|n| n > newest)) {
            begin_log(folder, newest)?;
            logs = Logs::of(folder)?;
            acknowledged = Some(newest);
        }
        let mut cursor = Self { path, logs, acknowledged, saved: (None, Instant::now()) };
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

    /// Whether how far it is is noted.
    pub(super) fn is_saved(&self) -> bool {
        self.path.is_none() || self.saved.0 == self.acknowledged
    }

    /// Notes how far it is.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn save(&mut self) -> Result<()> {
        self.saved.1 = Instant::now();
        if let Some(path) = &self.path {
            let kept = Kept { log: format!("{:016x}", self.logs.newest()), acknowledged: self.acknowledged };
            atomic::write(path, serde_json::to_string(&kept)?.as_bytes())?;
        }
        self.saved.0 = self.acknowledged;
        Ok(())
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
    use seabearing_base::Base;
    use seabearing_base::store::Store;

    #[test]
    fn a_cursor_outlives_the_program_and_belongs_to_its_store() {
        let dir = tempfile::tempdir().unwrap();
        let store = dir.path();
        drop(Store::open(store, &mut Base::new(None)).unwrap());
        let mut cursor = Cursor::open(Some(store), 100).unwrap();
        assert_eq!(cursor.acknowledged, None);
        let log = cursor.logs.newest();
        cursor.acknowledged = Some(40);
        cursor.now_and_then().unwrap();
        assert!(!cursor.is_saved());
        cursor.save().unwrap();
        let again = Cursor::open(Some(store), 100).unwrap();
        assert_eq!((again.logs.newest(), again.acknowledged, again.is_saved()), (log, Some(40), true));
        // A store put back from a copy has fewer records than were acknowledged: what comes next is not what came before.
        let older = Cursor::open(Some(store), 39).unwrap();
        assert_eq!(
            (older.logs.log(39), older.logs.log(40) != log, older.acknowledged),
            (log, true, Some(39))
        );
        // Another store in its place.
        std::fs::remove_file(store.join("store.sqlite")).unwrap();
        drop(Store::open(store, &mut Base::new(None)).unwrap());
        let other = Cursor::open(Some(store), 100).unwrap();
        assert!(!other.logs.has(log) && other.acknowledged.is_none());
        std::fs::write(store.join(FILE), "{").unwrap();
        let e = format!("{:#}", Cursor::open(Some(store), 100).unwrap_err());
        assert!(e.contains(FILE) && e.contains("never published"), "{e}");
        assert!(Cursor::open(None, 0).unwrap().logs != Cursor::open(None, 0).unwrap().logs);
    }
}
