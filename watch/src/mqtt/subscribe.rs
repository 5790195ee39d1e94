//! Taking the records of other base stations from a broker: kept as if they had been heard here, and acknowledged once they
//! are on the disk.

use super::broker::Broker;
use super::{Complaints, Counts, payload, why};
use anyhow::{Result, anyhow};
use rumqttc::{
    AckMode, AsyncClient, BrokerSessionResumePolicy, Event, EventLoop, ManualAck, Packet, Publish, QoS,
    SessionMode, SubscribeReasonCode,
};
use seabearing_base::record::Origin;
use seabearing_base::relay::{Relayed, packed};
use seabearing_base::service::Door;
use seabearing_base::store::Logs;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// Messages that may be unacknowledged at once; the broker may want fewer.
const WINDOW: u16 = 20_000;
/// Longest message, bytes.
const LONGEST: u32 = 1 << 20;
/// Records stored together, and batches of them that may be on their way to the disk.
const TOGETHER: usize = 5000;
const BATCHES: usize = 3;
/// Time for which the broker keeps what this client has not taken, seconds.
const KEPT_S: u32 = 30 * 86_400;

/// A subscriber at work.
pub struct Subscriber {
    counts: Arc<Counts>,
}

impl Subscriber {
    /// What it has done so far.
    pub fn counts(&self) -> &Arc<Counts> {
        &self.counts
    }
}

/// Starts to bring a service the records of other base stations. `store`: its folder, where this client's name is kept. `own`: the logs
/// that this program publishes itself; what comes back of them, by whatever way, is left out.
///
/// # Errors
/// The store's folder cannot be written, or a certificate is none.
pub fn start(broker: Broker, door: Door, store: Option<&Path>, own: Option<Logs>) -> Result<Subscriber> {
    let name = match &broker.name {
        Some(name) => format!("{name}-centre"),
        None => {
            format!("seabearing-{:016x}-centre", store.map_or_else(|| Ok(Logs::new()), Logs::of)?.newest())
        }
    };
    let lasting = store.is_some();
    broker.options(&name)?;
    let counts = Arc::new(Counts::default());
    let inbox = Arc::new(Inbox::default());
    let (bringing, bring_counts) = (Arc::clone(&inbox), Arc::clone(&counts));
    std::thread::spawn(move || bring(&bringing, &door, &bring_counts));
    let complaints = Complaints::of(&broker);
    let mut work = Work {
        broker,
        name,
        lasting,
        own,
        own_told: false.into(),
        inbox,
        counts: Arc::clone(&counts),
        complaints,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::spawn(move || runtime.block_on(work.go_on()));
    Ok(Subscriber { counts })
}

/// Where the records of a connection wait to be brought, and those on their way to the disk.
#[derive(Default)]
struct Inbox {
    state: Mutex<Came>,
    changed: Condvar,
}

#[derive(Default)]
struct Came {
    records: Vec<(Relayed, Acknowledgement)>,
    batches: usize,
    /// The service has ended.
    over: bool,
}

/// How a record is acknowledged: on the connection it came over, if that is still there.
struct Acknowledgement {
    /// None where the broker wants none: a message of quality of service 0.
    ack: Option<ManualAck>,
    to: UnboundedSender<Vec<ManualAck>>,
}

impl Inbox {
    fn state(&self) -> MutexGuard<'_, Came> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Brings what has come, in batches that grow with the load.
fn bring(inbox: &Arc<Inbox>, door: &Door, counts: &Arc<Counts>) {
    loop {
        let mut came = inbox.state();
        while came.records.is_empty() || came.batches >= BATCHES {
            came = inbox.changed.wait(came).unwrap_or_else(PoisonError::into_inner);
        }
        let most = came.records.len().min(TOGETHER);
        let batch: Vec<_> = came.records.drain(..most).collect();
        came.batches += 1;
        drop(came);
        let (records, acknowledgements): (Vec<_>, Vec<_>) = batch.into_iter().unzip();
        let (inbox_then, counts_then) = (Arc::clone(inbox), Arc::clone(counts));
        let stored = move || {
            counts_then.records.fetch_add(acknowledgements.len() as u64, Ordering::Relaxed);
            counts_then.waiting.fetch_sub(acknowledgements.len() as u64, Ordering::Relaxed);
            acknowledge(acknowledgements);
            inbox_then.state().batches -= 1;
            inbox_then.changed.notify_one();
        };
        let brought = packed(&records).is_ok_and(|bytes| door.bring(bytes, Box::new(stored)));
        if !brought {
            inbox.state().over = true;
            return;
        }
    }
}

/// Hands acknowledgements to their connections; of one that has ended the broker sends again.
fn acknowledge(all: Vec<Acknowledgement>) {
    let mut acks = Vec::new();
    let mut to: Option<UnboundedSender<Vec<ManualAck>>> = None;
    for one in all {
        if let Some(before) = to.take_if(|to| !to.same_channel(&one.to)) {
            let _ = before.send(std::mem::take(&mut acks));
        }
        to = Some(one.to);
        acks.extend(one.ack);
    }
    if let Some(to) = to {
        let _ = to.send(acks);
    }
}

struct Work {
    broker: Broker,
    name: String,
    /// The broker is to keep what comes while this client is away.
    lasting: bool,
    /// The store of this base station as it publishes it itself.
    own: Option<Logs>,
    own_told: std::cell::Cell<bool>,
    inbox: Arc<Inbox>,
    counts: Arc<Counts>,
    complaints: Complaints,
}

impl Work {
    async fn go_on(&mut self) {
        while !self.inbox.state().over {
            let ended = self.connection().await;
            let wait =
                self.complaints.away(&format!("{ended:#}"), "what comes waits at the broker", &self.counts);
            tokio::time::sleep(wait).await;
        }
    }

    /// A connection from its beginning to its end; gives why that came.
    async fn connection(&mut self) -> anyhow::Error {
        let (client, events) = match self.client() {
            Ok(pair) => pair,
            Err(e) => return e,
        };
        let (stored, acknowledgements) = unbounded_channel();
        tokio::select! {
            ended = self.drive(events, &client, &stored) => ended,
            ended = answer(&client, acknowledgements) => ended,
        }
    }

    fn client(&self) -> Result<(AsyncClient, EventLoop)> {
        let mut options = self.broker.options(&self.name)?;
        options.set_ack_mode(AckMode::Manual);
        options.set_receive_maximum(Some(WINDOW));
        options.set_max_packet_size(Some(LONGEST));
        // It publishes nothing. The client looks through as many places as this says whenever it sends, 65 535 of them else.
        options.set_outgoing_inflight_upper_limit(1);
        if self.lasting {
            options.set_session_mode(SessionMode::Persistent);
            options.set_session_expiry_interval(Some(KEPT_S));
            options.set_broker_session_resume_policy(BrokerSessionResumePolicy::AllowBrokerOnly);
        }
        Ok(AsyncClient::builder(options).capacity(usize::from(WINDOW)).try_build()?)
    }

    /// Takes what comes until the connection ends; gives why.
    async fn drive(
        &mut self,
        mut events: EventLoop,
        client: &AsyncClient,
        stored: &UnboundedSender<Vec<ManualAck>>,
    ) -> anyhow::Error {
        let mut foreign = false;
        loop {
            match events.poll().await {
                Ok(Event::Incoming(Packet::ConnAck(_))) => {
                    for filter in self.broker.filters() {
                        if let Err(e) = client.try_subscribe(filter, QoS::AtLeastOnce) {
                            return anyhow!("it cannot be subscribed to: {e}");
                        }
                    }
                }
                Ok(Event::Incoming(Packet::SubAck(said))) => {
                    let refused =
                        |code: &&SubscribeReasonCode| !matches!(code, SubscribeReasonCode::Success(_));
                    if let Some(code) = said.return_codes.iter().find(refused) {
                        return anyhow!(
                            "the broker refuses the subscription: {code:?} (is this user allowed to read there?)"
                        );
                    }
                    self.complaints.connected(&self.counts);
                }
                Ok(Event::Incoming(Packet::Publish(publish))) => {
                    if !self.take(client, &publish, stored) && !std::mem::replace(&mut foreign, true) {
                        let topic = String::from_utf8_lossy(&publish.topic).into_owned();
                        self.counts.note(format!(
                            "{}: {topic}: not a record of a base station; such are left out",
                            self.broker
                        ));
                    }
                }
                Ok(Event::Incoming(Packet::Disconnect(said))) => {
                    return anyhow!("the broker has closed the connection: {:?}", said.reason_code);
                }
                Ok(_) => {}
                Err(e) => return anyhow!(why(&e)),
            }
        }
    }

    /// Takes a message; false if it is no record.
    fn take(
        &self,
        client: &AsyncClient,
        publish: &Publish,
        stored: &UnboundedSender<Vec<ManualAck>>,
    ) -> bool {
        let ack = client.prepare_ack(publish);
        let Ok(record) = payload::relayed(&publish.payload) else {
            // It would come for ever.
            let _ = stored.send(ack.into_iter().collect());
            return false;
        };
        if let Some(own) = &self.own
            && let Origin { log, number } = record.origin()
            && own.has(log)
        {
            // This base station's own, on a way back.
            let _ = stored.send(ack.into_iter().collect());
            self.own_came(number);
            return true;
        }
        self.counts.waiting.fetch_add(1, Ordering::Relaxed);
        let mut came = self.inbox.state();
        came.records.push((record, Acknowledgement { ack, to: stored.clone() }));
        drop(came);
        self.inbox.changed.notify_one();
        true
    }

    fn own_came(&self, number: u64) {
        if !self.own_told.replace(true) {
            self.counts.note(format!(
                "{}: records that are published here come back (number {number}); they are left out",
                self.broker
            ));
        }
    }
}

/// Acknowledges what is stored.
async fn answer(client: &AsyncClient, mut stored: UnboundedReceiver<Vec<ManualAck>>) -> anyhow::Error {
    while let Some(acks) = stored.recv().await {
        for ack in acks {
            if let Err(e) = client.manual_ack(ack).await {
                return anyhow!("it cannot be acknowledged: {e}");
            }
        }
    }
    // The other end is beside this, and ends with it.
    std::future::pending().await
}
