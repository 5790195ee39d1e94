//! The recorder core of seabearing: from four-channel samples to bearings, ranges and tracks, in fixed memory.
//!
//! The same code runs in the firmware and on the host, and gives the same bytes on both. It performs no I/O,
//! reads no clock, allocates nothing and cannot panic. Samples come in as [`block::Block`]s; records leave as
//! [`wire::Message`]s through a sink the caller supplies.
//!
//! Modules, in the order data flows:
#![no_std]

#[cfg(test)]
extern crate std;

pub mod angle;
pub mod kit;
pub mod math;

pub mod config;
pub mod config_blob;
pub mod geometry;

pub mod block;
pub mod intake;
#[doc(inline)]
pub use seabearing_wire::health;

#[cfg(feature = "array")]
pub mod array;
pub mod demon;
pub mod levels;
#[cfg(feature = "obs")]
pub mod obs;

pub mod motion;
pub mod passage;
pub mod traffic;

#[doc(inline)]
pub use seabearing_wire as wire;

/// Names and texts of the configuration are its strings.
pub use heapless;

#[cfg(any(feature = "array", feature = "obs"))]
mod density;
pub mod keeper;
pub mod outlet;
pub mod port;
#[cfg(any(feature = "array", feature = "obs"))]
pub mod recorder;
pub mod run;
pub mod sample_line;
pub mod sbraw;
pub mod schedule;
#[cfg(feature = "array")]
mod slot;
pub mod slots;
#[cfg(any(feature = "array", feature = "obs"))]
mod slow_levels;
pub mod snippet;
pub mod utc;
mod version;
pub mod wait;
