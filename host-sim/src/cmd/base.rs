//! `seabearing base`: the base station: receive, store, show and export telemetry.

/// Arguments of `seabearing base`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`base` is not built yet")
}
