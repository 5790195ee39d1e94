//! Paper M where the vessels' true speeds are random and the estimator assumes their mean: the errors of figure 3, the
//! bias of equation 18, and the distributions of figures 4 and 5.
//!
//! Errors: the vessel's speed is drawn (Gaussian, above 2 m/s as in `motion-fleet`), the mean assumed, 200 s, 2°, 150 s as in figure 3. An
//! estimated range is `v̄/v₀` of the true one, so its bias is `r (E{v̄/v₀} − 1)` [M 18], which the paper takes as zero
//! [M 19], and its variance about the truth `r² E{(v̄/v₀ − 1)²}` more than the bound [M 20, 22].
//!
//! Distributions: the paper's AIS of the Salish Sea (3245 training and 171 test vessels) is not at hand; passes of vessels
//! within 3000 m of points in the Solent 5 km apart stand for them, those of every second vessel as training, the others as
//! test.

use super::motion::{BearingNoise, Drawn, POSITIONS, SPEED_M_S, StraightPass, config, generator, limits};
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::ais::{Pass, Selection, passes, read};
use crate::plot::{Plot, Scale, write_panels};
use anyhow::{Context, Result};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml;
use seabearing_locate::motion::whiten::Workspace;

/// Errors and bias.
pub const SPEEDS: Experiment = Experiment {
    name: "motion-speeds",
    about: "paper M, figure 3 and equation 18: random true speeds, their mean assumed: errors and bias of range",
    run: speeds,
};

/// Distributions.
pub const TRAFFIC: Experiment = Experiment {
    name: "motion-traffic",
    about: "counterpart of paper M, figures 4 and 5: speeds and headings of real vessels against CPA distance",
    run: traffic,
};

const RUNS: usize = 1000;
const RANGES_M: [f64; 4] = [500.0, 1000.0, 1500.0, 2000.0];
/// Spreads of the true speed, m/s; figure 3's.
const SPREADS_M_S: [f64; 4] = [0.0, 0.5, 1.0, 2.0];
/// Slowest vessel drawn, m/s.
const SLOWEST_M_S: f64 = 2.0;
/// The paper's mean and spread of speeds, m/s: training vessels and test vessels.
const PAPER_M_S: [(&str, f64, f64); 2] = [("training", 7.3, 2.3), ("test", 7.5, 2.4)];

fn draw(mean_m_s: f64, sd_m_s: f64, rng: &mut ChaCha8Rng) -> f64 {
    loop {
        let speed = Normal::new(mean_m_s, sd_m_s).map_or(mean_m_s, |n| n.sample(rng));
        if speed > SLOWEST_M_S {
            return speed;
        }
    }
}

/// Mean of v̄/v₀ − 1, and root of the mean of its square [M 18, 22].
fn ratio(speeds: impl Iterator<Item = f64> + Clone, mean_m_s: f64) -> (f64, f64) {
    let errors = speeds.map(|v| mean_m_s / v - 1.0);
    let n = errors.clone().count().max(1) as f64;
    (errors.clone().sum::<f64>() / n, (errors.map(|e| e * e).sum::<f64>() / n).sqrt())
}

fn speeds(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let bar = crate::progress::bar((SPREADS_M_S.len() * RANGES_M.len()) as u64, "motion-speeds");
    let mut report = CsvReport::new(
        "motion-speeds",
        "speed_sd_m_s,cpa_m,rmse_m,expected_m,ratio,bias_m,bias_eq18_m,bias_paper_m,sigma_k,sigma_k_linear",
    );
    let (mut curves, mut worst, mut apart) = (Vec::new(), (0.0f64, 0.0f64), 0.0f64);
    for (i, sd_m_s) in SPREADS_M_S.into_iter().enumerate() {
        let mut curve = Vec::new();
        for (j, range_m) in RANGES_M.into_iter().enumerate() {
            let scene = StraightPass {
                range_m,
                window_s: 200.0,
                sd_rad: 2f64.to_radians(),
                tau_s: 150.0,
                speed_m_s: SPEED_M_S,
            };
            let found: Vec<(f64, f64)> = (0..runs)
                .into_par_iter()
                .map_init(
                    || Box::new(Workspace::<POSITIONS>::new()),
                    |work, run| {
                        let mut rng = generator(options.seed, 700 + (10 * i + j) as u64, run);
                        let speed_m_s = draw(SPEED_M_S, sd_m_s, &mut rng);
                        let scene = StraightPass { speed_m_s, ..scene };
                        let errors = scene.errors(&BearingNoise::Linear, &mut rng);
                        let c = config(Model::Linear, scene.tau_s, SPEED_M_S);
                        let samples = scene.samples(&c.medium, &errors);
                        let fit = ml::fit(&c, &samples, work, &mut []).ok()?;
                        Some((speed_m_s, fit.solution.cpa_range_m - range_m))
                    },
                )
                .flatten()
                .collect();
            let n = found.len().max(1) as f64;
            let rmse = (found.iter().map(|f| f.1 * f.1).sum::<f64>() / n).sqrt();
            let bias = found.iter().map(|f| f.1).sum::<f64>() / n;
            let (mean_k, sigma_k) = ratio(found.iter().map(|f| f.0), SPEED_M_S);
            let (bound, _) = limits(&scene).context("singular geometry")?;
            let expected = bound.cpa_range_with_speed_error(range_m, sigma_k);
            report.row(&[
                sd_m_s,
                range_m,
                rmse,
                expected,
                rmse / expected,
                bias,
                range_m * mean_k,
                0.0,
                sigma_k,
                sd_m_s / SPEED_M_S,
            ]);
            // To 1000 m, where the bearings alone do not bend the estimate.
            if sd_m_s > 0.0 && range_m <= 1000.0 {
                let off = (rmse / expected - 1.0).abs();
                // Of speeds spread by 2 m/s the few slowest decide both.
                let worst = if sd_m_s < 2.0 { &mut worst.0 } else { &mut worst.1 };
                *worst = worst.max(off);
                apart = apart.max((bias - range_m * mean_k).abs() / range_m);
            }
            curve.push((range_m, rmse, expected));
            bar.inc(1);
        }
        curves.push((sd_m_s, curve));
    }
    bar.finish_and_clear();
    report.finish(options)?;
    let figures = &options.figures;
    let name = "speeds spread by 0.5 and 1 m/s, to 1000 m: RMSE of range off the expected, %";
    figures.at_most(name, 100.0 * worst.0, 10.0);
    figures.state("the same, spread by 2 m/s", 100.0 * worst.1);
    let name = "bias of range off that of equation 18, all spreads, to 1000 m, % of range";
    figures.at_most(name, 100.0 * apart, 3.0);
    for (name, mean_m_s, sd_m_s) in PAPER_M_S {
        let mut rng = generator(options.seed, 799, 0);
        let drawn: Vec<f64> = (0..100_000).map(|_| draw(mean_m_s, sd_m_s, &mut rng)).collect();
        let (bias, sigma_k) = ratio(drawn.iter().copied(), mean_m_s);
        figures.state(
            format!("{name} vessels' {mean_m_s} ± {sd_m_s} m/s: bias of equation 18, % of range"),
            100.0 * bias,
        );
        figures.state(format!("{name} vessels: the paper's, equation 19, %"), 0.0);
        figures.state(format!("{name} vessels: σ_k of equation 22"), sigma_k);
        figures.state(format!("{name} vessels: σ_v/v̄, what it is for small errors"), sd_m_s / mean_m_s);
    }
    let mut figure = Plot::new(
        "Range errors, true speed random (paper M, figure 3)",
        "CPA distance (m)",
        "RMSE of range (m)",
    );
    figure.y_scale(Scale::Log);
    for (sd_m_s, curve) in &curves {
        let of = |f: &dyn Fn(&(f64, f64, f64)) -> f64| curve.iter().map(|p| (p.0, f(p))).collect::<Vec<_>>();
        figure.points(&format!("σ = {sd_m_s} m/s"), &of(&|p| p.1));
        figure.line(&format!("{sd_m_s} m/s: expected"), &of(&|p| p.2)).same_colour();
    }
    figure.write(&options.out.join("motion-speeds.svg"))
}

/// What counts as a pass by the paper: within 3000 m, under way. Points of the Solent, rows and columns of them.
const WITHIN_M: f64 = 3000.0;
const POINTS: (u32, u32) = (5, 9);

/// Passes of every point, in the points' order.
fn of_points(reports: &[crate::ais::AisReport]) -> Vec<Pass> {
    let points = (0..POINTS.0).flat_map(|i| (0..POINTS.1).map(move |j| (i, j)));
    let place = |(i, j): (u32, u32)| (50.69 + 0.045 * f64::from(i), -1.55 + 0.071 * f64::from(j));
    let near = |lat_lon_deg| {
        let (max_range_m, min_speed_m_s) = (WITHIN_M, SLOWEST_M_S);
        passes(reports, &Selection { lat_lon_deg, max_range_m, min_speed_m_s, max_gap_s: 600.0 })
    };
    points.flat_map(|p| near(place(p))).collect()
}

fn traffic(options: &Options) -> Result<()> {
    let Some(file) = options.real("real/ais_solent_2016/SolentAIS_20160112_130211.csv") else {
        options.figures.state("passes within 3000 m", None);
        return Ok(());
    };
    let (reports, _) = read(&file)?;
    let all = of_points(&reports);
    let mut report = CsvReport::new("motion-traffic", "test,cpa_m,speed_m_s,heading_deg");
    for pass in &all {
        let test = f64::from(u8::from(is_test(pass)));
        report.row(&[test, pass.cpa_m, pass.speed_m_s, pass.heading_deg]);
    }
    crate::atomic::write(&options.out.join("motion-traffic.csv"), report.csv().as_bytes())?;
    let mut panels = Vec::new();
    let figures = &options.figures;
    for (test, (name, paper_mean, paper_sd)) in PAPER_M_S.into_iter().enumerate() {
        let group: Vec<&Pass> = all.iter().filter(|p| usize::from(is_test(p)) == test).collect();
        let n = group.len().max(1) as f64;
        let mean = group.iter().map(|p| p.speed_m_s).sum::<f64>() / n;
        let sd = (group.iter().map(|p| (p.speed_m_s - mean).powi(2)).sum::<f64>() / n).sqrt();
        figures.state(format!("{name}: passes within 3000 m"), group.len() as f64);
        figures.state(format!("{name}: mean speed, m/s (the paper's vessels {paper_mean})"), mean);
        figures.state(format!("{name}: spread of speeds, m/s (the paper's {paper_sd})"), sd);
        let (bias, _) = ratio(group.iter().map(|p| p.speed_m_s), mean);
        figures.state(
            format!("{name}: bias of equation 18, % of range (the paper's equation 19: 0)"),
            100.0 * bias,
        );
        for (label, value) in [
            ("speed (m/s)", (|p: &Pass| p.speed_m_s) as fn(&Pass) -> f64),
            ("heading (°)", |p: &Pass| p.heading_deg),
        ] {
            let mut figure = Plot::new(&format!("{name} vessels"), "CPA distance (m)", label);
            figure.size(480, 340);
            figure.points("passes", &group.iter().map(|p| (p.cpa_m, value(p))).collect::<Vec<_>>());
            panels.push(figure);
        }
    }
    write_panels(&options.out.join("motion-traffic.svg"), &panels.iter().collect::<Vec<_>>(), 2)
}

fn is_test(pass: &Pass) -> bool {
    pass.mmsi % 2 == 1
}
