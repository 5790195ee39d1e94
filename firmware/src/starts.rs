//! How a board that fails again and again goes on: it counts its starts and the failures of its supply over resets, waits ever
//! longer between attempts, and never for ever.

use crate::supply::{Detector, Supply, THRESHOLD_MV};
use seabearing_core::wait::Reason;
use seabearing_core::wire::FaultCode;

/// Causes of a start that count otherwise than others, as on the wire.
pub mod cause {
    /// Power came.
    pub const POWER_ON: u8 = 0;
    /// The reset pin.
    pub const RESET_PIN: u8 = 3;
    /// The supply sagged so far that the processor was reset.
    pub const BROWN_OUT: u8 = 4;
}

/// Starts in a row without a minute's work after the last of which the software waits, for commands or to try once more.
pub const MOST_STARTS: u32 = 5;
/// Work after which the starts before it count as right, µs.
const SETTLED_US: u64 = 60_000_000;
/// Work after which the failures of the supply before it are forgotten, µs.
const FORGOTTEN_US: u64 = 3_600_000_000;

/// What is counted over resets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Starts by software or watchdog, without a minute's work between.
    pub starts: u32,
    /// Failures of the supply, without an hour's work between.
    pub failures: u32,
    /// What the newest start does, after too many.
    pub phase: Phase,
}

/// What a start does, after too many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// It records.
    #[default]
    Records,
    /// It waits. Where another start finds this, waiting ended by a crash.
    Waits,
    /// It has waited: the next one records.
    Waited,
}

impl From<u32> for Phase {
    fn from(number: u32) -> Self {
        [Self::Records, Self::Waits, Self::Waited]
            .into_iter()
            .find(|p| *p as u32 == number)
            .unwrap_or_default()
    }
}

/// What a board that does not record waits for, beside a command.
#[derive(Clone, Copy, Debug)]
enum Until {
    /// It records, or waits for commands alone.
    Told,
    /// Its supply has been good for so long, µs.
    Good(Supply, u64),
    /// So long after the start, µs.
    Late(u64),
}

/// One start.
#[derive(Clone, Copy, Debug)]
pub struct Starts {
    counts: Counts,
    cause: u8,
    before: Phase,
    until: Until,
}

impl Starts {
    /// A start of this cause, after what was counted before. A person or the supply begins afresh.
    pub fn new(cause: u8, before: Counts) -> Self {
        let Counts { starts, failures, phase } = before;
        let counted = |starts, failures| Counts { starts, failures, phase: Phase::Records };
        let counts = match cause {
            cause::POWER_ON | cause::RESET_PIN => counted(1, 0),
            cause::BROWN_OUT => counted(1, failures.saturating_add(1)),
            _ => counted(starts.saturating_add(1), failures),
        };
        let mut new = Self { counts, cause, before: phase, until: Until::Told };
        if new.too_many() {
            new.counts.phase = Phase::Waits;
        }
        new
    }

    /// What is to be kept over a reset.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Why the board must not record yet, where that is so: it started too often, or its supply failed again. From then on it
    /// waits until that may be over.
    pub fn must_wait(&mut self) -> Option<Reason> {
        let Counts { starts, failures, .. } = self.counts;
        if self.too_many() {
            self.until = Until::Late(try_again_us(starts));
            return Some((FaultCode::ManyResets, starts.into()));
        }
        let waits = self.cause == cause::BROWN_OUT && failures > 1;
        waits.then(|| self.wait_for_supply())
    }

    fn too_many(&self) -> bool {
        self.counts.starts > MOST_STARTS && self.before != Phase::Waited
    }

    /// Whether even waiting has ended by a crash: it had better wait with nothing but the line.
    pub fn crashed_waiting(&self) -> bool {
        self.too_many() && self.before == Phase::Waits
    }

    /// The supply has failed: the board waits until it is good. Its counts have changed.
    pub fn supply_failed(&mut self) -> Reason {
        self.counts.failures = self.counts.failures.saturating_add(1);
        self.wait_for_supply()
    }

    fn wait_for_supply(&mut self) -> Reason {
        self.until = Until::Good(Supply::failed(), good_us(self.counts.failures));
        (FaultCode::SupplyLow, THRESHOLD_MV.into())
    }

    /// The board works, so long after its start. Whether that changed its counts.
    pub fn works(&mut self, us: u64) -> bool {
        let before = self.counts;
        if matches!(self.until, Until::Told) {
            self.counts.starts *= u32::from(us < SETTLED_US);
            self.counts.failures *= u32::from(us < FORGOTTEN_US);
        }
        self.counts != before
    }

    /// Whether what it waits for has come.
    pub fn over(&mut self, detector: &mut impl Detector) -> bool {
        match &mut self.until {
            Until::Told => false,
            Until::Good(supply, good_us) => supply.has_recovered(detector, *good_us),
            Until::Late(at_us) => detector.now_us() >= *at_us,
        }
    }

    /// The board begins a new session by a reset, in which it records. Where too many starts were waited out of which nobody
    /// said that they are over, they count on; else they count as right. Its counts have changed.
    pub fn again(&mut self, detector: &mut impl Detector) {
        if matches!(self.until, Until::Late(_)) && self.over(detector) {
            self.counts.phase = Phase::Waited;
        } else {
            self.counts = Counts { failures: self.counts.failures, ..Counts::default() };
        }
    }
}

/// For how long the supply must be good before a recording begins, µs, after so many failures with less than an hour's work
/// between: twice as long each time, so that a tired battery does not fill card and store with the begins of recordings.
fn good_us(failures: u32) -> u64 {
    const FIRST_US: u64 = 5_000_000;
    doubled(FIRST_US, failures.saturating_sub(1)).min(FORGOTTEN_US)
}

/// How long after its start a board tries once more, µs, after so many starts in a row: what ended it may be over, and nobody
/// may be there to say so. Ten minutes, then twice as long each time, a day at most. Each time has two starts: that which waits
/// and that which records.
fn try_again_us(starts: u32) -> u64 {
    const FIRST_US: u64 = 600_000_000;
    const LONGEST_US: u64 = 86_400_000_000;
    doubled(FIRST_US, starts.saturating_sub(MOST_STARTS + 1) / 2).min(LONGEST_US)
}

fn doubled(us: u64, times: u32) -> u64 {
    us.saturating_mul(1 << times.min(20))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Good since 0, at this moment of the board's time, µs.
    struct Good(u64);

    impl Detector for Good {
        fn is_low(&mut self) -> bool {
            false
        }
        fn now_us(&mut self) -> u64 {
            self.0
        }
    }

    const WATCHDOG: u8 = 1;
    const SOFTWARE: u8 = 2;

    /// When, after a start, what it waits for is over, s; `None`: it does not wait.
    fn waits_s(starts: &mut Starts) -> Option<u64> {
        starts.must_wait()?;
        (0..200_000).find(|s| starts.over(&mut Good(s * 1_000_000)))
    }

    /// Starts of a board whose recording always crashes and whose waiting crashes where it is asked: how long each waited, min,
    /// and with how much; `None`: it recorded.
    fn crashing(starts: usize, waiting_crashes: impl Fn(&Starts) -> bool) -> Vec<Option<(u64, bool)>> {
        let mut counts = Counts::default();
        let mut told = Vec::new();
        for _ in 0..starts {
            let mut starts = Starts::new(WATCHDOG, counts);
            counts = starts.counts();
            let waits = waits_s(&mut starts).map(|s| (s / 60, starts.crashed_waiting()));
            told.push(waits);
            if waits.is_some() && !waiting_crashes(&starts) {
                starts.again(&mut Good(200_000_000_000));
                counts = starts.counts();
            }
        }
        told
    }

    #[test]
    fn after_too_many_starts_it_waits_ever_longer_and_records_once_after_each_wait() {
        let told = crashing(25, |_| false);
        assert_eq!(told[..5], [None; 5]);
        let waits: Vec<u64> = told[5..].iter().step_by(2).map(|wait| wait.unwrap().0).collect();
        assert_eq!(waits, [10, 20, 40, 80, 160, 320, 640, 1280, 1440, 1440]);
        assert!(told[6..].iter().step_by(2).all(Option::is_none), "between, it recorded: {told:?}");
        assert!(told.iter().flatten().all(|(_, crashed)| !crashed));
    }

    #[test]
    fn where_waiting_crashes_too_it_waits_with_nothing_but_the_line_and_then_records_once() {
        let told = crashing(10, |starts| !starts.crashed_waiting());
        let waits = [Some((10, false)), Some((10, true)), None, Some((20, false)), Some((40, true))];
        assert_eq!(told[5..], waits);
    }

    #[test]
    fn a_command_power_and_the_reset_pin_begin_afresh() {
        let many = Counts { starts: 30, ..Counts::default() };
        let mut told = Starts::new(SOFTWARE, many);
        assert!(told.must_wait().is_some());
        told.again(&mut Good(1));
        assert_eq!(told.counts(), Counts::default());
        for cause in [cause::POWER_ON, cause::RESET_PIN] {
            let mut afresh = Starts::new(cause, Counts { phase: Phase::Waits, ..many });
            assert_eq!(afresh.counts(), Counts { starts: 1, ..Counts::default() });
            assert!(afresh.must_wait().is_none());
        }
        for phase in [Phase::Records, Phase::Waits, Phase::Waited] {
            assert_eq!(Phase::from(phase as u32), phase);
        }
    }

    #[test]
    fn a_supply_that_fails_again_is_waited_for_and_never_counts_as_a_start() {
        let mut counts = Counts::default();
        let mut waits = Vec::new();
        for _ in 0..12 {
            let mut starts = Starts::new(cause::BROWN_OUT, counts);
            waits.push(waits_s(&mut starts));
            counts = starts.counts();
            assert_eq!(counts.starts, 1);
        }
        let later = [10, 20, 40, 80, 160, 320, 640, 1280, 2560, 3600, 3600].map(Some);
        assert_eq!(waits, [&[None][..], &later].concat());
        // Of a supply that is low and not gone even the first is waited out.
        let mut starts = Starts::new(SOFTWARE, Counts::default());
        assert_eq!(starts.supply_failed(), (FaultCode::SupplyLow, THRESHOLD_MV.into()));
        // It is good again before the waiting begins, a day after the start.
        const DAY_S: u64 = 86_400;
        let over = (DAY_S..DAY_S + 100).find(|s| starts.over(&mut Good(s * 1_000_000)));
        assert_eq!(over, Some(DAY_S + 5));
    }

    #[test]
    fn work_settles_starts_after_a_minute_and_failures_after_an_hour() {
        let mut starts = Starts::new(cause::BROWN_OUT, Counts { starts: 4, ..Counts::default() });
        assert!(starts.must_wait().is_none() && !starts.works(59_000_000));
        assert!(starts.works(60_000_000) && !starts.works(61_000_000));
        assert_eq!(starts.counts(), Counts { failures: 1, ..Counts::default() });
        assert!(starts.works(3_600_000_000));
        assert_eq!(starts.counts(), Counts::default());
        // One that waits does not work.
        let mut waits = Starts::new(WATCHDOG, Counts { starts: 7, failures: 1, ..Counts::default() });
        assert!(waits.must_wait().is_some() && !waits.works(u64::MAX));
    }
}
