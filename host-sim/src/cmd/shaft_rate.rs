//! `seabearing shaft-rate`: the rate of a vessel's propeller from the envelope of its noise.

use super::mistake;
use crate::progress;
use crate::recording;
use crate::station::Station;
use anyhow::{Result, anyhow, bail};
use seabearing_core::array;
use seabearing_core::block::Block;
use seabearing_core::demon::{self, NoRate, RateReport, Reading, SpeedCurve, VESSEL_SPEEDS_M_S};
use serde_json::{Value, json};
use std::io::Write;
use std::path::PathBuf;

/// Samples handed to the chain at a time.
const PIECE: usize = 1024;

/// Arguments of `seabearing shaft-rate`.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  seabearing shaft-rate --station east.toml --speed-curve 0.5,3.1,0.6 --blades 4 pass.wav"
)]
pub struct Args {
    /// Station file of the recorder.
    #[arg(long, value_parser = super::input())]
    station: PathBuf,
    /// Recordings (WAV, FLAC) or folders of them.
    #[arg(required = true, value_parser = super::input())]
    input: Vec<PathBuf>,
    /// Corner of the high-pass before the envelope, Hz.
    #[arg(long, default_value_t = 3000.0)]
    high_pass_hz: f64,
    /// Rates that unmodulated noise may give, per hour.
    #[arg(long, default_value_t = 0.01)]
    false_rates_per_hour: f64,
    /// Speed of the fleet from its shaft rate: speed at rate zero (m/s), metres a turn, standard deviation (m/s); instead
    /// of the station file's `speed_from_shaft`.
    #[arg(long, value_name = "A,B,SD", value_delimiter = ',', allow_hyphen_values = true)]
    speed_curve: Option<Vec<f64>>,
    /// Blades of the fleet's propellers, where alike.
    #[arg(long)]
    blades: Option<u8>,
    /// Results as JSON Lines.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// A bad station file or setting, no usable recording, or less of it than one window.
pub fn run(args: Args) -> Result<()> {
    let station = Station::of_recorder(&args.station)?;
    let rate_hz = station.config.rate_hz;
    let settings = demon::Settings {
        high_pass_hz: args.high_pass_hz,
        false_rates_per_hour: args.false_rates_per_hour,
        ..demon::Settings::default()
    };
    let plan = array::Plan::new(&station.config).map_err(|e| anyhow!("{e}"))?;
    let plan = plan
        .with_shaft(&settings)
        .map_err(|e| anyhow!("`{}` is outside what can be demodulated at {rate_hz} Hz", e.0))?;
    let curve = match args.speed_curve.as_deref() {
        None => None,
        Some(&[intercept_m_s, slope_m, sd_m_s])
            if (intercept_m_s + slope_m + sd_m_s).is_finite() && slope_m > 0.0 && sd_m_s >= 0.0 =>
        {
            Some(SpeedCurve {
                intercept_m_s,
                slope_m,
                sd_m_s,
                blades: args.blades,
                valid_m_s: VESSEL_SPEEDS_M_S,
            })
        }
        Some(_) => mistake!("--speed-curve takes A,B,SD with B above 0 and SD at least 0"),
    };
    let curve = curve.or(station.config.tracking.shaft_speed);
    let mut source = recording::open(&args.input, &station, None)?;
    let bar = progress::bar(source.expected_end().map_or(0, |n| (n as f64 / rate_hz) as u64), "demodulating");
    let (mut state, mut scratch) = (Box::new(array::State::new()), Box::new(array::Scratch::new()));
    let mut reports = Vec::new();
    while let Some(block) = source.next_block()? {
        // Pieces shorter than the time between reports, so that each report is taken.
        for (n, frames) in block.frames.chunks(PIECE).enumerate() {
            let first_index = block.first_index + (n * PIECE) as u64;
            array::push(&plan, &mut state, &mut scratch, Block { first_index, frames }, &mut |_| {});
            reports.extend(state.take_shaft_report());
        }
        bar.set_position((block.first_index as f64 / rate_hz) as u64);
    }
    bar.finish_and_clear();
    let mut out = std::io::stdout().lock();
    for report in &reports {
        let record = record(report, rate_hz, curve.as_ref());
        if args.json {
            writeln!(out, "{record}")?;
        } else {
            writeln!(out, "{}", line(report, rate_hz, &record))?;
        }
    }
    if reports.iter().all(|r| matches!(r.rate, Err(NoRate::NotEnoughData))) {
        bail!("less than 30 s of connected data: a rate needs that much");
    }
    Ok(())
}

/// One report as a record.
fn record(report: &RateReport, rate_hz: f64, curve: Option<&SpeedCurve>) -> Value {
    let t_s = report.index as f64 / rate_hz;
    match &report.rate {
        Err(reason) => {
            json!({ "type": "shaft_rate", "t_s": t_s, "rate_hz": null, "reason": reason_text(*reason) })
        }
        Ok(rate) => {
            let blades = match rate.reading {
                Reading::ShaftWithBlades(n) => json!(n),
                Reading::ShaftOrBlade => Value::Null,
            };
            let speeds: Vec<Value> = curve
                .map(|c| c.speeds(rate))
                .into_iter()
                .flatten()
                .flatten()
                .map(|s| json!({ "shaft_hz": s.shaft_hz, "speed_m_s": s.mean_m_s, "sd_speed_m_s": s.sd_m_s }))
                .collect();
            json!({
                "type": "shaft_rate", "t_s": t_s, "rate_hz": rate.rate_hz, "sd_hz": rate.sd_hz,
                "confidence": rate.confidence, "ln_false_alarm": rate.ln_false_alarm, "blades": blades,
                "alternatives_hz": rate.alternatives.iter().flatten().collect::<Vec<_>>(), "speeds": speeds,
            })
        }
    }
}

fn reason_text(reason: NoRate) -> &'static str {
    match reason {
        NoRate::NotEnoughData => "not enough data",
        NoRate::Unmodulated => "no modulation above the noise",
    }
}

/// One report as a line for a person.
fn line(report: &RateReport, rate_hz: f64, record: &Value) -> String {
    let t_s = report.index as f64 / rate_hz;
    match &report.rate {
        Err(reason) => format!("{t_s:8.1} s  {}", reason_text(*reason)),
        Ok(rate) => {
            let what = match rate.reading {
                Reading::ShaftWithBlades(n) => format!("shaft of {n} blades"),
                Reading::ShaftOrBlade => "shaft or blade".to_owned(),
            };
            let speeds: Vec<String> = record["speeds"]
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(|s| Some((s["speed_m_s"].as_f64()?, s["sd_speed_m_s"].as_f64()?)))
                .map(|(mean, sd)| format!("{mean:.1} ± {sd:.1} m/s"))
                .collect();
            format!(
                "{t_s:8.1} s  {:.3} ± {:.3} Hz ({what}){}{}",
                rate.rate_hz,
                rate.sd_hz,
                if speeds.is_empty() { "" } else { ": " },
                speeds.join(" or ")
            )
        }
    }
}
