//! Running other programs.

use crate::firmware::IMAGES;
use crate::root;
use anyhow::{Context, Result, bail};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;

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

/// The command as the workspace's tests have built it, where they have.
static BUILT: OnceLock<PathBuf> = OnceLock::new();

/// From now on [`host`] is the command that `cargo test --workspace` has just built: built by itself its dependencies have
/// other features, and everything would be compiled once more.
pub fn use_what_the_tests_built() {
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
    let command = target.join("debug").join(format!("seabearing{}", std::env::consts::EXE_SUFFIX));
    if command.is_file() {
        BUILT.get_or_init(|| command);
    }
}

/// The command that [`use_what_the_tests_built`] found.
pub fn built() -> Option<&'static Path> {
    BUILT.get().map(PathBuf::as_path)
}

/// The command `seabearing` of this checkout, built if need be.
pub fn host(arguments: &[&str]) -> Command {
    match BUILT.get() {
        Some(built) => {
            let mut command = Command::new(built);
            command.args(arguments).current_dir(root());
            command
        }
        None => host_with(&[], arguments),
    }
}

/// The command without the experiments, which take a third of the time to build and which a demonstration does not need.
pub const WITHOUT_EXPERIMENTS: [&str; 3] = ["--no-default-features", "--features", "emulation"];
/// The same with the base station.
pub const WITH_BASE: [&str; 3] = ["--no-default-features", "--features", "emulation,base"];
/// The same with the base station's page.
pub const WITH_PAGE: [&str; 3] = ["--no-default-features", "--features", "emulation,page"];

/// The command with other features.
pub fn host_with(features: &[&str], arguments: &[&str]) -> Command {
    let mut command = cargo();
    command.args(["run", "--quiet", "--package", "seabearing"]).args(features).arg("--");
    command.args(arguments).current_dir(root());
    command
}

/// A program that runs beside this one; it ends when this is dropped.
pub struct Beside(Child);

impl Beside {
    /// Begins to build what [`host_with`] runs: linking the firmware keeps one core busy, this the other.
    pub fn build(features: &[&str]) -> Result<Self> {
        let mut command = cargo();
        command.args(["build", "--quiet", "--package", "seabearing"]).args(features);
        let child = command.current_dir(root()).stdin(Stdio::null()).spawn().context("cargo build")?;
        Ok(Self(child))
    }

    /// Waits for its end.
    pub fn join(mut self) -> Result<()> {
        match self.0.wait()? {
            status if status.success() => Ok(()),
            status => bail!("building the host's command failed ({status})"),
        }
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        // Nothing to do where it has ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Format, lints and documentation, warnings as errors.
pub fn check() -> Result<()> {
    say("format");
    run(cargo().args(["fmt", "--all", "--check"]), "format")?;
    say("lints");
    let lints = ["clippy", "--workspace", "--all-targets", "--quiet", "--", "-D", "warnings"];
    run(cargo().args(lints), "lints")?;
    say("lints of the guided fuzzer's targets");
    let targets = [
        "clippy",
        "--quiet",
        "--package",
        "seabearing-fuzz",
        "--features",
        "targets",
        "--bins",
        "--",
        "-D",
        "warnings",
    ];
    run(cargo().args(targets), "lints of the guided fuzzer's targets")?;
    board_lints()?;
    features_alone()?;
    say("documentation");
    let doc = ["doc", "--workspace", "--no-deps", "--document-private-items", "--quiet", "--keep-going"];
    run(cargo().args(doc).env("RUSTDOCFLAGS", "-D warnings"), "documentation")
}

/// What a user may leave out: every feature of the core alone and none, the command without experiments and emulation.
const PARTS: [(&str, &str); 6] = [
    ("seabearing-core", ""),
    ("seabearing-core", "array"),
    ("seabearing-core", "obs"),
    ("seabearing", ""),
    ("seabearing", "experiments"),
    ("seabearing", "base"),
];

/// Each part compiles by itself, warnings as errors.
fn features_alone() -> Result<()> {
    for (package, features) in PARTS {
        say(&format!("{package} with {} alone", if features.is_empty() { "no feature" } else { features }));
        let mut clippy = cargo();
        clippy.args([
            "clippy",
            "--quiet",
            "--package",
            package,
            "--no-default-features",
            "--features",
            features,
        ]);
        run(clippy.args(["--", "-D", "warnings"]), &format!("{package}, features `{features}`"))?;
    }
    Ok(())
}

/// The oldest compiler that the manifests promise, as rustup names it.
const OLDEST: &str = concat!(env!("CARGO_PKG_RUST_VERSION"), ".0");

/// The core, the wire format and the estimators compile with the oldest compiler promised, where rustup has it; else that
/// stands in the register of what is skipped.
pub fn oldest(skipped: &Path) -> Result<()> {
    let installed = find("rustup").and_then(|rustup| output(&rustup, &["toolchain", "list"]));
    if !installed.is_some_and(|list| list.lines().any(|l| l.starts_with(OLDEST))) {
        let line =
            format!("skipped compiler {OLDEST}, the oldest promised: `rustup toolchain install {OLDEST}`\n");
        let mut register = std::fs::OpenOptions::new().append(true).open(skipped)?;
        return Ok(register.write_all(line.as_bytes())?);
    }
    say(&format!("compiler {OLDEST}"));
    let mut check = Command::new("rustup");
    check.args([
        "run",
        OLDEST,
        "cargo",
        "check",
        "--quiet",
        "--package",
        "seabearing-core",
        "--package",
        "seabearing-wire",
    ]);
    check.args(["--package", "seabearing-locate", "--target-dir"]).arg(root().join("target/oldest"));
    run(check.env_remove("RUSTUP_TOOLCHAIN").env_remove("CARGO").env_remove("RUSTC"), "the oldest compiler")
}

/// What is made of the firmware package besides its images: kind of target, name, features.
const BESIDES: [(&str, &str, &str); 2] =
    [("--bin", "panic-free", "panic-free,array,obs"), ("--example", "bearings", "example")];

/// Lints of the boards' own code. Checked for the host's processor, for which the lint tool has a core library; what is
/// particular to the target is behind calls.
fn board_lints() -> Result<()> {
    let folder = root().join("target/lint");
    std::fs::create_dir_all(&folder).context("target/lint")?;
    // The hardware image holds a configuration; any will do here.
    let blob = folder.join("station.sbcf");
    std::fs::write(&blob, b"").context("target/lint/station.sbcf")?;
    let images = IMAGES.iter().map(|image| ("--bin", image.bin, image.features));
    for (kind, name, features) in images.chain(BESIDES) {
        say(&format!("lints of the firmware: {features}"));
        let mut clippy = cargo();
        clippy.args(["clippy", "--quiet", "--package", "seabearing-firmware", "--profile", "firmware"]);
        clippy.args(["--no-default-features", "--features", features, "--lib", kind, name, "--target-dir"]);
        clippy.arg(&folder).args(["--", "-D", "warnings"]);
        clippy.env("SEABEARING_STATION_BLOB", &blob).env("SEABEARING_KEY", &blob);
        run(&mut clippy, "lints of the firmware")?;
    }
    Ok(())
}
