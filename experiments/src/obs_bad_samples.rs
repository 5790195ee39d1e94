//! Bad samples at the ocean bottom: spikes common to all channels, and converters that clip, at full scale or below it.
//!
//! The seeded vessels of `obs-one-ship`, six hours each, heard clean and with each kind of damage; and the sea without a vessel, where
//! whatever points anywhere is false. An azimuth is wrong where it is more than 10° off. Clipping is stated in standard deviations of
//! the clean pressure; the converter's full scale is 2²³ throughout, so that every limit here is a rail below it. A converter
//! that clips at 3 or 2.2 deviations distorts what it does not clip: the same bars for it are figures of their own.

use super::obs_world::{Case, print, quiet, station_table};
use super::score::smad;
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{Clip, ObsFault, ObsScenario, Spikes};
use crate::ocean_bottom::simulate::Simulator;
use anyhow::Result;
use seabearing_core::wire::Message;

/// The experiment.
pub const BAD_SAMPLES: Experiment = Experiment {
    name: "obs-bad-samples",
    about: "ocean bottom: spikes on all channels and clipping, beside the same record without; what each costs",
    run,
};

/// Vessels where the command line names no number.
const RUNS: usize = 2;

/// Length of a record, s.
const RECORD_S: f64 = 21_600.0;

/// An azimuth this far off is wrong, rad.
const WRONG: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// What is done to a record.
#[derive(Clone, Copy)]
enum Damage {
    None,
    /// From one to the next, s, height, counts (the sea has 1000), and how many samples each lasts.
    Spikes(f64, f64, u64),
    /// Limit over the standard deviation of pressure.
    Clipped(f64),
}

const DAMAGES: [(&str, Damage); 11] = [
    ("clean", Damage::None),
    ("spikes of 20 every 300 s", Damage::Spikes(300.0, 2e4, 1)),
    ("spikes of 1000 every 300 s", Damage::Spikes(300.0, 1e6, 1)),
    ("spikes of 1000 every 7 s", Damage::Spikes(7.0, 1e6, 1)),
    ("spikes of 1000, three samples, every 300 s", Damage::Spikes(300.0, 1e6, 3)),
    ("spikes of 1000, three samples, every 7 s", Damage::Spikes(7.0, 1e6, 3)),
    ("spikes of 1000, eight samples, every 300 s", Damage::Spikes(300.0, 1e6, 8)),
    ("spikes of 1000, eight samples, every 7 s", Damage::Spikes(7.0, 1e6, 8)),
    ("clipped at 4.5 deviations", Damage::Clipped(4.5)),
    ("clipped at 3 deviations", Damage::Clipped(3.0)),
    ("clipped at 2.2 deviations", Damage::Clipped(2.2)),
];

/// Standard deviation of a record's pressure, counts.
fn deviation(scenario: &ObsScenario, table: &crate::propagation::Propagation) -> Result<f64> {
    let mut simulator = Simulator::new(scenario.clone(), table.clone(), Vec::new())?;
    let (mut sum, mut square, mut n) = (0.0, 0.0, 0.0);
    while let Some((_, frames)) = simulator.next_run() {
        for f in frames {
            let x = f64::from(f[0]);
            (sum, square, n) = (sum + x, square + x * x, n + 1.0);
        }
    }
    Ok((square / n - (sum / n) * (sum / n)).sqrt())
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let mut csv = CsvText::new(
        "scene,seed,azimuths,azimuths_10_deg_off,azimuth_smad_deg,ranges,wrong_ranges,tracked,azimuths_in_silence,\
         tracks_in_silence",
    );
    let mut clean = 0usize;
    // Least share of azimuths kept and vessels not tracked: with spikes or clipped at 4.5 deviations, and clipped at less.
    let (mut kept, mut lost) = ([f64::INFINITY; 2], [0usize; 2]);
    let mut worst = (0.0f64, 0usize, 0usize);
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let sea = quiet(seed, RECORD_S);
        let ship = ObsScenario { vessels: vec![super::obs_one_ship::ship(seed)], ..sea.clone() };
        let deviations = [deviation(&ship, &table)?, deviation(&sea, &table)?];
        for (name, damage) in DAMAGES {
            let damaged = |s: &ObsScenario, deviation: f64| {
                let faults = match damage {
                    Damage::None => Vec::new(),
                    Damage::Spikes(every_s, counts, samples) => {
                        vec![ObsFault::Spikes(Spikes { every_s, counts, samples })]
                    }
                    Damage::Clipped(limit) => vec![ObsFault::Clipped(Clip { counts: limit * deviation })],
                };
                ObsScenario { faults, ..s.clone() }
            };
            let case = Case::run(damaged(&ship, deviations[0]), &table, Vec::new())?;
            let d = case.detections().remove(0);
            let off = d.azimuth_wrong + d.azimuth.iter().filter(|e| e.abs() > WRONG).count();
            let azimuths = d.azimuth.len() + d.azimuth_wrong;
            let e = case.final_track(0);
            let tracked = e.is_some_and(|e| {
                e.cpa_time_s.abs() <= 10.0 && e.cpa_range_m.abs() <= 150.0 && e.speed_m_s.abs() <= 0.05
            });
            let silence = Case::run(damaged(&sea, deviations[1]), &table, Vec::new())?;
            let count = |of: &dyn Fn(&Message) -> bool| silence.messages.iter().filter(|m| of(m)).count();
            let false_azimuths = count(&|m| matches!(m, Message::Azimuth(a) if a.detected));
            let false_tracks = count(&|m| matches!(m, Message::Track(_)));
            csv.row(&[
                &name,
                &seed,
                &azimuths,
                &off,
                &Fixed(smad(&d.azimuth).to_degrees(), 2),
                &(d.range_m.len() + d.range_wrong),
                &d.range_wrong,
                &tracked,
                &false_azimuths,
                &false_tracks,
            ]);
            let group = match damage {
                Damage::None => {
                    clean = azimuths;
                    continue;
                }
                Damage::Clipped(limit) => usize::from(limit < 4.0),
                Damage::Spikes(..) => 0,
            };
            kept[group] = kept[group].min(azimuths as f64 / clean.max(1) as f64);
            lost[group] += usize::from(!tracked);
            let off_share = off as f64 / azimuths.max(1) as f64;
            worst = (worst.0.max(off_share), worst.1 + false_azimuths, worst.2 + false_tracks);
        }
    }
    print(options, "obs-bad-samples", csv)?;
    let figures = &options.figures;
    for (damage, kept, lost) in [
        ("with spikes or clipped at 4.5 deviations", kept[0], lost[0]),
        ("clipped at 3 and 2.2 deviations", kept[1], lost[1]),
    ] {
        figures.at_least(format!("azimuths {damage}, of the clean record's, worst, %"), 100.0 * kept, 90.0);
        figures.at_most(format!("vessels {damage} not tracked (10 s, 150 m, 0.05 m/s)"), lost as f64, 0.0);
    }
    figures.at_most("azimuths more than 10° off, worst record, %", 100.0 * worst.0, 1.0);
    figures.at_most("azimuths of nothing", worst.1 as f64, 0.0);
    figures.at_most("tracks of nothing", worst.2 as f64, 0.0);
    Ok(())
}
