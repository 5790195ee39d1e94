//! Publishing: the records of a store to a broker, from the last one on that it has acknowledged.
//!
//! The store is the buffer. A thread reads it from the cursor on and moves the cursor as the broker acknowledges; a broker
//! that is away moves nothing, and holds up nothing else. What was on its way when a connection ended is sent again.

use super::broker::Broker;
use super::cursor::Cursor;
use super::payload;
use super::{Complaints, Counts, why};
use anyhow::{Result, anyhow};
use rumqttc::{
    AsyncClient, Event, EventLoop, LastWill, Packet, PubAckReason, PublishNotice, PublishNoticeError,
    PublishOptions, QoS,
};
use seabearing_base::store::{Logs, Numbered, Tail};
use seabearing_base::waiting::Waiting;
use serde_json::json;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// Messages on their way at once; the broker may want fewer. The client looks through so many places whenever it sends.
const WINDOW: usize = 500;
/// Records read at once.
const TOGETHER: usize = 250;
/// How often new records are looked for.
const LOOK: Duration = Duration::from_millis(50);

/// Longest that a broker is waited for at the end which was never there.
const NEVER: Duration = Duration::from_secs(10);

/// Where the records are.
pub enum Source {
    /// In a store.
    Store(Tail),
    /// In memory, without one.
    Memory(Arc<Waiting>),
}

impl Source {
    fn newest(&self) -> Result<i64> {
        match self {
            Self::Store(tail) => tail.newest(),
            Self::Memory(waiting) => Ok(waiting.newest()),
        }
    }

    fn after(&mut self, after: i64) -> Result<Vec<Numbered>> {
        match self {
            Self::Store(tail) => tail.after(after, TOGETHER),
            Self::Memory(waiting) => Ok(waiting.after(after, TOGETHER)),
        }
    }
}

/// A publisher at work.
pub struct Publisher {
    counts: Arc<Counts>,
    logs: Logs,
}

impl Publisher {
    /// What it has done so far.
    pub fn counts(&self) -> &Arc<Counts> {
        &self.counts
    }

    /// The logs of what it publishes.
    pub fn logs(&self) -> &Logs {
        &self.logs
    }

    /// Waits until it is known whether the broker is there, at most so long.
    pub fn begun(&self, most: Duration) {
        let begun = Instant::now();
        while !self.counts.is_heard_of() && begun.elapsed() < most {
            std::thread::sleep(LOOK);
        }
    }

    /// Waits until the broker has all there is and that is noted, at most so long, and `tells` meanwhile; gives how many records it
    /// does not have, those among them that were let go of.
    pub fn settle(&self, most: Duration, tells: impl Fn()) -> u64 {
        let begun = Instant::now();
        // What was stored last may not have been seen yet.
        std::thread::sleep(LOOK * 4);
        self.counts.ending.store(true, Ordering::Relaxed);
        // One that was never there is waited for less.
        let most = if self.counts.connections.load(Ordering::Relaxed) == 0 { most.min(NEVER) } else { most };
        let settled = || self.counts.waiting() == 0 && self.counts.noted.load(Ordering::Relaxed);
        while !settled() && begun.elapsed() < most {
            std::thread::sleep(LOOK);
            tells();
        }
        self.counts.waiting() + self.counts.lost.load(Ordering::Relaxed)
    }
}

/// Starts to publish. `store`: its folder, where the cursor is kept.
///
/// # Errors
/// The store or its cursor cannot be read, or a certificate is none.
pub fn start(broker: Broker, source: Source, store: Option<&Path>) -> Result<Publisher> {
    let newest = source.newest()?;
    let mut cursor = Cursor::open(store, newest)?;
    if cursor.acknowledged.is_none() {
        cursor.acknowledged = Some(if broker.backfill { 0 } else { newest });
        cursor.save()?;
    }
    let name = broker.name.clone().unwrap_or_else(|| format!("seabearing-{:016x}", cursor.logs.newest()));
    broker.options(&name)?;
    let counts = Arc::new(Counts::default());
    let complaints = Complaints::of(&broker);
    let meanwhile = match &source {
        Source::Store(_) => "records wait in the store".to_owned(),
        Source::Memory(_) => format!("at most {} records wait in memory", broker.room),
    };
    let (state, logs) = (BTreeMap::new(), cursor.logs.clone());
    let mut work =
        Work { broker, name, source, cursor, state, counts: Arc::clone(&counts), complaints, meanwhile };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::spawn(move || runtime.block_on(work.go_on()));
    Ok(Publisher { counts, logs })
}

struct Work {
    broker: Broker,
    name: String,
    source: Source,
    cursor: Cursor,
    /// What was retained last, by topic: a broker that starts again may have forgotten it.
    state: BTreeMap<String, String>,
    counts: Arc<Counts>,
    complaints: Complaints,
    meanwhile: String,
}

/// A message on its way; its record is acknowledged with the last of its messages.
struct OnItsWay {
    number: Option<i64>,
    notice: PublishNotice,
}

impl Work {
    async fn go_on(&mut self) {
        loop {
            let ended = self.connection().await;
            if let Err(e) = self.cursor.save() {
                self.counts.note(format!("{e:#}; some records may be published twice"));
            }
            let why = format!("{ended:#}");
            let wait = self.complaints.away(&why, &self.meanwhile, &self.counts);
            let begun = Instant::now();
            while begun.elapsed() < wait {
                self.count();
                tokio::time::sleep(wait.min(Duration::from_secs(1))).await;
            }
        }
    }

    /// A connection from its beginning to its end; gives why that came.
    async fn connection(&mut self) -> anyhow::Error {
        let (client, events) = match self.client() {
            Ok(pair) => pair,
            Err(e) => return e,
        };
        let connected = Notify::new();
        let mut work = std::pin::pin!(async {
            connected.notified().await;
            match self.work(&client).await {
                Ok(never) => match never {},
                Err(e) => e,
            }
        });
        let ended = tokio::select! {
            ended = &mut work => return ended,
            ended = drive(events, &connected) => ended,
        };
        // A broker that refuses may close the connection in the same breath.
        tokio::select! {
            biased;
            refused = &mut work => if refused.is::<Refused>() { refused } else { ended },
            () = std::future::ready(()) => ended,
        }
    }

    fn status(&self, state: &str) -> (String, String) {
        let log = format!("{:016x}", self.cursor.logs.newest());
        let status = json!({ "type": "base", "base": self.name, "log": log, "state": state });
        (format!("{}/bases/{}/state", self.broker.prefix, self.name), status.to_string())
    }

    fn client(&self) -> Result<(AsyncClient, EventLoop)> {
        let mut options = self.broker.options(&self.name)?;
        let (topic, status) = self.status("offline");
        options.set_last_will(LastWill::new(topic, status, QoS::AtLeastOnce, true, None));
        options.set_outgoing_inflight_upper_limit(WINDOW as u16);
        Ok(AsyncClient::builder(options).capacity(WINDOW).try_build()?)
    }

    /// Publishes until the connection fails.
    async fn work(&mut self, client: &AsyncClient) -> Result<std::convert::Infallible> {
        let (topic, status) = self.status("online");
        let first = send(client, topic, status, true, None).await?;
        first.notice.wait_completion_async().await.map_err(refused)?;
        self.complaints.connected(&self.counts);
        let mut on_their_way = VecDeque::new();
        for (topic, text) in self.state.clone() {
            on_their_way.push_back(send(client, topic, text, true, None).await?);
        }
        let mut sent = self.cursor.acknowledged.unwrap_or(0);
        loop {
            if on_their_way.len() < WINDOW / 2 {
                for record in self.source.after(sent)? {
                    self.count_lost(record.number - sent - 1);
                    sent = record.number;
                    self.publish(client, &record, &mut on_their_way).await?;
                }
            }
            match on_their_way.pop_front() {
                Some(OnItsWay { number, notice }) => {
                    notice.wait_completion_async().await.map_err(refused)?;
                    if let Some(number) = number {
                        self.acknowledged(number);
                    }
                }
                None => {
                    self.count();
                    tokio::time::sleep(LOOK).await;
                }
            }
            // A disk that is full for a while costs nothing but records sent twice.
            let _ = match self.counts.ending.load(Ordering::Relaxed) && on_their_way.is_empty() {
                true if !self.cursor.is_saved() => self.cursor.save(),
                _ => self.cursor.now_and_then(),
            };
            self.counts.noted.store(self.cursor.is_saved(), Ordering::Relaxed);
        }
    }

    fn acknowledged(&mut self, number: i64) {
        self.cursor.acknowledged = Some(number);
        self.counts.records.fetch_add(1, Ordering::Relaxed);
        if let Source::Memory(waiting) = &self.source {
            waiting.forget(number);
        }
        if number % TOGETHER as i64 == 0 {
            self.count();
        }
    }

    /// How many records wait.
    fn count(&self) {
        if let Ok(newest) = self.source.newest() {
            let waiting = newest - self.cursor.acknowledged.unwrap_or(0);
            self.counts.waiting.store(waiting.max(0) as u64, Ordering::Relaxed);
        }
    }

    /// Records that were let go of before the broker had them: a memory that was full, or a rule of retention.
    fn count_lost(&self, records: i64) {
        if records > 0 {
            self.counts.lost.fetch_add(records as u64, Ordering::Relaxed);
            let waited = match self.source {
                Source::Store(_) => "the store has let go of them before",
                Source::Memory(_) => "no more fit into memory; `--store` keeps all",
            };
            self.counts.note(format!("{}: {records} records are not published: {waited}", self.broker));
        }
    }

    async fn publish(
        &mut self,
        client: &AsyncClient,
        record: &Numbered,
        on_their_way: &mut VecDeque<OnItsWay>,
    ) -> Result<()> {
        let number = record.number;
        let published = payload::record(record, &self.name, self.cursor.logs.log(number))?;
        let text = published.to_string();
        if let Some((topic, stands)) = payload::retained(&published) {
            let topic = self.topic(&topic);
            let last = if stands { text.clone() } else { String::new() };
            match stands {
                true => self.state.insert(topic.clone(), text.clone()),
                false => self.state.remove(&topic),
            };
            on_their_way.push_back(send(client, topic, last, true, None).await?);
        }
        let topic = self.topic(&payload::topic(&published));
        on_their_way.push_back(send(client, topic, text, false, Some(number)).await?);
        Ok(())
    }

    fn topic(&self, below: &str) -> String {
        format!("{}/{below}", self.broker.prefix)
    }
}

/// Keeps a connection going until it ends; gives why.
async fn drive(mut events: EventLoop, connected: &Notify) -> anyhow::Error {
    loop {
        match events.poll().await {
            Ok(Event::Incoming(Packet::ConnAck(_))) => connected.notify_one(),
            Ok(Event::Incoming(Packet::Disconnect(said))) => {
                return anyhow!("the broker has closed the connection: {:?}", said.reason_code);
            }
            Ok(_) => {}
            Err(e) => return anyhow!(why(&e)),
        }
    }
}

async fn send(
    client: &AsyncClient,
    topic: String,
    text: String,
    retain: bool,
    number: Option<i64>,
) -> Result<OnItsWay> {
    let options = PublishOptions::new(QoS::AtLeastOnce).retain(retain);
    let notice = client.publish_tracked(topic, text, options).await;
    let notice = notice.map_err(|e| anyhow!("it cannot be published: {e}"))?;
    Ok(OnItsWay { number, notice })
}

/// The broker does not take a message.
#[derive(Debug)]
struct Refused(PubAckReason);

impl std::fmt::Display for Refused {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the broker refuses records: {:?} (is this user allowed to write there?)", self.0)
    }
}

impl std::error::Error for Refused {}

/// Why a message was not taken.
fn refused(error: PublishNoticeError) -> anyhow::Error {
    match error {
        PublishNoticeError::V5PubAck(reason) => Refused(reason).into(),
        e => e.into(),
    }
}
