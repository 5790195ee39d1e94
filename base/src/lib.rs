//! The base station: telemetry bytes in, records, counters, the latest state of a recorder and its tracks out.
//!
//! [`Base`] is a function of the bytes it is given and of where streams began: replaying stored bytes gives the same
//! records again, which is how [`store`] resumes after anything. Damage costs the frames it hits and is counted.

pub mod about;
pub mod command;
pub mod export;
pub mod link;
pub mod store;
pub mod view;

use seabearing_host::{atomic, plot};

use seabearing_core::utc::Times;
use seabearing_core::wire::link::{Arrival, Inbox, Link, Loss, MemoryStore, Progress, Session, Settings};
use seabearing_core::wire::{
    Bearing, DecoderCounters, Fault, FaultCode, Health, Hello, Message, SCHEMA_HASH, Track, WIRE_VERSION,
    message_of,
};
use seabearing_host::record::RecordFormat;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};

/// Bearings kept for pictures: a day and more at two a second.
const BEARINGS: usize = 200_000;
/// Tracks kept, the oldest are forgotten first.
const TRACKS: usize = 1000;
/// Faults kept for the view.
const FAULTS: usize = 8;
/// Bits a second of a line of which nothing else was said.
pub const LINE_BAUD: u32 = 115_200;
/// Names of the classes of records.
const CLASSES: [&str; 5] = ["alarm", "final", "health", "bearing", "spectrum"];

/// The base station's side of a line: it answers.
fn settings(line: Settings) -> Settings {
    Settings { leads: false, ..line }
}

/// What was received and what was not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Bytes received.
    pub bytes: u64,
    /// Frames decoded, lost (within sessions) and damaged, as the decoder counts them.
    pub stream: DecoderCounters,
    /// Sessions: starts of the recorder heard, the first included.
    pub sessions: u32,
    /// Faults reported by the recorder.
    pub faults: u64,
    /// Records that came over a link, each once.
    pub records: u64,
    /// Records that a recorder's full store dropped before they could come.
    pub records_lost: u64,
}

impl std::fmt::Display for Counters {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let DecoderCounters { frames, lost, damaged, unknown, bytes_discarded, .. } = self.stream;
        // Over a link what is lost comes again.
        let lost = match self.records + self.records_lost {
            0 => format!("{lost} lost"),
            _ => format!("{lost} sent again, {} records, {} lost for good", self.records, self.records_lost),
        };
        write!(
            f,
            "{frames} frames, {lost}, {damaged} damaged, {unknown} unknown; {} bytes, {bytes_discarded} discarded",
            self.bytes
        )
    }
}

/// Bytes of commands that wait for their recorder.
const COMMAND_BYTES: usize = 1024;

/// Where the link leaves what comes, until the base takes it.
#[derive(Default)]
struct Desk {
    /// What came in one frame: a message with its place, or a loss.
    came: Vec<Came>,
    /// Of each log by station and boot.
    progress: BTreeMap<(u16, u32), Progress>,
}

enum Came {
    Message { sequence: u32, boot: Option<u32>, message: Option<Message> },
    Lost(Loss),
}

impl Inbox for Desk {
    fn recall(&mut self, session: &Session) -> Option<Progress> {
        self.progress.get(&(session.station, session.log)).copied()
    }

    fn take(&mut self, arrival: Arrival<'_>) {
        self.came.push(match arrival {
            Arrival::Opened(_) => return,
            Arrival::Lost(loss) => Came::Lost(loss),
            Arrival::Record(record) => Came::Message {
                sequence: record.ordinal,
                boot: Some(record.boot),
                message: message_of(record.bytes),
            },
            Arrival::Plain { sequence, message } => {
                Came::Message { sequence: sequence.into(), boot: None, message: message_of(message) }
            }
        });
    }
}

/// Identifies a track: the recorder numbers its tracks afresh in every session.
pub type TrackKey = (u32, u16);

/// A base station's knowledge of one recorder.
pub struct Base {
    link: Link<MemoryStore<COMMAND_BYTES>>,
    /// Counter of the newest signed command.
    counter: u64,
    desk: Desk,
    /// Sessions of recorders with a link, by station and boot.
    boots: BTreeMap<(u16, u32), u32>,
    recorder: RecordFormat,
    /// But for the stream's, which the decoder has.
    counters: Counters,
    hello: Option<Hello>,
    health: Option<Health>,
    tracks: BTreeMap<TrackKey, Vec<Track>>,
    bearings: VecDeque<(u32, Bearing)>,
    faults: VecDeque<Fault>,
    ended: bool,
    /// What the recorder says of UTC, by session; whether its clock has stepped since it last said when a sample was.
    times: BTreeMap<u32, (Times, bool)>,
    /// UTC of sample 0 as a person said it, by session; and of the session that is heard next.
    starts: BTreeMap<u32, time::OffsetDateTime>,
    said: Option<time::OffsetDateTime>,
    warnings: Vec<String>,
}

impl Base {
    /// Nothing heard yet. `rate_hz` is used until a `Hello` tells it; `start` is UTC of sample 0 in the session heard first.
    /// Without a rate records carry no time.
    pub fn new(rate_hz: Option<f64>, start: Option<time::OffsetDateTime>) -> Self {
        Self {
            link: Link::new(settings(Settings::serial(LINE_BAUD)), 0, 0, 0, MemoryStore::new()),
            counter: 0,
            desk: Desk::default(),
            boots: BTreeMap::new(),
            recorder: RecordFormat {
                rate_hz: rate_hz.unwrap_or(f64::NAN),
                start: None,
                times: Times::default(),
            },
            counters: Counters::default(),
            hello: None,
            health: None,
            tracks: BTreeMap::new(),
            bearings: VecDeque::new(),
            faults: VecDeque::new(),
            ended: false,
            times: BTreeMap::new(),
            starts: BTreeMap::new(),
            said: start,
            warnings: Vec::new(),
        }
    }

    /// UTC of sample 0 in sessions that are yet to be heard, or heard again from stored bytes.
    pub fn set_starts(&mut self, starts: BTreeMap<u32, time::OffsetDateTime>) {
        self.starts = starts;
    }

    /// UTC of sample 0 by session, as far as it was said.
    pub fn starts(&self) -> &BTreeMap<u32, time::OffsetDateTime> {
        &self.starts
    }

    /// UTC of sample 0 in the session of whatever is heard next. A recorder that starts again begins another.
    pub fn say_start(&mut self, start: Option<time::OffsetDateTime>) {
        self.said = start;
    }

    /// The bytes that mark the beginning of a stream in storage: a delimiter ends whatever was cut off before.
    pub const BEGIN: [u8; 1] = [0];

    /// Speaks over this line from now on: only to recorders with a link, which speak first.
    pub fn line(&mut self, line: Settings) {
        // A log of commands lives as long as this program.
        let boot = time::OffsetDateTime::now_utc().unix_timestamp() as u32;
        self.link.begin(settings(line), boot);
    }

    /// A stream begins: an unfinished frame of the one before is damage, and the recorder may be another.
    pub fn begin_stream(&mut self) {
        self.link.reconnected();
    }

    /// The next bytes for the recorder, if any are due. What was pushed before counts as received: it must be where it
    /// survives.
    pub fn answer(&mut self, now_us: u64) -> Option<&[u8]> {
        self.link.send(now_us)
    }

    /// Takes bytes that were stored; the records of the messages they completed are appended to `out`.
    pub fn push(&mut self, bytes: &[u8], out: &mut Vec<Value>) {
        self.push_at(0, bytes, out);
    }

    /// Takes bytes at a time in microseconds, which only decides when they are acknowledged.
    pub fn push_at(&mut self, now_us: u64, bytes: &[u8], out: &mut Vec<Value>) {
        self.counters.bytes += bytes.len() as u64;
        for byte in bytes {
            let (before, newest) = (self.link.line(), self.link.decoder().newest());
            self.link.receive(now_us, *byte, &mut self.desk);
            let mut came = std::mem::take(&mut self.desk.came);
            for came in came.drain(..) {
                match came {
                    Came::Message { sequence, boot: None, message: Some(message) } => {
                        // The first frame of a recorder that has started, unless zero is the next number anyway.
                        let is_first = matches!(message, Message::Hello(_)) && sequence == 0;
                        if is_first && newest != Some(u16::MAX) {
                            self.link.decoder().begin_again(0, before);
                            self.counters.sessions += 1;
                        }
                        // A stream joined in the middle belongs to a session, too.
                        self.counters.sessions = self.counters.sessions.max(1);
                        self.take(self.counters.sessions, sequence, &message, out);
                    }
                    Came::Message { boot: None, message: None, .. } => self.link.decoder().unknown(),
                    Came::Message { sequence, boot: Some(boot), message } => {
                        let session = self.session_of(boot);
                        self.counters.records += 1;
                        match message {
                            Some(message) => self.take(session, sequence, &message, out),
                            None => self.counters.stream.unknown += 1,
                        }
                    }
                    Came::Lost(loss) => out.push(self.lost(&loss)),
                }
            }
            // The vector is kept, not made for every byte.
            self.desk.came = came;
        }
        if let Some((session, progress)) = self.link.peer() {
            self.desk.progress.insert((session.station, session.log), progress);
        }
    }

    /// The session of a boot of the recorder that speaks; records of earlier boots may come later.
    fn session_of(&mut self, boot: u32) -> u32 {
        let station = self.link.peer().map_or(0, |(session, _)| session.station);
        *self.boots.entry((station, boot)).or_insert_with(|| {
            self.counters.sessions += 1;
            self.counters.sessions
        })
    }

    /// The record of a loss, and its count.
    fn lost(&mut self, loss: &Loss) -> Value {
        self.counters.records_lost += u64::from(loss.count);
        let station = self.link.peer().map(|(session, _)| session.station);
        serde_json::json!({
            "type": "lost", "station": station, "frames": loss.count, "class": CLASSES[loss.class as usize],
            "cause": "the recorder's store was full", "dropped_by_recorder": loss.told,
        })
    }

    /// The stream has ended for good: bytes of an unfinished frame are damage.
    pub fn end_stream(&mut self) {
        self.link.decoder().cut();
    }

    fn take(&mut self, session: u32, sequence: u32, message: &Message, out: &mut Vec<Value>) {
        self.ended = matches!(message, Message::End(_));
        let (times, stepped) = self.times.entry(session).or_default();
        match message {
            Message::Time(time) => times.note(*time, std::mem::take(stepped)),
            Message::Fault(fault) => *stepped |= fault.code == FaultCode::ClockStepped,
            _ => {}
        }
        self.recorder.times = *times;
        self.starts.extend(self.said.take().map(|start| (session, start)));
        self.recorder.start = self.starts.get(&session).copied();
        match message {
            Message::Hello(hello) => self.greet(hello),
            Message::Health(health) => self.health = Some(*health),
            Message::Track(track) => {
                self.tracks.entry((session, track.id)).or_default().push(*track);
                if self.tracks.len() > TRACKS {
                    self.tracks.pop_first();
                }
            }
            Message::Bearing(bearing) => {
                self.bearings.push_back((session, *bearing));
                if self.bearings.len() > BEARINGS {
                    self.bearings.pop_front();
                }
            }
            Message::Fault(fault) => {
                self.counters.faults += 1;
                self.faults.push_back(*fault);
                if self.faults.len() > FAULTS {
                    self.faults.pop_front();
                }
            }
            Message::FaultsHeld(held) => self.counters.faults += u64::from(held.count),
            Message::Azimuth(_)
            | Message::Range(_)
            | Message::Segment(_)
            | Message::ShaftRate(_)
            | Message::Time(_)
            | Message::Reply(_)
            | Message::End(_) => {}
        }
        let mut record = self.record(session, message);
        if let Value::Object(map) = &mut record {
            map.insert("sequence".into(), sequence.into());
        }
        out.push(record);
    }

    fn greet(&mut self, hello: &Hello) {
        if hello.rate_hz > 0.0 {
            self.recorder.rate_hz = f64::from(hello.rate_hz);
        }
        if hello.wire_version != WIRE_VERSION {
            self.warnings.push(format!(
                "the recorder speaks wire version {}, this base station {WIRE_VERSION}: numbers may be misread",
                hello.wire_version
            ));
        } else if hello.schema_hash != SCHEMA_HASH {
            self.warnings.push(format!(
                "the recorder's message schema is {:016x}, this base station's {SCHEMA_HASH:016x}: messages it \
                 does not know are counted as unknown",
                hello.schema_hash
            ));
        }
        self.hello = Some(*hello);
    }

    /// What a person should know about the stream; each is told once.
    pub fn warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    /// Counters so far.
    pub fn counters(&self) -> Counters {
        let unknown = self.counters.stream.unknown;
        let line = self.link.line();
        Counters { stream: DecoderCounters { unknown: line.unknown + unknown, ..line }, ..self.counters }
    }

    /// Who speaks, once it said so.
    pub fn hello(&self) -> Option<&Hello> {
        self.hello.as_ref()
    }

    /// The latest health report.
    pub fn health(&self) -> Option<&Health> {
        self.health.as_ref()
    }

    /// All reports of every track, in order.
    pub fn tracks(&self) -> &BTreeMap<TrackKey, Vec<Track>> {
        &self.tracks
    }

    /// The reports of every track as records, in order.
    pub fn track_records(&self) -> Vec<Value> {
        let of_track = |(session, _): &TrackKey, history: &[Track]| {
            let record = |t: &Track| self.record(*session, &Message::Track(*t));
            history.iter().map(record).collect::<Vec<_>>()
        };
        self.tracks.iter().flat_map(|(key, history)| of_track(key, history)).collect()
    }

    /// A message as a record that tells where it came from; `process` has no such keys.
    fn record(&self, session: u32, message: &Message) -> Value {
        let times = self.times.get(&session).map_or_else(Times::default, |(times, _)| *times);
        let start = self.starts.get(&session).copied();
        let mut record = RecordFormat { start, times, ..self.recorder }.json(message);
        if let Value::Object(map) = &mut record {
            let station = self.hello.map(|h| h.station);
            map.entry("station").or_insert_with(|| station.into());
            map.insert("session".into(), session.into());
        }
        record
    }

    /// The bearings kept, with their session.
    pub fn bearings(&self) -> impl DoubleEndedIterator<Item = &(u32, Bearing)> + ExactSizeIterator {
        self.bearings.iter()
    }

    /// The last faults.
    pub fn faults(&self) -> impl Iterator<Item = &Fault> {
        self.faults.iter()
    }

    /// Whether the last thing heard was the recorder's end.
    pub fn ended(&self) -> bool {
        self.ended
    }

    /// Sample rate and start used for times.
    pub fn clock(&self) -> &RecordFormat {
        &self.recorder
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::wire::{Encoder, End, Reply};

    use seabearing_core::wire::link::Class;

    /// A recorder with a link and a base station with a store that is opened anew every second; of the bytes of the
    /// recorder every seventh is damaged for a while.
    #[test]
    fn over_a_link_every_record_is_stored_once_whatever_happens_to_line_and_base() {
        let line = Settings::serial(115_200);
        let folder = tempfile::tempdir().unwrap();
        let mut buffer = [0; 160];
        let mut recorder = Link::new(line, 7, 1, 0, MemoryStore::<6400>::new());
        let (mut at_us, mut said, mut told) = (0u64, 0u32, Vec::new());
        for second in 0..40u64 {
            let mut base = Base::new(None, None);
            let mut store = store::Store::open(folder.path(), &mut base).unwrap();
            base.line(line);
            if second == 20 {
                // Another boot; the store is what survives.
                recorder = Link::new(line, 7, 2, 0, recorder.into_store());
            }
            for _ in 0..if second < 30 { 4 } else { 0 } {
                let message = if said % 80 == 0 {
                    hello()
                } else {
                    Message::End(End { index: said.into(), frames: 0 })
                };
                recorder.offer(Class::of(&message), seabearing_core::wire::bytes_of(&message, &mut buffer));
                said += 1;
            }
            for ms in 0..1000u64 {
                at_us += 1000;
                let mut frame = recorder.send(at_us).unwrap_or(&[]).to_vec();
                if second < 25 && ms % 7 == 3 {
                    frame.iter_mut().for_each(|b| *b ^= 4);
                }
                let mut records = Vec::new();
                store.bytes(&frame).unwrap();
                base.push_at(at_us, &frame, &mut records);
                store.records(&records).unwrap();
                told.extend(records);
                while let Some(answer) = base.answer(at_us).map(<[u8]>::to_vec) {
                    store.hold().unwrap();
                    answer.iter().for_each(|b| recorder.receive(at_us, *b, &mut Desk::default()));
                }
            }
        }
        assert_eq!((recorder.waiting(), told.len() as u32), (0, said));
        let mut sequences: Vec<u64> = told.iter().map(|r| r["sequence"].as_u64().unwrap()).collect();
        sequences.sort_unstable();
        assert!(sequences.into_iter().eq(0..u64::from(said)));
        // What was stored says the same again, of two sessions.
        let mut base = Base::new(None, None);
        let store = store::Store::open(folder.path(), &mut base).unwrap();
        let counters = base.counters();
        assert_eq!((store.resumed() as u32, counters.records, counters.sessions), (said, said.into(), 2));
        let kept = std::fs::read_to_string(folder.path().join("records.jsonl")).unwrap();
        assert!(told.iter().map(|r| r.to_string()).eq(kept.lines().map(str::to_owned)));
        let second_boot = told.iter().filter(|r| r["session"] == 2).count();
        assert_eq!(second_boot as u32, said - 80);
    }

    fn hello() -> Message {
        Message::Hello(Hello {
            wire_version: WIRE_VERSION,
            schema_hash: SCHEMA_HASH,
            config_hash: 1,
            version: (0, 1, 0),
            station: 7,
            kind: 0,
            rate_hz: 1000.0,
            reset_cause: 1,
        })
    }

    fn session(n: u64) -> Vec<u8> {
        let mut encoder = Encoder::default();
        let mut bytes = encoder.frame(&hello()).to_vec();
        for i in 0..n {
            bytes.extend_from_slice(encoder.frame(&Message::End(End { index: i * 1000, frames: 0 })));
        }
        bytes
    }

    #[test]
    fn a_restart_is_a_new_session_and_not_65000_lost_frames() {
        let mut base = Base::new(None, None);
        let mut out = Vec::new();
        base.push(&session(3), &mut out);
        base.push(&session(2), &mut out);
        let c = base.counters();
        assert_eq!((c.stream.frames, c.stream.lost, c.sessions, out.len()), (7, 0, 2, 7));
        assert_eq!(out[2]["t_s"], 1.0);
        assert_eq!(
            (&out[5]["session"], &out[5]["sequence"], &out[5]["station"]),
            (&2.into(), &1.into(), &7.into())
        );
    }

    #[test]
    fn what_a_new_session_lacks_is_counted_and_what_comes_late_is_not() {
        let frames = |n: u64| -> Vec<Vec<u8>> {
            session(n).split_inclusive(|b| *b == 0).map(<[u8]>::to_vec).collect()
        };
        let mut base = Base::new(None, None);
        let first = frames(5);
        // The fourth frame comes after the fifth.
        for k in [0, 1, 2, 4, 3, 5] {
            base.push(&first[k], &mut Vec::new());
        }
        assert_eq!(base.counters().stream.lost, 0);
        let second = frames(4);
        for k in [0, 1, 4] {
            base.push(&second[k], &mut Vec::new());
        }
        let c = base.counters();
        assert_eq!((c.sessions, c.stream.lost, c.stream.repeated), (2, 2, 0));
    }

    #[test]
    fn a_stream_joined_in_the_middle_has_no_times_but_its_values() {
        let whole = session(3);
        let first = whole.iter().position(|b| *b == 0).unwrap() + 1;
        let mut out = Vec::new();
        let mut base = Base::new(None, None);
        base.push(&whole[first..], &mut out);
        assert_eq!((out.len(), base.counters().sessions, base.counters().stream.lost), (3, 1, 0));
        assert!(out[1]["t_s"].is_null());
        let mut base = Base::new(Some(500.0), None);
        base.push(&whole[first..], &mut out);
        assert_eq!(out[4]["t_s"], 2.0);
    }

    #[test]
    fn whatever_the_index_and_the_rate_a_known_start_does_no_harm() {
        let start = Some(time::macros::datetime!(2024-05-01 09:00 UTC));
        for rate_hz in [None, Some(50.0)] {
            let mut base = Base::new(rate_hz, start);
            let mut out = Vec::new();
            for index in [0, 1 << 62, u64::MAX] {
                base.push(Encoder::default().frame(&Message::End(End { index, frames: 0 })), &mut out);
            }
            assert_eq!(out.len(), 3);
            assert_eq!(out[0].get("utc").is_some(), rate_hz.is_some());
            assert!(out[2].get("utc").is_none());
        }
    }

    #[test]
    fn a_cut_frame_does_not_take_the_next_stream_s_first_with_it() {
        let mut base = Base::new(None, None);
        let mut out = Vec::new();
        let whole = session(2);
        base.push(&whole[..whole.len() - 3], &mut out);
        base.push(&Base::BEGIN, &mut out);
        base.push(&session(1), &mut out);
        assert_eq!((out.len(), base.counters().stream.damaged), (4, 1));
        base.push(&whole[..5], &mut out);
        base.end_stream();
        base.end_stream();
        assert_eq!((base.counters().stream.damaged, base.counters().bytes), (2, 2 * whole.len() as u64 - 9));
    }

    #[test]
    fn another_version_is_noticed() {
        let mut base = Base::new(None, None);
        let Message::Hello(h) = hello() else { unreachable!() };
        let mut encoder = Encoder::default();
        base.push(encoder.frame(&Message::Hello(Hello { wire_version: 9, ..h })), &mut Vec::new());
        base.push(encoder.frame(&Message::Reply(Reply { token: 0, status: 0 })), &mut Vec::new());
        assert!(base.warnings()[0].contains("wire version 9"));
        assert!(base.warnings().is_empty());
    }
}
