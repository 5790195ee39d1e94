//! The recorder as a whole: what it says must not depend on how the samples are cut into blocks, every sample must
//! be accounted for whatever happens to the stream, and the configuration must be what telemetry says it is.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use seabearing::station::Station;
use seabearing_core::block::{Block, Frame, MISSING};
use seabearing_core::recorder::Memory;
use seabearing_core::run::Application;
use seabearing_core::wire::{Command, FaultCode, Message};
use seabearing_tests::array_station;

fn station() -> Station {
    array_station(16_000, "")
}

/// White noise on every hydrophone and one white source due east at the horizontal, in whole-sample delays.
fn recording(seconds: usize) -> Vec<Frame> {
    modulated(seconds, 0.0)
}

/// The same, the source's power swinging by `depth` at 5 Hz.
fn modulated(seconds: usize, depth: f64) -> Vec<Frame> {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let n = seconds * 16_000;
    let swing = |i: usize| 1.0 + depth * (std::f64::consts::TAU * 5.0 * i as f64 / 16_000.0).sin();
    let source: Vec<f64> = (0..n + 64).map(|i| swing(i).sqrt() * normal()).collect();
    let east = [0.0, 0.92, -0.92, 0.0];
    let delay = east.map(|x: f64| (32.0 - x / 1484.0 * 16_000.0).round() as usize);
    (0..n).map(|i| delay.map(|d| ((source[i + 64 - d] * 2.0 + normal()) * 20_000.0) as i32)).collect()
}

/// Runs the recorder over runs of samples, each with its first index, in blocks of at most `block`.
fn listen(runs: &[(u64, &[Frame])], block: impl FnMut() -> usize) -> Vec<Message> {
    listen_at(&station(), runs, block)
}

fn listen_at(station: &Station, runs: &[(u64, &[Frame])], mut block: impl FnMut() -> usize) -> Vec<Message> {
    let mut memory = Box::<Memory<'_>>::default();
    let mut recorder = memory.configure(&station.config, None).unwrap();
    let mut heard = Vec::new();
    let mut sink = |m: &Message| heard.push(*m);
    recorder.start(0, &mut sink);
    for (first, frames) in runs {
        let mut at = 0;
        while at < frames.len() {
            let n = block().clamp(1, frames.len() - at);
            recorder.push(Block { first_index: first + at as u64, frames: &frames[at..at + n] }, &mut sink);
            at += n;
        }
    }
    recorder.finish(&mut sink);
    heard
}

fn last_health(messages: &[Message]) -> seabearing_core::wire::Health {
    messages.iter().rev().find_map(|m| if let Message::Health(h) = m { Some(*h) } else { None }).unwrap()
}

#[test]
fn a_source_due_east_is_found_and_the_blocks_do_not_matter() {
    let samples = recording(8);
    let whole = listen(&[(0, &samples)], || usize::MAX);
    let bearings: Vec<_> =
        whole.iter().filter_map(|m| if let Message::Bearing(b) = m { Some(*b) } else { None }).collect();
    assert!(bearings.len() >= 8, "{} bearings in 8 s", bearings.len());
    for b in bearings.iter().filter(|b| b.band == 0) {
        // Whole-sample delays at 16 kHz are up to half a sample (46 µm/s · c = 4.6 cm) off on a 1.84 m base.
        assert!((f64::from(b.azimuth).to_degrees() - 90.0).abs() < 2.5, "{b:?}");
        assert!(b.var_azimuth > 0.0 && b.var_azimuth.is_finite() && (0.0..=1.0).contains(&b.quality));
    }
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    assert_eq!(whole, listen(&[(0, &samples)], || 512));
    assert_eq!(whole, listen(&[(0, &samples)], || rng.random_range(1..3000)));
    assert_eq!(whole, listen(&[(0, &samples[..777]), (777, &samples[777..])], || 100_000));
}

#[test]
fn a_shaft_rate_becomes_the_measured_speed_of_the_only_vessel() {
    let curve = "[tracking]\nspeed_from_shaft = { at_zero_m_s = 0.5, metres_a_turn = 1.4, sd_m_s = 0.3 }\n";
    let station = array_station(16_000, curve);
    let samples = modulated(36, 0.5);
    let heard = listen_at(&station, &[(0, &samples)], || usize::MAX);
    let rates: Vec<_> =
        heard.iter().filter_map(|m| if let Message::ShaftRate(s) = m { Some(*s) } else { None }).collect();
    let rate = rates.last().expect("a rate within 36 s");
    assert!((rate.rate_hz - 5.0).abs() < 0.01 && rate.confidence > 0.999, "{rate:?}");
    // 0.5 + 1.4 · 5 m/s; one vessel, so it is that one's.
    assert!((rate.speed_m_s - 7.5).abs() < 0.05 && (rate.sd_speed_m_s - 0.3).abs() < 0.01, "{rate:?}");
    let track =
        heard.iter().rev().find_map(|m| if let Message::Track(t) = m { Some(*t) } else { None }).unwrap();
    assert_eq!(rate.track, track.id);
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    assert_eq!(heard, listen_at(&station, &[(0, &samples)], || rng.random_range(1..3000)));
    // Without modulation there is none, and without a curve a rate but no speed.
    let steady = listen_at(&station, &[(0, &recording(36))], || 4096);
    assert!(!steady.iter().any(|m| matches!(m, Message::ShaftRate(_))));
    let plain = listen(&[(0, &samples)], || 4096);
    assert!(
        plain.iter().any(|m| matches!(m, Message::ShaftRate(s) if s.speed_m_s.is_infinite() && s.track == 0))
    );
}

#[test]
fn every_sample_is_processed_or_in_one_bucket() {
    let mut samples = recording(6);
    for frame in &mut samples[40_000..40_050] {
        frame[2] = MISSING;
    }
    for frame in &mut samples[60_000..63_000] {
        frame[1] = (1 << 23) - 1;
    }
    let jump = 12_345;
    let (a, b) = samples.split_at(30_001);
    let heard = listen(&[(0, a), (a.len() as u64 + jump, b)], || 640);
    let health = last_health(&heard);
    let total = health.processed + health.lost.iter().sum::<u64>();
    assert_eq!(total, samples.len() as u64 + jump, "{health:?}");
    assert_eq!(health.lost[0], jump);
    // The fifty instants without the third hydrophone, and in some frames what the others had.
    assert!(health.lost[2] == 50 && health.lost[4] > 0, "{health:?}");
    let dead =
        |m: &&Message| matches!(m, Message::Fault(f) if f.code == FaultCode::DeadChannel && f.value == 2);
    assert_eq!(heard.iter().filter(dead).count(), 1, "its own trouble, not everyone's");
    assert!(heard.iter().any(|m| matches!(m, Message::Fault(f) if f.code == FaultCode::Gap)));
    let invalid = heard.iter().filter(|m| matches!(m, Message::Fault(f) if f.code == FaultCode::Invalid));
    assert_eq!(invalid.count(), 1, "one row of invalid samples, one fault");
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    assert_eq!(heard, listen(&[(0, a), (a.len() as u64 + jump, b)], || rng.random_range(1..900)));
}

#[test]
fn a_dead_channel_is_named_and_gives_no_bearing() {
    let mut samples = recording(4);
    for frame in &mut samples {
        frame[3] = 0;
    }
    let heard = listen(&[(0, &samples)], || 1000);
    assert!(
        heard
            .iter()
            .any(|m| matches!(m, Message::Fault(f) if f.code == FaultCode::DeadChannel && f.value == 3))
    );
    assert!(!heard.iter().any(|m| matches!(m, Message::Bearing(_))));
    assert_eq!(last_health(&heard).channels & 0b1000, 0b1000);
}

#[test]
fn telemetry_names_the_configuration_it_ran_with() {
    let config = station().config;
    let mut memory = Box::<Memory<'_>>::default();
    let mut recorder = memory.configure(&config, None).unwrap();
    let mut heard = Vec::new();
    recorder.start(1, &mut |m| heard.push(*m));
    recorder.command(Command::Identify { token: 5 }, &mut |m| heard.push(*m));
    let hellos: Vec<_> =
        heard.iter().filter_map(|m| if let Message::Hello(h) = m { Some(*h) } else { None }).collect();
    assert_eq!(hellos.len(), 2);
    assert!(hellos.iter().all(|h| h.config_hash == config.hash() && h.station == 7));
    assert!(heard.iter().any(|m| matches!(m, Message::Reply(r) if r.token == 5 && r.status == 0)));
}

#[test]
fn one_invalid_instant_in_500_costs_a_few_per_cent_and_is_said() {
    let clean = recording(8);
    let mut samples = clean.clone();
    samples.iter_mut().skip(77).step_by(500).for_each(|f| *f = [MISSING; 4]);
    let missing = samples.iter().filter(|f| f[0] == MISSING).count() as u64;
    let bearings = |heard: &[Message]| -> Vec<_> {
        heard.iter().filter_map(|m| if let Message::Bearing(b) = m { Some(*b) } else { None }).collect()
    };
    let (before, heard) = (listen(&[(0, &clean)], || 512), listen(&[(0, &samples)], || 512));
    let health = last_health(&heard);
    assert_eq!(health.lost[2], missing);
    assert!(health.processed * 100 >= last_health(&before).processed * 97, "{health:?}");
    assert!(bearings(&heard).len() >= bearings(&before).len());
    for b in bearings(&heard).iter().filter(|b| b.band == 0) {
        assert!((f64::from(b.azimuth).to_degrees() - 90.0).abs() < 2.5 && b.flags & 2 != 0, "{b:?}");
    }
    assert!(bearings(&before).iter().filter(|b| b.band == 0).skip(1).any(|b| b.flags & 2 == 0));
    // Three faults, and one message for all the others.
    let faults = heard.iter().filter(|m| matches!(m, Message::Fault(_))).count();
    let held: Vec<_> =
        heard.iter().filter_map(|m| if let Message::FaultsHeld(h) = m { Some(*h) } else { None }).collect();
    assert!(faults == 3 && held.len() == 1, "{faults} {held:?}");
    assert_eq!(
        (held[0].code, held[0].count, held[0].value),
        (FaultCode::Invalid, missing as u32 - 3, missing as i64 - 3)
    );
}

#[test]
fn a_hydrophone_that_dies_loses_its_level() {
    let mut samples = recording(4);
    samples[2 * 16_000..].iter_mut().for_each(|f| f[3] = 100);
    let health = last_health(&listen(&[(0, &samples)], || 1000));
    assert!(health.level_half_db[3] == i8::MIN && health.level_half_db[0] > -120, "{health:?}");
}

#[test]
fn a_silent_source_is_named_and_health_goes_on_by_the_clock() {
    let mut memory = Box::<Memory<'_>>::default();
    let mut recorder = memory.configure(&station().config, None).unwrap();
    let mut heard = Vec::new();
    recorder.start(0, &mut |m| heard.push(*m));
    for second in 1..=150 {
        recorder.silent(second, &mut |m| heard.push(*m));
        recorder.fault(FaultCode::BadCommand, u64::from(second), &mut |m| heard.push(*m));
    }
    let silent = heard
        .iter()
        .filter(|m| matches!(m, Message::Fault(f) if f.code == FaultCode::NoSamples && f.value == 10));
    assert_eq!(silent.count(), 1);
    assert_eq!(heard.iter().filter(|m| matches!(m, Message::Health(_))).count(), 2);
    // Commands that cannot be read: three a minute, and how many more.
    let bad = heard.iter().filter(|m| matches!(m, Message::Fault(f) if f.code == FaultCode::BadCommand));
    assert_eq!(bad.count(), 9);
    let held: u32 =
        heard.iter().filter_map(|m| if let Message::FaultsHeld(h) = m { Some(h.count) } else { None }).sum();
    assert_eq!(held, 59 - 3 + 60 - 3);
}

#[test]
fn a_second_configuration_starts_afresh() {
    let samples = recording(8);
    let mut memory = Box::<Memory<'_>>::default();
    let mut go = || {
        let mut recorder = memory.configure(&station().config, None).unwrap();
        let mut heard = Vec::new();
        recorder.start(0, &mut |m| heard.push(*m));
        recorder.push(Block { first_index: 0, frames: &samples }, &mut |m| heard.push(*m));
        recorder.finish(&mut |m| heard.push(*m));
        heard
    };
    assert_eq!(go(), go());
}
