//! What a board has left: its record.

use seabearing_core::wire;
use serde::Serialize;

/// How far a board is from what it must not reach; comes after `health` from boards that can measure it.
#[derive(Clone, Copy, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Margins {
    /// Memory that the stack may fill, bytes.
    pub memory_bytes: u32,
    /// How much of it was never used since the start, bytes.
    pub memory_free_bytes: u32,
    /// The longest work on one block of samples since the start, s.
    pub longest_s: f64,
    /// Records that wait for the base station; null on a line without a link.
    pub waiting: Option<u32>,
    /// About how many records of the usual length there is room for; null on a line without a link.
    pub room: Option<u32>,
    /// The processor's supply, V; null where it was not measured.
    pub supply_v: Option<f64>,
    /// The cell that keeps the clock, V; null where it was not measured.
    pub battery_v: Option<f64>,
    /// Temperature of the processor, °C; null where it was not measured.
    pub temperature_c: Option<i8>,
}

impl From<&wire::Margins> for Margins {
    fn from(m: &wire::Margins) -> Self {
        let of_link = |n| (m.room > 0).then_some(n);
        let volts = |mv| f64::from(mv) / 1000.0;
        Self {
            memory_bytes: m.memory,
            memory_free_bytes: m.memory_free,
            longest_s: f64::from(m.longest_us) / 1e6,
            waiting: of_link(m.waiting),
            room: of_link(m.room),
            supply_v: m.supply_mv.map(volts),
            battery_v: m.battery_mv.map(volts),
            temperature_c: m.temperature_c,
        }
    }
}
