//! What an operator watches: records of tracks beside AIS ([`ais`], [`matching`], [`errors`]).
//!
//! In: records as the base station publishes and stores them. Out: records again, and what other programs read.

pub mod ais;
pub mod errors;
pub mod matching;
pub mod report;
