//! Which records of other base stations have come: their numbers, in runs, by the store they come from. Bounded whatever is said.

use std::collections::{BTreeMap, BTreeSet};

/// Runs of numbers kept of a log; in what lies between the oldest of more than these nothing comes again.
const RUNS: usize = 100_000;
/// The same of all logs together: of the log that has another its oldest are joined then.
const RUNS_OF_ALL: usize = 1_000_000;
/// Logs that are known; of further ones nothing is taken.
pub(super) const LOGS: usize = 10_000;

/// Which numbers of a log have come: runs of them, the first of each and the last.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Seen {
    pub(super) runs: BTreeMap<u64, u64>,
    /// First numbers of runs that have changed, or are no more, since they were last stored.
    changed: BTreeSet<u64>,
}

impl Seen {
    fn has(&self, number: u64) -> bool {
        self.runs.range(..=number).next_back().is_some_and(|(_, last)| number <= *last)
    }

    /// Takes a number; false if it has come before.
    pub(super) fn take(&mut self, number: u64) -> bool {
        let before = self.runs.range(..=number).next_back().map(|(first, last)| (*first, *last));
        if before.is_some_and(|(_, last)| number <= last) {
            return false;
        }
        // Below the oldest run only where the beginning was left out, or is forgotten.
        let joined = before.filter(|(_, last)| last + 1 == number);
        let first = joined.map_or(number, |(first, _)| first);
        let after = number.checked_add(1).and_then(|next| self.runs.remove(&next).map(|last| (next, last)));
        self.changed.extend(after.map(|(next, _)| next));
        self.runs.insert(first, after.map_or(number, |(_, last)| last));
        self.changed.insert(first);
        if self.runs.len() > RUNS {
            self.join_oldest();
        }
        true
    }

    fn join_oldest(&mut self) {
        let mut oldest = self.runs.iter().map(|(first, last)| (*first, *last));
        let (Some((first, _)), Some((second, last))) = (oldest.next(), oldest.next()) else { return };
        self.runs.remove(&second);
        self.runs.insert(first, last);
        self.changed.extend([first, second]);
    }

    /// Numbers between the first and the last that have not come.
    pub(super) fn missing(&self) -> u64 {
        let span = self.runs.first_key_value().zip(self.runs.last_key_value());
        let between = span.map_or(0, |((first, _), (_, last))| last - first);
        // All that have come but one, so that no sum is greater than the greatest number.
        let come = self.runs.iter().map(|(first, last)| last - first).sum::<u64>();
        between - come - (self.runs.len() as u64).saturating_sub(1)
    }
}

/// What becomes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// It is new.
    New,
    /// It has come before.
    Again,
    /// Nobody knows: no more logs fit.
    Refused,
}

/// The same of all logs.
#[derive(Debug, Default)]
pub(crate) struct Known {
    logs: BTreeMap<u64, Seen>,
    runs: usize,
}

impl Known {
    /// Whether a number has come.
    pub(super) fn has(&self, log: u64, number: u64) -> bool {
        self.logs.get(&log).is_some_and(|seen| seen.has(number))
    }

    /// Takes a number.
    pub(super) fn take(&mut self, log: u64, number: u64) -> Taken {
        if self.logs.len() >= LOGS && !self.logs.contains_key(&log) {
            return Taken::Refused;
        }
        let seen = self.logs.entry(log).or_default();
        let before = seen.runs.len();
        let new = seen.take(number);
        if self.runs >= RUNS_OF_ALL && seen.runs.len() > before {
            seen.join_oldest();
        }
        self.runs = self.runs + seen.runs.len() - before;
        if new { Taken::New } else { Taken::Again }
    }

    /// Takes a run from where it was stored.
    pub(crate) fn resume(&mut self, log: u64, first: u64, last: u64) {
        self.logs.entry(log).or_default().runs.insert(first, last);
        self.runs += 1;
    }

    /// What has changed since it was last stored: log, first number of a run, and its last; none where it is no more.
    pub(crate) fn changed(&self) -> impl Iterator<Item = (u64, u64, Option<u64>)> {
        let of = |(log, seen): (&u64, &Seen)| {
            let log = *log;
            seen.changed.iter().map(move |first| (log, *first)).collect::<Vec<_>>()
        };
        let last = |(log, first): (u64, u64)| {
            (log, first, self.logs.get(&log).and_then(|s| s.runs.get(&first)).copied())
        };
        self.logs.iter().filter(|(_, seen)| !seen.changed.is_empty()).flat_map(of).map(last)
    }

    /// That is in the store now.
    pub(super) fn stored(&mut self) {
        self.logs.values_mut().for_each(|seen| seen.changed.clear());
    }

    /// Logs.
    pub(super) fn len(&self) -> usize {
        self.logs.len()
    }

    /// Numbers between others that have not come.
    pub(super) fn missing(&self) -> u64 {
        self.logs.values().map(Seen::missing).fold(0, u64::saturating_add)
    }
}
