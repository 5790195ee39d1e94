//! What a person sees of a base station, and the files it writes besides its store: each in a thread of its own, so that a
//! reader who does not read, or a slow disk, holds up nothing.

use crate::base::export::{self, Format, Positions};
use crate::base::feed::{Behind, Feed, Subscription};
use crate::base::{Base, Recorder};
use crate::plot::result;
use anyhow::{Context, Result, anyhow};
use seabearing_core::wire::{Bearing, Track};
use serde_json::{Value, json};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often the terminal view is drawn.
const DRAW: Duration = Duration::from_millis(250);
/// How often exports are written while telemetry comes in.
const EXPORT: Duration = Duration::from_secs(10);
/// Records that wait for standard output.
const WAITING: usize = 20_000;

/// Standard output: records as JSON Lines, or the view.
pub(super) struct Screen {
    terminal: bool,
    /// Pictures to be printed, unless records are.
    pictures: Option<SyncSender<String>>,
    /// Records that are not printed.
    behind: Option<Behind>,
    complained: bool,
    drawn: Option<Instant>,
    printer: Option<JoinHandle<std::io::Result<()>>>,
}

impl Screen {
    /// Begins to print. `waits`: whoever reads is waited for, as what comes can wait, too.
    pub(super) fn start(json: bool, waits: bool, feed: &Feed) -> Self {
        let (mut pictures, mut behind) = (None, None);
        let printer = if json {
            let records = if waits { feed.subscribe_waiting() } else { feed.subscribe(WAITING) };
            behind = Some(records.behind());
            std::thread::spawn(move || print_records(&records))
        } else {
            let (to_print, coming) = sync_channel::<String>(1);
            pictures = Some(to_print);
            std::thread::spawn(move || coming.into_iter().try_for_each(|picture| print(&picture)))
        };
        let terminal = std::io::stdout().is_terminal();
        Self { terminal, pictures, behind, complained: false, drawn: None, printer: Some(printer) }
    }

    /// Looks whether all is printed, and draws the view on a terminal, now and then.
    pub(super) fn look(&mut self, view: impl FnOnce() -> String) -> Result<()> {
        if self.printer.as_ref().is_some_and(JoinHandle::is_finished) {
            return self.printed();
        }
        let behind = self.behind.as_ref().is_some_and(|b| b.missed() > 0);
        if behind && !self.complained {
            eprintln!(
                "seabearing: standard output is read too slowly; records are stored, and not all shown"
            );
        }
        self.complained = behind;
        if let Some(pictures) = &self.pictures
            && self.terminal
            && self.drawn.is_none_or(|d| d.elapsed() >= DRAW)
        {
            self.drawn = Some(Instant::now());
            // Of a terminal that is still being drawn on one picture is left out.
            let _ = pictures.try_send(drawn(&view()));
        }
        Ok(())
    }

    /// Waits for the printer, and says how it ended.
    fn printed(&mut self) -> Result<()> {
        self.pictures = None;
        match self.printer.take().map(JoinHandle::join) {
            Some(Ok(ended)) => Ok(ended?),
            Some(Err(_)) => Err(anyhow!("the printer of records has failed")),
            None => Ok(()),
        }
    }

    /// Prints the view a last time and waits until all is printed; the feed has ended.
    pub(super) fn finish(&mut self, view: &str) -> Result<()> {
        if let Some(pictures) = &self.pictures {
            // A printer that has ended says so itself.
            let _ = pictures.send(if self.terminal { drawn(view) } else { view.to_owned() });
        }
        self.printed()
    }
}

/// Home, draw, and clear what is left of the picture before.
fn drawn(text: &str) -> String {
    format!("\x1b[H{}\x1b[J", text.replace('\n', "\x1b[K\n"))
}

fn print(text: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.flush()
}

/// Records as JSON Lines, and how many were left out between them.
fn print_records(records: &Subscription) -> std::io::Result<()> {
    while let Some(taken) = records.take() {
        let gap = json!({ "type": "not_shown", "records": taken.missed });
        let gap = (taken.missed > 0).then_some(&gap);
        let lines: String = gap.into_iter().chain(taken.records.iter()).map(|r| format!("{r}\n")).collect();
        print(&lines)?;
    }
    Ok(())
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
        let mut exports = Self { files, plots, places, jobs: None, last: Instant::now() };
        if !exports.files.is_empty() || exports.plots.is_some() {
            exports.jobs = Some(exports.writer());
        }
        exports
    }

    /// The thread that writes. It takes a job when it has written the one before.
    fn writer(&self) -> SyncSender<Job> {
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
    }

    fn job(&self, base: &Base) -> Job {
        let pictured =
            if self.plots.is_some() { base.recorders().map(pictured).collect() } else { Vec::new() };
        let tracks = if self.files.is_empty() { Vec::new() } else { base.track_records() };
        Job { tracks, pictured }
    }

    /// Writes the files while telemetry comes in, if it is time and the last ones are written.
    pub(super) fn now_and_then(&mut self, base: &Base) {
        if self.last.elapsed() < EXPORT {
            return;
        }
        self.last = Instant::now();
        if let Some(jobs) = &self.jobs {
            // Whoever still writes is not waited for.
            let _ = jobs.try_send(self.job(base));
        }
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
