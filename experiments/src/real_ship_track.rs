//! `reproduce real-ship-track`: a real ship tracked from the bearings of one recorder below it, against its GPS.
//!
//! Data: as of `reproduce real-ship-ee`. The ship manoeuvres about the recorder, so its way is cut into overlapping legs
//! of three minutes; those along which GPS finds it on a straight line are fitted from azimuths and elevations, with the
//! recorder's depth known and nothing assumed of speed, by least squares and robustly. Printed for every leg: errors of
//! position at its middle, heading and speed, and what the fit claims for them.

use super::figure::Bar;
use super::real_ship_ee::{DATA, Judged, ShipRecording};
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::plot::Plot;
use crate::score::median;
use anyhow::Result;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::kit::straight_line::through;
use seabearing_core::motion::solution::position;
use seabearing_core::motion::{Medium, Solution};
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{Config, Sample, fit};
use seabearing_locate::motion::robust::fit_robust;
use seabearing_locate::motion::whiten::Workspace;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "real-ship-track",
    about: "a real ship: straight legs tracked from azimuths and elevations, no speed assumed, against GPS",
    run,
};

/// Length of a leg and step to the next, seconds.
const LEG_S: f64 = 180.0;
const STEP_S: f64 = 90.0;
/// A leg is straight where GPS stays within this of a line run at one speed, metres root mean square.
const STRAIGHT_M: f64 = 10.0;
/// Slower, a heading means little, m/s.
const SLOWEST_M_S: f64 = 0.5;
/// Fewest accepted bearings of a leg.
const LEAST_BEARINGS: usize = 60;
/// Direction error that lasts longer than a leg (geometry, antenna to propeller), degrees; what the scatter of single
/// bearings does not show.
const LASTING_DEG: f64 = 0.5;
/// Standard deviation of one accepted bearing, degrees in space, beside what its residuals say.
const SINGLE_DEG: f64 = 1.0;

/// The figure with a bar.
const HELD: &str = "headings in their 95 %, % of those told";

/// Position (m), velocity (m/s) of the ship at the middle of a leg.
#[derive(Clone, Copy, Debug)]
struct Leg {
    middle_s: f64,
    at_m: [f64; 2],
    velocity_m_s: [f64; 2],
}

/// Errors of a fit on one leg with their standard deviations: position (m), heading (degrees), speed (m/s).
type Errors = [(f64, f64); 3];

fn run(options: &Options) -> Result<()> {
    let names = ["median error of position, m", "median error of heading, deg", "median error of speed, m/s"];
    let Some(data) = options.real(DATA) else {
        names.into_iter().for_each(|name| options.figures.state(name, None));
        options.figures.report(HELD, None, Bar::Within(90.0, 97.0));
        return Ok(());
    };
    let folder = seabearing_host::beside::Folder::new()?;
    let recording = ShipRecording::convert(&data, folder.path())?;
    let judged = recording.judge()?;
    let height_m = recording.station.config.depth_m;
    let sound_speed_m_s = recording.station.config.sound_speed_m_s;
    let mut report = CsvReport::new(
        "real-ship-track",
        "middle_s,range_m,speed_m_s,bearings,position_ls,position_robust,sd_position,heading_robust,\
         sd_heading,speed_robust,sd_speed",
    );
    let mut work = Box::new(Workspace::<1024>::new());
    let mut scores: Vec<[Errors; 2]> = Vec::new();
    let mut lines: Vec<Vec<(f64, f64)>> = Vec::new();
    let last_s = judged.last().map_or(0.0, |j| j.result.t_s);
    let mut begin_s = 0.0;
    while begin_s + LEG_S <= last_s {
        let within: Vec<&Judged> =
            judged.iter().filter(|j| (begin_s..begin_s + LEG_S).contains(&j.result.t_s)).collect();
        begin_s += STEP_S;
        let samples = samples(&within);
        let Some(leg) = leg(&within, height_m).filter(|_| samples.len() >= LEAST_BEARINGS) else { continue };
        let config = Config {
            model: Model::White,
            tau_s: 0.0,
            white_share: 0.0,
            speed_m_s: 3.0,
            speed_sd_m_s: f64::INFINITY,
            range_m: (2.0, 3000.0),
            medium: Medium { height_m, ..Medium::of_sound_speed(sound_speed_m_s) },
            elevation_bias_sd_rad: LASTING_DEG * RAD_PER_DEG,
            acceleration_sd_m_s2: 0.0,
        };
        let mut copy = samples.clone();
        let (Ok(squares), Ok(robust)) = (
            fit(&config, &samples, &mut work, &mut []),
            fit_robust(&config, &samples, &mut copy, &mut work, &mut []),
        ) else {
            continue;
        };
        let both = [squares.solution, robust.fit.solution].map(|s| errors(&s, &leg, height_m));
        let [p, h, v] = both[1];
        report.row(&[
            leg.middle_s,
            leg.at_m[0].hypot(leg.at_m[1]),
            leg.velocity_m_s[0].hypot(leg.velocity_m_s[1]),
            samples.len() as f64,
            both[0][0].0,
            p.0,
            p.1,
            h.0,
            h.1,
            v.0,
            v.1,
        ]);
        scores.push(both);
        let s = robust.fit.solution;
        lines.push(
            [s.t0_s, s.t1_s].map(|t| position(&s.line, &s.covariance, t).0).map(|[x, y]| (x, y)).to_vec(),
        );
    }
    report.finish(options)?;
    let middle = |estimator: usize, quantity: usize| {
        median(scores.iter().map(|e| e[estimator][quantity].0.abs()).collect())
    };
    for (k, name) in names.into_iter().enumerate() {
        options.figures.state(name, middle(1, k));
        options.figures.state(format!("the same by least squares: {name}"), middle(0, k));
    }
    options.figures.state("straight legs", scores.len() as f64);
    // Where the bearing hardly turns, no heading is told.
    let told: Vec<_> = scores.iter().map(|e| e[1][1]).filter(|(_, sd)| sd.is_finite()).collect();
    options.figures.state("of these with a heading", told.len() as f64);
    let held = told.iter().filter(|(error, sd)| error.abs() <= 1.96 * sd).count();
    options.figures.report(HELD, 100.0 * held as f64 / told.len() as f64, Bar::Within(90.0, 97.0));
    let way: Vec<(f64, f64)> = judged.iter().map(|j| at_m(j, height_m)).map(|[x, y]| (x, y)).collect();
    let mut map = Plot::map("A ship above one recorder: GPS and tracked legs");
    map.truth("GPS", &way);
    for (i, line) in lines.iter().enumerate() {
        map.line(if i == 0 { "tracked legs" } else { "" }, line);
        if i > 0 {
            map.same_colour();
        }
    }
    map.write(&options.out.join("real-ship-track.svg"))
}

/// East and North of the ship by GPS, metres.
fn at_m(j: &Judged, height_m: f64) -> [f64; 2] {
    let (azimuth, elevation) = (j.truth_deg.0 * RAD_PER_DEG, j.truth_deg.1 * RAD_PER_DEG);
    let d = height_m / elevation.tan();
    [d * azimuth.sin(), d * azimuth.cos()]
}

/// The straight line through the GPS positions of a leg; `None` where they do not lie on one.
fn leg(within: &[&Judged], height_m: f64) -> Option<Leg> {
    let n = within.len() as f64;
    if within.len() < LEAST_BEARINGS {
        return None;
    }
    let middle_s = within.iter().map(|j| j.result.t_s).sum::<f64>() / n;
    let places: Vec<(f64, [f64; 2])> =
        within.iter().map(|j| (j.result.t_s - middle_s, at_m(j, height_m))).collect();
    let axis = |k: usize| through(places.iter().map(|(t, p)| (*t, p[k])));
    let (east, north) = (axis(0)?, axis(1)?);
    let off: f64 =
        places.iter().map(|(t, [x, y])| (x - east.at(*t)).powi(2) + (y - north.at(*t)).powi(2)).sum();
    let (mean, velocity) = ([east.value, north.value], [east.slope, north.slope]);
    let straight = (off / n).sqrt() <= STRAIGHT_M && velocity[0].hypot(velocity[1]) >= SLOWEST_M_S;
    straight.then_some(Leg { middle_s, at_m: mean, velocity_m_s: velocity })
}

/// The accepted bearings of a leg.
fn samples(within: &[&Judged]) -> Vec<Sample> {
    within
        .iter()
        .filter_map(|j| {
            let s = j.result.solution.filter(|s| s.accepted)?;
            let single = SINGLE_DEG * RAD_PER_DEG;
            let elevation_sd = single.hypot(f64::from(s.var_elevation).sqrt());
            // One error in space is a larger one in azimuth, the steeper the bearing.
            let azimuth_sd = (single / f64::from(s.elevation).cos()).hypot(f64::from(s.var_azimuth).sqrt());
            let mut sample = Sample::azimuth(j.result.t_s, f64::from(s.azimuth), azimuth_sd);
            sample.elevation_rad = (s.elevation, elevation_sd as f32);
            Some(sample)
        })
        .collect()
}

/// What a fit errs by on a leg, and claims. A direction error that lasts turns the track by as much azimuth, as in the recorder's own
/// passages; the steeper the bearing, the more azimuth it is.
fn errors(s: &Solution, leg: &Leg, height_m: f64) -> Errors {
    let [x, y] = leg.at_m;
    let lasting_deg = LASTING_DEG * x.hypot(y).hypot(height_m) / x.hypot(y);
    let ([x, y], [xx, yy, _]) = position(&s.line, &s.covariance, leg.middle_s);
    let [vx, vy] = leg.velocity_m_s;
    [
        ((x - leg.at_m[0]).hypot(y - leg.at_m[1]), (xx + yy).sqrt()),
        (
            wrap_pi(s.heading_rad - vx.atan2(vy)) / RAD_PER_DEG,
            (s.sd_heading_rad / RAD_PER_DEG).hypot(lasting_deg),
        ),
        (s.speed_m_s - vx.hypot(vy), s.sd_speed_m_s),
    ]
}
