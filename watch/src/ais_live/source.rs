//! Where live AIS comes from: TCP, UDP, a serial device, or a file that is read once.
//!
//! Each source has a thread of its own. One that cannot be opened, that goes away or says nothing is named once and opened
//! again; so are broken sentences, with their number.

use crate::ais::aivdm::{Decoder, Told, time_of};
use crate::ais::{self, AisFile};
use crate::report::unix_now_s;
use anyhow::{Context, Result, bail};
use seabearing_host::csv::shown;
use std::io::{ErrorKind, Read};
use std::net::{TcpStream, UdpSocket};
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

/// How long a read waits at most.
const PATIENCE: Duration = Duration::from_millis(200);
/// Time between attempts to open a source again: at first, and at most.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// A connection that has lasted for so long was one.
const LASTS: Duration = Duration::from_secs(30);
/// A source that says nothing for so long is named, and a connection made anew.
const SILENT: Duration = Duration::from_secs(180);
/// Broken sentences are told at most so often.
const BROKEN: Duration = Duration::from_secs(600);
/// That its clock is off, or right again, is told at most so often.
const CLOCK: Duration = Duration::from_secs(600);
/// Longest line; what is longer is no sentence.
const LONGEST: usize = 1024;
/// Times of sentences may lie so far from this computer's clock, s: else they are told of, and used.
const CLOCK_S: f64 = 60.0;

/// A source of live AIS.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// Connect to `host:port`.
    Tcp(String),
    /// Take datagrams at `address:port`.
    Udp(String),
    /// Read a serial device at so many bits a second.
    Serial(String, u32),
    /// Read a file once.
    File(PathBuf),
}

/// What a source says.
#[derive(Clone, Debug, PartialEq)]
pub enum Said {
    /// Of a vessel.
    Of(Told),
    /// Of a vessel, in a file.
    OfFile(Told),
    /// For a person: a name of the trouble, and one line.
    Note(&'static str, String),
}

impl std::str::FromStr for Source {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let with_port = |rest: &str| {
            let port = rest.rsplit_once(':').filter(|(host, _)| !host.is_empty());
            port.is_some_and(|(_, port)| port.parse::<u16>().is_ok())
        };
        match text.split_once(':') {
            Some(("tcp", to)) if with_port(to) => Ok(Self::Tcp(to.to_owned())),
            Some(("udp", at)) if with_port(at) => Ok(Self::Udp(at.to_owned())),
            Some(("tcp" | "udp", _)) => Err("a port is missing".to_owned()),
            Some(("serial", rest)) => {
                match rest.rsplit_once(':').map(|(device, baud)| (device, baud.parse())) {
                    Some((device, Ok(baud @ 50..))) if !device.is_empty() => {
                        Ok(Self::Serial(device.to_owned(), baud))
                    }
                    _ => {
                        Err("serial:DEVICE:BAUD expected, with BAUD bits a second (38400 is usual)"
                            .to_owned())
                    }
                }
            }
            _ if text.is_empty() => {
                Err("tcp:HOST:PORT, udp:ADDRESS:PORT, serial:DEVICE:BAUD or a file".to_owned())
            }
            _ => Ok(Self::File(text.into())),
        }
    }
}

impl std::fmt::Display for Source {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Tcp(to) => write!(f, "tcp:{to}"),
            Self::Udp(at) => write!(f, "udp:{at}"),
            Self::Serial(device, _) => write!(f, "serial:{device}"),
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}

/// Starts to read a source in a thread of its own.
///
/// # Errors
/// A file cannot be read, or an address not be listened at: what a person can mend now.
pub fn start(source: Source, to: SyncSender<Said>) -> Result<()> {
    match &source {
        Source::File(path) => {
            let AisFile { reports, names, bad } = ais::read(path)?;
            std::thread::spawn(move || {
                if let Some(first) = bad.first() {
                    let _ = to.send(Said::Note(
                        "AisBroken",
                        format!("{} broken lines of AIS, first {first}", bad.len()),
                    ));
                }
                let names = names.into_iter();
                let particulars =
                    names.map(|(mmsi, name)| Told::Particulars { mmsi, name: Some(name), length_m: None });
                let all = particulars.chain(reports.into_iter().map(Told::Position));
                all.map(Said::OfFile).try_for_each(|said| to.send(said))
            });
        }
        Source::Udp(at) => {
            let socket = UdpSocket::bind(at).with_context(|| format!("--ais {source}: cannot listen"))?;
            socket.set_read_timeout(Some(PATIENCE))?;
            std::thread::spawn(move || Reader::new(&source, &to).listen(&socket));
        }
        Source::Tcp(_) | Source::Serial(..) => {
            std::thread::spawn(move || Reader::new(&source, &to).call());
        }
    }
    Ok(())
}

fn open(source: &Source) -> Result<Box<dyn Read>> {
    match source {
        Source::Tcp(to) => {
            let stream = TcpStream::connect(to).context("cannot connect")?;
            stream.set_read_timeout(Some(PATIENCE))?;
            Ok(Box::new(stream))
        }
        Source::Serial(device, baud) => {
            let port = serialport::new(device, *baud).timeout(PATIENCE).open();
            Ok(Box::new(port.context("cannot open the device: is it connected, and may you use it?")?))
        }
        _ => bail!("nothing to open"),
    }
}

/// Reads one source.
struct Reader<'a> {
    source: &'a Source,
    to: &'a SyncSender<Said>,
    decoder: Decoder,
    line: Vec<u8>,
    heard: Instant,
    silent: bool,
    broken: u64,
    told_broken: Option<Instant>,
    clock_off: bool,
    told_clock: Option<Instant>,
}

impl<'a> Reader<'a> {
    fn new(source: &'a Source, to: &'a SyncSender<Said>) -> Self {
        Self {
            source,
            to,
            decoder: Decoder::default(),
            line: Vec::new(),
            heard: Instant::now(),
            silent: false,
            broken: 0,
            told_broken: None,
            clock_off: false,
            told_clock: None,
        }
    }

    /// Tells a person; false once nobody listens.
    fn note(&self, code: &'static str, what: &str) -> bool {
        self.to.send(Said::Note(code, format!("AIS {}: {what}", self.source))).is_ok()
    }

    /// Opens the source again and again.
    fn call(mut self) {
        let mut wait = RETRY.0;
        loop {
            let begun = Instant::now();
            let why = match open(self.source) {
                Ok(from) => {
                    self.heard = Instant::now();
                    match self.read(from) {
                        Some(why) => why,
                        None => return,
                    }
                }
                Err(e) => format!("{e:#}"),
            };
            self.line.clear();
            // One that lets in and sends away at once is not called every second.
            if begun.elapsed() > LASTS {
                wait = RETRY.0;
            }
            if !std::mem::replace(&mut self.silent, true)
                && !self.note("AisAway", &format!("{why}; it is tried again"))
            {
                return;
            }
            std::thread::sleep(wait);
            wait = (wait * 2).min(RETRY.1);
        }
    }

    /// Reads to the end, and says why that came; `None` once nobody listens.
    fn read(&mut self, mut from: Box<dyn Read>) -> Option<String> {
        let mut buffer = [0; 4096];
        loop {
            match from.read(&mut buffer) {
                Ok(0) => return Some("it has ended".to_owned()),
                Ok(n) => {
                    if !self.take(buffer.get(..n)?) {
                        return None;
                    }
                }
                Err(e)
                    if matches!(
                        e.kind(),
                        ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
                    ) =>
                {
                    if self.heard.elapsed() > SILENT {
                        return Some(format!("nothing has come for {} s", SILENT.as_secs()));
                    }
                }
                Err(e) => return Some(e.to_string()),
            }
        }
    }

    /// Takes datagrams for ever.
    fn listen(mut self, socket: &UdpSocket) {
        let mut buffer = [0; 65_536];
        loop {
            let goes_on = match socket.recv(&mut buffer) {
                Ok(n) => self.take(buffer.get(..n).unwrap_or_default()) && self.take(b"\n"),
                Err(_) if self.heard.elapsed() > SILENT && !self.silent => {
                    self.silent = true;
                    self.note("AisAway", &format!("nothing has come for {} s", SILENT.as_secs()))
                }
                Err(_) => true,
            };
            if !goes_on {
                return;
            }
        }
    }

    /// Takes bytes; false once nobody listens.
    fn take(&mut self, bytes: &[u8]) -> bool {
        self.heard = Instant::now();
        if std::mem::take(&mut self.silent) && !self.note("AisBack", "it is heard again") {
            return false;
        }
        for byte in bytes {
            if !matches!(byte, b'\n' | b'\r') {
                // What is longer is taken as broken at its end.
                if self.line.len() < LONGEST {
                    self.line.push(*byte);
                }
                continue;
            }
            let line = String::from_utf8_lossy(&std::mem::take(&mut self.line)).into_owned();
            if !line.trim().is_empty() && !self.sentence(&line) {
                return false;
            }
        }
        true
    }

    fn sentence(&mut self, line: &str) -> bool {
        let now_s = unix_now_s();
        let t_s = time_of(line).unwrap_or(now_s);
        let off = (t_s - now_s).abs() > CLOCK_S;
        // Of several receivers behind one source one may be off, and some tell no times.
        if off != self.clock_off && self.told_clock.is_none_or(|at| at.elapsed() >= CLOCK) {
            (self.clock_off, self.told_clock) = (off, Some(Instant::now()));
            let by = format!(
                "its times are {:.0} s from this computer's clock; they are used as they are",
                t_s - now_s
            );
            let said = if off {
                self.note("AisClock", &by)
            } else {
                self.note("AisClock", "its times are right again")
            };
            if !said {
                return false;
            }
        }
        match self.decoder.take(line, t_s) {
            Ok(told) => told.into_iter().map(Said::Of).try_for_each(|said| self.to.send(said)).is_ok(),
            Err(why) => {
                self.broken += 1;
                if self.told_broken.is_some_and(|at| at.elapsed() < BROKEN) {
                    return true;
                }
                self.told_broken = Some(Instant::now());
                let n = std::mem::take(&mut self.broken);
                self.note("AisBroken", &format!("{n} broken sentences, the last: {why}: `{}`", shown(line)))
            }
        }
    }
}
