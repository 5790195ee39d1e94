//! `seabearing propagation`: the interference table of an ocean-bottom station.

/// Arguments of `seabearing propagation`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`propagation` is not built yet")
}
