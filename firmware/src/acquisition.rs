//! From the converter's interrupt to the main loop: a queue of numbered frames, and the numbers of those missed.
//!
//! The interrupt side numbers frames by the time between them, so that a conversion that was not read leaves a jump of
//! the index (a gap the recorder counts) and never shifts what follows. A full queue does the same.

use heapless::spsc::{Consumer, Producer};
use seabearing_core::block::Frame;
use seabearing_core::port::{Chunk, SampleSource};

/// Frames the queue holds: 64 ms at 64 kHz, three times the recorder's longest block of work.
pub const QUEUE_FRAMES: usize = 4096;

/// A frame and the low half of its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Numbered {
    index: u32,
    frame: Frame,
}

/// Numbers frames by when they were ready, in ticks of a counter that wraps.
#[derive(Clone, Copy, Debug)]
pub struct Pacer {
    period_ticks: u32,
    last: Option<u32>,
    next: u32,
}

impl Pacer {
    /// `period_ticks`: from one conversion to the next.
    pub const fn new(period_ticks: u32) -> Self {
        Self { period_ticks, last: None, next: 0 }
    }

    /// The index of the frame that was ready at `ticks`. More than one and a half periods since the frame before mean
    /// that conversions were missed.
    pub fn index(&mut self, ticks: u32) -> u32 {
        let since = self.last.map_or(self.period_ticks, |last| ticks.wrapping_sub(last));
        let missed =
            (since.saturating_add(self.period_ticks / 2) / self.period_ticks.max(1)).saturating_sub(1);
        let index = self.next.wrapping_add(missed);
        self.last = Some(ticks);
        self.next = index.wrapping_add(1);
        index
    }
}

/// The interrupt's end.
pub struct Inlet<'a> {
    queue: Producer<'a, Numbered>,
    pacer: Pacer,
}

impl<'a> Inlet<'a> {
    /// An end that numbers by this pacer.
    pub fn new(queue: Producer<'a, Numbered>, pacer: Pacer) -> Self {
        Self { queue, pacer }
    }

    /// Takes the frame that was ready at `ticks`; a full queue loses it, and its number with it.
    pub fn push(&mut self, ticks: u32, frame: Frame) {
        let index = self.pacer.index(ticks);
        let _lost_if_full = self.queue.enqueue(Numbered { index, frame });
    }
}

/// The main loop's end.
pub struct Outlet<'a> {
    queue: Consumer<'a, Numbered>,
    next: u64,
}

impl<'a> Outlet<'a> {
    /// An end that begins at index 0.
    pub fn new(queue: Consumer<'a, Numbered>) -> Self {
        Self { queue, next: 0 }
    }

    /// The whole index whose low half is given: the first such at or after the next expected.
    fn whole(&self, low: u32) -> u64 {
        self.next.wrapping_add(u64::from(low.wrapping_sub(self.next as u32)))
    }
}

impl SampleSource for Outlet<'_> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let Some(first) = self.queue.peek().map(|n| n.index) else { return Chunk::Idle };
        let first_index = self.whole(first);
        let mut count = 0usize;
        for slot in frames.iter_mut() {
            let expected = first.wrapping_add(count as u32);
            match self.queue.peek() {
                Some(numbered) if numbered.index == expected => *slot = numbered.frame,
                _ => break,
            }
            self.queue.dequeue();
            count += 1;
        }
        self.next = first_index.wrapping_add(count as u64);
        Chunk::Frames { first_index, count }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heapless::spsc::Queue;

    #[test]
    fn missed_conversions_and_a_full_queue_leave_gaps_and_shift_nothing() {
        let mut queue: Queue<Numbered, 8> = Queue::new();
        let (producer, consumer) = queue.split();
        let mut inlet = Inlet::new(producer, Pacer::new(100));
        let mut outlet = Outlet::new(consumer);
        let mut frames = [[0; 4]; 16];
        // Conversions 0, 1, 2, then 3 and 4 missed, then 5 with jitter.
        for (ticks, code) in [(1000u32, 0), (1100, 1), (1195, 2), (1512, 5)] {
            inlet.push(ticks, [code; 4]);
        }
        assert_eq!(outlet.read(&mut frames), Chunk::Frames { first_index: 0, count: 3 });
        assert_eq!(frames[2], [2; 4]);
        assert_eq!(outlet.read(&mut frames), Chunk::Frames { first_index: 5, count: 1 });
        assert_eq!(frames[0], [5; 4]);
        assert_eq!(outlet.read(&mut frames), Chunk::Idle);
        // The queue holds seven: of 6 to 15, those from 13 on are lost, then 16 comes through.
        for i in 6..16 {
            inlet.push(1012 + i * 100, [i as i32; 4]);
        }
        assert_eq!(outlet.read(&mut frames), Chunk::Frames { first_index: 6, count: 7 });
        inlet.push(1012 + 16 * 100, [16; 4]);
        assert_eq!(outlet.read(&mut frames), Chunk::Frames { first_index: 16, count: 1 });
    }

    #[test]
    fn the_index_outlives_its_low_half() {
        let mut queue: Queue<Numbered, 4> = Queue::new();
        let (producer, consumer) = queue.split();
        let pacer = Pacer { next: u32::MAX, ..Pacer::new(10) };
        let mut inlet = Inlet::new(producer, pacer);
        let mut outlet = Outlet { queue: consumer, next: u64::from(u32::MAX) };
        let mut frames = [[0; 4]; 4];
        inlet.push(0, [1; 4]);
        inlet.push(10, [2; 4]);
        let first_index = u64::from(u32::MAX);
        assert_eq!(outlet.read(&mut frames), Chunk::Frames { first_index, count: 2 });
        assert_eq!(outlet.next, 1 << 32 | 1);
    }
}
