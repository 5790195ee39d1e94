//! Whether the converter's edges come when its pace says: one edge that was lost, or was none of the converter's, puts all numbers
//! after it off by one.
//!
//! A moment is noted by an interrupt, never early and mostly not late; so of a few moments in a row the least late is held against
//! the least late of those before. What rate they have to each other is taken from the seconds before in the same stretch of
//! conversions: over minutes, or while the converter stood still, the board's clock may drift by more than can be told apart from an edge.

use crate::pace::{Pace, Stamp};

/// What the moments of a window say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Not enough of them yet.
    Open,
    /// All edges were counted; the least late moment.
    Right(Stamp),
    /// Edges are wanting, or too many.
    Wrong,
}

/// The moments under way.
#[derive(Clone, Copy, Debug, Default)]
pub struct Phase {
    /// The moment that the others are held against: the least late of the window before, or the first of all.
    from: Option<Stamp>,
    /// The rate of the seconds before, by the least late moments of this stretch.
    recent: Option<Pace>,
    /// The least late, by how much, and how much is nothing.
    best: Option<(Stamp, i64, i64)>,
    seen: u8,
    newest: u64,
}

impl Phase {
    /// A moment; each counts once. `moments` make a window. By `pace` they are compared until a sixteenth of a second of this stretch was
    /// measured; until then nothing is judged.
    pub fn note(&mut self, stamp: Stamp, pace: &Pace, moments: u8) -> Verdict {
        if stamp.edges <= self.newest {
            return Verdict::Open;
        }
        self.newest = stamp.edges;
        let from = *self.from.get_or_insert(stamp);
        let recent = self.recent().copied();
        let (late, most) = recent.as_ref().unwrap_or(pace).late(from, stamp);
        let best = self.best.filter(|best| best.1 <= late).unwrap_or((stamp, late, most));
        self.best = Some(best);
        self.seen += 1;
        if self.seen < moments {
            return Verdict::Open;
        }
        let (best, late, most) = best;
        (self.from, self.best, self.seen) = (Some(best), None, 0);
        if recent.is_some() && late.abs() > most {
            return Verdict::Wrong;
        }
        self.recent.get_or_insert(Pace::recent(best, pace.hz())).note(best);
        Verdict::Right(best)
    }

    /// The rate of the seconds before, once it was measured.
    pub fn recent(&self) -> Option<&Pace> {
        self.recent.as_ref().filter(|pace| pace.is_measured())
    }

    /// The edge of this number was none of the converter's.
    pub fn leave_out(&mut self, edge: u64) {
        self.from.iter_mut().for_each(|stamp| stamp.leave_out(edge));
        self.recent.iter_mut().for_each(|pace| pace.leave_out(edge));
        self.best.iter_mut().for_each(|best| best.0.leave_out(edge));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HZ: u32 = 64_000;

    /// Moments of every 256th edge, the n-th late by `late_us`, of a converter that 1 % of the board's clock is wrong for.
    fn stamp(n: u64, lost: i64, late_us: u64) -> Stamp {
        let instants = n * 256;
        Stamp { edges: instants.saturating_add_signed(-lost), at_us: instants * 15_469 / 1000 + late_us }
    }

    fn pace() -> Pace {
        let mut pace = Pace::new(stamp(0, 0, 0), HZ);
        (1..1000).for_each(|n| pace.note(stamp(n, 0, 0)));
        pace
    }

    /// Windows until a loss of so many edges at moment 1021 is found, of those whose moments are late by up to 14 us but for one.
    fn found(lost: i64) -> Option<u64> {
        let (pace, mut phase) = (pace(), Phase::default());
        (1000..1400).find(|n| {
            let late = if n % 4 == 2 { 0 } else { n * 7 % 15 };
            let lost = if *n >= 1021 { lost } else { 0 };
            phase.note(stamp(*n, lost, late), &pace, 4) == Verdict::Wrong
        })
    }

    #[test]
    fn one_edge_less_or_more_is_found_within_two_windows_and_late_moments_are_not() {
        assert_eq!(found(0), None);
        for lost in [1, -1, 2, 3, -5] {
            assert!(matches!(found(lost), Some(1021..1029)), "{lost}: {:?}", found(lost));
        }
    }

    #[test]
    fn a_false_edge_that_is_left_out_is_none() {
        let (mut pace, mut phase) = (pace(), Phase::default());
        for n in 1000..1400 {
            if n == 1021 {
                // Its number; from then on there is one more.
                pace.leave_out(1020 * 256 + 40);
                phase.leave_out(1020 * 256 + 40);
            }
            let verdict = phase.note(stamp(n, -i64::from(n >= 1021), 0), &pace, 4);
            assert_ne!(verdict, Verdict::Wrong, "{n}");
        }
    }

    #[test]
    fn what_the_pace_does_not_know_is_no_loss() {
        // Measured over 4096 edges by moments that were late by most of a conversion.
        let (first, last) = (Stamp { edges: 0, at_us: 14 }, Stamp { edges: 4096, at_us: 64_000 });
        let mut pace = Pace::new(first, HZ);
        pace.note(last);
        let mut phase = Phase::default();
        for n in 17..40 {
            let stamp = Stamp { edges: n * 256, at_us: n * 4000 };
            assert_ne!(phase.note(stamp, &pace, 4), Verdict::Wrong, "{n}");
        }
    }

    #[test]
    fn hours_without_a_moment_and_a_clock_that_drifts_meanwhile_are_no_loss() {
        // 250 Hz; the board's clock is 40 millionths faster after three hours.
        let pace = {
            let mut pace = Pace::new(Stamp::default(), 250);
            (1..2000).for_each(|n| pace.note(Stamp { edges: n * 16, at_us: n * 64_000 }));
            pace
        };
        let mut phase = Phase::default();
        let before = Stamp { edges: 32_000, at_us: 128_000_000 };
        assert_ne!(phase.note(before, &pace, 1), Verdict::Wrong);
        let edges = 10_800 * 250;
        let after =
            Stamp { edges: before.edges + edges, at_us: before.at_us + edges * 4000 + edges * 4000 / 25_000 };
        assert_ne!(phase.note(after, &pace, 1), Verdict::Wrong);
        // A second of it, a conversion wanting.
        let next = Stamp { edges: after.edges + 249, at_us: after.at_us + 1_000_000 };
        assert_eq!(phase.note(next, &pace, 1), Verdict::Wrong);
    }
}
