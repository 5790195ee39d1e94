//! The base station: telemetry bytes in, records, counters, the latest state of a recorder and its tracks out.
//!
//! [`Base`] is a function of the bytes it is given and of where streams began: replaying stored bytes gives the same
//! records again, which is how [`store`] resumes after anything. Damage costs the frames it hits and is counted.

pub mod export;
pub mod link;
pub mod store;
pub mod view;

use seabearing_host::{atomic, plot};

use seabearing_core::wire::{
    Bearing, Decoder, DecoderCounters, Fault, Health, Hello, Message, SCHEMA_HASH, Track, WIRE_VERSION,
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
}

impl std::fmt::Display for Counters {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let DecoderCounters { frames, lost, damaged, unknown, bytes_discarded, .. } = self.stream;
        write!(
            f,
            "{frames} frames, {lost} lost, {damaged} damaged, {unknown} unknown; {} bytes, {bytes_discarded} discarded",
            self.bytes
        )
    }
}

/// Identifies a track: the recorder numbers its tracks afresh in every session.
pub type TrackKey = (u32, u16);

/// A base station's knowledge of one recorder.
pub struct Base {
    decoder: Decoder,
    recorder: RecordFormat,
    /// But for the stream's, which the decoder has.
    counters: Counters,
    hello: Option<Hello>,
    health: Option<Health>,
    tracks: BTreeMap<TrackKey, Vec<Track>>,
    bearings: VecDeque<(u32, Bearing)>,
    faults: VecDeque<Fault>,
    ended: bool,
    warnings: Vec<String>,
}

impl Base {
    /// Nothing heard yet. `rate_hz` and `start` are used until a `Hello` tells the rate; without either, records
    /// carry no time.
    pub fn new(rate_hz: Option<f64>, start: Option<time::OffsetDateTime>) -> Self {
        Self {
            decoder: Decoder::default(),
            recorder: RecordFormat { rate_hz: rate_hz.unwrap_or(f64::NAN), start },
            counters: Counters::default(),
            hello: None,
            health: None,
            tracks: BTreeMap::new(),
            bearings: VecDeque::new(),
            faults: VecDeque::new(),
            ended: false,
            warnings: Vec::new(),
        }
    }

    /// The bytes that mark the beginning of a stream in storage: a delimiter ends whatever was cut off before.
    pub const BEGIN: [u8; 1] = [0];

    /// Takes bytes; the records of the messages they completed are appended to `out`.
    pub fn push(&mut self, bytes: &[u8], out: &mut Vec<Value>) {
        self.counters.bytes += bytes.len() as u64;
        for byte in bytes {
            let (before, newest) = (self.decoder.counters(), self.decoder.newest());
            let Some(received) = self.decoder.push::<Message>(*byte) else { continue };
            // The first frame of a recorder that has started, unless zero is the next number anyway.
            let is_first = matches!(received.message, Message::Hello(_)) && received.sequence == 0;
            if is_first && newest != Some(u16::MAX) {
                self.decoder.begin_again(0, before);
                self.counters.sessions += 1;
            }
            self.take(received.sequence, &received.message, out);
        }
    }

    /// The stream has ended for good: bytes of an unfinished frame are damage.
    pub fn end_stream(&mut self) {
        self.decoder.cut();
    }

    fn take(&mut self, sequence: u16, message: &Message, out: &mut Vec<Value>) {
        // A stream joined in the middle belongs to a session, too.
        self.counters.sessions = self.counters.sessions.max(1);
        let session = self.counters.sessions;
        self.ended = matches!(message, Message::End(_));
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
            | Message::Reply(_)
            | Message::End(_) => {}
        }
        let mut record = self.recorder.json(message);
        if let Value::Object(map) = &mut record {
            // Where the record came from; `process` has no such keys.
            let station = self.hello.map(|h| h.station);
            map.entry("station").or_insert_with(|| station.into());
            map.insert("session".into(), session.into());
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
        Counters { stream: self.decoder.counters(), ..self.counters }
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
