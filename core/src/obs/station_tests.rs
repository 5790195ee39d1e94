//! The whole chain on small records: accounting, faults, independence of block lengths, memory.

use super::decimate::inner_rate_hz;
use super::plan::Plan;
use super::station::{Scratch, State, finish, push};
use super::table::{Table, blob_bytes};
use super::table_encode::{BranchColumns, Header, encode};
use crate::block::{Block, Frame, MISSING};
use crate::config::{Clips, Kind, Levels, ObsConfig, Schedule, StationConfig, Tracking};
use crate::health::LossCause;
use crate::math;
use crate::wire::{AZIGRAM_BANDS, Azigram, FaultCode, Message};
use std::boxed::Box;
use std::vec::Vec;
use std::{format, vec};

pub(crate) fn config(rate_hz: f64) -> StationConfig {
    StationConfig {
        id: 3,
        name: heapless::String::new(),
        lat_lon_deg: None,
        local_east_north_m: None,
        depth_m: 4340.0,
        orientation_deg: 0.0,
        sound_speed_m_s: 1500.0,
        rate_hz,
        full_scale: 1 << 23,
        kind: Kind::Obs(ObsConfig {
            orientation_of_north_deg: 77.0,
            intensity_towards: false,
            compatibility: Default::default(),
            azigram: true,
        }),
        tracking: Tracking::default(),
        levels: Levels::default(),
        schedule: Schedule::default(),
        doubts: Default::default(),
        clips: Clips::default(),
    }
}

/// Image paths under 1500 m/s at 4340 m: first and second crossing only.
pub(crate) fn table(rate_hz: f64) -> &'static [u8] {
    let slant = |j: usize, n: f32| math::f32::hypot(70.0 * j as f32, 4340.0 * n) / 1500.0;
    let toa: Vec<f32> = (0..716).map(|j| slant(j, 1.0)).collect();
    let delay: Vec<f32> = (0..716).map(|j| slant(j, 3.0) - slant(j, 1.0)).collect();
    let (phase, strength) = (vec![0.0; 716], vec![0.05; 716]);
    let c = BranchColumns { delay_s: &delay, phase_rad: &phase, strength: &strength };
    let blob = Box::leak(Box::new([0; blob_bytes(1)]));
    let header = Header { step_m: 70.0, f0_hz: 16.5, width_s: 0.05 };
    encode(&header, inner_rate_hz(rate_hz) as f32, &toa, &[c], blob).unwrap();
    blob
}

pub(super) fn plan(rate_hz: f64) -> Plan<'static> {
    Plan::new(&config(rate_hz), &Table::parse(table(rate_hz)).unwrap()).unwrap()
}

/// Noise, with a tone at 15 Hz from `azimuth` (seen in pressure and, away from it, in velocity).
pub(crate) fn record(n: usize, rate_hz: f64, azimuth_deg: f64, tone: f64) -> Vec<Frame> {
    let mut seed = 12_345u32;
    let mut noise = move || {
        let mut sum = 0.0;
        for _ in 0..6 {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum += f64::from(seed >> 8) / 8_388_608.0 - 1.0;
        }
        1000.0 * sum
    };
    // Components: north at 77 degrees true, velocity away from the source.
    let relative = (azimuth_deg - 77.0 + 180.0).to_radians();
    (0..n)
        .map(|i| {
            let s = tone * math::f64::sin(math::f64::TAU * 15.03 * i as f64 / rate_hz);
            let (sin, cos) = math::f64::sin_cos(relative);
            [noise() + s, noise() + s * cos, noise() + s * sin, noise()].map(|x| x as i32)
        })
        .collect()
}

fn run(plan: &Plan<'_>, pieces: &[(u64, &[Frame])]) -> (Vec<Message>, Box<State>) {
    let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
    let mut out = Vec::new();
    let mut sink = |m| out.push(m);
    for (first_index, frames) in pieces {
        push(plan, &mut state, &mut scratch, Block { first_index: *first_index, frames }, &mut sink);
    }
    finish(plan, &mut state, &mut scratch, &mut sink);
    (out, state)
}

fn azimuths(messages: &[Message]) -> Vec<f32> {
    let detected = |m: &Message| match m {
        Message::Azimuth(a) if a.detected && a.kind == 0 => Some(a.azimuth.to_degrees()),
        _ => None,
    };
    messages.iter().filter_map(detected).collect()
}

#[test]
fn a_tone_is_found_where_it_comes_from_at_every_rate() {
    for rate in [50.0, 62.5, 200.0] {
        let frames = record((rate * 420.0) as usize, rate, 200.0, 1500.0);
        let (messages, _) = run(&plan(rate), &[(0, &frames)]);
        let a = azimuths(&messages);
        assert!(a.len() >= 4, "{rate}: {a:?}");
        assert!(a.iter().all(|a| (a - 200.0).abs() < 3.0), "{rate}: {a:?}");
    }
}

#[test]
fn a_tone_stands_in_the_azigram_of_every_minute_unless_none_is_wanted() {
    for rate in [50.0, 100.0] {
        let frames = record((400.0 * rate) as usize, rate, 200.0, 1500.0);
        let mut p = plan(rate);
        let found = |messages: &[Message]| -> Vec<Azigram> {
            messages
                .iter()
                .filter_map(|m| if let Message::Azigram(a) = m { Some(*a) } else { None })
                .collect()
        };
        let all = found(&run(&p, &[(0, &frames)]).0);
        assert!(all.windows(2).all(|w| w[1].index - w[0].index == (60.0 * rate) as u64), "{all:?}");
        assert!(all.len() >= 5, "{rate}: {}", all.len());
        for a in &all {
            let bin = (15.03 / f64::from(a.bin_hz)) as usize - usize::from(a.first_bin);
            let band = (0..AZIGRAM_BANDS).find(|b| bin < Azigram::edge(a.bins.into(), b + 1)).unwrap();
            let azimuth_deg = f64::from(a.azimuth[band]) * 360.0 / 256.0;
            assert!((azimuth_deg - 200.0).abs() < 30.0, "{rate}: {azimuth_deg} {a:?}");
            let others =
                a.coherence.iter().enumerate().filter(|(n, _)| n.abs_diff(band) > 1).map(|(_, c)| *c);
            assert!(a.coherence[band] > others.max().unwrap(), "{rate}: {band} {a:?}");
        }
        p.azigram = false;
        assert!(found(&run(&p, &[(0, &frames)]).0).is_empty());
    }
}

#[test]
fn noise_and_silence_say_nothing() {
    let frames = record(30_000, 50.0, 0.0, 0.0);
    let (messages, _) = run(&plan(50.0), &[(0, &frames)]);
    assert!(azimuths(&messages).is_empty());
    let (messages, state) = run(&plan(50.0), &[(0, &vec![[0; 4]; 30_000])]);
    assert!(azimuths(&messages).is_empty());
    assert_eq!(state.channel_flags() & 0xf, 0xf, "every channel is dead");
}

#[test]
fn the_length_of_blocks_does_not_matter() {
    let p = plan(50.0);
    let frames = record(20_000, 50.0, 120.0, 1500.0);
    let whole = run(&p, &[(0, &frames)]).0;
    let mut pieces: Vec<(u64, &[Frame])> = Vec::new();
    let mut at = 0;
    while at < frames.len() {
        let n = (7 + at % 613).min(frames.len() - at);
        pieces.push((at as u64, &frames[at..at + n]));
        at += n;
    }
    assert_eq!(format!("{whole:?}"), format!("{:?}", run(&p, &pieces).0));
}

#[test]
fn every_instant_is_accounted_for() {
    let p = plan(50.0);
    let mut frames = record(30_000, 50.0, 120.0, 1500.0);
    frames[9_000] = [MISSING; 4];
    frames[12_000..14_000].iter_mut().for_each(|f| f[0] = 1 << 23);
    frames[15_000..17_000].iter_mut().for_each(|f| f[0] = 77);
    // A gap of 1000 instants, and 500 that come twice.
    let pieces = [(0u64, &frames[..20_000]), (21_000, &frames[21_000..25_000]), (24_500, &frames[24_500..])];
    let (messages, state) = run(&p, &pieces);
    let a = state.accounting();
    assert_eq!(a.total(), 30_000 + 500, "{a:?}");
    assert!(a.lost.iter().all(|n| *n > 0), "{a:?}");
    assert!(messages.iter().filter(|m| matches!(m, Message::Fault(_))).count() >= 5);
    assert!(azimuths(&messages).iter().all(|a| (a - 120.0).abs() < 3.0));
}

#[test]
fn a_twentieth_of_the_sample_lines_frames_lost_or_damaged_costs_little_more() {
    let p = plan(50.0);
    let frames = record(60_000, 50.0, 120.0, 1500.0);
    let (all, state) = run(&p, &[(0, &frames)]);
    let before = state.accounting().processed;
    let mut seed = 5u32;
    let mut hit = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        seed >> 8 < (1 << 24) / 20
    };
    let hits: Vec<bool> = frames.chunks(8).map(|_| hit()).collect();
    // Frames of eight instants that did not come, and frames whose codes are no codes.
    let lost: Vec<(u64, &[Frame])> = frames
        .chunks(8)
        .enumerate()
        .filter(|(k, _)| !hits[*k])
        .map(|(k, frames)| (8 * k as u64, frames))
        .collect();
    let mut damaged = frames.clone();
    for (frames, _) in damaged.chunks_mut(8).zip(&hits).filter(|(_, hit)| **hit) {
        frames.fill([MISSING; 4]);
    }
    let pieces: [(u64, &[Frame]); 1] = [(0, &damaged)];
    let n = 8 * hits.iter().filter(|hit| **hit).count() as u64;
    for (pieces, bucket) in [(&lost[..], 0), (&pieces[..], 2)] {
        let (messages, state) = run(&p, pieces);
        let a = state.accounting();
        assert_eq!(a.total(), 60_000, "{a:?}");
        assert!(a.lost[bucket] >= n && a.processed * 100 >= before * 90, "{n} hit: {a:?}");
        let found = azimuths(&messages);
        assert!(found.len() * 10 >= azimuths(&all).len() * 9, "{} of {}", found.len(), azimuths(&all).len());
        assert!(found.iter().all(|a| (a - 120.0).abs() < 3.0), "{found:?}");
        let faults = messages.iter().filter(|m| matches!(m, Message::Fault(_))).count();
        assert!(faults <= 3 * 20, "{faults} in 20 minutes");
    }
}

#[test]
fn a_bad_sample_costs_itself_and_points_nowhere() {
    let p = plan(50.0);
    let (frames, noise) = (record(60_000, 50.0, 120.0, 1500.0), record(60_000, 50.0, 0.0, 0.0));
    let (all, state) = run(&p, &[(0, &frames)]);
    let used = state.accounting().processed;
    let right = |messages: &[Message], what: &str| {
        let found = azimuths(messages);
        assert!(found.len() * 20 >= azimuths(&all).len() * 19, "{what}: {} azimuths", found.len());
        assert!(found.iter().all(|a| (a - 120.0).abs() < 3.0), "{what}: {found:?}");
    };
    // The noise has a standard deviation of 1414, the tone an amplitude of 1500.
    for (height, every) in [(20_000, 1_500), (400_000, 1_500), (400_000, 200)] {
        let spiked = |frames: &[Frame]| {
            let mut hit = frames.to_vec();
            hit.iter_mut().skip(700).step_by(every).for_each(|f| f.iter_mut().for_each(|x| *x += height));
            hit
        };
        let (messages, state) = run(&p, &[(0, &spiked(&frames))]);
        right(&messages, &format!("spikes of {height} every {every}"));
        let a = state.accounting();
        let n = (60_000 / every) as u64;
        assert_eq!(a.total(), 60_000);
        assert!((n * 9 / 10..=n).contains(&a.lost[LossCause::Invalid as usize]), "{n} spikes: {a:?}");
        assert!(a.processed + n + 512 >= used, "{a:?}");
        assert!(azimuths(&run(&p, &[(0, &spiked(&noise))]).0).is_empty(), "{height} every {every}");
    }
    // Clipped at 2.3 standard deviations of the whole, at full scale and at a rail below it.
    for (limit, full_scale) in [(4_000, 4_001), (4_000, 1 << 23)] {
        let p = Plan::new(&StationConfig { full_scale, ..config(50.0) }, &Table::parse(table(50.0)).unwrap())
            .unwrap();
        let mut clipped = frames.clone();
        clipped.iter_mut().for_each(|f| f.iter_mut().for_each(|x| *x = (*x).clamp(-limit, limit)));
        let (messages, state) = run(&p, &[(0, &clipped)]);
        right(&messages, &format!("clipped at {limit} of {full_scale}"));
        let a = state.accounting();
        let at_limit = clipped.iter().filter(|f| f[..3].iter().any(|x| x.abs() == limit)).count() as u64;
        assert_eq!(a.total(), 60_000);
        let lost = a.lost[LossCause::Clipped as usize];
        assert!(lost > 0 && lost <= at_limit && a.processed + lost + 512 >= used, "{at_limit}: {a:?}");
    }
}

#[test]
fn clipping_costs_as_much_at_every_rate() {
    // At 2.2 and 1.4 standard deviations of the whole, at full scale and at a rail below it: 3 and 16 % of the samples.
    for (limit, full_scale) in [(3_900, 3_901), (3_900, 1 << 23), (2_500, 1 << 23)] {
        let heard = |rate_hz: f64| {
            let config = StationConfig { full_scale, ..config(rate_hz) };
            let p = Plan::new(&config, &Table::parse(table(rate_hz)).unwrap()).unwrap();
            let mut frames = record((rate_hz * 420.0) as usize, rate_hz, 120.0, 1500.0);
            frames.iter_mut().for_each(|f| f.iter_mut().for_each(|x| *x = (*x).clamp(-limit, limit)));
            let (messages, state) = run(&p, &[(0, &frames)]);
            let told =
                messages.iter().any(|m| matches!(m, Message::Fault(f) if f.code == FaultCode::Clipping));
            let lost = state.accounting().lost[LossCause::Clipped as usize] as f64 / frames.len() as f64;
            (azimuths(&messages).len(), told, lost)
        };
        let (found, told, lost) = heard(50.0);
        assert!(told && lost > 0.01, "{limit}: {found} {told} {lost}");
        for rate_hz in [125.0, 500.0] {
            let at_rate = heard(rate_hz);
            let alike = at_rate.1 && at_rate.0.abs_diff(found) <= 1 && (at_rate.2 / lost - 1.0).abs() < 0.4;
            assert!(
                alike,
                "{limit} of {full_scale} at {rate_hz} Hz: {at_rate:?}, at 50 Hz {:?}",
                (found, told, lost)
            );
        }
    }
}

#[test]
fn an_index_near_the_end_of_all_numbers_ends_nothing() {
    let p = plan(50.0);
    let frames = record(20_000, 50.0, 120.0, 1500.0);
    for index in [u64::MAX, u64::MAX - 1000, u64::MAX / 2, 1 << 60] {
        let pieces = [(0u64, &frames[..12_000]), (index, &[[MISSING; 4]][..]), (12_000, &frames[12_000..])];
        let (messages, state) = run(&p, &pieces);
        assert_eq!(azimuths(&messages), azimuths(&run(&p, &[(0, &frames)]).0), "{index}");
        assert_eq!(state.accounting().total(), 20_001);
        let (messages, _) = run(&p, &pieces[..2]);
        assert!(messages.iter().all(|m| !matches!(m, Message::Fault(f) if f.value < 0)), "{messages:?}");
    }
}

#[test]
fn the_level_of_what_is_not_heard_is_not_the_last_that_was() {
    let p = plan(50.0);
    let mut frames = record(20_000, 50.0, 120.0, 1500.0);
    frames[10_000..].iter_mut().for_each(|f| f[1] = 7);
    let (_, state) = run(&p, &[(0, &frames)]);
    let [pressure, north, ..] = state.level_half_db(&p);
    assert!(north == i8::MIN && (-160..-100).contains(&i32::from(pressure)), "{pressure} {north}");
    frames[10_000..].fill([MISSING; 4]);
    let (_, state) = run(&p, &[(0, &frames)]);
    assert_eq!(state.level_half_db(&p), [i8::MIN; 4]);
}

#[test]
fn a_component_without_samples_is_a_dead_channel_and_takes_only_its_share_with_it() {
    let p = plan(50.0);
    let frames = record(60_000, 50.0, 120.0, 1500.0);
    let faults = |messages: &[Message], code| {
        messages.iter().filter(|m| matches!(m, Message::Fault(f) if f.code == code)).count()
    };
    let lost = |channel: usize, from: usize, to: usize| {
        let mut with = frames.clone();
        with[from..to].iter_mut().for_each(|f| f[channel] = MISSING);
        let (messages, state) = run(&p, &[(0, &with)]);
        let hops = state.accounting().processed;
        (messages, hops)
    };
    // The vertical is not used: nothing but the fault.
    let (all, hops) = run(&p, &[(0, &frames)]);
    let (without_vertical, same) = lost(3, 0, frames.len());
    assert_eq!((azimuths(&without_vertical), same), (azimuths(&all), hops.accounting().processed));
    assert_eq!(faults(&without_vertical, FaultCode::DeadChannel), 1);
    // A horizontal for a while: fewer azimuths, every instant still used for ranges.
    let (messages, same) = lost(1, 20_000, 40_000);
    assert_eq!(same, hops.accounting().processed);
    let n = azimuths(&messages).len();
    assert!(n > 0 && n < azimuths(&all).len(), "{n}");
    assert!(azimuths(&messages).iter().all(|a| (a - 120.0).abs() < 3.0));
    assert_eq!(
        (faults(&messages, FaultCode::DeadChannel), faults(&messages, FaultCode::ChannelBack)),
        (1, 1)
    );
    // Pressure: nothing goes on while it is away.
    let (messages, fewer) = lost(0, 20_000, 40_000);
    assert!(fewer < hops.accounting().processed - 15_000 && faults(&messages, FaultCode::Invalid) > 0);
}

#[test]
fn a_clock_set_back_or_far_ahead_is_survived() {
    let p = plan(50.0);
    let frames = record(20_000, 50.0, 120.0, 1500.0);
    let pieces = [(5_000_000u64, &frames[..]), (0, &frames[..]), (900_000_000, &frames[..])];
    let (messages, _) = run(&p, &pieces);
    let a = azimuths(&messages);
    assert!(a.len() >= 9 && a.iter().all(|a| (a - 120.0).abs() < 3.0), "{a:?}");
}

#[test]
fn everything_fits_the_recorder() {
    let (state, scratch, plan) = (size_of::<State>(), size_of::<Scratch>(), size_of::<Plan<'_>>());
    std::println!("state {state} B, scratch {scratch} B, plan {plan} B");
    assert!(state + scratch + plan <= 176 * 1024, "{state} + {scratch} + {plan}");
}
