//! `seabearing base send`: one command to a recorder, and its answer.

use super::mistake;
use crate::base::line::Line;
use crate::base::origin::Origin;
use crate::base::service::{Rules, Service};
use crate::base::store::{Retain, Store};
use crate::base::{Base, command, stations};
use crate::cmd::base_clock::Clock;
use crate::cmd::base_configure::Change;
use crate::cmd::base_listen::{Length, Snippet, Spectrum};
use crate::cmd::base_tokens;
use anyhow::{Context, Result, bail};
use seabearing_core::wire::guard::{COMMAND_BYTES, Key};
use seabearing_core::wire::link::{CLASSES, Class, Settings};
use seabearing_core::wire::{Command, bytes_of};
use serde_json::Value;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Arguments of `seabearing base send`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing base send --serial /dev/ttyACM0 --key east.key identify\n  \
    seabearing base send --tcp 10.0.0.7:4500 --key east.key health-every 600\n  \
    seabearing base send --stations stations.toml --station 7 identify\n  \
    seabearing base send --stations stations.toml --station 7 station new.toml\n  \
    seabearing base send --stations stations.toml --station 7 snippet --channels 0,1 --seconds 0.05 --out sea.wav\n  \
    seabearing base send --stations stations.toml --station 7 spectrum --calibration east.toml\n\n\
    The line must be free: where a base station holds it, stop that one first. A stations file gives line and key. The records that \
    the recorder holds are left with it, for the base station; with --store they are taken into the base station's store on the way, which is needed where \
    so many stand before the answer that it does not come, and is advised for another configuration: the recorder starts \
    again with nothing to send.")]
#[command(group(clap::ArgGroup::new("to").required(true).args(["serial", "tcp", "listen", "stations"])))]
#[command(group(clap::ArgGroup::new("signature").args(["key", "unsigned"])))]
pub struct Args {
    /// Serial device
    #[arg(long, value_name = "DEVICE")]
    serial: Option<String>,
    /// Speed of the serial device
    #[arg(long, default_value_t = crate::base::LINE_BAUD)]
    baud: u32,
    /// Only one end of the line can speak at a time
    #[arg(long)]
    half_duplex: bool,
    /// Connect to a recorder or a serial server
    #[arg(long, value_name = "HOST:PORT", value_parser = super::address)]
    tcp: Option<String>,
    /// Wait for the recorder's connection
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = super::address)]
    listen: Option<String>,
    /// File of stations, each with its line and its key
    #[arg(long, value_name = "STATIONS.toml", requires = "station", value_parser = super::input())]
    stations: Option<PathBuf>,
    /// Number of the station in that file
    #[arg(long, value_name = "ID", requires = "stations")]
    station: Option<u16>,
    /// File with the recorder's key: 64 hexadecimal digits
    #[arg(long, value_name = "FILE", value_parser = super::input())]
    key: Option<PathBuf>,
    /// Do not sign: for a recorder without a key, which whoever reaches the line commands
    #[arg(long)]
    unsigned: bool,
    /// Seconds to wait for the recorder and for its answer
    #[arg(long, default_value_t = 60)]
    wait: u64,
    /// Store of the base station, which is to take the recorder's records on the way; without it they are left with the recorder
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
    /// What the recorder is to do
    #[command(subcommand)]
    order: Order,
}

/// Commands.
#[derive(clap::Subcommand)]
enum Order {
    /// Say who it is, and how it is
    Identify,
    /// Send `Health` every so many seconds of samples; 0: only on request
    HealthEvery {
        /// Seconds
        seconds: u16,
    },
    /// Stop after the current block
    Stop,
    /// Begin a new session, where it has stopped
    Start,
    /// Tell it the time, for a recorder without a receiver
    Utc {
        /// `now`, by this computer's clock
        #[arg(value_parser = ["now"])]
        time: String,
        /// How wrong that may be when it arrives, one standard deviation: this clock's error and the line's delay
        #[arg(long, value_name = "MS", default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..=4_000_000))]
        sd_ms: u32,
    },
    /// Give it another configuration: it starts again with it, and goes back if it does not come up
    Station {
        /// Its new station file
        #[arg(value_name = "STATION.toml", value_parser = super::input())]
        file: PathBuf,
    },
    /// Send raw samples of the moment, in one piece: at most 16384 in all channels together
    Snippet {
        /// Recorder channels, from 0
        #[arg(long, visible_alias = "channel", value_name = "C,..", value_delimiter = ',', default_values_t = ALL,
            value_parser = clap::value_parser!(u8).range(..4))]
        channels: Vec<u8>,
        /// Samples of each channel; as many as there may be where neither is said
        #[arg(long, value_name = "N", conflicts_with = "seconds")]
        samples: Option<u32>,
        /// Seconds
        #[arg(long, value_name = "S")]
        seconds: Option<f64>,
        /// Write them to this file, whole or not at all; their records are not shown then
        #[arg(long, value_name = "FILE.wav")]
        out: Option<PathBuf>,
    },
    /// Send the spectra of the last data that were analysed
    Spectrum {
        /// Recorder channels, from 0
        #[arg(long, visible_alias = "channel", value_name = "C,..", value_delimiter = ',', default_values_t = ALL,
            value_parser = clap::value_parser!(u8).range(..4))]
        channels: Vec<u8>,
        /// Its station file, to show levels re 1 µPa (and 1 nm/s) instead of re full scale
        #[arg(long, value_name = "STATION.toml", value_parser = super::input())]
        calibration: Option<PathBuf>,
    },
}

/// Recorder channels.
const ALL: [u8; 4] = [0, 1, 2, 3];

/// Silence beyond the wait after which the line itself is given up.
const LONGEST_SILENCE: Duration = Duration::from_secs(300);
/// A recorder that speaks without a link may have nothing to say: it is asked after so long a silence.
const UNASKED: Duration = Duration::from_secs(2);
/// Records of a turn that are looked at.
const WAITING: usize = 20_000;

/// What is said to the recorder, one thing after the other.
enum Talk {
    /// One command, made with its token; whether it was given, and whether it was answered.
    Once { command: Box<dyn Fn(u8) -> Command>, given: bool, answered: bool },
    /// The time.
    Clock(Clock),
    /// Another configuration.
    Station(Change),
    /// Raw samples.
    Snippet(Snippet),
    /// Spectra.
    Spectrum(Spectrum),
}

impl Talk {
    fn of(order: &Order, station: Option<u16>) -> Result<Self> {
        let command: Box<dyn Fn(u8) -> Command> = match *order {
            Order::Utc { sd_ms, .. } => return Ok(Self::Clock(Clock::new(sd_ms * 1000))),
            Order::Identify => Box::new(|token| Command::Identify { token }),
            Order::HealthEvery { seconds } => Box::new(move |token| Command::HealthEvery { token, seconds }),
            Order::Stop => Box::new(|token| Command::Stop { token }),
            Order::Start => Box::new(|token| Command::Start { token }),
            Order::Snippet { ref channels, samples, seconds, ref out } => {
                let length = match (samples, seconds) {
                    (Some(n), _) => Length::Instants(n),
                    (_, Some(s)) => Length::Seconds(s),
                    _ => Length::Most,
                };
                return Ok(Self::Snippet(Snippet::new(channels, length, out.clone())?));
            }
            Order::Spectrum { ref channels, ref calibration } => {
                return Ok(Self::Spectrum(Spectrum::new(channels, calibration.as_ref())?));
            }
            Order::Station { ref file } => return Ok(Self::Station(Change::of(file, station)?)),
        };
        Ok(Self::Once { command, given: false, answered: false })
    }

    /// What is to be given now.
    fn due(&self) -> Option<Vec<u8>> {
        match self {
            Self::Station(change) => change.due(),
            Self::Snippet(snippet) => snippet.due(),
            Self::Spectrum(spectrum) => spectrum.due(),
            Self::Once { given: true, .. } => None,
            Self::Clock(clock) => clock.due(),
            Self::Once { command, .. } => {
                Some(bytes_of(&command(base_tokens::order()), &mut [0; COMMAND_BYTES]).to_vec())
            }
        }
    }

    fn given(&mut self) {
        match self {
            Self::Station(change) => change.given(),
            Self::Snippet(snippet) => snippet.given(),
            Self::Spectrum(spectrum) => spectrum.given(),
            Self::Clock(clock) => clock.given(),
            Self::Once { given, .. } => *given = true,
        }
    }

    /// Whether what the recorder says brings it on.
    fn heard(&mut self, record: &Value) -> Result<bool> {
        match self {
            Self::Station(change) => change.heard(record),
            Self::Snippet(snippet) => snippet.heard(record),
            Self::Spectrum(spectrum) => spectrum.heard(record),
            Self::Clock(clock) => clock.heard(record),
            Self::Once { answered, .. } if record["token"] == u64::from(base_tokens::order()) => {
                done(record)?;
                *answered = true;
                Ok(true)
            }
            Self::Once { .. } => Ok(false),
        }
    }

    /// Classes of which records are left with the recorder: all but that of samples and spectra where these are asked for. A
    /// recorder that is to start again does so once nothing waits any more: it is relieved of everything.
    fn leaves(&self) -> [bool; CLASSES] {
        Class::ALL.map(|class| !(self.relieves() || class == Class::Spectrum && self.asks_for_pieces()))
    }

    fn asks_for_pieces(&self) -> bool {
        matches!(self, Self::Snippet(_) | Self::Spectrum(_))
    }

    /// Whether a record is taken that nobody asked for, as azigrams are on the way to samples: it is to be shown for that.
    fn relieves_of(&self, record: &Value) -> bool {
        self.relieves() || record["type"] == "azigram" && self.asks_for_pieces()
    }

    /// Whether all of the recorder's records are taken, and are to be shown for that.
    fn relieves(&self) -> bool {
        matches!(self, Self::Station(_))
    }

    /// Whether it asks itself who the recorder is, before its command.
    fn asks(&self) -> bool {
        matches!(self, Self::Clock(_) | Self::Snippet(_))
    }

    fn done(&self) -> bool {
        match self {
            Self::Station(change) => change.done(),
            Self::Snippet(snippet) => snippet.done(),
            Self::Spectrum(spectrum) => spectrum.done(),
            Self::Clock(clock) => clock.done(),
            Self::Once { answered, .. } => *answered,
        }
    }

    /// How long the recorder may be silent, beside what any answer takes.
    fn patience(&self) -> Duration {
        match self {
            Self::Station(change) => change.patience(),
            Self::Snippet(snippet) => snippet.patience(),
            Self::Clock(_) | Self::Spectrum(_) | Self::Once { .. } => Duration::ZERO,
        }
    }

    /// What is to be said when it was silent for longer, where it has answered before.
    fn silence(&self) -> Option<String> {
        match self {
            Self::Station(change) => change.silence(),
            Self::Snippet(snippet) => snippet.silence(),
            Self::Clock(_) | Self::Spectrum(_) | Self::Once { .. } => None,
        }
    }

    /// The record as it is shown, where it is.
    fn shown(&self, record: &Value) -> Option<Value> {
        match self {
            Self::Spectrum(spectrum) => Some(spectrum.shown(record)),
            Self::Snippet(snippet) if !snippet.shows(record) => None,
            _ => Some(record.clone()),
        }
    }
}

/// Runs the command; what the recorder says until it has answered is printed as JSON Lines.
///
/// # Errors
/// One line for a person: the line or the key cannot be used, no recorder with a link was heard, or it did not answer.
pub fn run(args: &Args) -> Result<()> {
    let mut relieved = 0;
    let ran = run_counting(args, &mut relieved);
    if relieved == 0 {
        return ran;
    }
    let taken = format!(
        "{relieved} records of the recorder stand above and nowhere else: --store DIR takes them into the base station's store"
    );
    ran.map_err(|e| anyhow::anyhow!("{e:#}; {taken}"))?;
    log::warn!("{taken}");
    Ok(())
}

/// Runs it; `relieved`: the records that the recorder was relieved of, and that no store has.
fn run_counting(args: &Args, relieved: &mut u64) -> Result<()> {
    let To { origin, station, key } = to(args)?;
    if key.is_none() {
        log::warn!("the command is not signed: anyone who reaches the line could give it");
    }
    let settings =
        Settings { half_duplex: args.half_duplex, ..Settings::serial(origin.baud().unwrap_or(args.baud)) };
    // Where several call, the first need not be the one.
    let once = station.is_none() || !matches!(origin, Origin::Listen(_));
    let line = Line { origin: origin.clone(), station, settings, once };
    let mut talk = Talk::of(&args.order, station)?;
    let (mut since, wait) = (Instant::now(), Duration::from_secs(args.wait));
    // How long an answer may take the wait says; a recorder that takes samples for minutes is silent meanwhile.
    let idle = wait + LONGEST_SILENCE;
    let rules = Rules { idle, keep_days: None, retain: Retain::default(), identify: false };
    let mut base = Base::new(None);
    if let Some(folder) = args.store.as_deref().filter(|folder| !folder.is_dir()) {
        mistake!("--store {}: there is no such folder: it is the base station's store", folder.display());
    }
    let store = args.store.as_deref().map(|folder| Store::open(folder, &mut base)).transpose()?;
    if store.is_none() {
        // A base station will want them, and keep them.
        base.borrow_records(talk.leaves());
    }
    let mut service = Service::start(base, store, vec![line], rules)?;
    // Who the recorder is, is asked first: what it holds of its answers to earlier commands has come then.
    let who = bytes_of(&Command::Identify { token: base_tokens::who() }, &mut [0; COMMAND_BYTES]).to_vec();
    let (mut asked, mut met, mut called) = (false, talk.asks(), key.is_some());
    let (mut heard, begun) = (false, Instant::now());
    let said = service.feed().subscribe(WAITING);
    while since.elapsed() < wait + talk.patience() && begun.elapsed() < idle + talk.patience() {
        let goes_on = service.turn()?;
        service.notes().iter().for_each(|note| log::warn!("{note}"));
        let taken = said.take_within(Duration::ZERO);
        for record in taken.iter().flat_map(|t| t.records.iter()) {
            let wanted = station.is_none_or(|s| record["station"] == s);
            if !wanted || record["type"] == "line" || !(heard || talk.relieves_of(record)) {
                continue;
            }
            *relieved += u64::from(talk.relieves_of(record) && args.store.is_none());
            // The answer to the question before the command is nothing that was asked for.
            let of_question = ["hello", "health", "reply"].iter().any(|of| record["type"] == *of);
            if let Some(shown) = talk.shown(record).filter(|_| met || !of_question || talk.relieves()) {
                println!("{shown}");
            }
            let answers = heard && base_tokens::hear(record);
            if heard && if met { talk.heard(record)? } else { answers } {
                (since, met) = (Instant::now(), true);
            }
            if talk.done() {
                // The recorder may forget the answer now: the acknowledgement is on its way.
                service.turn()?;
                std::thread::sleep(Duration::from_millis(50));
                return Ok(());
            }
        }
        let due = match (met, asked) {
            (true, _) => talk.due(),
            (false, true) => None,
            (false, false) => Some(who.clone()),
        };
        if let Some(order) = due {
            let mut streams = service.base().streams().collect::<Vec<_>>().into_iter();
            let given = streams.any(|(stream, who)| {
                let wanted = station.is_none_or(|s| who == Some(s));
                wanted && service.base_mut().order(stream, key.as_ref(), &order)
            });
            if given {
                heard = true;
                if met { talk.given() } else { asked = true }
            }
        }
        if !heard && !called && begun.elapsed() > UNASKED {
            let streams = service.base().streams().map(|(stream, _)| stream).collect::<Vec<_>>();
            called = !streams.is_empty();
            streams.into_iter().for_each(|stream| service.base_mut().identify(stream));
        }
        if !goes_on {
            bail!("{origin}: the line was closed before the recorder answered");
        }
    }
    match (heard, talk.silence()) {
        (false, _) if service.base().hears_without_link() => bail!(
            "{origin}: the recorder speaks without a link, and takes no signed command so: --unsigned, where its image has no key"
        ),
        (false, _) => bail!("{origin}: no recorder was heard in {} s", args.wait),
        (true, Some(words)) => bail!("{origin}: {words}"),
        (true, None) if service.base().hears_without_link() => bail!(
            "{origin}: the recorder has not answered in {} s: without a link a command is given once, and a line's noise may have \
             taken it or its answer: send it again",
            args.wait
        ),
        (true, None) if args.store.is_none() => bail!(
            "{origin}: the recorder has not answered in {} s: is this its key? (it says BadCommand where it is not); or do its \
             records stand before the answer? (--store DIR takes them into the base station's store)",
            args.wait
        ),
        (true, None) => bail!(
            "{origin}: the recorder has not answered in {} s: is this its key? (it says BadCommand where it is not)",
            args.wait
        ),
    }
}

/// Where a command goes.
struct To {
    origin: Origin,
    station: Option<u16>,
    key: Option<Key>,
}

fn to(args: &Args) -> Result<To> {
    let mut key = args.key.as_deref().map(command::key).transpose()?;
    let (origin, station) = match (&args.serial, &args.tcp, &args.listen) {
        (Some(device), ..) => (Origin::Serial { device: device.clone(), baud: args.baud }, None),
        (_, Some(to), _) => (Origin::Connect(to.clone()), None),
        (_, _, Some(at)) => (Origin::Listen(at.clone()), None),
        _ => {
            let path = args.stations.as_deref().context("--stations needs a file")?;
            let id = args.station.context("--stations needs --station ID")?;
            let listed = stations::find(&stations::read(path)?, id, path)?;
            key = key.or(listed.key);
            let line =
                listed.line.with_context(|| format!("{}: station {id} has no `line`", path.display()))?;
            (line, Some(id))
        }
    };
    if let Origin::File { path, .. } = &origin {
        bail!("{}: a file takes no commands", path.display());
    }
    if key.is_none() && !args.unsigned {
        bail!(
            "a command is signed with --key FILE, or with the stations file's `key_file`; --unsigned for a recorder without a key"
        );
    }
    Ok(To { origin, station, key: key.filter(|_| !args.unsigned) })
}

/// Whether the recorder has done what it was told.
pub(super) fn done(reply: &Value) -> Result<()> {
    match reply["status"].as_u64() {
        Some(0) => Ok(()),
        Some(1) => bail!("the recorder has refused the command"),
        _ => bail!("the recorder does not know the command"),
    }
}
