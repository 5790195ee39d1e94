//! Bearings of the whole array chain on made signals: what must not change, and a second source.

use seabearing::reproduce::bearing_limit::{bearings, station};
use seabearing::reproduce::bearing_limit_source::{AmbientField, Sounder, exact_arrivals};
use seabearing_core::angle::wrap_pi;
use seabearing_core::array::{Plan, Scratch, State, finish, push};
use seabearing_core::block::{Block, Frame};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::wire::{Bearing, FaultCode, Message};

const SAMPLES: usize = 1 << 17;

fn configured(change: impl FnOnce(&mut StationConfig)) -> Plan {
    let mut config = station();
    change(&mut config);
    Plan::new(&config).unwrap()
}

fn record(azimuth: f64, elevation: f64, snr_db: f64, seed: u64) -> Vec<Frame> {
    let plan = configured(|_| {});
    let sounder = Sounder::new(plan.geometry(), 64_000.0, SAMPLES, AmbientField::Independent);
    sounder.record(seed, 2e4, Some((snr_db, exact_arrivals(plan.geometry(), azimuth, elevation, 500.0))))
}

fn error_deg(b: &Bearing, azimuth: f64, elevation: f64) -> f64 {
    let da = wrap_pi(f64::from(b.azimuth) - azimuth) * elevation.cos();
    da.hypot(f64::from(b.elevation) - elevation).to_degrees()
}

fn whole(b: &[Bearing]) -> Vec<Bearing> {
    b.iter().filter(|b| b.flags == 0 && b.band == 0).copied().collect()
}

#[test]
fn turning_the_array_turns_the_bearing() {
    let frames = record(1.0, 0.3, 5.0, 1);
    let straight = whole(&bearings(&configured(|_| {}), &frames));
    let turned = whole(&bearings(&configured(|c| c.orientation_deg = 70.0), &frames));
    assert_eq!((straight.len(), turned.len()), (3, 3));
    for (a, b) in straight.iter().zip(&turned) {
        let turn = wrap_pi(f64::from(b.azimuth) - f64::from(a.azimuth)).to_degrees();
        assert!((turn - 70.0).abs() < 1e-3, "{turn}");
        assert!((a.elevation - b.elevation).abs() < 1e-5);
    }
}

#[test]
fn channels_may_be_connected_in_any_order() {
    let frames = record(4.0, 0.1, 0.0, 2);
    let order = [2usize, 0, 3, 1];
    let mixed: Vec<Frame> = frames.iter().map(|f| std::array::from_fn(|c| f[order[c]])).collect();
    // Hydrophone h is on the recorder channel that carries it.
    let channels = std::array::from_fn(|h| order.iter().position(|o| *o == h).unwrap() as u8);
    let plan = configured(|c| {
        if let Kind::Array(a) = &mut c.kind {
            a.channels = channels;
        }
    });
    let straight = bearings(&configured(|_| {}), &frames);
    assert_eq!(straight, bearings(&plan, &mixed));
    assert!(straight.len() >= 3);
}

#[test]
fn time_comes_from_the_sample_index_and_block_length_does_not_matter() {
    let plan = configured(|_| {});
    let frames = record(2.0, 0.2, 10.0, 3);
    let run = |first: u64, block: usize| {
        let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
        let mut out = Vec::new();
        let mut index = first;
        for part in frames.chunks(block) {
            let sink = &mut |m: Message| out.push(m);
            push(&plan, &mut state, &mut scratch, Block { first_index: index, frames: part }, sink);
            index += part.len() as u64;
        }
        finish(&plan, &mut state, &mut scratch, &mut |m| out.push(m));
        out.into_iter()
            .filter_map(|m| if let Message::Bearing(b) = m { Some(b) } else { None })
            .collect::<Vec<_>>()
    };
    let base = run(0, 4096);
    assert_eq!(base, run(0, 777));
    // A whole number of steps later, everything is the same but the time.
    let shift = 32_000 * 1_000_003;
    let later = run(shift, 4096);
    assert_eq!(base.len(), later.len());
    for (a, b) in base.iter().zip(&later) {
        assert_eq!(Bearing { index: a.index + shift, ..*a }, *b);
    }
}

#[test]
fn a_known_near_range_removes_the_bias_of_the_reference_range() {
    let plan = configured(|_| {});
    let sounder = Sounder::new(plan.geometry(), 64_000.0, SAMPLES, AmbientField::Independent);
    let frames = sounder.record(5, 2e4, Some((10.0, exact_arrivals(plan.geometry(), 1.0, 0.5, 30.0))));
    let run = |range_m: Option<f32>| {
        let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
        state.set_places(range_m.map(|r| (1.0, r, 0.0)).into_iter());
        let mut worst = 0.0f64;
        let mut sink = |m: Message| {
            if let Message::Bearing(b) = m
                && b.flags == 0
            {
                worst = worst.max(error_deg(&b, 1.0, 0.5));
            }
        };
        push(&plan, &mut state, &mut scratch, Block { first_index: 0, frames: &frames }, &mut sink);
        finish(&plan, &mut state, &mut scratch, &mut sink);
        worst
    };
    assert!(run(Some(30.0)) < 0.01 && run(None) > 0.03, "{} {}", run(Some(30.0)), run(None));
}

#[test]
fn a_quieter_second_source_is_seen_and_a_single_one_has_no_ghost() {
    let plan = configured(|_| {});
    let sounder = Sounder::new(plan.geometry(), 64_000.0, 1 << 20, AmbientField::Independent);
    let loud = exact_arrivals(plan.geometry(), 1.0, 0.3, 500.0);
    let quiet = exact_arrivals(plan.geometry(), 2.2, 0.1, 500.0);
    let alone = sounder.record(6, 2e4, Some((10.0, loud)));
    assert_eq!(bearings(&plan, &alone).iter().filter(|b| b.band != 0).count(), 0);
    let mut both = alone;
    // The second record's own noise is 40 dB down.
    for (a, b) in both.iter_mut().zip(sounder.record(7, 2e2, Some((43.0, quiet)))) {
        *a = std::array::from_fn(|c| a[c] + b[c]);
    }
    let got = bearings(&plan, &both);
    let second: Vec<_> = got.iter().filter(|b| b.band == 1).collect();
    assert!(second.len() >= 2, "{} found", second.len());
    assert!(second.iter().all(|b| error_deg(b, 2.2, 0.1) < 0.5), "{second:?}");
    assert!(got.iter().filter(|b| b.band == 0).all(|b| error_deg(b, 1.0, 0.3) < 0.1));
}

#[test]
fn swapped_channels_of_an_irregular_array_are_noticed() {
    let plan = configured(|c| {
        if let Kind::Array(a) = &mut c.kind {
            a.hydrophones_m = [[0.0, 0.0, 0.0], [1.2, 0.2, 0.1], [0.1, 1.7, 0.3], [0.4, 0.3, 0.9]];
        }
    });
    let sounder = Sounder::new(plan.geometry(), 64_000.0, 1 << 18, AmbientField::Independent);
    let mut frames = sounder.record(8, 2e4, Some((10.0, exact_arrivals(plan.geometry(), 0.7, 0.2, 500.0))));
    let faults = |frames: &[Frame]| {
        let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
        let mut n = 0;
        let mut sink = |m: Message| {
            n += u32::from(matches!(m, Message::Fault(f) if f.code == FaultCode::Inconsistent));
        };
        push(&plan, &mut state, &mut scratch, Block { first_index: 0, frames }, &mut sink);
        n
    };
    assert_eq!(faults(&frames), 0);
    frames.iter_mut().for_each(|f| f.swap(1, 2));
    assert_eq!(faults(&frames), 1);
}
