//! Several files as one recording: their order, the gaps between them, and what to do with bad ones.

use super::flac::Flac;
use super::stamp::Stamp;
use super::wav::{Info, Wav};
use super::{Container, Source};
use anyhow::{Result, anyhow, bail};
use seabearing_core::block::{Block, CHANNELS, Frame};
use seabearing_core::config::StationConfig;
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

/// Drift of a recorder's clock against the times in file names that is not taken for a gap: 50 parts in a million,
/// the tolerance of an ordinary crystal over temperature.
const DRIFT: f64 = 50e-6;

enum Audio {
    Wav(Wav),
    Flac(Flac),
}

impl Audio {
    fn open(path: &Path, container: Container) -> Result<(Self, Info)> {
        if container == Container::Flac {
            Flac::open(path).map(|(f, i)| (Self::Flac(f), i))
        } else {
            Wav::open(path).map(|(f, i)| (Self::Wav(f), i))
        }
    }

    fn read(&mut self, out: &mut Vec<Frame>) -> Result<()> {
        match self {
            Self::Wav(wav) => wav.read(out),
            Self::Flac(flac) => flac.read(out),
        }
    }
}

/// One file of the sequence.
struct Part {
    path: PathBuf,
    container: Container,
    info: Info,
    stamp: Option<Stamp>,
    first_index: u64,
}

/// Files in order of time.
pub(super) struct Sequence {
    parts: std::vec::IntoIter<Part>,
    current: Option<(PathBuf, Audio, Info)>,
    next_index: u64,
    file_start: u64,
    end: u64,
    rate_hz: f64,
    start: Option<OffsetDateTime>,
    frames: Vec<Frame>,
}

fn complain(what: &str) {
    eprintln!("seabearing: {what}");
}

impl Sequence {
    /// Looks at every header. `complaints` are those of files already left out.
    ///
    /// # Errors
    /// No file is usable: the first complaint says why.
    pub(super) fn open(
        files: Vec<(PathBuf, Container)>,
        config: &StationConfig,
        start: Option<OffsetDateTime>,
        mut complaints: Vec<String>,
    ) -> Result<Self> {
        let mut parts = Vec::new();
        for (path, container) in files {
            match examine(&path, container, config) {
                Ok(part) => parts.push(part),
                Err(e) => complaints.push(format!("{e:#}")),
            }
        }
        if parts.is_empty() {
            let rest = complaints.len().saturating_sub(1);
            let first = complaints.into_iter().next().unwrap_or_else(|| "no recording given".to_owned());
            match rest {
                0 => bail!("{first}"),
                n => bail!("{first} ({n} more files are not usable either)"),
            }
        }
        for c in &complaints {
            complain(&format!("left out {c}"));
        }
        if parts.iter().all(|p| p.stamp.is_some()) {
            parts.sort_by_key(|p| p.stamp.map(|s| s.at));
        }
        let end = place(&mut parts, config.rate_hz);
        let start = parts.first().and_then(|p| p.stamp).map(|s| s.at).or(start);
        Ok(Self {
            parts: parts.into_iter(),
            current: None,
            next_index: 0,
            file_start: 0,
            end,
            rate_hz: config.rate_hz,
            start,
            frames: Vec::new(),
        })
    }

    /// Says so when a file gave less than its header promised.
    fn finish(&self, path: &Path, info: &Info, why: Option<&anyhow::Error>) {
        let got = self.next_index - self.file_start;
        let t = got as f64 / self.rate_hz;
        let cause = why.map_or_else(String::new, |e| format!(" ({e})"));
        match info.promised {
            Some(promised) if got < promised => complain(&format!(
                "{}: cut short or damaged{cause}: its first {t:.3} s of {:.3} s are used",
                path.display(),
                promised as f64 / self.rate_hz
            )),
            _ if why.is_some() => {
                complain(&format!(
                    "{}: damaged after {t:.3} s{cause}: what came before is used",
                    path.display()
                ));
            }
            _ => {}
        }
    }
}

/// A file's header and time, if it suits the station.
fn examine(path: &Path, container: Container, config: &StationConfig) -> Result<Part> {
    let (_, info) = Audio::open(path, container)?;
    let name = path.display();
    if usize::from(info.channels) != CHANNELS {
        bail!("{name}: {} channels, a recorder has four: merge or choose channels first", info.channels);
    }
    if (info.rate_hz - config.rate_hz).abs() > 1e-3 * config.rate_hz.max(1.0) {
        bail!(
            "{name}: {} samples a second, the station file says {}: correct `rate_hz` there or resample",
            info.rate_hz,
            config.rate_hz
        );
    }
    if info.frames == Some(0) {
        bail!("{name}: holds no samples");
    }
    Ok(Part { path: path.to_owned(), container, info, stamp: stamp(path)?, first_index: 0 })
}

/// The start time in the sidecar `FILE.start`, else in the name.
fn stamp(path: &Path) -> Result<Option<Stamp>> {
    let mut sidecar = path.as_os_str().to_owned();
    sidecar.push(".start");
    match std::fs::read_to_string(&sidecar) {
        Ok(text) => Stamp::parse(&text).map(Some).ok_or_else(|| {
            anyhow!("{}: not a time; 2024-01-31T12:00:00Z was expected", sidecar.to_string_lossy())
        }),
        Err(_) => Ok(path.file_name().and_then(|n| n.to_str()).and_then(Stamp::in_name)),
    }
}

/// Gives every part its first index; the index after the last sample.
fn place(parts: &mut [Part], rate_hz: f64) -> u64 {
    let mut next = 0u64;
    let mut origin: Option<Stamp> = None;
    for part in parts {
        part.first_index = next;
        if let (Some(zero), Some(stamp)) = (origin, part.stamp) {
            let at = (stamp.at - zero.at).as_seconds_f64() * rate_hz;
            let jump = at - next as f64;
            let tolerance = zero.resolution_s.max(stamp.resolution_s) * rate_hz + DRIFT * at.abs() + 1.5;
            if jump.abs() > tolerance && at >= 0.0 {
                part.first_index = at.round() as u64;
            }
        }
        origin = origin.or(part.stamp);
        let length = part.info.promised.max(part.info.frames).unwrap_or(0);
        next = part.first_index.saturating_add(length);
    }
    next
}

impl Source for Sequence {
    fn start(&self) -> Option<OffsetDateTime> {
        self.start
    }

    fn expected_end(&self) -> Option<u64> {
        Some(self.end)
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        loop {
            let Some((path, mut audio, info)) = self.current.take() else {
                let Some(part) = self.parts.next() else { return Ok(None) };
                match Audio::open(&part.path, part.container) {
                    Ok((audio, info)) => self.current = Some((part.path, audio, info)),
                    Err(e) => complain(&format!("left out {e:#}")),
                }
                self.next_index = part.first_index;
                self.file_start = part.first_index;
                continue;
            };
            match audio.read(&mut self.frames) {
                Ok(()) if self.frames.is_empty() => self.finish(&path, &info, None),
                Ok(()) => {
                    self.current = Some((path, audio, info));
                    let first_index = self.next_index;
                    self.next_index += self.frames.len() as u64;
                    return Ok(Some(Block { first_index, frames: &self.frames }));
                }
                Err(e) => self.finish(&path, &info, Some(&e)),
            }
        }
    }
}
