//! `seabearing bearing`: bearings from measured arrival-time differences.

/// Arguments of `seabearing bearing`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`bearing` is not built yet")
}
