//! What has come of a log: the next number of each class, and which of the 64 after it.

use super::ahead;
use super::store::{CLASSES, PerClass};

/// Numbers from the next one on that are taken; later ones must come again.
pub(super) const WINDOW: u32 = 64;

/// What has come of a log. A receiver that keeps it with the records goes on after a restart as if nothing had been.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// All records of the class before this number have come, or were told to be lost.
    pub next: PerClass,
    /// Bit n: number `next + 1 + n` has come.
    pub later: [u64; CLASSES],
}

/// What became of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// It had not come before.
    Fresh,
    /// It had.
    Again,
    /// Too far ahead.
    TooFar,
}

impl Progress {
    /// Takes note of a number.
    pub(super) fn take(&mut self, class: usize, number: u32) -> Taken {
        let (Some(next), Some(later)) = (self.next.get_mut(class), self.later.get_mut(class)) else {
            return Taken::TooFar;
        };
        match number.wrapping_sub(*next) {
            0 => {
                *next = next.wrapping_add(1);
                shift(next, later);
                Taken::Fresh
            }
            n if n <= WINDOW => {
                let bit = 1 << (n - 1);
                let taken = if *later & bit != 0 { Taken::Again } else { Taken::Fresh };
                *later |= bit;
                taken
            }
            _ if ahead(number, *next) => Taken::TooFar,
            _ => Taken::Again,
        }
    }

    /// The same, with nothing of these classes said to have come for good: the peer keeps all from `first` on, and does not say
    /// again what has come after that while it hears of it.
    pub(super) fn withheld(&self, first: &PerClass, withheld: &[bool; CLASSES]) -> Self {
        let mut told = *self;
        let told_of = told.next.iter_mut().zip(told.later.iter_mut());
        for ((next, to), (first, _)) in told_of.zip(first.iter().zip(withheld)).filter(|(_, (_, w))| **w) {
            let (n, later) = (next.wrapping_sub(*first), *to);
            *next = *first;
            // Bit k is number first + 1 + k: those before `next`, then those after it.
            let before = match n {
                0 | 1 => 0,
                n => u64::MAX.checked_shr(65u32.saturating_sub(n)).unwrap_or(u64::MAX),
            };
            *to = before | later.checked_shl(n).unwrap_or(0);
        }
        told
    }

    /// Records of the class before `start` will not come any more: how many of them had not come.
    pub(super) fn skip(&mut self, class: usize, start: u32) -> u32 {
        let (Some(next), Some(later)) = (self.next.get_mut(class), self.later.get_mut(class)) else {
            return 0;
        };
        if !ahead(start, *next) {
            return 0;
        }
        let jump = start.wrapping_sub(*next);
        // Of the numbers before `start` all but the first may have come.
        let below = if jump > WINDOW { u64::MAX } else { (1u64 << (jump - 1)) - 1 };
        let missing = jump - (*later & below).count_ones();
        let at_start = jump <= WINDOW && *later >> (jump - 1) & 1 != 0;
        *later = later.checked_shr(jump).unwrap_or(0);
        *next = start;
        if at_start {
            *next = next.wrapping_add(1);
            shift(next, later);
        }
        missing
    }
}

/// `next` has come: goes over what has come after it. Bit 0 of `later` becomes that of the number after the new `next`.
fn shift(next: &mut u32, later: &mut u64) {
    let run = later.trailing_ones();
    *next = next.wrapping_add(run);
    *later = later.checked_shr(run + 1).unwrap_or(0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    proptest::proptest! {
        #![proptest_config(seabearing_testkit::property(500))]

        #[test]
        fn as_a_set_of_numbers_would(
            first in proptest::prelude::prop_oneof![proptest::strategy::Just(0u32), proptest::strategy::Just(u32::MAX - 40)],
            steps in proptest::collection::vec((0u32..90, proptest::bool::weighted(0.05)), 1..300),
        ) {
            let mut progress = Progress { next: [first; CLASSES], ..Progress::default() };
            // The plain way: all numbers that came, and the lowest that may still come.
            let (mut came, mut low) = (BTreeSet::new(), 0u32);
            for (step, skip) in steps {
                let at = low.saturating_sub(8) + step;
                if skip {
                    let missing = progress.skip(2, first.wrapping_add(at));
                    proptest::prop_assert_eq!(missing, (low..at).filter(|n| !came.contains(n)).count() as u32);
                    low = low.max(at);
                } else {
                    let want = match at {
                        n if n < low || came.contains(&n) => Taken::Again,
                        n if n > low + WINDOW => Taken::TooFar,
                        _ => Taken::Fresh,
                    };
                    proptest::prop_assert_eq!(progress.take(2, first.wrapping_add(at)), want);
                    if want == Taken::Fresh {
                        came.insert(at);
                    }
                }
                while came.contains(&low) {
                    low += 1;
                }
                proptest::prop_assert_eq!(progress.next[2], first.wrapping_add(low));
                let later = (0..64).filter(|n| came.contains(&(low + 1 + n))).fold(0u64, |m, n| m | 1 << n);
                proptest::prop_assert_eq!(progress.later[2], later);
            }
        }
    }
}
