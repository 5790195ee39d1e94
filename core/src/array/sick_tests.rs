//! A vessel heard by a tetrahedron one of whose channels is sick.

use super::super::test_sea::{
    AZIMUTH, ELEVATION, Normal, SECONDS, error, error_from, hear, noisy, plan, sea, source, standardised,
};

use crate::block::CHANNELS;
use crate::wire::FaultCode;
use std::vec::Vec;

const RATE: f64 = 16_000.0;

/// A channel sick from 2 s on is named within 10 s; what is sent after that is right and says what it assumes.
fn named(code: FaultCode, channel: usize, snr_db: f64, spoil: impl Fn(usize, &mut [[f64; CHANNELS]], usize)) {
    let plan = plan(RATE);
    let mut sea = sea(&plan, snr_db, 77 + channel as u64);
    let from = 2 * RATE as usize;
    for i in from..sea.len() {
        spoil(i, &mut sea, channel);
    }
    let heard = hear(&plan, &sea);
    let faults: Vec<_> = heard.faults.iter().filter(|f| f.0 != FaultCode::Impulses).copied().collect();
    let [(named, value, at_s)] = faults[..] else { panic!("{code:?} {channel}: {:?}", heard.faults) };
    assert_eq!((named, value), (code, channel as i64));
    assert!(at_s < 12.0, "{at_s}");
    assert_eq!(heard.channels & 15, 1 << channel);
    let later: Vec<_> =
        heard.bearings.iter().filter(|b| b.index as f64 / RATE > at_s + 0.3 && b.band == 0).collect();
    let mut within = 0;
    for b in &later {
        assert_eq!(b.flags & 8, 8);
        let (across, up) = error(b);
        assert!(across.abs() < 0.003 && up.abs() < 0.01, "{code:?} {channel}: {across} {up}");
        within += usize::from(standardised(b, (AZIMUTH, ELEVATION)) < 5.991);
    }
    assert!(within * 10 >= later.len() * 8, "{code:?} {channel}: {within} of {}", later.len());
    std::println!(
        "{code:?} of channel {channel} at {snr_db} dB: {:.1} s after, {} bearings, {within} in their ellipse",
        at_s - 2.0,
        later.len()
    );
}

#[test]
fn a_deaf_or_noisy_hydrophone_is_named_and_left_out() {
    for channel in 0..CHANNELS {
        let noise = |gain: f64, own: bool| {
            move |i: usize, sea: &mut [[f64; CHANNELS]], c: usize| {
                let x = Normal((i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 7).next();
                sea[i][c] = gain * x + if own { 0.0 } else { sea[i][c] };
            }
        };
        // Replaced by its own noise, loud and faint; with noise 20 dB above the ambient.
        named(FaultCode::OwnNoise, channel, 10.0, noise(3.0, true));
        named(FaultCode::OwnNoise, channel, 0.0, noise(0.01, true));
        named(FaultCode::OwnNoise, channel, 5.0, noise(10.0, false));
    }
}

#[test]
fn an_inverted_channel_is_named_and_left_out() {
    for channel in 0..CHANNELS {
        for snr_db in [10.0, 0.0] {
            named(FaultCode::Inverted, channel, snr_db, |i, sea, c| sea[i][c] = -sea[i][c]);
        }
    }
}

#[test]
fn crosstalk_is_named_by_the_channel_that_receives_it() {
    let plan = plan(RATE);
    for channel in 0..CHANNELS {
        for snr_db in [10.0, 0.0] {
            // Three degrees a second, in steps.
            let rms = 10f64.powf(snr_db / 20.0);
            let step =
                |n: u64| source(&plan, (AZIMUTH + 0.0525 * n as f64, ELEVATION), rms, None, 1, 90 * n + 7);
            let mut sea = noisy((0..12).flat_map(step).collect(), 5 + channel as u64);
            // Of the pairs with hydrophone 3 that with 1 alone hears no echo off a bottom at once.
            let from = if channel == 1 { 0 } else { 1 };
            sea[2 * RATE as usize..].iter_mut().for_each(|x| x[channel] += 0.15 * x[from]);
            let heard = hear(&plan, &sea);
            let faults: Vec<_> =
                heard.faults.iter().filter(|f| f.0 != FaultCode::Impulses).copied().collect();
            let [(code, value, at_s)] = faults[..] else { panic!("{channel}: {:?}", heard.faults) };
            assert_eq!((code, value), (FaultCode::Leaking, channel as i64));
            assert!(at_s < 12.0, "{at_s}");
            assert_eq!(heard.channels & 15, 1 << channel);
        }
    }
}

#[test]
fn of_two_that_hear_each_other_both_are_named_and_the_one_listened_to_moves_no_bearing_unsaid() {
    let plan = plan(RATE);
    for (a, b) in [(0, 1), (1, 2), (0, 3)] {
        let step = |n: u64| source(&plan, (AZIMUTH + 0.0525 * n as f64, ELEVATION), 3.0, None, 1, 90 * n + 7);
        let mut sea = noisy((0..16).flat_map(step).collect(), 5 + a as u64);
        sea[2 * RATE as usize..].iter_mut().for_each(|x| {
            let (at_a, at_b) = (x[a], x[b]);
            x[a] += 0.25 * at_b;
            x[b] += 0.25 * at_a;
        });
        let heard = hear(&plan, &sea);
        let mut named: Vec<_> =
            heard.faults.iter().filter(|f| f.0 == FaultCode::Leaking).map(|f| f.1).collect();
        named.sort_unstable();
        assert_eq!(named, [a as i64, b as i64], "{:?}", heard.faults);
        assert_eq!((heard.channels & 15).count_ones(), 1);
    }
}

#[test]
fn a_leak_is_named_of_a_vessel_that_hardly_moves() {
    let plan = plan(RATE);
    // Of the highest hydrophone it is named once the vessel has moved: the three others lie level and do not hear an echo apart.
    for channel in 0..CHANNELS - 1 {
        let from = if channel == 1 { 0 } else { 1 };
        let mut sea = noisy(source(&plan, (AZIMUTH + 0.4, ELEVATION), 3.0, None, 9, 31), 15 + channel as u64);
        sea[2 * RATE as usize..].iter_mut().for_each(|x| x[channel] += 0.15 * x[from]);
        let heard = hear(&plan, &sea);
        let faults: Vec<_> = heard.faults.iter().filter(|f| f.0 != FaultCode::Impulses).collect();
        let [(FaultCode::Leaking, value, at_s)] = faults[..] else { panic!("{channel}: {:?}", heard.faults) };
        assert_eq!(*value, channel as i64);
        assert!(*at_s < 8.5, "{at_s}");
    }
}

#[test]
fn an_echo_off_the_bottom_is_no_leak() {
    let plan = plan(RATE);
    for (n, amplitude) in (0..90u64).step_by(3).flat_map(|n| [(n, 0.3), (n, 0.6)]) {
        let (azimuth, elevation) = (0.26 * n as f64, 0.15 + 0.01 * (n % 24) as f64);
        let sound = |down: f64| source(&plan, (azimuth, down * elevation), 3.0, None, 8, 40 + n);
        let (direct, echo) = (sound(1.0), sound(-1.0));
        // A bottom from nothing to some metres below the array.
        let later = n as usize;
        let mut sea = noisy(direct, 70 + n);
        for (x, echo) in sea[later..].iter_mut().zip(&echo) {
            x.iter_mut().zip(echo).for_each(|(x, e)| *x += amplitude * e);
        }
        let heard = hear(&plan, &sea);
        assert!(heard.faults.is_empty() && heard.channels == 0, "{n} {amplitude}: {:?}", heard.faults);
    }
}

#[test]
fn a_dead_channel_leaves_three_and_comes_back() {
    for channel in 0..CHANNELS {
        named(FaultCode::DeadChannel, channel, 10.0, |i, sea, c| sea[i][c] = 0.0);
    }
    let plan = plan(RATE);
    let mut sea = sea(&plan, 10.0, 5);
    for (i, x) in sea.iter_mut().enumerate().take(5 * RATE as usize).skip(2 * RATE as usize) {
        x[1] = if i % 2 == 0 { 0.0 } else { 1e-9 };
    }
    let heard = hear(&plan, &sea);
    let codes: Vec<_> =
        heard.faults.iter().map(|f| (f.0, f.1)).filter(|f| f.0 != FaultCode::Impulses).collect();
    assert_eq!(codes, [(FaultCode::DeadChannel, 1), (FaultCode::ChannelBack, 1)]);
    assert_eq!(heard.channels & 15, 0);
    assert_eq!(heard.bearings.last().unwrap().flags & 8, 0);
}

#[test]
fn a_channel_that_hears_again_is_used_again() {
    let plan = plan(RATE);
    let mut sea = sea(&plan, 10.0, 6);
    let mut random = Normal(9);
    for x in &mut sea[..5 * RATE as usize] {
        x[3] = 3.0 * random.next();
    }
    let heard = hear(&plan, &sea);
    let codes: Vec<_> =
        heard.faults.iter().map(|f| (f.0, f.1)).filter(|f| f.0 != FaultCode::Impulses).collect();
    assert_eq!(codes, [(FaultCode::OwnNoise, 3), (FaultCode::ChannelBack, 3)]);
    assert_eq!(heard.bearings.last().unwrap().flags & 8, 0);
}

#[test]
fn healthy_channels_are_never_named() {
    let plan = plan(RATE);
    for (seed, snr_db) in [(1, 20.0), (2, 10.0), (3, 0.0), (4, -8.0), (5, -40.0)] {
        let heard = hear(&plan, &sea(&plan, snr_db, seed));
        assert!(heard.faults.is_empty() && heard.channels == 0, "{snr_db}: {:?}", heard.faults);
    }
}

#[test]
fn no_direction_is_told_while_noise_common_to_all_contradicts_it() {
    let plan = plan(RATE);
    for (seed, snr_db) in [(1, 10.0), (2, 5.0), (3, 0.0)] {
        let mut sea = sea(&plan, snr_db, seed);
        let (from, to) = (2 * RATE as usize, 6 * RATE as usize);
        let mut random = Normal(seed + 40);
        for x in &mut sea[from..to] {
            let common = 3.0 * 10f64.powf(snr_db / 20.0) * random.next();
            x.iter_mut().for_each(|x| *x += common);
        }
        let heard = hear(&plan, &sea);
        let codes: Vec<_> = heard.faults.iter().map(|f| f.0).filter(|f| *f != FaultCode::Impulses).collect();
        assert_eq!(codes, [FaultCode::Inconsistent], "{snr_db}");
        let between = |from_s: f64, to_s: f64| {
            let within = move |t: f64| t > from_s && t < to_s;
            heard.bearings.iter().filter(move |b| within(b.index as f64 / RATE)).count()
        };
        assert_eq!(between(2.5, 6.0), 0, "{snr_db}");
        assert!(between(0.0, 2.0) >= 2, "{snr_db}");
        // Eight segments that agree, then as before.
        assert!(between(10.5, f64::INFINITY) >= 2, "{snr_db}");
    }
}

#[test]
fn hum_that_all_hydrophones_hear_at_once_is_nobody_and_is_named() {
    let plan = plan(RATE);
    let mut random = Normal(61);
    let phases: Vec<f64> = (0..40).map(|_| 3.0 * random.next()).collect();
    let gains = [0.7, 1.3, 1.0, 0.9];
    let mut sea = noisy(std::vec![[0.0; CHANNELS]; 10 * RATE as usize], 62);
    for (i, x) in sea.iter_mut().enumerate() {
        let angle = core::f64::consts::TAU * 50.0 * i as f64 / RATE;
        let hum: f64 = (1..).zip(&phases).map(|(k, p)| 0.3 * (f64::from(k) * angle + p).sin()).sum();
        x.iter_mut().zip(gains).for_each(|(x, gain)| *x += gain * hum);
    }
    let heard = hear(&plan, &sea);
    assert!(heard.bearings.is_empty(), "{:?}", heard.bearings);
    assert!(heard.faults.iter().any(|f| f.0 == FaultCode::Inconsistent), "{:?}", heard.faults);
}

#[test]
fn two_sick_channels_leave_no_direction() {
    let plan = plan(RATE);
    let noise =
        |i: usize, c: usize| Normal(((4 * i + c) as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 7).next();
    let told = |what: &str, spoil: &dyn Fn(usize, &mut [f64; CHANNELS])| {
        let mut sea = sea(&plan, 10.0, 31);
        sea.iter_mut().enumerate().skip(2 * RATE as usize).for_each(|(i, x)| spoil(i, x));
        let heard = hear(&plan, &sea);
        let later = heard.bearings.iter().filter(|b| b.index as f64 / RATE > 2.6).count();
        assert_eq!(later, 0, "{what}");
        let faults: Vec<_> =
            heard.faults.iter().filter(|f| f.0 != FaultCode::Impulses).map(|f| (f.0, f.1)).collect();
        faults
    };
    use FaultCode as F;
    for (a, b) in [(0usize, 1usize), (1, 3), (3, 2)] {
        let both = |mut faults: Vec<(F, i64)>, expected: [(F, i64); 2]| {
            faults.sort_by_key(|f| f.1);
            let mut expected = expected;
            expected.sort_by_key(|f| f.1);
            assert_eq!(faults, expected);
        };
        let (one, other) = (a as i64, b as i64);
        both(
            told("noise of their own", &|i, x| (x[a], x[b]) = (noise(i, a), noise(i, b))),
            [(F::OwnNoise, one), (F::OwnNoise, other)],
        );
        both(
            told("noise and nothing", &|i, x| (x[a], x[b]) = (noise(i, a), 0.0)),
            [(F::OwnNoise, one), (F::DeadChannel, other)],
        );
        both(
            told("noise and inverted", &|i, x| (x[a], x[b]) = (noise(i, a), -x[b])),
            [(F::OwnNoise, one), (F::Inverted, other)],
        );
        // Which two is not observable.
        let inverted = told("inverted", &|_, x| (x[a], x[b]) = (-x[a], -x[b]));
        assert!(matches!(inverted[..], [(F::Inconsistent, _)]), "{inverted:?}");
    }
}

#[test]
fn of_the_two_directions_that_three_hydrophones_give_the_one_heard_before_is_told() {
    let plan = plan(RATE);
    // Without the third hydrophone the mirror image rises as well, and lies ten degrees and more aside.
    let from = (2.4, 0.3);
    let sea = noisy(source(&plan, from, 3.0, None, SECONDS, 32), 33);
    let told = |dead_s: f64| {
        let mut sea = sea.clone();
        sea.iter_mut().skip((dead_s * RATE) as usize).for_each(|x| x[2] = 0.0);
        let later = move |b: &crate::wire::Bearing| b.index as f64 / RATE > dead_s + 0.6;
        hear(&plan, &sea).bearings.into_iter().filter(later).collect::<Vec<_>>()
    };
    assert!(told(0.0).is_empty(), "nothing tells which");
    let after = told(4.0);
    assert!(after.len() > 10, "{}", after.len());
    for b in after {
        let (across, up) = error_from(&b, from);
        assert!(across.abs() < 0.01 && up.abs() < 0.01 && b.flags & 8 == 8, "{across} {up}");
    }
}

#[test]
fn a_leak_is_suspected_until_it_is_denied() {
    use super::{LEAKING, SUSPECTED, Seen, Sick, Sign};
    let plan = plan(RATE);
    let mut sick = Sick::new();
    let take = |sick: &mut Sick, sign| sick.take(&plan, sign, None, Seen::NONE, 0, &mut |_| {});
    for n in 1..=SUSPECTED {
        assert_eq!(sick.suspected(), 0);
        take(&mut sick, Sign::Sick(LEAKING, 2));
        assert_eq!(sick.suspected() == 1 << 2, n == SUSPECTED);
    }
    // What hides it denies nothing.
    for _ in 0..20 {
        take(&mut sick, Sign::Well);
    }
    assert_eq!(sick.suspected(), 1 << 2);
    sick.deny();
    assert_eq!(sick.suspected(), 0);
}
