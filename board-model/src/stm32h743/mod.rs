//! The hardware board: an STM32H743 on a NUCLEO-H743ZI2 class board with a converter on SPI1, or with four seismic ones.
//!
//! Wiring of those: SPI1 is their clock (PA5, and as a slave's clock PB13, PC10, PE12) and their data in (PB5); data out on PA6
//! and, of the other three, where SPI2, SPI3 and SPI4 listen as slaves (PB15, PC12, PE14); reset PD14, SYNC PD15 (low and high while
//! nothing drives them); data ready of the first on PE9, of the second on PE11.
//!
//! Wiring of the array's: converter SCK PA5, DIN PB5, DOUT PA6, data ready PE9, chip select PD14 or SPI1's own (PA4, PA15), SYNC/RESET
//! PD15 where that is an output; an SD card on SDMMC1 (PC8 to PC12, PD2); the serial line USART3 on PD8 and PD9; a satellite receiver's pulse on PA0, its sentences on
//! PD6.

mod adc;
mod clocks;
mod dma;
mod ecc;
pub mod flash;
mod pins;
mod places;
mod registers;
mod rtc;
mod sdmmc;
mod spi;
#[cfg(test)]
mod tests;
mod timer;
mod usart;
mod watchdog;
mod wiring;

pub use adc::Analog;
pub use clocks::cause;
pub use pins::Pin;

use crate::ads131m04::{Ads131m04, Codes, Source};
use crate::ads1282::Ads1282s;
use crate::board::{Board, Bus, Refusal, Width, Wish};
use crate::core::Machine;
use crate::core::nvic::number::HARD_FAULT;
use crate::costs::Costs;
use crate::elf::Image;
use crate::memory::{Kind, Memory};
use crate::sd_card::SdCard;
use crate::time::{NEVER, Ticks};
use adc::Adc;
use clocks::Clocks;
use dma::Dma;
use ecc::Ecc;
use flash::{BANK_2, Flash, FlashTimes};
use pins::{Mode, Pins};
use places::TIMERS;
use rtc::Rtc;
use sdmmc::Sdmmc;
use spi::Spi;
use std::collections::VecDeque;
use timer::Timer;
use usart::{Port, Usart};
use watchdog::Watchdog;

/// Bits a second of the sentences.
const RECEIVER_BAUD: u32 = 9600;
const USART2: Port = Port { name: "USART2", interrupt: 38 };
const USART3: Port = Port { name: "USART3", interrupt: 39 };
/// Clock and data of each slave, and the pins' function.
const SLAVE_PINS: [([Pin; 2], u32); 3] = [
    ([Pin::new('B', 13), Pin::new('B', 15)], 5),
    ([Pin::new('C', 10), Pin::new('C', 12)], 6),
    ([Pin::new('E', 12), Pin::new('E', 14)], 5),
];
const SLAVES: [&str; 3] = ["SPI2", "SPI3", "SPI4"];
/// The backup domain needs so much of its cell.
const LEAST_CELL_V: f64 = 1.2;
/// SDMMC1's data, clock and command lines.
const CARD_PINS: [Pin; 6] = [
    Pin::new('C', 8),
    Pin::new('C', 9),
    Pin::new('C', 10),
    Pin::new('C', 11),
    Pin::new('C', 12),
    Pin::new('D', 2),
];
const CARD_FUNCTION: u32 = 12;

/// What every byte of memory holds at power-on.
pub const AT_POWER_ON: u8 = 0xa5;

/// What may differ from board to board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Relative error of the core's oscillator against the truth.
    pub board_clock_error: f64,
    /// Relative error of the converter's clock.
    pub converter_clock_error: f64,
    /// Relative error of the crystal of the clock on its cell.
    pub cell_clock_error: f64,
    /// Whether that crystal swings.
    pub crystal: bool,
    /// Relative error of the watchdog's oscillator.
    pub watchdog_clock_error: f64,
    /// Bits a second of the serial line at the other end.
    pub baud: u32,
    /// A write to AXI SRAM of less than 64 bits is lost if a reset follows it at once.
    pub loses_last_write: bool,
    /// How long the flash takes to program and to erase.
    pub flash: FlashTimes,
    /// Supply, cell and temperature.
    pub analog: Analog,
    /// The converters are an ocean-bottom recorder's.
    pub seismic: bool,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            board_clock_error: 0.0,
            converter_clock_error: 0.0,
            cell_clock_error: 0.0,
            crystal: true,
            watchdog_clock_error: 0.0,
            baud: 921_600,
            loses_last_write: true,
            flash: FlashTimes::default(),
            analog: Analog::default(),
            seismic: false,
        }
    }
}

/// The board around the core.
#[derive(Debug)]
pub struct Stm32h743 {
    clocks: Clocks,
    pins: Pins,
    dma: Dma,
    spi: Spi,
    slaves: [Spi; 3],
    usart: Usart,
    receiver: Usart,
    /// Levels of the receiver's pulse that are to come.
    pulses: VecDeque<(Ticks, bool)>,
    timers: Vec<Timer>,
    watchdog: Watchdog,
    debug: u32,
    compensation: u32,
    rtc: Rtc,
    crystal: bool,
    adc: Adc,
    /// Supply, cell and temperature.
    pub analog: Analog,
    /// The second bank of the flash.
    pub flash: Flash,
    ecc: Ecc,
    sdmmc: Sdmmc,
    /// The card in the holder.
    pub card: SdCard,
    /// The array's converter; without its supply where there are others.
    pub converter: Ads131m04,
    /// Those of an ocean-bottom recorder.
    pub seismic: Option<Ads1282s>,
    /// Bytes moved by DMA.
    pub dma_items: u64,
}

/// The board with an image in flash, at power-on, and a converter that reads `source` at `rate_hz`.
///
/// # Errors
/// The image does not fit.
pub fn machine(
    image: Image,
    costs: Costs,
    parameters: &Parameters,
    source: Source,
    rate_hz: f64,
) -> Result<Machine<Stm32h743>, String> {
    // The second bank is read by way of its controller.
    const FLASH: (u32, u32) = (0x0800_0000, 1 << 20);
    const ITCM: (u32, u32) = (0, 64 << 10);
    let mut memory = Memory::default();
    memory.add(ITCM.0, ITCM.1, Kind::TightlyCoupled, AT_POWER_ON);
    memory.add(FLASH.0, FLASH.1, Kind::Flash, 0xff);
    memory.add(0x2000_0000, 128 << 10, Kind::TightlyCoupled, AT_POWER_ON);
    memory.add(0x2400_0000, 512 << 10, Kind::Axi, AT_POWER_ON);
    memory.add(0x3000_0000, 288 << 10, Kind::Sram, AT_POWER_ON);
    memory.add(0x3800_0000, 64 << 10, Kind::Sram, AT_POWER_ON);
    memory.add(0x3880_0000, 4 << 10, Kind::Sram, AT_POWER_ON);
    // What the factory wrote into the processor.
    memory.add(0x1ff0_0000, 128 << 10, Kind::Flash, 0xff);
    for (address, word) in adc::FACTORY {
        let place = memory.bytes_mut(address, 2).ok_or("no place for the factory's words")?;
        place.copy_from_slice(&word.to_le_bytes());
    }
    if parameters.loses_last_write {
        memory.hold_writes();
    }
    let board = Stm32h743::new(parameters, source, rate_hz);
    Machine::new(board, memory, image, costs, &[ITCM, FLASH])
}

/// What a converter has done.
#[derive(Debug, Clone, Copy)]
pub struct Conversions<'a> {
    /// Numbers of those that were read whole, in order.
    pub delivered: &'a [u64],
    /// What was read of them: codes, of seismic converters the words.
    pub codes: &'a [Codes],
    /// When each number's was.
    pub moments: &'a [Ticks],
    /// How many were done.
    pub done: u64,
    /// The source has ended.
    pub exhausted: bool,
}

/// All timers after a reset; their pins are high but for the receiver's pulse.
fn timers() -> Vec<Timer> {
    let mut timers: Vec<Timer> = TIMERS.iter().map(|place| Timer::new(*place)).collect();
    timers.iter_mut().filter(|timer| timer.place.name == "TIM5").for_each(|timer| timer.pin(0, false, NEVER));
    timers
}

impl Stm32h743 {
    /// The board at power-on.
    fn new(parameters: &Parameters, source: Source, rate_hz: f64) -> Self {
        // Time is counted in the board's own clock.
        let board = 1.0 + parameters.board_clock_error;
        let error = (1.0 + parameters.converter_clock_error) / board - 1.0;
        let watchdog = (1.0 + parameters.watchdog_clock_error) / board - 1.0;
        let mut converter;
        let mut seismic = None;
        if parameters.seismic {
            seismic = Some(Ads1282s::new(source, rate_hz, error));
            converter = Ads131m04::new(Box::new(|| None), rate_hz, error);
            converter.set_dead(true, 0);
        } else {
            converter = Ads131m04::new(source, rate_hz, error);
        }
        Self {
            clocks: Clocks::new(cause::POWER, 0, parameters.crystal),
            pins: Pins::new(),
            dma: Dma::new(),
            spi: Spi::new(),
            slaves: SLAVES.map(Spi::slave),
            usart: Usart::new(USART3, parameters.baud),
            receiver: Usart::new(USART2, RECEIVER_BAUD),
            pulses: VecDeque::new(),
            timers: timers(),
            watchdog: Watchdog::new(watchdog),
            debug: 0,
            compensation: 0,
            rtc: Rtc::new((1.0 + parameters.cell_clock_error) / board - 1.0),
            crystal: parameters.crystal,
            adc: Adc::new(),
            analog: parameters.analog,
            flash: Flash::new(parameters.flash),
            ecc: Ecc::default(),
            sdmmc: Sdmmc::new(),
            card: SdCard::none(),
            converter,
            seismic,
            dma_items: 0,
        }
    }

    /// What the converter that is there has done.
    pub fn conversions(&self) -> Conversions<'_> {
        let c = &self.converter;
        let array = || Conversions {
            delivered: &c.delivered,
            codes: &c.codes,
            moments: &c.moments,
            done: c.converted(),
            exhausted: c.exhausted(),
        };
        self.seismic.as_ref().map_or_else(array, |chips| Conversions {
            delivered: &chips.delivered,
            codes: &chips.codes,
            moments: chips.moments(),
            done: chips.converted(),
            exhausted: chips.exhausted(),
        })
    }

    /// Bytes that have left on the serial line.
    pub fn sent(&self) -> &[u8] {
        &self.usart.sent
    }

    /// When each of [`Self::sent`] had left.
    pub fn sent_at(&self) -> &[Ticks] {
        &self.usart.sent_at
    }

    /// Sends bytes to the board, the first at `at`, one after the other.
    pub fn send(&mut self, at: Ticks, bytes: &[u8]) {
        self.disturb(at, bytes.iter().map(|byte| (*byte, false)));
    }

    /// The same for bytes some of which have a wrong stop bit.
    pub fn disturb(&mut self, at: Ticks, bytes: impl IntoIterator<Item = (u8, bool)>) {
        self.usart.bring(at, bytes);
    }

    /// The receiver's pulse rises at `at` and falls at `until`; after all that were told before.
    pub fn pulse(&mut self, at: Ticks, until: Ticks) {
        self.pulses.extend([(at, true), (until, false)]);
    }

    /// The receiver says bytes, the first at `at`.
    pub fn sentence(&mut self, at: Ticks, bytes: &[u8]) {
        self.receiver.bring(at, bytes.iter().map(|byte| (*byte, false)));
    }

    /// The supply is low but not yet too low to work, or good again.
    pub fn set_supply_low(&mut self, low: bool) {
        const LOW_V: f64 = 2.8;
        const GOOD_V: f64 = 3.3;
        self.analog.supply_v = if low { LOW_V } else { GOOD_V };
        self.clocks.supply_low = low;
    }

    /// The phase-locked loops lock, or do not any more once they are switched on.
    pub fn set_loops_lock(&mut self, lock: bool) {
        self.clocks.loops_lock = lock;
    }

    /// A word of memory at this address was found to have one wrong bit, which is corrected, or more. Whether its memory has
    /// error correction.
    pub fn wrong_bits(&mut self, address: u32, corrected: bool) -> bool {
        self.ecc.tell(address, corrected)
    }

    /// Frequency of SPI's clock.
    pub fn spi_hz(&self) -> u64 {
        self.spi.line_hz
    }

    /// Peripherals as after a reset for this reason; the backup domain stays.
    pub fn reset(&mut self, cause: u32) {
        let (supply_low, loops_lock) = (self.clocks.supply_low, self.clocks.loops_lock);
        self.clocks = Clocks::new(cause, self.clocks.backup(), self.crystal);
        (self.clocks.supply_low, self.clocks.loops_lock) = (supply_low, loops_lock);
        self.pins = Pins::new();
        self.dma = Dma::new();
        self.spi = Spi::new();
        self.slaves = SLAVES.map(Spi::slave);
        self.usart.reset();
        self.receiver.reset();
        self.timers = timers();
        self.watchdog.reset();
        self.adc = Adc::new();
        self.flash.reset();
        self.ecc = Ecc::default();
        self.sdmmc = Sdmmc::new();
        self.debug = 0;
        self.compensation = 0;
    }

    /// Timers go on at the clocks' new frequencies.
    fn set_timer_clocks(&mut self, now: Ticks) {
        for timer in &mut self.timers {
            timer.set_hz(now, self.clocks.timer_hz(timer.place.bus));
        }
    }
}

impl Board for Stm32h743 {
    fn read(&mut self, bus: &mut Bus<'_>, address: u32, width: Width) -> Result<u32, Refusal> {
        if address.wrapping_sub(BANK_2.0) < BANK_2.1 {
            if self.flash.crashes {
                bus.nvic.pend(HARD_FAULT);
            }
            return self.flash.load(address, width);
        }
        let value = self.register_read(bus, address, width)?;
        // Reading data makes room; other reads change nothing.
        if matches!(address & !0xff, 0x4001_3000 | 0x4001_3400 | 0x4000_4800)
            || address & 0xffff_0000 == 0x4000_0000
        {
            self.settle(bus)?;
        }
        Ok(value)
    }

    fn write(&mut self, bus: &mut Bus<'_>, address: u32, value: u32, width: Width) -> Result<(), Refusal> {
        if address.wrapping_sub(BANK_2.0) < BANK_2.1 {
            return self.flash.store(address, value, width, bus.now);
        }
        self.register_write(bus, address, value, width)?;
        self.settle(bus)
    }

    fn advance(&mut self, bus: &mut Bus<'_>) -> Result<(), Refusal> {
        if self.watchdog.next_event() <= bus.now {
            self.reset(cause::WATCHDOG);
            bus.wishes.push(Wish::Reset);
            return Ok(());
        }
        let mut cut = self.flash.next_event() <= bus.now && self.flash.advance(bus.now);
        if self.sdmmc.next_event() <= bus.now {
            let own = |pin: &Pin| self.pins.mode(*pin) == Mode::Alternate(CARD_FUNCTION);
            if !CARD_PINS.iter().all(own) {
                return Refusal::stop("SDMMC1 runs while its pins PC8 to PC12 and PD2 are not its own");
            }
            cut |= self.sdmmc.advance(bus, &mut self.card, self.clocks.sdmmc_hz())?;
        }
        if cut {
            // Nothing but flash and card outlasts a loss of power.
            bus.memory.lose_power(AT_POWER_ON);
            let mut kept = self.clocks.backup();
            if self.analog.cell_v < LEAST_CELL_V {
                self.rtc.forget();
                kept = 0;
            }
            self.clocks = Clocks::new(cause::POWER, kept, self.crystal);
            self.reset(cause::POWER);
            self.converter.reset(bus.now);
            self.seismic.iter_mut().for_each(|chips| chips.reset_chips(None, bus.now));
            self.card.power();
            bus.wishes.push(Wish::Reset);
            return Ok(());
        }
        self.converter.advance(bus.now);
        self.seismic.iter_mut().for_each(|chips| chips.advance(bus.now));
        // The next word begins when all has settled.
        if self.spi.next_event() <= bus.now {
            let selected = self.selected();
            let (converter, now) = (&mut self.converter, bus.now);
            let (line_hz, pins, slaves) = (self.spi.line_hz, &self.pins, &mut self.slaves);
            match &mut self.seismic {
                Some(chips) => self.spi.shifted(|byte| {
                    let [first, others @ ..] = chips.exchange(byte, now, line_hz);
                    for ((slave, (wires, function)), byte) in slaves.iter_mut().zip(SLAVE_PINS).zip(others) {
                        if wires.iter().all(|pin| pins.mode(*pin) == Mode::Alternate(function)) {
                            slave.hear(byte);
                        }
                    }
                    first
                }),
                None => self.spi.shifted(|byte| if selected { converter.exchange(byte, now) } else { 0xff }),
            }
        }
        for index in 0..self.timers.len() {
            if self.timers[index].next_event() <= bus.now {
                self.timers[index].advance(bus.now);
                if self.timers[index].place.name == "TIM1" {
                    let pulses = std::mem::take(&mut self.timers[index].triggers);
                    self.trigger_from_first(pulses);
                }
            }
        }
        self.settle(bus)
    }

    fn next_event(&self) -> Ticks {
        let timers = self.timers.iter().map(Timer::next_event).min();
        self.converter
            .next_event()
            .min(self.seismic.as_ref().map_or(NEVER, Ads1282s::next_event))
            .min(self.spi.next_event())
            .min(self.usart.next_event())
            .min(self.receiver.next_event())
            .min(self.pulses.front().map_or(NEVER, |pulse| pulse.0))
            .min(self.watchdog.next_event())
            .min(self.flash.next_event())
            .min(self.sdmmc.next_event())
            .min(timers.unwrap_or(NEVER))
    }

    fn software_reset(&mut self, _bus: &mut Bus<'_>) {
        self.reset(cause::SOFTWARE);
    }

    fn reset_hz(&self) -> u64 {
        self.clocks.core_hz()
    }
}
