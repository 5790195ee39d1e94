//! The range posterior on made-up likelihoods: one vessel, and a weak one beside a strong one that is tracked.

use super::interference::Interference;
use super::limits::{CELL_M, RANGE_CELLS, RANGE_STEP_M, SPEEDS};
use super::presence::{Expected, Known, Presence, RangePresence};
use super::radial::coded;
use super::shared::Grid;
use std::boxed::Box;

/// Farthest range of the model, m.
const MOST_M: f32 = RANGE_STEP_M * 715.0;

/// Log ratios of `(range, radial speed, height)` in a grid that elsewhere says no.
fn grid(vessels: &[(f32, f32, f32)]) -> Box<Grid> {
    let mut out = Box::new([[coded(-1.0); RANGE_CELLS]; SPEEDS]);
    for (range_m, speed_m_s, height) in vessels {
        out[(speed_m_s + 13.5) as usize][(range_m / CELL_M) as usize] = coded(*height);
    }
    out
}

/// A strong vessel that leaves and a weak one that approaches, for 30 minutes; the strong one tracked after 10, or never.
fn run(tracked: bool) -> RangePresence {
    let (model, mut presence) = (Interference::EMPTY, Box::new(Presence::new()));
    let mut work = Box::new([[0.0; RANGE_CELLS]; 3]);
    presence.start(MOST_M);
    let mut last = presence.blind();
    for minute in 0..30 {
        let t = 60.0 * minute as f32;
        let (strong_m, weak_m) = (12_000.0 + 6.0 * t, 40_000.0 - 5.0 * t);
        let mut known = Known::default();
        if tracked && minute >= 10 {
            known[0] = Some(Expected { range_m: strong_m, speed_m_s: 6.0, established: true });
        }
        presence.predict(&mut work);
        presence.claim(&model, &known);
        last = presence.update(&grid(&[(strong_m, 6.0, 40.0), (weak_m, -5.0, 8.0)]));
    }
    last
}

#[test]
fn a_strong_vessel_that_is_tracked_leaves_the_weak_one_its_share() {
    let last = run(true);
    let near = |range_m: f32| {
        last.modes.iter().flatten().find(move |m| (m.range_m - range_m).abs() < 500.0).copied()
    };
    let (strong, weak) = (near(22_440.0).unwrap(), near(31_300.0).unwrap());
    assert!(strong.weight > 0.5 && strong.detected, "{strong:?}");
    assert!(weak.weight > 0.5 && weak.detected, "{weak:?}");
    assert!((weak.speed_m_s + 5.0).abs() < 0.7, "{weak:?}");
    assert!((0.3..0.7).contains(&last.approaching), "{last:?}");
}

#[test]
fn undivided_the_strong_one_takes_all() {
    let last = run(false);
    let first = last.modes[0].unwrap();
    assert!((first.range_m - 22_440.0).abs() < 500.0 && first.weight > 0.9, "{first:?}");
    assert!(last.modes.iter().skip(1).flatten().all(|m| m.weight < 0.01), "{last:?}");
}
