//! The command `seabearing` and, under the names it uses, the libraries below it: what an operating system adds to the
//! recorder's core ([`station`], [`recording`], [`world`], …), the base station ([`base`]), the emulation of the firmware
//! ([`twin`], [`emulator`]; Unix only) and the experiments ([`reproduce`]).

#[macro_use(println)]
extern crate seabearing_host;

pub mod cmd;

#[cfg(feature = "base")]
pub use seabearing_base as base;
#[cfg(all(unix, feature = "emulation", feature = "base"))]
pub use seabearing_emulation::two_recorders;
#[cfg(all(unix, feature = "emulation"))]
pub use seabearing_emulation::{board, demo, emulator, rehearsal, sample_line, twin};
#[cfg(feature = "experiments")]
pub use seabearing_experiments as reproduce;
pub use seabearing_host::{
    ais, archive, atomic, beside, blob, bounds, card, console, course, csv, delays, geodesy, interrupt,
    levels, line, motion, ocean_bottom, orientation, plan, plot, progress, propagation, record, recording,
    replay, scenario, standard_input, station, toml_file, world,
};
