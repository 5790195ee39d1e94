//! Time of the model.

/// Moments and lengths of time of the board's own clock, in [`PER_SECOND`]ths of a second.
pub type Ticks = u64;

/// Ticks of a second: a multiple of all frequencies in use (480 MHz, 8.192 MHz, 25 MHz, 32.768 kHz); a 64-bit count
/// lasts 27 days.
pub const PER_SECOND: u64 = 7_680_000_000_000;

/// Ticks of a period of a frequency, to the nearest.
pub fn period(hz: u64) -> Ticks {
    (PER_SECOND + hz / 2) / hz.max(1)
}

/// A moment that never comes.
pub const NEVER: Ticks = u64::MAX;
