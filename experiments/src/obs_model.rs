//! The ocean-bottom paper's figures 1, 4c, 5a and 10 and Table II: the ships about the station, which ranges a delay may
//! mean, the stacked envelope of the cepstrum against range, and the strengths fitted to it.
//!
//! Figure 1 shows the AIS that the paper's authors published (terrestrial and satellite) about RR03; the places of the
//! other 56 stations are not at hand. The paper stacks ten recorded passages; here ten simulated ones go past the station 4
//! to 40 km away, through the same ray table, and [`fit`] does by least squares what the paper did by hand. The simulator
//! radiates through the rays' own amplitudes and not by Table II, so the table is a comparison, not a truth.

use super::obs_world::{quiet, station_table};
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::course::VesselCourse;
use crate::geodesy::LocalFrame;
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, Radiation, Side, Straight};
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::stages::{SpectralFrame, frames};
use crate::ocean_bottom::station;
use crate::ocean_bottom::strengths::{Branch, CELL_M, CELLS, Envelopes, fit, stack};
use crate::plot::{ColourMap, HeatMap, Plot, write_panels};
use crate::propagation::Propagation;
use crate::propagation::strength::{RR03, SkewNormal};
use anyhow::Result;
use rayon::prelude::*;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "obs-model",
    about: "the ocean-bottom paper's figures 1, 4c, 5a and 10 and Table II: strengths stacked from ten passages",
    run,
};

/// Passages stacked [O III C].
const PASSAGES: usize = 10;
/// Length of a passage's record, s: 50 km to either side at 8 m/s.
const RECORD_S: f64 = 14_000.0;
/// RR03 and half the widths of the AIS sets about it, degrees.
const RR03_DEG: (f64, f64) = (-21.3732, 54.1294);
/// Interferences as the paper calls them.
const NAMES: [&str; 3] = ["13", "35", "57"];

fn run(options: &Options) -> Result<()> {
    coverage(options)?;
    let table = station_table(options)?;
    let passages = options.runs.unwrap_or(PASSAGES);
    let heard: Vec<(VesselCourse, Vec<SpectralFrame>)> = (0..passages)
        .into_par_iter()
        .map(|k| passage(options.seed, k, passages, &table))
        .collect::<Result<_>>()?;
    // One record after another, so that in each stretch of time there is one vessel.
    let (mut courses, mut all) = (Vec::new(), Vec::new());
    for (course, frames) in heard {
        courses.push(course);
        all.extend(frames);
    }
    let branches = fit(&Envelopes::of(&all), &courses, &table);
    strengths(options, &branches)?;
    envelope(options, &all, &courses, &table)?;
    hypotheses(options, &table)
}

/// A passage's course and what is heard of it, at times of its own.
fn passage(
    seed: u64,
    k: usize,
    of: usize,
    table: &Propagation,
) -> Result<(VesselCourse, Vec<SpectralFrame>)> {
    let straight = Straight {
        cpa_time_s: 0.5 * RECORD_S,
        cpa_range_m: 4_000.0 + 36_000.0 * k as f64 / of.max(2) as f64,
        heading_deg: 36.0 * k as f64,
        speed_m_s: 8.0,
        side: if k.is_multiple_of(2) { Side::Port } else { Side::Starboard },
    };
    let vessel =
        ObsVessel { name: format!("{k}"), straight, active_s: [-1e9, 1e9], radiation: Radiation::default() };
    let scenario = ObsScenario { vessels: vec![vessel], ..quiet(seed + k as u64, RECORD_S) };
    let config = station::config(&scenario)?;
    let mut simulator = Simulator::new(scenario, table.clone(), Vec::new())?;
    let mut heard = frames(&mut simulator, &config)?;
    // Records follow one another a day apart.
    let late_s = 86_400.0 * k as f64;
    heard.iter_mut().for_each(|f| f.t_s += late_s);
    let later = Straight { cpa_time_s: straight.cpa_time_s + late_s, ..straight };
    Ok((VesselCourse::straight(&later), heard))
}

/// Figure 10 and Table II.
fn strengths(options: &Options, branches: &[Branch]) -> Result<()> {
    let mut report = CsvReport::new(
        "obs-model",
        "interference,k_m,shape,location_km,scale_km,peak,peak_km,paper_k_m,paper_shape,paper_location_km,\
         paper_scale_km,paper_peak,paper_peak_km,cells",
    );
    let mut figure =
        Plot::new("Strengths (ocean-bottom paper, figure 10)", "range (km)", "envelope of the cepstrum");
    for ((name, branch), paper) in NAMES.iter().zip(branches).zip(&RR03) {
        let law = branch.law;
        let (peak, at_km) = law.map_or((f64::NAN, f64::NAN), |l| highest(&l));
        let (paper_peak, paper_km) = highest(paper);
        let part = |f: fn(&SkewNormal) -> f64| law.as_ref().map_or(f64::NAN, f);
        report.row(&[
            name.parse().unwrap_or(f64::NAN),
            part(|l| l.k_m),
            part(|l| l.shape),
            part(|l| l.location_m / 1e3),
            part(|l| l.scale_m / 1e3),
            peak,
            at_km,
            paper.k_m,
            paper.shape,
            paper.location_m / 1e3,
            paper.scale_m / 1e3,
            paper_peak,
            paper_km,
            branch.cells.len() as f64,
        ]);
        let figures = &options.figures;
        figures.state(format!("interference {name}: greatest strength"), peak);
        figures.state(format!("interference {name}: the paper's"), paper_peak);
        figures.state(format!("interference {name}: range of the greatest strength, km"), at_km);
        figures.state(format!("interference {name}: the paper's, km"), paper_km);
        let left = branch.law.map_or(f64::NAN, |l| {
            super::score::rms(branch.cells.iter().map(|c| (c.envelope - l.at(c.range_m)) / peak))
        });
        figures.state(format!("interference {name}: what the law leaves, RMS, share of its height"), left);
        let points: Vec<_> = branch.cells.iter().map(|c| (c.range_m / 1e3, c.envelope)).collect();
        figure.points(name, &points);
        let curve = |law: &SkewNormal| {
            (0..=200).map(|i| 0.25 * f64::from(i)).map(|km| (km, law.at(1e3 * km))).collect::<Vec<_>>()
        };
        if let Some(law) = &law {
            figure.line(&format!("{name} fitted"), &curve(law)).same_colour();
        }
        figure.dashed(&format!("{name} of Table II"), &curve(paper)).same_colour();
    }
    report.finish(options)?;
    figure.write(&options.out.join("obs-model-strengths.svg"))
}

/// A law's greatest strength, and its range, km.
fn highest(law: &SkewNormal) -> (f64, f64) {
    let ranges = (0..=500).map(|i| 0.1 * f64::from(i));
    ranges.map(|km| (law.at(1e3 * km), km)).fold((0.0, 0.0), |best, x| if x.0 > best.0 { x } else { best })
}

/// Figure 5a: the stacked envelope, and the delays of the table.
fn envelope(
    options: &Options,
    all: &[SpectralFrame],
    courses: &[VesselCourse],
    table: &Propagation,
) -> Result<()> {
    let stacked = stack(all, courses, table);
    let quefrencies = stacked.first().map_or(0, Vec::len);
    let mut figure =
        Plot::new("Stacked envelope (ocean-bottom paper, figure 5a)", "range (km)", "quefrency (s)");
    let values = (0..quefrencies).flat_map(|q| stacked.iter().map(move |row| f64::from(row[q]))).collect();
    figure.heat(HeatMap {
        x: (0.0, CELLS as f64 * CELL_M / 1e3),
        y: (0.0, quefrencies as f64 / 50.0),
        columns: stacked.len(),
        values,
        strength: Vec::new(),
        range: Some((0.0, 0.1)),
        map: ColourMap::Amount,
        label: "envelope".to_owned(),
    });
    for (branch, name) in NAMES.iter().enumerate() {
        let curve = (0..table.rows()).filter_map(|row| {
            let (delay, _) = table.branch(branch, row)?;
            Some((row as f64 * table.step_m / 1e3, delay)).filter(|p| p.0 <= 50.0)
        });
        figure.dashed(&format!("{name} by rays"), &curve.collect::<Vec<_>>());
    }
    figure.write(&options.out.join("obs-model-envelope.svg"))
}

/// Figure 4c: the range by each hypothesis of each branch while a vessel passes 9 km away. The true ones agree at every
/// moment at which two branches are there; how often others do as well is what a moment alone cannot tell.
fn hypotheses(options: &Options, table: &Propagation) -> Result<()> {
    const AGREE_M: f64 = 1_000.0;
    let course = VesselCourse::straight(&Straight {
        cpa_time_s: 0.0,
        cpa_range_m: 9_000.0,
        heading_deg: 55.0,
        speed_m_s: 8.2,
        side: Side::Port,
    });
    // Ranges at which a branch has a delay.
    let ranges_of = |branch: usize, delay_s: f64| -> Vec<f64> {
        let mut before: Option<(f64, f64)> = None;
        let mut out = Vec::new();
        for row in 0..table.rows() {
            let range_m = row as f64 * table.step_m;
            let now =
                table.branch(branch, row).filter(|_| range_m <= 50_000.0).map(|(delay, _)| (range_m, delay));
            if let (Some((r0, d0)), Some((r1, d1))) = (before, now)
                && (d0 - delay_s) * (d1 - delay_s) <= 0.0
                && d0 != d1
            {
                out.push(r0 + (r1 - r0) * (delay_s - d0) / (d1 - d0));
            }
            before = now;
        }
        out
    };
    let mut figure =
        Plot::new("Ranges that delays may mean (ocean-bottom paper, figure 4c)", "time (h)", "range (km)");
    let mut curves: Vec<Vec<(f64, f64)>> = vec![Vec::new(); NAMES.len()];
    let (mut truth, mut moments, mut alone) = (Vec::new(), 0.0, 0.0);
    for k in -100..=100 {
        let t_s = 60.0 * f64::from(k);
        let Some((x, y)) = course.at(t_s) else { continue };
        let range_m = x.hypot(y);
        truth.push((t_s / 3600.0, range_m / 1e3));
        let row = (range_m / table.step_m).round() as usize;
        let delays: Vec<f64> = (0..NAMES.len()).filter_map(|b| Some(table.branch(b, row)?.0)).collect();
        // By what each branch is taken for: sets of ranges.
        let sets: Vec<Vec<f64>> = delays
            .iter()
            .map(|delay| {
                let mut ranges = Vec::new();
                for (taken, curve) in curves.iter_mut().enumerate() {
                    for range in ranges_of(taken, *delay) {
                        curve.push((t_s / 3600.0, range / 1e3));
                        ranges.push(range);
                    }
                }
                ranges
            })
            .collect();
        if let [first, others @ ..] = sets.as_slice()
            && !others.is_empty()
        {
            let near = |set: &[f64], r: f64| set.iter().any(|x| (x - r).abs() < AGREE_M);
            let agreed = first.iter().filter(|r| others.iter().all(|set| near(set, **r)));
            let wrong = agreed.filter(|r| (**r - range_m).abs() >= AGREE_M).count();
            (moments, alone) = (moments + 1.0, alone + f64::from(u8::from(wrong == 0)));
        }
    }
    for (name, curve) in NAMES.iter().zip(&curves) {
        figure.points(&format!("if it were {name}"), curve);
    }
    figure.truth("true", &truth);
    figure.write(&options.out.join("obs-model-hypotheses.svg"))?;
    let figures = &options.figures;
    figures.state("figure 4c: moments at which two branches or more have a delay", moments);
    figures.state("of these the share at which only the true range suits all, %", 100.0 * alone / moments);
    Ok(())
}

/// Figure 1: the ships about the station.
fn coverage(options: &Options) -> Result<()> {
    let frame = LocalFrame::new(RR03_DEG.0, RR03_DEG.1);
    let mut figure = Plot::map("Ships about RR03 (ocean-bottom paper, figure 1)");
    let sets = [("satellite", "ais_cls.csv.xz"), ("terrestrial", "ais_marine_traffic.csv")];
    for (name, file) in sets {
        let Some(path) = options.real(file) else {
            options.figures.state(format!("{name} AIS: positions"), None);
            continue;
        };
        let (reports, _) = crate::ais::read(&path)?;
        let places: Vec<(f64, f64)> =
            reports.iter().map(|r| frame.east_north_m(r.lat_lon_deg.0, r.lat_lon_deg.1)).collect();
        figure.points(name, &places);
        options.figures.state(format!("{name} AIS: positions"), places.len() as f64);
        let vessels: std::collections::BTreeSet<u64> = reports.iter().map(|r| r.mmsi).collect();
        options.figures.state(format!("{name} AIS: vessels"), vessels.len() as f64);
    }
    write_panels(&options.out.join("obs-model-ships.svg"), &[&figure], 1)
}
