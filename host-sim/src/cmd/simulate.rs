//! `seabearing simulate`: write simulated recordings, their truth and the station file.

use crate::scenario;
use anyhow::Result;
use std::path::PathBuf;

/// Arguments of `seabearing simulate`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing simulate scenarios/demo.toml --out out/pass\n  \
                        seabearing process --station out/pass/station.toml out/pass/*.wav")]
pub struct Args {
    /// What to simulate (TOML; `docs/simulate.md` describes every key).
    #[arg(value_parser = super::input())]
    scenario: PathBuf,
    /// Folder for recordings, truth.csv and station.toml (made if missing).
    #[arg(long)]
    out: PathBuf,
    /// What was written, as JSON Lines.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    let written = scenario::write(&args.scenario, &args.out)?;
    for (kind, path) in written.files() {
        if args.json {
            println!("{}", serde_json::json!({ "type": kind, "path": path }));
        } else {
            println!("{kind:9} {}", path.display());
        }
    }
    Ok(())
}
