//! Both recorders for tests, fed run by run, and the rules that what they say must obey.

use super::{Memory, Recorder};
use crate::block::{Block, Frame};
use crate::config::StationConfig;
use crate::obs::station_tests as bottom;
use crate::run::Application;
use crate::wire::{FaultCode, Health, Message};
use std::boxed::Box;
use std::vec::Vec;

pub(super) const ARRAY_RATE: u64 = 8000;
pub(super) const BOTTOM_RATE: u64 = 50;
pub(super) const HYDROPHONES_M: [[f64; 3]; 4] =
    [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];

/// A kind of recorder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Which {
    Array,
    Bottom,
}

pub(super) const BOTH: [Which; 2] = [Which::Array, Which::Bottom];

impl Which {
    pub(super) fn rate(self) -> u64 {
        match self {
            Self::Array => ARRAY_RATE,
            Self::Bottom => BOTTOM_RATE,
        }
    }

    /// Its configuration and its table.
    pub(super) fn config(self) -> (StationConfig, Option<&'static [u8]>) {
        match self {
            Self::Array => (StationConfig::array(ARRAY_RATE as f64, HYDROPHONES_M), None),
            Self::Bottom => (bottom::config(BOTTOM_RATE as f64), Some(bottom::table(BOTTOM_RATE as f64))),
        }
    }

    pub(super) fn configure<'m>(self, memory: &'m mut Memory<'static>) -> Recorder<'m, 'static> {
        let (config, table) = self.config();
        memory.configure(&config, table).unwrap()
    }
}

/// What was said, each with the instants fed before it.
pub(super) struct Heard {
    rate: u64,
    pub(super) fed: u64,
    pub(super) all: Vec<(u64, Message)>,
}

impl Heard {
    pub(super) fn health(&self) -> Vec<(u64, Health)> {
        let health =
            |(fed, m): &(u64, Message)| if let Message::Health(h) = m { Some((*fed, *h)) } else { None };
        self.all.iter().filter_map(health).collect()
    }

    pub(super) fn last(&self) -> Health {
        self.health().last().unwrap().1
    }

    /// Faults of a kind: when they were sent, and how many were told of later.
    pub(super) fn faults(&self, code: FaultCode) -> (Vec<u64>, u64) {
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
    pub(super) fn check(&self, what: &str) {
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

pub(super) fn noise(n: usize) -> Vec<Frame> {
    let mut seed = 77u32;
    let mut next = move || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 12) as i32 - (1 << 19)
    };
    (0..n).map(|_| core::array::from_fn(|_| next())).collect()
}

pub(super) fn listen(which: Which, runs: &[(u64, &[Frame])], cut: usize) -> Heard {
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
pub(super) fn trial(which: Which, what: &str, runs: &[(u64, &[Frame])]) -> Heard {
    let heard = listen(which, runs, 64);
    let other = listen(which, runs, 1000);
    assert!(
        heard.all.iter().map(|m| m.1).eq(other.all.iter().map(|m| m.1)),
        "{which:?} {what}: blocks matter"
    );
    heard.check(&std::format!("{which:?} {what}"));
    heard
}

/// A source due east, and noise of each hydrophone's own.
pub(super) fn source(seconds: usize) -> Vec<Frame> {
    let n = seconds * ARRAY_RATE as usize;
    let all = noise(2 * n + 64);
    let lead = HYDROPHONES_M.map(|[x, ..]| (16.5 + x / 1484.0 * ARRAY_RATE as f64) as usize);
    (0..n).map(|i| core::array::from_fn(|c| all[i + lead[c]][0] + all[n + 32 + i][c] / 4)).collect()
}
