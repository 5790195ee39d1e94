//! Records of other base stations, as a broker hands them on: at least once, so that what has come already is known by its
//! number in the store it comes from, and by its [`Origin`] where that has it from another: by whatever way it comes, it is taken
//! once, and records cannot go round.
//!
//! A record on its way ([`Relayed`]) is what a store keeps of it. A base station that takes it keeps it as it came
//! ([`Event::Relayed`](super::store::Event)) and makes the same record of it: its UTC, its session and its number in a link's
//! log are those of the base station that heard it.

use super::Base;
use super::record::{Body, Origin, Row, index};
use super::recorder::{Recorder, Session};
use anyhow::{Context, Result};
use seen::{Known, LOGS, Taken};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Kinds of records that cannot be read are told of at most so often.
const UNREAD: usize = 1000;

/// Sessions of other base stations' stations; of further ones nothing is taken.
const SESSIONS: usize = 200_000;

/// What a base station finds by its own fusion and its own alarms: it is not taken from others, whose numbers are others'.
const OWN: [&str; 2] = ["network_track", "alarm"];

/// A record of another base station.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Relayed {
    /// The store that it comes from, of which every record has a number of its own.
    pub log: u64,
    /// Its number there, from 1.
    pub number: u64,
    /// Station, session and sequence as there.
    pub station: Option<u16>,
    /// See [`Row::session`].
    pub session: Option<u32>,
    /// See [`Row::sequence`].
    pub sequence: Option<u32>,
    /// See [`Row::utc`].
    pub utc: Option<(i64, Option<f64>)>,
    /// When that base station received it, microseconds since 1970.
    pub received_us: Option<i64>,
    /// Samples a second of its session.
    pub rate_hz: Option<f64>,
    /// Number of the kind, and the body, as [`Row::stored`] gives them.
    pub kind: u8,
    /// See `kind`.
    pub body: Vec<u8>,
}

impl Relayed {
    /// A record of a store, by its number there.
    pub fn of(row: &Row, log: u64, number: u64, rate_hz: Option<f64>) -> Self {
        let (kind, body) = row.stored();
        let Row { station, session, sequence, utc, received_us, .. } = *row;
        Self { log, number, station, session, sequence, utc, received_us, rate_hz, kind, body }
    }

    /// Where it was made first.
    pub fn origin(&self) -> Origin {
        let from = Row::body(self.kind, &self.body).ok().and_then(|(_, origin)| origin);
        from.unwrap_or(Origin { log: self.log, number: self.number })
    }
}

/// Records as bytes.
///
/// # Errors
/// There is no memory for them.
pub fn packed(records: &[Relayed]) -> Result<Vec<u8>> {
    postcard::to_stdvec(records).context("records cannot be packed")
}

/// The same back.
fn unpacked(bytes: &[u8]) -> Result<Vec<Relayed>> {
    postcard::from_bytes(bytes).context("records of another base station are damaged")
}

/// What is known of the stores that records come from.
#[derive(Debug, Default)]
pub(crate) struct Sources {
    seen: Known,
    /// Origins that have come by way of other base stations.
    onward: Known,
    /// The session here of a log's station and session.
    pub(crate) sessions: BTreeMap<(u64, Option<u16>, u32), u32>,
    /// Those of which a store has to note the session.
    pub(crate) changed: BTreeSet<(u64, Option<u16>, u32)>,
    /// Logs and kinds of records of them that cannot be read, as a base station of a later version has: told once each.
    unread: BTreeSet<(u64, u8)>,
    taken: u64,
    again: u64,
    refused: u64,
}

/// What has come of other base stations since this one began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RelayCounters {
    /// Records taken.
    pub taken: u64,
    /// Records that had come before.
    pub again: u64,
    /// Records that lie between others and have not come: others of the group have them, or a broker has dropped them.
    pub missing: u64,
    /// Stores that they come from.
    pub logs: u64,
    /// Records that were not taken, because they name more stores or sessions than fit.
    pub refused: u64,
}

impl Sources {
    /// What has changed is in the store.
    pub(crate) fn stored(&mut self) {
        self.changed.clear();
        self.seen.stored();
        self.onward.stored();
    }

    /// The numbers that have come, with the names of their tables.
    pub(crate) fn seen(&self) -> [(&'static str, &Known); 2] {
        [("relayed", &self.seen), ("relayed_onward", &self.onward)]
    }

    /// The same, to be changed.
    pub(crate) fn seen_mut(&mut self) -> [(&'static str, &mut Known); 2] {
        [("relayed", &mut self.seen), ("relayed_onward", &mut self.onward)]
    }

    /// Takes note of a record that has come by way of another base station, or straight; whether it is new.
    fn note(&mut self, origin: Origin, straight: bool) -> Taken {
        let Origin { log, number } = origin;
        match straight {
            true if self.onward.has(log, number) => Taken::Again,
            true => Taken::New,
            false if self.seen.has(log, number) => Taken::Again,
            false => self.onward.take(log, number),
        }
    }

    /// Two logs may count the sessions of one station, and it may be heard here, too: one whose number is taken gets the
    /// next that is free.
    fn session(&mut self, of: (u64, Option<u16>, u32), recorder: Option<&Recorder>) -> Option<u32> {
        if let Some(here) = self.sessions.get(&of) {
            return Some(*here);
        }
        if self.sessions.len() >= SESSIONS {
            return None;
        }
        let (.., session) = of;
        let taken = recorder.is_some_and(|r| r.sessions.contains_key(&session));
        let newest = recorder.and_then(Recorder::session).unwrap_or(0);
        let here = if taken { newest.saturating_add(1) } else { session };
        self.sessions.insert(of, here);
        self.changed.insert(of);
        Some(here)
    }
}

impl Base {
    /// Takes records of other base stations, as [`packed`] gives them; those that are new are appended to `out`.
    pub(crate) fn relayed(&mut self, bytes: &[u8], out: &mut Vec<Row>) {
        let records = match unpacked(bytes) {
            Ok(records) => records,
            Err(e) => return self.warnings.push(format!("{e:#}; they are left out")),
        };
        for record in records {
            match self.sources.seen.take(record.log, record.number) {
                Taken::New => {}
                taken => {
                    self.left_out(taken);
                    continue;
                }
            }
            match Row::body(record.kind, &record.body) {
                Ok((Body::Said(said), _)) if OWN.iter().any(|kind| said["type"] == *kind) => {}
                Ok((body, from)) => {
                    let straight = Origin { log: record.log, number: record.number };
                    let origin = from.unwrap_or(straight);
                    match self.sources.note(origin, origin == straight) {
                        Taken::New => match self.take_relayed(&record, origin, body) {
                            Some(row) => out.push(row),
                            None => self.left_out(Taken::Refused),
                        },
                        taken => self.left_out(taken),
                    }
                }
                Err(e) => {
                    let (log, number) = (record.log, record.number);
                    if self.sources.unread.len() < UNREAD && self.sources.unread.insert((log, record.kind)) {
                        self.warnings.push(format!(
                            "record {number} of base station {log:016x}: {e:#}; it is left out, and others like it"
                        ));
                    }
                }
            }
        }
    }

    fn left_out(&mut self, taken: Taken) {
        match taken {
            Taken::Refused => {
                self.sources.refused += 1;
                if self.sources.refused == 1 {
                    self.warnings.push(format!(
                        "records of more than {LOGS} base stations or {SESSIONS} sessions have come: those of further ones are left out"
                    ));
                }
            }
            _ => self.sources.again += 1,
        }
    }

    /// None where its session is one too many.
    fn take_relayed(&mut self, record: &Relayed, origin: Origin, body: Body) -> Option<Row> {
        let most = super::KEPT / self.recorders.len().max(1);
        let of = |session| (record.log, record.station, session);
        let heard = self.recorders.get(&record.station);
        let own = match record.session {
            Some(session) => Some(self.sources.session(of(session), heard)?),
            None => None,
        };
        self.sources.taken += 1;
        self.over_links.records += 1;
        let Relayed { station, sequence, utc, received_us, .. } = *record;
        let mut row = Row { origin: Some(origin), station, session: own, sequence, utc, received_us, body };
        let (Some(session), Body::Message(message)) = (own, &row.body) else { return Some(row) };
        let recorder = self.recorder(station);
        let new = !recorder.sessions.contains_key(&session);
        let known: &mut Session = recorder.sessions.entry(session).or_default();
        let rate_hz = record.rate_hz.or(known.rate_hz);
        let (told, changed) = (known.note(message), known.rate_hz != rate_hz);
        known.rate_hz = rate_hz;
        row.utc = row.utc.or_else(|| index(message).and_then(|index| known.utc(index)));
        if new || changed {
            recorder.changed.insert(session);
        }
        if told {
            recorder.dated.insert(session);
        }
        recorder.forget_oldest();
        recorder.know(session, &row, most);
        Some(row)
    }

    /// What has come of other base stations.
    pub fn relay_counters(&self) -> RelayCounters {
        let Sources { taken, again, refused, seen, .. } = &self.sources;
        let (missing, logs) = (seen.missing(), seen.len() as u64);
        RelayCounters { taken: *taken, again: *again, missing, logs, refused: *refused }
    }
}

mod seen;
#[cfg(test)]
mod tests;
