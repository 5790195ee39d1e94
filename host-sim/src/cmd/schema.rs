//! `seabearing schema`: what records, station files, lists of stations and scenarios hold, as JSON Schema.

use crate::record;
use crate::station;
use anyhow::Result;
use seabearing_host::schema_page;
use std::io::Write;

/// Arguments of `seabearing schema`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing schema > records.schema.json\n  \
    seabearing schema station > station.schema.json\n  \
    seabearing schema records --markdown > records.md\n\n\
    An editor with a TOML language server completes and explains the keys of a station file that begins with\n  \
    #:schema ./station.schema.json")]
pub struct Args {
    /// Of what
    #[arg(value_enum, default_value_t = What::Records)]
    what: What,
    /// As a page for people instead: tables of every record and field, or of every key
    #[arg(long)]
    markdown: bool,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum What {
    /// What `process` and `base` print
    Records,
    /// A station file
    Station,
    /// A list of stations
    Network,
    /// What `simulate` plays, of either kind of recorder
    Scenario,
}

/// Prints the schema.
///
/// # Errors
/// Standard output cannot be written.
pub fn run(args: Args) -> Result<()> {
    let schema = match args.what {
        What::Records => record::schema(),
        What::Station => station::schema::station(),
        What::Network => station::schema::network(),
        What::Scenario => station::schema::scenario(),
    };
    let text = match args.what {
        _ if !args.markdown => format!("{schema:#}\n"),
        What::Records => schema_page::records(&schema),
        What::Station | What::Network => schema_page::keys(&schema),
        What::Scenario => schema_page::scenarios(&schema),
    };
    Ok(std::io::stdout().write_all(text.as_bytes())?)
}
