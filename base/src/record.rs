//! A record as the base station keeps it: what was said, by whom, when it was true and when it came.

use anyhow::{Context, Result};
use seabearing_core::utc::Times;
use seabearing_core::wire::{Message, bytes_of, message_of};
use seabearing_host::record::{RecordFormat, utc};
use serde_json::{Map, Value, json};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Kinds of what the base station says itself begin here; below are the numbers of the recorder's messages.
const SAID: u8 = 200;

/// What a record holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Body {
    /// A message of the recorder.
    Message(Message),
    /// What the base station notes itself: a loss, the state of a line, a warning; an object with its `type`.
    Said(Value),
}

/// The store in which a record was made first, by its log, and the record's number there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Origin {
    /// Number of the store.
    pub log: u64,
    /// Number of the record in it, from 1.
    pub number: u64,
}

/// Bytes behind a body that say its origin: a zero, which is in no JSON and ends every message's decoding, and both numbers.
const ORIGIN_BYTES: usize = 17;

impl Origin {
    fn bytes(self) -> [u8; ORIGIN_BYTES] {
        let mut out = [0; ORIGIN_BYTES];
        let numbers = self.log.to_le_bytes().into_iter().chain(self.number.to_le_bytes());
        out.iter_mut().skip(1).zip(numbers).for_each(|(to, from)| *to = from);
        out
    }

    /// What is before an origin, and the origin.
    fn split(bytes: &[u8]) -> Option<(&[u8], Self)> {
        let (body, [0, numbers @ ..]) = bytes.split_last_chunk::<ORIGIN_BYTES>()? else { return None };
        let (log, number) = numbers.split_first_chunk()?;
        Some((
            body,
            Self { log: u64::from_le_bytes(*log), number: u64::from_le_bytes(number.try_into().ok()?) },
        ))
    }
}

/// A record.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Where it was made, if it has come from another base station.
    pub origin: Option<Origin>,
    /// Number of the station, once it is known.
    pub station: Option<u16>,
    /// Session of that station.
    pub session: Option<u32>,
    /// Sequence number of its frame, or its place in the log of a link.
    pub sequence: Option<u32>,
    /// UTC in microseconds since 1970, and its standard deviation in seconds where that is known.
    pub utc: Option<(i64, Option<f64>)>,
    /// When it came, microseconds since 1970.
    pub received_us: Option<i64>,
    /// What it says.
    pub body: Body,
}

impl Row {
    /// The record for people and programs. `rate_hz`: samples a second of its session.
    pub fn json(&self, rate_hz: Option<f64>) -> Value {
        let rate_hz = rate_hz.unwrap_or(f64::NAN);
        let format = RecordFormat { rate_hz, start: None, times: Times::default() };
        let mut map = match &self.body {
            Body::Message(message) => match format.json(message) {
                Value::Object(map) => map,
                _ => Map::new(),
            },
            Body::Said(Value::Object(map)) => map.clone(),
            Body::Said(_) => Map::new(),
        };
        map.insert("utc".into(), self.utc.map_or(Value::Null, |(us, _)| rfc3339(us)));
        // What the time message itself says of its own deviation is the same thing.
        map.insert("sd_utc_s".into(), json!(self.utc.and_then(|(_, sd)| sd)));
        map.insert("received_utc".into(), self.received_us.map_or(Value::Null, rfc3339));
        map.insert("station".into(), json!(self.station));
        map.insert("session".into(), json!(self.session));
        if let Some(sequence) = self.sequence {
            map.insert("sequence".into(), sequence.into());
        }
        Value::Object(map)
    }

    /// The number of the kind, and the bytes in which the body is stored.
    pub fn stored(&self) -> (u8, Vec<u8>) {
        let (kind, mut bytes) = match &self.body {
            Body::Message(message) => {
                let mut buffer = [0; seabearing_core::wire::frame::MESSAGE_BYTES];
                let bytes = bytes_of(message, &mut buffer);
                (bytes.first().copied().unwrap_or(SAID - 1), bytes.to_vec())
            }
            Body::Said(value) => (SAID, value.to_string().into_bytes()),
        };
        bytes.extend(self.origin.into_iter().flat_map(Origin::bytes));
        (kind, bytes)
    }

    /// The body from what was stored, and where it was made if it has come from another base station.
    ///
    /// # Errors
    /// The bytes are no such body.
    pub fn body(kind: u8, bytes: &[u8]) -> Result<(Body, Option<Origin>)> {
        let alone = |bytes: &[u8]| {
            if kind < SAID {
                return message_of(bytes).map(Body::Message).context("a record is no message");
            }
            serde_json::from_slice(bytes).map(Body::Said).context("a record is no JSON")
        };
        match (alone(bytes), Origin::split(bytes)) {
            (Err(_), Some((body, origin))) => Ok((alone(body)?, Some(origin))),
            (body, _) => Ok((body?, None)),
        }
    }

    /// Sample index of the moment that the record is of, where it is of one.
    pub fn index(&self) -> Option<u64> {
        let Body::Message(message) = &self.body else { return None };
        index(message)
    }

    /// The track that it is of.
    pub fn track(&self) -> Option<u16> {
        match &self.body {
            Body::Message(Message::Track(track)) => Some(track.id),
            _ => None,
        }
    }
}

/// Sample index of the moment that a message is of, where it is of one.
pub fn index(message: &Message) -> Option<u64> {
    Some(match message {
        Message::Hello(_) | Message::Reply(_) => return None,
        Message::Bearing(m) => m.index,
        Message::Track(m) => m.index,
        Message::Health(m) => m.index,
        Message::Azimuth(m) => m.index,
        Message::Range(m) => m.index,
        Message::Segment(m) => m.end,
        Message::Fault(m) => m.index,
        Message::FaultsHeld(m) => m.index,
        Message::ShaftRate(m) => m.index,
        Message::Time(m) => m.index,
        Message::Snippet(m) => m.index,
        Message::Samples(m) => m.index,
        Message::Spectrum(m) => m.index,
        Message::Azigram(m) => m.index,
        Message::Margins(m) => m.index,
        Message::Transient(m) => m.index,
        Message::End(m) => m.index,
    })
}

/// Microseconds since 1970 as RFC 3339; `null` where no calendar has them.
pub fn rfc3339(us: i64) -> Value {
    let at = OffsetDateTime::from_unix_timestamp_nanos(i128::from(us) * 1000).ok();
    at.map(utc).filter(|text| !text.is_empty()).map_or(Value::Null, Value::String)
}

/// The same back; none where there is no time.
pub fn us_of(utc: &Value) -> Option<i64> {
    OffsetDateTime::parse(utc.as_str()?, &Rfc3339).ok().map(micros)
}

/// A time in microseconds since 1970.
pub fn micros(at: OffsetDateTime) -> i64 {
    (at.unix_timestamp_nanos() / 1000) as i64
}
