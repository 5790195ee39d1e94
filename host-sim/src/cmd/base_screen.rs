//! What a person sees of a base station, and the files it writes besides its store: each in a thread of its own, so that a
//! reader who does not read, or a slow disk, holds up nothing.

use crate::base::export::{self, Format, Positions};
use crate::base::{Base, Recorder};
use crate::plot::result;
use anyhow::{Context, Result, anyhow};
use seabearing_core::wire::{Bearing, Track};
use serde_json::{Value, json};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often the terminal view is drawn.
const DRAW: Duration = Duration::from_millis(250);
/// How often exports are written while telemetry comes in.
const EXPORT: Duration = Duration::from_secs(10);
/// Records that wait for standard output.
const WAITING: usize = 20_000;

/// Standard output.
pub(super) struct Screen {
    json: bool,
    /// Whoever reads is waited for: what comes can wait, too.
    waits: bool,
    terminal: bool,
    texts: Option<SyncSender<(usize, String)>>,
    /// Records that wait.
    waiting: Arc<AtomicUsize>,
    /// Records that found no room.
    not_shown: usize,
    drawn: Option<Instant>,
    printer: Option<JoinHandle<std::io::Result<()>>>,
}

impl Screen {
    /// Begins to print.
    pub(super) fn start(json: bool, waits: bool) -> Self {
        let (texts, coming) = sync_channel::<(usize, String)>(if waits { 16 } else { WAITING });
        let waiting = Arc::new(AtomicUsize::new(0));
        let taken = Arc::clone(&waiting);
        let printer = std::thread::spawn(move || {
            let mut out = std::io::stdout().lock();
            for (records, text) in coming {
                out.write_all(text.as_bytes())?;
                out.flush()?;
                taken.fetch_sub(records, Ordering::Relaxed);
            }
            Ok(())
        });
        Self {
            json,
            waits,
            terminal: std::io::stdout().is_terminal(),
            texts: Some(texts),
            waiting,
            not_shown: 0,
            drawn: None,
            printer: Some(printer),
        }
    }

    /// Prints records as JSON Lines, if that is asked for. Those for which there is no room are counted.
    pub(super) fn records(&mut self, count: usize, lines: impl FnOnce() -> String) -> Result<()> {
        if !self.json || self.texts.is_none() || count + self.not_shown == 0 {
            return Ok(());
        }
        let waiting = self.waiting.load(Ordering::Relaxed);
        if !self.waits && waiting > 0 && waiting + count > WAITING {
            if self.not_shown == 0 {
                eprintln!(
                    "seabearing: standard output is read too slowly; records are stored, and not all shown"
                );
            }
            self.not_shown += count;
            return Ok(());
        }
        let mut text = lines();
        if self.not_shown > 0 {
            let gap = json!({ "type": "not_shown", "records": self.not_shown });
            text = format!("{gap}\n{text}");
            self.not_shown = 0;
        }
        self.put(count, text)
    }

    /// Draws the view on a terminal, now and then.
    pub(super) fn picture(&mut self, text: impl FnOnce() -> String) -> Result<()> {
        if self.json || !self.terminal || self.drawn.is_some_and(|d| d.elapsed() < DRAW) {
            return Ok(());
        }
        self.drawn = Some(Instant::now());
        let picture = Self::drawn(&text());
        self.put(0, picture)
    }

    /// Home, draw, and clear what is left of the picture before.
    fn drawn(text: &str) -> String {
        format!("\x1b[H{}\x1b[J", text.replace('\n', "\x1b[K\n"))
    }

    fn put(&mut self, count: usize, text: String) -> Result<()> {
        let Some(texts) = &self.texts else { return Ok(()) };
        self.waiting.fetch_add(count, Ordering::Relaxed);
        let gone = if self.waits {
            texts.send((count, text)).is_err()
        } else {
            match texts.try_send((count, text)) {
                Err(TrySendError::Full(_)) => {
                    self.waiting.fetch_sub(count, Ordering::Relaxed);
                    self.not_shown += count;
                    false
                }
                sent => sent.is_err(),
            }
        };
        if gone { self.printed() } else { Ok(()) }
    }

    /// Waits for the printer, and says how it ended.
    fn printed(&mut self) -> Result<()> {
        self.texts = None;
        match self.printer.take().map(JoinHandle::join) {
            Some(Ok(ended)) => Ok(ended?),
            Some(Err(_)) => Err(anyhow!("the printer of records has failed")),
            None => Ok(()),
        }
    }

    /// Prints nothing any more.
    pub(super) fn give_up(&mut self) {
        self.texts = None;
    }

    /// Prints the view a last time and waits until all is printed.
    pub(super) fn finish(&mut self, view: &str) -> Result<()> {
        if !self.json && self.texts.is_some() {
            let text = if self.terminal { Self::drawn(view) } else { view.to_owned() };
            self.waits = true;
            self.put(0, text)?;
        }
        self.printed()
    }
}

/// What is drawn of a recorder.
struct Pictured {
    name: Option<u16>,
    rate_hz: f64,
    bearings: Vec<Bearing>,
    tracks: Vec<Track>,
}

/// All that files are made of.
struct Job {
    tracks: Vec<Value>,
    pictured: Vec<Pictured>,
}

/// The files besides the store.
pub(super) struct Exports {
    files: Vec<PathBuf>,
    plots: Option<PathBuf>,
    places: Positions,
    jobs: Option<SyncSender<Job>>,
    last: Instant,
}

impl Exports {
    /// Nothing is written yet.
    pub(super) fn start(files: Vec<PathBuf>, plots: Option<PathBuf>, places: Positions) -> Self {
        Self { files, plots, places, jobs: None, last: Instant::now() }
    }

    fn job(&self, base: &Base) -> Job {
        let pictured =
            if self.plots.is_some() { base.recorders().map(pictured).collect() } else { Vec::new() };
        let tracks = if self.files.is_empty() { Vec::new() } else { base.track_records() };
        Job { tracks, pictured }
    }

    /// Writes the files while telemetry comes in, if it is time and the last ones are written.
    pub(super) fn now_and_then(&mut self, base: &Base) {
        if self.last.elapsed() < EXPORT || (self.files.is_empty() && self.plots.is_none()) {
            return;
        }
        self.last = Instant::now();
        let jobs = self.jobs.get_or_insert_with(|| {
            let (files, plots, places) = (self.files.clone(), self.plots.clone(), self.places.clone());
            let (jobs, coming) = sync_channel::<Job>(0);
            std::thread::spawn(move || {
                let mut complained = String::new();
                for job in coming {
                    let said = write(&job, &files, plots.as_deref(), &places)
                        .err()
                        .map_or(String::new(), |e| format!("seabearing: {e:#}; it is tried again"));
                    if !said.is_empty() && said != complained {
                        eprintln!("{said}");
                    }
                    complained = said;
                }
            });
            jobs
        });
        // Whoever still writes is not waited for.
        let jobs = jobs.clone();
        let _ = jobs.try_send(self.job(base));
    }

    /// Writes the files a last time.
    pub(super) fn finish(&mut self, base: &Base) -> Result<()> {
        self.jobs = None;
        write(&self.job(base), &self.files, self.plots.as_deref(), &self.places)
    }
}

fn write(job: &Job, files: &[PathBuf], plots: Option<&Path>, places: &Positions) -> Result<()> {
    for path in files {
        export::write(path, Format::of(path)?, &job.tracks, places)?;
    }
    let Some(folder) = plots else { return Ok(()) };
    for recorder in &job.pictured {
        let into = match recorder.name {
            Some(name) if job.pictured.len() > 1 => folder.join(format!("station-{name}")),
            _ => folder.to_owned(),
        };
        pictures(recorder, &into).with_context(|| format!("cannot plot into {}", into.display()))?;
    }
    Ok(())
}

/// Bearings and tracks of a recorder's last session.
fn pictured(recorder: &Recorder) -> Pictured {
    let session = recorder.session().unwrap_or(0);
    Pictured {
        name: recorder.station,
        rate_hz: recorder.rate_hz(session).unwrap_or(f64::NAN),
        bearings: recorder.bearings().filter(|(s, _)| *s == session).map(|(_, b)| *b).collect(),
        tracks: recorder.tracks().filter(|((s, _), _)| *s == session).flat_map(|(_, t)| t).copied().collect(),
    }
}

/// Bearings against time, and tracks on a map.
fn pictures(recorder: &Pictured, folder: &Path) -> Result<()> {
    result::bearings(&recorder.bearings, recorder.rate_hz, &[]).write(&folder.join("bearings.svg"))?;
    result::tracks(&recorder.tracks, recorder.rate_hz, &[]).write(&folder.join("tracks.svg"))
}
