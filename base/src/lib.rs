//! The base station: telemetry bytes of any number of recorders in, records, counters, the latest state of each out.
//!
//! [`Base`] is a function of what it is given and of when that came: replaying what a store kept gives the same records
//! again. A connection is a [`stream`](Beginning); who speaks on it is known from the stations file, or once the recorder
//! says so, and what is known of a [`Recorder`] outlives its connections. Damage costs the frames it hits and is counted.

pub mod command;
mod counters;
pub mod export;
pub mod feed;
pub mod fusion;
pub mod line;
pub mod origin;
pub mod record;
pub mod recorder;
pub mod relay;
pub mod service;
pub mod stations;
pub mod store;
mod stream;
pub mod utc;
pub mod view;
pub mod waiting;

use seabearing_host::{atomic, plot};

pub use counters::Counters;
use record::{Body, Row};
pub use recorder::{Recorder, TrackKey};
use seabearing_core::wire::link::{self, Loss, Settings};
use seabearing_core::wire::{FaultCode, Message};
use seabearing_host::station::Calibrations;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use stream::{Came, Logs, Stream, foreign};

/// Bearings, and reports of tracks, kept of all recorders for pictures and maps.
const KEPT: usize = 100_000;
/// Bits a second of a line of which nothing else was said.
pub const LINE_BAUD: u32 = 115_200;
/// Names of the classes of records.
const CLASSES: [&str; 5] = ["alarm", "final", "health", "bearing", "spectrum"];
/// Bytes without a single whole frame after which a connection is closed.
const NOISE: u64 = 1 << 20;
/// Time in which bytes of a connection that another has taken over from may still be on their way, microseconds.
const GRACE_US: i64 = 2_000_000;

/// A connection that begins.
#[derive(Clone, Debug, Default)]
pub struct Beginning {
    /// What it came over, as `listen:0.0.0.0:4500`.
    pub line: String,
    /// Who called, where the line takes calls.
    pub peer: Option<String>,
    /// The station that the line belongs to, where that was said.
    pub station: Option<u16>,
    /// The line goes up and down, and that is told in records; a file does not.
    pub lasting: bool,
}

/// What is known of a connection.
struct Live {
    beginning: Beginning,
    stream: Stream,
    who: Option<u16>,
    /// Session of frames without a link.
    session: Option<u32>,
    up: bool,
    silent: bool,
    asked: bool,
    /// A newer connection of the same recorder has taken over: when, and which.
    replaced: Option<(i64, u32)>,
    /// It is to be closed.
    closing: bool,
}

/// What is known of a connection of which not all was decoded.
#[derive(Clone, Copy, Debug, Default)]
struct Halfway {
    who: Option<u16>,
    session: Option<u32>,
    up: bool,
    silent: bool,
    replaced: Option<(i64, u32)>,
    /// Number of the newest frame.
    newest: Option<u16>,
    log: Option<link::Session>,
}

/// A base station's knowledge.
#[derive(Default)]
pub struct Base {
    streams: BTreeMap<u32, Live>,
    /// By number of the station; without one those that have not said theirs.
    recorders: BTreeMap<Option<u16>, Recorder>,
    logs: Logs,
    changed_logs: BTreeSet<(u16, u32)>,
    /// Streams of which a store has to note who speaks.
    changed_streams: BTreeSet<u32>,
    /// Of connections that have ended.
    past: Counters,
    over_links: Counters,
    rate_hz: Option<f64>,
    said: Option<i64>,
    /// Classes of which records are left with the recorders.
    borrows: [bool; link::CLASSES],
    /// Counter of the newest signed command.
    counter: u64,
    warnings: Vec<String>,
    /// Reports of network tracks.
    networks: VecDeque<Row>,
    /// Other base stations whose records come here.
    sources: relay::Sources,
    /// What levels are of.
    calibrations: Calibrations,
}

impl Base {
    /// Nothing heard yet. `rate_hz` is used until a recorder tells its own; without a rate records carry no time.
    pub fn new(rate_hz: Option<f64>) -> Self {
        Self { rate_hz, ..Self::default() }
    }

    /// From now on records of these classes are read, and left with recorders that have a link: for whoever keeps them.
    pub fn borrow_records(&mut self, of: [bool; link::CLASSES]) {
        self.borrows = of;
    }

    /// UTC of sample 0 in the session of whatever is heard next, microseconds since 1970. A recorder that starts again
    /// begins another session.
    pub fn say_start(&mut self, start_us: Option<i64>) {
        self.said = start_us;
    }

    /// UTC of sample 0 of one station, as the stations file says: of the session that is heard next, unless it was said of
    /// one before.
    pub fn say_start_of(&mut self, station: u16, start_us: i64) {
        let recorder = self.recorder(Some(station));
        if recorder.sessions.values().all(|s| s.start_us != Some(start_us)) {
            recorder.said = Some(start_us);
        }
    }

    /// A connection begins. `line`: it is spoken over, to recorders with a link, which speak first.
    pub fn begin(&mut self, stream: u32, beginning: Beginning, line: Option<Settings>) {
        let who = beginning.station;
        let session = who.and_then(|who| self.recorder(Some(who)).plain);
        let mut connection = Stream::new(line);
        connection.link().withhold(self.borrows);
        let live = Live {
            beginning,
            stream: connection,
            who,
            session,
            up: false,
            silent: false,
            asked: false,
            replaced: None,
            closing: false,
        };
        self.streams.insert(stream, live);
    }

    /// Asks the recorder at the other end who it is.
    pub fn identify(&mut self, stream: u32) {
        if let Some(live) = self.streams.get_mut(&stream) {
            (live.stream.ask, live.asked) = (true, true);
        }
    }

    /// The next bytes for the recorder, if any are due. What was pushed before counts as received: it must be where it
    /// survives.
    pub fn answer(&mut self, stream: u32, now_us: u64) -> Option<&[u8]> {
        let live = self.streams.get_mut(&stream).filter(|l| l.replaced.is_none())?;
        live.stream.answer(now_us)
    }

    /// Takes bytes that came at `received_us` (since 1970); the records they completed are appended to `out`. `now_us` is
    /// any clock, and only decides when they are acknowledged.
    pub fn push(
        &mut self,
        stream: u32,
        now_us: u64,
        received_us: Option<i64>,
        bytes: &[u8],
        out: &mut Vec<Row>,
    ) {
        let Some(live) = self.streams.get_mut(&stream) else { return };
        if live.replaced.is_some() {
            self.past.bytes += bytes.len() as u64;
            self.doubled(stream, received_us, out);
            return;
        }
        if std::mem::take(&mut live.silent) {
            let row = self.line_row(stream, "up", None, received_us);
            out.extend(row);
        }
        let Some(live) = self.streams.get_mut(&stream) else { return };
        let mut came = Vec::new();
        live.stream.push(now_us, bytes, &mut self.logs, &mut |c| came.push(c));
        if live.stream.noise > NOISE
            && live.beginning.peer.is_some()
            && !std::mem::replace(&mut live.closing, true)
        {
            let who = live.beginning.peer.clone().unwrap_or_default();
            self.warnings.push(format!(
                "{who}: no telemetry frame in {NOISE} bytes: not a recorder; its connection is closed"
            ));
        }
        self.changed_logs.extend(live.stream.log());
        self.changed_streams.insert(stream);
        for came in came {
            self.took(stream, received_us, came, out);
        }
    }

    fn took(&mut self, stream: u32, received_us: Option<i64>, came: Came, out: &mut Vec<Row>) {
        let who = self.streams.get(&stream).and_then(|l| l.who);
        let (session, sequence, message) = match came {
            Came::Opened(station) => return self.heard_from(stream, station, received_us, out),
            Came::Plain { sequence, message, first } => {
                let said = if let Message::Hello(hello) = &message { Some(hello.station) } else { who };
                if let Some(station) = said {
                    self.heard_from(stream, station, received_us, out);
                }
                (self.plain_session(stream, first), sequence.into(), message)
            }
            Came::Record { ordinal, boot, message } => {
                self.over_links.records += 1;
                let Some(message) = message else { return };
                (self.recorder(who).session_of(boot), ordinal, message)
            }
            Came::Lost(loss) => {
                self.over_links.records_lost += u64::from(loss.count);
                return out.push(self.lost(who, &loss, received_us));
            }
            Came::Missed(frames) => {
                return out.push(self.said_row(
                    who,
                    received_us,
                    json!({ "type": "lost", "frames": frames }),
                ));
            }
        };
        let who = self.streams.get(&stream).and_then(|l| l.who);
        if let Message::Hello(hello) = &message
            && let Some(warning) = foreign(hello)
            && self.recorder(who).hello.is_none_or(|h| h.schema_hash != hello.schema_hash)
        {
            self.warnings.push(match who {
                Some(who) => format!("station {who}: {warning}"),
                None => warning,
            });
        }
        let (said, most) = (self.said.take(), KEPT / self.recorders.len().max(1));
        let recorder = self.recorder(who);
        recorder.said = said.or(recorder.said);
        let mut of = recorder.told_late(session, &message);
        if matches!(&message, Message::Fault(fault) if fault.code == FaultCode::Restarted) {
            of = recorder.restarted(session);
        }
        out.push(recorder.take(of, sequence, &message, received_us, most));
        if of > session
            && let Some(live) = self.streams.get_mut(&stream)
            && live.session == Some(session)
        {
            live.session = Some(of);
        }
    }

    /// The session of a frame without a link.
    fn plain_session(&mut self, stream: u32, first: bool) -> u32 {
        let Some(live) = self.streams.get(&stream) else { return 0 };
        let (who, known) = (live.who, live.session.filter(|_| !first));
        let session = known.unwrap_or_else(|| {
            let recorder = self.recorder(who);
            let session = recorder.begin(None);
            recorder.plain = Some(session);
            session
        });
        if let Some(live) = self.streams.get_mut(&stream) {
            live.session = Some(session);
            // Joined in mid-stream: who is it?
            if who.is_none() && live.beginning.lasting && !std::mem::replace(&mut live.asked, true) {
                live.stream.ask = true;
            }
        }
        session
    }

    /// A station has said its number, or its own line speaks.
    fn heard_from(&mut self, stream: u32, station: u16, received_us: Option<i64>, out: &mut Vec<Row>) {
        let plain = self.recorder(Some(station)).plain;
        let Some(live) = self.streams.get_mut(&stream) else { return };
        if live.up && live.who == Some(station) {
            return;
        }
        if live.who != Some(station) {
            live.session = plain;
            if let Some(expected) = live.beginning.station {
                self.warnings.push(format!(
                    "{}: station {station} speaks where station {expected} was expected",
                    live.beginning.line
                ));
            }
        }
        (live.who, live.up) = (Some(station), true);
        if !live.beginning.lasting {
            return;
        }
        for (other, live) in &mut self.streams {
            if *other != stream && live.beginning.lasting && live.who == Some(station) && live.up {
                live.replaced.get_or_insert((received_us.unwrap_or(0), stream));
                self.changed_streams.insert(*other);
            }
        }
        out.extend(self.line_row(stream, "up", None, received_us));
    }

    /// Bytes of a connection that another has taken over from: two recorders have one number.
    fn doubled(&mut self, stream: u32, received_us: Option<i64>, out: &mut Vec<Row>) {
        let name = |live: &Live| live.beginning.peer.clone().unwrap_or_else(|| live.beginning.line.clone());
        let Some(live) = self.streams.get(&stream) else { return };
        let Some((at, by)) = live.replaced.filter(|(at, _)| received_us.is_some_and(|us| us - at > GRACE_US))
        else {
            return;
        };
        let (who, first, closing) = (live.who, name(live), live.closing);
        let Some(second) = self.streams.get(&by).map(name).filter(|_| !closing && at > 0) else { return };
        let text = format!(
            "two recorders say at once that they are station {}: {first} and {second}; the newer connection is heard, \
             give one of them another number",
            who.unwrap_or(0)
        );
        out.push(self.said_row(
            who,
            received_us,
            json!({ "type": "warning", "code": "TwoOfOneNumber", "text": text }),
        ));
        self.warnings.push(text);
        if let Some(live) = self.streams.get_mut(&stream) {
            live.closing = true;
        }
    }

    /// The record of a loss.
    fn lost(&self, who: Option<u16>, loss: &Loss, received_us: Option<i64>) -> Row {
        let cause = match loss.told {
            told if told >= loss.count => "the recorder's store was full",
            0 => "somebody else has acknowledged them to the recorder",
            _ => "the recorder's store was full, and somebody else has acknowledged some to it",
        };
        let body = json!({
            "type": "lost", "frames": loss.count, "class": CLASSES[loss.class as usize],
            "cause": cause, "dropped_by_recorder": loss.told,
        });
        self.said_row(who, received_us, body)
    }

    /// Something that was found beside all connections, of a station. What says itself of when it was true (`utc`) is dated
    /// so.
    pub fn note(&mut self, station: Option<u16>, what: Value, received_us: Option<i64>, out: &mut Vec<Row>) {
        let true_us = record::us_of(&what["utc"]);
        let mut row = self.said_row(station, received_us, what);
        row.utc = true_us.map_or(row.utc, |us| Some((us, None)));
        if matches!(&row.body, Body::Said(said) if said["type"] == "network_track") {
            self.networks.push_back(row.clone());
            if self.networks.len() > KEPT {
                self.networks.pop_front();
            }
        }
        out.push(row);
    }

    /// A record of what the base station notes itself.
    fn said_row(&self, station: Option<u16>, received_us: Option<i64>, body: Value) -> Row {
        let session = self.recorders.get(&station).and_then(Recorder::session);
        let utc = received_us.map(|us| (us, None));
        Row { origin: None, station, session, sequence: None, utc, received_us, body: Body::Said(body) }
    }

    /// The record of a line's state, where the line has one.
    fn line_row(&self, stream: u32, state: &str, why: Option<&str>, received_us: Option<i64>) -> Option<Row> {
        let live = self.streams.get(&stream).filter(|l| l.beginning.lasting)?;
        let Beginning { line, peer, .. } = &live.beginning;
        let mut body = json!({ "type": "line", "state": state, "line": line, "peer": peer });
        if let Some(why) = why {
            body["cause"] = why.into();
        }
        Some(self.said_row(live.who, received_us, body))
    }

    /// Nothing has come over a connection for long.
    pub fn silent(&mut self, stream: u32, received_us: Option<i64>, out: &mut Vec<Row>) {
        if let Some(live) = self.streams.get_mut(&stream)
            && !std::mem::replace(&mut live.silent, true)
        {
            self.changed_streams.insert(stream);
            out.extend(self.line_row(stream, "silent", None, received_us));
        }
    }

    /// A connection has ended, or could not be made: bytes of an unfinished frame are damage.
    pub fn end(&mut self, stream: u32, why: Option<&str>, received_us: Option<i64>, out: &mut Vec<Row>) {
        let row = self.line_row(stream, "down", why, received_us);
        let Some(mut live) = self.streams.remove(&stream) else { return };
        live.stream.cut();
        self.past.add(&live.stream);
        // Who called and was no recorder is no line that has gone down.
        if live.who.is_some() || live.beginning.peer.is_none() {
            out.extend(row.filter(|_| live.replaced.is_none()));
        }
    }

    /// Connections that are to be closed: they bring noise, or another recorder has their number.
    pub fn closing(&self) -> impl Iterator<Item = u32> {
        self.streams.iter().filter(|(_, live)| live.closing).map(|(stream, _)| *stream)
    }

    /// Connections over which a recorder has opened its link, and who it is.
    pub(crate) fn linked(&self) -> Vec<(u32, link::Session)> {
        let heard = self.streams.iter().filter(|(_, live)| live.replaced.is_none());
        heard.filter_map(|(stream, live)| Some((*stream, live.stream.peer()?))).collect()
    }

    /// Whether the recorder of this session of a link has said when its samples were.
    pub(crate) fn is_dated(&self, session: &link::Session) -> bool {
        let recorder = self.recorders.get(&Some(session.station));
        let newest = recorder.and_then(|r| r.sessions.values().rev().find(|s| s.boot == Some(session.boot)));
        newest.is_some_and(recorder::Session::is_dated)
    }

    /// A connection goes on of which some was heard before this program began.
    fn take_up(&mut self, stream: u32, known: &Halfway) {
        let log = known.log.and_then(|s| Some((s, *self.logs.get(&(s.station, s.log))?)));
        if let Some(live) = self.streams.get_mut(&stream) {
            (live.who, live.session, live.up, live.asked) = (known.who, known.session, known.up, true);
            (live.silent, live.replaced) = (known.silent, known.replaced);
            live.stream.resume(known.newest, log);
        }
    }

    /// What a store has to know of a connection to go on with it.
    fn halfway(&mut self, stream: u32) -> Option<Halfway> {
        let live = self.streams.get_mut(&stream)?;
        Some(Halfway {
            who: live.who,
            session: live.session,
            up: live.up,
            silent: live.silent,
            replaced: live.replaced,
            newest: live.stream.newest(),
            log: live.stream.peer(),
        })
    }

    /// Says when a session's sample 0 was.
    fn date(&mut self, station: Option<u16>, session: u32, start_us: i64) {
        let recorder = self.recorder(station);
        if let Some(known) = recorder.sessions.get_mut(&session) {
            known.start_us = Some(start_us);
            recorder.changed.insert(session);
            recorder.dated.insert(session);
        }
    }

    /// The same where sessions were not told apart by station, because there was one.
    fn date_earlier(&mut self, session: u32, start_us: i64) {
        for station in self.recorders.keys().copied().collect::<Vec<_>>() {
            self.date(station, session, start_us);
        }
    }

    /// Nothing is to be stored.
    pub(crate) fn forget_changes(&mut self) {
        self.stored();
    }

    /// What has changed is in the store.
    fn stored(&mut self) {
        for recorder in self.recorders.values_mut() {
            recorder.changed.clear();
            recorder.dated.clear();
        }
        self.changed_logs.clear();
        self.changed_streams.clear();
        self.sources.stored();
    }

    /// What a person should know; each is told once.
    pub fn warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    /// Counters so far.
    pub fn counters(&self) -> Counters {
        let mut sum = Counters {
            records: self.over_links.records,
            records_lost: self.over_links.records_lost,
            ..self.past
        };
        self.streams.values().for_each(|live| sum.add(&live.stream));
        sum
    }

    /// The recorders heard of, by the number of their station.
    pub fn recorders(&self) -> impl Iterator<Item = &Recorder> {
        self.recorders.values().filter(|r| r.session().is_some())
    }

    /// The connections open now: their stream and their recorder.
    pub fn streams(&self) -> impl Iterator<Item = (u32, Option<u16>)> {
        self.streams.iter().map(|(stream, live)| (*stream, live.who))
    }

    /// The recorder of a station.
    fn recorder(&mut self, station: Option<u16>) -> &mut Recorder {
        let rate_hz = self.rate_hz;
        let new = || Recorder { station, rate_hz, ..Recorder::default() };
        self.recorders.entry(station).or_insert_with(new)
    }

    /// Samples a second of a record's session.
    pub(crate) fn rate_of(&self, row: &Row) -> Option<f64> {
        row.session.and_then(|s| self.recorders.get(&row.station)?.rate_hz(s))
    }

    /// Levels are told with these from now on; a store keeps them as they come.
    pub fn calibrate(&mut self, calibrations: Calibrations) {
        self.calibrations = calibrations;
    }

    /// A record as JSON.
    pub fn json(&self, row: &Row) -> Value {
        let mut record = row.json(self.rate_of(row));
        self.calibrations.apply(&mut record);
        record
    }

    /// The reports of the tracks kept, as records, in order; those of network tracks last.
    pub fn track_records(&self) -> Vec<Value> {
        let of_stations = self.recorders.values().flat_map(|r| r.tracks.values().flatten());
        of_stations.chain(&self.networks).map(|row| self.json(row)).collect()
    }
}

#[cfg(test)]
mod tests;
