//! A sound that is no vessel: its record.

use super::sound::{channels, rounded};
use crate::station::Calibration;
use seabearing_core::wire;
use serde::Serialize;
use serde_json::{Value, json};

/// A snap, a click, an explosion, a call that begins suddenly: what an array heard and kept out of its bearings; `t_s` is its arrival at
/// the hydrophone that hears it first.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Transient {
    /// `impulse`, or `burst`: longer than a frame of 512 samples.
    pub kind: &'static str,
    /// Seconds from the first sample that stands out to the last.
    pub duration_s: f64,
    /// Level of the greatest magnitude, dB re `reference` (zero to peak), on `channel`.
    pub peak_db: f64,
    /// What the level is of: `full scale`, or the unit in which a station file calibrates the channel, where its response is flat.
    pub reference: String,
    /// Recorder channel, from 0, on which it stands out most.
    pub channel: u8,
    /// Recorder channels that heard it.
    pub channels: Vec<u8>,
    /// Recorder channels that were clipped: their level is a least one.
    pub clipped_channels: Vec<u8>,
    /// Azimuth of its first arrival, degrees clockwise from true North; null where the hydrophones agree on none, or too few heard it.
    pub azimuth_deg: Option<f64>,
    /// Its elevation, degrees.
    pub elevation_deg: Option<f64>,
    /// Standard deviation of the azimuth, degrees.
    pub sd_azimuth_deg: Option<f64>,
    /// Standard deviation of the elevation, degrees.
    pub sd_elevation_deg: Option<f64>,
    /// Correlation of both errors.
    pub correlation: Option<f64>,
    /// Transients that this record stands for: 1, or the strongest one and as many less it that are told of nowhere else.
    pub count: u32,
}

impl Transient {
    /// The record of a message; `seconds` of a number of samples.
    pub fn of(t: &wire::Transient, seconds: impl Fn(u64) -> f64) -> Self {
        let known = |x: f64| Some(x).filter(|x| t.has_direction() && x.is_finite());
        let (va, ve) = (f64::from(t.var_azimuth), f64::from(t.var_elevation));
        let degrees = |x: f64| known(x.to_degrees());
        Self {
            kind: if t.kind == wire::Transient::BURST { "burst" } else { "impulse" },
            duration_s: seconds(t.duration.into()),
            peak_db: f64::from(t.peak_tenth_db) / 10.0,
            reference: "full scale".to_owned(),
            channel: t.channel,
            channels: channels(t.channels & 0b1111),
            clipped_channels: channels(t.channels >> 4),
            azimuth_deg: degrees(t.azimuth.into()),
            elevation_deg: degrees(t.elevation.into()),
            sd_azimuth_deg: degrees(va.sqrt()),
            sd_elevation_deg: degrees(ve.sqrt()),
            correlation: known(f64::from(t.cov) / (va * ve).sqrt()),
            count: t.count,
        }
    }
}

/// Brings a transient's level to the reference of its channel.
pub(super) fn calibrate(record: &mut Value, of: &Calibration) {
    if let Some(peak_db) = record["peak_db"].as_f64() {
        record["peak_db"] = json!(rounded(peak_db + of.flat_db(), 10.0));
        record["reference"] = of.reference.into();
    }
}
