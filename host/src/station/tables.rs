//! The tables of a station file and of a list of stations, as they are written.

use super::response::Response;
use seabearing_core::config::{ArrayConfig, Tracking};
use serde::Deserialize;
use std::path::PathBuf;

/// A recorder: where it is, what it hears with, and what is assumed.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    /// Who and where the recorder is.
    pub(super) station: StationTable,
    /// How it samples; of a line array only where recordings are processed.
    pub(super) sampling: Option<Sampling>,
    /// A compact array of four hydrophones (`kind = "array"`).
    pub(super) array: Option<Array>,
    /// An ocean-bottom station: hydrophone and three components of motion (`kind = "obs"`).
    pub(super) obs: Option<Obs>,
    /// A uniform line array (`kind = "line"`).
    pub(super) line: Option<Line>,
    /// What fits of tracks may assume of the vessels here.
    pub(super) tracking: Option<TrackingTable>,
    /// Levels that the recorder sends of itself; not of a line array.
    pub(super) levels: Option<LevelsTable>,
    /// When the recorder listens; always where this is not said. `process` takes what a recording holds.
    pub(super) schedule: Option<ScheduleTable>,
    /// What a recorder with a card keeps of its sound; all of it where this is not said.
    pub(super) card: Option<CardTable>,
    /// What levels need beside the sensitivities: volts at full scale, and frequency responses.
    pub(super) calibration: Option<CalibrationTable>,
}

/// A list of stations: positions for `locate`, lines for `base`.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NetworkFile {
    /// The stations.
    pub(super) stations: Vec<StationTable>,
}

/// Who and where a recorder is.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StationTable {
    /// Number of the station, 0 to 65535; 0 where it is not said.
    pub(super) id: Option<u16>,
    /// Name, at most 24 bytes; `station-ID` where it is not said.
    pub(super) name: Option<String>,
    /// `array`, `obs` or `line`; needed except in a list of stations.
    pub(super) kind: Option<String>,
    /// Where it is; not needed for bearings alone.
    pub(super) position: Option<Position>,
    /// Azimuth of the array's own North, degrees clockwise from true North.
    #[serde(default)]
    pub(super) orientation_deg: f64,
    /// Speed of sound at the station, m/s.
    #[serde(default = "default_sound_speed")]
    pub(super) sound_speed_m_s: f64,
    /// Of a list only: how the base station reaches it, `listen:ADDR:PORT`, `tcp:HOST:PORT`, `serial:DEVICE:BAUD` or `file:PATH`.
    pub(super) line: Option<String>,
    /// Of a list only: file with the key that commands are signed with.
    pub(super) key_file: Option<PathBuf>,
    /// Of a list only: UTC of sample 0 (RFC 3339) of a recorder without a clock.
    pub(super) utc_of_sample_0: Option<String>,
    /// Of a list only: standard deviation of `orientation_deg`, degrees, 0 to 180; what fits of several stations' bearings
    /// assume, 0.5 where it is not said: what passes of known vessels give. A compass alone is several degrees.
    pub(super) orientation_sd_deg: Option<f64>,
    /// Of a list only: standard deviation of its clock, seconds, 0 to 86400; where it is not said what
    /// the recorder states of its clock counts, and 2 where it states nothing: a part in a million, three weeks after it was set.
    pub(super) clock_sd_s: Option<f64>,
    /// Of a list only: the recorder's own station file, for the sensitivities with which its levels are told.
    pub(super) station_file: Option<PathBuf>,
}

impl StationTable {
    /// A key that is there and has its place in a list only.
    pub(super) fn listed_key(&self) -> Option<&'static str> {
        let keys = [
            ("line", self.line.is_some()),
            ("key_file", self.key_file.is_some()),
            ("utc_of_sample_0", self.utc_of_sample_0.is_some()),
            ("orientation_sd_deg", self.orientation_sd_deg.is_some()),
            ("clock_sd_s", self.clock_sd_s.is_some()),
            ("station_file", self.station_file.is_some()),
        ];
        keys.into_iter().find(|(_, there)| *there).map(|(key, _)| key)
    }
}

pub(super) fn default_sound_speed() -> f64 {
    1484.0
}

/// A position on the Earth, or in a network's own plane.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize, Clone)]
#[serde(deny_unknown_fields)]
pub(super) struct Position {
    /// Latitude, degrees; with `lon_deg`.
    pub(super) lat_deg: Option<f64>,
    /// Longitude, degrees; with `lat_deg`.
    pub(super) lon_deg: Option<f64>,
    /// Depth below the surface, metres.
    pub(super) depth_m: Option<f64>,
    /// East, North and up of a network's origin, metres.
    pub(super) local_m: Option<[f64; 3]>,
}

/// How the recorder samples.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Sampling {
    /// Samples a second of the recorder: array 4000 to 200000, ocean bottom 20 to 500. Recordings of a higher rate are brought to it.
    pub(super) rate_hz: f64,
    /// The code that means clipping.
    #[serde(default = "default_full_scale")]
    pub(super) full_scale: i32,
    /// Offset from UTC of the times in names of recordings that do not tell it, as "+10:00".
    pub(super) name_offset: Option<String>,
}

pub(super) fn default_full_scale() -> i32 {
    1 << 23
}

/// A compact array of four hydrophones.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Array {
    /// East, North and up of the four hydrophones before orientation, metres; not all in one plane.
    pub(super) hydrophones_m: Vec<[f64; 3]>,
    /// Channel of each hydrophone: of the recorder 0 to 3, or four of the channels of recordings that have more.
    pub(super) channels: Option<Vec<u8>>,
    /// Sensitivity of each hydrophone, dB re 1 V/µPa, -260 to -60.
    pub(super) sensitivity_db_re_1v_upa: Vec<f64>,
    /// Range for which delays are expected where no surface tells it (`vessel_depth_m` = 0, an array no deeper than that, sound from below), metres, 5 or more; inf means a plane wave.
    pub(super) reference_range_m: f64,
    /// Band used for bearings, Hz: lowest and highest.
    pub(super) band_hz: [f64; 2],
    /// Length of the data of one bearing, seconds, 0.1 to 10.
    pub(super) segment_s: f64,
    /// Time from one bearing to the next, seconds, 0.05 to `segment_s`.
    pub(super) step_s: f64,
    /// Lowest and highest elevation searched, degrees.
    pub(super) elevation_deg: [f64; 2],
    /// Bearings allowed from noise alone, an hour; sets the detection threshold.
    pub(super) false_alarms_per_hour: f64,
    /// Depth of the vessels' sources, metres; 0: no image in the surface is expected.
    pub(super) vessel_depth_m: f64,
    /// Standard deviation of each coordinate of each hydrophone, metres. Above 0.195 times the sound's speed over it no direction is looked for (but up to twice the speed over the longest baseline).
    pub(super) position_sd_m: f64,
    /// Standard deviation of the speed of sound, m/s.
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

/// An ocean-bottom station.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Obs {
    /// Whose records of an archive are the station's: `NET.STA` or `NET.STA.LOC`.
    pub(super) seed_id: Option<String>,
    /// Counts for a pascal and for a metre a second; motion is brought to north's, and reversed components are turned.
    pub(super) sensitivity: Option<Sensitivity>,
    /// Channel codes of the components.
    pub(super) components: Option<Components>,
    /// Poles and zeros of components that are not flat from 2 to 24 Hz; taken out where recordings are read, and not by the recorder itself.
    #[serde(default)]
    pub(super) responses: Responses,
    /// True azimuth of the component called north, degrees.
    #[serde(default)]
    pub(super) orientation_of_north_deg: f64,
    /// Standard deviation of `orientation_of_north_deg`, degrees, 0 to 90: an error that lasts, in what is stated of azimuths and
    /// tracks.
    #[serde(default)]
    pub(super) orientation_sd_deg: f32,
    /// Standard deviation of the gain of north over that of east, dB, 0 to 20: an error that lasts, too.
    #[serde(default)]
    pub(super) gain_sd_db: f32,
    /// Standard deviation of the depth for which the propagation table was made, metres, 0 to 1000: an error that lasts, in what is
    /// stated of ranges, speeds and tracks.
    #[serde(default)]
    pub(super) table_depth_sd_m: f32,
    /// Standard deviation of the speed of sound over that of the propagation table, m/s, 0 to 100: counts as an error of the table's depth of 0.6 times its
    /// share; needs the depth of the station.
    #[serde(default)]
    pub(super) table_sound_speed_sd_m_s: f32,
    /// `away`: active intensity points away from the source (physical); `towards` where polarity reverses it.
    #[serde(default = "default_intensity")]
    pub(super) intensity: String,
    /// Propagation table (`seabearing propagation`), from the station file's folder; the recorder needs it.
    pub(super) propagation: Option<PathBuf>,
    /// `paper`: the method as the text of paper O has it; `programme`: as its authors' programme runs it; both for comparison. What either chooses stands in the manual of the ocean bottom.
    pub(super) compatibility: Option<String>,
    /// Whether directions by frequency leave once a minute (`azigram`): 70 bytes, about as many as all else when little goes on; left out while several vessels take the line's 200 bytes a minute.
    #[serde(default = "default_azigram")]
    pub(super) azigram: bool,
}

/// Poles and zeros of what is analogue before the converter, of each component that is not flat.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct Responses {
    /// Of the hydrophone.
    pub(super) pressure: Option<Response>,
    /// Of the first horizontal.
    pub(super) north: Option<Response>,
    /// Of the second horizontal.
    pub(super) east: Option<Response>,
    /// Of the vertical.
    pub(super) vertical: Option<Response>,
}

/// Counts for a pascal and for a metre a second; negative where a component is reversed.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize, Clone, Copy)]
#[serde(deny_unknown_fields)]
pub(super) struct Sensitivity {
    /// Counts for a pascal.
    pub(super) pressure: f64,
    /// Counts for a metre a second.
    pub(super) north: f64,
    /// Counts for a metre a second.
    pub(super) east: f64,
    /// Counts for a metre a second.
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

pub(super) fn default_azigram() -> bool {
    true
}

pub(super) fn default_intensity() -> String {
    "away".into()
}

/// Levels that the recorder sends of itself: records `spectrum` of one channel, each the mean of an interval.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LevelsTable {
    /// Seconds of an interval: array 10 to 3600, ocean bottom 60 to 3600; 0: no levels, as without this table. Each takes some 70 bytes.
    pub(super) every_s: u16,
    /// Recorder channel, 0 to 3; of an ocean bottom 0, pressure.
    #[serde(default)]
    pub(super) channel: u8,
}

/// When the recorder listens: at the beginning of every period, counted from 1970-01-01 00:00 UTC where it knows UTC, and from its first
/// sample where it does not.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ScheduleTable {
    /// Seconds of a period, 20 to 604800 (a week); 0: it always listens, as without this table.
    pub(super) every_s: u32,
    /// Seconds for which it listens at the beginning of each, 10 to `every_s` - 10.
    pub(super) on_s: u32,
}

/// What a recorder with a card keeps of its sound: all of it, or clips about its detections.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CardTable {
    /// `"all"`, or `"events"`: the files that hold sound from `before_s` before a detection to `after_s` after it, and no others; of an array.
    #[serde(default)]
    pub(super) record: RecordTable,
    /// Seconds before a detection, 0 to 300.
    #[serde(default = "default_clip_s")]
    pub(super) before_s: u16,
    /// Seconds after it, 1 to 3600.
    #[serde(default = "default_clip_s")]
    pub(super) after_s: u16,
    /// Seconds from a detection that is kept to the next one that is, 1 to 86400: a vessel is heard for long, and a day has so many clips at most.
    #[serde(default = "default_apart_s")]
    pub(super) apart_s: u32,
}

/// Which sound is kept.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Default, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum RecordTable {
    /// All of it.
    #[default]
    All,
    /// What is around detections.
    Events,
}

fn default_clip_s() -> u16 {
    30
}

fn default_apart_s() -> u32 {
    600
}

/// What levels (`process --levels`) need beside the sensitivities.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CalibrationTable {
    /// Volts at the converter that give its full scale, 0.000001 to 1000; of an array. Without it levels are re full scale.
    pub(super) full_scale_v: Option<f64>,
    /// Gain between hydrophone and converter, dB, -120 to 120; of an array.
    #[serde(default)]
    pub(super) gain_db: f64,
    /// Frequency response of the hydrophones and what follows them: rising frequencies, Hz, and dB against the sensitivity.
    /// Between them it is linear in the logarithm of frequency; beyond them nothing is told. Flat where there is no table.
    #[serde(default)]
    pub(super) response_db: Vec<[f64; 2]>,
    /// The same of the components of motion of an ocean-bottom station.
    #[serde(default)]
    pub(super) motion_response_db: Vec<[f64; 2]>,
}

/// Channel code of each component of an ocean-bottom station.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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

impl Components {
    /// Two components that name one channel.
    pub(super) fn alike(&self) -> Option<[&'static str; 2]> {
        let all = [
            ("pressure", &self.pressure),
            ("north", &self.north),
            ("east", &self.east),
            ("vertical", &self.vertical),
        ];
        let pairs = (0..all.len()).flat_map(|i| (0..i).map(move |k| (all[k], all[i])));
        pairs.filter(|(a, b)| a.1 == b.1).map(|(a, b)| [a.0, b.0]).next()
    }
}

impl Default for Components {
    fn default() -> Self {
        Self { pressure: "BDH".into(), north: "BH1".into(), east: "BH2".into(), vertical: "BHZ".into() }
    }
}

/// A uniform line array.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Line {
    /// Number of sensors, 3 to 32.
    pub(super) sensors: u8,
    /// Distance between neighbours, metres.
    pub(super) spacing_m: f64,
    /// Frequencies at which its recordings are analysed, Hz: at most eight, two over `frame_s` apart or more, each below half a wavelength between
    /// neighbours.
    pub(super) frequencies_hz: Option<Vec<f64>>,
    /// Length of a transform, seconds; 0.0625 by default.
    pub(super) frame_s: Option<f64>,
    /// Time from one bearing to the next, seconds; 1 by default.
    pub(super) step_s: Option<f64>,
    /// Share of the steps before and after one in its covariance, as much of either, 0 to below 1; 0.4 by default. Bearings leave a few steps late.
    pub(super) forgetting: Option<f64>,
    /// Overlapping subarrays over which the covariance is averaged; 5 by default, fewer with few sensors.
    pub(super) subarrays: Option<u8>,
    /// Most sources at one time, 1 to 4; 2 by default, 1 with three sensors.
    pub(super) sources: Option<u8>,
    /// `root` (root-MUSIC, the default) or `spectrum` (MUSIC).
    pub(super) method: Option<String>,
    /// Channel of the recording of each sensor, counted from 0; the first so many by default.
    pub(super) channels: Option<Vec<u8>>,
}

/// What fits of tracks may assume.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct TrackingTable {
    /// Mean speed of vessels here, m/s.
    pub(super) speed_m_s: f64,
    /// Its standard deviation, m/s; 0: known.
    pub(super) speed_sd_m_s: f64,
    /// Standard deviation of a bearing's error beyond what the estimator states, degrees.
    pub(super) bearing_sd_deg: f64,
    /// Correlation time of that error, seconds.
    pub(super) bearing_tau_s: f64,
    /// Standard deviation of what a vessel's own way adds to the heading of its track and to the direction of its place, degrees; 0: ways are
    /// exactly straight.
    pub(super) course_sd_deg: f64,
    /// Nearest and farthest closest point of approach considered, metres.
    pub(super) range_m: [f64; 2],
    /// Speed of vessels here from the rate of their shafts.
    pub(super) speed_from_shaft: Option<ShaftTable>,
}

/// Speed of the vessels here from the rate of their shafts.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShaftTable {
    /// Speed at no turns, m/s.
    pub(super) at_zero_m_s: f64,
    /// Metres made good for each turn of the shaft.
    pub(super) metres_a_turn: f64,
    /// Standard deviation of the speed so found, m/s.
    pub(super) sd_m_s: f64,
    /// Blades of the propellers, 2 to 7, where all have as many.
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
            course_sd_deg: d.course_sd_deg,
            range_m: [d.range_m.0, d.range_m.1],
            speed_from_shaft: None,
        }
    }
}
