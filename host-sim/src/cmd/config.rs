//! `seabearing config`: check a station file or a list of stations, and say what accuracy to expect.

use super::config_network;
use super::mistake;
use crate::bounds::bearing::{self, worst};
use crate::bounds::line::Expectations;
use crate::bounds::passage::Assumed;
use crate::bounds::picture::{self, Curve};
use crate::line::check_frequencies;
use crate::propagation;
use crate::record::finite;
use crate::station::Station;
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::array::{FRAME, Plan, limit};
use seabearing_core::config::{ArrayConfig, Compatibility, Kind, LineConfig, ObsConfig, StationConfig};
use seabearing_core::geometry::PAIRS;
use seabearing_host::toml_file::TomlFile;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Arguments of `seabearing config`.
#[derive(clap::Args)]
#[command(arg_required_else_help = true)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    /// Validate a station file or a list of stations; print geometry, ambiguity and expected accuracy
    Check(CheckArgs),
}

/// Arguments of `seabearing config check`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  seabearing config check east.toml\n  seabearing config check east.toml --explain\n  \
    seabearing config check east.toml --plots out/expected\n  \
    seabearing config check network.toml --plots out/expected --max-range-m 1000   # a list of stations\n\n\
    The expected accuracy of a bearing is the physical limit of one segment for a source whose spectrum has the shape of the \
    noise's: no estimator does better; and with it what position_sd_m and sound_speed_sd_m_s of the file add (1 cm: 0.44° for an \
    array of 1.85 m). That of a passage is the bound for what the recorder itself assumes: the errors of [tracking], those that \
    last, 1° of all elevations, the doubt about the height. Of a list of stations ([[stations]]) it is that of \
    positions and straight passages against their place, for errors of --sigma-azimuth-deg and --sigma-elevation-deg and with \
    what the list says of orientations and clocks; --plots draws it as maps."
)]
pub(super) struct CheckArgs {
    /// Station file, or list of stations.
    #[arg(value_parser = super::input())]
    pub(super) station: PathBuf,
    /// Results as one JSON record.
    #[arg(long)]
    pub(super) json: bool,
    /// Folder for pictures of what to expect.
    #[arg(long, value_name = "DIR")]
    pub(super) plots: Option<PathBuf>,
    /// List of stations: standard deviation of azimuths, degrees [default: 1.5].
    #[arg(long)]
    pub(super) sigma_azimuth_deg: Option<f64>,
    /// List of stations: standard deviation of elevations, degrees [default: 1.6].
    #[arg(long)]
    pub(super) sigma_elevation_deg: Option<f64>,
    /// List of stations: depth of the source, metres [default: 5].
    #[arg(long)]
    pub(super) depth_m: Option<f64>,
    /// List of stations: how far about its centre, metres [default: 2000].
    #[arg(long)]
    pub(super) max_range_m: Option<f64>,
    /// Array, line or list of stations: speed of passing vessels, m/s [default: 7].
    #[arg(long = "speed", value_name = "M_S")]
    speed_m_s: Option<f64>,
    /// Array, line or list of stations: for how long a passing vessel is heard [default: 5].
    #[arg(long)]
    minutes: Option<f64>,
    /// List of stations: time between bearings of a passage whose errors are independent, seconds [default: 10].
    #[arg(long)]
    pub(super) every_s: Option<f64>,
    /// Explain every key of a station file first: its meaning, unit, bounds and default
    #[cfg(feature = "schema")]
    #[arg(long, conflicts_with = "json")]
    explain: bool,
}

impl CheckArgs {
    /// Speed of passing vessels, m/s.
    pub(super) fn speed_m_s(&self) -> f64 {
        self.speed_m_s.unwrap_or(7.0)
    }

    /// For how long a passing vessel is heard, minutes.
    pub(super) fn minutes(&self) -> f64 {
        self.minutes.unwrap_or(5.0)
    }

    /// What was asked that a station of this kind does not use: its name.
    fn unused(&self, kind: &Kind) -> Option<&'static str> {
        let of_a_passage = !matches!(kind, Kind::Obs(_));
        let given = [
            ("sigma-azimuth-deg", self.sigma_azimuth_deg),
            ("sigma-elevation-deg", self.sigma_elevation_deg),
            ("depth-m", self.depth_m),
            ("max-range-m", self.max_range_m),
            ("every-s", self.every_s),
            ("speed", self.speed_m_s.filter(|_| !of_a_passage)),
            ("minutes", self.minutes.filter(|_| !of_a_passage)),
        ];
        given.into_iter().find(|(_, x)| x.is_some()).map(|(key, _)| key)
    }
}

/// Signal-to-noise ratios for which accuracy is stated, dB.
const SNR_DB: [f64; 3] = [10.0, 0.0, -10.0];
/// Longest passage of one array, minutes: a bearing each half second.
const LONGEST_MIN: f64 = 6.5;
/// Signal-to-noise ratio (dB) and elevation (degrees) of the bearings of a passage: those of a vessel well heard, some depths away.
const PASSAGE_SNR_DB: f64 = 0.0;
const PASSAGE_ELEVATION_DEG: f64 = 20.0;
/// Elevations for which accuracy is stated, degrees.
const ELEVATIONS_DEG: [f64; 3] = [0.0, 20.0, 60.0];

/// Shallowest water over which tracks of an ocean-bottom station are tried, metres.
const TRIED_FROM_M: f64 = 2000.0;

/// Ranges for which the interference delays of an ocean-bottom station are shown, metres.
const RANGES_M: [f64; 4] = [10_000.0, 20_000.0, 35_000.0, 50_000.0];

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    let Action::Check(args) = args.action;
    if TomlFile::read(&args.station, "station file")?.has("stations") {
        return config_network::run(&args);
    }
    let positive = args.speed_m_s() > 0.0 && args.speed_m_s().is_finite();
    let heard = args.minutes() > 0.0 && args.minutes() <= LONGEST_MIN;
    if !(positive && heard) {
        mistake!("--speed must be a positive number, and --minutes at most {LONGEST_MIN} for one station");
    }
    #[cfg(feature = "schema")]
    if args.explain {
        let keys = crate::station::schema::keys();
        let width = keys.iter().map(|(key, _)| key.len()).max().unwrap_or(0);
        keys.iter().for_each(|(key, text)| println!("{key:width$}  {text}"));
        println!();
    }
    let station = Station::of_recorder(&args.station)?;
    let config = &station.config;
    if let Some(key) = args.unused(&config.kind) {
        mistake!(
            "--{key}: {} is one station, whose file says what its bearings err by; only a list of stations ([[stations]]) takes this",
            args.station.display()
        );
    }
    if let (Some(folder), Kind::Obs(_)) = (&args.plots, &config.kind) {
        mistake!(
            "--plots {}: what an array, a line or a list of stations will tell is drawn, not this",
            folder.display()
        );
    }
    let mut record = json!({
        "type": "config", "station": config.id, "name": config.name.as_str(),
        "hash": format!("{:016x}", config.hash()), "sound_speed_m_s": config.sound_speed_m_s,
        "orientation_deg": config.orientation_deg, "depth_m": config.depth_m, "rate_hz": config.rate_hz,
    });
    let details = match &config.kind {
        Kind::Array(array) => array_details(&args, config, array)?,
        Kind::Line(line) => line_details(&args, &station, line)?,
        Kind::Obs(obs) => obs_details(&station, obs)?,
    };
    if let (Some(record), Value::Object(details)) = (record.as_object_mut(), details) {
        record.extend(details);
    }
    let levels = &config.levels;
    if levels.every_s > 0
        && let Some(record) = record.as_object_mut()
    {
        record.insert("levels_every_s".into(), levels.every_s.into());
        record.insert("levels_channel".into(), levels.channel.into());
    }
    if args.json {
        println!("{record}");
    } else {
        print(&record);
        println!("the station file is valid");
    }
    Ok(())
}

/// Angles from broadside for which a line's accuracy is stated, degrees.
const FROM_BROADSIDE_DEG: [f64; 5] = [0.0, 30.0, 60.0, 80.0, 88.0];
/// Ranges of closest points for which passages are stated, metres.
const CLOSEST_M: [f64; 5] = [250.0, 500.0, 1000.0, 2000.0, 4000.0];
/// Ranges of the curves drawn, metres: so many from the first to the last.
const DRAWN: (usize, f64, f64) = (40, 100.0, 5000.0);

/// Bounds of straight passages, as the recorder follows them: by azimuths with the speed that `[tracking]` assumes, and where the
/// depths are known, with elevations; and of a position by one bearing. `null` where nothing is told. With them what was assumed.
fn passages(
    args: &CheckArgs,
    config: &StationConfig,
    array: &ArrayConfig,
    plan: &Plan,
) -> Result<(Value, Value)> {
    let (speed_m_s, window_s) = (args.speed_m_s(), 60.0 * args.minutes());
    let elevation_rad = PASSAGE_ELEVATION_DEG.to_radians();
    let own = worst(elevation_rad, |at| {
        bearing::noise(plan.geometry(), array, at, information(plan, array, PASSAGE_SNR_DB))
    });
    let lasting = worst(elevation_rad, |at| bearing::lasting(plan.geometry(), config, array, at));
    let assumed = Assumed::of(config, own, lasting);
    let pass = |range_m: f64| assumed.pass(range_m, window_s, speed_m_s);
    let expected = |range_m: f64, elevations: bool| assumed.expected(&pass(range_m), elevations);
    let one_bearing = |range_m: f64| assumed.one_bearing(config, range_m);
    if let Some(folder) = &args.plots {
        make(folder)?;
        let (n, from, to) = DRAWN;
        let ranges = (0..=n).map(|k| from * (to / from).powf(k as f64 / n as f64));
        let curve = |name: String, elevations: bool| -> Curve {
            let at = |r| expected(r, elevations).map(|b| (r, b.cpa_range_m, b.heading_rad.to_degrees()));
            (name, ranges.clone().filter_map(at).collect())
        };
        let speed_sd_m_s = config.tracking.speed_sd_m_s;
        let mut curves = vec![curve(format!("azimuths, speed to {speed_sd_m_s:.1} m/s"), false)];
        if assumed.elevations() {
            curves.push(curve("azimuths and elevations, as the recorder".to_owned(), true));
        }
        let positions: Vec<_> = ranges.filter_map(|r| Some((r, one_bearing(r)?))).collect();
        picture::passages(&pass(1000.0), &curves, &positions, &folder.join("accuracy.svg"))?;
    }
    let rows = CLOSEST_M.iter().map(|range_m| {
        let told = |x: Option<f64>| x.map_or(Value::Null, finite);
        let (speed, elevations) = (expected(*range_m, false), expected(*range_m, true));
        json!({
            "cpa_range_m": range_m,
            "sd_cpa_range_m": told(speed.map(|s| s.cpa_range_m)),
            "sd_heading_deg": told(speed.map(|s| s.heading_rad.to_degrees())),
            "sd_cpa_time_s": told(speed.map(|s| s.cpa_time_s)),
            "elevations_sd_cpa_range_m": told(elevations.map(|s| s.cpa_range_m)),
            "elevations_sd_heading_deg": told(elevations.map(|s| s.heading_rad.to_degrees())),
            "elevations_sd_speed_m_s": told(elevations.map(|s| s.speed_m_s)),
            "one_bearing_sd_position_m": told(one_bearing(*range_m)),
        })
    });
    let used = |x: f64| if assumed.elevations() { finite(x) } else { Value::Null };
    let recorder = &assumed.recorder;
    let said = json!([{
        "speed_m_s": speed_m_s, "heard_s": window_s, "speed_sd_m_s": recorder.speed_sd_m_s, "snr_db": PASSAGE_SNR_DB,
        "azimuth_sd_deg": assumed.azimuth_sd.to_degrees(), "azimuth_tau_s": pass(1000.0).tau_s,
        "lasting_azimuth_sd_deg": recorder.lasting_sd_rad.to_degrees(),
        "elevation_sd_deg": used(assumed.elevation_sd.to_degrees()),
        "elevation_bias_sd_deg": used(assumed.elevation_bias_sd.to_degrees()),
        "course_sd_deg": recorder.course_sd_rad.to_degrees(),
        "height_m": used(recorder.medium.height_m), "height_sd_m": used(recorder.height_sd_m),
    }]);
    Ok((rows.collect(), said))
}

/// Information of one bearing's segment about arrival times at a signal-to-noise ratio, 1/s².
fn information(plan: &Plan, array: &ArrayConfig, snr_db: f64) -> f64 {
    let snr = 10f64.powf(snr_db / 10.0);
    let (low, high) = plan.band_hz();
    limit::arrival_information(4, (f64::from(low), f64::from(high)), array.segment_s, |_| snr, 500)
}

/// The folder for pictures.
fn make(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make folder {}", folder.display()))
}

fn array_details(args: &CheckArgs, config: &StationConfig, array: &ArrayConfig) -> Result<Value> {
    let plan = Plan::new(config).map_err(|e| anyhow!("{e}"))?;
    let geometry = plan.geometry();
    let pairs: Vec<Value> = PAIRS
        .iter()
        .enumerate()
        .map(|(p, (i, j))| {
            let d = f64::from(geometry.separation_m(p));
            let delay = d / config.sound_speed_m_s;
            json!({
                "pair": format!("{i}{j}"), "separation_m": d, "longest_delay_us": delay * 1e6,
                "longest_delay_samples": delay * config.rate_hz,
            })
        })
        .collect();
    let longest = (0..PAIRS.len()).map(|p| geometry.separation_m(p)).fold(0.0f32, f32::max);
    let band = plan.band_hz();
    let band = (f64::from(band.0), f64::from(band.1));
    let mut accuracy = Vec::new();
    for snr_db in SNR_DB {
        let information = information(&plan, array, snr_db);
        for elevation_deg in ELEVATIONS_DEG {
            // Geometry decides how accuracy varies with azimuth: the worst of a ring of azimuths is stated.
            let elevation = f64::to_radians(elevation_deg);
            let noise = |at| bearing::noise(geometry, array, at, information);
            let whole = |at| Some(noise(at)?.with(bearing::lasting(geometry, config, array, at)?));
            let (noise, whole) = (worst(elevation, noise), worst(elevation, whole));
            accuracy.push(json!({
                "snr_db": snr_db, "elevation_deg": elevation_deg, "azimuth_limit_deg": noise.azimuth.to_degrees(),
                "elevation_limit_deg": noise.elevation.to_degrees(), "azimuth_sd_deg": whole.azimuth.to_degrees(),
                "elevation_sd_deg": whole.elevation.to_degrees(),
            }));
        }
    }
    let (expected, assumed) = passages(args, config, array, &plan)?;
    Ok(json!({
        "kind": "array", "pairs": pairs, "band_hz": [band.0, band.1], "segment_s": array.segment_s,
        "step_s": array.step_s, "reference_range_m": finite(array.reference_range_m),
        "bin_hz": config.rate_hz / FRAME as f64,
        "resolution_deg": f64::from(plan.resolution_rad()).to_degrees(),
        "ambient_coherent_below_hz": config.sound_speed_m_s / (2.0 * f64::from(longest)),
        "threshold": f64::from(plan.threshold()), "false_alarms_per_hour": array.false_alarms_per_hour,
        "ambiguity": "none: the hydrophones span space",
        "position_sd_m": array.position_sd_m, "sound_speed_sd_m_s": array.sound_speed_sd_m_s,
        "expected_accuracy": accuracy, "passages_assume": assumed, "expected_passages": expected,
    }))
}

fn obs_details(station: &Station, obs: &ObsConfig) -> Result<Value> {
    let mut details = json!({
        "kind": "obs", "orientation_of_north_deg": obs.orientation_of_north_deg,
        "intensity": if obs.intensity_towards { "towards" } else { "away" },
        "compatibility": match obs.compatibility {
            Compatibility::None => "none",
            Compatibility::Paper => "paper",
            Compatibility::Programme => "programme",
        },
        "azigram": obs.azigram,
        "ambiguity": "none in azimuth; range by its propagation table",
        "propagation": station.propagation.as_ref().map(|p| p.display().to_string()),
    });
    // The recorder's own form of the table: what cannot be used shall be known before the deployment.
    crate::ocean_bottom::table::of_station(station)?;
    let Some(path) = &station.propagation else {
        bail!(
            "{}: an ocean-bottom recorder needs a propagation table: key `propagation` in [obs]",
            station.config.name
        )
    };
    if let Some(map) = details.as_object_mut() {
        let table = propagation::file::read(path)?;
        if table.depth_m < TRIED_FROM_M {
            log::warn!(
                "{}: tracks are tried over {TRIED_FROM_M:.0} m of water and more; over {:.0} m vessels may be told at half of their range and speed, \
                 and tracks state that as their deviation",
                path.display(),
                table.depth_m
            );
        }
        let delays: Vec<Value> = RANGES_M
            .iter()
            .map(|range_m| {
                let row = (range_m / table.step_m).round() as usize;
                let mut at = serde_json::Map::new();
                at.insert("range_m".into(), json!(range_m));
                for branch in 0..table.paths.len().saturating_sub(1) {
                    let crossings = table.paths[branch].crossings;
                    let key = format!("delay_{}_{}_s", crossings, crossings + 2);
                    let arrival = |p: usize| table.paths[p].arrivals.get(row).copied().flatten();
                    let delay = arrival(branch + 1).zip(arrival(branch)).map(|(b, a)| b.toa_s - a.toa_s);
                    at.insert(key, delay.map_or(Value::Null, |d| json!(d)));
                }
                Value::Object(at)
            })
            .collect();
        map.insert("table_depth_m".into(), json!(table.depth_m));
        map.insert("table_range_m".into(), json!(table.max_range_m()));
        map.insert("interference".into(), json!(delays));
    }
    Ok(details)
}

fn line_details(args: &CheckArgs, station: &Station, line: &LineConfig) -> Result<Value> {
    let (config, analysis) = (&station.config, &station.line);
    let mut details = json!({
        "kind": "line", "sensors": line.sensors, "spacing_m": line.spacing_m,
        "length_m": f64::from(line.sensors - 1) * line.spacing_m,
        "unambiguous_below_hz": config.sound_speed_m_s / (2.0 * line.spacing_m),
        "ambiguity": "conical: a bearing and its mirror image about the line cannot be told apart",
    });
    if config.rate_hz > 0.0 {
        check_frequencies(analysis, config.rate_hz)
            .with_context(|| format!("{}: [line]", args.station.display()))?;
    }
    let lacks = match (analysis.frequencies_hz.is_empty(), config.rate_hz > 0.0) {
        (true, _) => Some("`frequencies_hz` in [line]"),
        (false, false) => Some("`rate_hz` in [sampling]"),
        (false, true) => None,
    };
    if let Some(key) = lacks {
        log::warn!(
            "{}: `orient` of a table can use this file, `process` cannot: it needs {key}",
            args.station.display()
        );
    }
    let expectations = Expectations::of(config, analysis)
        .map_err(|(f, e)| anyhow!("{}: [line] at {f} Hz: {e}", args.station.display()))?;
    let Some(line) = expectations else {
        if let Some(folder) = &args.plots {
            mistake!(
                "--plots {}: what this line will tell depends on `frequencies_hz` in [line], which its file does not name",
                folder.display()
            );
        }
        return Ok(details);
    };
    let power = |snr_db: f64| 10f64.powf(snr_db / 10.0);
    let (speed_m_s, heard_s) = (args.speed_m_s(), 60.0 * args.minutes());
    let azimuth_deg =
        |snr_db, from_deg: f64| line.azimuth_sd(power(snr_db), from_deg.to_radians()).map(f64::to_degrees);
    let orientation_deg = |snr_db, range_m| {
        line.orientation_sd(power(snr_db), range_m, speed_m_s, heard_s).map(f64::to_degrees)
    };
    let pairs = |of: &[f64]| -> Vec<(f64, f64)> {
        SNR_DB.iter().flat_map(|snr_db| of.iter().map(move |x| (*snr_db, *x))).collect()
    };
    let accuracy: Vec<Value> = pairs(&FROM_BROADSIDE_DEG)
        .into_iter()
        .map(|(snr_db, from_deg)| {
            json!({
                "snr_db": snr_db, "from_broadside_deg": from_deg, "sd_sin_bearing": line.sine_sd(power(snr_db)),
                "sd_azimuth_deg": azimuth_deg(snr_db, from_deg),
            })
        })
        .collect();
    let orientations: Vec<Value> = pairs(&CLOSEST_M)
        .into_iter()
        .map(|(snr_db, range_m)| {
            json!({
                "snr_db": snr_db, "cpa_range_m": range_m, "speed_m_s": speed_m_s, "heard_s": heard_s,
                "sd_orientation_deg": orientation_deg(snr_db, range_m),
            })
        })
        .collect();
    if let Some(folder) = &args.plots {
        make(folder)?;
        let (n, from, to) = DRAWN;
        let ranges: Vec<f64> = (0..=n).map(|k| from * (to / from).powf(k as f64 / n as f64)).collect();
        let angles: Vec<f64> = (0..90).map(f64::from).collect();
        let curves = |along: &[f64], of: &dyn Fn(f64, f64) -> Option<f64>| -> Vec<(f64, Vec<(f64, f64)>)> {
            let curve = |snr_db: f64| along.iter().filter_map(|x| Some((*x, of(snr_db, *x)?))).collect();
            SNR_DB.iter().map(|snr_db| (*snr_db, curve(*snr_db))).collect()
        };
        picture::line(
            &curves(&angles, &azimuth_deg),
            &curves(&ranges, &orientation_deg),
            &format!("{heard_s:.0} s, {speed_m_s:.1} m/s"),
            &folder.join("accuracy.svg"),
        )?;
    }
    details["frequencies_hz"] = json!(analysis.frequencies_hz);
    details["snapshots"] = json!(line.snapshots());
    details["expected_accuracy"] = json!(accuracy);
    details["expected_orientation"] = json!(orientations);
    Ok(details)
}

/// The record for a person: one key a line, tables as tables.
pub(super) fn print(record: &Value) {
    let Some(map) = record.as_object() else { return };
    for (key, value) in map.iter().filter(|(k, _)| *k != "type") {
        match value {
            Value::Array(rows) if rows.first().is_some_and(Value::is_object) => {
                println!("{key}:");
                for row in rows.iter().filter_map(Value::as_object) {
                    let cells: Vec<String> = row.iter().map(|(k, v)| format!("{k} {}", cell(v))).collect();
                    println!("    {}", cells.join("   "));
                }
            }
            _ => println!("{key}: {}", cell(value)),
        }
    }
}

fn cell(value: &Value) -> String {
    match value {
        Value::String(s) => s.clone(),
        Value::Number(n) if n.is_f64() => {
            let x = n.as_f64().unwrap_or(f64::NAN);
            if x != 0.0 && x.abs() < 0.1 { format!("{x:.5}") } else { format!("{:.3}", x) }
        }
        // Two are the ends of a range.
        Value::Array(list) => {
            let between = if list.len() == 2 { " to " } else { ", " };
            list.iter().map(cell).collect::<Vec<_>>().join(between)
        }
        Value::Null => "-".to_owned(),
        other => other.to_string(),
    }
}
