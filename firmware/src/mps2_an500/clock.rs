//! SysTick as a counter of work (with QEMU's `-icount shift=0` one tick of the 25 MHz core clock is 40 instructions), and
//! the board's first timer as the clock that goes on while the core sleeps.

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use seabearing_core::port::Clock;

/// The counter has 24 bits and counts down.
const WRAP: u32 = 1 << 24;

/// ARM's CMSDK timer 0: counts down at 25 MHz from `reload`, and raises an interrupt at each end.
const TIMER: *mut Timer = 0x4000_0000 as *mut Timer;
const TIMER_HZ: u32 = 25_000_000;
/// Counting and interrupt on.
const TIMER_ON: u32 = 1 | 1 << 3;
/// Interrupt of the timer: it wakes the core, and is never taken.
pub const TIMER_IRQ: u32 = 1 << 8;

/// Registers of the timer, in order of address.
#[repr(C)]
struct Timer {
    control: u32,
    value: u32,
    reload: u32,
    interrupt: u32,
}

/// Ticks of the core clock; one difference may span at most 2^24 ticks (0.67 s).
pub struct BoardClock {
    total: u32,
    last: u32,
    seconds: u32,
}

impl BoardClock {
    /// Starts SysTick on the core clock, and the timer.
    pub fn new(mut syst: SYST) -> Self {
        syst.set_clock_source(SystClkSource::Core);
        syst.set_reload(WRAP - 1);
        syst.clear_current();
        syst.enable_counter();
        // SAFETY: the timer's own registers, which nothing else touches.
        unsafe {
            (&raw mut (*TIMER).reload).write_volatile(TIMER_HZ - 1);
            (&raw mut (*TIMER).value).write_volatile(TIMER_HZ - 1);
            (&raw mut (*TIMER).control).write_volatile(TIMER_ON);
        }
        Self { total: 0, last: SYST::get_current(), seconds: 0 }
    }
}

impl Clock for BoardClock {
    fn ticks(&mut self) -> u32 {
        let now = SYST::get_current();
        self.total = self.total.wrapping_add(self.last.wrapping_sub(now) % WRAP);
        self.last = now;
        self.total
    }

    /// Ends of the timer seen: exact while asked for once a second, as during a silence; fewer otherwise.
    fn seconds(&mut self) -> u32 {
        // SAFETY: as above; writing one clears what was read.
        unsafe {
            if (&raw const (*TIMER).interrupt).read_volatile() != 0 {
                (&raw mut (*TIMER).interrupt).write_volatile(1);
                self.seconds = self.seconds.wrapping_add(1);
            }
        }
        self.seconds
    }

    /// Whole seconds and what the timer has counted of the next.
    fn micros(&mut self) -> u64 {
        loop {
            let seconds = self.seconds();
            // SAFETY: as above.
            let left = unsafe { (&raw const (*TIMER).value).read_volatile() };
            if self.seconds() == seconds {
                let ticks = TIMER_HZ.saturating_sub(left);
                return u64::from(seconds) * 1_000_000 + u64::from(ticks / (TIMER_HZ / 1_000_000));
            }
        }
    }
}
