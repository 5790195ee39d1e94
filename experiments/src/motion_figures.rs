//! Paper M, figures 1 to 3 and a synthetic counterpart of 6 and 7: errors of CPA range and heading from bearings of one
//! array against CPA distance, for both covariance models, beside their bounds.
//!
//! Columns: `rmse_*` of the estimator with the linear (right) model, `bound_*` the Cramér-Rao bound, `ratio_*` both
//! divided; `diag_*` the estimator with the diagonal matrix and the true spread of it (the sandwich covariance), which
//! is its bound; `butter_*` and `butter_diag_*` the same estimators on the paper's Butterworth-filtered noise, for
//! which neither model is right. `second_*` is the second-order (Bhattacharyya) bound: where a heading is uncertain by
//! ten degrees, CPA range depends on it quadratically, and the first-order bound is out of any unbiased estimator's reach.
//! `paper_m` is the bound as the paper draws it [M 28]; the RMSE is the paper's too, of the least distance of the
//! estimated track.

use super::motion::{
    BearingNoise, Butterworth, Rmse, SPEED_M_S, STEP_S, StraightPass, generator, limits, paper, repeat,
    second_order,
};
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::plot::{Plot, Scale, write_panels};
use crate::progress;
use anyhow::{Context, Result};
use rand_distr::{Distribution, Normal};
use seabearing_locate::motion::covariance::Model;

/// Figure 1.
pub const FIGURE_1: Experiment = Experiment {
    name: "motion-fig1",
    about: "paper M, figure 1: range and heading errors against CPA distance and correlation interval",
    run: figure_1,
};
/// Figure 2.
pub const FIGURE_2: Experiment = Experiment {
    name: "motion-fig2",
    about: "paper M, figure 2: range and heading errors against CPA distance and observation time",
    run: figure_2,
};
/// Figure 3.
pub const FIGURE_3: Experiment = Experiment {
    name: "motion-fig3",
    about: "paper M, figure 3: range and heading errors against CPA distance and speed error",
    run: figure_3,
};
/// Counterpart of figures 6 and 7.
pub const FLEET: Experiment = Experiment {
    name: "motion-fleet",
    about: "counterpart of paper M, figures 6 and 7: vessels of the fleet's speeds, mean speed or own speed assumed",
    run: fleet,
};

const RUNS: usize = 1000;
const SIGMA_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
const RANGES_M: [f64; 7] = [500.0, 750.0, 1000.0, 1250.0, 1500.0, 1750.0, 2000.0];
const FEWER_RANGES_M: [f64; 4] = [500.0, 1000.0, 1500.0, 2000.0];
const MODELS: [Model; 2] = [Model::Linear, Model::White];

/// One point of a figure: the estimators with the linear model and with the diagonal matrix.
struct Point {
    group: f64,
    range_m: f64,
    rmse: [Rmse; 2],
    bound: [Rmse; 2],
    butter: [Rmse; 2],
    second: Rmse,
    paper_m: f64,
}

/// Speed errors reach range only: `r² σ_k²` is added to both bounds [M 20]. Here the assumed speed errs about a true one
/// that stays, so that σ_k = σ_v/v exactly; where the true speeds are drawn it is the greater expectation of [M 22].
fn point(
    options: &Options,
    scene: &StraightPass,
    group: f64,
    seed: u64,
    sigma_v: f64,
    butterworth: bool,
) -> Result<Point> {
    let runs = options.runs.unwrap_or(RUNS);
    let (best, diagonal) = limits(scene).context("singular geometry")?;
    let seed = (options.seed, seed);
    // The vessel's speed is assumed right on average: assumed = true + error.
    let speeds = |rng: &mut rand_chacha::ChaCha8Rng| {
        let error = Normal::new(0.0, sigma_v).map_or(0.0, |n| n.sample(rng));
        (SPEED_M_S, (SPEED_M_S + error).max(0.5))
    };
    let pair = |v: Vec<Rmse>| -> Result<[Rmse; 2]> { v.try_into().ok().context("two models") };
    let sigma_k = sigma_v / SPEED_M_S;
    let bound = [best, diagonal].map(|b| Rmse {
        range_m: b.cpa_range_with_speed_error(scene.range_m, sigma_k),
        heading_deg: b.heading_rad.to_degrees(),
    });
    let rmse = pair(repeat(scene, &MODELS, &BearingNoise::Linear, runs, seed, speeds))?;
    let butter = if butterworth {
        let noise = BearingNoise::Butterworth(Butterworth::new(scene.tau_s / STEP_S));
        pair(repeat(scene, &MODELS, &noise, runs, seed, speeds))?
    } else {
        [Rmse { range_m: f64::NAN, heading_deg: f64::NAN }; 2]
    };
    let mut second = second_order(scene).context("singular geometry")?;
    second.range_m = second.range_m.hypot(scene.range_m * sigma_k);
    let paper_m = paper(scene).context("singular geometry")?.hypot(scene.range_m * sigma_k);
    Ok(Point { group, range_m: scene.range_m, rmse, bound, butter, second, paper_m })
}

/// A point for each value of what is varied and each range. `case` gives window (s), correlation interval (s) and speed
/// error (m/s) of a value, and whether the Butterworth noise is tried as well.
fn sweep<const N: usize>(
    options: &Options,
    name: &str,
    first_seed: u64,
    values: [f64; N],
    ranges_m: &[f64],
    case: impl Fn(f64) -> (f64, f64, f64, bool),
) -> Result<Vec<Point>> {
    let bar = progress::bar((N * ranges_m.len()) as u64, name);
    let mut points = Vec::new();
    for value in values {
        let (window_s, tau_s, sigma_v, butterworth) = case(value);
        for &range_m in ranges_m {
            let pass = StraightPass { range_m, window_s, sd_rad: SIGMA_RAD, tau_s, speed_m_s: SPEED_M_S };
            let seed = first_seed + points.len() as u64;
            points.push(point(options, &pass, value, seed, sigma_v, butterworth)?);
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    Ok(points)
}

fn figure_1(options: &Options) -> Result<()> {
    let case = |tau_s| (200.0, tau_s, 0.0, tau_s > 0.0);
    let points = sweep(options, "motion-fig1", 0, [0.0, 50.0, 100.0, 150.0], &RANGES_M, case)?;
    write(options, "motion-fig1", "tau_s", "correlation interval (s)", &points)
}

fn figure_2(options: &Options) -> Result<()> {
    let case = |window_s| (window_s, 150.0, 0.0, true);
    let points = sweep(options, "motion-fig2", 100, [100.0, 200.0, 300.0, 400.0], &FEWER_RANGES_M, case)?;
    write(options, "motion-fig2", "window_s", "observation time (s)", &points)
}

fn figure_3(options: &Options) -> Result<()> {
    let case = |sigma_v| (200.0, 150.0, sigma_v, false);
    let points = sweep(options, "motion-fig3", 200, [0.0, 0.5, 1.0, 2.0], &FEWER_RANGES_M, case)?;
    write(options, "motion-fig3", "speed_sd_m_s", "speed error (m/s)", &points)
}

fn write(options: &Options, name: &str, group: &str, what: &str, points: &[Point]) -> Result<()> {
    let mut report = CsvReport::new(
        name,
        &format!(
            "{group},cpa_m,rmse_m,bound_m,ratio,rmse_deg,bound_deg,ratio_deg,diag_rmse_m,diag_bound_m,\
         diag_ratio,diag_rmse_deg,diag_bound_deg,diag_ratio_deg,butter_rmse_m,butter_rmse_deg,\
         butter_diag_rmse_m,butter_diag_rmse_deg,second_m,second_ratio,second_deg,paper_m"
        ),
    );
    for p in points {
        let mut row = vec![p.group, p.range_m];
        for (r, b) in p.rmse.iter().zip(&p.bound) {
            row.extend([r.range_m, b.range_m, r.range_m / b.range_m]);
            row.extend([r.heading_deg, b.heading_deg, r.heading_deg / b.heading_deg]);
        }
        for b in &p.butter {
            row.extend([b.range_m, b.heading_deg]);
        }
        row.extend([p.second.range_m, p.rmse[0].range_m / p.second.range_m, p.second.heading_deg]);
        row.push(p.paper_m);
        report.row(&row);
    }
    report.finish(options)?;
    verdict(options, points);
    let mut figures = Vec::new();
    for (k, model) in ["linear covariance", "diagonal covariance"].iter().enumerate() {
        for (axis, value) in [
            ("RMSE of range (m)", (|r: &Rmse| r.range_m) as fn(&Rmse) -> f64),
            ("RMSE of heading (°)", |r: &Rmse| r.heading_deg),
        ] {
            let mut figure = Plot::new(&format!("{model}; by {what}"), "CPA distance (m)", axis);
            figure.y_scale(Scale::Log);
            let mut groups: Vec<f64> = points.iter().map(|p| p.group).collect();
            groups.dedup();
            for g in groups {
                let of = |f: &dyn Fn(&Point) -> f64| -> Vec<(f64, f64)> {
                    points.iter().filter(|p| p.group == g).map(|p| (p.range_m, f(p))).collect()
                };
                figure.line(&format!("{g}: bound"), &of(&|p| value(&p.bound[k])));
                figure.points(&format!("{g}: RMSE"), &of(&|p| value(&p.rmse[k]))).same_colour();
            }
            figures.push(figure);
        }
    }
    write_panels(&options.out.join(format!("{name}.svg")), &figures.iter().collect::<Vec<_>>(), 2)
}

/// Which points keep the bar of RMSE over bound, 1.1 wherever the bound is under a quarter of the range.
fn verdict(options: &Options, points: &[Point]) {
    let figures = &options.figures;
    for (k, model) in ["linear", "diagonal"].iter().enumerate() {
        let judged: Vec<_> = points.iter().filter(|p| p.bound[k].range_m < 0.25 * p.range_m).collect();
        let of = |f: &dyn Fn(&Point) -> f64| {
            let ratios: Vec<f64> = judged.iter().map(|p| f(p)).collect();
            (ratios.iter().filter(|r| **r <= 1.1).count(), ratios.iter().copied().fold(0.0, f64::max))
        };
        for (what, (held, worst)) in [
            ("range", of(&|p| p.rmse[k].range_m / p.bound[k].range_m)),
            ("heading", of(&|p| p.rmse[k].heading_deg / p.bound[k].heading_deg)),
        ] {
            let name = format!("{model} model: {what} RMSE over bound, worst of {} points", judged.len());
            figures.at_most(name, worst, 1.1);
            figures.state(format!("{model} model: {what} RMSE over bound at most 1.1, points"), held as f64);
        }
    }
    let straight = points.iter().filter(|p| p.second.range_m < 1.05 * p.bound[0].range_m);
    let worst = straight.map(|p| p.rmse[0].range_m / p.bound[0].range_m).fold(0.0, f64::max);
    let second = points.iter().map(|p| p.rmse[0].range_m / p.second.range_m).fold(0.0, f64::max);
    let paper = points.iter().map(|p| (p.paper_m / p.bound[0].range_m - 1.0).abs()).fold(0.0, f64::max);
    figures.state("the paper's bound [M 28] against the full one, % apart", 100.0 * paper);
    figures.state("linear model: worst range ratio where curvature raises the bound by under 5 %", worst);
    figures.state("linear model: worst range ratio to the second-order bound", second);
}

/// The fleet of the paper's test: mean speed and spread, and what the estimator assumes, m/s.
const TEST_FLEET: (f64, f64) = (7.5, 2.4);
const TRAINING_MEAN: f64 = 7.3;

fn fleet(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let bar = progress::bar(7, "motion-fleet");
    let mut report = CsvReport::new(
        "motion-fleet",
        "cpa_m,mean_speed_rmse_m,expected_m,mean_speed_diag_rmse_m,own_speed_rmse_m,\
         own_speed_diag_rmse_m,heading_rmse_deg,heading_diag_rmse_deg,heading_bound_deg",
    );
    let draw = |rng: &mut rand_chacha::ChaCha8Rng| loop {
        let v = Normal::new(TEST_FLEET.0, TEST_FLEET.1).map_or(TEST_FLEET.0, |n| n.sample(rng));
        if (2.0..16.0).contains(&v) {
            return v;
        }
    };
    // E{(v̄/v0 − 1)²} of the fleet drawn [M 22].
    let mut rng = generator(options.seed, 999, 0);
    let sigma_k =
        ((0..20_000).map(|_| (TRAINING_MEAN / draw(&mut rng) - 1.0).powi(2)).sum::<f64>() / 20_000.0).sqrt();
    let (mut by_mean, mut by_own, mut expected) = (Vec::new(), Vec::new(), Vec::new());
    for (i, range_m) in RANGES_M.into_iter().enumerate() {
        let scene = StraightPass {
            range_m,
            window_s: 200.0,
            sd_rad: SIGMA_RAD,
            tau_s: 50.0,
            speed_m_s: TEST_FLEET.0,
        };
        let seed = (options.seed, 300 + i as u64);
        let mean =
            repeat(&scene, &MODELS, &BearingNoise::Linear, runs, seed, |rng| (draw(rng), TRAINING_MEAN));
        let own = repeat(&scene, &MODELS, &BearingNoise::Linear, runs, seed, |rng| {
            let v = draw(rng);
            (v, v)
        });
        let (bound, _) = limits(&scene).context("singular geometry")?;
        let e = bound.cpa_range_with_speed_error(range_m, sigma_k);
        report.row(&[
            range_m,
            mean[0].range_m,
            e,
            mean[1].range_m,
            own[0].range_m,
            own[1].range_m,
            own[0].heading_deg,
            own[1].heading_deg,
            bound.heading_rad.to_degrees(),
        ]);
        by_mean.push((range_m, mean[0].range_m));
        by_own.push((range_m, own[0].range_m));
        expected.push((range_m, e));
        bar.inc(1);
    }
    bar.finish_and_clear();
    report.finish(options)?;
    let mut figure =
        Plot::new("Range errors of a fleet of unknown speeds", "CPA distance (m)", "RMSE of range (m)");
    figure.y_scale(Scale::Log);
    figure
        .points("mean speed of past traffic assumed", &by_mean)
        .line("its expectation", &expected)
        .same_colour();
    figure.points("own speed known", &by_own);
    figure.write(&options.out.join("motion-fleet.svg"))
}
