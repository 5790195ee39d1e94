//! `seabearing schema`: what the records hold, as JSON Schema.

use crate::record::schema;
use anyhow::Result;
use std::io::Write;

/// Arguments of `seabearing schema`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing schema > records.schema.json")]
pub struct Args {}

/// Prints the schema.
///
/// # Errors
/// Standard output cannot be written.
pub fn run(_: Args) -> Result<()> {
    Ok(writeln!(std::io::stdout(), "{:#}", schema())?)
}
