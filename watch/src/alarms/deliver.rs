//! The thread that watches, and those that tell: a webhook or a program that is slow holds up nothing else.

use super::Watcher;
use super::rules::Delivery;
use anyhow::{Context, Result, bail};
use seabearing_base::feed::{Feed, Subscription};
use seabearing_base::service::Notebook;
use seabearing_host::atomic;
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// How often time alone is looked at.
const TICK: Duration = Duration::from_millis(500);
/// Records that wait for the watcher, and alarms for a delivery.
const WAITING: usize = 20_000;
const UNDELIVERED: usize = 1000;
/// Attempts at a delivery, the time between them at first, and how long one may take.
const ATTEMPTS: u32 = 4;
const AGAIN: Duration = Duration::from_secs(2);
const PATIENCE: Duration = Duration::from_secs(10);
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
/// (`{"type":"acknowledge","id":..}`), or as files of the store's folder ([`acknowledge`]).
pub fn start(
    mut watcher: Watcher,
    deliveries: Vec<Delivery>,
    feed: &Feed,
    notebook: Notebook,
    store: Option<PathBuf>,
    standing: &[Value],
) {
    let clock = Steady::begin();
    let cleared = watcher.resume(standing, clock.now_s());
    let records = feed.subscribe(WAITING);
    let ways: Vec<SyncSender<Value>> = deliveries.into_iter().map(way).collect();
    std::thread::spawn(move || {
        // Alarms of rules that are no more.
        if cleared.into_iter().all(|record| tell(record, &ways, &notebook)) {
            watch(watcher, clock, &records, &ways, &notebook, store.as_deref());
        }
    });
}

fn watch(
    mut watcher: Watcher,
    clock: Steady,
    records: &Subscription,
    ways: &[SyncSender<Value>],
    notebook: &Notebook,
    store: Option<&Path>,
) {
    let mut looked = Instant::now();
    while let Some(taken) = records.take_within(TICK) {
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
        if !out.into_iter().all(|record| tell(record, ways, notebook)) {
            return;
        }
    }
}

/// Dates an alarm, and hands it to the deliveries and the store; false once the service has ended.
fn tell(mut record: Value, ways: &[SyncSender<Value>], notebook: &Notebook) -> bool {
    record["utc"] = crate::report::rfc3339(now_s());
    for way in ways {
        if let Err(TrySendError::Full(_)) = way.try_send(record.clone()) {
            log::warn!("{UNDELIVERED} alarms wait to be delivered; one is not: {}", record["text"]);
        }
    }
    notebook.note(station_of(&record), record)
}

fn station_of(record: &Value) -> Option<u16> {
    record["station"].as_u64().and_then(|s| u16::try_from(s).ok())
}

/// A thread that delivers.
fn way(delivery: Delivery) -> SyncSender<Value> {
    let (way, alarms) = sync_channel(UNDELIVERED);
    std::thread::spawn(move || deliver(&delivery, &alarms));
    way
}

fn deliver(delivery: &Delivery, alarms: &Receiver<Value>) {
    for alarm in alarms {
        let text = alarm.to_string();
        let mut wait = AGAIN;
        for attempt in 1..=ATTEMPTS {
            let told = match delivery {
                Delivery::Webhook(url) => post(url, &text),
                Delivery::Command(command) => run(command, &text),
            };
            match told {
                Ok(()) => break,
                Err(e) if attempt == ATTEMPTS => {
                    log::warn!("alarm {} was not delivered in {ATTEMPTS} attempts: {e:#}", alarm["id"]);
                }
                Err(_) => {
                    std::thread::sleep(wait);
                    wait *= 2;
                }
            }
        }
    }
}

/// Posts a record.
fn post(url: &str, text: &str) -> Result<()> {
    let request = minreq::post(url).with_header("Content-Type", "application/json").with_body(text);
    let answer = request.with_timeout(PATIENCE.as_secs()).send().with_context(|| url.to_owned())?;
    if !(200..300).contains(&answer.status_code) {
        bail!("{url}: answered {} {}", answer.status_code, answer.reason_phrase);
    }
    Ok(())
}

/// Runs a program with a record on its standard input.
fn run(command: &[String], text: &str) -> Result<()> {
    let Some((program, arguments)) = command.split_first() else { return Ok(()) };
    let mut child = Command::new(program)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .with_context(|| format!("cannot start {program}"))?;
    if let Some(mut to) = child.stdin.take() {
        // A program that does not read it may still do its work.
        let _ = writeln!(to, "{text}");
    }
    let begun = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            if !status.success() {
                bail!("{program}: {status}");
            }
            return Ok(());
        }
        if begun.elapsed() > PATIENCE {
            child.kill()?;
            child.wait()?;
            bail!("{program}: still at work after {} s, ended", PATIENCE.as_secs());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Tells the base station that holds a store that a person has seen an alarm.
///
/// # Errors
/// The store's folder cannot be written.
pub fn acknowledge(store: &Path, id: u64) -> Result<()> {
    atomic::write(&store.join(FOLDER).join(id.to_string()), json!({ "id": id }).to_string().as_bytes())
}

/// The alarms acknowledged since this was last asked.
fn acknowledged(store: &Path) -> Vec<u64> {
    let files = std::fs::read_dir(store.join(FOLDER)).into_iter().flatten().flatten();
    let id = |file: std::fs::DirEntry| {
        let id = file.file_name().to_str()?.parse().ok()?;
        std::fs::remove_file(file.path()).ok().map(|()| id)
    };
    files.filter_map(id).collect()
}
