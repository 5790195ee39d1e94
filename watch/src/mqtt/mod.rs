//! Records to an MQTT broker ([`publish`]) and from one ([`subscribe`]): what is between many base stations and a centre.
//!
//! MQTT 5, quality of service 1: a record counts as handed over once the broker has acknowledged it, and it is acknowledged to
//! a broker once it is on the disk here. So everything comes at least once, in the order of each base station.

pub mod broker;
mod cursor;
pub mod payload;
pub mod publish;
pub mod subscribe;

use broker::Broker;
use rumqttc::{ConnectReturnCode, ConnectionError, StateError};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time between attempts to reach a broker: at first, and at most.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// Time after which the same complaint is made again: at first, and at most.
const COMPLAIN: (Duration, Duration) = (Duration::from_secs(60), Duration::from_secs(3600));
/// A connection that has lasted for so long was one: after a shorter one the broker is left alone for longer each time.
const LASTS: Duration = Duration::from_secs(5);
/// The same complaint after a connection in between is made again after this, at most.
const FLAPS: Duration = Duration::from_secs(600);
/// Time in which a broker hears from a client that has nothing to say, seconds.
const KEEP_ALIVE_S: u16 = 30;

/// What a connection to a broker has done so far.
#[derive(Debug, Default)]
pub struct Counts {
    connected: AtomicBool,
    /// Connections made.
    connections: AtomicU64,
    /// Records acknowledged: by the broker, or to it.
    records: AtomicU64,
    /// Records that wait.
    waiting: AtomicU64,
    /// Records that can come no more.
    lost: AtomicU64,
    /// All input has ended: how far it is is noted without delay.
    ending: AtomicBool,
    /// How far it is is noted.
    noted: AtomicBool,
    notes: Mutex<Vec<String>>,
}

impl Counts {
    fn note(&self, text: String) {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).push(text);
    }

    /// What a person should know; each is told once.
    pub fn notes(&self) -> Vec<String> {
        std::mem::take(&mut self.notes.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Whether there was a connection, or is something to be said.
    fn is_heard_of(&self) -> bool {
        let notes = self.notes.lock().unwrap_or_else(PoisonError::into_inner);
        self.connections.load(Ordering::Relaxed) > 0 || !notes.is_empty()
    }

    /// Records that wait for the broker.
    pub fn waiting(&self) -> u64 {
        self.waiting.load(Ordering::Relaxed)
    }

    /// Records acknowledged.
    pub fn records(&self) -> u64 {
        self.records.load(Ordering::Relaxed)
    }

    /// As Prometheus reads it. `way`: `publish` or `subscribe`.
    pub fn text(&self, way: &str) -> String {
        let of = |n: &AtomicU64| n.load(Ordering::Relaxed);
        let connected = u64::from(self.connected.load(Ordering::Relaxed));
        let lines = [
            ("connected", "gauge", "Whether the broker is there", connected),
            ("connections_total", "counter", "Connections made to the broker", of(&self.connections)),
            ("records_total", "counter", "Records acknowledged by or to the broker", of(&self.records)),
            ("waiting_records", "gauge", "Records that wait to be acknowledged", of(&self.waiting)),
            (
                "lost_total",
                "counter",
                "Records that were let go of before the broker had them",
                of(&self.lost),
            ),
        ];
        let line = |(name, kind, help, value): (&str, &str, &str, u64)| {
            let name = format!("seabearing_mqtt_{way}_{name}");
            format!("# HELP {name} {help}.\n# TYPE {name} {kind}\n{name} {value}\n")
        };
        lines.map(line).concat()
    }
}

/// Tells a person of a broker that is away: once, again where the reason is another, and then more and more seldom.
#[derive(Debug)]
struct Complaints {
    broker: String,
    last: Option<(String, Instant, Duration)>,
    retry: Duration,
    /// When the connection began that is there, or was there last.
    since: Option<Instant>,
    /// That it is back was told.
    back: bool,
}

impl Complaints {
    fn of(broker: &Broker) -> Self {
        Self { broker: broker.to_string(), last: None, retry: RETRY.0, since: None, back: true }
    }

    /// It is there, and has taken something or promised to give it.
    fn connected(&mut self, counts: &Counts) {
        counts.connected.store(true, Ordering::Relaxed);
        let before = counts.connections.fetch_add(1, Ordering::Relaxed);
        self.since = Some(Instant::now());
        if !std::mem::replace(&mut self.back, true) || before == 0 {
            counts.note(format!("{}: connected", self.broker));
        }
    }

    /// It is not. Gives how long to wait before the next attempt.
    fn away(&mut self, why: &str, meanwhile: &str, counts: &Counts) -> Duration {
        counts.connected.store(false, Ordering::Relaxed);
        let lasted = self.since.take().map(|since| since.elapsed());
        if lasted.is_some_and(|lasted| lasted >= LASTS) {
            self.retry = RETRY.0;
        }
        // What lets in and closes in turn is not told of each time.
        if lasted.is_some_and(|lasted| lasted >= COMPLAIN.0) {
            self.last = None;
        }
        let most = if lasted.is_some() { FLAPS } else { COMPLAIN.1 };
        let due = match &self.last {
            Some((said, at, again)) if said == why => {
                (at.elapsed() >= (*again).min(most)).then_some(*again * 2)
            }
            _ => Some(COMPLAIN.0),
        };
        if let Some(again) = due {
            counts.note(format!("{}: {why}; it is tried again, {meanwhile}", self.broker));
            self.last = Some((why.to_owned(), Instant::now(), again.min(COMPLAIN.1)));
            self.back = false;
        }
        let next = (self.retry * 2).min(RETRY.1);
        std::mem::replace(&mut self.retry, next)
    }
}

/// Why a connection has ended, for a person.
fn why(error: &ConnectionError) -> String {
    match error {
        ConnectionError::ConnectionRefused(code) => match code {
            ConnectReturnCode::BadUserNamePassword => {
                "the broker refuses the user or the password".to_owned()
            }
            ConnectReturnCode::NotAuthorized => {
                "the broker does not let this client in (user, password, certificate or client id)".to_owned()
            }
            ConnectReturnCode::UnsupportedProtocolVersion | ConnectReturnCode::RefusedProtocolVersion => {
                "the broker does not speak MQTT 5".to_owned()
            }
            code => format!("the broker refuses: {code:?}"),
        },
        ConnectionError::Timeout(_) => "the broker does not answer".to_owned(),
        ConnectionError::Tls(e) => format!("TLS: {}", causes(e)),
        ConnectionError::Io(e) => e.to_string(),
        ConnectionError::MqttState(StateError::ConnectionAborted) => {
            "the broker has closed the connection (its log says why)".to_owned()
        }
        e => causes(e),
    }
}

/// An error with its causes, on one line.
fn causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(e) = cause {
        let more = e.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = e.source();
    }
    text.replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_broker_that_is_away_is_named_once_and_again_for_another_reason() {
        let broker = Broker::read("mqtt://127.0.0.1:1").unwrap();
        let (mut complaints, counts) = (Complaints::of(&broker), Counts::default());
        let waits: Vec<_> = (0..8).map(|_| complaints.away("gone", "all waits", &counts).as_secs()).collect();
        assert_eq!(waits, [1, 2, 4, 8, 16, 32, 60, 60]);
        assert_eq!(counts.notes(), ["mqtt://127.0.0.1:1: gone; it is tried again, all waits"]);
        complaints.away("refused", "all waits", &counts);
        complaints.connected(&counts);
        assert_eq!(counts.notes().len(), 2);
        // What was not away is not said to be back.
        complaints.connected(&counts);
        assert!(counts.notes().is_empty());
        complaints.since = Instant::now().checked_sub(LASTS);
        assert_eq!(complaints.away("gone", "", &counts), RETRY.0);
        assert_eq!(counts.notes().len(), 1);
        // One that lets in and closes at once: no two lines each time, and it is left alone for longer and longer.
        let waits: Vec<_> = (0..4)
            .map(|_| {
                complaints.connected(&counts);
                complaints.away("gone", "", &counts).as_secs()
            })
            .collect();
        assert_eq!(waits, [2, 4, 8, 16]);
        assert_eq!(counts.notes(), ["mqtt://127.0.0.1:1: connected"]);
        let text = counts.text("publish");
        assert!(text.contains("\nseabearing_mqtt_publish_connections_total 6\n"), "{text}");
    }
}
