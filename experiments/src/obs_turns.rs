//! Vessels that turn about their closest point: is each of their two courses told, and nobody's?
//!
//! A vessel past the station turns by 20 to 60° to either side, within five minutes of the closest point of its first course, 1 to 8 km off; 4 to
//! 10 m/s, six hours, what `obs-one-ship`'s vessels radiate, at the table's level and 5 dB below it. A final track is a course's if it is true
//! of the straight line that it lies on, by the bars of `obs-week`: its closest point may be one that the vessel, which turned before, has not
//! reached.

use super::obs_week::{Numbers, Stated, minutes, tracks, whose};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::course::{Steady, VesselCourse};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::Radiation;
use crate::ocean_bottom::simulate::{Extra, MovingVessel};
use crate::propagation::Propagation;
use crate::score::track;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::wire::Track;

/// The experiment.
pub const TURNS: Experiment = Experiment {
    name: "obs-turns",
    about: "ocean bottom: vessels that turn by 20 to 60° about their closest point; both courses told, none withdrawn, nobody's told",
    run,
};

/// Passes where the command line names no number.
const RUNS: usize = 20;

/// Length of a record, and about when vessels are nearest, s.
const RECORD_S: f64 = 21_600.0;
const NEAREST_S: f64 = 10_800.0;

/// Levels of the vessels against the table's, dB.
const VESSEL_DB: [f64; 2] = [0.0, -5.0];

/// Least share of the courses that have a final track, %.
const TOLD: f64 = 90.0;

/// A vessel that turns.
struct Turning {
    turn_deg: f64,
    range_m: f64,
    vessel: MovingVessel,
    /// Its two courses, straight on.
    legs: Vec<MovingVessel>,
}

impl Turning {
    fn of(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let cpa_s = NEAREST_S + rng.random_range(-900.0..900.0);
        let range_m = rng.random_range(1_000.0..8_000.0);
        let heading_deg: f64 = rng.random_range(0.0..360.0);
        let speed_m_s = rng.random_range(4.0..10.0);
        let first = VesselCourse::by_cpa(cpa_s, range_m, heading_deg.to_radians(), speed_m_s, rng.random());
        let turn_deg: f64 = rng.random_range(20.0..60.0) * if rng.random() { 1.0 } else { -1.0 };
        let turns_s = cpa_s + rng.random_range(-300.0..300.0);
        let (sine, cosine) = (heading_deg + turn_deg).to_radians().sin_cos();
        let turn = Steady {
            at_s: turns_s,
            place_m: first.position(turns_s),
            velocity_m_s: (speed_m_s * sine, speed_m_s * cosine),
        };
        let closest = closest_of(&turn);
        let after = VesselCourse::Straight(closest);
        let places = [0.0, turns_s, RECORD_S].map(|t_s| {
            let course = if t_s > turns_s { &after } else { &first };
            (t_s, course.position(t_s))
        });
        let vessel = |name: &str, course| MovingVessel { name: name.into(), course, active_s: (-1e9, 1e9) };
        Self {
            turn_deg,
            range_m,
            vessel: vessel("turns", VesselCourse::Fixes(places.to_vec())),
            legs: vec![vessel("before", first), vessel("after", after)],
        }
    }
}

/// The same motion, told by its closest point, as straight courses are.
fn closest_of(steady: &Steady) -> Steady {
    let ((x, y), (vx, vy)) = (steady.place_m, steady.velocity_m_s);
    let after_s = -(x * vx + y * vy) / (vx * vx + vy * vy);
    Steady {
        at_s: steady.at_s + after_s,
        place_m: (x + vx * after_s, y + vy * after_s),
        velocity_m_s: (vx, vy),
    }
}

/// What was told of one pass.
struct Told {
    turning: Turning,
    /// Of each course.
    finals: [usize; 2],
    of_nobody: usize,
    /// Tracks true of a course that were withdrawn.
    withdrawn: usize,
    numbers: Numbers,
    azimuth: Stated,
}

fn hear(table: &Propagation, seed: u64, vessel_db: f64) -> Result<Told> {
    let turning = Turning::of(seed);
    let mut radiation = Radiation::default();
    radiation.wideband_db += vessel_db;
    radiation.tone_db += vessel_db;
    let extra = vec![Extra { vessel: turning.vessel.clone(), radiation }];
    let case = Case::run(quiet(seed, RECORD_S), table, extra)?;
    let azimuth = Stated::sum(&minutes(&case).0);
    let (mut finals, mut of_nobody, mut withdrawn, mut numbers) = ([0; 2], 0, 0, Numbers::default());
    for t in tracks(&case) {
        let of = whose(&t, &turning.legs);
        match (t.stage, of) {
            (Track::FINAL, Some(leg)) => {
                finals[leg] += 1;
                if let Some(e) = track(&t, &turning.legs[leg].course) {
                    numbers.take(&t, &e);
                }
            }
            (Track::FINAL, None) => of_nobody += 1,
            (Track::WITHDRAWN, Some(_)) => withdrawn += 1,
            _ => {}
        }
    }
    Ok(Told { turning, finals, of_nobody, withdrawn, numbers, azimuth })
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let mut csv = CsvText::new(
        "vessel_db,seed,turn_deg,cpa_range_m,finals_before,finals_after,finals_of_nobody,withdrawn,numbers_in_95,azimuths,azimuths_in_95",
    );
    let figures = &options.figures;
    let runs = options.runs.unwrap_or(RUNS) as u64;
    for vessel_db in VESSEL_DB {
        let seeds: Vec<u64> = (0..runs).map(|i| options.seed + i).collect();
        let told: Vec<Told> =
            seeds.par_iter().map(|seed| hear(&table, *seed, vessel_db)).collect::<Result<_>>()?;
        for (seed, t) in seeds.iter().zip(&told) {
            let all = t.numbers.all();
            csv.row(&[
                &Fixed(vessel_db, 0),
                seed,
                &Fixed(t.turning.turn_deg, 0),
                &Fixed(t.turning.range_m, 0),
                &t.finals[0],
                &t.finals[1],
                &t.of_nobody,
                &t.withdrawn,
                &Fixed(all.percent(all.within), 0),
                &t.azimuth.said,
                &Fixed(t.azimuth.percent(t.azimuth.within), 1),
            ]);
        }
        let what = format!("vessel {vessel_db:+} dB");
        let sum = |of: &dyn Fn(&Told) -> usize| told.iter().map(of).sum::<usize>() as f64;
        let courses = sum(&|t| t.finals.iter().filter(|n| **n > 0).count());
        let share = 100.0 * courses / (2.0 * told.len() as f64);
        figures.at_least(format!("{what}: courses with a final track, %"), share, TOLD);
        figures.at_most(format!("{what}: true tracks withdrawn"), sum(&|t| t.withdrawn), 0.0);
        figures.at_most(format!("{what}: final tracks of nobody"), sum(&|t| t.of_nobody), 0.0);
        let all = Stated::sum(&told.iter().map(|t| t.numbers.all()).collect::<Vec<_>>());
        let name = format!("{what}: numbers of {} final tracks in their 95 %, %", all.said / 4);
        figures.report(name, all.percent(all.within), super::figure::Bar::Within(92.0, 97.0));
    }
    print(options, "obs-turns", csv)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_courses_meet_where_the_vessel_turns_and_differ_by_the_turn() {
        for seed in 0..20 {
            let t = Turning::of(seed);
            let VesselCourse::Fixes(fixes) = &t.vessel.course else { panic!("{:?}", t.vessel.course) };
            let turns_s = fixes[1].0;
            for (leg, at_s) in t.legs.iter().zip([turns_s - 3000.0, turns_s + 3000.0]) {
                let off = |t_s: f64| {
                    let (a, b) = (leg.course.position(t_s), t.vessel.course.position(t_s));
                    (a.0 - b.0).hypot(a.1 - b.1)
                };
                assert!(off(at_s) < 1e-6 && off(turns_s) < 1e-6, "seed {seed}");
            }
            let heading = |leg: usize| {
                let (e, n) = t.legs[leg].course.velocity(turns_s);
                e.atan2(n).to_degrees()
            };
            let turned = (heading(1) - heading(0) - t.turn_deg + 180.0).rem_euclid(360.0) - 180.0;
            assert!(turned.abs() < 1e-9 && (20.0..60.0).contains(&t.turn_deg.abs()), "seed {seed}: {turned}");
            // The straight course after it is told by its closest point.
            let VesselCourse::Straight(s) = &t.legs[1].course else { panic!("not straight") };
            let along = s.place_m.0 * s.velocity_m_s.0 + s.place_m.1 * s.velocity_m_s.1;
            assert!(along.abs() < 1e-6, "seed {seed}: {along}");
        }
    }
}
