//! What takes input from outside, each as a function of bytes, and inputs that are right: for mutation here, and for the
//! guided fuzzer (`fuzz/`).

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
use std::cell::Cell;
use std::collections::HashSet;
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
    /// The same where files and programs are named.
    pub file: &'static str,
    /// How many inputs of the fastest target one of this costs.
    pub cost: usize,
    /// Inputs that are right.
    pub seeds: fn() -> Result<Vec<Vec<u8>>>,
    /// Takes an input made of the seeds.
    pub run: fn(&[u8], &Seeds) -> Outcome,
}

/// Decoder and link.
pub const LINK: Target =
    Target { name: "decoder and link", file: "link", cost: 1, seeds: streams, run: link };
/// The sample line of a recorder whose converter is another computer.
pub const SAMPLE_LINE: Target =
    Target { name: "sample line", file: "sample_line", cost: 1, seeds: sample_lines, run: samples };
/// The base station's knowledge.
pub const BASE_STATION: Target =
    Target { name: "base station", file: "base_station", cost: 4, seeds: streams, run: base };
/// Messages whose frames have the right checksum: decoder, link, sample line, base station.
pub const MESSAGES: Target = Target {
    name: "messages behind the checksum",
    file: "messages",
    cost: 4,
    seeds: message_lists,
    run: behind_the_checksum,
};
/// Station files.
pub const STATION_FILE: Target =
    Target { name: "station file", file: "station_file", cost: 2, seeds: station_files, run: station_file };
/// The store: its file opened, read, checked, written to.
pub const STORE: Target = Target { name: "store", file: "store", cost: 400, seeds: stores, run: store };
/// All of them.
pub const TARGETS: [Target; 6] = [LINK, SAMPLE_LINE, BASE_STATION, MESSAGES, STATION_FILE, STORE];

/// Inputs that are right, and every frame in them.
#[derive(Clone, Debug, Default)]
pub struct Seeds {
    /// The inputs.
    pub inputs: Vec<Vec<u8>>,
    frames: HashSet<Box<[u8]>>,
}

impl Seeds {
    /// Those of a target.
    ///
    /// # Errors
    /// They cannot be made.
    pub fn of(target: &Target) -> Result<Self> {
        let inputs = (target.seeds)()?;
        let frames = inputs.iter().flat_map(|seed| seed.split(|b| *b == 0)).map(Box::from).collect();
        Ok(Self { inputs, frames })
    }

    /// Whether bytes between delimiters are a frame that stands in a seed as it is.
    fn hold(&self, frame: &[u8]) -> bool {
        self.frames.contains(frame)
    }
}

/// Streams captured of every version of the wire format.
const GOLDEN: [&[u8]; 2] =
    [include_bytes!("../../tests/golden/plain-1.bin"), include_bytes!("../../tests/golden/link-1.bin")];
/// Frames of a captured stream that make one seed.
const TOGETHER: usize = 8;

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

/// Frames of a recorder without a link, and of a link both ways; the captured streams in pieces.
fn streams() -> Result<Vec<Vec<u8>>> {
    let mut all = said()?;
    for stream in GOLDEN {
        let frames: Vec<&[u8]> = stream.split_inclusive(|b| *b == 0).collect();
        all.extend(frames.chunks(TOGETHER).map(<[_]>::concat));
    }
    Ok(all)
}

fn said() -> Result<Vec<Vec<u8>>> {
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

fn link(input: &[u8], seeds: &Seeds) -> Outcome {
    let settings = Settings::serial(115_200);
    let mut recorder = Link::new(settings, 7, 3, 9, MemoryStore::<1000>::new());
    let mut base = Link::new(Settings { leads: false, ..settings }, 0, 1, 0, MemoryStore::<1000>::new());
    recorder.offer(Class::Alarm, b"one");
    base.offer(Class::Health, b"two");
    let mut decoder = Decoder::default();
    let (mut outcome, mut begin) = (Outcome::default(), 0);
    for (at, byte) in input.iter().enumerate() {
        let now = at as u64 * 100;
        if decoder.push_frame(*byte).is_some() {
            outcome.taken = true;
            outcome.false_frames += u64::from(!seeds.hold(&input[begin..at]));
        }
        if *byte == 0 {
            begin = at + 1;
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

/// Bytes of a line, and how many were taken.
struct Line<'a>(&'a [u8], &'a Cell<usize>);

impl ByteSource for Line<'_> {
    fn next(&mut self) -> Came {
        let at = self.1.get();
        self.1.set(at + 1);
        self.0.get(at).map_or(Came::Closed, |b| Came::Byte(*b))
    }
}

fn samples(input: &[u8], seeds: &Seeds) -> Outcome {
    let taken = Cell::new(0);
    let mut reader = sample_line::Reader::new(Line(input, &taken));
    let mut frames = [[0; 4]; PACKET_FRAMES];
    let mut outcome = Outcome::default();
    while let Chunk::Frames { count, .. } = reader.read(&mut frames) {
        outcome.taken = true;
        assert!(count <= PACKET_FRAMES);
    }
    // What stands behind the frame that ends the line is not read.
    let read = &input[..taken.get().min(input.len())];
    let frames = read.split_inclusive(|b| *b == 0).filter_map(|f| f.strip_suffix(&[0]));
    let frames = frames.filter(|f| !f.is_empty() && seeds.hold(f)).count() as u64;
    outcome.false_frames = reader.counters().frames.saturating_sub(frames);
    outcome
}

fn base(input: &[u8], _: &Seeds) -> Outcome {
    let mut base = Base::new(None);
    base.begin(1, Beginning { lasting: true, ..Beginning::default() }, Some(Settings::serial(9600)));
    let mut rows = Vec::new();
    for (n, bytes) in input.chunks(50).enumerate() {
        base.push(1, n as u64 * 1000, Some(1_790_000_000_000_000), bytes, &mut rows);
        base.answer(1, n as u64 * 1000);
    }
    base.end(1, None, None, &mut rows);
    let shown: usize = rows.iter().map(|row| base.json(row).to_string().len()).sum();
    assert!(shown > 0 && !seabearing_base::view::text(&base).is_empty());
    Outcome { taken: base.counters().stream.frames > 0, ..Outcome::default() }
}

/// The messages of all streams, each behind its length.
fn message_lists() -> Result<Vec<Vec<u8>>> {
    let list = |stream: Vec<u8>| {
        let mut decoder = Decoder::default();
        let mut list = Vec::new();
        for byte in stream {
            if decoder.push_frame(byte).is_some() {
                list.push(decoder.message().len() as u8);
                list.extend_from_slice(decoder.message());
            }
        }
        list
    };
    Ok(streams()?.into_iter().chain(sample_lines()?).map(list).collect())
}

/// Everything that reads frames, with messages that no checksum keeps away.
fn behind_the_checksum(input: &[u8], _: &Seeds) -> Outcome {
    let (mut encoder, mut stream, mut rest) = (Encoder::default(), Vec::new(), input);
    while let Some((length, after)) = rest.split_first() {
        let (message, after) = after.split_at(usize::from(*length).min(after.len()));
        stream.extend_from_slice(encoder.frame_of(message));
        rest = after;
    }
    let unknown = Seeds::default();
    link(&stream, &unknown);
    samples(&stream, &unknown);
    base(&stream, &unknown)
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

fn station_file(input: &[u8], _: &Seeds) -> Outcome {
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
    for event in [began].into_iter().chain(said()?.into_iter().map(Event::Bytes)) {
        let entry = [Entry { stream: 1, received_us: Some(1_790_000_000_000_000), event }];
        store.keep(&entry)?;
        let mut rows = Vec::new();
        entry[0].tell(&mut base, 0, None, &mut rows);
        store.derive(&mut base, &rows)?;
    }
    drop(store);
    Ok(vec![std::fs::read(folder.path().join("store.sqlite"))?])
}

fn store(input: &[u8], _: &Seeds) -> Outcome {
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
