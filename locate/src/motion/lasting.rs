//! How much of the bearings' stated errors lasts, and how long, told from the bearings themselves.
//!
//! In: bearings with the whole deviation of each, and what else is assumed of the track. Out: the same assumptions with a Gauss-Markov share
//! of the errors' variance and its correlation interval, by maximum likelihood over a grid of both, each with a straight track of its own.
//! A recorder's deviation holds what is new with each bearing (noise) and what changes over many (echoes of surface and bottom): taken as
//! independent the second averages out, which it does not. The deviations themselves are kept. Assumes errors of one kind over the whole
//! passage. Cost: some 50 fits.

use super::covariance::Model;
use super::ml::{Config, FitError, Sample, fit, refit};
use super::normal::Normal;
use super::whiten::{Factorisation, Workspace};
use crate::math::f64 as m;
use crate::network::locate::misfit_limit;

/// Shares of the variance that are looked at.
const SHARES: [f64; 7] = [0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9];
/// The longest interval looked at is this part of the passage: what lasts longer is no other than a course.
const LONGEST: f64 = 0.25;
/// Least passage, bearings.
const LEAST: usize = 40;

/// The assumptions under which the bearings are likeliest: `config` itself where its errors are correlated already, where too few bearings
/// are there to tell, or where independent errors explain as much.
///
/// # Errors
/// As [`fit`].
pub fn estimate<const N: usize>(
    config: &Config,
    samples: &[Sample],
    work: &mut Workspace<N>,
) -> Result<Config, FitError> {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return Err(FitError::TooFew) };
    let span_s = last.t_s - first.t_s;
    if config.model != Model::White || samples.len() < LEAST || span_s <= 0.0 {
        return Ok(*config);
    }
    let alone = fit(config, samples, work, &mut [])?;
    // What a grid of two numbers gains by chance.
    let mut best = (twice(&alone.normal) - misfit_limit(2), *config);
    let times = || samples.iter().map(|s| s.t_s);
    let mut tau_s = 2.0 * span_s / (samples.len() - 1) as f64;
    while tau_s <= LONGEST * span_s {
        let plan =
            Factorisation::new(Model::Markov, tau_s, times(), work, &mut []).map_err(FitError::Whiten)?;
        for share in SHARES {
            let white_share = 1.0 - share;
            let assumed = Config { model: Model::Markov, tau_s, white_share, ..*config };
            let plan = plan.with_white(white_share);
            if let Some(found) = refit(&assumed, samples, &alone.solution.line, &plan, work, &[])
                && twice(&found.normal) < best.0
            {
                best = (twice(&found.normal), assumed);
            }
        }
        tau_s *= 1.5;
    }
    Ok(best.1)
}

/// Variance that all azimuths of a passage may have in common, rad², where a share of their errors lasts: what does not change while a vessel
/// passes turns its course and shows in no residual, so that it may be as large as what does.
pub(super) fn throughout(config: &Config, samples: &[Sample]) -> f64 {
    if config.white_share <= 0.0 || samples.is_empty() {
        return 0.0;
    }
    let square = |s: &Sample| f64::from(s.sd_rad) * f64::from(s.sd_rad);
    (1.0 - config.white_share) * samples.iter().map(square).sum::<f64>() / samples.len() as f64
}

/// Gives elevations, which a fit takes as independent, the deviation with which their mean is as well known as if their errors lasted like those
/// of the azimuths.
pub fn widen_elevations(config: &Config, samples: &mut [Sample]) {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return };
    let step_s = (last.t_s - first.t_s) / samples.len().saturating_sub(1).max(1) as f64;
    if config.model != Model::Markov || step_s <= 0.0 {
        return;
    }
    // The sum of all correlations with the others.
    let with_next = m::exp(-step_s / config.tau_s);
    let others = 2.0 * (1.0 - config.white_share) * with_next / (1.0 - with_next);
    let factor = m::sqrt(1.0 + others) as f32;
    for s in samples {
        s.elevation_rad.1 *= factor;
    }
}

/// Minus twice the logarithm of the restricted likelihood, but for a constant: what fitting a course takes off the residuals is given back, or
/// errors that last would look as if they lasted less.
fn twice(normal: &Normal) -> f64 {
    let [a, b, c, ..] = normal.gram();
    let of_course = a[0] * (b[1] * c[2] - b[2] * b[2]) - a[1] * (a[1] * c[2] - b[2] * a[2])
        + a[2] * (a[1] * b[2] - b[1] * a[2]);
    normal.cost() + normal.ln_det() + m::ln(of_course.max(1e-300))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::model::Line;
    use crate::motion::test_pass::{config, normal};
    use std::boxed::Box;
    use std::vec::Vec;

    const SD_RAD: f64 = 1e-4;

    fn passing(share: f64, tau_s: f64, seed: u64) -> Vec<Sample> {
        let mut normal = normal(seed);
        let line = Line { p: [0.5, 100.0, (7.0f64 / 500.0).ln(), 7f64.ln(), 0.0], sense: 1.0 };
        let kept = (-0.5 / tau_s).exp();
        let mut lasting = normal();
        let mut of = |k: u32| {
            let t_s = 0.5 * f64::from(k);
            lasting = kept * lasting + (1.0 - kept * kept).sqrt() * normal();
            let error = SD_RAD * ((1.0 - share).sqrt() * normal() + share.sqrt() * lasting);
            Sample::azimuth(t_s, line.azimuth(&config().medium, t_s) + error, SD_RAD)
        };
        (0..401).map(&mut of).collect()
    }

    #[test]
    fn what_lasts_is_told_and_counted_and_noise_is_not() {
        let mut work = Box::new(Workspace::<512>::new());
        let (mut lasting, mut consistent, mut inside, mut too_bold) = (0, 0, 0, 0);
        for seed in 0..40 {
            let samples = passing(0.4, 15.0, 101 + seed);
            let assumed = estimate(&config(), &samples, &mut work).unwrap();
            let found = fit(&assumed, &samples, &mut work, &mut []).unwrap();
            let off = |fit: &crate::motion::ml::Fit| {
                let s = fit.solution;
                (s.cpa_time_s - 100.0).abs() < 1.96 * s.sd_cpa_time_s
            };
            lasting += usize::from(assumed.model == Model::Markov);
            consistent += usize::from(found.growth <= 1.0 && found.change.is_none_or(|c| c.seen.is_none()));
            inside += usize::from(off(&found));
            let independent = fit(&config(), &samples, &mut work, &mut []).unwrap();
            too_bold += usize::from(independent.growth > 1.0);
            let noise = passing(0.0, 15.0, 501 + seed);
            let of_noise = estimate(&config(), &noise, &mut work).unwrap();
            assert_eq!(of_noise.model, Model::White, "{seed}: {of_noise:?}");
        }
        assert!(
            lasting >= 38 && consistent >= 38 && inside >= 35 && too_bold >= 30,
            "{lasting} {consistent} {inside} {too_bold}"
        );
    }
}
