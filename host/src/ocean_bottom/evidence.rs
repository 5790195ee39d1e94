//! What each minute of a recording says of azimuth and range, kept for pictures of weeks.
//!
//! Enters: frames in the order of time. Leaves: at each whole minute the natural logarithms of the likelihood ratios of
//! `stages.rs`, of 180 azimuths and 179 ranges (280 m each, the greatest of four), in a byte each: steps of a quarter from 0 to 60. That is half a
//! megabyte a day; frames are held for an hour. Work: 2 to 3 ms a minute, on all processors.

use super::stages::{AZIMUTHS, RANGE_STEP_M, RANGES, SpectralFrame, azimuth_likelihood, range_likelihood};
use crate::propagation::Propagation;

/// Ranges of the likelihood in a cell, and cells.
const MERGED: usize = 4;
const RANGE_CELLS: usize = RANGES.div_ceil(MERGED);
/// Steps in one, and the byte of what is not known.
const STEPS: f32 = 4.0;
const MOST: f32 = 60.0;
const UNKNOWN: u8 = u8::MAX;

/// Minutes of which frames are held.
const AT_ONCE: u64 = 60;
/// Half a window, s: as long before and after its minute frames count.
const HALF_S: f64 = 90.0;

/// Which of the two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Of {
    /// Azimuth, from North clockwise.
    Azimuth,
    /// Range, from the station.
    Range,
}

impl Of {
    fn cells(self) -> usize {
        match self {
            Self::Azimuth => AZIMUTHS,
            Self::Range => RANGE_CELLS,
        }
    }

    /// The edges of all cells: degrees or km.
    pub(super) fn edges(self) -> (f64, f64) {
        match self {
            Self::Azimuth => (0.0, 360.0),
            Self::Range => (0.0, RANGE_STEP_M * (MERGED * RANGE_CELLS) as f64 / 1e3),
        }
    }
}

/// What minutes say, being made.
pub(super) struct Evidence<'t> {
    table: &'t Propagation,
    held: Vec<SpectralFrame>,
    /// The first minute, and those that are done.
    first: Option<u64>,
    done: u64,
    azimuth: Vec<u8>,
    range: Vec<u8>,
}

/// Cells against time.
pub(super) struct Cells {
    /// Time of the left and right edge, s.
    pub(super) span_s: (f64, f64),
    /// Columns.
    pub(super) columns: usize,
    /// What a column is of, in words.
    pub(super) each: String,
    /// Row after row from the lowest; not a number where nothing is known.
    pub(super) values: Vec<f64>,
}

impl<'t> Evidence<'t> {
    /// By this table's delays.
    pub(super) fn new(table: &'t Propagation) -> Self {
        Self { table, held: Vec::new(), first: None, done: 0, azimuth: Vec::new(), range: Vec::new() }
    }

    /// Takes a frame.
    pub(super) fn take(&mut self, frame: SpectralFrame) {
        let first = *self.first.get_or_insert((frame.t_s / 60.0).ceil().max(0.0) as u64);
        let end_s = 60.0 * (first + self.done + AT_ONCE) as f64;
        if frame.t_s > end_s + HALF_S {
            // Those that this frame and later ones count for wait: after a gap there may be many that none does.
            let whole = ((frame.t_s - HALF_S) / 60.0).ceil() as u64;
            self.work(whole.saturating_sub(first));
        }
        self.held.push(frame);
    }

    /// When no more comes.
    pub(super) fn finish(&mut self) {
        if let Some((first, last)) = self.first.zip(self.held.last().map(|f| f.t_s)) {
            self.work(((last / 60.0).floor() as u64 + 1).saturating_sub(first));
        }
        self.held = Vec::new();
    }

    /// Does the minutes before this one, counted from the first, of which all frames have come.
    fn work(&mut self, until: u64) {
        let Some(first) = self.first else { return };
        while self.done < until {
            let count = AT_ONCE.min(until - self.done);
            let minutes: Vec<f64> = (0..count).map(|k| 60.0 * (first + self.done + k) as f64).collect();
            let (from_s, to_s) = (minutes[0] - HALF_S, minutes[minutes.len() - 1] + HALF_S);
            let a = self.held.partition_point(|f| f.t_s < from_s);
            let b = self.held.partition_point(|f| f.t_s <= to_s);
            let frames = &self.held[a..b];
            if frames.is_empty() {
                self.azimuth.resize(self.azimuth.len() + minutes.len() * AZIMUTHS, UNKNOWN);
                self.range.resize(self.range.len() + minutes.len() * RANGE_CELLS, UNKNOWN);
            } else {
                for minute in azimuth_likelihood(frames, &minutes) {
                    self.azimuth.extend(minute.iter().map(|v| byte(*v)));
                }
                for minute in range_likelihood(frames, &minutes, self.table) {
                    let greatest = |cell: &[f32]| cell.iter().copied().fold(f32::NAN, f32::max);
                    self.range.extend(minute.chunks(MERGED).map(|cell| byte(greatest(cell))));
                }
            }
            self.done += count;
        }
        let keep_s = 60.0 * (first + self.done) as f64 - HALF_S;
        self.held.drain(..self.held.partition_point(|f| f.t_s < keep_s));
    }

    /// Number of minutes that are known.
    pub(super) fn minutes(&self) -> usize {
        self.azimuth.len() / AZIMUTHS
    }

    /// The parts of a time (s) of which nothing is known: before the recording, in its gaps, after it.
    pub(super) fn unknown(&self, (from_s, to_s): (f64, f64)) -> Vec<(f64, f64)> {
        let first_s = 60.0 * self.first.unwrap_or(0) as f64;
        let ends_s = first_s + 60.0 * self.minutes() as f64;
        let is_unknown = |m: &usize| self.azimuth.get(m * AZIMUTHS).is_none_or(|b| *b == UNKNOWN);
        let minutes: Vec<usize> = (0..self.minutes()).filter(is_unknown).collect();
        let gaps = minutes.chunk_by(|a, b| a + 1 == *b).filter_map(|run| Some((*run.first()?, *run.last()?)));
        // A minute reaches half of one to both sides.
        let at = |m: usize| first_s + 60.0 * m as f64;
        let gaps = gaps.map(|(a, b)| (at(a) - 30.0, at(b) + 30.0));
        let all = [(f64::NEG_INFINITY, 0.0)].into_iter().chain(gaps).chain([(ends_s, f64::INFINITY)]);
        all.map(|(a, b)| (a.max(from_s), b.min(to_s))).filter(|(a, b)| b - a > 60.0).collect()
    }

    /// The minutes whose middle lies between two times (s), in at most so many columns: the greatest of those of one.
    pub(super) fn cells(&self, of: Of, (from_s, to_s): (f64, f64), most: usize) -> Cells {
        let (bytes, n) = match of {
            Of::Azimuth => (&self.azimuth, of.cells()),
            Of::Range => (&self.range, of.cells()),
        };
        let first_s = 60.0 * self.first.unwrap_or(0) as f64;
        let place = |t_s: f64| (((t_s - first_s) / 60.0).ceil().max(0.0) as usize).min(self.minutes());
        let (a, b) = (place(from_s), place(to_s).max(place(from_s)));
        let per = (b - a).div_ceil(most.max(1)).max(1);
        let groups: Vec<&[u8]> = bytes.get(a * n..b * n).unwrap_or(&[]).chunks(per * n).collect();
        let mut values = Vec::with_capacity(groups.len() * n);
        for row in 0..n {
            values.extend(groups.iter().map(|group| {
                let known = group.iter().skip(row).step_by(n).filter(|b| **b != UNKNOWN).max();
                known.map_or(f64::NAN, |b| f64::from(*b) / f64::from(STEPS))
            }));
        }
        // Not before the recording: half a cell is less than can be seen, another date is not.
        let begins = (first_s + 60.0 * a as f64 - 30.0).max(0.0);
        let ends = begins + 60.0 * (per * groups.len()) as f64;
        let each = match per {
            1 => "at each minute, of three minutes".to_owned(),
            n => format!("of three minutes, the greatest of {n} minutes"),
        };
        Cells { span_s: (begins, ends), columns: groups.len(), each, values }
    }
}

/// A value in its byte.
fn byte(value: f32) -> u8 {
    if value.is_nan() { UNKNOWN } else { (value.clamp(0.0, MOST) * STEPS).round() as u8 }
}

#[cfg(test)]
mod tests {
    use super::super::stages::{BINS, minutes};
    use super::*;
    use crate::propagation::bottom::Bottom;
    use crate::propagation::{profile::SpeedProfile, trace};
    use seabearing_core::obs::limits::QUEFRENCIES;

    fn table() -> Propagation {
        let profile = SpeedProfile::subtropical(4340.0).unwrap();
        trace::trace("subtropical", &profile, &Bottom::default(), 70.0, 1429, || ())
    }

    /// A frame of a recording in which all sound comes from an azimuth that turns slowly.
    fn frame(k: usize) -> SpectralFrame {
        let t_s = 10.24 * (k + 1) as f64;
        let azimuth = ((t_s / 5_000.0) as f32).rem_euclid(std::f32::consts::TAU);
        let filtered = std::array::from_fn(|q| 0.05 * ((q * 7 + k * 3) as f32).sin());
        let _: &[f32; QUEFRENCIES] = &filtered;
        SpectralFrame {
            t_s,
            log_pressure: vec![0.0; BINS],
            azimuth: vec![azimuth; BINS],
            raw: vec![0.0; BINS],
            filtered,
        }
    }

    #[test]
    fn minutes_are_the_same_as_of_all_frames_at_once_and_gaps_are_blank() {
        let table = table();
        // Five hours, of which one and a half are missing.
        let ks = || (0..1758usize).filter(|k| !(800..1320).contains(k));
        let mut evidence = Evidence::new(&table);
        let mut most_held = 0;
        for k in ks() {
            evidence.take(frame(k));
            most_held = most_held.max(evidence.held.len());
        }
        evidence.finish();
        assert!(most_held < 400, "{most_held}");
        let all: Vec<SpectralFrame> = ks().map(frame).collect();
        let when = minutes(&all);
        assert_eq!(evidence.minutes(), when.len());
        let expected = azimuth_likelihood(&all, &when);
        for (m, row) in expected.iter().enumerate() {
            let bytes: Vec<u8> = row.iter().map(|v| byte(*v)).collect();
            assert_eq!(evidence.azimuth[m * AZIMUTHS..(m + 1) * AZIMUTHS], bytes, "minute {m}");
        }
        let expected = range_likelihood(&all, &when, &table);
        for (m, row) in expected.iter().enumerate() {
            let bytes: Vec<u8> =
                row.chunks(MERGED).map(|c| byte(c.iter().copied().fold(f32::NAN, f32::max))).collect();
            assert_eq!(evidence.range[m * RANGE_CELLS..(m + 1) * RANGE_CELLS], bytes, "minute {m}");
        }
        // One column a minute, and of the missing hours nothing.
        let cells = evidence.cells(Of::Azimuth, (0.0, 1e9), 1000);
        assert_eq!((cells.columns, cells.span_s), (when.len(), (30.0, 30.0 + 60.0 * when.len() as f64)));
        let blank = (0..cells.columns).filter(|c| cells.values[*c].is_nan()).count();
        assert!((80..90).contains(&blank), "{blank}");
        let unknown = evidence.unknown((-3600.0, 24_000.0));
        let [before, gap, after] = unknown[..] else { panic!("{unknown:?}") };
        assert!(before == (-3600.0, 0.0) && after.1 == 24_000.0 && after.0 > 17_900.0);
        // Three minutes hear half of one beyond a gap's edges.
        assert!((8_192.0..8_400.0).contains(&gap.0) && (13_400.0..13_530.0).contains(&gap.1), "{gap:?}");
        // The direction is where it is.
        let column = 30;
        let rows = || (0..AZIMUTHS).map(|row| cells.values[row * cells.columns + column]);
        let greatest = rows().fold(0.0, f64::max);
        let turned_deg = (60.0 * 31.0 / 5_000.0f64).to_degrees();
        let row = (turned_deg / 2.0) as usize;
        assert!((row - 1..=row + 1).any(|r| cells.values[r * cells.columns + column] == greatest));
        // Few columns of many minutes; a part of the time.
        let part = evidence.cells(Of::Range, (3600.0, 7200.0), 10);
        assert_eq!(
            (part.columns, part.each.as_str(), part.span_s),
            (10, "of three minutes, the greatest of 6 minutes", (3570.0, 7170.0))
        );
    }
}
