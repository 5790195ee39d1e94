//! The images for hardware on the modelled board: what a conversion costs them, what their store in flash does, what they lose.

use super::{CORE_HZ, Figure, LEAST, OCEAN_BOTTOM_MHZ, stack_bound, thousandths, told, twin};
use crate::elf::Elf;
use crate::firmware::{self, HARDWARE, HARDWARE_LINK, HARDWARE_OBS};
use crate::process::say;
use crate::scenario::{self, Recording};
use crate::toolchain::Toolchain;
use anyhow::Result;

/// Cost at which the image for hardware must keep up: cycles an instruction, and more for an access to a register.
pub const HARDWARE_CYCLES: f64 = 2.5;
pub const HARDWARE_REGISTER: f64 = 30.0;
/// Interrupts a second, percent of the time asleep.
pub const HARDWARE_INTERRUPTS: f64 = 500.0;
pub const HARDWARE_ASLEEP: f64 = 60.0;
/// What leaves the core asleep long enough: cycles of a conversion's time, less the sleep, as instructions.
pub const MOST_IN_THREAD: f64 = (1.0 - HARDWARE_ASLEEP / 100.0) * CORE_HZ / 64_000.0 / HARDWARE_CYCLES;
/// Its bank of flash and the RAM it lives in (`memory.x`), bytes.
pub const HARDWARE_FLASH: f64 = 1_048_576.0;
pub const HARDWARE_RAM: f64 = 524_288.0;
/// So many times the stack that was used must be there.
pub const STACK_MARGIN: f64 = 4.0;

/// What a conversion costs the image for hardware on the modelled board, over the short scenario.
pub fn hardware(toolchain: &Toolchain) -> Result<Vec<Figure>> {
    let recording = scenario::simulate("short-pass")?;
    let station = recording.station.to_string_lossy().into_owned();
    let image = firmware::build_hardware(toolchain, &HARDWARE, Some(&station), None)?;
    say("counting what a conversion costs the image for hardware");
    let (cycles, register) = (HARDWARE_CYCLES.to_string(), HARDWARE_REGISTER.to_string());
    let arguments = ["--board", "stm32h743", "--cycles", &cycles, "--register-cycles", &register];
    let said = twin(&arguments, &image, &recording)?;
    let plain = |what: &str, value, bar| Figure { name: format!("stm32h743 {what}"), value, bar };
    let elf = Elf::read(&image)?;
    let (statics, stack) = (f64::from(elf.statics()), told(&said, "stack_bytes")?);
    let mut figures = vec![
        plain("core, MHz", CORE_HZ / 1e6, None),
        plain("cycles an instruction, assumed", HARDWARE_CYCLES, None),
        plain("cycles a register access, assumed", HARDWARE_REGISTER, None),
        plain("flash, bytes", f64::from(elf.flash()), Some(HARDWARE_FLASH)),
        plain("statics, bytes", statics, None),
        plain("stack used, bytes", stack, Some((told(&said, "stack_size_bytes")? / STACK_MARGIN).floor())),
        stack_bound("stm32h743", &elf, stack)?,
        plain("statics and stack, bytes", statics + stack, Some(HARDWARE_RAM)),
    ];
    let figure = |what: &str, key: &str, scale: f64, bar| -> Result<Figure> {
        Ok(plain(what, thousandths(told(&said, key)? * scale), bar))
    };
    figures.extend([
        figure("conversions lost in 5 s", "lost", 1.0, Some(0.0))?,
        figure("interrupts a second", "interrupts_per_s", 1.0, Some(HARDWARE_INTERRUPTS))?,
        figure(LEAST, "idle", 100.0, Some(HARDWARE_ASLEEP))?,
    ]);
    figures.extend(a_conversion("stm32h743", &said, Some(MOST_IN_THREAD))?);
    Ok(figures)
}

/// The image whose records wait in flash, over the same: sectors are erased while it records.
pub fn store(toolchain: &Toolchain) -> Result<Vec<Figure>> {
    let recording = scenario::simulate("short-pass")?;
    let station = recording.station.to_string_lossy().into_owned();
    let image = firmware::build_hardware(toolchain, &HARDWARE_LINK, Some(&station), None)?;
    say("counting what the store in flash costs the image for hardware");
    let (cycles, register) = (HARDWARE_CYCLES.to_string(), HARDWARE_REGISTER.to_string());
    let board = ["--board", "stm32h743", "--link", "--cycles", &cycles, "--register-cycles", &register];
    let said = twin(&board, &image, &recording)?;
    let figure = |what: &str, value, bar| Figure { name: format!("stm32h743 store {what}"), value, bar };
    let elf = Elf::read(&image)?;
    let (statics, stack) = (f64::from(elf.statics()), told(&said, "stack_bytes")?);
    let margin = (told(&said, "stack_size_bytes")? / STACK_MARGIN).floor();
    let idle = thousandths(told(&said, "idle")? * 100.0);
    let mut figures = vec![
        figure("flash, bytes", f64::from(elf.flash()), Some(HARDWARE_FLASH)),
        figure("statics, bytes", statics, None),
        figure("stack used, bytes", stack, Some(margin)),
        stack_bound("stm32h743 store", &elf, stack)?,
        figure("statics and stack, bytes", statics + stack, Some(HARDWARE_RAM)),
        figure("sectors erased in 5 s", told(&said, "flash_sectors")?, None),
        figure("words written in 5 s", told(&said, "flash_words")?, None),
        figure("conversions lost in 5 s", told(&said, "lost")?, Some(0.0)),
        figure(
            "interrupts a second",
            thousandths(told(&said, "interrupts_per_s")?),
            Some(HARDWARE_INTERRUPTS),
        ),
        figure(LEAST, idle, Some(HARDWARE_ASLEEP)),
    ];
    figures.extend(a_conversion("stm32h743 store", &said, Some(MOST_IN_THREAD))?);
    Ok(figures)
}

/// What a conversion costs, of an image and what the twin said of it; in the thread at most so many instructions.
pub fn a_conversion(image: &str, said: &str, most: Option<f64>) -> Result<Vec<Figure>> {
    [
        ("thread, instr.", "instructions_in_thread_per_conversion", most),
        ("interrupts, instr.", "instructions_in_interrupts_per_conversion", None),
        ("register accesses", "register_accesses_per_conversion", None),
        ("memory loads", "memory_loads_per_conversion", None),
    ]
    .into_iter()
    .map(|(what, key, bar)| {
        Ok(Figure {
            name: format!("{image} a conversion: {what}"),
            value: thousandths(told(said, key)?),
            bar,
        })
    })
    .collect()
}

/// The ocean-bottom recorder's share of the time asleep, percent.
const OCEAN_BOTTOM_ASLEEP: f64 = 95.0;

/// The ocean-bottom recorder's image on its modelled board, over the beginning of its recording.
pub fn ocean_bottom(toolchain: &Toolchain, recording: &Recording) -> Result<Vec<Figure>> {
    let station = recording.station.to_string_lossy().into_owned();
    let image = firmware::build_hardware(toolchain, &HARDWARE_OBS, Some(&station), None)?;
    say("counting what a conversion costs the ocean-bottom image");
    let (cycles, register) = (HARDWARE_CYCLES.to_string(), HARDWARE_REGISTER.to_string());
    let board =
        ["--board", "stm32h743", "--seconds", "200", "--cycles", &cycles, "--register-cycles", &register];
    let said = twin(&board, &image, recording)?;
    let figure = |what: &str, value, bar| Figure { name: format!("stm32h743 obs {what}"), value, bar };
    let elf = Elf::read(&image)?;
    let (statics, stack) = (f64::from(elf.statics()), told(&said, "stack_bytes")?);
    let margin = (told(&said, "stack_size_bytes")? / STACK_MARGIN).floor();
    let get = |key: &str, scale: f64| Ok::<_, anyhow::Error>(thousandths(told(&said, key)? * scale));
    let mut figures = vec![
        figure("core, MHz", OCEAN_BOTTOM_MHZ, None),
        figure("flash, bytes", f64::from(elf.flash()), Some(HARDWARE_FLASH)),
        figure("statics, bytes", statics, None),
        figure("stack used, bytes", stack, Some(margin)),
        stack_bound("stm32h743 obs", &elf, stack)?,
        figure("statics and stack, bytes", statics + stack, Some(HARDWARE_RAM)),
        figure("sectors erased in 200 s", told(&said, "flash_sectors")?, None),
        figure("words written in 200 s", told(&said, "flash_words")?, None),
        figure("conversions lost in 200 s", told(&said, "lost")?, Some(0.0)),
        figure("interrupts a second", told(&said, "interrupts_per_s")?, Some(HARDWARE_INTERRUPTS)),
        figure(LEAST, get("idle", 100.0)?, Some(OCEAN_BOTTOM_ASLEEP)),
    ];
    figures.extend(a_conversion("stm32h743 obs", &said, None)?);
    Ok(figures)
}
