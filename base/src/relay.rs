//! Records of other base stations, as a broker hands them on: at least once, so that what has come already is known by its
//! number in the store it comes from.
//!
//! A record on its way ([`Relayed`]) is what a store keeps of it. A base station that takes it keeps it as it came
//! ([`Event::Relayed`](super::store::Event)) and makes the same record of it: its UTC, its session and its number in a link's
//! log are those of the base station that heard it.

use super::Base;
use super::record::{Body, Row, index};
use super::recorder::{Recorder, Session};
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Runs of numbers kept of a log; in what lies between the oldest of more than these nothing comes again.
const RUNS: usize = 100_000;

/// Kinds of records that cannot be read are told of at most so often.
const UNREAD: usize = 1000;

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

/// Which numbers of a log have come: runs of them, the first of each and the last.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Seen {
    pub(crate) runs: BTreeMap<u64, u64>,
    /// First numbers of runs that have changed, or are no more, since they were last stored.
    pub(crate) changed: BTreeSet<u64>,
}

impl Seen {
    /// Takes a number; false if it has come before.
    pub(crate) fn take(&mut self, number: u64) -> bool {
        let before = self.runs.range(..=number).next_back().map(|(first, last)| (*first, *last));
        if before.is_some_and(|(_, last)| number <= last) {
            return false;
        }
        // Below the oldest run only where the beginning was left out, or is forgotten.
        let joined = before.filter(|(_, last)| last + 1 == number);
        let first = joined.map_or(number, |(first, _)| first);
        let after = number.checked_add(1).and_then(|next| self.runs.remove(&next).map(|last| (next, last)));
        self.changed.extend(after.map(|(next, _)| next));
        self.runs.insert(first, after.map_or(number, |(_, last)| last));
        self.changed.insert(first);
        if self.runs.len() > RUNS {
            self.join_oldest();
        }
        true
    }

    fn join_oldest(&mut self) {
        let mut oldest = self.runs.iter().map(|(first, last)| (*first, *last));
        let (Some((first, _)), Some((second, last))) = (oldest.next(), oldest.next()) else { return };
        self.runs.remove(&second);
        self.runs.insert(first, last);
        self.changed.extend([first, second]);
    }

    /// Numbers between the first and the last that have not come.
    fn missing(&self) -> u64 {
        let span = self.runs.first_key_value().zip(self.runs.last_key_value());
        let between = span.map_or(0, |((first, _), (_, last))| last - first);
        // All that have come but one, so that no sum is greater than the greatest number.
        let come = self.runs.iter().map(|(first, last)| last - first).sum::<u64>();
        between - come - (self.runs.len() as u64).saturating_sub(1)
    }
}

/// What is known of the stores that records come from.
#[derive(Debug, Default)]
pub(crate) struct Sources {
    pub(crate) seen: BTreeMap<u64, Seen>,
    /// The session here of a log's station and session.
    pub(crate) sessions: BTreeMap<(u64, Option<u16>, u32), u32>,
    /// Those of which a store has to note the session.
    pub(crate) changed: BTreeSet<(u64, Option<u16>, u32)>,
    /// Logs and kinds of records of them that cannot be read, as a base station of a later version has: told once each.
    unread: BTreeSet<(u64, u8)>,
    taken: u64,
    again: u64,
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
}

impl Sources {
    /// What has changed is in the store.
    pub(crate) fn stored(&mut self) {
        self.changed.clear();
        self.seen.values_mut().for_each(|seen| seen.changed.clear());
    }

    /// Two logs may count the sessions of one station, and it may be heard here, too: one whose number is taken gets the
    /// next that is free.
    fn session(&mut self, of: (u64, Option<u16>, u32), recorder: Option<&Recorder>) -> u32 {
        if let Some(here) = self.sessions.get(&of) {
            return *here;
        }
        let (.., session) = of;
        let taken = recorder.is_some_and(|r| r.sessions.contains_key(&session));
        let newest = recorder.and_then(Recorder::session).unwrap_or(0);
        let here = if taken { newest.saturating_add(1) } else { session };
        self.sessions.insert(of, here);
        self.changed.insert(of);
        here
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
            if !self.sources.seen.entry(record.log).or_default().take(record.number) {
                self.sources.again += 1;
                continue;
            }
            match Row::body(record.kind, &record.body) {
                Ok(Body::Said(said)) if OWN.iter().any(|kind| said["type"] == *kind) => {}
                Ok(body) => out.push(self.take_relayed(&record, body)),
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

    fn take_relayed(&mut self, record: &Relayed, body: Body) -> Row {
        self.sources.taken += 1;
        self.over_links.records += 1;
        let most = super::KEPT / self.recorders.len().max(1);
        let of = |session| (record.log, record.station, session);
        let heard = self.recorders.get(&record.station);
        let own = record.session.map(|session| self.sources.session(of(session), heard));
        let Relayed { station, sequence, utc, received_us, .. } = *record;
        let mut row = Row { station, session: own, sequence, utc, received_us, body };
        let (Some(session), Body::Message(message)) = (own, &row.body) else { return row };
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
        row
    }

    /// What has come of other base stations.
    pub fn relay_counters(&self) -> RelayCounters {
        let Sources { taken, again, seen, .. } = &self.sources;
        let missing = seen.values().map(Seen::missing).fold(0, u64::saturating_add);
        RelayCounters { taken: *taken, again: *again, missing, logs: seen.len() as u64 }
    }
}

#[cfg(test)]
mod tests;
