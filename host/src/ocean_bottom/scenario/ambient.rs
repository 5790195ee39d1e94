//! Noise of the sea and the instrument: `[ambient]`, `[[ambient.directional]]` and `[[ambient.shaking]]`.

use crate::scenario::{Wrong, within};
use serde::Deserialize;

/// Ambient noise.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AmbientTable {
    /// Root-mean-square pressure of the isotropic part, counts.
    pub pressure_counts: f64,
    /// Horizontal velocities against pressure, dB.
    pub horizontal_db: f64,
    /// Vertical velocity against pressure, dB.
    pub vertical_db: f64,
    /// How much louder 0.2 Hz is than 1 Hz and above, dB.
    pub microseism_db: f64,
    /// Directional parts.
    pub directional: Vec<DirectionalTable>,
    /// Noise of the horizontal velocities along an axis.
    pub shaking: Vec<ShakingTable>,
}

/// Noise of the horizontal velocities along one axis, which pressure does not have: a place or an instrument that shakes one way, or, with
/// the orientation of a component as its axis, a component that is noisier than the other.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShakingTable {
    /// True azimuth of the axis, degrees.
    pub axis_deg: f64,
    /// Level against the isotropic pressure, dB.
    pub level_db: f64,
}

/// Ambient noise from one direction.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DirectionalTable {
    /// Where it comes from, degrees.
    pub azimuth_deg: f64,
    /// Level against the isotropic pressure, dB.
    pub level_db: f64,
}

impl Default for AmbientTable {
    fn default() -> Self {
        Self {
            pressure_counts: 1000.0,
            horizontal_db: 0.0,
            vertical_db: 0.0,
            microseism_db: 15.0,
            directional: Vec::new(),
            shaking: Vec::new(),
        }
    }
}

impl AmbientTable {
    /// The first key found wrong.
    pub(super) fn wrong(&self) -> Result<(), Wrong> {
        within("ambient.pressure_counts", self.pressure_counts, 1e-3, 1e6)?;
        for (i, d) in self.directional.iter().enumerate() {
            within(&format!("ambient.directional.{i}.azimuth_deg"), d.azimuth_deg, -360.0, 360.0)?;
            within(&format!("ambient.directional.{i}.level_db"), d.level_db, -200.0, 60.0)?;
        }
        for (i, s) in self.shaking.iter().enumerate() {
            within(&format!("ambient.shaking.{i}.axis_deg"), s.axis_deg, -360.0, 360.0)?;
            within(&format!("ambient.shaking.{i}.level_db"), s.level_db, -200.0, 60.0)?;
        }
        Ok(())
    }
}
