//! `seabearing plan`: what a deployment costs and whether it fits.

use crate::plan::{self, Deployment, Plan, Power};
use crate::station::Station;
use anyhow::{Result, bail};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::recorder::HEALTH_EVERY_S;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Arguments of `seabearing plan`.
#[derive(clap::Args)]
#[command(
    arg_required_else_help = true,
    after_help = "Examples:\n  seabearing plan east.toml\n  \
    seabearing plan east.toml --days 30 --card-gb 2048 --vessels-a-day 40 --minutes-each 20\n\n\
    Work, memory and telemetry are measured (docs/budget.txt); traffic is what you expect. The line is judged by the worst \
    case: --at-once vessels, and faults of every kind. What the hardware draws is measured by whoever built it: \
    --battery-wh needs --supply-v, --awake-ma, --asleep-ma and --other-ma, and with --duty below 1 --off-ma. \
    Exit status 1 and one line where something does not fit."
)]
pub struct Args {
    /// Station file
    #[arg(value_parser = super::input())]
    station: PathBuf,
    /// Vessels that pass a day
    #[arg(long, value_name = "N", default_value_t = 20.0)]
    vessels_a_day: f64,
    /// Minutes for which each is heard
    #[arg(long, value_name = "MIN", default_value_t = 30.0)]
    minutes_each: f64,
    /// Vessels heard at once in the worst case
    #[arg(long, value_name = "N", default_value_t = seabearing_core::traffic::VESSELS as u32)]
    at_once: u32,
    /// Seconds between health reports, 0: only on request
    #[arg(long, value_name = "S", default_value_t = f64::from(HEALTH_EVERY_S))]
    health_s: f64,
    /// Bits a second of the telemetry's line [default: array 921600, ocean bottom 115200]
    #[arg(long, value_name = "BAUD")]
    baud: Option<f64>,
    /// Bytes a day that the link may carry [default: what the line carries]
    #[arg(long, value_name = "BYTES")]
    link_bytes_a_day: Option<f64>,
    /// Size of the card for the sound, 10⁹ bytes
    #[arg(long, value_name = "GB")]
    card_gb: Option<f64>,
    /// Bytes of a sample on the card [default: array 3, ocean bottom 4]
    #[arg(long, value_name = "BYTES")]
    bytes_a_sample: Option<f64>,
    /// Days that card and battery must last
    #[arg(long)]
    days: Option<f64>,
    /// Share of the time in which the recorder is switched on; the station file's schedule counts beside it
    #[arg(long, value_name = "SHARE", default_value_t = 1.0)]
    duty: f64,
    /// RAM of the microcontroller, KiB [default: the STM32H743's, memory.x]
    #[arg(long, value_name = "KIB")]
    ram_kb: Option<f64>,
    /// Its flash, KiB [default: the STM32H743's]
    #[arg(long, value_name = "KIB")]
    flash_kb: Option<f64>,
    /// Cycles an instruction takes [default: as docs/budget.txt assumes]
    #[arg(long)]
    cycles: Option<f64>,
    /// Energy of the battery that can be used
    #[arg(long, value_name = "WH")]
    battery_wh: Option<f64>,
    /// Its voltage
    #[arg(long, value_name = "V")]
    supply_v: Option<f64>,
    /// Current of the microcontroller awake
    #[arg(long, value_name = "MA")]
    awake_ma: Option<f64>,
    /// The same asleep
    #[arg(long, value_name = "MA")]
    asleep_ma: Option<f64>,
    /// Current of everything else while the recorder is on, pauses of its schedule with it: converter, amplifiers, line
    #[arg(long, value_name = "MA")]
    other_ma: Option<f64>,
    /// Current of all while it is off
    #[arg(long, value_name = "MA")]
    off_ma: Option<f64>,
    /// Results as one JSON record
    #[arg(long)]
    json: bool,
}

impl Args {
    fn deployment(&self, config: &StationConfig) -> Deployment {
        let is_obs = matches!(config.kind, Kind::Obs(_));
        Deployment {
            vessels_a_day: self.vessels_a_day,
            minutes_each: self.minutes_each,
            at_once: self.at_once,
            health_s: self.health_s,
            baud: self.baud.unwrap_or(if is_obs { 115_200.0 } else { 921_600.0 }),
            link_bytes_a_day: self.link_bytes_a_day,
            card_bytes: self.card_gb.map(|gb| gb * 1e9),
            sample_bytes: self.bytes_a_sample.unwrap_or(if is_obs { 4.0 } else { 3.0 }),
            days: self.days,
            duty: self.duty,
            ram_bytes: self.ram_kb.map(|k| k * 1024.0),
            flash_bytes: self.flash_kb.map(|k| k * 1024.0),
            cycles: self.cycles,
            power: Power {
                battery_wh: self.battery_wh,
                supply_v: self.supply_v,
                awake_ma: self.awake_ma,
                asleep_ma: self.asleep_ma,
                other_ma: self.other_ma,
                off_ma: self.off_ma,
            },
        }
    }
}

/// Runs the command.
///
/// # Errors
/// One line for a person: what is wrong with the input, or what does not fit.
pub fn run(args: Args) -> Result<()> {
    let station = Station::of_recorder(&args.station)?;
    let deployment = args.deployment(&station.config);
    let plan = plan::of(&station, &deployment)?;
    let record = record(&station, &deployment, &plan);
    if args.json {
        println!("{record}");
    } else {
        for (key, value) in record.as_object().into_iter().flatten().filter(|(key, _)| *key != "type") {
            match value {
                Value::Array(list) => list.iter().for_each(|v| println!("{key:26} {}", text(v))),
                value => println!("{key:26} {}", text(value)),
            }
        }
    }
    if !plan.misfits.is_empty() {
        bail!("{} does not fit: {}", args.station.display(), plan.misfits.join("; "));
    }
    Ok(())
}

fn record(station: &Station, deployment: &Deployment, plan: &Plan) -> Value {
    let config = &station.config;
    let whole = f64::round;
    let tenths = |x: f64| (x * 10.0).round() / 10.0;
    json!({
        "type": "plan", "station": config.id, "name": config.name.as_str(),
        "kind": if matches!(config.kind, Kind::Array(_)) { "array" } else { "obs" }, "rate_hz": config.rate_hz,
        "image": plan.image, "instructions_per_s": whole(plan.instructions_per_s),
        "awake": (plan.awake * 1e4).round() / 1e4, "awake_in_pauses": (plan.awake_in_pauses * 1e4).round() / 1e4,
        "ram_bytes": plan.ram_bytes.0, "ram_there_bytes": plan.ram_bytes.1,
        "flash_bytes": plan.flash_bytes.0, "flash_there_bytes": plan.flash_bytes.1,
        "vessels_a_day": deployment.vessels_a_day, "minutes_each": deployment.minutes_each,
        "link_bytes_a_day": whole(plan.link_bytes_a_day), "worst_link_bytes_a_day": whole(plan.worst_bytes_a_day),
        "worst_link_bytes_per_s": whole(plan.worst_bytes_per_s), "line_bytes_per_s": whole(plan.line_bytes_per_s),
        "at_once": deployment.at_once, "duty": deployment.duty, "listens": plan.listens,
        "card_bytes_a_day": whole(plan.card_bytes_a_day), "card_days": plan.card_days.map(tenths),
        "mean_ma": plan.mean_ma, "battery_days": plan.battery_days.map(tenths),
        "fits": plan.misfits.is_empty(), "misfits": plan.misfits, "notes": plan.notes,
    })
}

fn text(value: &Value) -> String {
    match value {
        Value::String(s) => s.clone(),
        Value::Number(n) => match n.as_f64() {
            Some(x) if x.fract() == 0.0 && x.abs() < 1e15 => format!("{x:.0}"),
            _ => n.to_string(),
        },
        Value::Null => "-".to_owned(),
        other => other.to_string(),
    }
}
