//! The independent watchdog (RM0433, chapter 45).

use super::clocks::unknown;
use crate::board::Refusal;
use crate::time::{NEVER, PER_SECOND, Ticks};

const LSI_HZ: f64 = 32_000.0;

/// Registers and when it bites.
#[derive(Debug)]
pub(super) struct Watchdog {
    prescaler: u32,
    reload: u32,
    window: u32,
    open: bool,
    started: bool,
    fed: Ticks,
    /// Relative error of its oscillator.
    error: f64,
}

impl Watchdog {
    pub fn new(error: f64) -> Self {
        Self { prescaler: 0, reload: 0xfff, window: 0xfff, open: false, started: false, fed: 0, error }
    }

    pub fn reset(&mut self) {
        *self = Self::new(self.error);
    }

    pub fn next_event(&self) -> Ticks {
        if !self.started {
            return NEVER;
        }
        let seconds = f64::from(self.reload + 1) * f64::from(4u32 << self.prescaler.min(6))
            / (LSI_HZ * (1.0 + self.error));
        self.fed + (seconds * PER_SECOND as f64) as Ticks
    }

    pub fn read(&self, offset: usize) -> Result<u32, Refusal> {
        match offset {
            0x04 => Ok(self.prescaler),
            0x08 => Ok(self.reload),
            0x00 | 0x0c => Ok(0),
            0x10 => Ok(self.window),
            _ => Err(unknown("IWDG1", offset)),
        }
    }

    pub fn write(&mut self, offset: usize, value: u32, now: Ticks) -> Result<(), Refusal> {
        match (offset, value) {
            (0, 0xcccc) => (self.started, self.fed) = (true, now),
            (0, 0xaaaa) => (self.fed, self.open) = (now, false),
            (0, 0x5555) => self.open = true,
            (0, _) => self.open = false,
            (4 | 8 | 0x10, _) if !self.open => {
                return Refusal::stop("a register of IWDG1 is written without its key");
            }
            (4, _) => self.prescaler = value & 7,
            (8, _) => self.reload = value & 0xfff,
            (0x10, _) => self.window = value & 0xfff,
            _ => return Err(unknown("IWDG1", offset)),
        }
        Ok(())
    }
}
