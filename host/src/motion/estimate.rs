//! The track that bearings give, by either estimator.

use super::BatchRoom;
use anyhow::{Result, bail};
use seabearing_core::kit::spd::quadratic;
use seabearing_core::motion::Solution;
use seabearing_core::passage::{self, Measurement};
use seabearing_locate::motion::change::Change;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::lasting;
use seabearing_locate::motion::lone::Lone;
use seabearing_locate::motion::ml::{self, Config, FitError, Interval, Sample};
use seabearing_locate::motion::robust::{STUDENT, fit_robust, wrong};
use seabearing_locate::motion::whiten::WhitenError;

/// What a likelihood ratio of one parameter exceeds in 5 % of cases: χ² of one degree.
const CHI2_95: f64 = 3.841;

/// Fits in which a height and the travel time from it settle.
const HEIGHTS: usize = 3;

/// A track and how it was come by.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// The track with its uncertainty.
    pub solution: Solution,
    /// Profile-likelihood interval of range, 95 % (batch estimator).
    pub range_95_m: Option<Interval>,
    /// White part that was added to a nearly singular error model, as a share of the variance.
    pub nugget: f64,
    /// By what a misfit beyond chance made every variance grow; 1 where the bearings fit.
    pub growth: f64,
    /// What the bearings tell of a change of speed or course; none where it could not be tested.
    pub change: Option<Change>,
    /// Bearings that the track does without: refused, or (robust) far from it.
    pub wrong: usize,
}

/// All bearings at once, by maximum likelihood; `robust` with heavy tails.
///
/// # Errors
/// One line: why there is no track.
pub fn batch(config: &Config, samples: &[Sample], robust: bool) -> Result<Estimate> {
    let mut memory = BatchRoom::new();
    // Robust: the samples with the errors that make the Gaussian likelihood pull as the heavy-tailed one.
    let mut weighted = samples.to_vec();
    let whitening = |e: &FitError| if let FitError::Whiten(e) = e { Some(*e) } else { None };
    let found = memory.with(whitening, |work, dense| {
        if robust {
            fit_robust(config, samples, &mut weighted, work, dense).map(|r| (r.fit, r.wrong))
        } else {
            ml::fit(config, samples, work, dense).map(|fit| (fit, 0))
        }
    });
    let (fit, wrong) = match found {
        Ok(found) => found,
        Err(FitError::TooFew) => bail!("{} usable bearings; a track needs at least 5", samples.len()),
        Err(FitError::NoRange) => return no_range(),
        Err(FitError::BadSample(i)) => bail!("bearing {} is not usable", i + 1),
        Err(FitError::Whiten(WhitenError::Memory(_))) => bail!(
            "{} bearings at irregular times are too many for this model; use --model markov or thin them out",
            samples.len()
        ),
        Err(FitError::Whiten(WhitenError::Singular)) => {
            bail!(
                "the {} model is singular for these times; use --model linear or markov",
                config.model.name()
            )
        }
        Err(FitError::Whiten(WhitenError::Times)) => bail!("times are not usable"),
        Err(FitError::NoMinimum) => bail!("no straight track fits (all bearings at one time?)"),
    };
    // What is counted besides the bearings' errors widens the interval as it does the deviation.
    let by_range = [0.0, 0.0, -1.0, 1.0, 0.0];
    let relative = quadratic(&by_range, &fit.solution.covariance, &by_range);
    let counted = fit.change.map_or(0.0, |c| quadratic(&by_range, &c.added, &by_range));
    let widened = if relative > counted { relative / (relative - counted) } else { 1.0 };
    let quantile = CHI2_95 * fit.growth * widened;
    let range_95_m = ml::range_interval(config, &weighted, &fit, quantile, &mut memory.work, &memory.dense);
    Ok(Estimate {
        solution: fit.solution,
        range_95_m,
        nugget: fit.factorisation.nugget,
        growth: fit.growth,
        change: fit.change,
        wrong,
    })
}

/// The assumptions with as much of the errors lasting as the bearings tell: `config` where its errors are correlated already, or where the
/// bearings do not tell. Elevations, whose errors last as long, get the deviations that count it.
pub fn with_lasting(config: &Config, samples: &mut [Sample]) -> Config {
    // What cannot be fitted says so when it is.
    let told = lasting::estimate(config, samples, &mut BatchRoom::new().work).unwrap_or(*config);
    lasting::widen_elevations(&told, samples);
    told
}

/// The assumptions with the height at which the elevations hear the vessel, for the travel time alone: range and speed scale with each other
/// as before, and the elevations of `samples` are left out from here on. `config` where no track is found or no elevation is there.
pub fn at_height_heard(config: &Config, samples: &mut [Sample]) -> Config {
    let heard: Vec<(f64, f64)> = samples
        .iter()
        .filter(|s| s.elevation_rad.1.is_finite())
        .map(|s| (s.t_s, f64::from(s.elevation_rad.0)))
        .collect();
    for s in samples.iter_mut() {
        s.elevation_rad = (0.0, f32::INFINITY);
    }
    let mut room = BatchRoom::new();
    let mut told = *config;
    for _ in 0..HEIGHTS {
        let white = Config { model: Model::White, ..told };
        let Ok(fit) = ml::fit(&white, samples, &mut room.work, &mut []) else { return *config };
        let line = fit.solution.line;
        let mut heights: Vec<f64> = heard
            .iter()
            .map(|(t_s, elevation)| {
                let ([east, north], _) = line.position(*t_s);
                east.hypot(north) * elevation.tan()
            })
            .collect();
        heights.sort_by(f64::total_cmp);
        let Some(height_m) = heights.get(heights.len() / 2).filter(|h| **h > 0.0) else { return *config };
        told.medium.height_m = *height_m;
    }
    told
}

/// One bearing after the other by the recorder's passage fit, whose correlated errors are Gauss-Markov. `sd_rad`: standard
/// deviation of those errors; bearings beyond `gate_sd` standard deviations are refused. `robust`: with heavy tails.
///
/// # Errors
/// One line: why there is no track.
pub fn one_by_one(
    config: &Config,
    samples: &[Sample],
    sd_rad: f64,
    gate_sd: f64,
    robust: bool,
) -> Result<Estimate> {
    if config.speed_sd_m_s.is_infinite() && samples.iter().all(|s| s.elevation_rad.1.is_infinite()) {
        return no_range();
    }
    let assumed = passage::Config {
        speed_m_s: config.speed_m_s,
        speed_sd_m_s: config.speed_sd_m_s,
        range_m: config.range_m,
        extra_sd_rad: sd_rad,
        extra_tau_s: if config.model == Model::White { 0.0 } else { config.tau_s },
        medium: config.medium,
        elevation_bias_sd_rad: config.elevation_bias_sd_rad,
        tails: robust.then_some(STUDENT),
        lasting_sd_rad: 0.0,
        course_sd_rad: 0.0,
        height_sd_m: 0.0,
    };
    let white_share = if assumed.extra_tau_s > 0.0 { config.white_share } else { 0.0 };
    let mut lone = Lone::new(assumed, gate_sd);
    for s in samples {
        let (elevation, sd) = s.elevation_rad;
        let sd_azimuth_rad = f64::from(s.sd_rad);
        lone.take(&Measurement {
            extra_scale: (1.0 - white_share).sqrt() * sd_azimuth_rad / sd_rad,
            elevation: sd.is_finite().then_some((f64::from(elevation), f64::from(sd * sd))),
            ..Measurement::azimuth(s.t_s, s.azimuth_rad, white_share * sd_azimuth_rad * sd_azimuth_rad)
        });
    }
    let (solution, refused) = lone.finish();
    let Some(solution) = solution else {
        bail!("{} usable bearings; a track needs at least 6 at different times", samples.len() - refused)
    };
    // Heavy tails have the misfit in them.
    let mut memory = BatchRoom::new();
    let assumed =
        Config { model: if assumed.extra_tau_s > 0.0 { Model::Markov } else { Model::White }, ..*config };
    let grown = if robust {
        None
    } else {
        ml::with_misfit(&assumed, samples, &solution, refused, &mut memory.work, &mut memory.dense)
    };
    let (solution, growth, change) = grown.unwrap_or((solution, 1.0, None));
    let wrong = if robust { wrong(&solution.line, &config.medium, samples) } else { refused };
    Ok(Estimate { solution, range_95_m: None, nugget: 0.0, growth, change, wrong })
}

fn no_range<T>() -> Result<T> {
    bail!("speed unknown (--speed-sd inf) needs elevations: a column elevation_deg and --height-m")
}
