//! Two demonstrations with two recorders under QEMU and one base station. In the first a line is pulled, both recorders lose
//! their power and the base station is killed; then an account of every record. The second shows them on its page.
//!
//! Everything runs in real time. What the recorders said is known from themselves (the ledger of their store) and from the
//! host's twin, which takes the same samples.

mod account;
mod recorder;

use crate::beside::{self, Beside, Folder};
use crate::blob;
use crate::emulator::Emulator;
use crate::world::ArrayScenario;
use crate::world::array::SimulatedArray;
use anyhow::{Context, Result, bail};
use recorder::Recorder;
use seabearing_core::block::Frame;
use serde_json::Value;
use std::io::{BufRead, BufReader, IsTerminal};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use time::OffsetDateTime;

/// Recorders, by number of the station.
const STATIONS: [u16; 2] = [1, 2];
/// Where they are, degrees.
const PLACES: [[f64; 2]; 2] = [[49.04, -123.32], [49.055, -123.30]];
/// Seconds of the sea where nobody looks at the page.
const SHORT_S: f64 = 30.0;
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
    let prepared = prepare(&scenario, folder.path(), END_S / shorter)?;
    let mut base = BaseStation::new(command, folder.path(), TELL_UTC_S / shorter, false)?;
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

/// Shows two recorders on the base station's page. At a terminal they pass their vessels in real time and the page stays
/// until this is interrupted; elsewhere it ends once both are live on the page.
///
/// # Errors
/// Something cannot run, or they do not appear on the page.
pub fn show(scenario: &Path, emulator: &Emulator, command: &Path) -> Result<()> {
    let scenario = ArrayScenario::read(scenario)?;
    let folder = Folder::new()?;
    let stays = std::io::stdin().is_terminal() && std::io::stdout().is_terminal();
    let duration_s = if stays { scenario.scene.duration_s } else { SHORT_S };
    println!("two recorders in QEMU and a base station with a page, in real time");
    let prepared = prepare(&scenario, folder.path(), duration_s)?;
    let mut base = BaseStation::new(command, folder.path(), TELL_UTC_S, true)?;
    base.start()?;
    let begun = Instant::now();
    let start = |(of, sea, folder)| Recorder::start(emulator, of, sea, folder, &base.address, begun);
    let recorders = prepared.into_iter().map(start).collect::<Result<Vec<_>>>()?;
    let page = base.page.clone().context("the base station names no page")?;
    let live = || -> Result<bool> {
        let picture: Value = serde_json::from_slice(&beside::ask(&page, "/api/moment")?)?;
        let up = |station: &&Value| {
            station["states"]["line"]["state"] == "up" && station["newest"]["bearing"].is_array()
        };
        Ok(picture["stations"].as_array().map_or(0, |all| all.iter().filter(up).count()) == STATIONS.len())
    };
    while !live()? {
        base.say();
        if begun.elapsed() > PATIENCE {
            bail!("the recorders are not live on the page {page}");
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    println!("two recorders are live on the page {page}");
    if !stays {
        println!("no terminal: this ends here; at one they stay");
        return Ok(());
    }
    println!("their vessels pass within {duration_s:.0} s; Ctrl-C ends this");
    for recorder in recorders {
        recorder.finish()?;
        base.say();
    }
    println!("both recorders have ended; the page {page} stays, with its time slider, until Ctrl-C");
    loop {
        base.say();
        std::thread::sleep(Duration::from_secs(1));
    }
}

/// A recorder's configuration and rate, its sea, its folder.
type Prepared = ((Vec<u8>, f64), Vec<Frame>, PathBuf);

/// Simulates the sea of both recorders.
fn prepare(scenario: &ArrayScenario, folder: &Path, duration_s: f64) -> Result<Vec<Prepared>> {
    println!("the sea is simulated first");
    let mut prepared = Vec::new();
    for station in STATIONS {
        let mut scenario = scenario.clone();
        scenario.scene.duration_s = duration_s;
        scenario.scene.seed += u64::from(station);
        scenario.station.config.id = station;
        let of = (blob::of(&scenario.station)?, scenario.station.config.rate_hz);
        let sea: Vec<Frame> = SimulatedArray::new(&scenario)?.collect();
        let folder = folder.join(format!("recorder-{station}"));
        std::fs::create_dir_all(&folder)?;
        std::fs::write(folder.join("key.bin"), key(station))?;
        prepared.push((of, sea, folder));
    }
    Ok(prepared)
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
    /// Its page, if it has one: where, once it has started.
    page: Option<String>,
    running: Option<(Beside, Receiver<String>)>,
}

impl BaseStation {
    /// Writes its stations file, at a port that is free now.
    fn new(command: &Path, folder: &Path, tell_utc_s: f64, page: bool) -> Result<Self> {
        let free = std::net::TcpListener::bind("127.0.0.1:0").context("no free port")?.local_addr()?;
        let mut stations = String::new();
        for station in STATIONS {
            let digits: String = key(station).iter().map(|b| format!("{b:02x}")).collect();
            std::fs::write(folder.join(format!("{station}.key")), digits)?;
            let [lat, lon] = PLACES[usize::from(station != STATIONS[0])];
            stations += &format!(
                "[[stations]]\nid = {station}\nline = \"listen:{free}\"\nkey_file = \"{station}.key\"\n\
                 position = {{ lat_deg = {lat}, lon_deg = {lon}, depth_m = 168.0 }}\n"
            );
        }
        std::fs::write(folder.join("stations.toml"), stations)?;
        let (command, folder) = (command.to_owned(), folder.to_owned());
        let store = folder.join("store");
        let page = page.then(String::new);
        Ok(Self { command, folder, store, address: free.to_string(), tell_utc_s, page, running: None })
    }

    /// Starts it, and waits until it listens.
    fn start(&mut self) -> Result<()> {
        let mut command = Command::new(&self.command);
        command.args(["base", "--json", "--stations", "stations.toml", "--store", "store", "--tell-utc"]);
        command.arg(format!("{:.0}", self.tell_utc_s.max(1.0))).current_dir(&self.folder);
        if self.page.is_some() {
            command.args(["--page", "127.0.0.1:0"]);
        }
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let child = Beside::start(&mut command).context("cannot start the base station")?;
        let stderr = BufReader::new(child.stderr().context("its standard error")?);
        let (said, says) = channel();
        std::thread::spawn(move || stderr.lines().map_while(Result::ok).for_each(|l| drop(said.send(l))));
        let mut last = String::new();
        loop {
            match says.recv_timeout(PATIENCE) {
                Ok(line) if line.contains("listening at ") => break,
                Ok(line) if line.contains("page at ") => {
                    self.page = line.split(' ').next_back().map(str::to_owned);
                }
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
