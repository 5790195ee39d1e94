//! The host side of an ocean-bottom station: its propagation table for the core, its simulator, its pictures.
//!
//! [`simulate::Simulator`] makes four-channel recordings of vessels ([`passage`]: what arrives of what [`source`]
//! radiates along a [`crate::course`]), of other sounds ([`event`]) and of the sea ([`ambient`]), as a [`scenario`] says.

pub mod ais;
pub mod ambient;
mod call_azimuths;
pub mod call_ranges;
pub mod caller_ways;
pub mod calls;
mod columns;
pub mod echoes_along;
pub mod event;
mod evidence;
pub mod far;
pub mod lateness;
pub(crate) mod mended;
pub mod mirrored;
pub mod notes;
pub mod orient;
pub mod pages;
pub mod passage;
pub mod pictures;
pub mod place;
mod presence;
pub mod pulse;
pub mod records;
pub mod run;
pub mod scenario;
pub mod ships;
pub mod simulate;
mod smooth;
pub mod source;
pub mod stages;
pub mod station;
pub mod strengths;
pub mod survey;
pub mod table;
pub mod truth;
pub mod write;
