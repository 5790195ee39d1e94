//! The subcommands, one file each.

pub mod ais;
#[cfg(feature = "base")]
mod ais_match;
#[cfg(feature = "base")]
pub mod base;
#[cfg(feature = "base")]
mod base_clock;
#[cfg(feature = "base")]
mod base_configure;
#[cfg(feature = "base")]
mod base_listen;
#[cfg(feature = "mqtt")]
mod base_mqtt;
#[cfg(feature = "page")]
mod base_page;
#[cfg(feature = "base")]
mod base_screen;
#[cfg(feature = "base")]
mod base_send;
#[cfg(feature = "base")]
mod base_tokens;
#[cfg(feature = "base")]
mod base_watch;
pub mod bearing;
pub mod blob;
pub mod calls;
pub mod card;
pub mod config;
mod config_network;
#[cfg(all(unix, feature = "emulation"))]
pub mod demo;
#[cfg(feature = "base")]
pub mod export;
pub mod far;
pub mod levels;
pub mod locate;
pub mod logging;
pub mod orient;
pub mod plan;
pub mod process;
pub mod propagation;
pub mod propagation_fit;
#[cfg(feature = "experiments")]
pub mod reproduce;
#[cfg(feature = "schema")]
pub mod schema;
pub mod shaft_rate;
pub mod shell;
pub mod ships;
pub mod simulate;
pub mod station;
pub mod track;
#[cfg(all(unix, feature = "emulation"))]
pub mod twin;
#[cfg(all(unix, feature = "emulation"))]
mod twin_board;
mod watched;

/// What the command ends with, as `--help` and the manual page say it.
pub const STATUSES: &str = "Exit status:\n  \
    0        it is done\n  \
    1        it is not done, or not all of it; one line on standard error says why\n  \
    2        a mistake in the arguments; nothing was begun\n  \
    3        `reproduce`: a figure misses its bar\n  \
    128 + n  ended by the signal n: 130 for Ctrl-C";

/// Figures that miss their bars, named: the work was done, its result is not as it should be.
#[derive(Debug, thiserror::Error)]
#[error("{}{}", Self::WORDS, self.0)]
pub struct Missed(pub String);

impl Missed {
    /// Exit status of a command that ends so.
    pub const STATUS: i32 = 3;
    /// How the line on standard error begins.
    pub const WORDS: &'static str = "missed: ";
}

/// A mistake in the arguments that shows only when they are taken together, or with what they name.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Mistake(pub String);

impl Mistake {
    /// Exit status of a command that ends so, as of one whose arguments cannot be read.
    pub const STATUS: u8 = 2;
}

/// Ends with a [`Mistake`], as `bail!` ends with an error.
macro_rules! mistake {
    ($($said:tt)+) => { return Err($crate::cmd::Mistake(format!($($said)+)).into()) };
}
use mistake;

/// A time as an option gives it, RFC 3339.
fn instant(text: &str) -> Result<time::OffsetDateTime, &'static str> {
    let parsed = time::OffsetDateTime::parse(text, &time::format_description::well_known::Rfc3339);
    parsed.map_err(|_| "not a time; one like 2024-05-01T09:00:00Z was expected")
}

/// `ADDRESS:PORT` to listen at.
#[cfg(feature = "base")]
fn address(text: &str) -> Result<String, &'static str> {
    let port =
        text.rsplit_once(':').filter(|(host, _)| !host.is_empty()).map(|(_, port)| port.parse::<u16>());
    match port {
        Some(Ok(_)) => Ok(text.to_owned()),
        _ => Err("not an address; one like 127.0.0.1:8080 was expected"),
    }
}

/// Seconds, above 0.
fn seconds(text: &str) -> Result<f64, &'static str> {
    let seconds = text.parse::<f64>().ok().filter(|s| s.is_finite() && *s > 0.0);
    seconds.ok_or("not a length of time; seconds above 0 were expected")
}

/// Records as JSON Lines, or key by key for people.
fn print_records(records: &[serde_json::Value], json: bool) -> anyhow::Result<()> {
    use std::io::Write;
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    for (i, record) in records.iter().enumerate() {
        if json {
            writeln!(out, "{record}")?;
            continue;
        }
        if i > 0 {
            writeln!(out)?;
        }
        for (key, value) in record.as_object().into_iter().flatten().filter(|(k, _)| *k != "type") {
            writeln!(out, "{key:24} {value}")?;
        }
    }
    Ok(out.flush()?)
}

/// Find, follow and report vessels with underwater recorders: simulate, replay, receive, reproduce.
#[derive(clap::Parser)]
#[command(name = "seabearing", version, propagate_version = true, after_help = STATUSES)]
pub struct Cli {
    /// What is to be done.
    #[command(subcommand)]
    pub command: Subcommand,
    /// What pictures are written as: svg, png, pdf; several with commas between them
    #[arg(long, global = true, value_name = "FORMAT,..", value_delimiter = ',', default_value = "svg")]
    pub pictures: Vec<crate::plot::format::Format>,
    /// How much is said of it.
    #[command(flatten)]
    pub verbosity: clap_verbosity_flag::Verbosity<clap_verbosity_flag::InfoLevel>,
}

impl Cli {
    /// Reads the command line: program, then arguments.
    ///
    /// # Errors
    /// It is none, or asks for help.
    pub fn read(words: impl IntoIterator<Item = std::ffi::OsString>) -> Result<Self, clap::Error> {
        let mut command = signed(<Self as clap::CommandFactory>::command());
        let mut matches = command.try_get_matches_from_mut(words)?;
        <Self as clap::FromArgMatches>::from_arg_matches_mut(&mut matches).map_err(|e| e.format(&mut command))
    }
}

/// Every option takes a number with its sign (`--depth-m -5`), so that one out of its bounds is told them.
fn signed(command: clap::Command) -> clap::Command {
    let signed_option = |arg: clap::Arg| {
        let option = arg.get_long().is_some() && arg.get_action().takes_values();
        if option { arg.allow_negative_numbers(true) } else { arg }
    };
    command.mut_args(signed_option).mut_subcommands(signed)
}

/// A file that is read, or `-` for standard input.
fn input() -> impl clap::builder::TypedValueParser<Value = std::path::PathBuf> {
    use clap::builder::TypedValueParser;
    let file = |path| crate::standard_input::file(path).map_err(|e| format!("{e:#}"));
    clap::builder::PathBufValueParser::new().try_map(file)
}

/// A file that is written, or `-` for standard output.
fn output() -> impl clap::builder::TypedValueParser<Value = std::path::PathBuf> {
    use clap::builder::TypedValueParser;
    let file = |path: std::path::PathBuf| match path.as_os_str() == "-" {
        false => Ok(path),
        true if cfg!(unix) => Ok("/dev/stdout".into()),
        true => Err("standard output takes no file here: name one"),
    };
    clap::builder::PathBufValueParser::new().try_map(file)
}

/// What the command line asks for.
#[derive(clap::Subcommand)]
#[allow(clippy::large_enum_variant)]
pub enum Subcommand {
    /// Write simulated recordings, their truth and the station file
    Simulate(simulate::Args),
    /// Run the recorder core over recordings; results as JSON Lines
    Process(process::Args),
    /// Bearings from measured arrival-time differences
    Bearing(bearing::Args),
    /// Motion of a vessel from bearings of one array
    Track(track::Args),
    /// Propeller rate and speed of a vessel from the envelope of its noise
    ShaftRate(shaft_rate::Args),
    /// Directions, ranges and ways of calling whales from an ocean-bottom recording
    Calls(calls::Args),
    /// What is known of each ship that an ocean-bottom recording holds, and pages of its days
    Ships(ships::Args),
    /// Vessels too far from an ocean-bottom station to be ranged, by azimuths and tones
    Far(far::Args),
    /// Percentiles and pictures of the levels that recorders send of themselves
    Levels(levels::Args),
    /// Positions from a network of arrays
    Locate(locate::Args),
    /// Station orientation (ocean bottom: and position) from vessels of known track
    Orient(orient::Args),
    /// Run the firmware in QEMU and the host over the same input and compare their telemetry
    #[cfg(all(unix, feature = "emulation"))]
    Twin(twin::Args),
    /// The base station: receive, store, show and export telemetry
    #[cfg(feature = "base")]
    Base(base::Args),
    /// Records of a base station's store as CSV, JSON Lines, Parquet, GeoJSON or KML
    #[cfg(feature = "base")]
    Export(export::Args),
    /// A simulated pass through the emulated firmware (`cargo xtask demo`)
    #[cfg(all(unix, feature = "emulation"))]
    Demo(demo::Args),
    /// The configuration of a station as the firmware stores it
    Blob(blob::Args),
    /// SD cards of recorders: prepare them, and see what is on them
    Card(card::Args),
    /// Monte Carlo reproductions of the papers' figures and tables
    #[cfg(feature = "experiments")]
    Reproduce(reproduce::Args),
    /// The interference table of an ocean-bottom station
    Propagation(propagation::Args),
    /// What records, station files and lists of stations hold, as JSON Schema
    #[cfg(feature = "schema")]
    Schema(schema::Args),
    /// Make station files of StationXML or dataless SEED
    Station(station::Args),
    /// Check a station file
    Config(config::Args),
    /// What a deployment costs and whether it fits: work, memory, line, card, battery
    Plan(plan::Args),
    /// Statistics of vessel traffic from AIS files
    Ais(ais::Args),
    /// What a shell completes
    Completions(shell::CompletionsArgs),
    /// Manual pages
    Man(shell::ManArgs),
}

impl Subcommand {
    /// Does it.
    ///
    /// # Errors
    /// One line for a person: what is wrong, where, and what to do.
    pub fn run(self) -> anyhow::Result<()> {
        match self {
            Self::Simulate(args) => simulate::run(args),
            Self::Process(args) => process::run(args),
            Self::Bearing(args) => bearing::run(args),
            Self::Track(args) => track::run(args),
            Self::ShaftRate(args) => shaft_rate::run(args),
            Self::Calls(args) => calls::run(args),
            Self::Ships(args) => ships::run(args),
            Self::Far(args) => far::run(args),
            Self::Levels(args) => levels::run(args),
            Self::Locate(args) => locate::run(args),
            Self::Orient(args) => orient::run(args),
            #[cfg(all(unix, feature = "emulation"))]
            Self::Twin(args) => twin::run(args),
            #[cfg(feature = "base")]
            Self::Base(args) => base::run(args),
            #[cfg(feature = "base")]
            Self::Export(args) => export::run(args),
            #[cfg(all(unix, feature = "emulation"))]
            Self::Demo(args) => demo::run(args),
            Self::Blob(args) => blob::run(args),
            Self::Card(args) => card::run(args),
            #[cfg(feature = "experiments")]
            Self::Reproduce(args) => reproduce::run(args),
            Self::Propagation(args) => propagation::run(args),
            #[cfg(feature = "schema")]
            Self::Schema(args) => schema::run(args),
            Self::Station(args) => station::run(args),
            Self::Config(args) => config::run(args),
            Self::Plan(args) => plan::run(args),
            Self::Ais(args) => ais::run(args),
            Self::Completions(args) => shell::completions(args),
            Self::Man(args) => shell::man(args),
        }
    }
}

#[cfg(test)]
mod tests {
    /// What the parser of arguments asks of its commands (names that are told twice, groups that are not there): it asks
    /// only of those that run.
    #[test]
    fn every_command_is_put_together_soundly() {
        <super::Subcommand as clap::Subcommand>::augment_subcommands(clap::Command::new("seabearing"))
            .debug_assert();
    }

    #[test]
    fn numbers_with_a_sign_need_no_equals_sign() {
        let read = |words: &str| super::Cli::read(words.split(' ').map(Into::into));
        for words in [
            "seabearing locate --stations s.toml --depth-m -5 b.csv",
            "seabearing locate --stations s.toml --sigma-azimuth-deg -1.5e0 b.csv",
            "seabearing config check s.toml --max-range-m -2",
            "seabearing orient --station s.toml --track t.csv b.csv --eta -0.9 1.1",
            "seabearing shaft-rate a.wav --station s.toml --speed-curve -0.5,3.1,0.2",
        ] {
            assert!(read(words).is_ok(), "{words}: {}", read(words).err().unwrap());
        }
        // What is no option's is still none.
        assert!(read("seabearing locate --stations s.toml --json -5 b.csv").is_err());
        assert!(read("seabearing locate --stations s.toml --depth-m --json b.csv").is_err());
    }
}
