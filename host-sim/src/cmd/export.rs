//! `seabearing export`: records of a base station's store as files that other programs open.

use super::instant;
use crate::base::export::{self, Format, Positions};
use crate::base::store::{self, Wanted};
use crate::station::Station;
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// Arguments of `seabearing export`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing export --store out/base --format csv --out records.csv\n  \
    seabearing export --store out/base --format kml --from 2024-05-01T09:00:00Z --to 2024-05-01T12:00:00Z --out morning.kml\n\n\
    JSON Lines, CSV and Parquet hold every record, GeoJSON and KML the tracks. A store that a base station is writing \
    into may be read.")]
pub struct Args {
    /// Folder of the store (`seabearing base --store`)
    #[arg(long, value_name = "DIR")]
    store: PathBuf,
    /// What the file is written as; by default what its name ends in
    #[arg(long, value_enum)]
    format: Option<Name>,
    /// Only records at or after this UTC, RFC 3339
    #[arg(long, value_name = "TIME")]
    from: Option<String>,
    /// Only records before this UTC, RFC 3339
    #[arg(long, value_name = "TIME")]
    to: Option<String>,
    /// Only records of this station
    #[arg(long, value_name = "ID")]
    station: Option<u16>,
    /// Network file with the stations' positions, where the store does not know them
    #[arg(long, value_name = "STATIONS.toml")]
    stations: Option<PathBuf>,
    /// File to write
    #[arg(long, value_name = "FILE")]
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
}

/// Runs the command.
///
/// # Errors
/// One line for a person: no store, no such station, or a map without positions.
pub fn run(args: Args) -> Result<()> {
    let format = match args.format {
        None => Format::of(&args.out)?,
        Some(Name::Jsonl) => Format::JsonLines,
        Some(Name::Csv) => Format::Csv,
        Some(Name::Geojson) => Format::GeoJson,
        Some(Name::Kml) => Format::Kml,
        Some(Name::Parquet) => Format::Parquet,
    };
    let time = |option: &str, text: &Option<String>| text.as_deref().map(|t| instant(option, t)).transpose();
    let (from, to) = (time("--from", &args.from)?, time("--to", &args.to)?);
    if let (Some(from), Some(to)) = (from, to)
        && from >= to
    {
        bail!("--to must be later than --from");
    }
    let folder = args.out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if std::fs::canonicalize(folder).ok().is_some_and(|f| std::fs::canonicalize(&args.store).ok() == Some(f))
    {
        bail!("{}: the store itself; write the export into another folder", args.out.display());
    }
    let kept = store::positions(&args.store)?;
    let mut places = Positions { otherwise: kept.get(&None).copied(), ..Positions::default() };
    places.of_station.extend(kept.into_iter().filter_map(|(of, at)| Some((u64::from(of?), at))));
    for station in args.stations.as_deref().map(Station::read_network).transpose()?.unwrap_or_default() {
        places.of_station.extend(station.lat_lon_deg.map(|at| (u64::from(station.id), at)));
    }
    export::check(&args.out, format, &places, "--stations STATIONS.toml")?;
    if let Some(wanted) = args.station {
        let stations = store::stations(&args.store)?;
        if !stations.contains(&wanted) {
            let known: Vec<String> = stations.iter().map(u16::to_string).collect();
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            bail!("{}: no records of station {wanted}; stations there: {known}", args.store.display());
        }
    }
    let mut records = Vec::new();
    let wanted = Wanted { station: args.station, from, to, track: None };
    let without_utc = store::read(&args.store, &wanted, |record| records.push(record))?;
    if without_utc > 0 {
        eprintln!(
            "seabearing: {without_utc} records left out that carry no UTC: `seabearing base` gives it to records it \
             receives with --start"
        );
    }
    export::write(&args.out, format, &records, &places).context("cannot export")?;
    eprintln!("seabearing: {} records to {}", records.len(), args.out.display());
    Ok(())
}
