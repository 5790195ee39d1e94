//! Whether residuals hold what changes slowly: a turn, an acceleration, a ripple of echoes.
//!
//! In: the bearings, what is assumed of their errors, and the fitted line. Out: the misfit of averages over successive stretches.
//! Among hundreds of bearings a bend of a third of a deviation is lost in the squared residual of each; of averages it is several
//! deviations. A stretch lasts two correlation intervals or more, so that averages are independent, and has four bearings or more.
//! Cost: the square of the bearings of a stretch, for each.

use super::ml::{Config, Sample};
use super::model::Line;
use crate::angle::wrap_pi;

/// Stretches at most, and at least: those whose freedom is what three parameters of a course leave, and as many again.
const MOST: usize = 16;
const LEAST: usize = 7;
/// Bearings of a stretch at least, and correlation intervals.
const BEARINGS: usize = 4;
const INTERVALS: f64 = 2.0;
/// Parameters of a course that azimuths tell.
const OBSERVABLE: f64 = 3.0;

/// Squared residual a degree of freedom of averaged azimuths, and how many of these there are; none where there are too few bearings, or
/// their errors last too long.
pub fn consistency(config: &Config, samples: &[Sample], line: &Line) -> Option<(f64, f64)> {
    let view = line.view(&config.medium);
    averaged(config, samples, |s| wrap_pi(s.azimuth_rad - view.expected(s.t_s).azimuth))
}

/// The same of any residuals of azimuth, radians.
pub(super) fn averaged(
    config: &Config,
    samples: &[Sample],
    residual: impl Fn(&Sample) -> f64,
) -> Option<(f64, f64)> {
    let span_s = samples.last()?.t_s - samples.first()?.t_s;
    let by_time = if config.tau_s > 0.0 { (span_s / (INTERVALS * config.tau_s)) as usize } else { MOST };
    let stretches = MOST.min(by_time).min(samples.len() / BEARINGS);
    if stretches < LEAST {
        return None;
    }
    let cost = samples.chunks(samples.len().div_ceil(stretches)).map(|stretch| {
        let (mut sum, mut variance) = (0.0, 0.0);
        for (k, a) in stretch.iter().enumerate() {
            // Weighted by information, each counts its residual over its deviation by the inverse of that.
            let weight = 1.0 / f64::from(a.sd_rad);
            sum += weight * weight * residual(a);
            variance += weight * weight;
            let others = stretch.iter().skip(k + 1).filter(|_| config.tau_s > 0.0);
            let shared = |b: &Sample| config.model.rho(b.t_s - a.t_s, config.tau_s) / f64::from(b.sd_rad);
            variance += 2.0 * (1.0 - config.white_share) * weight * others.map(shared).sum::<f64>();
        }
        sum * sum / variance
    });
    let (cost, count) = cost.fold((0.0, 0.0), |(cost, count), c| (cost + c, count + 1.0));
    let freedom: f64 = count - OBSERVABLE;
    Some((cost / freedom, freedom))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ml::fit;
    use crate::motion::test_pass::{config, normal};
    use crate::motion::whiten::Workspace;
    use std::boxed::Box;
    use std::vec::Vec;

    const SD_RAD: f64 = 0.01;

    /// 200 s of a vessel that passes 500 m away, with a ripple of so many deviations and a minute's period.
    fn passing(ripple_sd: f64, seed: u64) -> Vec<Sample> {
        let mut normal = normal(seed);
        let line = Line { p: [0.5, 100.0, (7.0f64 / 500.0).ln(), 7f64.ln(), 0.0], sense: 1.0 };
        let of = |k: u32| {
            let t_s = 0.5 * f64::from(k);
            let error = SD_RAD * (normal() + ripple_sd * (t_s * std::f64::consts::TAU / 60.0).sin());
            Sample::azimuth(t_s, line.azimuth(&config().medium, t_s) + error, SD_RAD)
        };
        (0..401).map(of).collect()
    }

    #[test]
    fn a_ripple_below_a_deviation_is_noticed_and_noise_is_not() {
        let mut work = Box::new(Workspace::<512>::new());
        let mut noticed = [0; 2];
        for seed in 0..40 {
            for (count, ripple_sd) in noticed.iter_mut().zip([0.0, 0.7]) {
                let found = fit(&config(), &passing(ripple_sd, 7 + seed), &mut work, &mut []).unwrap();
                *count += usize::from(found.growth > 1.0);
                assert!(found.growth <= 1.0 || found.growth <= found.solution.consistency);
            }
        }
        let [noise, ripple] = noticed;
        assert!(noise <= 1 && ripple >= 38, "{noise} {ripple}");
    }
}
