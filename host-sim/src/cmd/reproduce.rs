//! `seabearing reproduce`: the papers' figures and tables and the project's own figures, by Monte Carlo.

use crate::progress;
use crate::reproduce::{EXPERIMENTS, Experiment, Options};
use anyhow::{Context, Result, bail};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Arguments of `seabearing reproduce`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing reproduce bearing-limit --out out/reproduce")]
pub struct Args {
    /// Which experiment, or `all`; without a name the list is printed.
    name: Option<String>,
    /// Folder for CSV and plots.
    #[arg(long, default_value = "out/reproduce")]
    out: PathBuf,
    /// Monte Carlo runs instead of the experiment's own number.
    #[arg(long)]
    runs: Option<usize>,
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
/// An unknown name, or what the experiment says.
pub fn run(args: Args) -> Result<()> {
    let Some(name) = args.name.clone() else {
        for e in EXPERIMENTS {
            println!("{:24} {}", e.name, e.about);
        }
        return Ok(());
    };
    let chosen = EXPERIMENTS.iter().find(|e| e.name == name);
    if chosen.is_none() && name != "all" {
        let names: Vec<_> = EXPERIMENTS.iter().map(|e| e.name).collect();
        bail!("no experiment `{name}`; there are: all, {}", names.join(", "));
    }
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make folder {}", args.out.display()))?;
    let Some(e) = chosen else { return all(&args) };
    let options = Options { out: args.out, runs: args.runs, seed: args.seed, json: args.json };
    if !options.json {
        println!("== {}: {} (seed {})", e.name, e.about, options.seed);
    }
    (e.run)(&options).with_context(|| e.name.to_owned())
}

/// Experiments at once: some run on one core only, which would leave the others idle.
const LANES: usize = 2;

/// Runs every experiment as a process of its own, [`LANES`] at a time with the cores divided among them; each one's
/// table is printed when it is finished.
fn all(args: &Args) -> Result<()> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let lanes = cores.min(LANES);
    let bar = progress::bar(EXPERIMENTS.len() as u64, "experiments");
    let (next, failures) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let work = || {
        while let Some(e) = EXPERIMENTS.get(next.fetch_add(1, Ordering::Relaxed)) {
            match apart(args, e, cores / lanes) {
                Ok(said) => bar.suspend(|| print!("{said}")),
                Err(error) => {
                    if let Ok(mut failures) = failures.lock() {
                        failures.push(format!("{error:#}"));
                    }
                }
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
    match failures.into_inner().unwrap_or_default() {
        failures if failures.is_empty() => Ok(()),
        failures => bail!("{}", failures.join("; ")),
    }
}

/// One experiment in a process of its own; what it prints.
fn apart(args: &Args, experiment: &Experiment, threads: usize) -> Result<String> {
    let mut command = Command::new(std::env::current_exe().context("the command's own file")?);
    command.args(["reproduce", experiment.name, "--seed", &args.seed.to_string(), "--out"]).arg(&args.out);
    if let Some(runs) = args.runs {
        command.args(["--runs", &runs.to_string()]);
    }
    if args.json {
        command.arg("--json");
    }
    command.env("RAYON_NUM_THREADS", threads.to_string()).stdin(Stdio::null());
    let output = command.output().with_context(|| format!("cannot start {}", experiment.name))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        bail!("{}", said.trim().trim_start_matches("seabearing: "));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}
