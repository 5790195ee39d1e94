//! `reproduce sea-vessels`: one to four vessels at once, from their sound: when each is tracked, by how many tracks, and tracks of nobody;
//! how often the strongest is told, and how often in a direction that is nobody's by what it states (most where two cross), and channels said to be
//! sick though all are well. And two side by side, nearer to each other than the array resolves all the way.
//!
//! The vessels are as loud as each other within 6 dB, pass 250 to 800 m away on courses at random and are all heard from the first
//! second on; some cross others in azimuth. A vessel counts as tracked from the first record whose position lies in its direction.

use super::figure::Bar;
use super::report::CsvReport;
use super::sea::{Held, RATE_HZ, arrival, ferry, play, scenario, side, station};
use super::{Experiment, Options};
use crate::progress;
use crate::scenario::Straight;
use crate::world::ArrayScenario;
use crate::world::scenario::{ArrayVessel, Water};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
use seabearing_core::kit::median;
use seabearing_core::wire::FaultCode;

/// `seabearing reproduce sea-vessels`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-vessels",
    about: "one to four vessels at once from their sound: when each is tracked; --runs: scenes of each kind (24 for the figures)",
    run,
};

const DURATION_S: f64 = 180.0;
const MOST: usize = 4;
/// In the place of how many there are: two side by side.
const BESIDE: usize = 0;
/// Levels of the vessels, dB re 1 µPa²/Hz at 1 kHz and 1 m.
const LEVELS_DB: std::ops::Range<f64> = 168.0..174.0;
/// A track farther from every vessel than this is nobody's, degrees.
const NEAR_DEG: f64 = 3.0;
/// Segments, of which each may tell a bearing of the strongest.
const SEGMENTS: f64 = 2.0 * DURATION_S;
/// What makes a bearing nobody's: so many of its standard deviations from every vessel, and degrees.
const WRONG_SD: f64 = 4.0;
const WRONG_DEG: f64 = 0.1;
/// How far apart two side by side are at the closest point, degrees: the array's resolution is 2.8°.
const BESIDE_DEG: std::ops::Range<f64> = 0.3..3.0;
/// A second vessel is to appear so soon, seconds.
const SOON_S: f64 = 20.0;

/// What the recorder said of a scene.
#[derive(Clone, Debug, Default)]
struct Scene {
    /// First record of each vessel, seconds; infinite where there is none.
    first_s: Vec<f64>,
    /// Last solutions, and those of them that are nobody's.
    tracks: usize,
    nobody: usize,
    headings: Held,
    ranges: Held,
    /// Bearings of the strongest, and those of them that are nobody's.
    strongest: usize,
    wrong: usize,
    /// Azimuths of the strongest.
    azimuths: Held,
    /// Channels said to be sick; all are well.
    faults: usize,
}

impl Scene {
    fn of(scene: &ArrayScenario) -> Result<Self> {
        let said = play(scene)?;
        let rate = scene.station.config.rate_hz;
        let mut out = Self { first_s: vec![f64::INFINITY; scene.vessels.len()], ..Self::default() };
        out.faults = said.faults.iter().filter(|f| f.code != FaultCode::Impulses).count();
        for bearing in said.bearings.iter().filter(|b| b.band == 0) {
            let t_s = bearing.index as f64 / rate;
            let mut off = f64::INFINITY;
            for vessel in &scene.vessels {
                let azimuth = arrival(scene, vessel, t_s)?.0;
                off = off.min(wrap_pi(f64::from(bearing.azimuth) - azimuth).abs());
            }
            let sd = f64::from(bearing.var_azimuth).sqrt();
            out.strongest += 1;
            out.wrong += usize::from(off > (WRONG_SD * sd).max(WRONG_DEG.to_radians()));
            out.azimuths.take(off <= 1.96 * sd);
        }
        for t in &said.tracks {
            let t_s = t.index as f64 / rate;
            let azimuth = f64::from(t.x_m).atan2(f64::from(t.y_m));
            let mut nearest = (f64::INFINITY, 0);
            for (v, vessel) in scene.vessels.iter().enumerate() {
                let off = wrap_pi(azimuth - arrival(scene, vessel, t_s)?.0).abs();
                if off < nearest.0 {
                    nearest = (off, v);
                }
            }
            let theirs = nearest.0 < NEAR_DEG.to_radians();
            if theirs {
                out.first_s[nearest.1] = out.first_s[nearest.1].min(t_s);
            }
            if t.stage != 1 {
                continue;
            }
            out.tracks += 1;
            out.nobody += usize::from(!theirs);
            let Some(course) = scene.vessels[nearest.1].straight.filter(|_| theirs) else { continue };
            if t.sd_heading.is_finite() {
                let heading = wrap_pi(f64::from(t.heading) - course.heading_deg.to_radians()).abs();
                out.headings.take(heading <= 1.96 * f64::from(t.sd_heading));
            }
            if t.range_observable {
                let range = (f64::from(t.cpa_range_m) - course.cpa_range_m).abs();
                out.ranges.take(range <= 1.96 * f64::from(t.sd_cpa_range_m));
            }
        }
        out.first_s.sort_by(f64::total_cmp);
        Ok(out)
    }
}

fn vessel(rng: &mut ChaCha8Rng) -> ArrayVessel {
    let course = Straight {
        cpa_time_s: rng.random_range(60.0..120.0),
        cpa_range_m: rng.random_range(250.0..800.0),
        heading_deg: rng.random_range(0.0..360.0),
        speed_m_s: rng.random_range(4.0..9.0),
        side: side(rng.random()),
    };
    ArrayVessel {
        depth_m: rng.random_range(3.0..6.0),
        source_level_db: rng.random_range(LEVELS_DB),
        ..ferry(course)
    }
}

/// A vessel beside another: on much the same course, a little ahead.
fn beside(rng: &mut ChaCha8Rng, other: &ArrayVessel) -> ArrayVessel {
    let mut vessel = vessel(rng);
    let apart = rng.random_range(BESIDE_DEG).to_radians();
    vessel.straight = other.straight.map(|course| Straight {
        cpa_time_s: course.cpa_time_s + apart * course.cpa_range_m / course.speed_m_s,
        cpa_range_m: course.cpa_range_m * rng.random_range(0.97..1.03),
        heading_deg: course.heading_deg + rng.random_range(-1.0..1.0),
        ..course
    });
    vessel
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(6);
    let figures = &options.figures;
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut scenes: Vec<(usize, ArrayScenario)> = Vec::new();
    for n in 1..=MOST {
        for _ in 0..runs {
            let vessels = (0..n).map(|_| vessel(&mut rng)).collect();
            let config = station(RATE_HZ, 168.0, |_| {});
            scenes.push((n, scenario(config, Water::default(), vessels, DURATION_S, rng.random())));
        }
    }
    for _ in 0..runs {
        let first = vessel(&mut rng);
        let second = beside(&mut rng, &first);
        let config = station(RATE_HZ, 168.0, |_| {});
        scenes.push((
            BESIDE,
            scenario(config, Water::default(), vec![first, second], DURATION_S, rng.random()),
        ));
    }
    let bar = progress::bar(scenes.len() as u64, "scenes");
    let said: Result<Vec<Scene>> = scenes
        .par_iter()
        .map(|(_, scene)| {
            let said = Scene::of(scene);
            bar.inc(1);
            said
        })
        .collect();
    bar.finish_and_clear();
    let said = said?;
    let mut report = CsvReport::new(
        "sea_vessels",
        "vessels,scenes,tracked_%,second_s,last_s,tracks,nobody,heading_%,range_%,strongest_%,wrong,faults",
    );
    for n in 1..=MOST {
        let of: Vec<&Scene> =
            scenes.iter().zip(&said).filter(|((count, _), _)| *count == n).map(|(_, said)| said).collect();
        let (mut tracked, mut soon) = (Held::default(), Held::default());
        let (mut headings, mut ranges) = (Held::default(), Held::default());
        let mut times: [Vec<f64>; 2] = Default::default();
        for scene in &of {
            scene.first_s.iter().for_each(|t| tracked.take(t.is_finite()));
            headings.join(scene.headings);
            ranges.join(scene.ranges);
            if let [_, second, ..] = scene.first_s[..] {
                soon.take(second <= SOON_S);
                times[0].push(second);
            }
            times[1].extend(scene.first_s.last());
        }
        let [second_s, last_s] = times.map(|mut t| median(&mut t).unwrap_or(f64::NAN));
        let tracks: usize = of.iter().map(|s| s.tracks).sum();
        let nobody: usize = of.iter().map(|s| s.nobody).sum();
        let faults: usize = of.iter().map(|s| s.faults).sum();
        let strongest: usize = of.iter().map(|s| s.strongest).sum();
        let wrong: usize = of.iter().map(|s| s.wrong).sum();
        let wrong_share = 100.0 * wrong as f64 / strongest.max(1) as f64;
        let told = strongest;
        let strongest = 100.0 * strongest as f64 / (SEGMENTS * of.len() as f64);
        report.row(&[
            n as f64,
            of.len() as f64,
            tracked.percent(),
            second_s,
            last_s,
            tracks as f64,
            nobody as f64,
            headings.percent(),
            ranges.percent(),
            strongest,
            wrong as f64,
            faults as f64,
        ]);
        figures.report(
            format!("{n} at once: vessels tracked, % of {}", tracked.of),
            tracked.percent(),
            Bar::AtLeast(95.0),
        );
        if n > 1 {
            figures.report(
                format!("{n} at once: second one tracked within 20 s, % of {}", soon.of),
                soon.percent(),
                Bar::AtLeast(90.0),
            );
            figures.report(
                format!("{n} at once: second one tracked after, median, s"),
                second_s,
                Bar::AtMost(SOON_S),
            );
            figures.report(format!("{n} at once: last one tracked after, median, s"), last_s, Bar::None);
        }
        figures.report(
            format!("{n} at once: last solutions of nobody, of {tracks}"),
            nobody as f64,
            Bar::AtMost(0.0),
        );
        figures.report(
            format!("{n} at once: segments that tell the strongest, %"),
            strongest,
            Bar::AtLeast(95.0),
        );
        figures.report(
            format!("{n} at once: bearings of nobody, % of {told}"),
            wrong_share,
            Bar::AtMost(0.5),
        );
        figures.report(
            format!("{n} at once: faults of channels that are well"),
            faults as f64,
            Bar::AtMost(0.0),
        );
        figures.report(
            format!("{n} at once: headings in their 95 %, % of {}", headings.of),
            headings.percent(),
            Bar::None,
        );
        figures.report(
            format!("{n} at once: ranges in their 95 %, % of {}", ranges.of),
            ranges.percent(),
            Bar::None,
        );
    }
    let of = || scenes.iter().zip(&said).filter(|((count, _), _)| *count == BESIDE).map(|(_, said)| said);
    let mut azimuths = Held::default();
    of().for_each(|scene| azimuths.join(scene.azimuths));
    let wrong: usize = of().map(|s| s.wrong).sum();
    figures.report(
        format!("two side by side: bearings of nobody, % of {}", azimuths.of),
        100.0 * wrong as f64 / azimuths.of.max(1) as f64,
        Bar::AtMost(0.5),
    );
    figures.report(
        format!("two side by side: azimuths of either in their 95 %, % of {}", azimuths.of),
        azimuths.percent(),
        Bar::Within(92.0, 97.0),
    );
    report.finish(options)
}
