//! A vessel that moves past a tetrahedron two of whose channels are exchanged, or one of which is late, from one moment on.

use super::super::jump::arrivals;
use super::super::test_sea::{error_from, hear, noisy, planned, source, standardised};
use super::*;
use crate::angle::unit_vector;
use crate::geometry::PAIRS;
use crate::wire::{Bearing, FaultCode};
use std::vec::Vec;

const RATE: f64 = 16_000.0;
const SECONDS: u64 = 16;
/// When the channels change, in the midst of a segment.
const FROM: usize = (4.3 * RATE) as usize;

/// Without symmetry.
fn plan() -> Plan {
    planned(RATE, |array| {
        array.hydrophones_m =
            [[0.0, 1.06, -0.28], [0.92, -0.43, -0.45], [-0.80, -0.61, -0.38], [0.12, 0.0, 1.02]];
    })
}

/// A source that turns by 0.2° each quarter of a second.
fn passing(plan: &Plan, from: f64, seed: u64) -> Vec<[f64; CHANNELS]> {
    let rms = 2.0;
    let part = |n: u64| {
        let sea = source(plan, (from + 0.0035 * n as f64, 0.3), rms, None, 1, 31 * seed + n);
        sea.into_iter().take(RATE as usize / 4)
    };
    noisy((0..4 * SECONDS).flat_map(part).collect(), seed)
}

fn direction(from: f64, b: &Bearing) -> (f64, f64) {
    (from + 0.0035 * (b.index as f64 / RATE * 4.0 - 0.5), 0.3)
}

/// Names of the faults and the bearings after the change, that are wrong and that are right.
fn after(from: f64, seed: u64, spoil: impl Fn(&mut [[f64; CHANNELS]])) -> (Vec<FaultCode>, usize, usize) {
    after_of(0, from, seed, spoil)
}

/// The same of a recording that begins so many samples later.
fn after_of(
    begin: usize,
    from: f64,
    seed: u64,
    spoil: impl Fn(&mut [[f64; CHANNELS]]),
) -> (Vec<FaultCode>, usize, usize) {
    let plan = plan();
    let mut sea = passing(&plan, from, seed);
    spoil(&mut sea[FROM..]);
    let mut heard = hear(&plan, &sea[begin..]);
    heard.bearings.iter_mut().for_each(|b| b.index += begin as u64);
    let codes = heard.faults.iter().map(|f| f.0).filter(|f| *f != FaultCode::Impulses).collect();
    let later = heard.bearings.iter().filter(|b| b.band == 0 && b.index as usize > FROM + 8000);
    let (mut wrong, mut right) = (0, 0);
    for b in later {
        let at = direction(from, b);
        let (across, up) = error_from(b, at);
        if standardised(b, at) > 16.0 && across.hypot(up) > 0.003 { wrong += 1 } else { right += 1 }
    }
    (codes, wrong, right)
}

#[test]
fn a_vessel_that_moves_evenly_is_no_change() {
    for n in 0..6u64 {
        let (codes, wrong, right) = after(n as f64, n, |_| {});
        assert!(codes.is_empty() && wrong == 0 && right > 15, "{n}: {codes:?} {wrong} {right}");
    }
}

#[test]
fn pairs_that_go_from_a_vessel_to_its_image_are_no_change() {
    // So far above the array that upright pairs hear both apart.
    let plan = planned(64_000.0, |array| array.vessel_depth_m = 8.0);
    for n in 0..4u64 {
        let part = |k: u64, up: f64| {
            source(&plan, (1.5 * n as f64 + 0.004 * k as f64, up), 3.0, None, 1, 900 + 70 * n + k)
        };
        let mut sea = Vec::new();
        for k in 0..40 {
            let (direct, image) = (part(k, 0.36), part(k, 0.41));
            sea.extend(
                direct[150..150 + 16_000].iter().zip(&image).map(|(direct, image)| {
                    core::array::from_fn::<f64, CHANNELS, _>(|c| direct[c] - image[c])
                }),
            );
        }
        let faults = hear(&plan, &noisy(sea, n)).faults;
        assert!(faults.iter().all(|f| f.0 == FaultCode::Impulses), "{n}: {faults:?}");
    }
}

#[test]
fn a_vessel_that_turns_ever_faster_as_it_comes_near_is_no_change() {
    let mut plan = planned(64_000.0, |array| array.vessel_depth_m = 4.0);
    (plan.depth_m, plan.vessel_over_array_depth) = (30.0, 4.0 / 30.0);
    for n in 0..4u64 {
        let mut sea = Vec::new();
        for k in 0..44 {
            // 8 m/s, 32 m aside at its closest in 3 s.
            let along = 8.0 * (0.25 * k as f64 - 14.0);
            let azimuth = 1.5 * n as f64 + along.atan2(32.0);
            let up = 30.0f64.atan2(along.hypot(32.0));
            let heard = source(&plan, (azimuth, up), 3.0, None, 1, 1300 + 70 * n + k);
            sea.extend_from_slice(&heard[150..150 + 16_000]);
        }
        let faults = hear(&plan, &noisy(sea, n)).faults;
        assert!(faults.iter().all(|f| f.0 == FaultCode::Impulses), "{n}: {faults:?}");
    }
}

#[test]
fn a_channel_that_becomes_late_is_noticed_wherever_the_vessel_is() {
    // Where pairs contradict each other as exchanged channels' do, none is told.
    let mut told = 0;
    for n in 0..12u64 {
        let channel = n as usize % CHANNELS;
        let (codes, wrong, right) = after(0.5 * n as f64, n, |sea| {
            for i in (1..sea.len()).rev() {
                sea[i][channel] = sea[i - 1][channel];
            }
        });
        assert_eq!((codes, wrong), (std::vec![FaultCode::Inconsistent], 0), "{n}");
        told += usize::from(right > 10);
    }
    assert!(told >= 9, "{told}");
}

#[test]
fn of_exchanged_channels_no_bearing_is_told() {
    for n in 0..12u64 {
        let (i, j) = PAIRS[n as usize % PAIRS.len()];
        let (codes, wrong, right) =
            after(0.3 + 0.5 * n as f64, n, |sea| sea.iter_mut().for_each(|x| x.swap(i, j)));
        assert_eq!((codes, wrong), (std::vec![FaultCode::Inconsistent], 0), "{n}");
        assert!(right <= 1, "{n}: {right}");
    }
}

#[test]
fn of_channels_that_change_places_three_or_four_at_once_no_bearing_is_told() {
    // Slips by one, two and three, pairs of two lines each exchanged, and three in a ring.
    let orders =
        [[1, 2, 3, 0], [2, 3, 0, 1], [3, 0, 1, 2], [1, 0, 3, 2], [3, 2, 1, 0], [1, 2, 0, 3], [0, 3, 1, 2]];
    for (n, held) in (0..).zip(orders.into_iter().cycle().take(14)) {
        let slip = |sea: &mut [[f64; CHANNELS]]| sea.iter_mut().for_each(|x| *x = held.map(|h: usize| x[h]));
        let (codes, wrong, right) = after(0.3 + 0.5 * n as f64, n, slip);
        // Some vessel is heard as with a channel inverted as well.
        assert!(codes.first() == Some(&FaultCode::Inconsistent) && wrong == 0, "{n}: {codes:?} {wrong}");
        assert!(right <= 1, "{n}: {right}");
    }
}

/// When another channel falls silent.
const SILENT: usize = FROM + 5 * RATE as usize;

#[test]
fn what_four_hydrophones_told_of_exchanged_channels_three_do_not_forget() {
    for n in 0..6u64 {
        let (i, j) = PAIRS[n as usize % PAIRS.len()];
        // One of the two, and one beside.
        for silent in [i, (0..CHANNELS).find(|h| ![i, j].contains(h)).unwrap()] {
            let (codes, wrong, right) = after(0.3 + 0.5 * n as f64, n, |sea| {
                sea.iter_mut().for_each(|x| x.swap(i, j));
                sea[SILENT - FROM..].iter_mut().for_each(|x| x[silent] = 0.0);
            });
            assert_eq!(codes, [FaultCode::Inconsistent, FaultCode::DeadChannel], "{n} {silent}");
            assert!(wrong == 0 && right <= 1, "{n} {silent}: {wrong} {right}");
        }
    }
}

#[test]
fn three_hydrophones_without_the_late_one_are_right_and_with_it_say_how_far_they_may_be_off() {
    for n in 0..6u64 {
        let late = n as usize % CHANNELS;
        for silent in [late, (late + 1) % CHANNELS] {
            let (codes, wrong, _) = after(0.5 * n as f64, n, |sea| {
                for i in (1..sea.len()).rev() {
                    sea[i][late] = sea[i - 1][late];
                }
                sea[SILENT - FROM..].iter_mut().for_each(|x| x[silent] = 0.0);
            });
            assert!(codes.contains(&FaultCode::DeadChannel) && wrong == 0, "{n} {silent}: {codes:?} {wrong}");
        }
    }
}

#[test]
fn exchanged_channels_are_noticed_of_a_vessel_that_was_heard_for_a_second() {
    for n in 0..12u64 {
        let (i, j) = PAIRS[n as usize % PAIRS.len()];
        let swap = |sea: &mut [[f64; CHANNELS]]| sea.iter_mut().for_each(|x| x.swap(i, j));
        let (codes, wrong, right) = after_of(FROM - RATE as usize, 0.3 + 0.5 * n as f64, n, swap);
        assert_eq!(codes, std::vec![FaultCode::Inconsistent], "{n}");
        // One may be told of the segment in which they are exchanged.
        assert!(wrong <= 1 && right == 0, "{n}: {wrong} {right}");
    }
}

#[test]
fn another_vessel_that_follows_one_heard_for_a_second_is_no_change() {
    let plan = plan();
    let mut feigned = 0;
    for n in 0..12u64 {
        let mut sea = passing(&plan, n as f64, n);
        let other = passing(&plan, n as f64 + 0.4 + 0.37 * n as f64, n + 50);
        sea[FROM..].copy_from_slice(&other[FROM..]);
        let heard = hear(&plan, &sea[FROM - RATE as usize..]);
        let codes: Vec<_> = heard.faults.iter().map(|f| f.0).filter(|f| *f != FaultCode::Impulses).collect();
        feigned += usize::from(!codes.is_empty());
    }
    // Of six places to which exchanged channels would move it, each some degrees wide, one is another vessel's by chance.
    assert!(feigned <= 1, "{feigned}");
}

#[test]
fn another_vessel_is_no_change_of_channels() {
    let plan = plan();
    for n in 0..6u64 {
        let mut sea = passing(&plan, n as f64, n);
        let other = passing(&plan, n as f64 + 0.4 + 0.3 * n as f64, n + 50);
        sea[FROM..].copy_from_slice(&other[FROM..]);
        let heard = hear(&plan, &sea);
        let codes: Vec<_> = heard.faults.iter().map(|f| f.0).filter(|f| *f != FaultCode::Impulses).collect();
        assert!(codes.is_empty(), "{n}: {codes:?}");
        let later = heard.bearings.iter().filter(|b| b.band == 0 && b.index as usize > FROM + 16_000).count();
        assert!(later > 14, "{n}: {later}");
    }
}

#[test]
fn vectors_are_the_directions_of_plane_waves_and_move_by_duals() {
    let plan = plan();
    let duals = duals(&plan);
    for n in 0..8 {
        let u = unit_vector(0.8 * n as f32, 0.3 * n as f32 - 1.0);
        let mut t = arrivals(&plan, &u);
        let off = difference(&vector(&plan, &duals, &t), &u);
        assert!(length(&off) < 1e-5, "{off:?}");
        let h = n % CHANNELS;
        t[h] += 1e-5;
        let moved = difference(&vector(&plan, &duals, &t), &u);
        let expected = duals[h].map(|x| -1e-5 / plan.inv_c * x);
        assert!(length(&difference(&moved, &expected)) < 1e-5, "{moved:?} {expected:?}");
    }
}
