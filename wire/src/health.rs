//! Accounting: every sample is processed, or counted in exactly one loss bucket.

use serde::{Deserialize, Serialize};

/// Why samples were not used. The discriminant is the bucket's place in [`Accounting::lost`] and on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum LossCause {
    /// The index jumped forward: these samples never arrived.
    Gap = 0,
    /// The index went back or repeated: these samples arrived twice.
    Overlap = 1,
    /// Without a code on a needed channel, bridged or not, or in a frame with too many of those.
    Invalid = 2,
    /// In a frame where a channel was at the converter's limit too often to be used.
    Clipped = 3,
    /// In a frame where a channel was dead or stuck.
    DeadChannel = 4,
    /// Left over when a run of samples ended before it filled a transform frame.
    Remainder = 5,
}

/// Number of loss buckets.
pub const LOSS_CAUSES: usize = 6;

/// Running totals since the recorder started, in sample instants (one instant = all four channels).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Accounting {
    /// Instants used by the estimators (each counted once however many overlapping frames hold it).
    pub processed: u64,
    /// Instants lost, by [`LossCause`].
    pub lost: [u64; LOSS_CAUSES],
}

impl Accounting {
    /// Adds `n` instants to one loss bucket.
    pub fn lose(&mut self, cause: LossCause, n: u64) {
        if let Some(bucket) = self.lost.get_mut(cause as usize) {
            *bucket = bucket.saturating_add(n);
        }
    }

    /// Instants accounted for: what arrived plus what should have.
    pub fn total(&self) -> u64 {
        self.lost.iter().fold(self.processed, |sum, n| sum.saturating_add(*n))
    }
}
