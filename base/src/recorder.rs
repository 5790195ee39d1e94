//! What a base station knows of one recorder: its sessions with their clocks, its latest state, its tracks.

use super::record::{Body, Row, index};
use seabearing_core::utc::Times;
use seabearing_core::wire::{Bearing, Fault, FaultCode, Health, Hello, Message, Track};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Faults kept for the view.
const FAULTS: usize = 8;
/// Sessions whose clocks are kept at hand; records of older ones are dated no more.
pub(crate) const SESSIONS: usize = 1000;
/// Times beyond this, of year 9889, are none, microseconds.
const CALENDAR_US: u64 = 250_000_000_000_000_000;

/// One session: from a start of the recorder, or of its sample index, to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Session {
    /// The recorder's own count of its starts, where it has a link.
    pub boot: Option<u32>,
    /// Samples a second.
    pub rate_hz: Option<f64>,
    /// UTC of sample 0 as a person said it, microseconds since 1970.
    pub start_us: Option<i64>,
    /// What the recorder says of UTC.
    pub times: Times,
    /// Its clock has stepped at this sample, and it has not said since when a sample was.
    pub stepped: Option<u64>,
}

impl Session {
    /// UTC of a sample, microseconds since 1970, and its standard deviation in seconds where it is known.
    pub fn utc(&self, index: u64) -> Option<(i64, Option<f64>)> {
        let rate_hz = self.rate_hz.filter(|r| *r > 0.0)?;
        let told = match self.times.utc(index, rate_hz) {
            Some((us, sd_s)) => (us, Some(sd_s)),
            None => (self.start_us?.saturating_add((index as f64 / rate_hz * 1e6) as i64), None),
        };
        // An index may be any number, and gives a time that no calendar has.
        Some(told).filter(|(us, _)| us.unsigned_abs() < CALENDAR_US)
    }

    /// Takes what a message says of the clock; true if it is the first that dates the session.
    pub fn note(&mut self, message: &Message) -> bool {
        let dated = self.is_dated();
        match message {
            Message::Time(time) => {
                let rate_hz = self.rate_hz.unwrap_or_default();
                // Records come class by class after a gap of the line: a step is told before older lines are.
                let stepped = self.stepped.take_if(|at| *at <= time.index).is_some();
                self.times.note(*time, stepped, rate_hz);
            }
            Message::Fault(fault) if fault.code == FaultCode::ClockStepped => {
                self.stepped = Some(fault.index)
            }
            Message::Hello(hello) if hello.rate_hz > 0.0 => self.rate_hz = Some(hello.rate_hz.into()),
            _ => {}
        }
        !dated && self.is_dated()
    }

    /// Whether the recorder has said when a sample was.
    pub(crate) fn is_dated(&self) -> bool {
        self.times != Times::default()
    }
}

/// Identifies a track: the recorder numbers its tracks afresh in every session.
pub type TrackKey = (u32, u16);

/// A base station's knowledge of one recorder.
#[derive(Clone, Debug, Default)]
pub struct Recorder {
    /// Its number, once it is known.
    pub station: Option<u16>,
    pub(crate) sessions: BTreeMap<u32, Session>,
    /// Sessions that have changed since they were last stored.
    pub(crate) changed: BTreeSet<u32>,
    /// Sessions that can be dated as of now, and could not before.
    pub(crate) dated: BTreeSet<u32>,
    /// The newest session of a recorder without a link.
    pub(crate) plain: Option<u32>,
    /// Samples a second until the recorder tells it.
    pub(crate) rate_hz: Option<f64>,
    /// UTC of sample 0 in the session that is heard next.
    pub(crate) said: Option<i64>,
    pub(crate) faults_in_all: u64,
    pub(crate) records: u64,
    pub(crate) hello: Option<Hello>,
    pub(crate) health: Option<Health>,
    pub(crate) tracks: BTreeMap<TrackKey, Vec<Row>>,
    pub(crate) reports: usize,
    pub(crate) bearings: VecDeque<(u32, Bearing)>,
    pub(crate) faults: VecDeque<Fault>,
    pub(crate) ended: bool,
    /// When it was heard last, microseconds since 1970, by the clock of the base station.
    pub heard_us: Option<i64>,
}

impl Recorder {
    /// Begins a session.
    pub(crate) fn begin(&mut self, boot: Option<u32>) -> u32 {
        let session = self.sessions.last_key_value().map_or(1, |(n, _)| n + 1);
        let rate_hz = self.sessions.last_key_value().and_then(|(_, s)| s.rate_hz).or(self.rate_hz);
        self.sessions
            .insert(session, Session { boot, rate_hz, start_us: self.said.take(), ..Session::default() });
        self.forget_oldest();
        self.changed.insert(session);
        session
    }

    /// The session of a boot; records of earlier boots may come later.
    pub(crate) fn session_of(&mut self, boot: u32) -> u32 {
        let known = self.sessions.iter().rev().find(|(_, s)| s.boot == Some(boot)).map(|(n, _)| *n);
        known.unwrap_or_else(|| self.begin(Some(boot)))
    }

    /// The sample index of a session has started again: what follows has another line of UTC, not yet known.
    pub(crate) fn restarted(&mut self, session: u32) -> u32 {
        let boot = self.sessions.get(&session).and_then(|s| s.boot);
        let new = self.begin(boot);
        if self.plain == Some(session) {
            self.plain = Some(new);
        }
        new
    }

    /// The session of a message that came in this one: a restart is told before the last records of the passages it ended.
    pub(crate) fn told_late(&self, session: u32, message: &Message) -> u32 {
        let Message::Track(track) = message else { return session };
        let boot = |session: u32| self.sessions.get(&session).map(|s| s.boot);
        let before = session.saturating_sub(1);
        let ended = track.stage != Track::RUNNING
            && !self.tracks.contains_key(&(session, track.id))
            && self.tracks.contains_key(&(before, track.id))
            && boot(before) == boot(session);
        if ended { before } else { session }
    }

    /// Takes a message; gives its record. `most`: bearings and reports of tracks to be kept for pictures and maps.
    pub(crate) fn take(
        &mut self,
        session: u32,
        sequence: u32,
        message: &Message,
        received_us: Option<i64>,
        most: usize,
    ) -> Row {
        let said = self.said.take();
        let known = self.sessions.entry(session).or_default();
        known.start_us = said.or(known.start_us);
        let rate_hz = known.rate_hz;
        let first = known.note(message);
        if said.is_some() || known.rate_hz != rate_hz {
            self.changed.insert(session);
        }
        if first || said.is_some() || known.rate_hz != rate_hz {
            self.dated.insert(session);
        }
        let row = Row {
            origin: None,
            station: self.station,
            session: Some(session),
            sequence: Some(sequence),
            utc: index(message).and_then(|index| known.utc(index)),
            received_us,
            body: Body::Message(*message),
        };
        self.know(session, &row, most);
        row
    }

    /// Takes a record of a session into what is known now.
    pub(crate) fn know(&mut self, session: u32, row: &Row, most: usize) {
        let Body::Message(message) = &row.body else { return };
        self.records += 1;
        self.heard_us = row.received_us.or(self.heard_us);
        self.ended = matches!(message, Message::End(_));
        match message {
            Message::Hello(hello) => self.hello = Some(*hello),
            Message::Health(health) => self.health = Some(*health),
            Message::Track(_) => self.keep_track(row.clone(), most),
            Message::Bearing(bearing) => {
                self.bearings.push_back((session, *bearing));
                while self.bearings.len() > most {
                    self.bearings.pop_front();
                }
            }
            Message::Fault(fault) => {
                self.faults_in_all += 1;
                self.faults.push_back(*fault);
                if self.faults.len() > FAULTS {
                    self.faults.pop_front();
                }
            }
            Message::FaultsHeld(held) => self.faults_in_all += u64::from(held.count),
            _ => {}
        }
    }

    /// Sessions beyond those whose clocks are kept at hand are forgotten.
    pub(crate) fn forget_oldest(&mut self) {
        if self.sessions.len() > SESSIONS {
            self.sessions.pop_first();
        }
    }

    /// Keeps the report of a track; the oldest tracks are forgotten first.
    pub(crate) fn keep_track(&mut self, row: Row, most: usize) {
        let (Some(session), Some(id)) = (row.session, row.track()) else { return };
        self.tracks.entry((session, id)).or_default().push(row);
        self.reports += 1;
        while self.reports > most && self.tracks.len() > 1 {
            self.reports -= self.tracks.pop_first().map_or(0, |(_, reports)| reports.len());
        }
    }

    /// Samples a second in a session.
    pub fn rate_hz(&self, session: u32) -> Option<f64> {
        self.sessions.get(&session).and_then(|s| s.rate_hz)
    }

    /// UTC of a sample of a session, microseconds since 1970, where its clock is known.
    pub fn utc_us(&self, session: u32, index: u64) -> Option<i64> {
        Some(self.sessions.get(&session)?.utc(index)?.0)
    }

    /// The newest session, if one was heard.
    pub fn session(&self) -> Option<u32> {
        self.sessions.last_key_value().map(|(n, _)| *n)
    }

    /// Who speaks, once it said so.
    pub fn hello(&self) -> Option<&Hello> {
        self.hello.as_ref()
    }

    /// The latest health report.
    pub fn health(&self) -> Option<&Health> {
        self.health.as_ref()
    }

    /// The reports of every track kept, in order.
    pub fn tracks(
        &self,
    ) -> impl DoubleEndedIterator<Item = (&TrackKey, impl DoubleEndedIterator<Item = &Track>)> {
        self.tracks.iter().map(|(key, rows)| {
            let of = rows.iter().filter_map(|row| match &row.body {
                Body::Message(Message::Track(track)) => Some(track),
                _ => None,
            });
            (key, of)
        })
    }

    /// The bearings kept, with their session.
    pub fn bearings(&self) -> impl DoubleEndedIterator<Item = &(u32, Bearing)> + ExactSizeIterator {
        self.bearings.iter()
    }

    /// The last faults.
    pub fn faults(&self) -> impl Iterator<Item = &Fault> {
        self.faults.iter()
    }

    /// Faults heard of.
    pub fn faults_in_all(&self) -> u64 {
        self.faults_in_all
    }

    /// Whether the last thing heard was the recorder's end.
    pub fn ended(&self) -> bool {
        self.ended
    }
}
