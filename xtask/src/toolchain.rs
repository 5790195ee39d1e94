//! Set-up: a compiler for the Cortex-M7 and an emulator, found or installed, each with one line that says why.
//!
//! Three ways to a compiler, in this order: the target is there; rustup can add it; a compiler with the sources of
//! `core` builds it (Debian's `rustc-web` with `rust-web-src` and `lld`).

use crate::process::{find, output, run, say};
use crate::root;
use anyhow::{Context, Result, bail};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The firmware's target: Cortex-M with a floating-point unit.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// Oldest compiler the project builds with: minor version of 1.x (`rust-version` of the workspace).
const OLDEST_MINOR: u32 = 89;
/// Debian's packages that give a compiler for the target, and the emulator's.
const DEBIAN_COMPILER: [&str; 4] = ["rustc-web", "cargo-web", "rust-web-src", "lld"];
const DEBIAN_EMULATOR: &str = "qemu-system-arm";

/// How to compile for the target.
pub enum Toolchain {
    /// Plain cargo: the target is in its sysroot.
    Target,
    /// This compiler builds `core` from its own sources.
    FromSource {
        /// The compiler.
        rustc: PathBuf,
    },
}

impl Toolchain {
    /// Finds a way to compile, installing what is missing.
    pub fn find() -> Result<Self> {
        if has_target() {
            return Ok(Self::Target);
        }
        if let Some(rustup) = find("rustup") {
            say(&format!(
                "installing the Rust target {TARGET} with rustup: the firmware runs on a Cortex-M7"
            ));
            let added = run(Command::new(rustup).args(["target", "add", TARGET]), "rustup target add");
            if added.is_ok() && has_target() {
                return Ok(Self::Target);
            }
            say("rustup could not add it; looking for a compiler that has the sources of `core`");
        }
        if let (Some(rustc), Some(_)) = (compiler_with_sources(), find("ld.lld")) {
            return Ok(Self::FromSource { rustc });
        }
        install(&DEBIAN_COMPILER, &format!("a compiler that can build `core` for {TARGET}, and its linker"))
            .map_err(|e| e.context(no_compiler()))?;
        match (compiler_with_sources(), find("ld.lld")) {
            (Some(rustc), Some(_)) => Ok(Self::FromSource { rustc }),
            _ => bail!(no_compiler()),
        }
    }

    /// `cargo SUBCOMMAND` for the target, with the firmware's own target folder.
    pub fn cargo(&self, subcommand: &str) -> Command {
        let mut command = match self {
            Self::Target => crate::process::cargo(),
            Self::FromSource { rustc } => {
                let beside = rustc.with_file_name("cargo");
                let mut c = if beside.is_file() { Command::new(beside) } else { crate::process::cargo() };
                c.env("RUSTC", rustc)
                    .env("RUSTC_BOOTSTRAP", "1")
                    .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "ld.lld")
                    .env_remove("RUSTUP_TOOLCHAIN");
                c
            }
        };
        // Flags from outside would replace those of `.cargo/config.toml`.
        command.env_remove("RUSTFLAGS").env_remove("CARGO_ENCODED_RUSTFLAGS");
        command.arg(subcommand);
        if let Self::FromSource { .. } = self {
            command.arg("-Zbuild-std=core");
        }
        command.args(["--target", TARGET, "--target-dir"]).arg(root().join("target/firmware"));
        command
    }
}

/// A compiler and the emulator.
pub fn set_up() -> Result<Toolchain> {
    let toolchain = Toolchain::find()?;
    emulator()?;
    match &toolchain {
        Toolchain::Target => say(&format!("ready: cargo with the target {TARGET}, {DEBIAN_EMULATOR}")),
        Toolchain::FromSource { rustc } => {
            say(&format!("ready: {} building `core` from source, {DEBIAN_EMULATOR}", rustc.display()));
        }
    }
    Ok(toolchain)
}

/// Makes sure the emulator is there.
pub fn emulator() -> Result<()> {
    if find("qemu-system-arm").is_some() {
        return Ok(());
    }
    const NONE: &str = "no qemu-system-arm: install QEMU's ARM system emulator (Debian: apt-get install qemu-system-arm; \
         macOS: brew install qemu); `cargo xtask demo` and `test` do without where told --host-only";
    install(&[DEBIAN_EMULATOR], "QEMU, to run the firmware without hardware").context(NONE)?;
    match find("qemu-system-arm") {
        Some(_) => Ok(()),
        None => bail!("{NONE}: apt-get said it installed it, but it is not on the search path"),
    }
}

/// An MQTT broker for the tests that need a real one; without it they are skipped, and say so.
pub fn broker() {
    const NAME: &str = "mosquitto";
    // Debian has it where only the administrator looks.
    if find(NAME).is_some() || Path::new("/usr/sbin").join(NAME).is_file() {
        return;
    }
    if let Err(e) = install(&[NAME], "an MQTT broker for tests on the loopback interface") {
        say(&format!("no {NAME}, tests with a broker are skipped: {e:#}"));
    }
}

fn no_compiler() -> String {
    format!(
        "no compiler for {TARGET}: `rustup target add {TARGET}`, or on Debian `apt-get install --no-install-recommends \
         {}`; `cargo xtask demo` and `test` do without where told --host-only",
        DEBIAN_COMPILER.join(" ")
    )
}

fn has_target() -> bool {
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    output(Path::new(&rustc), &["--print", "sysroot"])
        .is_some_and(|s| Path::new(&s).join("lib/rustlib").join(TARGET).join("lib").is_dir())
}

/// A recent compiler whose sysroot holds the sources of `core`.
fn compiler_with_sources() -> Option<PathBuf> {
    [PathBuf::from("/usr/bin/rustc")].into_iter().chain(find("rustc")).find(|rustc| {
        let sources = output(rustc, &["--print", "sysroot"])
            .is_some_and(|s| Path::new(&s).join("lib/rustlib/src/rust/library/core/src").is_dir());
        sources && minor_version(rustc).is_some_and(|minor| minor >= OLDEST_MINOR)
    })
}

/// The y of `rustc 1.y.z`.
fn minor_version(rustc: &Path) -> Option<u32> {
    output(rustc, &["--version"])?.split_whitespace().nth(1)?.split('.').nth(1)?.parse().ok()
}

/// Installs Debian packages that are missing.
fn install(packages: &[&str], why: &str) -> Result<()> {
    if find("apt-get").is_none() {
        bail!("this is no Debian system, so nothing was installed");
    }
    let installed = |p: &&&str| {
        output(Path::new("dpkg-query"), &["-W", "-f=${Status}", p]).is_some_and(|s| s.ends_with(" installed"))
    };
    let missing: Vec<&str> = packages.iter().filter(|p| !installed(p)).copied().collect();
    if missing.is_empty() {
        bail!("{} installed, and still not usable", packages.join(", "));
    }
    say(&format!("installing {} with apt-get: {why}", missing.join(" ")));
    let update = || run(apt()?.args(["-q", "update"]), "apt-get update");
    let get = || {
        let arguments = ["-q", "-y", "install", "--no-install-recommends"];
        run(apt()?.args(arguments).args(&missing), "apt-get install")
    };
    if !known(&missing) {
        update()?;
        return get();
    }
    get().or_else(|_| {
        say("apt-get could not; its lists of packages may be old: fetching them and trying once more");
        update()?;
        get()
    })
}

/// Whether apt's lists name the packages.
fn known(packages: &[&str]) -> bool {
    output(Path::new("apt-cache"), &[&["show", "--no-all-versions"], packages].concat()).is_some()
}

/// `apt-get` as root.
fn apt() -> Result<Command> {
    let mut command = if output(Path::new("id"), &["-u"]).as_deref() == Some("0") {
        Command::new("apt-get")
    } else {
        let sudo = find("sudo").context("not root and no sudo: run the apt-get line as root")?;
        let mut c = Command::new(sudo);
        if !std::io::stdin().is_terminal() {
            c.arg("--non-interactive");
        }
        c.arg("apt-get");
        c
    };
    command.env("DEBIAN_FRONTEND", "noninteractive");
    Ok(command)
}
