//! Pictures of what a recorder reports: bearings against time, tracks on a map, correlations of the pairs.

use super::correlation::Correlations;
use super::times::Times;
use super::{Plot, Scale, cut_at_wraps};
use crate::angle::turn_deg;
use crate::world::truth::Truth;
use anyhow::{Result, anyhow};
use seabearing_core::block::Frame;
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::geometry::PAIRS;
use seabearing_core::kit::median;
use seabearing_core::wire::{Bearing, Track};
use std::collections::BTreeMap;
use time::OffsetDateTime;

/// Half the width of a 95 % interval of a Gaussian, in standard deviations.
const Z95: f64 = 1.959_964;

/// Azimuths against time with their 95 % band, and the truth where known.
pub fn bearings(bearings: &[Bearing], rate_hz: f64, times: &Times, truth: &[(String, Vec<Truth>)]) -> Plot {
    let mut figure = Plot::new("Bearings of the recorder", "", "azimuth (°)");
    figure.y_scale(Scale::Degrees);
    times.along(&mut figure);
    let at = |b: &Bearing| b.index as f64 / rate_hz;
    let deg = |x: f32| f64::from(x).to_degrees();
    let mut band = Vec::new();
    let mut points = Vec::new();
    let mut last: Option<(f64, f64)> = None;
    // Time between bearings, to notice where there were none.
    let mut steps: Vec<f64> = bearings.windows(2).map(|w| at(&w[1]) - at(&w[0])).collect();
    let usual = median(&mut steps).unwrap_or(1.0);
    for b in bearings {
        let (t, azimuth) = (at(b), deg(b.azimuth));
        let half = Z95 * deg(b.var_azimuth.max(0.0).sqrt());
        if last.is_some_and(|(t0, a0)| t - t0 > 4.0 * usual || (azimuth - a0).abs() > 90.0) {
            band.push((times.at(t), f64::NAN, f64::NAN));
        }
        band.push((times.at(t), azimuth - half, azimuth + half));
        points.push((times.at(t), azimuth));
        last = Some((t, azimuth));
    }
    figure.band("95 % band", &band).points("bearings", &points).same_colour();
    for (i, (_, rows)) in truth.iter().enumerate() {
        let line: Vec<_> = rows.iter().map(|r| (times.at(r.t_s), r.arrival_azimuth_deg)).collect();
        figure.truth(&legend(truth, i), &cut_at_wraps(&line));
    }
    figure
}

/// One entry for all vessels: their lines look alike.
fn legend(truth: &[(String, Vec<Truth>)], i: usize) -> String {
    let names: Vec<&str> = truth.iter().map(|(n, _)| n.as_str()).collect();
    if i == 0 { format!("truth: {}", names.join(", ")) } else { String::new() }
}

/// Error of each azimuth against the nearest vessel's truth, with the 95 % band the recorder states.
pub fn bearing_errors(
    bearings: &[Bearing],
    rate_hz: f64,
    times: &Times,
    truth: &[(String, Vec<Truth>)],
) -> Plot {
    let mut figure = Plot::new("Errors of the bearings", "", "azimuth error (°)");
    times.along(&mut figure);
    let mut band = Vec::new();
    let mut errors = Vec::new();
    for b in bearings {
        let t = b.index as f64 / rate_hz;
        let azimuth = f64::from(b.azimuth).to_degrees();
        let nearest = truth
            .iter()
            .filter_map(|(_, rows)| Truth::azimuth_at(rows, t))
            .map(|a| turn_deg(a, azimuth))
            .min_by(|a, b| a.abs().total_cmp(&b.abs()));
        if let Some(error) = nearest {
            let half = Z95 * f64::from(b.var_azimuth.max(0.0).sqrt()).to_degrees();
            band.push((times.at(t), -half, half));
            errors.push((times.at(t), error));
        }
    }
    figure.band("95 % band as reported", &band).points("error", &errors);
    figure
}

/// Elevations against time with their 95 % band.
fn elevations(bearings: &[Bearing], rate_hz: f64, times: &Times) -> Plot {
    let mut figure = Plot::new("Elevations", "", "elevation (°)");
    times.along(&mut figure);
    let deg = |x: f32| f64::from(x).to_degrees();
    let at = |b: &Bearing| times.at(b.index as f64 / rate_hz);
    let half = |b: &Bearing| Z95 * deg(b.var_elevation.max(0.0).sqrt());
    let band = |b: &Bearing| (at(b), deg(b.elevation) - half(b), deg(b.elevation) + half(b));
    figure.band("95 % band", &bearings.iter().map(band).collect::<Vec<_>>());
    let points: Vec<_> = bearings.iter().map(|b| (at(b), deg(b.elevation))).collect();
    figure.points("bearings", &points).same_colour();
    figure
}

/// Tracks on a map: the positions as reported, 95 % ellipses of the last, and the truth where known.
pub fn tracks(reports: &[Track], rate_hz: f64, truth: &[(String, Vec<Truth>)]) -> Plot {
    let mut figure = Plot::map("Tracks");
    for (i, (_, rows)) in truth.iter().enumerate() {
        let line: Vec<_> = rows.iter().map(|r| (r.x_m, r.y_m)).collect();
        figure.truth(&legend(truth, i), &line);
    }
    let mut by_id: BTreeMap<u16, Vec<&Track>> = BTreeMap::new();
    for report in reports {
        by_id.entry(report.id).or_default().push(report);
    }
    by_id.retain(|_, reports| reports.iter().all(|t| t.stage != Track::WITHDRAWN));
    for (id, reports) in by_id {
        let placed = |t: &&Track| t.range_observable && t.x_m.is_finite() && t.y_m.is_finite();
        let line: Vec<_> = reports
            .iter()
            .filter(|t| placed(t) && t.stage == 0)
            .map(|t| (f64::from(t.x_m), f64::from(t.y_m)))
            .collect();
        figure.points(&format!("track {id} as it was reported"), &line);
        let Some(last) = reports.iter().rev().find(|t| placed(t)) else { continue };
        let variances = (last.var_x_m2.into(), last.var_y_m2.into(), last.cov_xy_m2.into());
        if last.stage == 1 {
            figure.line(&format!("track {id}, final"), &fitted(last, &reports, rate_hz)).same_colour();
        }
        figure.ellipse("95 % ellipse", (last.x_m.into(), last.y_m.into()), variances, 0.95).same_colour();
    }
    figure
}

/// The straight course of a final solution, from the time of the first report to that of the last.
fn fitted(last: &Track, reports: &[&Track], rate_hz: f64) -> [(f64, f64); 2] {
    let (x, y) = (f64::from(last.x_m), f64::from(last.y_m));
    let (s, c) = f64::from(last.heading).sin_cos();
    let first = reports.first().map_or(last.index, |t| t.index.min(last.index));
    let back = (last.index - first) as f64 / rate_hz * f64::from(last.speed_m_s);
    [(x - back * s, y - back * c), (x, y)]
}

/// Cross-correlations of the six pairs against lag, in the order of [`PAIRS`]; the delays of a bearing are marked.
pub fn correlations(found: &Correlations, delays_s: &[f64; 6]) -> [Plot; 6] {
    std::array::from_fn(|p| {
        let (i, j) = PAIRS[p];
        let mut figure = Plot::new(&format!("Hydrophones {i} and {j}"), "lag (ms)", "correlation");
        figure.size(420, 300);
        let points: Vec<_> = found.lags_s.iter().zip(&found.curves[p]).map(|(l, v)| (l * 1e3, *v)).collect();
        let (lo, hi) = points.iter().fold((0.0f64, 0.0f64), |(a, b), p| (a.min(p.1), b.max(p.1)));
        let lag = delays_s[p] * 1e3;
        figure.line("correlation (PHAT)", &points).dashed("delay of the bearing", &[(lag, lo), (lag, hi)]);
        figure
    })
}

/// Delays of the six pairs, s, for sound from a direction (radians) at the station's reference range: positive where the
/// second hydrophone hears later.
///
/// # Errors
/// The station is no array.
pub fn delays(config: &StationConfig, azimuth: f64, elevation: f64) -> Result<[f64; 6]> {
    let geometry = config.geometry().map_err(|e| anyhow!("{e:?}"))?;
    let Kind::Array(array) = &config.kind else { return Err(anyhow!("delays need a station of kind array")) };
    // Half the Earth's circumference away is as good as infinitely far.
    let range = array.reference_range_m.min(2e7);
    let (sa, ca) = azimuth.sin_cos();
    let (se, ce) = elevation.sin_cos();
    let source = [range * sa * ce, range * ca * ce, range * se];
    let arrival = geometry.position_m.map(|h| {
        let d: f64 = source.iter().zip(h).map(|(s, h)| (s - f64::from(h)).powi(2)).sum();
        d.sqrt() / f64::from(geometry.sound_speed_m_s)
    });
    Ok(PAIRS.map(|(i, j)| arrival[j] - arrival[i]))
}

/// All pictures of one array recording: `bearings.svg` (azimuths and elevations), `tracks.svg`, with truth `errors.svg`, and with the samples of a
/// segment about a bearing `correlations.svg`. `start`: UTC of sample 0.
///
/// # Errors
/// The folder cannot be written.
pub fn write_all(
    folder: &std::path::Path,
    config: &StationConfig,
    start: Option<OffsetDateTime>,
    (found, reports): (&[Bearing], &[Track]),
    truth: &[(String, Vec<Truth>)],
    segment: Option<(&Bearing, &[Frame])>,
) -> Result<()> {
    let longest_s = found.last().map_or(0.0, |b| b.index as f64 / config.rate_hz);
    let times = Times::new(start, longest_s);
    let azimuths = bearings(found, config.rate_hz, &times, truth);
    let elevations = elevations(found, config.rate_hz, &times);
    super::write_panels(&folder.join("bearings.svg"), &[&azimuths, &elevations], 1)?;
    tracks(reports, config.rate_hz, truth).write(&folder.join("tracks.svg"))?;
    if !truth.is_empty() {
        bearing_errors(found, config.rate_hz, &times, truth).write(&folder.join("errors.svg"))?;
    }
    if let Some((bearing, frames)) = segment {
        let curves = super::correlation::correlations(frames, config)?;
        let delays = delays(config, bearing.azimuth.into(), bearing.elevation.into())?;
        let figures = correlations(&curves, &delays);
        let all: Vec<&Plot> = figures.iter().collect();
        super::write_panels(&folder.join("correlations.svg"), &all, 3)?;
    }
    Ok(())
}
