//! `seabearing ais`: statistics of vessel traffic from AIS files.

/// Arguments of `seabearing ais`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`ais` is not built yet")
}
