//! `seabearing base`: the base station: receive telemetry, store, show, export.

use crate::base::about::About;
use crate::base::export::{self, Format, Positions};
use crate::base::link::{LineEvent, LineLink, Origin};
use crate::base::store::Store;
use crate::base::{Base, LINE_BAUD, view};
use crate::plot::result;
use crate::station::Station;
use anyhow::{Context, Result, bail};
use seabearing_core::wire::link::Settings;
use seabearing_core::wire::{Command, Encoder};
use serde_json::Value;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// How often the terminal view is drawn.
const DRAW: Duration = Duration::from_millis(250);
/// How often exports are written while telemetry comes in.
const EXPORT: Duration = Duration::from_secs(10);

/// Arguments of `seabearing base`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  seabearing base telemetry.bin --station station.toml --export tracks.kml\n  \
    seabearing base --serial /dev/ttyACM0 --baud 115200 --store out/base\n  \
    seabearing base --listen 127.0.0.1:4500 --json | jq 'select(.type == \"track\")'"
)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(group(clap::ArgGroup::new("origin").required(true).args(["input", "serial", "tcp", "listen"])))]
pub struct Args {
    #[command(subcommand)]
    action: Option<Action>,
    /// File with telemetry, or - for standard input
    input: Option<PathBuf>,
    /// Serial device
    #[arg(long, value_name = "DEVICE")]
    serial: Option<String>,
    /// Speed of the serial device
    #[arg(long, default_value_t = LINE_BAUD)]
    baud: u32,
    /// Only one end of the line can speak at a time
    #[arg(long)]
    half_duplex: bool,
    /// Connect to a recorder or a serial server
    #[arg(long, value_name = "HOST:PORT")]
    tcp: Option<String>,
    /// Wait for connections
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<String>,
    /// Wait for more at the end of a file
    #[arg(long)]
    follow: bool,
    /// Stop when a connection ends instead of waiting for the next
    #[arg(long)]
    once: bool,
    /// Ask the recorder who it is when a connection begins
    #[arg(long)]
    identify: bool,
    /// Station file: position for exports, sample rate until the recorder tells it
    #[arg(long, value_name = "STATION.toml")]
    station: Option<PathBuf>,
    /// UTC of sample 0, RFC 3339
    #[arg(long, value_name = "TIME")]
    start: Option<String>,
    /// Folder that keeps raw bytes and records; a base station started again goes on from there
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
    /// File for the tracks, .csv, .geojson, .jsonl, .kml or .parquet (may be given several times)
    #[arg(long, value_name = "FILE")]
    export: Vec<PathBuf>,
    /// Folder for pictures of bearings and tracks
    #[arg(long, alias = "plot", value_name = "DIR")]
    plots: Option<PathBuf>,
    /// Records as JSON Lines on standard output instead of the view
    #[arg(long)]
    json: bool,
}

/// What else a base station does.
#[derive(clap::Subcommand)]
enum Action {
    /// Give a command to a recorder with a link, and print its answer
    Send(super::base_send::Args),
}

impl Args {
    fn origin(&self) -> Origin {
        match (&self.input, &self.serial, &self.tcp, &self.listen) {
            (Some(path), ..) if path.as_os_str() == "-" => Origin::Stdin,
            (Some(path), ..) => Origin::File { path: path.clone(), follow: self.follow },
            (_, Some(device), ..) => Origin::Serial { device: device.clone(), baud: self.baud },
            (_, _, Some(to), _) => Origin::Connect(to.clone()),
            (_, _, _, at) => Origin::Listen(at.clone().unwrap_or_default()),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// One line for a person: the origin or the store cannot be used, or no telemetry was in it.
pub fn run(args: Args) -> Result<()> {
    if let Some(Action::Send(args)) = &args.action {
        return super::base_send::run(args);
    }
    let station = args.station.as_deref().map(Station::read).transpose()?;
    let start = args.start.as_deref().map(|t| super::instant("--start", t)).transpose()?;
    // What was said of the recorder before holds until something else is said.
    let kept = args.store.as_deref().map(About::read).transpose()?.unwrap_or_default();
    let mut about = About {
        rate_hz: station.as_ref().map(|s| s.config.rate_hz).or(kept.rate_hz),
        place: station.as_ref().and_then(|s| s.config.lat_lon_deg).or(kept.place),
        starts: kept.starts.clone(),
    };
    let mut base = Base::new(about.rate_hz, None);
    base.set_starts(kept.starts.clone());
    let places = Positions { otherwise: about.place, ..Positions::default() };
    for path in &args.export {
        // A wrong ending or a missing position is better known now than after the deployment.
        export::check(path, Format::of(path)?, &places, "--station STATION.toml")?;
    }
    let origin = args.origin();
    let mut store = args.store.as_deref().map(|folder| Store::open(folder, &mut base)).transpose()?;
    if let Some(folder) = args.store.as_deref().filter(|_| about != kept) {
        about.write(folder)?;
    }
    base.say_start(start);
    if let Some(store) = store.as_ref().filter(|s| s.resumed() > 0) {
        eprintln!("seabearing: going on after {} records", store.resumed());
    }
    let before = base.counters();
    let mut link = LineLink::open(origin.clone(), args.once)?;
    if let Some(address) = link.listening() {
        eprintln!("seabearing: listening at {address}");
    }
    let mut line = Settings::serial(args.baud);
    line.half_duplex = args.half_duplex;
    base.line(line);
    let begun = Instant::now();
    let mut desk = Desk { args: &args, places, drawn: None, exported: Instant::now() };
    let mut buffer = vec![0u8; 1 << 16];
    let mut records: Vec<Value> = Vec::new();
    let mut commands = Encoder::default();
    // A stream begins with the link; bytes stored before it may have been cut off anywhere.
    let mut begins = true;
    loop {
        let event = if begins { LineEvent::Began } else { link.read(&mut buffer)? };
        begins = false;
        records.clear();
        let bytes = match event {
            LineEvent::Began => {
                if args.identify {
                    link.send(commands.frame(&Command::Identify { token: 1 }));
                }
                if base.counters().bytes > 0 { &Base::BEGIN[..] } else { &[] }
            }
            LineEvent::Bytes(n) => &buffer[..n],
            LineEvent::Idle | LineEvent::End => &[],
        };
        // First of all the bytes are kept; then they are read, and only then acknowledged.
        if let Some(store) = &mut store {
            store.bytes(bytes)?;
        }
        let now_us = begun.elapsed().as_micros() as u64;
        base.push_at(now_us, bytes, &mut records);
        if let Some(folder) = args.store.as_deref().filter(|_| *base.starts() != about.starts) {
            about.starts = base.starts().clone();
            about.write(folder)?;
        }
        if let Some(store) = &mut store {
            store.records(&records)?;
        }
        if event == LineEvent::Began {
            base.begin_stream();
        }
        while let Some(frame) = base.answer(now_us).filter(|_| event != LineEvent::End) {
            if let Some(store) = &mut store {
                store.hold()?;
            }
            link.send(frame);
        }
        if event == LineEvent::End {
            base.end_stream();
        }
        // Of a stream without a single frame there is nothing to show but the reason, below.
        if event == LineEvent::End && base.counters().stream.frames == before.stream.frames {
            break;
        }
        desk.show(&mut base, &records, event == LineEvent::End)?;
        if event == LineEvent::End {
            break;
        }
    }
    if let Some(store) = &mut store {
        store.sync()?;
    }
    let after = base.counters();
    let fresh = after.bytes - before.bytes;
    if after.stream.frames == before.stream.frames {
        match fresh {
            0 | 1 => bail!("{origin}: no telemetry came"),
            n => bail!(
                "{origin}: no telemetry frame in {n} bytes: is this a recorder's stream, at the right speed?"
            ),
        }
    }
    Ok(())
}

/// What a person sees and the files written besides the store.
struct Desk<'a> {
    args: &'a Args,
    places: Positions,
    drawn: Option<Instant>,
    exported: Instant,
}

impl Desk<'_> {
    fn show(&mut self, base: &mut Base, records: &[Value], last: bool) -> Result<()> {
        for warning in base.warnings() {
            eprintln!("seabearing: {warning}");
        }
        let mut out = std::io::stdout().lock();
        if self.args.json {
            for record in records {
                writeln!(out, "{record}")?;
            }
            out.flush()?;
            if last {
                eprintln!("seabearing: {}", base.counters());
            }
        } else if last || (out.is_terminal() && self.drawn.is_none_or(|d| d.elapsed() > DRAW)) {
            if out.is_terminal() {
                // Home, draw, and clear what is left of the picture before.
                write!(out, "\x1b[H{}\x1b[J", view::text(base).replace('\n', "\x1b[K\n"))?;
            } else {
                write!(out, "{}", view::text(base))?;
            }
            out.flush()?;
            self.drawn = Some(Instant::now());
        }
        if last || self.exported.elapsed() > EXPORT {
            for path in &self.args.export {
                export::write(path, Format::of(path)?, &base.track_records(), &self.places)?;
            }
            if let Some(folder) = &self.args.plots {
                pictures(base, folder).with_context(|| format!("cannot plot into {}", folder.display()))?;
            }
            self.exported = Instant::now();
        }
        Ok(())
    }
}

/// Bearings against time and tracks on a map, of the last session.
fn pictures(base: &Base, folder: &std::path::Path) -> Result<()> {
    let session = base.counters().sessions;
    let rate = base.clock().rate_hz;
    let bearings: Vec<_> = base.bearings().filter(|(s, _)| *s == session).map(|(_, b)| *b).collect();
    let tracks: Vec<_> = base
        .tracks()
        .iter()
        .filter(|((s, _), _)| *s == session)
        .flat_map(|(_, history)| history)
        .copied()
        .collect();
    result::bearings(&bearings, rate, &[]).write(&folder.join("bearings.svg"))?;
    result::tracks(&tracks, rate, &[]).write(&folder.join("tracks.svg"))
}
