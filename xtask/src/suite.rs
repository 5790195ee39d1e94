//! `cargo xtask test`: every test, the emulated ones included, one line a step; at the end what was skipped, and a count.

use crate::firmware::{
    self, EMULATED, EMULATED_LINK, HARDWARE, HARDWARE_CARD, HARDWARE_LINK, HARDWARE_LOGGING, HARDWARE_OBS,
};
use crate::process::{built, cargo, host, oldest, output, run, say, use_what_the_tests_built};
use crate::toolchain::{self, Toolchain};
use crate::{budget, example, panic_free, python, root, scenario};
use anyhow::{Context, Result, bail};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Runs steps and counts them; a failed step does not keep the others from running.
struct Suite {
    /// Steps that have ended: their names, and whether they passed.
    ended: Mutex<Vec<(&'static str, bool)>>,
    /// Where tests that do nothing say so (the variable is read by the tests' kit).
    skipped: PathBuf,
}

impl Suite {
    /// None has ended.
    fn new() -> Result<Self> {
        Ok(Self { ended: Mutex::default(), skipped: register()? })
    }

    fn step(&self, name: &'static str, work: impl FnOnce() -> Result<()>) {
        say(&format!("== {name}"));
        let begun = Instant::now();
        let outcome = work();
        match &outcome {
            Ok(()) => say(&format!("ok: {name} ({:.0} s)", begun.elapsed().as_secs_f64())),
            Err(error) => say(&format!("FAILED: {name}: {error:#}")),
        }
        self.ended.lock().unwrap_or_else(PoisonError::into_inner).push((name, outcome.is_ok()));
    }

    /// Takes note of what cannot be done here.
    fn skip(&self, what: &str) {
        let register = std::fs::OpenOptions::new().append(true).open(&self.skipped);
        let noted = register.and_then(|mut file| writeln!(file, "skipped {what}"));
        if noted.is_err() {
            say(&format!("skipped {what}"));
        }
    }

    /// `cargo test`, with the register of what is skipped.
    fn tests(&self, arguments: &[&str]) -> Command {
        let mut tests = cargo();
        tests
            .args(["test", "--quiet", "--no-fail-fast"])
            .args(arguments)
            .env("SEABEARING_SKIPPED", &self.skipped);
        tests
    }

    /// Says last what was skipped and failed, and counts.
    fn close(self) -> Result<()> {
        let skipped = std::fs::read_to_string(&self.skipped).unwrap_or_default();
        skipped.lines().for_each(say);
        let ended = self.ended.into_inner().unwrap_or_else(PoisonError::into_inner);
        let failed: Vec<_> = ended.iter().filter(|(_, passed)| !passed).map(|(name, _)| name).collect();
        for name in &failed {
            say(&format!("failed: {name}"));
        }
        let passed = ended.len() - failed.len();
        println!("{passed} passed, {} failed, {} skipped", failed.len(), skipped.lines().count());
        if failed.is_empty() { Ok(()) } else { bail!("{} steps failed", failed.len()) }
    }
}

/// `cargo xtask test`.
pub fn command(options: &[String]) -> Result<()> {
    let options: Vec<&str> = options.iter().map(String::as_str).collect();
    let host_only = match options[..] {
        [] => false,
        ["--host-only"] => true,
        ["--random", times] => return random(times),
        _ => bail!("test takes --host-only, --random N or nothing"),
    };
    let suite = Suite::new()?;
    let skipped = suite.skipped.clone();
    suite.step("the oldest compiler promised", || oldest(&skipped));
    // What is missing is found before the long part; the host's tests run all the same.
    let mut toolchain = None;
    if !host_only {
        suite.step("set-up", || {
            toolchain::broker();
            toolchain = Some(toolchain::set_up()?);
            Ok(())
        });
    }
    let mut build = suite.tests(&["--workspace", "--no-run"]);
    let mut tests = suite.tests(&["--workspace"]);
    if toolchain.is_some() {
        tests.env("SEABEARING_EMULATED", "later");
    }
    suite.step("host tests", || {
        run(&mut build, "building the tests")?;
        use_what_the_tests_built();
        run(&mut tests, "cargo test")
    });
    let python = || match python::missing() {
        None => suite.step("the Python package: tests, types, notebooks", || {
            python::check(python::Pages::Compared, built())
        }),
        Some(why) => suite.skip(&format!("the Python package: {why}")),
    };
    match &toolchain {
        Some(toolchain) => {
            suite.step("firmware for the emulated board", || {
                firmware::build(toolchain, &EMULATED).map(|_| ())
            });
            // Either side keeps one core busy, and neither waits for the clock.
            std::thread::scope(|scope| {
                scope.spawn(|| modelled(&suite, toolchain));
                python();
                twins(&suite);
            });
            emulated(&suite, toolchain);
        }
        None => {
            python();
            let why = if host_only { "--host-only" } else { "without the set-up" };
            say(&format!("{why}: the firmware was not built, and nothing was emulated"));
        }
    }
    suite.close()
}

/// The register of what is skipped, empty.
fn register() -> Result<PathBuf> {
    let path = root().join("target/skipped.txt");
    std::fs::create_dir_all(root().join("target")).context("target")?;
    std::fs::write(&path, "").context("target/skipped.txt")?;
    Ok(path)
}

/// The property tests with other cases than always, so many times as many. What fails is kept as a case.
fn random(times: &str) -> Result<()> {
    if !times.parse::<u32>().is_ok_and(|n| (1..=1_000_000).contains(&n)) {
        bail!("--random {times}: how many times the usual number of cases, 1 to 1000000");
    }
    let suite = Suite::new()?;
    let ran = run(suite.tests(&["--workspace"]).env("SEABEARING_RANDOM", times), "cargo test");
    let cases =
        output(Path::new("git"), &["ls-files", "--others", "--modified", "--exclude-standard", "*.cases"]);
    for file in cases.iter().flat_map(|files| files.lines()) {
        say(&format!("counterexamples in {file}: mend the cause and commit them"));
    }
    ran
}

/// The emulated board beside the host.
fn twins(suite: &Suite) {
    suite.step("twin: a pass of 200 s, byte for byte", || twin("demo"));
    suite.step("twin: gaps, dead and clipped channels, byte for byte", || twin("faults"));
    suite.step("twin: six hours at the ocean bottom, byte for byte", || twin("ocean-bottom"));
}

/// The images for hardware beside the host.
fn modelled(suite: &Suite, toolchain: &Toolchain) {
    suite.step("twin: the hardware image with its drivers on the modelled board, byte for byte", || {
        hardware_twin(toolchain)
    });
    suite.step("twin: the ocean-bottom image with its drivers on the modelled board, byte for byte", || {
        ocean_bottom_twin(toolchain)
    });
}

/// What else needs the target's compiler and the emulator, and what both twins were built for.
fn emulated(suite: &Suite, toolchain: &Toolchain) {
    let names = ["--workspace", "--test", "emulated_sample_line", "--test", "emulated_commands"];
    let mut tests = suite.tests(&names);
    tests.env("SEABEARING_EMULATED", "now");
    suite.step("samples over the emulated serial line; commands", || run(&mut tests, "emulated tests"));
    suite.step(
        "two recorders, a pulled line, resets, a killed base station: every record once, with its UTC",
        || two_recorders(toolchain),
    );
    suite.step("the core's example, on the target as on the host", || example::check(toolchain));
    suite.step("panic freedom", || panic_free::check(toolchain));
    suite.step("budget of the target, as in the snapshot", || budget::check(toolchain));
    // The images of the steps before.
    let mut tests = rehearsal(suite);
    suite.step("the hardware images rehearsed: every fault named, no wrong record", || {
        run(&mut tests, "the rehearsal")
    });
    suite.step("stm32h743 with deferred logging links within memory.x", || {
        firmware::build_hardware(toolchain, &HARDWARE_LOGGING, None, None).map(|_| ())
    });
}

/// `cargo xtask rehearse`: the two steps about the image for hardware, alone; with `bless` the table is written anew.
pub fn rehearse(bless: bool) -> Result<()> {
    let toolchain = Toolchain::find()?;
    let suite = Suite::new()?;
    firmware::build(&toolchain, &EMULATED)?;
    hardware_twin(&toolchain)?;
    ocean_bottom_twin(&toolchain)?;
    let mut tests = rehearsal(&suite);
    if bless {
        tests.env("INSTA_UPDATE", "always");
    }
    run(&mut tests, "the rehearsal")
}

/// The tests that keep the tables of faults.
fn rehearsal(suite: &Suite) -> Command {
    let names = ["--test", "rehearsal", "--test", "rehearsal_ocean_bottom"];
    let mut tests = suite.tests(&[&["--package", "seabearing-emulation"], &names[..]].concat());
    tests.env("SEABEARING_EMULATED", "now");
    tests
}

/// The image for hardware, with the short scenario's station, on the modelled board at plausible costs; then the emulated
/// board's image in the same interpreter.
fn hardware_twin(toolchain: &Toolchain) -> Result<()> {
    let recording = scenario::simulate("short-pass")?;
    let station = recording.station.to_string_lossy().into_owned();
    for image in [&HARDWARE, &HARDWARE_LINK, &HARDWARE_CARD] {
        firmware::build_hardware(toolchain, image, Some(&station), None)?;
    }
    let boards: [&[&str]; 2] =
        [&["--board", "stm32h743", "--cycles", "2.5", "--register-cycles", "30"], &["--emulator", "model"]];
    for board in boards {
        let mut twin = host(&["twin", "--station"]);
        twin.arg(&recording.station).args(board).args(&recording.files);
        run(&mut twin, "seabearing twin")?;
    }
    configured_by_probe(&recording)
}

/// The image for hardware with records in flash, and beside it another configuration than its own, as a probe writes it.
fn configured_by_probe(recording: &scenario::Recording) -> Result<()> {
    let station = recording.station.with_file_name("station-by-probe.toml");
    let text = std::fs::read_to_string(&recording.station).context("the scenario's station file")?;
    std::fs::write(&station, text.replace("[array]\n", "[array]\nstep_s = 1.0\n"))
        .context("another station file")?;
    let places = root().join("target/firmware/places.bin");
    let blob = ["blob", "--places", "--station"];
    run(host(&blob).arg(&station).arg("--out").arg(&places), "seabearing blob")?;
    let mut twin = host(&["twin", "--board", "stm32h743", "--link", "--places"]);
    twin.arg(places).arg("--station").arg(station).args(&recording.files);
    run(&mut twin, "seabearing twin")
}

/// The ocean-bottom image over the first minutes of its scenario.
fn ocean_bottom_twin(toolchain: &Toolchain) -> Result<()> {
    let recording = scenario::simulate("ocean-bottom")?;
    let station = recording.station.to_string_lossy().into_owned();
    firmware::build_hardware(toolchain, &HARDWARE_OBS, Some(&station), None)?;
    let mut twin = host(&["twin", "--station"]);
    twin.arg(&recording.station).args(OCEAN_BOTTOM).args(&recording.files);
    run(&mut twin, "seabearing twin")
}

/// How that board runs: three minutes and some, at plausible costs.
const OCEAN_BOTTOM: [&str; 8] =
    ["--board", "stm32h743", "--seconds", "200", "--cycles", "2.5", "--register-cycles", "30"];

/// `demo --two` in a fifth of its time, which fails where its account does not balance.
fn two_recorders(toolchain: &Toolchain) -> Result<()> {
    firmware::build(toolchain, &EMULATED_LINK)?;
    run(&mut host(&["demo", "--two", "--shorter", "5"]), "seabearing demo --two")
}

/// Simulates a scenario and compares the telemetry of firmware and host.
fn twin(scenario: &str) -> Result<()> {
    let recording = scenario::simulate(scenario)?;
    let mut twin = host(&["twin", "--station"]);
    twin.arg(recording.station).args(recording.files);
    run(&mut twin, "seabearing twin")
}
