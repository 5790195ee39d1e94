//! Both recorders under sequences of blocks that no healthy source sends: whatever the index does, `Health` goes on within
//! one interval of what arrives, faults stay gathered and none is forgotten, every instant is in one bucket, and the cut
//! into blocks changes nothing.

use super::test_recorder::{ARRAY_RATE, BOTH, BOTTOM_RATE, Heard, Which, listen, noise, source, trial};
use super::{Memory, Recorder};
use crate::block::{Block, Frame, MISSING};
use crate::health::LossCause;
use crate::obs::station_tests as bottom;
use crate::run::Application;
use crate::utc::Pair;
use crate::wire::{Command, FaultCode, Message};
use std::boxed::Box;
use std::vec;
use std::vec::Vec;

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
        let frames = noise(512);
        // In short pieces neither time is believed until they have swung for half a minute, in long ones both are.
        for piece in [64, 512] {
            let n = (200 * rate as usize / piece).min(4000);
            let runs: Vec<(u64, &[Frame])> =
                (0..n).map(|k| (if k % 2 == 0 { 0 } else { 10_000_000 }, &frames[..piece])).collect();
            let heard = trial(which, "swings", &runs);
            let (sent, held) = heard.faults(FaultCode::Restarted);
            let restarts = sent.len() as u64 + held;
            let expected = if piece == 64 { 0..=200 / 30 } else { (n as u64 - 1) / 2..=(n as u64 - 1) / 2 };
            assert!(expected.contains(&restarts), "{which:?} {piece}: {restarts} in {n}");
        }
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
    let clean = source(8);
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

#[test]
fn an_index_back_where_it_began_is_a_new_time_however_soon() {
    let frames = source(60);
    let rate = ARRAY_RATE as usize;
    for (from, back) in [(0, 3), (0, 10), (0, 29), (777, 20), (0, 31)] {
        let cut = back * rate + 5;
        let heard = trial(Which::Array, "soon back", &[(from, &frames[..cut]), (from, &frames[cut..])]);
        let bearings = heard.all.iter().filter(|m| matches!(m.1, Message::Bearing(_)));
        let after: Vec<u64> = bearings.map(|m| m.0).filter(|fed| *fed > cut as u64).collect();
        assert!(
            after[0] - (cut as u64) < 2 * ARRAY_RATE,
            "after {back} s: {} s",
            (after[0] - cut as u64) / ARRAY_RATE
        );
        assert!(heard.last().lost[LossCause::Overlap as usize] <= 256, "after {back} s: {:?}", heard.last());
        let (told, held) = heard.faults(FaultCode::Restarted);
        assert_eq!((told.len(), held), (1, 0), "after {back} s");
    }
    // A board that resets over and over, after a little longer each time.
    let runs: Vec<(u64, &[Frame])> = (0..40).map(|k| (0, &frames[..20 * rate + k * rate / 10])).collect();
    let heard = trial(Which::Array, "resets", &runs);
    assert!(heard.last().processed > heard.fed * 19 / 20, "{:?} of {}", heard.last(), heard.fed);
}

#[test]
fn a_packet_that_strayed_is_left_out_however_late() {
    let rate = BOTTOM_RATE as usize;
    let frames = bottom::record(5400 * rate, rate as f64, 200.0, 1500.0);
    let (at, undisturbed) = (3600 * rate, listen(Which::Bottom, &[(0, &frames)], 64));
    for late_s in [1, 29, 31, 600, 3600] {
        for n in [1, 8, 200] {
            let old = at - late_s * rate;
            let stray = &frames[old..old + n];
            let runs = [(0, &frames[..at]), (old as u64, stray), (at as u64, &frames[at..])];
            let heard = trial(Which::Bottom, "stray", &runs);
            let estimates = |heard: &Heard| -> Vec<Message> {
                let said = heard.all.iter().map(|m| m.1);
                said.filter(|m| !matches!(m, Message::Health(_) | Message::Fault(_))).collect()
            };
            assert_eq!(estimates(&heard), estimates(&undisturbed), "{n} instants {late_s} s late");
            let lost = heard.last().lost;
            assert_eq!(lost[LossCause::Overlap as usize], n as u64, "{n} instants {late_s} s late");
            assert_eq!(lost[LossCause::Gap as usize], 0, "{n} instants {late_s} s late");
        }
    }
}

#[test]
fn utc_is_learnt_anew_after_a_restart() {
    let frames = noise(10 * ARRAY_RATE as usize);
    let mut memory = Box::<Memory<'_>>::default();
    let mut recorder = Which::Array.configure(&mut memory);
    let start_us = 1_790_000_000_000_000;
    let tell = |recorder: &mut Recorder<'_, '_>, second: i64| {
        let (mut status, mut stepped) = (None, false);
        let utc_us = start_us + second * 1_000_000;
        recorder.command(Command::Utc { token: 1, utc_us, sd_us: 1000 }, &mut |m| match m {
            Message::Reply(reply) => status = Some(reply.status),
            Message::Fault(_) => stepped = true,
            _ => {}
        });
        (status, stepped)
    };
    recorder.push(Block { first_index: 0, frames: &frames[..8000] }, &mut |_| {});
    assert_eq!(tell(&mut recorder, 1), (Some(0), false));
    recorder.push(Block { first_index: 3600 * ARRAY_RATE, frames: &frames[..8000] }, &mut |_| {});
    // Back to 0, and beyond the index at which UTC was told before.
    recorder.push(Block { first_index: 0, frames: &frames }, &mut |_| {});
    assert_eq!(tell(&mut recorder, 3611), (Some(0), false));
}

#[test]
fn a_receiver_that_steps_again_and_again_does_not_fill_the_line() {
    for which in BOTH {
        let mut memory = Box::<Memory<'_>>::default();
        let mut recorder = which.configure(&mut memory);
        let mut steps = 0;
        for second in 0..60u64 {
            // Another second every three pulses.
            let utc_us = 1_790_000_000_000_000 + (second + second / 3) as i64 * 1_000_000;
            recorder.pair(Pair { index: second * which.rate(), utc_us, sd_s: 2e-6 }, &mut |m| {
                steps += u32::from(matches!(m, Message::Fault(f) if f.code == FaultCode::ClockStepped));
            });
        }
        assert_eq!(steps, 3, "{which:?}");
    }
}
