//! The records of a store made anew from its bytes.

use super::super::Base;
use super::look::{Look, Start};
use super::months::{Retain, folder, months};
use super::read::{entries, resume};
use super::schema::{FILE, knows_relayed, open_file_to_read, open_month, station};
use super::state::Replay;
use super::{Event, Store, damaged};
use anyhow::{Context, Result, bail};
use rusqlite::{Connection, params};
use std::path::Path;

/// The folder in which it is done.
const REBUILT: &str = "rebuilt";

/// Makes all records anew from the bytes, in a store beside, which takes the place of the old one in one step. Where the
/// rule of retention has dropped the bytes of months, their records stay as they are. Gives how many records there are.
///
/// # Errors
/// The store is in use, cannot be read, or bytes were let go within a month; it is as it was then.
pub fn rebuild(folder: &Path) -> Result<u64> {
    let cannot = || format!("cannot rebuild the store {}", folder.display());
    let _lock = super::lock::lock(folder)?;
    let made = try_rebuild(folder);
    let _ = std::fs::remove_dir_all(folder.join(REBUILT));
    made.map_err(|e| damaged(e, folder)).with_context(cannot)
}

fn try_rebuild(store: &Path) -> Result<u64> {
    let rebuilt = store.join(REBUILT);
    if !store.join(FILE).exists() && !store.join("raw.bin").exists() {
        bail!("there is none");
    }
    let old = super::schema::open(store)?;
    let look = Look::at(&old, store)?;
    let Some(start) = look.start() else {
        bail!(
            "its oldest bytes were let go by a rule of retention, and what was known then was not kept: some of the rest cannot be read without them"
        );
    };
    match std::fs::remove_dir_all(&rebuilt) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(e).context(REBUILT),
        _ => {}
    }
    let mut base = Base::new(None);
    let mut new = Store::open(&rebuilt, &mut base)?;
    let known = start.state.as_deref().map(open_file_to_read).transpose()?;
    if let Some(known) = &known {
        new.begin_after(&start, &look, &old)?;
        resume(known, &mut base)?;
    }
    let mut replay = Replay::new(known.as_ref());
    let files = look.bytes()?;
    for part in files.iter().chain([&old]) {
        let mut from = 0;
        loop {
            let mut found = entries(part, &old, from, 1000)?;
            // A month ends where it ended.
            let first = found.first().map_or(0, |(id, _)| *id);
            if let Some(ended) = look.months.iter().find(|m| m.bytes >= first) {
                found.retain(|(id, _)| *id <= ended.bytes);
            }
            let Some((last, _)) = found.last() else { break };
            from = last + 1;
            let (ids, all): (Vec<i64>, Vec<_>) = found.into_iter().unzip();
            new.keep(&all)?;
            let mut rows = Vec::new();
            for (id, entry) in ids.iter().zip(&all) {
                replay.tell(*id, entry, &mut base, &mut rows)?;
            }
            new.derive(&mut base, &rows)?;
            if all.iter().any(|entry| matches!(entry.event, Event::Began(_))) {
                base.warnings();
            }
            while new.tidy(Retain::default())? {}
        }
    }
    what_was_said(&mut new, &mut base, &old, store)?;
    let records = (new.newest_record + 1 - new.number("SELECT first_record FROM about")?) as u64;
    put_in_place(new, old, store)?;
    Ok(records)
}

/// What a person said does not follow from the bytes.
fn what_was_said(new: &mut Store, base: &mut Base, old: &Connection, store: &Path) -> Result<()> {
    {
        let mut starts =
            old.prepare("SELECT station, session, start_us FROM sessions WHERE start_us IS NOT NULL")?;
        let said =
            starts.query_map([], |r| Ok((r.get::<_, i64>(0)?, r.get::<_, u32>(1)?, r.get::<_, i64>(2)?)))?;
        for said in said {
            let (of, session, start_us) = said?;
            base.date(station(of), session, start_us);
        }
    }
    new.derive(base, &[])?;
    new.db.execute("ATTACH ?1 AS old", params![store.join(FILE).display().to_string()])?;
    Ok(new.db.execute_batch("INSERT OR REPLACE INTO stations SELECT * FROM old.stations; DETACH old;")?)
}

/// The new store takes the old one's place: its months under a name of their own first, then, in one step, the file that
/// names them.
fn put_in_place(new: Store, old: Connection, store: &Path) -> Result<()> {
    let before = folder(&old, store)?;
    let made = folder(&new.db, &store.join(REBUILT))?;
    if made.exists() {
        let mut names = (1..).map(|n| if n == 1 { "months".to_owned() } else { format!("months-{n}") });
        let name = names.find(|name| !store.join(name).exists()).context("no name for the months")?;
        new.db.execute("UPDATE about SET folder = ?1", [&name])?;
        std::fs::rename(&made, store.join(&name)).with_context(|| name)?;
    }
    let close = "PRAGMA wal_checkpoint(TRUNCATE); PRAGMA journal_mode = DELETE";
    new.db.execute_batch(close)?;
    drop(new);
    old.execute_batch(close).context("another program reads it: wait until it has ended, or stop it")?;
    drop(old);
    std::fs::rename(store.join(REBUILT).join(FILE), store.join(FILE))?;
    if before.exists() {
        std::fs::remove_dir_all(before)?;
    }
    Ok(())
}

/// Removes what a rebuilding that was broken off has left.
pub(super) fn clear(store: &Store) -> Result<()> {
    let counts = folder(&store.db, &store.folder)?;
    for entry in std::fs::read_dir(&store.folder)?.filter_map(|entry| entry.ok()) {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let ours = name == REBUILT || name == "months" || name.strip_prefix("months-").is_some_and(number);
        if ours && entry.path() != counts && entry.file_type().is_ok_and(|t| t.is_dir()) {
            std::fs::remove_dir_all(entry.path())?;
        }
    }
    Ok(())
}

fn number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())
}

impl Store {
    /// An empty store goes on where the kept bytes of another begin.
    fn begin_after(&mut self, start: &Start, look: &Look, old: &Connection) -> Result<()> {
        let Some(state) = &start.state else { return Ok(()) };
        let months_folder = folder(&self.db, &self.folder)?;
        std::fs::create_dir_all(&months_folder)?;
        let first_record: i64 = old.query_row("SELECT first_record FROM about", [], |r| r.get(0))?;
        let ended: Vec<_> = months(old)?.into_iter().filter(|m| m.bytes <= start.bytes).collect();
        for path in look.kept(&ended, first_record) {
            let name = path.file_name().context("a month's file")?;
            // With what a reader has kept from going into the file so far.
            let copy = months_folder.join(name);
            open_file_to_read(&path)?
                .execute("VACUUM INTO ?1", [copy.display().to_string()])
                .with_context(|| path.display().to_string())?;
            open_month(&copy)?;
        }
        let name = state.file_name().context("a month's file")?;
        std::fs::copy(state, months_folder.join(name)).with_context(|| state.display().to_string())?;
        self.db.execute("ATTACH ?1 AS state", [state.display().to_string()])?;
        self.db.execute("ATTACH ?1 AS old", [old.path()])?;
        self.db.execute_batch(
            "BEGIN; DELETE FROM streams; INSERT INTO streams SELECT * FROM state.streams;
             INSERT INTO sessions SELECT * FROM state.sessions; INSERT INTO logs SELECT * FROM state.logs;
             INSERT INTO clocks SELECT * FROM state.clocks;
             INSERT OR IGNORE INTO clocks SELECT id, station, session, body FROM state.records WHERE kind IN (7, 12);",
        )?;
        if knows_relayed(&self.db, "state")? {
            self.db.execute_batch(
                "INSERT INTO relayed SELECT * FROM state.relayed;
                 INSERT INTO relayed_onward SELECT * FROM state.relayed_onward;
                 INSERT INTO relayed_sessions SELECT * FROM state.relayed_sessions;",
            )?;
        }
        self.db.execute("INSERT INTO months SELECT * FROM old.months WHERE bytes <= ?1", [start.bytes])?;
        self.db.execute(
            "UPDATE about SET decoded = ?1, first_kept = ?1 + 1, moved_bytes = ?1, moved_records = ?2,
             first_record = min(?3, ?2 + 1)",
            [start.bytes, start.records, first_record],
        )?;
        self.db.execute_batch("COMMIT; DETACH state; DETACH old;")?;
        self.take_numbers()
    }
}
