//! `seabearing process`: recordings through the recorder core, exactly as the recorder would.

use crate::ocean_bottom::pictures;
use crate::plot::result;
use crate::progress;
use crate::recording::{Asked, BlockSource, Recording, Span, written_time};
use crate::replay::{ReplaySummary, replay};
use crate::station::Station;
use crate::{atomic, record};
use anyhow::{Context, Result, bail};
use seabearing_core::block::{Block, Frame};
use seabearing_core::config::Kind;
use seabearing_core::wire::{Encoder, Message};
use std::io::Write;
use std::path::PathBuf;
use time::OffsetDateTime;

/// Arguments of `seabearing process`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  seabearing process --station east.toml recording.wav > records.jsonl\n  \
    seabearing process --station east.toml east --from 2024-05-01T09:00:05Z --to 2024-05-01T09:00:30Z\n\n\
    docs/recordings.md says which files are read, and how whole archives are."
)]
pub struct Args {
    /// Station file of the recorder.
    #[arg(long)]
    station: PathBuf,
    /// Recordings (WAV, FLAC, miniSEED, SAC), or folders and archives of them
    #[arg(required = true)]
    input: Vec<PathBuf>,
    /// UTC of the first sample (RFC 3339), where neither the recording nor its name tells it
    #[arg(long, value_name = "TIME")]
    start: Option<String>,
    /// Only what was recorded at or after this UTC, RFC 3339
    #[arg(long, value_name = "TIME")]
    from: Option<String>,
    /// Only what was recorded before this UTC, RFC 3339
    #[arg(long, value_name = "TIME")]
    to: Option<String>,
    /// Offset from UTC of the times in files' names that do not tell it, as +10:00 (key `name_offset` of the station file)
    #[arg(long, value_name = "OFFSET", allow_hyphen_values = true)]
    name_offset: Option<String>,
    /// Also write the telemetry the recorder would have sent, byte for byte.
    #[arg(long)]
    telemetry: Option<PathBuf>,
    /// Write pictures into this folder: bearings and errors against time, tracks on a map, correlations
    /// (array); spectrogram, azigram, likelihoods, cepstrograms, presence, map (ocean bottom).
    #[arg(long, alias = "plot", value_name = "DIR")]
    plots: Option<PathBuf>,
    /// Truth to draw beside the results: the truth.csv of a simulation.
    #[arg(long, requires = "plots", value_name = "TRUTH.csv")]
    truth: Option<PathBuf>,
    /// Print how much was processed, how fast, and what was lost, on standard error.
    #[arg(long)]
    stats: bool,
    /// JSON Lines (what this command always prints).
    #[arg(long)]
    json: bool,
}

impl Args {
    /// What is asked of the recordings.
    fn asked(&self) -> Result<Asked> {
        let time = |option: &str, text: &Option<String>| {
            text.as_deref().map(|t| super::instant(option, t)).transpose()
        };
        let offset = |t: &String| {
            let parsed = written_time::offset(t);
            parsed.with_context(|| format!("--name-offset {t}: not an offset; one like +10:00 was expected"))
        };
        let span = Span { from: time("--from", &self.from)?, to: time("--to", &self.to)? };
        if span.from.zip(span.to).is_some_and(|(from, to)| from >= to) {
            bail!("--to must be later than --from");
        }
        let name_offset = self.name_offset.as_ref().map(offset).transpose()?;
        Ok(Asked { start: time("--start", &self.start)?, span, name_offset })
    }
}

/// Runs the command.
///
/// # Errors
/// A bad station file, no usable recording, or nothing useful in it.
pub fn run(args: Args) -> Result<()> {
    let station = Station::of_recorder(&args.station)?;
    // Where nothing can be written is said before the work, not after.
    let telemetry_file = args.telemetry.as_deref().map(atomic::Unfinished::beside).transpose()?;
    if let Some(folder) = &args.plots
        && let Some(file) = folder.ancestors().find(|path| path.exists()).filter(|path| !path.is_dir())
    {
        bail!("cannot write {}: {} is a file, a folder is needed", folder.display(), file.display());
    }
    let asked = args.asked()?;
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
    let recording = Recording::find(&args.input, &station, &asked)?;
    let source = recording.source(asked.span)?;
    let records = record::RecordFormat {
        rate_hz: station.config.rate_hz,
        start: source.start(),
        times: Default::default(),
    };
    let bar = progress::bar(
        source.expected_end().map_or(0, |n| (n as f64 / station.config.rate_hz) as u64),
        "processing",
    );
    let mut source = Watched { source, bar, rate_hz: station.config.rate_hz };
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    let mut encoder = Encoder::default();
    let mut telemetry = Vec::new();
    let mut messages = Vec::new();
    let mut last_health = None;
    let (mut bearings, mut tracks) = (Vec::new(), Vec::new());
    let summary = replay(&station.config, table.as_deref(), &mut source, |message| {
        if args.telemetry.is_some() {
            telemetry.extend_from_slice(encoder.frame(message));
        }
        match message {
            Message::Health(health) => last_health = Some(*health),
            Message::Bearing(b) if args.plots.is_some() => bearings.push(*b),
            Message::Track(t) if args.plots.is_some() => tracks.push(*t),
            _ => {}
        }
        if args.plots.is_some() && table.is_some() {
            messages.push(*message);
        }
        serde_json::to_writer(&mut out, &records.json(message))?;
        Ok(out.write_all(b"\n")?)
    })?;
    out.flush()?;
    source.bar.finish_and_clear();
    if let Some(file) = telemetry_file {
        file.as_file().write_all(&telemetry)?;
        file.finish()?;
    }
    if let Some(folder) = args.plots.as_deref().filter(|_| matches!(station.config.kind, Kind::Array(_))) {
        // The clearest bearing shows best what the correlations look like.
        let clearest = bearings.iter().max_by(|a, b| a.snr_db.total_cmp(&b.snr_db));
        let segment = match clearest {
            Some(b) => Some((b, segment(&recording, asked.span, &station, b.index)?)),
            None => None,
        };
        let segment =
            segment.as_ref().map(|(b, frames)| (*b, frames.as_slice())).filter(|s| s.1.len() > 4096);
        result::write_all(folder, &station.config, (&bearings, &tracks), &truth, segment)?;
    }
    if let (Some(folder), Some(path)) =
        (&args.plots, station.propagation.as_ref().filter(|_| table.is_some()))
    {
        // The pictures show intermediate stages, which the records do not carry: a second pass makes them again.
        let mut again = recording.source(asked.span)?;
        let interference = crate::propagation::file::read(path)?;
        if pictures::draw(folder, &mut *again, &station.config, &interference, &messages, &heard)?.is_empty()
        {
            eprintln!("seabearing: no pictures of less than two whole minutes");
        }
    }
    if args.stats {
        eprintln!("{}", stats(&summary, station.config.rate_hz));
    }
    let _ = args.json;
    match last_health {
        Some(health) if health.processed > 0 => Ok(()),
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

/// A source that moves a progress bar.
struct Watched {
    source: Box<dyn BlockSource>,
    bar: progress::ProgressBar,
    rate_hz: f64,
}

impl BlockSource for Watched {
    fn start(&self) -> Option<OffsetDateTime> {
        self.source.start()
    }

    fn expected_end(&self) -> Option<u64> {
        self.source.expected_end()
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        let block = self.source.next_block()?;
        if let Some(block) = &block {
            self.bar.set_position((block.first_index as f64 / self.rate_hz) as u64);
        }
        Ok(block)
    }
}
