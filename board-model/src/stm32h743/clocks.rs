//! Supply, flash latency and clocks: PWR, RCC and the registers of FLASH and SYSCFG that set-up touches
//! (RM0433, chapters 4, 6, 8 and 12).

use crate::board::{Bus, Refusal, Wish};

/// Why the core last started: bits of `RCC_RSR`.
pub mod cause {
    /// Power came.
    pub const POWER: u32 = 0x00fa_0000;
    /// The software asked for it.
    pub const SOFTWARE: u32 = 1 << 24 | 1 << 22 | 1 << 17;
    /// The independent watchdog.
    pub const WATCHDOG: u32 = 1 << 26 | 1 << 22 | 1 << 17;
    /// The reset pin.
    pub const PIN: u32 = 1 << 22 | 1 << 17;
    /// The supply sagged.
    pub const BROWN_OUT: u32 = 1 << 21 | 1 << 22 | 1 << 17;
}

const HSI_HZ: u64 = 64_000_000;
const CSI_HZ: u64 = 4_000_000;
/// The debugger's clock output on the NUCLEO board.
const HSE_HZ: u64 = 8_000_000;
/// The crystal of the battery-backed clock.
const LSE_HZ: u64 = 32_768;

/// Clock registers by their offset, and the supply.
#[derive(Debug)]
pub(super) struct Clocks {
    rcc: [u32; 0x180 / 4],
    power_control: [u32; 16],
    supply_written: bool,
    pub(super) latency: u32,
    overdrive: bool,
    /// Kernel clocks of SPI 1 to 3 and of the simple serial ports, as the registers set them.
    kernel_hz: [u64; 2],
    pub(super) reset_cause: u32,
    /// The supply is below what the voltage detector may be set to.
    pub(super) supply_low: bool,
    /// The crystal of the backup domain swings as soon as it is on.
    crystal: bool,
    /// Phase-locked loops lock as soon as they are on.
    pub(super) loops_lock: bool,
}

/// Offsets in RCC.
mod at {
    pub const CR: usize = 0;
    pub const CFGR: usize = 0x10;
    pub const D1CFGR: usize = 0x18;
    pub const D2CFGR: usize = 0x1c;
    pub const D3CFGR: usize = 0x20;
    pub const PLLCKSELR: usize = 0x28;
    pub const PLLCFGR: usize = 0x2c;
    pub const D1CCIPR: usize = 0x4c;
    pub const D2CCIP1R: usize = 0x50;
    pub const D2CCIP2R: usize = 0x54;
    pub const D3CCIPR: usize = 0x58;
    pub const BDCR: usize = 0x70;
    pub const CSR: usize = 0x74;
    pub const RSR: usize = 0xd0;
}

/// Bits of the supply's registers.
const VOLTAGE_READY: u32 = 1 << 13;
/// The voltage detector: PVDE in PWR_CR1, PVDO in PWR_CSR1.
const DETECTOR_ON: u32 = 1 << 4;
const DETECTED: u32 = 1 << 4;

impl Clocks {
    pub fn new(reset_cause: u32, kept_backup: u32, crystal: bool) -> Self {
        let mut rcc = [0; 0x180 / 4];
        rcc[at::CR / 4] = 1;
        rcc[at::BDCR / 4] = kept_backup;
        rcc[at::PLLCKSELR / 4] = 0x0202_0200;
        rcc[at::PLLCFGR / 4] = 0x01ff_0000;
        rcc[0x30 / 4] = 0x0101_0280;
        rcc[0x38 / 4] = 0x0101_0280;
        rcc[0x40 / 4] = 0x0101_0280;
        let mut clocks = Self {
            rcc,
            power_control: [0xf000_c000, 0x4000, 0, 0x46, 0, 0, 0x4000, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            supply_written: false,
            latency: 0x37,
            overdrive: false,
            kernel_hz: [0; 2],
            reset_cause,
            supply_low: false,
            crystal,
            loops_lock: true,
        };
        clocks.kernel_hz = clocks.kernels();
        clocks
    }

    /// The register of the backup domain, which a reset leaves.
    pub fn backup(&self) -> u32 {
        self.rcc[at::BDCR / 4]
    }

    pub fn read_rcc(&self, offset: usize) -> Result<u32, Refusal> {
        Ok(match offset {
            at::CR => {
                let cr = self.rcc[0];
                // Every oscillator and loop is ready as soon as it is on.
                let ready = |on: u32, bit: u32| (cr >> on & 1) << bit;
                let locked = |on: u32, bit: u32| ready(on, bit) * u32::from(self.loops_lock);
                cr & !0x0a02_4024
                    | 0x20
                    | ready(0, 2)
                    | ready(7, 8)
                    | ready(12, 13)
                    | ready(16, 17)
                    | locked(24, 25)
                    | locked(26, 27)
                    | locked(28, 29)
                    | 0xc000
            }
            at::CFGR => {
                let cfgr = self.rcc[at::CFGR / 4];
                cfgr & !0x38 | (cfgr & 7) << 3
            }
            at::BDCR => {
                let bdcr = self.rcc[at::BDCR / 4];
                bdcr & !2 | (bdcr & u32::from(self.crystal)) << 1
            }
            at::CSR => {
                let csr = self.rcc[at::CSR / 4];
                csr & 1 | (csr & 1) << 1
            }
            at::RSR | 0x130 => self.reset_cause,
            // Copies of the enables for this core.
            0x134..=0x154 => self.rcc[(offset - 0x60) / 4],
            offset if offset < 0x180 => self.rcc[offset / 4],
            _ => return Refusal::stop(format!("an unknown register of RCC at {offset:#x}")),
        })
    }

    pub fn write_rcc(&mut self, bus: &mut Bus<'_>, offset: usize, value: u32) -> Result<(), Refusal> {
        match offset {
            at::RSR | 0x130 => {
                if value & 1 << 16 != 0 {
                    self.reset_cause = 0;
                }
                return Ok(());
            }
            0x134..=0x154 => self.rcc[(offset - 0x60) / 4] = value,
            at::BDCR if self.power_control[0] & 0x100 == 0 => {
                return Refusal::stop("BDCR is written without access to the backup domain (PWR_CR1.DBP)");
            }
            offset if offset < 0x180 => {
                // The hardware keeps source, predivider and dividers of a loop that is on.
                let on = |index: u32| self.rcc[0] >> (24 + 2 * index) & 1 != 0;
                let fixed = match offset {
                    at::PLLCKSELR => {
                        let source = if (0..3).any(on) { 3 } else { 0 };
                        source | (0..3).filter(|i| on(*i)).map(|i| 0x3f << (4 + 8 * i)).sum::<u32>()
                    }
                    // A clock once chosen stays, until the backup domain is reset.
                    at::BDCR if self.rcc[at::BDCR / 4] & 0x300 != 0 && value & 1 << 16 == 0 => 0x300,
                    0x30 | 0x38 | 0x40 if on((offset as u32 - 0x30) / 8) => u32::MAX,
                    _ => 0,
                };
                let value = value & !fixed | self.rcc[offset / 4] & fixed;
                self.rcc[offset / 4] = value;
            }
            _ => return Refusal::stop(format!("an unknown register of RCC at {offset:#x}")),
        }
        self.kernel_hz = self.kernels();
        if matches!(offset, at::CR | at::CFGR | at::D1CFGR | at::PLLCKSELR | at::PLLCFGR | 0x30) {
            let source = [(0, 0), (1, 7), (2, 16), (3, 24)]
                .into_iter()
                .find(|(source, _)| *source == self.rcc[at::CFGR / 4] & 7);
            if source.is_none_or(|(_, on)| self.rcc[0] >> on & 1 == 0) {
                return Refusal::stop("the system clock is switched to a source that is off");
            }
            self.check_latency()?;
            bus.wishes.push(Wish::CoreHz(self.core_hz()));
        }
        Ok(())
    }

    /// Voltage scale 0 to 3.
    fn scale(&self) -> u32 {
        match self.power_control[6] >> 14 & 3 {
            3 if self.overdrive => 0,
            3 => 1,
            2 => 2,
            _ => 3,
        }
    }

    /// Voltage and flash latency must allow the frequency (RM0433, tables of FLASH and PWR).
    fn check_latency(&self) -> Result<(), Refusal> {
        let (core, axi, scale) = (self.core_hz(), self.ahb_hz(), self.scale());
        let most = [480, 400, 300, 200][scale as usize] * 1_000_000;
        if core > most {
            return Refusal::stop(format!(
                "the core's clock of {core} Hz is too fast for voltage scale {scale}"
            ));
        }
        let step = [70, 70, 55, 45][scale as usize] * 1_000_000;
        let needed = (axi.saturating_sub(1) / step) as u32;
        if self.latency & 15 < needed.min(4) && !(scale == 0 && self.latency & 15 >= 2 && axi <= 210_000_000)
        {
            return Refusal::stop(format!("flash latency {} is too short for {axi} Hz", self.latency & 15));
        }
        Ok(())
    }

    /// Whether the delays of programming are right for the flash's clock (`WRHIGHFREQ`; RM0433, table 17).
    pub fn may_program(&self) -> bool {
        let (slow, middle) = match self.scale() {
            0 | 1 => (70_000_000, 185_000_000),
            2 => (55_000_000, 165_000_000),
            _ => (45_000_000, 135_000_000),
        };
        let needed = u32::from(self.ahb_hz() > slow) + u32::from(self.ahb_hz() > middle);
        self.latency >> 4 & 3 == needed
    }

    pub fn read_power(&self, offset: usize) -> Result<u32, Refusal> {
        let word = *self.power_control.get(offset / 4).ok_or_else(|| unknown("PWR", offset))?;
        Ok(match offset {
            // Regulator and voltage are ready. The detector tells while it is on.
            4 => {
                let low = self.supply_low && self.power_control[0] & DETECTOR_ON != 0;
                word & !DETECTED
                    | VOLTAGE_READY
                    | (self.power_control[6] >> 14 & 3) << 14
                    | if low { DETECTED } else { 0 }
            }
            8 => word | (word & 1) << 16,
            0x18 => word | VOLTAGE_READY,
            _ => word,
        })
    }

    pub fn write_power(&mut self, offset: usize, value: u32) -> Result<(), Refusal> {
        match offset {
            0xc => {
                if self.supply_written && value & 7 != self.power_control[3] & 7 {
                    return Refusal::stop("PWR_CR3 selects the supply a second time");
                }
                self.supply_written = true;
            }
            0x18 if !self.supply_written => {
                return Refusal::stop("the voltage scale is changed before the supply is selected (PWR_CR3)");
            }
            _ => {}
        }
        *self.power_control.get_mut(offset / 4).ok_or_else(|| unknown("PWR", offset))? = value;
        Ok(())
    }

    /// The overdrive bit of SYSCFG.
    pub fn set_overdrive(&mut self, on: bool) -> Result<(), Refusal> {
        if on && self.power_control[6] >> 14 & 3 != 3 {
            return Refusal::stop("overdrive is enabled before voltage scale 1");
        }
        self.overdrive = on;
        Ok(())
    }

    /// Whether the low-power internal oscillator is on.
    pub fn low_power_oscillator(&self) -> bool {
        self.rcc[0] >> 7 & 1 != 0
    }

    /// Whether the clock of the backup domain has its crystal and is on.
    pub fn cell_clock_runs(&self) -> bool {
        let bdcr = self.rcc[at::BDCR / 4];
        self.crystal && bdcr & 1 != 0 && bdcr >> 8 & 3 == 1 && bdcr & 1 << 15 != 0
    }

    /// Its register as after a reset of the backup domain, which still is held.
    pub fn forget_backup(&mut self) {
        self.rcc[at::BDCR / 4] = 1 << 16;
    }

    /// Whether the backup domain is being reset.
    pub fn resets_backup(&self) -> bool {
        self.rcc[at::BDCR / 4] & 1 << 16 != 0
    }

    /// Whether the backup domain may be written.
    pub fn backup_open(&self) -> bool {
        self.power_control[0] & 0x100 != 0
    }

    fn field(&self, offset: usize, low: u32, bits: u32) -> u64 {
        u64::from(self.rcc[offset / 4] >> low & ((1 << bits) - 1))
    }

    fn oscillator(&self, source: u64) -> u64 {
        match source {
            0 => HSI_HZ >> self.field(at::CR, 3, 2),
            1 => CSI_HZ,
            _ => HSE_HZ,
        }
    }

    /// Output P, Q or R (0 to 2) of a loop (0 to 2).
    fn pll(&self, index: usize, output: u32) -> u64 {
        let input = self.oscillator(self.field(at::PLLCKSELR, 0, 2));
        let predivider = self.field(at::PLLCKSELR, 4 + 8 * index as u32, 6);
        let dividers = 0x30 + 8 * index;
        let n = self.field(dividers, 0, 9) + 1;
        let divider = match output {
            0 => self.field(dividers, 9, 7),
            1 => self.field(dividers, 16, 7),
            _ => self.field(dividers, 24, 7),
        } + 1;
        let enabled = self.field(at::PLLCFGR, 16 + 3 * index as u32 + output, 1) != 0;
        let on = self.field(at::CR, 24 + 2 * index as u32, 1) != 0;
        if predivider == 0 || !enabled || !on { 0 } else { input * n / predivider / divider }
    }

    fn system_hz(&self) -> u64 {
        match self.field(at::CFGR, 0, 3) {
            3 => self.pll(0, 0),
            source => self.oscillator(source),
        }
    }

    pub fn core_hz(&self) -> u64 {
        (self.system_hz() / prescaler(self.field(at::D1CFGR, 8, 4))).max(1)
    }

    fn ahb_hz(&self) -> u64 {
        self.core_hz() / prescaler(self.field(at::D1CFGR, 0, 4))
    }

    /// Bus clock of peripherals on APB1 (1), 2 or 4.
    pub fn apb_hz(&self, bus: u32) -> u64 {
        self.ahb_hz() / self.apb_divider(bus)
    }

    fn apb_divider(&self, bus: u32) -> u64 {
        let (offset, low) = match bus {
            1 => (at::D2CFGR, 4),
            2 => (at::D2CFGR, 8),
            _ => (at::D3CFGR, 4),
        };
        match self.field(offset, low, 3) {
            divider if divider >= 4 => 2 << (divider - 4),
            _ => 1,
        }
    }

    /// Clock of timers on APB1 or APB2.
    pub fn timer_hz(&self, bus: u32) -> u64 {
        let divider = self.apb_divider(bus);
        let free = if self.field(at::CFGR, 15, 1) != 0 { 4 } else { 2 };
        if divider <= free {
            self.ahb_hz().min(self.apb_hz(bus) * free.max(divider))
        } else {
            self.apb_hz(bus) * free
        }
    }

    /// Kernel clock of SPI 1 to 3.
    pub fn spi_hz(&self) -> u64 {
        self.kernel_hz[0]
    }

    /// Kernel clock of SDMMC 1 and 2.
    pub fn sdmmc_hz(&self) -> u64 {
        if self.field(at::D1CCIPR, 16, 1) == 0 { self.pll(0, 1) } else { self.pll(1, 2) }
    }

    /// Kernel clock of USART 2, 3 and the other simple ones.
    pub fn usart_hz(&self) -> u64 {
        self.kernel_hz[1]
    }

    /// Kernel clock of the analog converters.
    pub fn adc_hz(&self) -> u64 {
        match self.field(at::D3CCIPR, 16, 2) {
            0 => self.pll(1, 0),
            1 => self.pll(2, 2),
            // The peripherals' own clock: HSI, CSI or HSE.
            _ => self.oscillator(self.field(at::D1CCIPR, 28, 2)),
        }
    }

    fn kernels(&self) -> [u64; 2] {
        let spi = match self.field(at::D2CCIP1R, 12, 3) {
            0 => self.pll(0, 1),
            1 => self.pll(1, 0),
            2 => self.pll(2, 0),
            4 => HSI_HZ,
            _ => 0,
        };
        let usart = match self.field(at::D2CCIP2R, 0, 3) {
            0 => self.apb_hz(1),
            1 => self.pll(1, 1),
            2 => self.pll(2, 1),
            3 => self.oscillator(0),
            4 => CSI_HZ,
            _ => LSE_HZ,
        };
        [spi, usart]
    }

    /// Whether a peripheral's bit in one of the enable registers is set; offsets of `AHB3ENR` (0xd4) to `APB4ENR` (0xf4).
    pub fn enabled(&self, offset: usize, bit: u32) -> bool {
        self.rcc[offset / 4] >> bit & 1 != 0
    }
}

fn prescaler(field: u64) -> u64 {
    match field {
        0..8 => 1,
        8..12 => 2 << (field - 8),
        _ => 64 << (field - 12),
    }
}

pub(super) fn unknown(what: &str, offset: usize) -> Refusal {
    Refusal::Stop(format!("an unknown register of {what} at {offset:#x}"))
}
