//! What goes wrong in the recorder: `[[faults]]`.

use crate::scenario::{Affected, Wrong, within};
use serde::Deserialize;

/// What goes wrong in the recorder.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum ObsFault {
    /// A channel that does not move.
    Dead(Affected),
    /// A channel at full scale.
    Saturated(Affected),
    /// A channel without a file.
    Missing(Channel),
    /// A step of the clock.
    ClockStep(ClockStep),
    /// Samples far off, on all channels at once.
    Spikes(Spikes),
    /// A converter, or an amplifier before it, that clips every channel.
    Clipped(Clip),
}

/// Samples far off, on all channels at once.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spikes {
    /// From one to the next, s.
    pub every_s: f64,
    /// What each adds, counts.
    pub counts: f64,
    /// How many samples each lasts.
    #[serde(default = "super::one")]
    pub samples: u64,
}

/// A limit of every channel below full scale.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clip {
    /// Greatest magnitude of a code.
    pub counts: f64,
}

/// A channel, all along.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Channel {
    /// 0 pressure, 1 north, 2 east, 3 vertical.
    pub channel: usize,
}

/// A step of the clock.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClockStep {
    /// When, seconds.
    pub at_s: f64,
    /// By how much it is ahead afterwards, seconds.
    pub by_s: f64,
}

/// The first key found wrong.
pub(super) fn wrong(faults: &[ObsFault]) -> Result<(), Wrong> {
    for (i, f) in faults.iter().enumerate() {
        if let ObsFault::Dead(Affected { channel, .. })
        | ObsFault::Saturated(Affected { channel, .. })
        | ObsFault::Missing(Channel { channel }) = *f
        {
            within(&format!("faults.{i}.channel"), channel as f64, 0.0, 3.0)?;
        }
        match *f {
            ObsFault::Spikes(s) => {
                within(&format!("faults.{i}.every_s"), s.every_s, 0.1, 1e7)?;
                within(&format!("faults.{i}.counts"), s.counts, -8.4e6, 8.4e6)?;
                within(&format!("faults.{i}.samples"), s.samples as f64, 1.0, 1e6)?;
            }
            ObsFault::Clipped(c) => within(&format!("faults.{i}.counts"), c.counts, 1.0, 8.4e6)?,
            _ => {}
        }
    }
    Ok(())
}
