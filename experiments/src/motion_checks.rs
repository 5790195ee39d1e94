//! Motion beyond paper M: elevations instead of a speed, reported spreads against errors made, recursive against batch.

use super::figure::Bar;
use super::motion::{BearingNoise, Drawn, POSITIONS, StraightPass, config, generator};
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::progress;
use anyhow::{Context, Result};
use rand_distr::{Distribution, Normal, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::kit::quantile;
use seabearing_core::motion::{Medium, Solution, solution::position};
use seabearing_core::passage::{self, Measurement, Passage, RECORDED};
use seabearing_locate::motion::bound;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{self, Config};
use seabearing_locate::motion::whiten::{Factorisation, WhitenMethod, Workspace};

/// Elevations joined into the fit.
pub const ELEVATION: Experiment = Experiment {
    name: "motion-elevation",
    about: "motion from azimuths and elevations at 168 m depth, speed unknown: range and speed against their bounds",
    run: elevation,
};
/// Reported spreads and the recursive estimator.
pub const COVERAGE: Experiment = Experiment {
    name: "motion-coverage",
    about: "motion: standardised errors, 95 % ellipses, recursive against batch",
    run: coverage,
};

/// What a fit costs.
pub const COST: Experiment = Experiment {
    name: "motion-cost",
    about: "motion: time of one fit of 401 bearings on this machine, each error model, and its memory",
    run: cost,
};

const RUNS: usize = 1000;
/// The recorder's passage fit takes 401 bearings a run.
const COVERAGE_RUNS: usize = 400;
/// Array at 168 m, propeller at 5 m.
const HEIGHT_M: f64 = 163.0;

fn elevation(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let mut report = CsvReport::new(
        "motion-elevation",
        "cpa_m,bias_sd_deg,bias_modelled,range_rmse_m,range_bound_m,ratio,speed_rmse_percent,\
         speed_bound_percent,heading_rmse_deg,range_in_95_percent",
    );
    let bar = progress::bar(15, "motion-elevation");
    for (case, (bias_deg, modelled)) in [(0.0, false), (1.0, true), (1.0, false)].into_iter().enumerate() {
        for (i, range_m) in [300.0, 400.0, 500.0, 600.0, 700.0].into_iter().enumerate() {
            let scene = StraightPass {
                range_m,
                window_s: 200.0,
                sd_rad: 1.5 * RAD_PER_DEG,
                tau_s: 0.0,
                speed_m_s: 7.0,
            };
            let c = Config {
                speed_m_s: 7.3,
                speed_sd_m_s: f64::INFINITY,
                medium: Medium { height_m: HEIGHT_M, ..Medium::of_sound_speed(1484.0) },
                elevation_bias_sd_rad: if modelled { bias_deg * RAD_PER_DEG } else { 0.0 },
                ..config(Model::White, 0.0, 7.3)
            };
            let truth = scene.line();
            let sd = 1.6 * RAD_PER_DEG;
            let observe = |errors: &[f64], mut elevation_error: Box<dyn FnMut() -> f64 + '_>| {
                let mut s = scene.samples(&c.medium, errors);
                for s in &mut s {
                    let e = truth.expected(&c.medium, s.t_s).elevation + elevation_error();
                    s.elevation_rad = (e as f32, sd as f32);
                }
                s
            };
            let mut work = Box::new(Workspace::<POSITIONS>::new());
            let clean = observe(&vec![0.0; scene.count()], Box::new(|| 0.0));
            let plan = Factorisation::new(c.model, 0.0, clean.iter().map(|s| s.t_s), &mut work, &mut [])
                .ok()
                .context("times")?;
            let limit = bound::cramer_rao(&c, &clean, &truth, &plan, &mut work, &[]).context("singular")?;
            let errors: Vec<[f64; 4]> = (0..runs)
                .into_par_iter()
                .map_init(
                    || Box::new(Workspace::<POSITIONS>::new()),
                    |work, run| {
                        let mut rng = generator(options.seed, 400 + 10 * case as u64 + i as u64, run);
                        let errors = scene.errors(&BearingNoise::Linear, &mut rng);
                        let bias: f64 =
                            bias_deg * RAD_PER_DEG * Distribution::<f64>::sample(&StandardNormal, &mut rng);
                        let s = observe(
                            &errors,
                            Box::new(|| bias + sd * Distribution::<f64>::sample(&StandardNormal, &mut rng)),
                        );
                        let r = ml::fit(&c, &s, work, &mut []).ok()?.solution;
                        Some([
                            r.cpa_range_m - range_m,
                            r.speed_m_s - 7.0,
                            wrap_pi(r.heading_rad - truth.heading_rad()).to_degrees(),
                            f64::from(u8::from((r.cpa_range_m - range_m).abs() < 1.96 * r.sd_cpa_range_m)),
                        ])
                    },
                )
                .flatten()
                .collect();
            let n = errors.len() as f64;
            let rms = |k: usize| super::score::rms(errors.iter().map(|e| e[k]));
            let at = format!("{range_m} m, bias {bias_deg}°{}:", if modelled { " modelled" } else { "" });
            if bias_deg == 0.0 {
                let ratio = rms(0) / limit.cpa_range_m;
                options.figures.at_most(format!("{at} range RMSE over its bound"), ratio, 1.15);
            }
            if range_m == 500.0 && (bias_deg == 0.0 || modelled) {
                options.figures.at_most(format!("{at} speed RMSE, %"), 100.0 * rms(1) / 7.0, 5.0);
            }
            report.row(&[
                range_m,
                bias_deg,
                f64::from(u8::from(modelled)),
                rms(0),
                limit.cpa_range_m,
                rms(0) / limit.cpa_range_m,
                100.0 * rms(1) / 7.0,
                100.0 * limit.speed_m_s / 7.0,
                rms(2),
                100.0 * errors.iter().map(|e| e[3]).sum::<f64>() / n,
            ]);
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    report.finish(options)
}

/// Errors of one run over their reported spreads, and whether the ellipses held the truth.
struct Standard {
    /// Range, heading, time of CPA.
    z: [f64; 3],
    /// Squared Mahalanobis distance of position at the first, CPA and last time.
    ellipse: [f64; 3],
}

fn standardise(s: &Solution, scene: &StraightPass) -> Standard {
    let truth = scene.line();
    let at = |t: f64| {
        let ([x, y], [xx, yy, xy]) = position(&s.line, &s.covariance, t);
        let ([tx, ty], _) = truth.position(t);
        let (dx, dy) = (x - tx, y - ty);
        let det = xx * yy - xy * xy;
        (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det
    };
    Standard {
        z: [
            (s.cpa_range_m - scene.range_m) / s.sd_cpa_range_m,
            wrap_pi(s.heading_rad - truth.heading_rad()) / s.sd_heading_rad,
            s.cpa_time_s / s.sd_cpa_time_s,
        ],
        ellipse: [at(s.t0_s), at(0.0), at(s.t1_s)],
    }
}

/// 95 % of chi-square with two degrees of freedom.
const ELLIPSE_95: f64 = 5.991_464_547_107_98;

fn coverage(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(COVERAGE_RUNS);
    let mut report = CsvReport::new(
        "motion-coverage",
        "recursive,sigma_deg,tau_s,cpa_m,speed_sd_m_s,var_z_range,var_z_heading,var_z_time,\
         ellipse_first,ellipse_cpa,ellipse_last,difference_rms,difference_99,difference_max",
    );
    // Error sd (degrees), correlation interval, CPA range, spread of speed.
    let cases = [
        (0.1, 0.0, 500.0, 0.0),
        (2.0, 0.0, 500.0, 0.0),
        (0.5, 5.0, 500.0, 0.0),
        (0.5, 5.0, 200.0, 2.3),
        (2.0, 50.0, 500.0, 0.0),
        (2.0, 50.0, 1000.0, 0.0),
    ];
    let bar = progress::bar(cases.len() as u64, "motion-coverage");
    for (i, (sigma_deg, tau_s, range_m, speed_sd_m_s)) in cases.into_iter().enumerate() {
        let sd_rad = sigma_deg * RAD_PER_DEG;
        let mean = if speed_sd_m_s > 0.0 { 7.3 } else { 7.0 };
        let medium = Medium::of_sound_speed(1484.0);
        let model = if tau_s > 0.0 { Model::Markov } else { Model::White };
        let batch = Config { speed_sd_m_s, medium, ..config(model, tau_s, mean) };
        let filter = passage::Config {
            speed_m_s: mean,
            speed_sd_m_s,
            range_m: batch.range_m,
            extra_sd_rad: sd_rad,
            extra_tau_s: tau_s,
            medium,
            elevation_bias_sd_rad: 0.0,
            tails: None,
            lasting_sd_rad: 0.0,
            course_sd_rad: 0.0,
            height_sd_m: 0.0,
        };
        let results: Vec<(Standard, Standard, f64)> = (0..runs)
            .into_par_iter()
            .map_init(
                || Box::new(Workspace::<POSITIONS>::new()),
                |work, run| {
                    let mut rng = generator(options.seed, 500 + i as u64, run);
                    let speed_m_s = loop {
                        let v = Normal::new(mean, speed_sd_m_s).map_or(mean, |n| n.sample(&mut rng));
                        if v > 1.0 {
                            break v;
                        }
                    };
                    let scene = StraightPass { range_m, window_s: 200.0, sd_rad, tau_s, speed_m_s };
                    let errors = scene.errors(&BearingNoise::Markov, &mut rng);
                    let samples = scene.samples(&medium, &errors);
                    let a = ml::fit(&batch, &samples, work, &mut []).ok()?.solution;
                    let mut recorded = Passage::<RECORDED>::new();
                    for s in &samples {
                        recorded.push(&filter, &Measurement::azimuth(s.t_s, s.azimuth_rad, 0.0));
                        while recorded.work(&filter) {}
                    }
                    let b = recorded.finish(&filter)?;
                    let difference = [
                        (a.cpa_range_m - b.cpa_range_m) / a.sd_cpa_range_m,
                        wrap_pi(a.heading_rad - b.heading_rad) / a.sd_heading_rad,
                        (a.cpa_time_s - b.cpa_time_s) / a.sd_cpa_time_s,
                    ];
                    let largest = difference.iter().fold(0.0f64, |m, d| m.max(d.abs()));
                    Some((standardise(&a, &scene), standardise(&b, &scene), largest))
                },
            )
            .flatten()
            .collect();
        let n = results.len() as f64;
        let mut sorted: Vec<f64> = results.iter().map(|r| r.2).collect();
        let rms = super::score::rms(sorted.iter().copied());
        let mut at = |p: f64| quantile(&mut sorted, p).unwrap_or(f64::NAN);
        let of_case = format!("{sigma_deg}°, {tau_s} s, {range_m} m:");
        options.figures.at_most(format!("{of_case} recursive against batch, worst, sd"), at(1.0), 0.3);
        for which in 0..2 {
            let of = |r: &'_ (Standard, Standard, f64)| {
                if which == 0 { (r.0.z, r.0.ellipse) } else { (r.1.z, r.1.ellipse) }
            };
            let variance = |k: usize| results.iter().map(|r| of(r).0[k].powi(2)).sum::<f64>() / n;
            let inside =
                |k: usize| 100.0 * results.iter().filter(|r| of(r).1[k] < ELLIPSE_95).count() as f64 / n;
            let who = ["batch", "recursive"][which];
            let of_case = format!("{sigma_deg}°, {tau_s} s, {range_m} m, {who}:");
            for (k, when) in ["first", "CPA", "last"].iter().enumerate() {
                let name = format!("{of_case} truth in the 95 % ellipse at the {when} time, %");
                options.figures.report(name, inside(k), Bar::Within(92.0, 98.0));
            }
            report.row(&[
                which as f64,
                sigma_deg,
                tau_s,
                range_m,
                speed_sd_m_s,
                variance(0),
                variance(1),
                variance(2),
                inside(0),
                inside(1),
                inside(2),
                rms,
                at(0.99),
                at(1.0),
            ]);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    report.finish(options)
}

/// Rows: model 0 white, 1 linear, 2 sinc, 3 Gaussian, 4 Markov; 5 the recorder's passage fit of 401 bearings, one by one.
fn cost(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(20);
    let mut report = CsvReport::new("motion-cost", "model,tau_s,levinson,fit_ms,memory_kib");
    let scene = |tau_s| StraightPass { range_m: 500.0, window_s: 200.0, sd_rad: 0.03, tau_s, speed_m_s: 7.0 };
    let cases = [
        (0, Model::White, 0.0),
        (1, Model::Linear, 50.0),
        (1, Model::Linear, 50.3),
        (2, Model::Sinc, 50.0),
        (3, Model::Gaussian, 50.0),
        (4, Model::Markov, 50.0),
    ];
    // A full window of 401 bearings, in the memory a recorder would have.
    let mut work = Box::new(Workspace::<401>::new());
    let kib = (size_of::<Workspace<401>>() + 401 * size_of::<ml::Sample>()) as f64 / 1024.0;
    let draw = |tau_s: f64, run: usize| {
        let scene = scene(tau_s);
        let medium = Medium::of_sound_speed(1484.0);
        scene.samples(&medium, &scene.errors(&BearingNoise::Linear, &mut generator(options.seed, 600, run)))
    };
    for (number, model, tau_s) in cases {
        let c = Config { medium: Medium::of_sound_speed(1484.0), ..config(model, tau_s, 7.0) };
        let records: Vec<_> = (0..runs).map(|run| draw(tau_s, run)).collect();
        let mut levinson = false;
        let start = std::time::Instant::now();
        for s in &records {
            if let Ok(f) = ml::fit(&c, s, &mut work, &mut []) {
                levinson = matches!(f.factorisation.method, WhitenMethod::Levinson { .. });
            }
        }
        let ms = start.elapsed().as_secs_f64() * 1e3 / runs as f64;
        report.row(&[f64::from(number), tau_s, f64::from(u8::from(levinson)), ms, kib]);
    }
    let filter = passage::Config { speed_m_s: 7.0, speed_sd_m_s: 0.0, ..passage::Config::default() };
    let records: Vec<_> = (0..runs).map(|run| draw(0.0, run)).collect();
    let start = std::time::Instant::now();
    for s in &records {
        let mut recorded = Passage::<RECORDED>::new();
        for b in s {
            recorded.push(&filter, &Measurement::azimuth(b.t_s, b.azimuth_rad, 0.0));
            while recorded.work(&filter) {}
        }
    }
    let ms = start.elapsed().as_secs_f64() * 1e3 / runs as f64;
    report.row(&[5.0, 5.0, 0.0, ms, size_of::<Passage<RECORDED>>() as f64 / 1024.0]);
    report.finish(options)
}
