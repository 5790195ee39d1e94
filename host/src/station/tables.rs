//! The tables of a station file and of a list of stations, as they are written.

use seabearing_core::config::{ArrayConfig, Tracking};
use serde::Deserialize;
use std::path::PathBuf;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) station: StationTable,
    pub(super) sampling: Option<Sampling>,
    pub(super) array: Option<Array>,
    pub(super) obs: Option<Obs>,
    pub(super) line: Option<Line>,
    pub(super) tracking: Option<TrackingTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NetworkFile {
    pub(super) stations: Vec<StationTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StationTable {
    pub(super) id: Option<u16>,
    pub(super) name: Option<String>,
    pub(super) kind: Option<String>,
    pub(super) position: Option<Position>,
    #[serde(default)]
    pub(super) orientation_deg: f64,
    #[serde(default = "default_sound_speed")]
    pub(super) sound_speed_m_s: f64,
    // Of a base station's list only.
    pub(super) line: Option<String>,
    pub(super) key_file: Option<PathBuf>,
    pub(super) utc_of_sample_0: Option<String>,
}

impl StationTable {
    /// A key that is there and has its place in a list only.
    pub(super) fn listed_key(&self) -> Option<&'static str> {
        let keys = [
            ("line", self.line.is_some()),
            ("key_file", self.key_file.is_some()),
            ("utc_of_sample_0", self.utc_of_sample_0.is_some()),
        ];
        keys.into_iter().find(|(_, there)| *there).map(|(key, _)| key)
    }
}

pub(super) fn default_sound_speed() -> f64 {
    1484.0
}

#[derive(Deserialize, Clone)]
#[serde(deny_unknown_fields)]
pub(super) struct Position {
    pub(super) lat_deg: Option<f64>,
    pub(super) lon_deg: Option<f64>,
    pub(super) depth_m: Option<f64>,
    pub(super) local_m: Option<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Sampling {
    pub(super) rate_hz: f64,
    #[serde(default = "default_full_scale")]
    pub(super) full_scale: i32,
    pub(super) name_offset: Option<String>,
}

pub(super) fn default_full_scale() -> i32 {
    1 << 23
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Array {
    pub(super) hydrophones_m: Vec<[f64; 3]>,
    pub(super) channels: Option<Vec<u8>>,
    pub(super) sensitivity_db_re_1v_upa: Vec<f64>,
    pub(super) reference_range_m: f64,
    pub(super) band_hz: [f64; 2],
    pub(super) segment_s: f64,
    pub(super) step_s: f64,
    pub(super) elevation_deg: [f64; 2],
    pub(super) false_alarms_per_hour: f64,
    pub(super) vessel_depth_m: f64,
    pub(super) position_sd_m: f64,
    pub(super) sound_speed_sd_m_s: f64,
}

impl Default for Array {
    /// What a file means where it says nothing; hydrophones it must state.
    fn default() -> Self {
        let usual = ArrayConfig::new([[0.0; 3]; 4]);
        Self {
            hydrophones_m: Vec::new(),
            channels: None,
            sensitivity_db_re_1v_upa: usual.sensitivity_db_re_1v_upa.to_vec(),
            reference_range_m: usual.reference_range_m,
            band_hz: usual.band_hz.into(),
            segment_s: usual.segment_s,
            step_s: usual.step_s,
            elevation_deg: usual.elevation_deg.into(),
            false_alarms_per_hour: usual.false_alarms_per_hour,
            vessel_depth_m: usual.vessel_depth_m,
            position_sd_m: usual.position_sd_m,
            sound_speed_sd_m_s: usual.sound_speed_sd_m_s,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Obs {
    pub(super) seed_id: Option<String>,
    pub(super) sensitivity: Option<Sensitivity>,
    pub(super) components: Option<Components>,
    #[serde(default)]
    pub(super) orientation_of_north_deg: f64,
    #[serde(default = "default_intensity")]
    pub(super) intensity: String,
    pub(super) propagation: Option<PathBuf>,
    pub(super) compatibility: Option<String>,
}

/// Counts for a pascal and for a metre a second; negative where a component is reversed.
#[derive(Deserialize, Clone, Copy)]
#[serde(deny_unknown_fields)]
pub(super) struct Sensitivity {
    pub(super) pressure: f64,
    pub(super) north: f64,
    pub(super) east: f64,
    pub(super) vertical: f64,
}

impl Sensitivity {
    /// What codes are multiplied by so that all motion has the size of north's and nothing is reversed; what differs by
    /// less than a thousandth is left.
    pub(super) fn gains(self) -> [f64; 4] {
        let motion = |s: f64| {
            let gain = self.north.abs() / s;
            if (gain - 1.0).abs() < 1e-3 { 1.0 } else { gain }
        };
        [self.pressure.signum(), motion(self.north), motion(self.east), motion(self.vertical)]
    }
}

pub(super) fn default_intensity() -> String {
    "away".into()
}

/// Channel code of each component of an ocean-bottom station.
#[derive(Deserialize, Clone, Debug, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct Components {
    /// The hydrophone.
    pub pressure: String,
    /// First horizontal.
    pub north: String,
    /// Second horizontal, 90° clockwise of the first.
    pub east: String,
    /// Vertical, positive up.
    pub vertical: String,
}

impl Default for Components {
    fn default() -> Self {
        Self { pressure: "BDH".into(), north: "BH1".into(), east: "BH2".into(), vertical: "BHZ".into() }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Line {
    pub(super) sensors: u8,
    pub(super) spacing_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct TrackingTable {
    pub(super) speed_m_s: f64,
    pub(super) speed_sd_m_s: f64,
    pub(super) bearing_sd_deg: f64,
    pub(super) bearing_tau_s: f64,
    pub(super) range_m: [f64; 2],
    pub(super) speed_from_shaft: Option<ShaftTable>,
}

/// Speed of the vessels here from the rate of their shafts.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShaftTable {
    pub(super) at_zero_m_s: f64,
    pub(super) metres_a_turn: f64,
    pub(super) sd_m_s: f64,
    pub(super) blades: Option<u8>,
}

impl Default for TrackingTable {
    fn default() -> Self {
        let d = Tracking::default();
        Self {
            speed_m_s: d.speed_m_s,
            speed_sd_m_s: d.speed_sd_m_s,
            bearing_sd_deg: d.bearing_sd_deg,
            bearing_tau_s: d.bearing_tau_s,
            range_m: [d.range_m.0, d.range_m.1],
            speed_from_shaft: None,
        }
    }
}
