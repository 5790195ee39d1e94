//! `seabearing demo`: a simulated pass through the emulated firmware, with plots; `cargo xtask demo` runs it.

use crate::demo;
use crate::emulator::{self, Emulator, SamplePath};
use anyhow::Result;
use std::path::PathBuf;

/// Arguments of `seabearing demo`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  cargo xtask demo")]
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
    let firmware = emulator::firmware(args.firmware)?;
    let emulator = Emulator {
        firmware,
        count_instructions: false,
        samples: SamplePath::File,
        engine: emulator::Engine::Qemu,
    };
    demo::run(&args.scenario, &args.out, Some(&emulator))
}
