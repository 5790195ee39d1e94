//! Reading a store: what opening needs, the bytes, and the records.

use super::super::record::{Row, micros};
use super::super::recorder::{SESSIONS, Session};
use super::super::{Base, Beginning, Halfway};
use super::look::Look;
use super::schema::{knows_relayed, number, open_to_read, station};
use super::write::unpacked;
use super::{Entry, Event, damaged, earlier};
use anyhow::{Context, Result};
use rusqlite::{Connection, OptionalExtension, params};
use seabearing_core::wire::{Message, link, message_of};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use time::OffsetDateTime;

/// Reports of tracks that a base station has at hand when it begins.
pub(super) const REPORTS: i64 = 2000;
/// Records among which these are looked for.
pub(super) const LOOKED_AT: i64 = 20_000;
/// Messages about a session's clock that are looked at to know it.
pub(super) const CLOCKS: i64 = 64;
/// Which records these are: `Time`, and of `Fault` (its code is the second byte) `ClockStepped`.
pub(super) const CLOCKS_OF: &str = "(kind = 12 OR kind = 7 AND hex(substr(body, 2, 1)) = '0F')";
/// Sessions and logs of a recorder that are taken up: those of which records may still come.
const RECENT: i64 = SESSIONS as i64;
/// Sessions whose clocks are taken up.
pub(super) const CLOCKED: usize = 10;

/// Tells a base station of sessions, links, the latest reports and what a person said of stations.
pub(super) fn resume(db: &Connection, base: &mut Base) -> Result<()> {
    let mut stations = db.prepare("SELECT station, rate_hz FROM stations")?;
    let found = stations.query_map([], |r| Ok((r.get::<_, i64>(0)?, r.get::<_, Option<f64>>(1)?)))?;
    for found in found {
        let (of, rate_hz) = found?;
        match station(of) {
            Some(of) => base.recorder(Some(of)).rate_hz = rate_hz,
            None => base.rate_hz = base.rate_hz.or(rate_hz),
        }
    }
    let mut known = db.prepare("SELECT DISTINCT station FROM sessions")?;
    for of in known.query_map([], |r| r.get::<_, i64>(0))? {
        resume_station(db, of?, base)?;
    }
    let newest: i64 = db.query_row("SELECT ifnull(max(id), 0) FROM records", [], |r| r.get(0))?;
    let mut tracks = db.prepare(&format!(
        "SELECT {COLUMNS} FROM records NOT INDEXED WHERE track IS NOT NULL AND id > ?1 ORDER BY id DESC LIMIT ?2"
    ))?;
    let rows = tracks.query_map([newest - LOOKED_AT, REPORTS], row)?;
    let rows = rows.map(|row| row?).collect::<Result<Vec<_>>>()?;
    for row in rows.into_iter().rev() {
        let of = row.station;
        base.recorder(of).keep_track(row, REPORTS as usize);
    }
    if knows_relayed(db, "main")? { resume_relayed(db, base) } else { Ok(()) }
}

/// What has come of other base stations.
fn resume_relayed(db: &Connection, base: &mut Base) -> Result<()> {
    for (table, seen) in base.sources.seen_mut() {
        let mut runs = db.prepare(&format!("SELECT log, first, last FROM {table}"))?;
        let numbers =
            |r: &rusqlite::Row<'_>| Ok([r.get::<_, i64>(0)?, r.get(1)?, r.get(2)?].map(|n| n as u64));
        for run in runs.query_map([], numbers)? {
            let [log, first, last] = run?;
            seen.resume(log, first, last);
        }
    }
    let mut sessions = db.prepare("SELECT log, station, session, here FROM relayed_sessions")?;
    let sessions = sessions.query_map([], |r| {
        Ok(((r.get::<_, i64>(0)? as u64, station(r.get(1)?), r.get(2)?), r.get::<_, u32>(3)?))
    })?;
    for known in sessions {
        let (of, here) = known?;
        base.sources.sessions.insert(of, here);
    }
    Ok(())
}

fn resume_station(db: &Connection, of: i64, base: &mut Base) -> Result<()> {
    let mut sessions = db.prepare(
        "SELECT session, boot, rate_hz, start_us FROM sessions WHERE station = ?1 ORDER BY session DESC LIMIT ?2",
    )?;
    let recorder = base.recorder(station(of));
    let rows = sessions.query_map([of, RECENT], |r| {
        let session =
            Session { boot: r.get(1)?, rate_hz: r.get(2)?, start_us: r.get(3)?, ..Session::default() };
        Ok((r.get::<_, u32>(0)?, session))
    })?;
    for (n, row) in rows.enumerate() {
        let (number, mut session) = row?;
        for message in if n < CLOCKED { clocks(db, of, number)? } else { Vec::new() } {
            session.note(&message);
        }
        recorder.sessions.insert(number, session);
    }
    recorder.plain = recorder.sessions.iter().rev().find(|(_, s)| s.boot.is_none()).map(|(n, _)| *n);
    let mut logs =
        db.prepare("SELECT log, progress FROM logs WHERE station = ?1 ORDER BY log DESC LIMIT ?2")?;
    let rows = logs.query_map([of, RECENT], |r| Ok((r.get::<_, u32>(0)?, r.get::<_, Vec<u8>>(1)?)))?;
    for row in rows {
        let (log, progress) = row?;
        if let Some(of) = station(of) {
            base.logs.insert((of, log), unpacked(&progress)?);
        }
    }
    Ok(())
}

/// What a session's recorder last said of its clock, oldest first.
fn clocks(db: &Connection, of: i64, session: u32) -> Result<Vec<Message>> {
    let mut told = db.prepare(&format!(
        "SELECT body, id FROM records WHERE station = ?1 AND session = ?2 AND kind IN (7, 12) AND {CLOCKS_OF}
         UNION SELECT body, id FROM clocks WHERE station = ?1 AND session = ?2 ORDER BY id DESC LIMIT ?3"
    ))?;
    let bodies = told.query_map(params![of, session, CLOCKS], |r| r.get::<_, Vec<u8>>(0))?;
    let mut messages = bodies.map(|b| Ok(message_of(&b?))).collect::<Result<Vec<_>>>()?;
    messages.reverse();
    Ok(messages.into_iter().flatten().collect())
}

/// Rows of `bytes` from a number on. `store`: the store's own file, where the connections stand.
pub(super) fn entries(
    db: &Connection,
    store: &Connection,
    from: i64,
    most: i64,
) -> Result<Vec<(i64, Entry)>> {
    let mut rows = db.prepare(
        "SELECT id, stream, received_us, event, data FROM bytes WHERE id >= ?1 ORDER BY id LIMIT ?2",
    )?;
    let mut streams = store.prepare("SELECT line, peer, expected, lasting FROM streams WHERE stream = ?1")?;
    let mut beginning = |stream: u32| {
        let found = streams.query_row([stream], |r| {
            Ok(Beginning { line: r.get(0)?, peer: r.get(1)?, station: r.get(2)?, lasting: r.get(3)? })
        });
        found.optional().map(Option::unwrap_or_default)
    };
    let found = rows.query_map([from, most], |r| {
        let data: Option<Vec<u8>> = r.get(4)?;
        let stream = r.get(1)?;
        let event = match r.get::<_, i64>(3)? {
            0 => Event::Bytes(data.unwrap_or_default()),
            1 => Event::Began(beginning(stream)?),
            2 => Event::Silent,
            4 => {
                let (station, what) = serde_json::from_slice(&data.unwrap_or_default()).unwrap_or_default();
                Event::Noted(station, what)
            }
            5 => Event::Relayed(data.unwrap_or_default()),
            _ => Event::Ended(data.map(|d| String::from_utf8_lossy(&d).into_owned())),
        };
        Ok((r.get(0)?, Entry { stream, received_us: r.get(2)?, event }))
    })?;
    let found = found.collect::<rusqlite::Result<Vec<(i64, Entry)>>>()?;
    let mut least = from;
    for (id, _) in &found {
        if *id < least {
            // Whoever goes on after the last would come to the same rows for ever.
            let damage = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_CORRUPT);
            return Err(rusqlite::Error::SqliteFailure(damage, Some("rows out of order".into())).into());
        }
        least = id.saturating_add(1);
    }
    Ok(found)
}

/// A connection of which all before a row was decoded: who speaks on it, and the frame that was not complete.
pub(super) fn take_up(db: &Connection, stream: u32, before: i64, base: &mut Base) -> Result<()> {
    let known = db
        .query_row(
            "SELECT line, peer, expected, lasting, station, session, up, silent, replaced_us, replaced_by, newest, log, boot,
             config_hash FROM streams WHERE stream = ?1",
            [stream],
            |r| {
                let beginning =
                    Beginning { line: r.get(0)?, peer: r.get(1)?, station: r.get(2)?, lasting: r.get(3)? };
                let who = r.get::<_, Option<u16>>(4)?;
                let (log, boot, hash) = (r.get(11)?, r.get(12)?, r.get::<_, Option<i64>>(13)?);
                let log = who.zip(log).zip(boot).zip(hash);
                let halfway = Halfway {
                    who,
                    session: r.get(5)?,
                    up: r.get(6)?,
                    silent: r.get(7)?,
                    replaced: r.get::<_, Option<i64>>(8)?.zip(r.get::<_, Option<u32>>(9)?),
                    newest: r.get(10)?,
                    log: log.map(|(((station, log), boot), hash)| link::Session {
                        station,
                        log,
                        boot,
                        config_hash: hash as u64,
                    }),
                };
                Ok((beginning, halfway))
            },
        )
        .optional()?;
    let Some((beginning, halfway)) = known else { return Ok(()) };
    base.begin(stream, beginning, None);
    base.take_up(stream, &Halfway { replaced: None, silent: false, ..halfway });
    // Back to the delimiter before.
    let mut rows = db.prepare(
        "SELECT data FROM bytes WHERE stream = ?1 AND id < ?2 AND id > ?2 - 100000 AND event = 0 ORDER BY id DESC LIMIT 400",
    )?;
    let mut tail = Vec::new();
    for data in rows.query_map(params![stream, before], |r| r.get::<_, Vec<u8>>(0))? {
        let mut data = data?;
        let end = data.iter().rposition(|b| *b == 0);
        data.drain(..end.map_or(0, |at| at + 1));
        data.append(&mut tail);
        tail = data;
        if end.is_some() {
            break;
        }
    }
    // Without a delimiter it gives nothing.
    base.push(stream, 0, None, &tail, &mut Vec::new());
    base.take_up(stream, &Halfway { newest: None, log: None, ..halfway });
    Ok(())
}

/// Samples a second of every session, by station.
pub(super) fn rates(db: &Connection) -> Result<BTreeMap<(i64, u32), Option<f64>>> {
    let mut sessions = db.prepare("SELECT station, session, rate_hz FROM sessions")?;
    let found = sessions.query_map([], |r| Ok(((r.get(0)?, r.get(1)?), r.get(2)?)))?;
    Ok(found.collect::<rusqlite::Result<_>>()?)
}

/// The columns that [`row`] reads.
pub(super) const COLUMNS: &str = "station, session, sequence, utc_us, sd_s, received_us, kind, body";

/// A record from its columns; an error inside is one of its body.
pub(super) fn row(r: &rusqlite::Row<'_>) -> rusqlite::Result<Result<Row>> {
    let body: Vec<u8> = r.get(7)?;
    let kind: u8 = r.get(6)?;
    let (utc_us, sd_s): (Option<i64>, Option<f64>) = (r.get(3)?, r.get(4)?);
    let (of, session, sequence, received_us) = (r.get(0)?, r.get(1)?, r.get(2)?, r.get(5)?);
    Ok(Row::body(kind, &body).map(|(body, origin)| Row {
        origin,
        station: station(of),
        session,
        sequence,
        utc: utc_us.map(|us| (us, sd_s)),
        received_us,
        body,
    }))
}

/// Which records are wanted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wanted {
    /// At or after this UTC.
    pub from: Option<OffsetDateTime>,
    /// Before this UTC.
    pub to: Option<OffsetDateTime>,
    /// Of this station.
    pub station: Option<u16>,
    /// Of this track: its session and number.
    pub track: Option<(u32, u16)>,
}

/// Hands out records of a store, oldest first: in the order in which they came, or by their UTC where an interval of that
/// is wanted. Nothing in it is changed: a base station may be writing. Gives how many records of the station were left out
/// of an interval because they carry no UTC.
///
/// # Errors
/// There is no store, or it cannot be read.
pub fn read(folder: &Path, wanted: &Wanted, mut take: impl FnMut(Value)) -> Result<u64> {
    if earlier::is_one(folder) {
        return earlier::read(folder, wanted, take);
    }
    let unreadable = || format!("{}: cannot read the store of a base station", folder.display());
    let given = try_read(folder, wanted, &mut take);
    given.map_err(|e| damaged(e, folder)).with_context(unreadable)
}

fn try_read(folder: &Path, wanted: &Wanted, take: &mut dyn FnMut(Value)) -> Result<u64> {
    let (mut live, _) = open_to_read(folder)?;
    // One look at it, whatever is written meanwhile.
    let live = live.transaction()?;
    let rates = rates(&live)?;
    let (mut conditions, mut values) = (Vec::new(), Vec::new());
    let mut add = |condition: &str, value: i64| {
        values.push(value);
        conditions.push(format!("{condition} ?{}", values.len()));
    };
    if let Some(of) = wanted.station {
        add("station =", of.into());
    }
    if let Some((session, track)) = wanted.track {
        add("session =", session.into());
        add("track =", track.into());
    }
    let (from, to) = (wanted.from.map(micros), wanted.to.map(micros));
    from.into_iter().for_each(|us| add("utc_us >=", us));
    to.into_iter().for_each(|us| add("utc_us <", us));
    let timed = from.or(to).map(|_| (from.unwrap_or(i64::MIN), to.unwrap_or(i64::MAX)));
    let look = Look::at(&live, folder)?;
    let mut undated = 0;
    if timed.is_some() {
        let of = wanted.station.map_or(String::new(), |s| format!(" AND station = {s}"));
        let query = format!("SELECT count(*) FROM records WHERE utc_us IS NULL{of}");
        for db in look.records(None)?.iter().chain([&*live]) {
            undated += db.query_row(&query, [], |r| r.get::<_, i64>(0))? as u64;
        }
    }
    let order = if timed.is_some() { "utc_us, id" } else { "id" };
    let filter =
        if conditions.is_empty() { String::new() } else { format!("WHERE {}", conditions.join(" AND ")) };
    let query = format!("SELECT {COLUMNS} FROM records {filter} ORDER BY {order}");
    let files = look.records(timed)?;
    let all = files.iter().chain([&*live]);
    let mut parts = all.map(|db| Ok(db.prepare(&query)?)).collect::<Result<Vec<_>>>()?;
    let mut parts = parts
        .iter_mut()
        .map(|part| Ok(part.query_map(rusqlite::params_from_iter(&values), row)?.peekable()))
        .collect::<Result<Vec<_>>>()?;
    loop {
        // Months follow each other as they came; by UTC a record may belong before those of an earlier month.
        let next = parts.iter_mut().enumerate().filter_map(|(n, part)| {
            let utc = match part.peek()? {
                Ok(Ok(row)) if timed.is_some() => row.utc.map(|u| u.0),
                _ => None,
            };
            Some((utc, n))
        });
        let Some(found) = next.min().and_then(|(_, n)| parts.get_mut(n)?.next()) else { return Ok(undated) };
        let row = found??;
        let rate_hz = row.session.and_then(|s| *rates.get(&(number(row.station), s))?);
        take(row.json(rate_hz));
    }
}

/// Where the stations of a store are, by number; `None` is what was said of any.
///
/// # Errors
/// The store cannot be read.
pub fn positions(folder: &Path) -> Result<BTreeMap<Option<u16>, (f64, f64)>> {
    if earlier::is_one(folder) {
        return Ok(earlier::About::read(folder)?.place.map(|p| (None, p)).into_iter().collect());
    }
    let unreadable = || format!("{}: cannot read the store of a base station", folder.display());
    let given = (|| {
        let (db, _) = open_to_read(folder)?;
        let mut places =
            db.prepare("SELECT station, lat_deg, lon_deg FROM stations WHERE lat_deg IS NOT NULL")?;
        let found = places.query_map([], |r| Ok((station(r.get(0)?), (r.get(1)?, r.get(2)?))))?;
        Ok(found.collect::<rusqlite::Result<_>>()?)
    })();
    given.map_err(|e| damaged(e, folder)).with_context(unreadable)
}

/// UTC of the newest dated record of a recorder, microseconds since 1970; what the base station notes itself does not count.
///
/// # Errors
/// The store cannot be read.
pub fn newest_us(folder: &Path) -> Result<Option<i64>> {
    let unreadable = || format!("{}: cannot read the store of a base station", folder.display());
    try_newest_us(folder).map_err(|e| damaged(e, folder)).with_context(unreadable)
}

fn try_newest_us(folder: &Path) -> Result<Option<i64>> {
    let (mut live, _) = open_to_read(folder)?;
    let live = live.transaction()?;
    let newest =
        "SELECT utc_us FROM records WHERE utc_us IS NOT NULL AND kind < 200 ORDER BY utc_us DESC LIMIT 1";
    let ask = |db: &Connection| db.query_row(newest, [], |r| r.get::<_, i64>(0)).optional();
    if let Some(found) = ask(&live)? {
        return Ok(Some(found));
    }
    let months = Look::at(&live, folder)?.records(None)?;
    Ok(months.iter().map(ask).collect::<rusqlite::Result<Vec<_>>>()?.into_iter().flatten().max())
}

/// The stations that have records.
///
/// # Errors
/// The store cannot be read.
pub fn stations(folder: &Path) -> Result<BTreeSet<u16>> {
    if earlier::is_one(folder) {
        return earlier::stations(folder);
    }
    let unreadable = || format!("{}: cannot read the store of a base station", folder.display());
    let given = (|| {
        let (db, _) = open_to_read(folder)?;
        let mut known = db.prepare("SELECT DISTINCT station FROM sessions")?;
        let found = known.query_map([], |r| Ok(station(r.get(0)?)))?;
        Ok(found.collect::<rusqlite::Result<Vec<_>>>()?.into_iter().flatten().collect())
    })();
    given.map_err(|e| damaged(e, folder)).with_context(unreadable)
}
