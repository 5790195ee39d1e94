//! Faulty input to the array chain: every sample instant ends in exactly one bucket, and what is wrong is said.

use proptest::prelude::*;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use seabearing::reproduce::bearing_limit::station;
use seabearing_core::array::{FRAME, Plan, Scratch, State, finish, push};
use seabearing_core::block::{Block, Frame, MISSING};
use seabearing_core::health::LossCause;
use seabearing_core::wire::{FaultCode, Message};

fn noise(seed: u64, n: usize) -> Vec<Frame> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| std::array::from_fn(|_| rng.random_range(-20_000..20_000))).collect()
}

struct Run {
    state: Box<State>,
    messages: Vec<Message>,
}

impl Run {
    fn over(blocks: &[(u64, &[Frame])]) -> Self {
        let plan = Plan::new(&station()).unwrap();
        let mut state = Box::new(State::new());
        let mut scratch = Box::new(Scratch::new());
        let mut messages = Vec::new();
        let mut sink = |m: Message| messages.push(m);
        for (first_index, frames) in blocks {
            let block = Block { first_index: *first_index, frames };
            push(&plan, &mut state, &mut scratch, block, &mut sink);
        }
        finish(&plan, &mut state, &mut scratch, &mut sink);
        Self { state, messages }
    }

    fn lost(&self, cause: LossCause) -> u64 {
        self.state.accounting().lost[cause as usize]
    }

    fn faults(&self, code: FaultCode) -> Vec<i64> {
        self.messages
            .iter()
            .filter_map(|m| match m {
                Message::Fault(f) if f.code == code => Some(f.value),
                _ => None,
            })
            .collect()
    }
}

#[test]
fn a_gap_at_every_offset_is_counted_once() {
    let n = 3 * FRAME;
    let frames = noise(1, n);
    for at in (0..n).step_by(7) {
        let (a, b) = frames.split_at(at);
        let run = Run::over(&[(1000, a), (1000 + at as u64 + 77, b)]);
        let expected = n as u64 + if at == 0 { 0 } else { 77 };
        assert_eq!(run.state.accounting().total(), expected, "gap at {at}");
        assert_eq!(run.lost(LossCause::Gap), expected - n as u64);
    }
}

#[test]
fn repeats_are_dropped_and_counted() {
    let frames = noise(2, 4 * FRAME);
    let run = Run::over(&[(0, &frames[..1500]), (1300, &frames[1300..])]);
    assert_eq!(run.lost(LossCause::Overlap), 200);
    assert_eq!(run.state.accounting().total(), frames.len() as u64 + 200);
    assert_eq!(run.faults(FaultCode::Overlap), [200]);
}

#[test]
fn a_count_that_starts_again_is_survived() {
    let frames = noise(3, 4 * FRAME);
    let run = Run::over(&[(10_000_000, &frames), (0, &frames)]);
    assert_eq!(run.faults(FaultCode::Restarted).len(), 1);
    assert_eq!(run.state.accounting().total(), 8 * FRAME as u64);
}

#[test]
fn dead_copied_and_clipped_channels_are_named() {
    let clean = noise(4, 20 * FRAME);
    let mut dead = clean.clone();
    dead.iter_mut().for_each(|f| f[2] = 7);
    let run = Run::over(&[(0, &dead)]);
    assert_eq!(run.faults(FaultCode::DeadChannel), [2]);
    assert_eq!(run.state.channels(&Plan::new(&station()).unwrap()), 0b0100);
    assert!(run.lost(LossCause::DeadChannel) > 0 && run.state.accounting().processed == 0);
    assert_eq!(run.state.accounting().total(), dead.len() as u64);

    let mut copied = clean.clone();
    copied.iter_mut().for_each(|f| f[3] = f[1]);
    assert_eq!(Run::over(&[(0, &copied)]).faults(FaultCode::DeadChannel), [3]);

    let mut clipped = clean.clone();
    clipped.iter_mut().for_each(|f| f[0] = (f[0] * 1000).clamp(-(1 << 23), (1 << 23) - 1));
    let run = Run::over(&[(0, &clipped)]);
    assert_eq!(run.faults(FaultCode::Clipping), [0]);
    assert!(run.lost(LossCause::Clipped) > 0);
    assert_eq!(run.state.accounting().total(), clipped.len() as u64);
}

proptest! {
    #![proptest_config(seabearing_testkit::property(64))]

    #[test]
    fn whatever_comes_every_instant_is_in_one_bucket(
        seed in 0u64..1000,
        cuts in proptest::collection::vec((1usize..1500, 0u64..800, 0u8..4), 1..8),
    ) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut index = rng.random_range(0..1u64 << 40);
        let mut expected = 0u64;
        let mut blocks = Vec::new();
        for (n, (length, gap, fault)) in cuts.into_iter().enumerate() {
            let mut frames = noise(seed + n as u64, length);
            match fault {
                1 => frames.iter_mut().skip(3).step_by(97).for_each(|f| f[1] = MISSING),
                2 => frames.iter_mut().for_each(|f| f[0] = 0),
                3 => frames.iter_mut().for_each(|f| f[3] = i32::MAX),
                _ => {}
            }
            if n > 0 {
                index += gap;
                expected += gap;
            }
            expected += length as u64;
            blocks.push((index, frames));
            index += length as u64;
        }
        let views: Vec<(u64, &[Frame])> = blocks.iter().map(|(i, f)| (*i, f.as_slice())).collect();
        let run = Run::over(&views);
        prop_assert_eq!(run.state.accounting().total(), expected);
        for m in &run.messages {
            if let Message::Bearing(b) = m {
                prop_assert!(b.azimuth.is_finite() && b.var_azimuth.is_finite() && b.quality.is_finite());
            }
        }
    }
}
