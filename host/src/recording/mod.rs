//! Recordings: four-channel WAV and FLAC files, miniSEED, and `.sbraw` streams, as blocks of 24-bit codes, and writing them.
//!
//! Enters: files or folders, in any order. Leaves: [`BlockSource::next_block`], blocks whose sample index counts from the
//! first sample of the first file. Conventions:
//!
//! - Codes are those of a 24-bit converter, full scale ±2²³. 24-bit files come through as they are; 32-bit integers
//!   lose their lowest eight bits; 16-bit codes are multiplied by 256, and the greatest one (32767) becomes 2²³ − 1, so
//!   that what was clipped in the file is clipped for the recorder; floating point is multiplied by 2²³, rounded and
//!   clipped. A NaN or an infinity becomes [`seabearing_core::block::MISSING`].
//! - Time: a file's start is taken from its sidecar `FILE.start` (one RFC 3339 time) or from its name (see
//!   [`written_time`]). Where one file ends and the next starts within the resolution of these times and a clock drift of
//!   50 ppm, they follow one another; otherwise the index jumps, forward (a gap) or back (an overlap), and the core
//!   accounts for it. Files without a time follow one another in the order given.
//! - A damaged, foreign or wrongly sampled file among good ones is left out with one line on stderr; what is whole of a
//!   truncated file is used. It is an error only when nothing is left.
//!
//! Cost: blocks of 16384 frames are decoded in bulk; `cargo bench -p seabearing --bench recording` prints how fast, beside
//! `hound`'s sample by sample.

mod flac;
mod mseed;
pub(crate) mod mseed_record;
mod raw;
mod sequence;
mod wav;
pub mod write;
pub mod written_time;

use crate::station::Station;
use anyhow::{Context, Result, bail};
use seabearing_core::block::Block;
use std::io::Read;
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

/// Where blocks of samples come from.
pub trait BlockSource {
    /// UTC of sample 0, where the recording has a clock.
    fn start(&self) -> Option<OffsetDateTime>;

    /// Index after the last sample promised by the files' headers, where known (for progress).
    fn expected_end(&self) -> Option<u64>;

    /// The next block; `None` at the end. Indices jump where there are gaps.
    ///
    /// # Errors
    /// The source is lost for good. (A damaged file in a sequence is reported and passed over, not an error.)
    fn next_block(&mut self) -> Result<Option<Block<'_>>>;
}

/// What a file holds, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// RIFF, RF64 or BW64 WAVE.
    Wav,
    /// FLAC.
    Flac,
    /// miniSEED, version 2 or 3.
    MiniSeed,
    /// A stream of codes with their indices.
    Raw,
}

impl Container {
    /// Looks at the first bytes of a file; `None` where they are of none of these.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of(path: &Path) -> Result<Option<Self>> {
        let mut head = [0u8; 12];
        let file = std::fs::File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        let mut got = 0;
        let mut file = file.take(12);
        while let Some(space) = head.get_mut(got..).filter(|s| !s.is_empty()) {
            match file.read(space).with_context(|| format!("cannot read {}", path.display()))? {
                0 => break,
                n => got += n,
            }
        }
        Ok(match &head {
            [b'R', b'I', b'F', b'F', .., b'W', b'A', b'V', b'E'] => Some(Self::Wav),
            [b'R', b'F', b'6', b'4', .., b'W', b'A', b'V', b'E'] => Some(Self::Wav),
            [b'B', b'W', b'6', b'4', .., b'W', b'A', b'V', b'E'] => Some(Self::Wav),
            [b'f', b'L', b'a', b'C', ..] => Some(Self::Flac),
            [b'M', b'S', 3, ..] => Some(Self::MiniSeed),
            [magic @ .., _, _, _, _] if *magic == seabearing_core::sbraw::MAGIC => Some(Self::Raw),
            // Version 2: six digits of sequence number, then a quality letter.
            [number @ .., _, _, _, _, _, _]
                if number.iter().all(u8::is_ascii_digit) && matches!(head[6], b'D' | b'R' | b'Q' | b'M') =>
            {
                Some(Self::MiniSeed)
            }
            _ => None,
        })
    }
}

/// Opens recordings for a station: files, or folders whose recordings are all taken. `start` is the time of the first
/// sample where neither name nor sidecar tells it.
///
/// # Errors
/// Nothing usable was found; the line names the file and what to do.
pub fn open(
    paths: &[PathBuf],
    station: &Station,
    start: Option<OffsetDateTime>,
) -> Result<Box<dyn BlockSource>> {
    let files = expand(paths)?;
    let mut audio = Vec::new();
    let mut seismic = Vec::new();
    let mut complaints = Vec::new();
    if let [path] = &files[..]
        && Container::of(path)? == Some(Container::Raw)
    {
        return Ok(Box::new(raw::Raw::open(path, start)?));
    }
    for path in files {
        match Container::of(&path) {
            Ok(Some(Container::Raw)) => {
                bail!("{}: an .sbraw stream has indices of its own; give it alone", path.display())
            }
            Ok(Some(Container::MiniSeed)) => seismic.push(path),
            Ok(Some(container)) => audio.push((path, container)),
            Ok(None) => complaints.push(format!("{}: {}", path.display(), foreign(&path))),
            Err(e) => complaints.push(format!("{e:#}")),
        }
    }
    if !seismic.is_empty() && !audio.is_empty() {
        bail!("{}: give either miniSEED or WAV and FLAC files, not both", seismic[0].display());
    }
    if !seismic.is_empty() {
        for complaint in complaints {
            eprintln!("seabearing: left out {complaint}");
        }
        return Ok(Box::new(mseed::MiniSeed::open(seismic, station)?));
    }
    Ok(Box::new(sequence::Sequence::open(audio, &station.config, start, complaints)?))
}

/// Why a file is no recording.
fn foreign(path: &Path) -> &'static str {
    match std::fs::metadata(path).map(|m| m.len()) {
        Ok(0) => "empty file; a recording (WAV, FLAC, miniSEED or .sbraw) was expected",
        _ => "not a recording (WAV, FLAC, miniSEED or .sbraw expected)",
    }
}

/// Folders become the recordings in them, by name.
fn expand(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let entries =
            std::fs::read_dir(path).with_context(|| format!("cannot read folder {}", path.display()))?;
        let known = |p: &PathBuf| {
            let ending = p.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
            matches!(ending.as_deref(), Some("wav" | "flac" | "mseed" | "msd" | "ms3" | "seed" | "sbraw"))
        };
        let mut inside: Vec<PathBuf> =
            entries.filter_map(|e| e.ok().map(|e| e.path())).filter(known).collect();
        if inside.is_empty() {
            bail!("{}: no recording (.wav, .flac, .mseed, .sbraw) in this folder", path.display());
        }
        inside.sort();
        files.extend(inside);
    }
    if files.is_empty() {
        bail!("no recording given");
    }
    Ok(files)
}
