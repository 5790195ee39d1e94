//! `cargo xtask test`: every test, the emulated ones included, one line a step and a count at the end.

use crate::firmware::{self, EMULATED, HARDWARE, HARDWARE_LOGGING};
use crate::process::{cargo, host, run, say};
use crate::toolchain::{self, Toolchain};
use crate::{budget, panic_free, scenario};
use anyhow::{Result, bail};
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
    // What is missing is found before the long part; the host's tests run all the same.
    let mut toolchain = None;
    if !host_only {
        suite.step("set-up", || {
            toolchain = Some(toolchain::set_up()?);
            Ok(())
        });
    }
    suite.step("host tests", || {
        let mut tests = cargo();
        tests.args(["test", "--workspace", "--quiet", "--no-fail-fast"]);
        run(&mut tests, "cargo test")
    });
    match toolchain {
        Some(toolchain) => emulated(&mut suite, &toolchain),
        None if host_only => say("--host-only: the firmware was not built, and nothing was emulated"),
        None => say("without the set-up the firmware was not built, and nothing was emulated"),
    }
    for name in &suite.failed {
        say(&format!("failed: {name}"));
    }
    println!("{} passed, {} failed", suite.passed.len(), suite.failed.len());
    if suite.failed.is_empty() { Ok(()) } else { bail!("{} steps failed", suite.failed.len()) }
}

/// What needs the target's compiler and the emulator.
fn emulated(suite: &mut Suite, toolchain: &Toolchain) {
    suite.step("firmware for the emulated board", || firmware::build(toolchain, &EMULATED).map(|_| ()));
    suite.step("twin: a pass of 200 s, byte for byte", || twin("demo"));
    suite.step("twin: gaps, dead and clipped channels, byte for byte", || twin("faults"));
    suite.step("twin: six hours at the ocean bottom, byte for byte", || twin("ocean-bottom"));
    suite.step("samples over the emulated serial line; commands", || {
        let mut tests = cargo();
        tests.args(["test", "--quiet", "--package", "seabearing-tests", "--no-fail-fast"]);
        tests.args(["--test", "emulated_sample_line", "--test", "emulated_commands"]);
        tests.env("SEABEARING_EMULATED", "1");
        run(&mut tests, "emulated tests")
    });
    suite.step("panic freedom", || panic_free::check(toolchain));
    suite.step("budget of the target, as in the snapshot", || budget::check(toolchain));
    for (name, image) in [
        ("stm32h743 links within memory.x", &HARDWARE),
        ("stm32h743 with deferred logging links within memory.x", &HARDWARE_LOGGING),
    ] {
        suite.step(name, || firmware::build_hardware(toolchain, image, None).map(|_| ()));
    }
}

/// Simulates a scenario and compares the telemetry of firmware and host.
fn twin(scenario: &str) -> Result<()> {
    let recording = scenario::simulate(scenario)?;
    let mut twin = host(&["twin", "--station"]);
    twin.arg(recording.station).args(recording.files);
    run(&mut twin, "seabearing twin")
}
