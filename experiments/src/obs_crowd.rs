//! Three to five vessels within two hours, at the table's level and below it: is each told, and nobody's course?
//!
//! Closest points 2 to 25 km off at 3.5 to 10.5 m/s in any direction, all of them within two hours; each within 3 dB of the scene's level, with lines
//! of its own that may be another's too; twelve hours. Their azimuths cross, and the ranges of one may lie on the course of another. A final
//! track is a vessel's by the bars of `obs-week`; one with its time and heading, but another range, is its course at another pair of paths.

use super::figure::Bar;
use super::obs_week::{Numbers, Stated, minutes, tracks, whose};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, Radiation, Side, Straight};
use crate::progress;
use crate::propagation::Propagation;
use crate::score::{owner, track};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::wire::Track;

/// The experiment.
pub const CROWD: Experiment = Experiment {
    name: "obs-crowd",
    about: "ocean bottom: three to five vessels within two hours, as strong as the table's and 5 and 10 dB weaker; each told, and no course of nobody",
    run,
};

/// Scenes of each level where the command line names no number.
const RUNS: usize = 12;

/// Length of a record, when the vessels are nearest, and how far before and after, s.
const RECORD_S: f64 = 43_200.0;
const NEAREST_S: f64 = 21_600.0;
const WITHIN_S: f64 = 3_600.0;

/// Levels of the scenes against the table's, dB, and the least share of the vessels told, %.
const LEVELS: [(f64, f64); 3] = [(0.0, 90.0), (-5.0, 90.0), (-10.0, 50.0)];

/// How far a vessel's level is from the scene's, dB.
const APART_DB: f64 = 3.0;

fn vessel(rng: &mut ChaCha8Rng, number: usize, level_db: f64) -> ObsVessel {
    let plain = Radiation::default();
    let db = level_db + rng.random_range(-APART_DB..APART_DB);
    let lines = rng.random_range(3..=6);
    ObsVessel {
        name: format!("vessel-{number}"),
        straight: Straight {
            cpa_time_s: NEAREST_S + rng.random_range(-WITHIN_S..WITHIN_S),
            cpa_range_m: rng.random_range(2_000.0..25_000.0),
            heading_deg: rng.random_range(0.0..360.0),
            speed_m_s: rng.random_range(3.5..10.5),
            side: if rng.random() { Side::Starboard } else { Side::Port },
        },
        active_s: [-1e9, 1e9],
        radiation: Radiation {
            wideband_db: plain.wideband_db + db,
            tone_db: plain.tone_db + db,
            tones_hz: (0..lines).map(|_| rng.random_range(8.0..23.0)).collect(),
            ..plain
        },
    }
}

fn scene(seed: u64, level_db: f64) -> ObsScenario {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let vessels = rng.random_range(3..=5);
    let vessels = (1..=vessels).map(|number| vessel(&mut rng, number, level_db)).collect();
    ObsScenario { vessels, ..quiet(seed, RECORD_S) }
}

/// What was told of one scene.
struct Told {
    vessels: usize,
    /// Vessels with a final track.
    found: usize,
    finals: usize,
    /// Final tracks of no vessel, and among them those of a vessel's time and heading.
    wrong: usize,
    at_another_range: usize,
    withdrawn: usize,
    numbers: Numbers,
    azimuth: Stated,
}

fn hear(table: &Propagation, seed: u64, level_db: f64) -> Result<Told> {
    let case = Case::run(scene(seed, level_db), table, Vec::new())?;
    let mut found = vec![false; case.vessels.len()];
    let mut out = Told {
        vessels: found.len(),
        found: 0,
        finals: 0,
        wrong: 0,
        at_another_range: 0,
        withdrawn: tracks(&case).filter(|t| t.stage == Track::WITHDRAWN).count(),
        numbers: Numbers::default(),
        azimuth: Stated::sum(&minutes(&case).0),
    };
    for t in tracks(&case).filter(|t| t.stage == Track::FINAL) {
        out.finals += 1;
        match whose(&t, &case.vessels) {
            Some(vessel) => {
                found[vessel] = true;
                if let Some(e) = track(&t, &case.vessels[vessel].course) {
                    out.numbers.take(&t, &e);
                }
            }
            None => {
                out.wrong += 1;
                out.at_another_range += usize::from(owner(&t, &case.vessels).is_some());
            }
        }
    }
    out.found = found.iter().filter(|found| **found).count();
    Ok(out)
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let mut csv = CsvText::new(
        "vessel_db,seed,vessels,found,finals,wrong,at_another_range,withdrawn,numbers_in_95,azimuths,azimuths_in_95",
    );
    let figures = &options.figures;
    let seeds: Vec<u64> = (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i).collect();
    let bar = progress::bar((LEVELS.len() * seeds.len()) as u64, "scenes");
    for (level_db, least) in LEVELS {
        let one = |seed: &u64| {
            let told = hear(&table, *seed, level_db);
            bar.inc(1);
            told
        };
        let told: Vec<Told> = seeds.par_iter().map(one).collect::<Result<_>>()?;
        for (seed, t) in seeds.iter().zip(&told) {
            let all = t.numbers.all();
            csv.row(&[
                &Fixed(level_db, 0),
                seed,
                &t.vessels,
                &t.found,
                &t.finals,
                &t.wrong,
                &t.at_another_range,
                &t.withdrawn,
                &Fixed(all.percent(all.within), 0),
                &t.azimuth.said,
                &Fixed(t.azimuth.percent(t.azimuth.within), 1),
            ]);
        }
        let what = format!("vessels {level_db:+} dB");
        let sum = |of: &dyn Fn(&Told) -> usize| told.iter().map(of).sum::<usize>();
        let (vessels, finals) = (sum(&|t| t.vessels), sum(&|t| t.finals));
        let share = 100.0 * sum(&|t| t.found) as f64 / vessels as f64;
        figures.at_least(format!("{what}: of {vessels} found, %"), share, least);
        figures.at_most(format!("{what}: of {finals} final tracks wrong"), sum(&|t| t.wrong) as f64, 0.0);
        let name = format!("{what}: among these of a vessel's time and heading");
        figures.state(name, sum(&|t| t.at_another_range) as f64);
        let all = Stated::sum(&told.iter().map(|t| t.numbers.all()).collect::<Vec<_>>());
        let name = format!("{what}: numbers of the others in their 95 %, %");
        figures.report(name, all.percent(all.within), Bar::Within(92.0, 97.0));
        let azimuth = Stated::sum(&told.iter().map(|t| t.azimuth).collect::<Vec<_>>());
        let name = format!("{what}: azimuths in their 95 %, %");
        figures.report(name, azimuth.percent(azimuth.within), Bar::Within(92.0, 97.0));
    }
    bar.finish_and_clear();
    print(options, "obs-crowd", csv)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_its_seeds_and_its_vessels_pass_within_two_hours() {
        for seed in 0..20 {
            let (one, again) = (scene(seed, -5.0), scene(seed, -5.0));
            assert!((3..=5).contains(&one.vessels.len()));
            for (a, b) in one.vessels.iter().zip(&again.vessels) {
                assert_eq!(a.straight.cpa_time_s, b.straight.cpa_time_s);
                assert!((a.straight.cpa_time_s - NEAREST_S).abs() <= WITHIN_S);
                let off = a.radiation.tone_db - Radiation::default().tone_db + 5.0;
                assert!(off.abs() <= APART_DB, "{off}");
            }
        }
    }
}
