//! What a person sees of a base station, and the files it writes besides its store: each in a thread of its own, so that a
//! reader who does not read, or a slow disk, holds up nothing.

use crate::base::export::{self, Format, Positions};
use crate::base::feed::{Behind, Subscription};
#[cfg(feature = "terminal")]
use crate::base::record::micros;
use crate::base::service::Service;
use crate::base::stations::Listed;
use crate::base::{Base, Recorder};
use crate::plot::result::Pictures;
use crate::plot::times::Times;
use anyhow::{Context, Result, anyhow};
use seabearing_core::wire::{Bearing, Track};
use serde_json::{Value, json};
#[cfg(feature = "terminal")]
use std::io::IsTerminal;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use time::OffsetDateTime;

/// How often exports are written while telemetry comes in.
const EXPORT: Duration = Duration::from_secs(10);
/// How often it is seen whether all is printed.
const LOOK: Duration = Duration::from_millis(10);
/// Records that wait for standard output.
const WAITING: usize = 20_000;

/// Standard output: records as JSON Lines, the live view of a terminal, or at the end what is known.
pub(super) struct Screen {
    shows: Shows,
    /// Records that are not printed.
    behind: Option<Behind>,
    complained: bool,
}

/// What is on standard output.
enum Shows {
    Records(Option<JoinHandle<std::io::Result<()>>>),
    #[cfg(feature = "terminal")]
    Live(seabearing_watch::terminal::View),
    /// Nothing until the end.
    Last,
}

impl Screen {
    /// Begins to print. `waits`: whoever reads is waited for, as what comes can wait, too. `live`: on a terminal what comes is
    /// shown as it comes.
    pub(super) fn start(json: bool, waits: bool, service: &Service, known: Known<'_>) -> Self {
        let mut behind = None;
        let shows = if json {
            let records =
                if waits { service.feed().subscribe_waiting() } else { service.feed().subscribe(WAITING) };
            behind = Some(records.behind());
            Shows::Records(Some(std::thread::spawn(move || print_records(&records))))
        } else {
            known.show(waits, service)
        };
        Self { shows, behind, complained: false }
    }

    /// Whether nothing is shown any more of what comes.
    fn has_ended(&self) -> bool {
        match &self.shows {
            Shows::Records(printer) => printer.as_ref().is_some_and(JoinHandle::is_finished),
            #[cfg(feature = "terminal")]
            Shows::Live(view) => view.is_finished(),
            Shows::Last => false,
        }
    }

    /// Looks whether what is shown gets through.
    pub(super) fn look(&mut self) -> Result<()> {
        if self.has_ended() {
            return self.printed();
        }
        let behind = self.behind.as_ref().is_some_and(|b| b.missed() > 0);
        if behind && !self.complained {
            log::warn!("standard output is read too slowly; records are stored, and not all shown");
        }
        self.complained = behind;
        Ok(())
    }

    /// Waits until all is printed, and says how that ended.
    fn printed(&mut self) -> Result<()> {
        match &mut self.shows {
            Shows::Records(printer) => match printer.take().map(JoinHandle::join) {
                Some(Ok(ended)) => Ok(ended?),
                Some(Err(_)) => Err(anyhow!("the printer of records has failed")),
                None => Ok(()),
            },
            #[cfg(feature = "terminal")]
            Shows::Live(view) => view.end(),
            Shows::Last => Ok(()),
        }
    }

    /// Waits until all is printed, at most so long, and prints what is known where records are not; the feed has ended.
    pub(super) fn finish(&mut self, view: &str, most: Option<Duration>) -> Result<()> {
        let begun = Instant::now();
        while let (Some(most), Shows::Records(Some(_)), false) = (most, &self.shows, self.has_ended()) {
            if begun.elapsed() >= most {
                return Ok(());
            }
            std::thread::sleep(LOOK);
        }
        self.printed()?;
        match self.shows {
            Shows::Records(_) => Ok(()),
            _ => Ok(print(view)?),
        }
    }
}

/// What is known before records come.
#[cfg_attr(not(feature = "terminal"), expect(dead_code, reason = "only the live view begins with it"))]
pub(super) struct Known<'a> {
    /// Stations of the stations file.
    pub listed: &'a [Listed],
    /// Alarms that may stand, oldest first.
    pub alarms: &'a [Value],
    /// The terminal's keys are telemetry.
    pub reads_keys: bool,
}

impl Known<'_> {
    /// The live view, where there is somebody to look at it while records come.
    #[cfg(feature = "terminal")]
    fn show(&self, ends: bool, service: &Service) -> Shows {
        use seabearing_watch::terminal::{View, board::Board};
        if ends || self.reads_keys || !std::io::stdout().is_terminal() {
            return Shows::Last;
        }
        let mut board = Board::default();
        self.listed.iter().for_each(|s| board.expect(s.config.id, &s.config.name));
        let now_us = micros(OffsetDateTime::now_utc());
        for recorder in service.base().recorders() {
            let heard_s = recorder.heard_us.map(|us| (us - now_us) as f64 * 1e-6);
            heard_s.into_iter().for_each(|s| board.was_heard(recorder.station, s));
        }
        self.alarms.iter().for_each(|alarm| drop(board.take(alarm, 0.0)));
        Shows::Live(View::start(board, service.feed()))
    }

    #[cfg(not(feature = "terminal"))]
    fn show(&self, _: bool, _: &Service) -> Shows {
        Shows::Last
    }
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
    /// UTC of sample 0 as of the last bearing, where the clock is known.
    start: Option<OffsetDateTime>,
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
    /// The thread that writes, and the way to it.
    jobs: Option<(SyncSender<Job>, JoinHandle<()>)>,
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
    fn writer(&self) -> (SyncSender<Job>, JoinHandle<()>) {
        let (files, plots, places) = (self.files.clone(), self.plots.clone(), self.places.clone());
        let (jobs, coming) = sync_channel::<Job>(0);
        let writer = std::thread::spawn(move || {
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
        (jobs, writer)
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
        if let Some((jobs, _)) = &self.jobs {
            // Whoever still writes is not waited for.
            let _ = jobs.try_send(self.job(base));
        }
    }

    /// Writes the files a last time.
    pub(super) fn finish(&mut self, base: &Base) -> Result<()> {
        if let Some((jobs, writer)) = self.jobs.take() {
            // What it still writes is older, and must not take the place of what is written now.
            drop(jobs);
            let _ = writer.join();
        }
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
    let rate_hz = recorder.rate_hz(session).unwrap_or(f64::NAN);
    let bearings: Vec<Bearing> =
        recorder.bearings().filter(|(s, _)| *s == session).map(|(_, b)| *b).collect();
    let last = bearings.last().map_or(0, |b| b.index);
    let start = recorder.utc_us(session, last).and_then(|us| {
        let began_us = us as f64 - last as f64 / rate_hz * 1e6;
        OffsetDateTime::from_unix_timestamp_nanos((began_us as i128).checked_mul(1000)?).ok()
    });
    Pictured {
        name: recorder.station,
        rate_hz,
        start,
        bearings,
        tracks: recorder.tracks().filter(|((s, _), _)| *s == session).flat_map(|(_, t)| t).copied().collect(),
    }
}

/// Bearings against time, and tracks on a map.
fn pictures(recorder: &Pictured, folder: &Path) -> Result<()> {
    let longest_s = recorder.bearings.last().map_or(0.0, |b| b.index as f64 / recorder.rate_hz);
    let times = Times::new(recorder.start, longest_s);
    let drawn = Pictures::new(
        &recorder.bearings,
        &recorder.tracks,
        recorder.rate_hz,
        &times,
        &[],
        &recorder.name.map_or(String::new(), |name| name.to_string()),
    );
    drawn.azimuths.write(&folder.join("bearings.svg"))?;
    drawn.tracks.write(&folder.join("tracks.svg"))
}
