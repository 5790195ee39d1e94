//! Vessels beyond an ocean-bottom station's ranges: tracks from azimuths and tones alone.
//!
//! Seeded vessels pass at 55 to 90 km, each alone in a record of twelve hours, and a quarter as many pairs of them at once; vessels come from 95 km to pass at 5 to 30 km; and a week of
//! whales, earthquakes, T phases, strumming and directional noise has none. Lines are [`TONE_DB`] above the sea in one bin at 20 km. What is told is held
//! against the courses: a track is a vessel's if its azimuths are in the median within 5° of where the vessel was. `--runs` is the number of
//! those that pass alone.

use super::figure::Bar;
use super::obs_noise_week::scenario as noise;
use super::obs_week::{NO_BAR, Stated};
use super::obs_world::{print, quiet, station_table};
use super::{Experiment, Options};
use crate::course::VesselCourse;
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::far::heard::Heard;
use crate::ocean_bottom::far::tones::{Listener, Tapped};
use crate::ocean_bottom::far::{Known, Place, Track, tracks};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, Radiation, Side, Straight};
use crate::ocean_bottom::simulate::{MovingVessel, Simulator};
use crate::ocean_bottom::{run as chain, station};
use crate::propagation::Propagation;
use crate::score::{median, then};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;

/// The experiment.
pub const FAR: Experiment = Experiment {
    name: "obs-far",
    about: "vessels at 55 to 90 km by azimuths and tones alone, one that comes nearer, a week of nobody (--runs RECORDS)",
    run,
};

/// Vessels at 55 to 90 km, each alone, where the command line names no number.
const RUNS: usize = 40;

/// Length of a record, s.
const RECORD_S: f64 = 43_200.0;

/// Height of the lines above the sea in one bin, at 20 km, dB: what is heard of a loud merchant vessel at 80 km.
const TONE_DB: f64 = 32.0;

/// Wideband noise at 20 km, dB.
const WIDEBAND_DB: f64 = 5.0;

/// A track is a vessel's if its azimuths are no farther off in the median, rad.
const OWN: f64 = 0.087;

/// Days without a vessel.
const QUIET_DAYS: usize = 7;

/// What came of a record.
struct Case {
    vessels: Vec<MovingVessel>,
    tracks: Vec<Track>,
    whose: Vec<Option<usize>>,
}

fn hear(scenario: ObsScenario, table: &Propagation) -> Result<Case> {
    let config = station::config(&scenario)?;
    let (paths, rate_hz) = (scenario.paths, scenario.rate_hz);
    let mut simulator = Simulator::new(scenario, table.clone(), Vec::new())?;
    let vessels = simulator.vessels.clone();
    let mut tapped = Tapped { source: &mut simulator, listener: Listener::new(&config)? };
    let mut heard = Heard::default();
    chain::run(&config, table, &mut tapped, &mut |m| heard.take(&m, rate_hz))?;
    let place = Place {
        sound_speed_m_s: 1500.0,
        depth_m: Some(table.depth_m),
        orientation_sd: 0.0,
        table: Some(table),
    };
    let tracks = tracks(&heard, &tapped.listener.minutes, &place);
    let off = |t: &Track, v: &MovingVessel| {
        let error = |t_s: f64, azimuth: f64| {
            then(table, paths, v, t_s).map_or(3.0, |then| wrap_pi(azimuth - then.azimuth).abs())
        };
        median(t.directions.iter().map(|d| error(d.t_s, d.azimuth)).collect())
    };
    let whose = tracks.iter().map(|t| (0..vessels.len()).find(|i| off(t, &vessels[*i]) < OWN)).collect();
    Ok(Case { vessels, tracks, whose })
}

fn vessel(rng: &mut ChaCha8Rng, cpa_range_m: std::ops::Range<f64>) -> ObsVessel {
    let factor = rng.random_range(0.93..1.07);
    let plain = Radiation::default();
    ObsVessel {
        name: String::new(),
        straight: Straight {
            cpa_time_s: RECORD_S * rng.random_range(0.35..0.65),
            cpa_range_m: rng.random_range(cpa_range_m),
            heading_deg: rng.random_range(0.0..360.0),
            speed_m_s: rng.random_range(5.0..10.0),
            side: if rng.random() { Side::Starboard } else { Side::Port },
        },
        active_s: [-1e9, 1e9],
        radiation: Radiation {
            wideband_db: WIDEBAND_DB,
            tone_db: TONE_DB,
            tones_hz: plain.tones_hz.iter().map(|f| f * factor).collect(),
            ..plain
        },
    }
}

/// Numbers that were told, against the truth.
#[derive(Default)]
struct Told {
    azimuth: Stated,
    heading: Stated,
    time: Stated,
    scale: Stated,
    speed: Stated,
    range: Stated,
    errors: Vec<f64>,
    off: Vec<f64>,
}

fn take(stated: &mut Stated, known: Known, truth: f64) {
    stated.take(known.value - truth, known.sd as f32, NO_BAR);
}

impl Told {
    fn take(&mut self, t: &Track, course: &VesselCourse) {
        let cpa = course.cpa(0.0, RECORD_S);
        let (x, y) = course.position(cpa.time_s);
        let (vx, vy) = course.velocity(cpa.time_s);
        let speed = vx.hypot(vy);
        if let Some(c) = t.closest {
            let turned = |k: Known, truth: f64| Known { value: wrap_pi(k.value - truth), ..k };
            take(&mut self.azimuth, turned(c.azimuth, x.atan2(y)), 0.0);
            take(&mut self.heading, turned(c.heading, vx.atan2(vy)), 0.0);
            take(&mut self.time, c.time_s, cpa.time_s);
            self.errors.push(wrap_pi(c.heading.value - vx.atan2(vy)).abs().to_degrees());
            if let Some(q) = c.speed_over_range {
                take(&mut self.scale, q, speed / cpa.range_m);
            }
        }
        if let Some((v, r)) = t.speed_m_s.zip(t.range_m) {
            take(&mut self.speed, v, speed);
            take(&mut self.range, r, cpa.range_m);
            self.off.push(100.0 * (r.value / cpa.range_m - 1.0).abs());
        }
    }
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let runs = options.runs.unwrap_or(RUNS) as u64;
    let of_seed =
        |kind: u64, k: u64| ChaCha8Rng::seed_from_u64(options.seed.wrapping_mul(1009) + 100_000 * kind + k);
    let heard = |kind: u64, ranges: std::ops::Range<f64>, count: usize| -> Result<Vec<Case>> {
        let cases = (0..if kind == 1 { runs } else { runs.div_ceil(4) }).into_par_iter().map(|k| {
            let mut rng = of_seed(kind, k);
            let vessels = (0..count).map(|_| vessel(&mut rng, ranges.clone())).collect();
            hear(ObsScenario { vessels, ..quiet(options.seed + 31 * k + 1_000 * kind, RECORD_S) }, &table)
        });
        cases.collect()
    };
    let far = heard(1, 55_000.0..90_000.0, 1)?;
    let pairs = heard(3, 55_000.0..90_000.0, 2)?;
    let near = heard(2, 5_000.0..30_000.0, 1)?;
    let nobody = hear(noise(options.seed, QUIET_DAYS), &table)?;
    let mut csv = CsvText::new(
        "kind,record,closest_km,speed_m_s,tracks,azimuths,hours,ranges,tones,heading_error_deg,sd_heading_deg,cpa_time_error_s,speed_over_range_ratio,told_speed_m_s,sd_speed_m_s,told_range_km,scale",
    );
    let mut told = [Told::default(), Told::default(), Told::default()];
    let (mut found, mut one, mut ranged, mut ghosts) = ([0usize; 3], [0usize; 3], 0usize, [0usize; 3]);
    for (kind, cases) in [&far, &near, &pairs].into_iter().enumerate() {
        for (k, case) in cases.iter().enumerate() {
            ghosts[kind] += case.whose.iter().filter(|w| w.is_none()).count();
            for (i, v) in case.vessels.iter().enumerate() {
                let own: Vec<&Track> = case
                    .tracks
                    .iter()
                    .zip(&case.whose)
                    .filter(|(_, w)| **w == Some(i))
                    .map(|x| x.0)
                    .collect();
                found[kind] += usize::from(!own.is_empty());
                one[kind] += usize::from(own.len() == 1);
                let longest = own.iter().max_by_key(|t| t.directions.len());
                ranged +=
                    usize::from(kind == 1 && longest.is_some_and(|t| t.scale.is_some() && t.ranges > 0));
                own.iter().for_each(|t| told[kind].take(t, &v.course));
                row(&mut csv, ["far", "coming", "two"][kind], k, v, own.len(), longest.copied());
            }
        }
    }
    print(options, "obs-far", csv)?;
    let figures = &options.figures;
    let share = |n: usize, of: usize| 100.0 * n as f64 / of.max(1) as f64;
    let (far_n, near_n, pairs_n) = (far.len(), near.len(), 2 * pairs.len());
    figures.at_least("vessels at 55 to 90 km found, %", share(found[0], far_n), 90.0);
    figures.at_least("of them in one track, %", share(one[0], found[0]), 95.0);
    let within = Bar::Within(92.0, 97.0);
    let [of_far, of_near, of_two] = &told;
    let names = ["azimuth of the closest point", "heading", "time of the closest point", "speed over range"];
    let stated = [of_far.azimuth, of_far.heading, of_far.time, of_far.scale];
    for (name, s) in names.into_iter().zip(stated) {
        figures.state(format!("{name}: told, of vessels at 55 to 90 km, %"), share(s.said, far_n));
        figures.report(format!("{name}: truth in the stated 95 %"), s.percent(s.within), within);
    }
    // What of the paths' slowness is not known is no error here, for sound goes by the same table: deviations can only be too large.
    for (name, s) in [("speed by tones", of_far.speed), ("range by tones", of_far.range)] {
        figures.state(format!("{name}: told, of vessels at 55 to 90 km, %"), share(s.said, far_n));
        figures.at_least(format!("{name}: truth in the stated 95 %"), s.percent(s.within), 92.0);
    }
    figures.state("median error of heading, deg", median(of_far.errors.clone()));
    figures.state("median error of range by tones, %", median(of_far.off.clone()));
    figures.at_least(
        "vessels that come from 95 km to 5 to 30 km: one track, %",
        share(one[1], near_n),
        100.0,
    );
    figures.state("the same: ranges taken, %", share(ranged, near_n));
    figures.at_most(
        "the same: worst error of range, %",
        of_near.off.iter().copied().fold(0.0, f64::max),
        5.0,
    );
    for (name, s) in [("heading", of_near.heading), ("range", of_near.range), ("speed", of_near.speed)] {
        figures.at_least(format!("the same, {name}: truth in the stated 95 %"), s.percent(s.within), 92.0);
    }
    figures.state("two at 55 to 90 km at once: found, %", share(found[2], pairs_n));
    figures.state("the same: heading told, %", share(of_two.heading.said, pairs_n));
    let inside = of_two.heading.percent(of_two.heading.within);
    figures.state("the same, heading: truth in the stated 95 %", inside);
    figures.at_most("tracks of nobody, one vessel at a time", (ghosts[0] + ghosts[1]) as f64, 0.0);
    figures.at_most("tracks of nobody, two at once", ghosts[2] as f64, 0.0);
    figures.at_most("tracks in a week without vessels", nobody.tracks.len() as f64, 0.0);
    Ok(())
}

fn row(csv: &mut CsvText, kind: &str, k: usize, v: &MovingVessel, n: usize, t: Option<&Track>) {
    let cpa = v.course.cpa(0.0, RECORD_S);
    let (vx, vy) = v.course.velocity(cpa.time_s);
    let speed = vx.hypot(vy);
    let closest = t.and_then(|t| t.closest);
    let number = |x: Option<f64>| x.unwrap_or(f64::NAN);
    let span_h = t.and_then(|t| Some((t.directions.last()?.t_s - t.directions.first()?.t_s) / 3600.0));
    let scale = closest.and_then(|c| c.speed_over_range);
    csv.row(&[
        &kind,
        &k,
        &Fixed(cpa.range_m / 1e3, 1),
        &Fixed(speed, 1),
        &n,
        &t.map_or(0, |t| t.directions.len()),
        &Fixed(number(span_h), 1),
        &t.map_or(0, |t| t.ranges),
        &t.map_or(0, |t| t.tones.len()),
        &Fixed(number(closest.map(|c| wrap_pi(c.heading.value - vx.atan2(vy)).to_degrees())), 2),
        &Fixed(number(closest.map(|c| c.heading.sd.to_degrees())), 2),
        &Fixed(number(closest.map(|c| c.time_s.value - cpa.time_s)), 0),
        &Fixed(number(scale.map(|q| q.value * cpa.range_m / speed)), 3),
        &Fixed(number(t.and_then(|t| t.speed_m_s).map(|k| k.value)), 2),
        &Fixed(number(t.and_then(|t| t.speed_m_s).map(|k| k.sd)), 2),
        &Fixed(number(t.and_then(|t| t.range_m).map(|k| k.value / 1e3)), 1),
        &t.and_then(|t| t.scale).map_or("-", |s| s.name()),
    ]);
}
