//! `seabearing blob`: the configuration of a station as the firmware stores it.

use crate::station::Station;
use crate::{atomic, blob};
use anyhow::Result;
use std::path::PathBuf;

/// Arguments of `seabearing blob`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  seabearing blob --station east.toml --out east.sbcf\n  seabearing blob --station east.toml --places --out places.bin"
)]
pub struct Args {
    /// Station file
    #[arg(long, value_name = "STATION.toml", value_parser = super::input())]
    station: PathBuf,
    /// File to write (docs/firmware.md describes it)
    #[arg(long, value_name = "FILE", value_parser = super::output())]
    out: PathBuf,
    /// Write both places for a configuration of the STM32H743's flash (256 KiB, for a probe to write at 0x08100000)
    #[arg(long)]
    places: bool,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    let station = Station::of_recorder(&args.station)?;
    let bytes = if args.places { blob::places(&station)? } else { blob::of(&station)? };
    atomic::write(&args.out, &bytes)
}
