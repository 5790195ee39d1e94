//! The station file that goes with a simulated recording.

use super::scenario::ObsScenario;
use crate::station::Station;
use anyhow::Result;
use seabearing_core::config::StationConfig;
use std::fmt::Write as _;

/// The station file of a scenario, that which it names or one of what it states; `table` is the propagation table's name beside it.
pub fn text(scenario: &ObsScenario, table: &str) -> String {
    if let Some(file) = &scenario.station_file {
        return file.source.text_with("obs", "propagation", &format!("{table:?}"));
    }
    let mut out = format!(
        "[station]\nid = 1\nname = {:?}\nkind = \"obs\"\nsound_speed_m_s = 1500.0\n",
        scenario.name.to_lowercase()
    );
    if let Some([lat, lon]) = scenario.lat_lon_deg {
        let _ = writeln!(out, "position = {{ lat_deg = {lat:?}, lon_deg = {lon:?} }}");
    }
    let _ = write!(
        out,
        "\n[sampling]\nrate_hz = {:?}\n\n[obs]\n\
         components = {{ pressure = \"BDH\", north = \"BH1\", east = \"BH2\", vertical = \"BHZ\" }}\n\
         orientation_of_north_deg = {:?}\nintensity = {:?}\npropagation = {table:?}\n",
        scenario.rate_hz, scenario.orientation_of_north_deg, scenario.intensity
    );
    out
}

/// The configuration the same text gives.
///
/// # Errors
/// A value of the scenario that a station may not have.
pub fn config(scenario: &ObsScenario) -> Result<StationConfig> {
    Ok(Station::parse(&text(scenario, "table.toml"), "station.toml", std::path::Path::new("."))?.config)
}
