//! Streams of DMA1 that an edge sets going: how they are set up and stopped, and what they do for a bus.
//!
//! ```text
//! edge -> TIM1 request -> DMA1 stream 0: SPI1_IFCR = all flags
//!      -> DMAMUX event 0 -> request generator 0, thrice -> stream 1: SPI1_CR1 = 0, then SPE, then SPE and CSTART
//!                        request generator 1        -> stream 7: TIM5_CNT kept (ocean bottom)
//! SPI1 -> its requests -> stream 2: what comes into a ring; stream 3: zeros out
//! ```
//!
//! SPI1 is switched off and on before every transfer because the manual advises it after an end of transfer (RM0433, 50.4.9).

use super::counter::Input;
#[cfg(feature = "seismic")]
use core::sync::atomic::{AtomicU32, Ordering};
use embassy_stm32::pac::{self, dma, spi};

const TIM1_CH1: u8 = 11;
const SPI1_TX: u8 = 38;
/// SPI1's request to take what came.
pub(super) const SPI1_RX: u8 = 37;
const GENERATOR_0: u8 = 1;
#[cfg(feature = "seismic")]
const GENERATOR_1: u8 = 2;
const STREAM_CLEAR: usize = 0;
const STREAM_START: usize = 1;
/// Takes what SPI1 heard.
pub(super) const STREAM_RX: usize = 2;
const STREAM_TX: usize = 3;
/// The last of the four.
#[cfg(not(feature = "seismic"))]
pub(super) const LAST: usize = STREAM_TX;
/// Keeps the moment of every edge.
#[cfg(feature = "seismic")]
pub(super) const STREAM_MOMENT: usize = 7;

/// TIM5's count at the newest edge, where DMA puts it.
#[cfg(feature = "seismic")]
static MOMENT: AtomicU32 = AtomicU32::new(0);

const SPI_ON: u32 = 1;
const SPI_START: u32 = 1 << 9 | SPI_ON;
/// End of transfer, sent and received, overrun, underrun, suspended: all flags that stay.
pub(super) const SPI_FLAGS: u32 = 0xff8;

/// What DMA writes to SPI1_IFCR and SPI1_CR1, and what it sends.
static CLEAR: u32 = SPI_FLAGS;
static START: [u32; 3] = [0, SPI_ON, SPI_START];
static ZERO: u16 = 0;

fn stream(n: usize) -> dma::St {
    pac::DMA1.st(n)
}

/// Starts a transfer of SPI1 as an edge would.
pub(super) fn start_by_hand() {
    pac::SPI1.ifcr().write_value(spi::regs::Ifcr(SPI_FLAGS));
    START.iter().for_each(|value| pac::SPI1.cr1().write_value(spi::regs::Cr1(*value)));
}

/// Switches a stream off and forgets its flags.
fn halt(n: usize) {
    stream(n).cr().modify(|w| w.set_en(false));
    super::until(|| !stream(n).cr().read().en());
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

fn to_bus(w: &mut dma::regs::Cr, size: dma::vals::Size, minc: bool) {
    w.set_dir(dma::vals::Dir::MEMORY_TO_PERIPHERAL);
    w.set_circ(true);
    w.set_minc(minc);
    w.set_psize(size);
    w.set_msize(size);
    w.set_pl(dma::vals::Pl::HIGH);
}

/// Puts what a bus hears, two bytes at a time, into a ring from its start on.
pub(super) fn receive(n: usize, request: u8, bus: spi::Spi, ring: *mut u16, items: u16) {
    let rx = bus.rxdr16().as_ptr() as u32;
    prepare(n, request, false, rx, ring as u32, items, |w| {
        w.set_circ(true);
        w.set_minc(true);
        w.set_psize(dma::vals::Size::BITS16);
        w.set_msize(dma::vals::Size::BITS16);
        w.set_pl(dma::vals::Pl::VERY_HIGH);
    });
}

/// Makes every request of this input start a transfer of SPI1 that says zeros.
pub(super) fn start_by_edges(input: Input) {
    // The number of requests is set while the generator is off.
    let generator = pac::DMAMUX1.rgcr(0);
    generator.write(|w| {
        w.set_sig_id(0);
        w.set_gnbreq(START.len() as u8 - 1);
        w.set_gpol(pac::dmamux::vals::Pol::RISING_EDGE);
    });
    generator.modify(|w| w.set_ge(true));
    let bus = pac::SPI1;
    let word = dma::vals::Size::BITS32;
    let (cr1, ifcr, tx) =
        (bus.cr1().as_ptr() as u32, bus.ifcr().as_ptr() as u32, bus.txdr16().as_ptr() as u32);
    let zero = &raw const ZERO;
    prepare(STREAM_TX, SPI1_TX, false, tx, zero as u32, 1, |w| to_bus(w, dma::vals::Size::BITS16, false));
    let start = &raw const START;
    prepare(STREAM_START, GENERATOR_0, false, cr1, start as u32, START.len() as u16, |w| {
        to_bus(w, word, true)
    });
    let clear = &raw const CLEAR;
    let request = TIM1_CH1 + input.channel() as u8;
    prepare(STREAM_CLEAR, request, true, ifcr, clear as u32, 1, |w| to_bus(w, word, false));
}

/// Makes every edge that starts a transfer leave its moment too.
#[cfg(feature = "seismic")]
pub(super) fn keep_moments() {
    let generator = pac::DMAMUX1.rgcr(1);
    generator.write(|w| w.set_gpol(pac::dmamux::vals::Pol::RISING_EDGE));
    generator.modify(|w| w.set_ge(true));
    let count = pac::TIM5.cnt().as_ptr() as u32;
    prepare(STREAM_MOMENT, GENERATOR_1, false, count, MOMENT.as_ptr() as u32, 1, |w| {
        w.set_circ(true);
        w.set_psize(dma::vals::Size::BITS32);
        w.set_msize(dma::vals::Size::BITS32);
        w.set_pl(dma::vals::Pl::VERY_HIGH);
    });
}

/// TIM5's count at the newest edge.
#[cfg(feature = "seismic")]
pub(super) fn newest_moment() -> u32 {
    MOMENT.load(Ordering::Relaxed)
}

/// Stops streams up to this one, and the generators.
pub(super) fn stop(last: usize) {
    (0..=last).for_each(halt);
    pac::DMAMUX1.rgcr(0).write(|_| {});
    #[cfg(feature = "seismic")]
    pac::DMAMUX1.rgcr(1).write(|_| {});
}

/// Bytes that a stream has put into its ring of so many items, modulo its length.
pub(super) fn received(n: usize, items: u16) -> usize {
    let left = stream(n).ndtr().read().ndt();
    usize::from(items - left.min(items)) % usize::from(items) * 2
}
