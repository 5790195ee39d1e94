//! The store of a base station: every byte received, and every record, appended and never rewritten.
//!
//! `raw.bin` holds the bytes as they came (with a zero byte before each new stream) and is written first; it alone
//! matters. `records.jsonl` follows from it: on opening, the raw bytes are decoded again, a line cut off by a power
//! failure is removed and missing records are added, so that both always agree.

use super::Base;
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How often the operating system is made to put the files on the disk.
const SYNC: Duration = Duration::from_secs(5);

/// An open store.
pub struct Store {
    /// Held while the store is open; it names who holds it.
    _lock: File,
    raw: File,
    records: File,
    folder: PathBuf,
    synced: Instant,
    /// Bytes that may not be on the disk.
    unsynced: bool,
    /// Records found or completed on opening.
    resumed: usize,
}

impl Store {
    /// Opens or makes a store, and brings `base` to the state of what it holds.
    ///
    /// # Errors
    /// The folder or its files cannot be read or written.
    pub fn open(folder: &Path, base: &mut Base) -> Result<Self> {
        let cannot = || format!("cannot use the store {}", folder.display());
        std::fs::create_dir_all(folder).with_context(cannot)?;
        let lock = lock(folder)?;
        let mut raw = append(&folder.join("raw.bin")).with_context(cannot)?;
        let mut known = Vec::new();
        let mut bytes = vec![0u8; 1 << 16];
        loop {
            let n = raw.read(&mut bytes).with_context(cannot)?;
            if n == 0 {
                break;
            }
            base.push(&bytes[..n], &mut known);
        }
        let path = folder.join("records.jsonl");
        let mut records = append(&path).with_context(cannot)?;
        // Lines of bytes that were not on the disk when the power failed are not kept either: those bytes come again.
        let (lines, whole) = whole_lines(&records, known.len()).with_context(cannot)?;
        records.set_len(whole).with_context(cannot)?;
        let missing = known.get(lines..).unwrap_or(&[]);
        records.write_all(lines_of(missing).as_bytes()).with_context(cannot)?;
        let (folder, synced, resumed) = (folder.to_owned(), Instant::now(), known.len());
        Ok(Self { _lock: lock, raw, records, folder, synced, unsynced: false, resumed })
    }

    /// Records the store held when it was opened.
    pub fn resumed(&self) -> usize {
        self.resumed
    }

    /// Appends bytes, before anything is made of them.
    ///
    /// # Errors
    /// The disk does not take them.
    pub fn bytes(&mut self, bytes: &[u8]) -> Result<()> {
        let cannot = || format!("cannot write to the store {}", self.folder.display());
        self.raw.write_all(bytes).with_context(cannot)?;
        self.unsynced |= !bytes.is_empty();
        Ok(())
    }

    /// Puts the bytes on the disk, before they are acknowledged.
    ///
    /// # Errors
    /// The disk does not take them.
    pub fn hold(&mut self) -> Result<()> {
        if std::mem::take(&mut self.unsynced) {
            let cannot = || format!("cannot write to the store {}", self.folder.display());
            self.raw.sync_data().with_context(cannot)?;
        }
        Ok(())
    }

    /// Appends the records that bytes completed.
    ///
    /// # Errors
    /// The disk does not take them.
    pub fn records(&mut self, records: &[Value]) -> Result<()> {
        let cannot = || format!("cannot write to the store {}", self.folder.display());
        if !records.is_empty() {
            self.records.write_all(lines_of(records).as_bytes()).with_context(cannot)?;
        }
        if self.synced.elapsed() > SYNC {
            self.sync()?;
        }
        Ok(())
    }

    /// Puts everything on the disk.
    ///
    /// # Errors
    /// The disk does not take it.
    pub fn sync(&mut self) -> Result<()> {
        let cannot = || format!("cannot write to the store {}", self.folder.display());
        self.raw.sync_data().with_context(cannot)?;
        self.records.sync_data().with_context(cannot)?;
        self.synced = Instant::now();
        Ok(())
    }
}

/// Locks a store for this process.
fn lock(folder: &Path) -> Result<File> {
    let path = folder.join("lock");
    let cannot = || format!("cannot lock the store {}", folder.display());
    let mut file = append(&path).with_context(cannot)?;
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

fn append(path: &Path) -> std::io::Result<File> {
    OpenOptions::new().read(true).append(true).create(true).open(path)
}

fn lines_of(records: &[Value]) -> String {
    records.iter().map(|r| format!("{r}\n")).collect()
}

/// Hands out the records of a store, oldest first. Nothing in it is changed: a base station may be writing.
///
/// # Errors
/// There is no store, or it cannot be read.
pub fn read(folder: &Path, mut take: impl FnMut(Value)) -> Result<()> {
    let path = folder.join("records.jsonl");
    let unreadable = || format!("{}: cannot read the store of a base station", path.display());
    let mut reader = BufReader::new(File::open(&path).with_context(unreadable)?);
    let mut line = Vec::new();
    let mut number = 0;
    loop {
        line.clear();
        // A last line without its end is still being written.
        if reader.read_until(b'\n', &mut line).with_context(unreadable)? == 0 || line.last() != Some(&b'\n') {
            return Ok(());
        }
        number += 1;
        take(serde_json::from_slice(&line).with_context(|| format!("{}: line {number}", path.display()))?);
    }
}

/// Number of whole lines in a file, at most so many, and their length in bytes.
fn whole_lines(file: &File, most: usize) -> std::io::Result<(usize, u64)> {
    let mut reader = BufReader::new(file);
    let (mut lines, mut length, mut line) = (0, 0, Vec::new());
    loop {
        line.clear();
        let n = reader.read_until(b'\n', &mut line)?;
        if n == 0 || line.last() != Some(&b'\n') || lines == most {
            return Ok((lines, length));
        }
        lines += 1;
        length += n as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::wire::{Encoder, End, Message};

    #[test]
    fn a_store_survives_a_power_failure_between_any_two_bytes() {
        let mut encoder = Encoder::default();
        let frames: Vec<Vec<u8>> =
            (0..4).map(|i| encoder.frame(&Message::End(End { index: i, frames: 0 })).to_vec()).collect();
        let stream = frames.concat();
        let mut reference = Vec::new();
        Base::new(Some(1.0), None).push(&stream, &mut reference);
        let want = lines_of(&reference);
        for cut in 0..want.len() {
            // Any state of the records file that is a beginning of what it should be, and all of the raw bytes.
            let dir = tempfile::tempdir().unwrap();
            std::fs::write(dir.path().join("raw.bin"), &stream).unwrap();
            std::fs::write(dir.path().join("records.jsonl"), &want[..cut]).unwrap();
            let mut base = Base::new(Some(1.0), None);
            let store = Store::open(dir.path(), &mut base).unwrap();
            assert_eq!(store.resumed(), 4);
            assert_eq!(std::fs::read_to_string(dir.path().join("records.jsonl")).unwrap(), want);
        }
    }

    #[test]
    fn a_second_base_station_is_refused_and_the_first_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let mut base = Base::new(Some(1.0), None);
        let first = Store::open(dir.path(), &mut base).unwrap();
        let said = format!("{:#}", Store::open(dir.path(), &mut base).err().unwrap());
        assert!(said.contains(&format!("in use by process {}", std::process::id())), "{said}");
        drop(first);
        assert!(Store::open(dir.path(), &mut base).is_ok());
    }

    #[test]
    fn records_of_bytes_that_the_power_failure_took_are_not_kept() {
        let mut encoder = Encoder::default();
        let frames: Vec<Vec<u8>> =
            (0..4).map(|i| encoder.frame(&Message::End(End { index: i, frames: 0 })).to_vec()).collect();
        let mut reference = Vec::new();
        Base::new(Some(1.0), None).push(&frames.concat(), &mut reference);
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("raw.bin"), frames[..2].concat()).unwrap();
        std::fs::write(dir.path().join("records.jsonl"), lines_of(&reference)).unwrap();
        let mut base = Base::new(Some(1.0), None);
        let store = Store::open(dir.path(), &mut base).unwrap();
        assert_eq!(store.resumed(), 2);
        let text = std::fs::read_to_string(dir.path().join("records.jsonl")).unwrap();
        assert_eq!(text, lines_of(&reference[..2]));
    }

    #[test]
    fn appended_in_pieces_over_several_runs_it_is_the_same() {
        let mut encoder = Encoder::default();
        let mut stream = Vec::new();
        for i in 0..20 {
            stream.extend_from_slice(encoder.frame(&Message::End(End { index: i, frames: 0 })));
        }
        let dir = tempfile::tempdir().unwrap();
        for piece in stream.chunks(37) {
            let mut base = Base::new(Some(1.0), None);
            let mut store = Store::open(dir.path(), &mut base).unwrap();
            let mut records = Vec::new();
            store.bytes(piece).unwrap();
            base.push(piece, &mut records);
            store.records(&records).unwrap();
        }
        let text = std::fs::read_to_string(dir.path().join("records.jsonl")).unwrap();
        assert_eq!(text.lines().count(), 20);
        assert_eq!(std::fs::read(dir.path().join("raw.bin")).unwrap(), stream);
    }
}
