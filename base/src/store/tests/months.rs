//! A store that is kept for years: a file a month, rules of retention, and what was written before there were months.

use super::super::super::tests::{a_track, end, frames, hello_of};
use super::super::months::{Holds, folder, months};
use super::*;
use seabearing_core::wire::{Message, Time};
use std::collections::BTreeMap;
use time::OffsetDateTime;

/// 2026-01-10T00:00:00Z.
pub(super) const BEGIN_US: i64 = 1_768_003_200_000_000;
const MONTH_US: i64 = 2_635_200_000_000;

/// When the record of a number comes: a few a month.
pub(super) fn at(n: u64) -> i64 {
    BEGIN_US + n as i64 * MONTH_US / 7
}

/// What a recorder with a clock says, record by record: one in ten is a track's report.
pub(super) fn said(n: u64) -> Message {
    match n {
        0 => hello_of(7),
        n if n % 5 == 1 => Message::Time(Time {
            index: n * 1000,
            utc_us: at(n),
            sd_s: 0.1,
            drift: 0.0,
            sd_drift: 0.0,
            correlation: 0.0,
        }),
        n if n % 10 == 2 => {
            Message::Track(seabearing_core::wire::Track { index: n * 1000, x_m: n as f32, ..a_track() })
        }
        n => end(n * 1000),
    }
}

/// Bytes of `count` records, each frame cut into two pieces that come apart: a month's end falls between some.
fn pieces(count: u64) -> Vec<(i64, Vec<u8>)> {
    let mut encoder = Encoder::default();
    let mut all = Vec::new();
    for n in 0..count {
        let frame = encoder.frame(&said(n)).to_vec();
        let cut = frame.len() / 2;
        all.push((at(n), frame[..cut].to_vec()));
        all.push((at(n) + MONTH_US / 10, frame[cut..].to_vec()));
    }
    all
}

/// Keeps `count` records over their months, starting again before every `restart`-th piece.
pub(super) fn fill(folder: &Path, count: u64, restart: usize, retain: Retain) {
    let mut base = Base::new(None);
    let mut store = Store::open(folder, &mut base).unwrap();
    take(&mut store, &mut base, &[Entry { received_us: Some(at(0)), ..entry(1, Event::Began(of_seven())) }]);
    let mut stream = 1;
    for (n, (received_us, bytes)) in pieces(count).into_iter().enumerate() {
        if n % restart == restart - 1 {
            drop(store);
            base = Base::new(None);
            store = Store::open(folder, &mut base).unwrap();
            stream = store.next_stream();
            take(
                &mut store,
                &mut base,
                &[Entry { received_us: Some(received_us), ..entry(stream, Event::Began(of_seven())) }],
            );
        }
        take(
            &mut store,
            &mut base,
            &[Entry { stream, received_us: Some(received_us), event: Event::Bytes(bytes) }],
        );
        while store.tidy(retain).unwrap() {}
    }
}

pub(super) fn of_seven() -> Beginning {
    Beginning { station: Some(7), ..Beginning::default() }
}

/// The files of months, by their endings.
fn files(store: &Path) -> BTreeMap<String, usize> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(store.join("months")).into_iter().flatten() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        *found.entry(name.split_once('.').unwrap().1.to_owned()).or_default() += 1;
    }
    found
}

/// All that a record says but when it was told so.
pub(super) fn plain(all: &[Value]) -> Vec<String> {
    all.iter().map(Value::to_string).collect()
}

#[test]
fn months_have_files_of_their_own_and_nothing_else_changes() {
    let dir = tempfile::tempdir().unwrap();
    // No restart, and one at every few pieces: frames that were cut by it are lost, and it is the same everywhere.
    for restart in [usize::MAX, 9] {
        let whole = dir.path().join(format!("one-{restart}"));
        let split = dir.path().join(format!("split-{restart}"));
        fill(&split, 60, restart, Retain::default());
        fill_in_one_month(&whole, 60, restart);
        assert_eq!(files(&whole).len(), 0);
        let count = files(&split);
        assert!(count["bytes.sqlite"] >= 7 && count["records.sqlite"] == count["bytes.sqlite"], "{count:?}");
        assert_eq!(count["state.sqlite"], count["bytes.sqlite"] + 1);
        let of = |r: &Value| {
            (r["type"].to_string(), r["sequence"].as_u64(), r["session"].as_u64(), r["t_s"].to_string())
        };
        let (a, b) = (records(&whole), records(&split));
        assert!(a.iter().map(of).eq(b.iter().map(of)), "{restart}: {} and {}", a.len(), b.len());
        assert_eq!(check(&split).unwrap().faults, Vec::<String>::new());
        // An interval over several months, in order of UTC; one within a month; a track.
        let from = Some(OffsetDateTime::from_unix_timestamp(at(10) / 1_000_000).unwrap());
        let to = Some(OffsetDateTime::from_unix_timestamp(at(45) / 1_000_000).unwrap());
        let mut found = Vec::new();
        let wanted = Wanted { from, to, ..Wanted::default() };
        read(&split, &wanted, |r| found.push(r["utc"].as_str().unwrap().to_owned())).unwrap();
        assert!(found.is_sorted(), "{found:?}");
        let dated = b.iter().filter(|r| r["utc"].as_str().is_some_and(|utc| utc >= found[0].as_str()));
        assert!(found.len() >= 20 && dated.count() >= found.len());
        let mut reports = 0;
        let id = b.iter().find(|r| r["type"] == "track").unwrap();
        let track = Some((id["session"].as_u64().unwrap() as u32, id["id"].as_u64().unwrap() as u16));
        read(&split, &Wanted { track, ..Wanted::default() }, |_| reports += 1).unwrap();
        let same = |r: &&Value| r["type"] == "track" && r["session"] == id["session"] && r["id"] == id["id"];
        assert_eq!(reports, b.iter().filter(same).count());
        // Made anew, with the same months.
        assert_eq!(rebuild(&split).unwrap() as usize, b.len());
        assert_eq!(plain(&records(&split)), plain(&b));
        assert_eq!(check(&split).unwrap().faults, Vec::<String>::new());
        assert!(!split.join("months").exists() && split.join("months-2").exists());
        assert_eq!(Store::open(&split, &mut Base::new(None)).unwrap().resumed() as usize, b.len());
    }
}

/// The same bytes all in one month.
fn fill_in_one_month(folder: &Path, count: u64, restart: usize) {
    let mut base = Base::new(None);
    let mut store = Store::open(folder, &mut base).unwrap();
    let began = |stream| Entry { received_us: Some(BEGIN_US), ..entry(stream, Event::Began(of_seven())) };
    take(&mut store, &mut base, &[began(1)]);
    let mut stream = 1;
    for (n, (_, bytes)) in pieces(count).into_iter().enumerate() {
        if n % restart == restart - 1 {
            drop(store);
            base = Base::new(None);
            store = Store::open(folder, &mut base).unwrap();
            stream = store.next_stream();
            take(&mut store, &mut base, &[began(stream)]);
        }
        take(
            &mut store,
            &mut base,
            &[Entry { stream, received_us: Some(BEGIN_US), event: Event::Bytes(bytes) }],
        );
    }
}

#[test]
fn old_months_are_dropped_by_the_rule_and_the_rest_can_still_be_checked_and_made_anew() {
    let dir = tempfile::tempdir().unwrap();
    let (all, some) = (dir.path().join("all"), dir.path().join("some"));
    fill(&all, 60, usize::MAX, Retain::default());
    fill(&some, 60, usize::MAX, Retain { raw: Some(2), records: Some(4) });
    let (all, kept) = (records(&all), records(&some));
    let count = files(&some);
    // Of the two, and of the four, the last is in the store's own file.
    assert_eq!((count["bytes.sqlite"], count["records.sqlite"], count["state.sqlite"]), (1, 3, 3));
    assert!(kept.len() < all.len() && kept.len() > 25);
    assert_eq!(plain(&all[all.len() - kept.len()..]), plain(&kept));
    let found = check(&some).unwrap();
    assert!(found.faults.is_empty() && found.contents["months"].as_array().unwrap().len() >= 8);
    // A wrong record, after the bytes that were dropped, is found, and mended; the records before stay.
    for (part, wrong) in
        [(3, "UPDATE records SET sequence = 7777"), (9, "DELETE FROM records WHERE id % 7 = 0")]
    {
        let live = Connection::open(some.join(schema::FILE)).unwrap();
        let ended = months(&live).unwrap();
        let last = ended.iter().rev().nth(1).unwrap();
        let file = last.file(&folder(&live, &some).unwrap(), Holds::Records);
        drop(live);
        let db = Connection::open(if part == 3 { file } else { some.join(schema::FILE) }).unwrap();
        db.execute(wrong, []).unwrap();
        drop(db);
        assert!(!check(&some).unwrap().faults.is_empty(), "{part}");
        assert_eq!(rebuild(&some).unwrap() as usize, kept.len());
        assert_eq!(plain(&records(&some)), plain(&kept));
        assert_eq!(check(&some).unwrap().faults, Vec::<String>::new());
    }
    // It goes on.
    let mut base = Base::new(None);
    let mut store = Store::open(&some, &mut base).unwrap();
    assert_eq!(store.resumed() as usize, kept.len());
    let stream = store.next_stream();
    let now = |event| Entry { stream, received_us: Some(at(60)), event };
    take(&mut store, &mut base, &[now(Event::Began(of_seven())), now(Event::Bytes(frames(7, 2).concat()))]);
    drop(store);
    assert_eq!(records(&some).len(), kept.len() + 3);
    assert_eq!(check(&some).unwrap().faults, Vec::<String>::new());
}

/// Power fails anywhere while rows are moved: they are in the month's file and still in the store, or half of them are.
#[test]
fn a_move_that_is_broken_off_loses_and_doubles_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let store_of = |n: u64| dir.path().join(format!("{n}"));
    fill(&store_of(0), 40, usize::MAX, Retain::default());
    let all = plain(&records(&store_of(0)));
    for n in 1..12 {
        let folder = store_of(n);
        // Nothing was moved so far.
        let mut base = Base::new(None);
        let mut store = Store::open(&folder, &mut base).unwrap();
        take(
            &mut store,
            &mut base,
            &[Entry { received_us: Some(at(0)), ..entry(1, Event::Began(of_seven())) }],
        );
        for (received_us, bytes) in pieces(40) {
            take(
                &mut store,
                &mut base,
                &[Entry { stream: 1, received_us: Some(received_us), event: Event::Bytes(bytes) }],
            );
        }
        for _ in 0..n {
            store.tidy(Retain::default()).unwrap();
        }
        drop(store);
        let before = std::fs::read(folder.join(schema::FILE)).unwrap();
        let mut store = Store::open(&folder, &mut Base::new(None)).unwrap();
        store.tidy(Retain::default()).unwrap();
        drop(store);
        // The month's file has the rows, and the store does not know.
        std::fs::write(folder.join(schema::FILE), before).unwrap();
        assert_eq!(plain(&records(&folder)), all, "{n}");
        assert_eq!(check(&folder).unwrap().faults, Vec::<String>::new(), "{n}");
        let mut store = Store::open(&folder, &mut Base::new(None)).unwrap();
        while store.tidy(Retain::default()).unwrap() {}
        drop(store);
        assert_eq!(plain(&records(&folder)), all, "{n}");
        assert_eq!(check(&folder).unwrap().faults, Vec::<String>::new(), "{n}");
    }
}

#[test]
fn records_are_dated_in_the_files_of_months_too() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    take(&mut store, &mut base, &[Entry { received_us: Some(at(0)), ..entry(1, Event::Began(of_seven())) }]);
    let mut encoder = Encoder::default();
    let mut say = |n: u64, message: &Message| {
        let event = Event::Bytes(encoder.frame(message).to_vec());
        take(&mut store, &mut base, &[Entry { stream: 1, received_us: Some(at(n)), event }]);
        while store.tidy(Retain::default()).unwrap() {}
    };
    say(0, &hello_of(7));
    (1..40).for_each(|n| say(n, &end(n * 1000)));
    let dated = |all: &[Value]| all.iter().filter(|r| r["utc"].is_string()).count();
    assert_eq!(dated(&records(dir.path())), 0);
    let history = History::open(dir.path()).unwrap();
    assert_eq!(history.span_us().unwrap(), None);
    let time = Time { index: 0, utc_us: at(0), sd_s: 0.1, drift: 0.0, sd_drift: 0.0, correlation: 0.0 };
    say(40, &Message::Time(time));
    let all = records(dir.path());
    assert_eq!((all.len(), dated(&all)), (41, 40));
    assert_eq!(history.span_us().unwrap(), Some((at(0), at(0) + 39_000_000)));
    // The newest before a moment, in the file of the first month.
    let moment = history.moment(at(0) + 3_500_000, at(0)).unwrap();
    assert!(moment.records.iter().any(|r| r["type"] == "end" && r["t_s"] == 3.0), "{:?}", moment.records);
    assert_eq!(history.series(Some(7), 9, at(0), at(1), 100).unwrap().len(), 39);
    assert_eq!(newest_us(dir.path()).unwrap(), Some(at(0) + 39_000_000));
}

/// A clock that was far ahead for a moment, and one that goes a month back.
#[test]
fn a_clock_that_jumps_neither_ends_the_months_nor_drops_what_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    take(&mut store, &mut base, &[Entry { received_us: Some(at(0)), ..entry(1, Event::Began(of_seven())) }]);
    let mut encoder = Encoder::default();
    let far = 3_800_000_000_000_000;
    let times = [at(0), at(8), far, at(9), at(16), at(2), at(17), at(24), at(31), 0, at(33), at(40)];
    for (n, received_us) in times.into_iter().enumerate() {
        let event = Event::Bytes(encoder.frame(&said(n as u64)).to_vec());
        take(&mut store, &mut base, &[Entry { stream: 1, received_us: Some(received_us), event }]);
        while store.tidy(Retain { raw: Some(6), records: Some(12) }).unwrap() {}
    }
    drop(store);
    assert_eq!(records(dir.path()).len(), times.len());
    let found = check(dir.path()).unwrap();
    assert_eq!(found.faults, Vec::<String>::new());
    let all = rebuild(dir.path()).unwrap();
    assert_eq!(all as usize, times.len(), "{}", found.contents);
}

#[test]
fn a_file_that_is_gone_is_named() {
    let dir = tempfile::tempdir().unwrap();
    fill(dir.path(), 60, usize::MAX, Retain::default());
    let folder = dir.path().join("months");
    std::fs::remove_file(folder.join("2026-03.records.sqlite")).unwrap();
    let found = check(dir.path()).unwrap();
    assert!(found.faults[0].contains("2026-03.records.sqlite"), "{:?}", found.faults);
    let said = format!("{:#}", read(dir.path(), &Wanted::default(), |_| {}).unwrap_err());
    assert!(said.contains("2026-03.records.sqlite"), "{said}");
    // Whatever is left is not touched, and can be made anew.
    rebuild(dir.path()).unwrap();
    assert_eq!(check(dir.path()).unwrap().faults, Vec::<String>::new());
    assert_eq!(records(dir.path()).len(), 60);
}

/// The layout before there were months.
const FIRST: &str = "
CREATE TABLE about(layout INTEGER NOT NULL, decoded INTEGER NOT NULL, first_kept INTEGER NOT NULL);
INSERT INTO about VALUES(1, 0, 1);
CREATE TABLE bytes(id INTEGER PRIMARY KEY, stream INTEGER NOT NULL, received_us INTEGER, event INTEGER NOT NULL, data BLOB);
CREATE TABLE streams(stream INTEGER PRIMARY KEY, line TEXT NOT NULL, peer TEXT, expected INTEGER, lasting INTEGER NOT NULL,
    station INTEGER, session INTEGER, up INTEGER NOT NULL DEFAULT 0, silent INTEGER NOT NULL DEFAULT 0,
    replaced_us INTEGER, replaced_by INTEGER, newest INTEGER, log INTEGER, boot INTEGER, config_hash INTEGER);
CREATE TABLE stations(station INTEGER PRIMARY KEY, lat_deg REAL, lon_deg REAL, rate_hz REAL);
CREATE TABLE sessions(station INTEGER NOT NULL, session INTEGER NOT NULL, boot INTEGER, rate_hz REAL, start_us INTEGER,
    PRIMARY KEY(station, session)) WITHOUT ROWID;
CREATE TABLE logs(station INTEGER NOT NULL, log INTEGER NOT NULL, progress BLOB NOT NULL,
    PRIMARY KEY(station, log)) WITHOUT ROWID;
CREATE TABLE records(id INTEGER PRIMARY KEY, station INTEGER NOT NULL, session INTEGER, sequence INTEGER, kind INTEGER NOT NULL,
    track INTEGER, sample INTEGER, utc_us INTEGER, sd_s REAL, received_us INTEGER, body BLOB NOT NULL);
CREATE INDEX records_by_utc ON records(utc_us) WHERE utc_us IS NOT NULL;
CREATE INDEX records_by_track ON records(station, session, track) WHERE track IS NOT NULL;
CREATE INDEX records_undated ON records(station, session) WHERE utc_us IS NULL;
CREATE INDEX records_of_clocks ON records(station, session) WHERE kind IN (7, 12);
";

#[test]
fn a_store_from_before_there_were_months_is_read_and_gone_on_with() {
    let dir = tempfile::tempdir().unwrap();
    let new = dir.path().join("new");
    // What it held follows from the bytes.
    let mut base = Base::new(None);
    let mut store = Store::open(&new, &mut base).unwrap();
    take(&mut store, &mut base, &[Entry { received_us: Some(at(0)), ..entry(1, Event::Began(of_seven())) }]);
    for (received_us, bytes) in pieces(40) {
        take(
            &mut store,
            &mut base,
            &[Entry { stream: 1, received_us: Some(received_us), event: Event::Bytes(bytes) }],
        );
    }
    drop(store);
    let all = records(&new);
    let old = dir.path().join("old");
    std::fs::create_dir(&old).unwrap();
    let db = Connection::open(old.join(schema::FILE)).unwrap();
    db.execute_batch(FIRST).unwrap();
    db.execute("ATTACH ?1 AS new", [new.join(schema::FILE).display().to_string()]).unwrap();
    for table in ["bytes", "streams", "stations", "sessions", "logs", "records"] {
        db.execute_batch(&format!("INSERT INTO {table} SELECT * FROM new.{table}")).unwrap();
    }
    db.execute("UPDATE about SET decoded = (SELECT max(id) FROM bytes)", []).unwrap();
    drop(db);
    assert_eq!(plain(&records(&old)), plain(&all));
    assert_eq!(check(&old).unwrap().faults, Vec::<String>::new());
    assert!(History::open(&old).unwrap().span_us().unwrap().is_some());
    let mut base = Base::new(None);
    let mut store = Store::open(&old, &mut base).unwrap();
    assert_eq!(store.resumed() as usize, all.len());
    while store.tidy(Retain::default()).unwrap() {}
    drop(store);
    assert!(files(&old)["records.sqlite"] >= 4, "{:?}", files(&old));
    assert_eq!(plain(&records(&old)), plain(&all));
    assert_eq!(check(&old).unwrap().faults, Vec::<String>::new());
    // Of a month whose beginning was not kept the bytes are not decoded alone; made anew it is.
    let mut store = Store::open(&old, &mut Base::new(None)).unwrap();
    store.tidy(Retain { raw: Some(2), records: None }).unwrap();
    drop(store);
    let said = format!("{:#}", rebuild(&old).unwrap_err());
    assert!(said.contains("cannot be read without them"), "{said}");
    assert_eq!(plain(&records(&old)), plain(&all));
}
