//! Recordings: WAV and FLAC files, miniSEED, SAC, and `.sbraw` streams, as blocks of four 24-bit codes, and writing them.
//!
//! Enters: files or folders with folders in them, in any order; what a file is its first bytes say. Leaves: a [`Recording`],
//! which knows what there is and when it was, and of it [`BlockSource::next_block`], blocks at the recorder's rate whose
//! sample index counts from the first sample of the first file, or of a span of time. Conventions:
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
//! - Files of a recorder's card ([`crate::card`]) have the indices that the recorder gave.
//! - A station on a SeedLink server is a recording that goes on ([`BlockSource::is_live`]).
//!
//! Cost: blocks of 16384 frames are decoded in bulk; `cargo bench -p seabearing --bench recording` prints how fast, beside
//! `hound`'s sample by sample.

mod card;
mod equalise;
mod flac;
mod invalid;
mod memory;
mod mseed;
pub(crate) mod mseed_record;
mod mseed_scan;
mod mseed_strays;
mod pick;
mod placing;
mod rate;
mod raw;
mod resample;
mod sac;
mod seedlink;
mod sequence;
mod wav;
mod window;
pub mod write;
pub mod written_time;

use crate::station::Station;
use crate::station::response::Response;
use anyhow::{Context, Result, bail};
use seabearing_core::block::{Block, CHANNELS, Frame};
use seabearing_core::config::Kind;
use std::collections::BTreeSet;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use time::{Date, OffsetDateTime, UtcOffset};

pub(crate) use equalise::WATER_LEVEL;
pub use window::Span;

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

    /// Where what comes next follows samples that the recorder left out on purpose (its schedule, or sound away from detections): the
    /// index at which they end, once. To be asked before each [`Self::next_block`].
    ///
    /// # Errors
    /// As [`Self::next_block`].
    fn left_out(&mut self) -> Result<Option<u64>> {
        Ok(None)
    }

    /// Whether blocks come as they are recorded, so that what is said of them is wanted at once.
    fn is_live(&self) -> bool {
        false
    }
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
    /// SAC.
    Sac,
    /// A stream of codes with their indices.
    Raw,
}

impl Container {
    /// Looks at the first bytes of a file; `None` where they are of none of these.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of(path: &Path) -> Result<Option<Self>> {
        const LOOKED_AT: usize = sac::VERSION_AT + 4;
        let mut head = [0u8; LOOKED_AT];
        let file = std::fs::File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        let mut got = 0;
        let mut file = file.take(LOOKED_AT as u64);
        while let Some(space) = head.get_mut(got..).filter(|s| !s.is_empty()) {
            match file.read(space).with_context(|| format!("cannot read {}", path.display()))? {
                0 => break,
                n => got += n,
            }
        }
        let (start, rest) = head.split_at(12);
        let start: &[u8; 12] = start.try_into()?;
        Ok(match start {
            [b'R', b'I', b'F', b'F', .., b'W', b'A', b'V', b'E'] => Some(Self::Wav),
            [b'R', b'F', b'6', b'4', .., b'W', b'A', b'V', b'E'] => Some(Self::Wav),
            [b'B', b'W', b'6', b'4', .., b'W', b'A', b'V', b'E'] => Some(Self::Wav),
            head if flac::begins(head) => Some(Self::Flac),
            [b'M', b'S', 3, ..] => Some(Self::MiniSeed),
            [magic @ .., _, _, _, _] if *magic == seabearing_core::sbraw::MAGIC => Some(Self::Raw),
            // Version 2: six digits of sequence number, then a quality letter.
            [number @ .., _, _, _, _, _, _]
                if number.iter().all(|b| b.is_ascii_digit() || *b == b' ')
                    && matches!(start[6], b'D' | b'R' | b'Q' | b'M') =>
            {
                Some(Self::MiniSeed)
            }
            _ => {
                let version = rest.last_chunk().copied().filter(|_| got == LOOKED_AT);
                version.and_then(sac::Order::of).map(|_| Self::Sac)
            }
        })
    }
}

/// What is asked of recordings beside what the station file says.
#[derive(Clone, Copy, Debug, Default)]
pub struct Asked {
    /// UTC of the first sample, where neither name nor sidecar tells it.
    pub start: Option<OffsetDateTime>,
    /// What lies outside need not be looked at.
    pub span: Span,
    /// Offset of the times in files' names from UTC, where the names do not tell it.
    pub name_offset: Option<UtcOffset>,
}

/// The recordings of a station, looked at and not yet read.
pub struct Recording {
    found: Found,
    start: Option<OffsetDateTime>,
    /// The recorder's samples a second, and the code that means clipping.
    rate_hz: f64,
    full_scale: i32,
    /// Whether spikes are put right before the rate is changed: the recorder does so, which hears samples of its own rate.
    mends: bool,
    /// What is taken out of the components of motion and pressure.
    responses: [Option<Response>; CHANNELS],
    /// Offset of the times in names from UTC, where somebody told it.
    name_offset: Option<UtcOffset>,
}

enum Found {
    Audio(sequence::Parts),
    Seismic(Box<mseed::Components>),
    Card(card::Pieces),
    Raw(PathBuf),
    /// Samples, and how many there are in a second.
    Memory(Arc<[Frame]>, f64),
    /// A station on a server, from now on.
    Live(Box<seedlink::Remote>),
}

impl Recording {
    /// Looks for a station's recordings in files and folders.
    ///
    /// # Errors
    /// Nothing usable was found; the line names the file and what to do.
    pub fn find(paths: &[PathBuf], station: &Station, asked: &Asked) -> Result<Self> {
        if let Some(remote) = paths.iter().find(|path| seedlink::Address::is_one(path)) {
            if paths.len() > 1 {
                bail!("{}: give one station of a server, and nothing else", remote.display());
            }
            let found = Found::Live(Box::new(seedlink::Remote::of(remote, station)?));
            let config = &station.config;
            return Ok(Self {
                found,
                start: asked.start,
                rate_hz: config.rate_hz,
                full_scale: config.full_scale,
                mends: matches!(config.kind, Kind::Obs(_)),
                responses: station.responses.clone(),
                name_offset: None,
            });
        }
        let files = expand(paths, station.seed_id.as_deref(), asked.span)?;
        let mut audio = Vec::new();
        let mut recorded = Vec::new();
        let mut seismic = Vec::new();
        let mut complaints = Vec::new();
        let config = &station.config;
        let of = |found| Self {
            found,
            start: asked.start,
            rate_hz: config.rate_hz,
            full_scale: config.full_scale,
            mends: matches!(config.kind, Kind::Obs(_)),
            responses: station.responses.clone(),
            name_offset: asked.name_offset.or(station.name_offset),
        };
        if let [(path, _)] = &files[..]
            && Container::of(path)? == Some(Container::Raw)
        {
            return Ok(of(Found::Raw(path.clone())));
        }
        for (path, named) in files {
            let container = Container::of(&path);
            if let Ok(Some(container)) = &container {
                log::debug!("{}: {container:?}", path.display());
            }
            match container {
                Ok(Some(Container::Raw)) => {
                    bail!("{}: an .sbraw stream has indices of its own; give it alone", path.display())
                }
                Ok(Some(container @ (Container::MiniSeed | Container::Sac))) => {
                    seismic.push((path, container))
                }
                Ok(Some(container)) => match of_card(container, &path) {
                    Some(file) => recorded.push(file),
                    None => audio.push((path, container)),
                },
                // What else lies in a folder is passed over.
                Ok(None) if !named => {}
                Ok(None) => complaints.push(format!("{}: {}", path.display(), foreign(&path))),
                Err(e) => complaints.push(format!("{e:#}")),
            }
        }
        if !recorded.is_empty() {
            for (path, _) in audio.iter().chain(&seismic) {
                complain(&format!("left out {}: it is not of the recorder's card", path.display()));
            }
            let Some(pieces) = card::Pieces::of(recorded) else { bail!("nothing is recorded on the card") };
            if (pieces.rate_hz / config.rate_hz - 1.0).abs() > 1e-3 {
                bail!(
                    "the card has {} samples a second, the station file says {}: correct `rate_hz` there",
                    pieces.rate_hz,
                    config.rate_hz
                );
            }
            return Ok(of(Found::Card(pieces)));
        }
        if !seismic.is_empty() && !audio.is_empty() {
            let path = seismic[0].0.display();
            bail!("{path}: give either miniSEED and SAC or WAV and FLAC files, not both");
        }
        if !seismic.is_empty() {
            for complaint in complaints {
                complain(&format!("left out {complaint}"));
            }
            return Ok(of(Found::Seismic(Box::new(mseed::Components::find(seismic, station)?))).said());
        }
        let reading = sequence::Reading {
            rate_hz: config.rate_hz,
            channels: station.file_channels,
            least: match &config.kind {
                Kind::Line(line) => {
                    station.line.channels.iter().max().map_or(line.sensors, |c| c.saturating_add(1)).into()
                }
                _ => 0,
            },
            offset: asked.name_offset.or(station.name_offset).unwrap_or(UtcOffset::UTC),
        };
        Ok(of(Found::Audio(sequence::Parts::find(audio, &reading, complaints)?)).said())
    }

    /// Codes of a station's recorder that are in memory already, of which there are so many in a second.
    ///
    /// # Errors
    /// No sensible rate.
    pub fn of_frames(frames: Vec<Frame>, rate_hz: f64, station: &Station, asked: &Asked) -> Result<Self> {
        if !(rate_hz > 0.0 && rate_hz.is_finite()) {
            bail!("{rate_hz} samples a second: a number above 0 was expected");
        }
        let config = &station.config;
        let found = Found::Memory(frames.into(), rate_hz);
        let (rate_hz, full_scale) = (config.rate_hz, config.full_scale);
        Ok(Self {
            found,
            start: asked.start,
            rate_hz,
            full_scale,
            mends: matches!(config.kind, Kind::Obs(_)),
            responses: station.responses.clone(),
            name_offset: None,
        })
    }

    /// Offset of the times in names from UTC, where somebody told it.
    pub fn name_offset(&self) -> Option<UtcOffset> {
        self.name_offset
    }

    /// The same, said what is done where its rate is far above the recorder's.
    fn said(self) -> Self {
        rate::said(self.file_rate_hz(), self.rate_hz).iter().for_each(|said| complain(said));
        self
    }

    /// Samples a second in the files.
    fn file_rate_hz(&self) -> f64 {
        match &self.found {
            Found::Audio(parts) => parts.rate_hz,
            Found::Seismic(components) => components.rate_hz,
            Found::Card(pieces) => pieces.rate_hz,
            Found::Raw(_) => self.rate_hz,
            Found::Memory(_, rate_hz) => *rate_hz,
            Found::Live(_) => self.rate_hz,
        }
    }

    /// The days (UTC) on which something was recorded; `None` where the files do not tell when they were.
    pub fn days(&self) -> Option<BTreeSet<Date>> {
        let spans = match &self.found {
            Found::Audio(parts) => parts.spans()?,
            Found::Seismic(components) => components.spans(),
            Found::Card(pieces) => pieces.spans()?,
            Found::Raw(_) | Found::Memory(..) | Found::Live(_) => return None,
        };
        let mut days = BTreeSet::new();
        for (begins, ends) in spans {
            // What ends at midnight has nothing of the day after.
            let last = (ends - time::Duration::nanoseconds(1)).date();
            let mut day = begins.date();
            while day <= last {
                days.insert(day);
                let Some(next) = day.next_day() else { break };
                day = next;
            }
        }
        Some(days)
    }

    /// The files that hold something of a span of time.
    pub fn files(&self, span: Span) -> Vec<PathBuf> {
        match &self.found {
            Found::Audio(parts) => parts.files(span),
            Found::Seismic(components) => components.files(span),
            Found::Card(pieces) => pieces.files(),
            Found::Raw(path) => vec![path.clone()],
            Found::Memory(..) | Found::Live(_) => Vec::new(),
        }
    }

    /// Whether it goes on: it can be read once, from now on.
    pub fn is_live(&self) -> bool {
        matches!(self.found, Found::Live(_))
    }

    /// The samples of a span of time at the recorder's rate. Index 0 is the first of them.
    ///
    /// # Errors
    /// There are none, or the recording does not tell when it was.
    pub fn source(&self, span: Span) -> Result<Box<dyn BlockSource>> {
        let rate_hz = self.file_rate_hz();
        let mut source: Box<dyn BlockSource> = match &self.found {
            Found::Audio(parts) => {
                let mut sequence = parts.sequence(span, self.start)?;
                if let Some((start, from)) = sequence.start().zip(span.from) {
                    sequence.skip_to(window::index_at(start, from, rate_hz));
                }
                Box::new(sequence)
            }
            Found::Seismic(components) => Box::new(components.recording(span)?),
            Found::Card(pieces) => Box::new(pieces.open(self.start)),
            Found::Raw(path) => Box::new(raw::Raw::open(path, self.start)?),
            Found::Live(remote) => Box::new(remote.open(span)?),
            Found::Memory(frames, _) => Box::new(memory::Memory::new(Arc::clone(frames), self.start)),
        };
        if !span.is_all() {
            let Some(start) = source.start() else {
                bail!(
                    "the recording does not tell when it was: no part of it can be chosen {span} (--start tells it)"
                )
            };
            source = Box::new(window::Window::new(source, start, rate_hz, span));
        }
        if (rate_hz / self.rate_hz - 1.0).abs() > 1e-3 {
            let resampled = resample::Resampled::new(source, rate_hz, self.rate_hz, self.full_scale);
            source = Box::new(if self.mends { resampled.mending() } else { resampled });
        }
        // A raw stream or a card is what the recorder itself hears.
        if self.responses.iter().any(Option::is_some) && !matches!(self.found, Found::Raw(_) | Found::Card(_))
        {
            source =
                Box::new(equalise::Equalised::new(source, self.rate_hz, &self.responses, self.full_scale));
        }
        Ok(source)
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
    Recording::find(paths, station, &Asked { start, ..Asked::default() })?.source(Span::default())
}

/// Says on standard error what is odd about a recording.
pub(crate) fn complain(what: &str) {
    log::warn!("{what}");
}

/// A file of a recorder's card among WAV files.
fn of_card(container: Container, path: &Path) -> Option<crate::card::CardFile> {
    (container == Container::Wav).then(|| crate::card::recorded(path)).flatten()
}

/// Whether a file's name says that it is a recording.
fn is_named_as_one(path: &Path) -> bool {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    extension.is_some_and(|e| ["wav", "flac", "mseed", "sac", "sbraw"].contains(&e.as_str()))
}

/// Why a file is no recording.
fn foreign(path: &Path) -> &'static str {
    match std::fs::metadata(path).map(|m| m.len()) {
        Ok(0) => "empty file; a recording (WAV, FLAC, miniSEED, SAC or .sbraw) was expected",
        _ => "not a recording (WAV, FLAC, miniSEED, SAC or .sbraw expected)",
    }
}

/// Folders become the files in them and in folders in them, by name; whether a file was named itself. In an SDS archive
/// (`NET.STA.LOC.CHA.TYPE.YEAR.DAY`) files of other stations and of days outside a span are not looked at.
fn expand(paths: &[PathBuf], seed_id: Option<&str>, span: Span) -> Result<Vec<(PathBuf, bool)>> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push((path.clone(), true));
            continue;
        }
        let before = files.len();
        let (mut folders, mut passed) = (vec![path.clone()], false);
        while let Some(folder) = folders.pop() {
            let cannot = || format!("cannot read folder {}", folder.display());
            let entries = std::fs::read_dir(&folder).with_context(cannot)?;
            for entry in entries {
                let path = entry.with_context(cannot)?.path();
                let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
                if path.is_dir() && !hidden {
                    folders.push(path);
                } else if is_outside(&path, seed_id, span) {
                    passed = true;
                } else if !hidden && path.is_file() {
                    if Container::of(&path).is_ok_and(|c| c.is_some()) {
                        files.push((path, false));
                    } else if is_named_as_one(&path) {
                        log::warn!("{}: {}; left out", path.display(), foreign(&path));
                    }
                }
            }
        }
        files[before..].sort_by_cached_key(|(path, _)| pick::natural(&path.to_string_lossy()));
        if files.len() == before {
            let name = path.display();
            match passed {
                true => bail!("{name}: no recording {span} of the station in this folder"),
                false => bail!("{name}: no recording (WAV, FLAC, miniSEED, SAC, .sbraw) in this folder"),
            }
        }
    }
    if files.is_empty() {
        bail!("no recording given");
    }
    Ok(files)
}

/// Whether the name of a file of an SDS archive says that it holds nothing of a span of time or of a station.
fn is_outside(path: &Path, seed_id: Option<&str>, span: Span) -> bool {
    let name = path.file_name().and_then(|n| n.to_str()).unwrap_or("");
    let fields: Vec<&str> = name.split('.').collect();
    let [network, station, location, _, "D", year, day] = fields[..] else { return false };
    let date = year.parse().ok().zip(day.parse().ok()).and_then(|(y, d)| Date::from_ordinal_date(y, d).ok());
    let Some(midnight) = date.map(|d| d.midnight().assume_utc()) else { return false };
    let id = format!("{network}.{station}.{location}");
    // A file may begin or end with a record that reaches over midnight.
    let hour = time::Duration::HOUR;
    seed_id.is_some_and(|wanted| !mseed::is_of(&id, wanted))
        || !span.meets((midnight - hour, midnight + 25 * hour))
}
