//! A satellite receiver: its pulse on PA0, captured by TIM5, and its sentences on USART2.
//!
//! TIM5 keeps the moment of the pulse in hardware. Its interrupt then waits for the converter's next edge (16 us at 64 kHz),
//! whose number is that of a sample: how late the edge was is read from the same counter, so that the time the interrupt
//! took to begin does not matter. At the ocean bottom, where the next edge is up to 4 ms away, DMA has kept the moment of the
//! newest one ([`super::streams`]), from the same counter too: nobody waits.

use super::clock::{TICKS_PER_US, now_ticks, now_us};
use super::link::Incoming;
use crate::receiver::{Pulse, Reception};
use core::cell::Cell;
use critical_section::Mutex;
use embassy_stm32::Peri;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::{self, gpio, timer};
use embassy_stm32::peripherals::PA0;

/// Bytes that may come between two looks: half a second at 9600 baud.
pub const RING_BYTES: usize = 512;
/// An edge so far from the pulse, in ticks, is of a core that was held: the board's clock is 1 % wrong.
const FARTHEST: u32 = if cfg!(feature = "seismic") { 8000 } else { 2000 } * TICKS_PER_US;

/// Sooner after another, in ticks, it is no pulse of a second's: nobody waits for an edge then.
const SOONEST: u32 = 500_000 * TICKS_PER_US;

/// The newest pulse, and TIM5's count at the newest that was looked at.
static NEWEST: Mutex<Cell<Option<Pulse>>> = Mutex::new(Cell::new(None));
static LOOKED_AT: Mutex<Cell<Option<u32>>> = Mutex::new(Cell::new(None));

/// The number of an edge near this moment, and TIM5's count at it.
#[cfg(feature = "seismic")]
fn edge_near() -> Option<(u64, u32)> {
    super::seismic::newest_edge()
}

/// The number of the next edge, and TIM5's count at it.
#[cfg(not(feature = "seismic"))]
fn edge_near() -> Option<(u64, u32)> {
    use super::counter::edges;
    let before = edges();
    let mut after = before;
    let met = super::until(|| {
        after = edges();
        after != before
    });
    met.then(|| (after.wrapping_sub(1), now_ticks() as u32))
}

/// Called by TIM5's interrupt.
pub fn on_pulse() {
    let counter = pac::TIM5;
    let captured = counter.ccr(0).read();
    let twice = counter.sr().read().ccof(0);
    counter.sr().write_value(timer::regs::SrGp16(0));
    let before = critical_section::with(|cs| LOOKED_AT.borrow(cs).get());
    let soon = before.is_some_and(|before| captured.wrapping_sub(before) < SOONEST);
    // While it waits a board counts no edges.
    if twice || soon || !super::counter::is_counting() {
        return;
    }
    critical_section::with(|cs| LOOKED_AT.borrow(cs).set(Some(captured)));
    let Some((edge, moment)) = edge_near() else { return };
    let late = moment.wrapping_sub(captured).cast_signed();
    if late.unsigned_abs() > FARTHEST {
        return;
    }
    let now = now_ticks();
    let since = u64::from((now as u32).wrapping_sub(captured));
    let pulse = Pulse {
        edge,
        late_ns: (i64::from(late) * 1000 / i64::from(TICKS_PER_US)) as i32,
        at_us: now.wrapping_sub(since) / u64::from(TICKS_PER_US),
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
