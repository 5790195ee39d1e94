//! `-`: standard input in place of a file.
//!
//! What reads a file may look at its first bytes and begin again, or read it twice. So standard input is written into a file
//! first, whole; what is said of that file is said of standard input. What reads as it comes (`seabearing base -`) does without.

use crate::beside::Folder;
use anyhow::{Context, Result, bail};
use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// The file, while there is one, and the folder that it is in.
static HELD: Mutex<Option<(Folder, PathBuf)>> = Mutex::new(None);

/// The file that a path of the command line names: itself, but for `-`.
///
/// # Errors
/// Nothing comes from standard input, or it cannot be kept.
pub fn file(path: PathBuf) -> Result<PathBuf> {
    if path.as_os_str() != "-" {
        return Ok(path);
    }
    let mut held = HELD.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, path)) = &*held {
        return Ok(path.clone());
    }
    if std::io::stdin().is_terminal() {
        bail!("- is standard input, and nothing is sent there: a file or a pipe was expected");
    }
    let folder = Folder::new()?;
    let path = folder.path().join("standard-input");
    let cannot = || format!("cannot keep standard input in {}", path.display());
    let mut file = std::fs::File::create(&path).with_context(cannot)?;
    std::io::copy(&mut std::io::stdin().lock(), &mut file).with_context(cannot)?;
    *held = Some((folder, path.clone()));
    Ok(path)
}

/// A text in which the file is called what it is.
pub fn named(text: &str) -> String {
    let held = HELD.lock().unwrap_or_else(PoisonError::into_inner);
    match &*held {
        Some((_, path)) => text.replace(&path.display().to_string(), "standard input"),
        None => text.to_owned(),
    }
}

/// Removes the file.
pub fn forget() {
    drop(HELD.lock().unwrap_or_else(PoisonError::into_inner).take());
}
