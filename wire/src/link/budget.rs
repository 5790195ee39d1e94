//! Bytes an hour: a virtual clock that runs ahead by what was sent (the generic cell rate algorithm).
//!
//! An eighth of the hour's bytes (three frames at least) may go at once, the rest goes evenly, so that in no hour whatever
//! more than the budget is sent. Bearings and spectra leave half of that eighth to what is more urgent. After a start
//! nothing may go at once: what was sent before it is not known.

use super::store::Class;
use crate::frame::FRAME_BYTES;

const HOUR_US: u64 = 3_600_000_000;

/// A smaller budget is none on which anything could be said.
const LEAST: u32 = 1000;

/// What may be sent when.
#[derive(Clone, Copy, Debug)]
pub(super) struct Budget {
    /// Microseconds that one byte costs; 0: nothing is limited.
    byte_us: u64,
    /// How far the virtual clock may run ahead.
    ahead_us: u64,
    /// The virtual clock; `None` before it was first looked at.
    spent_us: Option<u64>,
}

impl Budget {
    /// A budget of bytes an hour, or none.
    pub(super) fn new(bytes_an_hour: Option<u32>) -> Self {
        let Some(bytes) = bytes_an_hour.map(|n| u64::from(n.max(LEAST))) else {
            return Self { byte_us: 0, ahead_us: 0, spent_us: None };
        };
        let at_once = (bytes / 8).max(3 * FRAME_BYTES as u64);
        let byte_us = HOUR_US.div_ceil((bytes - at_once).max(1));
        Self { byte_us, ahead_us: at_once * byte_us, spent_us: None }
    }

    /// Whether so many bytes of a class may go now.
    pub(super) fn allows(&self, now_us: u64, bytes: usize, class: Class) -> bool {
        if self.byte_us == 0 {
            return true;
        }
        let Some(spent_us) = self.spent_us else { return false };
        let reserve = if class < Class::Bearing { 0 } else { self.ahead_us / 2 };
        let after = spent_us.max(now_us).saturating_add(self.byte_us.saturating_mul(bytes as u64));
        after <= now_us.saturating_add(self.ahead_us - reserve)
    }

    /// So many bytes were sent, none for a first look.
    pub(super) fn spend(&mut self, now_us: u64, bytes: usize) {
        let cost = self.byte_us.saturating_mul(bytes as u64);
        let spent_us = self.spent_us.unwrap_or(now_us.saturating_add(self.ahead_us));
        self.spent_us = Some(spent_us.max(now_us).saturating_add(cost));
    }

    /// Microseconds in which so many bytes are earned.
    pub(super) fn earns(&self, bytes: usize) -> u64 {
        self.byte_us.saturating_mul(bytes as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_hour_whatever_has_more_than_the_budget_and_the_urgent_always_finds_some() {
        let mut budget = Budget::new(Some(8000));
        budget.spend(0, 0);
        assert!(!budget.allows(1_000_000, 50, Class::Alarm));
        let mut sent: std::vec::Vec<(u64, usize)> = std::vec::Vec::new();
        let mut urgent = 0;
        for second in 0..4 * 3600u64 {
            let now = second * 1_000_000;
            // Bearings without end, and after a quiet hour; an alarm every ten minutes.
            while !(3600..7200).contains(&second) && budget.allows(now, 150, Class::Bearing) {
                budget.spend(now, 150);
                sent.push((now, 150));
            }
            if second % 600 == 599 && budget.allows(now, 100, Class::Alarm) {
                budget.spend(now, 100);
                sent.push((now, 100));
                urgent += 1;
            }
        }
        assert_eq!(urgent, 24);
        for (i, (begin, _)) in sent.iter().enumerate() {
            let hour: usize = sent[i..].iter().take_while(|(t, _)| t - begin < HOUR_US).map(|s| s.1).sum();
            assert!(hour <= 8000, "{hour} bytes in the hour from {begin}");
        }
        let all: usize = sent.iter().map(|s| s.1).sum();
        assert!(all > 3 * 6500, "{all}");
        assert!(Budget::new(None).allows(0, 1 << 20, Class::Spectrum));
    }
}
