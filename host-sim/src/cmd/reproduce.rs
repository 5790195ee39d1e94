//! `seabearing reproduce`: the papers' figures and tables and the project's own figures, by Monte Carlo, each beside its
//! bar. A missed bar is exit status 3.

use super::{Missed, mistake};
use crate::beside::Beside;
use crate::progress;
use crate::reproduce::figure::{self, Figures};
use crate::reproduce::{DRAWN, EXPERIMENTS, Experiment, Options};
use anyhow::{Context, Result, bail};
use std::io::Read;
use std::path::PathBuf;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Arguments of `seabearing reproduce`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing reproduce obs-appendix-b --out out/reproduce\n\n\
    Exit status 3: a figure misses its bar. Data that are absent are named on standard error.")]
pub struct Args {
    /// Which experiment, or `all`; without a name the list is printed.
    name: Option<String>,
    /// Folder for CSV and plots.
    #[arg(long, default_value = "out/reproduce")]
    out: PathBuf,
    /// Also draw what was recorded into this folder, truth beside tracks: pages of azimuth and range against UTC, and what is known of each
    /// ship (obs-week, obs-week-5db, obs-week-10db)
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
    /// Folder of the real recordings and ship positions that some experiments need.
    #[arg(long, default_value = "../shared/data")]
    data: PathBuf,
    /// Monte Carlo runs instead of the experiment's own number.
    #[arg(long)]
    runs: Option<std::num::NonZeroUsize>,
    /// Seed of the random numbers.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Results as JSON Lines.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// An unknown name, what the experiment says, or [`Missed`].
pub fn run(args: Args) -> Result<()> {
    let Some(name) = args.name.clone() else {
        for e in EXPERIMENTS {
            println!("{:24} {}", e.name, e.about);
        }
        return Ok(());
    };
    let chosen = EXPERIMENTS.iter().find(|e| e.name == name);
    if chosen.is_none() && name != "all" {
        bail!(
            "no experiment `{name}`: `seabearing reproduce` without a name lists them, `all` runs them all"
        );
    }
    if args.plots.is_some() && chosen.is_none_or(|e| !DRAWN.contains(&e.name)) {
        mistake!("--plots: `{name}` has no recording to draw; {} have", DRAWN.join(", "));
    }
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make folder {}", args.out.display()))?;
    chosen.map_or_else(|| all(&args), |e| one(&args, e))
}

/// Runs one experiment and prints its figures.
fn one(args: &Args, e: &Experiment) -> Result<()> {
    if !args.json {
        println!("== {}: {} (seed {})", e.name, e.about, args.seed);
    }
    let options = Options {
        out: args.out.clone(),
        runs: args.runs.map(Into::into),
        seed: args.seed,
        json: args.json,
        plots: args.plots.clone(),
        data: args.data.clone(),
        figures: Figures::new(e.name),
    };
    (e.run)(&options).with_context(|| e.name.to_owned())?;
    let figures = options.figures.into_reported();
    if args.json {
        figures.iter().for_each(|f| println!("{}", f.json()));
    } else {
        seabearing_host::print!("{}", figure::text(&figures));
    }
    let missed: Vec<&str> =
        figures.iter().filter(|f| f.met() == Some(false)).map(|f| f.name.as_str()).collect();
    if missed.is_empty() { Ok(()) } else { Err(Missed(format!("{}: {}", e.name, missed.join("; "))).into()) }
}

/// Experiments at once: some run on one core only, which would leave the others idle.
const LANES: usize = 2;

/// Runs every experiment as a process of its own, [`LANES`] at a time with the cores divided among them; each one's
/// table and figures are printed when it is finished.
fn all(args: &Args) -> Result<()> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let lanes = cores.min(LANES);
    let bar = progress::bar(EXPERIMENTS.len() as u64, "experiments");
    let (next, complaints) = (AtomicUsize::new(0), Mutex::new((Vec::new(), Vec::new())));
    let work = || {
        while let Some(e) = EXPERIMENTS.get(next.fetch_add(1, Ordering::Relaxed)) {
            let ran = apart(args, e, cores / lanes);
            let mut complaints = complaints.lock().unwrap_or_else(PoisonError::into_inner);
            match ran {
                Ok(ran) => {
                    let mut remarks: Vec<&str> = ran.remarks.lines().collect();
                    let last = if ran.status.success() { None } else { remarks.pop() };
                    let last = last.map(|l| l.trim_start_matches("seabearing: ").to_owned());
                    match (ran.status.code(), last) {
                        (Some(0), _) => {}
                        (Some(Missed::STATUS), Some(last)) => {
                            complaints.1.push(last.trim_start_matches(Missed::WORDS).to_owned());
                        }
                        (_, last) => {
                            complaints.0.push(last.unwrap_or_else(|| format!("{}: {}", e.name, ran.status)));
                        }
                    }
                    bar.suspend(|| {
                        remarks.iter().for_each(|r| eprintln!("{r}"));
                        seabearing_host::print!("{}", ran.said);
                    });
                }
                Err(error) => complaints.0.push(format!("{error:#}")),
            }
            bar.inc(1);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..lanes {
            scope.spawn(work);
        }
    });
    bar.finish_and_clear();
    match complaints.into_inner().unwrap_or_else(PoisonError::into_inner) {
        (failed, _) if !failed.is_empty() => bail!("{}", failed.join("; ")),
        (_, missed) if !missed.is_empty() => Err(Missed(missed.join("; ")).into()),
        _ => Ok(()),
    }
}

/// What came of one experiment in a process of its own.
struct Ran {
    status: ExitStatus,
    said: String,
    remarks: String,
}

/// One experiment in a process of its own, which an interruption of this one ends too.
fn apart(args: &Args, experiment: &Experiment, threads: usize) -> Result<Ran> {
    let mut command = Command::new(std::env::current_exe().context("the command's own file")?);
    command.args(["reproduce", experiment.name, "--seed", &args.seed.to_string(), "--out"]).arg(&args.out);
    command.arg("--data").arg(&args.data);
    if let Some(runs) = args.runs {
        command.args(["--runs", &runs.to_string()]);
    }
    if args.json {
        command.arg("--json");
    }
    command.env("RAYON_NUM_THREADS", threads.to_string());
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child = Beside::start(&mut command).with_context(|| format!("cannot start {}", experiment.name))?;
    let (out, err) = (child.stdout(), child.stderr());
    let remarks = std::thread::spawn(move || text(err));
    let said = text(out)?;
    let remarks = remarks.join().ok().context("the reader of standard error")??;
    let status = child.wait()?;
    Ok(Ran { status, said, remarks })
}

/// All that comes from a pipe.
fn text(pipe: Option<impl Read>) -> std::io::Result<String> {
    let mut bytes = Vec::new();
    pipe.map_or(Ok(0), |mut p| p.read_to_end(&mut bytes))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
