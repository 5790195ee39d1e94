//! What the ocean-bottom experiments share: the station's table, a quiet sea, the chain over a simulated record.

use super::Options;
use crate::csv::{CsvTable, CsvText};
use crate::ocean_bottom::event::HeardEvent;
use crate::ocean_bottom::pictures::TruthCurve;
use crate::ocean_bottom::scenario::{ObsScenario, default_start};
use crate::ocean_bottom::simulate::{Extra, MovingVessel, Simulator};
use crate::ocean_bottom::{run, station};
use crate::plot::format;
use crate::propagation::{Propagation, bottom::Bottom, convert, profile, trace};
use crate::score::{Detections, detections};
use crate::score::{TrackMiss, owner, then, track};
use anyhow::Result;
use seabearing_core::config::StationConfig;
use seabearing_core::wire::{Encoder, Fault, FaultCode, Message};
use std::path::PathBuf;

/// Depth of station RR03, m.
const RR03_DEPTH_M: f64 = 4340.0;

/// The RR03 ray table where the papers' data are, else (said on standard error) the project's own trace through a
/// subtropical profile.
///
/// # Errors
/// The ray table is damaged.
pub fn station_table(options: &Options) -> Result<Propagation> {
    let csv = options.data.join("ray_tracing_rr03.csv");
    if csv.is_file() {
        return convert::read(&csv, Some(RR03_DEPTH_M), false);
    }
    eprintln!("seabearing: no ray table at {}; traced through a subtropical profile instead", csv.display());
    let profile = profile::SpeedProfile::subtropical(RR03_DEPTH_M)?;
    Ok(trace::trace("subtropical", &profile, &Bottom::default(), 70.0, 1429, || ()))
}

/// Vessels farther than this are not drawn, m: little of them is heard.
const HEARD_M: f64 = 100_000.0;

/// A scenario without any source.
pub fn quiet(seed: u64, duration_s: f64) -> ObsScenario {
    ObsScenario {
        kind: "obs".into(),
        seed,
        duration_s,
        start: default_start(),
        station: None,
        station_file: None,
        rate_hz: 50.0,
        propagation: PathBuf::new(),
        paths: 5,
        name: "RR03".into(),
        lat_lon_deg: None,
        orientation_of_north_deg: 77.0,
        intensity: "away".into(),
        ambient: Default::default(),
        vessels: Vec::new(),
        ais: Vec::new(),
        fin_whale: Vec::new(),
        blue_whale: Vec::new(),
        earthquake: Vec::new(),
        t_phase: Vec::new(),
        strumming: Vec::new(),
        gaps: Vec::new(),
        faults: Vec::new(),
    }
}

/// A simulated record and what the chain said about it.
pub struct Case {
    /// Everything said, in order.
    pub messages: Vec<Message>,
    /// The vessels that were there.
    pub vessels: Vec<MovingVessel>,
    /// Other sounds that were there.
    pub heard: Vec<HeardEvent>,
    pub(super) table: Propagation,
    pub(super) paths: usize,
    pub(super) rate_hz: f64,
}

impl Case {
    /// Simulates and listens.
    ///
    /// # Errors
    /// A wrong scenario, or a table the core refuses.
    pub fn run(scenario: ObsScenario, table: &Propagation, extra: Vec<Extra>) -> Result<Self> {
        let config = station::config(&scenario)?;
        Self::heard_by(&config, scenario, table, extra)
    }

    /// The same by a station of another configuration than the scenario's.
    ///
    /// # Errors
    /// As [`Case::run`].
    pub fn heard_by(
        config: &StationConfig,
        scenario: ObsScenario,
        table: &Propagation,
        extra: Vec<Extra>,
    ) -> Result<Self> {
        let (paths, rate_hz) = (scenario.paths, scenario.rate_hz);
        let mut simulator = Simulator::new(scenario, table.clone(), extra)?;
        let vessels = simulator.vessels.clone();
        let heard = simulator.heard();
        let mut messages = Vec::new();
        run::run(config, table, &mut simulator, &mut |m| messages.push(m))?;
        Ok(Self { messages, vessels, heard, table: table.clone(), paths, rate_hz })
    }

    /// Errors of a vessel's final track, where it has one.
    pub fn final_track(&self, vessel: usize) -> Option<TrackMiss> {
        let own = self.messages.iter().rev().find_map(|m| match m {
            Message::Track(t) if t.stage == 1 && owner(t, &self.vessels) == Some(vessel) => Some(*t),
            _ => None,
        });
        track(&own?, &self.vessels[vessel].course)
    }

    /// What the station said is wrong with its own set-up.
    pub fn set_up_faults(&self) -> Vec<Fault> {
        let of_set_up = |code: FaultCode| {
            use FaultCode::{Exchanged, GainInDoubt, OwnNoise, Reversed, SignInDoubt, TableOff, Unequal};
            matches!(code, SignInDoubt | Reversed | Exchanged | GainInDoubt | Unequal | TableOff | OwnNoise)
        };
        let faults =
            self.messages.iter().filter_map(|m| if let Message::Fault(f) = m { Some(*f) } else { None });
        faults.filter(|f| of_set_up(f.code)).collect()
    }

    /// Bytes of the telemetry, a minute of the record.
    pub fn bytes_a_minute(&self, duration_s: f64) -> f64 {
        let mut encoder = Encoder::default();
        let bytes: usize = self.messages.iter().map(|m| encoder.frame(m).len()).sum();
        60.0 * bytes as f64 / duration_s
    }

    /// Errors of detections, one entry a vessel.
    pub fn detections(&self) -> Vec<Detections> {
        detections(&self.messages, &self.table, self.paths, self.rate_hz, &self.vessels)
    }
}

/// Where the vessels could be heard, minute by minute, for pictures: those of the core's range, and where they were then.
pub fn truth(case: &Case, duration_s: f64) -> Vec<TruthCurve> {
    let minutes = || (0..=(duration_s / 60.0) as u32).map(|m| 60.0 * f64::from(m));
    let curve = |v: &MovingVessel| {
        let there = minutes().filter_map(|t| Some((t, then(&case.table, case.paths, v, t)?)));
        let heard: Vec<_> =
            there.filter(|(_, h)| h.range_m < HEARD_M).map(|(t, h)| (t, h.azimuth, h.range_m)).collect();
        let places = heard.iter().filter_map(|h| v.course.at(h.0)).collect();
        TruthCurve { name: v.name.clone(), heard, places }
    };
    case.vessels.iter().map(curve).collect()
}

/// Names the files that were written, pictures as they are wanted.
pub fn named(options: &Options, written: &[PathBuf]) {
    let files = written.iter().flat_map(|path| {
        let names = format::names_of(path);
        if names.is_empty() { vec![path.clone()] } else { names }
    });
    for path in files {
        if options.json {
            println!("{}", serde_json::json!({"type": "picture", "path": path}));
        } else {
            println!("  {}", path.display());
        }
    }
}

/// Writes an experiment's CSV and prints it.
///
/// # Errors
/// The file cannot be written.
pub fn print(options: &Options, name: &str, csv: CsvText) -> Result<()> {
    let csv = csv.finish();
    crate::atomic::write(&options.out.join(format!("{name}.csv")), csv.as_bytes())?;
    let table = CsvTable::parse(&csv, name)?;
    let header = table.header();
    if options.json {
        for row in table.rows() {
            let cells = header.iter().zip(row).map(|(k, v)| {
                let value = v.parse::<f64>().map_or_else(|_| v.as_str().into(), |x| serde_json::json!(x));
                (k.clone(), value)
            });
            let named = [("type".to_owned(), "row".into()), ("experiment".to_owned(), name.into())];
            println!("{}", serde_json::Value::Object(named.into_iter().chain(cells).collect()));
        }
        return Ok(());
    }
    println!("  {}", header.join("  "));
    for row in table.rows() {
        let cells: Vec<String> =
            row.iter().zip(header).map(|(v, k)| format!("{v:>width$}", width = k.len())).collect();
        println!("  {}", cells.join("  "));
    }
    Ok(())
}
