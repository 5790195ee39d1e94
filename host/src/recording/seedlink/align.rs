//! Records of four components, as they come, side by side.
//!
//! A component is waited for until another is `latest` samples ahead; what is not there by then is missing, and what comes
//! after that is left out. Where no component has anything the index jumps. A record follows the one before where its time
//! agrees within half a sample with what that one's time and length say; what comes twice is used once.

use seabearing_core::block::{CHANNELS, Frame, MISSING};
use std::collections::VecDeque;

/// Most frames of one block.
const BLOCK: i64 = 4096;

/// Where a record lies.
#[derive(Clone, Copy)]
struct Placed {
    start_ns: i128,
    first: i64,
    samples: i64,
}

/// One component.
#[derive(Default)]
struct Component {
    /// Index of the first sample, and the samples, in the order of their coming.
    held: VecDeque<(i64, Vec<i32>)>,
    /// The record that reaches farthest.
    last: Option<Placed>,
}

impl Component {
    fn end(&self) -> i64 {
        self.last.map_or(i64::MIN, |last| last.first + last.samples)
    }

    fn place(&mut self, start_ns: i128, samples: i64, zero_ns: i128, rate_hz: f64) -> i64 {
        let first = match self.last {
            None => ((start_ns - zero_ns) as f64 * 1e-9 * rate_hz).round() as i64,
            Some(last) => {
                // Samples between the end of the last and the start of this one; negative where they overlap.
                let between = (start_ns - last.start_ns) as f64 * 1e-9 * rate_hz - last.samples as f64;
                let jump = if between.abs() <= 0.5 { 0 } else { between.round() as i64 };
                last.first + last.samples + jump
            }
        };
        if first + samples >= self.end() {
            self.last = Some(Placed { start_ns, first, samples });
        }
        first
    }
}

/// The components of a station.
pub(super) struct Aligner {
    rate_hz: f64,
    /// Longest that a component is waited for, samples.
    latest: i64,
    zero_ns: Option<i128>,
    components: [Component; CHANNELS],
    /// Index of the next frame to leave.
    next: i64,
}

impl Aligner {
    pub(super) fn new(rate_hz: f64, latest: i64) -> Self {
        Self { rate_hz, latest, zero_ns: None, components: Default::default(), next: 0 }
    }

    /// Takes a record; sample 0 is the first one of the first.
    pub(super) fn take(&mut self, component: usize, start_ns: i128, samples: Vec<i32>) {
        let zero_ns = *self.zero_ns.get_or_insert(start_ns);
        let Some(c) = self.components.get_mut(component) else { return };
        let first = c.place(start_ns, samples.len() as i64, zero_ns, self.rate_hz);
        c.held.push_back((first, samples));
    }

    /// The next frames into `frames`, and the index of the first; `None` where some component has still to come. `all`: nothing
    /// will come any more.
    pub(super) fn block(&mut self, frames: &mut Vec<Frame>, all: bool) -> Option<u64> {
        let ends = self.components.each_ref().map(Component::end);
        let newest = ends.iter().copied().max().unwrap_or(i64::MIN);
        let waits_for = newest.saturating_sub(self.latest);
        let until = if all { newest } else { ends.iter().map(|end| (*end).max(waits_for)).min()? };
        let next = self.next;
        let pieces = || self.components.iter().flat_map(|c| &c.held);
        let there = pieces().filter(|(first, samples)| first + samples.len() as i64 > next);
        // Where nothing is, the index jumps.
        let from = there.map(|(first, _)| (*first).max(next)).min().filter(|from| *from < until)?;
        let to = until.min(from + BLOCK);
        frames.clear();
        frames.resize((to - from) as usize, [MISSING; CHANNELS]);
        let mut covered = vec![false; frames.len()];
        for (c, component) in self.components.iter().enumerate() {
            for (first, samples) in &component.held {
                let skipped = (from - first).max(0) as usize;
                let begins = (first - from).max(0) as usize;
                let places = frames.iter_mut().zip(&mut covered).skip(begins);
                for ((frame, covered), x) in places.zip(samples.iter().skip(skipped)) {
                    (frame[c], *covered) = (*x, true);
                }
            }
        }
        frames.truncate(covered.iter().position(|there| !there).unwrap_or(covered.len()));
        self.next = from + frames.len() as i64;
        for component in &mut self.components {
            component.held.retain(|(first, samples)| first + samples.len() as i64 > self.next);
        }
        u64::try_from(from).ok()
    }
}
