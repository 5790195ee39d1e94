//! How the board is wired, and what follows from a change: levels of pins, chip selects, edges and triggers, requests of DMA,
//! interrupt lines.

use super::Stm32h743;
use super::dma::request;
use super::pins::{Mode, Pin};
use crate::ads1282::Ads1282s;
use crate::board::{Bus, Refusal};
use crate::time::{NEVER, Ticks};

const DATA_READY: Pin = Pin::new('E', 9);
const CHIP_SELECT: Pin = Pin::new('D', 14);
const HARDWARE_SELECTS: [Pin; 2] = [Pin::new('A', 4), Pin::new('A', 15)];
const SYNC: Pin = Pin::new('D', 15);
/// The receiver's pulse is channel 1 of TIM5 there, as alternate function 2; its sentences come where USART2 listens.
const PULSE: (Pin, u32) = (Pin::new('A', 0), 2);
const SENTENCES: (Pin, u32) = (Pin::new('D', 6), 7);
const FLASH_INTERRUPT: u16 = 4;
const SPI_PINS: [Pin; 2] = [Pin::new('A', 5), Pin::new('A', 6)];
const SPI_FUNCTION: u32 = 5;
const SECOND_READY: Pin = Pin::new('E', 11);
const CHIPS_RESET: Pin = Pin::new('D', 14);
/// Requests that one pass of DMA may serve before something must be wrong.
const MOST_ITEMS: usize = 10_000;

impl Stm32h743 {
    /// The converter's chip select as pins and SPI drive it.
    pub(super) fn selected(&self) -> bool {
        let by_pin = self.pins.mode(CHIP_SELECT) == Mode::Output && !self.pins.output(CHIP_SELECT);
        let routed = |pin: &Pin| self.pins.mode(*pin) == Mode::Alternate(SPI_FUNCTION);
        by_pin || (self.spi.selected && HARDWARE_SELECTS.iter().any(routed))
    }

    /// Lets everything follow from a change: wires, DMA, interrupt lines.
    pub(super) fn settle(&mut self, bus: &mut Bus<'_>) -> Result<(), Refusal> {
        for _ in 0..MOST_ITEMS {
            self.wires(bus);
            let mut moved = self.spi.start(bus.now, || self.clocks.spi_hz())?;
            if moved && (self.selected() || self.seismic.is_some()) {
                match &mut self.seismic {
                    Some(chips) => chips.check(self.spi.mode(), self.spi.line_hz)?,
                    None => self.converter.check_bus(self.spi.mode(), self.spi.line_hz)?,
                }
                if !SPI_PINS.iter().all(|pin| self.pins.mode(*pin) == Mode::Alternate(SPI_FUNCTION)) {
                    return Refusal::stop("SPI1 runs while its pins PA5 and PA6 are not its own");
                }
            }
            moved |= self.serve_dma(bus)?;
            self.usart.advance(bus.now, || self.clocks.usart_hz())?;
            let deaf = self.pins.mode(SENTENCES.0) != Mode::Alternate(SENTENCES.1);
            if deaf {
                self.receiver.miss(bus.now);
            }
            self.receiver.advance(bus.now, || self.clocks.usart_hz())?;
            if !moved {
                self.lines(bus);
                return Ok(());
            }
        }
        Refusal::stop("DMA and peripherals do not come to rest: a request is never satisfied")
    }

    fn wires(&mut self, bus: &mut Bus<'_>) {
        let selected = self.selected();
        self.converter.select(selected, bus.now);
        if self.pins.mode(SYNC) == Mode::Output {
            let high = self.pins.output(SYNC);
            self.converter.sync(high, bus.now);
        }
        while let Some((high, lasts)) = self.converter.next_edge() {
            self.ready(bus, 0, high, lasts);
        }
        if let Some(chips) = &mut self.seismic {
            let high = |pin, otherwise| match self.pins.mode(pin) {
                Mode::Output => self.pins.output(pin),
                _ => otherwise,
            };
            chips.lines(high(CHIPS_RESET, false), high(SYNC, true), bus.now);
        }
        while let Some((chip, high, lasts)) = self.seismic.as_mut().and_then(Ads1282s::next_edge) {
            self.ready(bus, chip, high, lasts);
        }
        self.pins.drive(bus, DATA_READY, self.pins.input(DATA_READY));
        while let Some((_, high)) = self.pulses.front().copied().filter(|pulse| pulse.0 <= bus.now) {
            self.pulses.pop_front();
            self.pins.drive(bus, PULSE.0, high);
            if self.pins.mode(PULSE.0) == Mode::Alternate(PULSE.1)
                && let Some(timer) = self.timers.iter_mut().find(|t| t.place.name == "TIM5")
            {
                timer.advance(bus.now);
                timer.pin(0, high, NEVER);
            }
        }
    }

    /// Data ready of the first or second chip has this level for so long; the others' go nowhere.
    fn ready(&mut self, bus: &mut Bus<'_>, chip: usize, high: bool, lasts: Ticks) {
        let Some(pin) = [DATA_READY, SECOND_READY].get(chip).copied() else { return };
        self.pins.drive(bus, pin, high);
        // PE9 and PE11 are channels 1 and 2 of TIM1 as alternate function 1.
        if self.pins.mode(pin) == Mode::Alternate(1)
            && let Some(timer) = self.timers.iter_mut().find(|t| t.place.name == "TIM1")
        {
            timer.pin(chip, high, lasts);
            let pulses = std::mem::take(&mut timer.triggers);
            self.trigger_from_first(pulses);
        }
    }

    /// TIM1's trigger output is the internal trigger 0 of timers 2 to 5 and 8.
    pub(super) fn trigger_from_first(&mut self, pulses: u32) {
        for _ in 0..pulses {
            for timer in self
                .timers
                .iter_mut()
                .filter(|t| matches!(t.place.name, "TIM2" | "TIM3" | "TIM4" | "TIM5" | "TIM8"))
            {
                timer.internal_trigger(0);
            }
        }
    }

    fn lines(&mut self, bus: &mut Bus<'_>) {
        self.spi.lines(bus);
        self.usart.lines(bus);
        self.receiver.lines(bus);
        self.timers.iter_mut().for_each(|timer| timer.lines(bus));
        bus.nvic.set_level(FLASH_INTERRUPT, self.flash.interrupting());
    }

    /// Moves one item for every request there is; whether any was moved.
    fn serve_dma(&mut self, bus: &mut Bus<'_>) -> Result<bool, Refusal> {
        let mut moved = false;
        let levels = [
            (request::SPI1_RX, self.spi.wants_rx_dma()),
            (request::SPI1_TX, self.spi.wants_tx_dma()),
            (request::SPI2_RX, self.slaves[0].wants_rx_dma()),
            (request::SPI3_RX, self.slaves[1].wants_rx_dma()),
            (request::SPI4_RX, self.slaves[2].wants_rx_dma()),
            (request::USART2_RX, self.receiver.wants_rx_dma()),
            (request::USART3_TX, self.usart.wants_tx_dma()),
            (request::USART3_RX, self.usart.wants_rx_dma()),
        ];
        for (request, wanted) in levels {
            if wanted && let Some(stream) = self.dma.serving(request) {
                self.move_item(bus, stream)?;
                moved = true;
            }
        }
        while let Some((stream, generator)) = self.dma.generated() {
            self.dma.one_generated(generator);
            self.move_item(bus, stream)?;
            moved = true;
        }
        for index in 0..self.timers.len() {
            if self.timers[index].requests == 0 {
                continue;
            }
            let (pending, (channels, update)) =
                (self.timers[index].requests, self.timers[index].place.requests);
            for which in (0..5u8).filter(|which| pending >> which & 1 != 0) {
                let request = if which == 0 { update } else { channels + which - 1 };
                if request != 0
                    && let Some(stream) = self.dma.serving(request)
                {
                    self.timers[index].requests &= !(1 << which);
                    self.move_item(bus, stream)?;
                    moved = true;
                }
            }
        }
        Ok(moved)
    }

    fn move_item(&mut self, bus: &mut Bus<'_>, stream: usize) -> Result<(), Refusal> {
        let item = self.dma.item(bus, stream)?;
        let bytes = item.width.bytes();
        if item.to_peripheral {
            let from = bus.memory.bytes(item.memory, bytes);
            let from =
                from.ok_or_else(|| Refusal::Stop(format!("DMA reads no memory at {:#x}", item.memory)))?;
            let mut word = [0; 4];
            word[..bytes as usize].copy_from_slice(from);
            self.register_write(bus, item.peripheral, u32::from_le_bytes(word), item.width)?;
        } else {
            let word = self.register_read(bus, item.peripheral, item.width)?.to_le_bytes();
            let to = bus.memory.bytes_mut(item.memory, bytes);
            to.ok_or_else(|| Refusal::Stop(format!("DMA writes no memory at {:#x}", item.memory)))?
                .copy_from_slice(&word[..bytes as usize]);
        }
        self.dma_items += 1;
        self.dma.done(bus, stream);
        Ok(())
    }
}
