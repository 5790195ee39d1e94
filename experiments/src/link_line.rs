//! A line that fails in every way: frames dropped, damaged, doubled, overtaken, and times in which nothing passes.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// How a line fails.
#[derive(Clone, Copy, Debug, Default)]
pub struct Faults {
    /// Share of frames dropped.
    pub dropped: f64,
    /// Share of bytes with one bit wrong.
    pub damaged: f64,
    /// Share of frames that come twice.
    pub doubled: f64,
    /// Share of frames that are held up by as much as a second, so that others overtake them.
    pub held: f64,
}

/// One direction of a line.
pub struct Line {
    faults: Faults,
    bytes_per_second: f64,
    delay_us: u64,
    rng: ChaCha8Rng,
    /// Frames on their way, by the time of arrival and a number.
    flying: BTreeMap<(u64, u64), Vec<u8>>,
    frames: u64,
    /// Bytes put on the line.
    pub bytes: u64,
}

impl Line {
    /// A line of so many bytes a second with a delay besides.
    pub fn new(faults: Faults, bytes_per_second: f64, delay_us: u64, seed: u64) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed);
        Self { faults, bytes_per_second, delay_us, rng, flying: BTreeMap::new(), frames: 0, bytes: 0 }
    }

    /// Takes a frame; nothing passes while the line is `cut`.
    pub fn put(&mut self, now: u64, frame: &[u8], cut: bool) {
        self.bytes += frame.len() as u64;
        // Both are drawn whatever happens, so that a seed means the same faults.
        let dropped = self.rng.random_bool(self.faults.dropped);
        let copies = 1 + u64::from(self.rng.random_bool(self.faults.doubled));
        if dropped || cut {
            return;
        }
        for copy in 0..copies {
            let mut bytes = frame.to_vec();
            for byte in &mut bytes {
                if self.rng.random_bool(self.faults.damaged) {
                    *byte ^= 1 << self.rng.random_range(0..8);
                }
            }
            let held = copy > 0 || self.rng.random_bool(self.faults.held);
            let late = if held { self.rng.random_range(0..1_000_000) } else { 0 };
            let sent = (frame.len() as f64 / self.bytes_per_second * 1e6) as u64;
            self.frames += 1;
            self.flying.insert((now + sent + self.delay_us + late, self.frames), bytes);
        }
    }

    /// The next frame that has come by now.
    pub fn take(&mut self, now: u64) -> Option<Vec<u8>> {
        let first = self.flying.first_entry()?;
        (first.key().0 <= now).then(|| first.remove())
    }

    /// What is on its way is gone.
    pub fn cut(&mut self) {
        self.flying.clear();
    }
}
