//! Levels that recorders send of themselves (records `spectrum`): sorted by station and channel, and their percentiles over time.
//!
//! L5, L50 and L95 are levels that are *exceeded* for 5, 50 and 95 % of the time (N percentage exceedance level, ISO 1996-1:2016,
//! 3.1.3): L5 is the loud end. A value of the time is one interval of the recorder, so peaks within one do not show.
//! (The percentiles p5 and p95 of records `level` are counted from the other end, and of seconds.)

use super::db;
use seabearing_core::kit::{median, quantile};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use time::OffsetDateTime;

/// Periods to choose from, s.
const PERIODS_S: [f64; 9] = [60.0, 300.0, 600.0, 1800.0, 3600.0, 10_800.0, 21_600.0, 86_400.0, 604_800.0];

/// Fewest intervals of a period that is chosen, and most periods.
const LEAST_INTERVALS: f64 = 20.0;
const MOST_PERIODS: f64 = 48.0;

/// One spectrum.
#[derive(Clone, Debug)]
pub struct Row {
    /// Time of its middle: seconds since 1970 where [`Told::is_utc`], else since sample 0.
    pub at_s: f64,
    /// Levels of the density in each band, dB re the reference squared in a hertz.
    pub density_db: Vec<Option<f64>>,
    /// Levels of the bands, dB re the reference.
    pub band_db: Vec<Option<f64>>,
}

impl Row {
    /// Level of all bands together; `None` where nothing was measured.
    pub fn broad_db(&self) -> Option<f64> {
        power(self.band_db.iter().copied()).map(|(sum, _)| db(sum))
    }
}

/// Sum of the powers of what there is, and how many that is.
fn power(levels: impl Iterator<Item = Option<f64>>) -> Option<(f64, usize)> {
    let (sum, n) = levels.flatten().fold((0.0, 0), |(sum, n), db| (sum + 10f64.powf(db / 10.0), n + 1));
    (n > 0).then_some((sum, n))
}

/// The mean of the powers of what there is, dB; not a number where there is nothing.
pub(super) fn mean_db(levels: impl Iterator<Item = Option<f64>>) -> f64 {
    power(levels).map_or(f64::NAN, |(sum, n)| db(sum / n as f64))
}

/// The levels of one channel of one recorder.
#[derive(Clone, Debug)]
pub struct Told {
    /// Number of the station, where records tell it.
    pub station: Option<u64>,
    /// Recorder channel, from 0.
    pub channel: u64,
    /// What the levels are re.
    pub reference: String,
    /// Edges of the bands, Hz.
    pub edges_hz: Vec<f64>,
    /// Whether times are UTC.
    pub is_utc: bool,
    /// In the order of time.
    pub rows: Vec<Row>,
}

/// Levels exceeded for 5, 50 and 95 % of intervals, and the mean of their powers, dB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Percentiles {
    /// Intervals with a level.
    pub n: usize,
    /// L5, L50, L95.
    pub exceeded_db: [f64; 3],
    /// Level of the mean power.
    pub mean_db: f64,
}

impl Percentiles {
    /// Of levels; `None` of none.
    pub fn of(levels: impl Iterator<Item = Option<f64>>) -> Option<Self> {
        let mut values: Vec<f64> = levels.flatten().filter(|level| level.is_finite()).collect();
        let mean_db = mean_db(values.iter().copied().map(Some));
        let mut exceeded = |percent: f64| quantile(&mut values, 1.0 - percent / 100.0);
        let exceeded_db = [exceeded(5.0)?, exceeded(50.0)?, exceeded(95.0)?];
        Some(Self { n: values.len(), exceeded_db, mean_db })
    }
}

/// Sorts the records that recorders sent of themselves (answers to commands are not among them): by station, channel, reference
/// and bands. Where some of a channel's records have UTC those without are left out; how many.
pub fn sorted<'a>(records: impl Iterator<Item = &'a Value>) -> (Vec<Told>, usize) {
    let mut channels: BTreeMap<String, (Told, Vec<Row>)> = BTreeMap::new();
    let mut greeted = None;
    for record in records {
        if record["type"] == "hello" {
            greeted = record["station"].as_u64();
        }
        if record["type"] != "spectrum" || record["token"] != 0 {
            continue;
        }
        let numbers = |key: &str| -> Vec<Option<f64>> {
            record[key].as_array().into_iter().flatten().map(Value::as_f64).collect()
        };
        let edges_hz: Vec<f64> = numbers("edges_hz").into_iter().flatten().collect();
        let (density_db, band_db) = (numbers("density_db"), numbers("band_db"));
        if edges_hz.len() < 2
            || [&density_db, &band_db].iter().any(|levels| levels.len() + 1 != edges_hz.len())
        {
            continue;
        }
        let station = record["station"].as_u64().or(greeted);
        let channel = record["channel"].as_u64().unwrap_or(0);
        let reference = record["reference"].as_str().unwrap_or("full scale").to_owned();
        let key = format!("{station:?} {channel} {reference} {edges_hz:?}");
        let (told, timeless) = channels.entry(key).or_insert_with(|| {
            (Told { station, channel, reference, edges_hz, is_utc: true, rows: Vec::new() }, Vec::new())
        });
        let utc = record["utc"]
            .as_str()
            .and_then(|t| OffsetDateTime::parse(t, &time::format_description::well_known::Rfc3339).ok());
        let row = |at_s| Row { at_s, density_db, band_db };
        match (utc, record["t_s"].as_f64()) {
            (Some(utc), _) => told.rows.push(row(utc.unix_timestamp_nanos() as f64 * 1e-9)),
            (None, Some(t_s)) => timeless.push(row(t_s)),
            (None, None) => {}
        }
    }
    let mut left_out = 0;
    let told = channels.into_values().map(|(mut told, timeless)| {
        if told.rows.is_empty() {
            (told.rows, told.is_utc) = (timeless, false);
        } else {
            left_out += timeless.len();
        }
        told.rows.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        told.trim();
        told
    });
    (told.filter(|told| !told.rows.is_empty()).collect(), left_out)
}

impl Told {
    /// Leaves out the lowest and highest bands that were never measured.
    fn trim(&mut self) {
        let measured =
            |band: &usize| self.rows.iter().any(|r| r.band_db.get(*band).is_some_and(Option::is_some));
        let bands = self.edges_hz.len() - 1;
        let (Some(first), Some(last)) = ((0..bands).find(measured), (0..bands).rfind(measured)) else {
            return;
        };
        self.edges_hz = self.edges_hz.drain(first..last + 2).collect();
        for row in &mut self.rows {
            for levels in [&mut row.density_db, &mut row.band_db] {
                *levels = levels.drain(first..=last).collect();
            }
        }
    }

    /// Time from one interval to the next, s.
    pub fn every_s(&self) -> f64 {
        let mut steps: Vec<f64> =
            self.rows.windows(2).map(|w| w[1].at_s - w[0].at_s).filter(|s| *s > 0.0).collect();
        median(&mut steps).unwrap_or(60.0)
    }

    /// From the beginning of the first interval to the end of the last, s.
    pub fn span_s(&self) -> (f64, f64) {
        let half = 0.5 * self.every_s();
        let at = |row: Option<&Row>| row.map_or(0.0, |row| row.at_s);
        (at(self.rows.first()) - half, at(self.rows.last()) + half)
    }

    /// The shortest usual period that holds enough intervals for percentiles and is not one of too many, s.
    pub fn period_s(&self) -> f64 {
        let (from, to) = self.span_s();
        let least = (LEAST_INTERVALS * self.every_s()).max((to - from) / MOST_PERIODS);
        PERIODS_S
            .into_iter()
            .find(|p| *p >= 0.999 * least)
            .unwrap_or_else(|| 604_800.0 * (least / 604_800.0).ceil())
    }

    /// Percentiles of the level of all bands together over periods that begin at multiples of their length: beginning, and
    /// percentiles. Periods without a level are not among them.
    pub fn over_time(&self, period_s: f64) -> Vec<(f64, Percentiles)> {
        let period = |row: &Row| (row.at_s / period_s).floor();
        let groups = self.rows.chunk_by(|a, b| period(a) == period(b));
        groups
            .filter_map(|rows| {
                let begins = period(rows.first()?) * period_s;
                Some((begins, Percentiles::of(rows.iter().map(Row::broad_db))?))
            })
            .collect()
    }

    /// Percentiles of the level of all bands together over the whole time.
    pub fn broad(&self) -> Option<Percentiles> {
        Percentiles::of(self.rows.iter().map(Row::broad_db))
    }

    /// Percentiles of each band's level (or of its density) over the whole time.
    pub fn by_band(&self, of: impl Fn(&Row) -> &[Option<f64>]) -> Vec<Option<Percentiles>> {
        let bands = self.edges_hz.len() - 1;
        (0..bands)
            .map(|band| Percentiles::of(self.rows.iter().map(|r| of(r).get(band).copied().flatten())))
            .collect()
    }

    /// All percentiles as records: over periods, and of each band over the whole time.
    pub fn records(&self, period_s: f64) -> Vec<Value> {
        let (from, to) = self.span_s();
        let ends = (self.edges_hz.first().copied(), self.edges_hz.last().copied());
        let record = |begins: f64,
                      duration_s: f64,
                      (from_hz, to_hz): (Option<f64>, Option<f64>),
                      p: &Percentiles| {
            let utc = OffsetDateTime::from_unix_timestamp_nanos((begins * 1e9) as i128)
                .ok()
                .filter(|_| self.is_utc);
            let tenth = |x: f64| (x * 100.0).round() / 100.0;
            json!({
                "type": "level_percentiles", "station": self.station, "channel": self.channel,
                "utc": utc.map(crate::record::utc), "t_s": (!self.is_utc).then_some(begins), "duration_s": duration_s,
                "reference": self.reference, "from_hz": from_hz, "to_hz": to_hz, "n": p.n,
                "l5_db": tenth(p.exceeded_db[0]), "l50_db": tenth(p.exceeded_db[1]), "l95_db": tenth(p.exceeded_db[2]),
                "mean_db": tenth(p.mean_db),
            })
        };
        let periods = self.over_time(period_s);
        let mut out: Vec<Value> = periods.iter().map(|(at, p)| record(*at, period_s, ends, p)).collect();
        out.extend(self.broad().map(|p| record(from, to - from, ends, &p)));
        for (band, p) in self.edges_hz.windows(2).zip(self.by_band(|row| &row.band_db)) {
            out.extend(p.map(|p| record(from, to - from, (Some(band[0]), Some(band[1])), &p)));
        }
        out
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Spectra each minute from 2024-05-01T00:00:00Z on: two bands, of 10 and 100 Hz, and two that are not measured.
    pub(in super::super) fn spectra(levels_db: impl Iterator<Item = f64>) -> Vec<Value> {
        let spectrum = |(k, level): (usize, f64)| {
            let at = OffsetDateTime::from_unix_timestamp(1_714_521_600 + 30 + 60 * k as i64).unwrap();
            json!({
                "type": "spectrum", "utc": crate::record::utc(at), "t_s": 30.0 + 60.0 * k as f64, "token": 0, "channel": 2,
                "channels": [], "frames": 100, "reference": "1 µPa", "edges_hz": [5.0, 10.0, 20.0, 120.0, 500.0],
                "density_db": [null, level, level - 10.0, null], "band_db": [null, level + 10.0, level + 10.0, null],
            })
        };
        levels_db.enumerate().map(spectrum).collect()
    }

    #[test]
    fn percentiles_are_of_what_is_exceeded_and_bands_add_up() {
        // Two hours: levels 0 to 59 dB in each, 20 dB more in the second.
        let records = spectra((0..120).map(|k| f64::from(k % 60) + if k >= 60 { 20.0 } else { 0.0 }));
        let answer = json!({"type": "spectrum", "token": 3, "channel": 2});
        let (told, left_out) = sorted(records.iter().chain([&answer]));
        assert_eq!((told.len(), left_out), (1, 0));
        let told = &told[0];
        assert_eq!((told.is_utc, told.every_s(), told.rows.len()), (true, 60.0, 120));
        let hours = told.over_time(3600.0);
        let both = 10.0 + 10.0 * 2f64.log10();
        assert_eq!(hours.len(), 2);
        assert_eq!(hours[1].0 - hours[0].0, 3600.0);
        for (k, (_, p)) in hours.iter().enumerate() {
            let more = 20.0 * k as f64 + both;
            // Exceeded for 5 % of 0 to 59: 95 % of the way.
            for (found, want) in p.exceeded_db.iter().zip([0.95 * 59.0, 29.5, 0.05 * 59.0]) {
                assert!((found - want - more).abs() < 1e-9, "{found} {want}");
            }
            assert_eq!(p.n, 60);
        }
        assert!(hours[0].1.mean_db > hours[0].1.exceeded_db[1]);
        let bands = told.by_band(|row| &row.density_db);
        assert!((bands[0].unwrap().exceeded_db[1] - bands[1].unwrap().exceeded_db[1] - 10.0).abs() < 1e-9);
        // 20 minutes are no usual period; half an hour is.
        assert_eq!(told.period_s(), 1800.0);
        let records = told.records(3600.0);
        assert_eq!(records.len(), 2 + 1 + 2);
        assert_eq!((&records[2]["from_hz"], &records[2]["to_hz"]), (&10.0.into(), &120.0.into()));
        assert_eq!((&records[1]["utc"], &records[0]["n"]), (&"2024-05-01T01:00:00Z".into(), &60.into()));
    }

    #[test]
    fn what_was_not_measured_counts_nowhere_and_times_are_of_one_kind() {
        let mut records = spectra([50.0, 60.0, 70.0].into_iter());
        records[1]["band_db"] = json!([null, null, null, null]);
        let (told, _) = sorted(records.iter());
        assert_eq!((told[0].broad().unwrap().n, told[0].rows.len()), (2, 3));
        records[0]["utc"] = Value::Null;
        let (told, left_out) = sorted(records.iter());
        assert_eq!((told[0].rows.len(), left_out, told[0].is_utc), (2, 1, true));
        records.iter_mut().for_each(|r| r["utc"] = Value::Null);
        let (told, left_out) = sorted(records.iter());
        assert_eq!((told[0].rows[0].at_s, left_out, told[0].is_utc), (30.0, 0, false));
        records[0]["station"] = 8.into();
        assert_eq!(sorted(records.iter()).0.len(), 2);
    }
}
