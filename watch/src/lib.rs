//! What an operator watches: tracks beside AIS ([`ais`], [`ais_live`], [`matching`], [`errors`]), alarms ([`alarms`]), what chart plotters
//! ([`nmea`]) and monitors ([`metrics`]) read; with the feature `terminal` a view of all of it on a terminal, with `mqtt` the
//! way over a broker to other base stations. A vessel that several stations hear is one vessel to all of them ([`vessels`]).
//!
//! In: records as the base station publishes and stores them. Out: records again, and what other programs read.

pub mod ais;
pub mod ais_live;
pub mod alarms;
pub mod before;
pub mod errors;
pub mod matching;
pub mod metrics;
#[cfg(feature = "mqtt")]
pub mod mqtt;
pub mod nmea;
pub mod report;
#[cfg(feature = "terminal")]
pub mod terminal;
pub mod vessels;
