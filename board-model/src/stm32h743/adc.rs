//! The third analog converter as far as it reads the processor's own voltages: reference, temperature and the clock's cell
//! (RM0433, chapter 25).

use super::clocks::unknown;
use crate::board::Refusal;
use crate::time::{PER_SECOND, Ticks};

/// What there is to be measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Analog {
    /// The supply, V.
    pub supply_v: f64,
    /// The clock's cell, V; 0: none.
    pub cell_v: f64,
    /// Temperature, °C.
    pub temperature_c: f64,
}

impl Default for Analog {
    fn default() -> Self {
        Self { supply_v: 3.3, cell_v: 3.0, temperature_c: 12.0 }
    }
}

/// Words the factory wrote, by their place: reference at 3.3 V, temperature sensor at 3.3 V and 30 and 110 °C (DS12110; the
/// values are typical ones).
pub const FACTORY: [(u32, u16); 3] = [(0x1ff1_e860, 24_148), (0x1ff1_e820, 12_313), (0x1ff1_e840, 15_490)];
/// Full scale at 16 bits.
const FULL: f64 = 65_535.0;

/// Channels, and how long each must be sampled at least (DS12110), in ns.
const CELL: (u32, u64) = (17, 9000);
const TEMPERATURE: (u32, u64) = (18, 9000);
const REFERENCE: (u32, u64) = (19, 4300);

/// Time from the regulator's start until it is ready, ns.
const REGULATOR_NS: u64 = 10_000;
/// Clock periods of a calibration with linearity, and of a conversion of 16 bits without its sampling.
const CALIBRATION: f64 = 165_010.0;
const CONVERSION: f64 = 8.5;
/// Clock periods of the sampling times.
const SAMPLED: [f64; 8] = [1.5, 2.5, 8.5, 16.5, 32.5, 64.5, 387.5, 810.5];
/// Fastest clock, Hz.
const FASTEST_HZ: u64 = 50_000_000;

mod bit {
    pub const ENABLE: u32 = 1;
    pub const DISABLE: u32 = 1 << 1;
    pub const START: u32 = 1 << 2;
    pub const STOP: u32 = 1 << 4;
    pub const REGULATOR: u32 = 1 << 28;
    pub const ASLEEP: u32 = 1 << 29;
    pub const CALIBRATE: u32 = 1 << 31;
}

/// The converter.
#[derive(Debug)]
pub struct Adc {
    control: u32,
    status: u32,
    registers: [u32; 0x100 / 4],
    common: u32,
    data: u32,
    /// Since when the regulator is on; until when it calibrates or converts.
    regulated: Ticks,
    calibrates: Ticks,
    converts: Option<Ticks>,
    calibrated: bool,
}

impl Adc {
    pub fn new() -> Self {
        Self {
            control: bit::ASLEEP,
            status: 0,
            registers: [0; 0x100 / 4],
            common: 0,
            data: 0,
            regulated: 0,
            calibrates: 0,
            converts: None,
            calibrated: false,
        }
    }

    fn clock_hz(&self, kernel_hz: u64) -> Result<u64, Refusal> {
        // Prescalers 1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256; silicon from revision V on divides by two more.
        const PRESCALERS: [u64; 12] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256];
        let hz = PRESCALERS.get((self.common >> 18 & 15) as usize).map_or(0, |by| kernel_hz / by);
        match hz {
            0 => Refusal::stop("ADC3 has no clock (RCC_D3CCIPR.ADCSEL)"),
            hz if hz > FASTEST_HZ => Refusal::stop(format!("ADC3's clock of {hz} Hz is too fast")),
            hz => Ok(hz / 2),
        }
    }

    fn advance(&mut self, now: Ticks) {
        if self.converts.is_some_and(|until| until <= now) {
            self.converts = None;
            self.control &= !bit::START;
            // Ends of sampling, of the conversion and of the sequence.
            self.status |= 0b1110;
        }
        if self.calibrates != 0 && self.calibrates <= now {
            self.calibrates = 0;
            self.control &= !bit::CALIBRATE;
            self.calibrated = true;
        }
    }

    pub fn read(&mut self, offset: usize, now: Ticks) -> Result<u32, Refusal> {
        self.advance(now);
        Ok(match offset {
            0 => self.status,
            8 => self.control,
            0x40 => {
                self.status &= !0b100;
                self.data
            }
            0x308 => self.common,
            _ => *self.registers.get(offset / 4).ok_or_else(|| unknown("ADC3", offset))?,
        })
    }

    pub fn write(
        &mut self,
        offset: usize,
        value: u32,
        now: Ticks,
        kernel_hz: u64,
        analog: &Analog,
    ) -> Result<(), Refusal> {
        self.advance(now);
        match offset {
            0 => self.status &= !value,
            8 => self.control(value, now, kernel_hz, analog)?,
            0x308 if self.control & bit::ENABLE != 0 && (self.common ^ value) & 0x3f_0000 != 0 => {
                return Refusal::stop("ADC3's clock is changed while the converter is on");
            }
            0x308 => self.common = value,
            // Interrupts, sequences, sampling times, channels and calibration.
            0x0c | 0x10 | 0x14 | 0x18 | 0x1c | 0x30..=0x3c | 0xc0 if self.control & bit::START == 0 => {
                self.registers[offset / 4] = value;
            }
            0x0c | 0x10 | 0x14 | 0x18 | 0x1c | 0x30..=0x3c | 0xc0 => {
                return Refusal::stop(format!("register {offset:#x} of ADC3 is written while it converts"));
            }
            _ => return Err(unknown("ADC3", offset)),
        }
        Ok(())
    }

    fn control(&mut self, value: u32, now: Ticks, kernel_hz: u64, analog: &Analog) -> Result<(), Refusal> {
        let begun = value & !self.control;
        if begun & bit::REGULATOR != 0 {
            self.regulated = now;
        }
        let ready = value & bit::REGULATOR != 0
            && value & bit::ASLEEP == 0
            && now >= self.regulated + REGULATOR_NS * PER_SECOND / 1_000_000_000;
        if begun & (bit::CALIBRATE | bit::ENABLE) != 0 && !ready {
            return Refusal::stop("ADC3 is calibrated or enabled before its regulator is ready");
        }
        if begun & bit::CALIBRATE != 0 {
            if value & bit::ENABLE != 0 {
                return Refusal::stop("ADC3 is calibrated while it is on");
            }
            let seconds = CALIBRATION / self.clock_hz(kernel_hz)? as f64;
            self.calibrates = now + (seconds * PER_SECOND as f64) as Ticks;
        }
        if begun & bit::ENABLE != 0 {
            if !self.calibrated || self.control & bit::CALIBRATE != 0 {
                return Refusal::stop("ADC3 is enabled without a calibration");
            }
            self.status |= 1;
        }
        if begun & bit::START != 0 {
            if self.control & bit::ENABLE == 0 {
                return Refusal::stop("ADC3 is started while it is off");
            }
            self.start(now, kernel_hz, analog)?;
        }
        if begun & (bit::DISABLE | bit::STOP) != 0 {
            return Refusal::stop("ADC3 is stopped or disabled, which is not modelled");
        }
        self.control = value;
        Ok(())
    }

    /// Begins the conversion of the one channel of the sequence.
    fn start(&mut self, now: Ticks, kernel_hz: u64, analog: &Analog) -> Result<(), Refusal> {
        let sequence = self.registers[0x30 / 4];
        if sequence & 15 != 0 || self.registers[0x0c / 4] & 1 << 13 != 0 {
            return Refusal::stop("ADC3 converts more than one channel, which is not modelled");
        }
        let channel = sequence >> 6 & 31;
        if self.registers[0x1c / 4] >> channel & 1 == 0 {
            return Refusal::stop(format!("channel {channel} of ADC3 is not preselected"));
        }
        let sampling = match channel {
            0..10 => self.registers[0x14 / 4] >> (3 * channel) & 7,
            _ => self.registers[0x18 / 4] >> (3 * (channel - 10)) & 7,
        };
        let periods = SAMPLED[sampling as usize];
        let hz = self.clock_hz(kernel_hz)? as f64;
        // Its switch in the common register, how long it is sampled, and its voltage.
        let (switch, needed, volts) = match channel {
            c if c == CELL.0 => (24, CELL.1, analog.cell_v / 4.0),
            c if c == TEMPERATURE.0 => {
                (23, TEMPERATURE.1, volts(FACTORY[1].1) + slope() * (analog.temperature_c - 30.0))
            }
            c if c == REFERENCE.0 => (22, REFERENCE.1, volts(FACTORY[0].1)),
            _ => return Refusal::stop(format!("channel {channel} of ADC3 is not modelled")),
        };
        if self.common >> switch & 1 == 0 {
            return Refusal::stop(format!("channel {channel} of ADC3 is read without its switch (ADC3_CCR)"));
        }
        if periods / hz * 1e9 < needed as f64 {
            return Refusal::stop(format!("channel {channel} of ADC3 is sampled for less than {needed} ns"));
        }
        self.data = (FULL * volts / analog.supply_v).round().clamp(0.0, FULL) as u32;
        self.converts = Some(now + ((periods + CONVERSION) / hz * PER_SECOND as f64) as Ticks);
        Ok(())
    }
}

/// The voltage that gave this code at the factory's 3.3 V.
fn volts(code: u16) -> f64 {
    3.3 * f64::from(code) / FULL
}

/// Volts a degree of the temperature sensor.
fn slope() -> f64 {
    (volts(FACTORY[2].1) - volts(FACTORY[1].1)) / 80.0
}
