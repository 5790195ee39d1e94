//! Recorders that listen by a schedule: pauses are told as such, nothing is shifted, and health goes on.

use super::Memory;
use super::test_recorder::{Which, noise};
use crate::block::Frame;
use crate::config::Schedule;
use crate::port::{Chunk, Link, NoBoard, NoClock, SampleSource};
use crate::run::{Application, BLOCK_FRAMES, run};
use crate::wire::{Decoder, End, FaultCode, Health, Message};
use std::boxed::Box;
use std::vec::Vec;

const SCHEDULE: Schedule = Schedule { every_s: 120, on_s: 30 };
/// Two periods and the beginning of a third.
const SECONDS: u64 = 250;

/// Noise in blocks of this length.
struct Blocks {
    frames: Vec<Frame>,
    next: usize,
    length: usize,
}

impl SampleSource for Blocks {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let rest = &self.frames[self.next..];
        let count = rest.len().min(self.length).min(frames.len());
        if count == 0 {
            return Chunk::End;
        }
        frames[..count].copy_from_slice(&rest[..count]);
        self.next += count;
        Chunk::Frames { first_index: (self.next - count) as u64, count }
    }
}

#[derive(Default)]
struct Line(Vec<u8>);

impl Link for Line {
    fn send(&mut self, frame: &[u8]) -> bool {
        self.0.extend_from_slice(frame);
        true
    }
    fn receive(&mut self) -> Option<u8> {
        None
    }
}

fn said(which: Which, length: usize) -> Vec<Message> {
    let mut memory = Box::<Memory<'_>>::default();
    let (mut config, table) = which.config();
    config.schedule = SCHEDULE;
    let mut recorder = memory.configure(&config, table).unwrap();
    let mut source = Blocks { frames: noise((SECONDS * which.rate()) as usize), next: 0, length };
    let (mut line, mut frames) = (Line::default(), [[0; 4]; BLOCK_FRAMES]);
    run(&mut recorder, &mut source, &mut line, &mut NoClock, &mut NoBoard, &mut frames);
    let mut decoder = Decoder::default();
    line.0.iter().filter_map(|byte| decoder.push(*byte).map(|said| said.message)).collect()
}

#[test]
fn pauses_are_told_as_such_and_what_is_heard_keeps_its_numbers() {
    for which in [Which::Array, Which::Bottom] {
        let all = said(which, BLOCK_FRAMES);
        let rate = which.rate();
        let faults: Vec<_> = all
            .iter()
            .filter_map(|m| match m {
                Message::Fault(f) => Some((f.code, f.index, f.value)),
                _ => None,
            })
            .collect();
        let pause = |second: u64| (FaultCode::Paused, second * rate, 90 * rate as i64);
        assert_eq!(faults, [pause(30), pause(150)], "{which:?}");
        let health: Vec<Health> =
            all.iter().filter_map(|m| if let Message::Health(h) = m { Some(*h) } else { None }).collect();
        // A minute into each pause, and at least once more at the end.
        assert!(health.iter().filter(|h| h.index == 30 * rate).count() >= 1, "{which:?}: {health:?}");
        let last = health.last().unwrap();
        assert_eq!(last.index, SECONDS * rate);
        assert_eq!(last.lost[0], 180 * rate, "{which:?}");
        assert_eq!(last.processed + last.lost.iter().sum::<u64>(), last.index, "{which:?}");
        assert!(matches!(all.last(), Some(Message::End(End { index, .. })) if *index == SECONDS * rate));
    }
}

#[test]
fn how_samples_are_cut_into_blocks_changes_nothing() {
    let whole = said(Which::Bottom, BLOCK_FRAMES);
    for length in [1, 7, 61] {
        assert_eq!(said(Which::Bottom, length), whole, "{length}");
    }
}

#[test]
fn a_converter_that_dies_within_a_pause_is_told() {
    let mut memory = Box::<Memory<'_>>::default();
    let mut recorder = Which::Bottom.configure(&mut memory);
    let mut told = Vec::new();
    let mut sink = |m: &Message| {
        if let Message::Fault(f) = m {
            told.push((f.code, f.value));
        }
    };
    recorder.pause(5000, &mut sink);
    (1..=20).for_each(|second| recorder.paused(second, &mut sink));
    (1..=20).for_each(|second| recorder.silent(second, &mut sink));
    assert_eq!(told, [(FaultCode::Paused, 5000), (FaultCode::NoSamples, 10)]);
}
