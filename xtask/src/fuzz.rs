//! `cargo xtask fuzz`: hostile input, mutated at random or guided by coverage.
//!
//! Mutated inputs are the work of `seabearing reproduce fuzz`. Guided ones are that of libFuzzer: the targets of `fuzz/` are
//! built by the same stable compiler, which is asked for LLVM's coverage counters, and linked with libFuzzer's runtime, which a
//! C++ compiler builds. What is found is kept in `fuzz/cases/TARGET/`; committed, every test run tries it.

use crate::process::{cargo, find, output, run, say};
use crate::root;
use anyhow::{Context, Result, bail};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;

/// Targets, as their programs are called.
const TARGETS: [&str; 6] = ["link", "sample_line", "base_station", "messages", "station_file", "store"];
/// Counters of edges and tables of what they stand for, and compared values, so that a checksum does not stop the fuzzer: what
/// cargo-fuzz asks for. There is no address sanitizer, which a stable compiler lacks; the code under test has no `unsafe`.
const COVERAGE: &str = "-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-compares";
/// An input that takes so many seconds hangs.
const HANG_S: u32 = 10;
/// Memory that a target may use, MB.
const MOST_MB: u32 = 1024;

/// What was asked for.
struct Asked<'a> {
    inputs: Option<&'a str>,
    guided_s: Option<u32>,
    target: Option<&'a str>,
}

impl<'a> Asked<'a> {
    fn of(options: &'a [String]) -> Result<Self> {
        let mut asked = Self { inputs: None, guided_s: None, target: None };
        let (pairs, []) = options.as_chunks::<2>() else {
            bail!("fuzz takes --inputs N or --guided SECONDS, and --target NAME");
        };
        for [option, value] in pairs {
            match option.as_str() {
                "--inputs" => asked.inputs = Some(value),
                "--guided" => {
                    let seconds = value.parse().ok().filter(|s| (1..=1_000_000).contains(s));
                    asked.guided_s =
                        Some(seconds.with_context(|| format!("--guided {value}: seconds, 1 to 1000000"))?);
                }
                "--target" if TARGETS.contains(&value.as_str()) => asked.target = Some(value),
                "--target" => bail!("no target `{value}`; there are: {}", TARGETS.join(", ")),
                _ => bail!("fuzz takes --inputs N or --guided SECONDS, and --target NAME"),
            }
        }
        if asked.inputs.is_some() && asked.guided_s.is_some() {
            bail!("fuzz takes --inputs or --guided, not both");
        }
        Ok(asked)
    }
}

/// `cargo xtask fuzz`.
pub fn command(options: &[String]) -> Result<()> {
    let asked = Asked::of(options)?;
    match asked.guided_s {
        Some(seconds) => guided(seconds, asked.target),
        None => mutated(&asked),
    }
}

/// `seabearing reproduce fuzz`, built for speed and with checks of overflow.
fn mutated(asked: &Asked<'_>) -> Result<()> {
    let mut command = cargo();
    command.args(["run", "--quiet", "--profile", "fuzz", "--package", "seabearing", "--no-default-features"]);
    command.args(["--features", "experiments", "--", "reproduce", "fuzz"]);
    if let Some(n) = asked.inputs {
        command.args(["--runs", n]);
    }
    if let Some(name) = asked.target {
        command.env("SEABEARING_FUZZ_TARGET", name);
    }
    run(&mut command, "hostile input")
}

/// Builds the targets and runs each for so many seconds, as many at once as there are cores.
fn guided(seconds: u32, only: Option<&str>) -> Result<()> {
    let programs = build()?;
    let left = Mutex::new(TARGETS.into_iter().filter(|name| only.is_none_or(|only| only == *name)));
    let failed = Mutex::new(Vec::new());
    let next = || left.lock().ok().and_then(|mut left| left.next());
    let work = || {
        while let Some(name) = next() {
            say(&format!("{name}: {seconds} s"));
            match one(&programs, name, seconds) {
                Ok(summary) => say(&format!("{name}: {summary}; no panic, no hang")),
                Err(error) => {
                    say(&format!("FAILED: {name}: {error:#}"));
                    failed.lock().iter_mut().for_each(|failed| failed.push(name));
                }
            }
        }
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| (0..cores).for_each(|_| drop(scope.spawn(work))));
    match failed.into_inner() {
        Ok(failed) if failed.is_empty() => Ok(()),
        Ok(failed) => bail!("guided fuzzing failed: {}", failed.join(", ")),
        Err(_) => bail!("guided fuzzing has panicked"),
    }
}

/// Builds the targets; the folder of their programs.
fn build() -> Result<PathBuf> {
    let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".into());
    if find(&compiler).is_none() && !Path::new(&compiler).is_file() {
        bail!(
            "no C++ compiler `{compiler}`, which builds the fuzzer's runtime: `apt-get install g++`, or name one in CXX"
        );
    }
    let fetch =
        cargo().args(["fetch", "--quiet", "--locked"]).current_dir(root()).output().context("cargo fetch")?;
    if !fetch.status.success() {
        let said = String::from_utf8_lossy(&fetch.stderr);
        let why = said.lines().rfind(|l| !l.trim().is_empty()).unwrap_or("no reason given").trim();
        bail!("the crates of the guided fuzzer (libfuzzer-sys) cannot be had: {why}");
    }
    let host = host()?;
    let folder = root().join("target/guided");
    say("building the targets with coverage counters");
    let mut build = cargo();
    // For a named target cargo leaves its own flags away from what runs while building.
    build.args([
        "build",
        "--quiet",
        "--profile",
        "fuzz",
        "--package",
        "seabearing-fuzz",
        "--features",
        "guided",
    ]);
    build.args(["--bins", "--target", &host, "--target-dir"]).arg(&folder).env("RUSTFLAGS", COVERAGE);
    run(&mut build, "building the guided targets")?;
    Ok(folder.join(host).join("fuzz"))
}

/// The host, as the compiler calls it.
fn host() -> Result<String> {
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let said = output(Path::new(&rustc), &["-vV"]).unwrap_or_default();
    let host = said.lines().find_map(|l| l.strip_prefix("host: "));
    host.map(str::to_owned).context("rustc -vV names no host")
}

/// Runs a target; what it did. Its inputs stay in `target/guided/corpus`, from which the next run goes on.
fn one(programs: &Path, name: &str, seconds: u32) -> Result<String> {
    let folder = root().join("target/guided");
    let place =
        |of: PathBuf| std::fs::create_dir_all(&of).with_context(|| of.display().to_string()).map(|()| of);
    let (corpus, seeds) = (place(folder.join("corpus").join(name))?, place(folder.join("seeds").join(name))?);
    let cases = place(root().join("fuzz/cases").join(name))?;
    let log = folder.join(format!("{name}.log"));
    let status = Command::new(programs.join(name))
        .args([format!("-max_total_time={seconds}"), format!("-timeout={HANG_S}")])
        .args([format!("-rss_limit_mb={MOST_MB}"), format!("-artifact_prefix={}/", cases.display())])
        .args(["-print_final_stats=1", "-verbosity=1"])
        .args([&corpus, &seeds, &cases])
        .env("SEABEARING_FUZZ_SEEDS", &seeds)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(File::create(&log).with_context(|| log.display().to_string())?)
        .status()
        .context("cannot run it")?;
    // An empty folder is none that git keeps.
    let _ = std::fs::remove_dir(&cases);
    let said = String::from_utf8_lossy(&std::fs::read(&log)?).into_owned();
    if !status.success() {
        let kept = said.lines().find_map(|l| l.split_once("Test unit written to ")).map(|(_, path)| path);
        let kept = kept.map_or(String::new(), |path| {
            format!("; the input is kept as {path}: mend the cause and commit it")
        });
        let why = said.lines().find(|l| l.contains("panicked at") || l.contains("ERROR: libFuzzer"));
        bail!("{} ({status}; {}){kept}", why.unwrap_or("it failed"), log.display());
    }
    Ok(summary(&said))
}

/// Inputs and coverage, as the fuzzer says at its end.
fn summary(said: &str) -> String {
    let after = |line: &str, key: &str| {
        let (_, rest) = line.split_once(key)?;
        rest.split_whitespace().next().map(str::to_owned)
    };
    let last = |key: &str| said.lines().rev().find_map(|l| after(l, key)).unwrap_or_else(|| "?".into());
    format!(
        "{} inputs, {} edges, corpus {}",
        last("stat::number_of_executed_units:"),
        last(" cov: "),
        last(" corp: ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_is_checked() {
        let of = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(|w| (*w).to_owned()).collect();
            Asked::of(&words).map(|a| (a.inputs.map(str::to_owned), a.guided_s, a.target.map(str::to_owned)))
        };
        assert_eq!(of(&[]).unwrap(), (None, None, None));
        let guided = of(&["--guided", "60", "--target", "store"]).unwrap();
        assert_eq!(guided, (None, Some(60), Some("store".into())));
        for wrong in [
            &["--guided"][..],
            &["--guided", "0"],
            &["--target", "nothing"],
            &["--inputs", "5", "--guided", "5"],
            &["--what", "5"],
        ] {
            assert!(of(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn the_summary_is_what_the_fuzzer_said_last() {
        let said = "#2\tINITED cov: 10 ft: 11 corp: 1/1b\n#900\tDONE   cov: 120 ft: 300 corp: 40/2Kb lim: 4096\n\
                    stat::number_of_executed_units: 900\n";
        assert_eq!(summary(said), "900 inputs, 120 edges, corpus 40/2Kb");
    }
}
