//! `cargo xtask python`: the Python package built into an environment of its own, its tests, types and notebooks.

use crate::process::{find, output, run, say};
use crate::root;
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The pages that are made of notebooks, in `python/notebooks` and `docs/notebooks`.
const NOTEBOOKS: [&str; 2] = ["array-pass", "ocean-bottom-day"];

/// What is to become of the pages.
#[derive(Clone, Copy, PartialEq)]
pub enum Pages {
    /// They must be what the notebooks say now.
    Compared,
    /// They become that.
    Written,
}

/// Why nothing can be tested here, where that is so.
pub fn missing() -> Option<&'static str> {
    let new_enough = "import sys, venv; sys.exit(sys.version_info < (3, 10))";
    let python = find("python3")?;
    match output(&python, &["-c", new_enough]) {
        Some(_) => None,
        None => Some("no python3 from 3.10 on with venv"),
    }
}

/// Builds the package and tries it.
pub fn command(options: &[String]) -> Result<()> {
    match options {
        [] => check(Pages::Compared, None),
        [flag] if flag == "--bless" => check(Pages::Written, None),
        [flag] if flag == "--wheel" => wheel(),
        _ => bail!("python takes nothing, --bless or --wheel"),
    }
}

/// The tests, types and notebooks; records are compared with those of the command, where there is one.
pub fn check(pages: Pages, command: Option<&Path>) -> Result<()> {
    let bin = environment()?;
    say("building the Python package");
    let mut develop = tool(&bin, "maturin");
    develop.args(["develop", "--quiet", "--profile", "dev", "--manifest-path", "python/Cargo.toml"]);
    run(&mut develop, "maturin")?;
    let mut tests = tool(&bin, "python");
    tests.args(["-m", "pytest", "-q", "python"]);
    if let Some(command) = command {
        tests.env("SEABEARING", command);
    }
    run(&mut tests, "pytest")?;
    run(tool(&bin, "mypy").args(["--config-file", "python/pyproject.toml", "python/seabearing"]), "mypy")?;
    run(tool(&bin, "python").arg("python/bench.py"), "python/bench.py")?;
    NOTEBOOKS.iter().try_for_each(|name| notebook(&bin, name, pages))
}

/// A wheel for this machine in `target/wheels`.
fn wheel() -> Result<()> {
    let bin = environment()?;
    let mut build = tool(&bin, "maturin");
    build.args(["build", "--release", "--manifest-path", "python/Cargo.toml", "--out", "target/wheels"]);
    run(&mut build, "maturin")
}

/// The environment in `target/python` with what `python/requirements.txt` names; the folder of its programs.
fn environment() -> Result<PathBuf> {
    let folder = root().join("target/python");
    let bin = folder.join("bin");
    let wanted =
        std::fs::read_to_string(root().join("python/requirements.txt")).context("python/requirements.txt")?;
    let installed = folder.join("installed.txt");
    if std::fs::read_to_string(&installed).is_ok_and(|text| text == wanted) {
        return Ok(bin);
    }
    if let Some(why) = missing() {
        bail!("{why}");
    }
    say("installing what the Python package is tested with");
    run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&folder), "python3 -m venv")?;
    let mut install = tool(&bin, "python");
    install.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]);
    run(install.args(["--requirement", "python/requirements.txt"]), "pip")?;
    std::fs::write(installed, wanted).context("target/python/installed.txt")?;
    Ok(bin)
}

/// A program of the environment.
fn tool(bin: &Path, name: &str) -> Command {
    let mut command = Command::new(bin.join(name));
    command.env_remove("MPLBACKEND").env("VIRTUAL_ENV", bin.parent().unwrap_or(bin)).env("NO_COLOR", "1");
    command
}

/// Runs a notebook and makes a page of it.
fn notebook(bin: &Path, name: &str, pages: Pages) -> Result<()> {
    say(&format!("notebook {name}"));
    let docs = root().join("docs/notebooks");
    let folder = match pages {
        Pages::Written => docs.clone(),
        Pages::Compared => root().join("target/notebooks"),
    };
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let executed = folder.join(format!("{name}.ipynb"));
    let mut execute = tool(bin, "jupytext");
    execute.args(["--quiet", "--to", "ipynb", "--execute", "--run-path"]).arg(root());
    run(execute.arg(format!("python/notebooks/{name}.py")).arg("--output").arg(&executed), "jupytext")?;
    let mut convert = tool(bin, "jupyter");
    convert.args(["nbconvert", "--log-level", "WARN", "--to", "markdown"]).arg(&executed);
    run(convert.arg("--output-dir").arg(&folder), "nbconvert")?;
    let page = |folder: &Path| {
        let path = folder.join(format!("{name}.md"));
        std::fs::read_to_string(&path).with_context(|| path.display().to_string())
    };
    if page(&folder)? != page(&docs)? {
        bail!(
            "docs/notebooks/{name}.md is not what the notebook says now: see it, then `cargo xtask python --bless`"
        );
    }
    Ok(())
}
