//! `seabearing track`: motion of a vessel from bearings of one array.

/// Arguments of `seabearing track`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`track` is not built yet")
}
