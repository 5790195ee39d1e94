//! `cargo xtask test`: every test, the emulated ones included, one line a step and a count at the end.

use crate::firmware::{self, EMULATED};
use crate::process::{cargo, run, say};
use crate::{budget, panic_free, root, toolchain};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Runs steps and counts them; a failed step does not keep the others from running.
struct Suite {
    passed: Vec<&'static str>,
    failed: Vec<String>,
}

impl Suite {
    fn step(&mut self, name: &'static str, work: impl FnOnce() -> Result<()>) {
        say(&format!("== {name}"));
        let begun = Instant::now();
        match work() {
            Ok(()) => {
                say(&format!("ok: {name} ({:.0} s)", begun.elapsed().as_secs_f64()));
                self.passed.push(name);
            }
            Err(error) => {
                say(&format!("FAILED: {name}: {error:#}"));
                self.failed.push(name.to_owned());
            }
        }
    }
}

/// `cargo xtask test`.
pub fn command(options: &[String]) -> Result<()> {
    let host_only = match options {
        [] => false,
        [flag] if flag == "--host-only" => true,
        _ => bail!("test takes --host-only or nothing"),
    };
    let mut suite = Suite { passed: Vec::new(), failed: Vec::new() };
    suite.step("host tests", || {
        let mut tests = cargo();
        tests.args(["test", "--workspace", "--quiet"]);
        run(&mut tests, "cargo test")
    });
    suite.step("the command, optimised", || {
        run(cargo().args(["build", "--release", "--quiet", "--package", "seabearing"]), "building seabearing")
    });
    if host_only {
        say("--host-only: the firmware was not built, and nothing was emulated");
    } else {
        emulated(&mut suite)?;
    }
    for name in &suite.failed {
        say(&format!("failed: {name}"));
    }
    println!("{} passed, {} failed", suite.passed.len(), suite.failed.len());
    if suite.failed.is_empty() { Ok(()) } else { bail!("{} steps failed", suite.failed.len()) }
}

/// What needs the target's compiler and the emulator.
fn emulated(suite: &mut Suite) -> Result<()> {
    let toolchain = toolchain::set_up()?;
    suite.step("firmware for the emulated board", || firmware::build(&toolchain, &EMULATED).map(|_| ()));
    suite.step("twin: a pass of 200 s, byte for byte", || twin("demo"));
    suite.step("twin: gaps, dead and clipped channels, byte for byte", || twin("faults"));
    suite.step("twin: six hours at the ocean bottom, byte for byte", ocean_bottom);
    suite.step("panic freedom", || panic_free::check(&toolchain));
    suite.step("budget of the target, as in the snapshot", || budget::check(&toolchain));
    suite.step("stm32h743 links within memory.x", || firmware::build_hardware(&toolchain, None).map(|_| ()));
    Ok(())
}

/// Traces the ocean-bottom station's table, which its scenario needs, and compares the twins over it.
fn ocean_bottom() -> Result<()> {
    let mut trace = seabearing();
    trace.args([
        "propagation",
        "--profile",
        "scenarios/ocean-profile.csv",
        "--depth-m",
        "4340",
        "--rows",
        "720",
    ]);
    trace.args(["--out", "out/ocean-table.toml"]);
    std::fs::create_dir_all(root().join("out"))?;
    run(&mut trace, "seabearing propagation")?;
    twin("ocean-bottom")
}

/// Simulates a scenario and compares the telemetry of firmware and host.
fn twin(scenario: &str) -> Result<()> {
    let out = root().join("target/suite").join(scenario);
    let _ = std::fs::remove_dir_all(&out);
    let mut simulate = seabearing();
    simulate
        .arg("simulate")
        .arg(root().join("scenarios").join(format!("{scenario}.toml")))
        .arg("--out")
        .arg(&out);
    run(&mut simulate, "seabearing simulate")?;
    let mut twin = seabearing();
    twin.arg("twin").arg("--station").arg(out.join("station.toml")).args(recordings(&out)?);
    run(&mut twin, "seabearing twin")
}

/// The recordings in a folder.
fn recordings(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?
        .flatten()
        .map(|f| f.path())
        .filter(|p| p.extension().is_some_and(|e| e == "wav" || e == "mseed"))
        .collect();
    files.sort();
    if files.is_empty() {
        bail!("no recording in {}", folder.display());
    }
    Ok(files)
}

/// The optimised command.
fn seabearing() -> Command {
    Command::new(root().join("target/release/seabearing"))
}
