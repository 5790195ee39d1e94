//! When a recorder listens: stretches of samples that are worked on, and pauses between them, as its [`Schedule`] says.
//!
//! Enters: where the samples are, and what is known of their UTC. Leaves: how many of the next instants are heard or left out,
//! and when a pause begins. By UTC a stretch begins at a whole multiple of the schedule's period; while UTC is not known
//! the samples' own count stands for it, from sample 0 on. Numbers are those of the converter throughout: a pause shifts nothing.

use crate::config::Schedule;
use crate::math;
use crate::utc::along;
use crate::wire::Time;

/// A newer line of UTC that moves the next change by less than this is no reason to move it, s.
const SMALL_S: f64 = 1.0;

/// A stretch of samples that are all heard, or all left out.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stretch {
    listens: bool,
    from: u64,
    to: u64,
}

/// The recorder's stretches.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stretches {
    schedule: Schedule,
    rate_hz: f64,
    /// The newest line of UTC: what comes is after it.
    line: Option<Time>,
    now: Option<Stretch>,
    /// A pause that has begun, or ends otherwise than was told: the index at which it ends.
    begun: Option<u64>,
}

impl Stretches {
    /// At a recorder's rate.
    pub fn new(schedule: Schedule, rate_hz: f64) -> Self {
        Self { schedule, rate_hz, ..Self::default() }
    }

    /// UTC is known so from now on; samples have come up to this index.
    // Apart, like the next: seldom needed, and the loop is long enough.
    #[inline(never)]
    pub fn told(&mut self, time: &Time, index: u64) {
        self.line = Some(*time);
        let Some(now) = self.now.filter(|_| self.schedule.every_s > 0) else { return };
        let next = self.stretch(index);
        let small = (SMALL_S * self.rate_hz) as u64;
        let same = if next.listens == now.listens {
            next.to.abs_diff(now.to) <= small
        } else {
            // About to change, or just changed, by the line before.
            now.to.saturating_sub(index) <= small || next.to.saturating_sub(index) <= small
        };
        if !same {
            self.begin(Stretch { from: now.from.min(index), ..next });
            if next.listens && !now.listens {
                self.begun = Some(index);
            }
        }
    }

    /// Of `count` instants from this index on, how many are next, and whether they are heard.
    pub fn next(&mut self, index: u64, count: usize) -> (usize, bool) {
        if self.schedule.every_s == 0 {
            return (count, true);
        }
        let now = match self.now.filter(|now| (now.from..now.to).contains(&index)) {
            Some(now) => now,
            None => self.begin(self.stretch(index)),
        };
        let left = usize::try_from(now.to.saturating_sub(index)).unwrap_or(count);
        (left.clamp(1, count.max(1)), now.listens)
    }

    /// The index at which a pause ends that has just begun, or whose end has moved, once.
    pub fn begun(&mut self) -> Option<u64> {
        self.begun.take()
    }

    /// Whole seconds of the present pause up to this index.
    pub fn paused_s(&self, index: u64) -> u32 {
        let from = self.now.filter(|now| !now.listens).map_or(index, |now| now.from);
        (index.saturating_sub(from) as f64 / self.rate_hz) as u32
    }

    fn begin(&mut self, stretch: Stretch) -> Stretch {
        self.now = Some(stretch);
        self.begun = (!stretch.listens).then_some(stretch.to);
        stretch
    }

    /// The stretch that an index is in, from there on.
    #[inline(never)]
    fn stretch(&self, index: u64) -> Stretch {
        let (every_s, on_s) = (f64::from(self.schedule.every_s), f64::from(self.schedule.on_s));
        let utc_s = |index| self.line.map(|line| along(&line, index, self.rate_hz).0 as f64 * 1e-6);
        let at_s = utc_s(index).unwrap_or(index as f64 / self.rate_hz);
        let since_s = at_s - every_s * math::f64::floor(at_s / every_s);
        let listens = since_s < on_s;
        let left_s = if listens { on_s - since_s } else { every_s - since_s };
        let ahead =
            |seconds: f64| index.saturating_add(math::f64::ceil(seconds * self.rate_hz).max(1.0) as u64);
        // By the clock's own rate, which is not quite the nominal one.
        let to = match utc_s(ahead(left_s)) {
            Some(there_s) => ahead(left_s - (there_s - at_s - left_s)),
            None => ahead(left_s),
        };
        Stretch { listens, from: index, to }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const RATE_HZ: f64 = 50.0;
    const SCHEDULE: Schedule = Schedule { every_s: 100, on_s: 30 };
    /// A whole multiple of the period.
    const START_US: i64 = 1_790_000_000_000_000;

    /// Runs of indices that are heard, of so many seconds in blocks of this length; `utc` tells lines as they come.
    fn heard(seconds: u64, block: usize, mut utc: impl FnMut(u64) -> Option<Time>) -> Vec<(u64, u64)> {
        let mut stretches = Stretches::new(SCHEDULE, RATE_HZ);
        let (mut runs, mut index): (Vec<(u64, u64)>, u64) = (Vec::new(), 0);
        while index < seconds * 50 {
            let mut left = block;
            while left > 0 {
                let (n, listens) = stretches.next(index, left);
                match runs.last_mut().filter(|run| run.1 == index && listens) {
                    Some(run) => run.1 += n as u64,
                    None if listens => runs.push((index, index + n as u64)),
                    None => {}
                }
                (index, left) = (index + n as u64, left - n);
            }
            if let Some(time) = utc(index) {
                stretches.told(&time, index);
            }
        }
        runs
    }

    fn line(index: u64, utc_us: i64, drift: f32) -> Time {
        Time { index, utc_us, sd_s: 1e-6, drift, sd_drift: 1e-9, correlation: 0.0 }
    }

    #[test]
    fn without_utc_samples_count_whatever_the_blocks() {
        for block in [1, 7, 64, 1000, 9000] {
            let runs = heard(270, block, |_| None);
            assert_eq!(runs[..3], [(0, 1500), (5000, 6500), (10_000, 11_500)], "{block}");
        }
    }

    #[test]
    fn with_utc_it_listens_at_whole_periods_of_it() {
        // Sample 0 was 40 s into a period; that is known after 10 s, when it listens by count.
        let mut told = false;
        let tell = |index: u64| {
            let now = index >= 500 && !core::mem::replace(&mut told, index >= 500);
            now.then(|| line(0, START_US + 40_000_000, 0.0))
        };
        let runs = heard(280, 10, tell);
        assert_eq!(runs, [(0, 500), (3000, 4500), (8000, 9500), (13_000, 14_000)]);
    }

    #[test]
    fn a_clock_that_is_fast_or_slow_is_followed_to_the_sample_and_a_small_step_moves_nothing() {
        // A part in a thousand: 50 000 samples are 1001 s of UTC.
        let runs = heard(990, 10, |index| (index == 10).then(|| line(0, START_US, 1e-3)));
        let expected = |k: u64| (k as f64 * 5000.0 / 1.001).ceil() as u64;
        for (k, run) in runs.iter().enumerate() {
            assert!(run.0.abs_diff(expected(k as u64)) <= 1, "{k}: {run:?}");
        }
        let steps = heard(990, 10, |index| Some(line(0, START_US + (index as i64 % 7) * 10_000, 0.0)));
        assert_eq!(steps.len(), 10, "{steps:?}");
    }

    #[test]
    fn a_pause_is_told_once_with_its_end_and_counts_its_seconds() {
        let mut stretches = Stretches::new(SCHEDULE, RATE_HZ);
        assert_eq!((stretches.next(0, 64), stretches.begun()), ((64, true), None));
        assert_eq!((stretches.next(1480, 64), stretches.begun()), ((20, true), None));
        assert_eq!((stretches.next(1500, 44), stretches.begun()), ((44, false), Some(5000)));
        assert_eq!((stretches.next(1600, 64), stretches.begun()), ((64, false), None));
        assert_eq!((stretches.paused_s(1549), stretches.paused_s(4999)), (0, 69));
        // The index leaps out of the pause, and starts again.
        assert_eq!(stretches.next(5001, 64), (64, true));
        assert_eq!(stretches.next(7, 64), (64, true));
        assert_eq!(Stretches::new(Schedule::default(), RATE_HZ).next(9, 64), (64, true));
    }
}
