//! The array's converter on SPI1, moved by hardware: every data-ready edge (PE9) is counted ([`super::counter`]) and starts a
//! transfer into a ring ([`super::streams`]). Chip select is SPI1's own (PA4). The core hears of it once in 256 edges.

use super::clock::now_us;
use super::counter::{self, Input, edges};
use super::{streams, until};
use crate::acquisition::Board;
use crate::converter::{self, Bus, FRAME_BYTES, RING_BYTES, RING_FRAMES, Rate, Read};
use crate::pace::Stamp;
use core::ptr::addr_of_mut;
use embassy_stm32::Peri;
use embassy_stm32::pac::{self, gpio, spi};
use embassy_stm32::peripherals::{PA4, PA5, PA6, PB5, PE9, SPI1, TIM1, TIM2};

/// Two bytes an access.
const RING_ITEMS: u16 = (RING_BYTES / 2) as u16;

/// What the converter's hardware occupies.
pub type Claimed = (
    (Peri<'static, SPI1>, Peri<'static, TIM1>, Peri<'static, TIM2>),
    (Peri<'static, PA4>, Peri<'static, PA5>, Peri<'static, PA6>, Peri<'static, PB5>, Peri<'static, PE9>),
);

/// Memory of the ring.
pub type Ring = [u16; RING_BYTES / 2];
/// It before anything came.
#[allow(clippy::large_const_arrays)] // It is what a static begins with, and never a value of its own.
pub const EMPTY: Ring = [0; RING_BYTES / 2];

/// The converter's bus, counter and ring.
pub struct Sampling {
    _claimed: Claimed,
    ring: &'static mut Ring,
    rate: Rate,
    gain_log2: u8,
}

impl Sampling {
    /// Clocks, pins, counters and bus; nothing moves yet. The gain is a power of two.
    pub fn new(claimed: Claimed, ring: &'static mut Ring, rate: Rate, gain_log2: u8) -> Self {
        let rcc = pac::RCC;
        rcc.ahb1enr().modify(|w| w.set_dma1en(true));
        rcc.ahb4enr().modify(|w| {
            w.set_gpioaen(true);
            w.set_gpioben(true);
            w.set_gpioeen(true);
        });
        rcc.apb2enr().modify(|w| w.set_spi1en(true));
        for (port, pin, function) in [
            (pac::GPIOA, 4, 5),
            (pac::GPIOA, 5, 5),
            (pac::GPIOA, 6, 5),
            (pac::GPIOB, 5, 5),
            (pac::GPIOE, 9, 1),
        ] {
            port.afr(pin / 8).modify(|w| w.set_afr(pin % 8, function));
            port.ospeedr().modify(|w| w.set_ospeedr(pin, gpio::vals::Ospeedr::VERY_HIGH_SPEED));
            // A cut line, or a converter without supply, reads high and makes no edges.
            port.pupdr().modify(|w| w.set_pupdr(pin, gpio::vals::Pupdr::PULL_UP));
            port.moder().modify(|w| w.set_moder(pin, gpio::vals::Moder::ALTERNATE));
        }
        counter::start();
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
        Self { _claimed: claimed, ring, rate, gain_log2 }
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
        streams::start_by_hand();
        until(|| pac::SPI1.sr().read().eot())
    }
}

impl Bus for Sampling {
    fn exchange(&mut self, frame: &mut [u8; FRAME_BYTES]) {
        let bus = pac::SPI1;
        self.by_dma(false);
        streams::start_by_hand();
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
        super::wait_us(us);
    }
}

impl Board for Sampling {
    const RING_FRAMES: usize = RING_FRAMES;
    const FRAME_BYTES: usize = FRAME_BYTES;
    const LEAST_TIMED: u64 = 200;

    fn hz(&self) -> u32 {
        self.rate.hz()
    }

    fn begins_us(&self) -> u64 {
        // Its filter's three periods.
        3_000_000 / u64::from(self.rate.hz())
    }

    fn set_up(&mut self) -> bool {
        let (rate, gain_log2) = (self.rate, self.gain_log2);
        let set = converter::set_up(self, rate, gain_log2).is_ok();
        if set {
            converter::wake_up(self);
        }
        set
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

    fn arm(&mut self, behind: bool) -> Option<u64> {
        self.by_dma(true);
        let ring = addr_of_mut!(*self.ring).cast();
        streams::receive(streams::STREAM_RX, streams::SPI1_RX, pac::SPI1, ring, RING_ITEMS);
        streams::start_by_edges(Input::One);
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
            counter::ask_for_dma(Input::One, true);
            (edges() == before && (!behind || before == first + 2)).then_some(first)
        })
    }

    fn disarm(&mut self) {
        counter::ask_for_dma(Input::One, false);
        streams::stop(streams::LAST);
        self.by_dma(false);
    }

    fn received(&mut self) -> usize {
        streams::received(streams::STREAM_RX, RING_ITEMS)
    }

    fn frame(&mut self, slot: usize) -> Read {
        let mut bytes = [0; FRAME_BYTES];
        let words = self.ring.get(slot * (FRAME_BYTES / 2)..).unwrap_or_default();
        for (pair, word) in bytes.as_chunks_mut::<2>().0.iter_mut().zip(words) {
            // SAFETY: a valid reference; DMA writes it, so it is read anew.
            *pair = unsafe { core::ptr::read_volatile(word) }.to_le_bytes();
        }
        converter::parse(&bytes)
    }
}
