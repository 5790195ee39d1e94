//! The protocol's line: SeedLink 3 over TCP, kept up.
//!
//! The client says `HELLO`, `STATION STA NET`, `SELECT …` for each component, then `DATA` with the number of the record to go on
//! with, or `TIME` with a span, and `END`; from then on the server sends packets of eight bytes, `SL` and six hexadecimal digits, and a
//! record of 512. A line that says nothing for long, or something else, is given up and made again.

use super::{Address, Span};
use crate::interrupt;
use anyhow::{Context, Result, anyhow, bail};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};
use time::OffsetDateTime;

/// Bytes of a packet: header and record.
const HEADER: usize = 8;
const RECORD: usize = 512;

/// Between looks for an interruption.
const LOOK: Duration = Duration::from_millis(200);

/// How long is waited.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patience {
    /// For a connection, and for an answer.
    pub answer: Duration,
    /// For the next byte of a line that is up.
    pub silence: Duration,
    /// Before the line is made again: first, and at most.
    pub pause: Duration,
    pub longest_pause: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        let s = Duration::from_secs;
        Self { answer: s(20), silence: s(300), pause: s(1), longest_pause: s(60) }
    }
}

/// What came of waiting for bytes.
enum Came {
    /// All of them.
    All,
    /// An interruption.
    Interrupted,
}

/// A line to a server.
pub(super) struct Line {
    address: Address,
    select: Vec<String>,
    span: Span,
    patience: Patience,
    stream: Option<TcpStream>,
    /// Number of the last record that came.
    last: Option<u32>,
    pause: Duration,
    /// Whether the line was up before.
    was_up: bool,
}

impl Line {
    pub(super) fn new(address: Address, select: Vec<String>, span: Span, patience: Patience) -> Self {
        let pause = patience.pause;
        Self { address, select, span, patience, stream: None, last: None, pause, was_up: false }
    }

    /// The next record; `None` at the end of what was asked for, or where an interruption came.
    ///
    /// # Errors
    /// The first connection fails.
    pub(super) fn next(&mut self) -> Result<Option<Vec<u8>>> {
        loop {
            let Some(stream) = &mut self.stream else {
                if !self.connect()? {
                    return Ok(None);
                }
                continue;
            };
            match packet(stream, &self.patience) {
                Ok(Packet::Record(number, record)) => {
                    (self.last, self.pause) = (Some(number), self.patience.pause);
                    return Ok(Some(record));
                }
                Ok(Packet::Info) => {}
                Ok(Packet::End) => return Ok(None),
                Err(e) => {
                    log::warn!("{}: {e:#}; connecting again", self.address);
                    self.stream = None;
                }
            }
        }
    }

    /// Makes the line, with pauses where it was up before; `false` where an interruption came.
    fn connect(&mut self) -> Result<bool> {
        let mut tried = 0u32;
        loop {
            if self.was_up && !rest(self.pause) {
                return Ok(false);
            }
            match self.try_connect() {
                Ok(stream) => {
                    if self.was_up {
                        let from = self.last.map_or(String::new(), |n| format!(" after record {n:06X}"));
                        log::warn!("{}: connected again{from}", self.address);
                    }
                    (self.stream, self.was_up) = (Some(stream), true);
                    return Ok(true);
                }
                Err(e) if !self.was_up => return Err(e.context(self.address.to_string())),
                Err(e) => {
                    // Of many alike the first is said.
                    let level = if tried == 0 { log::Level::Warn } else { log::Level::Debug };
                    log::log!(level, "{}: {e:#}; trying on", self.address);
                }
            }
            tried = tried.saturating_add(1);
            self.pause = (2 * self.pause).min(self.patience.longest_pause);
        }
    }

    fn try_connect(&self) -> Result<TcpStream> {
        let Address { host, port, network, station } = &self.address;
        let mut places = (host.as_str(), *port).to_socket_addrs().context("no such host")?;
        let place = places.next().context("no such host")?;
        let mut stream =
            TcpStream::connect_timeout(&place, self.patience.answer).context("the server does not answer")?;
        stream.set_read_timeout(Some(LOOK))?;
        stream.set_write_timeout(Some(self.patience.answer))?;
        let mut ask = |what: &str| -> Result<String> {
            stream.write_all(format!("{what}\r\n").as_bytes()).context("the server does not listen")?;
            answer(&mut stream, &self.patience)
        };
        let hello = ask("HELLO")?;
        if !hello.to_ascii_lowercase().contains("seedlink") {
            bail!("no SeedLink server, it says {hello:?}");
        }
        let accepted = |said: String, refused: &str| match said.as_str() {
            "OK" => Ok(()),
            said => Err(anyhow!("{refused} (the server says {said:?})")),
        };
        // HELLO has a second line: the server's place.
        answer(&mut stream, &self.patience)?;
        let mut ask = |what: &str| -> Result<String> {
            stream.write_all(format!("{what}\r\n").as_bytes()).context("the server does not listen")?;
            answer(&mut stream, &self.patience)
        };
        accepted(ask(&format!("STATION {station} {network}"))?, "the server has no such station")?;
        for select in &self.select {
            accepted(ask(&format!("SELECT {select}"))?, &format!("the server has no component {select}"))?;
        }
        accepted(ask(&self.wanted())?, "the server does not send data")?;
        stream.write_all(b"END\r\n").context("the server does not listen")?;
        Ok(stream)
    }

    /// From where on: after the last record, a span, or now.
    fn wanted(&self) -> String {
        let time = |t: OffsetDateTime| {
            let (d, c) = (t.date(), t.time());
            let (h, m, s) = c.as_hms();
            format!("{},{:02},{:02},{h:02},{m:02},{s:02}", d.year(), u8::from(d.month()), d.day())
        };
        match (self.last, self.span.from) {
            (Some(last), _) => format!("DATA {:06X}", last.wrapping_add(1) & 0xff_ffff),
            (None, Some(from)) => {
                let to = self.span.to.map_or(String::new(), |to| format!(" {}", time(to)));
                format!("TIME {}{to}", time(from))
            }
            (None, None) => "DATA".to_owned(),
        }
    }
}

/// What a server sends once it sends.
enum Packet {
    Record(u32, Vec<u8>),
    /// About the server, which nobody asked for.
    Info,
    End,
}

fn packet(stream: &mut TcpStream, patience: &Patience) -> Result<Packet> {
    let mut header = [0; HEADER];
    let (start, rest) = header.split_at_mut(3);
    // Fewer bytes than a packet's header may end it all.
    match fill(stream, start, patience.silence)? {
        Came::Interrupted => return Ok(Packet::End),
        Came::All if start == b"END" => return Ok(Packet::End),
        Came::All => {}
    }
    if let Came::Interrupted = fill(stream, rest, patience.silence)? {
        return Ok(Packet::End);
    }
    let [b'S', b'L', number @ ..] = header else {
        bail!("what came is no packet: it begins with {:?}", String::from_utf8_lossy(&header));
    };
    let mut record = vec![0; RECORD];
    if let Came::Interrupted = fill(stream, &mut record, patience.silence)? {
        return Ok(Packet::End);
    }
    if number.starts_with(b"INFO") {
        return Ok(Packet::Info);
    }
    let digits = number.iter().all(u8::is_ascii_hexdigit);
    let number = std::str::from_utf8(&number).ok().and_then(|n| u32::from_str_radix(n, 16).ok());
    let number = number
        .filter(|_| digits)
        .with_context(|| format!("a packet's number is none: {:?}", String::from_utf8_lossy(&header)))?;
    Ok(Packet::Record(number, record))
}

/// One line that the server says.
fn answer(stream: &mut TcpStream, patience: &Patience) -> Result<String> {
    let mut said = Vec::new();
    while !said.ends_with(b"\n") {
        let mut byte = [0];
        if let Came::Interrupted = fill(stream, &mut byte, patience.answer).context("no answer")? {
            bail!("interrupted");
        }
        said.push(byte[0]);
        if said.len() > RECORD {
            bail!("no SeedLink server, its answer has no end");
        }
    }
    Ok(String::from_utf8_lossy(&said).trim().to_owned())
}

/// Reads bytes until all are there, with a look for an interruption now and then.
fn fill(stream: &mut TcpStream, bytes: &mut [u8], longest: Duration) -> Result<Came> {
    let mut got = 0;
    let mut since = Instant::now();
    while let Some(room) = bytes.get_mut(got..).filter(|room| !room.is_empty()) {
        match stream.read(room) {
            Ok(0) => bail!("the server has closed the line"),
            Ok(n) => (got, since) = (got + n, Instant::now()),
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                if interrupt::asked() {
                    return Ok(Came::Interrupted);
                }
                if since.elapsed() >= longest {
                    bail!("silent for {:.0} s", longest.as_secs_f64());
                }
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => return Err(e).context("the line is broken"),
        }
    }
    Ok(Came::All)
}

/// Pauses; `false` where an interruption came.
fn rest(pause: Duration) -> bool {
    let begun = Instant::now();
    while begun.elapsed() < pause {
        if interrupt::asked() {
            return false;
        }
        std::thread::sleep(LOOK.min(pause.saturating_sub(begun.elapsed())));
    }
    !interrupt::asked()
}
