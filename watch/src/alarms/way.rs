//! The ways on which alarms are told: webhooks and programs, each with a thread and a queue of its own, so that one that is slow holds
//! up nothing else.
//!
//! Where there is a store, what waits on a way is also a file below `undelivered/` there until it is told, so that it is told after the next
//! start: at least once.

use super::rules::Delivery;
use anyhow::{Context, Result, bail};
use seabearing_core::wire::hash::fnv1a;
use seabearing_host::{atomic, interrupt};
use serde_json::Value;
use std::collections::{BTreeSet, VecDeque};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Alarms that wait for a delivery.
const UNDELIVERED: usize = 1000;
/// Attempts at a delivery, the time between them at first, and how long one may take.
const ATTEMPTS: u32 = 4;
const AGAIN: Duration = Duration::from_secs(2);
const PATIENCE: Duration = Duration::from_secs(10);
/// The folder in a store where alarms wait.
const FOLDER: &str = "undelivered";

/// An alarm that waits, and the file that keeps it.
#[derive(Debug)]
struct Entry {
    alarm: Value,
    file: Option<PathBuf>,
}

/// What waits; the first of them is being told.
#[derive(Debug, Default)]
struct Queue {
    waiting: VecDeque<Entry>,
    /// Number of the newest file.
    newest: u64,
}

/// A way on which alarms are told.
#[derive(Debug)]
pub(super) struct Way {
    delivery: Delivery,
    folder: Option<PathBuf>,
    queue: Mutex<Queue>,
    changed: Condvar,
    running: Running,
}

/// The program that is being told, if one is; and that no other is to be started.
#[derive(Debug, Default)]
struct Running(Mutex<(Option<Group>, bool)>);

/// The process group of a program.
#[cfg(unix)]
type Group = rustix::process::Pid;
#[cfg(not(unix))]
type Group = ();

impl std::fmt::Display for Way {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.delivery.fmt(f)
    }
}

/// Begins all ways; what waited for them in a store is told first. What waits there for others is nobody's any more.
pub(super) fn begin(deliveries: Vec<Delivery>, store: Option<&Path>) -> Vec<Arc<Way>> {
    let parent = store.map(|store| store.join(FOLDER));
    let ways: Vec<Arc<Way>> =
        deliveries.into_iter().map(|d| Arc::new(Way::new(d, parent.as_deref()))).collect();
    let own: BTreeSet<&Path> = ways.iter().filter_map(|way| way.folder.as_deref()).collect();
    for other in
        parent.iter().flat_map(|folder| paths(folder)).filter(|folder| !own.contains(folder.as_path()))
    {
        let count = paths(&other).len();
        if std::fs::remove_dir_all(&other).is_ok() && count > 0 {
            log::warn!(
                "{count} alarms waited for a delivery that the file of alarms does not name any more: they are not told"
            );
        }
    }
    for way in &ways {
        let way = Arc::clone(way);
        std::thread::spawn(move || way.work());
    }
    ways
}

/// Alarms that wait in a store to be delivered.
pub(super) fn waiting(store: &Path) -> usize {
    paths(&store.join(FOLDER)).iter().map(|way| paths(way).len()).sum()
}

/// What is in a folder, in order.
fn paths(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> =
        std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    paths.sort();
    paths
}

impl Way {
    fn new(delivery: Delivery, parent: Option<&Path>) -> Self {
        let mut way = Self {
            delivery,
            folder: None,
            queue: Mutex::default(),
            changed: Condvar::new(),
            running: Running::default(),
        };
        let Some(parent) = parent else { return way };
        let folder = parent.join(format!("{:016x}", fnv1a(way.to_string().as_bytes())));
        let mut queue = Queue::default();
        for file in paths(&folder) {
            let number = file.file_stem().and_then(|name| name.to_str()?.parse().ok());
            let alarm = std::fs::read(&file).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
            if let Some((number, alarm)) = number.zip(alarm) {
                queue.newest = number;
                queue.waiting.push_back(Entry { alarm, file: Some(file) });
            }
        }
        if !queue.waiting.is_empty() {
            log::info!("{way}: {} alarms of before are told now", queue.waiting.len());
        }
        (way.queue, way.folder) = (Mutex::new(queue), Some(folder));
        way
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells an alarm when its turn comes.
    pub(super) fn put(&self, alarm: &Value) {
        let mut queue = self.queue();
        if queue.waiting.len() >= UNDELIVERED {
            log::warn!("{UNDELIVERED} alarms wait to be delivered; one is not: {}", alarm["text"]);
            return;
        }
        queue.newest += 1;
        let file = self.folder.as_ref().map(|folder| folder.join(format!("{:020}.json", queue.newest)));
        // Where the disk takes nothing it is told all the same, as long as this program runs.
        let file = file.filter(|file| atomic::write(file, alarm.to_string().as_bytes()).is_ok());
        queue.waiting.push_back(Entry { alarm: alarm.clone(), file });
        self.changed.notify_all();
    }

    fn has_ended(&self) -> bool {
        self.running.0.lock().unwrap_or_else(PoisonError::into_inner).1
    }

    /// Ends the program that is being told, with all that it has started: none outlives this one.
    pub(super) fn end(&self) {
        let mut running = self.running.0.lock().unwrap_or_else(PoisonError::into_inner);
        running.1 = true;
        end(running.0.take());
    }

    /// Waits until all is told, at most so long. What is not told then, and whether it is in the store.
    pub(super) fn settle(&self, until: Instant) -> Vec<(Value, bool)> {
        let mut queue = self.queue();
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if queue.waiting.is_empty() || left.is_zero() {
                return queue.waiting.iter().map(|e| (e.alarm.clone(), e.file.is_some())).collect();
            }
            (queue, _) = self.changed.wait_timeout(queue, left).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn work(&self) {
        loop {
            let mut queue = self.queue();
            let Some(alarm) = queue.waiting.front().map(|entry| entry.alarm.clone()) else {
                drop(self.changed.wait(queue));
                continue;
            };
            drop(queue);
            self.deliver(&alarm);
            if self.has_ended() {
                // It waits in the store.
                return;
            }
            queue = self.queue();
            if let Some(file) = queue.waiting.pop_front().and_then(|entry| entry.file)
                && let Err(e) = std::fs::remove_file(&file)
            {
                log::warn!("{}: {e}: this alarm will be told again", file.display());
            }
            self.changed.notify_all();
        }
    }

    fn deliver(&self, alarm: &Value) {
        let text = alarm.to_string();
        let mut wait = AGAIN;
        for attempt in 1..=ATTEMPTS {
            let told = match &self.delivery {
                Delivery::Webhook(url) => post(url, &text),
                Delivery::Command(command) => run(command, &text, PATIENCE, &self.running),
            };
            match told {
                Ok(()) => break,
                Err(_) if self.has_ended() => break,
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

/// Runs a program with a record on its standard input, for so long at most; after that it and all that it has started are ended.
fn run(command: &[String], text: &str, patience: Duration, running: &Running) -> Result<()> {
    let Some((program, arguments)) = command.split_first() else { return Ok(()) };
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::null());
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    // It does not outlive this program where that is interrupted.
    let lock = || running.0.lock().unwrap_or_else(PoisonError::into_inner);
    let started = interrupt::listing(|| {
        let mut running = lock();
        if running.1 {
            return Err(std::io::Error::other("this program ends"));
        }
        let child = command.spawn()?;
        let group = group(&child);
        running.0 = group;
        Ok((child, Box::new(move || end(group)) as Box<dyn FnMut() + Send>))
    });
    let (mut child, listed) = started.with_context(|| format!("cannot start {program}"))?;
    if let Some(mut to) = child.stdin.take() {
        // A program that does not read it may still do its work.
        let _ = writeln!(to, "{text}");
    }
    let begun = Instant::now();
    loop {
        let mut running = lock();
        if let Some(status) = child.try_wait()? {
            running.0 = None;
            drop((running, listed));
            if !status.success() {
                bail!("{program}: {status}");
            }
            return Ok(());
        }
        if begun.elapsed() > patience {
            end(running.0.take());
            child.kill()?;
            child.wait()?;
            bail!(
                "{program}: still at work after {} s, ended with all that it had started",
                patience.as_secs()
            );
        }
        drop(running);
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The process group of a program.
#[cfg(unix)]
fn group(child: &Child) -> Option<Group> {
    rustix::process::Pid::from_raw(child.id() as i32)
}

/// Ends a process group.
#[cfg(unix)]
fn end(group: Option<Group>) {
    if let Some(group) = group {
        // It may have ended by itself.
        let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    }
}

#[cfg(not(unix))]
fn group(_: &Child) -> Option<Group> {
    None
}

#[cfg(not(unix))]
fn end(_: Option<Group>) {}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn told(id: u64) -> Value {
        json!({ "type": "alarm", "id": id, "state": "raised", "text": "x" })
    }

    fn ids(file: &Path) -> Vec<u64> {
        let text = std::fs::read_to_string(file).unwrap_or_default();
        text.lines().filter_map(|l| serde_json::from_str::<Value>(l).ok()?["id"].as_u64()).collect()
    }

    fn soon(seconds: u64) -> Instant {
        Instant::now() + Duration::from_secs(seconds)
    }

    /// A program that keeps what it is told in a file, once the file `go` is there.
    #[cfg(unix)]
    fn keeper(folder: &Path) -> Delivery {
        let script = "while [ ! -e go ]; do sleep 0.02; done; cat >> told";
        let script = format!("cd '{}' && {script}", folder.display());
        Delivery::Command(vec!["sh".into(), "-c".into(), script])
    }

    #[cfg(unix)]
    #[test]
    fn what_is_not_told_at_the_end_is_told_after_the_next_start_in_order() {
        let dir = tempfile::tempdir().unwrap();
        let (store, said) = (dir.path().join("store"), dir.path().join("told"));
        let way = begin(vec![keeper(dir.path())], Some(&store)).remove(0);
        (1..=3).for_each(|id| way.put(&told(id)));
        let left = way.settle(Instant::now());
        assert_eq!(left.iter().map(|(a, kept)| (a["id"].as_u64(), *kept)).collect::<Vec<_>>().len(), 3);
        assert!(left.iter().all(|(_, kept)| *kept) && ids(&said).is_empty());
        // Another program begins with the same store, while this one still waits for its first.
        std::fs::write(dir.path().join("go"), "").unwrap();
        assert!(way.settle(soon(20)).is_empty());
        assert_eq!(ids(&said), [1, 2, 3]);
        std::fs::remove_file(dir.path().join("go")).unwrap();
        (4..=5).for_each(|id| way.put(&told(id)));
        let again = Way::new(keeper(dir.path()), Some(&store.join(FOLDER)));
        let left: Vec<_> = again.settle(Instant::now()).iter().map(|(a, _)| a["id"].as_u64()).collect();
        assert_eq!((left, waiting(&store)), (vec![Some(4), Some(5)], 2));
        again.put(&told(6));
        std::fs::write(dir.path().join("go"), "").unwrap();
        assert!(way.settle(soon(20)).is_empty());
        let last = Way::new(keeper(dir.path()), Some(&store.join(FOLDER)));
        let left: Vec<_> = last.settle(Instant::now()).iter().map(|(a, _)| a["id"].as_u64()).collect();
        assert_eq!(left, [Some(6)], "what was told waits no more");
        // For a delivery that is no more nothing waits.
        assert!(begin(Vec::new(), Some(&store)).is_empty() && paths(&store.join(FOLDER)).is_empty());
    }

    /// Whether a program whose number stands in a file is gone, soon.
    #[cfg(unix)]
    fn is_gone(file: &Path) -> bool {
        let child: i32 = std::fs::read_to_string(file).unwrap().trim().parse().unwrap();
        let child = rustix::process::Pid::from_raw(child).unwrap();
        let begun = Instant::now();
        // It is gone once whoever adopts it has taken note.
        let lives = || {
            let state = std::fs::read_to_string(format!("/proc/{}/stat", child.as_raw_nonzero()));
            let is_dead = state.is_ok_and(|s| s.contains(") Z "));
            !is_dead && rustix::process::test_kill_process(child).is_ok()
        };
        while lives() && begun.elapsed() < Duration::from_secs(5) {
            std::thread::sleep(Duration::from_millis(10));
        }
        !lives()
    }

    #[cfg(unix)]
    #[test]
    fn a_program_is_ended_with_all_that_it_has_started() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("child");
        let script = format!("sleep 300 & echo $! > '{0}.new'; mv '{0}.new' '{0}'; wait", file.display());
        let command = vec!["sh".to_owned(), "-c".to_owned(), script];
        let error =
            run(&command, "{}", Duration::from_millis(500), &Running::default()).unwrap_err().to_string();
        assert!(error.contains("ended with all that it had started"), "{error}");
        assert!(is_gone(&file), "the program's child is alive");
        // At the end of this program it does not wait for that time, and starts no other.
        std::fs::remove_file(&file).unwrap();
        let way = begin(vec![Delivery::Command(command)], Some(dir.path())).remove(0);
        (1..=2).for_each(|id| way.put(&told(id)));
        while !file.exists() {
            std::thread::sleep(Duration::from_millis(5));
        }
        way.end();
        assert!(is_gone(&file), "the program's child is alive");
        std::fs::remove_file(&file).unwrap();
        std::thread::sleep(AGAIN + Duration::from_millis(500));
        assert!(!file.exists(), "another was started");
        assert_eq!(
            way.settle(Instant::now()).iter().filter(|(_, kept)| *kept).count(),
            2,
            "they wait in the store"
        );
    }
}
