//! The thread that watches: alarms go into the store, onto the feed, and on the ways that tell people.

use super::Watcher;
use super::rules::Delivery;
use super::way::{self, Way};
use anyhow::Result;
use seabearing_base::feed::{Behind, Feed, Subscription};
use seabearing_base::service::Notebook;
use seabearing_host::atomic;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// How often time alone is looked at; and how often whether all has ended.
const TICK: Duration = Duration::from_millis(500);
const TURN: Duration = Duration::from_millis(100);
/// Records that wait for the watcher.
const WAITING: usize = 20_000;
/// How often it is seen whether it has looked at all, and how long that is waited for.
const LOOK: Duration = Duration::from_millis(2);
const LOOKED: Duration = Duration::from_secs(10);
/// Alarms that are named where they are not delivered at the end; of more their number.
const NAMED: usize = 10;
/// The folder in a store where acknowledgements are put.
const FOLDER: &str = "acknowledged";

/// Seconds since 1970 by this computer's clock.
fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}

/// The same from when this began on, of a clock that nobody sets: a recorder is not silent because a computer was told the time.
#[derive(Clone, Copy)]
struct Steady(Instant, f64);

impl Steady {
    fn begin() -> Self {
        Self(Instant::now(), now_s())
    }

    fn now_s(self) -> f64 {
        self.1 + self.0.elapsed().as_secs_f64()
    }
}

/// Starts to watch what a service publishes: alarms go into its store and onto its feed, and to the deliveries. `standing`:
/// the alarm records of the store, oldest first. Acknowledgements come over the feed
/// (`{"type":"acknowledge","id":..}`), or as files of the store's folder ([`acknowledge`]). What was not delivered when a base station of
/// the store ended is delivered now.
pub fn start(
    mut watcher: Watcher,
    deliveries: Vec<Delivery>,
    feed: &Feed,
    notebook: Notebook,
    store: Option<PathBuf>,
    standing: &[Value],
) -> AtWork {
    let clock = Steady::begin();
    let cleared = watcher.resume(standing, clock.now_s());
    let records = feed.subscribe(WAITING);
    let behind = records.behind();
    let ways = way::begin(deliveries, store.as_deref());
    let (finish, ends) = channel();
    let at_work = AtWork { behind, finish, ways: ways.clone() };
    std::thread::spawn(move || {
        // Alarms of rules that are no more.
        if cleared.into_iter().all(|record| tell(record, &ways, &notebook)) {
            watch(watcher, clock, (&records, &ends), &ways, &notebook, store.as_deref());
        }
    });
    at_work
}

/// Alarms at work.
pub struct AtWork {
    behind: Behind,
    finish: Sender<Sender<()>>,
    ways: Vec<Arc<Way>>,
}

impl AtWork {
    /// All input has ended: waits until all that was published is looked at, and what waits for fusion is raised; what came of it is in
    /// the service's notebook.
    pub fn settle(&self) {
        let begun = Instant::now();
        while self.behind.waiting() > 0 && begun.elapsed() < LOOKED {
            std::thread::sleep(LOOK);
        }
        let (done, is_done) = channel();
        if self.finish.send(done).is_ok() {
            let _ = is_done.recv_timeout(LOOKED);
        }
    }

    /// Waits until all alarms are delivered, for so long at most; says which are not.
    pub fn finish(&self, most: Duration) {
        let until = Instant::now() + most;
        for way in &self.ways {
            let left = way.settle(until);
            for (alarm, kept) in left.iter().take(NAMED) {
                let then = if *kept { "it waits in the store for the next start" } else { "it is lost" };
                log::warn!(
                    "alarm {} ({}, {}) is not delivered to {way}: {then}",
                    alarm["id"],
                    alarm["state"],
                    alarm["text"]
                );
            }
            if left.len() > NAMED {
                log::warn!("{} more alarms are not delivered to {way}", left.len() - NAMED);
            }
        }
    }
}

fn watch(
    mut watcher: Watcher,
    clock: Steady,
    (records, ends): (&Subscription, &Receiver<Sender<()>>),
    ways: &[Arc<Way>],
    notebook: &Notebook,
    store: Option<&Path>,
) {
    let mut looked = Instant::now();
    while let Some(taken) = records.take_within(TURN) {
        let mut out = Vec::new();
        for record in taken.records.iter() {
            if record["type"] == "acknowledge" {
                out.extend(record["id"].as_u64().and_then(|id| watcher.acknowledge(id)));
            } else {
                out.extend(watcher.take(record, clock.now_s()));
            }
        }
        if looked.elapsed() >= TICK {
            looked = Instant::now();
            out.extend(watcher.tick(clock.now_s()));
            if let Some(store) = store.filter(|_| watcher.asks_for_disk())
                && let (Ok(free), Ok(total)) = (fs4::available_space(store), fs4::total_space(store))
            {
                out.extend(watcher.disk(free, total, clock.now_s()));
            }
            for id in store.map(acknowledged).unwrap_or_default() {
                match watcher.acknowledge(id) {
                    Some(record) => out.push(record),
                    None => log::warn!("there is no alarm {id} to acknowledge"),
                }
            }
        }
        let ended = ends.try_recv().ok();
        if ended.is_some() {
            out.extend(watcher.finish(clock.now_s()));
        }
        if !out.into_iter().all(|record| tell(record, ways, notebook)) {
            return;
        }
        if let Some(done) = ended {
            let _ = done.send(());
        }
    }
}

impl Drop for AtWork {
    fn drop(&mut self) {
        self.ways.iter().for_each(|way| way.end());
    }
}

/// Dates an alarm, and hands it to the deliveries and the store; false once the service has ended.
fn tell(mut record: Value, ways: &[Arc<Way>], notebook: &Notebook) -> bool {
    record["utc"] = crate::report::rfc3339(now_s());
    ways.iter().for_each(|way| way.put(&record));
    notebook.note(station_of(&record), record)
}

fn station_of(record: &Value) -> Option<u16> {
    record["station"].as_u64().and_then(|s| u16::try_from(s).ok())
}

/// Tells the base station that holds a store that a person has seen an alarm.
///
/// # Errors
/// The store's folder cannot be written.
pub fn acknowledge(store: &Path, id: u64) -> Result<()> {
    atomic::write(&store.join(FOLDER).join(id.to_string()), json!({ "id": id }).to_string().as_bytes())
}

/// The alarms whose acknowledgement waits for the base station of a store.
pub fn acknowledgements(store: &Path) -> BTreeSet<u64> {
    files(store).map(|(id, _)| id).collect()
}

/// The alarms acknowledged since this was last asked.
fn acknowledged(store: &Path) -> Vec<u64> {
    files(store).filter_map(|(id, file)| std::fs::remove_file(file).ok().map(|()| id)).collect()
}

/// Acknowledgements, each with its file.
fn files(store: &Path) -> impl Iterator<Item = (u64, PathBuf)> {
    let files = std::fs::read_dir(store.join(FOLDER)).into_iter().flatten().flatten();
    files.filter_map(|file| Some((file.file_name().to_str()?.parse().ok()?, file.path())))
}

/// Alarms that wait in a store to be delivered by a base station that watches.
pub fn undelivered(store: &Path) -> usize {
    way::waiting(store)
}
