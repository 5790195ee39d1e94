//! Simulated recordings, and the tables that they and the stations of the ocean bottom need.

use crate::error::raise;
use anyhow::{Context, Result, bail};
use pyo3::prelude::*;
use seabearing_host::propagation::bottom::Bottom;
use seabearing_host::propagation::profile::SpeedProfile;
use seabearing_host::propagation::{file, trace};
use seabearing_host::scenario;
use std::path::{Path, PathBuf};

/// Distance between rows of a table, m.
const STEP_M: f64 = 70.0;

/// Writes a scenario's recordings, truth and station file into a folder; the kind and path of each.
#[pyfunction]
pub fn simulate(py: Python<'_>, scenario: PathBuf, out: PathBuf) -> PyResult<Vec<(String, String)>> {
    let written = py.detach(|| scenario::write(&scenario, &out)).map_err(raise)?;
    Ok(written.files().map(|(kind, path)| (kind.to_owned(), path.display().to_string())).collect())
}

/// Traces the interference table of a station through a profile of sound speed and writes it.
#[pyfunction]
pub fn propagation_table(
    py: Python<'_>,
    profile: PathBuf,
    depth_m: f64,
    rows: usize,
    out: PathBuf,
) -> PyResult<()> {
    py.detach(|| table(&profile, depth_m, rows, &out)).map_err(raise)
}

fn table(profile: &Path, depth_m: f64, rows: usize, out: &Path) -> Result<()> {
    if !(50.0..=12_000.0).contains(&depth_m) || !(3..=100_000).contains(&rows) {
        bail!("depth_m is {depth_m} and rows is {rows}; allowed are 50 to 12000 and 3 to 100000");
    }
    let name = profile.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let speeds = SpeedProfile::read(profile, depth_m)?;
    let table = trace::trace(&name, &speeds, &Bottom::default(), STEP_M, rows, || ());
    file::check(&table, &out.display().to_string())?;
    if let Some(folder) = out.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    file::write(&table, out)
}
