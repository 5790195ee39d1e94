//! `seabearing simulate`: write simulated recordings, their truth and the station file.

/// Arguments of `seabearing simulate`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`simulate` is not built yet")
}
