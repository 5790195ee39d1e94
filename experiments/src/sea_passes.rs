//! `reproduce sea-surface` and `sea-bottom`: passes with the surface's image, and with echoes off the bottom as well; whether
//! the recorder's bearings and end-of-passage solutions lie in the 95 % that it states.
//!
//! Speeds are drawn from the distribution that the station assumes, headings, sides and depths of 2 to 8 m at random. A pass counts as one track
//! where the recorder sends one end-of-passage solution.

use super::figure::Bar;
use super::report::CsvReport;
use super::sea::{ELLIPSE, Held, RATES, arrival, ferry, holds_azimuth, miss, play, scenario, side, station};
use super::{Experiment, Options};
use crate::progress;
use crate::scenario::Straight;
use crate::world::ArrayScenario;
use crate::world::scenario::{ArrayVessel, Water};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
use seabearing_core::config::{Kind, Tracking};
use seabearing_core::wire::{Fault, FaultCode};

/// `seabearing reproduce sea-surface`.
pub const SURFACE: Experiment = Experiment {
    name: "sea-surface",
    about: "passes with the surface's image: bearings, track ranges and headings in their 95 %",
    run: surface,
};

/// `seabearing reproduce sea-bottom`.
pub const BOTTOM: Experiment = Experiment {
    name: "sea-bottom",
    about: "passes with echoes off the bottom: one track a pass, range and heading in their 95 %",
    run: bottom,
};

const DURATION_S: f64 = 200.0;
/// Slower and faster vessels are drawn again, m/s.
const SPEEDS_M_S: std::ops::RangeInclusive<f64> = 3.0..=12.0;
/// Vessels' propellers are so deep, metres.
const DEPTHS_M: std::ops::Range<f64> = 2.0..8.0;
/// Amplitude that a surface with waves gives back.
const REFLECTIONS: std::ops::Range<f64> = 0.6..1.0;
/// Arrays are built so far from the regular tetrahedron, metres.
const UNEVEN_M: f64 = 0.05;
/// A heading may err by so much over a bottom, degrees.
const HEADING_DEG: f64 = 1.0;

/// What one scene gave.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pass {
    pub(super) bearings: Held,
    pub(super) azimuths: Held,
    pub(super) headings: Held,
    pub(super) ranges: Held,
    vessels: usize,
    /// End-of-passage solutions.
    pub(super) tracks: usize,
    /// Scenes with as many of them as vessels.
    whole: Held,
    /// Largest error of a heading, degrees.
    worst_deg: f64,
    /// Faults of channels and of geometry, of which there are none.
    pub(super) faults: usize,
}

impl Pass {
    pub(super) fn join(mut self, other: Self) -> Self {
        self.bearings.join(other.bearings);
        self.azimuths.join(other.azimuths);
        self.headings.join(other.headings);
        self.ranges.join(other.ranges);
        self.whole.join(other.whole);
        self.vessels += other.vessels;
        self.tracks += other.tracks;
        self.faults += other.faults;
        self.worst_deg = self.worst_deg.max(other.worst_deg);
        self
    }

    /// Plays a scene and scores it. Bearings of the whole band count for the vessel nearest in azimuth.
    fn of(scene: &ArrayScenario) -> Result<Self> {
        let said = play(scene)?;
        let mut pass = Self { vessels: scene.vessels.len(), ..Self::default() };
        let of_channels = |f: &&Fault| !matches!(f.code, FaultCode::Impulses | FaultCode::SpeedContradicted);
        pass.faults = said.faults.iter().filter(of_channels).count();
        let rate = scene.station.config.rate_hz;
        for b in said.bearings.iter().filter(|b| b.band == 0) {
            let t_s = b.index as f64 / rate;
            let mut nearest: Option<(f64, f64)> = None;
            for vessel in &scene.vessels {
                let at = arrival(scene, vessel, t_s)?;
                let off = |a: f64| wrap_pi(f64::from(b.azimuth) - a).abs();
                if nearest.is_none_or(|n| off(at.0) < off(n.0)) {
                    nearest = Some(at);
                }
            }
            let Some(at) = nearest else { continue };
            pass.bearings.take(miss(b, at).0 <= ELLIPSE);
            pass.azimuths.take(holds_azimuth(b, at.0));
        }
        for t in said.passages() {
            pass.tracks += 1;
            let error = |s: &Straight| wrap_pi(f64::from(t.heading) - s.heading_deg.to_radians());
            let courses = scene.vessels.iter().filter_map(|v| v.straight);
            let Some(course) = courses.min_by(|a, b| error(a).abs().total_cmp(&error(b).abs())) else {
                continue;
            };
            let heading = error(&course).abs();
            pass.headings.take(heading <= 1.96 * f64::from(t.sd_heading));
            let range = (f64::from(t.cpa_range_m) - course.cpa_range_m).abs();
            pass.ranges.take(range <= 1.96 * f64::from(t.sd_cpa_range_m));
            pass.worst_deg = pass.worst_deg.max(heading.to_degrees());
        }
        pass.whole.take(pass.tracks == pass.vessels);
        Ok(pass)
    }
}

/// A vessel on a random course past the array.
fn random(rng: &mut ChaCha8Rng, cpa_range_m: f64) -> Result<ArrayVessel> {
    let usual = Tracking::default();
    let speeds = Normal::new(usual.speed_m_s, usual.speed_sd_m_s)?;
    let mut speed_m_s = 0.0;
    while !SPEEDS_M_S.contains(&speed_m_s) {
        speed_m_s = speeds.sample(rng);
    }
    let course = Straight {
        cpa_time_s: rng.random_range(0.4 * DURATION_S..0.6 * DURATION_S),
        cpa_range_m,
        heading_deg: rng.random_range(0.0..360.0),
        speed_m_s,
        side: side(rng.random()),
    };
    Ok(ArrayVessel { depth_m: rng.random_range(DEPTHS_M), ..ferry(course) })
}

/// The scenes of the examples: the demo's pass, and two vessels that cross.
fn examples(seed: u64, rate_hz: f64) -> [ArrayScenario; 2] {
    let course = |cpa_time_s, cpa_range_m, heading_deg, speed_m_s, port| Straight {
        cpa_time_s,
        cpa_range_m,
        heading_deg,
        speed_m_s,
        side: side(port),
    };
    let demo = ferry(course(100.0, 500.0, 30.0, 7.0, false));
    let tug = ArrayVessel { source_level_db: 166.0, ..ferry(course(110.0, 350.0, 200.0, 4.5, true)) };
    let tanker = ArrayVessel {
        source_level_db: 178.0,
        depth_m: 7.0,
        ..ferry(course(180.0, 900.0, 310.0, 7.8, false))
    };
    let scene = |vessels, duration_s| {
        scenario(station(rate_hz, 168.0, |_| {}), Water::default(), vessels, duration_s, seed)
    };
    [scene(vec![demo], DURATION_S), scene(vec![tug, tanker], 300.0)]
}

/// All passes of a list of scenes.
pub(super) fn all(what: &str, scenes: &[ArrayScenario]) -> Result<Vec<Pass>> {
    let bar = progress::bar(scenes.len() as u64, what);
    let passes = scenes
        .par_iter()
        .map(|scene| {
            let pass = Pass::of(scene);
            bar.inc(1);
            pass
        })
        .collect();
    bar.finish_and_clear();
    passes
}

fn surface(options: &Options) -> Result<()> {
    let mut report = CsvReport::new(
        "sea_surface",
        "rate_khz,depth_m,cpa_m,passes,tracks,ellipse_%,azimuth_%,heading_%,range_%,worst_heading_deg,faults",
    );
    for (rate_hz, rate) in RATES {
        surface_at(rate_hz, rate, options, &mut report)?;
    }
    report.finish(options)
}

fn surface_at(rate_hz: f64, rate: &str, options: &Options, report: &mut CsvReport) -> Result<()> {
    let runs = options.runs.unwrap_or(1);
    let figures = &options.figures;
    let mut line = |depth_m: f64, cpa_m: f64, p: &Pass| {
        report.row(&[
            rate_hz / 1000.0,
            depth_m,
            cpa_m,
            p.vessels as f64,
            p.tracks as f64,
            p.bearings.percent(),
            p.azimuths.percent(),
            p.headings.percent(),
            p.ranges.percent(),
            p.worst_deg,
            p.faults as f64,
        ]);
    };
    for (name, pass) in ["demo", "two vessels"].iter().zip(all("examples", &examples(options.seed, rate_hz))?)
    {
        line(168.0, f64::NAN, &pass);
        let bar = Bar::Within(92.0, 97.0);
        figures.report(format!("{rate}, {name}: bearings in their ellipse, %"), pass.bearings.percent(), bar);
        figures.report(format!("{rate}, {name}: azimuths in their band, %"), pass.azimuths.percent(), bar);
    }
    let (mut places, mut scenes) = (Vec::new(), Vec::new());
    for depth_m in [60.0, 168.0] {
        for cpa_m in [200.0, 500.0, 1000.0] {
            places.push((depth_m, cpa_m));
            for n in 0..runs as u64 {
                let seed = options.seed.wrapping_mul(9_000_011) + n * 10_000_000 + (depth_m + cpa_m) as u64;
                let vessel = random(&mut ChaCha8Rng::seed_from_u64(seed), cpa_m)?;
                let config = station(rate_hz, depth_m, |_| {});
                scenes.push(scenario(config, Water::default(), vec![vessel], DURATION_S, seed));
            }
        }
    }
    let passes = all("passes", &scenes)?;
    // The same passes below waves, which give back less of the sound.
    for scene in &mut scenes {
        scene.scene.seed = scene.scene.seed.wrapping_mul(3) + 1;
        let mut rng = ChaCha8Rng::seed_from_u64(scene.scene.seed);
        scene.scene.water.surface_reflection = -rng.random_range(REFLECTIONS);
    }
    let rough = all("waves", &scenes)?.into_iter().fold(Pass::default(), Pass::join);
    let mut total = Pass::default();
    for ((depth_m, cpa_m), passes) in places.iter().zip(passes.chunks(runs)) {
        let pass = passes.iter().copied().fold(Pass::default(), Pass::join);
        line(*depth_m, *cpa_m, &pass);
        total = total.join(pass);
    }
    let bar = Bar::Within(92.0, 97.0);
    figures.report(format!("{rate}, passes: bearings in their ellipse, %"), total.bearings.percent(), bar);
    total.headings.report(figures, &format!("{rate}, headings in their 95 %"));
    total.ranges.report(figures, &format!("{rate}, ranges in their 95 %"));
    figures.at_least(format!("{rate}, passes with one track, %"), total.whole.percent(), 100.0);
    let faults = (total.faults + rough.faults) as f64;
    figures.at_most(format!("{rate}, faults of channels that are well"), faults, 0.0);
    figures.report(
        format!("{rate}, surface that gives back 0.6 to 1: bearings in their ellipse, %"),
        rough.bearings.percent(),
        bar,
    );
    Ok(())
}

/// Vessels 3 and 4 m deep over a bottom 2 m below the array: its echo comes about as late as the surface's image.
fn near_bottom(seed: u64, runs: usize, rate_hz: f64) -> Result<Vec<ArrayScenario>> {
    let mut scenes = Vec::new();
    for (k, depth_m) in [3.0, 4.0].into_iter().enumerate() {
        for (j, bottom_reflection) in [0.3, 0.5].into_iter().enumerate() {
            for (i, cpa_m) in [300.0, 500.0, 700.0].into_iter().enumerate() {
                for n in 0..runs {
                    let seed = seed.wrapping_mul(9_000_017) + (((k * 2 + j) * 3 + i) * 1000 + n) as u64;
                    let vessel = random(&mut ChaCha8Rng::seed_from_u64(seed), cpa_m)?;
                    let vessel = ArrayVessel { depth_m, ..vessel };
                    let water = Water { bottom_reflection, bottom_below_m: 2.0, ..Water::default() };
                    let config = station(rate_hz, 168.0, |_| {});
                    scenes.push(scenario(config, water, vec![vessel], DURATION_S, seed));
                }
            }
        }
    }
    Ok(scenes)
}

/// The same scene heard 60 m deep by an array whose hydrophones stand elsewhere, as told.
fn uneven(scene: &ArrayScenario) -> ArrayScenario {
    let mut scene = scene.clone();
    let mut rng = ChaCha8Rng::seed_from_u64(scene.scene.seed ^ 0x0dd);
    scene.station.config.depth_m = 60.0;
    if let Kind::Array(array) = &mut scene.station.config.kind {
        array.hydrophones_m.iter_mut().flatten().for_each(|x| *x += rng.random_range(-UNEVEN_M..UNEVEN_M));
    }
    scene
}

fn bottom(options: &Options) -> Result<()> {
    let mut report = CsvReport::new(
        "sea_bottom",
        "rate_khz,below_m,coefficient,cpa_m,tracks,heading_%,range_%,worst_heading_deg,ellipse_%,faults",
    );
    for (rate_hz, rate) in RATES {
        bottom_at(rate_hz, rate, options, &mut report)?;
    }
    report.finish(options)
}

fn bottom_at(rate_hz: f64, rate: &str, options: &Options, report: &mut CsvReport) -> Result<()> {
    let runs = options.runs.unwrap_or(1);
    let mut cases = Vec::new();
    for below_m in [2.0, 8.0, 30.0] {
        for (coefficient, at) in [(0.3, 0usize), (0.5, 1)] {
            for n in 0..runs {
                // Closest points take turns.
                let cpa_m = [300.0, 500.0, 700.0][(cases.len() + at + n) % 3];
                let seed = options.seed.wrapping_mul(9_000_013) + 1000 * cases.len() as u64;
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let water =
                    Water { bottom_reflection: coefficient, bottom_below_m: below_m, ..Water::default() };
                let config = station(rate_hz, 168.0, |_| {});
                let scene = scenario(config, water, vec![random(&mut rng, cpa_m)?], DURATION_S, seed);
                cases.push((below_m, coefficient, cpa_m, scene));
            }
        }
    }
    let scenes: Vec<_> = cases.iter().map(|c| c.3.clone()).collect();
    let passes = all("passes", &scenes)?;
    let shallow = all("shallow vessels", &near_bottom(options.seed, runs, rate_hz)?)?;
    let uneven: Vec<_> = scenes.iter().map(uneven).collect();
    let uneven = all("uneven arrays", &uneven)?.into_iter().fold(Pass::default(), Pass::join);
    for ((below_m, coefficient, cpa_m, _), p) in cases.iter().zip(&passes) {
        report.row(&[
            rate_hz / 1000.0,
            *below_m,
            *coefficient,
            *cpa_m,
            p.tracks as f64,
            p.headings.percent(),
            p.ranges.percent(),
            p.worst_deg,
            p.bearings.percent(),
            p.faults as f64,
        ]);
    }
    let total = passes.into_iter().fold(Pass::default(), Pass::join);
    let figures = &options.figures;
    figures.at_least(format!("{rate}, passes with one track, %"), total.whole.percent(), 100.0);
    figures.at_most(format!("{rate}, worst heading, deg"), total.worst_deg, HEADING_DEG);
    total.headings.report(figures, &format!("{rate}, headings in their 95 %"));
    total.ranges.report(figures, &format!("{rate}, ranges in their 95 %"));
    figures.at_most(format!("{rate}, faults of channels that are well"), total.faults as f64, 0.0);
    figures.state(format!("{rate}, bearings in their ellipse, %"), total.bearings.percent());
    let shallow = shallow.into_iter().fold(Pass::default(), Pass::join);
    let bar = Bar::Within(92.0, 97.0);
    let name = format!("{rate}, 3 and 4 m deep, bottom 2 m below: in their ellipse, %");
    figures.report(name, shallow.bearings.percent(), bar);
    let name = format!("{rate}, arrays 5 cm from a tetrahedron: in their ellipse, %");
    figures.report(name, uneven.bearings.percent(), bar);
    let name = format!("{rate}, arrays 5 cm from a tetrahedron: azimuths in their 95 %, %");
    figures.report(name, uneven.azimuths.percent(), bar);
    let name = format!("{rate}, arrays 5 cm from a tetrahedron: worst heading, deg");
    figures.at_most(name, uneven.worst_deg, HEADING_DEG);
    let name = format!("{rate}, arrays 5 cm from a tetrahedron: faults of channels that are well");
    figures.at_most(name, uneven.faults as f64, 0.0);
    Ok(())
}
