//! Vessels one after the other: six-hour records of one, and days of three, the vessels of `obs-one-ship`. Of all that is told as
//! detected, how much is wrong, and how much of it has the truth in its 95 %.

use super::figure::Bar;
use super::obs_week::{Numbers, Stated, minutes, tracks, whose};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel};
use crate::propagation::Propagation;
use crate::score::track_passed;
use anyhow::Result;
use rayon::prelude::*;
use seabearing_core::wire::Track;

/// The experiment.
pub const DAY: Experiment = Experiment {
    name: "obs-day",
    about: "ocean bottom: six hours with a vessel, and a day with three: wrong azimuths and ranges of all told, tracks, 95 %",
    run,
};

/// Records of each kind where the command line names no number.
const RUNS: usize = 6;

const HOUR_S: f64 = 3600.0;

/// A kind of record: its name, its length, and when its vessels pass, give or take a quarter of an hour.
struct Kind {
    name: &'static str,
    hours: f64,
    pass_h: &'static [f64],
}

const KINDS: [Kind; 2] = [
    Kind { name: "six hours, one vessel", hours: 6.0, pass_h: &[3.0] },
    Kind { name: "a day, three vessels", hours: 24.0, pass_h: &[5.0, 12.0, 19.0] },
];

/// When a vessel of `obs-one-ship` passes, h.
const ONE_SHIP_H: f64 = 3.0;

/// What was told of a kind.
#[derive(Default)]
struct Told {
    azimuth: Stated,
    range: Stated,
    numbers: Numbers,
    vessels: usize,
    tracked: usize,
    of_nobody: usize,
    faults: usize,
}

impl Told {
    fn take(&mut self, case: &Case) {
        let (azimuth, range) = minutes(case);
        self.azimuth = Stated::sum(&[self.azimuth, Stated::sum(&azimuth)]);
        self.range = Stated::sum(&[self.range, Stated::sum(&range)]);
        let finals: Vec<Track> = tracks(case).filter(|t| t.stage == Track::FINAL).collect();
        self.of_nobody += finals.iter().filter(|t| whose(t, &case.vessels).is_none()).count();
        self.faults += case.set_up_faults().len();
        for (i, vessel) in case.vessels.iter().enumerate() {
            self.vessels += 1;
            let own = finals.iter().rfind(|t| whose(t, &case.vessels) == Some(i));
            if let Some((t, miss)) = own.and_then(|t| Some((t, track_passed(t, &vessel.course)?))) {
                self.tracked += 1;
                self.numbers.take(t, &miss);
            }
        }
    }
}

/// The vessels of a record; no vessel is in two.
fn vessels(kind: &Kind, seed: u64) -> Vec<ObsVessel> {
    let passes = kind.pass_h.iter().zip(10 * seed..);
    passes
        .map(|(pass_h, seed)| {
            let mut ship = super::obs_one_ship::ship(seed);
            ship.straight.cpa_time_s += (pass_h - ONE_SHIP_H) * HOUR_S;
            ship
        })
        .collect()
}

fn hear(options: &Options, table: &Propagation, kind: &Kind) -> Result<Told> {
    let seeds = (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i);
    let mut told = Told::default();
    for seed in seeds {
        let scenario = ObsScenario { vessels: vessels(kind, seed), ..quiet(seed, kind.hours * HOUR_S) };
        told.take(&Case::run(scenario, table, Vec::new())?);
    }
    Ok(told)
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let heard: Vec<Told> = KINDS.par_iter().map(|kind| hear(options, &table, kind)).collect::<Result<_>>()?;
    let mut csv = CsvText::new(
        "record,vessels,tracked,of_nobody,azimuths,off_10_deg,in_95,ranges,off_1500_m,in_95,numbers_in_95",
    );
    let figures = &options.figures;
    for (kind, told) in KINDS.iter().zip(&heard) {
        let Told { azimuth, range, .. } = told;
        let inside = [*azimuth, *range, told.numbers.all()].map(|s| s.percent(s.within));
        csv.row(&[
            &kind.name,
            &told.vessels,
            &told.tracked,
            &told.of_nobody,
            &azimuth.said,
            &azimuth.wrong,
            &Fixed(inside[0], 1),
            &range.said,
            &range.wrong,
            &Fixed(inside[1], 1),
            &Fixed(inside[2], 1),
        ]);
        let of = |what: &str| format!("{}: {what}", kind.name);
        figures.at_most(of("ranges more than 1500 m off, %"), range.percent(range.wrong), 4.0);
        figures.at_most(of("azimuths more than 10° off, %"), azimuth.percent(azimuth.wrong), 1.0);
        for (what, inside) in ["azimuths", "ranges", "numbers of final tracks"].into_iter().zip(inside) {
            figures.report(of(&format!("{what} in their 95 %, %")), inside, Bar::Within(92.0, 97.0));
        }
        figures.at_most(of("vessels without a final track"), (told.vessels - told.tracked) as f64, 0.0);
        figures.at_most(of("final tracks of nobody"), told.of_nobody as f64, 0.0);
        figures.at_most(of("faults named of a set-up that is as told"), told.faults as f64, 0.0);
    }
    print(options, "obs-day", csv)
}
