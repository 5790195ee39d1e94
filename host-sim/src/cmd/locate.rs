//! `seabearing locate`: positions from a network of arrays; a vessel's motion and the shift of its antenna.

use super::mistake;
use crate::ocean_bottom::records::is_records;
use crate::orientation::lasting::{self, Positions};
use crate::orientation::network_file::{Network, NetworkBearings, read_rows};
use crate::orientation::over_time::{self, SOURCE_DEPTH_M, heard_by};
use crate::orientation::record_file;
use crate::orientation::sets::{SightingSet, gather};
use crate::orientation::unchecked;
use crate::orientation::way::Way;
use crate::record::RecordFormat;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_locate::network::joint::{JointTrack, Wrong};
use seabearing_locate::network::{Fix, FixSettings, Region};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Half-width of the search region, metres: about compact arrays, and about stations at the ocean bottom.
const NEAR_M: f64 = 2_000.0;
/// The same of stations at the ocean bottom.
const FAR_M: f64 = 60_000.0;

/// Share of the positions in which a station is set aside that is told, and how many are few: by chance it is one in a thousand.
const OFTEN: f64 = 0.03;
const FEW: usize = 2;

/// Scatter of bearings about a straight course, over the claimed one, from which on it is told.
const SCATTERED: f64 = 2.0;

/// Depths at which there is a source, metres: from a mast above the surface to the deepest trench (10 935 m, Challenger Deep).
const DEPTHS_M: std::ops::RangeInclusive<f64> = -100.0..=11_000.0;

/// Arguments of `seabearing locate`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    seabearing locate --stations network.toml --depth-m 5 bearings.csv              # a position an instant\n  \
    seabearing locate --stations network.toml --depth-m 5 --motion bearings.csv     # one straight track\n  \
    seabearing locate --stations network.toml --known-track gps.csv bearings.csv    # antenna to sound source\n  \
    seabearing locate --stations network.toml east.jsonl west.jsonl                 # records of the recorders\n  \
    seabearing locate --stations network.toml --motion --sigma-azimuth-deg 0.3 obs1.jsonl obs2.jsonl   # ocean bottom\n\n\
    BEARINGS.csv has the header t_s,station,azimuth_deg,elevation_deg; station is an id or a name of the stations \
    file, azimuths are true (clockwise from North), an empty elevation means none was measured. Rows within 1 s of \
    each other are one measurement set. Records carry their own errors and, where the recordings had a clock, their \
    UTC; their bearings of the whole band are used (of one vessel at a time). Of ocean-bottom stations these are the detected \
    tonal azimuths, with the range of the same minute where there is one. A set that does not determine a position gives a `no_fix` record with the \
    reason. A position is where the vessel was when the sound left it (t_source_s, utc_source), not when it was heard (t_s, utc): \
    tens of seconds before at ocean-bottom ranges. --motion takes all rows for one vessel on a straight course and needs no speed; it prints a `track` \
    record for each station (x0, y0: at the first bearing's time, in the frame of the network).")]
pub struct Args {
    /// Bearings: one CSV file t_s,station,azimuth_deg,elevation_deg, or records of `process` or `base` (.jsonl).
    #[arg(required = true, value_parser = super::input())]
    bearings: Vec<PathBuf>,
    /// Network file: a list of `[[stations]]`.
    #[arg(long, value_parser = super::input())]
    stations: PathBuf,
    /// Standard deviation of azimuths, degrees (joined to what records claim: geometry, multipath).
    #[arg(long, default_value_t = 1.5)]
    sigma_azimuth_deg: f64,
    /// Standard deviation of elevations, degrees (likewise).
    #[arg(long, default_value_t = 1.6)]
    sigma_elevation_deg: f64,
    /// Depth of the source, where known, metres.
    #[arg(long)]
    depth_m: Option<f64>,
    /// Half-width of the search region about the network, metres [default: 2000; with records of ocean-bottom stations 60000].
    #[arg(long)]
    max_range_m: Option<f64>,
    /// Azimuths are relative to each array's own North: add its orientation_deg.
    #[arg(long)]
    relative: bool,
    /// Use every array even where one contradicts the others.
    #[arg(long)]
    keep_outliers: bool,
    /// One straight motion from all bearings of all arrays instead of positions.
    #[arg(long)]
    motion: bool,
    /// Interval over which successive bearings of an array share one error, seconds (with --motion).
    #[arg(long, default_value_t = 0.0)]
    tau_s: f64,
    /// Known track of the vessel, t_s,x_m,y_m or t_s,lat,lon: how far the sound source is behind the antenna.
    #[arg(long, value_name = "TRACK.csv", conflicts_with = "motion", value_parser = super::input())]
    known_track: Option<PathBuf>,
    /// Largest such shift considered either way, seconds.
    #[arg(long, default_value_t = 60.0)]
    max_shift_s: f64,
    /// Results as JSON Lines.
    #[arg(long)]
    json: bool,
}

impl Args {
    /// The files, as a person named them.
    fn name(&self) -> String {
        self.bearings.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ")
    }
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    for (key, x) in [
        ("sigma-azimuth-deg", args.sigma_azimuth_deg),
        ("sigma-elevation-deg", args.sigma_elevation_deg),
        ("max-range-m", args.max_range_m.unwrap_or(NEAR_M)),
        ("max-shift-s", args.max_shift_s),
    ] {
        if !(x > 0.0 && x.is_finite()) {
            mistake!("--{key} is {x}; a positive number is needed");
        }
    }
    if !(args.tau_s >= 0.0 && args.tau_s.is_finite()) {
        mistake!("--tau-s is {}; zero or a positive number is needed", args.tau_s);
    }
    if let Some(d) = args.depth_m
        && !DEPTHS_M.contains(&d)
    {
        mistake!("--depth-m is {d}; a depth is between {} and {} m", DEPTHS_M.start(), DEPTHS_M.end());
    }
    let network = Network::read(&args.stations)?;
    let sd = (args.sigma_azimuth_deg * RAD_PER_DEG, args.sigma_elevation_deg * RAD_PER_DEG);
    let mut heard = match args.bearings.as_slice() {
        files if files.iter().all(|path| is_records(path)) => {
            record_file::read(files, &network, sd, args.relative)?
        }
        [table] => {
            let rows = read_rows(table, &network, sd, args.relative)?;
            NetworkBearings { rows, ..NetworkBearings::default() }
        }
        _ => bail!("{}: one CSV file, or records (.jsonl) of any number of stations", args.name()),
    };
    let (unordered, again) = heard.once();
    if unordered {
        log::warn!("{}: rows are not in order of time; sorted", args.name());
    }
    if again > 0 {
        log::warn!("{}: {again} bearings stand there more than once; each counts once", args.name());
    }
    let records = if args.motion {
        motion(&args, &network, &mut heard)?
    } else if let Some(track) = &args.known_track {
        alignment(&args, &network, &heard, track)?
    } else {
        return positions(&args, &network, &mut heard);
    };
    super::print_records(&records, args.json)
}

/// One straight motion from all rows: a `track` record for each station that was heard.
fn motion(args: &Args, network: &Network, heard: &mut NetworkBearings) -> Result<Vec<Value>> {
    let depth_m = args.depth_m.unwrap_or(SOURCE_DEPTH_M);
    let found = over_time::motion(network, heard, args.tau_s, depth_m, !args.keep_outliers)
        .with_context(|| args.name())?;
    let rows = &heard.rows;
    warn_of(network, &found);
    let (speed, sd_speed) = found.speed_m_s();
    let (heading, sd_heading) = found.heading();
    let t0_s = rows[0].t_s;
    let [x0, y0] = found.position_m(t0_s);
    let clock = RecordFormat { rate_hz: 1.0, start: heard.start, times: Default::default() };
    let rejected = found.rejected.map(|i| network.stations[i].id);
    let record = |i: usize| {
        let [x, y, _] = network.arrays_m[i];
        let Some(cpa) = found.closest([x, y]) else { bail!("{}: the vessel does not move", args.name()) };
        let mut record = json!({
            "type": "track", "station": network.stations[i].id, "t_s": t0_s,
            "cpa_time_s": cpa.t_s.0, "cpa_range_m": cpa.range_m.0, "heading_deg": heading / RAD_PER_DEG,
            "speed_m_s": speed, "side": if cpa.to_starboard { "starboard" } else { "port" },
            "sd_cpa_time_s": cpa.t_s.1, "sd_cpa_range_m": cpa.range_m.1,
            "sd_heading_deg": sd_heading / RAD_PER_DEG, "sd_speed_m_s": sd_speed, "range_observable": true,
            "x0_m": x0, "y0_m": y0, "n": rows.len(), "misfit": found.misfit, "freedom": found.freedom,
            "consistent": found.consistent, "growth": found.growth.sqrt(),
        });
        for (key, t_s) in [("utc", t0_s), ("utc_cpa", cpa.t_s.0)] {
            if let Some(utc) = clock.utc(t_s) {
                record[key] = utc.into();
            }
        }
        if found.rejected != Some(i) {
            let offset = found.offsets[i];
            for (key, angle) in [("turned_deg", offset.azimuth.0), ("sd_turned_deg", offset.azimuth.1)] {
                record[key] = (angle / RAD_PER_DEG).into();
            }
            record["late_s"] = offset.clock_s.0.into();
            record["sd_late_s"] = offset.clock_s.1.into();
            record["scatter"] = found.scatter[i].to_vec().into();
        }
        let Wrong { orientation, clock } = found.wrong;
        match (orientation == Some(i), clock == Some(i)) {
            (true, true) => record["wrong"] = "orientation and clock".into(),
            (true, false) => record["wrong"] = "orientation".into(),
            (false, true) => record["wrong"] = "clock".into(),
            (false, false) => {}
        }
        if let Some(id) = rejected {
            record["rejected"] = id.into();
        }
        Ok(record)
    };
    heard_by(network, rows).into_iter().map(record).collect()
}

/// Says in a line what a motion found wrong.
fn warn_of(network: &Network, found: &JointTrack) {
    let name = |k: usize| network.stations[k].name.as_str();
    if let Some(k) = found.wrong.orientation {
        let (turned, sd) = found.offsets[k].azimuth;
        log::warn!(
            "the azimuths of `{}` are {:.2}° ± {:.2}° too large, more than its orientation_sd_deg allows: is its \
             orientation_deg right, and is it the same vessel?",
            name(k),
            turned / RAD_PER_DEG,
            sd / RAD_PER_DEG
        );
    }
    if let Some(k) = found.wrong.clock {
        let (late_s, sd_s) = found.offsets[k].clock_s;
        log::warn!(
            "the clock of `{}` is {late_s:.2} s ± {sd_s:.2} s late against that of `{}`, more than their clock_sd_s allow",
            name(k),
            name(found.clock_of)
        );
    }
    if let Some(k) = found.rejected {
        log::warn!(
            "`{}` contradicts the others, which agree, and is set aside: does it hear another vessel, or is its place, orientation or \
             clock wrong?",
            name(k)
        );
    }
    if found.bent {
        log::warn!(
            "the bearings are off a straight course for long stretches, at all stations together far beyond their scatter: does the \
             vessel turn or change its speed, or are two heard? One course and speed do not tell its way, whatever is stated of them; give a \
             part of the record, or --known-track"
        );
    } else if !found.consistent {
        log::warn!(
            "the stations contradict each other by more than their bearings scatter and their orientations and clocks are \
             said to err, and which of them is wrong cannot be told: the stated errors have grown"
        );
    } else {
        warn_of_scatter(network, found);
    }
}

/// Says of the station whose bearings are worst that they scatter far more than claimed, if so.
fn warn_of_scatter(network: &Network, found: &JointTrack) {
    let stations = network.stations.iter().zip(&found.scatter);
    let worst =
        stations.map(|(s, of)| (s.name.as_str(), of[0].max(of[1]))).max_by(|a, b| a.1.total_cmp(&b.1));
    if let Some((name, times)) = worst.filter(|(_, times)| *times > SCATTERED) {
        log::warn!(
            "the bearings of `{name}` are off a straight course by {times:.1} times what --sigma-azimuth-deg and --sigma-elevation-deg say, \
             what successive ones have in common counted: the stated errors have grown. Do errors last (--tau-s), or are two vessels heard?"
        );
    }
}

/// How late the heard vessel is behind its known track: an `alignment` record for each station that was heard.
fn alignment(args: &Args, network: &Network, heard: &NetworkBearings, track: &Path) -> Result<Vec<Value>> {
    let rows = &heard.rows;
    let depth_m = args.depth_m.unwrap_or(SOURCE_DEPTH_M);
    let sd = [args.sigma_azimuth_deg * RAD_PER_DEG, args.sigma_elevation_deg * RAD_PER_DEG];
    let record = |i: usize| {
        let id = network.stations[i].id;
        Ok(match over_time::shift(network, i, rows, track, depth_m, sd, args.max_shift_s)? {
            Ok(s) => json!({
                "type": "alignment", "station": id, "shift_s": s.shift_s, "sd_s": s.sd_s, "n": s.n,
            }),
            Err(e) => json!({ "type": "no_alignment", "station": id, "reason": e.to_string() }),
        })
    };
    heard_by(network, rows).into_iter().map(record).collect()
}

/// A fix, or a reason, for every measurement set.
fn positions(args: &Args, network: &Network, heard: &mut NetworkBearings) -> Result<()> {
    let sets = gather(&mut heard.rows, &network.arrays_m);
    let clock = RecordFormat { rate_hz: 1.0, start: heard.start, times: Default::default() };
    let settings = FixSettings { region: region(network, heard, args)?, robust: !args.keep_outliers };

    let shared = network.shared(&heard.sd_clock_s);
    let said = network.said(&heard.sd_clock_s);
    let way = Way { sound_m_s: network.stations[0].sound_speed_m_s, thrice: heard.of_the_floor };
    let found = lasting::positions(&sets, &settings, &shared, &said, way);
    warn_of_lasting(network, &found);
    if !found.checked {
        log::warn!("{}", unchecked::of_positions());
    }
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    if !args.json {
        writeln!(
            out,
            "{:>12} {:>12} {:>9} {:>9} {:>8} {:>7} {:>7} {:>7}  stations",
            "t_s", "t_source_s", "x_m", "y_m", "z_m", "sd_x", "sd_y", "sd_z"
        )?;
    }
    for ((set, fix), given) in found.sets.iter().zip(&found.fixes).zip(&sets) {
        match (fix, args.json) {
            (Ok(fix), true) => {
                let mut record = record(network, set, fix, given, &way);
                record["checked"] = found.checked.into();
                writeln!(out, "{}", dated(record, &clock))?;
            }
            (Ok(fix), false) => writeln!(out, "{}", line(network, set, fix, given, &way))?,
            (Err(e), true) => {
                let record = json!({
                    "type": "no_fix", "t_s": set.t_s, "reason": e.to_string(), "stations": ids(network, set, None),
                });
                writeln!(out, "{}", dated(record, &clock))?;
            }
            (Err(e), false) => writeln!(out, "{:12.3} no fix: {e}", set.t_s)?,
        }
    }
    out.flush()?;
    Ok(())
}

/// Says what of the stations lasts that should not, and that the bearings scatter more than claimed.
fn warn_of_lasting(network: &Network, found: &Positions) {
    const BEYOND: &str = "more than the network file allows: it is taken out of the positions, and the stated errors have grown";
    const USUAL: &str = "of which the network file says nothing, or elevations or the depth are off, which looks the same: the stated errors \
         hold it (`orientation_sd_deg` and `clock_sd_s` in the network file, or --motion, take it out)";
    const WITHIN: &str = "within what the network file allows: it is taken out of the positions";
    let all = match &found.contradicted {
        Some(contradicted) => vec![(contradicted, BEYOND)],
        None => vec![(&found.untold, USUAL), (&found.within, WITHIN)],
    };
    let of_all =
        all.iter().flat_map(|(lasting, end)| network.stations.iter().zip(*lasting).map(|of| (of, *end)));
    for ((station, of), end) in of_all {
        let (name, (turned, late_s)) = (&station.name, (of.azimuth, of.clock_s));
        if of.beyond.0 {
            let [off, sd] = [turned.0, turned.1].map(|x| x / RAD_PER_DEG);
            log::warn!("the azimuths of `{name}` are {off:.2}° ± {sd:.2}° too large, {end}");
        }
        if of.beyond.1 {
            let of = found.clock_of.and_then(|k| network.stations.get(k)).map_or("the others", |of| &of.name);
            log::warn!(
                "the clock of `{name}` is {:.2} s ± {:.2} s late against that of `{of}`, {end}",
                late_s.0,
                late_s.1
            );
        }
    }
    if let Some(contradicted) = &found.contradicted
        && contradicted.iter().all(|of| of.beyond == (false, false))
    {
        log::warn!(
            "the stations contradict each other all the time: orientations or clocks are wrong by more than the network file \
             allows (--motion tells which), and the stated errors have grown"
        );
    }
    for (k, (station, (of, n))) in network.stations.iter().zip(found.aside).enumerate() {
        if n > FEW && n as f64 > OFTEN * of as f64 {
            let end = if found.left_out == Some(k) { "left out of all" } else { "set aside there" };
            log::warn!(
                "`{}` contradicts the others in {n} of {of} positions and is {end}: does it hear another vessel, or is its place, \
                 orientation or clock wrong?",
                station.name
            );
        }
    }
    if let Some(scatter) = found.scatter {
        log::warn!(
            "the bearings are off the positions by {:.1} times what --sigma-azimuth-deg and --sigma-elevation-deg say: the stated \
             errors have grown",
            scatter.sqrt()
        );
    }
}

fn region(network: &Network, heard: &NetworkBearings, args: &Args) -> Result<Region> {
    let max_range_m = args.max_range_m.unwrap_or(if heard.of_the_floor { FAR_M } else { NEAR_M });
    // What ocean-bottom stations hear are vessels.
    let depth_m = args.depth_m.or(heard.of_the_floor.then_some(SOURCE_DEPTH_M));
    let n = network.arrays_m.len() as f64;
    let centre = [0, 1].map(|k| network.arrays_m.iter().map(|a| a[k]).sum::<f64>() / n);
    if let Some(depth) = depth_m {
        return Ok(Region::at_depth(centre, max_range_m, -depth));
    }
    let deepest = network.arrays_m.iter().map(|a| a[2]).fold(f64::INFINITY, f64::min);
    if deepest >= 0.0 {
        bail!("the stations have no depth, so the water column is unknown: give --depth-m of the source");
    }
    Ok(Region::between(centre, max_range_m, (deepest, 0.0)))
}

fn ids(network: &Network, set: &SightingSet, without: Option<usize>) -> Vec<u16> {
    set.stations
        .iter()
        .enumerate()
        .filter(|(i, _)| Some(*i) != without)
        .map(|(_, s)| network.stations[*s].id)
        .collect()
}

/// The record with its UTC, where the recordings had a clock.
fn dated(mut record: Value, clock: &RecordFormat) -> Value {
    for (key, of) in [("utc", "t_s"), ("utc_source", "t_source_s")] {
        if let Some(utc) = record[of].as_f64().and_then(|t_s| clock.utc(t_s)) {
            record[key] = utc.into();
        }
    }
    record
}

/// When the vessel was at the place of a fix, seconds.
fn source_s(set: &SightingSet, fix: &Fix, way: &Way) -> f64 {
    set.t_s - way.mean_s(set, &fix.position_m)
}

/// The number of the station that was set aside at an instant, or left out of all; `given`: what was heard.
fn rejected(network: &Network, set: &SightingSet, fix: &Fix, given: &SightingSet) -> Option<u16> {
    let left_out = || given.stations.iter().find(|k| !set.stations.contains(k)).copied();
    let station = fix.rejected.map(|i| set.stations[i]).or_else(left_out);
    station.map(|k| network.stations[k].id)
}

fn record(network: &Network, set: &SightingSet, fix: &Fix, given: &SightingSet, way: &Way) -> Value {
    let [x, y, z] = fix.position_m;
    let c = &fix.covariance_m2;
    let mut record = json!({
        "type": "fix", "t_s": set.t_s, "t_source_s": source_s(set, fix, way), "x_m": x, "y_m": y, "z_m": z,
        "sd_x_m": c[0][0].sqrt(), "sd_y_m": c[1][1].sqrt(), "sd_z_m": c[2][2].sqrt(), "cov_xy_m2": c[0][1],
        "stations": ids(network, set, fix.rejected), "misfit": fix.misfit, "freedom": fix.freedom,
        "consistent": fix.consistent, "height_at_limit": fix.height_at_limit,
    });
    if let Some(frame) = &network.frame {
        let (lat, lon) = frame.lat_lon_deg(x, y);
        record["lat_deg"] = lat.into();
        record["lon_deg"] = lon.into();
    }
    if let Some(id) = rejected(network, set, fix, given) {
        record["rejected"] = id.into();
    }
    record
}

fn line(network: &Network, set: &SightingSet, fix: &Fix, given: &SightingSet, way: &Way) -> String {
    let [x, y, z] = fix.position_m;
    let sd = [0, 1, 2].map(|k| fix.covariance_m2[k][k].sqrt());
    let ids: Vec<_> = ids(network, set, fix.rejected).iter().map(u16::to_string).collect();
    let remark = match (rejected(network, set, fix, given), fix.consistent) {
        (Some(id), _) => format!(" (set aside: {id})"),
        (None, false) => " (arrays disagree; errors enlarged)".to_owned(),
        (None, true) => String::new(),
    };
    format!(
        "{:12.3} {:12.3} {x:9.1} {y:9.1} {z:8.1} {:7.1} {:7.1} {:7.1}  {}{remark}",
        set.t_s,
        source_s(set, fix, way),
        sd[0],
        sd[1],
        sd[2],
        ids.join(" ")
    )
}
