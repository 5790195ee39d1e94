//! The board's clock: TIM5 counts 24ths or 32nds of a microsecond, whether the core runs or not.
//!
//! The hardware library's own time comes from a counter of 16 bits whose overflows are counted by interrupts: 65 ms without
//! the core, and it has lost some. TIM5 has 32 bits; what wraps after three minutes is carried on at every look. It is fine
//! enough to say when a pulse came ([`super::pulse`]).

use core::cell::Cell;
use critical_section::Mutex;
use embassy_stm32::Peri;
use embassy_stm32::pac;
use embassy_stm32::peripherals::TIM5;
use seabearing_core::port::Clock;

/// Frequency of timers on the first peripheral bus, MHz: twice the bus.
const TIMER_MHZ: u16 = if cfg!(feature = "seismic") { 64 } else { 240 };
/// Ticks of a microsecond.
pub const TICKS_PER_US: u32 = if cfg!(feature = "seismic") { 32 } else { 24 };

/// Ticks at the newest look.
static NEWEST: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));

/// Ticks since [`Time::start`].
pub fn now_ticks() -> u64 {
    critical_section::with(|cs| {
        let newest = NEWEST.borrow(cs);
        let now =
            newest.get().wrapping_add(u64::from(pac::TIM5.cnt().read().wrapping_sub(newest.get() as u32)));
        newest.set(now);
        now
    })
}

/// Microseconds since [`Time::start`].
pub fn now_us() -> u64 {
    now_ticks() / u64::from(TICKS_PER_US)
}

/// The core's cycle counter, and seconds.
pub struct Time {
    _claimed: Peri<'static, TIM5>,
}

impl Time {
    /// Starts both.
    pub fn start(
        timer: Peri<'static, TIM5>,
        dcb: &mut cortex_m::peripheral::DCB,
        dwt: &mut cortex_m::peripheral::DWT,
    ) -> Self {
        dcb.enable_trace();
        cortex_m::peripheral::DWT::unlock();
        dwt.enable_cycle_counter();
        pac::RCC.apb1lenr().modify(|w| w.set_tim5en(true));
        let counter = pac::TIM5;
        counter.psc().write_value(TIMER_MHZ / TICKS_PER_US as u16 - 1);
        // The prescaler is taken over by an update.
        counter.egr().write(|w| w.set_ug(true));
        counter.cr1().write(|w| w.set_cen(true));
        Self { _claimed: timer }
    }
}

impl Clock for Time {
    fn ticks(&mut self) -> u32 {
        cortex_m::peripheral::DWT::cycle_count()
    }

    fn seconds(&mut self) -> u32 {
        (now_us() / 1_000_000) as u32
    }

    fn micros(&mut self) -> u64 {
        now_us()
    }
}
