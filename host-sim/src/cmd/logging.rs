//! What is said on standard error: one line each, as much of it as `-q` and `-v` ask for.
//!
//! Errors end a command or a part of it; warnings are what was left out or is odd; information is what is being done.

use clap_verbosity_flag::{InfoLevel, Verbosity};
use std::io::Write;

/// Begins; once.
pub fn begin(verbosity: &Verbosity<InfoLevel>) {
    let line = |to: &mut env_logger::fmt::Formatter, record: &log::Record<'_>| {
        writeln!(to, "seabearing: {}", crate::standard_input::named(&record.args().to_string()))
    };
    // What libraries say is for those who write them.
    let level = verbosity.log_level_filter();
    let begun = env_logger::Builder::new().filter_module("seabearing", level).format(line).try_init();
    // Another logger is there where a test has one.
    let _ = begun;
}
