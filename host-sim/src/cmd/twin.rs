//! `seabearing twin`: run the firmware in QEMU and the host over the same input and compare their telemetry.

/// Arguments of `seabearing twin`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`twin` is not built yet")
}
