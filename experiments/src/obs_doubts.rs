//! What is not known of an ocean-bottom station, told as deviations in its station file: whether the truth is inside what is stated.
//!
//! The days of `obs-week` are heard by a station whose orientation, gain of the north component and table's depth are off by one of the
//! deviations told, each alone and all together. An error of one deviation leaves the truth inside the 95 %; what it makes of errors in
//! units of the stated deviation says whether that is larger than need be. Where pairs of paths are in doubt no range is told as detected.
//! A final track is untrue where no vessel is within what it states. `--runs` is the number of days.

use super::obs_checks::{Altered, deeper};
use super::obs_week::{NO_BAR, Stated, Traffic, cells, minutes, tracks, traffic, whose};
use super::obs_world::{Case, print, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::ObsScenario;
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::{run, station};
use crate::propagation::Propagation;
use crate::score::{TrackMiss, track, track_passed};
use anyhow::Result;
use rayon::prelude::*;
use seabearing_core::block::Frame;
use seabearing_core::config::Doubts;
use seabearing_core::wire::Track;

/// The experiment.
pub const DOUBTS: Experiment = Experiment {
    name: "obs-doubts",
    about: "orientation 5° off, north 3 dB louder, table 100 m too deep or too shallow, told as deviations: truth in the stated 95 %",
    run,
};

/// What is off, by one deviation each.
struct Off {
    name: &'static str,
    turned_deg: f64,
    codes: fn(Frame) -> Frame,
    too_deep_m: f64,
    /// By which share the table's sound is too fast.
    too_fast: f64,
    told: Doubts,
}

/// As told, and said to be exact.
const NOTHING: Doubts = Doubts { orientation_deg: 0.0, gain_db: 0.0, table_depth_m: 0.0 };
const SOUND: Off =
    Off { name: "none", turned_deg: 0.0, codes: |f| f, too_deep_m: 0.0, too_fast: 0.0, told: NOTHING };

/// 15 m/s as an error of the table's depth, as `table_sound_speed_sd_m_s` in the station file means it over 4340 m.
const SOUND_AS_DEPTH_M: f32 = 0.6 * 4340.0 * 0.01;

/// A table as if sound were by a share faster.
fn faster(mut table: Propagation, share: f64) -> Propagation {
    for arrival in table.paths.iter_mut().flat_map(|path| path.arrivals.iter_mut().flatten()) {
        arrival.toa_s /= 1.0 + share;
    }
    table
}

/// North 3 dB louder.
fn louder([p, n, e, z]: Frame) -> Frame {
    [p, (f64::from(n) * 10f64.powf(3.0 / 20.0)) as i32, e, z]
}

const OFF: [Off; 8] = [
    SOUND,
    Off {
        name: "orientation 5° off",
        turned_deg: 5.0,
        told: Doubts { orientation_deg: 5.0, ..NOTHING },
        ..SOUND
    },
    Off { name: "north 3 dB louder", codes: louder, told: Doubts { gain_db: 3.0, ..NOTHING }, ..SOUND },
    Off {
        name: "table 100 m too deep",
        too_deep_m: 100.0,
        told: Doubts { table_depth_m: 100.0, ..NOTHING },
        ..SOUND
    },
    Off {
        name: "table 100 m too shallow",
        too_deep_m: -100.0,
        told: Doubts { table_depth_m: 100.0, ..NOTHING },
        ..SOUND
    },
    Off {
        name: "table's sound 1 % too fast",
        too_fast: 0.01,
        told: Doubts { table_depth_m: SOUND_AS_DEPTH_M, ..NOTHING },
        ..SOUND
    },
    Off {
        name: "table's sound 1 % too slow",
        too_fast: -0.01,
        told: Doubts { table_depth_m: SOUND_AS_DEPTH_M, ..NOTHING },
        ..SOUND
    },
    Off {
        name: "all but the sound",
        turned_deg: -5.0,
        codes: louder,
        too_deep_m: 100.0,
        too_fast: 0.0,
        told: Doubts { orientation_deg: 5.0, gain_db: 3.0, table_depth_m: 100.0 },
    },
];

fn hear(options: &Options, days: usize, table: &Propagation, off: &Off) -> Result<Case> {
    let Traffic { scenario, extra } = traffic(options, days, 0.0)?;
    let told = ObsScenario {
        orientation_of_north_deg: scenario.orientation_of_north_deg - off.turned_deg,
        ..scenario.clone()
    };
    let mut config = station::config(&told)?;
    config.doubts = off.told;
    let (paths, rate_hz) = (scenario.paths, scenario.rate_hz);
    let mut simulator = Simulator::new(scenario, table.clone(), extra)?;
    let (vessels, heard) = (simulator.vessels.clone(), simulator.heard());
    let mut altered = Altered::new(&mut simulator, off.codes);
    let mut messages = Vec::new();
    let table_told = faster(deeper(table, off.too_deep_m), off.too_fast);
    run::run(&config, &table_told, &mut altered, &mut |m| messages.push(m))?;
    Ok(Case { messages, vessels, heard, table: table.clone(), paths, rate_hz })
}

/// Half width of a track's four numbers that hold the truth together in 95 %, standard deviations of each.
const ALL_FOUR: f64 = 2.49;

fn deviations(t: &Track) -> [f64; 4] {
    [t.sd_cpa_time_s, t.sd_cpa_range_m, t.sd_heading.to_degrees(), t.sd_speed_m_s].map(f64::from)
}

/// Whether some vessel is within what a final track states, or it is on a vessel's way as `obs-week` has it.
pub(super) fn is_true(t: &Track, case: &Case) -> bool {
    let within = |miss: &TrackMiss| {
        cells(miss).into_iter().zip(deviations(t)).all(|(error, sd)| error.abs() <= ALL_FOUR * sd)
    };
    let ways = || case.vessels.iter().map(|v| &v.course);
    whose(t, &case.vessels).is_some()
        || ways().any(|w| [track(t, w), track_passed(t, w)].iter().flatten().any(within))
}

/// Final tracks against the ways: vessels found, finals that are true of none, what was stated, and squared errors in units of it.
fn finals(case: &Case) -> (usize, usize, Stated, f64) {
    let (mut found, mut stated, mut squares) = (0, Stated::default(), 0.0);
    let finals: Vec<Track> = tracks(case).filter(|t| t.stage == Track::FINAL).collect();
    let untrue = finals.iter().filter(|t| !is_true(t, case)).count();
    for (i, vessel) in case.vessels.iter().enumerate() {
        let own = finals.iter().rfind(|t| whose(t, &case.vessels) == Some(i));
        let Some((t, miss)) = own.and_then(|t| Some((t, track_passed(t, &vessel.course)?))) else { continue };
        found += 1;
        for (error, sd) in cells(&miss).into_iter().zip(deviations(t)) {
            stated.take(error, sd as f32, NO_BAR);
            squares += (error / sd).powi(2);
        }
    }
    let rms = (squares / stated.said.max(1) as f64).sqrt();
    (found, untrue, stated, rms)
}

fn run(options: &Options) -> Result<()> {
    let days = options.runs.unwrap_or(1);
    let table = station_table(options)?;
    let heard: Vec<Case> =
        OFF.par_iter().map(|off| hear(options, days, &table, off)).collect::<Result<_>>()?;
    let mut csv =
        CsvText::new("off,ships,found,untrue,azimuths,in_95,ranges,in_95,tracks_in_95,rms_of_stated");
    let figures = &options.figures;
    for (off, case) in OFF.iter().zip(&heard) {
        let (azimuth, range) = minutes(case);
        let (azimuth, range) = (Stated::sum(&azimuth), Stated::sum(&range));
        let (found, untrue, stated, rms) = finals(case);
        let inside = [azimuth, range, stated].map(|s| s.percent(s.within));
        csv.row(&[
            &off.name,
            &case.vessels.len(),
            &found,
            &untrue,
            &azimuth.said,
            &Fixed(inside[0], 1),
            &range.said,
            &Fixed(inside[1], 1),
            &Fixed(inside[2], 1),
            &Fixed(rms, 2),
        ]);
        for (what, inside) in ["azimuths", "ranges", "final tracks"].into_iter().zip(inside) {
            if inside.is_nan() {
                figures.state(format!("{}: {what} that are told", off.name), 0.0);
                continue;
            }
            figures.at_least(
                format!("{}: {what} with the truth in the stated 95 %, %", off.name),
                inside,
                92.0,
            );
        }
        if off.name == OFF[0].name {
            let (azimuth, range) = (azimuth.percent(azimuth.wrong), range.percent(range.wrong));
            figures.at_most("none: azimuths more than 10° off, %", azimuth, 1.0);
            figures.at_most("none: ranges more than 1500 m off, %", range, 4.0);
        }
        figures.at_most(
            format!("{}: final tracks of no vessel within what they state", off.name),
            untrue as f64,
            0.0,
        );
        figures.state(format!("{}: error of final tracks over the stated deviation, rms", off.name), rms);
    }
    print(options, "obs-doubts", csv)
}
