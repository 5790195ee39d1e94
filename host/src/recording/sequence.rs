//! Several files as one recording: their order, the gaps between them, and what to do with bad ones.

use super::flac::Flac;
use super::wav::{Info, Wav};
use super::written_time::WrittenTime;
use super::{BlockSource, Container};
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

    /// Frames that can be read from here on.
    fn count(&mut self) -> u64 {
        let (mut frames, mut count) = (Vec::new(), 0);
        while self.read(&mut frames).is_ok() && !frames.is_empty() {
            count += frames.len() as u64;
        }
        count
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
    stamp: Option<WrittenTime>,
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

/// Leaves out every file that begins when the one before it does, of files in order of their times and of equal times
/// the longest first. Files shorter than their names tell the time may follow each other under one time.
fn leave_out_copies(parts: &mut Vec<Part>, rate_hz: f64) {
    parts.dedup_by(|later, earlier| {
        let (Some(this), Some(that)) = (later.stamp, earlier.stamp) else { return false };
        let long = earlier.info.frames.is_none_or(|n| n as f64 >= that.resolution_s * rate_hz);
        let copy = this.at == that.at && long;
        if copy {
            let (later, earlier) = (later.path.display(), earlier.path.display());
            complain(&format!("left out {later}: it begins when {earlier} does"));
        }
        copy
    });
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
            parts.sort_by_key(|p| (p.stamp.map(|s| s.at), std::cmp::Reverse(p.info.frames)));
            leave_out_copies(&mut parts, config.rate_hz);
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
    let (mut audio, mut info) = Audio::open(path, container)?;
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
    if info.frames.is_none() {
        // A file that does not state its length is decoded for it, so that the next one finds its place.
        info.frames = Some(audio.count());
    }
    if info.frames == Some(0) {
        bail!("{name}: holds no samples");
    }
    Ok(Part { path: path.to_owned(), container, info, stamp: stamp(path)?, first_index: 0 })
}

/// The start time in the sidecar `FILE.start`, else in the name.
fn stamp(path: &Path) -> Result<Option<WrittenTime>> {
    let mut sidecar = path.as_os_str().to_owned();
    sidecar.push(".start");
    match std::fs::read_to_string(&sidecar) {
        Ok(text) => WrittenTime::parse(&text).map(Some).ok_or_else(|| {
            anyhow!("{}: not a time; 2024-01-31T12:00:00Z was expected", sidecar.to_string_lossy())
        }),
        Err(_) => Ok(path.file_name().and_then(|n| n.to_str()).and_then(WrittenTime::in_name)),
    }
}

/// What a file's time says against the samples counted.
#[derive(Clone, Copy)]
struct Mark {
    /// The time, in samples since the first file that has one.
    at: f64,
    /// By how much it is ahead of the file's first index.
    ahead: f64,
    resolution_s: f64,
}

impl Mark {
    /// Samples missing (negative: doubled) between this file and a later one, where they are more than the times'
    /// resolution and the clock's drift from one to the other explain.
    fn jump(self, later: Self, rate_hz: f64) -> Option<f64> {
        let jump = later.ahead - self.ahead;
        (jump.abs() > self.resolution(later, rate_hz) + self.drift(later) + 1.5).then_some(jump)
    }

    /// The coarser of both times' resolutions, samples.
    fn resolution(self, later: Self, rate_hz: f64) -> f64 {
        self.resolution_s.max(later.resolution_s) * rate_hz
    }

    /// By how much the clock may have drifted from this file to a later one, samples.
    fn drift(self, later: Self) -> f64 {
        DRIFT * (later.at - self.at).abs()
    }
}

/// Gives every part its first index; the index after the last sample. Each time is held against that of the file
/// before, so that drift over days hides no gap, and against the last file after a gap, so that many small gaps show.
fn place(parts: &mut [Part], rate_hz: f64) -> u64 {
    let mut next = 0u64;
    let mut origin: Option<OffsetDateTime> = None;
    let (mut before, mut set): (Option<Mark>, Option<Mark>) = (None, None);
    for part in parts {
        part.first_index = next;
        if let Some(stamp) = part.stamp {
            let at = (stamp.at - *origin.get_or_insert(stamp.at)).as_seconds_f64() * rate_hz;
            let mut mark = Mark { at, ahead: at - next as f64, resolution_s: stamp.resolution_s };
            let found = [before, set].into_iter().flatten().find_map(|m| m.jump(mark, rate_hz));
            // Its size is measured from the last file after a gap, so that coarse times do not add up, until the clock may
            // have drifted by more than the times resolve.
            let anchor = set.filter(|set| set.drift(mark) <= set.resolution(mark, rate_hz));
            let jump = found.map(|jump| anchor.map_or(jump, |anchor| mark.ahead - anchor.ahead));
            if let Some(jump) = jump.filter(|jump| next as f64 + jump >= 0.0) {
                part.first_index = (next as f64 + jump).round() as u64;
                mark.ahead = at - part.first_index as f64;
                set = Some(mark);
            }
            set = set.or(Some(mark));
            before = Some(mark);
        }
        let length = part.info.promised.max(part.info.frames).unwrap_or(0);
        next = part.first_index.saturating_add(length);
    }
    next
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
            path: PathBuf::new(),
            container: Container::Wav,
            info: Info { channels: 4, rate_hz: RATE_HZ, frames: Some(HOUR), promised: Some(HOUR) },
            stamp: Some(WrittenTime {
                at: first + time::Duration::seconds(s.floor() as i64),
                resolution_s: 1.0,
            }),
            first_index: 0,
        };
        starts_s.map(part).collect()
    }

    #[test]
    fn a_gap_of_half_a_minute_on_day_ten_is_seen_through_the_drift_of_the_clock() {
        // The clock is 30 parts in a million slow: by then 26 s of drift, which are no gap.
        let start = |k: u64| 3600.0 * k as f64 * (1.0 + 30e-6) + if k < 240 { 0.0 } else { 30.0 };
        let mut parts = hourly((0..260).map(start));
        place(&mut parts, RATE_HZ);
        for (k, p) in (0..240).zip(&parts) {
            assert_eq!(p.first_index, HOUR * k);
        }
        let gap_s = (parts[240].first_index - HOUR * 240) as f64 / RATE_HZ;
        assert!((gap_s - 30.0).abs() <= 1.0, "{gap_s}");
        for (k, p) in (0..20).zip(&parts[240..]) {
            assert_eq!(p.first_index, parts[240].first_index + HOUR * k);
        }
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

    #[test]
    fn gaps_each_below_the_resolution_show_when_they_add_up() {
        let mut parts = hourly((0..40).map(|k| 3600.6 * f64::from(k)));
        place(&mut parts, RATE_HZ);
        let lost_s = (parts[39].first_index - HOUR * 39) as f64 / RATE_HZ;
        assert!((lost_s - 0.6 * 39.0).abs() < 4.0, "{lost_s}");
    }
}
