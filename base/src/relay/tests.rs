use super::super::store::{Entry, Event, Logs, Retain, Store, Tail, Wanted, check, read, rebuild};
use super::super::tests::{a_track, end, frames, hello_of};
use super::super::{Base, Beginning};
use super::seen::Seen;
use super::*;
use proptest::prelude::*;
use seabearing_core::wire::{Encoder, Message, Time};
use serde_json::Value;
use std::path::Path;

/// 2026-09-21.
const NOW_US: i64 = 1_790_000_000_000_000;

fn take(store: &mut Store, base: &mut Base, stream: u32, received_us: i64, event: Event) -> usize {
    let entry = Entry { stream, received_us: Some(received_us), event };
    store.keep(std::slice::from_ref(&entry)).unwrap();
    let mut rows = Vec::new();
    entry.tell(base, 0, None, &mut rows);
    store.derive(base, &rows).unwrap();
    rows.len()
}

fn records(folder: &Path) -> Vec<Value> {
    let mut all = Vec::new();
    read(folder, &Wanted::default(), |r| all.push(r)).unwrap();
    all
}

/// A base station that has heard a station's session, as a store of its own; and all of it as it is relayed.
fn heard(folder: &Path, bytes: &[u8], log: u64) -> Vec<Relayed> {
    let mut base = Base::new(None);
    let mut store = Store::open(folder, &mut base).unwrap();
    take(
        &mut store,
        &mut base,
        1,
        NOW_US,
        Event::Began(Beginning { line: "x".into(), ..Beginning::default() }),
    );
    take(&mut store, &mut base, 1, NOW_US, Event::Bytes(bytes.to_vec()));
    let mut tail = Tail::open(folder).unwrap();
    let all = tail.after(0, 1000).unwrap();
    assert_eq!(all.last().unwrap().number, tail.newest().unwrap());
    all.iter().map(|n| Relayed::of(&n.row, log, n.number as u64, n.rate_hz)).collect()
}

/// Hello, a track before UTC is known, UTC, and what follows.
fn session() -> Vec<u8> {
    let mut encoder = Encoder::default();
    let time = Time { index: 500, utc_us: NOW_US, sd_s: 1e-3, drift: 0.0, sd_drift: 1e-7, correlation: 0.0 };
    let messages = [hello_of(7), Message::Track(a_track()), Message::Time(time), end(900), end(1000)];
    messages.iter().flat_map(|m| encoder.frame(m).to_vec()).collect()
}

#[test]
fn a_centre_has_the_records_of_a_base_station_as_they_are_there_and_each_once() {
    let (near, far) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let relayed = heard(near.path(), &session(), 5);
    // Each comes as it was when it was stored: before `Time` without UTC.
    let undated: Vec<Relayed> =
        relayed.iter().map(|r| Relayed { utc: r.utc.filter(|_| r.number > 2), ..r.clone() }).collect();
    let (mut base, mut came) = (Base::new(None), 0);
    let mut store = Store::open(far.path(), &mut base).unwrap();
    for (part, now_us) in [(&undated[..3], NOW_US), (&undated[1..4], NOW_US), (&undated[..], NOW_US + 1)] {
        came += take(&mut store, &mut base, 0, now_us, Event::Relayed(packed(part).unwrap()));
    }
    assert_eq!(came, relayed.len());
    assert_eq!(records(far.path()), records(near.path()));
    assert!(
        records(far.path())
            .iter()
            .any(|r| r["type"] == "track" && r["utc"].is_string() && r["t_s"].is_number())
    );
    let counters = base.relay_counters();
    assert_eq!(counters, RelayCounters { taken: 5, again: 6, missing: 0, logs: 1, refused: 0 });
    // Started again, and killed between keeping and decoding.
    let more = Relayed { number: 9, ..relayed[4].clone() };
    let again = [relayed.clone(), vec![more]].concat();
    let event = Event::Relayed(packed(&again).unwrap());
    store.keep(&[Entry { stream: 0, received_us: Some(NOW_US + 2), event }]).unwrap();
    drop(store);
    let mut base = Base::new(None);
    let store = Store::open(far.path(), &mut base).unwrap();
    assert_eq!(base.relay_counters().missing, 3);
    assert_eq!(store.resumed(), 6);
    drop(store);
    assert!(check(far.path()).unwrap().faults.is_empty());
    let before = records(far.path());
    rebuild(far.path()).unwrap();
    assert_eq!(records(far.path()), before);
}

#[test]
fn what_has_come_is_known_beyond_the_end_of_a_month_and_without_the_bytes_before() {
    let (near, far) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let relayed = heard(near.path(), &session(), u64::MAX);
    let month_us = 31 * 86_400_000_000;
    let mut base = Base::new(None);
    let mut store = Store::open(far.path(), &mut base).unwrap();
    for (n, part) in [&relayed[..2], &relayed[..3], &relayed[2..4], &relayed[..]].into_iter().enumerate() {
        take(&mut store, &mut base, 0, NOW_US + n as i64 * month_us, Event::Relayed(packed(part).unwrap()));
        while store.tidy(Retain { raw: Some(1), records: None }).unwrap() {}
    }
    drop(store);
    assert_eq!(records(far.path()), records(near.path()));
    assert!(check(far.path()).unwrap().faults.is_empty());
    rebuild(far.path()).unwrap();
    assert_eq!(records(far.path()), records(near.path()));
    // A store's tail goes through the files of its months.
    let numbers = |after, most| {
        let found = Tail::open(far.path()).unwrap().after(after, most).unwrap();
        found.iter().map(|n| n.number).collect::<Vec<_>>()
    };
    assert_eq!((numbers(0, 9), numbers(1, 3)), (vec![1, 2, 3, 4, 5], vec![2, 3, 4]));
    let first = Tail::open(far.path()).unwrap().after(0, 1).unwrap().remove(0);
    assert_eq!((first.row.station, first.rate_hz), (Some(7), Some(1000.0)));
}

#[test]
fn a_station_heard_by_two_base_stations_has_sessions_of_both() {
    let (one, two, far) =
        (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let first = heard(one.path(), &frames(7, 3).concat(), 1);
    let second = heard(two.path(), &frames(7, 2).concat(), 2);
    let mut base = Base::new(None);
    let mut store = Store::open(far.path(), &mut base).unwrap();
    let mixed = [&first[..2], &second[..2], &first[2..], &second[2..]].concat();
    take(&mut store, &mut base, 0, NOW_US, Event::Relayed(packed(&mixed).unwrap()));
    let sessions: Vec<u64> = records(far.path()).iter().filter_map(|r| r["session"].as_u64()).collect();
    assert_eq!(sessions, [1, 1, 2, 2, 1, 1, 2]);
}

#[test]
fn what_another_base_station_found_itself_is_left_out_and_damage_is_named() {
    let mut base = Base::new(None);
    let said = |kind: &str, number| {
        let body = Body::Said(serde_json::json!({ "type": kind }));
        let row = Row {
            origin: None,
            station: Some(7),
            session: None,
            sequence: None,
            utc: None,
            received_us: None,
            body,
        };
        Relayed::of(&row, 1, number, None)
    };
    let all = [said("network_track", 1), said("alarm", 2), said("line", 3)];
    let mut rows = Vec::new();
    base.relayed(&packed(&all).unwrap(), &mut rows);
    assert_eq!(rows.len(), 1);
    assert_eq!(base.relay_counters().missing, 0);
    base.relayed(&[200, 1], &mut rows);
    let unread = [4, 5].map(|number| Relayed { kind: 1, body: vec![255], ..said("line", number) });
    base.relayed(&packed(&unread).unwrap(), &mut rows);
    let warnings = base.warnings();
    assert!(rows.len() == 1 && warnings.len() == 2, "{warnings:?}");
}

#[test]
fn records_that_go_round_by_way_of_another_centre_are_known_and_so_are_both_ways_to_one() {
    let near = tempfile::tempdir().unwrap();
    let heard = heard(near.path(), &session(), 5);
    // What a centre with this log publishes of what it has taken.
    let onward = |base: &mut Base, from: &[Relayed], log: u64| -> Vec<Relayed> {
        let mut rows = Vec::new();
        base.relayed(&packed(from).unwrap(), &mut rows);
        assert!(rows.iter().all(|row| row.origin.is_some_and(|o| o.log == 5)));
        (1..).zip(&rows).map(|(number, row)| Relayed::of(row, log, number, None)).collect()
    };
    let (mut one, mut two) = (Base::new(None), Base::new(None));
    let by_one = onward(&mut one, &heard, 100);
    let by_two = onward(&mut two, &by_one, 200);
    assert_eq!((by_one.len(), by_two.len()), (heard.len(), heard.len()));
    assert_eq!(by_two[2].origin(), Origin { log: 5, number: 3 });
    // Back at the first, and straight to the second after it had come by way of the first.
    assert!(onward(&mut one, &by_two, 100).is_empty());
    assert!(onward(&mut two, &heard, 200).is_empty());
    assert_eq!((one.relay_counters().again, two.relay_counters().again), (5, 5));
    // That outlives the program, and the bytes give the same records anew.
    let far = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(far.path(), &mut base).unwrap();
    take(&mut store, &mut base, 0, NOW_US, Event::Relayed(packed(&by_one).unwrap()));
    drop(store);
    let mut base = Base::new(None);
    let mut store = Store::open(far.path(), &mut base).unwrap();
    for again in [&by_two, &heard] {
        assert_eq!(take(&mut store, &mut base, 0, NOW_US, Event::Relayed(packed(again).unwrap())), 0);
    }
    let kept = Tail::open(far.path()).unwrap().after(0, 9).unwrap();
    assert_eq!(kept[4].row.origin, Some(Origin { log: 5, number: 5 }));
    drop(store);
    assert!(check(far.path()).unwrap().faults.is_empty());
}

#[test]
fn a_copy_of_a_store_that_goes_on_by_itself_gives_other_numbers_and_what_it_was_copied_with_stays_known() {
    let (first, copy) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    drop(heard(first.path(), &session(), 0));
    for file in std::fs::read_dir(first.path()).unwrap().flatten() {
        std::fs::copy(file.path(), copy.path().join(file.file_name())).unwrap();
    }
    let goes_on = |folder: &Path, index| {
        let mut base = Base::new(None);
        let mut store = Store::open(folder, &mut base).unwrap();
        let stream = store.next_stream();
        let began = Beginning { line: "x".into(), ..Beginning::default() };
        take(&mut store, &mut base, stream, NOW_US, Event::Began(began));
        let mut encoder = Encoder::default();
        let bytes = [hello_of(7), end(index)].iter().flat_map(|m| encoder.frame(m).to_vec()).collect();
        take(&mut store, &mut base, stream, NOW_US, Event::Bytes(bytes));
        let logs = Logs::of(folder).unwrap();
        let all = Tail::open(folder).unwrap().after(0, 99).unwrap();
        all.iter()
            .map(|n| Relayed::of(&n.row, logs.log(n.number), n.number as u64, n.rate_hz))
            .collect::<Vec<_>>()
    };
    // Twice each: a store that stays where it is keeps its log.
    let logs = |records: &[Relayed]| records.iter().map(|r| r.log).collect::<BTreeSet<_>>().len();
    goes_on(first.path(), 2000);
    goes_on(copy.path(), 3000);
    let (ours, theirs) = (goes_on(first.path(), 2001), goes_on(copy.path(), 3001));
    assert_eq!((ours.len(), theirs.len(), logs(&ours), logs(&theirs)), (9, 9, 1, 2));
    let (mut base, mut rows) = (Base::new(None), Vec::new());
    base.relayed(&packed(&ours).unwrap(), &mut rows);
    base.relayed(&packed(&theirs).unwrap(), &mut rows);
    assert_eq!((rows.len(), base.relay_counters().again), (9 + 4, 5));
}

#[test]
fn what_a_hostile_publisher_says_fills_no_memory() {
    let mut base = Base::new(None);
    let row = Row {
        origin: None,
        station: Some(7),
        session: None,
        sequence: None,
        utc: None,
        received_us: None,
        body: Body::Said(serde_json::json!({ "type": "line" })),
    };
    let all: Vec<Relayed> = (0..LOGS as u64 + 50).map(|log| Relayed::of(&row, log, 1, None)).collect();
    let mut rows = Vec::new();
    base.relayed(&packed(&all).unwrap(), &mut rows);
    let counters = base.relay_counters();
    assert_eq!((rows.len(), counters.logs, counters.refused), (LOGS, LOGS as u64, 50));
    assert_eq!(base.warnings().len(), 1);
    // Those that are known go on.
    base.relayed(&packed(&[Relayed::of(&row, 3, 2, None)]).unwrap(), &mut rows);
    assert_eq!(rows.len(), LOGS + 1);
}

#[test]
fn numbers_of_no_store_are_counted_without_a_panic() {
    let mut seen = Seen::default();
    assert!(seen.take(0) && seen.take(u64::MAX) && !seen.take(u64::MAX));
    assert_eq!(seen.missing(), u64::MAX - 1);
}

proptest! {
    #![proptest_config(seabearing_testkit::property(300))]
    #[test]
    fn runs_of_numbers_join_whatever_their_order(numbers in proptest::collection::vec(0u64..40, 0..80)) {
        let (mut seen, mut all) = (Seen::default(), BTreeSet::new());
        for n in &numbers {
            prop_assert_eq!(seen.take(*n), all.insert(*n));
        }
        let known: Vec<u64> = seen.runs.iter().flat_map(|(first, last)| *first..=*last).collect();
        prop_assert!(known.iter().eq(&all));
        let span = all.first().zip(all.last()).map_or(0, |(first, last)| last - first + 1);
        prop_assert_eq!(seen.missing(), span - all.len() as u64);
        let next = seen.runs.keys().skip(1);
        prop_assert!(seen.runs.values().zip(next).all(|(last, next)| last + 1 < *next), "{:?}", seen.runs);
    }
}
