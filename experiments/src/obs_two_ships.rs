//! Two vessels at once, their azimuths 30° apart or more while both are near: both must be tracked.
//!
//! Tracked means: one final track whose closest point, range and speed are within the bars of a vessel alone. Headings are
//! counted beside it: each vessel's wideband noise bends the intensity in the other's tone bins towards itself.

use super::obs_week::cells;
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::course::{VesselCourse, polar};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel};
use crate::score::{TrackMiss, smad};
use anyhow::Result;
use seabearing_core::angle::wrap_pi;
use std::f64::consts::PI;

/// The experiment.
pub const TWO_SHIPS: Experiment = Experiment {
    name: "obs-two-ships",
    about: "two vessels past an ocean-bottom station at once, 30° apart or more: both tracked?",
    run,
};

/// Pairs where the command line names no number.
const RUNS: usize = 4;

/// Time about the closest points in which the azimuths must stay apart, s.
const NEAR_S: f64 = 5400.0;

/// Whether two vessels stay 30° apart while they are near.
pub(super) fn apart(a: &ObsVessel, b: &ObsVessel) -> bool {
    let middle = 0.5 * (a.straight.cpa_time_s + b.straight.cpa_time_s);
    let (a, b) = (VesselCourse::straight(&a.straight), VesselCourse::straight(&b.straight));
    (0..=60).map(|k| middle - NEAR_S + NEAR_S / 30.0 * f64::from(k)).all(|t| {
        let azimuth = |c: &VesselCourse| c.at(t).map_or(0.0, |p| polar(p).1);
        wrap_pi(azimuth(&a) - azimuth(&b)).abs() >= PI / 6.0
    })
}

/// Whether a final track is within the bars of a vessel alone: 10 s, 150 m, 0.05 m/s.
pub(super) fn is_tracked(e: &TrackMiss) -> bool {
    e.cpa_time_s.abs() <= 10.0 && e.cpa_range_m.abs() <= 150.0 && e.speed_m_s.abs() <= 0.05
}

/// A seeded pair: two vessels of the one-vessel figure, the first pair of the seed's row that stays apart.
pub fn pair(seed: u64) -> [ObsVessel; 2] {
    let mut k = 1000 * seed;
    loop {
        let (mut a, mut b) = (super::obs_one_ship::ship(k), super::obs_one_ship::ship(k + 1));
        k += 2;
        if apart(&a, &b) {
            a.name = "first".into();
            b.name = "second".into();
            b.radiation.tones_hz.iter_mut().for_each(|f| *f += 0.83);
            return [a, b];
        }
    }
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let mut csv = CsvText::new(
        "seed,ship,cpa_range_m,azimuth_n,azimuth_smad_deg,range_n,wrong_branch,tracked,cpa_time_s,cpa_range_error_m,\
         heading_deg,speed_m_s",
    );
    let (mut ships, mut tracked, mut straight, mut faults) = (0, 0, 0, 0);
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let scenario = ObsScenario { vessels: pair(seed).to_vec(), ..quiet(seed, 21_600.0) };
        let case = Case::run(scenario, &table, Vec::new())?;
        faults += case.set_up_faults().len();
        for (i, d) in case.detections().iter().enumerate() {
            let e = case.final_track(i);
            let cells = e.map_or([f64::NAN; 4], |e| cells(&e));
            let held = e.is_some_and(|e| is_tracked(&e));
            ships += 1;
            tracked += usize::from(held);
            straight += usize::from(held && e.is_some_and(|e| e.heading.abs() <= 0.5f64.to_radians()));
            let closest_m = crate::score::closest(&case.vessels[i].course).map_or(f64::NAN, |c| c.1);
            csv.row(&[
                &seed,
                &(i + 1),
                &Fixed(closest_m, 0),
                &d.azimuth.len(),
                &Fixed(smad(&d.azimuth).to_degrees(), 2),
                &(d.range_m.len() + d.range_wrong),
                &d.range_wrong,
                &held,
                &Fixed(cells[0], 1),
                &Fixed(cells[1], 0),
                &Fixed(cells[2], 2),
                &Fixed(cells[3], 3),
            ]);
        }
    }
    print(options, "obs-two-ships", csv)?;
    let figures = &options.figures;
    figures.at_most("vessels not tracked (10 s, 150 m, 0.05 m/s)", (ships - tracked) as f64, 0.0);
    figures.at_most("faults named of a set-up that is as told", faults as f64, 0.0);
    figures.at_most("vessels whose heading is not within 0.5°", (ships - straight) as f64, 0.0);
    Ok(())
}
