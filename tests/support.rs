//! Helpers shared by the cross-crate tests.

use seabearing::ocean_bottom::{self, scenario::ObsScenario, simulate::Simulator};
use seabearing::propagation::{self, bottom::Bottom, profile::SpeedProfile, trace};
use seabearing::recording::BlockSource;
use seabearing::station::Station;
use seabearing_core::block::Frame;
use std::path::Path;

/// A compact array 168 m deep at a sampling rate; `more` is further text of its station file.
pub fn array_station(rate_hz: u32, more: &str) -> Station {
    let text = format!(
        "[station]\nid = 7\nkind = \"array\"\nposition = {{ lat_deg = 49.04, lon_deg = -123.32, depth_m = 168.0 }}\n\
         [sampling]\nrate_hz = {rate_hz}\n[array]\nhydrophones_m = [[0.0, 1.062, -0.376], [0.92, -0.531, -0.376], \
         [-0.92, -0.531, -0.376], [0.0, 0.0, 1.127]]\n{more}"
    );
    Station::parse(&text, "station", Path::new(".")).expect("a good station file")
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
    let profile = SpeedProfile::subtropical(4340.0)?;
    let table = trace::trace("t", &profile, &Bottom::default(), 350.0, 150, || ());
    propagation::file::write(&table, &folder.join("table.toml"))?;
    let scenario = format!(
        "kind = \"obs\"\nseed = 3\nduration_s = {duration_s:?}\npropagation = \"table.toml\"\n[[vessels]]\n\
         straight = {{ cpa_time_s = {:?}, cpa_range_m = 6000.0, heading_deg = 30.0, speed_m_s = 8.0, side = \"port\" }}\n",
        0.5 * duration_s
    );
    std::fs::write(folder.join("scenario.toml"), scenario)?;
    let scenario = ObsScenario::read(&folder.join("scenario.toml"))?;
    let station = folder.join("station.toml");
    std::fs::write(&station, ocean_bottom::station::text(&scenario, "table.toml"))?;
    let mut simulator = Simulator::new(scenario, table, Vec::new())?;
    let mut blocks = Vec::new();
    while let Some(block) = simulator.next_block()? {
        blocks.push((block.first_index, block.frames.to_vec()));
    }
    Ok(OceanBottom { station: Station::read(&station)?, blocks })
}
