//! A horizontal component that is really louder than the station file says, beside one that is only noisier: what is told meanwhile.
//!
//! Days of five seeded vessels of tones of their own, at the table's level, as an ordinary station hears them, one whose north component is
//! 3 or 6 dB too loud or too quiet, and one whose north component is 3 or 7 dB noisier and of its gain. The noise is alike in both kinds, and vessels decide
//! which it is: a gain is told (`Unequal`) and put right, a noise is not told. Until then either may be so, and what is stated must hold the truth.

use super::obs_checks::Altered;
use super::obs_week::{Numbers, Stated, minutes, tracks, whose};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, ShakingTable, Side, Straight};
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::{run as listen, station};
use crate::propagation::Propagation;
use crate::score::track_passed;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::block::Frame;
use seabearing_core::wire::{FaultCode, Message, Track};

/// The experiment.
pub const GAINS: Experiment = Experiment {
    name: "obs-gains",
    about: "ocean bottom: a horizontal component 3 or 6 dB too loud, and one only noisier; azimuths and tracks in their 95 %, when it is told",
    run,
};

/// Days where the command line names no number.
const RUNS: usize = 3;

/// Length of a day, s.
pub(super) const DAY_S: f64 = 86_400.0;

/// Vessels of a day, and how much higher the tones of each are than those of the one before, Hz.
const VESSELS: usize = 5;
const TONES_APART_HZ: f64 = 0.83;

/// What north is, against the station file.
struct North {
    name: &'static str,
    codes: fn(Frame) -> Frame,
    /// Its noise over east's where it is no gain, dB.
    noisier_db: f64,
    /// Whether it is to be told.
    unequal: bool,
}

/// North times an amplitude.
pub(super) fn north(frame: Frame, times: f64) -> Frame {
    let [pressure, north, east, vertical] = frame;
    [pressure, (f64::from(north) * times) as i32, east, vertical]
}

/// 3 and 6 dB as amplitudes.
pub(super) const BY_3_DB: f64 = 1.412_54;
pub(super) const BY_6_DB: f64 = 1.995_26;

const NORTHS: [North; 7] = [
    North { name: "as told", codes: |f| f, noisier_db: 0.0, unequal: false },
    North { name: "3 dB too loud", codes: |f| north(f, BY_3_DB), noisier_db: 0.0, unequal: true },
    North { name: "3 dB too quiet", codes: |f| north(f, 1.0 / BY_3_DB), noisier_db: 0.0, unequal: true },
    North { name: "6 dB too loud", codes: |f| north(f, BY_6_DB), noisier_db: 0.0, unequal: true },
    North { name: "6 dB too quiet", codes: |f| north(f, 1.0 / BY_6_DB), noisier_db: 0.0, unequal: true },
    North { name: "3 dB noisier", codes: |f| f, noisier_db: 3.0, unequal: false },
    North { name: "7 dB noisier", codes: |f| f, noisier_db: 7.0, unequal: false },
];

/// Seeded vessels of a day.
pub(super) fn vessels(seed: u64) -> Vec<ObsVessel> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let vessel = |k: usize| {
        let mut vessel = ObsVessel {
            name: format!("{}", k + 1),
            straight: Straight {
                cpa_time_s: rng.random_range(0.0..DAY_S),
                cpa_range_m: rng.random_range(3_000.0..25_000.0),
                heading_deg: rng.random_range(0.0..360.0),
                speed_m_s: rng.random_range(4.0..11.0),
                side: if rng.random() { Side::Starboard } else { Side::Port },
            },
            active_s: [-1e9, 1e9],
            radiation: Default::default(),
        };
        vessel.radiation.tones_hz.iter_mut().for_each(|f| *f += TONES_APART_HZ * k as f64);
        vessel
    };
    (0..VESSELS).map(vessel).collect()
}

/// What was told of some days.
struct Told {
    azimuth: Stated,
    range: Stated,
    numbers: Numbers,
    /// Hours until it was told, of each day.
    after_h: Vec<f64>,
}

fn hear(options: &Options, table: &Propagation, of: &North) -> Result<Told> {
    let (mut azimuths, mut ranges, mut numbers, mut after_h) =
        (Vec::new(), Vec::new(), Numbers::default(), Vec::new());
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let mut scenario = ObsScenario { vessels: vessels(seed), ..quiet(seed, DAY_S) };
        if of.noisier_db > 0.0 {
            let level_db = 10.0 * (10f64.powf(of.noisier_db / 10.0) - 1.0).log10();
            scenario
                .ambient
                .shaking
                .push(ShakingTable { axis_deg: scenario.orientation_of_north_deg, level_db });
        }
        let (config, paths, rate_hz) = (station::config(&scenario)?, scenario.paths, scenario.rate_hz);
        let mut simulator = Simulator::new(scenario, table.clone(), Vec::new())?;
        let (vessels, heard) = (simulator.vessels.clone(), simulator.heard());
        let mut messages = Vec::new();
        let mut altered = Altered::new(&mut simulator, of.codes);
        listen::run(&config, table, &mut altered, &mut |m| messages.push(m))?;
        let case = Case { messages, vessels, heard, table: table.clone(), paths, rate_hz };
        let (azimuth, range) = minutes(&case);
        azimuths.extend(azimuth);
        ranges.extend(range);
        for t in tracks(&case).filter(|t| t.stage == Track::FINAL) {
            let own = whose(&t, &case.vessels);
            if let Some(e) = own.and_then(|i| track_passed(&t, &case.vessels[i].course)) {
                numbers.take(&t, &e);
            }
        }
        let told = case.messages.iter().find_map(|m| match m {
            Message::Fault(f) if f.code == FaultCode::Unequal => Some(f.index as f64 / rate_hz / 3600.0),
            _ => None,
        });
        after_h.push(told.unwrap_or(f64::INFINITY));
    }
    Ok(Told { azimuth: Stated::sum(&azimuths), range: Stated::sum(&ranges), numbers, after_h })
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let all: Vec<Told> =
        NORTHS.par_iter().map(|north| hear(options, &table, north)).collect::<Result<_>>()?;
    let mut csv = CsvText::new(
        "north,azimuths,off_10_deg,azimuths_in_95,ranges,ranges_in_95,numbers,numbers_in_95,told_days,told_h",
    );
    for (north, told) in NORTHS.iter().zip(&all) {
        let numbers = told.numbers.all();
        let inside = [told.azimuth, told.range, numbers].map(|s| s.percent(s.within));
        let said = told.after_h.iter().filter(|h| h.is_finite()).count();
        let latest_h = told.after_h.iter().copied().fold(0.0, f64::max);
        csv.row(&[
            &north.name,
            &told.azimuth.said,
            &told.azimuth.wrong,
            &Fixed(inside[0], 1),
            &told.range.said,
            &Fixed(inside[1], 1),
            &numbers.said,
            &Fixed(inside[2], 1),
            &said,
            &Fixed(latest_h, 1),
        ]);
        for (what, inside) in ["azimuths", "numbers of final tracks"].into_iter().zip([inside[0], inside[2]])
        {
            options.figures.at_least(format!("north {}: {what} in their 95 %, %", north.name), inside, 92.0);
        }
        let name = format!("north {}", north.name);
        if north.unequal {
            options.figures.at_most(
                format!("{name}: told after, h of the day, at the latest"),
                latest_h,
                24.0,
            );
        } else {
            options.figures.at_most(format!("{name}: days in which a gain was told"), said as f64, 0.0);
        }
    }
    print(options, "obs-gains", csv)
}
