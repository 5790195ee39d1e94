//! Which register an access reaches.

use super::Stm32h743;
use super::places::{Peripheral, place};
use super::sdmmc::Sdmmc;
use crate::board::{Bus, Refusal, Width};

/// Offset of the register that resets what AHB3 carries.
const RESET_AHB3: usize = 0x7c;

impl Stm32h743 {
    pub(super) fn register_read(
        &mut self,
        bus: &mut Bus<'_>,
        address: u32,
        width: Width,
    ) -> Result<u32, Refusal> {
        let Some((peripheral, offset)) = self.locate(address)? else {
            return Err(Refusal::BusFault);
        };
        // Registers of a word read in part give that part, but data registers of serial lines are read as wide as asked.
        let (word, shift) = (offset & !3, 8 * (offset as u32 & 3));
        let value = match peripheral {
            Peripheral::Rcc => self.clocks.read_rcc(word)?,
            Peripheral::Power => self.clocks.read_power(word)?,
            Peripheral::Flash if word == 0 => self.clocks.latency,
            Peripheral::Flash if (0x104..0x200).contains(&word) => self.flash.read(word - 0x104)?,
            Peripheral::Flash => return Refusal::stop(format!("flash register {word:#x} is not modelled")),
            Peripheral::SystemConfiguration => match word {
                8..0x18 => *self.pins.source((word - 8) / 4),
                // The compensation cell is ready as soon as it is on.
                0x20 => self.compensation | (self.compensation & 1) << 8,
                _ => 0,
            },
            Peripheral::Exti => self.pins.read_exti(word)?,
            Peripheral::Gpio(port) => self.pins.read_gpio(port, word)?,
            Peripheral::Dma(controller) => self.dma.read(controller, word)?,
            Peripheral::DmaMux => self.dma.read_mux(word)?,
            Peripheral::Spi1 => self.spi.read(word, width.bytes() as usize)?,
            Peripheral::Slave(index) => self.slaves[index].read(word, width.bytes() as usize)?,
            Peripheral::Sdmmc1 => self.sdmmc.read(word, &self.card, bus.now)?,
            Peripheral::Usart2 => self.receiver.read(word)?,
            Peripheral::Usart3 => self.usart.read(word)?,
            Peripheral::Timer(index) => {
                self.timers[index].advance(bus.now);
                self.timers[index].read(word)?
            }
            Peripheral::Watchdog => self.watchdog.read(word)?,
            Peripheral::Adc => self.adc.read(word, bus.now)?,
            Peripheral::Debug => {
                if word == 0 {
                    0x2003_6450
                } else {
                    self.debug
                }
            }
            Peripheral::Rtc => self.rtc.read(word, bus.now)?,
            Peripheral::Ecc(block) => self.ecc.read(block, word)?,
        };
        Ok(value >> shift)
    }

    pub(super) fn register_write(
        &mut self,
        bus: &mut Bus<'_>,
        address: u32,
        value: u32,
        width: Width,
    ) -> Result<(), Refusal> {
        let Some((peripheral, offset)) = self.locate(address)? else {
            return Err(Refusal::BusFault);
        };
        let data = matches!(
            (peripheral, offset),
            (Peripheral::Spi1, 0x20) | (Peripheral::Usart2 | Peripheral::Usart3, 0x28)
        );
        if width != Width::Word && !data && !matches!(peripheral, Peripheral::Timer(_)) {
            return Refusal::stop(format!("a narrow write of register {address:#010x}"));
        }
        match peripheral {
            Peripheral::Rcc => {
                self.clocks.write_rcc(bus, offset, value)?;
                if self.clocks.resets_backup() {
                    self.rtc.forget();
                    self.clocks.forget_backup();
                }
                if offset == RESET_AHB3 && value & 1 << 16 != 0 {
                    self.sdmmc = Sdmmc::new();
                }
                self.set_timer_clocks(bus.now);
            }
            Peripheral::Power => self.clocks.write_power(offset, value)?,
            Peripheral::Flash if offset == 0 => self.clocks.latency = value,
            Peripheral::Flash if (0x104..0x200).contains(&offset) => {
                self.flash.write(offset - 0x104, value, bus.now, self.clocks.may_program())?;
            }
            Peripheral::Flash => return Refusal::stop(format!("flash register {offset:#x} is not modelled")),
            Peripheral::SystemConfiguration => match offset {
                8..0x18 => *self.pins.source((offset - 8) / 4) = value,
                0x2c => self.clocks.set_overdrive(value & 1 != 0)?,
                // Analog switches and fast-mode drive: nothing here depends on them.
                0x20 if value & 1 != 0 && !self.clocks.low_power_oscillator() => {
                    return Refusal::stop("the compensation cell is switched on without CSI");
                }
                0x20 => self.compensation = value,
                4 => {}
                _ => return Refusal::stop(format!("register {offset:#x} of SYSCFG is not modelled")),
            },
            Peripheral::Exti => self.pins.write_exti(bus, offset, value)?,
            Peripheral::Gpio(port) => self.pins.write_gpio(port, offset, value)?,
            Peripheral::Dma(controller) => self.dma.write(bus, controller, offset, value)?,
            Peripheral::DmaMux => self.dma.write_mux(offset, value)?,
            Peripheral::Spi1 => self.spi.write(offset, value, width.bytes() as usize)?,
            Peripheral::Slave(index) => self.slaves[index].write(offset, value, width.bytes() as usize)?,
            Peripheral::Sdmmc1 => self.sdmmc.write(offset, value, bus.now, self.clocks.sdmmc_hz())?,
            Peripheral::Usart2 => self.receiver.write(offset, value)?,
            Peripheral::Usart3 => self.usart.write(offset, value)?,
            Peripheral::Timer(index) => {
                self.timers[index].advance(bus.now);
                self.timers[index].write(offset, value)?;
            }
            Peripheral::Watchdog => self.watchdog.write(offset, value, bus.now)?,
            Peripheral::Adc => {
                let kernel_hz = self.clocks.adc_hz();
                self.adc.write(offset, value, bus.now, kernel_hz, &self.analog)?;
            }
            Peripheral::Ecc(block) => self.ecc.write(block, offset, value)?,
            Peripheral::Debug => {
                self.debug = value;
                // DBGSLEEP_D1 keeps the core's clock, and with it the cycle counter, running in sleep.
            }
            Peripheral::Rtc if !self.clocks.backup_open() => {
                return Refusal::stop("RTC is written without access to the backup domain (PWR_CR1.DBP)");
            }
            Peripheral::Rtc => {
                let runs = self.clocks.cell_clock_runs();
                self.rtc.write(offset, value, bus.now, runs)?;
            }
        }
        *bus.counts_asleep = self.debug & 1 != 0;
        Ok(())
    }

    /// The peripheral at an address, if its clock is on.
    fn locate(&self, address: u32) -> Result<Option<(Peripheral, usize)>, Refusal> {
        let Some(found) = place(address) else {
            // Nothing this model knows: outside the peripherals' part of the map that is a bus fault.
            return if address >> 29 == 2 {
                Refusal::stop(format!("nothing is modelled at {address:#010x}"))
            } else {
                Ok(None)
            };
        };
        if let Some((offset, bit)) = found.enable
            && !self.clocks.enabled(offset, bit)
        {
            return Refusal::stop(format!(
                "{} is used at {address:#010x} while its clock is off",
                found.name
            ));
        }
        Ok(Some((found.peripheral, (address - found.base) as usize)))
    }
}
