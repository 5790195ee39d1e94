//! `seabearing config`: check a station file.

/// Arguments of `seabearing config`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`config` is not built yet")
}
