//! What stood at a moment: of a store, without reading through it. Every query is a number of steps into an index that does
//! not grow with what the store holds.

use super::super::record::{Body, Row};
use super::damaged;
use super::read::{COLUMNS, rates, row};
use super::schema::{NOBODY, number, open_to_read, station};
use anyhow::{Context, Result};
use rusqlite::{Connection, OptionalExtension, params};
use seabearing_core::wire::Message;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// Kinds of which the newest before a moment are wanted, and how many: several bearings, azimuths and ranges may be of one
/// instant.
const NEWEST: [(u8, i64); 10] =
    [(1, 6), (3, 1), (4, 4), (5, 4), (7, 12), (9, 1), (10, 1), (11, 6), (12, 1), (200, 12)];
/// Of these only those of the newest instants, microseconds.
const INSTANT: ([u8; 3], i64) = ([1, 4, 5], 15_000_000);
/// The kind of tracks' reports.
const TRACK: u8 = 2;
/// Reports of tracks of one station that a moment shows.
const REPORTS: usize = 60;
/// 2000-01-01, microseconds since 1970: what is said to be earlier has no clock.
const EARLIEST_US: i64 = 946_684_800_000_000;
/// How far ahead of its coming a record's time is believed, microseconds.
const AHEAD_US: i64 = 3_600_000_000;

/// What was known at a moment.
#[derive(Debug, Default)]
pub struct Moment {
    /// The newest records of every kind and station, the newest report of every track among them; oldest first.
    pub records: Vec<Value>,
    /// Where the tracks were.
    pub paths: Vec<Path>,
}

/// Where a track was.
#[derive(Debug, PartialEq)]
pub struct Path {
    /// Station.
    pub station: Option<u16>,
    /// Its session.
    pub session: u32,
    /// Number of the track.
    pub track: u16,
    /// Milliseconds since 1970, metres East and North of the station, in order.
    pub places: Vec<[f64; 3]>,
}

/// Where the report of a track puts the vessel, if its range is observable.
fn place(report: &Row) -> Option<[f64; 3]> {
    let (Body::Message(Message::Track(track)), Some((us, _))) = (&report.body, report.utc) else {
        return None;
    };
    let place = [us as f64 / 1e3, track.x_m.into(), track.y_m.into()];
    (track.range_observable && place.iter().all(|x| x.is_finite())).then_some(place)
}

/// An open store to look back into, while a base station may be writing.
pub struct History {
    db: Connection,
    folder: PathBuf,
}

impl History {
    /// Opens it.
    ///
    /// # Errors
    /// There is no store, or it cannot be read.
    pub fn open(folder: &std::path::Path) -> Result<Self> {
        let db = open_to_read(folder).map_err(|e| damaged(e, folder));
        let db = db.with_context(|| format!("cannot look into the store {}", folder.display()))?;
        Ok(Self { db, folder: folder.to_owned() })
    }

    /// UTC of the oldest and of the newest record, microseconds since 1970. Times that no record can be of, from clocks
    /// that jumped, do not count.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn span_us(&self) -> Result<Option<(i64, i64)>> {
        self.explained((|| {
            let came =
                "SELECT max(received_us) FROM (SELECT received_us FROM records ORDER BY id DESC LIMIT 100)";
            let came: Option<i64> = self.db.query_row(came, [], |r| r.get(0))?;
            let last = came.map_or(i64::MAX, |us| us.saturating_add(AHEAD_US));
            let oldest = "SELECT min(utc_us) FROM records WHERE utc_us >= ?1 AND utc_us <= ?2";
            let newest = oldest.replace("min", "max");
            let ask =
                |query: &str| self.db.query_row(query, [EARLIEST_US, last], |r| r.get::<_, Option<i64>>(0));
            Ok(ask(oldest)?.zip(ask(&newest)?))
        })())
    }

    /// What was known at `at_us`: of every station who speaks, its newest bearings, azimuths, ranges, health, clock and
    /// events, and the tracks that were reported since `since_us`.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn moment(&self, at_us: i64, since_us: i64) -> Result<Moment> {
        self.explained(self.try_moment(at_us, since_us))
    }

    fn try_moment(&self, at_us: i64, since_us: i64) -> Result<Moment> {
        let (mut rows, mut paths): (Vec<Row>, BTreeMap<_, Vec<_>>) = Default::default();
        let mut newest = self.db.prepare(&format!(
            "SELECT {COLUMNS} FROM records WHERE station = ?1 AND kind = ?2 AND utc_us <= ?3 ORDER BY utc_us DESC LIMIT ?4"
        ))?;
        let mut hello = self.db.prepare(&format!(
            "SELECT {COLUMNS} FROM records WHERE station = ?1 AND session = ?2 AND utc_us IS NULL AND kind = 0 LIMIT 1"
        ))?;
        let mut last = self.db.prepare(&format!(
            "SELECT {COLUMNS} FROM records WHERE station = ?1 AND session = ?2 AND track = ?3 AND utc_us <= ?4
             ORDER BY id DESC LIMIT 1"
        ))?;
        for of in self.stations()? {
            let before = rows.len();
            for (kind, most) in NEWEST {
                let first = rows.len();
                for found in newest.query_map(params![of, kind, at_us, most], row)? {
                    rows.push(found??);
                }
                let when = |row: &Row| row.utc.map(|u| u.0);
                if let Some(last) = rows.get(first).and_then(when).filter(|_| INSTANT.0.contains(&kind)) {
                    let earlier = rows.iter().skip(first).position(|r| when(r) < Some(last - INSTANT.1));
                    rows.truncate(earlier.map_or(rows.len(), |n| first + n));
                }
            }
            let mut tracks = BTreeSet::new();
            for report in self.thinned(of, TRACK, (since_us, at_us + 1), REPORTS)? {
                let (Some(session), Some(track)) = (report.session, report.track()) else { continue };
                tracks.insert((session, track));
                paths.entry((of, session, track)).or_default().extend(place(&report));
            }
            for (session, track) in tracks {
                if let Some(found) = last.query_row(params![of, session, track, at_us], row).optional()? {
                    let found = found?;
                    paths.entry((of, session, track)).or_default().extend(place(&found));
                    rows.push(found);
                }
            }
            let of_station = rows.get(before..).unwrap_or(&[]);
            let session = of_station.iter().max_by_key(|r| r.utc.map(|u| u.0)).and_then(|r| r.session);
            if let Some(found) = hello.query_row(params![of, session], row).optional()? {
                rows.insert(before, found?);
            }
        }
        rows.sort_by_key(|r| r.utc.map(|u| u.0));
        let path = |((of, session, track), places)| Path { station: station(of), session, track, places };
        Ok(Moment { records: self.json(&rows)?, paths: paths.into_iter().map(path).collect() })
    }

    /// Records of one station and kind from `from_us` to before `to_us`, in order; of many about `most`, evenly in time.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn series(
        &self,
        of: Option<u16>,
        kind: u8,
        from_us: i64,
        to_us: i64,
        most: usize,
    ) -> Result<Vec<Value>> {
        self.explained((|| self.json(&self.thinned(number(of), kind, (from_us, to_us), most)?))())
    }

    fn thinned(&self, of: i64, kind: u8, (from_us, to_us): (i64, i64), most: usize) -> Result<Vec<Row>> {
        let within = "FROM records WHERE station = ?1 AND kind = ?2 AND utc_us >= ?3 AND utc_us < ?4";
        // More than that need not be counted.
        let count = format!("SELECT count(*) FROM (SELECT 1 {within} LIMIT {})", most + 1);
        let all: i64 = self.db.query_row(&count, params![of, kind, from_us, to_us], |r| r.get(0))?;
        let (slots, each) = if all > most as i64 { (most.max(1) as i64, 1) } else { (1, most as i64) };
        let mut take = self.db.prepare(&format!("SELECT {COLUMNS} {within} ORDER BY utc_us LIMIT ?5"))?;
        let mut rows = Vec::new();
        let slot = |n: i64| from_us + ((to_us - from_us) as f64 / slots as f64 * n as f64) as i64;
        for n in 0..slots {
            let end = if n + 1 == slots { to_us } else { slot(n + 1) };
            for found in take.query_map(params![of, kind, slot(n), end, each], row)? {
                rows.push(found??);
            }
        }
        Ok(rows)
    }

    /// The stations that have records, and nobody.
    fn stations(&self) -> Result<Vec<i64>> {
        let mut known = self.db.prepare("SELECT DISTINCT station FROM sessions WHERE station <> ?1")?;
        let found = known.query_map([NOBODY], |r| r.get(0))?;
        let mut all = vec![NOBODY];
        all.extend(found.collect::<rusqlite::Result<Vec<i64>>>()?);
        Ok(all)
    }

    fn json(&self, rows: &[Row]) -> Result<Vec<Value>> {
        let rates: BTreeMap<(i64, u32), Option<f64>> = rates(&self.db)?;
        let rate = |row: &Row| row.session.and_then(|s| *rates.get(&(number(row.station), s))?);
        Ok(rows.iter().map(|row| row.json(rate(row))).collect())
    }

    fn explained<T>(&self, result: Result<T>) -> Result<T> {
        result
            .map_err(|e| damaged(e, &self.folder))
            .with_context(|| format!("cannot look into the store {}", self.folder.display()))
    }
}
