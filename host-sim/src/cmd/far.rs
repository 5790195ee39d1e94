//! `seabearing far`: vessels too far from an ocean-bottom station to be ranged, by azimuths and tones.

use super::mistake;
use crate::ocean_bottom::far::heard::Heard;
use crate::ocean_bottom::far::tones::{Listener, Minute, Tapped};
use crate::ocean_bottom::far::{Known, Place, Track, picture, tracks};
use crate::ocean_bottom::records::is_records;
use crate::ocean_bottom::table;
use crate::propagation::{Propagation, file};
use crate::record::{finite, utc};
use crate::recording;
use crate::replay::replay;
use crate::station::Station;
use anyhow::Result;
use seabearing_core::angle::RAD_PER_DEG;
use serde_json::{Map, Value, json};
use std::path::PathBuf;
use time::OffsetDateTime;

/// Arguments of `seabearing far`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing far --station obs.toml --json *.mseed\n  \
    seabearing far obs.jsonl --plot far.svg     # records of `process` or of a base station: no tones\n\n\
    A `far_track` record for each vessel: azimuth and its rate, time and azimuth of the closest point, heading, speed over range;\n\
    speed and range by the fall of its tones (recordings alone), or by ranges where the recorder has them. What is not observable\n\
    is null. docs/ocean-bottom.md says what is assumed.")]
pub struct Args {
    /// Station file; needed for recordings, where records are of several stations, and for ranges: the depth of the floor is
    /// that of its propagation table.
    #[arg(long, value_parser = super::input())]
    station: Option<PathBuf>,
    /// Recordings (miniSEED or WAV) or folders of them; or one file of records of `seabearing process`.
    #[arg(required = true, value_parser = super::input())]
    input: Vec<PathBuf>,
    /// Draw azimuths, courses and ways into this SVG file.
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Results as JSON Lines.
    #[arg(long)]
    json: bool,
}

/// Speed of sound where no station file tells it, m/s.
const SOUND_M_S: f64 = 1_500.0;

/// Runs the command.
///
/// # Errors
/// One line: what is missing or cannot be read.
pub fn run(args: Args) -> Result<()> {
    let station = args.station.as_ref().map(|path| Station::read(path)).transpose()?;
    let propagation =
        station.as_ref().and_then(|s| s.propagation.as_ref()).map(|path| file::read(path)).transpose()?;
    let (heard, minutes) = match &args.input[..] {
        [one] if is_records(one) => (Heard::read(one, station.as_ref().map(|s| s.config.id))?, Vec::new()),
        _ => listen(&args, station.as_ref())?,
    };
    let place = place(station.as_ref(), propagation.as_ref());
    let found = tracks(&heard, &minutes, &place);
    if let Some(path) = &args.plot {
        picture::draw(&found, &heard.directions, heard.start, path)?;
    }
    let records: Vec<Value> = found.iter().enumerate().map(|(n, t)| record(n + 1, t, heard.start)).collect();
    super::print_records(&records, args.json)
}

fn place<'t>(station: Option<&Station>, table: Option<&'t Propagation>) -> Place<'t> {
    let config = station.map(|s| &s.config);
    Place {
        sound_speed_m_s: config.map_or(SOUND_M_S, |c| c.sound_speed_m_s),
        depth_m: table.map(|t| t.depth_m).or(config.map(|c| c.depth_m).filter(|d| *d > 0.0)),
        orientation_sd: config.map_or(0.0, |c| f64::from(c.doubts.orientation_deg) * RAD_PER_DEG),
        table,
    }
}

/// The recorder's chain over the recordings, and their lines.
fn listen(args: &Args, station: Option<&Station>) -> Result<(Heard, Vec<Minute>)> {
    let Some(station) = station else { mistake!("recordings need --station STATION.toml") };
    let mut source = recording::open(&args.input, station, None)?;
    let bytes = table::of_station(station)?;
    let mut heard = Heard::default();
    heard.start = source.start();
    let mut tapped = Tapped { source: source.as_mut(), listener: Listener::new(&station.config)? };
    let rate_hz = station.config.rate_hz;
    replay(&station.config, bytes.as_deref(), &mut tapped, |m| {
        heard.take(m, rate_hz);
        Ok(())
    })?;
    Ok((heard, tapped.listener.minutes))
}

fn record(id: usize, t: &Track, start: Option<OffsetDateTime>) -> Value {
    let mut out = Map::new();
    let mut put = |key: &str, value: Value| {
        out.insert(key.to_owned(), value);
    };
    let number = |k: Option<Known>, scale: f64| k.map_or(Value::Null, |k| finite(k.value * scale));
    let sd = |k: Option<Known>, scale: f64| k.map_or(Value::Null, |k| finite(k.sd * scale));
    let at = |t_s: f64| {
        let utc =
            |start: OffsetDateTime| Some(utc(start.checked_add(time::Duration::checked_seconds_f64(t_s)?)?));
        start.and_then(utc)
    };
    let degrees = 1.0 / RAD_PER_DEG;
    let (from_s, to_s) =
        (t.directions.first().map_or(0.0, |d| d.t_s), t.directions.last().map_or(0.0, |d| d.t_s));
    put("type", "far_track".into());
    put("id", id.into());
    put("from_s", json!(from_s));
    put("to_s", json!(to_s));
    for (key, t_s) in [("utc_from", from_s), ("utc_to", to_s)] {
        if let Some(utc) = at(t_s) {
            put(key, utc.into());
        }
    }
    put("n", t.directions.len().into());
    put("azimuth_deg", json!(t.azimuth.value * degrees));
    put("sd_azimuth_deg", json!(t.azimuth.sd * degrees));
    put("turning_deg_min", json!(t.turning.value * 60.0 * degrees));
    put("sd_turning_deg_min", json!(t.turning.sd * 60.0 * degrees));
    put("phase", t.phase.map_or(Value::Null, |p| p.name().into()));
    let closest = t.closest;
    put("cpa_time_s", number(closest.map(|c| c.time_s), 1.0));
    put("sd_cpa_time_s", sd(closest.map(|c| c.time_s), 1.0));
    if let Some(utc) = closest.and_then(|c| at(c.time_s.value)) {
        put("utc_cpa", utc.into());
    }
    put("cpa_azimuth_deg", number(closest.map(|c| c.azimuth), degrees));
    put("sd_cpa_azimuth_deg", sd(closest.map(|c| c.azimuth), degrees));
    put("heading_deg", number(closest.map(|c| c.heading), degrees));
    put("sd_heading_deg", sd(closest.map(|c| c.heading), degrees));
    put("side", closest.map_or(Value::Null, |c| if c.starboard { "starboard" } else { "port" }.into()));
    let scale = closest.and_then(|c| c.speed_over_range);
    put("speed_over_range_per_h", number(scale, 3_600.0));
    put("sd_speed_over_range_per_h", sd(scale, 3_600.0));
    put("speed_m_s", number(t.speed_m_s, 1.0));
    put("sd_speed_m_s", sd(t.speed_m_s, 1.0));
    put("cpa_range_m", number(t.range_m, 1.0));
    put("sd_cpa_range_m", sd(t.range_m, 1.0));
    put("distance_by", t.scale.map_or(Value::Null, |s| s.name().into()));
    put("ranges", t.ranges.into());
    put("ranges_refused", t.ranges_refused.into());
    put("tones_hz", t.tones.iter().map(|tone| (1e4 * tone.hz).round() / 1e4).collect());
    put("tracks", t.recorder_tracks.iter().copied().collect());
    Value::Object(out)
}
