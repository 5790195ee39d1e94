//! A pulse each second and the sentence that says which second it was: samples with their UTC.
//!
//! A pulse says when a second began, to a fraction of a microsecond, and its sentence, which follows it by some tenths of a
//! second, says which. Neither is believed alone: a pulse counts if it came one second after another, a sentence if it
//! agrees with the one before it. A glitch, a lost pulse or a wrong second so costs a few seconds without a pair, and a
//! receiver that steps is followed. [`seabearing_core::utc`] judges what comes of it once more.

use crate::acquisition::{Acquisition, Board};
use crate::battery::{BatteryClock, Counter, NoCounter};
use crate::nmea::Sentences;
use seabearing_core::block::Frame;
use seabearing_core::math::f64::sqrt;
use seabearing_core::port::{Chunk, SampleSource};
use seabearing_core::utc::{Pair, Times};
use seabearing_core::wire::{FaultCode, Time};

/// Two pulses are a second apart within this: the board's clock may be 1 % wrong.
const SECOND_WITHIN_US: u64 = 20_000;
/// The sentence has ended so soon after its pulse.
const SENTENCE_US: u64 = 950_000;
/// Longest time over which the board's clock tells how many seconds have passed.
const BRIDGED_US: u64 = 30_000_000;
/// Standard deviation of a pair, s: the core sees an edge some tenths of a microsecond late, and so is the pulse itself.
const PAIR_SD_S: f64 = 2e-6;
/// Bytes of sentences taken at a time: more than come between two looks, less than would keep samples waiting.
const MOST_BYTES: usize = 64;

/// A pulse and an edge of the converter's near it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulse {
    /// Number of the edge.
    pub edge: u64,
    /// How long after the pulse it was by the board's clock, ns; negative where it was before.
    pub late_ns: i32,
    /// The pulse by the board's clock, µs.
    pub at_us: u64,
}

/// Pulses and the bytes of sentences, as a board hears them.
pub trait Reception {
    /// The newest pulse, once.
    fn pulse(&mut self) -> Option<Pulse>;

    /// The next byte, if there is one.
    fn byte(&mut self) -> Option<u8>;

    /// Microseconds of the board's clock.
    fn now_us(&mut self) -> u64;
}

/// What pulses and sentences say together.
#[derive(Clone, Debug, Default)]
pub struct Labels {
    sentences: Sentences,
    /// The newest pulse, until it has its second.
    pulse: Option<Pulse>,
    /// When that was, and, where it was a second after the one before, how long the board's clock had that second.
    newest_us: Option<u64>,
    second_us: Option<u64>,
    /// The newest pulse that had a second, and that.
    before: Option<(u64, i64)>,
}

impl Labels {
    /// A pulse has come.
    pub fn pulse(&mut self, pulse: Pulse) {
        let since = self.newest_us.map(|newest| pulse.at_us.saturating_sub(newest));
        self.second_us = since.filter(|us| us.abs_diff(1_000_000) <= SECOND_WITHIN_US);
        self.newest_us = Some(pulse.at_us);
        self.pulse = Some(pulse);
    }

    /// Takes a byte; an edge's number and its UTC in µs where that is known now.
    pub fn byte(&mut self, byte: u8, now_us: u64) -> Option<(u64, i64)> {
        let second = self.sentences.push(byte)?;
        // The first sentence after a pulse is its own.
        let pulse = self.pulse.take()?;
        let second_us = self.second_us.filter(|_| now_us.saturating_sub(pulse.at_us) <= SENTENCE_US)?;
        let before = self.before.replace((pulse.at_us, second));
        let agrees = before.is_some_and(|(at_us, earlier)| {
            let passed_us = pulse.at_us.saturating_sub(at_us);
            let passed = (passed_us + 500_000) / 1_000_000;
            passed_us <= BRIDGED_US && i64::try_from(passed) == Ok(second - earlier)
        });
        // In true time, as the pulse before has shown it.
        let late_ns = (i64::from(pulse.late_ns) * 1_000_000).checked_div(second_us as i64)?;
        let utc_us = second * 1_000_000 + (late_ns + 500).div_euclid(1000);
        agrees.then_some((pulse.edge, utc_us))
    }
}

/// From one look at the clock on its cell to the next, µs.
const CELL_EVERY_US: u64 = 1_000_000;

/// The converter's samples with their UTC: from the receiver, and where that says nothing from the clock on its cell.
#[derive(Debug)]
pub struct Timed<B, R, C = NoCounter> {
    acquisition: Acquisition<B>,
    reception: R,
    labels: Labels,
    turn: u8,
    cell: BatteryClock<C>,
    /// What the recorder knows of UTC, and when the cell's clock is looked at next.
    known: Times,
    next_us: u64,
}

impl<B: Board, R: Reception> Timed<B, R> {
    /// Nothing heard yet.
    pub fn new(acquisition: Acquisition<B>, reception: R) -> Self {
        Self::with_cell(acquisition, reception, BatteryClock::new(NoCounter))
    }
}

impl<B: Board, R: Reception, C: Counter> Timed<B, R, C> {
    /// Nothing heard yet, and a clock that went on meanwhile.
    pub fn with_cell(acquisition: Acquisition<B>, reception: R, cell: BatteryClock<C>) -> Self {
        let (labels, known) = (Labels::default(), Times::default());
        Self { acquisition, reception, labels, turn: 0, cell, known, next_us: 0 }
    }

    /// The newest sample's index, and what the recorder knows of its UTC.
    fn now(&mut self) -> Option<(u64, Option<(i64, f64)>)> {
        let edge = self.acquisition.board_mut().edges().checked_sub(1)?;
        let index = self.acquisition.index_of(edge)?;
        Some((index, self.known.utc(index, self.acquisition.rate_hz())))
    }

    /// Where the clock on its cell knows UTC better: a pair of it.
    fn of_cell(&mut self) -> Option<Pair> {
        let now_us = self.reception.now_us();
        if now_us < self.next_us {
            return None;
        }
        let (index, known) = self.now()?;
        self.next_us = now_us.saturating_add(CELL_EVERY_US);
        let (utc_us, sd_s) = self.cell.tell(known.map(|(_, sd_s)| sd_s))?;
        // The sample was up to a period ago.
        let period_s = 1.0 / self.acquisition.rate_hz();
        Some(Pair { index, utc_us, sd_s: sqrt(sd_s * sd_s + period_s * period_s) })
    }
}

impl<B: Board, R: Reception, C: Counter> SampleSource for Timed<B, R, C> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        self.acquisition.read(frames)
    }

    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        self.acquisition.fault()
    }

    fn age_us(&mut self, index: u64) -> Option<u64> {
        self.acquisition.age_us(index)
    }

    fn pair(&mut self) -> Option<Pair> {
        self.turn = self.turn.wrapping_add(1);
        if !self.turn.is_multiple_of(B::LOOK_EVERY) {
            return None;
        }
        // Sentences heard so far belong to the pulse before.
        if let Some(pulse) = self.reception.pulse() {
            self.labels.pulse(pulse);
        }
        for _ in 0..MOST_BYTES {
            let Some(byte) = self.reception.byte() else { break };
            let now_us = self.reception.now_us();
            if let Some((edge, utc_us)) = self.labels.byte(byte, now_us)
                && let Some(index) = self.acquisition.index_of(edge)
            {
                return Some(Pair { index, utc_us, sd_s: PAIR_SD_S });
            }
        }
        self.of_cell()
    }

    fn told(&mut self, time: &Time) {
        self.known.note(*time, false, self.acquisition.rate_hz());
        if let Some((_, Some((utc_us, sd_s)))) = self.now() {
            let period_s = 1.0 / self.acquisition.rate_hz();
            self.cell.learn(utc_us, sqrt(sd_s * sd_s + period_s * period_s));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;
    use std::vec::Vec;

    /// 2026-09-21 14:13:20 and as many seconds.
    fn sentence(seconds: i64) -> Vec<u8> {
        let (minute, second) = (13 + (20 + seconds) / 60, (20 + seconds) % 60);
        let body = format!("GPRMC,14{minute:02}{second:02}.00,A,,,,,,,210926,,,A");
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        format!("${body}*{sum:02X}\r\n").into_bytes()
    }

    const START_US: i64 = 1_790_000_000_000_000;

    /// The pulse of a second at 64 kHz, and 200 ms later what is said.
    fn second(labels: &mut Labels, k: i64, said: &[u8]) -> Option<(u64, i64)> {
        pulse(labels, 1_000_000 * k as u64 + 123);
        say(labels, k, said)
    }

    fn pulse(labels: &mut Labels, at_us: u64) {
        labels.pulse(Pulse { edge: at_us * 64 / 1000, late_ns: 7000, at_us });
    }

    fn say(labels: &mut Labels, k: i64, said: &[u8]) -> Option<(u64, i64)> {
        said.iter().filter_map(|byte| labels.byte(*byte, 1_000_000 * k as u64 + 200_123)).last()
    }

    fn expected(k: i64) -> Option<(u64, i64)> {
        Some((64_000 * k as u64 + 7, START_US + 1_000_000 * k + 7))
    }

    #[test]
    fn from_the_third_pulse_on_each_has_its_second() {
        let mut labels = Labels::default();
        let told: Vec<_> = (0..5).map(|k| second(&mut labels, k, &sentence(k))).collect();
        assert_eq!(told, [None, None, expected(2), expected(3), expected(4)]);
    }

    #[test]
    fn an_edge_before_or_after_its_pulse_is_placed_in_true_time() {
        // The board's clock has 990 000 microseconds in a second; the edges are 4 ms off by it.
        for (late_ns, true_us) in [(-3_960_000, -4000), (3_960_000, 4000), (-400, 0), (-1600, -2)] {
            let mut labels = Labels::default();
            let at = |k: u64| Pulse { edge: 250 * k, late_ns, at_us: 990_000 * k };
            let told = (0..3).map(|k| {
                labels.pulse(at(k));
                let said = sentence(k as i64);
                said.iter().filter_map(|b| labels.byte(*b, 990_000 * k + 200_000)).last()
            });
            assert_eq!(told.last().unwrap(), Some((500, START_US + 2_000_000 + true_us)), "{late_ns}");
        }
    }

    #[test]
    fn a_wrong_second_is_none_and_a_lasting_step_is_followed() {
        let mut labels = Labels::default();
        (0..3).for_each(|k| _ = second(&mut labels, k, &sentence(k)));
        assert_eq!(second(&mut labels, 3, &sentence(4)), None);
        assert_eq!(second(&mut labels, 4, &sentence(4)), None);
        assert_eq!(second(&mut labels, 5, &sentence(5)), expected(5));
        assert_eq!(second(&mut labels, 6, &sentence(16)), None);
        let stepped = second(&mut labels, 7, &sentence(17)).unwrap();
        assert_eq!(stepped.1 - expected(7).unwrap().1, 10_000_000);
    }

    #[test]
    fn lost_pulses_and_sentences_and_glitches_cost_only_pairs() {
        let mut labels = Labels::default();
        (0..3).for_each(|k| _ = second(&mut labels, k, &sentence(k)));
        // No sentence; a sentence without its pulse; damaged ones.
        assert_eq!(second(&mut labels, 3, b""), None);
        assert_eq!(say(&mut labels, 4, &sentence(4)), None);
        assert_eq!(second(&mut labels, 5, &sentence(5)), None);
        assert_eq!(second(&mut labels, 6, &sentence(6)), expected(6));
        assert_eq!(second(&mut labels, 7, b"$GPRMC,1413"), None);
        assert_eq!(second(&mut labels, 8, &sentence(8)), expected(8));
        // A pulse that is none, before the true one's sentence.
        pulse(&mut labels, 9_000_123);
        pulse(&mut labels, 9_100_000);
        assert_eq!(say(&mut labels, 9, &sentence(9)), None);
        assert_eq!(second(&mut labels, 10, &sentence(10)), None);
        assert_eq!(second(&mut labels, 11, &sentence(11)), expected(11));
        // RMC and ZDA of one second: one pair.
        let twice = [sentence(12), sentence(12)].concat();
        assert_eq!(second(&mut labels, 12, &twice), expected(12));
        // A minute without pulses: the board's clock no longer says how many seconds passed.
        assert_eq!(second(&mut labels, 80, &sentence(80)), None);
        assert_eq!(second(&mut labels, 81, &sentence(81)), None);
        assert_eq!(second(&mut labels, 82, &sentence(82)), expected(82));
    }
}
