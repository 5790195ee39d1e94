//! The real-time clock in the backup domain, which a cell at VBAT keeps running, as a counter of its crystal's periods
//! (RM0433, chapter 46; from memory of it).
//!
//! It is set to the year 2000 once, when it first runs, and never again; what its count means stands in the backup registers. A
//! crystal that does not swing keeps nobody waiting: until it does there is no count.

use crate::battery::Counter;
use embassy_stm32::Peri;
use embassy_stm32::pac::{self, rcc::vals::Lsedrv, rcc::vals::Rtcsel};
use embassy_stm32::peripherals::RTC;
use embassy_stm32::rcc::{LsConfig, LseConfig, LseDrive, LseMode};
use embassy_stm32::time::Hertz;

/// Periods of the crystal in a second, less one: the count below the seconds.
const BELOW_SECOND: u16 = 32_767;
/// What opens the clock's registers and closes them.
const OPEN: [u8; 2] = [0xca, 0x53];
const CLOSE: u8 = 0xff;
/// Looks at a flag that comes within two periods.
const MOST_LOOKS: u32 = 100_000;

/// What the hardware library must find in the backup domain so that it leaves it alone: a clock that runs, or nothing.
pub fn kept() -> LsConfig {
    let domain = pac::RCC.bdcr().read();
    let runs = domain.rtcsel() == Rtcsel::LSE && domain.rtcen() && domain.lseon() && domain.lserdy();
    let drive = match domain.lsedrv() {
        Lsedrv::LOW => LseDrive::Low,
        Lsedrv::MEDIUM_LOW => LseDrive::MediumLow,
        Lsedrv::MEDIUM_HIGH => LseDrive::MediumHigh,
        Lsedrv::HIGH => LseDrive::High,
    };
    if !runs || domain.lsebyp() {
        return LsConfig::off();
    }
    let lse = LseConfig { frequency: Hertz(32_768), mode: LseMode::Oscillator(drive) };
    LsConfig { lse: Some(lse), ..LsConfig::default_lse() }
}

/// The clock.
#[derive(Debug)]
pub struct CellClock {
    _claimed: Peri<'static, RTC>,
    runs: bool,
}

impl CellClock {
    /// Starts the crystal where it does not run yet. The backup domain is open since the clocks were set.
    pub fn start(clock: Peri<'static, RTC>) -> Self {
        pac::RCC.apb4enr().modify(|w| w.set_rtcapben(true));
        let domain = pac::RCC.bdcr();
        let runs = domain.read().rtcen();
        if !runs {
            domain.modify(|w| w.set_lsedrv(Lsedrv::MEDIUM_HIGH));
            domain.modify(|w| w.set_lseon(true));
        }
        Self { _claimed: clock, runs }
    }

    /// Begins to count, once the crystal swings.
    fn begin(&mut self) -> Option<()> {
        let domain = pac::RCC.bdcr();
        if !domain.read().lserdy() {
            return None;
        }
        domain.modify(|w| w.set_rtcsel(Rtcsel::LSE));
        domain.modify(|w| w.set_rtcen(true));
        let clock = pac::RTC;
        for key in OPEN {
            clock.wpr().write(|w| w.set_key(key));
        }
        clock.isr().modify(|w| w.set_init(true));
        let ready = (0..MOST_LOOKS).any(|_| clock.isr().read().initf());
        if ready {
            // Two writes, as the manual wants.
            clock.prer().write(|w| w.set_prediv_s(BELOW_SECOND));
            clock.prer().modify(|w| w.set_prediv_a(0));
            clock.cr().modify(|w| w.set_bypshad(true));
            clock.tr().write(|_| {});
            clock.dr().write(|w| {
                // Saturday, 1 January 2000.
                w.set_wdu(6);
                w.set_mu(1);
                w.set_du(1);
            });
        }
        clock.isr().modify(|w| w.set_init(false));
        clock.wpr().write(|w| w.set_key(CLOSE));
        self.runs = ready;
        ready.then_some(())
    }
}

/// Whole days from 1 January 2000, of a year of that century; the clock's calendar has a leap year every four.
fn days(year: u32, month: u32, day: u32) -> u64 {
    const BEFORE: [u32; 12] = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334];
    let before = BEFORE.get(month.saturating_sub(1) as usize).copied().unwrap_or(0);
    let leap = u32::from(year.is_multiple_of(4) && month > 2);
    u64::from(365 * year + year.div_ceil(4) + before + leap + day.saturating_sub(1))
}

impl Counter for CellClock {
    fn count(&mut self) -> Option<u64> {
        if !self.runs {
            self.begin()?;
        }
        let clock = pac::RTC;
        let read = || (clock.ssr().read().ss(), clock.tr().read(), clock.dr().read());
        let mut before = read();
        // Registers that a period changes between are read again.
        let (below, time, date) = (0..8).find_map(|_| {
            let now = read();
            let same = (now.0, now.1.0, now.2.0) == (before.0, before.1.0, before.2.0);
            before = now;
            same.then_some(now)
        })?;
        let two = |tens: u8, ones: u8| 10 * u32::from(tens) + u32::from(ones);
        let days =
            days(two(date.yt(), date.yu()), two(date.mt().into(), date.mu()), two(date.dt(), date.du()));
        let [h, m, s] = [two(time.ht(), time.hu()), two(time.mnt(), time.mnu()), two(time.st(), time.su())]
            .map(u64::from);
        let seconds = days * 86_400 + h * 3600 + m * 60 + s;
        Some(seconds * 32_768 + u64::from(BELOW_SECOND.saturating_sub(below)))
    }

    fn word(&mut self, n: usize) -> u32 {
        pac::RTC.bkpr(n).read().bkp()
    }

    fn keep(&mut self, n: usize, word: u32) {
        pac::RTC.bkpr(n).write(|w| w.set_bkp(word));
    }
}
