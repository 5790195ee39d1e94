//! The command `seabearing`.

use clap::error::ErrorKind;
use seabearing::cmd::{Cli, Missed, Mistake, logging};
use seabearing::standard_input;
use std::io::Write;

fn main() -> std::process::ExitCode {
    // Standard input may be read while the arguments are.
    seabearing::interrupt::watch();
    let status = match Cli::read(std::env::args_os()) {
        Ok(cli) => run(cli),
        Err(error) => usage(&error),
    };
    standard_input::forget();
    status
}

fn run(cli: Cli) -> std::process::ExitCode {
    logging::begin(&cli.verbosity);
    seabearing::plot::format::write_as(&cli.pictures);
    match cli.command.run() {
        Ok(()) => std::process::ExitCode::SUCCESS,
        // The reader of our output has gone (`seabearing … | head`): nothing is wrong.
        Err(error) if is_broken_pipe(&error) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            // Standard error may be gone too; then there is nobody left to tell.
            let _ = writeln!(std::io::stderr(), "seabearing: {}", one_line(&error));
            if error.is::<Missed>() {
                return std::process::ExitCode::from(Missed::STATUS as u8);
            }
            if error.is::<Mistake>() {
                return std::process::ExitCode::from(Mistake::STATUS);
            }
            std::process::ExitCode::FAILURE
        }
    }
}

/// Help and version as they are; a mistake in the arguments on one line, exit code 2.
fn usage(error: &clap::Error) -> std::process::ExitCode {
    if !error.use_stderr() || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        let _ = error.print();
        return std::process::ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
    }
    let text = error.render().to_string();
    let reason =
        text.split("\n\nUsage:").next().unwrap_or(&text).split("\n\nFor more").next().unwrap_or(&text);
    let paragraphs: Vec<String> = reason
        .trim_start_matches("error:")
        .split("\n\n")
        .map(|p| p.split_whitespace().collect::<Vec<_>>().join(" "))
        .collect();
    let _ = writeln!(std::io::stderr(), "seabearing: {}; `--help` shows how", paragraphs.join("; "));
    std::process::ExitCode::from(2)
}

/// The whole chain of causes on one line.
fn one_line(error: &anyhow::Error) -> String {
    let mut parts: Vec<String> = Vec::new();
    for cause in error.chain() {
        let text = cause.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        if !parts.iter().any(|p| p.contains(&text)) {
            parts.push(text);
        }
    }
    standard_input::named(&parts.join(": "))
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let kind = match cause.downcast_ref::<std::io::Error>() {
            Some(e) => Some(e.kind()),
            None => cause.downcast_ref::<serde_json::Error>().and_then(serde_json::Error::io_error_kind),
        };
        kind == Some(std::io::ErrorKind::BrokenPipe)
    })
}
