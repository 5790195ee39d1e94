//! `reproduce network-vessels`: the counterpart of paper N's figures 5 to 8: two arrays, known depth, vessels on real
//! tracks, median errors per 20 m cell.
//!
//! Tracks: pieces of AIS tracks of the Solent where they stand beside the project (positions and manoeuvres real,
//! moved and turned so that they pass the arrays), straight ones with the fleet's speeds otherwise; which of the two is
//! printed. The sound comes from where the antenna was 2 to 15 s earlier. Each array gives a bearing a second, the
//! second array up to a second later, errors 1.5° and 1.6°, one bearing in fifty wrong altogether. Bearings are brought
//! to one time, located, and compared with the antenna's track shifted by the τ_p found from the first array [N 22].
//! Cells and bands show `√median(Δ²)` [N 23], which for Gaussian errors is 0.67 (one-dimensional) to 0.83 (round) of the
//! RMSE: it is called median error here and not compared with the bound as if it were one.

use super::network::{SIGMA, TWO, sight};
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::csv::CsvTable;
use crate::geodesy::LocalFrame;
use crate::orientation::sets::{BearingRow, gather};
use crate::plot::{ColourMap, HeatMap, Plot, write_panels};
use crate::score::median;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_locate::network::align::{AlignSettings, TimedBearing, align};
use seabearing_locate::network::known_track::{TrackPoint, position_at};
use seabearing_locate::network::{FixSettings, Region, locate, rectangular_bound};
use std::collections::BTreeMap;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "network-vessels",
    about: "paper N, figures 5 to 8: positions and median errors per cell of vessels on real tracks, two arrays, known depth",
    run,
};

/// Number of vessels (paper N).
const VESSELS: usize = 204;
/// Half-width of the area and width of a cell, metres.
const HALF_M: f64 = 1000.0;
const CELL_M: f64 = 20.0;
/// Fewest fixes of a cell [N 23].
const LEAST_FIXES: usize = 10;
const DEPTH_M: f64 = 5.0;
/// Longest gap in a vessel's reports, seconds.
const GAP_S: f64 = 60.0;

/// One fix against the truth.
struct Judged {
    truth_m: [f64; 2],
    position_m: f64,
    azimuth_deg: f64,
    range_m: f64,
}

fn run(options: &Options) -> Result<()> {
    let vessels = options.runs.unwrap_or(VESSELS);
    let real = real_tracks(options)?;
    options
        .figures
        .state("real track pieces (none: straight tracks with the fleet's speeds)", real.len() as f64);
    let bar = crate::progress::bar(vessels as u64, "network-vessels");
    let passages: Vec<(Vec<Judged>, Option<f64>, usize)> = (0..vessels)
        .into_par_iter()
        .map(|v| {
            let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
            rng.set_stream(v as u64);
            let track = passage(&real, v, &mut rng);
            let judged = judge(&track, &mut rng);
            bar.inc(1);
            judged
        })
        .collect();
    bar.finish_and_clear();
    let all: Vec<&Judged> = passages.iter().flat_map(|p| &p.0).collect();
    bands(options, &all)?;
    let shifts: Vec<f64> = passages.iter().filter_map(|p| p.1).map(f64::abs).collect();
    let refused: usize = passages.iter().map(|p| p.2).sum();
    options.figures.state("fixes", all.len() as f64);
    options.figures.state("sets without a fix", refused as f64);
    options.figures.state("vessels whose antenna shift was found", shifts.len() as f64);
    options.figures.state("median error of that shift, s", median(shifts));
    pictures(options, &all)
}

/// Pieces of real tracks, metres about their own middle, where the data are.
fn real_tracks(options: &Options) -> Result<Vec<Vec<TrackPoint>>> {
    let Some(file) = options.real("real/ais_solent_2016/SolentAIS_20160112_130211.csv") else {
        return Ok(Vec::new());
    };
    let table = CsvTable::read(&file)?;
    let time = table.column("Time")?;
    let frame = LocalFrame::new(50.8, -1.3);
    let mut reports: BTreeMap<u64, Vec<TrackPoint>> = BTreeMap::new();
    let columns = ["MMSI", "Latitude_degrees", "Longitude_degrees", "SOG_knots"];
    for (i, (_, row)) in table.numbers(columns)?.into_iter().enumerate() {
        let (Ok([mmsi, lat, lon, knots]), Some(t_s)) = (row, table.text(i, time).and_then(seconds)) else {
            continue;
        };
        let (x, y) = frame.east_north_m(lat, lon);
        if knots > 2.0 {
            reports.entry(mmsi as u64).or_default().push(TrackPoint { t_s, position_m: [x, y, -DEPTH_M] });
        }
    }
    let mut pieces = Vec::new();
    for points in reports.values_mut() {
        points.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        let mut piece: Vec<TrackPoint> = Vec::new();
        for p in points.iter() {
            if let Some(last) = piece.last() {
                let dt = p.t_s - last.t_s;
                let step = (p.position_m[0] - last.position_m[0]).hypot(p.position_m[1] - last.position_m[1]);
                // Repeated and stale reports: no time has passed, or the vessel would have jumped.
                if dt < 1.0 || (dt <= GAP_S && step > 20.0 * dt + 20.0) {
                    continue;
                }
                if dt > GAP_S {
                    keep(&mut pieces, std::mem::take(&mut piece));
                }
            }
            piece.push(*p);
        }
        keep(&mut pieces, piece);
    }
    Ok(pieces)
}

/// Keeps a piece long enough for a passage, about the position at its middle.
fn keep(pieces: &mut Vec<Vec<TrackPoint>>, mut piece: Vec<TrackPoint>) {
    let (Some(first), Some(last)) = (piece.first().copied(), piece.last().copied()) else { return };
    let way = (last.position_m[0] - first.position_m[0]).hypot(last.position_m[1] - first.position_m[1]);
    if last.t_s - first.t_s < 240.0 || way < 800.0 {
        return;
    }
    let middle = piece[piece.len() / 2];
    for p in &mut piece {
        p.t_s -= middle.t_s;
        p.position_m[0] -= middle.position_m[0];
        p.position_m[1] -= middle.position_m[1];
    }
    pieces.push(piece);
}

/// Seconds of the day of `2016-01-12 13:02:11.218`.
fn seconds(text: &str) -> Option<f64> {
    let clock = text.split_whitespace().nth(1)?;
    let mut parts = clock.split(':').map(|p| p.parse::<f64>().ok());
    Some(3600.0 * parts.next()?? + 60.0 * parts.next()?? + parts.next()??)
}

/// A track past the arrays: along one of two lanes, most of them near.
fn passage(real: &[Vec<TrackPoint>], vessel: usize, rng: &mut ChaCha8Rng) -> Vec<TrackPoint> {
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    let lane = if vessel.is_multiple_of(2) { 150.0 } else { 60.0 };
    let heading = (lane + 10.0 * normal()) * RAD_PER_DEG;
    let aside = 300.0 * normal();
    let (s, c) = heading.sin_cos();
    // In the vessel's own frame: along, across.
    let own: Vec<(f64, [f64; 2])> = if real.is_empty() {
        let speed = (7.3 + 2.3 * normal()).clamp(1.0, 11.0);
        (-60..=60).map(|k| 10.0 * f64::from(k)).map(|t| (t, [speed * t, 0.0])).collect()
    } else {
        let piece = &real[vessel % real.len()];
        let (a, b) = (piece[0].position_m, piece[piece.len() - 1].position_m);
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let d = dx.hypot(dy);
        piece
            .iter()
            .map(|p| {
                let [x, y, _] = p.position_m;
                (p.t_s, [(x * dx + y * dy) / d, (y * dx - x * dy) / d])
            })
            .collect()
    };
    own.into_iter()
        .map(|(t_s, [along, across])| {
            let across = across + aside;
            TrackPoint { t_s, position_m: [along * s - across * c, along * c + across * s, -DEPTH_M] }
        })
        .collect()
}

/// Fixes of a passage against the antenna's corrected track; error of the shift; sets without a fix.
fn judge(track: &[TrackPoint], rng: &mut ChaCha8Rng) -> (Vec<Judged>, Option<f64>, usize) {
    let shift = 2.0 + 13.0 * rng.random::<f64>();
    let late = rng.random::<f64>();
    let (first, last) = (track[0].t_s, track[track.len() - 1].t_s);
    let mut rows = Vec::new();
    let mut heard = Vec::new();
    for k in 0..(last - first) as u32 {
        for (station, array_m) in TWO.iter().enumerate() {
            let t_s = first + f64::from(k) + late * station as f64;
            let Some(p) = position_at(track, t_s - shift, GAP_S) else { continue };
            if p[0].abs() > HALF_M || p[1].abs() > HALF_M {
                continue;
            }
            let seen = sight(&[*array_m], &p, rng)[0];
            let wrong =
                if rng.random::<f64>() < 0.02 { std::f64::consts::TAU * rng.random::<f64>() } else { 0.0 };
            rows.push(BearingRow {
                t_s,
                station,
                azimuth: seen.azimuth + wrong,
                elevation: seen.elevation,
                sd: SIGMA,
            });
            if station == 0 {
                heard.push(TimedBearing {
                    t_s,
                    azimuth: Some(seen.azimuth + wrong),
                    elevation: seen.elevation,
                });
            }
        }
    }
    let found = align(
        &heard,
        track,
        &AlignSettings { array_m: TWO[0], sd: [SIGMA.0, SIGMA.1], largest_shift_s: 40.0, gap_s: GAP_S },
    );
    let Ok(found) = found else { return (Vec::new(), None, 0) };
    let settings = FixSettings { region: Region::at_depth([0.0, 0.0], 2000.0, -DEPTH_M), robust: true };
    let (mut out, mut refused) = (Vec::new(), 0);
    for set in gather(&mut rows, &TWO).iter().filter(|s| s.sightings.len() == 2) {
        let Some([x, y, _]) = position_at(track, set.t_s - found.shift_s, GAP_S) else { continue };
        match locate(&set.sightings, &settings) {
            Ok(fix) => {
                let [fx, fy, _] = fix.position_m;
                out.push(Judged {
                    truth_m: [x, y],
                    position_m: (fx - x).hypot(fy - y),
                    azimuth_deg: wrap_pi(fx.atan2(fy) - x.atan2(y)) / RAD_PER_DEG,
                    range_m: fx.hypot(fy) - x.hypot(y),
                });
            }
            Err(_) => refused += 1,
        }
    }
    (out, Some(found.shift_s - shift), refused)
}

/// Figure 8: median errors over bands of range, beside the bound.
fn bands(options: &Options, all: &[&Judged]) -> Result<()> {
    let mut report =
        CsvReport::new("network-vessels", "range_m,fixes,median_m,crb_m,median_az_deg,median_range_m");
    let mut curve = Vec::new();
    for k in 0..10 {
        let middle = 50.0 + 100.0 * f64::from(k);
        let band: Vec<&&Judged> =
            all.iter().filter(|j| (j.truth_m[0].hypot(j.truth_m[1]) - middle).abs() < 50.0).collect();
        let of = |f: &dyn Fn(&Judged) -> f64| median(band.iter().map(|j| f(j).abs()).collect());
        // Bound averaged over azimuth, as the vessels pass on all sides.
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let bounds: Vec<f64> = (0..12)
            .filter_map(|a| {
                let (s, c) = (30.0 * f64::from(a) * RAD_PER_DEG).sin_cos();
                let p = [middle * s, middle * c, -DEPTH_M];
                rectangular_bound(&sight(&TWO, &p, &mut rng), &p).ok()?.horizontal_known_depth_m()
            })
            .collect();
        let crb = (bounds.iter().map(|b| b * b).sum::<f64>() / bounds.len() as f64).sqrt();
        let values = [
            middle,
            band.len() as f64,
            of(&|j| j.position_m),
            crb,
            of(&|j| j.azimuth_deg),
            of(&|j| j.range_m),
        ];
        report.row(&values);
        curve.push(values);
    }
    report.finish(options)?;
    let pick = |i: usize| curve.iter().map(|r| (r[0], r[i])).collect::<Vec<_>>();
    let panel = |label: &str, series: &[(&str, usize)]| {
        let mut f = Plot::new(label, "horizontal range (m)", label);
        f.size(420, 360);
        for (name, i) in series {
            f.line(name, &pick(*i));
        }
        f
    };
    let panels = [
        panel("azimuth error (°)", &[("median", 4)]),
        panel("range error (m)", &[("median", 5)]),
        panel("position error (m)", &[("median", 2), ("bound (RMSE)", 3)]),
    ];
    write_panels(&options.out.join("network-vessels-range.svg"), &panels.each_ref(), 3)
}

/// Figures 5 to 7: positions and median errors per cell.
fn pictures(options: &Options, all: &[&Judged]) -> Result<()> {
    let columns = (2.0 * HALF_M / CELL_M) as usize;
    let mut cells: Vec<Vec<&Judged>> = vec![Vec::new(); columns * columns];
    for j in all {
        let index = |x: f64| ((x + HALF_M) / CELL_M).floor();
        let (c, r) = (index(j.truth_m[0]), index(j.truth_m[1]));
        if c >= 0.0 && r >= 0.0 && (c as usize) < columns && (r as usize) < columns {
            cells[r as usize * columns + c as usize].push(j);
        }
    }
    let map = |title: &str, label: &str, top: f64, f: &dyn Fn(&Judged) -> f64| {
        let values = cells
            .iter()
            .map(|cell| {
                if cell.len() < LEAST_FIXES {
                    f64::NAN
                } else {
                    median(cell.iter().map(|j| f(j).abs()).collect())
                }
            })
            .collect();
        let mut figure = Plot::map(title);
        figure.size(520, 470).heat(HeatMap {
            x: (-HALF_M, HALF_M),
            y: (-HALF_M, HALF_M),
            columns,
            values,
            strength: Vec::new(),
            range: Some((0.0, top)),
            map: ColourMap::Amount,
            label: label.to_owned(),
        });
        figure
    };
    // Figure 5: where the vessels were.
    let most = cells.iter().map(Vec::len).max().unwrap_or(1);
    let mut where_heard = Plot::map("Positions");
    where_heard.size(520, 470).heat(HeatMap {
        x: (-HALF_M, HALF_M),
        y: (-HALF_M, HALF_M),
        columns,
        values: cells.iter().map(|c| if c.is_empty() { f64::NAN } else { c.len() as f64 }).collect(),
        strength: Vec::new(),
        range: Some((0.0, most as f64)),
        map: ColourMap::Amount,
        label: "positions in a cell".to_owned(),
    });
    let panels = [
        where_heard,
        map("Azimuth", "median error (°)", 3.0, &|j| j.azimuth_deg),
        map("Range", "median error (m)", 100.0, &|j| j.range_m),
        map("Position", "median error (m)", 100.0, &|j| j.position_m),
    ];
    write_panels(&options.out.join("network-vessels-map.svg"), &panels.each_ref(), 2)
}
