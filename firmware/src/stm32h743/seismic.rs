//! The ocean-bottom recorder's four converters, read at once and moved by hardware.
//!
//! SPI1 is their clock and their common line in (PA5, PB5) and hears the first chip (PA6); SPI2, SPI3 and SPI4 are slaves of
//! that same clock (PB13, PC10, PE12) and hear one chip each (PB15, PC12, PE14). Reset is PD14, SYNC PD15. Data ready of the
//! first chip comes in at PE9, that of the second at PE11: if the first does not answer the second's edges are counted. The
//! edge starts a transfer of four bytes ([`super::streams`]) that four streams put into four rings. The core hears of it once in
//! 16 edges and takes blocks of 64; between two conversions it reads the chips' registers back once a second,
//! and what came meanwhile is given only when they are right.

use super::clock::now_us;
use super::counter::{self, Input, edges};
use super::streams::{self, STREAM_MOMENT, STREAM_RX};
use super::{CORE_HZ, until};
use crate::acquisition::Board;
use crate::converter::Read;
use crate::pace::Stamp;
use crate::seismic::chips::{self, Answer, Bus, Settings, WORD_BYTES};
use core::cell::Cell;
use core::ptr::addr_of_mut;
use critical_section::Mutex;
use embassy_stm32::Peri;
use embassy_stm32::pac::{self, gpio, spi};
use embassy_stm32::peripherals::{
    PA5, PA6, PB5, PB13, PB15, PC10, PC12, PD14, PD15, PE9, PE11, PE12, PE14, SPI1, SPI2, SPI3, SPI4, TIM1,
    TIM2,
};
use seabearing_core::block::{CHANNELS, MISSING};

/// Conversions the rings hold: 4 s at 1000 Hz, longer than the watchdog waits.
const RING_FRAMES: usize = 4096;
/// Two bytes an access.
const RING_ITEMS: u16 = (RING_FRAMES * WORD_BYTES / 2) as u16;
/// One chip's.
type One = [u16; RING_ITEMS as usize];
/// Memory of the rings.
pub type Ring = [One; CHANNELS];
/// They before anything came.
#[allow(clippy::large_const_arrays)] // It is what a static begins with, and never a value of its own.
pub const EMPTY: Ring = [[0; RING_ITEMS as usize]; CHANNELS];

/// Requests of SPI1 to 4 to take what came.
const REQUESTS: [u8; CHANNELS] = [streams::SPI1_RX, 39, 61, 83];
/// Streams that take it: after those that an edge sets going.
const STREAMS: [usize; CHANNELS] = [STREAM_RX, 4, 5, 6];
/// From one look at the registers to the next.
const LOOK_US: u64 = 1_000_000;
/// Data ready without an edge for so long in microseconds is none: two periods of 250 Hz.
const PATIENCE_US: u64 = 8_000;
/// A transfer takes 16 us.
const TRANSFER_US: u32 = 40;

/// The number of the first edge whose moment was kept since the streams were set going.
static KEPT_FROM: Mutex<Cell<Option<u64>>> = Mutex::new(Cell::new(None));

/// The newest edge's number and TIM5's count at it, where it was kept.
pub(super) fn newest_edge() -> Option<(u64, u32)> {
    /// An edge is counted some tenths of a microsecond before its moment is kept.
    const AFTER_US: u32 = 2;
    const MOST_LOOKS: usize = 3;
    let from = critical_section::with(|cs| KEPT_FROM.borrow(cs).get())?;
    let mut looks = (0..MOST_LOOKS).map(|_| {
        let before = (edges(), streams::newest_moment());
        super::wait_us(AFTER_US);
        (before == (edges(), streams::newest_moment())).then_some(before)
    });
    let (count, moment) = looks.find_map(|look| look)?;
    (count > from).then(|| (count - 1, moment))
}

/// What the converters' hardware occupies.
pub type Claimed = (
    (Peri<'static, SPI1>, Peri<'static, SPI2>, Peri<'static, SPI3>, Peri<'static, SPI4>),
    (Peri<'static, TIM1>, Peri<'static, TIM2>),
    (Peri<'static, PA5>, Peri<'static, PA6>, Peri<'static, PB5>, Peri<'static, PB13>, Peri<'static, PB15>),
    (Peri<'static, PC10>, Peri<'static, PC12>, Peri<'static, PE12>, Peri<'static, PE14>),
    (Peri<'static, PD14>, Peri<'static, PD15>, Peri<'static, PE9>, Peri<'static, PE11>),
);

/// The chips' line, counter and rings.
pub struct Chips {
    _claimed: Claimed,
    rings: &'static mut Ring,
    settings: Settings,
    /// Whose edges are counted.
    input: Input,
    /// What each chip answered when it was set up.
    answers: [Answer; CHANNELS],
}

fn buses() -> [spi::Spi; CHANNELS] {
    [pac::SPI1, pac::SPI2, pac::SPI3, pac::SPI4]
}

impl Chips {
    /// Clocks, pins, counters and buses; nothing moves yet.
    pub fn new(claimed: Claimed, rings: &'static mut Ring, settings: Settings) -> Self {
        let rcc = pac::RCC;
        rcc.ahb1enr().modify(|w| w.set_dma1en(true));
        rcc.ahb4enr().modify(|w| {
            w.set_gpioaen(true);
            w.set_gpioben(true);
            w.set_gpiocen(true);
            w.set_gpioden(true);
            w.set_gpioeen(true);
        });
        rcc.apb1lenr().modify(|w| {
            w.set_spi2en(true);
            w.set_spi3en(true);
        });
        rcc.apb2enr().modify(|w| {
            w.set_spi1en(true);
            w.set_spi4en(true);
        });
        for (port, pin, function) in [
            (pac::GPIOA, 5, 5),
            (pac::GPIOA, 6, 5),
            (pac::GPIOB, 5, 5),
            (pac::GPIOB, 13, 5),
            (pac::GPIOB, 15, 5),
            (pac::GPIOC, 10, 6),
            (pac::GPIOC, 12, 6),
            (pac::GPIOE, 12, 5),
            (pac::GPIOE, 14, 5),
            (pac::GPIOE, 9, 1),
            (pac::GPIOE, 11, 1),
        ] {
            port.afr(pin / 8).modify(|w| w.set_afr(pin % 8, function));
            // A cut line, or a chip without supply, reads high and makes no edges.
            port.pupdr().modify(|w| w.set_pupdr(pin, gpio::vals::Pupdr::PULL_UP));
            port.moder().modify(|w| w.set_moder(pin, gpio::vals::Moder::ALTERNATE));
        }
        // Reset and SYNC low until the chips are set up.
        pac::GPIOD.bsrr().write(|w| {
            w.set_br(14, true);
            w.set_br(15, true);
        });
        pac::GPIOD.moder().modify(|w| {
            w.set_moder(14, gpio::vals::Moder::OUTPUT);
            w.set_moder(15, gpio::vals::Moder::OUTPUT);
        });
        counter::start();
        // 64 MHz / 32 = 2 MHz, bytes.
        for bus in buses() {
            bus.cfg1().write(|w| {
                w.set_dsize(7);
                w.set_mbr(spi::vals::Mbr::DIV32);
            });
        }
        pac::SPI1.cfg2().write(|w| {
            w.set_afcntr(true);
            w.set_ssoe(true);
            w.set_master(spi::vals::Master::MASTER);
        });
        for bus in buses().into_iter().skip(1) {
            bus.cfg2().write(|w| {
                w.set_comm(spi::vals::Comm::RECEIVER);
                w.set_ssm(true);
            });
        }
        let answers = [Answer::Silent; CHANNELS];
        Self { _claimed: claimed, rings, settings, input: Input::One, answers }
    }

    /// Lets DMA serve the buses, a conversion a transfer, or the core, a byte a transfer. SPI1 is off afterwards; the slaves are
    /// on, with nothing heard yet.
    fn by_dma(&mut self, on: bool) {
        for bus in buses() {
            bus.cr1().write_value(spi::regs::Cr1(0));
            bus.ifcr().write_value(spi::regs::Ifcr(streams::SPI_FLAGS));
            bus.cfg1().modify(|w| {
                w.set_fthlv(if on { spi::vals::Fthlv::TWO_FRAMES } else { spi::vals::Fthlv::ONE_FRAME });
                w.set_rxdmaen(on);
            });
        }
        pac::SPI1.cfg1().modify(|w| w.set_txdmaen(on));
        pac::SPI1.cr2().write(|w| w.set_tsize(if on { WORD_BYTES as u16 } else { 1 }));
        buses().iter().skip(1).for_each(|bus| bus.cr1().write(|w| w.set_spe(true)));
    }

    /// One look at all chips' registers, between two conversions: whether they are as they were set.
    fn looks_as_set(&mut self) -> bool {
        let (begun, begun_us) = (edges(), now_us());
        // Right after an edge, or when there are none.
        while edges() == begun && now_us().saturating_sub(begun_us) < PATIENCE_US {}
        let at = edges();
        super::wait_us(TRANSFER_US);
        self.by_dma(false);
        let settings = self.settings;
        let answers = chips::look(self, settings);
        self.by_dma(true);
        // If an edge came meanwhile what was heard is no answer, and the rings no longer agree with the edges. Where all are silent
        // while their edges come the line is cut: setting them up would only spoil the count.
        edges() != at || answers == self.answers || answers == [Answer::Silent; CHANNELS]
    }

    /// A level of a pin of port D.
    fn pin(&mut self, pin: usize, high: bool) {
        pac::GPIOD.bsrr().write(|w| if high { w.set_bs(pin, true) } else { w.set_br(pin, true) });
    }
}

impl Bus for Chips {
    fn exchange(&mut self, byte: u8) -> [u8; CHANNELS] {
        streams::start_by_hand();
        pac::SPI1.txdr8().write_value(byte);
        // What does not come is the level of a line that nobody drives.
        buses().map(|bus| if until(|| bus.sr().read().rxp()) { bus.rxdr8().read() } else { 0xff })
    }

    fn wait_us(&mut self, us: u32) {
        super::wait_us(us);
    }

    fn reset(&mut self, high: bool) {
        self.pin(14, high);
    }

    fn sync(&mut self, high: bool) {
        self.pin(15, high);
    }
}

impl Board for Chips {
    const RING_FRAMES: usize = RING_FRAMES;
    const FRAME_BYTES: usize = WORD_BYTES;
    const LEAST_TIMED: u64 = 16;
    // A moment is late by some microseconds, of a conversion of some thousand.
    const MOMENTS: u8 = 1;
    // Some thirty turns a second.
    const LOOK_EVERY: u8 = 1;

    fn hz(&self) -> u32 {
        self.settings.rate.hz()
    }

    fn begins_us(&self) -> u64 {
        self.settings.rate.settles_us()
    }

    fn set_up(&mut self) -> bool {
        self.by_dma(false);
        let settings = self.settings;
        self.answers = chips::set_up(self, settings);
        // The third and the fourth have no line that says when they are ready.
        self.input = match self.answers {
            [Answer::Set, ..] => Input::One,
            [_, Answer::Set, ..] => Input::Two,
            _ => return false,
        };
        counter::count(self.input);
        true
    }

    fn look_every_us(&self) -> Option<u64> {
        Some(LOOK_US)
    }

    fn is_as_set(&mut self) -> bool {
        // A wrong bit on a line does not stand in a register: it is gone at the second look.
        self.looks_as_set() || self.looks_as_set()
    }

    fn edges(&mut self) -> u64 {
        edges()
    }

    fn stamp(&mut self) -> Stamp {
        counter::stamp()
    }

    fn now_us(&mut self) -> u64 {
        now_us()
    }

    fn arm(&mut self, _: bool) -> Option<u64> {
        self.by_dma(true);
        for (((stream, request), bus), ring) in
            STREAMS.into_iter().zip(REQUESTS).zip(buses()).zip(self.rings.iter_mut())
        {
            streams::receive(stream, request, bus, addr_of_mut!(*ring).cast(), RING_ITEMS);
        }
        streams::start_by_edges(self.input);
        streams::keep_moments();
        critical_section::with(|cs| {
            let first = edges();
            counter::ask_for_dma(self.input, true);
            let first = (edges() == first).then_some(first);
            KEPT_FROM.borrow(cs).set(first);
            first
        })
    }

    fn disarm(&mut self) {
        critical_section::with(|cs| KEPT_FROM.borrow(cs).set(None));
        counter::ask_for_dma(self.input, false);
        streams::stop(STREAM_MOMENT);
        self.by_dma(false);
    }

    fn received(&mut self) -> usize {
        let [first, others @ ..] = STREAMS.map(|stream| streams::received(stream, RING_ITEMS));
        // In the midst of a transfer, or out of step.
        if others.iter().all(|other| *other == first) { first } else { usize::MAX }
    }

    fn frame(&mut self, slot: usize) -> Read {
        let mut words = [0; CHANNELS];
        for (word, ring) in words.iter_mut().zip(self.rings.iter()) {
            for half in ring.iter().skip(2 * slot).take(2) {
                // SAFETY: a valid reference; DMA writes it, so it is read anew. The line's first byte is the lower one.
                let half = unsafe { core::ptr::read_volatile(half) }.swap_bytes();
                *word = *word << 16 | u32::from(half);
            }
        }
        match chips::parse(words) {
            [MISSING, MISSING, MISSING, MISSING] => Read::Damaged,
            frame => Read::Samples(frame),
        }
    }
}

const _: () = assert!(CORE_HZ == 64_000_000, "the chips' clock is made for this one");
