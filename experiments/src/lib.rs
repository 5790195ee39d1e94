//! Monte Carlo reproductions of the papers' figures and tables, and of the project's own stated figures.
//!
//! Each experiment is one file with one function; it writes CSV and plots into the output folder, prints its table and
//! reports its figures. Seeds are stated in the output.

#[macro_use(print, println)]
extern crate seabearing_host;

mod ais_kinematics;
mod ais_match;
mod ais_paths;
mod archive;
mod base_fusion;
mod base_power;
mod base_process;
mod base_station;
mod batch;
pub mod bearing_limit;
pub mod bearing_limit_source;
mod card_cuts;
pub mod difar;
mod difar_tracks;
pub mod figure;
mod flash_cuts;
mod fuzz;
pub mod fuzz_targets;
mod heard_vessels;
mod late_hydrophone;
mod levels;
mod line;
mod line_bound;
mod link;
mod link_ends;
mod link_line;
pub mod mosquitto;
mod motion;
mod motion_checks;
mod motion_figures;
mod motion_speeds;
mod mqtt;
mod network;
mod network_offsets;
mod network_scene;
mod network_vessels;
mod obs_appendix_b;
mod obs_bad_samples;
mod obs_checks;
mod obs_core_clutter;
mod obs_crowd;
mod obs_day;
mod obs_doubts;
mod obs_far;
mod obs_first_motion;
mod obs_four_ships;
mod obs_gains;
mod obs_loud;
mod obs_model;
mod obs_month;
mod obs_network;
mod obs_noise_week;
mod obs_noisy;
mod obs_one_ship;
mod obs_onsets;
mod obs_orient;
mod obs_pictures;
mod obs_pulse;
mod obs_real;
mod obs_spectra;
mod obs_speeds;
mod obs_table1;
mod obs_turns;
mod obs_two_ships;
mod obs_week;
mod obs_whales;
pub mod obs_world;
mod obs_year;
mod orient_geometry;
mod page;
pub mod real_ship_ee;
mod real_ship_track;
mod report;
pub mod score;
mod sea;
mod sea_moving;
mod sea_near;
mod sea_passes;
mod sea_positions;
mod sea_random;
mod sea_sick;
mod sea_snaps;
mod sea_three;
mod sea_transients;
mod sea_vessels;
mod sea_weak;
mod several_vessels;
mod shaft_rate;
mod sub_bands;

use anyhow::Result;
use figure::Figures;
use seabearing_host::{
    ais, angle, atomic, course, csv, delays, geodesy, ocean_bottom, orientation, plot, progress, propagation,
    recording, replay, scenario, station, world,
};
use std::path::PathBuf;

/// What every experiment is told.
#[derive(Debug)]
pub struct Options {
    /// Folder for CSV and plots (made if missing).
    pub out: PathBuf,
    /// Monte Carlo runs, where the experiment's default is not wanted.
    pub runs: Option<usize>,
    /// Seed.
    pub seed: u64,
    /// Print JSON Lines instead of a table.
    pub json: bool,
    /// Folder for pictures of the recordings themselves, where an experiment draws any ([`DRAWN`]).
    pub plots: Option<PathBuf>,
    /// Folder of real recordings, ray tables and ship positions, which are no part of the project.
    pub data: PathBuf,
    /// Takes the figures.
    pub figures: Figures,
}

impl Options {
    /// A file or folder of the real data; where it is absent, one line on standard error says so.
    pub fn real(&self, name: &str) -> Option<PathBuf> {
        let path = self.data.join(name);
        if !path.exists() {
            self.figures.no_data(&path);
            return None;
        }
        Some(path)
    }
}

/// One experiment.
pub struct Experiment {
    /// Name on the command line.
    pub name: &'static str,
    /// One line about it.
    pub about: &'static str,
    /// Runs it: prints its table, writes its files, reports its figures.
    pub run: fn(&Options) -> Result<()>,
}

/// Experiments that draw what they recorded.
pub const DRAWN: &[&str] = &[obs_week::WEEK.name, obs_week::WEEK_5_DB.name, obs_week::WEEK_10_DB.name];

/// All experiments. `reproduce all` begins them in this order, the long ones first, so that none is left to run alone.
pub const EXPERIMENTS: &[Experiment] = &[
    bearing_limit::EXPERIMENT,
    sub_bands::EXPERIMENT,
    sea_passes::SURFACE,
    sea_passes::BOTTOM,
    sea_near::EXPERIMENT,
    sea_random::EXPERIMENT,
    sea_random::BOTTOM,
    sea_three::EXPERIMENT,
    sea_weak::EXPERIMENT,
    sea_sick::EXPERIMENT,
    sea_snaps::EXPERIMENT,
    sea_transients::EXPERIMENT,
    sea_vessels::EXPERIMENT,
    sea_positions::EXPERIMENT,
    orient_geometry::EXPERIMENT,
    late_hydrophone::EXPERIMENT,
    motion_checks::COVERAGE,
    motion_figures::FIGURE_1,
    motion_figures::FIGURE_2,
    motion_figures::FIGURE_3,
    motion_figures::FLEET,
    motion_speeds::SPEEDS,
    motion_speeds::TRAFFIC,
    motion_checks::ELEVATION,
    obs_table1::TABLE_1,
    obs_week::WEEK,
    obs_week::WEEK_5_DB,
    obs_week::WEEK_10_DB,
    obs_month::EXPERIMENT,
    archive::EXPERIMENT,
    shaft_rate::EXPERIMENT,
    link::EXPERIMENT,
    base_station::LOAD,
    base_station::KILL,
    base_station::YEAR,
    base_fusion::EXPERIMENT,
    base_power::EXPERIMENT,
    page::EXPERIMENT,
    mqtt::OUTAGE,
    mqtt::NODE,
    fuzz::EXPERIMENT,
    flash_cuts::EXPERIMENT,
    card_cuts::EXPERIMENT,
    line::ORIENTATION,
    line_bound::EXPERIMENT,
    line::FREQUENCIES,
    obs_noise_week::NOISE_WEEK,
    obs_orient::ORIENT,
    obs_checks::CHECKS,
    obs_doubts::DOUBTS,
    obs_far::FAR,
    obs_bad_samples::BAD_SAMPLES,
    obs_loud::LOUD,
    obs_noisy::NOISY,
    obs_gains::GAINS,
    obs_onsets::ONSETS,
    obs_first_motion::FIRST_MOTION,
    obs_spectra::SPECTRA,
    obs_speeds::SPEEDS,
    obs_turns::TURNS,
    obs_real::REAL,
    obs_pulse::PULSE,
    obs_whales::WHALES,
    obs_network::NETWORK,
    several_vessels::EXPERIMENT,
    levels::EXPERIMENT,
    ais_kinematics::EXPERIMENT,
    ais_match::EXPERIMENT,
    obs_one_ship::ONE_SHIP,
    obs_day::DAY,
    obs_two_ships::TWO_SHIPS,
    obs_four_ships::FOUR_SHIPS,
    obs_crowd::CROWD,
    obs_core_clutter::CLUTTER,
    obs_year::EXPERIMENT,
    obs_appendix_b::APPENDIX_B,
    obs_pictures::PICTURES,
    obs_model::EXPERIMENT,
    network_vessels::EXPERIMENT,
    network_scene::EXPERIMENT,
    network_offsets::EXPERIMENT,
    network::FIGURE_2,
    network::FIGURE_3,
    difar::EXPERIMENT,
    real_ship_ee::EXPERIMENT,
    real_ship_track::EXPERIMENT,
    motion_checks::COST,
];
