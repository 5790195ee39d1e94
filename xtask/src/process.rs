//! Running other programs.

use crate::root;
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// One line about what is going on.
pub fn say(line: &str) {
    println!("xtask: {line}");
}

/// Runs to the end; `what` names it where it fails.
pub fn run(command: &mut Command, what: &str) -> Result<()> {
    let program = command.get_program().to_string_lossy().into_owned();
    let status = command
        .current_dir(root())
        .stdin(Stdio::null())
        .status()
        .with_context(|| format!("{what}: cannot run {program}"))?;
    if !status.success() {
        bail!("{what} failed ({program}: {status})");
    }
    Ok(())
}

/// What a program prints, or nothing if it cannot be run or fails.
pub fn output(program: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).stdin(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Where a program is, by the search path.
pub fn find(program: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).map(|dir| dir.join(program)).find(|p| p.is_file())
}

/// The cargo that runs this task, for the host.
pub fn cargo() -> Command {
    Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// The command `seabearing` of this checkout, built if need be.
pub fn host(arguments: &[&str]) -> Command {
    let mut command = cargo();
    command.args(["run", "--quiet", "--package", "seabearing", "--"]).args(arguments).current_dir(root());
    command
}

/// Format, lints and documentation, warnings as errors.
pub fn check() -> Result<()> {
    say("format");
    run(cargo().args(["fmt", "--all", "--check"]), "format")?;
    say("lints");
    let lints = ["clippy", "--workspace", "--all-targets", "--quiet", "--", "-D", "warnings"];
    run(cargo().args(lints), "lints")?;
    say("documentation");
    let doc = ["doc", "--workspace", "--no-deps", "--document-private-items", "--quiet"];
    run(cargo().args(doc).env("RUSTDOCFLAGS", "-D warnings"), "documentation")
}
