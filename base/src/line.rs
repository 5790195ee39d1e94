//! Lines, each in a thread of its own: opened, read, and opened again where they were lost; none waits for another.
//!
//! What happens on them comes through one bounded channel. A line that brings more than is taken waits, and with it the
//! other end; what is to be said goes through a queue of each connection, and is dropped where that is full, because a link
//! says it again.

use super::Beginning;
use super::origin::Origin;
use super::record::micros;
use super::store::{Entry, Event};
use anyhow::{Context, Error, Result};
use seabearing_core::wire::link::Settings;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// How long a read waits at most.
const PATIENCE: Duration = Duration::from_millis(200);
/// How often a listener is asked for calls.
const CALLS: Duration = Duration::from_millis(20);
/// Time between attempts to open a line again: at first, and at most.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// Bytes of one read.
const READ: usize = 1 << 14;
/// Reports that wait to be taken.
const WAITING: usize = 256;
/// Frames of one connection that wait to be sent.
const FRAMES: usize = 64;
/// Connections at once.
const CONNECTIONS: usize = 1000;
/// Time in which a peer must take what is sent.
const STALLED: Duration = Duration::from_secs(30);

/// A line and how to use it.
#[derive(Clone, Debug)]
pub struct Line {
    /// Where.
    pub origin: Origin,
    /// The station it belongs to, where that was said.
    pub station: Option<u16>,
    /// Its speed and kind.
    pub settings: Settings,
    /// It is not opened again after its end.
    pub once: bool,
}

/// What the threads report.
#[derive(Debug)]
pub enum Report {
    /// Something happened on a connection; with its beginning comes the way to answer, and the number of its line.
    Happened(Entry, Option<(Answers, usize)>),
    /// Records of other base stations have come; whoever brought them is told when they are stored.
    Relayed(Entry, Stored),
    /// Something that a person should know.
    Note(String),
    /// A line has come to its end.
    Finished,
    /// A line cannot be read, and it makes no sense to try again.
    Failed(Error),
}

/// Tells that what came is stored.
pub struct Stored(pub Box<dyn FnOnce() + Send>);

impl std::fmt::Debug for Stored {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Stored")
    }
}

/// The way back to the other end of a connection.
#[derive(Clone, Debug)]
pub struct Answers {
    frames: SyncSender<Vec<u8>>,
    closed: Arc<AtomicBool>,
}

impl Answers {
    /// Says a frame; one that finds no room is lost, as on a line.
    pub fn say(&self, frame: &[u8]) {
        let _ = self.frames.try_send(frame.to_vec());
    }

    /// Closes the connection.
    pub fn close(&self) {
        self.closed.store(true, Ordering::Relaxed);
    }
}

/// What the threads of all lines share.
#[derive(Clone)]
struct Shared {
    reports: SyncSender<Report>,
    streams: Arc<AtomicU32>,
    connections: Arc<AtomicUsize>,
    idle: Duration,
}

impl Shared {
    /// Reports; false once nobody listens any more.
    fn happened(&self, stream: u32, event: Event, answers: Option<(Answers, usize)>) -> bool {
        let received_us = Some(micros(time::OffsetDateTime::now_utc()));
        self.reports.send(Report::Happened(Entry { stream, received_us, event }, answers)).is_ok()
    }
}

/// Lines at work.
pub struct Lines {
    /// What happens.
    pub reports: Receiver<Report>,
    /// For what comes by other ways than lines; to be dropped once they have theirs.
    pub door: Option<SyncSender<Report>>,
    /// The addresses listened at; a port may have been chosen by the system.
    pub listening: Vec<std::net::SocketAddr>,
    /// While this is here listeners go on.
    _streams: Arc<AtomicU32>,
}

/// Starts a thread for each line. Connections are numbered from `first_stream` on. After `idle` without a byte a line is
/// reported silent, and a TCP connection is closed.
///
/// # Errors
/// A file cannot be read, a port not be listened at, or, of a line that is to be used once, it cannot be opened.
pub fn start(lines: &[Line], first_stream: u32, idle: Duration) -> Result<Lines> {
    let (reports, receiver) = sync_channel(WAITING);
    let shared = Shared {
        reports,
        streams: Arc::new(AtomicU32::new(first_stream)),
        connections: Arc::default(),
        idle,
    };
    let (alive, door) = (Arc::clone(&shared.streams), Some(shared.reports.clone()));
    let mut listening = Vec::new();
    let mut ports: Vec<&str> = Vec::new();
    for (n, line) in lines.iter().enumerate() {
        let (shared, line) = (shared.clone(), line.clone());
        match &line.origin {
            Origin::Listen(at) => {
                // Several stations may call at one port.
                if ports.contains(&at.as_str()) {
                    let _ = shared.reports.try_send(Report::Finished);
                    continue;
                }
                ports.extend(lines.iter().filter_map(|l| match &l.origin {
                    Origin::Listen(other) if other == at => Some(other.as_str()),
                    _ => None,
                }));
                let shares = lines.iter().filter(|l| l.origin == line.origin).count() > 1;
                let line = if shares { Line { station: None, ..line } } else { line };
                let Origin::Listen(at) = &line.origin else { continue };
                let listener = TcpListener::bind(at).with_context(|| {
                    format!("cannot listen at {at}: address:port of this machine expected, which no other program uses")
                })?;
                listener.set_nonblocking(true).with_context(|| format!("cannot listen at {at}"))?;
                listening.extend(listener.local_addr().ok());
                std::thread::spawn(move || accept(&listener, n, &line, &shared));
            }
            Origin::File { .. } | Origin::Stdin => {
                let file = open_file(&line.origin)?;
                std::thread::spawn(move || {
                    let _ = shared.reports.send(match follow(file, n, &line, &shared) {
                        Ok(()) => Report::Finished,
                        Err(e) => Report::Failed(e),
                    });
                });
            }
            Origin::Serial { .. } | Origin::Connect(_) => {
                let first = if line.once { Some(connect(&line.origin)?) } else { None };
                std::thread::spawn(move || call(first, n, &line, &shared));
            }
        }
    }
    Ok(Lines { reports: receiver, door, listening, _streams: alive })
}

fn open_file(origin: &Origin) -> Result<Box<dyn Read + Send>> {
    Ok(match origin {
        Origin::File { path, .. } => {
            Box::new(std::fs::File::open(path).with_context(|| format!("cannot read {}", path.display()))?)
        }
        _ => Box::new(std::io::stdin()),
    })
}

/// Reads a file to its end, or for ever.
fn follow(mut file: Box<dyn Read + Send>, n: usize, line: &Line, shared: &Shared) -> Result<()> {
    let stream = shared.streams.fetch_add(1, Ordering::Relaxed);
    let beginning =
        Beginning { line: line.origin.to_string(), station: line.station, peer: None, lasting: false };
    let (frames, _nowhere) = sync_channel(1);
    let answers = Answers { frames, closed: Arc::default() };
    if !shared.happened(stream, Event::Began(beginning), Some((answers, n))) {
        return Ok(());
    }
    let mut buffer = vec![0; READ];
    loop {
        match file.read(&mut buffer) {
            Ok(0) if line.origin.ends() || line.once => break,
            Ok(0) => std::thread::sleep(PATIENCE),
            Ok(n) => {
                if !shared.happened(stream, Event::Bytes(buffer[..n].to_vec()), None) {
                    return Ok(());
                }
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => return Err(e).with_context(|| format!("cannot read {}", line.origin)),
        }
    }
    shared.happened(stream, Event::Ended(None), None);
    Ok(())
}

/// A connection: what is read and, in another thread, written.
struct Wire {
    read: Box<dyn Read + Send>,
    write: Box<dyn Write + Send>,
    /// It can be closed and made again when the other end is silent.
    calls: bool,
}

fn connect(origin: &Origin) -> Result<Wire> {
    match origin {
        Origin::Serial { device, baud } => {
            let port = serialport::new(device, *baud).timeout(PATIENCE).open().with_context(|| {
                format!("cannot open serial device {device}: is it connected, and may you use it?")
            })?;
            let write = port.try_clone().with_context(|| format!("cannot use serial device {device}"))?;
            Ok(Wire { read: Box::new(port), write: Box::new(write), calls: false })
        }
        Origin::Connect(to) => {
            let stream = TcpStream::connect(to).with_context(|| {
                format!("cannot connect to {to}: host:port of a running recorder expected")
            })?;
            tcp(stream).with_context(|| format!("cannot use {to}"))
        }
        _ => anyhow::bail!("{origin} is no line that is called"),
    }
}

fn tcp(stream: TcpStream) -> std::io::Result<Wire> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(STALLED))?;
    stream.set_nodelay(true)?;
    let probes = socket2::TcpKeepalive::new()
        .with_time(Duration::from_secs(30))
        .with_interval(Duration::from_secs(10));
    socket2::SockRef::from(&stream).set_tcp_keepalive(&probes)?;
    let write = Box::new(stream.try_clone()?);
    Ok(Wire { read: Box::new(stream), write, calls: true })
}

/// Takes calls, any number at once.
fn accept(listener: &TcpListener, n: usize, line: &Line, shared: &Shared) {
    let mut full = false;
    loop {
        match listener.accept() {
            Ok((stream, peer)) => {
                if shared.connections.fetch_add(1, Ordering::Relaxed) >= CONNECTIONS {
                    shared.connections.fetch_sub(1, Ordering::Relaxed);
                    let note =
                        format!("{}: more than {CONNECTIONS} connections; {peer} is refused", line.origin);
                    if !std::mem::replace(&mut full, true) && shared.reports.send(Report::Note(note)).is_err()
                    {
                        return;
                    }
                    continue;
                }
                full = false;
                let (once, line, mine) = (line.once, line.clone(), shared.clone());
                let serves = std::thread::Builder::new().stack_size(1 << 18).spawn(move || {
                    if let Ok(wire) = tcp(stream) {
                        serve(wire, Some(peer.to_string()), n, &line, &mine);
                    }
                    mine.connections.fetch_sub(1, Ordering::Relaxed);
                    if line.once {
                        let _ = mine.reports.send(Report::Finished);
                    }
                });
                if serves.is_err() {
                    shared.connections.fetch_sub(1, Ordering::Relaxed);
                } else if once {
                    return;
                }
            }
            Err(e) if e.kind() == ErrorKind::WouldBlock => {
                std::thread::sleep(CALLS);
                // Nobody takes reports any more.
                if Arc::strong_count(&shared.streams) == 1 {
                    return;
                }
            }
            // Out of descriptors, or the caller has gone again.
            Err(_) => std::thread::sleep(PATIENCE),
        }
    }
}

/// Opens a line, serves it, and opens it again, later and later while that fails.
fn call(first: Option<Wire>, n: usize, line: &Line, shared: &Shared) {
    let mut wait = RETRY.0;
    let (mut complained, mut down) = (false, false);
    let mut next = first.map(Ok);
    loop {
        match next.take().unwrap_or_else(|| connect(&line.origin)) {
            Ok(wire) => {
                if std::mem::take(&mut complained) {
                    let note = Report::Note(format!("{}: open again", line.origin));
                    if shared.reports.send(note).is_err() {
                        return;
                    }
                }
                if serve(wire, None, n, line, shared) {
                    wait = RETRY.0;
                }
                down = true;
            }
            Err(e) if !std::mem::replace(&mut complained, true) => {
                let why = format!("{e:#}");
                let note = Report::Note(format!("{why}; it is tried again"));
                if shared.reports.send(note).is_err() {
                    return;
                }
                if !std::mem::replace(&mut down, true) {
                    let stream = shared.streams.fetch_add(1, Ordering::Relaxed);
                    shared.happened(stream, Event::Began(beginning(line, None)), None);
                    shared.happened(stream, Event::Ended(Some(why)), None);
                }
            }
            Err(_) => {}
        }
        if line.once {
            let _ = shared.reports.send(Report::Finished);
            return;
        }
        std::thread::sleep(wait);
        wait = (wait * 2).min(RETRY.1);
    }
}

fn beginning(line: &Line, peer: Option<String>) -> Beginning {
    Beginning { line: line.origin.to_string(), peer, station: line.station, lasting: true }
}

/// Reads a connection to its end; true if anything came.
fn serve(wire: Wire, peer: Option<String>, n: usize, line: &Line, shared: &Shared) -> bool {
    let stream = shared.streams.fetch_add(1, Ordering::Relaxed);
    let (frames, waiting) = sync_channel::<Vec<u8>>(FRAMES);
    let closed = Arc::new(AtomicBool::new(false));
    let answers = Answers { frames, closed: Arc::clone(&closed) };
    let (mut read, mut write) = (wire.read, wire.write);
    let stalled = Arc::clone(&closed);
    let writes = std::thread::Builder::new().stack_size(1 << 18).spawn(move || {
        for frame in waiting {
            if write.write_all(&frame).and_then(|()| write.flush()).is_err() {
                stalled.store(true, Ordering::Relaxed);
                return;
            }
        }
    });
    if writes.is_err() || !shared.happened(stream, Event::Began(beginning(line, peer)), Some((answers, n))) {
        return false;
    }
    let (mut buffer, mut last, mut any, mut silent) = (vec![0; READ], Instant::now(), false, false);
    let why = loop {
        if closed.load(Ordering::Relaxed) {
            break Some("closed by the base station".to_owned());
        }
        match read.read(&mut buffer) {
            Ok(n) if n > 0 => {
                (last, any, silent) = (Instant::now(), true, false);
                if !shared.happened(stream, Event::Bytes(buffer[..n].to_vec()), None) {
                    return any;
                }
            }
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
                ) =>
            {
                if last.elapsed() > shared.idle && !std::mem::replace(&mut silent, true) {
                    if !shared.happened(stream, Event::Silent, None) {
                        return any;
                    }
                    if wire.calls {
                        break Some(format!("silent for {} s", shared.idle.as_secs()));
                    }
                }
            }
            Ok(_) => break None,
            Err(e) => break Some(e.to_string()),
        }
    };
    shared.happened(stream, Event::Ended(why), None);
    any
}
