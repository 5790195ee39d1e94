//! `seabearing calls`: directions, ranges and ways of whales that call, from an ocean-bottom station's recording.

use crate::ocean_bottom::caller_ways::{CallerWay, ways};
use crate::ocean_bottom::calls::{Heard, WhaleCall, calls};
use crate::propagation::file;
use crate::recording;
use crate::station::Station;
use anyhow::{Result, bail};
use seabearing_core::angle::wrap_tau;
use seabearing_core::config::Kind;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Arguments of `seabearing calls`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing calls --station station.toml --json *.mseed\n\
                        A `call` record for each minute about which notes are heard (of fin whales, 15 to 25 Hz, and the fall between the tones of Antarctic \
                        blue whales), and a `caller` record for each way that calls with azimuth and range make. The recorder tells the azimuth of calls by \
                        itself (`azimuth` records, source `impulsive`); ranges are of this command alone. Recordings have 50 to 100 samples a second.")]
pub struct Args {
    /// Station file; its propagation table gives the delays.
    #[arg(long, value_parser = super::input())]
    station: PathBuf,
    /// Recordings (miniSEED or WAV) or folders of them.
    #[arg(required = true, value_parser = super::input())]
    input: Vec<PathBuf>,
    /// Results as JSON Lines.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// One line: what is missing or cannot be read.
pub fn run(args: Args) -> Result<()> {
    let station = Station::read(&args.station)?;
    let Kind::Obs(_) = &station.config.kind else {
        bail!("{}: an ocean-bottom station is needed (kind = \"obs\")", args.station.display());
    };
    let Some(path) = &station.propagation else {
        bail!("{}: no `propagation` in [obs]: ranges need a table of delays", args.station.display());
    };
    let table = file::read(path)?;
    let mut source = recording::open(&args.input, &station, None)?;
    let heard = calls(source.as_mut(), &station.config, &table)?;
    if let Some(said) = mended(&heard) {
        log::warn!("{said}");
    }
    let ways = ways(&heard.calls);
    let records: Vec<Value> = heard.calls.iter().map(call).chain(ways.iter().map(caller)).collect();
    super::print_records(&records, args.json)
}

/// What was put right and what could not be; `None` where all is well.
fn mended(heard: &Heard) -> Option<String> {
    let spikes = (heard.spikes > 0).then(|| format!("spikes put right at {} instants", heard.spikes));
    let clipped = (heard.clipped > 0)
        .then(|| format!("{} instants clipped: notes cut off tell no azimuth", heard.clipped));
    let said: Vec<String> = spikes.into_iter().chain(clipped).collect();
    (!said.is_empty()).then(|| said.join("; "))
}

fn call(c: &WhaleCall) -> Value {
    json!({
        "type": "call", "whale": c.kind, "t_s": c.t_s, "notes": c.notes, "interval_s": c.interval_s,
        "azimuth_deg": c.azimuth.map(|a| a.0.to_degrees()), "sd_azimuth_deg": c.azimuth.map(|a| a.1.to_degrees()),
        "range_m": c.range.map(|r| r.range_m), "sd_range_m": c.range.map(|r| r.sd_m),
        "log_ratio": c.range.map(|r| r.log_ratio),
    })
}

fn caller(w: &CallerWay) -> Value {
    let (x, y) = w.place_m;
    let (vx, vy) = w.velocity_m_s;
    json!({
        "type": "caller", "whale": w.kind, "from_s": w.span_s.0, "to_s": w.span_s.1, "calls": w.calls, "x_m": x, "y_m": y,
        "sd_m": w.sd_place_m, "range_m": x.hypot(y), "azimuth_deg": wrap_tau(x.atan2(y)).to_degrees(),
        "vx_m_s": vx, "vy_m_s": vy, "sd_v_m_s": w.sd_velocity_m_s,
    })
}
