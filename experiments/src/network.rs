//! Paper N, figures 2 and 3: errors of position from networks of two and three compact arrays against the source's
//! range, in rectangular and polar form, with and without the depth known, beside their bounds.
//!
//! The bottom arrays see a source 5 m deep; the search region of the forms without known depth is the water column,
//! ±2000 m wide (the paper names none for its figures 2 and 3 but 0 to 90° of elevation). Figure 2's polar errors are
//! those of the same maximum in polar coordinates; columns `open_*` are of the polar search the paper describes (any
//! azimuth, 0 to 90°, up to 2000 m), which knows no surface and so exceeds the bound of range where that is a large
//! part of the range. Figure 3's known-depth errors are of the fixes as reported; `fixes_*` counts how many runs
//! gave one.

use super::figure::Bar;
use super::report::CsvReport;
use super::score::rms;
use super::{Experiment, Options};
use crate::plot::{Plot, Scale, write_panels};
use anyhow::Result;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_locate::network::model::{bearing, polar};
use seabearing_locate::network::search::maximum;
use seabearing_locate::network::{FixSettings, Region, Sighting, locate, polar_bound, rectangular_bound};

/// Figure 2: rectangular and polar coordinates, depth unknown.
pub const FIGURE_2: Experiment = Experiment {
    name: "network-fig2",
    about: "paper N, figure 2: errors of 3-D position in polar and rectangular form, two networks",
    run: figure_2,
};

/// Figure 3: horizontal position, with and without the depth known.
pub const FIGURE_3: Experiment = Experiment {
    name: "network-fig3",
    about: "paper N, figure 3: horizontal errors with and without known depth, two networks",
    run: figure_3,
};

/// The two arrays in the Strait of Georgia (paper N, section IV), East, North, Up in metres.
pub const TWO: [[f64; 3]; 2] = [[4.5, -21.2, -168.0], [-4.5, 21.2, -168.0]];
/// The hypothetical three arrays on a circle of 100 m.
pub const THREE: [[f64; 3]; 3] = [[0.0, 100.0, -168.0], [86.6, -50.0, -168.0], [-86.6, -50.0, -168.0]];
/// Errors of azimuth and elevation, radians.
pub const SIGMA: (f64, f64) = (1.5 * RAD_PER_DEG, 1.6 * RAD_PER_DEG);
/// Height of the bottom and of the source, metres.
const BOTTOM_M: f64 = -168.0;
const SOURCE_M: f64 = -5.0;
/// Half-width of the search region, metres.
const HALF_M: f64 = 2000.0;
const RUNS: usize = 1000;

/// Sightings of a source with Gaussian errors.
pub fn sight(arrays: &[[f64; 3]], source_m: &[f64; 3], rng: &mut ChaCha8Rng) -> Vec<Sighting> {
    arrays
        .iter()
        .map(|array_m| {
            let (azimuth, elevation) = bearing(array_m, source_m);
            let mut normal = || -> f64 { StandardNormal.sample(rng) };
            Sighting {
                array_m: *array_m,
                azimuth: azimuth + SIGMA.0 * normal(),
                elevation: Some(elevation + SIGMA.1 * normal()),
                sd_azimuth: SIGMA.0,
                sd_elevation: SIGMA.1,
            }
        })
        .collect()
}

/// The source at a horizontal range and the paper's azimuth.
fn source(range_m: f64) -> [f64; 3] {
    let (s, c) = (-5.0 * RAD_PER_DEG).sin_cos();
    [range_m * s, range_m * c, SOURCE_M]
}

/// Degrees of a bound; one beyond the half circle bounds nothing.
fn degrees(x: f64) -> f64 {
    if x < std::f64::consts::PI { x / RAD_PER_DEG } else { f64::NAN }
}

fn column() -> Region {
    Region::between([0.0, 0.0], HALF_M, (BOTTOM_M, 0.0))
}

fn surface() -> Region {
    Region::at_depth([0.0, 0.0], HALF_M, SOURCE_M)
}

/// One generator for every run of every point, so that results do not depend on the number of threads.
fn generator(options: &Options, point: u64, run: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(point << 32 | run as u64);
    rng
}

/// Errors of azimuth and elevation (degrees) and range (metres) about the network's centre on the bottom; straight
/// above it there is no azimuth.
fn polar_error(position_m: &[f64; 3], truth_m: &[f64; 3]) -> [f64; 3] {
    let ([a, e, r], [ta, te, tr]) = (polar(position_m), polar(truth_m));
    let above = truth_m[0].hypot(truth_m[1]) < 1.0;
    let azimuth = if above { f64::NAN } else { wrap_pi(a - ta) / RAD_PER_DEG };
    [azimuth, (e - te) / RAD_PER_DEG, r - tr]
}

fn ranges() -> impl Iterator<Item = f64> {
    (0..=10).map(|k| 100.0 * f64::from(k))
}

fn networks() -> [&'static [[f64; 3]]; 2] {
    [&TWO, &THREE]
}

fn figure_2(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let bar = crate::progress::bar(22, "network-fig2");
    let mut report = CsvReport::new(
        "network-fig2",
        "arrays,range_m,rmse_x,crb_x,rmse_y,crb_y,rmse_z,crb_z,rmse_az,crb_az,rmse_el,crb_el,rmse_r,\
         crb_r,open_az,open_el,open_r",
    );
    let mut curves: Vec<Vec<[f64; 16]>> = Vec::new();
    for (n, arrays) in networks().into_iter().enumerate() {
        // The polar form is about the network's centre on the bottom, so that 0 to 90° of elevation hold the water.
        let lowered: Vec<[f64; 3]> = arrays.iter().map(|[x, y, z]| [*x, *y, z - BOTTOM_M]).collect();
        let polar_region = Region::Polar { elevation: (0.0, 90.0 * RAD_PER_DEG), range_m: (1.0, HALF_M) };
        let mut curve = Vec::new();
        for (k, range) in ranges().enumerate() {
            let truth = source(range);
            let raised = [truth[0], truth[1], truth[2] - BOTTOM_M];
            let errors: Vec<[f64; 9]> = (0..runs)
                .into_par_iter()
                .map(|run| {
                    let seen = sight(arrays, &truth, &mut generator(options, (11 * n + k) as u64, run));
                    let shifted: Vec<Sighting> = seen
                        .iter()
                        .zip(&lowered)
                        .map(|(s, array_m)| Sighting { array_m: *array_m, ..*s })
                        .collect();
                    let (Ok(a), Ok(b)) = (maximum(&seen, &column()), maximum(&shifted, &polar_region)) else {
                        return [f64::NAN; 9];
                    };
                    let [x, y, z] = a.position_m;
                    let [a1, a2, a3] = polar_error(&[x, y, z - BOTTOM_M], &raised);
                    let [b1, b2, b3] = polar_error(&b.position_m, &raised);
                    [x - truth[0], y - truth[1], z - truth[2], a1, a2, a3, b1, b2, b3]
                })
                .collect();
            let rmse = [0, 1, 2, 3, 4, 5, 6, 7, 8].map(|i| rms(errors.iter().map(|e| e[i])));
            let seen = sight(arrays, &truth, &mut generator(options, 0, 0));
            let free = rectangular_bound(&seen, &truth)?.free_m.unwrap_or([f64::NAN; 3]);
            let shifted: Vec<Sighting> =
                seen.iter().zip(&lowered).map(|(s, a)| Sighting { array_m: *a, ..*s }).collect();
            let p = polar_bound(&shifted, &raised)
                .map_or([f64::NAN; 3], |p| [degrees(p.azimuth), p.elevation / RAD_PER_DEG, p.range_m]);
            let row = [
                range, rmse[0], free[0], rmse[1], free[1], rmse[2], free[2], rmse[3], p[0], rmse[4], p[1],
                rmse[5], p[2], rmse[6], rmse[7], rmse[8],
            ];
            let mut values = vec![arrays.len() as f64];
            values.extend(row);
            report.row(&values);
            curve.push(row);
            bar.inc(1);
        }
        curves.push(curve);
    }
    bar.finish_and_clear();
    report.finish(options)?;
    let panel = |title: &str, unit: &str, column: usize| {
        let mut f = Plot::new(title, "horizontal range (m)", unit);
        f.size(520, 360);
        if unit == "error (m)" {
            f.y_scale(Scale::Log);
        }
        for (curve, n) in curves.iter().zip([2, 3]) {
            let pick = |i: usize| curve.iter().map(|r| (r[0], r[i])).collect::<Vec<_>>();
            f.points(&format!("RMSE, N = {n}"), &pick(column));
            f.line(&format!("bound, N = {n}"), &pick(column + 1)).same_colour();
            if column >= 7 {
                f.dashed(&format!("no surface, N = {n}"), &pick(13 + (column - 7) / 2)).same_colour();
            }
        }
        f
    };
    let panels = [
        panel("Azimuth", "error (°)", 7),
        panel("East", "error (m)", 1),
        panel("Elevation", "error (°)", 9),
        panel("North", "error (m)", 3),
        panel("Range", "error (m)", 11),
        panel("Height", "error (m)", 5),
    ];
    write_panels(&options.out.join("network-fig2.svg"), &panels.each_ref(), 2)
}

fn figure_3(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let bar = crate::progress::bar(22, "network-fig3");
    let mut report = CsvReport::new(
        "network-fig3",
        "arrays,range_m,rmse_3d_m,crb_3d_m,ratio_3d,rmse_2d_m,crb_2d_m,ratio_2d,var_x_2d,var_y_2d,\
         fixes_2d,fixes_3d",
    );
    let mut curves: Vec<Vec<[f64; 5]>> = Vec::new();
    let mut worst = [0.0f64; 2];
    let mut standardised = [0.0f64; 2];
    let mut count = 0.0;
    for (n, arrays) in networks().into_iter().enumerate() {
        let mut curve = Vec::new();
        for (k, range) in ranges().enumerate() {
            let truth = source(range);
            // Horizontal errors of the 3-D and the 2-D form, standardised x and y of the latter, and whether each
            // is resolved well enough to be reported as a fix.
            let errors: Vec<[f64; 6]> = (0..runs)
                .into_par_iter()
                .map(|run| {
                    let seen = sight(arrays, &truth, &mut generator(options, (11 * n + k) as u64, run));
                    let Ok(free) = maximum(&seen, &column()) else { return [f64::NAN; 6] };
                    let away = |p: [f64; 3]| (p[0] - truth[0]).hypot(p[1] - truth[1]);
                    let fix_2d = locate(&seen, &FixSettings { region: surface(), robust: false });
                    let flat = fix_2d.map_or(f64::NAN, |f| away(f.position_m));
                    let fix_3d = locate(&seen, &FixSettings { region: column(), robust: false });
                    let z = fix_2d.map_or([f64::NAN; 2], |f| {
                        [0, 1].map(|i| (f.position_m[i] - truth[i]) / f.covariance_m2[i][i].sqrt())
                    });
                    let told = |ok: bool| f64::from(u8::from(ok));
                    [away(free.position_m), flat, z[0], z[1], told(fix_2d.is_ok()), told(fix_3d.is_ok())]
                })
                .collect();
            let rmse = [0, 1].map(|i| rms(errors.iter().map(|e| e[i]).filter(|e| e.is_finite())));
            let variance = [2, 3].map(|i| rms(errors.iter().map(|e| e[i]).filter(|z| z.is_finite())).powi(2));
            let fixes = [4, 5].map(|i| errors.iter().map(|e| e[i]).sum::<f64>());
            let seen = sight(arrays, &truth, &mut generator(options, 0, 0));
            let bound = rectangular_bound(&seen, &truth)?;
            let free = bound.horizontal_free_m().unwrap_or(f64::NAN);
            let flat = bound.horizontal_known_depth_m().unwrap_or(f64::NAN);
            report.row(&[
                arrays.len() as f64,
                range,
                rmse[0],
                free,
                rmse[0] / free,
                rmse[1],
                flat,
                rmse[1] / flat,
                variance[0],
                variance[1],
                fixes[0],
                fixes[1],
            ]);
            worst = [worst[0].max(rmse[0] / free), worst[1].max(rmse[1] / flat)];
            standardised = [standardised[0] + variance[0], standardised[1] + variance[1]];
            count += 1.0;
            curve.push([range, rmse[0], free, rmse[1], flat]);
            bar.inc(1);
        }
        curves.push(curve);
    }
    bar.finish_and_clear();
    report.finish(options)?;
    let figures = &options.figures;
    figures.at_most("largest RMSE over bound, depth unknown", worst[0], 1.1);
    figures.at_most("largest RMSE over bound, depth known", worst[1], 1.1);
    for (axis, sum) in ["x", "y"].iter().zip(standardised) {
        let name = format!("mean variance of standardised {axis}, depth known");
        figures.report(name, sum / count, Bar::Within(0.85, 1.15));
    }
    let mut figure =
        Plot::new("Horizontal error of position (paper N, figure 3)", "horizontal range (m)", "error (m)");
    figure.y_scale(Scale::Log);
    for (curve, n) in curves.iter().zip([2, 3]) {
        let pick = |i: usize| curve.iter().map(|r| (r[0], r[i])).collect::<Vec<_>>();
        figure.points(&format!("3-D, N = {n}"), &pick(1));
        figure.line(&format!("bound, N = {n}"), &pick(2)).same_colour();
        figure.points(&format!("known depth, N = {n}"), &pick(3));
        figure.dashed(&format!("bound, known depth, N = {n}"), &pick(4)).same_colour();
    }
    figure.write(&options.out.join("network-fig3.svg"))
}
