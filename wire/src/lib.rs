//! Telemetry of a recorder: messages, frames, and a decoder that finds its feet again after damage.
//!
//! A base station needs nothing else of this project. `docs/wire.md` specifies every byte.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod configure;
pub mod frame;
pub mod guard;
pub mod hash;
pub mod health;
pub mod link;
pub mod margins;
pub mod message;
mod room;
pub mod sound;
pub mod transient;

pub use frame::{Decoder, DecoderCounters, Encoder, Received};
pub use message::*;
