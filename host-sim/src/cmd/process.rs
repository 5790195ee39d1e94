//! `seabearing process`: run the recorder core over recordings; results as JSON Lines.

/// Arguments of `seabearing process`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("`process` is not built yet")
}
