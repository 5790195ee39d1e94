//! What must not change while a recorder runs: its settings and its calibration, as they were worked out of the configuration.
//!
//! A check sum is taken when the recorder was configured, and compared every few seconds, a little a turn of the loop. The processor's memories
//! correct one wrong bit in a word; what gets through, or was written by mistake, would make wrong records that look right. So it is told,
//! and the recorder starts again with the configuration that stands in flash.

use super::clock;
use crate::fault::{self, Record};
use core::ops::Range;
use core::sync::atomic::{AtomicU32, Ordering};
use crc::{Crc, Digest, Table};
use seabearing_core::config_blob::CRC;

/// Bytes that are looked at in a turn of the loop.
const SLICE: usize = 256;
/// From the end of one comparison to the beginning of the next.
const EVERY_US: u64 = 2_000_000;

/// Where it stands and how long it is: for who looks from outside, the model's rehearsal or a probe.
#[used]
static SETTLED_PLACE: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

/// Bytes that stay as they are.
pub struct Settled {
    bytes: Range<*const u8>,
    sum: u32,
    /// The next to be looked at, and the sum of those before.
    next: *const u8,
    digest: Digest<'static, u32, Table<1>>,
    due_us: u64,
}

fn begin() -> Digest<'static, u32, Table<1>> {
    let crc: &'static Crc<u32, Table<1>> = &CRC;
    crc.digest()
}

/// Adds up to so many bytes from `next` on; the first after them.
fn add(
    digest: &mut Digest<'static, u32, Table<1>>,
    next: *const u8,
    end: *const u8,
    most: usize,
) -> *const u8 {
    let count = (end as usize).saturating_sub(next as usize).min(most);
    // SAFETY: the range is of one object, which lives for ever; whoever changes it meanwhile is what is looked for, so it is read anew.
    let byte = |n: usize| unsafe { next.wrapping_add(n).read_volatile() };
    (0..count).for_each(|n| digest.update(&[byte(n)]));
    next.wrapping_add(count)
}

impl Settled {
    /// These bytes, of an object that lives for ever, are not to change from now on.
    pub fn new(bytes: Range<*const u8>) -> Self {
        let mut digest = begin();
        add(&mut digest, bytes.start, bytes.end, usize::MAX);
        let length = (bytes.end as usize).saturating_sub(bytes.start as usize);
        for (place, value) in SETTLED_PLACE.iter().zip([bytes.start as usize, length]) {
            place.store(value as u32, Ordering::Relaxed);
        }
        let next = bytes.start;
        Self { bytes, sum: digest.finalize(), next, digest: begin(), due_us: 0 }
    }

    /// Goes on looking; starts again where they have changed.
    pub fn look(&mut self) {
        if self.next == self.bytes.start && clock::now_us() < self.due_us {
            return;
        }
        self.next = add(&mut self.digest, self.next, self.bytes.end, SLICE);
        if self.next >= self.bytes.end {
            let sum = core::mem::replace(&mut self.digest, begin()).finalize();
            if sum != self.sum {
                fault::keep_and_reset(Record::settings());
            }
            (self.next, self.due_us) = (self.bytes.start, clock::now_us() + EVERY_US);
        }
    }
}
