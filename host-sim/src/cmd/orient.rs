//! `seabearing orient`: station orientation from a vessel of known track.

use super::mistake;
use crate::atomic;
use crate::csv::CsvTable;
use crate::geodesy::LocalFrame;
use crate::line::doubts::{at_limit, doubts};
use crate::line::known;
use crate::line::records as line_records;
use crate::ocean_bottom::lateness::Lateness;
use crate::ocean_bottom::mirrored::Horizontals;
use crate::ocean_bottom::place::{Displacement, SEARCH_M};
use crate::ocean_bottom::records::is_records;
use crate::ocean_bottom::survey::{Survey, Turn, survey};
use crate::orientation::known_vessel::{self, LineRecord, LineSearch};
use crate::orientation::{compact, mend, track_file};
use crate::propagation::Propagation;
use crate::record::finite;
use crate::recording::{self, Container};
use crate::station::Station;
use crate::toml_file::TomlFile;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_locate::network::known_track::TrackPoint;
use seabearing_locate::orient::geometry::{Doubts, Mended};
use seabearing_locate::orient::line::LineBearing;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Depth of a vessel's sound source where none is told, metres.
const SOURCE_DEPTH_M: f64 = 5.0;

/// Limits of η, and where every bearing has an elevation beside it: 3 % are what is left for the speed of sound and the spacing of sensors.
const ETA: (f64, f64) = (0.85, 1.05);
const ETA_BESIDE: (f64, f64) = (0.97, 1.03);

/// Arguments of `seabearing orient`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    seabearing orient --station line.toml --track ship.csv bearings.csv      # t_s,sin_bearing\n  \
    seabearing orient --station line.toml --track ship.csv records.jsonl     # of `process`\n  \
    seabearing orient --station array.toml --track ship.csv bearings.csv     # t_s,azimuth_deg,elevation_deg; or records\n  \
    seabearing orient --station array.toml --track ship.csv differences.csv  # t_s,tdoa01_s,...: hydrophone positions\n  \
    seabearing orient --geometry --station array.toml --track ship.csv --write mended.toml pass.wav  # and orientation\n  \
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
    #[arg(required = true, value_name = "INPUT", value_parser = super::input())]
    input: Vec<PathBuf>,
    /// Station file.
    #[arg(long, value_parser = super::input())]
    station: PathBuf,
    /// Track of a vessel: t_s,x_m,y_m or t_s,lat,lon; repeated for more vessels (ocean-bottom stations).
    #[arg(long, required = true, value_name = "TRACK.csv", value_parser = super::input())]
    track: Vec<PathBuf>,
    /// Depth of the vessel's sound source, metres [default: 5; with --geometry 0, from where vessel and image are heard together, if the
    /// station expects an image].
    #[arg(long)]
    source_depth_m: Option<f64>,
    /// Longest gap of the track that is interpolated, seconds.
    #[arg(long, default_value_t = 300.0)]
    max_gap_s: f64,
    /// Line, array: largest clock shift searched either way, seconds [default: the larger of six bearings and a tenth of the
    /// record].
    #[arg(long)]
    max_shift_s: Option<f64>,
    /// Line: do not prefer shifts of whole bearings where the data allow them.
    #[arg(long)]
    free_shift: bool,
    /// Line: limits of eta, the cosine of the sound's common elevation [default: 0.85 1.05; with records, whose bearings have elevations of
    /// their own, 0.97 1.03].
    #[arg(long, num_args = 2, value_names = ["LEAST", "GREATEST"])]
    eta: Option<Vec<f64>>,
    /// Line: how the orientation is found.
    #[arg(long, value_enum, default_value_t = Method::Fit)]
    method: Method,
    /// Ocean bottom: farthest the station is looked for from its nominal position, either way, metres.
    #[arg(long, default_value_t = SEARCH_M)]
    search_m: f64,
    /// Array: how many successive bearings share one error at least (1: independent); more where they show it.
    #[arg(long, default_value_t = 2.0)]
    correlated: f64,
    /// Array: positions of the hydrophones and orientation together, from a recording or from arrival-time differences of one pass;
    /// the positions may be off by the station file's `position_sd_m`, the speed of sound by its `sound_speed_sd_m_s`.
    #[arg(long)]
    geometry: bool,
    /// Geometry: station file to write, with what was found.
    #[arg(long, requires = "geometry", value_name = "STATION.toml")]
    write: Option<PathBuf>,
    /// Geometry: standard deviation of the whole track's place, East and North, metres.
    #[arg(long, default_value_t = 2.0)]
    track_sd_m: f64,
    /// Geometry: standard deviation of the depth of the sound source, metres.
    #[arg(long, default_value_t = 3.0)]
    source_depth_sd_m: f64,
    /// Array: standard deviation of the recorder's clock against the track's, seconds; 0: they agree.
    #[arg(long, default_value_t = 1.0)]
    clock_sd_s: f64,
    /// Results as JSON Lines.
    #[arg(long)]
    json: bool,
}

/// How a line array is oriented.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    /// Robust and continuous
    Fit,
    /// Paper L: shift by whole bearings, eta by 0.001
    ClosedForm,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    for (key, x) in [("max-gap-s", args.max_gap_s), ("max-shift-s", args.max_shift_s.unwrap_or(1.0))] {
        if !(x > 0.0 && x.is_finite()) {
            mistake!("--{key} is {x}; a positive number is needed");
        }
    }
    if !(args.source_depth_m.is_none_or(f64::is_finite)
        && args.correlated >= 1.0
        && args.correlated.is_finite())
    {
        mistake!("--source-depth-m must be finite and --correlated at least 1");
    }
    if !(args.search_m >= 100.0 && args.search_m <= 20_000.0) {
        mistake!("--search-m is {}; 100 to 20000 m are possible", args.search_m);
    }
    for (key, x) in [
        ("track-sd-m", args.track_sd_m),
        ("source-depth-sd-m", args.source_depth_sd_m),
        ("clock-sd-s", args.clock_sd_s),
    ] {
        if !(x >= 0.0 && x.is_finite()) {
            mistake!("--{key} is {x}; a number that is not negative is needed");
        }
    }
    for input in &args.input {
        let size = std::fs::metadata(input).map_or(1, |m| if m.is_file() { m.len() } else { 1 });
        if size == 0 {
            bail!(
                "{}: empty, there is no bearing in it: records of `seabearing process` of a pass that was heard, or a table with a header, are needed",
                input.display()
            );
        }
    }
    let read = Station::read(&args.station)?;
    let records = match &read.config.kind {
        _ if args.geometry => vec![mended(&args, &read)?],
        Kind::Obs(_) if !is_table(&args.input) => {
            let tracks = tracks(&args, &read.config)?;
            of_survey(&read, survey(&read, &args.input, &tracks, args.max_gap_s, args.search_m)?)?
        }
        _ => vec![from_table(&args, &read.config)?],
    };
    super::print_records(&records, args.json)
}

/// Whether the input is one table: no folder, no records and no recording.
fn is_table(input: &[PathBuf]) -> bool {
    let [one] = input else { return false };
    one.is_file() && !is_records(one) && Container::of(one).is_ok_and(|container| container.is_none())
}

/// The vessels' tracks.
fn tracks(args: &Args, station: &StationConfig) -> Result<Vec<Vec<TrackPoint>>> {
    let image = match &station.kind {
        Kind::Array(array) => args.geometry && array.vessel_depth_m > 0.0,
        _ => false,
    };
    let depth_m = args.source_depth_m.unwrap_or(if image { 0.0 } else { SOURCE_DEPTH_M });
    args.track.iter().map(|path| track_file::read(path, station, depth_m)).collect()
}

/// The compact array's geometry and orientation from one pass, and the station file of it where one is wanted.
fn mended(args: &Args, station: &Station) -> Result<Value> {
    let config = &station.config;
    let array = mend::doubted(config).with_context(|| args.station.display().to_string())?;
    let tracks = tracks(args, config)?;
    let [track] = &tracks[..] else { bail!("one --track goes with --geometry, {} were given", tracks.len()) };
    let sets = if is_table(&args.input) {
        let [input] = &args.input[..] else { bail!("one CSV file is needed") };
        mend::of_table(&CsvTable::read(input)?)?
    } else {
        let mut source = recording::open(&args.input, station, None)?;
        mend::of_recording(config, array, &mut *source)?
    };
    let doubts = Doubts {
        track_m: args.track_sd_m,
        height_m: args.source_depth_sd_m,
        clock_s: args.clock_sd_s,
        image_m2: if args.source_depth_m.is_none() { mend::image_m2(array) } else { 0.0 },
        ..Doubts::default()
    };
    let (found, off_track) = mend::mend(config, &sets, track, args.max_gap_s, &doubts)
        .with_context(|| args.input[0].display().to_string())?;
    if off_track > 0 {
        log::warn!("the track tells nothing of the times of {off_track} of {} sets of delays", sets.len());
    }
    if let Some(line) = mend::untold(&found) {
        log::warn!("{line}");
    }
    let contradicted = mend::contradicted(config, array, &found, &doubts);
    if !contradicted.is_empty() {
        log::warn!(
            "the pass contradicts what was said beforehand ({}): the deviations do not hold; correct it or give larger ones",
            contradicted.join("; ")
        );
    }
    if let Some(path) = &args.write {
        let text = mend::station_text(&TomlFile::read(&args.station, "station file")?, &found)?;
        atomic::write(path, text.as_bytes())?;
    }
    let sd_deg = found.sd_turn.map(|x| x / RAD_PER_DEG);
    Ok(json!({
        "type": "geometry", "hydrophones_m": found.level_m, "sd_m": found.sd_level_m, "position_sd_m": mend::largest_sd_m(&found),
        "orientation_deg": degrees(found.heading), "sd_deg": sd_deg[2], "matrix": found.matrix,
        "shape_m": found.position_m, "sd_shape_m": shape_sd(&found), "sd_turn_deg": sd_deg,
        "sd_mean_m": found.sd_m.0, "sd_largest_m": found.sd_m.1, "untold": found.untold,
        "sound_speed_m_s": found.sound_speed_m_s.0, "sd_sound_speed_m_s": found.sound_speed_m_s.1,
        "track_m": found.track_m.0, "sd_track_m": found.track_m.1,
        "time_shift_s": found.late_s.0, "sd_time_shift_s": found.late_s.1,
        "scale_s": found.scale_s, "correlated": found.correlated, "n": found.n, "wrong": found.wrong, "off_track": off_track,
        "consistent": contradicted.is_empty(),
    }))
}

/// Standard deviations of the coordinates of the shape, hydrophone by hydrophone.
fn shape_sd(found: &Mended) -> Vec<Vec<f64>> {
    let sd: Vec<f64> = (0..12).map(|k| found.covariance_m2[k][k].max(0.0).sqrt()).collect();
    sd.chunks(3).map(<[f64]>::to_vec).collect()
}

/// What a CSV file tells about a station.
fn from_table(args: &Args, station: &StationConfig) -> Result<Value> {
    let [input] = &args.input[..] else {
        bail!("one CSV file is needed, {} files were given", args.input.len())
    };
    let tracks = tracks(args, station)?;
    let [track] = &tracks[..] else { bail!("one --track goes with a CSV file, {} were given", tracks.len()) };
    let table = || CsvTable::read(input);
    match &station.kind {
        Kind::Line(_) => line(args, station, input, track),
        Kind::Array(_) if is_records(input) => {
            turned_record(station, &compact::of_file(station, input, track, &turn_search(args))?)
        }
        Kind::Array(_) => array(args, station, &table()?, track),
        Kind::Obs(o) => {
            let (found, off_track) = known_vessel::horizontals(station, &table()?, track, args.max_gap_s)?;
            Ok(json!({
                "type": "orientation",
                "orientation_deg": degrees(found.offset + o.orientation_of_north_deg * RAD_PER_DEG),
                "sd_deg": found.sd / RAD_PER_DEG, "mean_error_deg": found.scale / RAD_PER_DEG,
                "support": found.support, "n": found.n, "passes": found.passes, "off_track": off_track,
            }))
        }
    }
}

/// The compact array: how it leans, or where its hydrophones are.
fn array(args: &Args, station: &StationConfig, table: &CsvTable, track: &[TrackPoint]) -> Result<Value> {
    if table.has("tdoa01_s") {
        let (found, off_track) = known_vessel::positions(station, table, track, args.max_gap_s)?;
        return Ok(json!({
            "type": "hydrophones", "hydrophones_m": found.position_m, "sd_m": found.sd_m,
            "scale_s": found.scale_s, "n": found.n, "off_track": off_track,
        }));
    }
    turned_record(station, &compact::array(station, table, track, &turn_search(args))?)
}

/// What is searched of a compact array's turn.
fn turn_search(args: &Args) -> compact::Search {
    compact::Search {
        gap_s: args.max_gap_s,
        correlated: args.correlated,
        max_shift_s: args.max_shift_s,
        clock_sd_s: args.clock_sd_s,
    }
}

/// The record of a compact array's turn.
fn turned_record(station: &StationConfig, turned: &compact::Turned) -> Result<Value> {
    let found = &turned.rotation;
    if !turned.doubts.is_empty() {
        log::warn!("the deviations of the orientation do not hold: {}", turned.doubts.join(" "));
    }
    Ok(json!({
        "type": "orientation",
        "orientation_deg": degrees(found.heading + station.orientation_deg * RAD_PER_DEG),
        "sd_deg": found.sd[0] / RAD_PER_DEG,
        "pitch_deg": found.pitch / RAD_PER_DEG, "sd_pitch_deg": found.sd[1] / RAD_PER_DEG,
        "roll_deg": found.roll / RAD_PER_DEG, "sd_roll_deg": found.sd[2] / RAD_PER_DEG,
        "time_shift_s": turned.shift_s.0, "sd_time_shift_s": turned.shift_s.1, "correlated": turned.correlated,
        "mean_error_deg": found.median_error / RAD_PER_DEG, "n": found.n, "off_track": turned.off_track,
        "matrix": found.matrix, "consistent": turned.doubts.is_empty(),
    }))
}

/// The line array: orientation, clock shift and η.
fn line(args: &Args, station: &StationConfig, input: &Path, track: &[TrackPoint]) -> Result<Value> {
    // A table's bearings belong to the track's own times and have one elevation, η.
    let level: Vec<TrackPoint> = track
        .iter()
        .map(|p| TrackPoint { position_m: [p.position_m[0], p.position_m[1], 0.0], ..*p })
        .collect();
    let up_m = (station.depth_m > 0.0).then(|| track.first().map_or(0.0, |p| p.position_m[2]));
    let name = input.display().to_string();
    let steps = if is_records(input) { line_records::read(input)? } else { Vec::new() };
    let usual = if steps.is_empty() { ETA } else { ETA_BESIDE };
    let search = LineSearch {
        max_shift_s: args.max_shift_s,
        free_shift: args.free_shift,
        eta: args.eta.as_deref().and_then(|eta| Some((*eta.first()?, *eta.get(1)?))).unwrap_or(usual),
        gap_s: args.max_gap_s,
    };
    let several = steps.iter().any(|s| s.sines.len() > 1);
    let read = if steps.is_empty() {
        LineRecord::of(&CsvTable::read(input)?, &search)?
    } else {
        let strongest = |s: &line_records::Step| Some(LineBearing { t_s: s.t_s, sine: *s.sines.first()? });
        LineRecord::of_bearings(steps.iter().filter_map(strongest).collect(), &search, name.clone())
    };
    Ok(match args.method {
        Method::ClosedForm if several => bail!(
            "{name}: several sources at once: --method fit chooses the one of the known track, the closed form does not"
        ),
        Method::Fit => {
            let by = |track: &[TrackPoint]| {
                if several { known::fit(&steps, track, &search, &name) } else { read.fit(track) }
            };
            let fit = if steps.is_empty() {
                by(&level)?
            } else {
                known::heard(&level, up_m, station.sound_speed_m_s, by)?
            };
            known::check(&fit, &name)?;
            if fit.off_track > 0 {
                log::warn!(
                    "the track tells nothing of the times of {} of {} bearings",
                    fit.off_track,
                    fit.n + fit.wrong + fit.off_track
                );
            }
            let doubts = doubts(&fit, search.eta);
            if !doubts.is_empty() {
                log::warn!("the deviations of the orientation do not hold: {}", doubts.join(" "));
            }
            // Where it is held at an end nothing is known of how far off it is.
            let sd_eta = (!at_limit(&fit, search.eta)).then_some(fit.sd_eta);
            json!({
                "type": "orientation", "orientation_deg": degrees(fit.orientation), "sd_deg": fit.sd / RAD_PER_DEG,
                "time_shift_s": fit.time_shift_s, "eta": fit.eta, "mean_error_deg": fit.mean_error / RAD_PER_DEG,
                "n": fit.n, "sd_time_shift_s": fit.sd_time_shift_s, "sd_eta": sd_eta, "wrong": fit.wrong,
                "off_track": fit.off_track, "consistent": doubts.is_empty(),
            })
        }
        Method::ClosedForm => {
            let heard = track_file::as_heard(track, up_m.unwrap_or(0.0), station.sound_speed_m_s);
            let (found, sd) = read.closed_form(if steps.is_empty() { &level } else { &heard })?;
            json!({
                "type": "orientation", "orientation_deg": degrees(found.orientation),
                "sd_deg": sd.map(|sd| sd / RAD_PER_DEG),
                "time_shift_s": found.time_shift_s, "eta": found.eta,
                "mean_error_deg": found.mean_error / RAD_PER_DEG, "n": found.n,
            })
        }
    })
}

/// The records of orientation and position; why one of them is not observed, and what is wrong with the components, goes to standard error.
fn of_survey(station: &Station, found: Survey) -> Result<Vec<Value>> {
    let mut out = Vec::new();
    match &found.turn {
        Ok(turn) => out.push(turn_record(station, turn)),
        Err(reason) => log::warn!("{reason}"),
    }
    // An orientation that is off is what the record of it says.
    if let Some(doubt) = found.doubt.filter(|doubt| !matches!(doubt, Horizontals::Turned(_))) {
        log::warn!("{}", doubt.text());
    }
    match (&found.position, &found.turn) {
        (Ok(offset), _) => {
            if let Some(late) = offset.lateness.filter(Lateness::is_wrong) {
                log::warn!(
                    "{}: the position and the orientation are off by what vessels go meanwhile, which their deviations do not say",
                    late.text()
                );
            }
            out.push(position_record(&station.config, offset, &found.table));
        }
        (Err(reason), Ok(_)) => log::warn!("{reason}"),
        (Err(reason), Err(turn)) => bail!("{turn}; {reason}"),
    }
    Ok(out)
}

fn turn_record(station: &Station, turn: &Turn) -> Value {
    let configured_deg = match &station.config.kind {
        Kind::Obs(o) => o.orientation_of_north_deg,
        _ => 0.0,
    };
    let mut record = json!({
        "type": "orientation", "orientation_deg": degrees(turn.correction + configured_deg * RAD_PER_DEG),
        "sd_deg": finite(turn.sd / RAD_PER_DEG), "n": turn.n, "passes": turn.passages,
    });
    if let Some((scale, support)) = turn.quality {
        record["mean_error_deg"] = json!(scale / RAD_PER_DEG);
        record["support"] = json!(support);
    }
    record
}

fn position_record(config: &StationConfig, offset: &Displacement, table: &Propagation) -> Value {
    let (sd_x_m, sd_y_m) = offset.sd_m();
    let (east, north) = config.local_east_north_m.unwrap_or((0.0, 0.0));
    let mut record = json!({
        "type": "position", "x_m": east + offset.east_m, "y_m": north + offset.north_m, "sd_x_m": sd_x_m, "sd_y_m": sd_y_m,
        "cov_xy_m2": offset.cov_m2[2], "moved_east_m": offset.east_m, "moved_north_m": offset.north_m,
        "n": offset.n, "passes": offset.passages, "table": table.name,
        "time_shift_s": offset.lateness.map(|l| l.late_s), "sd_time_shift_s": offset.lateness.map(|l| l.sd_s),
        "consistent": !offset.lateness.is_some_and(|l| l.is_wrong()),
    });
    if let Some((lat, lon)) = config.lat_lon_deg {
        let (lat, lon) = LocalFrame::new(lat, lon).lat_lon_deg(offset.east_m, offset.north_m);
        record["lat_deg"] = json!(lat);
        record["lon_deg"] = json!(lon);
    }
    record
}

/// Degrees in (−180, 180].
fn degrees(angle: f64) -> f64 {
    wrap_pi(angle) / RAD_PER_DEG
}
