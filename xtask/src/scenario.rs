//! Simulated recordings for the emulated runs, from the scenarios a person can read.

use crate::process::{host, run, say};
use crate::root;
use anyhow::{Result, bail};
use std::path::PathBuf;

/// A simulated recording: its station file and its files in order of name.
pub struct Recording {
    /// The station file.
    pub station: PathBuf,
    /// The recordings.
    pub files: Vec<PathBuf>,
}

/// Simulates `scenarios/NAME.toml` into `target/scenarios/NAME`.
pub fn simulate(name: &str) -> Result<Recording> {
    if name == "ocean-bottom" {
        trace_table()?;
    }
    let scenario = format!("scenarios/{name}.toml");
    say(&format!("simulating {scenario}"));
    let folder = root().join("target/scenarios").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    run(host(&["simulate", &scenario, "--out"]).arg(&folder), "seabearing simulate")?;
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)?
        .flatten()
        .map(|f| f.path())
        .filter(|p| p.extension().is_some_and(|e| e == "wav" || e == "mseed"))
        .collect();
    files.sort();
    if files.is_empty() {
        bail!("{scenario} gave no recording in {}", folder.display());
    }
    Ok(Recording { station: folder.join("station.toml"), files })
}

/// The interference table that the ocean-bottom scenario names.
fn trace_table() -> Result<()> {
    std::fs::create_dir_all(root().join("out"))?;
    let arguments = [
        "propagation",
        "--profile",
        "scenarios/ocean-profile.csv",
        "--depth-m",
        "4340",
        "--rows",
        "720",
        "--out",
        "out/ocean-table.toml",
    ];
    run(&mut host(&arguments), "seabearing propagation")
}
