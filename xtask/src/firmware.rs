//! Building firmware images. Finished ones are copied to `target/firmware/images`.

use crate::elf::Elf;
use crate::process::{run, say};
use crate::root;
use crate::toolchain::{TARGET, Toolchain};
use anyhow::{Context, Result, bail};
use std::path::PathBuf;

/// One image.
pub struct Image {
    /// Its file, without folder.
    pub name: &'static str,
    /// The binary it is made from.
    pub bin: &'static str,
    /// Features of the firmware package.
    pub features: &'static str,
}

/// The emulated board with everything.
pub const EMULATED: Image =
    Image { name: "mps2-an500.elf", bin: "mps2-an500", features: "mps2-an500,array,obs" };
/// The emulated board as an array recorder only, for its budget.
pub const EMULATED_ARRAY: Image =
    Image { name: "mps2-an500-array.elf", bin: "mps2-an500", features: "mps2-an500,array" };
/// The emulated board as an ocean-bottom recorder only, for its budget.
pub const EMULATED_OBS: Image =
    Image { name: "mps2-an500-obs.elf", bin: "mps2-an500", features: "mps2-an500,obs" };

/// Where an image is once built.
pub fn path(image: &Image) -> PathBuf {
    root().join("target/firmware/images").join(image.name)
}

/// Where cargo leaves a binary.
pub fn cargo_path(bin: &str) -> PathBuf {
    root().join("target/firmware").join(TARGET).join("firmware").join(bin)
}

/// Builds an image.
pub fn build(toolchain: &Toolchain, image: &Image) -> Result<PathBuf> {
    say(&format!("building firmware {} ({})", image.name, image.features));
    let mut cargo = toolchain.cargo("build");
    cargo.args(["--quiet", "--package", "seabearing-firmware", "--profile", "firmware"]);
    cargo.args(["--features", image.features, "--bin", image.bin]);
    run(&mut cargo, &format!("building {}", image.name))?;
    let to = path(image);
    std::fs::create_dir_all(root().join("target/firmware/images")).context("target/firmware/images")?;
    std::fs::copy(cargo_path(image.bin), &to).with_context(|| format!("copying {}", image.name))?;
    Ok(to)
}

/// `cargo xtask build-firmware`.
pub fn command(options: &[String]) -> Result<()> {
    let images: &[&Image] = match options {
        [] => &[&EMULATED],
        [flag, board] if flag == "--board" => match board.as_str() {
            "mps2-an500" => &[&EMULATED],
            "all" => &[&EMULATED, &EMULATED_ARRAY, &EMULATED_OBS],
            other => bail!("there is no board `{other}`: mps2-an500, stm32h743 or all"),
        },
        _ => bail!("build-firmware takes --board mps2-an500, stm32h743 or all"),
    };
    let toolchain = Toolchain::find()?;
    for image in images {
        let path = build(&toolchain, image)?;
        let elf = Elf::read(&path)?;
        let (flash, statics) = (elf.flash(), elf.statics());
        let path = path.strip_prefix(root()).unwrap_or(&path).display();
        say(&format!("built {path}: {flash} bytes of flash, {statics} of statics"));
    }
    Ok(())
}
