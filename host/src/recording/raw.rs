//! An `.sbraw` stream as a recording: codes with their sample indices, as they came from a recorder.

use super::BlockSource;
use anyhow::{Context, Result, bail};
use seabearing_core::block::{Block, CHANNELS, Frame};
use seabearing_core::port::{Chunk, SampleSource as _};
use seabearing_core::sbraw::{Ending, ReadBytes, Reader};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

/// Frames of a block.
const FRAMES: usize = 16_384;

/// A file or FIFO, with the error that ended it.
struct Bytes {
    file: BufReader<File>,
    error: Option<std::io::Error>,
}

impl ReadBytes for Bytes {
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        let mut got = 0;
        while let Some(space) = bytes.get_mut(got..).filter(|s| !s.is_empty()) {
            match self.file.read(space) {
                Ok(0) => break,
                Ok(n) => got += n,
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                Err(e) => {
                    self.error = Some(e);
                    break;
                }
            }
        }
        got
    }
}

/// One stream.
pub(super) struct Raw {
    path: PathBuf,
    reader: Reader<Bytes>,
    frames: Vec<Frame>,
    start: Option<OffsetDateTime>,
}

impl Raw {
    /// A stream whose sample 0 was at `start`, where that is known.
    ///
    /// # Errors
    /// The file cannot be read.
    pub(super) fn open(path: &Path, start: Option<OffsetDateTime>) -> Result<Self> {
        let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        let reader = Reader::new(Bytes { file: BufReader::with_capacity(1 << 18, file), error: None });
        Ok(Self { path: path.to_owned(), reader, frames: vec![[0; CHANNELS]; FRAMES], start })
    }
}

impl BlockSource for Raw {
    fn start(&self) -> Option<OffsetDateTime> {
        self.start
    }

    fn expected_end(&self) -> Option<u64> {
        None
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        if let Chunk::Frames { first_index, count } = self.reader.read(&mut self.frames) {
            return Ok(self.frames.get(..count).map(|frames| Block { first_index, frames }));
        }
        let path = self.path.display();
        if let Some(error) = self.reader.bytes().error.take() {
            bail!("cannot read {path}: {error}");
        }
        match self.reader.ending() {
            Ending::NotSbraw => bail!("{path}: not an .sbraw stream (docs/firmware.md)"),
            Ending::Truncated => {
                super::complain(&format!("{path}: ends within a record; what is whole of it was used"))
            }
            Ending::Open | Ending::Clean => {}
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::sbraw::{MAGIC, frame_bytes, record_head};

    fn stream(folder: &Path, records: &[(u64, u32)], cut: usize) -> PathBuf {
        let mut bytes = MAGIC.to_vec();
        for (first, count) in records {
            bytes.extend(record_head(*first, *count));
            (0..*count).for_each(|i| bytes.extend(frame_bytes(&[i as i32, -1, 2, 3])));
        }
        bytes.truncate(bytes.len() - cut);
        let path = folder.join("a.sbraw");
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn blocks(path: &Path) -> Result<Vec<(u64, usize)>> {
        let mut raw = Raw::open(path, None)?;
        let mut out = Vec::new();
        while let Some(block) = raw.next_block()? {
            assert_eq!(block.frames[1], [1, -1, 2, 3]);
            out.push((block.first_index, block.frames.len()));
        }
        Ok(out)
    }

    #[test]
    fn indices_are_the_streams_own_and_a_cut_costs_the_frame_it_is_in() {
        let folder = tempfile::tempdir().unwrap();
        let records = [(7, 100), (500, 40), (20, 30)];
        assert_eq!(
            blocks(&stream(folder.path(), &records, 0)).unwrap(),
            records.map(|(i, n)| (i, n as usize))
        );
        assert_eq!(blocks(&stream(folder.path(), &records, 5)).unwrap()[2], (20, 29));
        std::fs::write(folder.path().join("b"), b"SBRAW2\0\0").unwrap();
        let error = blocks(&folder.path().join("b")).unwrap_err().to_string();
        assert!(error.contains("not an .sbraw stream"), "{error}");
    }
}
