//! Networks of stations and their orientation, on the host: files in, records out.
//!
//! The estimators are the core's (`seabearing_locate::network`, `orient`, `line`); here is what reads their input.

pub mod compact;
mod compact_doubts;
pub mod known_vessel;
pub mod lasting;
pub mod measured_delays;
pub mod mend;
pub mod network_file;
pub mod over_time;
pub mod record_file;
pub mod sets;
pub mod track_file;
pub mod unchecked;
pub mod way;
