//! How real vessels move, and what the tracker makes of them: AIS of the Solent (harbours, ferries, pilots, tugs).
//!
//! Three questions. Speeds, rates of turn and accelerations of vessels under way. How long they hold the straight course
//! at constant speed that the fit assumes: a window holds it while the positions stay within 0.5° (the tracker's own
//! coloured error) of the best straight line as seen from 500 or 1000 m. And, with bearings simulated from these tracks
//! past virtual arrays 200 to 1000 m aside ([`super::heard_vessels`]), whether the vessel is tracked, and whether tracks
//! are split where it turned and only there, and how often the vessel is where they state. A passage of 300 s counts as straight if the course stays within 10° and the
//! speed within 20 %, as turning if the course changes by 25° or more, as bending otherwise.

use super::ais_paths::{Instant, Passing, VesselPath, paths};
use super::heard_vessels::{HeardVessel, RATE_HZ, listen, track};
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::plot::{Plot, Scale, cut_at_wraps, write_panels};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
use seabearing_core::config::Tracking;
use seabearing_core::kit::straight_line::through;
use seabearing_core::kit::{median, quantile};
use seabearing_core::wire::Track;
use std::collections::BTreeSet;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "ais-kinematics",
    about: "real vessels (AIS): speeds, turns, how long they go straight, and the tracker on their tracks",
    run,
};

/// Length of a passage, seconds.
const PASSAGE_S: usize = 300;
/// Passages simulated.
const PASSAGES: usize = 300;
/// Least speed of a vessel under way, m/s.
const UNDER_WAY_M_S: f64 = 1.5;
/// Lengths of the windows judged for straightness, seconds.
const WINDOWS_S: [usize; 6] = [60, 100, 150, 200, 300, 400];
/// Deviation a straight fit does not notice, radians.
const UNNOTICED_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// Limits of the classes of passages.
const STRAIGHT_DEG: f64 = 10.0;
const STEADY: f64 = 0.2;
const TURNING_DEG: f64 = 25.0;
/// Deviations in a plane within which 95 % lie.
const DEVIATIONS_95: f64 = 2.448;
/// A report this near the truth is on its vessel, degrees.
const ON_VESSEL_DEG: f64 = 5.0;

fn run(options: &Options) -> Result<()> {
    let Some(file) = options.real("real/ais_solent_2016/SolentAIS_20160112_130211.csv") else {
        options.figures.state("vessel hours under way", None);
        return Ok(());
    };
    let (reports, _) = crate::ais::read(&file)?;
    let all: Vec<VesselPath> = paths(&reports, 60)
        .iter()
        .flat_map(|path| path.split(|i| i.speed_m_s() < UNDER_WAY_M_S).map(<[Instant]>::to_vec))
        .filter(|path| path.len() >= 60)
        .collect();
    let hours = all.iter().map(Vec::len).sum::<usize>() as f64 / 3600.0;
    options.figures.state("vessel hours under way", hours);
    kinematics(options, &all)?;
    let held = straightness(options, &all)?;
    let passages = passages(options, &all)?;
    pictures(options, &all, &held, &passages)
}

/// Quantiles of speed, rate of turn and acceleration.
fn kinematics(options: &Options, all: &[VesselPath]) -> Result<()> {
    let mut report = CsvReport::new("ais-kinematics", "percent,speed_m_s,turn_deg_s,acceleration_m_s2");
    let values = |f: &dyn Fn(&Instant) -> f64| all.iter().flatten().map(f).collect::<Vec<f64>>();
    let mut speed = values(&Instant::speed_m_s);
    let mut turn = values(&|i| i.turn_rad_s().abs().to_degrees());
    let mut along = values(&|i| i.along_m_s2().abs());
    for percent in [5.0, 25.0, 50.0, 75.0, 90.0, 95.0, 99.0] {
        let of = |values: &mut [f64]| quantile(values, percent / 100.0).unwrap_or(f64::NAN);
        report.row(&[percent, of(&mut speed), of(&mut turn), of(&mut along)]);
    }
    report.finish(options)
}

/// Root mean square distance of a stretch from the best straight track at constant speed, metres.
fn deviation_m(path: &[Instant]) -> f64 {
    let n = path.len() as f64;
    let middle = 0.5 * (n - 1.0);
    let axis = |i: usize| {
        let points = || path.iter().enumerate().map(|(k, p)| (k as f64 - middle, p.position_m[i]));
        through(points()).map_or(0.0, |line| points().map(|(t, x)| (x - line.at(t)).powi(2)).sum::<f64>())
    };
    ((axis(0) + axis(1)) / n).sqrt()
}

/// Shares of windows that are straight as seen from 500 and 1000 m, by their length.
fn straightness(options: &Options, all: &[VesselPath]) -> Result<Vec<[f64; 3]>> {
    let mut report = CsvReport::new(
        "ais-straightness",
        "window_s,windows,median_deviation_m,straight_500m_percent,straight_1000m_percent",
    );
    let mut shares = Vec::new();
    for window in WINDOWS_S {
        let starts =
            |path: &'_ VesselPath| (0..=path.len().saturating_sub(window)).step_by(20).collect::<Vec<_>>();
        let mut found: Vec<f64> = all
            .par_iter()
            .filter(|path| path.len() >= window)
            .flat_map_iter(|path| {
                starts(path).into_iter().map(|k| deviation_m(&path[k..k + window])).collect::<Vec<_>>()
            })
            .collect();
        found.sort_by(f64::total_cmp);
        let n = found.len() as f64;
        let within = |range_m: f64| {
            100.0 * found.partition_point(|d| *d <= range_m * UNNOTICED_RAD) as f64 / n.max(1.0)
        };
        let (near, far) = (within(500.0), within(1000.0));
        report.row(&[window as f64, n, median(&mut found).unwrap_or(f64::NAN), near, far]);
        shares.push([window as f64, near, far]);
    }
    report.finish(options)?;
    Ok(shares)
}

/// What kind of passage it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Class {
    Straight,
    Bending,
    Turning,
}

/// One passage and what the tracker made of it.
struct PassageScore {
    path: usize,
    from: usize,
    array_m: [f64; 2],
    class: Class,
    /// Share of the time with a report on the vessel.
    tracked: f64,
    /// Track numbers beyond the first that held the vessel.
    splits: usize,
    /// From the moment the course had changed by 10° to the first split, seconds.
    delay_s: Option<f64>,
    /// Error of the heading at the end, degrees, where reported.
    heading_deg: Option<f64>,
    /// Running reports on the vessel that tell its place and heading; of these with the true place, and the true heading, in their 95 %.
    told: usize,
    placed: usize,
    headed: usize,
}

/// Course against the first second's, unwrapped, degrees.
fn courses(path: &[Instant]) -> Vec<f64> {
    let mut course = 0.0;
    let mut last = path.first().map_or(0.0, Instant::course);
    path.iter()
        .map(|i| {
            course += wrap_pi(i.course() - last).to_degrees();
            last = i.course();
            course
        })
        .collect()
}

fn classify(path: &[Instant]) -> Class {
    let range = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), x| (lo.min(x), hi.max(x)))
    };
    let (left, right) = range(&mut courses(path).into_iter());
    let (slow, fast) = range(&mut path.iter().map(Instant::speed_m_s));
    if right - left >= TURNING_DEG {
        Class::Turning
    } else if right - left <= STRAIGHT_DEG && fast - slow <= STEADY * fast {
        Class::Straight
    } else {
        Class::Bending
    }
}

fn passage(all: &[VesselPath], long: &[usize], seed: u64, run: usize) -> PassageScore {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(run as u64);
    let path = long[run % long.len()];
    let from = rng.random_range(0..=all[path].len() - PASSAGE_S);
    let stretch = &all[path][from..from + PASSAGE_S];
    // The array lies aside of where the vessel is in the middle third.
    let at = stretch[rng.random_range(PASSAGE_S / 3..2 * PASSAGE_S / 3)];
    let aside = rng.random_range(200.0..1000.0) * if rng.random::<bool>() { 1.0 } else { -1.0 };
    let (s, c) = at.course().sin_cos();
    let array_m = [at.position_m[0] + aside * c, at.position_m[1] - aside * s];
    let vessel = Passing { path: stretch, array_m };
    let bearings = listen(&[vessel], PASSAGE_S as f64, &mut rng, 0.0);
    let (records, _) = track(&bearings, Tracking::default().course_sd_deg);
    let (mut ids, mut on, mut split_s) = (BTreeSet::new(), BTreeSet::new(), None);
    let (mut told, mut placed, mut headed) = (0, 0, 0);
    for record in records.iter().filter(|r| r.stage == 0) {
        let t_s = record.index as f64 / RATE_HZ;
        let azimuth = f64::from(record.x_m).atan2(f64::from(record.y_m));
        if wrap_pi(azimuth - vessel.azimuth(t_s)).abs().to_degrees() < ON_VESSEL_DEG {
            on.insert((t_s / 10.0) as u32);
            if record.sd_heading.is_finite() && record.var_x_m2.is_finite() {
                told += 1;
                placed += usize::from(deviations(record, vessel.position(t_s)) < DEVIATIONS_95);
                let off = wrap_pi(f64::from(record.heading) - stretch[t_s as usize].course()).abs();
                headed += usize::from(off < 1.96 * f64::from(record.sd_heading));
            }
            if ids.insert(record.id) && ids.len() == 2 {
                split_s = Some(t_s);
            }
        }
    }
    let turned = courses(stretch);
    let onset = turned.iter().position(|c| c.abs() > 10.0).map(|k| k as f64);
    let last = records.iter().rfind(|r| r.stage == 1).filter(|r| r.sd_heading.is_finite());
    let truth = stretch[PASSAGE_S - 1].course();
    PassageScore {
        path,
        from,
        array_m,
        class: classify(stretch),
        // The first ten seconds or so make the track.
        tracked: on.len() as f64 / ((PASSAGE_S - 20) as f64 / 10.0),
        splits: ids.len().saturating_sub(1),
        delay_s: split_s.zip(onset).map(|(s, o)| s - o),
        heading_deg: last.map(|r| wrap_pi(f64::from(r.heading) - truth).abs().to_degrees()),
        told,
        placed,
        headed,
    }
}

/// How far a place (m) is from the one stated, in the deviations stated.
fn deviations(record: &Track, (x, y): (f64, f64)) -> f64 {
    let (x, y) = (f64::from(record.x_m) - x, f64::from(record.y_m) - y);
    let [xx, yy, xy] = [record.var_x_m2, record.var_y_m2, record.cov_xy_m2].map(f64::from);
    ((x * x * yy - 2.0 * x * y * xy + y * y * xx) / (xx * yy - xy * xy)).sqrt()
}

fn passages(options: &Options, all: &[VesselPath]) -> Result<Vec<PassageScore>> {
    let runs = options.runs.unwrap_or(PASSAGES);
    let long: Vec<usize> = (0..all.len()).filter(|k| all[*k].len() > PASSAGE_S).collect();
    let bar = crate::progress::bar(runs as u64, "ais-kinematics");
    let found: Vec<PassageScore> = (0..runs)
        .into_par_iter()
        .map(|run| {
            bar.inc(1);
            passage(all, &long, options.seed, run)
        })
        .collect();
    bar.finish_and_clear();
    let mut report = CsvReport::new(
        "ais-passages",
        "turning,passages,tracked_percent,time_on_vessel_percent,split_percent,splits_a_passage,\
         median_delay_s,median_heading_error_deg,in_their_95_place_percent,heading_percent",
    );
    for (k, class) in [Class::Straight, Class::Bending, Class::Turning].into_iter().enumerate() {
        let mine: Vec<&PassageScore> = found.iter().filter(|p| p.class == class).collect();
        let n = mine.len() as f64;
        let share = |f: &dyn Fn(&PassageScore) -> f64| mine.iter().map(|p| f(p)).sum::<f64>() / n;
        let middle = |f: &dyn Fn(&PassageScore) -> Option<f64>| {
            median(&mut mine.iter().filter_map(|p| f(p)).collect::<Vec<_>>()).unwrap_or(f64::NAN)
        };
        let name = ["straight", "bending", "turning"][k];
        let tracked = 100.0 * share(&|p| f64::from(u8::from(p.tracked >= 0.8)));
        let split = 100.0 * share(&|p| f64::from(u8::from(p.splits > 0)));
        options.figures.state(format!("{name} passages tracked in four fifths of all 10 s, %"), tracked);
        options.figures.state(format!("{name} passages split, %"), split);
        let told = mine.iter().map(|p| p.told).sum::<usize>() as f64;
        let inside =
            |f: fn(&PassageScore) -> usize| 100.0 * mine.iter().map(|p| f(p)).sum::<usize>() as f64 / told;
        let (placed, headed) = (inside(|p| p.placed), inside(|p| p.headed));
        options.figures.state(format!("{name} passages: places in their 95 %, %"), placed);
        options.figures.state(format!("{name} passages: headings in their 95 %, %"), headed);
        report.row(&[
            k as f64,
            n,
            tracked,
            100.0 * share(&|p| p.tracked.min(1.0)),
            split,
            share(&|p| p.splits as f64),
            middle(&|p| p.delay_s),
            middle(&|p| p.heading_deg),
            placed,
            headed,
        ]);
    }
    report.finish(options)?;
    Ok(found)
}

/// Distributions, straightness, and one turning vessel with its tracks.
fn pictures(
    options: &Options,
    all: &[VesselPath],
    held: &[[f64; 3]],
    passages: &[PassageScore],
) -> Result<()> {
    let cumulative = |f: &dyn Fn(&Instant) -> f64, top: f64| -> Vec<(f64, f64)> {
        let mut values: Vec<f64> = all.iter().flatten().map(f).collect();
        values.sort_by(f64::total_cmp);
        (0..=100)
            .map(|k| top * f64::from(k) / 100.0)
            .map(|x| (x, 100.0 * values.partition_point(|v| *v <= x) as f64 / values.len() as f64))
            .collect()
    };
    let mut speed = Plot::new("Speed of vessels under way", "speed (m/s)", "share below (%)");
    speed.size(450, 340).line("", &cumulative(&Instant::speed_m_s, 20.0));
    let mut turn = Plot::new("Rate of turn", "rate (°/s)", "share below (%)");
    turn.size(450, 340).line("", &cumulative(&|i| i.turn_rad_s().abs().to_degrees(), 3.0));
    let mut straight = Plot::new("Windows as good as straight", "window (s)", "share (%)");
    straight.size(450, 340).y_range(0.0, 100.0);
    straight.line("seen from 500 m", &held.iter().map(|h| (h[0], h[1])).collect::<Vec<_>>());
    straight.line("seen from 1000 m", &held.iter().map(|h| (h[0], h[2])).collect::<Vec<_>>());
    let mut turning = Plot::new("A turning vessel and its tracks", "time (s)", "azimuth (°)");
    turning.size(450, 340).y_scale(Scale::Degrees);
    if let Some(p) = passages.iter().find(|p| p.class == Class::Turning && p.splits > 0) {
        let vessel = Passing { path: &all[p.path][p.from..p.from + PASSAGE_S], array_m: p.array_m };
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let bearings = listen(&[vessel], PASSAGE_S as f64, &mut rng, 0.0);
        let (_, on) = track(&bearings, Tracking::default().course_sd_deg);
        for id in on.iter().flatten().collect::<BTreeSet<_>>() {
            let mine = bearings.iter().zip(&on).filter(|(_, o)| o.as_ref() == Some(id));
            let points: Vec<(f64, f64)> = mine.map(|((t, a), _)| (*t, a.to_degrees())).collect();
            turning.points(&format!("track {id}"), &points);
        }
        let curve: Vec<(f64, f64)> = (0..PASSAGE_S as u32)
            .map(|k| (f64::from(k), vessel.azimuth(f64::from(k)).to_degrees()))
            .collect();
        turning.truth("truth", &cut_at_wraps(&curve));
    }
    write_panels(&options.out.join("ais-kinematics.svg"), &[&speed, &turn, &straight, &turning], 2)
}
