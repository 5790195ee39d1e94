//! Part of `reproduce difar`: tracks from bearings with the errors of real buoys, robust (all bearings at once, and by the
//! recorder's passage fit) against least squares.
//!
//! The real passes say nothing of this: the ship leaves its buoy straight away for a minute, and range is not
//! observable. Vessels therefore pass a buoy in simulation, and each bearing's error is drawn from the real ones.

use super::Options;
use super::motion::generator;
use super::report::CsvReport;
use anyhow::Result;
use rand::RngExt;
use rayon::prelude::*;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::motion::Medium;
use seabearing_host::motion::estimate::one_by_one;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{Config, Sample, fit};
use seabearing_locate::motion::robust::fit_robust;
use seabearing_locate::motion::whiten::Workspace;

/// Closest points of approach, metres.
const RANGES_M: [f64; 3] = [200.0, 400.0, 800.0];
/// Passes a range.
const RUNS: usize = 500;
/// Bearings of a pass, one every ten seconds as the buoys give them.
const BEARINGS: u32 = 40;
/// Speed of the vessels, known to the fit, m/s.
const SPEED_M_S: f64 = 5.0;
/// Scale of the good bearings' errors, degrees: 1.4826 times the median of the real ones, which is 1.5°.
const SCALE_DEG: f64 = 2.2;

/// The figures, and their bar: the robust fits are the better ones.
pub(super) const FIGURES: [&str; 2] =
    ["tracks: heading RMSE, robust over least squares, worst", "the same by the recorder's passage fit"];
pub(super) const BAR: f64 = 1.0;

/// Errors of heading (degrees) and of closest range (share of it) of one pass.
type Errors = [f64; 2];
/// Least squares, robust, robust by the passage fit.
const ESTIMATORS: usize = 3;

/// Fits passes with errors drawn from `errors_deg` and reports root mean squares and medians of what they give.
pub(super) fn tracks(errors_deg: &[f64], options: &Options) -> Result<()> {
    let mut report = CsvReport::new(
        "difar-tracks",
        "cpa_m,runs,heading_rms_ls,heading_rms_robust,heading_rms_passage,range_rms_ls,range_rms_robust,\
         range_rms_passage",
    );
    let runs = options.runs.unwrap_or(RUNS);
    let mut worst = [0.0f64; 2];
    for (point, range_m) in RANGES_M.into_iter().enumerate() {
        let both: Vec<[Errors; ESTIMATORS]> = (0..runs)
            .into_par_iter()
            .filter_map(|run| pass(errors_deg, range_m, &mut generator(options.seed, point as u64, run)))
            .collect();
        let rms = |estimator: usize, quantity: usize| {
            (both.iter().map(|e| e[estimator][quantity].powi(2)).sum::<f64>() / both.len() as f64).sqrt()
        };
        let [heading, range] = [0, 1].map(|quantity| [0, 1, 2].map(|estimator| rms(estimator, quantity)));
        let row = [range_m, both.len() as f64].into_iter().chain(heading).chain(range);
        report.row(&row.collect::<Vec<f64>>());
        for (worst, robust) in worst.iter_mut().zip(&heading[1..]) {
            *worst = worst.max(robust / heading[0]);
        }
    }
    report.finish(options)?;
    for (figure, worst) in FIGURES.into_iter().zip(worst) {
        options.figures.at_most(figure, worst, BAR);
    }
    Ok(())
}

/// One pass by each estimator; `None` where one gives no track.
fn pass(errors_deg: &[f64], range_m: f64, rng: &mut rand_chacha::ChaCha8Rng) -> Option<[Errors; ESTIMATORS]> {
    let heading = rng.random_range(0.0..360.0) * RAD_PER_DEG;
    let (s, c) = heading.sin_cos();
    let samples: Vec<Sample> = (0..BEARINGS)
        .map(|k| {
            let t_s = 10.0 * f64::from(k);
            let along = SPEED_M_S * (t_s - 5.0 * f64::from(BEARINGS));
            let azimuth = (along * s - range_m * c).atan2(along * c + range_m * s);
            let error = errors_deg[rng.random_range(0..errors_deg.len())];
            Sample::azimuth(t_s, azimuth + error * RAD_PER_DEG, SCALE_DEG * RAD_PER_DEG)
        })
        .collect();
    let config = Config {
        model: Model::White,
        tau_s: 0.0,
        white_share: 0.0,
        speed_m_s: SPEED_M_S,
        speed_sd_m_s: 0.0,
        range_m: (20.0, 5000.0),
        medium: Medium::of_sound_speed(f64::INFINITY),
        elevation_bias_sd_rad: 0.0,
        acceleration_sd_m_s2: 0.0,
    };
    let mut work = Box::new(Workspace::<64>::new());
    let mut copy = samples.clone();
    let squares = fit(&config, &samples, &mut work, &mut []).ok()?;
    let robust = fit_robust(&config, &samples, &mut copy, &mut work, &mut []).ok()?;
    let passage = one_by_one(&config, &samples, SCALE_DEG * RAD_PER_DEG, f64::INFINITY, true).ok()?;
    Some(
        [squares.solution, robust.fit.solution, passage.solution].map(|found| {
            [wrap_pi(found.heading_rad - heading) / RAD_PER_DEG, found.cpa_range_m / range_m - 1.0]
        }),
    )
}
