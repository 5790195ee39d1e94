//! Writing output files so that a reader never sees half of one: a temporary file beside it, then a rename. Where a name is a link
//! the file it leads to is written; a device or a pipe gets the bytes once they are all there.
//!
//! An interruption removes the temporary file ([`crate::interrupt`]). One that a run left which was killed outright is
//! removed by the next run that writes into the folder: the temporary file's name tells the process it belonged to.

use crate::interrupt::{self, Guard};
use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use tempfile::NamedTempFile;

/// Begins the names of temporary files; the process's number follows.
const PREFIX: &str = ".seabearing-";
/// Links followed, as many as Linux does.
const LINKS: usize = 40;

/// Writes a whole file atomically; its folder is made if missing.
///
/// # Errors
/// The folder or file cannot be written; the line names the path.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    write_with(path, |out| Ok(out.write_all(bytes)?))
}

/// Writes a file atomically through a buffered writer; nothing is left behind if `fill` fails.
///
/// # Errors
/// The folder or file cannot be written, or `fill` says so.
pub fn write_with(
    path: &Path,
    fill: impl FnOnce(&mut std::io::BufWriter<&std::fs::File>) -> Result<()>,
) -> Result<()> {
    let file = Unfinished::beside(path)?;
    {
        let mut out = std::io::BufWriter::with_capacity(1 << 16, file.as_file());
        fill(&mut out).with_context(|| file.cannot())?;
        out.flush().with_context(|| file.cannot())?;
    }
    file.finish()
}

/// A file that appears under its name when it is finished; dropped or interrupted, it leaves nothing.
#[derive(Debug)]
pub struct Unfinished {
    file: NamedTempFile,
    path: PathBuf,
    /// It is no file, and is written into instead of replaced.
    special: bool,
    listed: Guard,
}

impl Unfinished {
    /// Begins a file; its folder is made if missing.
    ///
    /// # Errors
    /// The folder cannot be made or written; the line names the path.
    pub fn beside(path: &Path) -> Result<Self> {
        let cannot = || format!("cannot write {}", path.display());
        let there = std::fs::metadata(path).ok();
        if there.as_ref().is_some_and(|m| m.is_dir()) {
            anyhow::bail!("cannot write {}: it is a folder", path.display());
        }
        let special = there.as_ref().is_some_and(|m| !m.is_file());
        let path = if special { path.to_owned() } else { linked(path).with_context(cannot)? };
        let elsewhere = std::env::temp_dir();
        let folder = if special {
            &elsewhere
        } else {
            path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
        };
        std::fs::create_dir_all(folder).with_context(cannot)?;
        clear_up(folder);
        let (file, listed) = interrupt::listing(|| {
            let prefix = format!("{PREFIX}{}-", std::process::id());
            let mut builder = tempfile::Builder::new();
            builder.prefix(&prefix);
            // Temporary files are private by default; results should be as readable as any other file (less the umask).
            #[cfg(unix)]
            builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
            let file = builder.tempfile_in(folder)?;
            let begun = file.path().to_owned();
            Ok::<_, std::io::Error>((file, Box::new(move || drop(std::fs::remove_file(&begun))) as _))
        })
        .with_context(cannot)?;
        Ok(Self { file, path, special, listed })
    }

    /// The file to write into.
    pub fn as_file(&self) -> &std::fs::File {
        self.file.as_file()
    }

    /// Gives it its name; a file of that name is replaced.
    ///
    /// # Errors
    /// It cannot be renamed; the line names the path.
    pub fn finish(self) -> Result<()> {
        let Self { file, path, special, listed } = self;
        let done = if special {
            let from = file.reopen();
            let to = std::fs::OpenOptions::new().write(true).open(&path);
            from.and_then(|mut from| std::io::copy(&mut from, &mut to?)).map(drop)
        } else {
            file.persist(&path).map(drop).map_err(|e| e.error)
        };
        done.with_context(|| format!("cannot write {}", path.display()))?;
        drop(listed);
        Ok(())
    }

    fn cannot(&self) -> String {
        format!("cannot write {}", self.path.display())
    }
}

/// Where a name leads to: that of the last of a chain of links, which need not exist.
fn linked(path: &Path) -> std::io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..LINKS {
        match std::fs::read_link(&path) {
            Ok(to) => path = path.parent().unwrap_or(Path::new("")).join(to),
            Err(_) => return Ok(path),
        }
    }
    Err(std::io::Error::other("links that lead in a circle"))
}

/// Removes what a process that is no more has left in a folder; once a folder and run.
fn clear_up(folder: &Path) {
    static DONE: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    if !DONE.lock().unwrap_or_else(PoisonError::into_inner).insert(folder.to_owned()) {
        return;
    }
    // Whether a process lives is known where there is /proc.
    if !Path::new("/proc/self").exists() {
        return;
    }
    let left: Vec<PathBuf> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| {
            let name = entry.file_name();
            let owner =
                name.to_str().and_then(|n| n.strip_prefix(PREFIX)?.split_once('-')?.0.parse::<u32>().ok());
            owner.is_some_and(|pid| !Path::new("/proc").join(pid.to_string()).exists())
        })
        .map(|entry| entry.path())
        .filter(|path| std::fs::remove_file(path).is_ok())
        .collect();
    if !left.is_empty() {
        log::warn!("removed {} unfinished file(s) of a killed run in {}", left.len(), folder.display());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("new/folder/x.txt");
        write(&path, b"old").unwrap();
        assert!(
            write_with(&path, |out| Ok(out.write_all(b"half")?).and(Err(anyhow::anyhow!("stop")))).is_err()
        );
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_one_and_a_pipe_is_written_into() {
        use std::io::Read;
        let dir = tempfile::tempdir().unwrap();
        let (real, link) = (dir.path().join("real.txt"), dir.path().join("link.txt"));
        std::os::unix::fs::symlink("real.txt", &link).unwrap();
        for text in ["new", "newer"] {
            write(&link, text.as_bytes()).unwrap();
            assert_eq!(std::fs::read_to_string(&real).unwrap(), text);
            assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        }
        std::os::unix::fs::symlink("round.txt", dir.path().join("round.txt")).unwrap();
        assert!(write(&dir.path().join("round.txt"), b"x").is_err());
        let pipe = dir.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || {
                let mut text = String::new();
                std::fs::File::open(pipe).unwrap().read_to_string(&mut text).unwrap();
                text
            }
        });
        write(&pipe, b"through").unwrap();
        assert_eq!(reader.join().unwrap(), "through");
        assert!(!std::fs::symlink_metadata(&pipe).unwrap().is_file());
    }

    #[test]
    fn what_a_killed_run_left_is_removed_and_what_a_living_one_writes_is_not() {
        let dir = tempfile::tempdir().unwrap();
        // No process has the largest number there could be; this one lives.
        let dead = dir.path().join(".seabearing-4294967295-abc");
        let living = dir.path().join(format!(".seabearing-{}-abc", std::process::id()));
        let other = dir.path().join(".seabearing-notes");
        for path in [&dead, &living, &other] {
            std::fs::write(path, b"x").unwrap();
        }
        write(&dir.path().join("x.txt"), b"x").unwrap();
        assert!(!dead.exists() || !Path::new("/proc/self").exists());
        assert!(living.exists() && other.exists());
    }
}
