//! Defects that begin while the station listens, and components deaf from the start: what is told until they are named.
//!
//! Days of five seeded vessels ([`super::obs_gains`]) as an ordinary station hears them; from an hour on something is wrong with a component. Judged is
//! what is told from then on: azimuths in their 95 %, final tracks of nobody, and after how many hours the defect is named.

use super::obs_checks::{Altered, noise};
use super::obs_gains::{BY_3_DB, BY_6_DB, DAY_S, north, vessels};
use super::obs_week::{Stated, minutes, tracks, whose};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::ObsScenario;
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::{run as listen, station};
use crate::propagation::Propagation;
use anyhow::Result;
use rayon::prelude::*;
use seabearing_core::block::Frame;
use seabearing_core::wire::{FaultCode, Message, Track};

/// The experiment.
pub const ONSETS: Experiment = Experiment {
    name: "obs-onsets",
    about: "ocean bottom: defects that begin in the middle of a day, and deaf components: what is told until they are named",
    run,
};

/// Days where the command line names no number.
const RUNS: usize = 4;

/// What becomes of the components.
struct Onset {
    name: &'static str,
    codes: fn(Frame) -> Frame,
    /// Hour from which on.
    from_h: f64,
    /// What is to be told of it.
    named: Option<FaultCode>,
}

const ONSETS_OF: [Onset; 9] = [
    Onset { name: "nothing", codes: |f| f, from_h: 8.0, named: None },
    Onset {
        name: "north 3 dB louder",
        codes: |f| north(f, BY_3_DB),
        from_h: 8.0,
        named: Some(FaultCode::Unequal),
    },
    Onset {
        name: "north 3 dB quieter",
        codes: |f| north(f, 1.0 / BY_3_DB),
        from_h: 8.0,
        named: Some(FaultCode::Unequal),
    },
    Onset {
        name: "north 6 dB louder",
        codes: |f| north(f, BY_6_DB),
        from_h: 8.0,
        named: Some(FaultCode::Unequal),
    },
    Onset { name: "north deaf from the start", codes: deaf, from_h: 0.0, named: Some(FaultCode::OwnNoise) },
    Onset { name: "north deaf", codes: deaf, from_h: 8.0, named: Some(FaultCode::OwnNoise) },
    Onset {
        name: "east deaf",
        codes: |f @ [p, n, _, z]| [p, n, noise(f, 1.0), z],
        from_h: 8.0,
        named: Some(FaultCode::OwnNoise),
    },
    Onset {
        name: "pressure reversed",
        codes: |[p, n, e, z]| [-p, n, e, z],
        from_h: 8.0,
        named: Some(FaultCode::Reversed),
    },
    Onset {
        name: "vertical and north exchanged",
        codes: |[p, n, e, z]| [p, z, e, n],
        from_h: 8.0,
        named: Some(FaultCode::Exchanged),
    },
];

fn deaf(frame: Frame) -> Frame {
    let [pressure, _, east, vertical] = frame;
    [pressure, noise(frame, 1.0), east, vertical]
}

/// What was told of some days.
#[derive(Default)]
struct Told {
    azimuth: Stated,
    finals: usize,
    of_nobody: usize,
    /// Hours from its beginning until it was named, of each day.
    after_h: Vec<f64>,
}

fn hear(options: &Options, table: &Propagation, onset: &Onset) -> Result<Told> {
    let (mut azimuths, mut told) = (Vec::new(), Told::default());
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let scenario = ObsScenario { vessels: vessels(seed), ..quiet(seed, DAY_S) };
        let (config, paths, rate_hz) = (station::config(&scenario, false)?, scenario.paths, scenario.rate_hz);
        let mut simulator = Simulator::new(scenario, table.clone(), Vec::new())?;
        let (vessels, heard) = (simulator.vessels.clone(), simulator.heard());
        let from = (onset.from_h * 3600.0 * rate_hz) as u64;
        let mut altered = Altered::from(&mut simulator, onset.codes, from);
        let mut messages = Vec::new();
        listen::run(&config, table, &mut altered, &mut |m| messages.push(m))?;
        let named = messages.iter().find_map(|m| match m {
            Message::Fault(f) if Some(f.code) == onset.named && f.index > from => Some(f.index - from),
            _ => None,
        });
        told.after_h.push(named.map_or(f64::INFINITY, |n| n as f64 / rate_hz / 3600.0));
        messages.retain(|m| match m {
            Message::Azimuth(a) => a.index > from,
            Message::Track(t) => t.index > from,
            _ => true,
        });
        let case = Case { messages, vessels, heard, table: table.clone(), paths, rate_hz };
        azimuths.extend(minutes(&case).0);
        for track in tracks(&case).filter(|t| t.stage == Track::FINAL) {
            told.finals += 1;
            told.of_nobody += usize::from(whose(&track, &case.vessels).is_none());
        }
    }
    Ok(Told { azimuth: Stated::sum(&azimuths), ..told })
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let all: Vec<Told> =
        ONSETS_OF.par_iter().map(|onset| hear(options, &table, onset)).collect::<Result<_>>()?;
    let mut csv = CsvText::new(
        "what,from_h,azimuths,off_10_deg,azimuths_in_95,finals,of_nobody,days,named_days,named_h",
    );
    for (onset, told) in ONSETS_OF.iter().zip(&all) {
        let inside = told.azimuth.percent(told.azimuth.within);
        let named: Vec<f64> = told.after_h.iter().copied().filter(|h| h.is_finite()).collect();
        let latest_h = named.iter().copied().fold(0.0, f64::max);
        csv.row(&[
            &onset.name,
            &onset.from_h,
            &told.azimuth.said,
            &told.azimuth.wrong,
            &Fixed(inside, 1),
            &told.finals,
            &told.of_nobody,
            &told.after_h.len(),
            &named.len(),
            &Fixed(latest_h, 1),
        ]);
        let name = onset.name;
        // Of directions withheld nothing is wrong.
        if told.azimuth.said > 0 {
            options.figures.at_least(format!("{name}: azimuths in their 95 %, %"), inside, 92.0);
        }
        options.figures.at_most(format!("{name}: final tracks of nobody"), told.of_nobody as f64, 0.0);
        if onset.named.is_some() {
            let share = named.len() as f64 / told.after_h.len().max(1) as f64;
            options.figures.at_least(format!("{name}: days in which it was named, share"), share, 1.0);
        }
    }
    print(options, "obs-onsets", csv)
}
