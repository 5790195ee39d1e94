//! Whether residuals hold what changes slowly: a turn, an acceleration, a ripple of echoes.
//!
//! In: the bearings, what is assumed of their errors, and the fitted line. Out: the misfit of averages over successive stretches.
//! Among hundreds of bearings a bend of a third of a deviation is lost in the squared residual of each; of averages it is several
//! deviations. A stretch lasts two correlation intervals or more, so that averages are independent, and has four bearings or more.
//! Cost: the square of the bearings of a stretch, for each.

use super::ml::{Config, Sample};
use super::model::Line;
use super::solution::Misfit;
use crate::angle::wrap_pi;

/// Stretches at most, and at least: those whose freedom is what three parameters of a course leave, and as many again.
const MOST: usize = 16;
const LEAST: usize = 7;
/// Bearings of a stretch at least, and correlation intervals.
const BEARINGS: usize = 4;
const INTERVALS: f64 = 2.0;
/// Parameters of a course that azimuths tell.
const OBSERVABLE: f64 = 3.0;

/// The misfit of averaged azimuths; none where there are too few, or their errors last too long.
pub fn misfit(config: &Config, samples: &[Sample], line: &Line) -> Option<Misfit> {
    let span_s = samples.last()?.t_s - samples.first()?.t_s;
    let by_time = if config.tau_s > 0.0 { (span_s / (INTERVALS * config.tau_s)) as usize } else { MOST };
    let stretches = MOST.min(by_time).min(samples.len() / BEARINGS);
    if stretches < LEAST {
        return None;
    }
    let view = line.view(&config.medium);
    let cost = samples.chunks(samples.len().div_ceil(stretches)).map(|stretch| {
        let (mut sum, mut variance) = (0.0, 0.0);
        for (k, a) in stretch.iter().enumerate() {
            // Weighted by information, each counts its residual over its deviation by the inverse of that.
            let weight = 1.0 / f64::from(a.sd_rad);
            sum += weight * weight * wrap_pi(a.azimuth_rad - view.expected(a.t_s).azimuth);
            variance += weight * weight;
            let others = stretch.iter().skip(k + 1).filter(|_| config.tau_s > 0.0);
            let shared = |b: &Sample| config.model.rho(b.t_s - a.t_s, config.tau_s) / f64::from(b.sd_rad);
            variance += 2.0 * weight * others.map(shared).sum::<f64>();
        }
        sum * sum / variance
    });
    let (cost, count) = cost.fold((0.0, 0.0), |(cost, count), c| (cost + c, count + 1.0));
    Some(Misfit { cost, freedom: count - OBSERVABLE, counts: true })
}
