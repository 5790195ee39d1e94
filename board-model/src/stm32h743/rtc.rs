//! The real-time clock and the words beside it, in the backup domain (RM0433, chapter 46; from memory of it).

use super::clocks::unknown;
use crate::board::Refusal;
use crate::time::{PER_SECOND, Ticks};

const CRYSTAL_HZ: f64 = 32_768.0;
const KEYS: [u32; 2] = [0xca, 0x53];
/// Days of the months of a year that is no leap year.
const MONTHS: [u64; 12] = [31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];

/// The clock; a reset leaves it.
#[derive(Debug)]
pub struct Rtc {
    /// Words that stay.
    words: [u32; 32],
    control: u32,
    prescaler: u32,
    /// Time and date as they were set.
    set: [u32; 2],
    /// Since when it counts from there.
    since: Option<Ticks>,
    initializes: bool,
    keys: usize,
    /// Relative error of the crystal against the board's clock.
    error: f64,
}

impl Rtc {
    pub fn new(error: f64) -> Self {
        Self {
            words: [0; 32],
            control: 0,
            prescaler: 0x007f_00ff,
            set: [0, 0x2101],
            since: None,
            initializes: false,
            keys: 0,
            error,
        }
    }

    /// As after a reset of the backup domain.
    pub fn forget(&mut self) {
        *self = Self::new(self.error);
    }

    /// Seconds since it was set, and periods below the second that are still to come.
    fn passed(&self, now: Ticks) -> (u64, u32) {
        let asynchronous = f64::from((self.prescaler >> 16 & 0x7f) + 1);
        let synchronous = u64::from(self.prescaler & 0x7fff) + 1;
        let since = self.since.map_or(0, |since| now.saturating_sub(since));
        let seconds = since as f64 / PER_SECOND as f64;
        let periods = (seconds * CRYSTAL_HZ * (1.0 + self.error) / asynchronous) as u64;
        (periods / synchronous, (synchronous - 1 - periods % synchronous) as u32)
    }

    /// Time and date now.
    fn calendar(&self, now: Ticks) -> [u32; 2] {
        let [time, date] = self.set;
        let two = |bits: u32, tens: u32| u64::from(10 * (bits >> 4 & tens) + (bits & 15));
        let second = two(time, 7) + 60 * two(time >> 8, 7) + 3600 * two(time >> 16, 3) + self.passed(now).0;
        let mut days = second / 86_400 + two(date, 3) - 1;
        let (mut year, mut month) = (two(date >> 16, 15), two(date >> 8, 1) as usize - 1);
        let length =
            |year: u64, month: usize| MONTHS[month] + u64::from(year.is_multiple_of(4) && month == 1);
        while days >= length(year, month) {
            days -= length(year, month);
            month += 1;
            if month == 12 {
                (year, month) = (year + 1, 0);
            }
        }
        let packed = |n: u64| (((n / 10) << 4) | (n % 10)) as u32;
        let second = second % 86_400;
        let time = packed(second / 3600) << 16 | packed(second / 60 % 60) << 8 | packed(second % 60);
        [time, packed(year % 100) << 16 | 6 << 13 | packed(month as u64 + 1) << 8 | packed(days + 1)]
    }

    pub fn read(&self, offset: usize, now: Ticks) -> Result<u32, Refusal> {
        Ok(match offset {
            0 => self.calendar(now)[0],
            4 => self.calendar(now)[1],
            8 => self.control,
            // Set, in set-up; the shadow registers are bypassed.
            0x0c => {
                u32::from(self.since.is_some()) << 4
                    | u32::from(self.initializes) << 6
                    | u32::from(self.initializes) << 7
            }
            0x10 => self.prescaler,
            0x28 => self.passed(now).1,
            0x50..0xd0 => self.words[(offset - 0x50) / 4],
            _ => return Err(unknown("RTC", offset)),
        })
    }

    /// `runs`: its crystal swings and the clock is switched on.
    pub fn write(&mut self, offset: usize, value: u32, now: Ticks, runs: bool) -> Result<(), Refusal> {
        let unlocked = self.keys == KEYS.len();
        match offset {
            0x24 => self.keys = if KEYS.get(self.keys) == Some(&value) { self.keys + 1 } else { 0 },
            0x50..0xd0 => self.words[(offset - 0x50) / 4] = value,
            _ if !unlocked => return Refusal::stop("a register of RTC is written without its keys"),
            _ if !runs => return Refusal::stop("RTC is set up while it has no clock (RCC_BDCR)"),
            0x0c => {
                let initializes = value & 1 << 7 != 0;
                if self.initializes && !initializes {
                    self.since = Some(now);
                }
                self.initializes = initializes;
            }
            0 | 4 | 0x10 if !self.initializes => {
                return Refusal::stop("time or prescaler of RTC is written outside of its set-up");
            }
            0 => self.set[0] = value,
            4 => self.set[1] = value,
            0x10 => self.prescaler = value,
            // Only whether shadow registers are bypassed.
            8 if value & !0x20 == 0 => self.control = value,
            _ => return Err(unknown("RTC", offset)),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The clock, set to a second before the end of a day.
    fn set(date: u32) -> Rtc {
        let mut rtc = Rtc::new(0.0);
        KEYS.iter().for_each(|key| rtc.write(0x24, *key, 0, true).unwrap());
        rtc.write(0x0c, 1 << 7, 0, true).unwrap();
        rtc.write(0x10, 32_767, 0, true).unwrap();
        rtc.write(0, 0x23_59_59, 0, true).unwrap();
        rtc.write(4, date | 6 << 13, 0, true).unwrap();
        rtc.write(0x0c, 0, 0, true).unwrap();
        rtc
    }

    #[test]
    fn its_calendar_goes_over_years_and_leap_days() {
        for (before, after) in [(0x23_0228, 0x23_0301), (0x24_0228, 0x24_0229), (0x23_1231, 0x24_0101)] {
            let rtc = set(before);
            let [time, date] = rtc.calendar(PER_SECOND);
            assert_eq!((time, date & 0xff_1fff), (0, after));
            assert_eq!(rtc.calendar(PER_SECOND - 1)[0], 0x23_59_59);
            assert_eq!(rtc.read(0x28, PER_SECOND / 2).unwrap(), 16_383);
        }
    }

    #[test]
    fn what_a_driver_must_not_do_stops_the_run() {
        let mut rtc = Rtc::new(0.0);
        assert!(rtc.write(0, 0, 0, true).is_err(), "without its keys");
        KEYS.iter().for_each(|key| rtc.write(0x24, *key, 0, true).unwrap());
        assert!(rtc.write(0, 0, 0, true).is_err(), "outside of its set-up");
        assert!(rtc.write(0x0c, 1 << 7, 0, false).is_err(), "without a clock");
        assert!(rtc.write(0x50, 7, 0, false).is_ok(), "words need none");
    }
}
