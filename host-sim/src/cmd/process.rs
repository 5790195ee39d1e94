//! `seabearing process`: recordings through the recorder core, exactly as the recorder would.

use super::watched::Watched;
use super::{Mistake, mistake};
use crate::archive::{self, Member, Outcome, Unit};
#[cfg(feature = "base")]
use crate::base::export::{self, Format, Positions};
use crate::interrupt::Keeping;
use crate::levels::{Meter, picture};
use crate::line::{Line, picture as line_picture, records as line_records};
use crate::ocean_bottom::pictures;
use crate::plot::{passage, result};
use crate::progress;
use crate::recording::{Asked, Recording, Span, written_time};
use crate::replay::{ReplaySummary, Said, with_levels};
use crate::station::Station;
use crate::station::described::Wanted;
use crate::station::import::{self, Imported};
use crate::{atomic, record};
use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_core::block::Frame;
use seabearing_core::config::Kind;
use seabearing_core::wire::{Encoder, Message};
#[cfg(feature = "base")]
use std::io::IsTerminal;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use time::OffsetDateTime;

/// Arguments of `seabearing process`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  seabearing process --station east.toml recording.wav > records.jsonl\n  \
    seabearing process --station east.toml east --from 2024-05-01T09:00:05Z --to 2024-05-01T09:00:30Z\n  \
    seabearing process --station east.toml east --out records --jobs 2\n  \
    seabearing process --station east.toml recording.wav --levels 10 --plots pictures\n  \
    seabearing process --station east.toml recording.wav --format csv > records.csv\n\n\
    docs/recordings.md says which files are read, and how whole archives are."
)]
pub struct Args {
    /// Station file of the recorder, StationXML or dataless SEED; of several stations, one after another, into --out
    #[arg(long, required = true, value_name = "STATION.toml", value_parser = super::input())]
    station: Vec<PathBuf>,
    /// Propagation table of the stations that metadata describe, which else is traced through a typical sea
    #[arg(long, value_name = "TABLE.toml", value_parser = super::input())]
    propagation: Option<PathBuf>,
    /// Recordings (WAV, FLAC, miniSEED, SAC), folders and archives of them, or a station of a SeedLink server as it records:
    /// seedlink://HOST:PORT/NET_STA
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
    /// Offset from UTC of the times in files' names that do not tell it, as +10:00 (key `name_offset` of the station file)
    #[arg(long, value_name = "OFFSET", allow_hyphen_values = true, value_parser = offset)]
    name_offset: Option<time::UtcOffset>,
    /// Write the records of each station and day into files in this folder, with what they were made of; what is there already
    /// is passed over, so that a run that was ended goes on
    #[arg(long, value_name = "DIR", conflicts_with_all = ["plots", "stats", "telemetry"])]
    out: Option<PathBuf>,
    /// How many stations and days to process at once (default: one a processor)
    #[arg(long, value_name = "N", requires = "out")]
    jobs: Option<usize>,
    /// Only the I-th of N shares of the stations and days, counted from 1, for N jobs that know nothing of each other
    #[arg(long, value_name = "I/N", requires = "out", value_parser = share)]
    share: Option<(usize, usize)>,
    /// Also measure levels over intervals of so many seconds (60 is usual): decidecade and decade bands, spectra, percentiles
    #[arg(long, value_name = "SECONDS", value_parser = super::seconds)]
    levels: Option<f64>,
    /// What the records on standard output are: JSON Lines as they are made, or, at the end, a table with a row a record and a column
    /// a field
    #[cfg(feature = "base")]
    #[arg(long, value_enum, default_value = "jsonl", conflicts_with = "out")]
    format: Table,
    /// Also write the telemetry the recorder would have sent, byte for byte
    #[arg(long, value_name = "FILE", value_parser = super::output())]
    telemetry: Option<PathBuf>,
    /// Write pictures into this folder: bearings and errors against time, tracks on a map, correlations
    /// (array); spectrogram, azigram, likelihoods, cepstrograms, presence, map, and the pages and tables of `ships` (ocean bottom);
    /// levels with --levels.
    #[arg(long, alias = "plot", value_name = "DIR")]
    plots: Option<PathBuf>,
    /// Also draw a page for each passage: spectrogram, azimuth and elevation (ocean bottom: range), course on a map with times
    /// and ellipse, and what is stated of it
    #[arg(long, requires = "plots")]
    passages: bool,
    /// Truth to draw beside the results: the truth.csv of a simulation.
    #[arg(long, requires = "plots", value_name = "TRUTH.csv", value_parser = super::input())]
    truth: Option<PathBuf>,
    /// Print how much was processed, how fast, and what was lost, on standard error.
    #[arg(long)]
    stats: bool,
    /// JSON Lines (what this command prints without --format).
    #[arg(long)]
    json: bool,
}

/// What records are written as.
#[cfg(feature = "base")]
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Table {
    Jsonl,
    Csv,
    Parquet,
}

impl Args {
    /// The table that the records become, if they do.
    #[cfg(feature = "base")]
    fn table(&self) -> Result<Option<Format>> {
        Ok(match self.format {
            Table::Jsonl => None,
            Table::Csv => Some(Format::Csv),
            Table::Parquet if std::io::stdout().is_terminal() => {
                mistake!("--format parquet is not for a terminal: `> records.parquet`")
            }
            Table::Parquet => {
                let to = Path::new("standard output");
                export::check(to, Format::Parquet, &Positions::default(), "")?;
                Some(Format::Parquet)
            }
        })
    }

    /// The stations, and what keeps the files that were made of metadata.
    fn stations(&self) -> Result<Vec<(Option<Arc<Imported>>, Station)>> {
        let mut out = Vec::new();
        for path in &self.station {
            if !import::is_metadata(path) {
                out.push((None, Station::of_recorder(path)?));
                continue;
            }
            let at = self.asked()?.span.from;
            let wanted = Wanted { at, ..Wanted::default() };
            let imported = Arc::new(import::import(path, &wanted, self.propagation.as_deref())?);
            for file in &imported.files {
                out.push((Some(Arc::clone(&imported)), Station::of_recorder(file)?));
            }
        }
        Ok(out)
    }

    /// What is asked of the recordings.
    fn asked(&self) -> Result<Asked> {
        let span = Span { from: self.from, to: self.to };
        if span.from.zip(span.to).is_some_and(|(from, to)| from >= to) {
            mistake!("--to must be later than --from");
        }
        Ok(Asked { start: self.start, span, name_offset: self.name_offset })
    }
}

/// Runs the command.
///
/// # Errors
/// A bad station file, no usable recording, or nothing useful in it.
pub fn run(args: Args) -> Result<()> {
    let asked = args.asked()?;
    let stations = args.stations()?;
    if let Some(folder) = &args.out {
        if stations.iter().any(|(_, station)| matches!(station.config.kind, Kind::Line(_))) {
            mistake!(
                "--out is not possible with a line of sensors (kind = \"line\"): its records go to standard output"
            );
        }
        return archive(&args, stations, folder);
    }
    let mut stations = stations.into_iter();
    let (Some((imported, station)), None) = (stations.next(), stations.next()) else {
        bail!("several stations need a folder for their records: --out DIR");
    };
    if matches!(station.config.kind, Kind::Line(_)) {
        return line(&args, &station);
    }
    // Where nothing can be written is said before the work, not after.
    let telemetry_file = args.telemetry.as_deref().map(atomic::Unfinished::beside).transpose()?;
    if let Some(folder) = &args.plots
        && let Some(file) = folder.ancestors().find(|path| path.exists()).filter(|path| !path.is_dir())
    {
        bail!("cannot write {}: {} is a file, a folder is needed", folder.display(), file.display());
    }
    // A simulation writes what its kind of station can be compared with.
    let ocean_bottom = matches!(station.config.kind, Kind::Obs(_));
    let truth = args
        .truth
        .as_deref()
        .filter(|_| !ocean_bottom)
        .map(crate::world::truth::Truth::read)
        .transpose()?
        .unwrap_or_default();
    let heard = args
        .truth
        .as_deref()
        .filter(|_| ocean_bottom)
        .map(pictures::TruthCurve::read)
        .transpose()?
        .unwrap_or_default();
    let table = crate::ocean_bottom::table::of_station(&station)?;
    let meter = args.levels.map(|s| Meter::new(&station, s, args.plots.is_some()));
    let mut meter = meter.transpose().map_err(|e| Mistake(format!("{e:#}")))?;
    let recording = Recording::find(&args.input, &station, &asked)?;
    if let Some(imported) = imported.as_ref().filter(|_| asked.span.from.is_none()) {
        imported.hold(&station.config.name, recording.days().as_ref());
    }
    let live = recording.is_live();
    if live && args.plots.is_some() {
        mistake!("--plots needs a recording that has an end: draw the records of a live station afterwards");
    }
    let source = recording.source(asked.span)?;
    let records = record::RecordFormat {
        rate_hz: station.config.rate_hz,
        start: source.start(),
        times: Default::default(),
    };
    let mut source = Watched::new(source, station.config.rate_hz);
    let keeping = Keeping::begin();
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    let mut encoder = Encoder::default();
    let mut telemetry = Vec::new();
    let mut messages = Vec::new();
    let mut last_health = None;
    let mut directions = 0u64;
    let (mut bearings, mut tracks, mut levels) = (Vec::new(), Vec::new(), Vec::new());
    #[cfg(feature = "base")]
    let (as_table, mut rows) = (args.table()?, Vec::new());
    let mut write = |record: serde_json::Value| -> Result<()> {
        #[cfg(feature = "base")]
        if as_table.is_some() {
            rows.push(record);
            return Ok(());
        }
        serde_json::to_writer(&mut out, &record)?;
        out.write_all(b"\n")?;
        // What is live is waited for.
        if live {
            out.flush()?;
        }
        Ok(())
    };
    let summary = with_levels(&station.config, table.as_deref(), &mut source, meter.as_mut(), |said| {
        let message = match said {
            Said::Message(message) => message,
            Said::Level(index, level) => {
                if args.plots.is_some() {
                    levels.push((records.t_s(index), level.clone()));
                }
                return write(records.said(said));
            }
        };
        if args.telemetry.is_some() {
            telemetry.extend_from_slice(encoder.frame(message));
        }
        match message {
            Message::Health(health) => last_health = Some(*health),
            Message::Bearing(_) => directions += 1,
            _ => {}
        }
        match message {
            Message::Bearing(b) if args.plots.is_some() => bearings.push(*b),
            Message::Track(t) if args.plots.is_some() => tracks.push(*t),
            _ => {}
        }
        if args.passages || args.plots.is_some() && table.is_some() {
            messages.push(*message);
        }
        let mut record = records.json(message);
        record::calibrate(&mut record, &station.calibration);
        write(record)
    })?;
    #[cfg(feature = "base")]
    if let Some(format) = as_table {
        let places = Positions { otherwise: station.config.lat_lon_deg, ..Positions::default() };
        let mut table = Vec::new();
        export::table_to(&mut table, format, &rows, &places)?;
        out.write_all(&table)?;
    }
    out.flush()?;
    source.bar.finish_and_clear();
    if let Some(file) = telemetry_file {
        file.as_file().write_all(&telemetry)?;
        file.finish()?;
    }
    let seconds = summary.index as f64 / station.config.rate_hz;
    keeping.end(|| format!("the records of the first {seconds:.0} s are kept"));
    if let Some(folder) = args.plots.as_deref().filter(|_| matches!(station.config.kind, Kind::Array(_))) {
        // The clearest bearing shows best what the correlations look like.
        let clearest = bearings.iter().max_by(|a, b| a.snr_db.total_cmp(&b.snr_db));
        let segment = match clearest {
            Some(b) => Some((b, segment(&recording, asked.span, &station, b.index)?)),
            None => None,
        };
        let segment =
            segment.as_ref().map(|(b, frames)| (*b, frames.as_slice())).filter(|s| s.1.len() > 4096);
        result::write_all(folder, &station.config, records.start, (&bearings, &tracks), &truth, segment)?;
    }
    if let (Some(folder), Some(path)) =
        (&args.plots, station.propagation.as_ref().filter(|_| table.is_some()))
    {
        // The pictures show intermediate stages, which the records do not carry: a second pass makes them again.
        let mut again = recording.source(asked.span)?;
        let interference = crate::propagation::file::read(path)?;
        let (config, pressure) = (&station.config, &station.calibration[0]);
        let drawn = pictures::draw(folder, &mut *again, config, &interference, pressure, &messages, &heard)?;
        if drawn.is_empty() {
            log::warn!("no pictures of less than two whole minutes");
        }
    }
    if let Some(folder) = args.plots.as_deref().filter(|_| args.passages) {
        let mut again = recording.source(asked.span)?;
        if passage::write_all(folder, &station, records.start, &messages, &mut *again)? == 0 {
            log::info!("no passage to draw a page of");
        }
    }
    if let (Some(folder), Some(meter)) = (&args.plots, &meter) {
        picture::draw(folder, meter, &levels, records.start, &station.config.name)?;
    }
    if args.stats {
        eprintln!("{}", stats(&summary, station.config.rate_hz));
    }
    let _ = args.json;
    match last_health {
        // Three hydrophones give bearings where the fourth is dead, though no instant is whole.
        Some(health) if health.processed > 0 || directions > 0 => Ok(()),
        Some(health) => bail!(
            "no sample of {} could be used: {} missing, {} repeated, {} invalid, {} clipped, {} with a dead channel, {} left over",
            health.lost.iter().sum::<u64>(),
            health.lost[0],
            health.lost[1],
            health.lost[2],
            health.lost[3],
            health.lost[4],
            health.lost[5]
        ),
        None => bail!("the recording holds no samples"),
    }
}

/// A line of sensors: no recorder's core, but MUSIC.
fn line(args: &Args, station: &Station) -> Result<()> {
    for (given, option) in [
        (args.levels.is_some(), "--levels"),
        (args.telemetry.is_some(), "--telemetry"),
        (args.truth.is_some(), "--truth"),
    ] {
        if given {
            bail!("{option} is not possible with a line of sensors (kind = \"line\")");
        }
    }
    #[cfg(feature = "base")]
    if args.table()?.is_some() {
        mistake!("--format is not possible with a line of sensors (kind = \"line\")");
    }
    let asked = args.asked()?;
    let found = Line::find(&args.input, station, &asked)?;
    let records = record::RecordFormat {
        rate_hz: station.config.rate_hz,
        start: found.start(),
        times: Default::default(),
    };
    let orientation = station.config.orientation_deg * RAD_PER_DEG;
    let keeping = Keeping::begin();
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    let mut bearings = Vec::new();
    let begun = std::time::Instant::now();
    let summary = found.run(|bearing| {
        if args.plots.is_some() {
            bearings.push(bearing);
        }
        serde_json::to_writer(&mut out, &line_records::json(&bearing, orientation, &records))?;
        Ok(out.write_all(b"\n")?)
    })?;
    out.flush()?;
    let seconds = (summary.used + summary.lost) as f64 / station.config.rate_hz;
    keeping.end(|| format!("the records of the first {seconds:.0} s are kept"));
    if let Some(folder) = &args.plots {
        line_picture::draw(folder, &bearings, station, records.start)?;
    }
    if args.stats {
        let took_s = begun.elapsed().as_secs_f64();
        let lost_s = summary.lost as f64 / station.config.rate_hz;
        eprintln!("processed {seconds:.1} s of data in {took_s:.2} s; {lost_s:.2} s were left out");
    }
    if summary.used == 0 {
        bail!("the recording holds no whole transform of samples of all sensors");
    }
    Ok(())
}

/// Every day of every station into a folder.
fn archive(args: &Args, stations: Vec<(Option<Arc<Imported>>, Station)>, folder: &Path) -> Result<()> {
    let asked = args.asked()?;
    let (share, shares) = args.share.unwrap_or((1, 1));
    let mut members = Vec::new();
    let several = stations.len() > 1;
    for (imported, station) in stations {
        let name = station.config.name.clone();
        match Member::find(station, &args.input, &asked, args.levels) {
            Ok(member) => {
                if let Some(imported) = imported.as_ref().filter(|_| asked.span.from.is_none()) {
                    imported.hold(&name, member.recording().days().as_ref());
                }
                members.push(member);
            }
            // StationXML tells of whole networks; the archive need not hold all of it.
            Err(e) if several && imported.is_some() => log::warn!("left out {name}: {e:#}"),
            Err(e) => return Err(e.context(name.to_string())),
        }
    }
    let units = archive::units(&members, asked.span)?;
    if units.is_empty() {
        bail!("nothing was recorded {}", asked.span);
    }
    let mine: Vec<_> = units.iter().skip(share - 1).step_by(shares).collect();
    let bar = progress::bar(mine.len() as u64, "processing");
    // A recorder's memory is made on the stack before it is put into its place.
    let pool =
        rayon::ThreadPoolBuilder::new().num_threads(args.jobs.unwrap_or(0)).stack_size(1 << 25).build()?;
    let keeping = Keeping::begin();
    let one = |unit: &&Unit| {
        let outcome = archive::process(unit, &members, folder);
        bar.inc(1);
        outcome.with_context(|| unit.name.clone())
    };
    // One thread takes the units in their order; several take them as they come.
    let outcomes: Vec<Result<Outcome>> = pool.install(|| mine.par_iter().with_max_len(1).map(one).collect());
    bar.finish_and_clear();
    let count = |wanted: fn(&Outcome) -> bool| outcomes.iter().flatten().filter(|o| wanted(o)).count();
    let (done, there) = (count(|o| matches!(o, Outcome::Done(_))), count(|o| *o == Outcome::There));
    keeping.end(|| {
        format!("{} of {} station-days are done and kept; the same command goes on", done + there, mine.len())
    });
    let failed: Vec<&anyhow::Error> = outcomes.iter().filter_map(|o| o.as_ref().err()).collect();
    log::info!("{done} station-days processed, {there} were there, {} failed", failed.len());
    if let Some((last, before)) = failed.split_last() {
        before.iter().for_each(|e| log::error!("{e:#}"));
        bail!("{last:#}");
    }
    Ok(())
}

/// `I/N`, I from 1 to N.
fn share(text: &str) -> Result<(usize, usize), &'static str> {
    let parsed = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    let share = parsed.filter(|(i, n)| (1..=*n).contains(i));
    share.ok_or("not a share; one from 1/N to N/N was expected, as 3/16")
}

/// An offset from UTC.
fn offset(text: &str) -> Result<time::UtcOffset, &'static str> {
    written_time::offset(text).ok_or("not an offset; one like +10:00 was expected")
}

/// The second of samples about an index, as far as it was recorded without a gap.
fn segment(recording: &Recording, span: Span, station: &Station, middle: u64) -> Result<Vec<Frame>> {
    let half = (station.config.rate_hz / 2.0) as u64;
    let (from, to) = (middle.saturating_sub(half), middle + half);
    let mut source = recording.source(span)?;
    let mut frames = Vec::new();
    while let Some(block) = source.next_block()? {
        if block.first_index >= to {
            break;
        }
        let indexed = (block.first_index..).zip(block.frames);
        frames.extend(indexed.filter(|(i, _)| (from..to).contains(i)).map(|(_, f)| *f));
    }
    Ok(frames)
}

/// One line about speed: seconds of data over seconds of processor time, of the core alone and of all.
fn stats(summary: &ReplaySummary, rate_hz: f64) -> String {
    let data_s = summary.instants as f64 / rate_hz;
    let times = |d: std::time::Duration| data_s / d.as_secs_f64().max(1e-9);
    format!(
        "processed {data_s:.1} s of data ({} samples of four channels) in {:.2} s of processor time: {:.0} times real time, {:.0} times in the core alone",
        summary.instants,
        summary.all.as_secs_f64(),
        times(summary.all),
        times(summary.core)
    )
}
