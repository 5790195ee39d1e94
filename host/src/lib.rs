//! Everything around the recorder's core that needs an operating system and is no experiment: the station file,
//! recordings, simulators, replay, propagation tables, records and pictures.

#[macro_use]
pub mod console;

pub mod ais;
pub mod angle;
pub mod archive;
pub mod atomic;
pub mod beside;
pub mod blob;
pub mod bounds;
pub mod card;
pub mod course;
pub mod csv;
pub mod delays;
pub mod geodesy;
pub mod interrupt;
pub mod levels;
pub mod line;
pub mod motion;
pub mod ocean_bottom;
pub mod orientation;
pub mod plan;
pub mod plot;
pub mod progress;
pub mod propagation;
pub mod record;
pub mod recording;
pub mod replay;
pub mod scenario;
#[cfg(feature = "schema")]
pub mod schema_page;
pub mod standard_input;
pub mod station;
pub mod toml_file;
pub mod world;
