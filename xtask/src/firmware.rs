//! Building firmware images. Finished ones are copied to `target/firmware/images`.

use crate::elf::Elf;
use crate::process::{find, host, run, say};
use crate::root;
use crate::scenario;
use crate::toolchain::{TARGET, Toolchain};
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

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
/// The emulated board as an array recorder whose records wait until the base station has them.
pub const EMULATED_LINK: Image =
    Image { name: "mps2-an500-link.elf", bin: "mps2-an500", features: "mps2-an500,array,link" };
/// One batch motion fit on the emulated board, for its budget.
pub const EMULATED_FIT: Image =
    Image { name: "mps2-an500-motion-fit.elf", bin: "motion-fit", features: "motion-fit" };

/// The tracks of eight vessels on the emulated board, for their budget.
pub const EMULATED_TRACKS: Image = Image { name: "mps2-an500-tracks.elf", bin: "tracks", features: "tracks" };

/// A configuration taken twice on the emulated board, for the stack it needs.
pub const EMULATED_TWICE: Image =
    Image { name: "mps2-an500-configure-twice.elf", bin: "configure-twice", features: "configure-twice" };

/// The hardware board with everything.
pub const HARDWARE: Image =
    Image { name: "stm32h743.elf", bin: "stm32h743", features: "stm32h743,array,obs" };
/// The same, whose records wait in flash until the base station has them.
pub const HARDWARE_LINK: Image =
    Image { name: "stm32h743-link.elf", bin: "stm32h743", features: "stm32h743,array,obs,link" };
/// The same board with an ocean-bottom recorder's converters.
pub const HARDWARE_OBS: Image = Image { name: "stm32h743-obs.elf", bin: "stm32h743", features: "seismic" };
/// An array recorder that writes its sound to a card too: the image to be deployed.
pub const HARDWARE_CARD: Image =
    Image { name: "stm32h743-card.elf", bin: "stm32h743", features: "stm32h743,array,card" };
/// The hardware board with deferred logging of its library over the probe.
pub const HARDWARE_LOGGING: Image =
    Image { name: "stm32h743-defmt.elf", bin: "stm32h743", features: "stm32h743,array,obs,defmt" };
/// Every image.
pub const IMAGES: [Image; 12] = [
    EMULATED,
    EMULATED_ARRAY,
    EMULATED_OBS,
    EMULATED_LINK,
    EMULATED_FIT,
    EMULATED_TRACKS,
    EMULATED_TWICE,
    HARDWARE,
    HARDWARE_LINK,
    HARDWARE_OBS,
    HARDWARE_CARD,
    HARDWARE_LOGGING,
];
/// The station an image for hardware holds unless another is given.
const DEFAULT_STATION: &str = "scenarios/demo-station.toml";
/// The same of an ocean-bottom recorder.
const DEFAULT_OBS: &str = "scenarios/ocean-bottom-station.toml";

/// Where an image is once built.
pub fn path(image: &Image) -> PathBuf {
    root().join("target/firmware/images").join(image.name)
}

/// Where cargo leaves a binary.
pub fn cargo_path(bin: &str) -> PathBuf {
    root().join("target/firmware").join(TARGET).join("firmware").join(bin)
}

/// Builds an image for hardware, which holds its station's configuration and, where its records wait, the key of its commands.
pub fn build_hardware(
    toolchain: &Toolchain,
    image: &Image,
    station: Option<&str>,
    key: Option<&str>,
) -> Result<PathBuf> {
    let station = station.unwrap_or(DEFAULT_STATION);
    // The tests that run an image read what it holds.
    let blob = if image.name == HARDWARE_OBS.name { "station-obs.sbcf" } else { "station.sbcf" };
    let blob = root().join("target/firmware").join(blob);
    say(&format!("writing the configuration of {station} for the image"));
    run(host(&["blob", "--station", station, "--out"]).arg(&blob), "seabearing blob")?;
    let binary = root().join("target/firmware/station.key");
    std::fs::write(&binary, key.map(read_key).transpose()?.unwrap_or_default())
        .with_context(|| binary.display().to_string())?;
    build_with(toolchain, image, Some((&blob, &binary)))
}

/// The 32 bytes of a key's file of 64 hexadecimal digits.
fn read_key(path: &str) -> Result<Vec<u8>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {path}"))?;
    let text = text.trim();
    let byte = |at: usize| text.get(at..at + 2).and_then(|two| u8::from_str_radix(two, 16).ok());
    let bytes: Option<Vec<u8>> = (0..64).step_by(2).map(byte).collect();
    bytes.filter(|_| text.len() == 64).with_context(|| {
        format!(
            "{path} is no key: it must hold 64 hexadecimal digits (head -c 32 /dev/urandom | xxd -p -c 64)"
        )
    })
}

/// Builds an image.
pub fn build(toolchain: &Toolchain, image: &Image) -> Result<PathBuf> {
    build_with(toolchain, image, None)
}

fn build_with(toolchain: &Toolchain, image: &Image, holds: Option<(&Path, &Path)>) -> Result<PathBuf> {
    // Images of one board are one file to cargo until they are copied.
    static BUILDING: Mutex<()> = Mutex::new(());
    let _alone = BUILDING.lock().unwrap_or_else(PoisonError::into_inner);
    say(&format!("building firmware {} ({})", image.name, image.features));
    let mut cargo = toolchain.cargo("build");
    cargo.args(["--quiet", "--package", "seabearing-firmware", "--profile", "firmware"]);
    cargo.args(["--no-default-features", "--features", image.features, "--bin", image.bin]);
    if let Some((blob, key)) = holds {
        cargo.env("SEABEARING_STATION_BLOB", blob).env("SEABEARING_KEY", key);
    }
    run(&mut cargo, &format!("building {}", image.name))?;
    let to = path(image);
    std::fs::create_dir_all(root().join("target/firmware/images")).context("target/firmware/images")?;
    std::fs::copy(cargo_path(image.bin), &to).with_context(|| format!("copying {}", image.name))?;
    Ok(to)
}

/// Options of the tasks that build for a board.
struct Options<'a> {
    board: &'a str,
    station: Option<&'a str>,
    key: Option<&'a str>,
}

impl<'a> Options<'a> {
    fn read(options: &'a [String], board: &'a str) -> Result<Self> {
        let mut read = Self { board, station: None, key: None };
        let mut rest = options.iter();
        while let Some(flag) = rest.next() {
            let value = rest.next().with_context(|| format!("{flag} needs a value"))?;
            match flag.as_str() {
                "--board" => read.board = value,
                "--station" => read.station = Some(value),
                "--key" => read.key = Some(value),
                other => bail!("there is no option `{other}`: --board, --station and --key"),
            }
        }
        Ok(read)
    }
}

/// `cargo xtask build-firmware`.
pub fn command(options: &[String]) -> Result<()> {
    let options = Options::read(options, "mps2-an500")?;
    let emulated: &[&Image] = match options.board {
        "mps2-an500" => &[&EMULATED],
        "stm32h743" | "stm32h743-link" | "stm32h743-card" | "stm32h743-obs" => &[],
        "all" => &[&EMULATED, &EMULATED_ARRAY, &EMULATED_OBS, &EMULATED_LINK],
        "link" => &[&EMULATED_LINK],
        other => bail!(
            "there is no board `{other}`: mps2-an500, link, stm32h743, stm32h743-link, stm32h743-card, stm32h743-obs or all"
        ),
    };
    let toolchain = Toolchain::find()?;
    for image in emulated {
        report(&build(&toolchain, image)?)?;
    }
    if matches!(options.board, "stm32h743" | "all") {
        report(&build_hardware(&toolchain, &HARDWARE, options.station, None)?)?;
    }
    if matches!(options.board, "stm32h743-link" | "all") {
        report(&build_hardware(&toolchain, &HARDWARE_LINK, options.station, options.key)?)?;
    }
    if matches!(options.board, "stm32h743-card" | "all") {
        report(&build_hardware(&toolchain, &HARDWARE_CARD, options.station, options.key)?)?;
    }
    if options.board == "stm32h743-obs" {
        let station = match options.station {
            Some(station) => station,
            None => {
                scenario::trace_table()?;
                DEFAULT_OBS
            }
        };
        report(&build_hardware(&toolchain, &HARDWARE_OBS, Some(station), options.key)?)?;
    }
    Ok(())
}

/// `cargo xtask flash`: builds for the hardware board, writes it and attaches, where probe-rs is installed; or writes a configuration
/// alone, which the image that is there runs with from its next start.
pub fn flash(options: &[String]) -> Result<()> {
    if let [flag, station] = options
        && flag == "--configuration"
    {
        return flash_configuration(station);
    }
    let options = Options::read(options, "stm32h743")?;
    let probe = probe()?;
    let kind = match options.board {
        "stm32h743-link" => &HARDWARE_LINK,
        "stm32h743-obs" => &HARDWARE_OBS,
        "stm32h743-card" => &HARDWARE_CARD,
        _ => &HARDWARE,
    };
    let image = build_hardware(&Toolchain::find()?, kind, options.station, options.key)?;
    say("flashing; the board's reset and faults are shown until interrupted");
    run(Command::new(probe).args(["run", "--chip", CHIP]).arg(image), "probe-rs")
}

/// The chip as probe-rs calls it.
const CHIP: &str = "STM32H743ZITx";

fn probe() -> Result<PathBuf> {
    find("probe-rs").context(
        "probe-rs is not installed: `cargo install probe-rs-tools --locked`, then connect the board and run this again",
    )
}

/// Writes both places for a configuration (`core/src/slots.rs`).
fn flash_configuration(station: &str) -> Result<()> {
    let probe = probe()?;
    let places = root().join("target/firmware/places.bin");
    run(host(&["blob", "--station", station, "--places", "--out"]).arg(&places), "seabearing blob")?;
    say("writing the configuration; the board starts with it");
    let download = ["download", "--chip", CHIP, "--binary-format", "bin", "--base-address", "0x08100000"];
    run(Command::new(&probe).args(download).arg(places), "probe-rs download")?;
    run(Command::new(probe).args(["reset", "--chip", CHIP]), "probe-rs reset")
}

/// One line about what an image takes.
fn report(path: &Path) -> Result<()> {
    let elf = Elf::read(path)?;
    let (flash, statics) = (elf.flash(), elf.statics());
    let path = path.strip_prefix(root()).unwrap_or(path).display();
    say(&format!("built {path}: {flash} bytes of flash, {statics} of statics"));
    Ok(())
}
