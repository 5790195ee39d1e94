//! `seabearing track`: motion of a vessel from bearings of one array.

use super::track_errors::error_model;
use super::track_lone::Lone;
use crate::csv::{Table, good_rows};
use crate::plot::{Figure, Scale, cut_at_wraps, write_panels};
use crate::record::finite;
use anyhow::{Result, bail};
use clap::ValueEnum;
use seabearing_core::angle::{RAD_PER_DEG, wrap_tau};
use seabearing_core::motion::{Medium, Solution, solution::position};
use seabearing_core::passage::{self, Measurement};
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{self, FitError, Interval, Sample};
use seabearing_locate::motion::robust::fit_robust;
use seabearing_locate::motion::whiten::{WhitenError, Workspace};
use serde_json::{Map, Value, json};
use std::path::PathBuf;

/// Positions on a regular grid a batch fit takes: over half an hour at two bearings a second.
pub(super) const POSITIONS: usize = 4001;
/// Largest lent memory for irregular times: 4000 bearings, 64 MB.
pub(super) const DENSE: usize = 4000 * 4001 / 2;

/// Arguments of `seabearing track`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing track bearings.csv --sigma-deg 2 --tau-s 50 --speed 7\n  \
    seabearing track bearings.csv --estimator recursive --json --plot track.svg\n  \
    seabearing track bearings.csv --robust --sigma-deg 2     # some bearings are wrong altogether\n  \
    seabearing track bearings.csv --known-track gps.csv      # the error model instead of a track\n\n\
    BEARINGS.csv: t_s,azimuth_deg and optionally sigma_deg, elevation_deg; rows may be missing or irregular. Without\n\
    --speed a vessel's speed is taken as 7.3 ± 2.3 m/s; --speed alone means that it is known. `side` is the vessel's\n\
    side on which the array lies; x0, y0 are East and North of the array at the first bearing's time.")]
pub struct Args {
    /// Bearings, CSV.
    bearings: PathBuf,
    /// Standard deviation of a bearing's error, degrees (a column sigma_deg goes before it).
    #[arg(long, default_value_t = 1.0)]
    sigma_deg: f64,
    /// Correlation interval of the errors, seconds; 0: uncorrelated.
    #[arg(long, default_value_t = 0.0)]
    tau_s: f64,
    /// Correlation of the errors (default: white if --tau-s is 0, else linear).
    #[arg(long, value_enum)]
    pub(super) model: Option<ErrorModel>,
    /// Speed of the vessel, m/s.
    #[arg(long)]
    speed: Option<f64>,
    /// Standard deviation of that speed, m/s; 0: known; `inf`: unknown, range from elevations.
    #[arg(long)]
    speed_sd: Option<f64>,
    /// All bearings at once, or one after the other as the recorder does (Gauss-Markov errors).
    #[arg(long, value_enum, default_value_t = Estimator::Ml)]
    estimator: Estimator,
    /// Heavy tails (Student-t): single wrong bearings hardly pull; --sigma-deg is that of the good ones.
    #[arg(long)]
    robust: bool,
    /// Speed of sound for the travel time, m/s; `inf` leaves it out.
    #[arg(long, default_value_t = 1484.0)]
    pub(super) sound_speed: f64,
    /// Nearest closest-point range considered, metres.
    #[arg(long, default_value_t = 5.0)]
    min_range_m: f64,
    /// Farthest closest-point range considered, metres.
    #[arg(long, default_value_t = 20_000.0)]
    max_range_m: f64,
    /// Height of the vessel above the array, metres: the column elevation_deg then takes part.
    #[arg(long)]
    height_m: Option<f64>,
    /// Standard deviation of an elevation's error, degrees.
    #[arg(long, default_value_t = 1.6)]
    sigma_elevation_deg: f64,
    /// Standard deviation of an error common to all elevations (multipath), degrees.
    #[arg(long, default_value_t = 0.0)]
    elevation_bias_deg: f64,
    /// Recursive estimator: refuse bearings beyond this many standard deviations (default: none).
    #[arg(long)]
    gate_sd: Option<f64>,
    /// Known track t_s,x_m,y_m: estimate the error model from it instead of a track.
    #[arg(long, value_name = "TRACK.csv")]
    known_track: Option<PathBuf>,
    /// Draw bearings and track into this SVG file.
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Result as a JSON line.
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ErrorModel {
    White,
    Linear,
    Sinc,
    Gaussian,
    Markov,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Estimator {
    Ml,
    Recursive,
}

impl Args {
    fn check(&self) -> Result<()> {
        let least = |name: &str, x: f64, least: f64, above: bool| -> Result<()> {
            if x.is_nan() || x < least || (above && x <= least) {
                bail!("--{name} is {x}, it must be {} {least}", if above { "above" } else { "at least" });
            }
            Ok(())
        };
        least("sigma-deg", self.sigma_deg, 0.0, true)?;
        least("tau-s", self.tau_s, 0.0, false)?;
        least("speed-sd", self.speed_sd.unwrap_or(0.0), 0.0, false)?;
        least("sound-speed", self.sound_speed, 100.0, false)?;
        least("min-range-m", self.min_range_m, 0.1, false)?;
        least("max-range-m", self.max_range_m, 1.5 * self.min_range_m, false)?;
        least("sigma-elevation-deg", self.sigma_elevation_deg, 0.0, true)?;
        least("elevation-bias-deg", self.elevation_bias_deg, 0.0, false)?;
        least("height-m", self.height_m.unwrap_or(1.0), 0.0, true)?;
        if self.robust && self.estimator == Estimator::Recursive {
            bail!("--robust is for --estimator ml; the recursive one has --gate-sd");
        }
        least("gate-sd", self.gate_sd.unwrap_or(1.0), 0.0, true)?;
        if let Some(v) = self.speed
            && !(0.2..=40.0).contains(&v)
        {
            bail!("--speed is {v} m/s, a vessel's speed is between 0.2 and 40");
        }
        for (name, x) in
            [("tau-s", self.tau_s), ("sigma-deg", self.sigma_deg), ("max-range-m", self.max_range_m)]
        {
            if !x.is_finite() {
                bail!("--{name} must be finite");
            }
        }
        Ok(())
    }

    /// Mean and standard deviation of speed: nothing said is the fleet of paper M, a speed alone is known.
    fn speed(&self) -> (f64, f64) {
        match (self.speed, self.speed_sd) {
            (Some(v), sd) => (v, sd.unwrap_or(0.0)),
            (None, sd) => (7.3, sd.unwrap_or(2.3)),
        }
    }

    pub(super) fn model(&self) -> Model {
        match self.model {
            Some(ErrorModel::White) => Model::White,
            Some(ErrorModel::Linear) => Model::Linear,
            Some(ErrorModel::Sinc) => Model::Sinc,
            Some(ErrorModel::Gaussian) => Model::Gaussian,
            Some(ErrorModel::Markov) => Model::Markov,
            None if self.tau_s > 0.0 => {
                if self.estimator == Estimator::Recursive {
                    Model::Markov
                } else {
                    Model::Linear
                }
            }
            None => Model::White,
        }
    }

    fn medium(&self) -> Medium {
        Medium { height_m: self.height_m.unwrap_or(0.0), ..Medium::of_sound_speed(self.sound_speed) }
    }
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    args.check()?;
    let samples = read(&args)?;
    if let Some(track) = &args.known_track {
        return error_model(&args, &samples, track);
    }
    let (solution, interval, nugget, refused) = match args.estimator {
        Estimator::Ml => batch(&args, &samples)?,
        Estimator::Recursive => one_by_one(&args, &samples)?,
    };
    if nugget > 0.0 {
        eprintln!(
            "seabearing: the {:?} model is nearly singular for these times; a white part of {:.0} % of the error's \
             standard deviation was added",
            args.model(),
            100.0 * nugget.sqrt()
        );
    }
    if let Some(path) = &args.plot {
        draw(&samples, &args, &solution, path)?;
    }
    if args.json {
        println!("{}", record(&args, &solution, interval, nugget, refused));
    } else {
        print_for_people(&args, &solution, interval, refused);
    }
    Ok(())
}

/// The bearings in order of time.
fn read(args: &Args) -> Result<Vec<Sample>> {
    let table = Table::read(&args.bearings)?;
    let name = args.bearings.display().to_string();
    let mut rows = Vec::new();
    let (sigma, elevation) = (table.has("sigma_deg"), table.has("elevation_deg") && args.height_m.is_some());
    let sigmas = if sigma { Some(table.numbers(["sigma_deg"])?) } else { None };
    let elevations = if elevation { Some(table.numbers(["elevation_deg"])?) } else { None };
    for (i, (line, row)) in table.numbers(["t_s", "azimuth_deg"])?.into_iter().enumerate() {
        let one = row.and_then(|[t_s, azimuth_deg]| {
            let sigma_deg = match sigmas.as_ref().and_then(|s| s.get(i)) {
                Some((_, Ok([s]))) if *s > 0.0 => *s,
                Some((_, Ok([s]))) => bail!("{name}, line {line}: `sigma_deg` is {s}, it must be above 0"),
                Some((_, Err(e))) => bail!("{e:#}"),
                None => args.sigma_deg,
            };
            // A row may do without an elevation.
            let elevation_rad = match elevations.as_ref().and_then(|e| e.get(i)) {
                Some((_, Ok([e]))) => {
                    ((e * RAD_PER_DEG) as f32, (args.sigma_elevation_deg * RAD_PER_DEG) as f32)
                }
                _ => (0.0, f32::INFINITY),
            };
            let mut sample =
                Sample::azimuth(t_s, wrap_tau(azimuth_deg * RAD_PER_DEG), sigma_deg * RAD_PER_DEG);
            sample.elevation_rad = elevation_rad;
            Ok(sample)
        });
        rows.push((line, one));
    }
    let mut samples = good_rows(&name, rows)?;
    if !samples.is_sorted_by(|a, b| a.t_s <= b.t_s) {
        eprintln!("seabearing: {name}: rows are not in order of time; sorted");
        samples.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    }
    Ok(samples)
}

type Answer = (Solution, Option<Interval>, f64, usize);

fn batch(args: &Args, samples: &[Sample]) -> Result<Answer> {
    let (speed_m_s, speed_sd_m_s) = args.speed();
    let config = ml::Config {
        model: args.model(),
        tau_s: args.tau_s,
        speed_m_s,
        speed_sd_m_s,
        range_m: (args.min_range_m, args.max_range_m),
        medium: args.medium(),
        elevation_bias_sd_rad: args.elevation_bias_deg * RAD_PER_DEG,
    };
    let mut work = Box::new(Workspace::<POSITIONS>::new());
    let mut dense = Vec::new();
    // Robust: the samples with the errors that make the Gaussian likelihood pull as the heavy-tailed one.
    let mut weighted = samples.to_vec();
    let mut attempt = |dense: &mut [f64]| {
        if args.robust {
            fit_robust(&config, samples, &mut weighted, &mut work, dense).map(|r| (r.fit, r.wrong))
        } else {
            ml::fit(&config, samples, &mut work, dense).map(|fit| (fit, 0))
        }
    };
    let mut found = attempt(&mut dense);
    if let Err(FitError::Whiten(WhitenError::Memory(needed))) = found
        && needed <= DENSE
    {
        dense.resize(needed, 0.0);
        found = attempt(&mut dense);
    }
    let name = args.bearings.display();
    let (fit, wrong) = match found {
        Ok(found) => found,
        Err(FitError::TooFew) => bail!("{name}: {} usable bearings; a track needs at least 5", samples.len()),
        Err(FitError::NoRange) => {
            bail!("speed unknown (--speed-sd inf) needs elevations: a column elevation_deg and --height-m")
        }
        Err(FitError::BadSample(i)) => bail!("{name}: bearing {} is not usable", i + 1),
        Err(FitError::Whiten(WhitenError::Memory(_))) => bail!(
            "{name}: {} bearings at irregular times are too many for this model; use --model markov or thin them out",
            samples.len()
        ),
        Err(FitError::Whiten(WhitenError::Singular)) => {
            bail!("the {:?} model is singular for these times; use --model linear or markov", args.model())
        }
        Err(FitError::Whiten(WhitenError::Times)) => bail!("{name}: times are not usable"),
        Err(FitError::NoMinimum) => bail!("{name}: no straight track fits (all bearings at one time?)"),
    };
    let interval = ml::range_interval(&config, &weighted, &fit, 3.841, &mut work, &dense);
    Ok((fit.solution, interval, fit.plan.nugget, wrong))
}

fn one_by_one(args: &Args, samples: &[Sample]) -> Result<Answer> {
    let model = args.model();
    if !matches!(model, Model::White | Model::Markov) {
        eprintln!(
            "seabearing: the recursive estimator takes correlated errors as Gauss-Markov (--model markov)"
        );
    }
    let (speed_m_s, speed_sd_m_s) = args.speed();
    if speed_sd_m_s.is_infinite() && samples.iter().all(|s| s.elevation_rad.1.is_infinite()) {
        bail!("speed unknown (--speed-sd inf) needs elevations: a column elevation_deg and --height-m");
    }
    let sd_rad = args.sigma_deg * RAD_PER_DEG;
    let config = passage::Config {
        speed_m_s,
        speed_sd_m_s,
        range_m: (args.min_range_m, args.max_range_m),
        extra_sd_rad: sd_rad,
        extra_tau_s: if model == Model::White { 0.0 } else { args.tau_s },
        medium: args.medium(),
        elevation_bias_sd_rad: args.elevation_bias_deg * RAD_PER_DEG,
    };
    let mut lone = Lone::new(config, args.gate_sd.unwrap_or(f64::INFINITY));
    for s in samples {
        let (elevation, sd) = s.elevation_rad;
        lone.take(&Measurement {
            extra_scale: f64::from(s.sd_rad) / sd_rad,
            elevation: sd.is_finite().then_some((f64::from(elevation), f64::from(sd * sd))),
            ..Measurement::azimuth(s.t_s, s.azimuth_rad, 0.0)
        });
    }
    let (solution, refused) = lone.finish();
    match solution {
        Some(solution) => Ok((solution, None, 0.0, refused)),
        None => bail!(
            "{}: {} usable bearings; a track needs at least 6 at different times",
            args.bearings.display(),
            samples.len() - refused
        ),
    }
}

/// The record; what the data do not tell is null.
fn record(args: &Args, s: &Solution, interval: Option<Interval>, nugget: f64, refused: usize) -> Value {
    let ranged = |x: f64| if s.range_observable { finite(x) } else { Value::Null };
    let mut out = Map::new();
    let mut put = |key: &str, value: Value| {
        out.insert(key.to_owned(), value);
    };
    put("type", "track".into());
    put("cpa_time_s", finite(s.cpa_time_s));
    put("cpa_range_m", ranged(s.cpa_range_m));
    put("heading_deg", finite(s.heading_rad.to_degrees()));
    put("speed_m_s", finite(s.speed_m_s));
    put("side", if s.starboard { "starboard" } else { "port" }.into());
    put("sd_cpa_time_s", finite(s.sd_cpa_time_s));
    put("sd_cpa_range_m", finite(s.sd_cpa_range_m));
    put("sd_heading_deg", finite(s.sd_heading_rad.to_degrees()));
    put("range_observable", s.range_observable.into());
    put("x0_m", ranged(s.position0_m[0]));
    put("y0_m", ranged(s.position0_m[1]));
    put("n", s.n.into());
    put("cpa_azimuth_deg", finite(s.cpa_azimuth_rad.to_degrees()));
    put("sd_speed_m_s", finite(s.sd_speed_m_s));
    for (key, x) in ["var_x0_m2", "var_y0_m2", "cov_x0_y0_m2"].into_iter().zip(s.covariance0_m2) {
        put(key, ranged(x));
    }
    put("consistency", finite(s.consistency));
    put("estimator", if args.estimator == Estimator::Ml { "ml" } else { "recursive" }.into());
    put("model", format!("{:?}", args.model()).to_lowercase().into());
    if let Some(i) = interval {
        let end = |x: f64, open: bool| if open { Value::Null } else { finite(x) };
        put("range_interval_95_m", json!([end(i.low_m, i.low_open), end(i.high_m, i.high_open)]));
    }
    if nugget > 0.0 {
        put("regularised", finite(nugget));
    }
    if refused > 0 || args.robust {
        put(if args.robust { "wrong" } else { "refused" }, refused.into());
    }
    Value::Object(out)
}

fn print_for_people(args: &Args, s: &Solution, interval: Option<Interval>, refused: usize) {
    let side = if s.starboard { "starboard" } else { "port" };
    let spread = |x: f64, unit: &str| {
        if x.is_finite() { format!("± {x:.3}{unit}") } else { "(not observable)".into() }
    };
    println!(
        "bearings             {} used{}",
        s.n,
        match (refused, args.robust) {
            (0, _) => String::new(),
            (n, true) => format!(", {n} of them far from the track"),
            (n, false) => format!(", {n} refused"),
        }
    );
    println!("closest approach at  {:.2} s {}", s.cpa_time_s, spread(s.sd_cpa_time_s, " s"));
    if s.range_observable {
        println!("               range {:.1} m {}", s.cpa_range_m, spread(s.sd_cpa_range_m, " m"));
    } else {
        println!("               range not observable from these bearings");
    }
    if let Some(i) = interval {
        let low = if i.low_open { format!("below {}", args.min_range_m) } else { format!("{:.1}", i.low_m) };
        let high = if i.high_open { "no upper end".into() } else { format!("{:.1} m", i.high_m) };
        println!("       95 % interval {low} to {high}");
    }
    println!("             azimuth {:.2}°", s.cpa_azimuth_rad.to_degrees());
    println!(
        "heading              {:.2}° {}",
        s.heading_rad.to_degrees(),
        spread(s.sd_heading_rad.to_degrees(), "°")
    );
    println!(
        "speed                {:.2} m/s {}",
        s.speed_m_s,
        if s.sd_speed_m_s > 0.0 { spread(s.sd_speed_m_s, " m/s") } else { "(given)".into() }
    );
    println!("array lies to        {side}");
    if s.range_observable {
        println!(
            "at first bearing     {:.1} m East, {:.1} m North ({:.2} s)",
            s.position0_m[0], s.position0_m[1], s.t0_s
        );
    }
    println!("consistency          {:.2} (1: errors and straight track as assumed)", s.consistency);
}

/// Bearings with the fit above, the track with its 95 % ellipses below.
fn draw(samples: &[Sample], args: &Args, s: &Solution, path: &std::path::Path) -> Result<()> {
    let medium = args.medium();
    let mut angles = Figure::new("Bearings and fitted track", "time (s)", "azimuth (°)");
    let measured: Vec<_> = samples.iter().map(|b| (b.t_s, b.azimuth_rad.to_degrees())).collect();
    let times: Vec<f64> = (0..=300).map(|k| s.t0_s + (s.t1_s - s.t0_s) * f64::from(k) / 300.0).collect();
    let fitted: Vec<_> =
        times.iter().map(|t| (*t, wrap_tau(s.line.azimuth(&medium, *t)).to_degrees())).collect();
    angles.y_scale(Scale::Degrees).points("measured", &measured).line("fit", &cut_at_wraps(&fitted));
    if !s.range_observable {
        return angles.write(path);
    }
    let mut map = Figure::map("Track about the array");
    let at = |t: f64| position(&s.line, &s.covariance, t);
    let track: Vec<_> = times.iter().map(|t| at(*t).0).map(|[x, y]| (x, y)).collect();
    map.line("track", &track);
    for (i, t) in [s.t0_s, s.cpa_time_s, s.t1_s].into_iter().enumerate() {
        let ([x, y], [xx, yy, xy]) = at(t);
        map.ellipse(if i == 0 { "95 % of position" } else { "" }, (x, y), (xx, yy, xy), 0.95);
        if i > 0 {
            map.same_colour();
        }
    }
    write_panels(path, &[&angles, &map], 1)
}
