//! Simulated recordings for the emulated runs, from the scenarios a person can read.

use crate::process::{host, run, say};
use crate::root;
use anyhow::{Result, bail};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// What was simulated by this task: steps read it that run beside each other.
static SIMULATED: Mutex<BTreeMap<String, Recording>> = Mutex::new(BTreeMap::new());

/// A simulated recording: its station file and its files in order of name.
#[derive(Clone)]
pub struct Recording {
    /// The station file.
    pub station: PathBuf,
    /// The recordings.
    pub files: Vec<PathBuf>,
}

/// Simulates `scenarios/NAME.toml` into `target/scenarios/NAME`, once.
pub fn simulate(name: &str) -> Result<Recording> {
    let mut simulated = SIMULATED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(recording) = simulated.get(name) {
        return Ok(recording.clone());
    }
    if name.starts_with("ocean-bottom") {
        trace_table()?;
    }
    let folder = root().join("target/scenarios").join(name);
    let recording = record(&root().join(format!("scenarios/{name}.toml")), &folder)?;
    simulated.insert(name.to_owned(), recording.clone());
    Ok(recording)
}

/// The demo's pass as a station hears it whose file differs from the demo's in these words.
pub fn simulate_changed(name: &str, changes: &[(&str, &str)]) -> Result<Recording> {
    let folder = root().join("target/scenarios").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder)?;
    let mut station = std::fs::read_to_string(root().join("scenarios/demo-station.toml"))?;
    for (from, to) in changes {
        if !station.contains(from) {
            bail!("scenarios/demo-station.toml has no `{from}`");
        }
        station = station.replace(from, to);
    }
    std::fs::write(folder.join("demo-station.toml"), station)?;
    let scenario = folder.join("demo.toml");
    std::fs::copy(root().join("scenarios/demo.toml"), &scenario)?;
    record(&scenario, &folder.join("recording"))
}

fn record(scenario: &Path, folder: &Path) -> Result<Recording> {
    let shown = scenario.strip_prefix(root()).unwrap_or(scenario).display();
    say(&format!("simulating {shown}"));
    let _ = std::fs::remove_dir_all(folder);
    run(host(&["simulate"]).arg(scenario).arg("--out").arg(folder), "seabearing simulate")?;
    recorded(folder)
}

/// The recording in a folder.
fn recorded(folder: &Path) -> Result<Recording> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?
        .flatten()
        .map(|f| f.path())
        .filter(|p| p.extension().is_some_and(|e| e == "wav" || e == "mseed"))
        .collect();
    files.sort();
    if files.is_empty() {
        bail!("there is no recording in {}", folder.display());
    }
    Ok(Recording { station: folder.join("station.toml"), files })
}

/// The interference table that the ocean-bottom scenario names.
pub fn trace_table() -> Result<()> {
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
