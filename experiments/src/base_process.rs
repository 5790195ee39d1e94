//! A base station as a process of its own, and recorders that call it over TCP.

use anyhow::{Context, Result, bail};
use seabearing_core::wire::link::{Arrival, Class, Inbox, Link, MemoryStore, Progress, Session, Settings};
use seabearing_core::wire::{Hello, Message, SCHEMA_HASH, WIRE_VERSION, bytes_of};
use seabearing_host::beside::Beside;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Bytes of a recorder's store.
const STORE: usize = 1 << 16;

/// What a recorder says first.
pub fn hello(station: u16, rate_hz: f32) -> Message {
    Message::Hello(Hello {
        wire_version: WIRE_VERSION,
        schema_hash: SCHEMA_HASH,
        config_hash: 1,
        version: (0, 1, 0),
        station,
        kind: 0,
        rate_hz,
        reset_cause: 0,
    })
}

/// A base station that listens; ended when it is dropped.
pub struct Process {
    child: Beside,
    /// Where it listens.
    pub address: String,
    /// Its page, where it has one.
    pub page: Option<String>,
    /// What it says on standard error after that.
    said: Arc<Mutex<Vec<String>>>,
}

/// Longest that something is waited for that it is to say.
const PATIENCE: Duration = Duration::from_secs(30);

impl Process {
    /// Starts this command as a base station with a store.
    pub fn start(store: &Path) -> Result<Self> {
        Self::start_with(store, &[], Path::new("."))
    }

    /// The same with other arguments, in a folder; a page is named before it listens.
    pub fn start_with(store: &Path, arguments: &[&str], folder: &Path) -> Result<Self> {
        let mut command = Command::new(std::env::current_exe().context("the command's own file")?);
        command.args(["base", "--json", "--listen", "127.0.0.1:0", "--store"]).arg(store);
        command.args(arguments).current_dir(folder);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let child = Beside::start(&mut command).context("cannot start a base station")?;
        let mut lines = BufReader::new(child.stderr().context("its standard error")?).lines();
        let mut said = String::new();
        let mut page = None;
        let address = loop {
            match lines.next() {
                Some(Ok(line)) if line.contains("page at ") => {
                    page = line.split(' ').next_back().map(str::to_owned)
                }
                Some(Ok(line)) => match line.split_once("listening at ") {
                    Some((_, address)) => break address.to_owned(),
                    None => said = line,
                },
                _ => bail!("the base station does not listen: {said}"),
            }
        };
        // What else it says is taken, so that it never waits for it.
        let said: Arc<Mutex<Vec<String>>> = Arc::default();
        let keep = Arc::clone(&said);
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                keep.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            }
        });
        Ok(Self { child, address, page, said })
    }

    /// Waits until it has said a text.
    pub fn wait_for(&self, text: &str) -> Result<()> {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            let said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
            if said.iter().any(|line| line.contains(text)) {
                return Ok(());
            }
            drop(said);
            std::thread::sleep(Duration::from_millis(10));
        }
        bail!("the base station has not said `{text}`")
    }

    /// Most memory it has used so far, MB; `None` where the system does not tell.
    pub fn peak_mb(&self) -> Option<f64> {
        peak_mb(&self.child.id().to_string())
    }

    /// Processor time it has used so far, s; `None` where the system does not tell.
    pub fn processor_s(&self) -> Option<f64> {
        /// The unit that the system tells it in, s.
        const TICK_S: f64 = 0.01;
        let text = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).ok()?;
        // The name, in parentheses, may hold anything; user and system time are the 14th and 15th field.
        let ticks = |n: usize| text.rsplit(") ").next()?.split(' ').nth(n - 3)?.parse::<f64>().ok();
        Some((ticks(14)? + ticks(15)?) * TICK_S)
    }

    /// Kills it outright.
    pub fn kill(self) {
        self.child.kill();
    }
}

/// Most memory of a process (`self` or its number), MB.
pub fn peak_mb(process: &str) -> Option<f64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok().map(|kb| kb / 1000.0)
}

/// A recorder with a link, whose store survives the base station.
pub struct Caller {
    link: Link<MemoryStore<STORE>>,
    stream: Option<TcpStream>,
    offered: VecDeque<Instant>,
    /// Records said so far.
    pub said: u32,
    /// Longest time from saying a record until it was acknowledged, s.
    pub worst_s: f64,
}

impl Caller {
    /// A recorder that has just started.
    pub fn new(station: u16) -> Self {
        let link = Link::new(Settings::serial(921_600), station, 1, 0, MemoryStore::new());
        let mut caller = Self { link, stream: None, offered: VecDeque::new(), said: 0, worst_s: 0.0 };
        caller.say(&hello(station, 1000.0));
        caller
    }

    /// Calls a base station.
    pub fn call(&mut self, base: &Process) -> Result<()> {
        let stream = TcpStream::connect(&base.address).context("cannot call the base station")?;
        stream.set_nodelay(true)?;
        stream.set_nonblocking(true)?;
        self.stream = Some(stream);
        self.link.reconnected();
        Ok(())
    }

    /// Says a message.
    pub fn say(&mut self, message: &Message) {
        let mut buffer = [0; 160];
        self.link.offer(Class::of(message), bytes_of(message, &mut buffer));
        self.offered.push_back(Instant::now());
        self.said += 1;
    }

    /// Sends and takes what is due; a line that is gone is none.
    pub fn work(&mut self, now_us: u64) {
        let Some(stream) = &mut self.stream else { return };
        let mut gone = false;
        while let Some(frame) = self.link.send(now_us) {
            gone |= stream.write_all(frame).is_err_and(|e| e.kind() != ErrorKind::WouldBlock);
        }
        let mut answer = [0; 1024];
        if let Ok(n) = stream.read(&mut answer) {
            answer.iter().take(n).for_each(|b| self.link.receive(now_us, *b, &mut Nothing));
        }
        while self.offered.len() > self.waiting() as usize {
            let took = self.offered.pop_front().map_or(0.0, |at| at.elapsed().as_secs_f64());
            self.worst_s = self.worst_s.max(took);
        }
        if gone {
            self.stream = None;
        }
    }

    /// Records that are not acknowledged.
    pub fn waiting(&self) -> u32 {
        self.link.waiting()
    }
}

struct Nothing;

impl Inbox for Nothing {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, _: Arrival<'_>) {}
}
