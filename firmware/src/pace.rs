//! How long a conversion takes in the board's time, measured by the converter's own edges.

/// A moment at which an edge was counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// Edges up to then.
    pub edges: u64,
    /// Microseconds of the board's clock.
    pub at_us: u64,
}

/// Least distance of two moments kept, as a part of a second.
const STEP: u64 = 16;
/// A baseline is between one and two of these long, s: a minute or two, over which an oscillator hardly drifts.
const SPAN: u64 = 64;

/// Moments far apart.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    oldest: Stamp,
    middle: Stamp,
    newest: Stamp,
    hz: u32,
}

impl Pace {
    /// From this moment on; nominally so many conversions a second.
    pub fn new(first: Stamp, hz: u32) -> Self {
        Self { oldest: first, middle: first, newest: first, hz }
    }

    /// A later moment.
    pub fn note(&mut self, stamp: Stamp) {
        let hz = u64::from(self.hz);
        if stamp.edges < self.newest.edges.saturating_add(hz / STEP) {
            return;
        }
        self.newest = stamp;
        if stamp.edges - self.middle.edges >= hz * SPAN {
            (self.oldest, self.middle) = (self.middle, stamp);
        }
    }

    /// The newest moment kept.
    pub fn newest(&self) -> Stamp {
        self.newest
    }

    /// Conversions, to the nearest, that `us` would have held; by the nominal rate where nothing was measured yet.
    pub fn conversions(&self, us: u64) -> u64 {
        let (edges, span_us) = match self.newest.edges - self.oldest.edges {
            0 => (u64::from(self.hz), 1_000_000),
            edges => (edges, self.newest.at_us.saturating_sub(self.oldest.at_us).max(1)),
        };
        let (edges, span_us) = (u128::from(edges), u128::from(span_us));
        ((u128::from(us) * edges + span_us / 2) / span_us) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minute_is_as_many_conversions_as_there_were_in_the_minutes_before() {
        // The board's clock is 1 % slow: 64 000 edges in 990 000 of its microseconds.
        let stamp = |n: u64| Stamp { edges: 77 + n * 6400, at_us: 5 + n * 99_000 };
        let mut pace = Pace::new(stamp(0), 64_000);
        assert_eq!(pace.conversions(60_000_000), 3_840_000, "nothing is measured yet");
        (1..3000).for_each(|n| pace.note(stamp(n)));
        assert_eq!(pace.newest(), stamp(2999));
        let conversions = pace.conversions(60 * 990_000);
        assert!(conversions.abs_diff(3_840_000) <= 1, "{conversions}");
    }
}
