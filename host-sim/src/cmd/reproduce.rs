//! `seabearing reproduce`: the papers' figures and tables and the project's own figures, by Monte Carlo.

use crate::reproduce::{EXPERIMENTS, Options};
use anyhow::{Context, Result, bail};
use std::path::PathBuf;

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
    let Some(name) = args.name else {
        for e in EXPERIMENTS {
            println!("{:24} {}", e.name, e.about);
        }
        return Ok(());
    };
    let chosen: Vec<_> = EXPERIMENTS.iter().filter(|e| name == "all" || e.name == name).collect();
    if chosen.is_empty() {
        let names: Vec<_> = EXPERIMENTS.iter().map(|e| e.name).collect();
        bail!("no experiment `{name}`; there are: all, {}", names.join(", "));
    }
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make folder {}", args.out.display()))?;
    let options = Options { out: args.out, runs: args.runs, seed: args.seed, json: args.json };
    for e in chosen {
        if !options.json {
            println!("== {}: {} (seed {})", e.name, e.about, options.seed);
        }
        (e.run)(&options).with_context(|| e.name.to_owned())?;
    }
    Ok(())
}
