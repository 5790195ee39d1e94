//! Several files as one recording: their order, the gaps between them, and what to do with bad ones.

use super::invalid::Invalid;
use super::pick::{Audio, FIRST, Joined, Source, natural, without_last_number};
use super::placing::{self, Stretch};
use super::wav::Info;
use super::written_time::WrittenTime;
use super::{BlockSource, Container, Span, complain};
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::block::{Block, CHANNELS, Frame};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use time::{Duration, OffsetDateTime, UtcOffset};

/// One file of the sequence, or several that hold its channels.
#[derive(Clone)]
pub(super) struct Part {
    source: Source,
    info: Info,
    stamp: Option<WrittenTime>,
    first_index: u64,
}

impl Part {
    /// Its (first) file.
    fn path(&self) -> &Path {
        self.source.files.first().map_or(Path::new(""), |(path, _)| path)
    }

    /// Samples that are there, or were to be.
    fn samples(&self) -> u64 {
        self.info.promised.max(self.info.frames).unwrap_or(0)
    }

    /// When it began and ended, where its start is known.
    fn span(&self, rate_hz: f64) -> Option<(OffsetDateTime, OffsetDateTime)> {
        let at = self.stamp?.at;
        let seconds = self.samples() as f64 / rate_hz;
        Some((at, at.checked_add(Duration::checked_seconds_f64(seconds)?)?))
    }
}

/// WAV and FLAC files in order of time, looked at and not yet read.
#[derive(Clone)]
pub(super) struct Parts {
    parts: Vec<Part>,
    /// Samples a second of all of them.
    pub rate_hz: f64,
}

/// Files in order of time.
pub(super) struct Sequence {
    parts: std::vec::IntoIter<Part>,
    current: Option<(Part, Joined)>,
    /// Of the current one.
    invalid: Invalid,
    next_index: u64,
    file_start: u64,
    /// Frames of the next file to pass over.
    skip: u64,
    end: u64,
    rate_hz: f64,
    start: Option<OffsetDateTime>,
    frames: Vec<Frame>,
}

/// Leaves out every file that begins when the one before it does, of files in order of their times and of equal times
/// the longest first. Files shorter than their names tell the time may follow each other under one time.
fn leave_out_copies(parts: &mut Vec<Part>, rate_hz: f64) {
    parts.dedup_by(|later, earlier| {
        let (Some(this), Some(that)) = (later.stamp, earlier.stamp) else { return false };
        let long = earlier.info.frames.is_none_or(|n| n as f64 >= that.resolution_s * rate_hz);
        let copy = this.at == that.at && long;
        if copy {
            let (later, earlier) = (later.path().display(), earlier.path().display());
            complain(&format!("left out {later}: it begins when {earlier} does"));
        }
        copy
    });
}

/// How files are to be understood.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    /// The recorder's samples a second.
    pub rate_hz: f64,
    /// Channels of the file for the recorder's, where the station file names them.
    pub channels: Option<[u8; CHANNELS]>,
    /// Channels that a file must have to be a recording by itself; of a line more than the four that are read at a time.
    pub least: usize,
    /// Offset of the times in names from UTC.
    pub offset: UtcOffset,
}

impl Parts {
    /// Looks at every header. `complaints` are those of files already left out.
    ///
    /// # Errors
    /// No file is usable: the first complaint says why.
    pub(super) fn find(
        files: Vec<(PathBuf, Container)>,
        reading: &Reading,
        mut complaints: Vec<String>,
    ) -> Result<Self> {
        let mut found = Vec::new();
        for (path, container) in files {
            match examine(path, container, reading) {
                Ok(part) => found.push(part),
                Err(e) => complaints.push(format!("{e:#}")),
            }
        }
        let mut parts = together(found, reading, &mut complaints);
        // Files at the recorder's rate, or where there are none at that of the first.
        let same = |a: f64, b: f64| (a - b).abs() <= 1e-3 * b.max(1.0);
        let rates: Vec<f64> = parts.iter().map(|p| p.info.rate_hz).collect();
        let own = rates.iter().any(|r| same(*r, reading.rate_hz));
        let rate_hz = if own { reading.rate_hz } else { rates.first().copied().unwrap_or(reading.rate_hz) };
        parts.retain(|p| {
            let (here, rate) = (p.path().display(), p.info.rate_hz);
            if !same(rate, rate_hz) {
                complaints.push(format!("{here}: {rate} samples a second, the other files have {rate_hz}"));
            } else if rate_hz < 0.999 * reading.rate_hz {
                complaints.push(format!(
                    "{here}: {rate} samples a second, the station file says {}: correct `rate_hz` there",
                    reading.rate_hz
                ));
            } else {
                return true;
            }
            false
        });
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
            parts.sort_by_key(|p| (p.stamp.map(|s| s.at), std::cmp::Reverse(p.info.frames)));
            leave_out_copies(&mut parts, rate_hz);
        }
        for one in placing::place(&stretches(&parts), rate_hz).doubtful {
            complain(&format!("{}: {}", parts[one.file].path().display(), one.said(rate_hz)));
        }
        Ok(Self { parts, rate_hz })
    }

    /// When each part began and ended; `None` where one does not tell it.
    pub(super) fn spans(&self) -> Option<Vec<(OffsetDateTime, OffsetDateTime)>> {
        self.parts.iter().map(|p| p.span(self.rate_hz)).collect()
    }

    /// The files that hold something of a span of time.
    pub(super) fn files(&self, span: Span) -> Vec<PathBuf> {
        let inside = self.within(span);
        inside.iter().flat_map(|p| p.source.files.iter().map(|(path, _)| path.clone())).collect()
    }

    fn within(&self, span: Span) -> Vec<Part> {
        let inside = |p: &&Part| p.span(self.rate_hz).is_none_or(|own| span.meets(own));
        self.parts.iter().filter(inside).cloned().collect()
    }

    /// What was recorded in a span of time, from the first part that reaches into it.
    ///
    /// # Errors
    /// Nothing was.
    pub(super) fn sequence(&self, span: Span, start: Option<OffsetDateTime>) -> Result<Sequence> {
        let mut parts = self.within(span);
        if parts.is_empty() {
            bail!("nothing was recorded {span}");
        }
        let placed = placing::place(&stretches(&parts), self.rate_hz);
        parts.iter_mut().zip(placed.first).for_each(|(part, index)| part.first_index = index);
        let start = parts.first().and_then(|p| p.stamp).map(|s| s.at).or(start);
        Ok(Sequence {
            parts: parts.into_iter(),
            current: None,
            invalid: Invalid::default(),
            next_index: 0,
            file_start: 0,
            skip: 0,
            end: placed.end,
            rate_hz: self.rate_hz,
            start,
            frames: Vec::new(),
        })
    }
}

/// When parts began, and how long they are.
fn stretches(parts: &[Part]) -> Vec<Stretch> {
    let of = |p: &Part| Stretch { stamp: p.stamp, samples: p.samples() };
    parts.iter().map(of).collect()
}

/// Parts of the recorder's channels each, from files of any number of channels.
fn together(found: Vec<Part>, reading: &Reading, complaints: &mut Vec<String>) -> Vec<Part> {
    let named = reading.channels.map(|w| w.map(usize::from));
    let least = named.map_or(CHANNELS, |n| n.iter().max().map_or(CHANNELS, |m| m + 1)).max(reading.least);
    let mut parts = Vec::new();
    let mut groups: BTreeMap<(Option<OffsetDateTime>, String), Vec<Part>> = BTreeMap::new();
    for mut part in found {
        let channels = usize::from(part.info.channels);
        if channels < least {
            let common = if part.stamp.is_some() { String::new() } else { without_last_number(part.path()) };
            groups.entry((part.stamp.map(|s| s.at), common)).or_default().push(part);
        } else if channels > CHANNELS && named.is_none() {
            complaints.push(format!(
                "{}: {channels} channels, a recorder has four: name them, `channels = [0, 1, 2, 3]` in [array]",
                part.path().display()
            ));
        } else {
            part.source.pick = named.unwrap_or(FIRST).map(|channel| (0, channel));
            parts.push(part);
        }
    }
    for (_, mut group) in groups {
        group.sort_by_cached_key(|p| natural(&p.path().to_string_lossy()));
        let places: Vec<(usize, usize)> = (0..)
            .zip(&group)
            .flat_map(|(file, p)| (0..usize::from(p.info.channels)).map(move |channel| (file, channel)))
            .collect();
        let pick = named.unwrap_or(FIRST).map(|c| places.get(c).copied());
        let [Some(a), Some(b), Some(c), Some(d)] = pick else {
            complaints.extend(group.iter().map(|p| {
                let beside = match places.len() - usize::from(p.info.channels) {
                    0 => String::new(),
                    n => format!(" (and {n} in files of the same time)"),
                };
                let path = p.path().display();
                match Some(reading.least).filter(|least| *least > CHANNELS) {
                    Some(least) => format!(
                        "{path}: {} channels{beside}, and [line] of the station file needs {least}: are `sensors` and `channels` those of this \
                         file?",
                        p.info.channels
                    ),
                    None => format!(
                        "{path}: {} channels{beside}, a recorder has four: give the files of all",
                        p.info.channels
                    ),
                }
            }));
            continue;
        };
        let Some(first) = group.first() else { continue };
        let path = first.path().display();
        if places.len() > CHANNELS && named.is_none() {
            complaints.push(format!(
                "{path}: {} channels with the files of the same time: name four, `channels = [0, 1, 2, 3]` in [array]",
                places.len()
            ));
            continue;
        }
        if group.iter().any(|p| p.info.rate_hz != first.info.rate_hz) {
            complaints.push(format!("{path}: the other channels of the same time have another rate"));
            continue;
        }
        let frames = group.iter().map(|p| p.info.frames).min().flatten();
        if group.iter().any(|p| p.info.frames != frames) {
            complain(&format!("{path}: channels of unlike length, as much as all have is used"));
        }
        let info = Info { channels: CHANNELS as u16, frames, promised: frames, ..first.info };
        let stamp = first.stamp;
        let files = group.into_iter().flat_map(|p| p.source.files).collect();
        parts.push(Part { source: Source { files, pick: [a, b, c, d] }, info, stamp, first_index: 0 });
    }
    parts
}

impl Sequence {
    /// Passes over what lies before an index, where a file has places to go to.
    pub(super) fn skip_to(&mut self, index: u64) {
        while let Some(part) = self.parts.as_slice().first() {
            if part.first_index + part.samples() > index {
                break;
            }
            self.parts.next();
        }
        self.skip = self.parts.as_slice().first().map_or(0, |p| index.saturating_sub(p.first_index));
    }

    /// Says so when a file gave less than its header promised, or no numbers.
    fn finish(&mut self, part: &Part, why: Option<&anyhow::Error>) {
        let (path, info) = (part.path(), &part.info);
        let invalid = std::mem::take(&mut self.invalid);
        for (c, (file, channel)) in part.source.pick.into_iter().enumerate() {
            if let Some(said) = invalid.said(c, self.rate_hz) {
                let path = part.source.files.get(file).map_or(path, |(path, _)| path);
                complain(&format!("{}: channel {channel}: {said}", path.display()));
            }
        }
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

/// A file's header and time.
fn examine(path: PathBuf, container: Container, reading: &Reading) -> Result<Part> {
    let (mut audio, mut info) = Audio::open(&path, container)?;
    if info.frames.is_none() {
        // A file that does not state its length is decoded for it, so that the next one finds its place.
        info.frames = Some(audio.count());
    }
    if info.frames == Some(0) {
        bail!("{}: holds no samples", path.display());
    }
    let stamp = stamp(&path, reading.offset)?;
    let source = Source { files: vec![(path, container)], pick: FIRST.map(|c| (0, c)) };
    Ok(Part { source, info, stamp, first_index: 0 })
}

/// The start time in the sidecar `FILE.start`, else in the name.
fn stamp(path: &Path, offset: UtcOffset) -> Result<Option<WrittenTime>> {
    let mut sidecar = path.as_os_str().to_owned();
    sidecar.push(".start");
    match std::fs::read_to_string(&sidecar) {
        Ok(text) => WrittenTime::parse(&text).map(Some).ok_or_else(|| {
            anyhow!("{}: not a time; 2024-01-31T12:00:00Z was expected", sidecar.to_string_lossy())
        }),
        Err(_) => Ok(path.file_name().and_then(|n| n.to_str()).and_then(|n| WrittenTime::in_name(n, offset))),
    }
}

impl BlockSource for Sequence {
    fn start(&self) -> Option<OffsetDateTime> {
        self.start
    }

    fn expected_end(&self) -> Option<u64> {
        Some(self.end)
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        loop {
            let Some((part, mut open)) = self.current.take() else {
                let Some(part) = self.parts.next() else { return Ok(None) };
                let skip = std::mem::take(&mut self.skip);
                self.file_start = part.first_index;
                self.next_index = part.first_index + skip;
                match Joined::open(&part.source, skip).with_context(|| part.path().display().to_string()) {
                    Ok(open) => self.current = Some((part, open)),
                    Err(e) => complain(&format!("left out {e:#}")),
                }
                continue;
            };
            match open.read(&mut self.frames) {
                Ok(()) if self.frames.is_empty() => self.finish(&part, None),
                Ok(()) => {
                    self.current = Some((part, open));
                    self.invalid.take(&self.frames);
                    let first_index = self.next_index;
                    self.next_index += self.frames.len() as u64;
                    return Ok(Some(Block { first_index, frames: &self.frames }));
                }
                Err(e) => self.finish(&part, Some(&e)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use time::macros::datetime;

    const RATE_HZ: f64 = 1000.0;
    const HOUR: u64 = 3_600_000;

    /// Hourly files whose k-th starts so many seconds after the first, by names of whole seconds.
    fn hourly(starts_s: impl Iterator<Item = f64>) -> Vec<Part> {
        let first = datetime!(2024-01-31 12:00:00 UTC);
        let part = |s: f64| Part {
            source: Source { files: Vec::new(), pick: FIRST.map(|c| (0, c)) },
            info: Info { channels: 4, rate_hz: RATE_HZ, frames: Some(HOUR), promised: Some(HOUR) },
            stamp: Some(WrittenTime { at: first + Duration::seconds(s.floor() as i64), resolution_s: 1.0 }),
            first_index: 0,
        };
        starts_s.map(part).collect()
    }

    #[test]
    fn a_copy_is_left_out_and_files_of_less_than_a_second_are_not() {
        let mut parts = hourly([0.0, 0.0, 3600.0, 7200.0, 7200.0, 7200.0].into_iter());
        leave_out_copies(&mut parts, RATE_HZ);
        assert_eq!(parts.len(), 3);
        let mut short = hourly([0.0, 0.0, 1.0].into_iter());
        short.iter_mut().for_each(|p| p.info.frames = Some(500));
        leave_out_copies(&mut short, RATE_HZ);
        assert_eq!(short.len(), 3);
    }

    #[test]
    fn a_flac_file_that_states_no_length_is_followed_by_the_next() {
        let frames: Vec<[i32; 4]> = (0..1024).map(|i| [i, -i, 7, 8]).collect();
        let mut bytes = crate::recording::flac::tests::encode(&frames, 24, 64_000);
        bytes[21] &= 0xf0;
        bytes[22..26].fill(0);
        let folder = tempfile::tempdir().unwrap();
        let files = ["a.flac", "b.flac"].map(|name| folder.path().join(name));
        files.iter().for_each(|f| std::fs::write(f, &bytes).unwrap());
        let text = "[station]\nkind = \"array\"\n[sampling]\nrate_hz = 64000\n[array]\nhydrophones_m = \
                    [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.13]]\n";
        let station = crate::station::Station::parse(text, "s.toml", Path::new(".")).unwrap();
        let mut source = crate::recording::open(&files, &station, None).unwrap();
        assert_eq!(source.expected_end(), Some(2048));
        let mut indices = Vec::new();
        while let Some(block) = source.next_block().unwrap() {
            indices.extend((0..block.frames.len() as u64).map(|i| block.first_index + i));
        }
        assert!(indices.iter().copied().eq(0..2048));
    }
}
