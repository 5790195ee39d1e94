//! A store's months. The open month and the one before it are in the store's own file; older ones have a file for their
//! bytes and one for their records, which change no more, and which the rule of retention drops whole.
//!
//! A month ends before the first bytes of another, and what was known then is kept ([`super::state`]): so every month can be
//! decoded, checked and made anew without those before it. Its rows are moved a few at a time, first into the month's file,
//! then out of the store: whatever happens between, none is lost, and `moved_*` of `about` says from where on each counts.

use super::super::recorder::Session;
use super::read::{CLOCKED, CLOCKS, CLOCKS_OF};
use super::schema::{FILE, open_month};
use super::{CLOCK_SET_US, Store, state};
use anyhow::{Context, Result};
use rusqlite::{Connection, params};
use std::path::{Path, PathBuf};

/// Rows moved at once.
const ROWS: i64 = 2000;
/// Bytes moved at once, about.
const SIZE: i64 = 1_000_000;

/// What of each month a store keeps, in months before the open one in which something came; at least the last one of them
/// stays. All where nothing is said.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retain {
    /// Months of which the bytes stay.
    pub raw: Option<u32>,
    /// Months of which the records stay.
    pub records: Option<u32>,
}

impl std::str::FromStr for Retain {
    type Err = String;

    /// As `raw=3m,records=2y`: months, or years of twelve.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let mut retain = Self::default();
        for part in text.split(',') {
            let wrong = || {
                format!(
                    "`{part}` is not `raw=..` or `records=..` with a number of months or years, as `raw=3m` or `records=2y`"
                )
            };
            let (what, long) = part.trim().split_once('=').ok_or_else(wrong)?;
            let (number, months) = match (long.strip_suffix('m'), long.strip_suffix('y')) {
                (Some(number), _) => (number, 1),
                (_, Some(number)) => (number, 12),
                _ => return Err(wrong()),
            };
            let number: u16 = number.parse().ok().filter(|n| *n > 0).ok_or_else(wrong)?;
            let to = match what {
                "raw" => &mut retain.raw,
                "records" => &mut retain.records,
                _ => return Err(wrong()),
            };
            if to.replace(u32::from(number) * months).is_some() {
                return Err(format!("`{what}` is said twice"));
            }
        }
        Ok(retain)
    }
}

/// A month that has ended.
#[derive(Clone, Debug)]
pub(super) struct Month {
    pub(super) number: i64,
    /// As `2026-08`.
    pub(super) name: String,
    /// Its last row of `bytes`.
    pub(super) bytes: i64,
    /// Its last row of `records`.
    pub(super) records: i64,
    /// All of it is in its files.
    pub(super) whole: bool,
    /// UTC of its oldest and newest record, microseconds since 1970, once it is whole.
    pub(super) span_us: Option<(i64, i64)>,
    /// Records of samples without UTC, once it is whole.
    undated: i64,
}

/// What a month's files hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Holds {
    Bytes,
    Records,
    /// What was known at its end.
    State,
}

impl Month {
    /// Its file in the folder of the months.
    pub(super) fn file(&self, months: &Path, holds: Holds) -> PathBuf {
        let of = match holds {
            Holds::Bytes => "bytes",
            Holds::Records => "records",
            Holds::State => "state",
        };
        months.join(format!("{}.{of}.sqlite", self.name))
    }
}

/// The months that have ended, oldest first.
pub(super) fn months(db: &Connection) -> Result<Vec<Month>> {
    let mut all = db.prepare(
        "SELECT number, name, bytes, records, whole, first_us, last_us, undated FROM months ORDER BY number",
    )?;
    let found = all.query_map([], |r| {
        let (first, last): (Option<i64>, Option<i64>) = (r.get(5)?, r.get(6)?);
        Ok(Month {
            number: r.get(0)?,
            name: r.get(1)?,
            bytes: r.get(2)?,
            records: r.get(3)?,
            whole: r.get(4)?,
            span_us: first.zip(last),
            undated: r.get(7)?,
        })
    })?;
    Ok(found.collect::<rusqlite::Result<_>>()?)
}

/// The folder of the months' files.
pub(super) fn folder(db: &Connection, store: &Path) -> Result<PathBuf> {
    let name: String = db.query_row("SELECT folder FROM about", [], |r| r.get(0))?;
    Ok(store.join(name))
}

/// The month of a time, as `2026-08`.
fn name_of(received_us: i64) -> Option<String> {
    let at = time::OffsetDateTime::from_unix_timestamp_nanos(i128::from(received_us) * 1000).ok()?;
    Some(format!("{:04}-{:02}", at.year(), u8::from(at.month())))
}

impl Store {
    /// Ends the open month if what comes now is of another. A clock that was a moment in the month before does not begin
    /// that again; one that was far ahead does not keep the next from beginning.
    pub(super) fn turn_month(&mut self, received_us: Option<i64>) -> Result<()> {
        let received_us = received_us.filter(|us| *us >= CLOCK_SET_US);
        let Some(name) = received_us.and_then(name_of) else { return Ok(()) };
        if self.month.as_deref() == Some(&name) || self.decoded < self.newest {
            return Ok(());
        }
        let Some(open) = self.month.clone() else { return self.open_month(name, None) };
        let months = |name: &str| {
            let (year, month) = name.split_once('-')?;
            Some(year.parse::<i64>().ok()? * 12 + month.get(..2)?.parse::<i64>().ok()?)
        };
        let later = months(&name).zip(months(&open)).map_or(0, |(new, old)| new - old);
        if (-1..=0).contains(&later) {
            return Ok(());
        }
        self.open_month(name, Some(open))
    }

    fn open_month(&mut self, name: String, ended: Option<String>) -> Result<()> {
        let ended = ended.map(|ended| self.end_month(ended)).transpose()?;
        let turned = self.db.transaction()?;
        if let Some(month) = ended {
            turned.execute(
                "INSERT INTO months(name, bytes, records) VALUES(?1, ?2, ?3)",
                params![month.name, month.bytes, month.records],
            )?;
        }
        turned.execute("UPDATE about SET month = ?1", [&name])?;
        turned.commit()?;
        self.month = Some(name);
        Ok(())
    }

    /// Keeps what is known now for a month that ends here.
    fn end_month(&self, ended: String) -> Result<Month> {
        let months = self.months_folder()?;
        let taken = |name: &str| {
            self.db.query_row("SELECT EXISTS(SELECT 1 FROM months WHERE name = ?1)", [name], |r| {
                r.get::<_, bool>(0)
            })
        };
        let mut month = ended.clone();
        // Of a clock that came back to a month which was left.
        for again in 2.. {
            if !taken(&month)? {
                break;
            }
            month = format!("{ended}-{again}");
        }
        let month = Month {
            number: 0,
            name: month,
            bytes: self.newest,
            records: self.newest_record,
            whole: false,
            span_us: None,
            undated: 0,
        };
        state::write(&self.db, &self.open_streams, &month.file(&months, Holds::State))?;
        Ok(month)
    }

    /// The folder of the months' files, made where it is missing.
    fn months_folder(&self) -> Result<PathBuf> {
        let months = folder(&self.db, &self.folder)?;
        if !months.exists() {
            std::fs::create_dir_all(&months).with_context(|| months.display().to_string())?;
            state::sync(&self.folder);
        }
        Ok(months)
    }

    /// Moves some of the months before the last into their files, and drops what is kept no longer; true if there is more
    /// to do. Storing waits for it for a small part of a second.
    ///
    /// # Errors
    /// The disk does not take it; it may be tried again.
    pub fn tidy(&mut self, retain: Retain) -> Result<bool> {
        let tidied = self.try_tidy(retain);
        self.explained(tidied)
    }

    fn try_tidy(&mut self, retain: Retain) -> Result<bool> {
        let all = months(&self.db)?;
        let Some((_, before)) = all.split_last() else { return Ok(false) };
        if let Some(month) = before.iter().find(|m| !m.whole) {
            self.move_some(month)?;
            return Ok(true);
        }
        self.drop_months(&all, retain)?;
        Ok(false)
    }

    fn move_some(&mut self, month: &Month) -> Result<()> {
        let months = self.months_folder()?;
        let (bytes, records) =
            self.db.query_row("SELECT moved_bytes, moved_records FROM about", [], |r| {
                Ok((r.get(0)?, r.get(1)?))
            })?;
        if bytes < month.bytes {
            let path = month.file(&months, Holds::Bytes);
            return self.move_rows("bytes", "data", &path, bytes, month.bytes);
        }
        if records < month.records {
            let path = month.file(&months, Holds::Records);
            return self.move_rows("records", "body", &path, records, month.records);
        }
        // A month in which nothing came has its files too.
        open_month(&month.file(&months, Holds::Bytes))?;
        let db = open_month(&month.file(&months, Holds::Records))?;
        summarise(&self.db, month, &db)?;
        state::sync(&months);
        Ok(())
    }

    /// Moves rows after `from` up to `last` at most.
    fn move_rows(&mut self, table: &str, content: &str, path: &Path, from: i64, last: i64) -> Result<()> {
        let upto: Option<i64> = self.db.query_row(
            &format!(
                "SELECT max(id) FROM (SELECT id, sum(ifnull(length({content}), 0)) OVER (ORDER BY id) AS size FROM
                 (SELECT id, {content} FROM {table} WHERE id > ?1 AND id <= ?2 ORDER BY id LIMIT {ROWS}))
                 WHERE size <= {SIZE} OR id = (SELECT min(id) FROM {table} WHERE id > ?1)"
            ),
            [from, last],
            |r| r.get(0),
        )?;
        let upto = upto.unwrap_or(last);
        {
            let to = open_month(path)?;
            to.execute("ATTACH ?1 AS store", [self.folder.join(FILE).display().to_string()])?;
            to.execute(
                &format!(
                    "INSERT OR REPLACE INTO {table} SELECT * FROM store.{table} WHERE id > ?1 AND id <= ?2"
                ),
                [from, upto],
            )?;
        }
        let moved = self.db.transaction()?;
        if table == "records" {
            keep_clocks(&moved, upto)?;
        }
        moved.execute(&format!("DELETE FROM {table} WHERE id <= ?1"), [upto])?;
        moved.execute(&format!("UPDATE about SET moved_{table} = ?1"), [upto])?;
        Ok(moved.commit()?)
    }

    /// Drops the months that are kept no longer.
    fn drop_months(&mut self, all: &[Month], retain: Retain) -> Result<()> {
        // A clock that goes back and forth makes pieces of a month, and they count once.
        let last_of = |keep: Option<u32>| {
            let keep = keep?.max(1) as usize;
            let mut names = std::collections::BTreeSet::new();
            all.iter().rev().find(|month| {
                // Nor does a piece of the open month, or what a clock that was far ahead made of it.
                let name = month.name.get(..7);
                if name < self.month.as_deref() {
                    names.insert(name);
                }
                names.len() > keep
            })
        };
        if let Some(last) = last_of(retain.raw) {
            self.db.execute("UPDATE about SET first_kept = max(first_kept, ?1 + 1)", [last.bytes])?;
        }
        if let Some(last) = last_of(retain.records) {
            self.db.execute("UPDATE about SET first_record = max(first_record, ?1 + 1)", [last.records])?;
        }
        self.clear(all)
    }

    /// Lets go of whole months that ended before the month of a time.
    pub(super) fn forget_months(&mut self, before_us: i64) -> Result<()> {
        let Some(before) = name_of(before_us) else { return Ok(()) };
        let all = months(&self.db)?;
        // Rows of a month that came after something that is kept stay, whatever the clock said then.
        let Some(last) = all.iter().take_while(|m| m.whole && m.name < before).last() else { return Ok(()) };
        self.db.execute(
            "UPDATE about SET first_kept = max(first_kept, ?1 + 1), first_record = max(first_record, ?2 + 1)",
            [last.bytes, last.records],
        )?;
        self.clear(&all)
    }

    /// Removes the files of which nothing counts any more.
    pub(super) fn clear(&self, all: &[Month]) -> Result<()> {
        let months = folder(&self.db, &self.folder)?;
        let (first, first_record): (i64, i64) =
            self.db.query_row("SELECT first_kept, first_record FROM about", [], |r| {
                Ok((r.get(0)?, r.get(1)?))
            })?;
        for (n, month) in all.iter().enumerate() {
            let remove = |holds| {
                for ending in ["", "-wal", "-shm"] {
                    let mut path = month.file(&months, holds).into_os_string();
                    path.push(ending);
                    match std::fs::remove_file(path) {
                        Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(e),
                        _ => {}
                    }
                }
                Ok(())
            };
            if month.bytes < first {
                remove(Holds::Bytes)?;
                // With what was known at its end the next is read.
                if all.get(n + 1).is_some_and(|next| next.bytes < first) {
                    remove(Holds::State)?;
                }
            }
            if month.records < first_record {
                remove(Holds::Records)?;
            }
        }
        Ok(())
    }
}

/// Dates records of a session in the files of a store's months. It may be done again.
pub(super) fn date_moved(
    db: &Connection,
    store: &Path,
    of: i64,
    session: u32,
    known: &Session,
) -> Result<()> {
    let (moved, first): (i64, i64) =
        db.query_row("SELECT moved_records, first_record FROM about", [], |r| Ok((r.get(0)?, r.get(1)?)))?;
    let folder = folder(db, store)?;
    let mut before = 0;
    for month in months(db)? {
        let some = before < moved && month.records >= first && !(month.whole && month.undated == 0);
        before = month.records;
        if !some {
            continue;
        }
        let mut file = open_month(&month.file(&folder, Holds::Records))?;
        let dated = file.transaction()?;
        date(&dated, of, session, known)?;
        dated.commit()?;
        if month.whole {
            summarise(db, &month, &file)?;
        }
    }
    Ok(())
}

/// Notes what a month's records are.
fn summarise(db: &Connection, month: &Month, file: &Connection) -> Result<()> {
    let ask = "SELECT min(utc_us), max(utc_us), (SELECT count(*) FROM records WHERE utc_us IS NULL AND sample IS NOT NULL)
        FROM records";
    let (first, last, undated): (Option<i64>, Option<i64>, i64) =
        file.query_row(ask, [], |r| Ok((r.get(0)?, r.get(1)?, r.get(2)?)))?;
    db.execute(
        "UPDATE months SET whole = 1, first_us = ?2, last_us = ?3, undated = ?4 WHERE number = ?1",
        params![month.number, first, last, undated],
    )?;
    Ok(())
}

/// Keeps what records up to a number say of clocks: those of a session that goes on for years are in other files then.
pub(super) fn keep_clocks(db: &Connection, upto: i64) -> Result<()> {
    let told = format!("FROM records WHERE id <= ?1 AND {CLOCKS_OF}");
    let sessions = format!("SELECT DISTINCT station, session {told}");
    let sessions = db
        .prepare(&sessions)?
        .query_map([upto], |r| Ok((r.get(0)?, r.get(1)?)))?
        .collect::<rusqlite::Result<Vec<(i64, Option<u32>)>>>()?;
    db.execute(&format!("INSERT OR REPLACE INTO clocks SELECT id, station, session, body {told}"), [upto])?;
    for (of, session) in sessions {
        let of_session = "FROM clocks WHERE station = ?1 AND session = ?2";
        let newest = format!("SELECT id {of_session} ORDER BY id DESC LIMIT {CLOCKS}");
        db.execute(&format!("DELETE {of_session} AND id NOT IN ({newest})"), params![of, session])?;
        // Of older sessions nothing comes any more.
        db.execute(
            "DELETE FROM clocks WHERE station = ?1 AND session < (SELECT max(session) FROM sessions WHERE station = ?1) - ?2",
            params![of, CLOCKED as i64],
        )?;
    }
    Ok(())
}

/// Dates the records of a session that have no UTC yet.
pub(super) fn date(db: &Connection, of: i64, session: u32, known: &Session) -> Result<()> {
    let mut update = db.prepare("UPDATE records SET utc_us = ?2, sd_s = ?3 WHERE id = ?1")?;
    let mut undated = db.prepare(
        "SELECT id, sample FROM records WHERE station = ?1 AND session = ?2 AND utc_us IS NULL AND sample IS NOT NULL",
    )?;
    let found = undated.query_map(params![of, session], |r| Ok((r.get(0)?, r.get(1)?)))?;
    for (id, sample) in found.collect::<rusqlite::Result<Vec<(i64, i64)>>>()? {
        if let Some((utc_us, sd_s)) = known.utc(sample as u64) {
            update.execute(params![id, utc_us, sd_s])?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_has_its_month() {
        assert_eq!(name_of(0).unwrap(), "1970-01");
        assert_eq!(name_of(1_793_491_199_999_999).unwrap(), "2026-10");
        assert_eq!(name_of(1_793_491_200_000_000).unwrap(), "2026-11");
        assert_eq!(name_of(i64::MAX), None);
    }

    #[test]
    fn a_rule_is_read_and_what_is_none_is_named() {
        let read = |text: &str| text.parse::<Retain>();
        assert_eq!(read("raw=3m,records=2y").unwrap(), Retain { raw: Some(3), records: Some(24) });
        assert_eq!(read("records=1m").unwrap(), Retain { raw: None, records: Some(1) });
        for wrong in [
            "",
            "raw",
            "raw=3",
            "raw=0m",
            "raw=-1m",
            "raw=3d",
            "all=3m",
            "raw=1m,raw=2m",
            "raw=3m;records=1y",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
