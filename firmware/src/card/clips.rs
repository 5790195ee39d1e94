//! Which sound is kept, where a recorder keeps clips about its detections: files without a claim are filled again.
//!
//! Enters: detections, and files that are written. Leaves: which of these files may be filled again. The recorder writes always;
//! what lies before a detection is on the card when it is made, in a file that nothing claimed yet. Such files wait here until no
//! detection can claim them any more. All lengths are in instants.

use super::search::Found;
use core::ops::Range;
use heapless::Deque;
use seabearing_core::config;

/// Files that may wait; with more, the oldest of them is filled again before its time.
const MOST_HELD: usize = 64;
/// A detection is told so long after its sound at most, s.
const LATE_S: u32 = 10;

/// What is kept about detections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clips {
    before: u64,
    after: u64,
    apart: u64,
    late: u64,
}

impl Clips {
    /// As a station's configuration says, at so many samples a second.
    pub fn new(clips: config::Clips, rate_hz: u32) -> Self {
        let instants = |seconds: u32| u64::from(seconds) * u64::from(rate_hz);
        Self {
            before: instants(clips.before_s.into()),
            after: instants(clips.after_s.into()),
            apart: instants(clips.apart_s),
            late: instants(LATE_S),
        }
    }

    /// Whether sound without a claim is given up.
    pub fn are_kept(&self) -> bool {
        self.after > 0
    }
}

/// A written file without a claim.
#[derive(Debug)]
struct Held {
    found: Found,
    /// Its indices.
    samples: Range<u64>,
}

/// Claims on sound, and files that nothing claimed.
#[derive(Debug, Default)]
pub struct Claims {
    clips: Clips,
    held: Deque<Held, MOST_HELD>,
    /// Index before which no other detection is kept.
    next: u64,
    /// The newest claim.
    claim: Range<u64>,
}

impl Claims {
    /// None, of a card whose every sound is kept.
    pub const fn new() -> Self {
        let clips = Clips { before: 0, after: 0, apart: 0, late: 0 };
        Self { clips, held: Deque::new(), next: 0, claim: 0..0 }
    }

    /// From the beginning.
    pub fn begin(&mut self, clips: Clips) {
        self.held.clear();
        (self.clips, self.next, self.claim) = (clips, 0, 0..0);
    }

    /// Another card, or the same from the beginning: what is on it stays.
    pub fn forget_files(&mut self) {
        self.held.clear();
    }

    /// A detection; the samples that it claims, if it is kept. Files that hold some of them stay.
    pub fn heard(&mut self, index: u64) -> Option<Range<u64>> {
        let Clips { before, after, apart, .. } = self.clips;
        // Where time began again, what was kept before says nothing.
        let anew = index.saturating_add(apart) < self.next;
        if !self.clips.are_kept() || index < self.next && !anew {
            return None;
        }
        self.next = index.saturating_add(apart);
        self.claim = index.saturating_sub(before)..index.saturating_add(after);
        for _ in 0..self.held.len() {
            if let Some(held) = self.held.pop_front()
                && !meet(&held.samples, &self.claim)
            {
                // There is room: one was taken out.
                let _ = self.held.push_back(held);
            }
        }
        Some(self.claim.clone())
    }

    /// Whether a file that begins with this sample has a claim already.
    pub fn reaches(&self, index: u64) -> bool {
        self.claim.contains(&index)
    }

    /// A file without a claim was written.
    pub fn hold(&mut self, found: Found, samples: Range<u64>) {
        if self.clips.are_kept() {
            // There is room: `again` leaves some.
            let _ = self.held.push_back(Held { found, samples });
        }
    }

    /// A file that no detection from now on can claim, to be filled again; the next sample has this index.
    pub fn again(&mut self, index: u64) -> Option<Found> {
        let Clips { before, late, .. } = self.clips;
        let oldest = self.held.front()?;
        let over = oldest.samples.end.saturating_add(before).saturating_add(late) <= index;
        let anew = index < oldest.samples.start;
        if over || anew || self.held.is_full() { self.held.pop_front().map(|held| held.found) } else { None }
    }
}

/// Whether two spans share a sample.
pub fn meet(a: &Range<u64>, b: &Range<u64>) -> bool {
    a.start < b.end && b.start < a.end
}
