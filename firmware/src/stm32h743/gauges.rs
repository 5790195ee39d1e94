//! The processor's third converter, which reads supply, clock's cell and temperature from inside.

use crate::gauges::{Calibration, Codes, Gauged};
use embassy_stm32::Peri;
use embassy_stm32::adc::{Adc, SampleTime, Temperature, VrefInt};
use embassy_stm32::pac;
use embassy_stm32::peripherals::ADC3;

/// Long enough for all three, which need 9 us at least (DS12110): 24 us at 16 MHz.
const SAMPLED: SampleTime = SampleTime::CYCLES387_5;

/// The converter, on and calibrated.
pub struct Gauges {
    adc: Adc<'static, ADC3>,
    reference: VrefInt,
    temperature: Temperature,
    factory: Calibration,
}

impl Gauges {
    /// Switches it on and calibrates it, which takes some 5 ms.
    pub fn start(adc: Peri<'static, ADC3>) -> Self {
        let adc = Adc::new(adc);
        let (reference, temperature) = (adc.enable_vrefint(), adc.enable_temperature());
        Self { adc, reference, temperature, factory: calibration() }
    }

    /// Reads all three: 0.1 ms.
    pub fn read(&mut self) -> Gauged {
        // The divider draws from the cell while it is on.
        let mut cell = self.adc.enable_vbat();
        let codes = Codes {
            reference: self.adc.blocking_read(&mut self.reference, SAMPLED),
            temperature: self.adc.blocking_read(&mut self.temperature, SAMPLED),
            cell: self.adc.blocking_read(&mut cell, SAMPLED),
        };
        pac::ADC3_COMMON.ccr().modify(|w| w.set_vbaten(false));
        codes.gauged(&self.factory)
    }
}

/// What the factory wrote (DS12110: VREFINT_CAL, TS_CAL1, TS_CAL2).
fn calibration() -> Calibration {
    const REFERENCE: *const u16 = 0x1ff1_e860 as *const u16;
    const AT_30_C: *const u16 = 0x1ff1_e820 as *const u16;
    const AT_110_C: *const u16 = 0x1ff1_e840 as *const u16;
    // SAFETY: words of the processor's own read-only memory.
    unsafe {
        Calibration {
            reference: REFERENCE.read_volatile(),
            temperature: (AT_30_C.read_volatile(), AT_110_C.read_volatile()),
        }
    }
}
