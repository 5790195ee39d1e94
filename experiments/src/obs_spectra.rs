//! Vessels of other spectra than the one that everything was tried with: strong in wideband sound and faint in lines, with a comb of blade rates,
//! with no line at all.
//!
//! The seeded vessels of `obs-one-ship`, six hours each. Before such a vessel is noticed its wideband sound has been heard for long, and it must not
//! be taken for the sea's.

use super::obs_noisy::{COLUMNS, Row};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::CsvText;
use crate::ocean_bottom::scenario::{ObsScenario, Radiation};
use crate::propagation::Propagation;
use anyhow::Result;
use rayon::prelude::*;

/// The experiment.
pub const SPECTRA: Experiment = Experiment {
    name: "obs-spectra",
    about: "ocean bottom: vessels strong in wideband sound, with faint lines, a comb of blade rates or no line; azimuths and tracks in their 95 %",
    run,
};

/// Vessels where the command line names no number.
const RUNS: usize = 6;

/// Length of a record, s.
const RECORD_S: f64 = 21_600.0;

/// What a vessel's sound has other than the usual.
type Change = fn(&mut Radiation);

/// What vessels sound like, by name.
const SPECTRA_OF: [(&str, Change); 5] = [
    ("six lines", |_| {}),
    ("two lines of 12 dB, wideband +5 dB", |r| {
        (r.tones_hz, r.tone_db, r.wideband_db) = (vec![12.1, 16.9], 12.0, 5.0);
    }),
    ("six lines of 12 dB, wideband +5 dB", |r| (r.tone_db, r.wideband_db) = (12.0, 5.0)),
    ("blade rates of 20 dB, wideband +3 dB", |r| {
        (r.tones_hz, r.blade_hz, r.comb_fall_db) = (Vec::new(), 6.8, 6.0);
        (r.tone_db, r.wideband_db, r.centre_hz, r.half_width_hz, r.modulation) = (20.0, 3.0, 12.0, 9.0, 0.4);
    }),
    ("no line, wideband +5 dB", |r| (r.tones_hz, r.wideband_db) = (Vec::new(), 5.0)),
];

fn hear(options: &Options, table: &Propagation, change: Change) -> Result<Row> {
    let mut row = Row::default();
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let mut ship = super::obs_one_ship::ship(seed);
        change(&mut ship.radiation);
        let scenario = ObsScenario { vessels: vec![ship], ..quiet(seed, RECORD_S) };
        row.take(&Case::run(scenario, table, Vec::new())?);
    }
    Ok(row)
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let rows: Vec<Row> =
        SPECTRA_OF.par_iter().map(|(_, change)| hear(options, &table, *change)).collect::<Result<_>>()?;
    let mut csv = CsvText::new(&format!("spectrum,{COLUMNS}"));
    let runs = options.runs.unwrap_or(RUNS);
    for ((name, _), row) in SPECTRA_OF.iter().zip(&rows) {
        row.write(&mut csv, &[name]);
        let inside = row.inside();
        for (what, inside) in ["azimuths", "ranges", "numbers of final tracks"].into_iter().zip(inside) {
            options.figures.at_least(format!("{name}: {what} in their 95 %, %"), inside, 92.0);
        }
        let tracked = 100.0 * row.tracked as f64 / runs as f64;
        options.figures.at_least(format!("{name}: vessels tracked, % of {runs}"), tracked, 90.0);
        let nobody = (row.finals - row.tracked) as f64;
        options.figures.at_most(format!("{name}: further final tracks"), nobody, 0.0);
    }
    print(options, "obs-spectra", csv)
}
