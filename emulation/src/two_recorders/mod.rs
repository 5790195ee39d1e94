//! The demonstration of the base station: two recorders under QEMU feed one base station while one line is pulled, both
//! recorders lose their power and the base station is killed; then an account of every record.
//!
//! Everything runs in real time. What the recorders said is known from themselves (the ledger of their store) and from the
//! host's twin, which takes the same samples.

mod account;
mod recorder;

use crate::beside::{Beside, Folder};
use crate::blob;
use crate::emulator::Emulator;
use crate::world::ArrayScenario;
use crate::world::array::SimulatedArray;
use anyhow::{Context, Result, bail};
use recorder::Recorder;
use seabearing_core::block::Frame;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use time::OffsetDateTime;

/// Recorders, by number of the station.
const STATIONS: [u16; 2] = [1, 2];
/// Longest wait for a program.
const PATIENCE: Duration = Duration::from_secs(120);
/// Seconds between the times that the base station tells, at full length.
const TELL_UTC_S: f64 = 20.0;

/// What happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Event {
    /// The line of the first recorder is pulled.
    Pull,
    Plug,
    /// A recorder loses its power.
    Off(usize),
    On(usize),
    /// The base station is killed.
    Kill,
    Restart,
}

/// When, in seconds: the first recorder loses its power while its line is pulled, the base station is killed while it is
/// pulled, and for three seconds nobody listens.
const EVENTS: [(f64, Event, &str); 8] = [
    (15.0, Event::Pull, "the line of recorder 1 is pulled"),
    (30.0, Event::Off(1), "recorder 2 loses its power"),
    (33.0, Event::On(1), "recorder 2 has power again"),
    (45.0, Event::Off(0), "recorder 1 loses its power, with all of a pulled line's records in its store"),
    (48.0, Event::On(0), "recorder 1 has power again"),
    (60.0, Event::Kill, "the base station is killed"),
    (63.0, Event::Restart, "the base station is started again"),
    (75.0, Event::Plug, "the line of recorder 1 is plugged in again"),
];
/// End of the samples, s.
const END_S: f64 = 100.0;

/// Runs it. `command`: the command `seabearing`; `shorter`: all times are divided by this.
///
/// # Errors
/// Something cannot run, or the account does not balance.
pub fn run(scenario: &Path, emulator: &Emulator, command: &Path, shorter: f64) -> Result<()> {
    let scenario = ArrayScenario::read(scenario)?;
    let folder = Folder::new()?;
    println!("two recorders in QEMU, one base station, in real time; {} s", END_S / shorter);
    if shorter > 1.0 {
        println!("shortened: all times are 1/{shorter} of the full demonstration's");
    }
    println!("the sea is simulated first");
    let mut prepared = Vec::new();
    for station in STATIONS {
        let mut scenario = scenario.clone();
        scenario.scene.duration_s = END_S / shorter;
        scenario.scene.seed += u64::from(station);
        scenario.station.config.id = station;
        let of = (blob::of(&scenario.station)?, scenario.station.config.rate_hz);
        let sea: Vec<Frame> = SimulatedArray::new(&scenario)?.collect();
        let folder = folder.path().join(format!("recorder-{station}"));
        std::fs::create_dir_all(&folder)?;
        std::fs::write(folder.join("key.bin"), key(station))?;
        prepared.push((of, sea, folder));
    }
    let mut base = BaseStation::new(command, folder.path(), TELL_UTC_S / shorter)?;
    base.start()?;
    let (begun, begun_utc) = (Instant::now(), OffsetDateTime::now_utc());
    let start = |(of, sea, folder)| Recorder::start(emulator, of, sea, folder, &base.address, begun);
    let mut recorders = prepared.into_iter().map(start).collect::<Result<Vec<_>>>()?;
    for (at_s, event, text) in EVENTS {
        let due = Duration::from_secs_f64(at_s / shorter);
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
        base.say();
        println!("{:6.1} s  {text}", begun.elapsed().as_secs_f64());
        match event {
            Event::Pull => recorders[0].pull(true),
            Event::Plug => recorders[0].pull(false),
            Event::Off(n) => recorders[n].power_off(),
            Event::On(n) => recorders[n].power_on()?,
            Event::Kill => base.kill(),
            Event::Restart => base.start()?,
        }
    }
    let mut ended = Vec::new();
    for recorder in recorders {
        ended.push(recorder.finish()?);
        base.say();
    }
    println!("{:6.1} s  both recorders have ended", begun.elapsed().as_secs_f64());
    base.kill();
    account::balance(&base.store, &ended, begun_utc)
}

/// The key of a recorder.
fn key(station: u16) -> [u8; 32] {
    [station as u8; 32]
}

/// The base station, a program of its own.
struct BaseStation {
    command: PathBuf,
    folder: PathBuf,
    store: PathBuf,
    address: String,
    tell_utc_s: f64,
    running: Option<(Beside, Receiver<String>)>,
}

impl BaseStation {
    /// Writes its stations file, at a port that is free now.
    fn new(command: &Path, folder: &Path, tell_utc_s: f64) -> Result<Self> {
        let free = std::net::TcpListener::bind("127.0.0.1:0").context("no free port")?.local_addr()?;
        let mut stations = String::new();
        for station in STATIONS {
            let digits: String = key(station).iter().map(|b| format!("{b:02x}")).collect();
            std::fs::write(folder.join(format!("{station}.key")), digits)?;
            let line = format!("id = {station}\nline = \"listen:{free}\"\nkey_file = \"{station}.key\"\n");
            stations += &format!("[[stations]]\n{line}");
        }
        std::fs::write(folder.join("stations.toml"), stations)?;
        let (command, folder) = (command.to_owned(), folder.to_owned());
        let store = folder.join("store");
        Ok(Self { command, folder, store, address: free.to_string(), tell_utc_s, running: None })
    }

    /// Starts it, and waits until it listens.
    fn start(&mut self) -> Result<()> {
        let mut command = Command::new(&self.command);
        command.args(["base", "--json", "--stations", "stations.toml", "--store", "store", "--tell-utc"]);
        command.arg(format!("{:.0}", self.tell_utc_s.max(1.0))).current_dir(&self.folder);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let child = Beside::start(&mut command).context("cannot start the base station")?;
        let stderr = BufReader::new(child.stderr().context("its standard error")?);
        let (said, says) = channel();
        std::thread::spawn(move || stderr.lines().map_while(Result::ok).for_each(|l| drop(said.send(l))));
        let mut last = String::new();
        loop {
            match says.recv_timeout(PATIENCE) {
                Ok(line) if line.contains("listening at ") => break,
                Ok(line) => last = line,
                Err(_) => bail!("the base station does not listen: {last}"),
            }
        }
        self.running = Some((child, says));
        Ok(())
    }

    /// Hands on what it has complained of.
    fn say(&self) {
        let Some((_, says)) = &self.running else { return };
        says.try_iter().for_each(|line| println!("          {line}"));
    }

    /// As a loss of power would.
    fn kill(&mut self) {
        self.say();
        if let Some((child, _)) = self.running.take() {
            child.kill();
        }
    }
}
