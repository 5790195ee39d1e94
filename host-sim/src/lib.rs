//! Everything around the recorder core that needs an operating system: the station file, recordings, the simulator,
//! the base station, plots and reproductions. The command `seabearing` is a thin layer over this library.

#[macro_use]
pub mod console;

pub mod ais;
pub mod atomic;
pub mod base;
pub mod cmd;
pub mod csv;
pub mod demo;
pub mod emulator;
pub mod interrupt;
pub mod ocean_bottom;
pub mod orientation;
pub mod plot;
pub mod progress;
pub mod propagation;
pub mod record;
pub mod recording;
pub mod replay;
pub mod reproduce;
pub mod sample_line;
pub mod station;
pub mod twin;
pub mod world;
