//! miniSEED and SAC recordings of an ocean-bottom station: several files, or one with several channels, as four-channel
//! blocks.
//!
//! A first pass over the headers (`mseed_scan`) finds every record's place, time and length; samples are decoded once, when they are due,
//! so memory stays small. Sample 0 is the earliest sample of any component. A component that has no data somewhere has
//! [`MISSING`] there (the core takes it for a dead channel); where none has, the index jumps. A record follows the one
//! before where its time agrees within half a sample with what that one's time and length say, whatever the clock has
//! drifted since the start: samples are counted, and the drift is said. What overlaps is used once. Every irregularity is
//! named once on stderr.

use super::mseed_record::{self, code_of};
use super::mseed_scan::{Form, Found, Piece, Stretch, scan, scan_sac};
use super::mseed_strays::without_strays;
use super::{BlockSource, Container, Span, complain, invalid, sac};
use crate::station::Station;
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::block::{Block, CHANNELS, Frame, MISSING};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::PathBuf;
use std::sync::Arc;
use time::OffsetDateTime;

/// Frames of one block.
pub(super) const BLOCK: usize = 4096;

/// Bytes of a file read at once.
const AT_ONCE: usize = 1 << 14;

/// Worst clock that is one: share by which a stated rate may differ from the station's. (Rates of version 2 are also
/// rounded to ratios of 16-bit numbers.)
pub(super) const WORST_CLOCK: f64 = 1e-4;

/// Least rate that a station file may state.
const SLOWEST_HZ: f64 = 20.0;

/// One component being read.
struct Reader {
    pieces: std::vec::IntoIter<Piece>,
    /// Samples of the last record read, and how many of them are used.
    held: Vec<i32>,
    used: usize,
    /// Index of the first not used.
    first: i64,
    /// The file last read, by its number, and how far.
    file: Option<(usize, BufReader<File>, u64)>,
    /// The bytes of the record last read.
    raw: Vec<u8>,
    /// Samples read, those that were no numbers, and the file of the first of these.
    numbers: u64,
    invalid: u64,
    invalid_in: usize,
}

/// What the files hold of a channel.
#[derive(Clone, Default)]
struct Channel {
    pieces: Vec<Piece>,
    rates_hz: Vec<f64>,
    stations: Vec<String>,
}

impl Channel {
    fn of(stretches: Vec<Stretch>) -> Self {
        let mut channel = Self::default();
        for stretch in stretches.into_iter().filter(|s| !s.pieces.is_empty()) {
            if !channel.stations.contains(&stretch.source) {
                channel.stations.push(stretch.source);
            }
            if !channel.rates_hz.contains(&stretch.rate_hz) {
                channel.rates_hz.push(stretch.rate_hz);
            }
            channel.pieces.extend(stretch.pieces);
        }
        channel
    }
}

/// The components of a station in miniSEED and SAC files, looked at and not yet read.
#[derive(Clone)]
pub(super) struct Components {
    files: Arc<Vec<PathBuf>>,
    /// Code and records of pressure, north, east and vertical.
    channels: [(String, Channel); CHANNELS],
    /// What their codes are multiplied by.
    gains: [f64; CHANNELS],
    /// Samples a second.
    pub rate_hz: f64,
}

/// A seismic recording.
pub(super) struct Seismic {
    files: Arc<Vec<PathBuf>>,
    gains: [f64; CHANNELS],
    readers: [Reader; CHANNELS],
    start: OffsetDateTime,
    next: i64,
    end: i64,
    frames: Vec<Frame>,
}

impl Components {
    /// Finds the station's components in files.
    ///
    /// # Errors
    /// No pressure component, components of unlike rate or of one the recorder cannot be given, several stations.
    pub(super) fn find(files: Vec<(PathBuf, Container)>, station: &Station) -> Result<Self> {
        let mut found = Found::new();
        for (number, (path, container)) in files.iter().enumerate() {
            let scanned = match container {
                Container::Sac => scan_sac(path, number, &mut found),
                _ => scan(path, number, &mut found),
            };
            if let Err(e) = scanned {
                complain(&format!("left out {e:#}"));
            }
        }
        let mut channels: BTreeMap<String, Channel> = BTreeMap::new();
        let mut passed: BTreeSet<String> = BTreeSet::new();
        for (code, stretches) in found {
            let is_wanted =
                |s: &Stretch| station.seed_id.as_deref().is_none_or(|wanted| is_of(&s.source, wanted));
            let (wanted, others): (Vec<_>, Vec<_>) = stretches.into_iter().partition(is_wanted);
            passed.extend(others.into_iter().map(|s| s.source));
            if !wanted.is_empty() {
                let kept = without_strays(&code, wanted);
                channels.insert(code, Channel::of(kept));
            }
        }
        if let (Some(wanted), true) = (&station.seed_id, channels.is_empty()) {
            let passed = passed.into_iter().collect::<Vec<_>>().join(", ");
            bail!("no record of {wanted} (`seed_id`); the files hold: {passed}");
        }
        let c = &station.components;
        let wanted =
            [("pressure", &c.pressure), ("north", &c.north), ("east", &c.east), ("vertical", &c.vertical)];
        let there = channels.keys().cloned().collect::<Vec<_>>().join(", ");
        let mut chosen: Vec<(String, Channel)> = Vec::new();
        for (role, code) in wanted {
            let channel = channels.remove(code.as_str()).unwrap_or_default();
            if channel.pieces.is_empty() && role == "pressure" {
                bail!(
                    "no component {code} (pressure) in the files, they hold: {}",
                    if there.is_empty() { "nothing" } else { &there }
                );
            }
            if channel.pieces.is_empty() {
                complain(&format!("component {code} ({role}) is missing; the files hold: {there}"));
            }
            if channel.stations.len() > 1 {
                bail!(
                    "component {code} comes from several stations ({}): give one station's files, or `seed_id` in [obs]",
                    channel.stations.join(", ")
                );
            }
            chosen.push((code.clone(), channel));
        }
        let own = station.config.rate_hz;
        let clock = |a: f64, b: f64| (a / b - 1.0).abs() <= WORST_CLOCK;
        let rates = || chosen.iter().flat_map(|(code, c)| c.rates_hz.iter().map(move |r| (code, *r)));
        let first = rates().next().map_or(own, |(_, r)| r);
        let rate_hz = if clock(first, own) { own } else { first };
        if let Some((code, rate)) = rates().find(|(_, r)| !clock(*r, rate_hz)) {
            bail!(
                "component {code} has {rate} samples a second and others have {rate_hz}; the station file says rate_hz = {own}"
            );
        }
        // What a station file can say it must say: a lower rate would leave an empty band.
        if rate_hz < own && rate_hz >= SLOWEST_HZ {
            bail!(
                "the components have {rate_hz} samples a second, the station file says rate_hz = {own}: correct it there"
            );
        }
        let channels: [_; CHANNELS] =
            chosen.try_into().map_err(|_| anyhow!("a recorder has four components"))?;
        Ok(Self {
            files: Arc::new(files.into_iter().map(|(path, _)| path).collect()),
            channels,
            gains: station.gains,
            rate_hz,
        })
    }

    /// When each record began and ended.
    pub(super) fn spans(&self) -> Vec<(OffsetDateTime, OffsetDateTime)> {
        let pieces = self.channels.iter().flat_map(|(_, c)| &c.pieces);
        pieces.filter_map(|p| p.span(self.rate_hz)).collect()
    }

    /// The files that hold something of a span of time.
    pub(super) fn files(&self, span: Span) -> Vec<PathBuf> {
        let inside = self.channels.iter().flat_map(|(_, c)| &c.pieces);
        let inside = inside.filter(|p| p.span(self.rate_hz).is_none_or(|own| span.meets(own)));
        let numbers: BTreeSet<usize> = inside.map(|p| p.file).collect();
        numbers.into_iter().filter_map(|n| self.files.get(n).cloned()).collect()
    }

    /// What was recorded in a span of time, from the first record that reaches into it.
    ///
    /// # Errors
    /// Nothing was.
    pub(super) fn recording(&self, span: Span) -> Result<Seismic> {
        let rate = self.rate_hz;
        let mut chosen = self.channels.clone();
        for (_, channel) in &mut chosen {
            channel.pieces.retain(|p| p.span(rate).is_none_or(|own| span.meets(own)));
        }
        let Some(zero) = chosen.iter().flat_map(|(_, c)| &c.pieces).map(|p| p.start_ns).min() else {
            bail!("no sample in the files {span}");
        };
        let mut end = 0;
        let mut starts = Vec::new();
        for (code, channel) in &mut chosen {
            let placed = place(&mut channel.pieces, zero, rate);
            if placed.overlapping > 0 {
                complain(&format!(
                    "component {code}: {} samples overlap (repeated data or a clock set back), used once",
                    placed.overlapping
                ));
            }
            if placed.drift_s.abs() * rate > 0.5 {
                complain(&format!(
                    "component {code}: its clock runs {:.1} ppm beside the station's rate_hz = {rate}: samples are counted, \
                     times are {:.3} s off at the end",
                    placed.drift_s / placed.span_s * 1e6,
                    placed.drift_s
                ));
            }
            if let Some(p) = channel.pieces.first() {
                starts.push((code.clone(), p.start_ns));
            }
            end = end.max(channel.pieces.iter().map(|p| p.first + p.samples as i64).max().unwrap_or(0));
        }
        for (code, start_ns) in &starts {
            let late = (start_ns - zero) as f64 * 1e-9;
            let fraction = (late * rate - (late * rate).round()).abs();
            if late > 0.0 {
                complain(&format!("component {code} starts {late:.3} s after the first"));
            }
            if fraction > 0.05 {
                complain(&format!(
                    "component {code} is sampled {:.1} ms beside the first: directions will suffer",
                    fraction / rate * 1e3
                ));
            }
        }
        let start =
            OffsetDateTime::from_unix_timestamp_nanos(zero).context("the recording's start is no time")?;
        let mut chosen = chosen.into_iter();
        let readers = std::array::from_fn(|_| Reader {
            pieces: chosen.next().unwrap_or_default().1.pieces.into_iter(),
            held: Vec::new(),
            used: 0,
            first: 0,
            file: None,
            raw: Vec::new(),
            numbers: 0,
            invalid: 0,
            invalid_in: 0,
        });
        let files = Arc::clone(&self.files);
        Ok(Seismic { files, gains: self.gains, readers, start, next: 0, end, frames: Vec::new() })
    }
}

/// A code multiplied; one that is missing stays it.
pub(super) fn scaled(x: i32, gain: f64) -> i32 {
    if x == MISSING { x } else { code_of(f64::from(x) * gain) }
}

/// Whether a source `NET.STA.LOC` is a wanted one, which may leave out the location.
pub(super) fn is_of(id: &str, wanted: &str) -> bool {
    id.strip_prefix(wanted).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

impl Piece {
    /// When it began and ended.
    fn span(&self, rate_hz: f64) -> Option<(OffsetDateTime, OffsetDateTime)> {
        let at = OffsetDateTime::from_unix_timestamp_nanos(self.start_ns).ok()?;
        let length = time::Duration::checked_seconds_f64(self.samples as f64 / rate_hz)?;
        Some((at, at.checked_add(length)?))
    }
}

/// What [`place`] found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Placed {
    overlapping: u64,
    /// By how much the times of records that follow one another run ahead of their count, s, and over how long.
    drift_s: f64,
    span_s: f64,
}

/// Sorts records by time and gives each its sample index: each time is held against that of the record that reaches
/// farthest of those before.
fn place(pieces: &mut [Piece], zero_ns: i128, rate_hz: f64) -> Placed {
    pieces.sort_by_key(|p| p.start_ns);
    let mut placed = Placed::default();
    let mut before: Option<Piece> = None;
    for p in pieces {
        let Some(last) = before else {
            p.first = ((p.start_ns - zero_ns) as f64 * 1e-9 * rate_hz).round() as i64;
            before = Some(*p);
            continue;
        };
        let since_s = (p.start_ns - last.start_ns) as f64 * 1e-9;
        let end = last.first + last.samples as i64;
        // Samples between the end of the last and the start of this one; negative where they overlap.
        let between = since_s * rate_hz - last.samples as f64;
        let follows = between.abs() <= 0.5;
        p.first = if follows { end } else { end + between.round() as i64 };
        if follows {
            placed.drift_s += between / rate_hz;
            placed.span_s += since_s;
        }
        let after = p.first + p.samples as i64;
        placed.overlapping += (end.min(after) - p.first).max(0) as u64;
        if after >= end {
            before = Some(*p);
        }
    }
    placed
}

impl Reader {
    /// Makes the next samples available; the index of the first, or `None` at the end.
    fn ready(&mut self, files: &[PathBuf]) -> Option<i64> {
        while self.used >= self.held.len() {
            let Some(p) = self.pieces.next() else {
                self.say_invalid(files);
                return None;
            };
            self.held = self.load(files, &p).unwrap_or_else(|e| {
                complain(&format!("{}: lost a record: {e:#}", files[p.file].display()));
                Vec::new()
            });
            let invalid = self.held.iter().filter(|x| **x == MISSING).count() as u64;
            if invalid > 0 && self.invalid == 0 {
                self.invalid_in = p.file;
            }
            self.invalid += invalid;
            self.numbers += self.held.len() as u64;
            // What was used already is not used again.
            self.used = (self.first - p.first).clamp(0, self.held.len() as i64) as usize;
            self.first = self.first.max(p.first);
        }
        Some(self.first)
    }

    /// Says once, at the end, what was no number.
    fn say_invalid(&mut self, files: &[PathBuf]) {
        if let Some(said) = invalid::said(std::mem::take(&mut self.invalid), self.numbers, None) {
            complain(&format!("{}: {said}", files[self.invalid_in].display()));
        }
    }

    /// Takes up to `n` of the samples made available.
    fn take(&mut self, n: usize) -> &[i32] {
        let from = self.used;
        self.used = (from + n).min(self.held.len());
        self.first += (self.used - from) as i64;
        &self.held[from..self.used]
    }

    fn load(&mut self, files: &[PathBuf], p: &Piece) -> Result<Vec<i32>> {
        let (mut file, at) = match self.file.take() {
            Some((number, file, at)) if number == p.file => (file, at),
            _ => (BufReader::with_capacity(AT_ONCE, File::open(&files[p.file])?), 0),
        };
        // Most records follow the one before.
        if at != p.offset {
            file.seek_relative(p.offset.wrapping_sub(at).cast_signed())?;
        }
        self.raw.resize(p.bytes, 0);
        file.read_exact(&mut self.raw)?;
        self.file = Some((p.file, file, p.offset + p.bytes as u64));
        match p.form {
            Form::MiniSeed => mseed_record::samples(&self.raw),
            Form::Sac(order) => Ok(sac::samples(&self.raw, order)),
        }
    }
}

impl BlockSource for Seismic {
    fn start(&self) -> Option<OffsetDateTime> {
        Some(self.start)
    }

    fn expected_end(&self) -> Option<u64> {
        u64::try_from(self.end).ok()
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        let files: &[PathBuf] = &self.files;
        let Some(first) = self.readers.iter_mut().filter_map(|r| r.ready(files)).min() else {
            return Ok(None);
        };
        // Where nothing is, the index jumps.
        self.next = self.next.max(first);
        self.frames.clear();
        let start = self.next;
        while self.frames.len() < BLOCK {
            // As far as no component begins or ends its samples.
            let mut run = BLOCK - self.frames.len();
            let mut there = [false; CHANNELS];
            for (there, reader) in there.iter_mut().zip(&mut self.readers) {
                let Some(first) = reader.ready(files) else { continue };
                *there = first <= self.next;
                let left =
                    if *there { reader.held.len() - reader.used } else { (first - self.next) as usize };
                run = run.min(left);
            }
            if !there.contains(&true) {
                break;
            }
            let from = self.frames.len();
            self.frames.resize(from + run, [MISSING; CHANNELS]);
            for (c, reader) in self.readers.iter_mut().enumerate().filter(|(c, _)| there[*c]) {
                let samples = reader.take(run);
                let gain = self.gains[c];
                let code = |x: i32| if gain == 1.0 { x } else { scaled(x, gain) };
                self.frames[from..].iter_mut().zip(samples).for_each(|(frame, x)| frame[c] = code(*x));
            }
            self.next += run as i64;
        }
        Ok(Some(Block { first_index: start.max(0) as u64, frames: &self.frames }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_drifts_makes_no_jumps_and_gaps_keep_their_length() {
        // 50.002 samples a second, records of 500; after the hundredth 30 s are missing, the last comes twice.
        let start = |k: usize| (k as f64 * 500.0 / 50.002 + if k < 100 { 0.0 } else { 30.0 }) * 1e9;
        let piece = |k: usize| Piece {
            file: 0,
            form: Form::MiniSeed,
            offset: 0,
            bytes: 0,
            start_ns: start(k) as i128,
            first: 0,
            samples: 500,
        };
        let mut pieces: Vec<Piece> = (0..200).chain([199]).map(piece).collect();
        let placed = place(&mut pieces, 0, 50.0);
        for (k, p) in pieces.iter().take(200).enumerate() {
            assert_eq!(p.first, 500 * k as i64 + if k < 100 { 0 } else { 1500 });
        }
        assert_eq!(placed.overlapping, 500);
        let ppm = placed.drift_s / placed.span_s * 1e6;
        assert!((ppm + 40.0).abs() < 0.1, "{ppm}");
    }
}
