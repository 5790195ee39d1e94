//! How far a board is from what it must not reach.

use serde::{Deserialize, Serialize};

/// What a board has left of memory, time, room and supply; comes after each `Health` from boards that can measure it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Margins {
    /// Sample index after the last sample seen.
    pub index: u64,
    /// Memory that the stack may fill, bytes.
    pub memory: u32,
    /// How much of it was never used since the start, bytes.
    pub memory_free: u32,
    /// The longest work on one block of samples since the start, µs.
    pub longest_us: u32,
    /// Records that wait for the base station; 0 on a line without a link.
    pub waiting: u32,
    /// About how many records of the usual length there is room for; 0 on a line without a link.
    pub room: u32,
    /// The processor's supply, mV.
    pub supply_mv: Option<u16>,
    /// The cell that keeps the clock, mV.
    pub battery_mv: Option<u16>,
    /// Temperature of the processor, °C.
    pub temperature_c: Option<i8>,
}
