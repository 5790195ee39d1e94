//! Maximum-likelihood fit of a straight track to all bearings of a passage at once [M 9, 10].
//!
//! In: bearings (with elevations where the height of the vessel above the array is known), an error model, a prior of
//! speed. Out: the minimum of `(α̂ − α(θ))ᵀ C⁻¹ (α̂ − α(θ))` with wrapped residuals, found by damped Gauss-Newton from
//! several starting hypotheses of both passing sides, and its covariance; a profile-likelihood interval of range.
//! Assumes constant speed and heading and Gaussian errors of known covariance. Cost at K = 401 with the linear model:
//! about 10 evaluations of the short way of [`super::whiten`].

use super::change::{Change, change};
use super::covariance::Model;
use super::hypotheses::{add_priors, same};
use super::lasting;
use super::model::{LN_SPEED, Limits, Line, Medium, PARAMETERS};
use super::normal::{COLUMNS, Normal, Point, minimise};
use super::profile::{heading_sd_rad, widened};
use super::slow;
use super::solution::{Solution, from_covariance, solution};
use super::start::{STARTS, emitted, starts};
use super::whiten::{Factorisation, WhitenError, Workspace};
use crate::angle::wrap_pi;
use crate::math::f64 as m;
use crate::network::locate::misfit_limit;

/// What is assumed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Correlation of the azimuths' errors.
    pub model: Model,
    /// Correlation interval, s.
    pub tau_s: f64,
    /// Share of an azimuth's variance that is its own, 0 to 1; what the others have in common follows `model` (Markov only).
    pub white_share: f64,
    /// Known speed, mean of the prior, or (with an infinite `speed_sd_m_s`) only a starting value, m/s.
    pub speed_m_s: f64,
    /// 0: known; finite: standard deviation of the prior or measurement; infinite: unknown (needs elevations).
    pub speed_sd_m_s: f64,
    /// Nearest and farthest closest-point range considered, m.
    pub range_m: (f64, f64),
    /// Travel time and height above the array.
    pub medium: Medium,
    /// Standard deviation of a bias common to all elevations (multipath), radians; 0: none.
    pub elevation_bias_sd_rad: f64,
    /// Standard deviation of an acceleration along the course that a vessel is assumed to have, m/s²; 0: constant speed is assumed.
    pub acceleration_sd_m_s2: f64,
}

impl Config {
    fn free(&self) -> [bool; PARAMETERS] {
        let elevations = self.medium.height_m > 0.0;
        [true, true, true, self.speed_sd_m_s > 0.0, elevations && self.elevation_bias_sd_rad > 0.0]
    }
}

/// One bearing of the batch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time of reception, s.
    pub t_s: f64,
    /// Azimuth, radians.
    pub azimuth_rad: f64,
    /// Standard deviation of its error, radians: `[C]_ij = σ_i σ_j ρ(t_i − t_j)`.
    pub sd_rad: f32,
    /// Elevation and the standard deviation of its (independent) error, radians; infinite where there is none.
    pub elevation_rad: (f32, f32),
}

impl Sample {
    /// An azimuth alone.
    pub fn azimuth(t_s: f64, azimuth_rad: f64, sd_rad: f64) -> Self {
        Self { t_s, azimuth_rad, sd_rad: sd_rad as f32, elevation_rad: (0.0, f32::INFINITY) }
    }
}

/// A finished fit.
#[derive(Clone, Copy, Debug)]
pub struct Fit {
    /// What it says about the vessel, the growth in it.
    pub solution: Solution,
    /// By what a misfit beyond chance, of the bearings or of their averages, makes every variance grow; 1 where they fit.
    pub growth: f64,
    /// What the residuals tell of a change of speed or course, counted in the solution; none where it cannot be tested.
    pub change: Option<Change>,
    /// Normal equations at the minimum.
    pub normal: Normal,
    /// How the errors were whitened; its `nugget` is above zero where the model was nearly singular.
    pub factorisation: Factorisation,
}

/// Why there is no fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// Fewer than five bearings.
    #[error("a track needs at least 5 bearings")]
    TooFew,
    /// Not finite, a standard deviation that is not positive, or nonsense in the configuration; index of the sample.
    #[error("bearing {n} is not usable", n = .0 + 1)]
    BadSample(usize),
    /// Speed is unknown and there are no elevations.
    #[error("an unknown speed needs elevations")]
    NoRange,
    /// The errors cannot be whitened.
    #[error(transparent)]
    Whiten(WhitenError),
    /// No starting hypothesis led to a minimum.
    #[error("no straight track fits")]
    NoMinimum,
}

/// Steps from each start over a thinned record, and at most over all bearings.
const ROUGH_STEPS: usize = 8;
const FINE_STEPS: usize = 40;
/// A heading with less spread has the deviation of its line, radians (1°).
const SURE_RAD: f64 = 0.0175;
/// Bearings of the thinned record.
const THINNED: usize = 32;

/// Fits the track. `dense` is memory for irregular times with the linear, sinc and Gaussian models (may be empty).
///
/// # Errors
/// [`FitError`].
pub fn fit<const N: usize>(
    config: &Config,
    samples: &[Sample],
    work: &mut Workspace<N>,
    dense: &mut [f64],
) -> Result<Fit, FitError> {
    let limits = check(config, samples)?;
    let times = samples.iter().map(|s| s.t_s);
    let factorisation =
        Factorisation::new(config.model, config.tau_s, times, work, dense).map_err(FitError::Whiten)?;
    let factorisation = factorisation.with_white(config.white_share);
    let free = config.free();
    let stride = samples.len().div_ceil(THINNED).max(1);
    let white =
        Factorisation { method: super::whiten::WhitenMethod::Chain, model: Model::White, ..factorisation };
    let pairs = samples.iter().map(|s| (s.t_s, s.azimuth_rad));
    let mut best: Option<Point> = None;
    let mut tried = [None; STARTS];
    for (k, start) in starts(pairs, samples.len(), config.speed_m_s, &limits).iter().flatten().enumerate() {
        let line = emitted(&start.line, &config.medium);
        let rough =
            |line: &Line| evaluate(config, &white, samples.iter().step_by(stride), line, &mut *work, &[]);
        let Some(line) = minimise(&line, &free, &limits, ROUGH_STEPS, rough).map(|p| p.at) else { continue };
        // Several starts lead to one minimum, which is looked at once.
        if tried.iter().flatten().any(|other| same(other, &line)) {
            continue;
        }
        if let Some(slot) = tried.get_mut(k) {
            *slot = Some(line);
        }
        let Some(normal) = evaluate(config, &factorisation, samples.iter(), &line, work, dense) else {
            continue;
        };
        if best.is_none_or(|b| normal.cost() < b.normal.cost()) {
            best = Some(Point { at: line, normal, damping: 1e-6 });
        }
    }
    let line = best.ok_or(FitError::NoMinimum)?.at;
    let point = minimise(&line, &free, &limits, FINE_STEPS, |line| {
        evaluate(config, &factorisation, samples.iter(), line, &mut *work, dense)
    })
    .ok_or(FitError::NoMinimum)?;
    finished(config, samples, &limits, &factorisation, &point, work, dense).ok_or(FitError::NoMinimum)
}

/// Fits from a given line alone, with a plan made before for the same times: for many records of the same geometry.
pub fn refit<const N: usize>(
    config: &Config,
    samples: &[Sample],
    start: &Line,
    factorisation: &Factorisation,
    work: &mut Workspace<N>,
    dense: &[f64],
) -> Option<Fit> {
    let limits = check(config, samples).ok()?;
    let point = minimise(start, &config.free(), &limits, FINE_STEPS, |line| {
        evaluate(config, factorisation, samples.iter(), line, &mut *work, dense)
    })?;
    finished(config, samples, &limits, factorisation, &point, work, dense)
}

/// Normal equations of the samples about `line`, priors included.
pub fn evaluate<'a, const N: usize>(
    config: &Config,
    factorisation: &Factorisation,
    samples: impl Iterator<Item = &'a Sample> + Clone,
    line: &Line,
    work: &mut Workspace<N>,
    dense: &[f64],
) -> Option<Normal> {
    let elevations = config.medium.height_m > 0.0;
    let mut of_elevations = Normal::default();
    let mut rows = samples.clone();
    let view = line.view(&config.medium);
    let mut normal = factorisation.normal(samples.map(|s| s.t_s), work, dense, |_, t| {
        let mut row = [0.0; COLUMNS];
        let Some(sample) = rows.next() else { return row };
        let e = view.expected(t);
        let scale = 1.0 / f64::from(sample.sd_rad);
        for (x, d) in row.iter_mut().zip(&e.d_azimuth) {
            *x = d * scale;
        }
        row[PARAMETERS] = wrap_pi(sample.azimuth_rad - e.azimuth) * scale;
        if elevations && sample.elevation_rad.1.is_finite() {
            let mut extra = [0.0; COLUMNS];
            for (x, d) in extra.iter_mut().zip(&e.d_elevation) {
                *x = *d;
            }
            extra[PARAMETERS] = f64::from(sample.elevation_rad.0) - e.elevation;
            let sd = f64::from(sample.elevation_rad.1);
            of_elevations.add(&extra, 1.0 / (sd * sd));
        }
        row
    })?;
    normal.join(&of_elevations);
    add_priors(&mut normal, line, config.speed_m_s, config.speed_sd_m_s, config.elevation_bias_sd_rad);
    normal.is_finite().then_some(normal)
}

fn check(config: &Config, samples: &[Sample]) -> Result<Limits, FitError> {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return Err(FitError::TooFew) };
    if samples.len() < PARAMETERS {
        return Err(FitError::TooFew);
    }
    for (i, s) in samples.iter().enumerate() {
        let sane = s.t_s.is_finite() && s.azimuth_rad.is_finite() && s.sd_rad.is_finite() && s.sd_rad > 0.0;
        if !sane || !s.elevation_rad.0.is_finite() || s.elevation_rad.1.is_nan() || s.elevation_rad.1 <= 0.0 {
            return Err(FitError::BadSample(i));
        }
    }
    let seen = config.medium.height_m > 0.0 && samples.iter().any(|s| s.elevation_rad.1.is_finite());
    if config.speed_sd_m_s == f64::INFINITY && !seen {
        return Err(FitError::NoRange);
    }
    Ok(Limits { range_m: config.range_m, ln_speed: LN_SPEED, times_s: (first.t_s, last.t_s) })
}

fn finished<const N: usize>(
    config: &Config,
    samples: &[Sample],
    limits: &Limits,
    factorisation: &Factorisation,
    point: &Point,
    work: &mut Workspace<N>,
    dense: &[f64],
) -> Option<Fit> {
    let elevations = if config.medium.height_m > 0.0 {
        samples.iter().filter(|s| s.elevation_rad.1.is_finite()).count()
    } else {
        0
    };
    let measurements = (samples.len() + elevations) as f64;
    let n = samples.len() as u32;
    let free = config.free();
    let mut of_each = solution(&point.at, &point.normal, &free, limits, n, measurements)?;
    let sure = of_each.covariance[0][0] < SURE_RAD * SURE_RAD && point.at.at_limit(limits) == 0;
    if !sure {
        let normal_at =
            |line: &Line| evaluate(config, factorisation, samples.iter(), line, &mut *work, dense);
        let sd = heading_sd_rad(&point.at, &of_each.covariance, &free, limits, normal_at);
        let covariance = widened(&of_each.covariance, sd);
        of_each = from_covariance(&point.at, &covariance, limits, n, of_each.consistency)?;
    }
    let unknowns = free.iter().filter(|f| **f).count() as f64;
    let freedom = measurements - unknowns;
    let at = (&point.at, &point.normal);
    let change = change(config, samples, at, &free, limits, freedom, factorisation, work, dense);
    let (solution, growth) = grown(config, samples, limits, of_each, freedom, true, change.as_ref())?;
    Some(Fit { solution, growth, change, normal: point.normal, factorisation: *factorisation })
}

/// A solution whose variances count a misfit beyond chance, of each measurement and of `averages` of azimuths, and what a change of speed
/// or course does; and by what they grew for the misfit.
fn grown(
    config: &Config,
    samples: &[Sample],
    limits: &Limits,
    of_each: Solution,
    freedom: f64,
    averages: bool,
    change: Option<&Change>,
) -> Option<(Solution, f64)> {
    let of_averages = if averages { slow::consistency(config, samples, &of_each.line) } else { None };
    // Beyond chance, the worse of both counts.
    let both = [Some((of_each.consistency, freedom)), of_averages];
    let beyond =
        both.into_iter().flatten().filter(|(x, freedom)| x * freedom > misfit_limit(*freedom as u32));
    let misfit = beyond.fold(1.0, |most: f64, (x, _)| most.max(x));
    // What a change explains is counted as such.
    let growth = match change {
        Some(Change { seen: Some(_), scatter, .. }) => misfit.min(scatter.max(1.0)),
        _ => misfit,
    };
    let mut added = change.map_or([[0.0; PARAMETERS]; PARAMETERS], |c| c.added);
    added[0][0] += lasting::throughout(config, samples);
    if misfit > 1.0 || added.iter().flatten().any(|x| *x != 0.0) {
        let mut covariance = of_each.covariance.map(|row| row.map(|x| growth * x));
        for (row, added) in covariance.iter_mut().zip(&added) {
            for (x, added) in row.iter_mut().zip(added) {
                *x += added;
            }
        }
        let consistency = if misfit > 1.0 { misfit } else { of_each.consistency };
        let solution = from_covariance(&of_each.line, &covariance, limits, of_each.n, consistency)?;
        return Some((solution, growth));
    }
    Some((of_each, growth))
}

/// The same of a solution by another estimator, of these samples but for `refused` ones; `None` where they are not usable.
pub fn with_misfit<const N: usize>(
    config: &Config,
    samples: &[Sample],
    solution: &Solution,
    refused: usize,
    work: &mut Workspace<N>,
    dense: &mut [f64],
) -> Option<(Solution, f64, Option<Change>)> {
    let limits = check(config, samples).ok()?;
    let free = config.free();
    let unknowns = free.iter().filter(|f| **f).count();
    let freedom = (solution.n as usize).saturating_sub(unknowns) as f64;
    // Averages and patterns would hold what was refused.
    let mut tested = || {
        let times = samples.iter().map(|s| s.t_s);
        let factorisation = Factorisation::new(config.model, config.tau_s, times, work, dense).ok()?;
        let factorisation = factorisation.with_white(config.white_share);
        let line = &solution.line;
        let normal = evaluate(config, &factorisation, samples.iter(), line, work, dense)?;
        change(config, samples, (line, &normal), &free, &limits, freedom, &factorisation, work, dense)
    };
    let change = if refused == 0 { tested() } else { None };
    let (solution, growth) =
        grown(config, samples, &limits, *solution, freedom, refused == 0, change.as_ref())?;
    Some((solution, growth, change))
}

/// An interval of the closest-point range; an end that reaches the configured limit is open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Lower end, m.
    pub low_m: f64,
    /// Whether the interval goes on below the nearest range considered.
    pub low_open: bool,
    /// Upper end, m.
    pub high_m: f64,
    /// Whether it goes on beyond the farthest range considered.
    pub high_open: bool,
}

/// Profile-likelihood interval of the closest-point range: all ranges at which the least squared residual over all
/// other parameters is within `quantile` (3.84 for 95 %) of the minimum. The speed prior takes part.
pub fn range_interval<const N: usize>(
    config: &Config,
    samples: &[Sample],
    fit: &Fit,
    quantile: f64,
    work: &mut Workspace<N>,
    dense: &[f64],
) -> Option<Interval> {
    let limits = check(config, samples).ok()?;
    let free = config.free();
    let least = fit.normal.cost();
    // Far stiffer than what the bearings know of range, or the profile gives way to them.
    let of_range = |k: usize| fit.normal.gram()[k][k];
    let stiff = 1e4 * (of_range(2) + of_range(3)).max(1e4);
    let centre = m::ln(fit.solution.cpa_range_m);
    // The profile at a given ln range: a stiff pseudo-measurement pins it, its own residual is taken off again.
    let mut profile = |from: &Line, ln_range: f64| -> Option<(Line, f64)> {
        let mut start = *from;
        start.p[2] = start.p[3] - ln_range;
        let point = minimise(&start, &free, &limits, FINE_STEPS, |line| {
            let mut normal = evaluate(config, &fit.factorisation, samples.iter(), line, &mut *work, dense)?;
            let off = ln_range - (line.p[3] - line.p[2]);
            normal.add(&[0.0, 0.0, -1.0, 1.0, 0.0, off], stiff);
            Some(normal)
        })?;
        let off = ln_range - (point.at.p[3] - point.at.p[2]);
        Some((point.at, point.normal.cost() - stiff * off * off - least))
    };
    let mut end = |sign: f64, limit: f64| -> Option<(f64, bool)> {
        let relative = fit.solution.sd_cpa_range_m / fit.solution.cpa_range_m;
        let mut step = if relative.is_finite() { relative.max(1e-4) } else { 0.3 };
        let (mut inside, mut line) = (centre, fit.solution.line);
        let mut outside = None;
        for _ in 0..40 {
            let at = centre + sign * step;
            if sign * (at - limit) >= 0.0 {
                let (_, rise) = profile(&line, limit)?;
                if rise <= quantile {
                    return Some((m::exp(limit), true));
                }
                outside = Some(limit);
                break;
            }
            let (there, rise) = profile(&line, at)?;
            if rise > quantile {
                outside = Some(at);
                break;
            }
            (inside, line) = (at, there);
            step *= 1.5;
        }
        let mut outside = outside?;
        for _ in 0..14 {
            let at = 0.5 * (inside + outside);
            let (there, rise) = profile(&line, at)?;
            if rise > quantile {
                outside = at;
            } else {
                (inside, line) = (at, there);
            }
        }
        Some((m::exp(0.5 * (inside + outside)), false))
    };
    let (low_m, low_open) = end(-1.0, m::ln(config.range_m.0))?;
    let (high_m, high_open) = end(1.0, m::ln(config.range_m.1))?;
    Some(Interval { low_m, low_open, high_m, high_open })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::{RAD_PER_DEG, wrap_pi};
    use crate::motion::test_pass::{config, normal};
    use std::boxed::Box;
    use std::vec::Vec;

    #[test]
    fn an_arc_that_noise_makes_tells_no_heading() {
        // 1500 m to the east of the array, going north, from a minute before the closest point on.
        let config = Config { speed_sd_m_s: 2.0, ..config() };
        let mut work = Box::new(Workspace::<128>::new());
        for bearings in [24, 40, 60, 90] {
            let (mut told, mut right) = (0, 0);
            for run in 0..60 {
                let mut normal = normal(300 + run);
                let sd_rad = 0.9 * RAD_PER_DEG;
                let of = |k: usize| (0.5 * k as f64, 1500.0_f64.atan2(3.5 * k as f64 - 420.0));
                let heard = |k| (of(k).0, of(k).1 + sd_rad * normal());
                let samples: Vec<Sample> = (0..bearings)
                    .map(heard)
                    .map(|(t_s, azimuth)| Sample::azimuth(t_s, azimuth, sd_rad))
                    .collect();
                let Ok(fit) = fit(&config, &samples, &mut work, &mut []) else { continue };
                let (heading, sd) = (fit.solution.heading_rad, fit.solution.sd_heading_rad);
                told += usize::from(sd.is_finite());
                right += usize::from(sd.is_finite() && wrap_pi(heading).abs() < 1.96 * sd);
            }
            assert!(told - right <= 5, "{bearings}: {right} of {told}");
        }
    }
}
