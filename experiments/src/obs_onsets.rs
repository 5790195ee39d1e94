//! Defects that begin while the station listens, and components deaf from the start: what is told until they are named.
//!
//! Days of five seeded vessels ([`super::obs_gains`]) as an ordinary station hears them; from an hour on something is wrong with a component. Judged is
//! what is told from then on until it is named, and after that: azimuths in their 95 %, final tracks of nobody; and after how many hours a sign is known to
//! be in doubt (from then on no direction is told) and the defect is named. Of a station that has said to be reversed nothing more is judged: what it
//! tells is half a turn off, or its vertical component alone is, and which it is cannot be heard.

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

const ONSETS_OF: [Onset; 11] = [
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
        name: "pressure reversed from the start",
        codes: |[p, n, e, z]| [-p, n, e, z],
        from_h: 0.0,
        named: Some(FaultCode::Reversed),
    },
    Onset {
        name: "vertical and north exchanged from the start",
        codes: |[p, n, e, z]| [p, z, e, n],
        from_h: 0.0,
        named: Some(FaultCode::Exchanged),
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

/// What was told in a time of some days.
#[derive(Default)]
struct Told {
    azimuth: Stated,
    finals: usize,
    of_nobody: usize,
}

/// What was told of some days.
struct Heard {
    /// Until the defect was named, and from then on.
    until: Told,
    after: Told,
    /// Hours from its beginning until a sign was in doubt, and until it was named, of each day.
    doubted_h: Vec<f64>,
    named_h: Vec<f64>,
}

/// Hours of the days in which something was said, and the latest of them.
fn said(after_h: &[f64]) -> (usize, f64) {
    let said = after_h.iter().copied().filter(|h| h.is_finite());
    (said.clone().count(), said.fold(0.0, f64::max))
}

fn hear(options: &Options, table: &Propagation, onset: &Onset) -> Result<Heard> {
    let mut azimuths = [Vec::new(), Vec::new()];
    let mut told = [Told::default(), Told::default()];
    let (mut doubted_h, mut named_h) = (Vec::new(), Vec::new());
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let scenario = ObsScenario { vessels: vessels(seed), ..quiet(seed, DAY_S) };
        let (config, paths, rate_hz) = (station::config(&scenario)?, scenario.paths, scenario.rate_hz);
        let mut simulator = Simulator::new(scenario, table.clone(), Vec::new())?;
        let (vessels, heard) = (simulator.vessels.clone(), simulator.heard());
        let from = (onset.from_h * 3600.0 * rate_hz) as u64;
        let mut altered = Altered::from(&mut simulator, onset.codes, from);
        let mut messages = Vec::new();
        listen::run(&config, table, &mut altered, &mut |m| messages.push(m))?;
        let first = |code: Option<FaultCode>| {
            messages.iter().find_map(|m| match m {
                // A minute about the moment is told of with sound from after it.
                Message::Fault(f) if Some(f.code) == code && f.index >= from => Some(f.index),
                _ => None,
            })
        };
        let named = first(onset.named);
        for (hours, index) in [(&mut doubted_h, first(Some(FaultCode::SignInDoubt))), (&mut named_h, named)] {
            hours.push(index.map_or(f64::INFINITY, |n| (n - from) as f64 / rate_hz / 3600.0));
        }
        let spans = [from..named.unwrap_or(u64::MAX), named.unwrap_or(u64::MAX)..u64::MAX];
        for (span, (azimuths, told)) in spans.iter().zip(azimuths.iter_mut().zip(&mut told)) {
            let of_span = |m: &&Message| match m {
                Message::Azimuth(a) => span.contains(&a.index),
                Message::Track(t) => span.contains(&t.index),
                _ => true,
            };
            let messages = messages.iter().filter(of_span).copied().collect();
            let (vessels, heard, table) = (vessels.clone(), heard.clone(), table.clone());
            let case = Case { messages, vessels, heard, table, paths, rate_hz };
            azimuths.extend(minutes(&case).0);
            for track in tracks(&case).filter(|t| t.stage == Track::FINAL) {
                told.finals += 1;
                told.of_nobody += usize::from(whose(&track, &case.vessels).is_none());
            }
        }
    }
    let [until, after] = azimuths;
    let [told_until, told_after] = told;
    Ok(Heard {
        until: Told { azimuth: Stated::sum(&until), ..told_until },
        after: Told { azimuth: Stated::sum(&after), ..told_after },
        doubted_h,
        named_h,
    })
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let all: Vec<Heard> =
        ONSETS_OF.par_iter().map(|onset| hear(options, &table, onset)).collect::<Result<_>>()?;
    let mut csv = CsvText::new(
        "what,from_h,azimuths,off_10_deg,azimuths_in_95,finals,of_nobody,azimuths_after,in_95_after,finals_after,of_nobody_after,\
         days,doubted_days,doubted_h,named_days,named_h",
    );
    for (onset, heard) in ONSETS_OF.iter().zip(&all) {
        let Heard { until, after, doubted_h, named_h } = heard;
        let inside = |told: &Told| told.azimuth.percent(told.azimuth.within);
        let ((doubted, latest_doubt_h), (named, latest_h)) = (said(doubted_h), said(named_h));
        csv.row(&[
            &onset.name,
            &onset.from_h,
            &until.azimuth.said,
            &until.azimuth.wrong,
            &Fixed(inside(until), 1),
            &until.finals,
            &until.of_nobody,
            &after.azimuth.said,
            &Fixed(inside(after), 1),
            &after.finals,
            &after.of_nobody,
            &named_h.len(),
            &doubted,
            &Fixed(latest_doubt_h, 1),
            &named,
            &Fixed(latest_h, 1),
        ]);
        let judged = if onset.named == Some(FaultCode::Reversed) { 1 } else { 2 };
        for (told, when) in [(until, ""), (after, " once named")].into_iter().take(judged) {
            let name = format!("{}{when}", onset.name);
            // Of directions withheld nothing is wrong.
            if told.azimuth.said > 0 {
                options.figures.at_least(format!("{name}: azimuths in their 95 %, %"), inside(told), 92.0);
            }
            options.figures.at_most(format!("{name}: final tracks of nobody"), told.of_nobody as f64, 0.0);
        }
        if onset.named.is_some() {
            let share = named as f64 / named_h.len().max(1) as f64;
            options.figures.at_least(
                format!("{}: days in which it was named, share", onset.name),
                share,
                1.0,
            );
        }
        let is_of_signs = matches!(onset.named, Some(FaultCode::Reversed | FaultCode::Exchanged));
        let share = doubted as f64 / doubted_h.len().max(1) as f64;
        let figure = format!("{}: days in which a sign was in doubt, share", onset.name);
        if is_of_signs {
            options.figures.at_least(figure, share, 1.0);
        } else {
            options.figures.at_most(figure, share, 0.0);
        }
    }
    print(options, "obs-onsets", csv)
}
