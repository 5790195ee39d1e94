//! The measured budgets that a deployment is planned from: `docs/budget.txt`, as `cargo xtask budget` wrote it.

use anyhow::{Context, Result};

/// The snapshot, taken in when this was built.
const SNAPSHOT: &str = include_str!("../../../docs/budget.txt");

/// What runs over the demonstration's pass cost, and what else follows from measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// Instructions a second of the array's recorder at 64 kHz with a step of 0.5 s.
    array_work: f64,
    /// The same at 16 kHz.
    array_slow: f64,
    /// The same at 16 kHz with a step of 1 s.
    array_sparse: f64,
    /// Instructions of the longest work after one block, array.
    pub worst_block: f64,
    /// Bearings a minute with a step of 0.5 s, bytes of a bearing's frame, and bytes a minute of the other records, while
    /// one vessel is heard all the time.
    pub bearings_per_min: f64,
    /// Bytes of a bearing's frame.
    pub bearing_bytes: f64,
    /// Bytes a minute of tracks, shaft rates and faults.
    pub array_other_per_min: f64,
    /// Instructions a second of the ocean bottom's recorder at 50 Hz.
    obs_work: f64,
    /// Bytes a minute of everything but health reports, ocean bottom.
    pub obs_per_min: f64,
    /// RAM and flash of the ocean bottom's image for hardware, bytes.
    pub obs_ram: f64,
    /// Flash of the same, with the configuration it was measured with.
    pub obs_flash: f64,
    /// Clock of that board's core.
    obs_core_hz: f64,
    /// Instructions and register accesses of a conversion at 250 Hz, the recorder's work at 50 Hz in it.
    obs_instructions: f64,
    /// Register accesses of the same.
    obs_registers: f64,
    /// The image with a link, and the one that records sound too.
    pub link: BoardImage,
    /// The one that records sound.
    pub card: BoardImage,
    /// Clock of the core of an array's board.
    pub core_hz: f64,
    /// Cycles an instruction, as assumed where the board was measured.
    pub cycles: f64,
    /// More cycles for an access to a register, as assumed there.
    pub register_cycles: f64,
    /// Instructions and register accesses of a conversion on the board at 64 kHz, the recorder's work in it.
    board_instructions: f64,
    /// Register accesses of the same.
    board_registers: f64,
}

/// What an image for an array's board takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardImage {
    /// AXI SRAM that its statics take, and its stack where that stands there too, bytes.
    pub ram: f64,
    /// Flash, bytes.
    pub flash: f64,
    /// How much longer it is awake than the plain image.
    pub more: f64,
}

/// Rate and step of the array's first row, and the rate of the others.
const FULL: (f64, f64) = (64_000.0, 0.5);
const SLOW_HZ: f64 = 16_000.0;

impl Budget {
    /// The snapshot.
    ///
    /// # Errors
    /// A row that is needed is not there.
    pub fn measured() -> Result<Self> {
        Self::of(SNAPSHOT)
    }

    fn of(text: &str) -> Result<Self> {
        let row = |name: &str| {
            let values = text.lines().filter_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
            let value = values.filter_map(|rest| rest.split_whitespace().next()?.parse().ok()).next();
            value
                .with_context(|| format!("docs/budget.txt has no row `{name}`: `cargo xtask budget --bless`"))
        };
        let awake = |name: &str| Ok::<f64, anyhow::Error>(100.0 - row(name)?);
        let plain = awake("stm32h743 asleep, %")?;
        let millions = |name: &str| Ok::<f64, anyhow::Error>(1e6 * row(name)?);
        Ok(Self {
            array_work: millions("array work, million instructions/s")?,
            array_slow: millions("array at 16 kHz, million instr./s")?,
            array_sparse: millions("array at 16 kHz, 1 s steps, million/s")?,
            worst_block: millions("array worst block, million instr.")?,
            bearings_per_min: row("array bearings a minute, one vessel")?,
            bearing_bytes: row("array bearing frame, bytes")?,
            array_other_per_min: row("array other telemetry, bytes/min")?,
            obs_work: millions("obs work, million instructions/s")?,
            obs_per_min: row("obs other telemetry, bytes/min")?,
            obs_ram: row("stm32h743 obs statics and stack, bytes")?,
            obs_flash: row("stm32h743 obs flash, bytes")?,
            obs_core_hz: millions("stm32h743 obs core, MHz")?,
            obs_instructions: row("stm32h743 obs a conversion: thread, instr.")?
                + row("stm32h743 obs a conversion: interrupts, instr.")?,
            obs_registers: row("stm32h743 obs a conversion: register accesses")?,
            link: BoardImage {
                ram: row("stm32h743 store statics, bytes")?,
                flash: row("stm32h743 store flash, bytes")?,
                more: awake("stm32h743 store asleep, %")? / plain,
            },
            card: BoardImage {
                ram: row("stm32h743 card statics in AXI SRAM, bytes")?,
                flash: row("stm32h743 card flash, bytes")?,
                more: awake("stm32h743 card asleep, %")? / plain,
            },
            core_hz: millions("stm32h743 core, MHz")?,
            cycles: row("stm32h743 cycles an instruction, assumed")?,
            register_cycles: row("stm32h743 cycles a register access, assumed")?,
            board_instructions: row("stm32h743 a conversion: thread, instr.")?
                + row("stm32h743 a conversion: interrupts, instr.")?,
            board_registers: row("stm32h743 a conversion: register accesses")?,
        })
    }

    /// Instructions a second of the array's recorder: so many a sample, and so many a step.
    pub fn array_work(&self, rate_hz: f64, step_s: f64) -> f64 {
        let a_sample = (self.array_work - self.array_slow) / (FULL.0 - SLOW_HZ);
        let a_step = (self.array_slow - a_sample * SLOW_HZ) * FULL.1;
        a_sample * rate_hz + a_step / step_s
    }

    /// Share of the time the board's core is awake while an array records at this rate.
    pub fn array_awake(&self, rate_hz: f64, step_s: f64, cycles: f64) -> f64 {
        self.array_pause(rate_hz, cycles) + cycles * self.array_work(rate_hz, step_s) / self.core_hz
    }

    /// The same while samples are counted and left out.
    pub fn array_pause(&self, rate_hz: f64, cycles: f64) -> f64 {
        let around = (self.board_instructions - self.array_work / FULL.0).max(0.0);
        (cycles * around + self.register_cycles * self.board_registers) * rate_hz / self.core_hz
    }
}

/// Conversions and samples a second at which the ocean bottom's board was measured.
const OBS_HZ: (f64, f64) = (250.0, 50.0);

impl Budget {
    /// Instructions a second of the ocean bottom's recorder; a sample costs no more at a higher rate.
    pub fn obs_work(&self, rate_hz: f64) -> f64 {
        self.obs_work * (rate_hz / OBS_HZ.1).max(1.0)
    }

    /// Share of the time that board's core is awake at this rate, made of so many conversions a second.
    pub fn obs_awake(&self, rate_hz: f64, conversions_hz: f64, cycles: f64) -> f64 {
        self.obs_pause(conversions_hz, cycles) + cycles * self.obs_work(rate_hz) / self.obs_core_hz
    }

    /// The same while samples are counted and left out.
    pub fn obs_pause(&self, conversions_hz: f64, cycles: f64) -> f64 {
        let around = (self.obs_instructions - self.obs_work / OBS_HZ.0).max(0.0);
        (cycles * around + self.register_cycles * self.obs_registers) * conversions_hz / self.obs_core_hz
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_that_is_needed_is_in_the_snapshot_and_its_absence_is_named() {
        Budget::measured().unwrap();
        let without = SNAPSHOT.replace("stm32h743 core, MHz", "stm32h743 core");
        let e = Budget::of(&without).unwrap_err().to_string();
        assert!(e.contains("stm32h743 core, MHz") && e.contains("--bless"), "{e}");
    }

    #[test]
    fn a_row_is_found_by_its_whole_name() {
        let text = SNAPSHOT.replace("obs flash, bytes ", "obs flash, bytes more ");
        // Both images' rows are gone.
        assert!(Budget::of(&text).is_err());
    }

    #[test]
    fn work_scales_as_it_was_measured() {
        let budget = Budget::measured().unwrap();
        assert!((budget.array_work(FULL.0, FULL.1) / budget.array_work - 1.0).abs() < 1e-9);
        let (told, measured) = (budget.array_work(SLOW_HZ, 1.0), budget.array_sparse);
        assert!((told / measured - 1.0).abs() < 0.05, "{told} {measured}");
    }
}
