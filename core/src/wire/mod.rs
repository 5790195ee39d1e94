//! Telemetry: messages, frames, and a decoder that finds its feet again after damage.
//!
//! `docs/wire.md` specifies every byte.

pub mod frame;
pub mod message;

pub use frame::{Decoder, DecoderCounters, Encoder, Received};
pub use message::*;
