//! `seabearing station`: station files from what data centres keep.

use super::mistake;
use crate::station::described::Wanted;
use crate::station::import;
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};

/// Arguments of `seabearing station`.
#[derive(clap::Args)]
#[command(arg_required_else_help = true)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    /// A station file, and the propagation table beside it, from StationXML or dataless SEED
    Import(ImportArgs),
}

/// Arguments of `seabearing station import`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  seabearing station import network.xml --station RR03 --out rr03.toml\n  \
    seabearing station import network.xml --network YV --station RR03 --propagation table.toml --out rr03.toml\n\n\
    Codes, orientation, position, rate, sensitivities and responses are those of the XML. Without --propagation a table is traced through \
    a typical subtropical sea of the station's depth; `seabearing propagation` makes one of the sea's own profile."
)]
struct ImportArgs {
    /// StationXML or dataless SEED of one or more stations
    #[arg(value_parser = super::input())]
    xml: PathBuf,
    /// Network code
    #[arg(long, value_name = "CODE")]
    network: Option<String>,
    /// Station code
    #[arg(long, value_name = "CODE")]
    station: Option<String>,
    /// Location code, -- for the empty one
    #[arg(long, value_name = "CODE", allow_hyphen_values = true)]
    location: Option<String>,
    /// UTC at which the station recorded, where the XML tells several epochs (by default the latest counts)
    #[arg(long, value_name = "TIME", value_parser = super::instant)]
    at: Option<time::OffsetDateTime>,
    /// Number of the station
    #[arg(long, default_value_t = 1)]
    id: u16,
    /// Propagation table of the station
    #[arg(long, value_name = "TABLE.toml", value_parser = super::input())]
    propagation: Option<PathBuf>,
    /// Station file to write, or - for standard output
    #[arg(long, value_name = "STATION.toml", value_parser = super::output())]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    let Action::Import(args) = args.action;
    if args.out == Path::new("/dev/stdout") && args.propagation.is_none() {
        mistake!("--out - needs --propagation: a table made here is a file beside the station file");
    }
    let wanted =
        Wanted { network: args.network, station: args.station, location: args.location, at: args.at };
    let found = import::read(&args.xml, &wanted)?;
    let [station] = &found[..] else {
        let codes: Vec<&str> = found.iter().map(|d| d.code.as_str()).collect();
        bail!(
            "{}: several stations, choose by --network and --station: {}",
            args.xml.display(),
            codes.join(", ")
        );
    };
    import::write(station, args.id, args.propagation.as_deref(), &args.out)
}
