//! `seabearing orient`: station orientation from a vessel of known track.

/// Arguments of `seabearing orient`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`orient` is not built yet")
}
