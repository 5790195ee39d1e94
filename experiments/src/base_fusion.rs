//! `reproduce base-fusion`: a vessel passes three recorders; their telemetry goes through a base station, which fuses it without
//! assuming a speed. Is the vessel inside the network track's 95 %?
//!
//! Every recorder is the host's twin of the firmware over the sound of the pass at its own place; its bytes are decoded by
//! the base station and fused as they come. Orientations are drawn with the standard deviation that the stations file states.
//! The same telemetry is fused again with one clock late, with one station silent from half way on, by two stations alone, and
//! with one station turned by 3° against what it states (its messages turned, as a wrong `orientation_deg` turns them). Then
//! two vessels whose ways cross.

use super::figure::Bar;
use super::report::CsvReport;
use super::sea::{Held, RATE_HZ, ferry, messages, scenario, side, station};
use super::sea_moving::MovingSea;
use super::{Experiment, Options};
use crate::progress;
use crate::scenario::Straight;
use crate::world::scenario::Water;
use anyhow::{Context, Result};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, StandardNormal};
use rayon::prelude::*;
use seabearing_base::fusion::Fusion;
use seabearing_base::fusion::sites::{Site, Sites};
use seabearing_base::record::us_of;
use seabearing_base::{Base, Beginning};
use seabearing_core::angle::wrap_tau;
use seabearing_core::kit::spd;
use seabearing_core::wire::{Encoder, Message, Time};
use serde_json::Value;
use std::f64::consts::TAU;

/// `seabearing reproduce base-fusion`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "base-fusion",
    about: "vessels past three recorders, fused by a base station: network tracks in their 95 %; --runs: passes (200 for the figure)",
    run,
};

/// Passes without --runs.
const QUICK: usize = 3;
/// One scene of two vessels for so many passes.
const PASSES_A_CROSSING: usize = 4;
const DURATION_S: f64 = 160.0;
const DEPTH_M: f64 = 100.0;
/// Where the recorders are, metres.
const PLACES: [[f64; 2]; 3] = [[0.0, 0.0], [900.0, 0.0], [450.0, 780.0]];
const CENTRE: [f64; 2] = [450.0, 260.0];
/// How far from the centre vessels pass it at most, metres.
const OFF_M: f64 = 700.0;
/// What the stations file states: deviation of orientations, degrees, and of clocks, s; of the late one, which is late by it.
const SD_ORIENTATION_DEG: f64 = 0.5;
const SD_CLOCK_S: f32 = 1e-3;
const LATE_S: f32 = 2.0;
/// The station that is turned, late or silent, and by how many degrees it is turned.
const BAD: usize = 2;
const TURNED_DEG: f64 = 3.0;
/// 2026-06-01.
const BEGIN_US: i64 = 1_780_272_000_000_000;
/// 95 % of chi-squared, two and four degrees of freedom.
const ELLIPSE_95: f64 = 5.991_464_547_107_98;
const STATE_95: f64 = 9.487_729_036_781_15;

/// A vessel on a straight way: place at the beginning, velocity.
#[derive(Clone, Copy, Debug)]
struct Way {
    at_m: [f64; 2],
    velocity_m_s: [f64; 2],
}

impl Way {
    fn random(rng: &mut ChaCha8Rng) -> Result<Self> {
        let speeds = Normal::new(7.3, 2.3)?;
        let speed =
            std::iter::repeat_with(|| speeds.sample(rng)).find(|v| (3.0..12.0).contains(v)).unwrap_or(7.3);
        let (s, c) = rng.random_range(0.0..TAU).sin_cos();
        let (off, mid_s) = (rng.random_range(-OFF_M..OFF_M), rng.random_range(0.4..0.6) * DURATION_S);
        let velocity_m_s = [speed * s, speed * c];
        let at = |k: usize, across: f64| CENTRE[k] + off * across - velocity_m_s[k] * mid_s;
        Ok(Self { at_m: [at(0, c), at(1, -s)], velocity_m_s })
    }

    fn at(&self, t_s: f64) -> [f64; 2] {
        [0, 1].map(|k| self.at_m[k] + self.velocity_m_s[k] * t_s)
    }

    /// As a station at a place sees it.
    fn past(&self, place: [f64; 2]) -> Straight {
        let [vx, vy] = self.velocity_m_s;
        let [x, y] = [0, 1].map(|k| self.at_m[k] - place[k]);
        let speed_m_s = vx.hypot(vy);
        let cpa_time_s = -(x * vx + y * vy) / (speed_m_s * speed_m_s);
        let (x, y) = (x + vx * cpa_time_s, y + vy * cpa_time_s);
        let heading_deg = vx.atan2(vy).to_degrees().rem_euclid(360.0);
        // The array is to port where it lies to the left of the way.
        let port = -x * vy + y * vx < 0.0;
        Straight { cpa_time_s, cpa_range_m: x.hypot(y), heading_deg, speed_m_s, side: side(port) }
    }
}

/// What one station sends.
type Telemetry = Vec<Message>;

/// A scene: the ways, and what the recorders send of them.
struct Heard {
    ways: Vec<Way>,
    of: Vec<Telemetry>,
}

impl Heard {
    fn new(ways: Vec<Way>, seed: u64) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let listen = |(n, place): (usize, &[f64; 2])| {
            let mut config = station(RATE_HZ, DEPTH_M, |_| {});
            config.id = n as u16 + 1;
            let vessels = ways.iter().map(|w| ferry(w.past(*place))).collect();
            let scene = scenario(config.clone(), Water::default(), vessels, DURATION_S, seed + n as u64);
            let error: f64 = StandardNormal.sample(&mut rng);
            config.orientation_deg = SD_ORIENTATION_DEG * error;
            messages(&config, MovingSea::new(&scene)?)
        };
        let of = PLACES.iter().enumerate().map(listen).collect::<Result<_>>()?;
        Ok(Self { ways, of })
    }
}

/// How a scene comes to the base station.
#[derive(Clone, Copy, Debug, Default)]
struct Coming {
    late: bool,
    silent: bool,
    two: bool,
    turned: bool,
}

/// What became of the vessels of a scene.
#[derive(Clone, Copy, Debug, Default)]
struct Score {
    /// Vessels, and those with a network track of their own.
    vessels: usize,
    found: usize,
    /// Places in their ellipse, states in their ellipsoid.
    places: Held,
    states: Held,
    /// Network tracks of no vessel: beyond any of them by more than six times what is stated.
    ghosts: usize,
    /// Tracks said to contradict each other.
    contradicted: usize,
    /// Outside the 95 % and not said to be contradicted.
    confident: usize,
    /// Sum of the squared errors of the states in units of their covariance; four are expected of each.
    squares: f64,
    /// Sum of the semi-major axes of the ellipses, m, standard deviations.
    axes_m: f64,
}

impl Score {
    fn join(mut self, other: Self) -> Self {
        self.vessels += other.vessels;
        self.found += other.found;
        self.places.join(other.places);
        self.states.join(other.states);
        self.ghosts += other.ghosts;
        self.contradicted += other.contradicted;
        self.confident += other.confident;
        self.squares += other.squares;
        self.axes_m += other.axes_m;
        self
    }

    /// Of the network tracks that stand at the end.
    fn of(tracks: &[Value], ways: &[Way]) -> Self {
        let mut score = Self { vessels: ways.len(), ..Self::default() };
        let mut found = vec![false; ways.len()];
        for track in tracks {
            let Some((t_s, state, covariance)) = state(track) else { continue };
            let off = |w: &Way, of: usize| {
                let at = w.at(t_s);
                let d = [
                    state[0] - at[0],
                    state[1] - at[1],
                    state[2] - w.velocity_m_s[0],
                    state[3] - w.velocity_m_s[1],
                ];
                if of == 4 {
                    return spd::solve(&covariance, &d).map_or(f64::INFINITY, |x| spd::dot(&d, &x));
                }
                let place = [[covariance[0][0], covariance[0][1]], [covariance[1][0], covariance[1][1]]];
                spd::solve(&place, &[d[0], d[1]]).map_or(f64::INFINITY, |x| spd::dot(&[d[0], d[1]], &x))
            };
            let Some(nearest) =
                (0..ways.len()).min_by(|a, b| off(&ways[*a], 4).total_cmp(&off(&ways[*b], 4)))
            else {
                continue;
            };
            score.contradicted += usize::from(track["consistent"] == false);
            let (place, whole) = (off(&ways[nearest], 2), off(&ways[nearest], 4));
            if found[nearest] || whole > 36.0 * STATE_95 {
                score.ghosts += 1;
                continue;
            }
            found[nearest] = true;
            score.places.take(place <= ELLIPSE_95);
            score.states.take(whole <= STATE_95);
            score.squares += whole;
            score.confident += usize::from(place > ELLIPSE_95 && track["consistent"] == true);
            let (half, diff) = (
                (covariance[0][0] + covariance[1][1]) / 2.0,
                ((covariance[0][0] - covariance[1][1]) / 2.0).hypot(covariance[0][1]),
            );
            score.axes_m += (half + diff).sqrt();
        }
        score.found = found.into_iter().filter(|f| *f).count();
        score
    }
}

/// Time since the beginning, state and covariance of a network track's record; none where nothing is observable.
fn state(track: &Value) -> Option<(f64, [f64; 4], spd::Square<4>)> {
    let number = |key: &str| track[key].as_f64();
    let (speed, heading) = (number("speed_m_s")?, number("heading_deg")?.to_radians());
    let all: Vec<f64> = track["covariance"].as_array()?.iter().filter_map(Value::as_f64).collect();
    let mut covariance = [[0.0; 4]; 4];
    covariance.iter_mut().flatten().zip(all).for_each(|(c, x)| *c = x);
    let t_s = (us_of(&track["utc"])? - BEGIN_US) as f64 * 1e-6;
    let state = [number("x_m")?, number("y_m")?, speed * heading.sin(), speed * heading.cos()];
    Some((t_s, state, covariance))
}

/// A message as a station says it that is turned clockwise by an angle and does not know.
fn turned(message: Message, by: f64) -> Message {
    let turn = |a: f32| wrap_tau(f64::from(a) - by) as f32;
    match message {
        Message::Bearing(mut b) => {
            b.azimuth = turn(b.azimuth);
            Message::Bearing(b)
        }
        Message::Track(mut t) => {
            (t.cpa_azimuth, t.heading) = (turn(t.cpa_azimuth), turn(t.heading));
            let (s, c) = (by.sin() as f32, by.cos() as f32);
            (t.x_m, t.y_m) = (t.x_m * c - t.y_m * s, t.x_m * s + t.y_m * c);
            Message::Track(t)
        }
        other => other,
    }
}

fn index_of(message: &Message) -> u64 {
    seabearing_base::record::index(message).unwrap_or(0)
}

/// The network tracks that stand when all telemetry has come: decoded by a base station, fused as it comes.
fn fuse(heard: &Heard, how: Coming) -> Result<Vec<Value>> {
    let (mut base, mut records) = (Base::new(None), Vec::new());
    let mut frames: Vec<(u64, u32, Vec<u8>)> = Vec::new();
    for (n, telemetry) in heard.of.iter().enumerate() {
        let (stream, bad) = (n as u32 + 1, n == BAD);
        if bad && how.two {
            continue;
        }
        base.begin(stream, Beginning { line: format!("file:{n}"), ..Beginning::default() }, None);
        let (late_us, sd_s) = if bad && how.late { ((LATE_S * 1e6) as i64, LATE_S) } else { (0, SD_CLOCK_S) };
        let utc_us = BEGIN_US + late_us;
        let time = Time { index: 0, utc_us, sd_s, drift: 0.0, sd_drift: 1e-7, correlation: 0.0 };
        let mut encoder = Encoder::default();
        for (k, message) in telemetry.iter().enumerate() {
            let index = index_of(message);
            if bad && how.silent && index as f64 > 0.5 * DURATION_S * RATE_HZ {
                break;
            }
            let by = if bad && how.turned { TURNED_DEG.to_radians() } else { 0.0 };
            frames.push((index, stream, encoder.frame(&turned(*message, by)).to_vec()));
            if k == 0 {
                frames.push((0, stream, encoder.frame(&Message::Time(time)).to_vec()));
            }
        }
    }
    frames.sort_by_key(|(index, ..)| *index);
    let mut fusion = Fusion::new(sites());
    let mut standing: Vec<Value> = Vec::new();
    for (_, stream, bytes) in &frames {
        base.push(*stream, 0, None, bytes, &mut records);
        for row in records.drain(..) {
            for (_, what) in fusion.take(&base.json(&row)) {
                standing.retain(|t| t["id"] != what["id"]);
                standing
                    .extend(Some(what).filter(|w| w["type"] == "network_track" && w["state"] != "withdrawn"));
            }
        }
    }
    Ok(standing)
}

fn sites() -> Sites {
    let site = |(n, [x, y]): (usize, &[f64; 2])| Site {
        station: n as u16 + 1,
        at_m: [*x, *y, -DEPTH_M],
        north: 0.0,
        sd_orientation: SD_ORIENTATION_DEG.to_radians(),
        sd_clock_s: None,
        sound_speed_m_s: 1484.0,
    };
    Sites { sites: PLACES.iter().enumerate().map(site).collect(), frame: None }
}

const HOW: [(&str, Coming); 5] = [
    ("three recorders", Coming { late: false, silent: false, two: false, turned: false }),
    ("one late by its stated 2 s", Coming { late: true, silent: false, two: false, turned: false }),
    ("one silent half way", Coming { late: false, silent: true, two: false, turned: false }),
    ("two recorders", Coming { late: false, silent: false, two: true, turned: false }),
    ("one turned by 3°, 0.5° stated", Coming { late: false, silent: false, two: false, turned: true }),
];

fn run(options: &Options) -> Result<()> {
    let passes = options.runs.unwrap_or(QUICK);
    let crossings = passes.div_ceil(PASSES_A_CROSSING);
    let bar = progress::bar((passes + crossings) as u64, "passes");
    let pass = |n: usize| -> Result<Vec<Score>> {
        let seed = options.seed.wrapping_mul(9_000_017) + 1000 * n as u64;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let vessels = if n < passes { 1 } else { 2 };
        let ways = (0..vessels).map(|_| Way::random(&mut rng)).collect::<Result<_>>()?;
        let heard = Heard::new(ways, seed)?;
        let how = if vessels == 1 { &HOW[..] } else { &HOW[..1] };
        let scored = how.iter().map(|(_, how)| Ok(Score::of(&fuse(&heard, *how)?, &heard.ways))).collect();
        bar.inc(1);
        scored
    };
    let all: Vec<Vec<Score>> = (0..passes + crossings).into_par_iter().map(pass).collect::<Result<_>>()?;
    bar.finish_and_clear();
    let (one, two) = all.split_at(passes);
    let sum = |of: &[Vec<Score>], k: usize| of.iter().map(|s| s[k]).fold(Score::default(), Score::join);
    let mut scores: Vec<(&str, Score)> =
        HOW.iter().enumerate().map(|(k, (name, _))| (*name, sum(one, k))).collect();
    scores.push(("two vessels", sum(two, 0)));
    report(options, &scores)
}

fn report(options: &Options, scores: &[(&str, Score)]) -> Result<()> {
    let mut table = CsvReport::new(
        "base_fusion",
        "scene,vessels,found,place_%,state_%,ghosts,contradicted,wrong_and_confident,mean_chi2_of_4,mean_axis_m",
    );
    let figures = &options.figures;
    for (n, (name, s)) in scores.iter().enumerate() {
        table.row(&[
            n as f64,
            s.vessels as f64,
            s.found as f64,
            s.places.percent(),
            s.states.percent(),
            s.ghosts as f64,
            s.contradicted as f64,
            s.confident as f64,
            s.squares / s.found as f64,
            s.axes_m / s.found as f64,
        ]);
        match n {
            0 => s.places.report(figures, "three recorders: vessels in the 95 % of their network track"),
            _ => {
                let bar = Bar::None;
                figures.report(
                    format!("{name}: vessels in the 95 %, % of {}", s.places.of),
                    s.places.percent(),
                    bar,
                );
            }
        }
        figures.state(format!("{name}: states in the 95 %, % of {}", s.states.of), s.states.percent());
        figures.state(
            format!("{name}: vessels with a network track, % of {}", s.vessels),
            100.0 * s.found as f64 / s.vessels as f64,
        );
        figures.state(format!("{name}: network tracks of no vessel"), s.ghosts as f64);
    }
    let turned = scores.get(4).context("no such scene")?.1;
    figures
        .state("one turned by 3°: outside the 95 % and not said to be contradicted", turned.confident as f64);
    table.finish(options)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_past_a_place_is_the_same_way() {
        let way = Way { at_m: [100.0, -300.0], velocity_m_s: [3.0, 4.0] };
        for place in PLACES {
            let s = way.past(place);
            let vessel = ferry(s);
            let course = vessel.course(None).unwrap();
            for t_s in [0.0, 50.0, 100.0] {
                let ((x, y), at) = (course.position(t_s), way.at(t_s));
                assert!((x + place[0] - at[0]).abs() < 1e-6 && (y + place[1] - at[1]).abs() < 1e-6, "{s:?}");
            }
        }
    }
}
