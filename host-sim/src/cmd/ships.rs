//! `seabearing ships`: what is known of each ship of an ocean-bottom recording, and pages of its days.

use super::mistake;
use super::watched::Watched;
use crate::ocean_bottom::far::tones::{Listener, Tapped};
use crate::ocean_bottom::pictures::TruthCurve;
use crate::ocean_bottom::ships::{doubted, ships, told};
use crate::ocean_bottom::{pages, table};
use crate::plot::times::Times;
use crate::propagation::file;
use crate::recording::{Asked, BlockSource, Recording, Span};
use crate::replay::replay;
use crate::station::Station;
use anyhow::{Result, bail};
use seabearing_core::config::Kind;
use seabearing_core::wire::Message;
use std::path::PathBuf;
use time::OffsetDateTime;

/// Arguments of `seabearing ships`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing ships --station obs.toml *.mseed\n  \
    seabearing ships --station obs.toml *.mseed --plots pages      # pages of azimuth and range against UTC\n  \
    seabearing ships --station obs.toml *.mseed --json > ships.jsonl\n\n\
    A row for each track: when it was heard, closest point, heading, speed, tones and what may be doubted, each with its standard\n\
    deviation. --plots writes ships.svg (azimuth and range against UTC, tracks over likelihoods, the same table), of recordings of\n\
    several days a page a day, ships.txt and ships.csv. docs/ocean-bottom.md says what is drawn and how it is found.")]
pub struct Args {
    /// Station file of the ocean-bottom station; its propagation table gives the delays
    #[arg(long, value_name = "STATION.toml", value_parser = super::input())]
    station: PathBuf,
    /// Recordings (miniSEED, SAC or WAV), folders and archives of them
    #[arg(required = true, value_parser = super::input())]
    input: Vec<PathBuf>,
    /// UTC of the first sample (RFC 3339), where neither the recording nor its name tells it
    #[arg(long, value_name = "TIME", value_parser = super::instant)]
    start: Option<OffsetDateTime>,
    /// Only what was recorded at or after this UTC, RFC 3339
    #[arg(long, value_name = "TIME", value_parser = super::instant)]
    from: Option<OffsetDateTime>,
    /// Only what was recorded before this UTC, RFC 3339
    #[arg(long, value_name = "TIME", value_parser = super::instant)]
    to: Option<OffsetDateTime>,
    /// Write the pages and the tables into this folder
    #[arg(long, alias = "plot", value_name = "DIR")]
    plots: Option<PathBuf>,
    /// Truth to draw beside the tracks: the truth.csv of a simulation
    #[arg(long, requires = "plots", value_name = "TRUTH.csv", value_parser = super::input())]
    truth: Option<PathBuf>,
    /// Results as JSON Lines, a `ship` record a row
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// One line: what is missing or cannot be read or written.
pub fn run(args: Args) -> Result<()> {
    let span = Span { from: args.from, to: args.to };
    if span.from.zip(span.to).is_some_and(|(from, to)| from >= to) {
        mistake!("--to must be later than --from");
    }
    let station = Station::of_recorder(&args.station)?;
    let Kind::Obs(_) = &station.config.kind else {
        bail!("{}: an ocean-bottom station is needed (kind = \"obs\")", args.station.display());
    };
    let Some(path) = &station.propagation else {
        bail!("{}: no `propagation` in [obs]: ranges need a table of delays", args.station.display());
    };
    let propagation = file::read(path)?;
    if let Some(folder) = &args.plots
        && let Some(file) = folder.ancestors().find(|path| path.exists()).filter(|path| !path.is_dir())
    {
        bail!("cannot write {}: {} is a file, a folder is needed", folder.display(), file.display());
    }
    let truth = args.truth.as_deref().map(TruthCurve::read).transpose()?.unwrap_or_default();
    let recording =
        Recording::find(&args.input, &station, &Asked { start: args.start, span, name_offset: None })?;
    if recording.is_live() {
        mistake!("a recording that has an end is needed: `process` takes a live station");
    }
    let bytes = table::of_station(&station)?;
    let config = &station.config;
    let mut watched = Watched::new(recording.source(span)?, config.rate_hz);
    let start = watched.start();
    let mut messages: Vec<Message> = Vec::new();
    let mut listening = Tapped { source: &mut watched, listener: Listener::new(config)? };
    let summary = replay(config, bytes.as_deref(), &mut listening, |m| {
        messages.push(*m);
        Ok(())
    })?;
    let lines = listening.listener.minutes;
    watched.bar.finish_and_clear();
    let end_s = summary.index as f64 / config.rate_hz;
    let found = match &args.plots {
        // Likelihoods are no part of what the recorder says: a second pass makes them again.
        Some(folder) => {
            let mut again = recording.source(span)?;
            pages::draw(folder, &mut *again, config, &propagation, &messages, &truth)?.0
        }
        None => ships(&messages, config, propagation.depth_m, &lines),
    };
    let (doubted, times) = (doubted(&messages, config.rate_hz), Times::new(start, end_s));
    for line in told::warnings(&doubted, &times) {
        log::warn!("{line}");
    }
    if args.json {
        let records: Vec<_> = found.iter().map(|ship| told::record(ship, start)).collect();
        return super::print_records(&records, true);
    }
    seabearing_host::print!("{}", told::text(&found, &doubted, &times, &config.name));
    Ok(())
}
