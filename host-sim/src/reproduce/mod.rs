//! Monte Carlo reproductions of the papers' figures and tables, and of the project's own stated figures.
//!
//! Each experiment is one file with one function; it writes CSV and plots into the output folder and prints its
//! table. Seeds are stated in the output.

pub mod bearing_limit;
pub mod bearing_limit_source;
pub mod difar;
mod difar_tracks;
mod line;
mod motion;
mod motion_checks;
mod motion_figures;
mod network;
mod network_vessels;
mod obs_appendix_b;
mod obs_core_clutter;
mod obs_noise_week;
mod obs_one_ship;
mod obs_orient;
mod obs_pictures;
mod obs_table1;
mod obs_two_ships;
mod obs_world;
pub mod real_ship_ee;
mod real_ship_track;
mod report;
mod several_vessels;
mod shaft_rate;

use anyhow::Result;
use std::path::PathBuf;

/// What every experiment is told.
#[derive(Debug, Clone)]
pub struct Options {
    /// Folder for CSV and plots (made if missing).
    pub out: PathBuf,
    /// Monte Carlo runs, where the experiment's default is not wanted.
    pub runs: Option<usize>,
    /// Seed.
    pub seed: u64,
    /// Print JSON Lines instead of a table.
    pub json: bool,
}

/// One experiment.
pub struct Experiment {
    /// Name on the command line.
    pub name: &'static str,
    /// One line about it.
    pub about: &'static str,
    /// Runs it.
    pub run: fn(&Options) -> Result<()>,
}

/// All experiments, in the order `reproduce all` runs them.
pub const EXPERIMENTS: &[Experiment] = &[
    network::FIGURE_2,
    network::FIGURE_3,
    network_vessels::EXPERIMENT,
    line::ORIENTATION,
    difar::EXPERIMENT,
    obs_one_ship::ONE_SHIP,
    obs_core_clutter::CLUTTER,
    obs_two_ships::TWO_SHIPS,
    obs_noise_week::NOISE_WEEK,
    obs_appendix_b::APPENDIX_B,
    obs_table1::TABLE_1,
    obs_orient::ORIENT,
    obs_pictures::PICTURES,
    bearing_limit::EXPERIMENT,
    shaft_rate::EXPERIMENT,
    real_ship_ee::EXPERIMENT,
    real_ship_track::EXPERIMENT,
    several_vessels::EXPERIMENT,
    motion_figures::FIGURE_1,
    motion_figures::FIGURE_2,
    motion_figures::FIGURE_3,
    motion_figures::FLEET,
    motion_checks::ELEVATION,
    motion_checks::COVERAGE,
    motion_checks::COST,
];
