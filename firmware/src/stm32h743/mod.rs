//! The hardware board: STM32H743 (NUCLEO-H743ZI2 class) with an ADS131M04 on SPI1; with the feature `seismic` that of an
//! ocean-bottom recorder, with four converters of the ADS1282 kind ([`seismic`]), whose core runs at 64 MHz.
//!
//! Runs with its real drivers in an emulator in every test run; **not yet on silicon**. Wiring: SPI1 SCK PA5, MISO PA6,
//! MOSI PB5, chip select PA4, data ready PE9; telemetry and commands on USART3 (PD8, PD9: the board's debugger shows it as
//! a serial port), 921 600 baud; a satellite receiver's pulse on PA0, its sentences on PD6 (USART2, 9600 baud). The core runs at 480 MHz with the instruction cache on and the data cache off (DMA buffers
//! need no care then). Conversions are counted and moved by hardware ([`counter`], [`streams`]).

#![allow(unsafe_code)]

pub mod battery;
pub mod clock;
pub mod counter;
pub mod flash;
pub mod gauges;
#[cfg(feature = "link")]
pub mod kept;
pub mod link;
pub mod memory;
pub mod pulse;
#[cfg(not(feature = "seismic"))]
pub mod sampling;
#[cfg(feature = "card")]
pub mod sd;
#[cfg(feature = "seismic")]
pub mod seismic;
mod settled;
#[cfg(feature = "card")]
pub mod sram;
mod streams;

use crate::fault::{self, Record};
use crate::stack;
use crate::starts::{Starts, cause};
use crate::supply::{Detector, Supply, THRESHOLD_MV};
use embassy_stm32::Config;
use embassy_stm32::pac;
use embassy_stm32::peripherals::IWDG1;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, HSIPrescaler, Pll, PllDiv, PllMul, PllPreDiv, PllSource,
};
use embassy_stm32::rcc::{Sysclk, VoltageScale, mux};
use embassy_stm32::wdg::IndependentWatchdog;
use gauges::Gauges;
use memory::Errors;
use seabearing_core::port::{Load, Supervisor};
use seabearing_core::wait::Reason;
use seabearing_core::wire::{FaultCode, Margins};
use settled::Settled;

/// Frequency of the core: an ocean-bottom recorder has a hundredth of an array's work.
pub const CORE_HZ: u32 = if cfg!(feature = "seismic") { 64_000_000 } else { 480_000_000 };
/// Bits a second of the line.
pub const BAUD: u32 = if cfg!(feature = "seismic") { 115_200 } else { 921_600 };
/// The recorder feeds the watchdog once a block (8 ms at 64 kHz, 10 s at 50 Hz would be too long: it feeds while idle
/// too), so two seconds without is a hang.
pub const WATCHDOG_US: u32 = 2_000_000;

/// Clocks: 64 MHz internal oscillator, first phase-locked loop to 480 MHz, buses at 120 MHz. For an ocean-bottom recorder the
/// oscillator itself at the lowest voltage, buses at 32 MHz.
pub fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = Some(HSIPrescaler::DIV1);
    config.rcc.csi = true;
    config.rcc.apb1_pre = APBPrescaler::DIV2;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.rcc.apb3_pre = APBPrescaler::DIV2;
    config.rcc.apb4_pre = APBPrescaler::DIV2;
    // ADC3's clock: 64 MHz, which its driver divides by two and the converter by two again.
    config.rcc.mux.adcsel = mux::Adcsel::PER;
    config.rcc.ls = battery::kept();
    config.rcc.mux.rtcsel = config.rcc.ls.rtc;
    if cfg!(feature = "seismic") {
        config.rcc.sys = Sysclk::HSI;
        config.rcc.voltage_scale = VoltageScale::Scale3;
        config.rcc.mux.spi123sel = mux::Saisel::PER;
        return config;
    }
    config.rcc.pll1 = Some(Pll {
        source: PllSource::HSI,
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL60,
        fracn: None,
        divp: Some(PllDiv::DIV2),
        // 96 MHz for SPI1, whose clock is a quarter of it: 24 of the 25 MHz that the converter takes.
        divq: Some(PllDiv::DIV10),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.ahb_pre = AHBPrescaler::DIV2;
    config.rcc.voltage_scale = VoltageScale::Scale0;
    config
}

/// Starts the watchdog before anything waits for hardware, the clocks among it. Its own oscillator starts with it (RM0433, 46.3),
/// at 32 kHz: a sixteenth of that, as many times as the period has.
pub fn watch_the_start() {
    use pac::iwdg::vals::{Key, Pr};
    const PERIOD: u16 = (WATCHDOG_US / 1_000_000 * 2_000) as u16;
    pac::IWDG1.kr().write(|w| w.set_key(Key::START));
    pac::IWDG1.kr().write(|w| w.set_key(Key::ENABLE));
    pac::IWDG1.pr().write(|w| w.set_pr(Pr::DIVIDE_BY16));
    pac::IWDG1.rlr().write(|w| w.set_rl(PERIOD));
}

/// Longest wait for a transfer or a pair of edges, in cycles of the core: two periods at 8 kHz.
const PATIENCE_CYCLES: u32 = CORE_HZ / 1000;

/// Waits for something, not for ever.
fn until(mut done: impl FnMut() -> bool) -> bool {
    let begun = cortex_m::peripheral::DWT::cycle_count();
    while !done() {
        if cortex_m::peripheral::DWT::cycle_count().wrapping_sub(begun) > PATIENCE_CYCLES {
            return false;
        }
    }
    true
}

/// Waits at least so long, a second at most, by the cycle counter: counted instructions take less time on a core that carries
/// out two at once.
fn wait_us(us: u32) {
    let (begun, cycles) = (cortex_m::peripheral::DWT::cycle_count(), us * (CORE_HZ / 1_000_000));
    while cortex_m::peripheral::DWT::cycle_count().wrapping_sub(begun) < cycles {}
}

/// Why the core last started, as on the wire; forgets it afterwards.
pub fn reset_cause() -> u8 {
    let flags = pac::RCC.rsr().read();
    pac::RCC.rsr().modify(|r| r.set_rmvf(true));
    if flags.iwdg1rstf() {
        1
    } else if flags.sftrstf() {
        2
    } else if flags.borrstf() && !flags.porrstf() {
        cause::BROWN_OUT
    } else if flags.porrstf() {
        cause::POWER_ON
    } else if flags.pinrstf() {
        cause::RESET_PIN
    } else {
        255
    }
}

/// The voltage detector of the processor's supply: 2.85 V falling, 0.1 V more rising (RM0433, 6.5.2).
#[derive(Debug)]
pub struct VoltageDetector(());

impl VoltageDetector {
    /// Switches it on.
    pub fn start() -> Self {
        const AT_2_85_V: u8 = 6;
        pac::PWR.cr1().modify(|w| {
            w.set_pls(AT_2_85_V);
            w.set_pvde(true);
        });
        Self(())
    }
}

impl Detector for VoltageDetector {
    fn is_low(&mut self) -> bool {
        pac::PWR.csr1().read().pvdo()
    }

    fn now_us(&mut self) -> u64 {
        clock::now_us()
    }
}

/// Watchdog, idling, and what was before this start.
pub struct Board {
    watchdog: IndependentWatchdog<'static, IWDG1>,
    cause: u8,
    fault: Option<Record>,
    starts: Starts,
    gauges: Option<Gauges>,
    /// The recorder's settings, while there is one.
    settled: Option<Settled>,
    errors: Errors,
    /// The supply while nothing is recorded, and whether it was told to be low.
    supply: Supply,
    told_low: bool,
}

impl Board {
    /// Counts the start; the watchdog is on.
    pub fn new(watchdog: IndependentWatchdog<'static, IWDG1>) -> Self {
        let cause = reset_cause();
        let starts = Starts::new(cause, fault::counts());
        fault::keep_counts(starts.counts());
        let fault = fault::take();
        VoltageDetector::start();
        let errors = Errors::watch();
        let supply = Supply::default();
        Self { watchdog, cause, fault, starts, gauges: None, settled: None, errors, supply, told_low: false }
    }

    /// With these it tells its margins.
    pub fn gauge(&mut self, gauges: Gauges) {
        self.gauges = Some(gauges);
    }

    /// These bytes, of an object that lives for ever, are not to change from now on.
    pub fn watch(&mut self, settings: core::ops::Range<*const u8>) {
        self.settled = Some(Settled::new(settings));
    }

    /// Nothing is recorded any more.
    pub fn rest(&mut self) {
        self.settled = None;
    }

    /// Why the board must not record yet, where that is so.
    pub fn must_wait(&mut self) -> Option<Reason> {
        self.starts.must_wait()
    }

    /// Whether even waiting has ended by a crash: it had better wait with nothing but the line.
    pub fn crashed_waiting(&self) -> bool {
        self.starts.crashed_waiting()
    }

    /// The supply has failed: the board waits until it is good.
    pub fn supply_failed(&mut self) -> Reason {
        let reason = self.starts.supply_failed();
        fault::keep_counts(self.starts.counts());
        reason
    }

    /// Begins a new session.
    pub fn start_again(&mut self) -> ! {
        self.starts.again(&mut VoltageDetector(()));
        fault::keep_counts(self.starts.counts());
        cortex_m::peripheral::SCB::sys_reset()
    }
}

impl Supervisor for Board {
    fn feed(&mut self) {
        self.watchdog.pet();
        self.settled.iter_mut().for_each(Settled::look);
        self.errors.look(self.settled.is_some());
        if self.starts.works(clock::now_us()) {
            fault::keep_counts(self.starts.counts());
        }
    }

    fn idle(&mut self) {
        // The next conversions, the next byte, or `wake` ends the sleep.
        cortex_m::asm::wfi();
        self.watchdog.pet();
    }

    fn reset_cause(&self) -> u8 {
        self.cause
    }

    fn last_fault(&mut self) -> Option<(FaultCode, i64)> {
        self.fault.take().map(Record::told)
    }

    fn fault(&mut self) -> Option<(FaultCode, i64)> {
        let failed = self.settled.is_none() && self.supply.has_failed(&mut VoltageDetector(()));
        let newly = failed && !core::mem::replace(&mut self.told_low, failed);
        self.told_low &= failed;
        let low = newly.then_some((FaultCode::SupplyLow, THRESHOLD_MV.into()));
        low.or_else(|| self.errors.found())
    }

    fn margins(&mut self, load: &Load) -> Option<Margins> {
        let (memory, used) = stack::used();
        let gauged = self.gauges.as_mut()?.read();
        Some(Margins {
            index: load.index,
            memory,
            memory_free: memory - used,
            longest_us: load.longest_ticks / (CORE_HZ / 1_000_000),
            waiting: load.waiting.0,
            room: load.waiting.1,
            supply_mv: gauged.supply_mv,
            battery_mv: gauged.cell_mv,
            temperature_c: gauged.temperature_c,
        })
    }

    fn over(&mut self) -> bool {
        self.starts.over(&mut VoltageDetector(()))
    }
}

/// Wakes the loop's core ten times a second while neither conversions nor bytes do, for ever: so the watchdog is fed and a
/// converter that fell silent is noticed and set up again.
#[embassy_executor::task]
pub async fn wake() -> ! {
    loop {
        embassy_time::Timer::after_millis(100).await;
    }
}
