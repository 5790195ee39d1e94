//! `seabearing process`: recordings through the recorder core, exactly as the recorder would.

use crate::progress;
use crate::recording::{self, Source};
use crate::replay::{Summary, replay};
use crate::station::Station;
use crate::{atomic, record};
use anyhow::{Context, Result, bail};
use seabearing_core::block::Block;
use seabearing_core::wire::{Encoder, Message};
use std::io::Write;
use std::path::PathBuf;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Arguments of `seabearing process`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing process --station east.toml recording.wav > records.jsonl")]
pub struct Args {
    /// Station file of the recorder.
    #[arg(long)]
    station: PathBuf,
    /// Recordings (WAV, FLAC, miniSEED) or folders of them.
    #[arg(required = true)]
    input: Vec<PathBuf>,
    /// UTC of the first sample (RFC 3339), where neither the recording nor its name tells it.
    #[arg(long)]
    start: Option<String>,
    /// Also write the telemetry the recorder would have sent, byte for byte.
    #[arg(long)]
    telemetry: Option<PathBuf>,
    /// Print how much was processed, how fast, and what was lost, on standard error.
    #[arg(long)]
    stats: bool,
    /// JSON Lines (what this command always prints).
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// A bad station file, no usable recording, or nothing useful in it.
pub fn run(args: Args) -> Result<()> {
    let station = Station::read(&args.station)?;
    let start = match &args.start {
        None => None,
        Some(text) => Some(OffsetDateTime::parse(text, &Rfc3339).with_context(|| {
            format!("--start is `{text}`; a time like 2016-02-21T13:05:00Z was expected")
        })?),
    };
    let table = station.propagation_blob()?;
    let source = recording::open(&args.input, &station, start)?;
    let records = record::Recorder { rate_hz: station.config.rate_hz, start: source.start() };
    let bar = progress::bar(
        source.expected_end().map_or(0, |n| (n as f64 / station.config.rate_hz) as u64),
        "processing",
    );
    let mut source = Watched { source, bar, rate_hz: station.config.rate_hz };
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    let mut encoder = Encoder::default();
    let mut telemetry = Vec::new();
    let mut last_health = None;
    let summary = replay(&station.config, table.as_deref(), &mut source, |message| {
        if args.telemetry.is_some() {
            telemetry.extend_from_slice(encoder.frame(message));
        }
        if let Message::Health(health) = message {
            last_health = Some(*health);
        }
        serde_json::to_writer(&mut out, &records.json(message))?;
        Ok(out.write_all(b"\n")?)
    })?;
    out.flush()?;
    source.bar.finish_and_clear();
    if let Some(path) = &args.telemetry {
        atomic::write(path, &telemetry)?;
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

/// One line about speed: seconds of data over seconds of work, of the core alone and of all.
fn stats(summary: &Summary, rate_hz: f64) -> String {
    let data_s = summary.instants as f64 / rate_hz;
    let times = |d: std::time::Duration| data_s / d.as_secs_f64().max(1e-9);
    format!(
        "processed {data_s:.1} s of data ({} samples of four channels): {:.0} times real time, {:.0} times in the core alone",
        summary.instants,
        times(summary.wall),
        times(summary.core)
    )
}

/// A source that moves a progress bar.
struct Watched {
    source: Box<dyn Source>,
    bar: indicatif::ProgressBar,
    rate_hz: f64,
}

impl Source for Watched {
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
