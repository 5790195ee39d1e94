//! What the second transaction of a store writes: records, and what has changed of sessions, logs and connections.

use super::super::record::Row;
use super::super::{Base, Beginning};
use super::months::{date, date_moved};
use super::schema::number;
use anyhow::{Result, bail};
use rusqlite::{Transaction, params};
use seabearing_core::wire::link::{CLASSES, Progress};
use std::path::Path;

/// A connection begins.
pub(super) fn begin(db: &Transaction<'_>, stream: u32, beginning: &Beginning) -> Result<()> {
    let Beginning { line, peer, station, lasting } = beginning;
    db.execute(
        "INSERT INTO streams(stream, line, peer, expected, lasting) VALUES(?1, ?2, ?3, ?4, ?5)",
        params![stream, line, peer, station, lasting],
    )?;
    Ok(())
}

/// Records, numbered after `newest`.
pub(super) fn rows(db: &Transaction<'_>, rows: &[Row], newest: i64) -> Result<()> {
    let mut insert = db.prepare(
        "INSERT INTO records(id, station, session, sequence, kind, track, sample, utc_us, sd_s, received_us, body)
         VALUES(?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)",
    )?;
    for (id, row) in (newest + 1..).zip(rows) {
        let (kind, body) = row.stored();
        let (utc_us, sd_s) = row.utc.unzip();
        insert.execute(params![
            id,
            number(row.station),
            row.session,
            row.sequence,
            kind,
            row.track(),
            row.index().map(|index| index as i64),
            utc_us,
            sd_s.flatten(),
            row.received_us,
            body
        ])?;
    }
    Ok(())
}

/// What has changed of sessions, logs and connections; records that can be dated now are.
pub(super) fn state(db: &Transaction<'_>, store: &Path, base: &mut Base) -> Result<()> {
    for (of, recorder) in &base.recorders {
        for session in &recorder.changed {
            let Some(known) = recorder.sessions.get(session) else { continue };
            db.execute(
                "INSERT INTO sessions VALUES(?1, ?2, ?3, ?4, ?5) ON CONFLICT DO UPDATE SET boot = excluded.boot,
                 rate_hz = excluded.rate_hz, start_us = excluded.start_us",
                params![number(*of), session, known.boot, known.rate_hz, known.start_us],
            )?;
        }
        for session in &recorder.dated {
            let Some(known) = recorder.sessions.get(session) else { continue };
            date_moved(db, store, number(*of), *session, known)?;
            date(db, number(*of), *session, known)?;
        }
    }
    for (of, log) in &base.changed_logs {
        let Some(progress) = base.logs.get(&(*of, *log)) else { continue };
        db.execute("INSERT OR REPLACE INTO logs VALUES(?1, ?2, ?3)", params![of, log, packed(progress)])?;
    }
    relayed(db, base)?;
    for stream in base.changed_streams.clone() {
        let Some(known) = base.halfway(stream) else { continue };
        let (replaced_us, replaced_by) = known.replaced.unzip();
        db.execute(
            "UPDATE streams SET station = ?2, session = ?3, up = ?4, silent = ?5, replaced_us = ?6, replaced_by = ?7,
             newest = ?8, log = ?9, boot = ?10, config_hash = ?11 WHERE stream = ?1",
            params![
                stream,
                known.log.map(|l| l.station).or(known.who),
                known.session,
                known.up,
                known.silent,
                replaced_us,
                replaced_by,
                known.newest,
                known.log.map(|l| l.log),
                known.log.map(|l| l.boot),
                known.log.map(|l| l.config_hash as i64)
            ],
        )?;
    }
    Ok(())
}

/// What has changed of what came from other base stations.
fn relayed(db: &Transaction<'_>, base: &Base) -> Result<()> {
    for (table, seen) in base.sources.seen() {
        let mut put = db.prepare(&format!("INSERT OR REPLACE INTO {table} VALUES(?1, ?2, ?3)"))?;
        let mut drop = db.prepare(&format!("DELETE FROM {table} WHERE log = ?1 AND first = ?2"))?;
        for (log, first, last) in seen.changed() {
            match last {
                Some(last) => put.execute(params![log as i64, first as i64, last as i64])?,
                None => drop.execute(params![log as i64, first as i64])?,
            };
        }
    }
    for of in &base.sources.changed {
        let (log, station, session) = of;
        db.execute(
            "INSERT OR REPLACE INTO relayed_sessions VALUES(?1, ?2, ?3, ?4)",
            params![*log as i64, number(*station), session, base.sources.sessions.get(of)],
        )?;
    }
    Ok(())
}

/// How far a log has come, as bytes: the next number of each class, then the sets of later ones.
fn packed(progress: &Progress) -> Vec<u8> {
    let next = progress.next.iter().flat_map(|n| n.to_le_bytes());
    next.chain(progress.later.iter().flat_map(|n| n.to_le_bytes())).collect()
}

/// The same back.
pub(super) fn unpacked(bytes: &[u8]) -> Result<Progress> {
    let mut progress = Progress::default();
    let Some((next, later)) = bytes.split_at_checked(4 * CLASSES) else {
        bail!("a link's progress is cut short")
    };
    for (to, from) in progress.next.iter_mut().zip(next.as_chunks::<4>().0) {
        *to = u32::from_le_bytes(*from);
    }
    for (to, from) in progress.later.iter_mut().zip(later.as_chunks::<8>().0) {
        *to = u64::from_le_bytes(*from);
    }
    Ok(progress)
}
