//! Bearings from arrival-time differences that someone else measured.
//!
//! In: six delays a set. Out: a direction with its covariance and whether it is believed: `tdoa` solves one set,
//! `continuity` says what the sets before make of it.

pub mod continuity;
pub mod tdoa;

use seabearing_core::array::{report, wavefront};
