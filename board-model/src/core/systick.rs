//! The core's own timer (ARMv7-M, B3.3).

use crate::time::{NEVER, Ticks};

/// SysTick: counts down from `reload` from `since` on, a count every `period`.
#[derive(Clone, Debug)]
pub(super) struct SysTick {
    pub enabled: bool,
    pub interrupts: bool,
    pub core_clock: bool,
    pub wrapped: bool,
    pub reload: u32,
    /// Value at `since`.
    pub value: u32,
    pub since: Ticks,
    pub period: Ticks,
}

impl SysTick {
    /// As after a reset.
    pub fn off() -> Self {
        Self {
            enabled: false,
            interrupts: false,
            core_clock: false,
            wrapped: false,
            reload: 0,
            value: 0,
            since: 0,
            period: 1,
        }
    }

    pub fn counts(&self, now: Ticks) -> u64 {
        if self.enabled { (now - self.since) / self.period.max(1) } else { 0 }
    }

    /// Value now: from 0 it goes to the reload value.
    pub fn now(&self, now: Ticks) -> u32 {
        let counts = self.counts(now);
        if counts <= u64::from(self.value) {
            self.value - counts as u32
        } else {
            let past = (counts - u64::from(self.value) - 1) % (u64::from(self.reload) + 1);
            self.reload - past as u32
        }
    }

    pub fn rebase(&mut self, now: Ticks) {
        let counts = self.counts(now);
        self.value = self.now(now);
        self.since = if self.enabled { self.since + counts * self.period } else { now };
    }

    /// When it next reaches zero.
    pub fn next(&self) -> Ticks {
        if !(self.enabled && self.interrupts) || self.reload == 0 {
            return NEVER;
        }
        let counts = if self.value == 0 { u64::from(self.reload) + 1 } else { u64::from(self.value) };
        self.since + counts * self.period
    }
}
