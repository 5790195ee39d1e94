//! What the recorder knows of a file it fills.

use super::clips::meet;
use super::layout::{Extent, GAPS, Gap, LEAST_PAGES, Why};
use super::search::Found;
use heapless::Vec;
use seabearing_core::utc::Pair;

/// Entries from which on gaps are kept apart, so that the rest last to the file's end.
const SCARCE: usize = GAPS / 2;

/// A file that is filled, or still written.
#[derive(Debug)]
pub struct Sheet {
    /// The file, once it was found: the ring takes sound before.
    pub found: Option<Found>,
    /// Index of its first sample.
    pub first_index: u64,
    /// Instants put in.
    pub frames: u32,
    /// What is missing.
    pub gaps: Vec<Gap, GAPS>,
    /// Two points of the newest line of UTC.
    pub times: [Option<Pair>; 2],
    /// Nothing more is put in.
    pub closed: bool,
    /// Instants on the card.
    pub acknowledged: u32,
    /// Its sound is about a detection, so the file stays.
    pub claimed: bool,
    /// Detections told while it was filled.
    pub detections: u32,
    /// The sample of the first of them.
    pub first_detection: u64,
}

impl Sheet {
    /// Nothing yet.
    pub const fn new(found: Option<Found>, first_index: u64) -> Self {
        let gaps = Vec::new();
        Self {
            found,
            first_index,
            frames: 0,
            gaps,
            times: [None; 2],
            closed: false,
            acknowledged: 0,
            claimed: false,
            detections: 0,
            first_detection: 0,
        }
    }

    /// Instants that still fit.
    pub fn room(&self) -> u32 {
        // Every file has as much.
        const LEAST: Extent = Extent { first: 0, pages: LEAST_PAGES };
        self.found.map_or(LEAST, |found| found.extent).frames().saturating_sub(self.frames)
    }

    /// How many instants from the beginning of a gap on are given up at least, so that the list lasts to the file's end.
    pub fn apart(&self) -> u64 {
        match GAPS.saturating_sub(self.gaps.len()) {
            left if left > 0 && self.gaps.len() >= SCARCE => u64::from(self.room()) / left as u64,
            _ => 0,
        }
    }

    /// Notes what is missing before the next instant; whether there was room for it.
    pub fn miss(&mut self, why: Why, count: u64) -> bool {
        let (at, scarce) = (self.frames, self.gaps.len() >= SCARCE);
        match self.gaps.last_mut() {
            Some(last) if last.at == at && (last.why == why || scarce) => {
                last.count = last.count.saturating_add(count);
                if last.why != why {
                    last.why = Why::Card;
                }
                true
            }
            _ => self.gaps.push(Gap { at, why, count }).is_ok(),
        }
    }

    /// Whether the file held older sound.
    pub fn is_again(&self) -> bool {
        self.found.is_some_and(|found| found.sequence > 0)
    }

    /// The indices from its first sample to its last.
    pub fn samples(&self) -> core::ops::Range<u64> {
        let missing = self.gaps.iter().fold(0u64, |sum, gap| sum.saturating_add(gap.count));
        self.first_index..self.first_index.saturating_add(u64::from(self.frames)).saturating_add(missing)
    }

    /// Something was heard about this sample, which may be one of the file before.
    pub fn heard(&mut self, index: u64) {
        if self.detections == 0 {
            self.first_detection = index;
        }
        self.detections = self.detections.saturating_add(1);
    }

    /// These samples are to be kept.
    pub fn claim(&mut self, claim: &core::ops::Range<u64>) {
        let samples = self.samples();
        // What is still filled reaches as far as the claim does.
        let to = if self.closed { samples.end } else { u64::MAX };
        self.claimed |= meet(claim, &(samples.start..to));
    }
}
