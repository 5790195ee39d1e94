//! The streaming clutter filter of the core against the paper's batch singular-value decomposition.
//!
//! The same six-hour records of one vessel go through both filters, then through the same radial detector: the minute's
//! likelihood and the recursive posterior. The issue asks for as many range detections within 5 % and for the same
//! scatter within 10 %. The batch filter sees three hours at once, the streaming one only the past.

use super::obs_one_ship::ship;
use super::obs_world::{print, quiet, station_table};
use super::{Experiment, Options};
use crate::batch;
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::ObsScenario;
use crate::ocean_bottom::simulate::{MovingVessel, Simulator};
use crate::ocean_bottom::{station, table};
use crate::propagation::Propagation;
use crate::recording::BlockSource;
use crate::score::{Detections, detections, smad};
use anyhow::{Result, anyhow};
use seabearing_core::obs::clutter::{Clutter, FIRST_QUEFRENCY};
use seabearing_core::obs::limits::HOP;
use seabearing_core::obs::presence::Presence;
use seabearing_core::obs::radial::RadialScratch;
use seabearing_core::obs::shared::Shared;
use seabearing_core::obs::{Plan, Table};
use seabearing_core::wire::{Message, Range};

/// The experiment.
pub const CLUTTER: Experiment = Experiment {
    name: "obs-clutter",
    about: "range detections after the streaming clutter filter and after the batch decomposition",
    run,
};

const RATE_HZ: f64 = 50.0;

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let mut rows = CsvText::new("seed,filter,range_n,wrong_branch,range_smad_m");
    let mut all = [Detections::default(), Detections::default()];
    for seed in (0..options.runs.unwrap_or(4) as u64).map(|i| options.seed + i) {
        let scenario = ObsScenario { vessels: vec![ship(seed)], ..quiet(seed, 21_600.0) };
        let bytes = table::blob(&table, "RR03", RATE_HZ)?;
        let view = Table::parse(&bytes).map_err(|e| anyhow!("{e}"))?;
        let plan = Plan::new(&station::config(&scenario)?, &view).map_err(|e| anyhow!("{e}"))?;
        let paths = scenario.paths;
        let mut simulator = Simulator::new(scenario, table.clone(), Vec::new())?;
        let vessels = simulator.vessels.clone();
        let mut pressure = Vec::new();
        while let Some(block) = simulator.next_block()? {
            pressure.extend(block.frames.iter().map(|f| f[0] as f32));
        }
        let raw = batch::cepstrogram(&pressure);
        let mut streamed = raw.clone();
        let mut filter = Clutter::new();
        streamed.iter_mut().for_each(|c| filter.filter(c));
        let mut batched = raw;
        batch::filter(&mut batched, FIRST_QUEFRENCY);
        for ((name, cepstra), all) in [("streaming", streamed), ("batch", batched)].iter().zip(&mut all) {
            let d = detect(&plan, cepstra, &table, paths, &vessels);
            let detected = d.range_m.len() + d.range_wrong;
            rows.row(&[&seed, &name, &detected, &d.range_wrong, &Fixed(smad(&d.range_m), 0)]);
            all.append(&d);
        }
    }
    print(options, "obs-clutter", rows)?;
    let n = |d: &Detections| (d.range_m.len() + d.range_wrong) as f64;
    let [s, b] = &all;
    let off = |x: f64, y: f64| 100.0 * (x / y - 1.0).abs();
    let figures = &options.figures;
    figures.at_most("range detections, streaming against batch, % apart", off(n(s), n(b)), 5.0);
    let apart = off(smad(&s.range_m), smad(&b.range_m));
    figures.at_most("range SMAD, streaming against batch, % apart", apart, 10.0);
    Ok(())
}

/// The radial detector over filtered cepstra.
fn detect(
    plan: &Plan<'_>,
    cepstra: &[batch::Cepstrum],
    table: &Propagation,
    paths: usize,
    vessels: &[MovingVessel],
) -> Detections {
    let mut presence = Box::new(Presence::new());
    presence.start(plan.max_range_m());
    let mut scratch = Box::new(RadialScratch::new());
    let mut shared = Box::new(Shared::new());
    let mut messages = Vec::new();
    let minutes = (cepstra.len() * HOP) as u64 / 3000;
    for k in 1..minutes {
        let centre = 60.0 * k as f64;
        scratch.clear();
        for (m, c) in cepstra.iter().enumerate() {
            let t = HOP as f64 * (m + 1) as f64 / RATE_HZ - centre;
            if (-30.0..30.0).contains(&t) {
                scratch.add(plan.interference(), shared.envelope(), c.iter().copied(), t as f32);
            }
        }
        presence.predict(shared.columns());
        scratch.fill(shared.grid());
        let r = presence.update(shared.grid(), plan.interference(), &scratch);
        let Some(m) = r.modes[0].filter(|_| r.log_odds > 0.0) else { continue };
        messages.push(Message::Range(Range {
            index: k * 3000,
            range_m: m.range_m,
            sd_range_m: m.sd_range_m,
            speed_m_s: m.speed_m_s,
            sd_speed_m_s: m.sd_speed_m_s,
            log_presence: r.log_odds,
            weight: m.weight,
            detected: true,
        }));
    }
    detections(&messages, table, paths, RATE_HZ, vessels).remove(0)
}
