//! Helpers shared by the cross-crate tests.

use seabearing::ocean_bottom::{self, scenario::Scenario, simulate::Simulator};
use seabearing::propagation::{self, bottom::Bottom, profile::Profile, trace};
use seabearing::recording::Source;
use seabearing::station::Station;
use seabearing_core::block::Frame;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Says why a test does nothing. Straight to standard error: what tests print with `println!` is kept back when they pass.
fn skipped(test: &str, reason: &str) {
    let _ = writeln!(std::io::stderr(), "skipped {test}: {reason}");
}

/// The folder of real recordings and ship positions beside the project (`../shared/data`), if it is there.
///
/// The data carry no licence to redistribute and are not part of the project; a test that needs them
/// calls this and returns after the printed reason where it answers `None`.
pub fn shared_data(test: &str) -> Option<PathBuf> {
    let dir = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    if dir.is_dir() {
        Some(dir)
    } else {
        skipped(test, "no real data at ../shared/data");
        None
    }
}

/// Whether tests may boot the firmware in the emulator: `cargo xtask test` says so once it has built the image for this
/// tree. Otherwise the reason is printed and the test returns.
pub fn emulated(test: &str) -> bool {
    let ready = std::env::var_os("SEABEARING_EMULATED").is_some();
    if !ready {
        skipped(test, "it boots the firmware in QEMU; `cargo xtask test` builds that and runs this");
    }
    ready
}

/// Runs the command `seabearing` that stands beside the test's own binary, if it is built.
pub fn seabearing(args: &[&str]) -> Option<Output> {
    let dir = std::env::current_exe().ok()?.parent()?.parent()?.to_path_buf();
    let binary = dir.join(format!("seabearing{}", std::env::consts::EXE_SUFFIX));
    if !binary.is_file() {
        skipped("a command", &format!("{} is not built (cargo build -p seabearing)", binary.display()));
        return None;
    }
    Command::new(binary).args(args).output().ok()
}

/// A station at the bottom of the ocean and what it records while a ship passes, in blocks.
pub struct OceanBottom {
    /// The station.
    pub station: Station,
    /// First sample index and samples of each block, in order, without gaps.
    pub blocks: Vec<(u64, Vec<Frame>)>,
}

/// Records for a time; files it needs go into `folder`.
///
/// # Errors
/// The folder cannot be written.
pub fn ocean_bottom(folder: &Path, duration_s: f64) -> anyhow::Result<OceanBottom> {
    let profile = Profile::subtropical(4340.0)?;
    let table = trace::trace("t", &profile, &Bottom::default(), 350.0, 150, || ());
    propagation::file::write(&table, &folder.join("table.toml"))?;
    let scenario = format!(
        "kind = \"obs\"\nseed = 3\nduration_s = {duration_s:?}\npropagation = \"table.toml\"\n[[ship]]\n\
         cpa_time_s = {:?}\ncpa_range_m = 6000.0\nheading_deg = 30.0\nspeed_m_s = 8.0\n",
        0.5 * duration_s
    );
    std::fs::write(folder.join("scenario.toml"), scenario)?;
    let scenario = Scenario::read(&folder.join("scenario.toml"))?;
    let station = folder.join("station.toml");
    std::fs::write(&station, ocean_bottom::station::text(&scenario, "table.toml", false))?;
    let mut simulator = Simulator::new(scenario, table, Vec::new())?;
    let mut blocks = Vec::new();
    while let Some(block) = simulator.next_block()? {
        blocks.push((block.first_index, block.frames.to_vec()));
    }
    Ok(OceanBottom { station: Station::read(&station)?, blocks })
}
