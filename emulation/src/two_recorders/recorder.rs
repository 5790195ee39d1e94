//! A recorder under QEMU with its sea, its converter and its line, in real time.

use super::PATIENCE;
use crate::beside::Beside;
use crate::emulator::{Board, Emulator, RETAINED, SAMPLES};
use crate::twin::write_block;
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::block::{Block, Frame};
use seabearing_core::sbraw;
use std::fs::File;
use std::io::{BufWriter, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Samples that the converter hands over at a time: 20 ms.
const TOGETHER: usize = 1280;
/// Longest wait for bytes of either end of the line.
const LOOK: Duration = Duration::from_millis(3);
/// Delay beyond which a converter's samples are lost.
const LATE: Duration = Duration::from_millis(200);
/// Time between two calls of the base station.
const CALL: Duration = Duration::from_millis(300);

/// What the threads of a recorder share.
#[derive(Default)]
struct Shared {
    /// Where samples go while there is power.
    session: Mutex<Option<Session>>,
    /// The recorder's end of the line while there is power.
    line: Mutex<Option<UnixStream>>,
    pulled: AtomicBool,
    over: AtomicBool,
}

/// The samples between a start and the end of the power.
struct Session {
    fifo: BufWriter<File>,
    /// The same once more, for the twin.
    kept: BufWriter<File>,
    /// The first one's place in the sea's time.
    first: Option<u64>,
}

/// A recorder.
pub struct Recorder {
    emulator: Emulator,
    blob: Vec<u8>,
    folder: PathBuf,
    rate_hz: f64,
    shared: Arc<Shared>,
    board: Option<Board>,
    /// Of every session: its samples in a file, and the place of the first.
    sessions: Vec<(PathBuf, u64)>,
    sea: JoinHandle<Result<u64>>,
    relay: JoinHandle<()>,
}

/// What is left of a recorder that has ended.
pub struct Ended {
    /// Its configuration.
    pub blob: Vec<u8>,
    /// Samples a second.
    pub rate_hz: f64,
    /// The memory that survives.
    pub retained: PathBuf,
    /// Of every session: its samples in a file, and the place of the first.
    pub sessions: Vec<(PathBuf, u64)>,
    /// Samples lost because the board was late.
    pub lost: u64,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Recorder {
    /// Switches it on; the sea's time began at `begun`.
    pub fn start(
        emulator: &Emulator,
        (blob, rate_hz): (Vec<u8>, f64),
        sea: Vec<Frame>,
        folder: PathBuf,
        base: &str,
        begun: Instant,
    ) -> Result<Self> {
        let shared = Arc::new(Shared::default());
        let of_sea = Arc::clone(&shared);
        let sea = std::thread::spawn(move || convert(&sea, rate_hz, begun, &of_sea));
        let (of_line, base) = (Arc::clone(&shared), base.to_owned());
        let relay = std::thread::spawn(move || relay(&of_line, &base));
        let emulator = emulator.clone();
        let mut recorder =
            Self { emulator, blob, folder, rate_hz, shared, board: None, sessions: Vec::new(), sea, relay };
        recorder.power_on()?;
        Ok(recorder)
    }

    /// Its line is pulled, or plugged in.
    pub fn pull(&self, pulled: bool) {
        self.shared.pulled.store(pulled, Ordering::Relaxed);
    }

    /// Its power goes, whatever it is doing.
    pub fn power_off(&mut self) {
        self.board = None;
        *locked(&self.shared.line) = None;
        self.close_session();
    }

    /// Notes where the session of the samples began; its files are closed.
    fn close_session(&mut self) {
        if let Some(session) = locked(&self.shared.session).take()
            && let Some(last) = self.sessions.last_mut()
        {
            last.1 = session.first.unwrap_or(0);
        }
    }

    /// It starts.
    pub fn power_on(&mut self) -> Result<()> {
        let board = self.emulator.power_on(&self.folder, &self.blob, true)?;
        board.telemetry.set_read_timeout(Some(LOOK))?;
        board.telemetry.set_write_timeout(Some(Duration::from_secs(1)))?;
        *locked(&self.shared.line) = Some(board.telemetry.try_clone()?);
        let kept = self.folder.join(format!("session-{}.sbraw", self.sessions.len() + 1));
        // Waits until the firmware reads.
        let fifo =
            File::options().write(true).open(self.folder.join(SAMPLES)).context("the samples' FIFO")?;
        let mut session =
            Session { fifo: BufWriter::new(fifo), kept: BufWriter::new(File::create(&kept)?), first: None };
        session.fifo.write_all(&sbraw::MAGIC)?;
        session.kept.write_all(&sbraw::MAGIC)?;
        self.sessions.push((kept, 0));
        *locked(&self.shared.session) = Some(session);
        self.board = Some(board);
        Ok(())
    }

    /// Waits until the sea is over, the recorder has said so, and the base station has everything.
    pub fn finish(mut self) -> Result<Ended> {
        while !self.sea.is_finished() {
            std::thread::sleep(LOOK);
        }
        self.close_session();
        let status = ended(&self.board.as_ref().context("it has no power")?.qemu)?;
        self.shared.over.store(true, Ordering::Relaxed);
        let Self { blob, rate_hz, folder, sessions, sea, relay, .. } = self;
        let lost = sea.join().map_err(|_| anyhow!("the sea has panicked"))??;
        relay.join().map_err(|_| anyhow!("the line has panicked"))?;
        if !status.success() {
            let console = std::fs::read_to_string(folder.join("console")).unwrap_or_default();
            bail!("the firmware has failed: {}", console.lines().last().unwrap_or("without a reason"));
        }
        Ok(Ended { blob, rate_hz, retained: folder.join(RETAINED), sessions, lost })
    }
}

/// How the firmware has ended, once it has.
fn ended(qemu: &Beside) -> Result<ExitStatus> {
    let begun = Instant::now();
    loop {
        if let Some(status) = qemu.ended()? {
            return Ok(status);
        }
        if begun.elapsed() > PATIENCE {
            bail!("a recorder did not end within {} s after its last sample", PATIENCE.as_secs());
        }
        std::thread::sleep(LOOK);
    }
}

/// Hands samples over when a converter would have them; what comes while there is no power is lost, and what the board is
/// too slow for is lost and counted.
fn convert(sea: &[Frame], rate_hz: f64, begun: Instant, shared: &Shared) -> Result<u64> {
    let (mut at, mut lost) = (0u64, 0);
    for frames in sea.chunks(TOGETHER) {
        let first = at;
        at += frames.len() as u64;
        let due = Duration::from_secs_f64(at as f64 / rate_hz);
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
        let late = begun.elapsed().saturating_sub(due) > LATE;
        let mut session = locked(&shared.session);
        let Some(to) = &mut *session else { continue };
        if late {
            lost += frames.len() as u64;
            continue;
        }
        let block = Block { first_index: first - *to.first.get_or_insert(first), frames };
        write_block(&mut to.kept, block).context("the samples' copy")?;
        // Where the power has just gone nobody reads.
        let _ = write_block(&mut to.fifo, block).and_then(|()| to.fifo.flush());
    }
    Ok(lost)
}

/// The line between the recorder and the base station; pulled, it carries nothing.
fn relay(shared: &Shared, base: &str) {
    let mut call: Option<TcpStream> = None;
    let mut called = Instant::now() - CALL;
    let mut buffer = [0; 1 << 12];
    while !shared.over.load(Ordering::Relaxed) {
        let line = locked(&shared.line).as_ref().and_then(|l| l.try_clone().ok());
        let Some(mut line) = line.filter(|_| !shared.pulled.load(Ordering::Relaxed)) else {
            call = None;
            // What it says meanwhile goes nowhere.
            if let Some(line) = &mut *locked(&shared.line) {
                let _ = line.read(&mut buffer);
            }
            std::thread::sleep(LOOK);
            continue;
        };
        if call.is_none() && called.elapsed() >= CALL {
            called = Instant::now();
            call = TcpStream::connect(base)
                .ok()
                .filter(|c| c.set_nodelay(true).is_ok() && c.set_read_timeout(Some(LOOK)).is_ok());
        }
        if let Ok(n) = line.read(&mut buffer)
            && call.as_mut().is_some_and(|call| call.write_all(&buffer[..n]).is_err())
        {
            call = None;
        }
        let Some(open) = &mut call else { continue };
        match open.read(&mut buffer) {
            Ok(0) => call = None,
            Ok(n) => drop(line.write_all(&buffer[..n])),
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => call = None,
        }
    }
}

/// The part of the file that stands for the memory in which the firmware keeps its records.
pub fn records_memory(retained: &Path) -> Result<Vec<u8>> {
    let bytes = std::fs::read(retained).with_context(|| format!("cannot read {}", retained.display()))?;
    let memory =
        bytes.get(8 << 20..(8 << 20) + (1 << 15)).context("the memory that survives is too short")?;
    Ok(memory.to_vec())
}
