//! What the processor's own converter says of supply, clock's cell and temperature.
//!
//! The processor measures against its supply, which is not known; but a reference inside it is (RM0433, 25.4.33 to 25.4.35), and what
//! the factory read of it at 3.3 V stands in the processor's memory (data sheet DS12110, table "Internal reference voltage
//! calibration values").

/// Supply at which the factory measured, mV.
const FACTORY_MV: u32 = 3300;
/// Temperatures at which the factory measured, °C.
const FACTORY_C: (i32, i32) = (30, 110);
/// The cell comes to the converter divided by so much.
const CELL_DIVIDED: u32 = 4;
/// Full scale of the converter's 16 bits.
const FULL: u32 = 65_535;
/// What the processor can be supplied with at all, mV: anything else is a wrong reading.
const POSSIBLE_MV: core::ops::RangeInclusive<u32> = 1500..=3700;
/// Temperatures that the processor bears, °C.
const POSSIBLE_C: core::ops::RangeInclusive<i32> = -45..=127;

/// What the factory read at 3.3 V.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Calibration {
    /// Of the reference.
    pub reference: u16,
    /// Of the temperature sensor at 30 and at 110 °C.
    pub temperature: (u16, u16),
}

/// Codes of the converter, at the supply there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Codes {
    /// Of the reference.
    pub reference: u16,
    /// Of the temperature sensor.
    pub temperature: u16,
    /// Of the clock's cell, divided by four.
    pub cell: u16,
}

/// What follows; `None` where a reading is impossible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gauged {
    /// The supply, mV.
    pub supply_mv: Option<u16>,
    /// The cell of the clock, mV; the supply where the pin is tied to it.
    pub cell_mv: Option<u16>,
    /// Temperature of the processor, °C.
    pub temperature_c: Option<i8>,
}

impl Codes {
    /// Volts and degrees.
    pub fn gauged(&self, factory: &Calibration) -> Gauged {
        let supply_mv = (FACTORY_MV * u32::from(factory.reference)).checked_div(self.reference.into());
        let Some(supply_mv) = supply_mv.filter(|mv| POSSIBLE_MV.contains(mv)) else {
            return Gauged::default();
        };
        let (cold, hot) = (i32::from(factory.temperature.0), i32::from(factory.temperature.1));
        // The code as it would be at 3.3 V.
        let code = (u32::from(self.temperature) * supply_mv / FACTORY_MV) as i32;
        let span = FACTORY_C.1 - FACTORY_C.0;
        let temperature = (span * (code - cold)).checked_div(hot - cold).map(|above| FACTORY_C.0 + above);
        let cell_mv = u32::from(self.cell) * CELL_DIVIDED * supply_mv / FULL;
        Gauged {
            supply_mv: u16::try_from(supply_mv).ok(),
            cell_mv: u16::try_from(cell_mv).ok(),
            temperature_c: temperature.filter(|c| POSSIBLE_C.contains(c)).and_then(|c| i8::try_from(c).ok()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FACTORY: Calibration = Calibration { reference: 24_100, temperature: (12_300, 15_500) };

    /// The codes of a supply, a cell and a temperature.
    fn codes(supply_mv: f64, cell_mv: f64, temperature_c: f64) -> Codes {
        let at = |code: f64| (code * 3300.0 / supply_mv).round() as u16;
        let temperature = 12_300.0 + 3200.0 * (temperature_c - 30.0) / 80.0;
        Codes {
            reference: at(24_100.0),
            temperature: at(temperature),
            cell: (cell_mv / 4.0 / supply_mv * 65_535.0).round() as u16,
        }
    }

    #[test]
    fn volts_and_degrees_do_not_depend_on_the_supply() {
        for supply_mv in [1800.0, 2850.0, 3300.0, 3600.0] {
            for (cell_mv, c) in [(3300.0, 4.0), (2400.0, -20.0), (1000.0, 85.0)] {
                let gauged = codes(supply_mv, cell_mv, c).gauged(&FACTORY);
                let off = |got: Option<u16>, wanted: f64| (f64::from(got.unwrap()) - wanted).abs();
                assert!(off(gauged.supply_mv, supply_mv) <= 1.0, "{gauged:?}");
                assert!(off(gauged.cell_mv, cell_mv) <= 2.0, "{gauged:?}");
                assert!((f64::from(gauged.temperature_c.unwrap()) - c).abs() <= 1.0, "{gauged:?}");
            }
        }
    }

    #[test]
    fn what_cannot_be_is_not_told() {
        let none = Codes { reference: 0, ..codes(3300.0, 3000.0, 20.0) };
        assert_eq!(none.gauged(&FACTORY), Gauged::default());
        // Words that no factory wrote.
        let erased = Calibration { reference: 0xffff, temperature: (0xffff, 0xffff) };
        assert_eq!(codes(3300.0, 3000.0, 20.0).gauged(&erased), Gauged::default());
        let half = Calibration { temperature: (0xffff, 0xffff), ..FACTORY };
        assert_eq!(codes(3300.0, 3000.0, 20.0).gauged(&half).temperature_c, None);
        assert_eq!(codes(3300.0, 3000.0, 300.0).gauged(&FACTORY).temperature_c, None);
    }
}
