use super::record::Row;
use super::store::{Entry, Event, Store, Wanted, read};
use super::*;
use seabearing_core::wire::link::{Arrival, Class, Inbox, Link, MemoryStore, Progress, Session};
use seabearing_core::wire::{
    Encoder, End, Fault, FaultCode, Hello, Message, Reply, SCHEMA_HASH, Time, Track, WIRE_VERSION, bytes_of,
};

pub(crate) fn hello_of(station: u16) -> Message {
    Message::Hello(Hello {
        wire_version: WIRE_VERSION,
        schema_hash: SCHEMA_HASH,
        config_hash: 1,
        version: (0, 1, 0),
        station,
        kind: 0,
        rate_hz: 1000.0,
        reset_cause: 1,
    })
}

pub(crate) fn end(index: u64) -> Message {
    Message::End(End { index, frames: 0 })
}

/// A report of track 3.
pub(crate) fn a_track() -> Track {
    Track {
        id: 3,
        stage: 0,
        index: 0,
        cpa_time_s: 2.0,
        cpa_range_m: 500.0,
        cpa_azimuth: 1.5,
        heading: 0.5,
        speed_m_s: 7.0,
        starboard: true,
        sd_cpa_time_s: 0.1,
        sd_cpa_range_m: 20.0,
        sd_heading: 0.01,
        sd_speed_m_s: 0.2,
        x_m: 0.0,
        y_m: 500.0,
        var_x_m2: 100.0,
        var_y_m2: 400.0,
        cov_xy_m2: 50.0,
        range_observable: true,
        n: 9,
    }
}

/// A session of station 7 as frames: `Hello`, and then so many others.
pub(crate) fn frames(station: u16, n: u64) -> Vec<Vec<u8>> {
    let mut encoder = Encoder::default();
    let first = encoder.frame(&hello_of(station)).to_vec();
    let rest = (0..n).map(|i| encoder.frame(&end(i * 1000)).to_vec());
    std::iter::once(first).chain(rest).collect()
}

fn session(n: u64) -> Vec<u8> {
    frames(7, n).concat()
}

fn lasting(line: &str, peer: Option<&str>, station: Option<u16>) -> Beginning {
    Beginning { line: line.into(), peer: peer.map(Into::into), station, lasting: true }
}

/// A base station with one file being read.
fn one(rate_hz: Option<f64>) -> Base {
    let mut base = Base::new(rate_hz);
    base.begin(1, Beginning::default(), None);
    base
}

fn push(base: &mut Base, bytes: &[u8]) -> Vec<Value> {
    let mut rows = Vec::new();
    base.push(1, 0, None, bytes, &mut rows);
    rows.iter().map(|row| base.json(row)).collect()
}

struct Nothing;

impl Inbox for Nothing {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, _: Arrival<'_>) {}
}

/// A recorder with a link and a base station with a store that is opened anew every second; of the bytes of the recorder
/// every seventh is damaged for a while.
#[test]
fn over_a_link_every_record_is_stored_once_whatever_happens_to_line_and_base() {
    let line = Settings::serial(115_200);
    let folder = tempfile::tempdir().unwrap();
    let mut buffer = [0; 160];
    let mut recorder = Link::new(line, 7, 1, 0, MemoryStore::<6400>::new());
    let (mut at_us, mut said) = (0u64, 0u32);
    for second in 0..40u64 {
        let mut base = Base::new(None);
        let mut store = Store::open(folder.path(), &mut base).unwrap();
        let stream = store.next_stream();
        let happen = |event| [Entry { stream, received_us: Some(second as i64), event }];
        let began = happen(Event::Began(lasting("tcp:x:1", None, None)));
        store.keep(&began).unwrap();
        began[0].tell(&mut base, at_us, Some(line), &mut Vec::new());
        if second == 20 {
            // Another boot; the store is what survives.
            recorder = Link::new(line, 7, 2, 0, recorder.into_store());
        }
        for _ in 0..if second < 30 { 4 } else { 0 } {
            let message = if said % 80 == 0 { hello_of(7) } else { end(said.into()) };
            recorder.offer(Class::of(&message), bytes_of(&message, &mut buffer));
            said += 1;
        }
        for ms in 0..1000u64 {
            at_us += 1000;
            let mut frame = recorder.send(at_us).unwrap_or(&[]).to_vec();
            if second < 25 && ms % 7 == 3 {
                frame.iter_mut().for_each(|b| *b ^= 4);
            }
            if !frame.is_empty() {
                let came = happen(Event::Bytes(frame));
                store.keep(&came).unwrap();
                // Killed between bytes and records, and neither decoded nor acknowledged.
                if second % 5 == 4 && ms > 800 {
                    continue;
                }
                let mut rows = Vec::new();
                came[0].tell(&mut base, at_us, None, &mut rows);
                store.derive(&mut base, &rows).unwrap();
            }
            while let Some(answer) = base.answer(stream, at_us).map(<[u8]>::to_vec) {
                answer.iter().for_each(|b| recorder.receive(at_us, *b, &mut Nothing));
            }
        }
    }
    assert_eq!(recorder.waiting(), 0);
    let mut kept = Vec::new();
    read(folder.path(), &Wanted::default(), |r| kept.push(r)).unwrap();
    let of_recorder: Vec<&Value> = kept.iter().filter(|r| r["type"] != "line").collect();
    let mut sequences: Vec<u64> = of_recorder.iter().map(|r| r["sequence"].as_u64().unwrap()).collect();
    sequences.sort_unstable();
    assert!(sequences.into_iter().eq(0..u64::from(said)));
    let second_boot = of_recorder.iter().filter(|r| r["session"] == 2).count();
    assert_eq!(second_boot as u32, said - 80);
    assert!(of_recorder.iter().all(|r| r["station"] == 7 && r["received_utc"].is_string()));
    let found = store::check(folder.path()).unwrap();
    assert_eq!(found.faults, Vec::<String>::new());
    // Made anew from the bytes it is the same.
    assert_eq!(store::rebuild(folder.path()).unwrap() as usize, kept.len());
    let mut anew = Vec::new();
    read(folder.path(), &Wanted::default(), |r| anew.push(r)).unwrap();
    assert_eq!(anew, kept);
}

#[test]
fn a_restart_is_a_new_session_and_not_65000_lost_frames() {
    let mut base = one(None);
    let mut out = push(&mut base, &session(3));
    out.extend(push(&mut base, &session(2)));
    let c = base.counters();
    assert_eq!((c.stream.frames, c.stream.lost, out.len()), (7, 0, 7));
    assert_eq!(out[2]["t_s"], 1.0);
    assert_eq!(
        (&out[5]["session"], &out[5]["sequence"], &out[5]["station"]),
        (&2.into(), &1.into(), &7.into())
    );
    for key in ["utc", "sd_utc_s", "received_utc"] {
        assert_eq!(out[5].get(key), Some(&Value::Null), "{key}");
    }
}

#[test]
fn what_a_session_lacks_is_counted_and_told_and_what_comes_late_is_not() {
    let mut base = one(None);
    let first = frames(7, 5);
    // The fourth frame comes after the fifth.
    for k in [0, 1, 2, 4, 3, 5] {
        push(&mut base, &first[k]);
    }
    assert_eq!(base.counters().stream.lost, 0);
    let second = frames(7, 4);
    let told: Vec<Value> = [0, 1, 4].iter().flat_map(|k| push(&mut base, &second[*k])).collect();
    let c = base.counters();
    assert_eq!((c.stream.lost, c.stream.repeated), (2, 0));
    let lost: Vec<&Value> = told.iter().filter(|r| r["type"] == "lost").collect();
    assert_eq!((lost.len(), &lost[0]["frames"], &lost[0]["station"]), (1, &2.into(), &7.into()));
}

#[test]
fn a_stream_joined_in_the_middle_has_no_times_but_its_values() {
    let whole = session(3);
    let first = whole.iter().position(|b| *b == 0).unwrap() + 1;
    let out = push(&mut one(None), &whole[first..]);
    assert_eq!(out.len(), 3);
    assert!(out[1]["t_s"].is_null() && out[1]["station"].is_null());
    let out = push(&mut one(Some(500.0)), &whole[first..]);
    assert_eq!(out[1]["t_s"], 2.0);
    // On a line it is asked who it is.
    let mut base = Base::new(None);
    base.begin(1, lasting("listen:x:1", Some("10.0.0.1:5"), None), None);
    assert!(base.answer(1, 0).is_none());
    push(&mut base, &whole[first..]);
    assert!(base.answer(1, 0).is_some() && base.answer(1, 0).is_none());
}

#[test]
fn whatever_the_index_and_the_rate_a_known_start_does_no_harm() {
    for rate_hz in [None, Some(50.0)] {
        let mut base = one(rate_hz);
        base.say_start(Some(1_714_554_000_000_000));
        let mut out = Vec::new();
        for index in [0, 1 << 62, u64::MAX] {
            out.extend(push(&mut base, Encoder::default().frame(&end(index))));
        }
        assert_eq!(out.len(), 3);
        assert_eq!(out[0]["utc"].is_string(), rate_hz.is_some());
        assert!(out[2]["utc"].is_null());
    }
}

#[test]
fn a_cut_frame_does_not_take_the_next_stream_s_first_with_it() {
    let mut base = one(None);
    let whole = session(2);
    let mut rows = Vec::new();
    base.push(1, 0, None, &whole[..whole.len() - 3], &mut rows);
    base.end(1, None, None, &mut rows);
    base.begin(2, Beginning::default(), None);
    base.push(2, 0, None, &session(1), &mut rows);
    assert_eq!((rows.len(), base.counters().stream.damaged), (4, 1));
}

#[test]
fn another_version_is_noticed_once_and_named() {
    let mut base = one(None);
    let Message::Hello(h) = hello_of(7) else { unreachable!() };
    let mut encoder = Encoder::default();
    push(&mut base, encoder.frame(&Message::Hello(Hello { wire_version: 9, ..h })));
    push(&mut base, encoder.frame(&Message::Reply(Reply { token: 0, status: 0 })));
    let said = base.warnings();
    assert!(
        said.len() == 1 && said[0].contains("wire version 9") && said[0].contains("station 7"),
        "{said:?}"
    );
    let mut base = one(None);
    let mut encoder = Encoder::default();
    push(&mut base, encoder.frame(&Message::Hello(Hello { schema_hash: 5, ..h })));
    assert!(base.warnings()[0].contains("counted as unknown"));
    // A message that this version does not know: counted, and nothing else is.
    push(&mut base, encoder.frame_of(&[99, 1, 2]));
    assert_eq!((base.counters().stream.unknown, base.counters().stream.damaged), (1, 0));
}

/// Two recorders on one port keep their sessions, clocks and tracks apart.
#[test]
fn recorders_are_told_apart_and_a_newer_connection_takes_over() {
    let mut base = Base::new(None);
    let mut rows = Vec::new();
    for (stream, station) in [(1, 7), (2, 8)] {
        base.begin(stream, lasting("listen:x:1", Some(&format!("10.0.0.{station}:5")), None), None);
        base.push(stream, 0, Some(0), &frames(station, 1).concat(), &mut rows);
    }
    let said = rows.iter().filter(|r| r.sequence.is_some());
    let stations = said.map(|r| (r.station, r.session)).collect::<BTreeSet<_>>();
    assert_eq!(stations.into_iter().collect::<Vec<_>>(), [(Some(7), Some(1)), (Some(8), Some(1))]);
    // The line of 7 is lost without a word, and it calls again.
    base.begin(3, lasting("listen:x:1", Some("10.0.0.7:6"), None), None);
    rows.clear();
    base.push(3, 0, Some(1_000_000), &frames(7, 1).concat(), &mut rows);
    assert_eq!(base.json(&rows[0])["state"], "up");
    assert_eq!(rows[2].session, Some(2));
    // What was still on its way is no fault; what comes later is another recorder.
    rows.clear();
    base.push(1, 0, Some(1_500_000), &frames(7, 3).concat(), &mut rows);
    assert!(rows.is_empty() && base.closing().count() == 0);
    base.push(1, 0, Some(9_000_000), &frames(7, 3).concat(), &mut rows);
    let told = base.json(&rows[0]);
    let text = told["text"].as_str().unwrap();
    assert!(
        text.contains("station 7") && text.contains("10.0.0.7:5") && text.contains("10.0.0.7:6"),
        "{text}"
    );
    assert_eq!((rows.len(), base.closing().collect::<Vec<_>>()), (1, vec![1]));
    assert_eq!(base.warnings().len(), 1);
    // The end of a connection that was taken over from is not the line's.
    rows.clear();
    base.end(1, None, Some(9_000_000), &mut rows);
    assert!(rows.is_empty());
    base.silent(3, Some(9_500_000), &mut rows);
    base.push(3, 0, Some(9_600_000), &[0], &mut rows);
    base.end(3, Some("cable"), Some(9_700_000), &mut rows);
    let states: Vec<Value> = rows.iter().map(|r| base.json(r)["state"].clone()).collect();
    assert_eq!(states, ["silent", "up", "down"]);
}

#[test]
fn noise_ends_a_call_and_nothing_else() {
    let mut base = Base::new(None);
    base.begin(1, lasting("listen:x:1", Some("10.0.0.9:5"), None), None);
    base.begin(2, lasting("listen:x:1", Some("10.0.0.7:5"), None), None);
    let mut rows = Vec::new();
    let mut state = 1u32;
    let noise: Vec<u8> = (0..1 << 16)
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        })
        .collect();
    for _ in 0..17 {
        base.push(1, 0, Some(0), &noise, &mut rows);
    }
    base.push(2, 0, Some(0), &session(2), &mut rows);
    base.end(1, None, Some(0), &mut rows);
    assert_eq!(rows.len(), 4);
    let said = base.warnings();
    assert!(said.len() == 1 && said[0].contains("10.0.0.9"), "{said:?}");
}

/// What the recorder says of its clock dates records that came before, in the store too, and each session has its own.
#[test]
fn records_from_before_the_first_time_get_their_utc_in_the_store() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::new(None);
    let mut store = Store::open(dir.path(), &mut base).unwrap();
    let mut encoder = Encoder::default();
    let time = Time {
        index: 5000,
        utc_us: 1_790_000_000_000_000,
        sd_s: 0.25,
        drift: 0.0,
        sd_drift: 0.0,
        correlation: 0.0,
    };
    let messages = [hello_of(7), end(1000), Message::Time(time), end(6000)];
    let mut bytes: Vec<u8> = messages.iter().flat_map(|m| encoder.frame(m).to_vec()).collect();
    let mut again = Encoder::default();
    bytes.extend(again.frame(&hello_of(7)));
    bytes.extend(again.frame(&end(1000)));
    let entries = [
        Entry { stream: 1, received_us: Some(5), event: Event::Began(Beginning::default()) },
        Entry { stream: 1, received_us: Some(5), event: Event::Bytes(bytes) },
    ];
    store.keep(&entries).unwrap();
    let mut rows: Vec<Row> = Vec::new();
    entries.iter().for_each(|e| e.tell(&mut base, 0, None, &mut rows));
    store.derive(&mut base, &rows).unwrap();
    drop(store);
    let mut kept = Vec::new();
    read(dir.path(), &Wanted::default(), |r| kept.push(r)).unwrap();
    assert_eq!(kept[1]["utc"], "2026-09-21T14:13:16Z");
    assert!((kept[1]["sd_utc_s"].as_f64().unwrap() - 0.25).abs() < 1e-9);
    assert_eq!(kept[3]["utc"], "2026-09-21T14:13:21Z");
    assert_eq!((&kept[5]["session"], &kept[5]["utc"]), (&2.into(), &Value::Null));
    // A base station that is started again goes on with the clock of the session.
    let mut base = Base::new(None);
    let _store = Store::open(dir.path(), &mut base).unwrap();
    let first = &base.recorders().next().unwrap().sessions[&1];
    assert_eq!(first.utc(6000).map(|(us, _)| us), Some(1_790_000_001_000_000));
    let fault = Message::Fault(Fault { code: FaultCode::Gap, index: 1, value: 1 });
    assert_eq!(record::index(&fault), Some(1));
}

#[test]
fn an_index_that_starts_again_has_another_line_of_utc() {
    const START_US: i64 = 1_790_000_000_000_000;
    let time = |index: u64, second: i64| {
        let utc_us = START_US + second * 1_000_000;
        Message::Time(Time { index, utc_us, sd_s: 1e-3, drift: 0.0, sd_drift: 1e-6, correlation: 0.0 })
    };
    let track = |index: u64, stage: u8| Message::Track(Track { index, stage, ..a_track() });
    let restarted = Message::Fault(Fault { code: FaultCode::Restarted, index: 0, value: 10_000_000 });
    let mut encoder = Encoder::default();
    let said = [
        hello_of(7),
        time(10_000_000, 10_000),
        track(10_050_000, 0),
        restarted,
        // Of the passage that the restart ended.
        track(10_060_000, 1),
        end(1000),
        time(2000, 10_070),
        end(3000),
    ];
    let bytes: Vec<u8> = said.iter().flat_map(|m| encoder.frame(m).to_vec()).collect();
    let mut base = one(None);
    let mut rows = Vec::new();
    base.push(1, 0, None, &bytes, &mut rows);
    let seconds: Vec<Option<i64>> =
        rows.iter().map(|row| row.utc.map(|(us, _)| (us - START_US) / 1_000_000)).collect();
    let expected = [Some(10_050), None, Some(10_060), None, Some(10_070), Some(10_071)];
    assert_eq!(seconds[2..], expected);
    let sessions: Vec<Option<u32>> = rows.iter().map(|row| row.session).collect();
    assert_eq!(sessions, [1, 1, 1, 2, 1, 2, 2, 2].map(Some));
}
