//! What takes input from outside, each as a function of bytes, and inputs that are right: for mutation here, and for any
//! other fuzzer that brings bytes.

use super::base_process::hello;
use super::base_station::{bearing, track};
use super::station::Station;
use anyhow::Result;
use seabearing_base::store::{Entry, Event, Store, Wanted, check, read};
use seabearing_base::{Base, Beginning};
use seabearing_core::block::Frame;
use seabearing_core::port::{Chunk, SampleSource};
use seabearing_core::sample_line::{self, Arrival as Came, ByteSource, PACKET_FRAMES};
use seabearing_core::wire::link::{Arrival, Class, Inbox, Link, MemoryStore, Progress, Session, Settings};
use seabearing_core::wire::{Command, Decoder, Encoder, Message, Time, bytes_of};
use seabearing_host::beside::Folder;
use std::path::Path;

/// What came of an input.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outcome {
    /// Frames that were taken and that nobody wrote.
    pub false_frames: u64,
    /// Something was taken.
    pub taken: bool,
}

/// A way in.
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// How many inputs of the fastest target one of this costs.
    pub cost: usize,
    /// Inputs that are right.
    pub seeds: fn() -> Result<Vec<Vec<u8>>>,
    /// Takes an input made of the seeds.
    pub run: fn(&[u8], &[Vec<u8>]) -> Outcome,
}

/// All of them.
pub const TARGETS: [Target; 5] = [
    Target { name: "decoder and link", cost: 1, seeds: streams, run: link },
    Target { name: "sample line", cost: 2, seeds: sample_lines, run: samples },
    Target { name: "base station", cost: 10, seeds: streams, run: base },
    Target { name: "station file", cost: 20, seeds: station_files, run: station_file },
    Target { name: "store", cost: 2000, seeds: stores, run: store },
];

fn messages() -> Vec<Message> {
    let time = Time {
        index: 900,
        utc_us: 1_790_000_000_000_000,
        sd_s: 1e-3,
        drift: 1e-6,
        sd_drift: 1e-7,
        correlation: 0.1,
    };
    vec![hello(7, 1000.0), Message::Time(time), bearing(1000), track(3, 2000, true), bearing(u64::MAX)]
}

/// Frames of a recorder without a link, and of a link both ways.
fn streams() -> Result<Vec<Vec<u8>>> {
    let mut encoder = Encoder::default();
    let mut all: Vec<Vec<u8>> = messages().iter().map(|m| encoder.frame(m).to_vec()).collect();
    all.push(all.concat());
    all.push(encoder.frame(&Command::Identify { token: 1 }).to_vec());
    let settings = Settings::serial(115_200);
    let mut recorder = Link::new(settings, 7, 3, 9, MemoryStore::<4000>::new());
    let mut base = Link::new(Settings { leads: false, ..settings }, 0, 1, 0, MemoryStore::<400>::new());
    let mut buffer = [0; 160];
    for message in messages().iter().chain(&messages()) {
        recorder.offer(Class::of(message), bytes_of(message, &mut buffer));
    }
    base.offer(Class::Health, bytes_of(&Command::Stop { token: 4 }, &mut buffer));
    let (mut said, mut answered) = (Vec::new(), Vec::new());
    for now in (0..3_000_000).step_by(10_000) {
        if let Some(frame) = recorder.send(now) {
            said.extend_from_slice(frame);
            frame.iter().for_each(|b| base.receive(now, *b, &mut Nothing));
        }
        if let Some(frame) = base.send(now) {
            answered.extend_from_slice(frame);
            frame.iter().for_each(|b| recorder.receive(now, *b, &mut Nothing));
        }
    }
    all.extend([said, answered]);
    Ok(all)
}

/// A desk that nobody looks at.
pub struct Nothing;

impl Inbox for Nothing {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, _: Arrival<'_>) {}
}

/// Whether bytes between delimiters are a frame that stands in a seed as it is.
fn written(frame: &[u8], seeds: &[Vec<u8>]) -> bool {
    seeds.iter().any(|seed| seed.split(|b| *b == 0).any(|known| known == frame))
}

fn link(input: &[u8], seeds: &[Vec<u8>]) -> Outcome {
    let settings = Settings::serial(115_200);
    let mut recorder = Link::new(settings, 7, 3, 9, MemoryStore::<1000>::new());
    let mut base = Link::new(Settings { leads: false, ..settings }, 0, 1, 0, MemoryStore::<1000>::new());
    recorder.offer(Class::Alarm, b"one");
    base.offer(Class::Health, b"two");
    let mut decoder = Decoder::default();
    let (mut outcome, mut begin) = (Outcome::default(), 0);
    for (now, byte) in (0u64..).zip(input) {
        let now = now * 100;
        if decoder.push_frame(*byte).is_some() {
            outcome.taken = true;
            outcome.false_frames += u64::from(!written(&input[begin..now as usize / 100], seeds));
        }
        if *byte == 0 {
            begin = now as usize / 100 + 1;
        }
        recorder.receive(now, *byte, &mut Nothing);
        base.receive(now, *byte, &mut Nothing);
        if *byte == 0 {
            recorder.send(now);
            base.send(now);
        }
    }
    outcome
}

fn sample_lines() -> Result<Vec<Vec<u8>>> {
    let mut writer = sample_line::Writer::default();
    let frames: Vec<Frame> = (0..8).map(|n| [n, -n * 1000, 1 << 20, i32::MIN]).collect();
    let mut all: Vec<Vec<u8>> =
        [0, 8, 16, u64::MAX - 3].iter().map(|n| writer.samples(*n, &frames).to_vec()).collect();
    all.push(writer.end(24).to_vec());
    all.push(all.concat());
    Ok(all)
}

/// Bytes of a line.
struct Line<'a>(std::slice::Iter<'a, u8>);

impl ByteSource for Line<'_> {
    fn next(&mut self) -> Came {
        self.0.next().map_or(Came::Closed, |b| Came::Byte(*b))
    }
}

fn samples(input: &[u8], seeds: &[Vec<u8>]) -> Outcome {
    let mut reader = sample_line::Reader::new(Line(input.iter()));
    let mut frames = [[0; 4]; PACKET_FRAMES];
    let mut outcome = Outcome::default();
    while let Chunk::Frames { count, .. } = reader.read(&mut frames) {
        outcome.taken = true;
        assert!(count <= PACKET_FRAMES);
    }
    let frames = input.split(|b| *b == 0).filter(|f| written(f, seeds)).count() as u64;
    outcome.false_frames = reader.counters().frames.saturating_sub(frames);
    outcome
}

fn base(input: &[u8], _: &[Vec<u8>]) -> Outcome {
    let mut base = Base::new(None);
    base.begin(1, Beginning { lasting: true, ..Beginning::default() }, Some(Settings::serial(9600)));
    let mut rows = Vec::new();
    for (n, bytes) in input.chunks(50).enumerate() {
        base.push(1, n as u64 * 1000, Some(1_790_000_000_000_000), bytes, &mut rows);
        base.answer(1, n as u64 * 1000);
    }
    base.end(1, None, None, &mut rows);
    let shown: usize = rows.iter().map(|row| base.json(row).to_string().len()).sum();
    assert!(!seabearing_base::view::text(&base).is_empty());
    Outcome { taken: shown > 0, ..Outcome::default() }
}

fn station_files() -> Result<Vec<Vec<u8>>> {
    Ok([
        include_str!("../../scenarios/demo-station.toml"),
        include_str!("../../scenarios/ocean-bottom-station.toml"),
        include_str!("../../scenarios/tetrahedron.toml"),
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec())
}

fn station_file(input: &[u8], _: &[Vec<u8>]) -> Outcome {
    let Ok(text) = std::str::from_utf8(input) else { return Outcome::default() };
    let taken = match Station::parse(text, "station.toml", Path::new("/nowhere")) {
        Ok(_) => true,
        Err(e) => {
            let said = format!("{e:#}");
            assert!(!said.is_empty() && !said.contains('\n'), "{said}");
            // Which of the values is refused is as good as taking them.
            said.contains("line")
        }
    };
    Outcome { taken, ..Outcome::default() }
}

/// The file of a store with one recorder's session.
fn stores() -> Result<Vec<Vec<u8>>> {
    let folder = Folder::new()?;
    let mut base = Base::new(None);
    let mut store = Store::open(folder.path(), &mut base)?;
    let began = Event::Began(Beginning { line: "file:x".into(), ..Beginning::default() });
    for event in [began].into_iter().chain(streams()?.into_iter().map(Event::Bytes)) {
        let entry = [Entry { stream: 1, received_us: Some(1_790_000_000_000_000), event }];
        store.keep(&entry)?;
        let mut rows = Vec::new();
        entry[0].tell(&mut base, 0, None, &mut rows);
        store.derive(&mut base, &rows)?;
    }
    drop(store);
    Ok(vec![std::fs::read(folder.path().join("store.sqlite"))?])
}

fn store(input: &[u8], _: &[Vec<u8>]) -> Outcome {
    let Ok(folder) = Folder::new() else { return Outcome::default() };
    if std::fs::write(folder.path().join("store.sqlite"), input).is_err() {
        return Outcome::default();
    }
    let mut records = 0;
    let _ = read(folder.path(), &Wanted::default(), |_| records += 1);
    let _ = check(folder.path());
    let mut base = Base::new(None);
    if let Ok(mut store) = Store::open(folder.path(), &mut base) {
        let event = Event::Began(Beginning::default());
        let _ = store.keep(&[Entry { stream: store.next_stream(), received_us: None, event }]);
        let _ = store.derive(&mut base, &[]);
    }
    Outcome { taken: records > 0, ..Outcome::default() }
}
