//! What an ocean-bottom station finds wrong with its own set-up, from a day of traffic or two.
//!
//! The days of `obs-week` are heard as they are, and by a station that is not what its station file says: pressure reversed,
//! the vertical component exchanged with a horizontal one, pressure with any, the horizontal components of unequal gain, one that hears noise alone or
//! has no signal, a propagation table for deeper water. One that is noisier than the other and spikes on all components are no defect of
//! the set-up. `--runs` is the number of days. What a station alone cannot know (a horizontal component reversed, the two
//! exchanged, an orientation that is off: a mirrored or turned world) is told by a vessel of known track.

use super::obs_week::{Traffic, traffic};
use super::obs_world::station_table;
use super::{Experiment, Options};
use crate::course::VesselCourse;
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::mirrored::{Horizontals, doubt};
use crate::ocean_bottom::scenario::{ObsFault, ObsScenario, Spikes};
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::survey::pairings;
use crate::ocean_bottom::{run, station};
use crate::propagation::Propagation;
use crate::recording::BlockSource;
use anyhow::Result;
use rayon::prelude::*;
use seabearing_core::block::{Block, Frame};
use seabearing_core::wire::{Fault, FaultCode, Message, Track};

/// The experiment.
pub const CHECKS: Experiment = Experiment {
    name: "obs-checks",
    about: "a station that is not what its file says names it within a day of traffic, a deaf horizontal within three; one that is says nothing",
    run,
};

/// A station that is not as told.
struct Defect {
    name: &'static str,
    /// What becomes of an instant's codes: pressure, north, east, vertical.
    codes: fn(Frame) -> Frame,
    /// Samples far off on all components.
    spikes: Option<Spikes>,
    /// By how much the table is for deeper water, m.
    too_deep_m: f64,
    /// By how much the orientation told is too small, degrees.
    turned_deg: f64,
    /// What the recorder is to name, and within how many days.
    wanted: Option<FaultCode>,
    within_days: usize,
    /// The component in whose place pressure stands.
    pressure_in: Option<i64>,
    /// What vessels of known track are to tell.
    known: Option<&'static str>,
    /// Whether a horizontal component is louder by noise of its own, which is in doubt and no fault.
    noisier: bool,
}

/// As told.
const SOUND: Defect = Defect {
    name: "none",
    codes: |f| f,
    spikes: None,
    too_deep_m: 0.0,
    turned_deg: 0.0,
    wanted: None,
    within_days: 1,
    pressure_in: None,
    known: None,
    noisier: false,
};

/// Added to a component's number in `Exchanged` where pressure stands in its place (docs/wire.md).
const PRESSURE: i64 = 4;

/// 3 dB louder.
fn louder(code: i32) -> i32 {
    (f64::from(code) * 10f64.powf(3.0 / 20.0)) as i32
}

/// 20 dB louder.
fn much_louder(code: i32) -> i32 {
    10 * code
}

/// Noise of the sea's level, or so many times that, from an instant's codes and in no other way of them.
pub(super) fn noise(frame: Frame, times: f64) -> i32 {
    let mut hash = frame.iter().fold(0x9e37_79b9_7f4a_7c15u64, |h, c| {
        let h = (h ^ u64::from(c.cast_unsigned())).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h ^ h >> 29
    });
    // Of twelve numbers from 0 to 1 the sum has a variance of 1.
    let sum: f64 = (0..12)
        .map(|_| {
            hash = hash.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (hash >> 11) as f64 / (1u64 << 53) as f64
        })
        .sum();
    (1000.0 * times * (sum - 6.0)) as i32
}

const DEFECTS: [Defect; 21] = [
    SOUND,
    Defect {
        name: "pressure reversed",
        codes: |[p, n, e, z]| [-p, n, e, z],
        wanted: Some(FaultCode::Reversed),
        ..SOUND
    },
    Defect {
        name: "motion reversed",
        codes: |[p, n, e, z]| [p, -n, -e, -z],
        wanted: Some(FaultCode::Reversed),
        ..SOUND
    },
    Defect {
        name: "vertical and north exchanged",
        codes: |[p, n, e, z]| [p, z, e, n],
        wanted: Some(FaultCode::Exchanged),
        ..SOUND
    },
    Defect {
        name: "vertical and east exchanged",
        codes: |[p, n, e, z]| [p, n, z, e],
        wanted: Some(FaultCode::Exchanged),
        ..SOUND
    },
    Defect {
        name: "pressure and north exchanged",
        codes: |[p, n, e, z]| [n, p, e, z],
        wanted: Some(FaultCode::Exchanged),
        pressure_in: Some(1),
        ..SOUND
    },
    Defect {
        name: "pressure and east exchanged",
        codes: |[p, n, e, z]| [e, n, p, z],
        wanted: Some(FaultCode::Exchanged),
        pressure_in: Some(2),
        ..SOUND
    },
    Defect {
        name: "pressure and vertical exchanged",
        codes: |[p, n, e, z]| [z, n, e, p],
        wanted: Some(FaultCode::Exchanged),
        pressure_in: Some(3),
        ..SOUND
    },
    Defect {
        name: "north 3 dB louder",
        codes: |[p, n, e, z]| [p, louder(n), e, z],
        wanted: Some(FaultCode::Unequal),
        ..SOUND
    },
    Defect {
        name: "east 3 dB louder",
        codes: |[p, n, e, z]| [p, n, louder(e), z],
        wanted: Some(FaultCode::Unequal),
        ..SOUND
    },
    Defect {
        name: "north 20 dB louder",
        codes: |[p, n, e, z]| [p, much_louder(n), e, z],
        wanted: Some(FaultCode::Unequal),
        ..SOUND
    },
    Defect {
        name: "north 6 dB noisier",
        codes: |f @ [p, n, e, z]| [p, n + noise(f, 3f64.sqrt()), e, z],
        noisier: true,
        ..SOUND
    },
    Defect {
        name: "north hears noise alone",
        codes: |f @ [p, _, e, z]| [p, noise(f, 1.0), e, z],
        wanted: Some(FaultCode::OwnNoise),
        within_days: 3,
        ..SOUND
    },
    Defect {
        name: "east hears noise alone",
        codes: |f @ [p, n, _, z]| [p, n, noise(f, 1.0), z],
        wanted: Some(FaultCode::OwnNoise),
        within_days: 3,
        ..SOUND
    },
    Defect {
        name: "east without signal",
        codes: |[p, n, _, z]| [p, n, 12, z],
        wanted: Some(FaultCode::DeadChannel),
        ..SOUND
    },
    Defect {
        name: "spikes of four samples every 7 s",
        spikes: Some(Spikes { every_s: 7.0, counts: 1e4, samples: 4 }),
        ..SOUND
    },
    Defect { name: "table 100 m too deep", too_deep_m: 100.0, wanted: Some(FaultCode::TableOff), ..SOUND },
    Defect {
        name: "table 100 m too shallow",
        too_deep_m: -100.0,
        wanted: Some(FaultCode::TableOff),
        ..SOUND
    },
    Defect {
        name: "north and east exchanged",
        codes: |[p, n, e, z]| [p, e, n, z],
        known: Some("HorizontalsExchanged"),
        ..SOUND
    },
    Defect {
        name: "north reversed",
        codes: |[p, n, e, z]| [p, -n, e, z],
        known: Some("NorthReversed"),
        ..SOUND
    },
    Defect { name: "orientation 5° off", turned_deg: 5.0, known: Some("OrientationOff"), ..SOUND },
];

/// A recording whose codes are not what they should be.
pub(super) struct Altered<'a> {
    source: &'a mut Simulator,
    codes: fn(Frame) -> Frame,
    from: u64,
    held: Vec<Frame>,
}

impl<'a> Altered<'a> {
    /// A simulated one.
    pub(super) fn new(source: &'a mut Simulator, codes: fn(Frame) -> Frame) -> Self {
        Self::from(source, codes, 0)
    }

    /// One whose codes are right before an instant.
    pub(super) fn from(source: &'a mut Simulator, codes: fn(Frame) -> Frame, from: u64) -> Self {
        Self { source, codes, from, held: Vec::new() }
    }
}

impl BlockSource for Altered<'_> {
    fn start(&self) -> Option<time::OffsetDateTime> {
        self.source.start()
    }

    fn expected_end(&self) -> Option<u64> {
        self.source.expected_end()
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        let Some(block) = self.source.next_block()? else { return Ok(None) };
        let first_index = block.first_index;
        let frames = (first_index..).zip(block.frames);
        self.held = frames.map(|(i, f)| if i < self.from { *f } else { (self.codes)(*f) }).collect();
        Ok(Some(Block { first_index, frames: &self.held }))
    }
}

/// The table of a station as if it lay deeper: what arrives at a range in deeper water arrived at a proportional one.
pub(super) fn deeper(table: &Propagation, by_m: f64) -> Propagation {
    let mut deeper = table.clone();
    let scale = 1.0 + by_m / table.depth_m;
    for (n, path) in deeper.paths.iter_mut().enumerate() {
        for (row, arrival) in path.arrivals.iter_mut().enumerate() {
            *arrival = table.arrival(n, row as f64 * table.step_m / scale);
            if let Some(a) = arrival {
                a.toa_s *= scale;
            }
        }
    }
    deeper.depth_m += by_m;
    deeper
}

/// What was said of a defect: by the recorder, and by vessels of known track.
struct Said {
    faults: Vec<Fault>,
    known: Option<Horizontals>,
    /// Azimuths, ranges detected and tracks told after components were said to be exchanged or a sign turned round: directions are none then, and without pressure
    /// ranges neither.
    told_after: [usize; 3],
}

fn hear(options: &Options, days: usize, table: &Propagation, defect: &Defect) -> Result<Said> {
    let Traffic { mut scenario, extra } = traffic(options, days, 0.0)?;
    scenario.faults.extend(defect.spikes.map(ObsFault::Spikes));
    let told = ObsScenario {
        orientation_of_north_deg: scenario.orientation_of_north_deg - defect.turned_deg,
        ..scenario.clone()
    };
    let (config, rate_hz) = (station::config(&told)?, scenario.rate_hz);
    let mut simulator = Simulator::new(scenario, table.clone(), extra)?;
    let courses: Vec<VesselCourse> = simulator.vessels.iter().map(|v| v.course.clone()).collect();
    let mut altered = Altered::new(&mut simulator, defect.codes);
    let (mut faults, mut azimuths, mut told_after) = (Vec::<Fault>::new(), Vec::new(), [0; 3]);
    let told_table = deeper(table, defect.too_deep_m);
    run::run(&config, &told_table, &mut altered, &mut |m| {
        let exchanged = faults.iter().any(|f| matches!(f.code, FaultCode::Exchanged | FaultCode::Reversed));
        let told = match m {
            Message::Azimuth(a) if a.detected => Some(0),
            Message::Range(r) if r.detected => Some(1),
            Message::Track(t) if t.stage != Track::WITHDRAWN => Some(2),
            _ => None,
        };
        if let Some(k) = told.filter(|_| exchanged) {
            told_after[k] += 1;
        }
        match m {
            Message::Fault(f) => faults.push(f),
            Message::Azimuth(a) if a.detected && a.kind == 0 => {
                azimuths.push((a.index as f64 / rate_hz, f64::from(a.azimuth)));
            }
            _ => {}
        }
    })?;
    let travel = |range_m: f64| table.travel_time_s((range_m / table.step_m).round() as usize);
    let pairings = pairings(&azimuths, &courses, &travel, (0.0, 0.0));
    Ok(Said { faults, told_after, known: doubt(&pairings, told.orientation_of_north_deg.to_radians()) })
}

/// Hours of the record.
fn hours(fault: &Fault) -> f64 {
    fault.index as f64 / (3600.0 * 50.0)
}

fn run(options: &Options) -> Result<()> {
    let days = options.runs.unwrap_or(1);
    let table = station_table(options)?;
    let all: Vec<Said> = DEFECTS
        .par_iter()
        .map(|defect| hear(options, days.max(defect.within_days), &table, defect))
        .collect::<Result<_>>()?;
    let mut csv = CsvText::new("defect,named,value,after_h");
    let figures = &options.figures;
    for (defect, said) in DEFECTS.iter().zip(&all) {
        let name = defect.name;
        for f in &said.faults {
            csv.row(&[&name, &format!("{:?}", f.code), &f.value, &Fixed(hours(f), 1)]);
        }
        if let Some(known) = &said.known {
            csv.row(&[&name, &known.code(), &"", &""]);
        }
        let (named, others): (Vec<&Fault>, Vec<&Fault>) =
            said.faults.iter().partition(|f| Some(f.code) == defect.wanted);
        // That a sign is wrong is known before it is known whose, and is no other name.
        let is_of_signs = matches!(defect.wanted, Some(FaultCode::Reversed | FaultCode::Exchanged));
        // So is that one component is louder before it is known whether that is its gain or noise; and that a doubt is over names nothing.
        let is_of_gain = defect.wanted == Some(FaultCode::Unequal) || defect.noisier;
        let may_be = |code: FaultCode| match code {
            FaultCode::SignInDoubt => is_of_signs,
            FaultCode::GainInDoubt => is_of_gain,
            _ => false,
        };
        let (warned, others): (Vec<&Fault>, Vec<&Fault>) = others.into_iter().partition(|f| match f.code {
            FaultCode::SetUpGood => {
                FaultCode::ALL.iter().any(|over| may_be(*over) && *over as i64 == f.value)
            }
            code => may_be(code),
        });
        if is_of_gain {
            let first = warned.iter().chain(&named).map(|f| hours(f)).fold(f64::INFINITY, f64::min);
            figures.at_most(format!("{name}: warned of after, h of the record"), first, 24.0);
        }
        if defect.wanted.is_some() {
            let first = named.first().map_or(f64::INFINITY, |f| hours(f));
            figures.at_most(
                format!("{name}: named after, h of the record"),
                first,
                24.0 * defect.within_days as f64,
            );
        }
        // A mirrored or turned world, which contradicts nothing that one station hears.
        if defect.wanted.is_none() && defect.known.is_some() {
            let first = said.faults.first().map_or(f64::INFINITY, hours);
            figures.at_most(
                format!("{name}: named by the station alone after, h of the record"),
                first,
                24.0,
            );
        }
        figures.at_most(
            format!("{name}: other things named"),
            others.len() as f64 + named.len().saturating_sub(1) as f64,
            0.0,
        );
        if let Some(component) = defect.pressure_in {
            let wrong = named.iter().filter(|f| f.value != PRESSURE + component).count();
            figures.at_most(format!("{name}: named as another"), wrong as f64, 0.0);
        }
        if is_of_signs {
            let [azimuths, ranges, tracks] = said.told_after;
            let ranges = if defect.pressure_in.is_some() { ranges } else { 0 };
            let told = azimuths + ranges + tracks;
            figures.at_most(format!("{name}: told when it was named"), told as f64, 0.0);
        }
        let told = said.known.as_ref().map(Horizontals::code);
        if defect.known.is_some() || defect.wanted.is_none() {
            let wrong = f64::from(u8::from(told != defect.known));
            figures.at_most(format!("{name}: vessels of known track tell something else"), wrong, 0.0);
        }
    }
    super::obs_world::print(options, "obs-checks", csv)
}
