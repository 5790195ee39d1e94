//! Panic freedom, proved by linking: the recorder with a panic handler that calls a function defined nowhere.

use crate::elf::Elf;
use crate::firmware::cargo_path;
use crate::process::{find, output, say};
use crate::root;
use crate::toolchain::Toolchain;
use anyhow::{Context, Result, bail};
use std::process::Stdio;

/// The binary that is linked.
const BIN: &str = "panic-free";
/// The function defined nowhere.
const UNDEFINED: &str = "a_panic_is_reachable";
/// Parts of the mangled names of the library's own panicking functions, whose callers are the sites.
const MACHINERY: [&str; 7] = [
    "9panicking",
    "slice_index_fail",
    "unwrap_failed",
    "expect_failed",
    "len_mismatch_fail",
    "rust_begin_unwind",
    "_index_fail",
];

/// Links the image, and one with a planted panic, which must not link.
pub fn check(toolchain: &Toolchain) -> Result<()> {
    say("panic freedom: linking the recorder with a panic handler that cannot be linked");
    let recorder = link(toolchain, "panic-free,array,obs", &[])?;
    if let Err(reason) = recorder {
        if !reason.contains(UNDEFINED) {
            bail!("the panic-free image does not build:\n{reason}");
        }
        let sites = sites(toolchain)?;
        bail!("panics are reachable in the recorder, from {} places:\n{}", sites.len(), sites.join("\n"));
    }
    match link(toolchain, "panic-free,array,obs,seeded-panic", &[])? {
        Ok(()) => bail!("an image with a planted panic links: this check notices nothing"),
        Err(reason) if reason.contains(UNDEFINED) => {}
        Err(reason) => bail!("the image with a planted panic fails for another reason:\n{reason}"),
    }
    say("panic freedom: the recorder links; with a planted panic it does not");
    Ok(())
}

/// Builds the image; what the linker says where it fails.
fn link(toolchain: &Toolchain, features: &str, linker: &[&str]) -> Result<Result<(), String>> {
    let mut cargo = toolchain.cargo("rustc");
    cargo.args(["--quiet", "--package", "seabearing-firmware", "--profile", "firmware"]);
    cargo.args(["--no-default-features", "--features", features, "--bin", BIN, "--"]);
    for argument in linker {
        cargo.args(["-C", &format!("link-arg={argument}")]);
    }
    let output = cargo.current_dir(root()).stdin(Stdio::null()).output().context("cargo rustc")?;
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    Ok(if output.status.success() { Ok(()) } else { Err(said) })
}

/// Where panics are called from: links again with the missing function ignored and looks who calls the machinery.
fn sites(toolchain: &Toolchain) -> Result<Vec<String>> {
    let ignoring = ["--unresolved-symbols=ignore-all"];
    if let Err(reason) = link(toolchain, "panic-free,array,obs", &ignoring)? {
        bail!("cannot link even with the missing function ignored:\n{reason}");
    }
    let path = cargo_path(BIN);
    let elf = Elf::read(&path)?;
    let symbols = elf.symbols();
    let machinery = |name: &str| MACHINERY.iter().any(|m| name.contains(m));
    let mut found = Vec::new();
    for call in elf.calls() {
        let Some(to) = symbols.iter().find(|s| s.function && s.address == call.to && machinery(&s.name))
        else {
            continue;
        };
        let inside =
            |s: &&crate::elf::Symbol| s.function && (s.address..s.address + s.size).contains(&call.from);
        let from = symbols.iter().find(inside).map_or("?", |s| s.name.as_str());
        if machinery(from) {
            continue;
        }
        let address = format!("{:#x}", call.from);
        let lines = find("addr2line")
            .and_then(|tool| output(&tool, &["-f", "-C", "-i", "-s", "-e", path.to_str()?, &address]));
        let place = lines.map_or(from.to_owned(), |l| l.replace('\n', " "));
        found.push(format!("  {address} -> {}: {place}", to.name));
    }
    Ok(found)
}
