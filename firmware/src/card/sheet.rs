//! What the recorder knows of a file it fills.

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
    /// First time told in it, and the latest.
    pub times: [Option<Pair>; 2],
    /// Nothing more is put in.
    pub closed: bool,
    /// Instants on the card.
    pub acknowledged: u32,
}

impl Sheet {
    /// Nothing yet.
    pub const fn new(found: Option<Found>, first_index: u64) -> Self {
        let gaps = Vec::new();
        Self { found, first_index, frames: 0, gaps, times: [None; 2], closed: false, acknowledged: 0 }
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

    /// A sample's time.
    pub fn tell(&mut self, pair: Pair) {
        let [first, latest] = &mut self.times;
        first.get_or_insert(pair);
        *latest = Some(pair);
    }
}
