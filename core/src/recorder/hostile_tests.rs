//! Both recorders under sequences of blocks that no healthy source sends: whatever the index does, `Health` goes on within
//! one interval of what arrives, faults stay gathered and none is forgotten, every instant is in one bucket, and the cut
//! into blocks changes nothing.

use super::{Memory, Recorder};
use crate::block::{Block, Frame, MISSING};
use crate::config::StationConfig;
use crate::obs::station_tests as bottom;
use crate::run::Application;
use crate::wire::{Command, FaultCode, Health, Message};
use std::boxed::Box;
use std::vec;
use std::vec::Vec;

const ARRAY_RATE: u64 = 8000;
const BOTTOM_RATE: u64 = 50;
const HYDROPHONES_M: [[f64; 3]; 4] =
    [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];

/// A kind of recorder.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Which {
    Array,
    Bottom,
}

const BOTH: [Which; 2] = [Which::Array, Which::Bottom];

impl Which {
    fn rate(self) -> u64 {
        match self {
            Self::Array => ARRAY_RATE,
            Self::Bottom => BOTTOM_RATE,
        }
    }

    fn configure<'m>(self, memory: &'m mut Memory<'static>) -> Recorder<'m, 'static> {
        let (config, table) = match self {
            Self::Array => (StationConfig::array(ARRAY_RATE as f64, HYDROPHONES_M), None),
            Self::Bottom => (bottom::config(BOTTOM_RATE as f64), Some(bottom::table(BOTTOM_RATE as f64))),
        };
        memory.configure(&config, table).unwrap()
    }
}

/// What was said, each with the instants fed before it.
struct Heard {
    rate: u64,
    fed: u64,
    all: Vec<(u64, Message)>,
}

impl Heard {
    fn health(&self) -> Vec<(u64, Health)> {
        let health =
            |(fed, m): &(u64, Message)| if let Message::Health(h) = m { Some((*fed, *h)) } else { None };
        self.all.iter().filter_map(health).collect()
    }

    fn last(&self) -> Health {
        self.health().last().unwrap().1
    }

    /// Faults of a kind: when they were sent, and how many were told of later.
    fn faults(&self, code: FaultCode) -> (Vec<u64>, u64) {
        let (mut sent, mut held) = (Vec::new(), 0);
        for (fed, m) in &self.all {
            match m {
                Message::Fault(f) if f.code == code => sent.push(*fed),
                Message::FaultsHeld(h) if h.code == code => held += u64::from(h.count),
                _ => {}
            }
        }
        (sent, held)
    }

    /// The rules that hold whatever comes.
    fn check(&self, what: &str) {
        let slack = 2 * crate::intake::PATIENCE + 64;
        let mut before = 0;
        for (fed, _) in self.health() {
            assert!(
                fed - before <= 60 * self.rate + slack,
                "{what}: {} s without Health",
                (fed - before) / self.rate
            );
            before = fed;
        }
        for w in self.health().windows(21) {
            assert!(w[20].0 - w[0].0 >= 60 * self.rate, "{what}: 21 Health within a minute");
        }
        let health = self.last();
        let total = health.processed + health.lost.iter().sum::<u64>();
        assert_eq!(total - health.lost[0], self.fed, "{what}: {health:?}");
        for code in FaultCode::ALL {
            let (sent, _) = self.faults(code);
            // Any stretch as long as a minute touches two minutes.
            for w in sent.windows(7) {
                assert!(w[6] - w[0] >= 60 * self.rate, "{what}: seven of {code:?} within a minute");
            }
        }
    }
}

fn noise(n: usize) -> Vec<Frame> {
    let mut seed = 77u32;
    let mut next = move || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 12) as i32 - (1 << 19)
    };
    (0..n).map(|_| core::array::from_fn(|_| next())).collect()
}

fn listen(which: Which, runs: &[(u64, &[Frame])], cut: usize) -> Heard {
    let mut memory = Box::<Memory<'_>>::default();
    let mut recorder = which.configure(&mut memory);
    let mut heard = Heard { rate: which.rate(), fed: 0, all: Vec::new() };
    for (first, frames) in runs {
        for (k, frames) in frames.chunks(cut).enumerate() {
            heard.fed += frames.len() as u64;
            let (fed, all) = (heard.fed, &mut heard.all);
            let first_index = first.saturating_add((k * cut) as u64);
            recorder.push(Block { first_index, frames }, &mut |m| all.push((fed, *m)));
        }
    }
    let (fed, all) = (heard.fed, &mut heard.all);
    recorder.finish(&mut |m| all.push((fed, *m)));
    heard
}

/// The same however it is cut, and by the rules.
fn trial(which: Which, what: &str, runs: &[(u64, &[Frame])]) -> Heard {
    let heard = listen(which, runs, 64);
    let other = listen(which, runs, 1000);
    assert!(
        heard.all.iter().map(|m| m.1).eq(other.all.iter().map(|m| m.1)),
        "{which:?} {what}: blocks matter"
    );
    heard.check(&std::format!("{which:?} {what}"));
    heard
}

#[test]
fn restarts_in_a_row_are_all_told_and_health_goes_on() {
    for which in BOTH {
        let rate = which.rate();
        // Back to 0 every 40 s: no minute of the index ever ends.
        let frames = noise(40 * rate as usize);
        let runs = vec![(0, frames.as_slice()); 12];
        let heard = trial(which, "back to 0 every 40 s", &runs);
        let (sent, held) = heard.faults(FaultCode::Restarted);
        assert_eq!(sent.len() as u64 + held, 11, "{which:?}");
    }
}

#[test]
fn an_index_that_swings_between_two_times_does_not_fill_the_line() {
    for which in BOTH {
        let rate = which.rate();
        let frames = noise(64);
        let n = (200 * rate as usize / 64).min(4000);
        let runs: Vec<(u64, &[Frame])> =
            (0..n).map(|k| (if k % 2 == 0 { 0 } else { 10_000_000 }, frames.as_slice())).collect();
        let heard = trial(which, "swings", &runs);
        let (sent, held) = heard.faults(FaultCode::Restarted);
        assert_eq!(sent.len() as u64 + held, (n as u64 - 1) / 2, "{which:?}");
    }
}

#[test]
fn an_index_that_stands_still_leaves_health() {
    for which in BOTH {
        let frames = noise(64);
        let n = 300 * which.rate() as usize / 64;
        let heard = trial(which, "stands still", &vec![(0, frames.as_slice()); n]);
        assert!(heard.health().len() >= 4, "{which:?}");
    }
}

#[test]
fn indices_beyond_all_time_leave_health() {
    for which in BOTH {
        let frames = noise(64);
        let n = 300 * which.rate() as usize / 64;
        let mut runs = vec![(0, frames.as_slice())];
        runs.extend(vec![(u64::MAX - 5, frames.as_slice()); n]);
        let heard = trial(which, "beyond all time", &runs);
        assert!(heard.health().len() >= 4, "{which:?}");
    }
}

#[test]
fn a_level_from_before_a_restart_is_not_told_as_of_now() {
    for which in BOTH {
        let rate = which.rate();
        let (frames, absent) = (noise(90 * rate as usize), vec![[MISSING; 4]; 200 * rate as usize]);
        let heard = trial(which, "deaf after a restart", &[(1_000_000_000, &frames), (0, &absent)]);
        let late = heard.health().into_iter().find(|(fed, _)| *fed > (90 + 70) * rate).unwrap().1;
        assert_eq!(late.level_half_db, [i8::MIN; 4], "{which:?}");
    }
}

#[test]
fn a_level_from_before_a_silence_is_not_told_as_of_now() {
    for which in BOTH {
        let frames = noise(90 * which.rate() as usize);
        let mut memory = Box::<Memory<'_>>::default();
        let mut recorder = which.configure(&mut memory);
        recorder.push(Block { first_index: 0, frames: &frames }, &mut |_| {});
        let mut levels = Vec::new();
        for seconds in 1..=120 {
            recorder.silent(seconds, &mut |m| {
                if let Message::Health(h) = m {
                    levels.push(h.level_half_db);
                }
            });
        }
        recorder.command(Command::Identify { token: 1 }, &mut |m| {
            if let Message::Health(h) = m {
                levels.push(h.level_half_db);
            }
        });
        assert_eq!(levels, [[i8::MIN; 4]; 3], "{which:?}");
    }
}

#[test]
fn a_presence_ends_while_nothing_can_be_heard() {
    let (rate, hour) = (BOTTOM_RATE as f64, 3600 * BOTTOM_RATE as usize);
    let frames = bottom::record(hour, rate, 200.0, 1500.0);
    // Hours without a code, and hours of a stuck pressure channel.
    for code in [MISSING, 5] {
        let mut deaf = bottom::record(2 * hour, rate, 200.0, 1500.0);
        deaf.iter_mut().for_each(|f| f[0] = code);
        let heard = trial(Which::Bottom, "deaf", &[(0, &frames), (hour as u64, &deaf)]);
        let told = heard.all.iter().find(|m| matches!(m.1, Message::Segment(_))).unwrap().0;
        assert!(told < 7000 * BOTTOM_RATE, "{code}: told after {} s", told / BOTTOM_RATE);
    }
}

#[test]
fn what_was_open_is_said_before_the_restart() {
    let rate = BOTTOM_RATE;
    let frames = bottom::record(3600 * rate as usize, rate as f64, 200.0, 1500.0);
    let heard = trial(Which::Bottom, "open segment", &[(1_000_000_000, &frames), (0, &frames[..60_000])]);
    let restarted = heard
        .all
        .iter()
        .position(|m| matches!(m.1, Message::Fault(f) if f.code == FaultCode::Restarted))
        .unwrap();
    let of_old = heard.all.iter().skip(restarted).find(|m| match m.1 {
        Message::Azimuth(a) => a.index >= 1_000_000_000,
        Message::Range(a) => a.index >= 1_000_000_000,
        Message::Segment(s) => s.end >= 1_000_000_000,
        _ => false,
    });
    assert!(of_old.is_none(), "{of_old:?}");
}

#[test]
fn random_hostilities_keep_the_rules() {
    for which in BOTH {
        let rate = which.rate();
        let mut frames = noise(20 * rate as usize);
        for seed in 0..3u32 {
            let mut state = seed * 7919 + 1;
            let mut random = |n: u64| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                u64::from(state >> 8) % n
            };
            frames
                .iter_mut()
                .skip(random(9000) as usize)
                .step_by(1 + random(90) as usize)
                .for_each(|f| f[1] = MISSING);
            let stuck = random(4) as usize;
            frames.iter_mut().skip(rate as usize).take(rate as usize).for_each(|f| f[stuck] = 9);
            let mut at = 1_000_000u64;
            let mut runs: Vec<(u64, &[Frame])> = Vec::new();
            for _ in 0..40 {
                at = match random(12) {
                    0 => at.saturating_sub(1),
                    1 => at.saturating_sub(29 * rate),
                    2 => at.saturating_sub(31 * rate),
                    3 => at + 1_000_000,
                    4 => 0,
                    5 => u64::MAX - random(100),
                    6 => at + random(30),
                    7 => at.saturating_sub(30 * rate),
                    8 => at.saturating_sub(30 * rate + 1),
                    _ => at,
                };
                let n = random(5 * rate) as usize;
                runs.push((at, &frames[..n]));
                at = if at > u64::MAX / 2 { 1_000_000 + random(1_000_000) } else { at + n as u64 };
            }
            trial(which, &std::format!("seed {seed}"), &runs);
        }
    }
}

#[test]
fn bearings_hold_the_documented_flags_and_no_other() {
    let n = 8 * ARRAY_RATE as usize;
    let all = noise(2 * n + 16);
    // A source due east, and noise of each hydrophone's own.
    let lead = HYDROPHONES_M.map(|[x, ..]| (8.5 + x / 1484.0 * ARRAY_RATE as f64) as usize);
    let heard_at = |i: usize| core::array::from_fn(|c| all[i + lead[c]][0] + all[n + 16 + i][c] / 4);
    let clean: Vec<Frame> = (0..n).map(heard_at).collect();
    let (mut clipped, mut damaged) = (clean.clone(), clean.clone());
    clipped.iter_mut().skip(5).step_by(ARRAY_RATE as usize).for_each(|f| f[2] = (1 << 23) - 1);
    damaged.iter_mut().skip(77).step_by(900).for_each(|f| *f = [MISSING; 4]);
    for (samples, bit) in [(&clean, 0), (&clipped, 1), (&damaged, 2)] {
        let heard = listen(Which::Array, &[(0, samples)], 512);
        let flags = heard
            .all
            .iter()
            .filter_map(|(_, m)| if let Message::Bearing(b) = m { Some(b.flags) } else { None });
        let flags: Vec<u8> = flags.collect();
        assert!(flags.iter().all(|f| f & !7 == 0) && flags.iter().any(|f| f & 3 == bit), "{bit}: {flags:?}");
    }
}

#[test]
fn an_index_that_leaps_again_and_again_does_not_fill_the_line() {
    for which in BOTH {
        let frames = noise(64);
        let n = (200 * which.rate() as usize / 64).min(4000);
        let runs: Vec<(u64, &[Frame])> = (0..n as u64).map(|k| (k * 1_000_000, frames.as_slice())).collect();
        trial(which, "leaps", &runs);
    }
}

#[test]
fn a_second_configuration_says_the_same_as_the_first() {
    let rate = BOTTOM_RATE;
    let frames = bottom::record(1800 * rate as usize, rate as f64, 200.0, 1500.0);
    let mut memory = Box::<Memory<'_>>::default();
    let mut said = [Vec::new(), Vec::new()];
    for all in &mut said {
        let mut recorder = Which::Bottom.configure(&mut memory);
        recorder.push(Block { first_index: 0, frames: &frames }, &mut |m| all.push(*m));
    }
    assert_eq!(said[0], said[1]);
}
