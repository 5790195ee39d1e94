//! The host's speed beside that of another revision: the same recordings through both, in turn, in processor time.

use crate::process::{cargo, find, run, say};
use crate::{root, scenario};
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Recordings that both process: an array's passage of 200 s; six hours of an ocean-bottom station; a day of it, three
/// vessels.
const SCENARIOS: [&str; 3] = ["demo", "ocean-bottom", "ocean-bottom-day"];
/// Runs of each, taken in turn; the least is compared.
const RUNS: usize = 3;

/// Builds both with optimisation, and prints the processor time of each and the ratio.
pub fn command(revision: &str) -> Result<()> {
    let before = Checkout::of(revision)?;
    let (new, old) = (built(&root())?, built(&before.folder)?);
    for name in SCENARIOS {
        let recording = scenario::simulate(name)?;
        let (mut least_new, mut least_old) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..RUNS {
            least_old = least_old.min(seconds(&old, &recording)?);
            least_new = least_new.min(seconds(&new, &recording)?);
        }
        let ratio = least_new / least_old;
        say(&format!(
            "{name}: {least_new:.2} s of processor time, {least_old:.2} s at {revision}, ratio {ratio:.2}"
        ));
    }
    Ok(())
}

/// A revision beside this one; gone when dropped.
struct Checkout {
    git: PathBuf,
    folder: PathBuf,
}

impl Checkout {
    fn of(revision: &str) -> Result<Self> {
        let git = find("git").context("git is not installed")?;
        let folder = root().join("target/pace");
        drop(Self { git: git.clone(), folder: folder.clone() });
        let mut add = Command::new(&git);
        run(add.args(["worktree", "add", "--quiet", "--detach"]).arg(&folder).arg(revision), "git worktree")?;
        Ok(Self { git, folder })
    }
}

impl Drop for Checkout {
    fn drop(&mut self) {
        // Nothing to do where there is none.
        let mut remove = Command::new(&self.git);
        remove.args(["worktree", "remove", "--force"]).arg(&self.folder).current_dir(root());
        let _ = remove.stderr(Stdio::null()).status();
    }
}

/// The command of a checkout, with optimisation.
fn built(folder: &Path) -> Result<PathBuf> {
    say(&format!("building {}", folder.display()));
    let target = root().join("target/pace-build");
    let mut build = cargo();
    build.args(["build", "--quiet", "--release", "--package", "seabearing", "--manifest-path"]);
    run(build.arg(folder.join("Cargo.toml")).arg("--target-dir").arg(&target), "building the command")?;
    let to = target.join(if folder == root() { "new" } else { "old" });
    std::fs::copy(target.join("release/seabearing"), &to).context("target/pace-build")?;
    Ok(to)
}

/// Processor seconds of a program over a recording.
fn seconds(program: &Path, recording: &scenario::Recording) -> Result<f64> {
    let mut timed = Command::new("bash");
    timed.args(["-c", "TIMEFORMAT='%U'; time \"$@\" > /dev/null", "bash"]).arg(program);
    timed.args(["process", "--station"]).arg(&recording.station).args(&recording.files);
    let output = timed.env("RAYON_NUM_THREADS", "1").output().context("bash")?;
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let last = said.lines().last().and_then(|l| l.trim().parse().ok());
    match last {
        Some(seconds) if output.status.success() => Ok(seconds),
        _ => bail!("{} failed:\n{said}", program.display()),
    }
}
