//! Tracks beside AIS: how many are matched right, and whether what does not report stays dark.
//!
//! Vessels move as the real ones did (Solent, every few seconds; about RR03, every few minutes). Stations beside their ways
//! report them with honest errors: an azimuth and a range that are wrong by one draw for the whole passage, a white error a
//! report on top, both in the covariance; heading and speed likewise. The matcher is given every second AIS report only, and
//! none at all of every fifth vessel.

use super::figure::Figures;
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::ais::{AisReport, IMPOSSIBLE_M_S, read};
use crate::course::{Fix, polar};
use crate::csv::CsvText;
use crate::geodesy::LocalFrame;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use seabearing_core::angle::wrap_pi;
use seabearing_core::kit::straight_line::through;
use seabearing_watch::ais::{Fleet, Vessel};
use seabearing_watch::errors::{of_track, over_fleet};
use seabearing_watch::matching::{Heard, Rules, Verdict, judge};
use seabearing_watch::report::{Covariance, TrackId, TrackReport, VesselId};
use std::collections::{BTreeMap, BTreeSet};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "ais-match",
    about: "tracks of real vessels' ways with honest noise, matched with AIS from which every fifth vessel is missing",
    run,
};

/// A sea with its stations.
struct Sea {
    name: &'static str,
    file: &'static str,
    /// Stations lie this far from some vessel's way, m.
    aside_m: (f64, f64),
    /// Range within which a vessel is heard, m.
    heard_m: f64,
    /// Time between reports of a track, s.
    every_s: f64,
    /// Shortest track, reports.
    least: usize,
    /// Longest gap between AIS reports that truth bridges, s.
    gap_s: f64,
    /// Truth is the straight line through the reports within so long either side, s: positions and times are coarse.
    reach_s: f64,
    /// Where a report lies further from that line truth is not known, m.
    known_m: f64,
    /// Errors that a passage keeps: share of the range, azimuth (rad), speed (share), heading (rad).
    lasting: [f64; 4],
}

const SEAS: [Sea; 2] = [
    Sea {
        name: "harbours (Solent, arrays)",
        file: "real/ais_solent_2016/SolentAIS_20160112_130211.csv",
        aside_m: (150.0, 800.0),
        heard_m: 2000.0,
        every_s: 10.0,
        least: 12,
        gap_s: 60.0,
        reach_s: 30.0,
        known_m: 60.0,
        lasting: [0.05, 0.01, 0.05, 0.05],
    },
    Sea {
        name: "open sea (RR03, ocean bottom)",
        file: "ais_marine_traffic.csv",
        aside_m: (1000.0, 12_000.0),
        heard_m: 25_000.0,
        every_s: 60.0,
        least: 20,
        gap_s: 900.0,
        reach_s: 900.0,
        known_m: 400.0,
        lasting: [0.05, 0.03, 0.05, 0.05],
    },
];
const STATIONS: u16 = 40;
/// Every so manieth vessel is left out of AIS.
const DARK_EVERY: usize = 5;
/// Slower vessels are not heard, m/s.
const LEAST_M_S: f64 = 1.5;
/// Vessels nearer to each other in azimuth give one bearing between them, rad.
const MERGED_RAD: f64 = 0.05;
/// White error of a report, share of its range.
const WHITE: f64 = 0.02;

fn run(options: &Options) -> Result<()> {
    let mut report = CsvReport::new(
        "ais-match",
        "sea,tracks,dark,right,wrong,dark_matched,vessel_called_dark,unmatched,mean_distance2",
    );
    let mut all = [0usize; 4];
    let mut any = false;
    for (n, sea) in SEAS.iter().enumerate() {
        let Some(path) = options.real(sea.file) else { continue };
        any = true;
        let counts = of_sea(options, sea, n, &read(&path)?.0, &mut report)?;
        all.iter_mut().zip(counts).for_each(|(a, b)| *a += b);
    }
    let [reporting, right, wrong, dark] = all.map(|n| n as f64);
    let share = |x: f64| any.then_some(100.0 * x / reporting);
    let figures: &Figures = &options.figures;
    figures.at_least("tracks of reporting vessels matched right, %", share(right), 95.0);
    figures.at_most("tracks matched with a wrong vessel, %", share(wrong), 1.0);
    figures.at_most("tracks of vessels without AIS matched with one", any.then_some(dark), 0.0);
    report.finish(options)
}

/// The ways of all vessels: pieces without long gaps and impossible legs.
fn ways(reports: &[AisReport], sea: &Sea, about: (f64, f64)) -> Vec<(u64, Vec<Fix>)> {
    let mut out = Vec::new();
    for (mmsi, track) in crate::ais::tracks(reports, about) {
        let mut piece: Vec<Fix> = Vec::new();
        for (fix, _) in track {
            let breaks = piece.last().is_some_and(|last| {
                let (dt, d) = (fix.0 - last.0, (fix.1.0 - last.1.0).hypot(fix.1.1 - last.1.1));
                dt > sea.gap_s || d > IMPOSSIBLE_M_S * dt
            });
            if breaks {
                out.push((mmsi, std::mem::take(&mut piece)));
            }
            piece.push(fix);
        }
        out.push((mmsi, piece));
    }
    out.retain(|(_, piece)| piece.len() >= 10);
    out
}

/// Reporting vessels' tracks, right ones, wrong ones, matched dark ones.
fn of_sea(
    options: &Options,
    sea: &Sea,
    stream: usize,
    reports: &[AisReport],
    out: &mut CsvReport,
) -> Result<[usize; 4]> {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(stream as u64);
    let about = reports.first().map_or((0.0, 0.0), |r| r.lat_lon_deg);
    let frame = LocalFrame::new(about.0, about.1);
    let ways = ways(reports, sea, about);
    let vessels: BTreeSet<u64> = ways.iter().map(|(mmsi, _)| *mmsi).collect();
    let dark: BTreeSet<u64> = vessels.iter().copied().skip(2).step_by(DARK_EVERY).collect();
    let everybody = Fleet::of(reports, &BTreeMap::new());
    let (mut tracks, mut truth, mut together) = (Vec::new(), Vec::new(), 0);
    for station in 1..=options.runs.map_or(STATIONS, |n| n as u16) {
        // Beside some moving vessel's way.
        let (_, way) = &ways[rng.random_range(0..ways.len())];
        let (_, (x, y)) = way[rng.random_range(0..way.len())];
        let (s, c) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
        let aside = rng.random_range(sea.aside_m.0..sea.aside_m.1);
        let place = (x + aside * s, y + aside * c);
        let own = frame.lat_lon_deg(place.0, place.1);
        let own = LocalFrame::new(own.0, own.1);
        let mut here: Vec<(u64, Vec<TrackReport>)> = Vec::new();
        for (mmsi, way) in &ways {
            let moved: Vec<Fix> =
                way.iter().map(|(t, (x, y))| (*t, own_place(&frame, &own, (*x, *y)))).collect();
            here.extend(passage(sea, &moved, &mut rng).into_iter().map(|track| (*mmsi, track)));
        }
        for (mmsi, reports) in &here {
            if is_one_sound(sea, *mmsi, reports, &own, &everybody) {
                together += 1;
                continue;
            }
            let vessel = VesselId::Track(TrackId {
                station: Some(station),
                session: Some(1),
                id: tracks.len() as u16,
            });
            let reports =
                reports.iter().map(|r| TrackReport { vessel, station: Some(station), ..*r }).collect();
            tracks.push(Heard { vessel, stations: vec![Some(station)], frame: own, reports });
            truth.push(*mmsi);
        }
    }
    // AIS as the matcher gets it: without the dark ones, every second report.
    let mut seen: BTreeMap<u64, usize> = BTreeMap::new();
    let thin: Vec<AisReport> = reports
        .iter()
        .filter(|r| !dark.contains(&r.mmsi))
        .filter(|r| {
            let n = seen.entry(r.mmsi).or_default();
            *n += 1;
            n.is_multiple_of(2)
        })
        .copied()
        .collect();
    let (fleet, rules) = (Fleet::of(&thin, &BTreeMap::new()), Rules::default());
    let verdicts = judge(&tracks, &fleet, &rules);
    let (mut reporting, mut right, mut wrong, mut dark_matched, mut called_dark, mut unmatched) =
        (0, 0, 0, 0, 0, 0);
    let mut errors = Vec::new();
    let mut list =
        CsvText::new("mmsi,reports_ais,station,track,reports,range_m,verdict,vessel,probability,distance2");
    for ((heard, verdict), mmsi) in tracks.iter().zip(&verdicts).zip(&truth) {
        let is_dark = dark.contains(mmsi);
        reporting += usize::from(!is_dark);
        let range_m = heard.reports[heard.reports.len() / 2].place.map_or(f64::NAN, |(p, _)| polar(p).0);
        let (said, of, p, d2) = match verdict {
            Verdict::Vessel { vessel, probability, distance2 } => {
                ("vessel", fleet.vessels[*vessel].mmsi.to_string(), *probability, *distance2)
            }
            Verdict::Dark { probability } => ("dark", String::new(), *probability, f64::NAN),
            Verdict::Unmatched(reason) => (reason.as_str(), String::new(), f64::NAN, f64::NAN),
        };
        let VesselId::Track(track) = heard.vessel else { continue };
        let station = track.station.unwrap_or(0);
        list.row(&[
            mmsi,
            &!is_dark,
            &station,
            &track.id,
            &heard.reports.len(),
            &range_m.round(),
            &said,
            &of,
            &p,
            &d2,
        ]);
        match verdict {
            Verdict::Vessel { .. } if is_dark => dark_matched += 1,
            Verdict::Vessel { vessel, .. } => {
                let of = &fleet.vessels[*vessel];
                right += usize::from(of.mmsi == *mmsi);
                wrong += usize::from(of.mmsi != *mmsi);
                errors.extend(of_track(heard, of, &fleet, &rules).map(|e| (e, of.length_m)));
            }
            Verdict::Dark { .. } => called_dark += usize::from(!is_dark),
            Verdict::Unmatched(_) => unmatched += 1,
        }
    }
    let file = options.out.join(format!("ais-match-tracks-{stream}.csv"));
    crate::atomic::write(&file, list.finish().as_bytes())?;
    let record = over_fleet(&verdicts, &errors);
    let distance2 = record["mean_distance2"].as_f64();
    out.row(&[
        stream as f64,
        tracks.len() as f64,
        truth.iter().filter(|m| dark.contains(m)).count() as f64,
        right as f64,
        wrong as f64,
        dark_matched as f64,
        called_dark as f64,
        unmatched as f64,
        distance2.unwrap_or(f64::NAN),
    ]);
    options.figures.state(format!("{}: mean squared standardised distance (2: honest)", sea.name), distance2);
    options.figures.state(
        format!("{}: tracks left out, of vessels within 3° of another", sea.name),
        f64::from(together),
    );
    Ok([reporting, right, wrong, dark_matched])
}

/// A place of one frame in another.
fn own_place(from: &LocalFrame, to: &LocalFrame, (x, y): (f64, f64)) -> (f64, f64) {
    let (lat, lon) = from.lat_lon_deg(x, y);
    to.east_north_m(lat, lon)
}

/// Whether other vessels under way that the station hears, by all their reports, are nearer to one in azimuth, for half of
/// its track and more, than a recorder tells apart. They need no track of their own: of some the truth is not sharp enough
/// for one, and they sound nevertheless.
fn is_one_sound(sea: &Sea, mmsi: u64, track: &[TrackReport], own: &LocalFrame, everybody: &Fleet) -> bool {
    let others: Vec<&Vessel> = everybody.vessels.iter().filter(|v| v.mmsi != mmsi).collect();
    let beside = |report: &&TrackReport| {
        let (Some((t_s, _)), Some(((x, y), _))) = (report.utc_s, report.place) else { return false };
        others.iter().any(|v| {
            let placed = v.at(t_s, own, Rules::default().gap_s, everybody.time_sd_s);
            placed.is_some_and(|p| {
                let ((px, py), (vx, vy)) = (p.place_m, p.velocity_m_s);
                let heard = px.hypot(py) <= sea.heard_m && vx.hypot(vy) >= LEAST_M_S;
                heard && wrap_pi(px.atan2(py) - x.atan2(y)).abs() < MERGED_RAD
            })
        })
    };
    2 * track.iter().filter(beside).count() > track.len()
}

/// Place and velocity by the straight line through the reports about a time; `None` where there are too few,
/// or they do not lie on one.
fn truth_at(fixes: &[Fix], t_s: f64, sea: &Sea) -> Option<((f64, f64), (f64, f64))> {
    let from = fixes.partition_point(|f| f.0 < t_s - sea.reach_s);
    let near = || fixes[from..].iter().take_while(|f| f.0 <= t_s + sea.reach_s);
    let sides = near().filter(|f| f.0 <= t_s).count().min(near().filter(|f| f.0 >= t_s).count());
    let x = through(near().map(|(t, p)| (t - t_s, p.0)))?;
    let y = through(near().map(|(t, p)| (t - t_s, p.1)))?;
    let off = |(t, p): &Fix| (p.0 - x.at(t - t_s)).hypot(p.1 - y.at(t - t_s));
    let known = near().all(|fix| off(fix) <= sea.known_m);
    (sides >= 2 && known).then_some(((x.value, y.value), (x.slope, y.slope)))
}

/// What a station reports of a vessel: a track for each stretch in which it is near and under way.
fn passage(sea: &Sea, fixes: &[Fix], rng: &mut ChaCha8Rng) -> Vec<Vec<TrackReport>> {
    let near = |f: &Fix| polar(f.1).0 <= sea.heard_m;
    if fixes.len() < 2 || !fixes.iter().any(near) {
        return Vec::new();
    }
    let (first, last) = (fixes[0].0, fixes[fixes.len() - 1].0);
    let (mut out, mut now) = (Vec::new(), Vec::new());
    let mut lasting = [0.0; 4];
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    for k in 0..=((last - first) / sea.every_s) as usize {
        let t_s = first + sea.every_s * k as f64;
        let Some((place, (vx, vy))) = truth_at(fixes, t_s, sea) else {
            out.push(std::mem::take(&mut now));
            continue;
        };
        let ((range, azimuth), speed) = (polar(place), vx.hypot(vy));
        if range > sea.heard_m || range < 1.0 || speed < LEAST_M_S {
            out.push(std::mem::take(&mut now));
            continue;
        }
        if now.is_empty() {
            lasting = sea.lasting.map(|sd| sd * normal());
        }
        let [sd_range, sd_azimuth, sd_speed, sd_heading] = sea.lasting;
        let wrong_range = range * (lasting[0] + WHITE * normal());
        let wrong_azimuth = lasting[1] + 0.5 * sd_azimuth * normal();
        let (s, c) = (azimuth + wrong_azimuth).sin_cos();
        let r = range + wrong_range;
        let along = range * range * (sd_range * sd_range + WHITE * WHITE);
        let across = range * range * 1.25 * sd_azimuth * sd_azimuth;
        now.push(TrackReport {
            vessel: VesselId::Track(TrackId { station: None, session: None, id: 0 }),
            station: None,
            is_final: false,
            is_withdrawn: false,
            utc_s: Some((t_s, Some(0.1))),
            place: Some(((r * s, r * c), Covariance::along_across((s, c), along, across))),
            heading_rad: Some((vx.atan2(vy) + lasting[3], sd_heading)),
            speed_m_s: Some((speed * (1.0 + lasting[2]), speed * sd_speed)),
            cpa_utc_s: None,
            cpa_range_m: None,
        });
    }
    out.push(now);
    out.retain(|track| track.len() >= sea.least);
    out
}
