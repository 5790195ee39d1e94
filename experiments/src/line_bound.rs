//! A line's orientation against its bound: bearings with errors of a known kind, on a track that covers all of them or a
//! part, with the clock's shift unknown; root mean square error over the Cramér-Rao bound, and how honest the stated
//! deviation is.

use super::line::{ETA, ORIENTATION_DEG, sine_of, vessel};
use super::report::CsvReport;
use super::{Experiment, Options};
use anyhow::{Context, Result, anyhow};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_host::bounds::line::orientation as bound;
use seabearing_locate::network::known_track::{TrackPoint, position_at};
use seabearing_locate::orient::line::{LineBearing, LineSettings, orient};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "line-bound",
    about: "orientation of a linear array against its bound, its track covering all bearings or a part",
    run,
};

const RUNS: usize = 200;
const BEARINGS: u32 = 87;
/// Standard deviations of a sine: with the smaller, whole shifts can be told from others, with the larger they can't.
const SD: [f64; 2] = [0.001, 0.004];
/// Share of an error that stays in the next: none, and that of paper L's forgetting factor.
const COMMON: [f64; 2] = [0.0, 0.4];
/// Ends of the track, seconds: more than the bearings, less at one end, less at both.
const TRACKS: [(i32, i32); 3] = [(-20, 110), (0, 80), (10, 60)];
/// Longest gap that is interpolated, seconds.
const GAP_S: f64 = 60.0;

/// Orientation, shift and η.
type Truth = [f64; 3];

fn sine(t_s: f64, [orientation, shift_s, eta]: Truth) -> f64 {
    sine_of(vessel(t_s - shift_s), orientation, eta)
}

fn track((from_s, to_s): (i32, i32)) -> Vec<TrackPoint> {
    let times = (from_s..=to_s).step_by(10).map(f64::from);
    let point = |t_s| {
        let [x, y] = vessel(t_s);
        TrackPoint { t_s, position_m: [x, y, 0.0] }
    };
    times.map(point).collect()
}

fn bearings(rng: &mut ChaCha8Rng, sd: f64, common: f64, truth: Truth) -> Vec<LineBearing> {
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    let mut error = sd * normal();
    (0..BEARINGS)
        .map(|k| {
            let t_s = f64::from(k);
            error = common * error + sd * (1.0 - common * common).sqrt() * normal();
            LineBearing { t_s, sine: sine(t_s, truth) + error }
        })
        .collect()
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let mut report = CsvReport::new(
        "line-bound",
        "track_from_s,track_to_s,sd_sine,common,whole_shifts,bound_deg,rmse_deg,rmse_over_bound,standardised_rms",
    );
    let bar = crate::progress::bar((TRACKS.len() * SD.len() * COMMON.len() * 2) as u64, "line-bound");
    let (mut ratios, mut stated) = ([0.0f64; 2], [f64::INFINITY, 0.0]);
    for ends in TRACKS {
        for sd in SD {
            for common in COMMON {
                for (whole_s, shift_s) in [(0.0, 2.4), (1.0, 2.0)] {
                    let truth = [ORIENTATION_DEG * RAD_PER_DEG, shift_s, ETA];
                    let track = track(ends);
                    let settings =
                        LineSettings { shift_s: (-9.0, 9.0), eta: (0.85, 1.05), gap_s: GAP_S, whole_s };
                    let errors = (0..runs)
                        .into_par_iter()
                        .map(|run| {
                            let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
                            rng.set_stream(run as u64);
                            let heard = bearings(&mut rng, sd, common, truth);
                            let found = orient(&heard, &track, &settings).map_err(|e| anyhow!("{e}"))?;
                            Ok((wrap_pi(found.orientation - truth[0]), found.sd))
                        })
                        .collect::<Result<Vec<(f64, f64)>>>()?;
                    let mean =
                        |of: &dyn Fn(&(f64, f64)) -> f64| errors.iter().map(of).sum::<f64>() / runs as f64;
                    let rmse = mean(&|(e, _)| e * e).sqrt();
                    let standardised = mean(&|(e, sd)| (e / sd).powi(2)).sqrt();
                    let on_track = |t_s: &f64| position_at(&track, t_s - truth[1], GAP_S).is_some();
                    let times: Vec<f64> = (0..BEARINGS).map(f64::from).filter(on_track).collect();
                    let bound = bound(&times, sd, common, truth, vessel)
                        .context("no bound: too few bearings on the track")?;
                    let ratio = rmse / bound;
                    let [from_s, to_s] = [ends.0, ends.1].map(f64::from);
                    let row = [
                        from_s,
                        to_s,
                        sd,
                        common,
                        whole_s,
                        bound.to_degrees(),
                        rmse.to_degrees(),
                        ratio,
                        standardised,
                    ];
                    report.row(&row);
                    let of = usize::from(whole_s > 0.0);
                    ratios[of] = ratios[of].max(ratio);
                    // A whole shift that is right makes the errors smaller than what has to be reckoned with.
                    let least = if of == 0 { standardised } else { f64::INFINITY };
                    stated = [stated[0].min(least), stated[1].max(standardised)];
                    bar.inc(1);
                }
            }
        }
    }
    bar.finish_and_clear();
    report.finish(options)?;
    let figures = &options.figures;
    figures.at_most("orientation, free shift: RMSE over its bound, worst of all rows", ratios[0], 1.1);
    figures.at_most("orientation, whole shifts preferred: RMSE over the free bound", ratios[1], 1.1);
    figures.at_least("standardised errors, free shift: least root mean square of all rows", stated[0], 0.8);
    figures.at_most("standardised errors, greatest root mean square of all rows", stated[1], 1.2);
    Ok(())
}
