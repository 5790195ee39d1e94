//! `reproduce real-ship-ee`: bearings of a real ship from arrival-time differences measured at sea, against its GPS.
//!
//! Data: a four-hydrophone recorder on the sea floor, 4669 unedited sets of differences in 10 µs steps with their wrong
//! peaks, and the ship's GPS. The hydrophones' places were fitted by others to such data: told as known to a centimetre. They stand beside the project, not in it; without them the experiment says so and ends.

use super::{Experiment, Options};
use crate::angle::{azimuth_deg, turn_deg};
use crate::csv::{CsvTable, CsvText, Fixed};
use crate::delays::{COLUMNS, SetResult, Solved, check_above, solve};
use crate::geodesy::LocalFrame;
use crate::plot::{Plot, Scale, write_panels};
use crate::station::Station;
use anyhow::{Context, Result};
use seabearing_core::kit::median;
use seabearing_locate::between::{between, mixed};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "real-ship-ee",
    about: "a real ship: bearings from measured time differences against GPS, rejected sets marked",
    run,
};

/// A GPS fix further away in time than this says nothing about a set, s.
const GPS_MOST_S: f64 = 5.0;
/// Time before and after a set over which the ship's course is taken, s, and the slowest ship that has one, m/s.
const COURSE_S: f64 = 5.0;
const SLOWEST_M_S: f64 = 0.5;

/// Where the data are.
pub const DATA: &str = "real/harp4_ship_tdoa_EE";

/// The recordings brought into the project's own form.
pub struct ShipRecording {
    /// The station file.
    pub station: Station,
    /// Path of the differences in the project's sign and pair order.
    pub tdoa: PathBuf,
    /// Direction to the ship by GPS at a time: East, North, Up, length one.
    truth: Vec<(f64, [f64; 3])>,
    /// Height of the surface above the recorder, metres.
    height_m: f64,
}

/// Error of one set.
#[derive(Debug, Clone, Copy)]
pub struct Judged {
    /// Result of the set.
    pub result: SetResult,
    /// Azimuth and elevation by GPS, degrees.
    pub truth_deg: (f64, f64),
    /// Angle in space between the bearing and the GPS direction, degrees.
    pub error_deg: f64,
}

/// The figures the issue asks for.
#[derive(Debug, Clone, Copy)]
pub struct BearingScore {
    /// Sets with a GPS fix.
    pub sets: usize,
    /// Share of them accepted.
    pub kept: f64,
    /// Median error of the accepted ones, degrees.
    pub median_deg: f64,
    /// Share of the accepted ones that err by more than 10°.
    pub beyond_10_deg: f64,
    /// Share of the accepted ones whose error lies within the stated 95 % ellipse.
    pub in_ellipse: f64,
}

impl ShipRecording {
    /// Converts the data: writes `ee.toml` and `ee_tdoa.csv` (opposite sign, hydrophones from 0) into `folder`.
    ///
    /// # Errors
    /// A file is missing or not as its description says.
    pub fn convert(data: &Path, folder: &Path) -> Result<Self> {
        let geometry: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(data.join("geometry.json"))?)?;
        let numbers = |v: &serde_json::Value| -> Result<Vec<f64>> {
            v.as_array().context("a list")?.iter().map(|x| x.as_f64().context("a number")).collect()
        };
        let receiver = numbers(&geometry["receiver_lat_lon_depth_m"])?;
        let c = geometry["c_m_s"].as_f64().context("sound speed")?;
        let mut toml = format!(
            "[station]\nid = 63\nname = \"EE\"\nkind = \"array\"\nsound_speed_m_s = {c:?}\nposition = {{ lat_deg = {:?}, \
             lon_deg = {:?}, depth_m = {:?} }}\n[sampling]\nrate_hz = 100000\n[array]\nreference_range_m = {:?}\n\
             hydrophones_m = [",
            receiver[0], receiver[1], -receiver[2], -receiver[2]
        );
        for h in geometry["hyd_pos_m_xEast_yNorth_zUp"].as_array().context("positions")? {
            write!(toml, "{:?}, ", numbers(h)?)?;
        }
        toml.push_str("]\nband_hz = [100, 10000]\nposition_sd_m = 0.01\n");
        let path = folder.join("ee.toml");
        std::fs::write(&path, toml)?;
        let station = Station::read(&path)?;

        let table = CsvTable::read(&data.join("tdoa.csv"))?;
        let columns = ["matlab_days", "tdoa12_s", "tdoa13_s", "tdoa14_s", "tdoa23_s", "tdoa24_s", "tdoa34_s"];
        let rows: Vec<[f64; 7]> =
            table.numbers(columns)?.into_iter().filter_map(|(_, row)| row.ok()).collect();
        let start = rows.first().context("no sets")?[0];
        let seconds = |days: f64| (days - start) * 86_400.0;
        let mut text = CsvText::new(&COLUMNS.join(","));
        for [days, delays @ ..] in &rows {
            let [a, b, c, d, e, f] = delays.map(|d| Fixed(-d, 7));
            text.row(&[&Fixed(seconds(*days), 4), &a, &b, &c, &d, &e, &f]);
        }
        let tdoa = folder.join("ee_tdoa.csv");
        std::fs::write(&tdoa, text.finish())?;

        let gps = CsvTable::read(&data.join("ship_gps.csv"))?;
        let frame = LocalFrame::new(receiver[0], receiver[1]);
        let mut truth = Vec::new();
        for (_, row) in gps.numbers(["matlab_days", "lat_deg", "lon_deg"])? {
            let [days, lat, lon] = row?;
            let (east, north) = frame.east_north_m(lat, lon);
            let v = [east, north, -receiver[2]];
            let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            truth.push((seconds(days), v.map(|x| x / length)));
        }
        Ok(Self { station, tdoa, truth, height_m: -receiver[2] })
    }

    /// What the command's own function makes of the sets.
    ///
    /// # Errors
    /// As the command.
    pub fn solved(&self) -> Result<Solved> {
        solve(&self.station.config, &self.tdoa, None)
    }

    /// Runs the command's own function over the sets and compares with GPS.
    ///
    /// # Errors
    /// As the command.
    pub fn judge(&self) -> Result<Vec<Judged>> {
        let Solved { sets, .. } = self.solved()?;
        check_above(&sets)?;
        Ok(sets.into_iter().filter_map(|r| self.judged(r)).collect())
    }

    /// Errors of the accepted ones of judged sets against GPS where the ship was when the sound left it, degrees, and how far behind the GPS
    /// antenna along its course their bearings meet the surface, metres; what sounds is not where the antenna is.
    fn behind(&self, judged: &[Judged]) -> (Vec<f64>, Vec<f64>) {
        let c = self.station.config.sound_speed_m_s;
        // The surface is level over so short a way.
        let at = |u: &[f64; 3]| [0, 1].map(|k: usize| u[k] * self.height_m / u[2]);
        let (mut errors, mut behind) = (Vec::new(), Vec::new());
        for j in judged {
            let Some(s) = j.result.solution.filter(|s| s.accepted) else { continue };
            let t_s = j.result.t_s;
            let Some(now) = self.truth_at(t_s) else { continue };
            let travel_s = self.height_m / now[2] / c;
            let u = s.direction.map(f64::from);
            if let Some(left) = self.truth_at(t_s - travel_s) {
                errors.push(between_deg(&left, &u));
            }
            let course = (self.truth_at(t_s - travel_s - COURSE_S), self.truth_at(t_s - travel_s + COURSE_S));
            if let ((Some(before), Some(after)), Some(left)) = (course, self.truth_at(t_s - travel_s)) {
                let (before, after, left, heard) = (at(&before), at(&after), at(&left), at(&u));
                let way = [after[0] - before[0], after[1] - before[1]];
                let length = way[0].hypot(way[1]);
                if length > 2.0 * COURSE_S * SLOWEST_M_S {
                    behind.push(((left[0] - heard[0]) * way[0] + (left[1] - heard[1]) * way[1]) / length);
                }
            }
        }
        (errors, behind)
    }

    /// Direction by GPS: linear between the fixes around a time, none where they are too far away.
    fn truth_at(&self, t_s: f64) -> Option<[f64; 3]> {
        let near = |(t, _): &&(f64, [f64; 3])| (t - t_s).abs() <= GPS_MOST_S;
        match between(&self.truth, |fix| fix.0, t_s) {
            Some((a, b, share)) if near(&a) && near(&b) => Some(mixed(&a.1, &b.1, share)),
            Some((a, b, _)) => [a, b].into_iter().find(near).map(|fix| fix.1),
            None => [self.truth.first(), self.truth.last()].into_iter().flatten().find(near).map(|fix| fix.1),
        }
    }

    fn judged(&self, result: SetResult) -> Option<Judged> {
        let truth = self.truth_at(result.t_s)?;
        let truth_deg =
            (azimuth_deg(truth[0], truth[1]), truth[2].atan2(truth[0].hypot(truth[1])).to_degrees());
        let error_deg = match &result.solution {
            Some(s) => between_deg(&truth, &s.direction.map(f64::from)),
            None => 180.0,
        };
        Some(Judged { result, truth_deg, error_deg })
    }
}

/// Angle between a direction and one of length one, degrees.
fn between_deg(a: &[f64; 3], unit: &[f64; 3]) -> f64 {
    let dot: f64 = a.iter().zip(unit).map(|(a, b)| a * b).sum();
    let length = a.iter().map(|x| x * x).sum::<f64>().sqrt();
    (dot / length).clamp(-1.0, 1.0).acos().to_degrees()
}

/// Sums judged sets up.
pub fn score(judged: &[Judged]) -> BearingScore {
    let accepted: Vec<&Judged> =
        judged.iter().filter(|j| j.result.solution.is_some_and(|s| s.accepted)).collect();
    let mut errors: Vec<f64> = accepted.iter().map(|j| j.error_deg).collect();
    errors.sort_by(f64::total_cmp);
    let n = errors.len().max(1) as f64;
    let inside = accepted
        .iter()
        .filter(|j| {
            j.result.solution.is_some_and(|s| {
                let da = turn_deg(j.truth_deg.0, f64::from(s.azimuth).to_degrees());
                let (da, de) = (da.to_radians(), f64::from(s.elevation) - j.truth_deg.1.to_radians());
                let (va, ve, c) = (f64::from(s.var_azimuth), f64::from(s.var_elevation), f64::from(s.cov));
                (ve * da * da - 2.0 * c * da * de + va * de * de) / (va * ve - c * c) <= 5.991
            })
        })
        .count();
    BearingScore {
        sets: judged.len(),
        kept: accepted.len() as f64 / judged.len().max(1) as f64,
        median_deg: errors.get(errors.len() / 2).copied().unwrap_or(f64::NAN),
        beyond_10_deg: errors.iter().filter(|e| **e > 10.0).count() as f64 / n,
        in_ellipse: inside as f64 / n,
    }
}

/// The sets of the data, converted in a folder that goes again.
struct Run {
    judged: Vec<Judged>,
    /// Whether a hydrophone is called late.
    late: bool,
    /// Medians against the ship when the sound left it: see [`ShipRecording::behind`].
    left_deg: Option<f64>,
    behind_m: Option<f64>,
}

fn judged(data: &Path) -> Result<Run> {
    let folder = seabearing_host::beside::Folder::new()?;
    let recording = ShipRecording::convert(data, folder.path())?;
    let late = recording.solved()?.lateness.and_then(|l| l.said());
    let judged = recording.judge()?;
    let (mut left, mut behind) = recording.behind(&judged);
    Ok(Run { left_deg: median(&mut left), behind_m: median(&mut behind), judged, late: late.is_some() })
}

fn run(options: &Options) -> Result<()> {
    let run = options.real(DATA).map(|data| judged(&data)).transpose()?;
    let late = run.as_ref().map(|run| f64::from(u8::from(run.late)));
    let score = run.as_ref().map(|run| score(&run.judged));
    let figures = &options.figures;
    figures.at_least("sets kept, %", score.map(|s| 100.0 * s.kept), 80.0);
    figures.at_most("median error, deg", score.map(|s| s.median_deg), 0.90);
    figures.at_most("beyond 10°, %", score.map(|s| 100.0 * s.beyond_10_deg), 0.5);
    figures.at_least("in the 95 % ellipse, %", score.map(|s| 100.0 * s.in_ellipse), 92.0);
    figures.at_most("in the 95 % ellipse, %", score.map(|s| 100.0 * s.in_ellipse), 97.0);
    figures.at_most("hydrophones called late (none is known to be)", late, 0.0);
    let (left_deg, behind_m) = run.as_ref().map_or((None, None), |run| (run.left_deg, run.behind_m));
    figures.state("median error against GPS when the sound left the ship, deg", left_deg);
    figures.state("bearings behind the GPS antenna then, along the course, m (median)", behind_m);
    let (Some(s), Some(run)) = (score, run) else { return Ok(()) };
    let mut report = super::report::CsvReport::new(
        "real_ship_ee",
        "sets,kept_percent,median_deg,beyond_10_percent,in_ellipse_percent",
    );
    report.row(&[s.sets as f64, 100.0 * s.kept, s.median_deg, 100.0 * s.beyond_10_deg, 100.0 * s.in_ellipse]);
    report.finish(options)?;
    draw(&run.judged, &options.out.join("real_ship_ee.svg"))
}

/// Azimuth and error against time, rejected sets marked.
fn draw(judged: &[Judged], path: &Path) -> Result<()> {
    let minutes = |j: &Judged| j.result.t_s / 60.0;
    let accepted = |j: &&Judged| j.result.solution.is_some_and(|s| s.accepted);
    let azimuth =
        |j: &Judged| (minutes(j), j.result.solution.map_or(f64::NAN, |s| f64::from(s.azimuth).to_degrees()));
    let error = |j: &Judged| (minutes(j), j.error_deg.max(0.02));
    let mut top =
        Plot::new("A ship's azimuth from time differences, and by GPS", "time (min)", "azimuth (°)");
    top.size(1000, 420);
    top.y_scale(Scale::Degrees);
    top.points("rejected", &judged.iter().filter(|j| !accepted(j)).map(azimuth).collect::<Vec<_>>());
    top.points("accepted", &judged.iter().filter(accepted).map(azimuth).collect::<Vec<_>>());
    let truth: Vec<(f64, f64)> = judged.iter().map(|j| (minutes(j), j.truth_deg.0)).collect();
    top.truth("GPS", &crate::plot::cut_at_wraps(&truth));
    let mut bottom = Plot::new("Angle between bearing and GPS", "time (min)", "error (°)");
    bottom.size(1000, 380);
    bottom.y_scale(Scale::Log);
    bottom.points("rejected", &judged.iter().filter(|j| !accepted(j)).map(error).collect::<Vec<_>>());
    bottom.points("accepted", &judged.iter().filter(accepted).map(error).collect::<Vec<_>>());
    write_panels(path, &[&top, &bottom], 1)
}
