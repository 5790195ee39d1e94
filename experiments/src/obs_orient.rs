//! Orientation and place of an ocean-bottom station from vessels of known track, both unknown at first.
//!
//! The station lies 350 m east and 50 m north of its nominal position, its first horizontal points to 77° and is taken to
//! point to 60°. Vessels pass one after the other, six hours apart; `--runs` is their number. Where there are several they are told once more by a clock that
//! is a minute late.

use super::figure::Bar;
use super::obs_world::{print, quiet, station_table};
use super::{Experiment, Options};
use crate::course::VesselCourse;
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::orient::orientation;
use crate::ocean_bottom::place::{SEARCH_M, place};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel};
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::{stages, station};
use anyhow::{Context, Result};

/// The experiment.
pub const ORIENT: Experiment = Experiment {
    name: "obs-orient",
    about: "orientation and place of an ocean-bottom station from vessels of known track, and whether their clock is its own",
    run,
};

/// Passages where the command line names no number.
const RUNS: usize = 6;
/// Where the station is against where it is thought to be, m.
const OFFSET_M: (f64, f64) = (350.0, 50.0);
/// Where its first horizontal is thought to point, degrees; in truth 77.
const ASSUMED_DEG: f64 = 60.0;
const PASSAGE_S: f64 = 21_600.0;
/// The tracks' clock the second time, s.
const LATE_S: f64 = 60.0;

/// The same course told by a clock that is late.
fn later(course: &VesselCourse, late_s: f64) -> VesselCourse {
    match course {
        VesselCourse::Fixes(fixes) => {
            VesselCourse::Fixes(fixes.iter().map(|(t_s, place)| (t_s + late_s, *place)).collect())
        }
        other => other.clone(),
    }
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let n = options.runs.unwrap_or(RUNS).max(1);
    let vessels: Vec<ObsVessel> = (0..n)
        .map(|i| {
            let mut s = super::obs_one_ship::ship(options.seed + i as u64);
            s.straight.cpa_time_s += PASSAGE_S * i as f64;
            // Each sounds for its own six hours only, as neighbours would else overlap.
            s.active_s = [PASSAGE_S * i as f64, PASSAGE_S * (i + 1) as f64];
            s
        })
        .collect();
    let scenario = ObsScenario { vessels, ..quiet(options.seed, PASSAGE_S * n as f64) };
    let assumed = ObsScenario { orientation_of_north_deg: ASSUMED_DEG, ..scenario.clone() };
    let mut simulator = Simulator::new(scenario.clone(), table.clone(), Vec::new())?;
    let courses: Vec<VesselCourse> = simulator
        .vessels
        .iter()
        .map(|v| {
            let (from, to) = v.active_s;
            let steps = ((to - from) / 60.0) as u64;
            let fixes = (0..=steps).map(|k| from + 60.0 * k as f64).filter_map(|t| {
                let (x, y) = v.course.at(t)?;
                Some((t, (x + OFFSET_M.0, y + OFFSET_M.1)))
            });
            VesselCourse::Fixes(fixes.collect())
        })
        .collect();
    let frames = stages::frames(&mut simulator, &station::config(&assumed)?)?;
    let evidence = stages::range_evidence(&frames, &table);
    let travel = |range_m: f64| table.travel_time_s((range_m / table.step_m).round() as usize);
    let at = place(&evidence, &courses, &travel, SEARCH_M)?;
    let tones = 226..492;
    let turn = orientation(&frames, &courses, &travel, (at.east_m, at.north_m), tones)
        .context("no usable passage")?;
    let true_deg = scenario.orientation_of_north_deg;
    let found_deg = ASSUMED_DEG + turn.correction.to_degrees();
    let mut csv = CsvText::new("quantity,true,found,sd");
    let ((two_true, two_found), (sd_east_m, sd_north_m)) =
        ((Fixed(true_deg, 2), Fixed(found_deg, 2)), at.sd_m());
    csv.row(&[&"orientation deg", &two_true, &two_found, &Fixed(turn.sd.to_degrees(), 2)]);
    csv.row(&[&"east m", &Fixed(OFFSET_M.0, 0), &Fixed(at.east_m, 0), &Fixed(sd_east_m, 0)]);
    csv.row(&[&"north m", &Fixed(OFFSET_M.1, 0), &Fixed(at.north_m, 0), &Fixed(sd_north_m, 0)]);
    for (i, e) in turn.each.iter().enumerate() {
        let found = Fixed(ASSUMED_DEG + e.to_degrees(), 2);
        csv.row(&[&format!("passage {} deg", i + 1), &two_true, &found, &""]);
    }
    print(options, "obs-orient", csv)?;
    let off = (found_deg - true_deg).abs() / turn.sd.to_degrees();
    options.figures.at_most("orientation error in standard deviations", off, 3.0);
    // One course tells nothing of a clock.
    let clocks = [(0.0, "as they are"), (-LATE_S, "60 s late")];
    for (late_s, tracks) in clocks.into_iter().filter(|_| n > 1) {
        let courses: Vec<VesselCourse> = courses.iter().map(|course| later(course, -late_s)).collect();
        let found = place(&evidence, &courses, &travel, SEARCH_M);
        if let Some(late) = found.as_ref().ok().and_then(|found| found.lateness) {
            let name = format!("tracks {tracks}: error of the clock's shift in standard deviations");
            options.figures.at_most(name, (late.late_s - late_s).abs() / late.sd_s, 3.0);
        }
        // A place that is not told is not wrong.
        let said = found.map_or(late_s != 0.0, |found| found.lateness.is_some_and(|l| l.is_wrong()));
        let name = format!("tracks {tracks}: said to be of another clock, or no place told");
        let wanted = f64::from(u8::from(late_s != 0.0));
        options.figures.report(name, f64::from(u8::from(said)), Bar::Within(wanted, wanted));
    }
    let place = (at.east_m - OFFSET_M.0).hypot(at.north_m - OFFSET_M.1);
    options.figures.at_most("place error, m", place, 50.0);
    Ok(())
}
