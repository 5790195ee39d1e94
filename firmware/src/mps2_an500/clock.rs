//! SysTick as a counter of work: with QEMU's `-icount shift=0` one tick of the 25 MHz core clock is 40 instructions.

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use seabearing_core::port::Clock;

/// The counter has 24 bits and counts down.
const WRAP: u32 = 1 << 24;

/// Ticks of the core clock; one difference may span at most 2^24 ticks (0.67 s).
pub struct CoreTicks {
    total: u32,
    last: u32,
}

impl CoreTicks {
    /// Starts SysTick on the core clock.
    pub fn new(mut syst: SYST) -> Self {
        syst.set_clock_source(SystClkSource::Core);
        syst.set_reload(WRAP - 1);
        syst.clear_current();
        syst.enable_counter();
        Self { total: 0, last: SYST::get_current() }
    }
}

impl Clock for CoreTicks {
    fn ticks(&mut self) -> u32 {
        let now = SYST::get_current();
        self.total = self.total.wrapping_add(self.last.wrapping_sub(now) % WRAP);
        self.last = now;
        self.total
    }
}
