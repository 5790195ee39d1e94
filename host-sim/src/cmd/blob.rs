//! `seabearing blob`: the configuration of a station as the firmware stores it.

use crate::station::Station;
use crate::{atomic, blob};
use anyhow::Result;
use std::path::PathBuf;

/// Arguments of `seabearing blob`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing blob --station east.toml --out east.sbcf")]
pub struct Args {
    /// Station file
    #[arg(long, value_name = "STATION.toml", value_parser = super::input())]
    station: PathBuf,
    /// File to write (docs/firmware.md describes it)
    #[arg(long, value_name = "FILE", value_parser = super::output())]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    let station = Station::of_recorder(&args.station)?;
    atomic::write(&args.out, &blob::of(&station)?)
}
