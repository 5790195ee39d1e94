//! What stood at a moment: of a store, without reading through it. Every query is a number of steps into an index that does
//! not grow with what the store holds. Of the files of months only those are opened that have some of the interval asked for.

use super::super::record::{Body, Row};
use super::damaged;
use super::look::Look;
use super::read::{COLUMNS, rates, row};
use super::schema::{NOBODY, number, open_to_read, station};
use anyhow::{Context, Result};
use rusqlite::{Connection, params};
use seabearing_core::wire::Message;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// Kinds of which the newest before a moment are wanted, and how many: several bearings, azimuths and ranges may be of one
/// instant.
const NEWEST: [(u8, i64); 12] =
    [(1, 6), (3, 1), (4, 4), (5, 4), (7, 12), (9, 1), (10, 1), (11, 6), (12, 1), (17, 1), (18, 1), (200, 24)];
/// Of these only those of the newest instants, microseconds.
const INSTANT: ([u8; 3], i64) = ([1, 4, 5], 15_000_000);
/// The kind of tracks' reports.
const TRACK: u8 = 2;
/// Reports of tracks of one station that a moment shows.
const REPORTS: usize = 60;
/// 2000-01-01, microseconds since 1970: what is said to be earlier has no clock.
const EARLIEST_US: i64 = 946_684_800_000_000;
/// How long before a moment something was said last that still counts then, microseconds.
const BACK_US: i64 = 31 * 86_400_000_000;
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

/// The databases that have some of an interval, the newest first; the store's own is always among them.
struct View<'a> {
    live: &'a Connection,
    months: Vec<Connection>,
}

impl View<'_> {
    fn all(&self) -> impl Iterator<Item = &Connection> {
        std::iter::once(self.live).chain(self.months.iter().rev())
    }
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
        let (db, _) = db.with_context(|| format!("cannot look into the store {}", folder.display()))?;
        Ok(Self { db, folder: folder.to_owned() })
    }

    /// UTC of the oldest and of the newest record, microseconds since 1970. Times that no record can be of, from clocks
    /// that jumped, do not count.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn span_us(&self) -> Result<Option<(i64, i64)>> {
        self.explained((|| {
            let look = self.db.unchecked_transaction()?;
            let came =
                "SELECT max(received_us) FROM (SELECT received_us FROM records ORDER BY id DESC LIMIT 100)";
            let came: Option<i64> = self.db.query_row(came, [], |r| r.get(0))?;
            let last = came.map_or(i64::MAX, |us| us.saturating_add(AHEAD_US));
            let oldest = "SELECT min(utc_us) FROM records WHERE utc_us >= ?1 AND utc_us <= ?2";
            let newest = oldest.replace("min", "max");
            let ask = |db: &Connection, query: &str| {
                db.query_row(query, [EARLIEST_US, last], |r| r.get::<_, Option<i64>>(0))
            };
            let mut span = ask(&self.db, oldest)?.zip(ask(&self.db, &newest)?);
            for month in Look::at(&look, &self.folder)?.records(Some((EARLIEST_US, last)))? {
                let of = ask(&month, oldest)?.zip(ask(&month, &newest)?);
                span = match (span, of) {
                    (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
                    (a, b) => a.or(b),
                };
            }
            Ok(span)
        })())
    }

    /// What was known at `at_us`: of every station who speaks, its newest bearings, azimuths, ranges, health, clock and
    /// events of a month or so before, and the tracks that were reported since `since_us`.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn moment(&self, at_us: i64, since_us: i64) -> Result<Moment> {
        self.explained(self.try_moment(at_us, since_us))
    }

    fn try_moment(&self, at_us: i64, since_us: i64) -> Result<Moment> {
        let (mut rows, mut paths): (Vec<Row>, BTreeMap<_, Vec<_>>) = Default::default();
        let look = self.db.unchecked_transaction()?;
        let back = since_us.min(at_us.saturating_sub(BACK_US));
        let view = self.view(&look, (back, at_us.saturating_add(1)))?;
        let newest = "station = ?1 AND kind = ?2 AND utc_us <= ?3 ORDER BY utc_us DESC LIMIT ?4";
        let hello = "station = ?1 AND session = ?2 AND utc_us IS NULL AND kind = 0 LIMIT 1";
        let last = "station = ?1 AND session = ?2 AND track = ?3 AND utc_us <= ?4 ORDER BY id DESC LIMIT 1";
        let when = |row: &Row| row.utc.map(|u| u.0);
        for of in self.stations()? {
            let before = rows.len();
            for (kind, most) in NEWEST {
                let mut found = Vec::new();
                for db in view.all() {
                    found.extend(some(db, newest, params![of, kind, at_us, most])?);
                }
                // What came late may be older than what is in the file of the month before.
                found.sort_by_key(|row| std::cmp::Reverse(when(row)));
                found.truncate(most as usize);
                if let Some(last) = found.first().and_then(when).filter(|_| INSTANT.0.contains(&kind)) {
                    found.retain(|row| when(row) >= Some(last - INSTANT.1));
                }
                rows.extend(found);
            }
            let mut tracks = BTreeSet::new();
            for report in thinned(&view, of, TRACK, (since_us, at_us + 1), REPORTS)? {
                let (Some(session), Some(track)) = (report.session, report.track()) else { continue };
                tracks.insert((session, track));
                paths.entry((of, session, track)).or_default().extend(place(&report));
            }
            for (session, track) in tracks {
                if let Some(found) = first(&view, last, params![of, session, track, at_us])? {
                    paths.entry((of, session, track)).or_default().extend(place(&found));
                    rows.push(found);
                }
            }
            let of_station = rows.get(before..).unwrap_or(&[]);
            let session = of_station.iter().max_by_key(|r| when(r)).and_then(|r| r.session);
            if let Some(found) = first(&view, hello, params![of, session])? {
                rows.insert(before, found);
            }
        }
        rows.sort_by_key(when);
        let path = |((of, session, track), places)| Path { station: station(of), session, track, places };
        Ok(Moment { records: self.json(&rows)?, paths: paths.into_iter().map(path).collect() })
    }

    /// The databases with some of an interval of UTC, within a transaction.
    fn view<'a>(&self, live: &'a Connection, span_us: (i64, i64)) -> Result<View<'a>> {
        Ok(View { live, months: Look::at(live, &self.folder)?.records(Some(span_us))? })
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
        self.explained((|| {
            let look = self.db.unchecked_transaction()?;
            let view = self.view(&look, (from_us, to_us))?;
            self.json(&thinned(&view, number(of), kind, (from_us, to_us), most)?)
        })())
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

/// Rows of one database.
fn some(db: &Connection, condition: &str, values: impl rusqlite::Params) -> Result<Vec<Row>> {
    let mut rows = db.prepare_cached(&format!("SELECT {COLUMNS} FROM records WHERE {condition}"))?;
    let found = rows.query_map(values, row)?.collect::<rusqlite::Result<Vec<_>>>()?;
    found.into_iter().collect()
}

/// The newest of one row a database.
fn first(view: &View<'_>, condition: &str, values: &[&dyn rusqlite::ToSql]) -> Result<Option<Row>> {
    for db in view.all() {
        if let Some(found) = some(db, condition, values)?.pop() {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

/// Records of an interval in order; of many about `most`, evenly in time.
fn thinned(
    view: &View<'_>,
    of: i64,
    kind: u8,
    (from_us, to_us): (i64, i64),
    most: usize,
) -> Result<Vec<Row>> {
    let within = "station = ?1 AND kind = ?2 AND utc_us >= ?3 AND utc_us < ?4";
    // More than that need not be counted.
    let count = format!("SELECT count(*) FROM (SELECT 1 FROM records WHERE {within} LIMIT {})", most + 1);
    let mut all = 0;
    for db in view.all() {
        all += db.query_row(&count, params![of, kind, from_us, to_us], |r| r.get::<_, i64>(0))?;
    }
    let (slots, each) = if all > most as i64 { (most.max(1) as i64, 1) } else { (1, most as i64) };
    let take = format!("{within} ORDER BY utc_us LIMIT ?5");
    let mut rows = Vec::new();
    let slot = |n: i64| from_us + ((to_us - from_us) as f64 / slots as f64 * n as f64) as i64;
    for n in 0..slots {
        let end = if n + 1 == slots { to_us } else { slot(n + 1) };
        let mut found = Vec::new();
        for db in view.all() {
            found.extend(some(db, &take, params![of, kind, slot(n), end, each])?);
        }
        found.sort_by_key(|row| row.utc.map(|u| u.0));
        found.truncate(each as usize);
        rows.extend(found);
    }
    Ok(rows)
}
