//! Captured streams of every version keep decoding: `tests/golden/NAME-VERSION.bin` as a base station received them, and
//! beside each the records they gave, a line each: station, session, number, and the message's bytes.
//!
//! `plain-1`: telemetry that `process` writes of `scenarios/demo.toml`, and after it a session with one of every message of
//! `docs/wire.md`. `link-1`: a recorder with a link on a line that loses every fifth frame, with one of every message in each of
//! two boots. `plain-2`, `link-2`: the same with `Snippet`, `Samples` and
//! `Spectrum`. `plain-3`, `link-3`: the same with `Azigram`; `plain-4`, `link-4`:
//! with `Margins`; `plain-5`, `link-5`: with `Transient`. A new version adds files and leaves these as they are: `SEABEARING_CAPTURE=telemetry.bin cargo test -p
//! seabearing-tests --test golden_streams` makes them where they are absent.

use seabearing::base::{Base, Beginning};
use seabearing_core::wire::link::{Arrival, Class, Inbox, Link, MemoryStore, Progress, Session, Settings};
use seabearing_core::wire::{Encoder, Message, SCHEMA, bytes_of, message_of};
use std::fmt::Write;
use std::path::PathBuf;

const PAGE: &str = include_str!("../../docs/wire.md");

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("golden")
}

/// What a base station makes of a stream, that comes in pieces of any size.
fn decoded(stream: &[u8], piece: usize) -> (String, Base) {
    let mut base = Base::new(None);
    base.begin(1, Beginning::default(), None);
    let (mut rows, mut text) = (Vec::new(), String::new());
    stream.chunks(piece).for_each(|bytes| base.push(1, 0, None, bytes, &mut rows));
    for row in rows {
        let number = |n: Option<u32>| n.map_or("-".to_owned(), |n| n.to_string());
        let (kind, bytes) = row.stored();
        assert!(kind < 200, "{}", row.json(None));
        let hex: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
        let station = number(row.station.map(u32::from));
        let _ = writeln!(text, "{station} {} {} {hex}", number(row.session), number(row.sequence));
    }
    (text, base)
}

#[test]
fn streams_of_every_version_give_the_records_they_gave() {
    capture();
    let mut streams = 0;
    for file in std::fs::read_dir(folder()).unwrap().flatten().map(|f| f.path()) {
        if file.extension().is_none_or(|e| e != "bin") {
            continue;
        }
        let name = file.display();
        let stream = std::fs::read(&file).unwrap();
        let wanted = std::fs::read_to_string(file.with_extension("txt")).unwrap();
        for piece in [1, 61, stream.len()] {
            let (text, base) = decoded(&stream, piece);
            assert!(text == wanted, "{name}: other records than it gave");
            let line = base.counters().stream;
            assert_eq!((line.damaged, line.unknown), (0, 0), "{name}");
        }
        streams += 1;
    }
    assert!(streams >= 10, "{streams}");
}

/// Of this version there are both, with every message of its schema.
#[test]
fn every_message_of_this_version_is_in_them() {
    let variants = SCHEMA.lines().filter(|l| !l.starts_with("command")).count();
    for name in ["plain-5", "link-5"] {
        let text = std::fs::read_to_string(folder().join(name).with_extension("txt")).unwrap();
        let kinds: std::collections::BTreeSet<&str> =
            text.lines().map(|l| &l.rsplit(' ').next().unwrap()[..2]).collect();
        assert_eq!(kinds.len(), variants, "{name}: a message is new: capture streams of it as NAME-6");
    }
}

/// One of every message, from the page's example frames.
fn examples() -> Vec<Message> {
    let names =
        SCHEMA.lines().filter(|l| !l.starts_with("command")).filter_map(|l| l.split_whitespace().nth(1));
    let example = |name: &str| {
        let is = |l: &&str| l.split_whitespace().next() == Some(name) && l.trim_end().ends_with(" 00");
        let line = PAGE.lines().find(is).unwrap();
        let hex = line.split_whitespace().skip(1);
        let bytes: Vec<u8> = hex.map(|h| u8::from_str_radix(h, 16).unwrap()).collect();
        let mut decoder = seabearing_core::wire::Decoder::default();
        bytes.iter().find_map(|b| decoder.push::<Message>(*b)).unwrap().message
    };
    names.map(example).collect()
}

struct Nothing;

impl Inbox for Nothing {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, arrival: Arrival<'_>) {
        if let Arrival::Record(record) = arrival {
            assert!(message_of(record.bytes).is_some());
        }
    }
}

fn of_a_link() -> Vec<u8> {
    let line = Settings::serial(9600);
    let mut recorder = Link::new(line, 300, 4, 0x0102_0304_0506_0708, MemoryStore::<6400>::new());
    let mut base = Link::new(Settings { leads: false, ..line }, 0, 1, 0, MemoryStore::<64>::new());
    let (mut stream, mut frames, mut buffer) = (Vec::new(), 0, [0; 160]);
    for boot in [4, 5] {
        if boot == 5 {
            recorder = Link::new(line, 300, 5, 0x0102_0304_0506_0708, recorder.into_store());
            base.reconnected();
        }
        for message in examples() {
            recorder.offer(Class::of(&message), bytes_of(&message, &mut buffer));
        }
        for ms in 0..20_000u64 {
            let now = (boot * 60_000 + ms) * 1000;
            if let Some(frame) = recorder.send(now) {
                frames += 1;
                if frames % 5 != 3 {
                    stream.extend_from_slice(frame);
                    frame.iter().for_each(|b| base.receive(now, *b, &mut Nothing));
                }
            }
            if let Some(frame) = base.send(now) {
                frame.iter().for_each(|b| recorder.receive(now, *b, &mut Nothing));
            }
        }
        assert_eq!(recorder.waiting(), 0);
    }
    stream
}

/// Makes the files that are absent, where told of what.
fn capture() {
    let Ok(telemetry) = std::env::var("SEABEARING_CAPTURE") else { return };
    let mut plain = std::fs::read(telemetry).unwrap();
    let mut encoder = Encoder::default();
    examples().iter().for_each(|m| plain.extend_from_slice(encoder.frame(m)));
    for (name, stream) in [("plain-5", plain), ("link-5", of_a_link())] {
        let file = folder().join(name);
        if !file.with_extension("bin").exists() {
            std::fs::write(file.with_extension("txt"), decoded(&stream, 64).0).unwrap();
            std::fs::write(file.with_extension("bin"), stream).unwrap();
        }
    }
}
