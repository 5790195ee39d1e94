//! `seabearing simulate`: write simulated recordings, their truth and the station file.

use crate::scenario::{Kind, ScenarioFile};
use crate::world::{self, Scenario};
use anyhow::Result;
use std::path::PathBuf;

/// Arguments of `seabearing simulate`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing simulate scenarios/demo.toml --out out/pass\n  \
                        seabearing process --station out/pass/station.toml out/pass/*.wav")]
pub struct Args {
    /// What to simulate (TOML; `docs/simulate.md` describes every key).
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
    if ScenarioFile::read(&args.scenario)?.kind == Kind::Obs {
        return ocean_bottom(&args);
    }
    let scenario = Scenario::read(&args.scenario)?;
    let written = world::write(&scenario, &args.out)?;
    let all = written.recordings.iter().map(|p| ("recording", p));
    for (kind, path) in all.chain([("truth", &written.truth), ("station", &written.station)]) {
        if args.json {
            println!("{}", serde_json::json!({ "type": kind, "path": path }));
        } else {
            println!("{kind:9} {}", path.display());
        }
    }
    Ok(())
}

/// The same for an ocean-bottom station.
fn ocean_bottom(args: &Args) -> Result<()> {
    use crate::ocean_bottom::{scenario::Scenario, simulate::Simulator, write::write};
    let scenario = Scenario::read(&args.scenario)?;
    let table = crate::propagation::file::read(&scenario.propagation)?;
    let extra = crate::ocean_bottom::ais::extras(&scenario)?;
    let written = write(&mut Simulator::new(scenario, table, extra)?, &args.out)?;
    let rest = [
        ("truth", &written.truth),
        ("tracks", &written.tracks),
        ("station", &written.station),
        ("table", &written.table),
    ];
    for (kind, path) in written.recordings.iter().map(|p| ("recording", p)).chain(rest) {
        if args.json {
            println!("{}", serde_json::json!({ "type": kind, "path": path }));
        } else {
            println!("{kind:9} {}", path.display());
        }
    }
    Ok(())
}
