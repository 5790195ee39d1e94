//! `seabearing demo`: a simulated pass through the emulated firmware, with plots; `cargo xtask demo` runs it.

use crate::demo;
use crate::emulator::{self, Emulator, SamplePath};
use anyhow::Result;
use std::path::PathBuf;

/// What builds the firmware of recorders whose records wait for the base station.
#[cfg(feature = "base")]
const LINK: &str = "cargo xtask build-firmware --board link";

/// Arguments of `seabearing demo`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  cargo xtask demo\n  cargo xtask demo --no-page\n  cargo xtask demo --two"
)]
pub struct Args {
    /// Scenario with one vessel
    #[arg(long, value_name = "SCENARIO.toml", default_value = "scenarios/demo.toml")]
    scenario: PathBuf,
    /// Folder for the plots
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    out: PathBuf,
    /// Firmware image [default: target/firmware/images/mps2-an500.elf of the checkout]
    #[arg(long, value_name = "ELF")]
    firmware: Option<PathBuf>,
    /// Run the host's twin instead of the firmware
    #[arg(long)]
    host_only: bool,
    /// Do not show two live recorders on the base station's page at the end
    #[cfg(feature = "page")]
    #[arg(long)]
    no_page: bool,
    /// Two recorders and a base station instead: a line is pulled, the power goes, the base station is killed, and every
    /// record is accounted for
    #[cfg(feature = "base")]
    #[arg(long, conflicts_with_all = ["host_only", "out"])]
    two: bool,
    /// With --two: all times are divided by this
    #[cfg(feature = "base")]
    #[arg(long, value_name = "N", requires = "two", default_value_t = 1.0, value_parser = shorter)]
    shorter: f64,
}

#[cfg(feature = "base")]
fn shorter(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|n| (1.0..=10.0).contains(n)).ok_or_else(|| "a number from 1 to 10".into())
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    if args.host_only {
        println!("host only: the host's twin stands in for the emulated firmware");
        return demo::run(&args.scenario, &args.out, None);
    }
    #[cfg(feature = "base")]
    if args.two {
        let firmware = emulator::image(args.firmware, "mps2-an500-link.elf", LINK)?;
        let command = std::env::current_exe()?;
        return crate::two_recorders::run(&args.scenario, &in_qemu(firmware), &command, args.shorter);
    }
    let firmware = emulator::firmware(args.firmware)?;
    demo::run(&args.scenario, &args.out, Some(&in_qemu(firmware)))?;
    #[cfg(feature = "page")]
    if !args.no_page {
        let firmware = emulator::image(None, "mps2-an500-link.elf", LINK)?;
        crate::two_recorders::show(&args.scenario, &in_qemu(firmware), &std::env::current_exe()?)?;
    }
    Ok(())
}

fn in_qemu(firmware: PathBuf) -> Emulator {
    Emulator {
        firmware,
        count_instructions: false,
        samples: SamplePath::File,
        engine: emulator::Engine::Qemu,
    }
}
