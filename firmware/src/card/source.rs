//! A source of samples whose sound goes to the card on its way.

use super::Drive;
use super::writer::{Event, Writer};
use seabearing_core::block::Frame;
use seabearing_core::port::{Chunk, SampleSource, Supervisor};
use seabearing_core::utc::Pair;
use seabearing_core::wire::{FaultCode, Time};

/// Longest wait at the end of a recording for what is not on the card yet.
const SETTLE_US: u64 = 2_000_000;

/// A source whose sound is recorded.
#[derive(Debug)]
pub struct Recorded<'a, S, D> {
    source: S,
    card: Writer<'a, D>,
    /// What is not recorded.
    unwanted: core::ops::Range<u64>,
}

impl<'a, S: SampleSource, D: Drive> Recorded<'a, S, D> {
    /// Records what this source gives.
    pub fn new(source: S, card: Writer<'a, D>) -> Self {
        Self { source, card, unwanted: 0..0 }
    }

    /// The source.
    pub fn source(&self) -> &S {
        &self.source
    }

    /// Ends the recording: what waits is written, for two seconds at most.
    pub fn settle(&mut self, supervisor: &mut impl Supervisor, mut now_us: impl FnMut() -> u64) {
        self.card.finish();
        let begun_us = now_us();
        while !self.card.rests() && now_us().saturating_sub(begun_us) < SETTLE_US {
            supervisor.feed();
            self.card.work();
        }
    }
}

impl<S: SampleSource, D: Drive> SampleSource for Recorded<'_, S, D> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        self.card.work();
        let chunk = self.source.read(frames);
        if let Chunk::Frames { first_index, count } = chunk {
            let left_out = match self.unwanted.contains(&first_index) {
                true => usize::try_from(self.unwanted.end - first_index).unwrap_or(count).min(count),
                false => 0,
            };
            if left_out < count {
                let wanted = frames.get(left_out..count).unwrap_or_default();
                self.card.take(first_index + left_out as u64, wanted);
            }
        }
        chunk
    }

    fn rest(&mut self, samples: core::ops::Range<u64>) {
        self.unwanted = samples;
    }

    fn waits(&self) -> bool {
        self.source.waits()
    }

    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        self.source.fault().or_else(|| {
            self.card.event().map(|event| match event {
                Event::Failed(trouble, missed) => (FaultCode::CardFailed, trouble as u64 | missed << 8),
                Event::Back(missed) => (FaultCode::CardBack, missed),
                Event::Full(recorded) => (FaultCode::CardFull, recorded),
            })
        })
    }

    fn told(&mut self, time: &Time) {
        self.source.told(time);
    }

    fn age_us(&mut self, index: u64) -> u64 {
        self.source.age_us(index)
    }

    fn pair(&mut self) -> Option<Pair> {
        let pair = self.source.pair();
        if let Some(pair) = pair {
            self.card.pair(pair);
        }
        pair
    }
}
