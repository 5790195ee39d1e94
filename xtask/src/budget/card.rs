//! The image that records sound too: what waits for the card fills AXI SRAM, its stack and its store stand apart.

use super::modelled::{
    HARDWARE_ASLEEP, HARDWARE_CYCLES, HARDWARE_FLASH, HARDWARE_INTERRUPTS, HARDWARE_RAM, HARDWARE_REGISTER,
    MOST_IN_THREAD, STACK_MARGIN, a_conversion,
};
use super::{Figure, LEAST, stack_bound, thousandths, told, twin};
use crate::elf::Elf;
use crate::firmware::{self, HARDWARE_CARD};
use crate::process::say;
use crate::scenario;
use crate::toolchain::Toolchain;
use anyhow::Result;

/// The D2 domain's first two SRAMs (`memory.x`), bytes.
const D2_SRAM: f64 = 262_144.0;

/// What it takes and what it loses, which must be nothing.
pub fn figures(toolchain: &Toolchain) -> Result<Vec<Figure>> {
    let recording = scenario::simulate("short-pass")?;
    let station = recording.station.to_string_lossy().into_owned();
    let image = firmware::build_hardware(toolchain, &HARDWARE_CARD, Some(&station), None)?;
    say("counting what sound on a card costs the image for hardware");
    let (cycles, register) = (HARDWARE_CYCLES.to_string(), HARDWARE_REGISTER.to_string());
    let board = ["--board", "stm32h743", "--card", "--cycles", &cycles, "--register-cycles", &register];
    let said = twin(&board, &image, &recording)?;
    let figure = |what: &str, value, bar| Figure { name: format!("stm32h743 card {what}"), value, bar };
    let elf = Elf::read(&image)?;
    let stack = told(&said, "stack_bytes")?;
    let margin = (told(&said, "stack_size_bytes")? / STACK_MARGIN).floor();
    let idle = thousandths(told(&said, "idle")? * 100.0);
    let mut figures = vec![
        figure("flash, bytes", f64::from(elf.flash()), Some(HARDWARE_FLASH)),
        figure("statics in AXI SRAM, bytes", f64::from(elf.statics_from(0x2400_0000)), Some(HARDWARE_RAM)),
        figure("statics in D2 SRAM, bytes", f64::from(elf.statics_from(0x3000_0000)), Some(D2_SRAM)),
        figure("stack used, bytes", stack, Some(margin)),
        stack_bound("stm32h743 card", &elf, stack)?,
        figure("conversions lost in 5 s", told(&said, "lost")?, Some(0.0)),
        figure("instants missing in 5 s", told(&said, "card_missing")?, Some(0.0)),
        figure("instants wrong in 5 s", told(&said, "card_wrong")?, Some(0.0)),
        figure(
            "interrupts a second",
            thousandths(told(&said, "interrupts_per_s")?),
            Some(HARDWARE_INTERRUPTS),
        ),
        figure(LEAST, idle, Some(HARDWARE_ASLEEP)),
    ];
    figures.extend(a_conversion("stm32h743 card", &said, Some(MOST_IN_THREAD))?);
    Ok(figures)
}
