//! Where telemetry comes from: a file, standard input, a serial device, a TCP peer.

use anyhow::{Context, Result};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// How long a read may wait before the caller is given a turn.
const PATIENCE: Duration = Duration::from_millis(200);
/// Time between attempts to open a lost link again.
const RETRY: Duration = Duration::from_secs(2);

/// The places telemetry may come from.
#[derive(Clone, Debug)]
pub enum Origin {
    /// A file; followed as it grows if asked.
    File {
        /// Where.
        path: PathBuf,
        /// Wait for more at its end.
        follow: bool,
    },
    /// Standard input.
    Stdin,
    /// A serial device.
    Serial {
        /// Device, e.g. `/dev/ttyACM0`.
        device: String,
        /// Bits a second.
        baud: u32,
    },
    /// Connect to `host:port`.
    Connect(String),
    /// Accept connections at `address:port`, one at a time.
    Listen(String),
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File { path, .. } => write!(f, "{}", path.display()),
            Self::Stdin => write!(f, "standard input"),
            Self::Serial { device, baud } => write!(f, "{device} at {baud} baud"),
            Self::Connect(to) => write!(f, "{to}"),
            Self::Listen(at) => write!(f, "port {at}"),
        }
    }
}

/// What a read gave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineEvent {
    /// A stream began: what was cut off before belongs to another.
    Began,
    /// So many bytes.
    Bytes(usize),
    /// Nothing for now.
    Idle,
    /// The end: no more will come.
    End,
}

/// A byte stream that can also carry commands.
trait Wire: Read + Write + Send {}
impl<T: Read + Write + Send> Wire for T {}

enum Open {
    Wire(Box<dyn Wire>),
    File(Box<dyn Read + Send>),
}

/// An origin, opened, and opened again where it was lost.
pub struct LineLink {
    origin: Origin,
    listener: Option<TcpListener>,
    open: Option<Open>,
    once: bool,
    next_try: Instant,
}

impl LineLink {
    /// Opens an origin. `once`: do not open it again after its end.
    ///
    /// # Errors
    /// It cannot be opened; the line says what to check.
    pub fn open(origin: Origin, once: bool) -> Result<Self> {
        let mut link = Self { origin, listener: None, open: None, once, next_try: Instant::now() };
        if let Origin::Listen(at) = &link.origin {
            let listener = TcpListener::bind(at)
                .with_context(|| format!("cannot listen at {at}: address:port of this machine expected"))?;
            listener.set_nonblocking(true).with_context(|| format!("cannot listen at {at}"))?;
            link.listener = Some(listener);
        } else {
            link.open = link.connect()?;
        }
        Ok(link)
    }

    /// The address listened at, if any (the port may have been chosen by the system).
    pub fn listening(&self) -> Option<std::net::SocketAddr> {
        self.listener.as_ref().and_then(|l| l.local_addr().ok())
    }

    fn connect(&self) -> Result<Option<Open>> {
        Ok(Some(match &self.origin {
            Origin::File { path, .. } => Open::File(Box::new(
                std::fs::File::open(path).with_context(|| format!("cannot read {}", path.display()))?,
            )),
            Origin::Stdin => Open::File(Box::new(std::io::stdin())),
            Origin::Serial { device, baud } => {
                Open::Wire(Box::new(serialport::new(device, *baud).timeout(PATIENCE).open().with_context(
                    || format!("cannot open serial device {device}: is it connected, and may you use it?"),
                )?))
            }
            Origin::Connect(to) => {
                let stream = TcpStream::connect(to).with_context(|| {
                    format!("cannot connect to {to}: host:port of a running recorder expected")
                })?;
                Open::Wire(Box::new(patient(stream).with_context(|| format!("cannot use {to}"))?))
            }
            Origin::Listen(at) => {
                let Some(listener) = &self.listener else { return Ok(None) };
                match listener.accept() {
                    Ok((stream, _)) => {
                        Open::Wire(Box::new(patient(stream).with_context(|| format!("cannot use {at}"))?))
                    }
                    Err(e) if e.kind() == ErrorKind::WouldBlock => return Ok(None),
                    Err(e) => return Err(e).with_context(|| format!("cannot accept at {at}")),
                }
            }
        }))
    }

    /// Waits a moment for bytes.
    ///
    /// # Errors
    /// A file cannot be read. (A lost connection is not an error: it is opened again, or is the end.)
    pub fn read(&mut self, buffer: &mut [u8]) -> Result<LineEvent> {
        let Some(open) = &mut self.open else {
            if Instant::now() < self.next_try {
                std::thread::sleep(PATIENCE.min(self.next_try.saturating_duration_since(Instant::now())));
                return Ok(LineEvent::Idle);
            }
            // A listener is asked every time, what must be called up only now and then.
            self.next_try = Instant::now() + if self.listener.is_some() { PATIENCE / 4 } else { RETRY };
            self.open = self.connect().unwrap_or(None);
            return Ok(if self.open.is_some() { LineEvent::Began } else { LineEvent::Idle });
        };
        let got = match open {
            Open::Wire(wire) => wire.read(buffer),
            Open::File(file) => file.read(buffer),
        };
        match (got, &self.origin) {
            (Ok(0), Origin::File { follow: true, .. }) => {
                std::thread::sleep(PATIENCE);
                Ok(LineEvent::Idle)
            }
            (Ok(0), Origin::File { .. } | Origin::Stdin) => Ok(LineEvent::End),
            (Ok(n), _) if n > 0 => Ok(LineEvent::Bytes(n)),
            (Err(e), _)
                if matches!(
                    e.kind(),
                    ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
                ) =>
            {
                Ok(LineEvent::Idle)
            }
            (Err(e), Origin::File { .. } | Origin::Stdin) => {
                Err(e).with_context(|| format!("cannot read {}", self.origin))
            }
            // The connection is gone: the peer closed it, or the device was unplugged.
            _ => {
                self.open = None;
                self.next_try = Instant::now() + if self.listener.is_some() { Duration::ZERO } else { RETRY };
                Ok(if self.once { LineEvent::End } else { LineEvent::Idle })
            }
        }
    }

    /// Sends bytes to the recorder; `false` where the link cannot.
    pub fn send(&mut self, bytes: &[u8]) -> bool {
        match &mut self.open {
            Some(Open::Wire(wire)) => wire.write_all(bytes).and_then(|()| wire.flush()).is_ok(),
            _ => false,
        }
    }
}

fn patient(stream: TcpStream) -> std::io::Result<TcpStream> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_nodelay(true)?;
    Ok(stream)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wait(link: &mut LineLink, buffer: &mut [u8]) -> LineEvent {
        for _ in 0..200 {
            match link.read(buffer).unwrap() {
                LineEvent::Idle => {}
                event => return event,
            }
        }
        LineEvent::Idle
    }

    #[test]
    fn a_listener_takes_one_peer_after_another() {
        let mut link = LineLink::open(Origin::Listen("127.0.0.1:0".into()), false).unwrap();
        let address = link.listening().unwrap();
        let mut buffer = [0u8; 16];
        for text in [b"one", b"two"] {
            let mut peer = TcpStream::connect(address).unwrap();
            assert_eq!(wait(&mut link, &mut buffer), LineEvent::Began);
            peer.write_all(text).unwrap();
            assert_eq!(wait(&mut link, &mut buffer), LineEvent::Bytes(3));
            assert_eq!(&buffer[..3], text);
            assert!(link.send(b"?"));
            let mut answer = [0u8; 1];
            peer.read_exact(&mut answer).unwrap();
            drop(peer);
            // Seen as closed at the next read.
            while link.open.is_some() {
                assert_eq!(link.read(&mut buffer).unwrap(), LineEvent::Idle);
            }
        }
    }

    #[test]
    fn what_cannot_be_opened_is_named() {
        let missing = Origin::File { path: "/nonexistent/x".into(), follow: false };
        assert!(format!("{:#}", LineLink::open(missing, true).err().unwrap()).contains("/nonexistent/x"));
        let serial = Origin::Serial { device: "/dev/nonexistent".into(), baud: 115_200 };
        assert!(format!("{:#}", LineLink::open(serial, true).err().unwrap()).contains("/dev/nonexistent"));
    }
}
