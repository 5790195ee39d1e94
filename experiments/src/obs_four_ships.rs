//! Four vessels at once, their azimuths 30° apart or more while they are near: how many are tracked.
//!
//! Tracked means what it means in `obs-two-ships`. The recorder has places for as many tracks at once (`VESSELS` in
//! `core/src/obs/limits.rs`). Telemetry is what a line carries for all that is said meanwhile.

use super::obs_two_ships::{apart, is_tracked};
use super::obs_week::cells;
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel};
use anyhow::Result;
use seabearing_core::wire::{Message, Track};

/// The experiment.
pub const FOUR_SHIPS: Experiment = Experiment {
    name: "obs-four-ships",
    about: "four vessels past an ocean-bottom station at once, 30° apart or more: how many are tracked",
    run,
};

/// Scenes where the command line names no number.
const RUNS: usize = 2;

const SHIPS: usize = 4;

const DURATION_S: f64 = 21_600.0;

/// Ships tried for one more place before all are chosen anew.
const TRIES: u64 = 300;

/// Their tones must not share bins: each is so much higher than the one before, Hz.
const TONES_APART_HZ: f64 = 0.83;

/// Seeded ships that stay apart.
fn four(seed: u64) -> Vec<ObsVessel> {
    let mut k = 1_000_000 * seed;
    loop {
        let mut chosen: Vec<ObsVessel> = Vec::new();
        for next in k..k + TRIES {
            let ship = super::obs_one_ship::ship(next);
            if chosen.iter().all(|other| apart(other, &ship)) {
                chosen.push(ship);
            }
            if chosen.len() == SHIPS {
                for (i, ship) in chosen.iter_mut().enumerate() {
                    ship.name = format!("ship-{}", i + 1);
                    ship.radiation.tones_hz.iter_mut().for_each(|f| *f += TONES_APART_HZ * i as f64);
                }
                return chosen;
            }
        }
        k += TRIES;
    }
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let mut csv = CsvText::new(
        "seed,ship,azimuth_n,range_n,wrong_branch,tracked,cpa_time_s,cpa_range_error_m,heading_deg,speed_m_s",
    );
    let (mut ships, mut tracked, mut finals, mut owned, mut faults) =
        (0usize, 0usize, 0usize, 0usize, 0usize);
    let (mut ranges, mut wrong, mut bytes_a_minute) = (0usize, 0usize, 0.0_f64);
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let scenario = ObsScenario { vessels: four(seed), ..quiet(seed, DURATION_S) };
        let case = Case::run(scenario, &table, Vec::new())?;
        bytes_a_minute = bytes_a_minute.max(case.bytes_a_minute(DURATION_S));
        let stage = |m: &&Message| matches!(m, Message::Track(t) if t.stage == Track::FINAL);
        finals += case.messages.iter().filter(stage).count();
        faults += case.set_up_faults().len();
        for (i, d) in case.detections().iter().enumerate() {
            let e = case.final_track(i);
            let cells = e.map_or([f64::NAN; 4], |e| cells(&e));
            let held = e.is_some_and(|e| is_tracked(&e));
            ships += 1;
            tracked += usize::from(held);
            owned += usize::from(e.is_some());
            ranges += d.range_m.len() + d.range_wrong;
            wrong += d.range_wrong;
            csv.row(&[
                &seed,
                &(i + 1),
                &d.azimuth.len(),
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
    print(options, "obs-four-ships", csv)?;
    let figures = &options.figures;
    figures.at_most("vessels not tracked (10 s, 150 m, 0.05 m/s)", (ships - tracked) as f64, 0.0);
    figures.at_most("final tracks beyond one a vessel", finals.saturating_sub(owned) as f64, 0.0);
    figures.at_most("faults named of a set-up that is as told", faults as f64, 0.0);
    figures.at_most("wrong ranges, %", 100.0 * wrong as f64 / ranges.max(1) as f64, 4.0);
    figures.at_most("telemetry, bytes a minute, the most of a scene", bytes_a_minute, 200.0);
    Ok(())
}
