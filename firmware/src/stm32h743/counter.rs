//! The converter's edges, counted by hardware: TIM1 counts the falling edges of data ready, TIM2 the overflows of TIM1. 48
//! bits that count whether the core runs or not (RM0433, 38.3.5 and 38.3.26). Channel 3 of TIM1 wakes the core.

use super::clock::now_us;
use crate::pace::Stamp;
use core::cell::Cell;
use critical_section::Mutex;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::{self, timer};

/// Edges from one wake-up of the core to the next: 4 ms at 64 kHz, 64 ms at 250 Hz.
pub const WAKE_EDGES: u16 = if cfg!(feature = "seismic") { 16 } else { 256 };

/// What shorter pulses than are no edges: so many samples of the timer's clock in a row must agree. The array's converter, where nobody
/// reads it, lifts its line for four periods of its clock, 488 ns; a seismic one for 977 ns. 8 samples at 240 MHz / 8: 267 ns; 6
/// at 64 MHz / 4: 375 ns.
const FILTER: timer::vals::FilterValue = if cfg!(feature = "seismic") {
    timer::vals::FilterValue::FDTS_DIV4_N6
} else {
    timer::vals::FilterValue::FDTS_DIV8_N8
};

/// Times that a moment is noted anew where edges came meanwhile.
const TRIES: u8 = 3;

/// Where data ready comes in: PE9, channel 1 of TIM1, or PE11, channel 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Input {
    /// PE9.
    One,
    /// PE11.
    #[cfg(feature = "seismic")]
    Two,
}

impl Input {
    /// The channel of TIM1, from 0.
    pub fn channel(self) -> usize {
        self as usize
    }
}

/// The newest count of edges at a wake-up, and when.
static NOTED: Mutex<Cell<Stamp>> = Mutex::new(Cell::new(Stamp { edges: 0, at_us: 0 }));

/// Edges counted by both timers.
pub(super) fn edges() -> u64 {
    loop {
        let high = pac::TIM2.cnt().read();
        let low = pac::TIM1.cnt().read().cnt();
        if pac::TIM2.cnt().read() == high {
            return u64::from(high) << 16 | u64::from(low);
        }
    }
}

/// The newest count of edges at a wake-up, and when.
pub(super) fn stamp() -> Stamp {
    critical_section::with(|cs| NOTED.borrow(cs).get())
}

/// Called by TIM1's interrupt, once in [`WAKE_EDGES`] edges: notes the moment, which ends the core's sleep.
pub fn on_wake() {
    let timer = pac::TIM1;
    timer.sr().write_value(timer::regs::SrAdv(!(1 << 3)));
    // Edge and moment belong together, whatever interrupts; but a line that swings without end is not waited for.
    let (mut counted, mut at_us) = (edges(), now_us());
    for _ in 0..TRIES {
        let again = edges();
        if again == counted {
            break;
        }
        (counted, at_us) = (again, now_us());
    }
    timer.ccr(2).write_value(timer::regs::Ccr1ch(u32::from((counted as u16).wrapping_add(WAKE_EDGES))));
    let stamp = Stamp { edges: counted, at_us };
    critical_section::with(|cs| NOTED.borrow(cs).set(stamp));
}

/// Whether it counts: the timers have their clocks.
pub(super) fn is_counting() -> bool {
    let rcc = pac::RCC;
    rcc.apb2enr().read().tim1en() && rcc.apb1lenr().read().tim2en()
}

/// Begins to count, on the first input.
pub(super) fn start() {
    pac::RCC.apb1lenr().modify(|w| w.set_tim2en(true));
    pac::RCC.apb2enr().modify(|w| w.set_tim1en(true));
    let (low, high) = (pac::TIM1, pac::TIM2);
    high.smcr().write(|w| {
        w.set_ts(timer::vals::Ts::ITR0);
        w.set_sms(timer::vals::Sms::EXT_CLOCK_MODE);
    });
    high.cr1().write(|w| w.set_cen(true));
    low.cr2().write(|w| w.set_mms(timer::vals::Mms::UPDATE));
    low.ccmr_input(0).write(|w| {
        for channel in 0..1 + usize::from(cfg!(feature = "seismic")) {
            w.set_ccs(channel, timer::vals::CcmrInputCcs::TI4);
            w.set_icf(channel, FILTER);
        }
    });
    low.ccer().write(|w| {
        for channel in 0..1 + usize::from(cfg!(feature = "seismic")) {
            w.set_ccp(channel, true);
            w.set_cce(channel, true);
        }
    });
    low.smcr().write(|w| {
        w.set_ts(timer::vals::Ts::TI1FP1);
        w.set_sms(timer::vals::Sms::EXT_CLOCK_MODE);
    });
    low.ccr(2).write_value(timer::regs::Ccr1ch(u32::from(WAKE_EDGES)));
    low.dier().write(|w| w.set_ccie(2, true));
    low.cr1().write(|w| w.set_cen(true));
    interrupt::TIM1_CC.set_priority(Priority::P5);
    // SAFETY: the handler only touches TIM1 and the noted stamp.
    unsafe { interrupt::TIM1_CC.enable() };
}

/// Counts the edges of this input from now on; those counted so far stay.
#[cfg(feature = "seismic")]
pub(super) fn count(input: Input) {
    let timer = pac::TIM1;
    let trigger = match input {
        Input::One => timer::vals::Ts::TI1FP1,
        Input::Two => timer::vals::Ts::TI2FP2,
    };
    // Without its slave mode it would count its own clock, and the trigger may not change meanwhile.
    timer.cr1().modify(|w| w.set_cen(false));
    timer.smcr().modify(|w| w.set_sms(timer::vals::Sms::DISABLED));
    timer.smcr().modify(|w| w.set_ts(trigger));
    timer.smcr().modify(|w| w.set_sms(timer::vals::Sms::EXT_CLOCK_MODE));
    timer.cr1().modify(|w| w.set_cen(true));
}

/// Whether every edge of an input asks for DMA.
pub(super) fn ask_for_dma(input: Input, on: bool) {
    pac::TIM1.dier().modify(|w| w.set_ccde(input.channel(), on));
}
