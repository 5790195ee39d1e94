//! `seabearing export`: records, of a base station's store or of `process`, as files that other programs open.

use super::{Mistake, instant, mistake};
use crate::base::export::{self, Format, Positions};
use crate::base::store::{self, Wanted};
use crate::station::{Calibrations, Station};
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::io::BufRead;
use std::path::{Path, PathBuf};

/// Arguments of `seabearing export`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing export --store out/base --format csv --out records.csv\n  \
    seabearing export --store out/base --format kml --from 2024-05-01T09:00:00Z --to 2024-05-01T12:00:00Z --out morning.kml\n  \
    seabearing export records.jsonl --format raven --out pass.selections.txt\n  \
    seabearing export records.jsonl --seed-id YV.RR03.00 --out calls.quakeml\n\n\
    JSON Lines, CSV and Parquet hold every record, GeoJSON and KML the tracks; Raven, Audacity and PAMGuard (events for PAMpal) \
    tracks, presences, calls and bearings, QuakeML the calls and T phases of an ocean-bottom station. A store that a base \
    station is writing into may be read.")]
pub struct Args {
    /// Records of `process` or `base` (JSON Lines)
    #[arg(value_name = "RECORDS.jsonl", required_unless_present = "store", conflicts_with = "store", value_parser = super::input())]
    records: Vec<PathBuf>,
    /// Folder of the store (`seabearing base --store`)
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
    /// What the file is written as; by default what its name ends in
    #[arg(long, value_enum)]
    format: Option<Name>,
    /// Only records at or after this UTC, RFC 3339
    #[arg(long, value_name = "TIME", value_parser = instant)]
    from: Option<time::OffsetDateTime>,
    /// Only records before this UTC, RFC 3339
    #[arg(long, value_name = "TIME", value_parser = instant)]
    to: Option<time::OffsetDateTime>,
    /// Only records of this station
    #[arg(long, value_name = "ID")]
    station: Option<u16>,
    /// Network file with the stations' positions, where the store does not know them, and the station files of which levels of a
    /// store get their sensitivities
    #[arg(long, value_name = "STATIONS.toml", value_parser = super::input())]
    stations: Option<PathBuf>,
    /// What seismologists call the station, for QuakeML
    #[arg(long, value_name = "NET.STA.LOC.CHAN", value_parser = seed_id)]
    seed_id: Option<String>,
    /// File to write
    #[arg(long, value_name = "FILE", value_parser = super::output())]
    out: PathBuf,
}

/// A format as it is called on the command line.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Name {
    Jsonl,
    Csv,
    Geojson,
    Kml,
    Parquet,
    Raven,
    Audacity,
    Pamguard,
    Quakeml,
}

/// A station as seismologists write it.
fn seed_id(text: &str) -> Result<String, &'static str> {
    let codes: Vec<&str> = text.split('.').collect();
    let named = matches!(codes[..], [network, station, ..] if !network.is_empty() && !station.is_empty());
    let ok = named && codes.len() <= 4;
    ok.then(|| text.to_owned()).ok_or("not a station; NET.STA, NET.STA.LOC or NET.STA.LOC.CHAN was expected")
}

/// Runs the command.
///
/// # Errors
/// One line for a person: no store, no such station, or a map without positions.
pub fn run(args: Args) -> Result<()> {
    let format = match args.format {
        None => Format::of(&args.out).map_err(|e| Mistake(format!("{e:#}; or give --format")))?,
        Some(Name::Jsonl) => Format::JsonLines,
        Some(Name::Csv) => Format::Csv,
        Some(Name::Geojson) => Format::GeoJson,
        Some(Name::Kml) => Format::Kml,
        Some(Name::Parquet) => Format::Parquet,
        Some(Name::Raven) => Format::Raven,
        Some(Name::Audacity) => Format::Audacity,
        Some(Name::Pamguard) => Format::PamGuard,
        Some(Name::Quakeml) => Format::QuakeMl,
    };
    let (from, to) = (args.from, args.to);
    if let (Some(from), Some(to)) = (from, to)
        && from >= to
    {
        mistake!("--to must be later than --from");
    }
    let mut places = Positions { seed_id: args.seed_id, ..Positions::default() };
    if let Some(store) = &args.store {
        let folder = args.out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if std::fs::canonicalize(folder).ok().is_some_and(|f| std::fs::canonicalize(store).ok() == Some(f)) {
            bail!("{}: the store itself; write the export into another folder", args.out.display());
        }
        let kept = store::positions(store)?;
        places.otherwise = kept.get(&None).copied();
        places.of_station.extend(kept.into_iter().filter_map(|(of, at)| Some((u64::from(of?), at))));
    }
    let listed = args.stations.as_deref().map(Station::read_listed).transpose()?;
    let listed = listed.map_or_else(Vec::new, |(_, listed)| listed);
    for station in listed.iter().map(|s| &s.config) {
        places.of_station.extend(station.lat_lon_deg.map(|at| (u64::from(station.id), at)));
    }
    export::check(&args.out, format, &places, "--stations STATIONS.toml")?;
    let wanted = Wanted { station: args.station, from, to, track: None };
    let records = match &args.store {
        Some(store) => {
            let mut records = of_store(store, &wanted)?;
            let own = listed.iter().map(|s| (s.config.id, s.calibration.clone()));
            let calibrations = Calibrations::new(own, None);
            records.iter_mut().for_each(|record| calibrations.apply(record));
            records
        }
        None => of_files(&args.records, &wanted, matches!(format, Format::GeoJson | Format::Kml))?,
    };
    export::write(&args.out, format, &records, &places).context("cannot export")?;
    let written = export::written(format, &records, &places);
    match written == records.len() {
        true => log::info!("{written} records to {}", args.out.display()),
        false => log::info!(
            "{written} of {} records to {}: {}",
            records.len(),
            args.out.display(),
            export::takes(format)
        ),
    }
    Ok(())
}

/// The records wanted of a base station's store.
fn of_store(store: &Path, wanted: &Wanted) -> Result<Vec<Value>> {
    if let Some(station) = wanted.station {
        let stations = store::stations(store)?;
        if !stations.contains(&station) {
            let known: Vec<String> = stations.iter().map(u16::to_string).collect();
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            bail!("{}: no records of station {station}; stations there: {known}", store.display());
        }
    }
    let mut records = Vec::new();
    let without_utc = store::read(store, wanted, |record| records.push(record))?;
    if without_utc > 0 {
        log::warn!(
            "{without_utc} records left out that carry no UTC: `seabearing base` gives it to records it \
             receives with --start"
        );
    }
    Ok(records)
}

/// The records wanted of files. Those that tell no station are of the one whose `hello` came before them in their file, or of any;
/// those without UTC are left out where a span is asked for. `placed`: each tells its station.
fn of_files(files: &[PathBuf], wanted: &Wanted, placed: bool) -> Result<Vec<Value>> {
    let mut records = Vec::new();
    let mut without_utc = 0;
    for path in files {
        let name = path.display();
        let file = std::fs::File::open(path).with_context(|| format!("cannot read {name}"))?;
        let mut greeted = None;
        for (line, n) in std::io::BufReader::new(file).lines().zip(1..) {
            let line = line.with_context(|| format!("cannot read {name}"))?;
            let mut record: Value = match serde_json::from_str(&line) {
                Ok(record @ Value::Object(_)) => record,
                _ if line.trim().is_empty() => continue,
                _ => bail!("{name}, line {n}: no record; JSON Lines of `process` or `base` were expected"),
            };
            if record["type"] == "hello" {
                greeted = record["station"].as_u64();
            }
            let of = record["station"].as_u64().or(greeted);
            if placed && let Some(of) = of {
                record["station"] = of.into();
            }
            if wanted.station.zip(of).is_some_and(|(w, of)| u64::from(w) != of) {
                continue;
            }
            if wanted.from.is_some() || wanted.to.is_some() {
                let utc = record["utc"].as_str().and_then(|t| instant(t).ok());
                let Some(utc) = utc else {
                    without_utc += 1;
                    continue;
                };
                if wanted.from.is_some_and(|from| utc < from) || wanted.to.is_some_and(|to| utc >= to) {
                    continue;
                }
            }
            records.push(record);
        }
    }
    if without_utc > 0 {
        log::warn!("{without_utc} records left out that carry no UTC");
    }
    Ok(records)
}
