//! A store of years that is disturbed: clocks that jump, readers, kills in the middle of a move.

use super::super::super::tests::{end, frames, hello_of};
use super::months::{BEGIN_US, at, fill, of_seven, plain, said};
use super::*;
use seabearing_core::wire::{Message, Time};

/// Tells a store one record at a time, tidying as the service does.
fn say_at(folder: &Path, times: &[i64], retain: Retain, keep_days: Option<i64>) -> usize {
    let mut base = Base::new(None);
    let mut store = Store::open(folder, &mut base).unwrap();
    take(
        &mut store,
        &mut base,
        &[Entry { received_us: Some(times[0]), ..entry(1, Event::Began(of_seven())) }],
    );
    let mut encoder = Encoder::default();
    for (n, received_us) in times.iter().enumerate() {
        let event = Event::Bytes(encoder.frame(&said(n as u64)).to_vec());
        take(&mut store, &mut base, &[Entry { stream: 1, received_us: Some(*received_us), event }]);
        while store.tidy(retain).unwrap() {}
        if let Some(days) = keep_days.filter(|_| *received_us > BEGIN_US) {
            while store.forget(received_us - days * 86_400_000_000).unwrap() {}
        }
    }
    drop(store);
    records(folder).len()
}

/// A single-board computer without a battery: at every start some seconds of 1970, then the network's time. All in five days.
#[test]
fn a_computer_that_starts_in_1970_keeps_its_months() {
    let dir = tempfile::tempdir().unwrap();
    let day = 86_400_000_000;
    let times: Vec<i64> =
        (0..12).map(|n| if n % 2 == 1 { 60_000_000 } else { BEGIN_US + day * n / 2 }).collect();
    assert_eq!(say_at(&dir.path().join("all"), &times, Retain::default(), None), 12);
    let kept = say_at(&dir.path().join("retain"), &times, Retain { raw: Some(3), records: Some(3) }, None);
    let days = say_at(&dir.path().join("days"), &times, Retain::default(), Some(30));
    // Only the six of 1970 may be thought of as old.
    assert!(kept == 12 && days >= 6, "--retain: {kept} of 12; --keep-days 30: {days} of 6 of this month");
}

/// One export that nobody takes, while a month is moved.
#[test]
fn storing_does_not_wait_for_a_reader() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    take(&mut store, &mut base, &[Entry { received_us: Some(at(0)), ..entry(1, Event::Began(of_seven())) }]);
    for n in 0..6u64 {
        let bytes = frames(7, 2000).concat();
        take(
            &mut store,
            &mut base,
            &[Entry { stream: 1, received_us: Some(at(n * 7)), event: Event::Bytes(bytes) }],
        );
    }
    // Some of a month is in its file.
    while !dir
        .path()
        .join("months")
        .read_dir()
        .is_ok_and(|mut d| d.any(|e| e.unwrap().file_name().to_string_lossy().ends_with("records.sqlite")))
    {
        store.tidy(Retain::default()).unwrap();
    }
    let mut worst = std::time::Duration::ZERO;
    let mut said = String::new();
    let mut n = 0;
    read(dir.path(), &Wanted::default(), |_| {
        n += 1;
        if n == 1 {
            for _ in 0..3 {
                let begun = std::time::Instant::now();
                if let Err(e) = store.tidy(Retain::default()) {
                    said = format!("{e:#}");
                }
                worst = worst.max(begun.elapsed());
            }
        }
    })
    .unwrap();
    assert!(worst.as_secs_f64() < 1.0, "{worst:?} {said}");
}

/// A recorder that said its time once, months ago, on a base station that starts again.
#[test]
fn a_clock_said_months_ago_still_dates_after_a_restart() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    take(&mut store, &mut base, &[Entry { received_us: Some(at(0)), ..entry(1, Event::Began(of_seven())) }]);
    let mut encoder = Encoder::default();
    let time = Time { index: 0, utc_us: at(0), sd_s: 0.1, drift: 0.0, sd_drift: 0.0, correlation: 0.0 };
    for n in 0..40 {
        let message = match n {
            0 => hello_of(7),
            1 => Message::Time(time),
            n => end(n * 1000),
        };
        if n == 39 {
            drop(store);
            base = Base::new(None);
            store = Store::open(dir.path(), &mut base).unwrap();
            take(
                &mut store,
                &mut base,
                &[Entry { received_us: Some(at(n)), ..entry(2, Event::Began(of_seven())) }],
            );
        }
        let event = Event::Bytes(encoder.frame(&message).to_vec());
        let stream = if n == 39 { 2 } else { 1 };
        take(&mut store, &mut base, &[Entry { stream, received_us: Some(at(n)), event }]);
        while store.tidy(Retain::default()).unwrap() {}
    }
    drop(store);
    let all = records(dir.path());
    let dated: Vec<bool> = all.iter().map(|r| r["utc"].is_string()).collect();
    // A `Hello` is of no sample.
    assert!(dated.iter().skip(1).all(|d| *d), "{dated:?}");
}

/// The base station was killed while a month's file was written: half of a change is in the file's log.
#[test]
fn a_store_is_read_after_a_kill_in_a_move() {
    let dir = tempfile::tempdir().unwrap();
    let (live, dead) = (dir.path().join("live"), dir.path().join("dead"));
    fill(&live, 60, usize::MAX, Retain::default());
    let file = "months/2026-03.records.sqlite";
    std::fs::create_dir_all(dead.join("months")).unwrap();
    let db = schema::open_month(&live.join(file)).unwrap();
    db.execute_batch(
        "PRAGMA cache_size = 2; BEGIN; UPDATE records SET sequence = 9999;
        WITH RECURSIVE n(i) AS (SELECT 1000000 UNION ALL SELECT i + 1 FROM n WHERE i < 1001000)
        INSERT INTO records(id, station, kind, body) SELECT i, 7, 9, zeroblob(500) FROM n;",
    )
    .unwrap();
    std::fs::copy(live.join("store.sqlite"), dead.join("store.sqlite")).unwrap();
    for entry in std::fs::read_dir(live.join("months")).unwrap() {
        let entry = entry.unwrap();
        std::fs::copy(entry.path(), dead.join("months").join(entry.file_name())).unwrap();
    }
    db.execute_batch("ROLLBACK").unwrap();
    drop(db);
    assert!(std::fs::metadata(dead.join("months/2026-03.records.sqlite-wal")).unwrap().len() > 100_000);
    let all = plain(&records(&live));
    assert_eq!(plain(&records(&dead)), all);
    drop(Store::open(&dead, &mut Base::new(None)).unwrap());
    assert_eq!(check(&dead).unwrap().faults, Vec::<String>::new());
    assert_eq!(rebuild(&dead).unwrap() as usize, all.len());
    assert_eq!(plain(&records(&dead)), all);
}

/// A session is dated while somebody reads, and the store is made anew.
#[test]
fn records_of_months_are_dated_while_somebody_reads() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    take(&mut store, &mut base, &[Entry { received_us: Some(at(0)), ..entry(1, Event::Began(of_seven())) }]);
    let mut encoder = Encoder::default();
    for n in 0..30u64 {
        let message = if n == 0 { hello_of(7) } else { end(n * 1000) };
        let event = Event::Bytes(encoder.frame(&message).to_vec());
        take(&mut store, &mut base, &[Entry { stream: 1, received_us: Some(at(n)), event }]);
        while store.tidy(Retain::default()).unwrap() {}
    }
    let time = Time { index: 0, utc_us: at(0), sd_s: 0.1, drift: 0.0, sd_drift: 0.0, correlation: 0.0 };
    let event = Event::Bytes(encoder.frame(&Message::Time(time)).to_vec());
    let told = Entry { stream: 1, received_us: Some(at(30)), event };
    let mut taken = Some(told);
    let mut shown = 0;
    read(dir.path(), &Wanted::default(), |_| {
        shown += 1;
        if let Some(told) = taken.take() {
            let begun = std::time::Instant::now();
            take(&mut store, &mut base, &[told]);
            assert!(begun.elapsed().as_secs_f64() < 5.0, "{:?}", begun.elapsed());
        }
    })
    .unwrap();
    assert_eq!(shown, 30);
    let all = records(dir.path());
    assert_eq!((all.len(), all.iter().filter(|r| r["utc"].is_string()).count()), (31, 30));
    drop(store);
    assert_eq!(rebuild(dir.path()).unwrap(), 31);
    assert_eq!(plain(&records(dir.path())), plain(&all));
}

/// A recorder that said its time once and has had many faults since, with days as the rule.
#[test]
fn a_clock_outlives_faults_and_days() {
    use seabearing_core::wire::{Fault, FaultCode};
    let fault = |code| Message::Fault(Fault { code, index: 5, value: 1 });
    let mut buffer = [0; 128];
    let bytes = seabearing_core::wire::bytes_of(&fault(FaultCode::ClockStepped), &mut buffer);
    assert_eq!(bytes.get(..2), Some(&[7, 15][..]), "as the queries have it");
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    let mut encoder = Encoder::default();
    let mut say = |store: &mut Store, base: &mut Base, n: u64, message: &Message| {
        let event = Event::Bytes(encoder.frame(message).to_vec());
        take(store, base, &[Entry { stream: 1, received_us: Some(at(0) + n as i64 * 3_600_000_000), event }]);
    };
    take(&mut store, &mut base, &[Entry { received_us: Some(at(0)), ..entry(1, Event::Began(of_seven())) }]);
    say(&mut store, &mut base, 0, &hello_of(7));
    let time = Time { index: 0, utc_us: at(0), sd_s: 0.1, drift: 0.0, sd_drift: 0.0, correlation: 0.0 };
    say(&mut store, &mut base, 0, &Message::Time(time));
    (1..200).for_each(|n| say(&mut store, &mut base, n, &fault(FaultCode::Impulses)));
    // Three days are kept, of the same month.
    while store.forget(at(0) + 130 * 3_600_000_000).unwrap() {}
    drop(store);
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    take(&mut store, &mut base, &[Entry { received_us: Some(at(2)), ..entry(2, Event::Began(of_seven())) }]);
    let event = Event::Bytes(Encoder::default().frame(&end(9000)).to_vec());
    take(&mut store, &mut base, &[Entry { stream: 2, received_us: Some(at(2)), event }]);
    drop(store);
    let all = records(dir.path());
    assert_eq!(all.len(), 71);
    assert!(all.iter().all(|r| r["utc"].is_string()), "{:?}", all.last());
}

/// A computer whose clock starts at 2001 before it is told the time, and one that is far ahead for a moment, with the
/// strictest rule.
#[test]
fn clocks_that_are_wrong_at_starts_drop_nothing_of_this_month() {
    let dir = tempfile::tempdir().unwrap();
    let day = 86_400_000_000;
    for (name, wrong) in [("behind", 980_000_000_000_000), ("ahead", 4_070_908_800_000_000)] {
        let times: Vec<i64> =
            (0..12).map(|n| if n % 2 == 1 { wrong } else { BEGIN_US + day * n / 2 }).collect();
        let strict = Retain { raw: Some(1), records: Some(1) };
        assert_eq!(say_at(&dir.path().join(name), &times, strict, None), 12, "{name}");
    }
}
