//! One horizontal component noisier than the other, or a place that shakes one way: noise along an axis, which pressure does not have.
//!
//! The seeded vessels of `obs-one-ship`, six hours each, at the table's level and 5 dB below it, with 0 to 10 dB more noise along the
//! north component, the east component or between them than across. What is told must hold the truth all the same.

use super::obs_week::{Numbers, Stated, minutes, tracks, whose};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, ShakingTable};
use crate::propagation::Propagation;
use crate::score::track_passed;
use anyhow::Result;
use rayon::prelude::*;
use seabearing_core::wire::Track;
use std::fmt::Display;

/// The experiment.
pub const NOISY: Experiment = Experiment {
    name: "obs-noisy",
    about: "ocean bottom: one horizontal component 3 to 10 dB noisier, or a place that shakes one way; azimuths and tracks in their 95 %",
    run,
};

/// Vessels where the command line names no number.
const RUNS: usize = 6;

/// Length of a record, s.
const RECORD_S: f64 = 21_600.0;

/// Noise along an axis over that across it, dB, and the axis, degrees from the north component.
const NOISE: [(f64, f64); 6] = [(0.0, 0.0), (3.0, 0.0), (7.0, 0.0), (10.0, 0.0), (10.0, 90.0), (10.0, 45.0)];

/// Levels of the vessels against the table's, dB.
const VESSEL_DB: [f64; 2] = [0.0, -5.0];

/// What was told of single vessels.
#[derive(Default)]
pub(super) struct Row {
    pub(super) azimuth: Stated,
    pub(super) range: Stated,
    pub(super) numbers: Numbers,
    /// Vessels with a final track of their own, and final tracks.
    pub(super) tracked: usize,
    pub(super) finals: usize,
}

impl Row {
    /// Takes what was told of a record with one vessel.
    pub(super) fn take(&mut self, case: &Case) {
        let (azimuth, range) = minutes(case);
        self.azimuth = Stated::sum(&[self.azimuth, Stated::sum(&azimuth)]);
        self.range = Stated::sum(&[self.range, Stated::sum(&range)]);
        let finals: Vec<Track> = tracks(case).filter(|t| t.stage == Track::FINAL).collect();
        self.finals += finals.len();
        let own = finals.iter().rfind(|t| whose(t, &case.vessels) == Some(0));
        if let Some((t, e)) = own.and_then(|t| Some((t, track_passed(t, &case.vessels[0].course)?))) {
            self.tracked += 1;
            self.numbers.take(t, &e);
        }
    }

    /// Shares of azimuths, ranges and numbers of final tracks in their 95 %, per cent.
    pub(super) fn inside(&self) -> [f64; 3] {
        [self.azimuth, self.range, self.numbers.all()].map(|s| s.percent(s.within))
    }

    /// Writes it behind what the row is of: see [`COLUMNS`].
    pub(super) fn write(&self, csv: &mut CsvText, of: &[&dyn Display]) {
        let [azimuths, ranges, numbers] = self.inside().map(|x| Fixed(x, 1));
        let Self { azimuth, range, tracked, finals, .. } = self;
        let cells: [&dyn Display; 8] =
            [&azimuth.said, &azimuth.wrong, &azimuths, &range.said, &ranges, tracked, finals, &numbers];
        csv.row(&[of, &cells].concat());
    }
}

/// Names of a row's cells.
pub(super) const COLUMNS: &str =
    "azimuths,off_10_deg,azimuths_in_95,ranges,ranges_in_95,tracked,finals,numbers_in_95";

fn hear(
    options: &Options,
    table: &Propagation,
    (along_db, axis_deg): (f64, f64),
    vessel_db: f64,
) -> Result<Row> {
    let mut row = Row::default();
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let mut ship = super::obs_one_ship::ship(seed);
        ship.radiation.wideband_db += vessel_db;
        ship.radiation.tone_db += vessel_db;
        let mut scenario = ObsScenario { vessels: vec![ship], ..quiet(seed, RECORD_S) };
        if along_db > 0.0 {
            let more_db = 10.0 * (10f64.powf(along_db / 10.0) - 1.0).log10();
            let axis_deg = scenario.orientation_of_north_deg + axis_deg;
            scenario.ambient.shaking.push(ShakingTable { axis_deg, level_db: more_db });
        }
        let case = Case::run(scenario, table, Vec::new())?;
        row.take(&case);
    }
    Ok(row)
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let settings: Vec<_> =
        NOISE.into_iter().flat_map(|noise| VESSEL_DB.map(|vessel_db| (noise, vessel_db))).collect();
    let rows: Vec<Row> = settings
        .par_iter()
        .map(|(noise, vessel_db)| hear(options, &table, *noise, *vessel_db))
        .collect::<Result<_>>()?;
    let mut csv = CsvText::new(&format!("along_db,axis_deg,vessel_db,{COLUMNS}"));
    for (((along_db, axis_deg), vessel_db), row) in settings.into_iter().zip(&rows) {
        row.write(&mut csv, &[&Fixed(along_db, 0), &Fixed(axis_deg, 0), &Fixed(vessel_db, 0)]);
        let inside = row.inside();
        let what = format!("{along_db} dB along {axis_deg}°, vessel {vessel_db:+} dB");
        for (name, inside) in ["azimuths", "ranges", "numbers of final tracks"].into_iter().zip(inside) {
            options.figures.at_least(format!("{what}: {name} in their 95 %, %"), inside, 92.0);
        }
    }
    print(options, "obs-noisy", csv)
}
