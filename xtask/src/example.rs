//! The core's example, which shows how others use the crate: on the host and on the target it prints the same.

use crate::firmware::cargo_path;
use crate::process::{cargo, say};
use crate::toolchain::{self, Toolchain};
use anyhow::{Context, Result, bail};
use std::process::{Command, Stdio};

/// Runs both and compares them.
pub fn check(toolchain: &Toolchain) -> Result<()> {
    toolchain::emulator()?;
    say("the core's example, for the target");
    let mut build = toolchain.cargo("build");
    build.args(["--quiet", "--package", "seabearing-firmware", "--profile", "firmware"]);
    build.args(["--no-default-features", "--features", "example", "--example", "bearings"]);
    printed(&mut build, "building the example")?;
    let mut board = Command::new("qemu-system-arm");
    board
        .args(["-machine", "mps2-an500", "-nographic", "-semihosting", "-kernel"])
        .arg(cargo_path("examples/bearings"));
    let there = printed(&mut board, "the example on the emulated board")?;
    let mut run = cargo();
    run.args(["run", "--quiet", "--package", "seabearing-core", "--example", "bearings"]);
    let here = printed(&mut run, "the example on the host")?;
    if here.is_empty() || here != there {
        bail!("the example prints on the host\n{here}and on the target\n{there}");
    }
    say(&format!(
        "the example printed the same {} lines on the host and on the target",
        here.lines().count()
    ));
    Ok(())
}

/// What a program prints.
fn printed(command: &mut Command, what: &str) -> Result<String> {
    let output = command.stdin(Stdio::null()).output().with_context(|| what.to_owned())?;
    if !output.status.success() {
        bail!("{what} failed:\n{}", String::from_utf8_lossy(&output.stderr));
    }
    Ok(String::from_utf8_lossy(&output.stdout).replace('\r', ""))
}
