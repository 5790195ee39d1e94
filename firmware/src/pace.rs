//! How long a conversion takes in the board's time, measured by the converter's own edges.

/// A moment at which an edge was counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// Edges up to then.
    pub edges: u64,
    /// Microseconds of the board's clock.
    pub at_us: u64,
}

impl Stamp {
    /// The edge of this number was none of the converter's: a moment before it is given the count that fits those after it.
    pub fn leave_out(&mut self, edge: u64) {
        if self.edges <= edge {
            self.edges += 1;
        }
    }
}

/// Parts of a conversion.
pub const PARTS: i64 = 256;
/// Least distance of two moments kept, as a part of a second.
const STEP: u64 = 16;
/// A baseline is between one and two of these long, s: a minute or two. An oscillator without a crystal drifts by tens of millionths in that,
/// and by thousandths as a recorder sinks into cold water: what a few conversions are held against is [`Pace::recent`].
const SPAN: u64 = 64;
/// The same of a recent one, in edges; a second at least.
const RECENT: u64 = 4096;
/// A stretch of a second tells the rate to this part: one that was measured before and is farther from it holds no longer.
const HOLDS: u64 = 50_000;

/// Moments far apart.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    oldest: Stamp,
    middle: Stamp,
    newest: Stamp,
    /// Edges and microseconds that were measured before the oldest moment; `None`: nothing was.
    before: Option<(u64, u64)>,
    hz: u32,
    /// A baseline is between one and two of these long, in edges.
    span: u64,
}

impl Pace {
    /// From this moment on; nominally so many conversions a second.
    pub fn new(first: Stamp, hz: u32) -> Self {
        Self { oldest: first, middle: first, newest: first, before: None, hz, span: u64::from(hz) * SPAN }
    }

    /// The same over a second or two, or some thousand conversions where that is longer: no temperature changes so fast.
    pub fn recent(first: Stamp, hz: u32) -> Self {
        Self { span: RECENT.max(hz.into()), ..Self::new(first, hz) }
    }

    /// From this moment on, after edges that were missed: what was measured before holds until more has been.
    pub fn after_outage(self, first: Stamp) -> Self {
        Self { before: self.measured(), ..Self::new(first, self.hz) }
    }

    /// Whether it has measured anything.
    pub fn is_measured(&self) -> bool {
        self.measured().is_some()
    }

    /// The same that was measured from one moment to another, of other edges.
    pub fn by(self, from: Stamp, to: Stamp) -> Self {
        let edges = to.edges.saturating_sub(from.edges);
        Self { before: Some((edges, to.at_us.saturating_sub(from.at_us).max(1))), ..self }
    }

    /// Edges and microseconds of the longest time that was measured and still holds.
    fn measured(&self) -> Option<(u64, u64)> {
        let edges = self.newest.edges - self.oldest.edges;
        let us = self.newest.at_us.saturating_sub(self.oldest.at_us).max(1);
        let holds = |before: &(u64, u64)| {
            let by_before = (u128::from(us) * u128::from(before.0) / u128::from(before.1)) as u64;
            edges < u64::from(self.hz) || by_before.abs_diff(edges) <= 2 + edges / HOLDS
        };
        self.before.filter(|before| before.0 > edges && holds(before)).or((edges > 0).then_some((edges, us)))
    }

    /// A later moment.
    pub fn note(&mut self, stamp: Stamp) {
        let hz = u64::from(self.hz);
        if stamp.edges < self.newest.edges.saturating_add(hz / STEP) {
            return;
        }
        self.newest = stamp;
        if stamp.edges - self.middle.edges >= self.span {
            (self.oldest, self.middle) = (self.middle, stamp);
        }
    }

    /// Conversions a second, nominally.
    pub fn hz(&self) -> u32 {
        self.hz
    }

    /// The newest moment kept.
    pub fn newest(&self) -> Stamp {
        self.newest
    }

    /// How much later `to` was than the edges since `from` would have it, in parts ([`PARTS`]) of a conversion, and how much of that
    /// is nothing: half a conversion, what the pace may be off by, and by how much the clocks may have drifted since: a hundred thousandth, a
    /// millionth more each second as oscillators without a crystal do with temperature, a thousandth at most.
    pub fn late(&self, from: Stamp, to: Stamp) -> (i64, i64) {
        let (edges, span_us) = self.measured().unwrap_or((u64::from(self.hz), 1_000_000));
        let us = to.at_us.saturating_sub(from.at_us);
        let counted = to.edges.saturating_sub(from.edges);
        let by_clock = (u128::from(us) * u128::from(edges) * PARTS as u128 / u128::from(span_us)) as i64;
        let of = counted as i64 * PARTS;
        let drifted = of / 100_000 + of / 1_000_000 * (us / 1_000_000) as i64;
        (by_clock - of, PARTS / 2 + of / edges.max(1) as i64 + drifted.min(of / 1000))
    }

    /// An edge that was none of the converter's is counted as if it had not been: moments before it are moved to those after.
    pub fn leave_out(&mut self, edge: u64) {
        for stamp in [&mut self.oldest, &mut self.middle, &mut self.newest] {
            stamp.leave_out(edge);
        }
    }

    /// Conversions, to the nearest, that `us` would have held; by the nominal rate where nothing was measured yet.
    pub fn conversions(&self, us: u64) -> u64 {
        let (edges, span_us) = self.measured().unwrap_or((u64::from(self.hz), 1_000_000));
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

    #[test]
    fn a_second_outage_is_measured_by_what_came_before_the_first() {
        let stamp = |n: u64| Stamp { edges: n * 6400, at_us: n * 99_000 };
        let mut pace = Pace::new(stamp(0), 64_000);
        (1..50).for_each(|n| pace.note(stamp(n)));
        for outages in 0..3 {
            let conversions = pace.conversions(60 * 990_000);
            assert!(conversions.abs_diff(3_840_000) <= 1, "after {outages}: {conversions}");
            pace = pace.after_outage(stamp(1000 * (outages + 1)));
            // A little is measured between, badly.
            pace.note(Stamp {
                edges: stamp(1000 * (outages + 1)).edges + 4000,
                at_us: stamp(1000 * (outages + 1)).at_us + 61_000,
            });
        }
    }
}
