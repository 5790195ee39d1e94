//! `seabearing track`: motion of a vessel from bearings of one array.

use super::mistake;
use crate::motion::estimate::{Estimate as Found, at_height_heard, batch, one_by_one, with_lasting};
use crate::motion::radians::are_radians;
use crate::motion::{bearings, errors, picture};
use crate::record::finite;
use anyhow::{Context, Result};
use clap::ValueEnum;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_core::motion::{Medium, Solution};
use seabearing_locate::motion::change::{Change, Pattern};
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::errors::ErrorModel;
use seabearing_locate::motion::ml::{Config, Sample};
use serde_json::{Map, Value, json};
use std::path::PathBuf;

/// Arguments of `seabearing track`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing track bearings.csv --sigma-deg 2 --tau-s 50 --speed 7\n  \
    seabearing track bearings.csv --estimator recursive --json --plot track.svg\n  \
    seabearing track bearings.csv --robust --sigma-deg 2     # some bearings are wrong altogether\n  \
    seabearing track bearings.csv --known-track gps.csv      # the error model instead of a track\n\n\
    BEARINGS.csv: t_s,azimuth_deg and optionally sigma_deg, elevation_deg; rows may be missing or irregular; or records\n\
    of `seabearing process`, of which the strongest source's bearings are taken with the errors they state. Without\n\
    --speed a vessel's speed is taken as 7.3 ± 2.3 m/s; --speed alone means that it is known. `side` is the vessel's\n\
    side on which the array lies; x0, y0 are East and North of the array at the first bearing's time.")]
pub struct Args {
    /// Bearings: CSV, or records of `seabearing process`.
    #[arg(value_parser = super::input())]
    bearings: PathBuf,
    /// Standard deviation of a bearing's error, degrees (a column sigma_deg goes before it).
    #[arg(long, default_value_t = 1.0)]
    sigma_deg: f64,
    /// Correlation interval of the errors, seconds; 0: uncorrelated [default: 0; of records told from their own bearings].
    #[arg(long)]
    tau_s: Option<f64>,
    /// Correlation of the errors (default: white if --tau-s is 0, else linear).
    #[arg(long, value_parser = model())]
    model: Option<Model>,
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
    sound_speed: f64,
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
    /// Standard deviation of an acceleration along the course, m/s², that bearings cannot tell and every deviation is to count; nothing said:
    /// constant speed is assumed.
    #[arg(long, value_name = "M_S2", default_value_t = 0.0)]
    acceleration_sd: f64,
    /// Recursive estimator: refuse bearings beyond this many standard deviations (default: none).
    #[arg(long)]
    gate_sd: Option<f64>,
    /// Known track t_s,x_m,y_m: estimate the error model from it instead of a track.
    #[arg(long, value_name = "TRACK.csv", value_parser = super::input())]
    known_track: Option<PathBuf>,
    /// Draw bearings and track into this SVG file.
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Result as a JSON line.
    #[arg(long)]
    json: bool,
}

/// The error models by their names.
fn model() -> impl TypedValueParser<Value = Model> {
    let named = |name: String| Model::NAMED.iter().find(|(n, _)| *n == name).map(|(_, model)| *model);
    PossibleValuesParser::new(Model::NAMED.map(|(name, _)| name))
        .map(move |name| named(name).unwrap_or(Model::White))
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
                mistake!("--{name} is {x}, it must be {} {least}", if above { "above" } else { "at least" });
            }
            Ok(())
        };
        least("sigma-deg", self.sigma_deg, 0.0, true)?;
        least("tau-s", self.tau_s(), 0.0, false)?;
        least("speed-sd", self.speed_sd.unwrap_or(0.0), 0.0, false)?;
        least("sound-speed", self.sound_speed, 100.0, false)?;
        least("min-range-m", self.min_range_m, 0.1, false)?;
        least("max-range-m", self.max_range_m, 1.5 * self.min_range_m, false)?;
        least("sigma-elevation-deg", self.sigma_elevation_deg, 0.0, true)?;
        least("elevation-bias-deg", self.elevation_bias_deg, 0.0, false)?;
        least("acceleration-sd", self.acceleration_sd, 0.0, false)?;
        least("height-m", self.height_m.unwrap_or(1.0), 0.0, true)?;
        if self.robust && self.estimator == Estimator::Ml && self.tau_s() > 0.0 {
            mistake!(
                "--robust takes errors as independent; with --tau-s give --estimator recursive beside it"
            );
        }
        least("gate-sd", self.gate_sd.unwrap_or(1.0), 0.0, true)?;
        if let Some(v) = self.speed
            && !(0.2..=40.0).contains(&v)
        {
            mistake!("--speed is {v} m/s, a vessel's speed is between 0.2 and 40");
        }
        for (name, x) in [
            ("tau-s", self.tau_s()),
            ("sigma-deg", self.sigma_deg),
            ("max-range-m", self.max_range_m),
            ("height-m", self.height_m.unwrap_or(1.0)),
            ("sigma-elevation-deg", self.sigma_elevation_deg),
            ("elevation-bias-deg", self.elevation_bias_deg),
            ("acceleration-sd", self.acceleration_sd),
        ] {
            if !x.is_finite() {
                mistake!("--{name} must be finite");
            }
        }
        Ok(())
    }

    fn tau_s(&self) -> f64 {
        self.tau_s.unwrap_or(0.0)
    }

    /// Whether nobody says how the errors are correlated, and the file's deviations count what lasts of them.
    fn tells_lasting(&self) -> bool {
        self.tau_s.is_none() && self.model.is_none() && !self.robust && bearings::are_recorded(&self.bearings)
    }

    /// Mean and standard deviation of speed: nothing said is the fleet of paper M, a speed alone is known.
    fn speed(&self) -> (f64, f64) {
        match (self.speed, self.speed_sd) {
            (Some(v), sd) => (v, sd.unwrap_or(0.0)),
            (None, sd) => (7.3, sd.unwrap_or(2.3)),
        }
    }

    fn model(&self) -> Model {
        self.model.unwrap_or(match self.estimator {
            _ if self.tau_s() == 0.0 => Model::White,
            Estimator::Recursive => Model::Markov,
            Estimator::Ml => Model::Linear,
        })
    }

    /// What both estimators assume.
    fn assumed(&self) -> Config {
        let (speed_m_s, speed_sd_m_s) = self.speed();
        let medium =
            Medium { height_m: self.height_m.unwrap_or(0.0), ..Medium::of_sound_speed(self.sound_speed) };
        Config {
            model: self.model(),
            tau_s: self.tau_s(),
            white_share: 0.0,
            speed_m_s,
            speed_sd_m_s,
            range_m: (self.min_range_m, self.max_range_m),
            medium,
            elevation_bias_sd_rad: self.elevation_bias_deg * RAD_PER_DEG,
            acceleration_sd_m_s2: self.acceleration_sd,
        }
    }
}

/// Acceleration of a usual vessel under way, m/s²: half of 53 straight legs of 200 s in the Solent (AIS, 13 vessels) had 0.0007 or less, two
/// thirds 0.0013 or less, one in ten 0.005 or more.
const USUAL_M_S2: f64 = 0.001;

/// What an acceleration of [`USUAL_M_S2`] that the fit does not know of does to its outcome.
struct Moved {
    heading_deg: f64,
    cpa_time_s: f64,
    cpa_range_m: f64,
}

impl Moved {
    fn of(solution: &Solution, change: &Change) -> Self {
        let [azimuth, time, ln_rate, ln_speed, _] = change.by_acceleration.map(|x| USUAL_M_S2 * x);
        Self {
            heading_deg: azimuth.to_degrees(),
            cpa_time_s: time,
            cpa_range_m: solution.cpa_range_m * (ln_speed - ln_rate),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    args.check()?;
    let sd_rad = args.sigma_deg * RAD_PER_DEG;
    let recorded = bearings::are_recorded(&args.bearings);
    let sd_elevation_rad =
        (args.height_m.is_some() || recorded).then_some(args.sigma_elevation_deg * RAD_PER_DEG);
    let mut samples = bearings::read(&args.bearings, sd_rad, sd_elevation_rad)?;
    if let Some(track) = &args.known_track {
        let model = args.model.unwrap_or(Model::Markov);
        let (found, n) = errors::of_known_track(model, &samples, track, args.sound_speed)?;
        print_error_model(&args, model, &found, n);
        return Ok(());
    }
    let assumed = args.assumed();
    if are_radians(&assumed, &samples) {
        log::warn!(
            "{}: azimuths between -π and 2π that turn as those of a pass do in radians and of none in degrees: are they radians? \
             `azimuth_deg` is degrees",
            args.bearings.display()
        );
    }
    let assumed =
        if recorded && args.height_m.is_none() { at_height_heard(&assumed, &mut samples) } else { assumed };
    let assumed = if args.tells_lasting() { with_lasting(&assumed, &mut samples) } else { assumed };
    let found = match args.estimator {
        Estimator::Ml => batch(&assumed, &samples, args.robust),
        Estimator::Recursive => {
            if !matches!(assumed.model, Model::White | Model::Markov) {
                log::warn!(
                    "the recursive estimator takes correlated errors as Gauss-Markov (--model markov)"
                );
            }
            one_by_one(&assumed, &samples, sd_rad, args.gate_sd.unwrap_or(f64::INFINITY), args.robust)
        }
    };
    let found = found.with_context(|| args.bearings.display().to_string())?;
    if found.nugget > 0.0 {
        log::warn!(
            "the {} model is nearly singular for these times; a white part of {:.0} % of the error's \
             standard deviation was added",
            assumed.model.name(),
            100.0 * found.nugget.sqrt()
        );
    }
    let growth = found.growth;
    let contradicted = contradicted_speed(&assumed, &samples, &found, args.robust);
    if let Some((speed_m_s, sd_m_s)) = contradicted {
        log::warn!(
            "{}: the elevations contradict a speed of {} m/s: without it (--speed-sd inf) they tell {speed_m_s:.2} ± {sd_m_s:.2} m/s; \
             range and speed are drawn to the speed given, and their standard deviations do not hold",
            args.bearings.display(),
            assumed.speed_m_s
        );
    } else if let Some((pattern, change)) = found.change.and_then(|c| c.seen.zip(Some(c))) {
        let what = match pattern {
            Pattern::Turn => {
                format!("the vessel turned, by {:.3}° a second", change.turn_rad_s.0.to_degrees())
            }
            Pattern::Acceleration => "the vessel changed its speed".into(),
        };
        log::warn!(
            "{}: the bearings contradict a straight track at constant speed: their residuals are those of one at which {what}; every \
             standard deviation counts that, and the heading is the one at the closest approach; split the record where the vessel turns",
            args.bearings.display()
        );
    } else if growth > 1.0 {
        log::warn!(
            "{}: the bearings contradict a straight track at constant speed with such errors (consistency {:.1}): \
             every standard deviation is {:.1} times what they would give; split the record where the vessel turns, or \
             state --sigma-deg and --tau-s as they are",
            args.bearings.display(),
            found.solution.consistency,
            growth.sqrt()
        );
    }
    if let Some(path) = &args.plot {
        picture::draw(&samples, &assumed.medium, &found.solution, bearings::start(&args.bearings), path)?;
    }
    if args.json {
        println!("{}", record(&args, &assumed, &found, contradicted.is_none()));
    } else {
        print_for_people(&args, &assumed, &found);
    }
    Ok(())
}

/// Share of the misfit that is left where the speed is left free, below which it is the speed that the elevations contradict. Where there is no
/// misfit, as of a speed with a deviation, or elevations that may all be off, it is by the two speeds alone.
const LEFT_OF_MISFIT: f64 = 0.5;
/// By how many standard deviations the two speeds differ then, at least.
const SPEEDS_APART_SD: f64 = 4.0;

/// The speed that the elevations tell (m/s, with its standard deviation) where they contradict the one assumed.
fn contradicted_speed(
    assumed: &Config,
    samples: &[Sample],
    found: &Found,
    robust: bool,
) -> Option<(f64, f64)> {
    let elevations = samples.iter().any(|s| s.elevation_rad.1.is_finite());
    if !elevations || !assumed.speed_sd_m_s.is_finite() {
        return None;
    }
    let free = Config { speed_sd_m_s: f64::INFINITY, ..*assumed };
    let free = batch(&free, samples, robust).ok()?;
    let (speed_m_s, sd_m_s) = (free.solution.speed_m_s, free.solution.sd_speed_m_s);
    let explained =
        found.growth <= 1.0 || free.solution.consistency < LEFT_OF_MISFIT * found.solution.consistency;
    let apart = (speed_m_s - assumed.speed_m_s).abs();
    (explained && apart > SPEEDS_APART_SD * sd_m_s.hypot(assumed.speed_sd_m_s)).then_some((speed_m_s, sd_m_s))
}

/// Share of the errors' variance that lasts.
fn lasting_share(assumed: &Config) -> f64 {
    if assumed.model == Model::White { 0.0 } else { 1.0 - assumed.white_share }
}

fn print_error_model(args: &Args, model: Model, e: &ErrorModel, n: usize) {
    let (sd, offset) = (e.sd_rad.to_degrees(), e.offset_rad.0.to_degrees());
    let (sd_sd, sd_offset) = (sd * e.sd_relative, e.offset_rad.1.to_degrees());
    let sd_tau_s = e.tau_s * e.sd_ln_tau;
    if args.json {
        println!(
            "{}",
            json!({
                "type": "error_model", "model": model.name(), "sigma_deg": sd, "sd_sigma_deg": sd_sd,
                "tau_s": e.tau_s, "sd_tau_s": finite(sd_tau_s), "offset_deg": offset, "sd_offset_deg": sd_offset,
                "shift_s": e.shift_s.0, "sd_shift_s": finite(e.shift_s.1),
                "log_likelihood": e.ln_likelihood, "n": n,
            })
        );
    } else {
        println!("error model          {}, {n} bearings", model.name());
        println!("standard deviation   {sd:.3}° ± {sd_sd:.3}°");
        if sd_tau_s.is_finite() {
            println!("correlation interval {:.2} s ± {sd_tau_s:.2} s", e.tau_s);
        } else {
            println!(
                "correlation interval not told by this track ({:.2} s, where its search ends, is used)",
                e.tau_s
            );
        }
        println!("offset               {offset:.3}° ± {sd_offset:.3}°");
        println!("shift                {:.2} s ± {:.2} s", e.shift_s.0, e.shift_s.1);
        println!("log likelihood       {:.2}", e.ln_likelihood);
    }
}

/// The record, of a speed that nothing contradicts (`as_declared`) or one that the elevations do; what the data do not tell is null.
fn record(args: &Args, assumed: &Config, found: &Found, as_declared: bool) -> Value {
    let s = &found.solution;
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
    let seen = found.change.and_then(|c| c.seen);
    put("consistent", (found.growth <= 1.0 && seen.is_none() && as_declared).into());
    put("change", seen.map(Pattern::name).into());
    put("acceleration_sd_m_s2", finite(args.acceleration_sd));
    if let Some(moved) = found.change.map(|c| Moved::of(s, &c)) {
        let (heading_deg, cpa_time_s, cpa_range_m) = (moved.heading_deg, moved.cpa_time_s, moved.cpa_range_m);
        put(
            "an_acceleration_moves",
            json!({
                "acceleration_m_s2": USUAL_M_S2, "heading_deg": finite(heading_deg),
                "cpa_time_s": finite(cpa_time_s), "cpa_range_m": ranged(cpa_range_m),
            }),
        );
    }
    put("estimator", if args.estimator == Estimator::Ml { "ml" } else { "recursive" }.into());
    put("model", assumed.model.name().into());
    if args.tells_lasting() {
        put("lasting_share", lasting_share(assumed).into());
        put("lasting_s", if assumed.tau_s > 0.0 { finite(assumed.tau_s) } else { Value::Null });
    }
    if let Some(i) = found.range_95_m {
        let end = |x: f64, open: bool| if open { Value::Null } else { finite(x) };
        put("range_interval_95_m", json!([end(i.low_m, i.low_open), end(i.high_m, i.high_open)]));
    }
    if found.nugget > 0.0 {
        put("regularised", finite(found.nugget));
    }
    if found.wrong > 0 || args.robust {
        put(if args.robust { "wrong" } else { "refused" }, found.wrong.into());
    }
    Value::Object(out)
}

fn print_for_people(args: &Args, assumed: &Config, found: &Found) {
    let s = &found.solution;
    let side = if s.starboard { "starboard" } else { "port" };
    let spread = |x: f64, unit: &str| {
        if x.is_finite() { format!("± {x:.3}{unit}") } else { "(not observable)".into() }
    };
    println!(
        "bearings             {} used{}",
        s.n,
        match (found.wrong, args.robust) {
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
    if let Some(i) = found.range_95_m {
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
    if let Some(moved) = found.change.filter(|_| args.acceleration_sd == 0.0).map(|c| Moved::of(s, &c)) {
        println!(
            "speed                assumed constant: {USUAL_M_S2} m/s² would move the heading by {:.2}°, the time by {:.2} s (--acceleration-sd)",
            moved.heading_deg.abs(),
            moved.cpa_time_s.abs()
        );
    }
    if args.tells_lasting() {
        match lasting_share(assumed) {
            0.0 => println!("errors               independent, as far as these bearings tell"),
            share => println!(
                "errors               {:.0} % of their variance lasts {:.1} s, as these bearings tell (--tau-s)",
                100.0 * share,
                assumed.tau_s
            ),
        }
    }
    println!("consistency          {:.2} (1: errors and straight track as assumed)", s.consistency);
}
