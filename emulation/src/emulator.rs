//! The firmware under QEMU: samples through a FIFO or a second serial line, telemetry and commands through a socket,
//! costs from its summary.
//!
//! QEMU runs in a temporary folder that holds the FIFO `samples.sbraw`, the sockets and the summary; the configuration
//! blob is loaded into the emulated board's memory before the start. Nothing is lost at the end: the firmware waits
//! for its transmitter, and the socket is read until QEMU closes it.

use crate::beside::{Beside, Folder};
use anyhow::{Context, Result, anyhow, bail};
use seabearing_board_model::time::NEVER;
use seabearing_board_model::{Ending, Image, mps2_an500};
use seabearing_core::wire::{Decoder, FaultCode, Message, Received};
use std::io::{BufReader, BufWriter, ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant};

/// Where the configuration blob is loaded: PSRAM of the emulated board.
const BLOB_ADDRESS: &str = "0x60000000";
/// Instructions per tick of the emulated core clock with `-icount shift=0` (1 ns an instruction, 40 ns a tick).
pub const INSTRUCTIONS_PER_TICK: u64 = 40;
/// Silence after which the emulated firmware is taken for dead.
const PATIENCE: Duration = Duration::from_secs(120);

/// How samples reach the firmware.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SamplePath {
    /// By semihosting, from a FIFO: an `.sbraw` stream.
    #[default]
    File,
    /// Over UART1: the sample line of `docs/firmware.md`; some 10 kB/s, so for ocean-bottom stations only.
    Uart,
}

/// What runs the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Engine {
    /// QEMU, a program of its own.
    #[default]
    Qemu,
    /// The interpreter that is part of this program; it always counts instructions.
    Model,
}

/// How to run.
#[derive(Debug, Clone)]
pub struct Emulator {
    /// The firmware image (ELF).
    pub firmware: PathBuf,
    /// Count instructions instead of following the wall clock.
    pub count_instructions: bool,
    /// How samples go in.
    pub samples: SamplePath,
    /// What runs the image.
    pub engine: Engine,
}

/// What the firmware leaves behind: see `docs/firmware.md`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FirmwareSummary {
    /// Sample index after the last sample seen.
    pub index: u64,
    /// Sample instants seen.
    pub instants: u64,
    /// Ticks spent in the recorder and in framing.
    pub busy_ticks: u64,
    /// Most ticks one block took.
    pub worst_block_ticks: u64,
    /// Frames sent.
    pub frames: u64,
    /// Frames dropped.
    pub frames_dropped: u64,
    /// Bytes of stack there were.
    pub stack_bytes: u64,
    /// Most bytes of stack used.
    pub stack_used: u64,
    /// Frames of the sample line that were damaged.
    pub line_damaged: u64,
    /// Frames of the sample line that were lost, damaged ones included.
    pub line_lost: u64,
}

impl FirmwareSummary {
    fn of(bytes: &[u8]) -> Option<Self> {
        let (words, rest) = bytes.as_chunks::<8>();
        let mut words = words.iter().map(|w| u64::from_le_bytes(*w));
        let mut next = || words.next();
        let summary = Self {
            index: next()?,
            instants: next()?,
            busy_ticks: next()?,
            worst_block_ticks: next()?,
            frames: next()?,
            frames_dropped: next()?,
            stack_bytes: next()?,
            stack_used: next()?,
            line_damaged: next()?,
            line_lost: next()?,
        };
        (rest.is_empty() && words.next().is_none()).then_some(summary)
    }

    /// The summary of a run that ended well, or why it did not: `reason` is the console's last line.
    fn of_run(ended_well: bool, reason: &str, bytes: &[u8]) -> Result<Self> {
        if !ended_well {
            bail!("the firmware has failed: {reason}");
        }
        Self::of(bytes).context("the firmware left no summary")
    }
}

/// The FIFO of the samples, in the board's folder.
pub const SAMPLES: &str = "samples.sbraw";
/// The file of the memory that survives a loss of power, in the board's folder.
pub const RETAINED: &str = "psram.bin";

/// The emulated board at work; its power goes when it is dropped.
#[derive(Debug)]
pub struct Board {
    /// The emulator.
    pub qemu: Beside,
    /// Telemetry and commands.
    pub telemetry: UnixStream,
    /// The sample line, where samples come over one.
    pub samples: Option<UnixStream>,
}

/// The emulated board's image, that of the checkout unless another is given.
///
/// # Errors
/// Says how to build it.
pub fn firmware(path: Option<PathBuf>) -> Result<PathBuf> {
    image(path, "mps2-an500.elf", "cargo xtask build-firmware")
}

/// An image, that of the checkout with this name unless another is given.
///
/// # Errors
/// Says how to build it.
pub fn image(path: Option<PathBuf>, name: &str, build: &str) -> Result<PathBuf> {
    let images = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../target/firmware/images"));
    let path = path.unwrap_or_else(|| images.join(name));
    match path.canonicalize() {
        Ok(path) => Ok(path),
        Err(_) => bail!("no firmware image at {}: run `{build}`", path.display()),
    }
}

impl Emulator {
    /// Runs the firmware to its end. `feed` writes the `.sbraw` stream or the bytes of the sample line; `heard` gets
    /// telemetry as it comes and may write commands back.
    ///
    /// # Errors
    /// One line: QEMU missing or failing, the firmware's own reason, or silence.
    pub fn run(
        &self,
        blob: &[u8],
        feed: impl FnOnce(&mut dyn Write) -> Result<()> + Send,
        mut heard: impl FnMut(&[u8], &mut dyn Write) -> Result<()>,
    ) -> Result<FirmwareSummary> {
        if self.engine == Engine::Model {
            return self.run_model(blob, feed, heard);
        }
        let folder = Folder::new()?;
        let fifo = folder.path().join(SAMPLES);
        let Board { qemu, telemetry: mut uart, samples: sample_line } =
            self.power_on(folder.path(), blob, false)?;
        uart.set_read_timeout(Some(Duration::from_millis(500)))?;
        // QEMU forgets what it has not read of a line that is closed: this end stays open until it has ended.
        let _open = sample_line.as_ref().map(UnixStream::try_clone).transpose()?;

        let fed = AtomicU64::new(0);
        let (fifo, fed) = (fifo.as_path(), &fed);
        std::thread::scope(|scope| {
            let feeder = scope.spawn(move || match sample_line {
                // As it comes: whoever feeds a line keeps its time.
                Some(line) => while_read(feed(&mut Counted { to: line, fed })),
                None => {
                    let to = std::fs::OpenOptions::new().write(true).open(fifo)?;
                    feed_all(feed, Counted { to, fed })
                }
            });
            let mut decoder = Decoder::default();
            let mut panicked = None;
            let mut heard = |bytes: &[u8], commands: &mut dyn Write| {
                for byte in bytes {
                    if let Some(Received { message: Message::Fault(fault), .. }) = decoder.push(*byte) {
                        panicked = panicked.or((fault.code == FaultCode::Panicked).then_some(fault.value));
                    }
                }
                heard(bytes, commands)
            };
            let listened = listen(&mut uart, fed, &mut heard);
            if listened.is_err() {
                qemu.kill();
            }
            let status = qemu.wait().context("waiting for QEMU");
            // A feeder whose reader has gone is let go: opening both ways never waits, closing breaks the pipe.
            if self.samples == SamplePath::File {
                drop(std::fs::OpenOptions::new().read(true).write(true).open(fifo));
            }
            let feeding = joined(feeder);
            listened?;
            let status = status?;
            if let Some(value) = panicked {
                bail!("the firmware panicked at line {} of file {:08x}", value as u32, value >> 32 << 1);
            }
            feeding?;
            let summary = std::fs::read(folder.path().join("summary.bin")).unwrap_or_default();
            FirmwareSummary::of_run(status.success(), &console(folder.path(), &status), &summary)
        })
    }

    /// As [`Emulator::run`], in this program: telemetry is heard when the run has ended.
    fn run_model(
        &self,
        blob: &[u8],
        feed: impl FnOnce(&mut dyn Write) -> Result<()> + Send,
        mut heard: impl FnMut(&[u8], &mut dyn Write) -> Result<()>,
    ) -> Result<FirmwareSummary> {
        let (near, far) = UnixStream::pair()?;
        let image = std::fs::read(&self.firmware).context("the firmware image")?;
        let image = Image::parse(&image).map_err(|e| anyhow!("{}: {e}", self.firmware.display()))?;
        let (ending, telemetry, (summary, console)) = std::thread::scope(|scope| -> Result<_> {
            let feeder = scope.spawn(move || feed_all(feed, near));
            let mut samples = BufReader::with_capacity(1 << 16, far);
            let mut line = Vec::new();
            if self.samples == SamplePath::Uart {
                samples.read_to_end(&mut line)?;
            }
            let mut machine =
                mps2_an500::machine(image, blob, Box::new(samples)).map_err(anyhow::Error::msg)?;
            if self.samples == SamplePath::Uart {
                machine.board.set_sample_line(line);
            }
            let ending = machine.run(NEVER).map_err(anyhow::Error::msg);
            let mut board = machine.into_board();
            let heard = std::mem::take(&mut board.telemetry);
            let left = (std::mem::take(&mut board.summary), std::mem::take(&mut board.console));
            // Samples that nobody takes any more are let go, so that their writer ends.
            drop(board);
            joined(feeder)?;
            Ok((ending?, heard, left))
        })?;
        heard(&telemetry, &mut std::io::sink())?;
        FirmwareSummary::of_run(ending == Ending::Exit(0), console.trim(), &summary)
    }

    /// Starts the board in a folder, which gets the FIFO [`SAMPLES`] where samples go that way. `retained`: its PSRAM is the
    /// file [`RETAINED`] there, which survives a loss of power.
    ///
    /// # Errors
    /// QEMU is missing, or does not start.
    pub fn power_on(&self, folder: &Path, blob: &[u8], retained: bool) -> Result<Board> {
        let fifo = folder.join(SAMPLES);
        let lines: &[&str] = match self.samples {
            SamplePath::File => {
                // What was not read before the power went is not read now.
                let _ = std::fs::remove_file(&fifo);
                make_fifo(&fifo)?;
                &["uart0"]
            }
            SamplePath::Uart => &["uart0", "uart1"],
        };
        std::fs::write(folder.join("station.sbcf"), blob)?;
        let bind = |line: &&str| {
            let _ = std::fs::remove_file(folder.join(line));
            UnixListener::bind(folder.join(line))
        };
        let listeners = lines.iter().map(bind).collect::<Result<Vec<_>, _>>()?;
        let qemu = self.start(folder, lines, retained)?;
        let mut sockets = Vec::new();
        for listener in &listeners {
            sockets.push(accept(listener, &qemu, folder)?);
        }
        let mut sockets = sockets.into_iter();
        let telemetry = sockets.next().context("QEMU connected no serial port")?;
        Ok(Board { qemu, telemetry, samples: sockets.next() })
    }

    fn start(&self, folder: &Path, lines: &[&str], retained: bool) -> Result<Beside> {
        let mut command = Command::new("qemu-system-arm");
        let machine = if retained { "mps2-an500,memory-backend=psram" } else { "mps2-an500" };
        command.args(["-M", machine, "-display", "none", "-monitor", "none", "-parallel", "none"]);
        if retained {
            let file = format!("memory-backend-file,id=psram,size=16M,share=on,mem-path={RETAINED}");
            command.args(["-object", &file]);
        }
        let arguments = match self.samples {
            SamplePath::File => "",
            SamplePath::Uart => ",arg=samples=uart",
        };
        command.arg("-semihosting-config").arg(format!("enable=on,target=native{arguments}"));
        for line in lines {
            command.arg("-serial").arg(format!("unix:{line}"));
        }
        command.arg("-device").arg(format!("loader,file=station.sbcf,addr={BLOB_ADDRESS},force-raw=on"));
        command.arg("-kernel").arg(&self.firmware);
        if self.count_instructions {
            command.args(["-icount", "shift=0"]);
        }
        let console = std::fs::File::create(folder.join("console"))?;
        command.current_dir(folder).stdin(Stdio::null());
        command.stdout(console.try_clone()?).stderr(console);
        Beside::start(&mut command).map_err(|e| match e.kind() {
            ErrorKind::NotFound => {
                anyhow::anyhow!("no qemu-system-arm on the search path: run `cargo xtask setup`")
            }
            _ => anyhow::anyhow!("cannot start qemu-system-arm: {e}"),
        })
    }
}

fn make_fifo(path: &Path) -> Result<()> {
    let made = Command::new("mkfifo").arg(path).status().context("cannot run mkfifo")?;
    if !made.success() {
        bail!("cannot make the FIFO {}", path.display());
    }
    Ok(())
}

/// Counts what the firmware was given: a sign of life.
struct Counted<'a, W> {
    to: W,
    fed: &'a AtomicU64,
}

impl<W: Write> Write for Counted<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let n = self.to.write(bytes)?;
        self.fed.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        self.to.flush()
    }
}

/// Waits for QEMU to connect its serial port.
fn accept(listener: &UnixListener, qemu: &Beside, folder: &Path) -> Result<UnixStream> {
    listener.set_nonblocking(true)?;
    let begun = Instant::now();
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                stream.set_nonblocking(false)?;
                return Ok(stream);
            }
            Err(e) if e.kind() == ErrorKind::WouldBlock => {}
            Err(e) => return Err(e).context("waiting for QEMU's serial port"),
        }
        if let Some(status) = qemu.ended()? {
            bail!("QEMU did not start: {}", console(folder, &status));
        }
        if begun.elapsed() > PATIENCE {
            bail!("QEMU did not connect its serial port within {} s", PATIENCE.as_secs());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Reads telemetry until QEMU closes the line.
fn listen(
    uart: &mut UnixStream,
    fed: &AtomicU64,
    heard: &mut impl FnMut(&[u8], &mut dyn Write) -> Result<()>,
) -> Result<()> {
    let mut commands = uart.try_clone()?;
    let mut buffer = vec![0u8; 1 << 14];
    let (mut life, mut alive) = (0, Instant::now());
    loop {
        match uart.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(n) => {
                alive = Instant::now();
                heard(&buffer[..n], &mut commands)?;
            }
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) if e.kind() == ErrorKind::ConnectionReset => return Ok(()),
            Err(e) => return Err(e).context("reading the emulated serial port"),
        }
        let now = fed.load(Ordering::Relaxed);
        if now != life {
            (life, alive) = (now, Instant::now());
        }
        if alive.elapsed() > PATIENCE {
            bail!("the firmware has neither taken samples nor sent anything for {} s", PATIENCE.as_secs());
        }
    }
}

/// The last line on the emulator's console, or the status where there is none.
fn console(folder: &Path, status: &ExitStatus) -> String {
    let text = std::fs::read(folder.join("console")).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    text.lines().map(str::trim).rfind(|l| !l.is_empty()).map_or(status.to_string(), str::to_owned)
}

/// Feeds to the end, or until nobody reads any more.
pub(crate) fn feed_all(feed: impl FnOnce(&mut dyn Write) -> Result<()>, to: impl Write) -> Result<()> {
    let mut out = BufWriter::with_capacity(1 << 16, to);
    while_read(feed(&mut out).and_then(|()| Ok(out.flush()?)))
}

/// What came of feeding; that the reader has gone is no error.
fn while_read(fed: Result<()>) -> Result<()> {
    fed.or_else(|error| if reader_has_gone(&error) { Ok(()) } else { Err(error) })
}

/// What came of a thread that feeds.
pub(crate) fn joined(feeder: ScopedJoinHandle<'_, Result<()>>) -> Result<()> {
    feeder.join().unwrap_or_else(|_| bail!("the writer of samples has panicked"))
}

/// Whether something failed because its reader has gone.
fn reader_has_gone(error: &anyhow::Error) -> bool {
    let gone = |e: &std::io::Error| matches!(e.kind(), ErrorKind::BrokenPipe | ErrorKind::ConnectionReset);
    error.chain().any(|c| c.downcast_ref::<std::io::Error>().is_some_and(gone))
}
