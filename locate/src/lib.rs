//! Estimators that need more than one recorder, or a vessel whose track is known, or all bearings at once.
//!
//! They run where telemetry arrives, not in the recorder; like the recorder's core they allocate nothing, so that a
//! microcontroller may run them too (one batch fit is held to a budget on the target).
//!
//! - [`motion`]: one vessel's motion from all bearings of one array, by maximum likelihood, and its bounds (paper M);
//! - [`delays`]: bearings from measured arrival-time differences;
//! - [`network`]: positions from several arrays, at one instant or over time (paper N);
//! - [`orient`]: which way a station looks, from vessels of known track (paper L);
//! - [`mod@line`]: bearings of a uniform line array (paper L);
//! - [`mod@between`]: values between the rows of a table in order of time.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod between;
pub mod delays;
pub mod line;
pub mod motion;
pub mod network;
pub mod orient;

// What both crates speak of, under the names it has in the recorder's.
use seabearing_core::{angle, block, geometry, kit, math};
