//! `seabearing base`: the base station: receive telemetry of any number of recorders, store, show, export.

use super::base_screen::{Exports, Known, Screen};
use crate::base::export::{self, Format, Positions};
use crate::base::fusion::regions::Regions;
use crate::base::fusion::task::Task;
use crate::base::line::Line;
use crate::base::origin::Origin;
use crate::base::record::micros;
use crate::base::service::{Rules, Service};
use crate::base::stations::{self, Listed};
use crate::base::store::{self, Retain, Store};
use crate::base::utc::Teller;
use crate::base::{Base, LINE_BAUD, view};
use crate::interrupt::{self, Keeping};
use crate::station::{Calibrations, Station};
use anyhow::{Result, bail};
use seabearing_core::wire::link::Settings;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Options that say where telemetry comes from.
#[cfg(feature = "mqtt")]
const ORIGINS: [&str; 6] = ["input", "serial", "tcp", "listen", "stations", "from_mqtt"];
#[cfg(not(feature = "mqtt"))]
const ORIGINS: [&str; 5] = ["input", "serial", "tcp", "listen", "stations"];

/// What an interruption waits for is waited for so long.
const HURRY: Duration = Duration::from_secs(3);
/// Longest that the end of all input waits for the broker, and for alarms to be delivered.
const SETTLE: Duration = Duration::from_secs(30);

/// Arguments of `seabearing base`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  seabearing base telemetry.bin --station station.toml --export tracks.kml\n  \
    seabearing base --serial /dev/ttyACM0 --baud 115200 --store out/base\n  \
    seabearing base --listen 127.0.0.1:4500 --json | jq 'select(.type == \"track\")'\n  \
    seabearing base --stations stations.toml --store out/network --retain raw=3m,records=2y\n  \
    seabearing base --stations stations.toml --store out/network --page 127.0.0.1:8080\n  \
    seabearing base --stations stations.toml --store out/network --ais udp:0.0.0.0:10110\n  \
    seabearing base --listen 0.0.0.0:4500 --store out/north --mqtt mqtt://127.0.0.1:1883/seabearing/north\n  \
    seabearing base --from-mqtt centre.toml --stations stations.toml --store out/centre\n  \
    seabearing base check --store out/base\n\n\
    A stations file is a list of [[stations]] with the keys of [station] and\n  \
    line = \"listen:ADDR:PORT\", \"tcp:HOST:PORT\", \"serial:DEVICE:BAUD\" or \"file:PATH\"\n  \
    key_file = \"east.key\", to sign commands with (`seabearing base send`)\n  \
    utc_of_sample_0 = \"2024-05-01T09:00:00Z\", where a recorder has no clock\n  \
    station_file = \"east.toml\", for the sensitivities with which levels are told\n  \
    orientation_sd_deg = 0.5, how well its orientation is known; bearings of stations with positions are fused"
)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(group(clap::ArgGroup::new("origin").required(true).multiple(true).args(ORIGINS)))]
pub struct Args {
    #[command(subcommand)]
    action: Option<Action>,
    /// Files with telemetry, or - for standard input
    input: Vec<PathBuf>,
    /// Serial device (may be given several times)
    #[arg(long, value_name = "DEVICE")]
    serial: Vec<String>,
    /// Speed of the serial devices
    #[arg(long, default_value_t = LINE_BAUD)]
    baud: u32,
    /// Only one end of the line can speak at a time
    #[arg(long)]
    half_duplex: bool,
    /// Connect to a recorder or a serial server (may be given several times)
    #[arg(long, value_name = "HOST:PORT", value_parser = super::address)]
    tcp: Vec<String>,
    /// Take calls of any number of recorders at once (may be given several times)
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = super::address)]
    listen: Vec<String>,
    /// File of stations, each with its line
    #[arg(long, value_name = "STATIONS.toml")]
    stations: Option<PathBuf>,
    /// Wait for more at the end of a file
    #[arg(long)]
    follow: bool,
    /// Stop when a connection ends instead of waiting for the next
    #[arg(long)]
    once: bool,
    /// Ask every recorder who it is when its connection begins
    #[arg(long)]
    identify: bool,
    /// Seconds without a byte after which a line is silent; a TCP connection is then closed
    #[arg(long, value_name = "SECONDS", default_value_t = 180, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    idle: u64,
    /// Tell the stations of the stations file that have a key the time, when they start and every so many seconds: for
    /// recorders without a satellite receiver
    #[arg(long, value_name = "SECONDS", requires = "stations", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    tell_utc: Option<u64>,
    /// Station file: position for exports, sensitivities for levels, sample rate until the recorder tells it
    #[arg(long, value_name = "STATION.toml")]
    station: Option<PathBuf>,
    /// UTC of sample 0, RFC 3339
    #[arg(long, value_name = "TIME", value_parser = super::instant)]
    start: Option<time::OffsetDateTime>,
    /// Folder that keeps all bytes and records; a base station started again goes on from there
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
    /// Let go of what came more than so many days ago
    #[arg(long, value_name = "DAYS", requires = "store", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    keep_days: Option<u32>,
    /// Months that the store keeps, of bytes and of records, before the open one: as raw=3m,records=2y
    #[arg(long, value_name = "RULE", requires = "store")]
    retain: Option<Retain>,
    /// File for the tracks, .csv, .geojson, .jsonl, .kml or .parquet (may be given several times)
    #[arg(long, value_name = "FILE")]
    export: Vec<PathBuf>,
    /// Folder for pictures of bearings and tracks
    #[arg(long, alias = "plot", value_name = "DIR")]
    plots: Option<PathBuf>,
    /// Serve the live page at this address, and go on until interrupted even where all input has ended
    #[cfg(feature = "page")]
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = super::address)]
    page: Option<String>,
    /// Records over a broker
    #[cfg(feature = "mqtt")]
    #[command(flatten)]
    mqtt: super::base_mqtt::Mqtt,
    /// What else watches the records
    #[command(flatten)]
    watch: super::base_watch::Watch,
    /// Records as JSON Lines on standard output instead of the view
    #[arg(long)]
    json: bool,
}

/// What else a base station does.
#[derive(clap::Subcommand)]
enum Action {
    /// Give a command to a recorder with a link, and print its answer
    Send(Box<super::base_send::Args>),
    /// Say what is in a store and whether it is sound
    Check(Kept),
    /// Make the records of a store anew from its bytes
    Rebuild(Kept),
    /// Tell the base station of a store that a person has seen an alarm
    Acknowledge(super::base_watch::Acknowledge),
}

/// A store.
#[derive(clap::Args)]
struct Kept {
    /// Folder of the store
    #[arg(long, value_name = "DIR")]
    store: PathBuf,
    /// The result as JSON
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Where telemetry comes from, and of which station.
    fn lines(&self, listed: &[Listed], station: Option<u16>) -> Vec<Line> {
        let files = self.input.iter().map(|path| match path.as_os_str() == "-" {
            true => Origin::Stdin,
            false => Origin::File { path: path.clone(), follow: self.follow },
        });
        let serial =
            self.serial.iter().map(|device| Origin::Serial { device: device.clone(), baud: self.baud });
        let tcp = self.tcp.iter().cloned().map(Origin::Connect);
        let listen = self.listen.iter().cloned().map(Origin::Listen);
        let own = files.chain(serial).chain(tcp).chain(listen).map(|origin| {
            let calls = matches!(origin, Origin::Listen(_));
            (origin, station.filter(|_| !calls))
        });
        let listed = listed.iter().filter_map(|s| Some((s.line.clone()?, Some(s.config.id))));
        let line = |(origin, station): (Origin, Option<u16>)| {
            let baud = origin.baud().unwrap_or(self.baud);
            let settings = Settings { half_duplex: self.half_duplex, ..Settings::serial(baud) };
            Line { origin, station, settings, once: self.once }
        };
        own.chain(listed).map(line).collect()
    }
}

/// Runs the command.
///
/// # Errors
/// One line for a person: a line or the store cannot be used, or no telemetry was in it.
pub fn run(args: Args) -> Result<()> {
    match &args.action {
        Some(Action::Send(args)) => return super::base_send::run(args),
        Some(Action::Check(kept)) => return check(kept),
        Some(Action::Acknowledge(args)) => return super::base_watch::acknowledge(args),
        Some(Action::Rebuild(kept)) => {
            let records = store::rebuild(&kept.store)?;
            log::info!("{records} records made anew in {}", kept.store.display());
            return Ok(());
        }
        None => {}
    }
    let station = args.station.as_deref().map(Station::read).transpose()?;
    let listed = args.stations.as_deref().map(stations::read).transpose()?.unwrap_or_default();
    let start = args.start;
    let places = places(&args, station.as_ref(), &listed)?;
    for path in &args.export {
        // A wrong ending or a missing position is better known now than after the deployment.
        let format = Format::of(path).map_err(|e| super::Mistake(format!("{e:#}")))?;
        export::check(path, format, &places, "--station STATION.toml")?;
    }
    let alarms = args.watch.read(&places, &listed, args.store.is_some())?;
    let lines = args.lines(&listed, station.as_ref().map(|s| s.config.id).filter(|id| *id > 0));
    #[cfg(feature = "mqtt")]
    let brokers = args.mqtt.read()?;
    #[cfg(feature = "mqtt")]
    let brought = brokers.brings();
    #[cfg(not(feature = "mqtt"))]
    let brought = false;
    if lines.is_empty() && !brought {
        bail!("{}: no station has a `line`", args.stations.unwrap_or_default().display());
    }
    #[cfg(feature = "page")]
    let page = args.page.as_deref().map(seabearing_page::Page::bind).transpose()?;
    let mut base = Base::new(station.as_ref().map(|s| s.config.rate_hz));
    let mut store = args.store.as_deref().map(|folder| Store::open(folder, &mut base)).transpose()?;
    if let Some(store) = &mut store {
        if let Some(s) = &station {
            store.describe(None, s.config.lat_lon_deg, Some(s.config.rate_hz))?;
        }
        for s in &listed {
            store.describe(Some(s.config.id), s.config.lat_lon_deg, None)?;
        }
        if store.resumed() > 0 {
            log::info!("going on after {} records", store.resumed());
        }
    }
    let own = listed.iter().map(|s| (s.config.id, s.calibration.clone()));
    let calibrations = Calibrations::new(own, station.as_ref().map(|s| s.calibration.clone()));
    base.calibrate(calibrations);
    base.say_start(start.map(micros));
    for s in &listed {
        if let Some(start) = s.start {
            base.say_start_of(s.config.id, micros(start));
        }
    }
    let rules = Rules {
        idle: Duration::from_secs(args.idle),
        keep_days: args.keep_days,
        retain: args.retain.unwrap_or_default(),
        identify: args.identify,
    };
    let names: Vec<String> = lines.iter().map(|l| l.origin.to_string()).collect();
    let mut service = Service::start(base, store, lines, rules)?;
    #[cfg(feature = "mqtt")]
    let mqtt = brokers.start(&mut service, args.store.as_deref())?;
    #[cfg(feature = "mqtt")]
    let counters = mqtt.counters();
    #[cfg(not(feature = "mqtt"))]
    let counters = String::new;
    if let Some(every) = args.tell_utc {
        let keys: BTreeMap<u16, _> = listed.iter().filter_map(|s| Some((s.config.id, s.key?))).collect();
        for s in listed.iter().filter(|s| s.key.is_none()) {
            log::warn!("station {} has no `key_file`: it is not told the time", s.config.id);
        }
        service.tell_utc(Teller::new(Duration::from_secs(every), keys));
    }
    #[cfg(feature = "page")]
    let page = page
        .map(|page| super::base_page::serve(page, &service, args.store.clone(), &listed, &places))
        .transpose()?;
    for address in service.listening() {
        log::info!("listening at {address}");
    }
    let fused = fused(&listed);
    let counters = move || counters() + &fused;
    let before = service.base().counters();
    let must_show = service.ends() || args.store.is_none();
    let watch = args.watch.start(alarms, &service, args.store.as_deref(), &listed, &places, counters)?;
    #[cfg(feature = "page")]
    page.iter().for_each(|page| page.stand(&watch.standing));
    let fusion = fuse(&service, &listed, args.store.as_deref())?;
    let mut exports = Exports::start(args.export.clone(), args.plots.clone(), places);
    let reads_keys = args.input.iter().any(|path| path.as_os_str() == "-");
    let known = Known { listed: &listed, alarms: &watch.standing, reads_keys };
    let mut screen = Screen::start(args.json, service.ends(), &service, known);
    let tell = |notes: Vec<String>| {
        for note in notes {
            log::warn!("{note}");
            #[cfg(feature = "page")]
            page.iter().for_each(|page| page.note(&note));
        }
    };
    // Of lines that go on an interruption is the end like any other; files are there to be read again.
    let keeping = (!service.ends()).then(Keeping::begin);
    while service.turn()? && !interrupt::asked() {
        tell(service.notes());
        #[cfg(feature = "mqtt")]
        tell(mqtt.notes());
        let shown = screen.look();
        if shown.is_err() && !must_show {
            log::warn!("nobody takes the results any more; storing goes on");
        } else {
            shown?;
        }
        exports.now_and_then(service.base());
    }
    if let Some(fusion) = &fusion {
        fusion.settle();
        while service.take_noted()? {}
    }
    let hurry = interrupt::asked().then_some(HURRY);
    watch.settle(&mut service, hurry)?;
    tell(service.notes());
    // What a store keeps is told after the next start.
    let most = hurry.filter(|_| args.store.is_some()).unwrap_or(SETTLE);
    watch.finish(most);
    #[cfg(feature = "mqtt")]
    let unpublished = mqtt.settle(args.store.is_some(), most, &tell);
    #[cfg(feature = "mqtt")]
    tell(mqtt.notes());
    #[cfg(not(feature = "mqtt"))]
    let unpublished: Option<String> = None;
    // Whoever ends it knows that something may be left: it is told, and no failure.
    let unpublished = match unpublished {
        Some(text) if interrupt::asked() => {
            log::warn!("{text}");
            None
        }
        other => other,
    };
    let after = service.base().counters();
    // Of streams without a single frame there is nothing to show but the reason.
    if after.stream.frames == before.stream.frames && !interrupt::asked() {
        let names = names.join(", ");
        match after.bytes - before.bytes {
            0 => bail!("{names}: no telemetry came"),
            n => bail!(
                "{names}: no telemetry frame in {n} bytes: is this a recorder's stream, at the right speed?"
            ),
        }
    }
    service.feed().end();
    // Files first: whoever reads standard output may not read on.
    let written = exports.finish(service.base());
    let shown = screen.finish(&view::text(service.base()), interrupt::asked().then_some(HURRY));
    written?;
    if must_show && !interrupt::asked() {
        shown?;
    }
    if args.json {
        log::info!("{}", service.base().counters());
    }
    if let Some(keeping) = keeping {
        keeping.end(|| "what came is written".to_owned());
    }
    #[cfg(feature = "page")]
    if page.is_some() {
        unpublished.iter().for_each(|text| log::warn!("{text}"));
        super::base_page::stay();
    }
    unpublished.map_or(Ok(()), |text| bail!("{text}"))
}

/// How many stations are fused, and how many are too many, for Prometheus.
fn fused(listed: &[Listed]) -> String {
    let (regions, _) = Regions::of(listed);
    let line = |name: &str, help: &str, n: usize| {
        format!("# HELP seabearing_{name} {help}.\n# TYPE seabearing_{name} gauge\nseabearing_{name} {n}\n")
    };
    line("fusion_stations", "Stations whose bearings are fused", regions.stations())
        + &line(
            "fusion_stations_left_out",
            "Stations that are not fused, because there are too many",
            regions.left_out,
        )
}

/// Fuses the bearings of the stations of a stations file, where two or more have a position.
fn fuse(service: &Service, listed: &[Listed], store: Option<&Path>) -> Result<Option<Task>> {
    if listed.len() < 2 {
        return Ok(None);
    }
    let (regions, notes) = Regions::of(listed);
    for note in notes {
        log::warn!("{note}");
    }
    if regions.regions.is_empty() {
        log::warn!("no two stations have a position (`position`) near each other: bearings are not fused");
        return Ok(None);
    }
    Task::start(regions, service, store).map(Some)
}

/// Where stations are, as the command line, the stations file or the store says.
fn places(args: &Args, station: Option<&Station>, listed: &[Listed]) -> Result<Positions> {
    let kept = match &args.store {
        Some(folder)
            if folder.exists() && std::fs::read_dir(folder).is_ok_and(|mut f| f.next().is_some()) =>
        {
            store::positions(folder)?
        }
        _ => Default::default(),
    };
    let said = station.and_then(|s| s.config.lat_lon_deg);
    let mut places = Positions { otherwise: said.or(kept.get(&None).copied()), ..Positions::default() };
    let kept = kept.into_iter().filter_map(|(of, at)| Some((u64::from(of?), at)));
    let listed = listed.iter().filter_map(|s| Some((u64::from(s.config.id), s.config.lat_lon_deg?)));
    places.of_station.extend(kept.chain(listed));
    Ok(places)
}

/// `seabearing base check`.
fn check(kept: &Kept) -> Result<()> {
    let found = store::check(&kept.store)?;
    super::print_records(&[found.contents], kept.json)?;
    if !found.faults.is_empty() {
        bail!("the store {} is not sound: {}", kept.store.display(), found.faults.join("; "));
    }
    if !kept.json {
        println!("sound");
    }
    Ok(())
}
