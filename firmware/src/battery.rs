//! A clock that runs on a cell of its own, and so outlasts resets and losses of supply: UTC is known again at a start.
//!
//! The clock only counts: what its count means stands beside it, in words that outlast a reset too, as a line of UTC over the count with
//! the uncertainty of time and rate ([`seabearing_core::utc`]), learnt whenever UTC is known better than the line tells it. Nothing
//! ever sets the clock, so a power cut at any moment leaves a line that is right.

use seabearing_core::math::f64::sqrt;
use seabearing_core::utc::{Noted, Pair, Times, UtcClock};
use seabearing_core::wire::Time;

/// Counts a second.
pub const RATE_HZ: f64 = 32_768.0;
/// Words of a line: sequence, count, UTC, deviation, drift and its deviation, correlation, check.
const WORDS: usize = 10;
/// Two lines, so that one is whole while the other is written.
pub const KEPT_WORDS: usize = 2 * WORDS;
/// Deviation of the clock's rate that its temperature adds to what was learnt: a tuning-fork crystal has its turning point near
/// 25 °C and is 15 parts in a million slower at 4 °C (−0.035 ppm a square degree).
const TEMPERATURE: f64 = 1.5e-5;
/// Deviation of one reading of the count, s: a period.
const READING_SD_S: f64 = 1.0 / RATE_HZ;
/// UTC that is known so much better than the line tells it is learnt.
const BETTER: f64 = 0.5;
/// UTC further from what the line tells than so many standard deviations contradicts it.
const CONTRADICTS: f64 = 6.0;
/// What is told of the clock is told with so much more: it is one error that lasts, not a new one each time.
const LASTS: f64 = 1.5;

/// The count, and words beside it.
pub trait Counter {
    /// How far it has counted; `None` while it does not run.
    fn count(&mut self) -> Option<u64>;

    /// A word kept, of [`KEPT_WORDS`].
    fn word(&mut self, n: usize) -> u32;

    /// Keeps a word.
    fn keep(&mut self, n: usize, word: u32);
}

/// A board without such a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoCounter;

impl Counter for NoCounter {
    fn count(&mut self) -> Option<u64> {
        None
    }

    fn word(&mut self, _: usize) -> u32 {
        0
    }

    fn keep(&mut self, _: usize, _: u32) {}
}

/// A line as words, and back: the line and its sequence, of words that a line was written in whole.
fn words_of(line: &Time, sequence: u32) -> [u32; WORDS] {
    let (index, utc) = (line.index, line.utc_us as u64);
    let mut words = [
        sequence,
        index as u32,
        (index >> 32) as u32,
        utc as u32,
        (utc >> 32) as u32,
        line.sd_s.to_bits(),
        line.drift.to_bits(),
        line.sd_drift.to_bits(),
        line.correlation.to_bits(),
        0,
    ];
    words[WORDS - 1] = check(&words);
    words
}

fn line_of(words: &[u32; WORDS]) -> Option<(Time, u32)> {
    let [sequence, low, high, utc_low, utc_high, sd, drift, sd_drift, correlation, sum] = *words;
    let wide = |low: u32, high: u32| u64::from(high) << 32 | u64::from(low);
    let line = Time {
        index: wide(low, high),
        utc_us: wide(utc_low, utc_high) as i64,
        sd_s: f32::from_bits(sd),
        drift: f32::from_bits(drift),
        sd_drift: f32::from_bits(sd_drift),
        correlation: f32::from_bits(correlation),
    };
    let numbers = [line.sd_s, line.drift, line.sd_drift, line.correlation];
    (sum == check(words) && numbers.iter().all(|x| x.is_finite())).then_some((line, sequence))
}

/// Of all words but the last. Words that are all alike are none.
fn check(words: &[u32; WORDS]) -> u32 {
    words
        .iter()
        .take(WORDS - 1)
        .fold(0x5ea_b0a7, |sum, word| (sum ^ word).wrapping_mul(0x0100_0193).rotate_left(5))
}

/// The clock and what is known of it.
#[derive(Clone, Debug)]
pub struct BatteryClock<C> {
    counter: C,
    /// What was learnt since the start.
    learnt: UtcClock,
    line: Option<(Time, u32)>,
}

impl<C: Counter> BatteryClock<C> {
    /// With what was kept.
    pub fn new(mut counter: C) -> Self {
        let lines = [0, WORDS].map(|from| {
            let mut words = [0; WORDS];
            words.iter_mut().enumerate().for_each(|(n, word)| *word = counter.word(from + n));
            line_of(&words)
        });
        let newer = |(a, b): ((Time, u32), (Time, u32))| if b.1.wrapping_sub(a.1) as i32 > 0 { b } else { a };
        let line = lines[0].zip(lines[1]).map(newer).or(lines[0]).or(lines[1]);
        let learnt = line.map_or(UtcClock::new(), |(line, _)| UtcClock::resumed(&line));
        Self { counter, learnt, line }
    }

    /// UTC now in µs and its standard deviation in s, where both count and line are there.
    pub fn utc(&mut self) -> Option<(i64, f64)> {
        let (line, _) = self.line?;
        let count = self.counter.count().filter(|count| *count >= line.index)?;
        let warm = f64::from(line.sd_drift);
        let total = sqrt(warm * warm + TEMPERATURE * TEMPERATURE);
        let correlation = f64::from(line.correlation) * warm / total;
        let line = Time { sd_drift: total as f32, correlation: correlation as f32, ..line };
        let mut times = Times::default();
        times.note(line, false, RATE_HZ);
        let (utc_us, sd_s) = times.utc(count, RATE_HZ)?;
        Some((utc_us, sqrt(sd_s * sd_s + READING_SD_S * READING_SD_S)))
    }

    /// UTC is this now, with this standard deviation, as the recorder has judged: learns it where that is better than what it knows, or
    /// contradicts it.
    pub fn learn(&mut self, utc_us: i64, sd_s: f64) {
        let Some(index) = self.counter.count() else { return };
        match self.utc() {
            Some((own_us, own_s)) => {
                let off_s = 1e-6 * own_us.wrapping_sub(utc_us) as f64;
                if off_s * off_s > CONTRADICTS * CONTRADICTS * (own_s * own_s + sd_s * sd_s) {
                    // The recorder has judged it: what was kept was wrong.
                    self.learnt = UtcClock::new();
                } else if sd_s > BETTER * own_s {
                    return;
                }
            }
            // There is no line, or it is of a clock that has begun anew.
            None => self.learnt = UtcClock::new(),
        }
        let sd_s = sqrt(sd_s * sd_s + READING_SD_S * READING_SD_S);
        let (Noted::Taken(line) | Noted::Stepped(line, _)) =
            self.learnt.note(Pair { index, utc_us, sd_s }, RATE_HZ)
        else {
            return;
        };
        let sequence = self.line.map_or(0, |(_, sequence)| sequence).wrapping_add(1);
        // The line that is read stays while the other is written.
        let from = if sequence.is_multiple_of(2) { WORDS } else { 0 };
        for (n, word) in words_of(&line, sequence).into_iter().enumerate() {
            self.counter.keep(from + n, word);
        }
        self.line = Some((line, sequence));
    }

    /// What a recorder that knows UTC no better than `known_sd_s` now is told: UTC now and its standard deviation.
    pub fn tell(&mut self, known_sd_s: Option<f64>) -> Option<(i64, f64)> {
        let (utc_us, sd_s) = self.utc()?;
        let sd_s = LASTS * sd_s;
        known_sd_s.is_none_or(|known| sd_s < BETTER * known).then_some((utc_us, sd_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const START_US: i64 = 1_790_000_000_000_000;

    /// A clock that runs wrong, of a truth in seconds; words that outlast it.
    #[derive(Clone)]
    struct Crystal {
        now_s: f64,
        error: f64,
        words: Vec<u32>,
        runs: bool,
        /// Writes that are still carried out.
        writes: usize,
    }

    impl Crystal {
        fn new(error: f64) -> Self {
            Self { now_s: 0.0, error, words: std::vec![0; KEPT_WORDS], runs: true, writes: usize::MAX }
        }

        fn utc_us(&self) -> i64 {
            START_US + (self.now_s * 1e6) as i64
        }
    }

    impl Counter for Crystal {
        fn count(&mut self) -> Option<u64> {
            self.runs.then_some((1e6 + self.now_s * RATE_HZ * (1.0 + self.error)) as u64)
        }
        fn word(&mut self, n: usize) -> u32 {
            self.words[n]
        }
        fn keep(&mut self, n: usize, word: u32) {
            if let Some(left) = self.writes.checked_sub(1) {
                (self.writes, self.words[n]) = (left, word);
            }
        }
    }

    /// How far off it is in its standard deviations.
    fn off_sd(clock: &mut BatteryClock<Crystal>) -> f64 {
        let truth = clock.counter.utc_us();
        let (utc_us, sd_s) = clock.utc().unwrap();
        (utc_us - truth) as f64 * 1e-6 / sd_s
    }

    fn restarted(clock: BatteryClock<Crystal>) -> BatteryClock<Crystal> {
        BatteryClock::new(Crystal { writes: usize::MAX, ..clock.counter })
    }

    #[test]
    fn what_was_learnt_outlasts_a_restart_and_its_uncertainty_holds() {
        for (error, learnt_s) in [(2e-5, 0), (-1e-4, 60), (5e-5, 86_400), (-3e-5, 604_800)] {
            let mut clock = BatteryClock::new(Crystal::new(error));
            assert_eq!(clock.utc(), None, "nothing is known");
            for s in (0..=learnt_s).step_by(60) {
                clock.counter.now_s = f64::from(s);
                let utc_us = clock.counter.utc_us();
                clock.learn(utc_us, 2e-6);
            }
            let mut clock = restarted(clock);
            for away_s in [0.5, 60.0, 3600.0, 86_400.0, 1e7] {
                clock.counter.now_s = f64::from(learnt_s) + away_s;
                assert!(
                    off_sd(&mut clock).abs() < 2.0,
                    "{error} {learnt_s} {away_s}: {}",
                    off_sd(&mut clock)
                );
            }
        }
    }

    /// A crystal that cools from the deck to the sea floor.
    #[test]
    fn cooling_is_within_what_is_stated() {
        let mut clock = BatteryClock::new(Crystal::new(1e-5));
        for s in 0..2000 {
            clock.counter.now_s = f64::from(60 * s);
            let utc_us = clock.counter.utc_us();
            clock.learn(utc_us, 2e-6);
        }
        let mut clock = restarted(clock);
        // 15 parts in a million slower from now on.
        let cooled_s = clock.counter.now_s;
        clock.counter.error = 1e-5;
        for away_s in [600.0, 86_400.0, 1e7] {
            clock.counter.now_s = cooled_s + away_s * (1.0 - 1.5e-5);
            let told = clock.utc().unwrap();
            let off_s = (told.0 - START_US) as f64 * 1e-6 - cooled_s - away_s;
            assert!(off_s.abs() < 2.0 * told.1, "{away_s}: {off_s} of {}", told.1);
        }
    }

    #[test]
    fn power_cut_at_any_write_leaves_a_line() {
        let mut before = BatteryClock::new(Crystal::new(0.0));
        for (s, sd_s) in [(0.0, 0.3), (100.0, 0.01)] {
            before.counter.now_s = s;
            let utc_us = before.counter.utc_us();
            before.learn(utc_us, sd_s);
        }
        let kept = before.line.unwrap();
        for writes in 0..WORDS {
            let mut clock = before.clone();
            (clock.counter.now_s, clock.counter.writes) = (200.0, writes);
            let utc_us = clock.counter.utc_us();
            clock.learn(utc_us, 2e-6);
            assert_ne!(clock.line.unwrap(), kept);
            let mut clock = restarted(clock);
            assert_eq!(clock.line.unwrap(), kept, "{writes}");
            assert!(off_sd(&mut clock).abs() < 1.0);
        }
    }

    #[test]
    fn it_tells_only_who_knows_less_and_learns_only_from_who_knows_more() {
        let mut clock = BatteryClock::new(Crystal::new(0.0));
        assert_eq!(clock.tell(None), None);
        let utc_us = clock.counter.utc_us();
        clock.learn(utc_us, 0.2);
        let (_, sd_s) = clock.tell(None).unwrap();
        assert!((0.2..0.4).contains(&sd_s), "{sd_s}");
        assert_eq!(clock.tell(Some(0.4)), None);
        assert!(clock.tell(Some(1.0)).is_some());
        // What it told comes back as what the recorder knows: nothing is learnt from it.
        let line = clock.line;
        clock.learn(utc_us + 1, sd_s);
        assert_eq!(clock.line, line);
        clock.learn(utc_us, 2e-6);
        assert_ne!(clock.line, line);
        clock.counter.runs = false;
        assert_eq!(clock.tell(None), None);
    }

    #[test]
    fn what_the_recorder_found_wrong_is_not_told_again() {
        let mut crystal = Crystal::new(0.0);
        crystal.now_s = 10.0;
        let mut clock = BatteryClock::new(crystal);
        // An hour wrong by command, and put right by command: no better known, but another time.
        let wrong = clock.counter.utc_us() + 3_600_000_000;
        clock.learn(wrong, 0.25);
        clock.counter.now_s += 30.0;
        let right = clock.counter.utc_us();
        clock.learn(right, 0.25);
        let (told, sd_s) = restarted(clock).tell(None).unwrap();
        assert!((told - right).abs() < 10_000 && sd_s < 0.5, "{} {sd_s}", told - right);
    }

    #[test]
    fn words_of_nothing_are_no_line() {
        for word in [0, u32::MAX, 0xa5a5_a5a5] {
            let mut crystal = Crystal::new(0.0);
            crystal.words = std::vec![word; KEPT_WORDS];
            assert_eq!(BatteryClock::new(crystal).line, None);
        }
        // A clock that has begun anew while its words were kept: its count is before the line's.
        let mut clock = BatteryClock::new(Crystal { now_s: 1e6, ..Crystal::new(0.0) });
        let utc_us = clock.counter.utc_us();
        clock.learn(utc_us, 1e-3);
        clock.counter.now_s = 0.0;
        let mut clock = restarted(clock);
        assert_eq!(clock.utc(), None);
        let utc_us = clock.counter.utc_us();
        clock.learn(utc_us, 1e-3);
        assert!(off_sd(&mut clock).abs() < 1.0);
    }
}
