//! `reproduce difar`: compass offsets of real sonobuoys from the noise of a ship of known track, and how the errors of
//! real bearings are distributed.
//!
//! Data: 604 bearings (whole degrees, 300 to 600 Hz) of a research ship that leaves freshly dropped DIFAR buoys, with
//! its GPS antenna; the sound comes from where the antenna was some seconds before, the same for all buoys [N 22]. They stand beside the project, not in it; without them the experiment says so and ends. Per buoy the
//! robust offset of `seabearing_locate::orient::offset`, against the median residual and against least squares: how much
//! of the corrected bearings lies within 7°, how well one half of a ship's track is predicted from the other half, and
//! how far the tails are from Gaussian.

use super::difar_tracks::{self, tracks};
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::angle::turn_deg;
use crate::csv::CsvTable;
use crate::geodesy::LocalFrame;
use crate::plot::{Plot, Scale};
use crate::score::median;
use anyhow::{Context, Result};
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_locate::orient::offset::{LEAST_RESIDUALS, Residual, offset};
use std::collections::BTreeMap;
use std::path::Path;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "difar",
    about: "real DIFAR buoys: compass offsets from a ship's own noise, and the tails of real bearing errors",
    run,
};

/// One bearing of a buoy: time of day (s), the ship's antenna East and North of the buoy (m), measured azimuth (°).
#[derive(Debug, Clone, Copy)]
struct Heard {
    t_s: f64,
    antenna_m: [f64; 2],
    measured_deg: f64,
}

/// The bearings of every buoy in order of time.
type Buoys = BTreeMap<(String, String), Vec<Heard>>;

/// The figures the issue asks for.
#[derive(Debug, Clone)]
pub struct DifarScore {
    /// Buoys with enough bearings, and bearings of them.
    pub buoys: usize,
    /// Bearings of those.
    pub bearings: usize,
    /// How far the sound source is behind the antenna, seconds of the ship's way [N 22], common to all buoys.
    pub shift_s: f64,
    /// Share of the buoys whose offset lies within 1° of the median residual.
    pub within_1_deg_of_median: f64,
    /// Largest such difference, degrees.
    pub largest_from_median_deg: f64,
    /// Share of the corrected bearings within 7°.
    pub within_7_deg: f64,
    /// Root mean square difference of the offsets from a track's alternate bearings: robust, least squares, degrees.
    pub repeat_deg: [f64; 2],
    /// Mean absolute error of a bearing predicted from the others of its track: robust, least squares, degrees.
    pub predicted_deg: [f64; 2],
    /// Excess kurtosis of the corrected bearings' errors (Gaussian: zero).
    pub excess_kurtosis: f64,
    /// Errors after correction, degrees.
    pub errors_deg: Vec<f64>,
}

/// Judges the buoys of a file.
///
/// # Errors
/// The file is not as its description says.
pub fn score(file: &Path) -> Result<DifarScore> {
    let buoys = read(file)?;
    let shift_s = common_shift(&buoys);
    let buoys: Vec<Vec<f64>> = buoys.values().map(|b| residuals(b, shift_s)).collect();
    let mut s = DifarScore {
        buoys: 0,
        bearings: 0,
        shift_s,
        within_1_deg_of_median: 0.0,
        largest_from_median_deg: 0.0,
        within_7_deg: 0.0,
        repeat_deg: [0.0; 2],
        predicted_deg: [0.0; 2],
        excess_kurtosis: 0.0,
        errors_deg: Vec::new(),
    };
    let (mut halves, mut predictions) = (0.0, 0.0);
    for residuals in buoys.iter().filter(|r| r.len() >= LEAST_RESIDUALS) {
        let Some(robust) = robust_deg(residuals) else { continue };
        let centred: Vec<f64> = residuals.iter().map(|r| turn_deg(robust, *r)).collect();
        s.buoys += 1;
        s.bearings += centred.len();
        let away = median(centred.to_vec()).abs();
        s.within_1_deg_of_median += f64::from(u8::from(away <= 1.0));
        s.largest_from_median_deg = s.largest_from_median_deg.max(away);
        if centred.len() >= 2 * LEAST_RESIDUALS {
            let half = |k: usize| centred.iter().skip(k).step_by(2).copied().collect::<Vec<_>>();
            let (even, odd) = (half(0), half(1));
            halves += 1.0;
            s.repeat_deg[0] += (location(&even) - location(&odd)).powi(2);
            s.repeat_deg[1] += (mean(&even) - mean(&odd)).powi(2);
        }
        for i in 0..centred.len() {
            let others: Vec<f64> =
                centred.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, x)| *x).collect();
            predictions += 1.0;
            s.predicted_deg[0] += (centred[i] - location(&others)).abs();
            s.predicted_deg[1] += (centred[i] - mean(&others)).abs();
        }
        s.errors_deg.extend(centred);
    }
    s.within_1_deg_of_median /= s.buoys as f64;
    s.within_7_deg = s.errors_deg.iter().filter(|e| e.abs() <= 7.0).count() as f64 / s.bearings as f64;
    s.repeat_deg = s.repeat_deg.map(|x| (x / halves).sqrt());
    s.predicted_deg = s.predicted_deg.map(|x| x / predictions);
    let moment = |p: i32| s.errors_deg.iter().map(|e| e.powi(p)).sum::<f64>() / s.bearings as f64;
    s.excess_kurtosis = moment(4) / moment(2).powi(2) - 3.0;
    Ok(s)
}

fn read(file: &Path) -> Result<Buoys> {
    let table = CsvTable::read(file)?;
    let (station, channel) = (table.column("Station")?, table.column("Channel")?);
    let time = table.column("utc")?;
    let mut buoys = Buoys::new();
    let columns = ["BuoyLatitude", "BuoyLongitude", "BoatLat", "BoatLong", "DIFARBearing"];
    for (i, (_, row)) in table.numbers(columns)?.into_iter().enumerate() {
        let [buoy_lat, buoy_lon, lat, lon, measured_deg] = row?;
        let cell = |c| table.text(i, c).map(str::to_owned).context("a row is too short");
        let (east, north) = LocalFrame::new(buoy_lat, buoy_lon).east_north_m(lat, lon);
        let t_s = seconds(&cell(time)?).context("a time that is not like 2014-10-01T03:02:39Z")?;
        let heard = Heard { t_s, antenna_m: [east, north], measured_deg };
        buoys.entry((cell(station)?, cell(channel)?)).or_default().push(heard);
    }
    for b in buoys.values_mut() {
        b.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        b.dedup_by(|later, first| later.t_s == first.t_s);
    }
    Ok(buoys)
}

/// Seconds of the day of `2014-10-01T03:02:39Z`.
fn seconds(text: &str) -> Option<f64> {
    let mut parts = text.split('T').nth(1)?.trim_end_matches('Z').split(':').map(|p| p.parse::<f64>().ok());
    Some(3600.0 * parts.next()?? + 60.0 * parts.next()?? + parts.next()??)
}

/// True − measured azimuth, degrees, of a source so many seconds behind the antenna; the ship's way is carried on
/// straight beyond its first and last position.
fn residuals(heard: &[Heard], shift_s: f64) -> Vec<f64> {
    if heard.len() < 2 {
        return Vec::new();
    }
    heard
        .iter()
        .enumerate()
        .map(|(i, h)| {
            let j = if shift_s > 0.0 { i } else { i + 1 }.clamp(1, heard.len() - 1);
            let (a, b) = (&heard[j - 1], &heard[j]);
            let f = (h.t_s - shift_s - a.t_s) / (b.t_s - a.t_s);
            let [x, y] = [0, 1].map(|k| a.antenna_m[k] + f * (b.antenna_m[k] - a.antenna_m[k]));
            turn_deg(h.measured_deg, x.atan2(y) / RAD_PER_DEG)
        })
        .collect()
}

/// The shift common to all buoys with the least mean absolute residual, by whole seconds.
fn common_shift(buoys: &Buoys) -> f64 {
    let cost = |shift_s: f64| {
        let (mut sum, mut n) = (0.0, 0.0);
        for b in buoys.values().filter(|b| b.len() >= LEAST_RESIDUALS) {
            let r = residuals(b, shift_s);
            let Some(offset) = robust_deg(&r) else { continue };
            sum += r.iter().map(|x| turn_deg(offset, *x).abs()).sum::<f64>();
            n += r.len() as f64;
        }
        sum / n
    };
    let best = |shifts: &mut dyn Iterator<Item = f64>| {
        shifts.map(|s| (cost(s), s)).min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |b| b.1)
    };
    let coarse = best(&mut (-4..=6).map(|k| 5.0 * f64::from(k)));
    best(&mut (-4..=4).map(|k| coarse + f64::from(k)))
}

fn robust_deg(residuals: &[f64]) -> Option<f64> {
    let r: Vec<Residual> = residuals.iter().map(|d| Residual { angle: d * RAD_PER_DEG, pass: 0 }).collect();
    offset(&r).ok().map(|o| o.offset / RAD_PER_DEG)
}

/// Robust location of residuals near zero; the median where they are too few for the robust fit.
fn location(residuals: &[f64]) -> f64 {
    robust_deg(residuals).map_or_else(|| median(residuals.to_vec()), |x| turn_deg(0.0, x))
}

fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len() as f64
}

fn run(options: &Options) -> Result<()> {
    let file = options.real("real/difar_vessel_bearings_A/vessel_bearings.csv");
    let score = file.map(|file| score(&file)).transpose()?;
    let of = |value: fn(&DifarScore) -> f64| score.as_ref().map(value);
    let figures = &options.figures;
    figures.at_least("corrected bearings within 7°, %", of(|s| 100.0 * s.within_7_deg), 90.0);
    figures.at_least(
        "offsets within 1° of the median residual, % of the buoys",
        of(|s| 100.0 * s.within_1_deg_of_median),
        100.0,
    );
    figures.state("halves of a track differ, robust, deg", of(|s| s.repeat_deg[0]));
    figures.state("halves of a track differ, least squares, deg", of(|s| s.repeat_deg[1]));
    let Some(s) = score else {
        for figure in difar_tracks::FIGURES {
            figures.at_most(figure, None, difar_tracks::BAR);
        }
        return Ok(());
    };
    let mut report = CsvReport::new(
        "difar",
        "buoys,bearings,shift_s,within_1deg,largest_deg,within_7deg,repeat_robust,repeat_ls,\
         predict_robust,predict_ls,excess_kurtosis",
    );
    report.row(&[
        s.buoys as f64,
        s.bearings as f64,
        s.shift_s,
        s.within_1_deg_of_median,
        s.largest_from_median_deg,
        s.within_7_deg,
        s.repeat_deg[0],
        s.repeat_deg[1],
        s.predicted_deg[0],
        s.predicted_deg[1],
        s.excess_kurtosis,
    ]);
    report.finish(options)?;
    tracks(&s.errors_deg, options)?;
    let mut sizes: Vec<f64> = s.errors_deg.iter().map(|e| e.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let n = sizes.len() as f64;
    let beyond: Vec<(f64, f64)> =
        sizes.iter().enumerate().map(|(i, e)| (e.max(0.05), 1.0 - i as f64 / n)).collect();
    let sd = (sizes.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
    let scale = seabearing_core::kit::MAD_TO_SD * median(sizes.to_vec());
    let gaussian = |sd: f64| {
        (1..=300)
            .map(|k| 0.1 * f64::from(k))
            .map(|e| (e, beyond_gaussian(e / sd)))
            .filter(|(_, p)| *p > 1e-3)
            .collect::<Vec<_>>()
    };
    let mut figure =
        Plot::new("Errors of real bearings after correction", "size of the error (°)", "share beyond it");
    figure.y_scale(Scale::Log).x_range(0.0, 30.0).y_range(1e-3, 1.0);
    figure.points("DIFAR buoys", &beyond);
    figure.dashed("Gaussian of the same standard deviation", &gaussian(sd));
    figure.dashed("Gaussian of the same median", &gaussian(scale));
    figure.write(&options.out.join("difar.svg"))
}

/// Share of a Gaussian beyond x standard deviations either way.
fn beyond_gaussian(x: f64) -> f64 {
    seabearing_core::math::f64::erfc(x / std::f64::consts::SQRT_2)
}
