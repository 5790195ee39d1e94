//! The converter on SPI1, moved by hardware: every data-ready edge is counted and starts a transfer into a ring.
//!
//! PE9 is channel 1 of TIM1. Its falling edges clock TIM1, whose overflows clock TIM2: 48 bits that count edges whether
//! the core runs or not (RM0433, 38.3.5 and 38.3.26). The same edge asks for DMA by the channel's capture:
//!
//! ```text
//! edge -> TIM1_CH1 request -> DMA1 stream 0: SPI1_IFCR = all flags
//!      -> DMAMUX event 0 -> request generator 0, thrice -> stream 1: SPI1_CR1 = 0, then SPE, then SPE and CSTART
//! SPI1 -> its requests -> stream 2: frame into the ring; stream 3: zeros out (the converter's null command)
//! ```
//!
//! SPI1 is switched off and on before every transfer because the manual advises it after an end of transfer (RM0433,
//! 50.4.9). Chip select is SPI1's own (PA4). The core hears of it once in [`WAKE_EDGES`] edges.

use super::clock::now_us;
use crate::acquisition::{Board, RING_BYTES};
use crate::converter::{Bus, FRAME_BYTES};
use crate::pace::Stamp;
use core::cell::Cell;
use core::ptr::addr_of_mut;
use critical_section::Mutex;
use embassy_stm32::Peri;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::{self, dma, gpio, spi, timer};
use embassy_stm32::peripherals::{PA4, PA5, PA6, PB5, PE9, SPI1, TIM1, TIM2};

/// Edges from one wake-up of the core to the next: 4 ms at 64 kHz.
pub const WAKE_EDGES: u16 = 256;

const TIM1_CH1: u8 = 11;
const SPI1_RX: u8 = 37;
const SPI1_TX: u8 = 38;
const GENERATOR_0: u8 = 1;
const STREAM_CLEAR: usize = 0;
const STREAM_START: usize = 1;
const STREAM_RX: usize = 2;
const STREAM_TX: usize = 3;
/// Two bytes an access.
const RING_ITEMS: u16 = (RING_BYTES / 2) as u16;
/// Longest wait for a transfer or a pair of edges, in cycles of the core: two periods at 8 kHz.
const PATIENCE_CYCLES: u32 = super::CORE_HZ / 1000;

const SPI_ON: u32 = 1;
const SPI_START: u32 = 1 << 9 | SPI_ON;

/// End of transfer, sent and received, overrun, underrun, suspended: all flags that stay.
const SPI_FLAGS: u32 = 0xff8;

/// What DMA writes to SPI1_IFCR and SPI1_CR1, and what it sends.
static CLEAR: u32 = SPI_FLAGS;
static START: [u32; 3] = [0, SPI_ON, SPI_START];
static ZERO: u16 = 0;

/// The newest count of edges at a wake-up, and when.
static NOTED: Mutex<Cell<Stamp>> = Mutex::new(Cell::new(Stamp { edges: 0, at_us: 0 }));

/// What the converter's hardware occupies.
pub type Claimed = (
    (Peri<'static, SPI1>, Peri<'static, TIM1>, Peri<'static, TIM2>),
    (Peri<'static, PA4>, Peri<'static, PA5>, Peri<'static, PA6>, Peri<'static, PB5>, Peri<'static, PE9>),
);

/// The converter's bus, counter and ring.
pub struct Sampling {
    _claimed: Claimed,
    ring: &'static mut [u16; RING_BYTES / 2],
}

fn stream(n: usize) -> dma::St {
    pac::DMA1.st(n)
}

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

/// Called by TIM1's interrupt, once in [`WAKE_EDGES`] edges: notes the moment, which ends the core's sleep.
pub fn on_wake() {
    let timer = pac::TIM1;
    timer.sr().write_value(timer::regs::SrAdv(!(1 << 3)));
    let edges = edges();
    timer.ccr(2).write_value(timer::regs::Ccr1ch(u32::from((edges as u16).wrapping_add(WAKE_EDGES))));
    let stamp = Stamp { edges, at_us: now_us() };
    critical_section::with(|cs| NOTED.borrow(cs).set(stamp));
}

impl Sampling {
    /// Clocks, pins, counters and bus; nothing moves yet.
    pub fn new(claimed: Claimed, ring: &'static mut [u16; RING_BYTES / 2]) -> Self {
        let rcc = pac::RCC;
        rcc.ahb1enr().modify(|w| w.set_dma1en(true));
        rcc.ahb4enr().modify(|w| {
            w.set_gpioaen(true);
            w.set_gpioben(true);
            w.set_gpioeen(true);
        });
        rcc.apb1lenr().modify(|w| w.set_tim2en(true));
        rcc.apb2enr().modify(|w| {
            w.set_tim1en(true);
            w.set_spi1en(true);
        });
        for (port, pin, function) in [
            (pac::GPIOA, 4, 5),
            (pac::GPIOA, 5, 5),
            (pac::GPIOA, 6, 5),
            (pac::GPIOB, 5, 5),
            (pac::GPIOE, 9, 1),
        ] {
            port.afr(pin / 8).modify(|w| w.set_afr(pin % 8, function));
            port.ospeedr().modify(|w| w.set_ospeedr(pin, gpio::vals::Ospeedr::VERY_HIGH_SPEED));
            port.moder().modify(|w| w.set_moder(pin, gpio::vals::Moder::ALTERNATE));
        }
        count_edges();
        let bus = pac::SPI1;
        // 96 MHz / 4 = 24 MHz, bytes, two of them a request.
        bus.cfg1().write(|w| {
            w.set_dsize(7);
            w.set_fthlv(spi::vals::Fthlv::TWO_FRAMES);
            w.set_mbr(spi::vals::Mbr::DIV4);
        });
        bus.cfg2().write(|w| {
            w.set_afcntr(true);
            w.set_ssoe(true);
            w.set_cpha(spi::vals::Cpha::SECOND_EDGE);
            w.set_master(spi::vals::Master::MASTER);
        });
        bus.cr2().write(|w| w.set_tsize(FRAME_BYTES as u16));
        Self { _claimed: claimed, ring }
    }

    /// Lets DMA serve the bus, or not; SPI1 is off afterwards.
    fn by_dma(&mut self, on: bool) {
        let bus = pac::SPI1;
        bus.cr1().write_value(spi::regs::Cr1(0));
        bus.cfg1().modify(|w| {
            w.set_rxdmaen(on);
            w.set_txdmaen(on);
        });
    }

    /// One transfer that the core starts; DMA moves it. Whether it came to its end.
    fn transfer(&mut self) -> bool {
        let bus = pac::SPI1;
        bus.ifcr().write_value(spi::regs::Ifcr(SPI_FLAGS));
        START.iter().for_each(|value| bus.cr1().write_value(spi::regs::Cr1(*value)));
        until(|| bus.sr().read().eot())
    }
}

/// Waits for something, not for ever.
pub(super) fn until(mut done: impl FnMut() -> bool) -> bool {
    let begun = cortex_m::peripheral::DWT::cycle_count();
    while !done() {
        if cortex_m::peripheral::DWT::cycle_count().wrapping_sub(begun) > PATIENCE_CYCLES {
            return false;
        }
    }
    true
}

/// TIM1 counts falling edges of PE9, TIM2 the overflows of TIM1; channel 3 of TIM1 wakes the core.
fn count_edges() {
    let (low, high) = (pac::TIM1, pac::TIM2);
    high.smcr().write(|w| {
        w.set_ts(timer::vals::Ts::ITR0);
        w.set_sms(timer::vals::Sms::EXT_CLOCK_MODE);
    });
    high.cr1().write(|w| w.set_cen(true));
    low.cr2().write(|w| w.set_mms(timer::vals::Mms::UPDATE));
    low.ccmr_input(0).write(|w| w.set_ccs(0, timer::vals::CcmrInputCcs::TI4));
    low.ccer().write(|w| {
        w.set_ccp(0, true);
        w.set_cce(0, true);
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

impl Bus for Sampling {
    fn exchange(&mut self, frame: &mut [u8; FRAME_BYTES]) {
        let bus = pac::SPI1;
        self.by_dma(false);
        bus.ifcr().write_value(spi::regs::Ifcr(SPI_FLAGS));
        START.iter().for_each(|value| bus.cr1().write_value(spi::regs::Cr1(*value)));
        let (mut sent, mut received) = (0usize, 0usize);
        until(|| {
            let status = bus.sr().read();
            if status.txp()
                && let Some(&[a, b]) = frame.as_chunks::<2>().0.get(sent)
            {
                bus.txdr16().write_value(u16::from_le_bytes([a, b]));
                sent += 1;
            }
            if status.rxp()
                && let Some(pair) = frame.as_chunks_mut::<2>().0.get_mut(received)
            {
                *pair = bus.rxdr16().read().to_le_bytes();
                received += 1;
            }
            received == FRAME_BYTES / 2
        });
        bus.cr1().write_value(spi::regs::Cr1(0));
    }

    fn wait_us(&mut self, us: u32) {
        cortex_m::asm::delay(us * (super::CORE_HZ / 1_000_000));
    }
}

impl Board for Sampling {
    fn edges(&mut self) -> u64 {
        edges()
    }

    fn stamp(&mut self) -> Stamp {
        critical_section::with(|cs| NOTED.borrow(cs).get())
    }

    fn now_us(&mut self) -> u64 {
        now_us()
    }

    fn arm(&mut self, behind: bool) -> Option<u64> {
        self.by_dma(true);
        let bus = pac::SPI1;
        let to_ring = |w: &mut dma::regs::Cr| {
            w.set_circ(true);
            w.set_minc(true);
            w.set_psize(dma::vals::Size::BITS16);
            w.set_msize(dma::vals::Size::BITS16);
            w.set_pl(dma::vals::Pl::VERY_HIGH);
        };
        let to_bus = |w: &mut dma::regs::Cr, size, minc| {
            w.set_dir(dma::vals::Dir::MEMORY_TO_PERIPHERAL);
            w.set_circ(true);
            w.set_minc(minc);
            w.set_psize(size);
            w.set_msize(size);
            w.set_pl(dma::vals::Pl::HIGH);
        };
        // The number of requests is set while the generator is off.
        let generator = pac::DMAMUX1.rgcr(0);
        generator.write(|w| {
            w.set_sig_id(0);
            w.set_gnbreq(START.len() as u8 - 1);
            w.set_gpol(pac::dmamux::vals::Pol::RISING_EDGE);
        });
        generator.modify(|w| w.set_ge(true));
        let word = dma::vals::Size::BITS32;
        let (cr1, ifcr) = (bus.cr1().as_ptr() as u32, bus.ifcr().as_ptr() as u32);
        let (tx, rx) = (bus.txdr16().as_ptr() as u32, bus.rxdr16().as_ptr() as u32);
        prepare(STREAM_RX, SPI1_RX, false, rx, addr_of_mut!(*self.ring) as u32, RING_ITEMS, to_ring);
        let zero = &raw const ZERO;
        prepare(STREAM_TX, SPI1_TX, false, tx, zero as u32, 1, |w| to_bus(w, dma::vals::Size::BITS16, false));
        let start = &raw const START;
        prepare(STREAM_START, GENERATOR_0, false, cr1, start as u32, START.len() as u16, |w| {
            to_bus(w, word, true)
        });
        let clear = &raw const CLEAR;
        prepare(STREAM_CLEAR, TIM1_CH1, true, ifcr, clear as u32, 1, |w| to_bus(w, word, false));
        critical_section::with(|_| {
            let first = if behind {
                // Two conversions wait unread in the converter: they are the ring's first.
                let begun = edges();
                if !until(|| edges() >= begun + 2) {
                    return None;
                }
                let first = edges() - 2;
                if !(self.transfer() && self.transfer()) {
                    return None;
                }
                // Both waiting results were those before the next edge, if that has not come meanwhile.
                (edges() == first + 2).then_some(first)?
            } else {
                edges()
            };
            let before = edges();
            pac::TIM1.dier().modify(|w| w.set_ccde(0, true));
            (edges() == before && (!behind || before == first + 2)).then_some(first)
        })
    }

    fn disarm(&mut self) {
        pac::TIM1.dier().modify(|w| w.set_ccde(0, false));
        for n in [STREAM_CLEAR, STREAM_START, STREAM_RX, STREAM_TX] {
            halt(n);
        }
        pac::DMAMUX1.rgcr(0).write(|_| {});
        self.by_dma(false);
    }

    fn received(&mut self) -> usize {
        let left = stream(STREAM_RX).ndtr().read().ndt();
        usize::from(RING_ITEMS - left.min(RING_ITEMS)) % usize::from(RING_ITEMS) * 2
    }

    fn frame(&mut self, slot: usize) -> [u8; FRAME_BYTES] {
        let mut bytes = [0; FRAME_BYTES];
        let words = self.ring.get(slot * (FRAME_BYTES / 2)..).unwrap_or_default();
        for (pair, word) in bytes.as_chunks_mut::<2>().0.iter_mut().zip(words) {
            // SAFETY: a valid reference; DMA writes it, so it is read anew.
            *pair = unsafe { core::ptr::read_volatile(word) }.to_le_bytes();
        }
        bytes
    }
}

/// Switches a stream off and forgets its flags.
fn halt(n: usize) {
    stream(n).cr().modify(|w| w.set_en(false));
    until(|| !stream(n).cr().read().en());
    pac::DMA1.ifcr(n / 4).write_value(dma::regs::Ixr(0x3d << [0, 6, 16, 22][n % 4]));
}

/// Sets a stream up and switches it on; `event`: its requests are passed on as an event.
fn prepare(
    n: usize,
    request: u8,
    event: bool,
    peripheral: u32,
    memory: u32,
    items: u16,
    control: impl FnOnce(&mut dma::regs::Cr),
) {
    halt(n);
    pac::DMAMUX1.ccr(n).write(|w| {
        w.set_dmareq_id(request);
        w.set_ege(event);
    });
    stream(n).par().write_value(peripheral);
    stream(n).m0ar().write_value(memory);
    stream(n).ndtr().write(|w| w.set_ndt(items));
    stream(n).cr().write(|w| {
        control(w);
        w.set_en(true);
    });
}
