//! A source of samples whose sound goes to the card on its way.

use super::Drive;
use super::writer::{Event, Writer};
use core::ops::Range;
use seabearing_core::block::{CHANNELS, Frame};
use seabearing_core::port::{Chunk, SampleSource, Supervisor};
use seabearing_core::run::BLOCK_FRAMES;
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
    unwanted: Range<u64>,
    /// The newest samples: whether they are wanted is known once they were listened to.
    newest: [Frame; BLOCK_FRAMES],
    first_index: u64,
    count: usize,
}

impl<'a, S: SampleSource, D: Drive> Recorded<'a, S, D> {
    /// Records what this source gives.
    pub fn new(source: S, card: Writer<'a, D>) -> Self {
        let newest = [[0; CHANNELS]; BLOCK_FRAMES];
        Self { source, card, unwanted: 0..0, newest, first_index: 0, count: 0 }
    }

    /// The source.
    pub fn source(&self) -> &S {
        &self.source
    }

    /// Ends the recording: what waits is written, for two seconds at most.
    pub fn settle(&mut self, supervisor: &mut impl Supervisor, mut now_us: impl FnMut() -> u64) {
        self.pass_on();
        self.card.finish();
        let begun_us = now_us();
        while !self.card.rests() && now_us().saturating_sub(begun_us) < SETTLE_US {
            supervisor.feed();
            self.card.work();
        }
    }

    /// The card takes what is wanted of the newest samples.
    fn pass_on(&mut self) {
        let frames = self.newest.get(..core::mem::take(&mut self.count)).unwrap_or_default();
        let at = |index: u64| (index.saturating_sub(self.first_index) as usize).min(frames.len());
        let (before, after) = (at(self.unwanted.start), at(self.unwanted.end));
        self.card.take(self.first_index, frames.get(..before).unwrap_or_default());
        self.card.take(self.first_index + after as u64, frames.get(after..).unwrap_or_default());
    }
}

impl<S: SampleSource, D: Drive> SampleSource for Recorded<'_, S, D> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        self.pass_on();
        self.card.work();
        let most = frames.len().min(BLOCK_FRAMES);
        let chunk = self.source.read(frames.get_mut(..most).unwrap_or_default());
        if let Chunk::Frames { first_index, count } = chunk {
            self.newest.iter_mut().zip(frames.iter().take(count)).for_each(|(to, from)| *to = *from);
            (self.first_index, self.count) = (first_index, count);
        }
        chunk
    }

    fn rest(&mut self, samples: Range<u64>) {
        self.card.rest(samples.clone());
        self.unwanted = samples;
    }

    fn heard(&mut self, index: u64) {
        self.card.heard(index);
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
        self.card.told(time);
    }

    fn age_us(&mut self, index: u64) -> Option<u64> {
        self.source.age_us(index)
    }

    fn pair(&mut self) -> Option<Pair> {
        self.source.pair()
    }
}
