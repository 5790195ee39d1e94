//! A satellite receiver: its pulse on PA0, captured by TIM5, and its sentences on USART2.
//!
//! TIM5 keeps the moment of the pulse in hardware. Its interrupt then waits for the converter's next edge (16 us at 64 kHz),
//! whose number is that of a sample: how late the edge was is read from the same counter, so that the time the interrupt
//! took to begin does not matter.

use super::clock::{TICKS_PER_US, now_ticks, now_us};
use super::counter::edges;
use super::link::Incoming;
use super::until;
use crate::receiver::{Pulse, Reception};
use core::cell::Cell;
use critical_section::Mutex;
use embassy_stm32::Peri;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::{self, gpio, timer};
use embassy_stm32::peripherals::PA0;

/// Bytes that may come between two looks: half a second at 9600 baud.
pub const RING_BYTES: usize = 512;
/// An edge so long after the pulse, in ticks, is of a core that was held: the board's clock is 1 % wrong.
const LATEST: u32 = 2000 * TICKS_PER_US;

/// The newest pulse.
static NEWEST: Mutex<Cell<Option<Pulse>>> = Mutex::new(Cell::new(None));

/// Called by TIM5's interrupt.
pub fn on_pulse() {
    let counter = pac::TIM5;
    let captured = counter.ccr(0).read();
    let twice = counter.sr().read().ccof(0);
    counter.sr().write_value(timer::regs::SrGp16(0));
    let before = edges();
    let mut after = before;
    let met = until(|| {
        after = edges();
        after != before
    });
    let now = now_ticks();
    let late = (now as u32).wrapping_sub(captured);
    if twice || !met || late > LATEST {
        return;
    }
    let pulse = Pulse {
        edge: after.wrapping_sub(1),
        late_ns: late * 1000 / TICKS_PER_US,
        at_us: now.wrapping_sub(u64::from(late)) / u64::from(TICKS_PER_US),
    };
    critical_section::with(|cs| NEWEST.borrow(cs).set(Some(pulse)));
}

/// Pulse and sentences.
pub struct Satellites {
    _claimed: Peri<'static, PA0>,
    sentences: Incoming,
}

impl Satellites {
    /// Listens to both; the board's clock runs.
    pub fn new(pin: Peri<'static, PA0>, sentences: Incoming) -> Self {
        pac::RCC.ahb4enr().modify(|w| w.set_gpioaen(true));
        let port = pac::GPIOA;
        // Without a receiver the pin must not float.
        port.pupdr().modify(|w| w.set_pupdr(0, gpio::vals::Pupdr::PULL_DOWN));
        port.afr(0).modify(|w| w.set_afr(0, 2));
        port.moder().modify(|w| w.set_moder(0, gpio::vals::Moder::ALTERNATE));
        let counter = pac::TIM5;
        counter.ccmr_input(0).modify(|w| {
            w.set_ccs(0, timer::vals::CcmrInputCcs::TI4);
            w.set_icf(0, timer::vals::FilterValue::FCK_INT_N8);
        });
        counter.ccer().modify(|w| w.set_cce(0, true));
        counter.dier().modify(|w| w.set_ccie(0, true));
        interrupt::TIM5.set_priority(Priority::P5);
        // SAFETY: the handler only reads timers and sets the newest pulse.
        unsafe { interrupt::TIM5.enable() };
        Self { _claimed: pin, sentences }
    }
}

impl Reception for Satellites {
    fn pulse(&mut self) -> Option<Pulse> {
        critical_section::with(|cs| NEWEST.borrow(cs).take())
    }

    fn byte(&mut self) -> Option<u8> {
        self.sentences.byte()
    }

    fn now_us(&mut self) -> u64 {
        now_us()
    }
}
