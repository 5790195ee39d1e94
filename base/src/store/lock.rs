//! One base station a store: a lock that names who holds it.

use anyhow::{Context, Result, bail};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::Path;

/// Locks a store for this process, as long as the file is open.
pub(super) fn lock(folder: &Path) -> Result<File> {
    let path = folder.join("lock");
    let cannot = || format!("cannot lock the store {}", folder.display());
    let mut file =
        OpenOptions::new().read(true).append(true).create(true).open(&path).with_context(cannot)?;
    match file.try_lock() {
        Ok(()) => {
            file.set_len(0).with_context(cannot)?;
            write!(file, "process {}", std::process::id()).with_context(cannot)?;
            Ok(file)
        }
        Err(std::fs::TryLockError::WouldBlock) => {
            let holder = std::fs::read_to_string(&path).unwrap_or_default();
            bail!(
                "the store {} is in use by {holder}: stop that base station, or use another folder",
                folder.display()
            )
        }
        Err(std::fs::TryLockError::Error(e)) => Err(e).with_context(cannot),
    }
}
