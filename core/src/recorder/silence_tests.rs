//! Sources that fall silent, or nearly: what was open ends by the board's clock, and `Health` goes on.

use super::Memory;
use super::test_recorder::{ARRAY_RATE, Which, noise, source};
use crate::block::{Block, Frame};
use crate::obs::station_tests as bottom;
use crate::port::{Chunk, Clock, Link, SampleSource};
use crate::run::tests::Idle;
use crate::run::{Application, BLOCK_FRAMES, run};
use crate::wire::{Decoder, FaultCode, Message};
use std::boxed::Box;
use std::vec::Vec;

/// Seconds of silence at which each message that fits was said.
fn said(all: &[(u32, Message)], fits: impl Fn(&Message) -> bool) -> Vec<u32> {
    all.iter().filter(|m| fits(&m.1)).map(|m| m.0).collect()
}

fn is_last(m: &Message) -> bool {
    matches!(m, Message::Track(t) if t.stage == 1)
}

#[test]
fn a_source_that_dies_leaves_nothing_open() {
    let mut memory = Box::<Memory<'_>>::default();
    let bottom = bottom::record(3600 * 50, 50.0, 200.0, 1500.0);
    for (which, frames) in [(Which::Array, source(60)), (Which::Bottom, bottom)] {
        let mut recorder = which.configure(&mut memory);
        let mut before = Vec::new();
        recorder.push(Block { first_index: 0, frames: &frames }, &mut |m| before.push((0, *m)));
        let mut silent = Vec::new();
        for second in 1..=2 * 3600 {
            recorder.silent(second, &mut |m| silent.push((second, *m)));
        }
        let mut after = Vec::new();
        recorder.finish(&mut |m| after.push((0, *m)));
        let ended = match which {
            Which::Array => said(&silent, is_last),
            Which::Bottom => said(&silent, |m| matches!(m, Message::Segment(_))),
        };
        let by = if which == Which::Array { 60 } else { 1800 };
        assert!(!ended.is_empty() && ended.iter().all(|s| *s <= by), "{which:?}: {ended:?}");
        let left = said(&after, |m| !matches!(m, Message::Health(_)));
        assert!(left.is_empty(), "{which:?}: {after:?}");
    }
}

#[test]
fn what_a_restart_ends_is_sent_though_no_samples_follow() {
    let mut memory = Box::<Memory<'_>>::default();
    let mut recorder = Which::Array.configure(&mut memory);
    let frames = source(60);
    recorder.push(Block { first_index: 1_000_000_000, frames: &frames }, &mut |_| {});
    let mut all = Vec::new();
    recorder.push(Block { first_index: 0, frames: &frames[..320] }, &mut |m| all.push((0, *m)));
    for second in 1..=60 {
        recorder.silent(second, &mut |m| all.push((second, *m)));
    }
    assert_eq!(said(&all, is_last).len(), 1, "{all:?}");
}

/// A little every few seconds of a clock that goes on by a quarter at each look.
struct Stutter<'a> {
    now: &'a core::cell::Cell<u32>,
    frames: Vec<Frame>,
    every_s: u32,
    /// Whether the index goes on with time, or by what came.
    honest: bool,
    came: u32,
}

impl SampleSource for Stutter<'_> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let second = self.now.get() / 4;
        if second >= 7200 {
            return Chunk::End;
        }
        if second / self.every_s < self.came {
            return Chunk::Idle;
        }
        let count = self.frames.len();
        let index = if self.honest { self.every_s * ARRAY_RATE as u32 } else { count as u32 };
        let first_index = u64::from(self.came) * u64::from(index);
        self.came += 1;
        frames.iter_mut().zip(&self.frames).for_each(|(to, from)| *to = *from);
        Chunk::Frames { first_index, count }
    }
}

struct Quarters<'a>(&'a core::cell::Cell<u32>);

impl Clock for Quarters<'_> {
    fn ticks(&mut self) -> u32 {
        0
    }

    fn seconds(&mut self) -> u32 {
        self.0.set(self.0.get() + 1);
        self.0.get() / 4
    }
}

/// What was said, each with the quarter second at which.
struct Line<'a> {
    now: &'a core::cell::Cell<u32>,
    decoder: Decoder,
    heard: Vec<(u32, Message)>,
}

impl Link for Line<'_> {
    fn send(&mut self, frame: &[u8]) -> bool {
        for byte in frame {
            if let Some(received) = self.decoder.push(*byte) {
                self.heard.push((self.now.get() / 4, received.message));
            }
        }
        true
    }

    fn receive(&mut self) -> Option<u8> {
        None
    }
}

#[test]
fn a_source_that_stutters_is_told_of_and_health_goes_on() {
    for (count, honest) in [(1, true), (64, true), (64, false)] {
        let now = core::cell::Cell::new(0);
        let mut memory = Box::<Memory<'_>>::default();
        let mut recorder = Which::Array.configure(&mut memory);
        let mut source = Stutter { now: &now, frames: noise(count), every_s: 9, honest, came: 0 };
        let mut line = Line { now: &now, decoder: Decoder::default(), heard: Vec::new() };
        let mut room = [[0; 4]; BLOCK_FRAMES];
        run(&mut recorder, &mut source, &mut line, &mut Quarters(&now), &mut Idle, &mut room);
        let health = said(&line.heard, |m| matches!(m, Message::Health(_)));
        let longest = health.windows(2).map(|w| w[1] - w[0]).max().unwrap();
        assert!(longest <= 130 && health.len() > 90, "{count} {honest}: {health:?}");
        let silent = said(&line.heard, |m| matches!(m, Message::Fault(f) if f.code == FaultCode::NoSamples));
        assert!(silent[0] <= 20, "{count} {honest}: {silent:?}");
    }
}
