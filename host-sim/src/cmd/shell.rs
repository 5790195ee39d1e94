//! `seabearing completions` and `seabearing man`: what a shell and `man` know of the command.

use super::Cli;
use anyhow::{Context, Result};
use clap::CommandFactory;
use std::path::PathBuf;

/// Arguments of `seabearing completions`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing completions bash > seabearing.bash\n\n\
    Where bash looks for it: /usr/share/bash-completion/completions/seabearing, or the same under ~/.local/share.")]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: clap_complete::Shell,
}

/// Arguments of `seabearing man`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing man man1")]
pub struct ManArgs {
    /// Folder to write the pages into, one a subcommand
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

/// Prints a completion script.
///
/// # Errors
/// Standard output cannot be written.
pub fn completions(args: CompletionsArgs) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "seabearing", &mut script);
    Ok(std::io::Write::write_all(&mut std::io::stdout(), &script)?)
}

/// Writes the manual pages.
///
/// # Errors
/// The folder cannot be written.
pub fn man(args: ManArgs) -> Result<()> {
    let cannot = || format!("cannot write {}", args.folder.display());
    std::fs::create_dir_all(&args.folder).with_context(cannot)?;
    clap_mangen::generate_to(Cli::command(), &args.folder).with_context(cannot)
}
