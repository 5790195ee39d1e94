use super::super::tests::{end, frames, hello_of};
use super::*;
use seabearing_core::wire::Encoder;
use serde_json::Value;

mod disturbed;
mod months;

fn records(folder: &Path) -> Vec<Value> {
    let mut all = Vec::new();
    read(folder, &Wanted::default(), |r| all.push(r)).unwrap();
    all
}

fn entry(stream: u32, event: Event) -> Entry {
    Entry { stream, received_us: Some(1_790_000_000_000_000 + i64::from(stream)), event }
}

/// Keeps and decodes.
fn take(store: &mut Store, base: &mut Base, entries: &[Entry]) {
    store.keep(entries).unwrap();
    let mut rows = Vec::new();
    entries.iter().for_each(|e| e.tell(base, 0, None, &mut rows));
    store.derive(base, &rows).unwrap();
}

/// A base station that was killed at any moment between two bytes, before or after it had decoded the last ones.
#[test]
fn a_base_station_killed_at_any_moment_has_every_record_once() {
    let whole = frames(7, 3).concat();
    for cut in 1..whole.len() {
        for decoded in [false, true] {
            let dir = tempfile::tempdir().unwrap();
            let mut base = Base::new(None);
            let mut store = Store::open(dir.path(), &mut base).unwrap();
            take(&mut store, &mut base, &[entry(1, Event::Began(Beginning::default()))]);
            take(&mut store, &mut base, &[entry(1, Event::Bytes(whole[..cut].to_vec()))]);
            let rest = entry(1, Event::Bytes(whole[cut..].to_vec()));
            if decoded {
                take(&mut store, &mut base, &[rest]);
            } else {
                store.keep(&[rest]).unwrap();
            }
            drop(store);
            let mut base = Base::new(None);
            let store = Store::open(dir.path(), &mut base).unwrap();
            assert_eq!(store.resumed(), 4, "{cut} {decoded}");
            let all = records(dir.path());
            let of = |r: &Value| (r["sequence"].as_u64(), r["session"].as_u64(), r["station"].as_u64());
            assert!(all.iter().map(of).eq((0..4).map(|n| (Some(n), Some(1), Some(7)))), "{all:?}");
            assert!(check(dir.path()).unwrap().faults.is_empty());
        }
    }
}

#[test]
fn a_second_base_station_is_refused_and_the_first_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let first = Store::open(dir.path(), &mut Base::new(None)).unwrap();
    let said = format!("{:#}", Store::open(dir.path(), &mut Base::new(None)).err().unwrap());
    assert!(said.contains(&format!("in use by process {}", std::process::id())), "{said}");
    // Reading goes on beside it.
    assert!(records(dir.path()).is_empty() && check(dir.path()).unwrap().faults.is_empty());
    drop(first);
    assert!(Store::open(dir.path(), &mut Base::new(None)).is_ok());
}

/// As the version before wrote it: bytes, records, and what was said.
#[test]
fn a_store_of_the_version_before_is_read_and_gone_on_with() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &[u8]| std::fs::write(dir.path().join(name), text).unwrap();
    let bytes = frames(7, 3).concat();
    write("raw.bin", &bytes);
    write(
        "records.jsonl",
        b"{\"type\":\"hello\",\"station\":7}\n{\"type\":\"end\",\"station\":7,\"utc\":\"2024-05-01T09:00:00Z\"}\n{\"type\":",
    );
    write(
        "about.json",
        b"{\"rate_hz\":null,\"utc_of_sample_0\":{\"1\":\"2024-05-01T09:00:00Z\"},\"lat_deg\":49.0,\"lon_deg\":-123.0}",
    );
    assert_eq!(records(dir.path()).len(), 2);
    let from = Some(time::macros::datetime!(2024-05-01 08:00 UTC));
    let undated = read(dir.path(), &Wanted { from, ..Wanted::default() }, |_| {}).unwrap();
    assert_eq!((undated, positions(dir.path()).unwrap()[&None]), (1, (49.0, -123.0)));
    assert!(stations(dir.path()).unwrap().contains(&7));
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    assert_eq!(store.resumed(), 4);
    let stream = store.next_stream();
    take(&mut store, &mut base, &[entry(stream, Event::Began(Beginning::default()))]);
    take(&mut store, &mut base, &[entry(stream, Event::Bytes(frames(7, 1).concat()))]);
    drop(store);
    let all = records(dir.path());
    assert_eq!(
        (all.len(), &all[2]["utc"], &all[5]["session"]),
        (6, &"2024-05-01T09:00:01Z".into(), &2.into())
    );
    assert_eq!(positions(dir.path()).unwrap()[&None], (49.0, -123.0));
    assert_eq!(std::fs::read(dir.path().join("raw.bin")).unwrap(), bytes);
    // Not taken over twice, and what was said survives that the records are made anew.
    assert_eq!(rebuild(dir.path()).unwrap(), 6);
    assert_eq!(records(dir.path()), all);
    assert_eq!(Store::open(dir.path(), &mut Base::new(None)).unwrap().resumed(), 6);
}

#[test]
fn damage_is_named_and_a_check_finds_it() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    take(&mut store, &mut base, &[entry(1, Event::Began(Beginning::default()))]);
    for _ in 0..40 {
        take(&mut store, &mut base, &[entry(1, Event::Bytes(frames(7, 50).concat()))]);
    }
    store.db.execute("UPDATE records SET sequence = 99 WHERE id = 10", []).unwrap();
    drop(store);
    let found = check(dir.path()).unwrap();
    assert!(found.faults[0].contains("record 10 is not what the bytes give"), "{:?}", found.faults);
    rebuild(dir.path()).unwrap();
    assert!(check(dir.path()).unwrap().faults.is_empty());
    let path = dir.path().join(schema::FILE);
    let whole = std::fs::read(&path).unwrap();
    // Cut short, torn, and no database at all.
    let torn: Vec<u8> =
        whole.iter().enumerate().map(|(n, b)| if n % 4096 > 3000 { 0x55 } else { *b }).collect();
    for (name, bytes) in [
        ("cut", whole[..whole.len() / 2 + 100].to_vec()),
        ("torn", torn),
        ("text", b"hello, world".repeat(1000)),
    ] {
        std::fs::write(&path, &bytes).unwrap();
        let opened = Store::open(dir.path(), &mut Base::new(None)).err().map(|e| format!("{e:#}"));
        let checked = match check(dir.path()) {
            Ok(found) => found.faults.join("; "),
            Err(e) => format!("{e:#}"),
        };
        assert!(!checked.is_empty() && checked.lines().count() == 1, "{name}: {checked}");
        if let Some(said) = opened {
            assert!(said.contains("store.sqlite is damaged") && said.lines().count() == 1, "{name}: {said}");
        }
        // Whatever it was, it is still there to be mended.
        assert_eq!(std::fs::read(&path).unwrap().len(), bytes.len(), "{name}");
    }
}

#[test]
fn a_store_that_cannot_be_made_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("file"), b"x").unwrap();
    let below = dir.path().join("file/store");
    let said = format!("{:#}", Store::open(&below, &mut Base::new(None)).err().unwrap());
    assert!(said.contains("file/store"), "{said}");
    // A later version's.
    let later = dir.path().join("later");
    drop(Store::open(&later, &mut Base::new(None)).unwrap());
    Connection::open(later.join(schema::FILE)).unwrap().execute("UPDATE about SET layout = 9", []).unwrap();
    let said = format!("{:#}", Store::open(&later, &mut Base::new(None)).err().unwrap());
    assert!(said.contains("later version (layout 9"), "{said}");
}

#[test]
fn only_so_much_is_kept_and_the_newest_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    take(&mut store, &mut base, &[entry(1, Event::Began(Beginning::default()))]);
    let mut encoder = Encoder::default();
    let hello = encoder.frame(&hello_of(7)).to_vec();
    take(&mut store, &mut base, &[entry(1, Event::Bytes(hello))]);
    let at = |n: u64| 1_790_000_000_000_000 + n as i64 * 1_000_000;
    for n in 0..20 {
        let bytes = encoder.frame(&end(n * 1000)).to_vec();
        take(
            &mut store,
            &mut base,
            &[Entry { stream: 1, received_us: Some(at(n)), event: Event::Bytes(bytes) }],
        );
    }
    while store.forget(at(15)).unwrap() {}
    drop(store);
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    assert_eq!(store.resumed(), 5);
    let stream = store.next_stream();
    take(
        &mut store,
        &mut base,
        &[entry(stream, Event::Began(Beginning { station: Some(7), ..Beginning::default() }))],
    );
    take(&mut store, &mut base, &[entry(stream, Event::Bytes(encoder.frame(&end(50)).to_vec()))]);
    drop(store);
    let all = records(dir.path());
    assert_eq!((all.len(), &all[5]["session"], &all[5]["t_s"]), (6, &1.into(), &0.05.into()));
    assert!(check(dir.path()).unwrap().faults.is_empty());
    let said = format!("{:#}", rebuild(dir.path()).unwrap_err());
    assert!(said.contains("retention") && records(dir.path()) == all, "{said}");
}

#[test]
fn a_moment_is_what_was_known_then_and_a_long_series_is_thinned() {
    use seabearing_core::wire::{Message, Time};
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    take(&mut store, &mut base, &[entry(1, Event::Began(Beginning::default()))]);
    let begin_us = 1_790_000_000_000_000i64;
    let time = |index: u64, utc_us| {
        Message::Time(Time { index, utc_us, sd_s: 0.1, drift: 0.0, sd_drift: 0.0, correlation: 0.0 })
    };
    let mut encoder = Encoder::default();
    let mut bytes = encoder.frame(&hello_of(7)).to_vec();
    bytes.extend(encoder.frame(&time(0, begin_us)));
    // A report a second, and one whose range is not observable.
    for second in 0..1000u64 {
        let report = seabearing_core::wire::Track {
            index: second * 1000,
            x_m: second as f32,
            range_observable: second != 500,
            ..super::super::tests::a_track()
        };
        bytes.extend(encoder.frame(&Message::Track(report)));
        bytes.extend(encoder.frame(&end(second * 1000)));
    }
    // A clock that says 2090.
    bytes.extend(encoder.frame(&time(1_000_000, 3_800_000_000_000_000)));
    take(
        &mut store,
        &mut base,
        &[Entry { stream: 1, received_us: Some(begin_us), event: Event::Bytes(bytes) }],
    );
    drop(store);
    let history = History::open(dir.path()).unwrap();
    let at = |second: i64| begin_us + second * 1_000_000;
    assert_eq!(history.span_us().unwrap(), Some((at(0), at(999))));
    let moment = history.moment(at(700) + 1, at(100)).unwrap();
    let of = |kind: &str| moment.records.iter().filter(|r| r["type"] == kind).collect::<Vec<_>>();
    assert_eq!((of("hello").len(), of("end").len(), of("track").len()), (1, 1, 1));
    assert_eq!((&of("track")[0]["x_m"], &of("end")[0]["t_s"]), (&700.0.into(), &700.0.into()));
    let [path] = &moment.paths[..] else { panic!("{:?}", moment.paths) };
    let places = &path.places;
    assert!(places.len() > 50 && places.len() <= 61 && places[0][1] >= 100.0, "{}", places.len());
    assert!(places.is_sorted_by(|a, b| a[0] <= b[0]) && places.iter().all(|p| p[1] != 500.0));
    // Before anything was, nothing is known.
    assert!(history.moment(at(-10), at(-20)).unwrap().records.is_empty());
    let thin = history.series(Some(7), 9, at(0), at(1000), 100).unwrap();
    assert!(thin.len() == 100 && thin[99]["t_s"].as_f64() >= Some(980.0), "{}", thin.len());
    assert_eq!(history.series(Some(7), 9, at(0), at(50), 100).unwrap().len(), 50);
    assert!(history.series(Some(8), 9, at(0), at(1000), 100).unwrap().is_empty());
}

#[test]
fn what_is_noted_beside_the_connections_is_kept_checked_and_made_anew() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    let alarm = serde_json::json!({ "type": "alarm", "id": 5, "state": "raised" });
    take(&mut store, &mut base, &[entry(0, Event::Noted(Some(7), alarm.clone()))]);
    // Killed before it was decoded.
    store.keep(&[entry(0, Event::Noted(None, alarm))]).unwrap();
    drop(store);
    drop(Store::open(dir.path(), &mut Base::new(None)).unwrap());
    let noted = |dir: &Path| {
        let of =
            |r: Value| (r["type"].to_string(), r["station"].as_u64(), r["id"].as_u64(), r["utc"].is_string());
        records(dir).into_iter().map(of).collect::<Vec<_>>()
    };
    let both =
        [("\"alarm\"".to_owned(), Some(7), Some(5), true), ("\"alarm\"".to_owned(), None, Some(5), true)];
    assert_eq!(noted(dir.path()), both);
    assert!(check(dir.path()).unwrap().faults.is_empty());
    assert_eq!(rebuild(dir.path()).unwrap(), 2);
    assert_eq!(noted(dir.path()), both);
}
