//! `seabearing locate`: positions from a network of arrays.

/// Arguments of `seabearing locate`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`locate` is not built yet")
}
