//! The firmware in an emulator, its twin on the host over the same samples, and the demonstration. Unix only: samples and
//! telemetry go through sockets and pipes of the file system.
#![cfg(unix)]

#[macro_use(print, println)]
extern crate seabearing_host;

pub mod board;
pub mod demo;
pub mod emulator;
pub mod rehearsal;
pub mod sample_line;
pub mod twin;
#[cfg(feature = "base")]
pub mod two_recorders;

use seabearing_host::{angle, beside, blob, csv, plot, record, world};
