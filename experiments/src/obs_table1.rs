//! Table I of \[O\] in form: detections and tracks of the vessels of six days, on synthetic records.
//!
//! The recording of the paper's test week (May 2013) is not at hand, and both AIS files that are (terrestrial to November,
//! satellite to December 2012) end before it; so the six days of 2012 with the most vessels after the paper's own rule
//! (within 100 km, closest point within 25 km), eleven at most, are simulated: real tracks, station RR03, its ray table,
//! five paths. Vessels that do not pass on a roughly straight way (drifting, anchoring, positions that end at the closest
//! point) have no track to compare with and are left out. Columns are the paper's, errors as SMAD; two more say how close
//! each passed and how far its real way within 50 km departs from the straight line that a track is compared with.

use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::ais::{AisPassage, passages, read};
use crate::ocean_bottom::scenario::{DirectionalTable, Radiation, Whale};
use crate::score::{Detections, TrackMiss, closest, median, smad};
use anyhow::{Result, bail};
use std::fmt::Display;

/// The experiment.
pub const TABLE_1: Experiment = Experiment {
    name: "obs-table1",
    about: "Table I of the ocean-bottom paper: detections and tracks of real ship tracks over six days, synthetic sound",
    run,
};

/// Deployment position of RR03 (latitude, longitude in degrees).
pub(super) const RR03_DEG: (f64, f64) = (-21.3732, 54.1294);

const DAYS: f64 = 6.0;
const DAY_S: f64 = 86_400.0;

/// A way that departs farther from a straight line than this within 50 km has no one heading and closest point, m.
const BEND_M: f64 = 3_000.0;

/// Vessels of the paper's table.
const VESSELS: usize = 11;

/// Knots in a metre a second.
const KNOTS: f64 = 1.943_844;

fn run(options: &Options) -> Result<()> {
    // Dense terrestrial positions where they are, satellite ones else.
    let terrestrial = Some(options.data.join("ais_marine_traffic.csv")).filter(|p| p.is_file());
    let Some(file) = terrestrial.or_else(|| options.real("ais_cls.csv.xz")) else {
        options.figures.state("vessels with a final track", None);
        return Ok(());
    };
    let found = passages(&read(&file)?, RR03_DEG);
    let all: Vec<AisPassage> = found.iter().filter(|p| passes(p)).cloned().collect();
    let Some((start, chosen)) = window(&all, DAYS) else {
        bail!("{} holds no passage", file.display());
    };
    let mut scenario = quiet(options.seed, DAYS * DAY_S);
    let when = time::OffsetDateTime::from_unix_timestamp(start as i64)?;
    scenario.start = when;
    scenario.ambient.directional.push(DirectionalTable { azimuth_deg: 90.0, level_db: -6.0 });
    scenario.fin_whale.push(Whale {
        azimuth_deg: 210.0,
        range_m: 9_000.0,
        start_s: 4.4 * DAY_S,
        duration_s: 6.0 * 3600.0,
        interval_s: 13.0,
        level_db: 12.0,
    });
    let extra = chosen.iter().map(|p| p.extra(start, &Radiation::default())).collect();
    if !options.json {
        println!(
            "  {} passages in {}, {} of them straight; {} closest within six days from {}",
            found.len(),
            file.display(),
            all.len(),
            chosen.len(),
            scenario.start
        );
    }
    let case = Case::run(scenario, &station_table(options)?, extra)?;
    let (rows, tracked) = table(&case);
    options.figures.state("vessels with a final track", f64::from(tracked));
    options.figures.state("vessels", case.vessels.len() as f64);
    print(options, "obs-table1", rows)
}

/// Whether a vessel really passes: before and after its closest point, and on a roughly straight way.
pub(super) fn passes(p: &AisPassage) -> bool {
    let around =
        |before: f64, after: f64| p.fixes.iter().any(|f| (before..after).contains(&(f.0 - p.cpa_unix_s)));
    let hour = 3_600.0;
    around(-GREATEST_GAP_S, -0.5 * hour)
        && around(0.5 * hour, GREATEST_GAP_S)
        && p.course(0.0).bend_m().is_some_and(|bend| bend <= BEND_M)
}

/// Seconds about the closest point in which a passage must have positions on both sides.
const GREATEST_GAP_S: f64 = 4.0 * 3_600.0;

/// The days, starting at a midnight, with the most closest points, eleven at most.
pub(super) fn window(all: &[AisPassage], days: f64) -> Option<(f64, Vec<&AisPassage>)> {
    let first = (all.first()?.cpa_unix_s / DAY_S).floor() as i64;
    let last = (all.last()?.cpa_unix_s / DAY_S).floor() as i64;
    (first..=last)
        .map(|d| {
            let start = d as f64 * DAY_S;
            let inside = |p: &&AisPassage| (start..start + days * DAY_S).contains(&p.cpa_unix_s);
            (start, all.iter().filter(inside).take(VESSELS).collect::<Vec<_>>())
        })
        .max_by_key(|(start, p)| (p.len(), -*start as i64))
}

/// The table, and how many vessels have a final track.
fn table(case: &Case) -> (CsvText, u32) {
    let mut out = CsvText::new(
        "ship,azimuth_n,azimuth_smad_deg,range_n,range_smad_m,speed_smad_kn,cpa_time_s,heading_deg,cpa_range_m,speed_kn,\
         closest_km,bend_m",
    );
    let mut total = Detections::default();
    let mut errors: Vec<TrackMiss> = Vec::new();
    for (i, d) in case.detections().iter().enumerate() {
        let error = case.final_track(i);
        errors.extend(error);
        let course = &case.vessels[i].course;
        let near = closest(course).map_or(f64::NAN, |c| c.1 / 1e3);
        let bend = course.bend_m().unwrap_or(f64::NAN);
        row(&mut out, &(i + 1), d, error, [&Fixed(near, 1), &Fixed(bend, 0)]);
        total.append(d);
    }
    let middle = |f: &dyn Fn(&TrackMiss) -> f64| median(errors.iter().map(|e| f(e).abs()).collect());
    let all = (!errors.is_empty()).then(|| TrackMiss {
        cpa_time_s: middle(&|e| e.cpa_time_s),
        cpa_range_m: middle(&|e| e.cpa_range_m),
        heading: middle(&|e| e.heading),
        speed_m_s: middle(&|e| e.speed_m_s),
    });
    row(&mut out, &"all", &total, all, [&"-", &"-"]);
    (out, errors.len() as u32)
}

/// A row: detections, the track where there is one, and how the vessel passed.
fn row(
    out: &mut CsvText,
    name: &dyn Display,
    d: &Detections,
    e: Option<TrackMiss>,
    passed: [&dyn Display; 2],
) {
    let track = e.map_or(["-"; 4].map(str::to_owned), |e| {
        [
            Fixed(e.cpa_time_s.abs(), 0),
            Fixed(e.heading.abs().to_degrees(), 1),
            Fixed(e.cpa_range_m.abs(), 0),
            Fixed(e.speed_m_s.abs() * KNOTS, 2),
        ]
        .map(|x| x.to_string())
    });
    let [time, heading, range, speed] = &track;
    let (azimuth, ranges) = (Fixed(smad(&d.azimuth).to_degrees(), 1), Fixed(smad(&d.range_m), 0));
    let radial = Fixed(smad(&d.speed_m_s) * KNOTS, 2);
    let (n, m) = (d.azimuth.len(), d.range_m.len());
    let [near, bend] = passed;
    out.row(&[name, &n, &azimuth, &m, &ranges, &radial, time, heading, range, speed, near, bend]);
}
