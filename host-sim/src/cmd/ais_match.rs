//! `seabearing ais match`: which vessel of AIS each track is, and how wrong the tracks are.

use super::mistake;
use crate::base::store::{self, Wanted};
use crate::station::Station;
use anyhow::{Context, Result, bail};
use seabearing_watch::ais::{self, AisFile, Fleet};
use seabearing_watch::before::{Before, as_before};
use seabearing_watch::errors;
use seabearing_watch::matching::{Rules, heard};
use seabearing_watch::report::{TrackReport, VesselId, utc};
use seabearing_watch::vessels::{Vessels, Word};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::BufRead;
use std::path::{Path, PathBuf};

/// Arguments of `seabearing ais match`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    seabearing ais match --stations stations.toml --ais traffic.csv tracks.jsonl\n  \
    seabearing ais match --stations stations.toml --ais received.nmea --json out/base | jq 'select(.verdict == \"dark\")'\n\n\
    TRACKS are records of `process` or `base` (.jsonl) with UTC, or the folder of a base station's store. AIS is a CSV file \
    (MarineTraffic, CLS or plain layout) or AIVDM sentences with their times. Each track is `vessel`, `dark` (no vessel of \
    AIS is it) or `unmatched` with the reason; a last record sums up errors, their histogram in standard deviations, and \
    the range at which vessels are heard against speed and length.")]
pub struct Args {
    /// Records with tracks (.jsonl), or the folder of a store
    #[arg(required = true, value_name = "TRACKS", value_parser = super::input())]
    tracks: Vec<PathBuf>,
    /// AIS files
    #[arg(long, required = true, value_name = "FILE", value_parser = super::input())]
    ais: Vec<PathBuf>,
    /// Network file with the stations' positions
    #[arg(long, value_name = "STATIONS.toml", value_parser = super::input())]
    stations: PathBuf,
    /// Longest gap between reports of a vessel that is bridged, seconds
    #[arg(long, default_value_t = Rules::default().gap_s)]
    max_gap_s: f64,
    /// Share of vessels without AIS, before anything is known
    #[arg(long, default_value_t = Rules::default().dark_share)]
    dark_share: f64,
    /// Results as JSON Lines
    #[arg(long)]
    json: bool,
}

/// Lines of bad input that are shown.
const SHOWN: usize = 5;

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub(super) fn run(args: &Args) -> Result<()> {
    if !(args.max_gap_s > 0.0 && args.max_gap_s <= 86_400.0) {
        mistake!("--max-gap-s is {}; above 0, at most 86400", args.max_gap_s);
    }
    if !(args.dark_share > 0.0 && args.dark_share < 1.0) {
        mistake!("--dark-share is {}; between 0 and 1", args.dark_share);
    }
    let rules = Rules { gap_s: args.max_gap_s, dark_share: args.dark_share, ..Rules::default() };
    let mut places: BTreeMap<Option<u16>, (f64, f64)> = BTreeMap::new();
    let stations = Station::read_network(&args.stations)?;
    for station in &stations {
        places.extend(station.lat_lon_deg.map(|at| (Some(station.id), at)));
    }
    if places.is_empty() {
        bail!("{}: no station has `lat_deg` and `lon_deg`", args.stations.display());
    }
    if let [only] = stations.as_slice() {
        // Records of `process` do not tell their station.
        places.extend(only.lat_lon_deg.map(|at| (None, at)));
    }
    let known: BTreeMap<u16, (f64, f64)> = places.iter().filter_map(|(of, at)| Some(((*of)?, *at))).collect();
    let mut told = Vessels::new(&known);
    let mut reports: BTreeMap<VesselId, Vec<TrackReport>> = BTreeMap::new();
    let mut before = Before::default();
    for path in &args.tracks {
        read_tracks(path, &mut |record| {
            let at_s = utc(&record["received_utc"]).or_else(|| utc(&record["utc"])).unwrap_or(0.0);
            for word in told.take(record, at_s) {
                match word {
                    Word::Joins(track, _) => {
                        let said = reports.remove(&VesselId::Track(track)).unwrap_or_default();
                        before.joins(track, said, at_s);
                    }
                    Word::Parts(network, _) => drop(reports.remove(&VesselId::Network(network))),
                    Word::Says(seen) => {
                        let Some(vessel) = seen.first().map(|r| r.vessel) else { continue };
                        let of = reports.entry(vessel).or_default();
                        of.extend(before.parts(vessel));
                        of.extend(as_before(of.first(), &seen, &told));
                    }
                }
            }
        })?;
    }
    for (vessel, said) in &mut reports {
        *said = before.with(*vessel, said, &told);
    }
    let total = reports.values().map(Vec::len).sum::<usize>();
    let (mut tracks, left_out) = heard(reports.into_values().flatten(), &places);
    for track in tracks.iter_mut().filter(|t| matches!(t.vessel, VesselId::Network(_))) {
        track.stations = told.stations(track.vessel).into_iter().map(Some).collect();
    }
    if tracks.is_empty() {
        bail!("no track with UTC of a station of {} in {total} reports", args.stations.display());
    }
    if left_out > 0 {
        log::warn!("{left_out} of {total} reports left out: no UTC, or a station that is not in the list");
    }
    let (mut vessels, mut names) = (Vec::new(), BTreeMap::new());
    for path in &args.ais {
        let AisFile { reports, names: of, bad } = ais::read(path)?;
        bad.iter().take(SHOWN).for_each(|line| log::warn!("skipped {line}"));
        if bad.len() > SHOWN {
            log::warn!("skipped {} more bad lines of {}", bad.len() - SHOWN, path.display());
        }
        vessels.extend(reports);
        names.extend(of);
    }
    let fleet = Fleet::of(&vessels, &names);
    fleet.remarks.iter().take(SHOWN).for_each(|remark| log::warn!("{remark}"));
    if fleet.remarks.len() > SHOWN {
        log::warn!("{} more remarks like these", fleet.remarks.len() - SHOWN);
    }
    super::print_records(&errors::records(&tracks, &fleet, &rules), args.json)
}

/// Hands out the records of a file or of a store.
fn read_tracks(path: &Path, take: &mut dyn FnMut(&Value)) -> Result<()> {
    if path.is_dir() {
        return store::read(path, &Wanted::default(), |record| take(&record)).map(drop);
    }
    let file = std::fs::File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
    for (n, line) in std::io::BufReader::new(file).lines().enumerate() {
        let line = line.with_context(|| format!("{}, line {}", path.display(), n + 1))?;
        if !line.trim().is_empty() {
            let record = serde_json::from_str(&line).with_context(|| {
                format!("{}, line {}: a record (JSON) was expected", path.display(), n + 1)
            })?;
            take(&record);
        }
    }
    Ok(())
}
