//! `seabearing orient`: station orientation from a vessel of known track.

use super::orient_obs;
use crate::csv::{Table, good_rows};
use crate::ocean_bottom::place::SEARCH_M;
use crate::orientation::track_file::{self, heard_at};
use crate::station::Station;
use anyhow::{Result, anyhow, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::kit::median;
use seabearing_locate::network::known_track::TrackPoint;
use seabearing_locate::orient::closed_form;
use seabearing_locate::orient::hydrophones::{Differences, hydrophones};
use seabearing_locate::orient::line::{LineBearing, LineSettings, orient};
use seabearing_locate::orient::offset::{Residual, offset};
use seabearing_locate::orient::rotation::{Direction, rotation};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Rows farther apart than this belong to different passes of an ocean-bottom station, seconds.
const PASS_GAP_S: f64 = 600.0;
/// Steps of η in which the closed form searches [L 18, 19].
const STEP_ETA: f64 = 0.001;

/// Arguments of `seabearing orient`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    seabearing orient --station line.toml --track ship.csv bearings.csv      # t_s,sin_bearing\n  \
    seabearing orient --station array.toml --track ship.csv bearings.csv     # t_s,azimuth_deg,elevation_deg\n  \
    seabearing orient --station array.toml --track ship.csv differences.csv  # t_s,tdoa01_s,...: hydrophone positions\n  \
    seabearing orient --station obs.toml --track ship.csv azimuths.csv       # t_s,azimuth_deg\n  \
    seabearing orient --station obs.toml --track a.csv --track b.csv records.jsonl   # orientation and position\n  \
    seabearing orient --station obs.toml --track a.csv --track b.csv *.mseed         # the same from the recording\n\n\
    TRACK.csv has the header t_s,x_m,y_m (local frame of the station file; the station at the origin where the file \
    gives no local_m) or t_s,lat,lon; a vessel each. From the azimuth and range records of `process`, or from the \
    recording, an ocean-bottom station's position is estimated too; times are seconds from the recording's start. \
    orientation_deg is what belongs into the station file; for arrays and \
    ocean-bottom stations the bearings are taken as computed with the orientation that stands there now.")]
pub struct Args {
    /// What the station measured: CSV, its header depends on the station's kind; records or recordings of an
    /// ocean-bottom station.
    #[arg(required = true, value_name = "INPUT")]
    input: Vec<PathBuf>,
    /// Station file.
    #[arg(long)]
    station: PathBuf,
    /// Track of a vessel: t_s,x_m,y_m or t_s,lat,lon; repeated for more vessels (ocean-bottom stations).
    #[arg(long, required = true, value_name = "TRACK.csv")]
    track: Vec<PathBuf>,
    /// Depth of the vessel's sound source, metres.
    #[arg(long, default_value_t = 5.0)]
    source_depth_m: f64,
    /// Longest gap of the track that is interpolated, seconds.
    #[arg(long, default_value_t = 300.0)]
    max_gap_s: f64,
    /// Line: largest clock shift searched either way, seconds [default: the larger of six bearings and a tenth of the
    /// record].
    #[arg(long)]
    max_shift_s: Option<f64>,
    /// Line: do not prefer shifts of whole bearings where the data allow them.
    #[arg(long)]
    free_shift: bool,
    /// Line: limits of eta, the cosine of the sound's common elevation.
    #[arg(long, default_values_t = [0.85, 1.05], num_args = 2, value_names = ["LEAST", "GREATEST"])]
    eta: Vec<f64>,
    /// Line: `fit` (robust, continuous) or `closed-form` (paper L: shift by whole bearings, eta by 0.001).
    #[arg(long, default_value = "fit")]
    method: String,
    /// Ocean bottom: farthest the station is looked for from its nominal position, either way, metres.
    #[arg(long, default_value_t = SEARCH_M)]
    search_m: f64,
    /// Array: how many successive bearings share one error (1: independent).
    #[arg(long, default_value_t = 2.0)]
    correlated: f64,
    /// Results as JSON Lines.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    for (key, x) in [("max-gap-s", args.max_gap_s), ("max-shift-s", args.max_shift_s.unwrap_or(1.0))] {
        if !(x > 0.0 && x.is_finite()) {
            bail!("--{key} is {x}; a positive number is needed");
        }
    }
    if !(args.source_depth_m.is_finite() && args.correlated >= 1.0 && args.correlated.is_finite()) {
        bail!("--source-depth-m must be finite and --correlated at least 1");
    }
    if !(args.search_m >= 100.0 && args.search_m <= 20_000.0) {
        bail!("--search-m is {}; 100 to 20000 m are possible", args.search_m);
    }
    let read = Station::read(&args.station)?;
    let records = match &read.config.kind {
        Kind::Obs(_) if !is_table(&args.input) => {
            let tracks = tracks(&args, &read.config)?;
            orient_obs::records(&read, &args.input, &tracks, args.max_gap_s, args.search_m)?
        }
        _ => vec![from_table(&args, &read.config)?],
    };
    for record in &records {
        if args.json {
            println!("{record}");
            continue;
        }
        for (key, value) in record.as_object().into_iter().flatten().filter(|(k, _)| *k != "type") {
            println!("{key:24} {value}");
        }
    }
    Ok(())
}

/// Whether the input is one CSV file, by its name.
fn is_table(input: &[PathBuf]) -> bool {
    matches!(input, [one] if one.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")))
}

/// The vessels' tracks.
fn tracks(args: &Args, station: &StationConfig) -> Result<Vec<Vec<TrackPoint>>> {
    args.track.iter().map(|path| track_file::read(path, station, args.source_depth_m)).collect()
}

/// What a CSV file tells about a station.
fn from_table(args: &Args, station: &StationConfig) -> Result<Value> {
    let [input] = &args.input[..] else {
        bail!("one CSV file is needed, {} files were given", args.input.len())
    };
    let tracks = tracks(args, station)?;
    let [track] = &tracks[..] else { bail!("one --track goes with a CSV file, {} were given", tracks.len()) };
    let table = Table::read(input)?;
    match &station.kind {
        Kind::Line(_) => line(args, &table, track),
        Kind::Array(_) if table.has("tdoa01_s") => positions(args, station, &table, track),
        Kind::Array(_) => array(args, station, &table, track),
        Kind::Obs(o) => horizontals(args, station, o.orientation_of_north_deg, &table, track),
    }
}

fn file_name(args: &Args) -> String {
    args.input.first().map_or(String::new(), |p| p.display().to_string())
}

/// The line array: orientation, clock shift and η.
fn line(args: &Args, table: &Table, track: &[TrackPoint]) -> Result<Value> {
    let name = file_name(args);
    let rows = table.numbers(["t_s", "sin_bearing"])?.into_iter().map(|(line, row)| {
        let row = row.and_then(|[t_s, sine]| {
            if sine.abs() > 1.5 {
                bail!("{name}, line {line}: `sin_bearing` is {sine}, a sine was expected");
            }
            Ok(LineBearing { t_s, sine })
        });
        (line, row)
    });
    let mut bearings = good_rows(&name, rows.collect())?;
    bearings.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    let interval = median_interval(&bearings);
    let duration = bearings[bearings.len() - 1].t_s - bearings[0].t_s;
    let most = args.max_shift_s.unwrap_or((6.0 * interval).max(0.1 * duration));
    let settings = LineSettings {
        shift_s: (-most, most),
        eta: (args.eta[0].min(args.eta[1]), args.eta[0].max(args.eta[1])),
        gap_s: args.max_gap_s,
        whole_s: if args.free_shift { 0.0 } else { interval },
    };
    let refused = |e| anyhow!("{name}: {e}");
    match args.method.as_str() {
        "fit" => {
            let fit = orient(&bearings, track, &settings).map_err(refused)?;
            Ok(json!({
                "type": "orientation", "orientation_deg": degrees(fit.orientation), "sd_deg": fit.sd / RAD_PER_DEG,
                "time_shift_s": fit.time_shift_s, "eta": fit.eta, "mean_error_deg": fit.mean_error / RAD_PER_DEG,
                "n": fit.n, "sd_time_shift_s": fit.sd_time_shift_s, "sd_eta": fit.sd_eta,
            }))
        }
        "closed-form" => {
            let whole = LineSettings {
                shift_s: (-(most / interval).floor() * interval, (most / interval).floor() * interval),
                ..settings
            };
            let found = closed_form::search(&bearings, track, &whole, interval, STEP_ETA).map_err(refused)?;
            let sd = closed_form::spread(&bearings, track, &whole, interval, STEP_ETA, &found);
            Ok(json!({
                "type": "orientation", "orientation_deg": degrees(found.orientation),
                "sd_deg": sd.map(|sd| sd / RAD_PER_DEG),
                "time_shift_s": found.time_shift_s, "eta": found.eta,
                "mean_error_deg": found.mean_error / RAD_PER_DEG, "n": found.n,
            }))
        }
        other => bail!("--method {other}; fit or closed-form"),
    }
}

fn median_interval(bearings: &[LineBearing]) -> f64 {
    let mut steps: Vec<f64> = bearings.windows(2).map(|w| w[1].t_s - w[0].t_s).filter(|d| *d > 0.0).collect();
    median(&mut steps).unwrap_or(1.0)
}

/// The compact array: heading, pitch and roll.
fn array(args: &Args, station: &StationConfig, table: &Table, track: &[TrackPoint]) -> Result<Value> {
    let name = file_name(args);
    let rows = good_rows(&name, table.numbers(["t_s", "azimuth_deg", "elevation_deg"])?)?;
    let directions: Vec<Direction> = rows
        .into_iter()
        .filter_map(|[t_s, azimuth_deg, elevation_deg]| {
            let p = heard_at(track, t_s, args.max_gap_s, station.sound_speed_m_s)?;
            let n = p.iter().map(|x| x * x).sum::<f64>().sqrt();
            let (sa, ca) = (azimuth_deg * RAD_PER_DEG).sin_cos();
            let (se, ce) = (elevation_deg * RAD_PER_DEG).sin_cos();
            (n > 0.0).then(|| Direction { measured: [sa * ce, ca * ce, se], known: p.map(|x| x / n) })
        })
        .collect();
    let found = rotation(&directions, args.correlated).map_err(|e| anyhow!("{name}: {e}"))?;
    Ok(json!({
        "type": "orientation",
        "orientation_deg": degrees(found.heading + station.orientation_deg * RAD_PER_DEG),
        "sd_deg": found.sd[0] / RAD_PER_DEG,
        "pitch_deg": found.pitch / RAD_PER_DEG, "sd_pitch_deg": found.sd[1] / RAD_PER_DEG,
        "roll_deg": found.roll / RAD_PER_DEG, "sd_roll_deg": found.sd[2] / RAD_PER_DEG,
        "mean_error_deg": found.median_error / RAD_PER_DEG, "n": found.n, "matrix": found.matrix,
    }))
}

/// The compact array: positions of its hydrophones from arrival-time differences.
fn positions(args: &Args, station: &StationConfig, table: &Table, track: &[TrackPoint]) -> Result<Value> {
    let name = file_name(args);
    let columns = ["t_s", "tdoa01_s", "tdoa02_s", "tdoa03_s", "tdoa12_s", "tdoa13_s", "tdoa23_s"];
    let rows = good_rows(&name, table.numbers(columns)?)?;
    let sets: Vec<Differences> = rows
        .into_iter()
        .filter_map(|[t_s, a, b, c, d, e, f]| {
            let source_m = heard_at(track, t_s, args.max_gap_s, station.sound_speed_m_s)?;
            Some(Differences { source_m, tdoa_s: [a, b, c, d, e, f] })
        })
        .collect();
    let geometry = station.geometry().map_err(|e| anyhow!("{}: {e:?}", args.station.display()))?;
    let configured = geometry.position_m.map(|p| p.map(f64::from));
    let found =
        hydrophones(&sets, &configured, station.sound_speed_m_s).map_err(|e| anyhow!("{name}: {e}"))?;
    // Back into the frame before orientation, in which the station file states positions.
    let (s, c) = (station.orientation_deg * RAD_PER_DEG).sin_cos();
    let unturned = found.position_m.map(|[x, y, z]| [x * c - y * s, x * s + y * c, z]);
    Ok(json!({
        "type": "hydrophones", "hydrophones_m": unturned, "sd_m": found.sd_m, "scale_s": found.scale_s, "n": found.n,
    }))
}

/// The ocean-bottom station: true azimuth of its "north" component.
fn horizontals(
    args: &Args,
    station: &StationConfig,
    configured_deg: f64,
    table: &Table,
    track: &[TrackPoint],
) -> Result<Value> {
    let name = file_name(args);
    let mut rows = good_rows(&name, table.numbers(["t_s", "azimuth_deg"])?)?;
    rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let (mut pass, mut last) = (0u32, f64::NEG_INFINITY);
    let mut residuals = Vec::new();
    for [t_s, azimuth_deg] in rows {
        let Some([x, y, _]) = heard_at(track, t_s, args.max_gap_s, station.sound_speed_m_s) else { continue };
        if t_s - last > PASS_GAP_S && last.is_finite() {
            pass += 1;
        }
        last = t_s;
        residuals.push(Residual { angle: wrap_pi(x.atan2(y) - azimuth_deg * RAD_PER_DEG), pass });
    }
    let found = offset(&residuals).map_err(|e| anyhow!("{name}: {e}"))?;
    Ok(json!({
        "type": "orientation",
        "orientation_deg": degrees(found.offset + configured_deg * RAD_PER_DEG),
        "sd_deg": found.sd / RAD_PER_DEG, "mean_error_deg": found.scale / RAD_PER_DEG, "support": found.support,
        "n": found.n, "passes": found.passes,
    }))
}

/// Degrees in (−180, 180].
pub(super) fn degrees(angle: f64) -> f64 {
    wrap_pi(angle) / RAD_PER_DEG
}
