//! Spectra, directions and cepstra of a whole recording as the columns of a picture: as many as can be seen, however long it is.
//!
//! Enters: frames in the order of time. A column is the sum of the frames of its time; when there are too many columns, neighbours
//! become one, so that at most [`FINE`] of 7 kB each are kept (10 MB), of a minute as of a year.

use super::stages::{BINS, SpectralFrame};

/// Columns a picture has at most: more cannot be seen.
pub(super) const COLUMNS: usize = 360;
/// Columns that are kept at most.
const FINE: usize = 4 * COLUMNS;

/// Rows of spectra: two bins each, 0 to 25 Hz.
pub(super) const ROWS: usize = BINS / 2;
/// First quefrency of the rows of cepstra, 0.4 s, and their number, two quefrencies each, to 7 s: the branches' span; nearer zero
/// lies the spectrum's own shape.
pub(super) const FROM: usize = 20;
pub(super) const CEPSTRAL: usize = 165;

/// Sums of what a column's frames say, each row of a pair of bins or quefrencies, and how many there are in each.
#[derive(Clone)]
pub(super) struct Column {
    /// Frames.
    pub(super) frames: usize,
    /// Powers.
    pub(super) power: Vec<f64>,
    /// Sines and cosines of azimuths, and their number.
    pub(super) directions: Vec<(f32, f32, f32)>,
    /// Magnitudes of the cepstrum before the clutter filter and after it, and their numbers.
    pub(super) raw: Vec<(f32, f32)>,
    pub(super) filtered: Vec<(f32, f32)>,
}

impl Column {
    fn new() -> Self {
        let cepstral = vec![(0.0, 0.0); CEPSTRAL];
        Self {
            frames: 0,
            power: vec![0.0; ROWS],
            directions: vec![(0.0, 0.0, 0.0); ROWS],
            raw: cepstral.clone(),
            filtered: cepstral,
        }
    }

    fn take(&mut self, frame: &SpectralFrame) {
        self.frames += 1;
        for (sum, pair) in self.power.iter_mut().zip(frame.log_pressure.chunks_exact(2)) {
            *sum += pair.iter().map(|l| f64::from(2.0 * l).exp()).sum::<f64>();
        }
        for (sum, pair) in self.directions.iter_mut().zip(frame.azimuth.chunks_exact(2)) {
            for a in pair.iter().filter(|a| a.is_finite()) {
                *sum = (sum.0 + a.sin(), sum.1 + a.cos(), sum.2 + 1.0);
            }
        }
        let sums = [(&mut self.raw, frame.raw.as_slice()), (&mut self.filtered, frame.filtered.as_slice())];
        for (sums, cepstrum) in sums {
            let pairs = cepstrum.get(FROM..).unwrap_or(&[]).chunks(2);
            for (sum, pair) in sums.iter_mut().zip(pairs) {
                for c in pair.iter().filter(|c| c.is_finite()) {
                    *sum = (sum.0 + c.abs(), sum.1 + 1.0);
                }
            }
        }
    }

    fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.power.iter_mut().zip(&other.power).for_each(|(a, b)| *a += b);
        for (a, b) in self.directions.iter_mut().zip(&other.directions) {
            *a = (a.0 + b.0, a.1 + b.1, a.2 + b.2);
        }
        let both = self.raw.iter_mut().zip(&other.raw).chain(self.filtered.iter_mut().zip(&other.filtered));
        both.for_each(|(a, b)| *a = (a.0 + b.0, a.1 + b.1));
    }
}

/// Columns being made.
pub(super) struct Columns {
    /// Time from one frame to the next where none is missing, s.
    hop_s: f64,
    /// Frames of a column.
    per: usize,
    /// Middle of the first frame and of the last, s.
    first_s: f64,
    last_s: f64,
    columns: Vec<Option<Box<Column>>>,
}

impl Columns {
    /// Of frames that follow each other so, s.
    pub(super) fn new(hop_s: f64) -> Self {
        Self { hop_s, per: 1, first_s: f64::NAN, last_s: f64::NAN, columns: Vec::new() }
    }

    /// Takes a frame.
    pub(super) fn take(&mut self, frame: &SpectralFrame) {
        if self.columns.is_empty() {
            self.first_s = frame.t_s;
        }
        self.last_s = frame.t_s;
        let step = ((frame.t_s - self.first_s) / self.hop_s + 1e-6) as usize;
        while step / self.per >= FINE {
            self.join(2);
        }
        let at = step / self.per;
        if self.columns.len() <= at {
            self.columns.resize(at + 1, None);
        }
        if let Some(place) = self.columns.get_mut(at) {
            place.get_or_insert_with(|| Box::new(Column::new())).take(frame);
        }
    }

    /// Makes one column of so many.
    fn join(&mut self, n: usize) {
        let one = |columns: &mut [Option<Box<Column>>]| {
            let mut columns = columns.iter_mut().filter_map(Option::take);
            let mut sum = columns.next()?;
            columns.for_each(|other| sum.add(&other));
            Some(sum)
        };
        self.columns = self.columns.chunks_mut(n).map(one).collect();
        self.per *= n;
    }

    /// When no more comes: as many columns as can be seen.
    pub(super) fn finish(&mut self) {
        let n = self.columns.len().div_ceil(COLUMNS);
        if n > 1 {
            self.join(n);
        }
    }

    /// Cells row after row: `value(column, row)`, blank where there are no frames.
    pub(super) fn cells(&self, rows: usize, value: &dyn Fn(&Column, usize) -> f64) -> (usize, Vec<f64>) {
        let mut out = Vec::with_capacity(rows * self.columns.len());
        for row in 0..rows {
            out.extend(self.columns.iter().map(|c| c.as_ref().map_or(f64::NAN, |c| value(c, row))));
        }
        (self.columns.len(), out)
    }

    /// From the beginning of the first column to the end of the last, s.
    pub(super) fn span_s(&self) -> (f64, f64) {
        let begins = self.first_s - 0.5 * self.hop_s;
        (begins, begins + (self.columns.len() * self.per) as f64 * self.hop_s)
    }

    /// Middle of the last frame, s; not a number without one.
    pub(super) fn last_s(&self) -> f64 {
        self.last_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::obs::limits::QUEFRENCIES;

    fn frame(k: usize) -> SpectralFrame {
        SpectralFrame {
            t_s: 10.0 + 5.0 * k as f64,
            log_pressure: vec![0.0; BINS],
            azimuth: vec![f32::NAN; BINS],
            raw: vec![-1.0; BINS],
            filtered: [k as f32; QUEFRENCIES],
        }
    }

    fn columns(frames: impl Iterator<Item = usize>) -> Columns {
        let mut out = Columns::new(5.0);
        frames.for_each(|k| out.take(&frame(k)));
        out.finish();
        out
    }

    #[test]
    fn a_gap_of_a_recording_is_blank_and_what_follows_it_stands_at_its_time() {
        let all = columns((0..1000).filter(|k| !(300..700).contains(k)));
        let (n, values) = all.cells(1, &|c, row| f64::from(c.filtered[row].0 / c.filtered[row].1));
        // Each column is 3 frames long, and begins with its own.
        let (from, to) = all.span_s();
        assert_eq!((n, from, to), (334, 7.5, 7.5 + 334.0 * 15.0));
        for (k, value) in values.iter().enumerate() {
            let mean = match k {
                100..233 => f64::NAN,
                233 => 700.5,
                333 => 999.0,
                _ => (3 * k + 1) as f64,
            };
            assert!(value.to_bits() == mean.to_bits() || (value.is_nan() && mean.is_nan()), "{k} {value}");
        }
    }

    #[test]
    fn a_long_recording_has_as_many_columns_as_a_short_one_and_loses_no_frame() {
        let n = 60_000;
        let all = columns(0..n);
        let (n_columns, frames) = all.cells(1, &|c, _| c.frames as f64);
        assert!((COLUMNS / 2..=COLUMNS).contains(&n_columns), "{n_columns}");
        assert_eq!(frames.iter().sum::<f64>(), n as f64);
        let (_, raw) = all.cells(CEPSTRAL, &|c, row| f64::from(c.raw[row].0 / c.raw[row].1));
        assert!(raw.iter().all(|r| *r == 1.0));
        assert!((all.last_s() - (10.0 + 5.0 * (n - 1) as f64)).abs() < 1e-9);
    }
}
