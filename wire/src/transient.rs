//! A sound that is no vessel: a snap, a click, an explosion, a call that begins suddenly.

use serde::{Deserialize, Serialize};

/// A transient that an array has heard; or the strongest of several that were not told one by one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transient {
    /// Index of the first sample that stands out, on the hydrophone that hears it first.
    pub index: u64,
    /// Sample instants from that one to the last that stands out, both counted.
    pub duration: u32,
    /// Transients that this record stands for: 1, or the strongest one and so many less it that are told of nowhere else.
    pub count: u32,
    /// Greatest magnitude on `channel`, dB re full scale, in tenths.
    pub peak_tenth_db: i16,
    /// Azimuth of the first arrival, radians clockwise from true North, [0, 2π); 0 where it was not found.
    pub azimuth: f32,
    /// Its elevation, radians.
    pub elevation: f32,
    /// Variance of azimuth, rad²; infinite where no direction was found.
    pub var_azimuth: f32,
    /// Variance of elevation, rad².
    pub var_elevation: f32,
    /// Covariance of both, rad².
    pub cov: f32,
    /// Channel on which it stands out most.
    pub channel: u8,
    /// Bit c: channel c heard it; bit 4 + c: channel c was clipped.
    pub channels: u8,
    /// 0 an impulse: blanked within frames; 1 a burst: a frame as a whole was left out.
    pub kind: u8,
}

impl Transient {
    /// Kind of an impulse.
    pub const IMPULSE: u8 = 0;
    /// Kind of a burst.
    pub const BURST: u8 = 1;

    /// Whether it came from a known direction.
    pub fn has_direction(&self) -> bool {
        self.var_azimuth.is_finite()
    }
}
