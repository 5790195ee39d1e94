//! The range posterior on made-up likelihoods: one vessel, and a weak one beside a strong one that is tracked.

use super::cepstrum::noise_sd;
use super::interference::Interference;
use super::limits::{CELL_M, QUEFRENCIES, RANGE_CELLS, RANGE_STEP_M, SPEEDS};
use super::presence::{Expected, ExpectedVessels, Presence, RangeMode, RangePresence};
use super::radial::{RadialScratch, coded};
use super::shared::{Grid, Shared};
use super::table::{Table, blob_bytes};
use super::table_encode::{BranchColumns, Header, encode};
use std::boxed::Box;
use std::vec;
use std::vec::Vec;

/// Six frames that say nothing of where in its cell a vessel is.
fn six() -> Box<RadialScratch> {
    let mut radial = Box::new(RadialScratch::new());
    radial.frames = 6;
    radial
}

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
    let mut work = Box::new([[0.0; RANGE_CELLS]; 4]);
    presence.start(MOST_M);
    let mut last = presence.blind();
    for minute in 0..30 {
        let t = 60.0 * minute as f32;
        let (strong_m, weak_m) = (12_000.0 + 6.0 * t, 40_000.0 - 5.0 * t);
        let mut known = ExpectedVessels::default();
        if tracked && minute >= 10 {
            known[0] = Some(Expected {
                range_m: strong_m,
                speed_m_s: 6.0,
                established: true,
                strong: true,
                placed: true,
            });
        }
        presence.predict(&mut work);
        presence.claim(&model, &known);
        last = presence.update(&grid(&[(strong_m, 6.0, 40.0), (weak_m, -5.0, 8.0)]), &model, &six());
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

/// Cells that a table shows a vessel in begin here (7 km).
const SHOWN: usize = 50;

/// A table whose one branch is too weak to show a vessel nearer than that.
fn weak_near() -> Vec<u8> {
    let delay: Vec<f32> = (0..716).map(|j| 4.5 - 0.004 * j as f32).collect();
    let strength: Vec<f32> = (0..716).map(|j| if j < 2 * SHOWN { 0.005 } else { 0.06 }).collect();
    let c = BranchColumns { delay_s: &delay, phase_rad: &[0.0; 716], strength: &strength };
    let mut out = vec![0; blob_bytes(1)];
    let header = Header { step_m: RANGE_STEP_M, f0_hz: 16.5, width_s: 0.05 };
    encode(&header, 50.0, &[4.0; 716], &[c], &mut out).unwrap();
    out
}

/// An hour of cepstra of noise, six a minute.
fn noise(model: &Interference<'_>, presence: &mut Presence, mut seed: u32) -> RangePresence {
    let (mut radial, mut shared) = (Box::new(RadialScratch::new()), Box::new(Shared::new()));
    let mut last = presence.blind();
    for _ in 0..60 {
        presence.predict(shared.columns());
        radial.clear();
        for frame in 0..6 {
            let cepstrum = (0..QUEFRENCIES).map(|k| {
                let mut sum = 0.0;
                for _ in 0..12 {
                    seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    sum += (seed >> 8) as f32 / 16_777_216.0;
                }
                (sum - 6.0) * noise_sd(k.max(1))
            });
            radial.add(model, shared.envelope(), cepstrum, 10.0 * frame as f32 - 25.0);
        }
        radial.fill(shared.grid());
        last = presence.update(shared.grid(), model, &radial);
    }
    last
}

/// Log ratios that noise gives where vessels of the model would show, and in one place those of a vessel.
fn shown(model: &Interference<'_>, range_m: f32, height: f32) -> Box<Grid> {
    let mut out = Box::new([[0; RANGE_CELLS]; SPEEDS]);
    for row in out.iter_mut() {
        row.iter_mut().enumerate().for_each(|(i, g)| *g = coded(-model.energy(i, 6)));
    }
    out[SPEEDS / 2][(range_m / CELL_M) as usize] = coded(height);
    out
}

#[test]
fn noise_says_nothing_and_hides_no_vessel_that_comes_after_it() {
    let bytes = weak_near();
    let model = Interference::new(&Table::parse(&bytes).unwrap());
    let mut work = Box::new([[0.0; RANGE_CELLS]; 4]);
    let mut believed = 0.0;
    for seed in 1..=6 {
        let mut presence = Box::new(Presence::new());
        presence.start(MOST_M);
        let last = noise(&model, &mut presence, seed);
        let said = last.modes.iter().flatten().filter(|m| m.detected && m.sure);
        assert!(said.count() == 0, "seed {seed}: {last:?}");
        believed += 1.0 / (1.0 + (-last.log_odds).exp());
        // What noise has gathered where the model shows nothing is no more than can be undone in minutes.
        let mut last = presence.blind();
        for _ in 0..3 {
            presence.predict(&mut work);
            last = presence.update(&shown(&model, 20_000.0, 20.0), &model, &six());
        }
        let first = last.modes[0].unwrap();
        assert!((first.range_m - 20_000.0).abs() < 500.0 && first.weight > 0.9, "seed {seed}: {last:?}");
        assert!(first.detected && first.sure, "seed {seed}: {last:?}");
    }
    // A weak vessel that may be there is not excluded, but no more than that: as likely as where nothing is heard at all.
    assert!(believed / 6.0 < 0.5, "{believed} of 6");
}

#[test]
fn no_range_is_reported_where_the_model_shows_nothing() {
    let bytes = weak_near();
    let model = Interference::new(&Table::parse(&bytes).unwrap());
    let mut work = Box::new([[0.0; RANGE_CELLS]; 4]);
    let mut ranges = |range_m: f32| {
        let mut presence = Box::new(Presence::new());
        presence.start(MOST_M);
        let mut last = presence.blind();
        for _ in 0..10 {
            presence.predict(&mut work);
            last = presence.update(&shown(&model, range_m, 20.0), &model, &six());
        }
        last.modes.iter().flatten().count()
    };
    assert_eq!((ranges(5_500.0), ranges(9_500.0)), (0, 1));
}

/// A vessel at a share of the table's strengths, in noise, for 20 minutes: the last that was said of it.
fn at_share(share: f32) -> RangePresence {
    let bytes = weak_near();
    let model = Interference::new(&Table::parse(&bytes).unwrap());
    let mut work = Box::new([[0.0; RANGE_CELLS]; 4]);
    let mut presence = Box::new(Presence::new());
    presence.start(MOST_M);
    let mut last = presence.blind();
    let energy = model.energy((20_000.0 / CELL_M) as usize, 6);
    for _ in 0..20 {
        presence.predict(&mut work);
        // ⟨y, μ⟩ = 2 a E, less E.
        last = presence.update(&shown(&model, 20_000.0, (2.0 * share - 1.0) * energy), &model, &six());
    }
    last
}

#[test]
fn a_weak_vessel_is_found_but_its_range_is_not_sure() {
    for (share, sure) in [(1.0, true), (0.9, true), (0.5, false), (0.45, false)] {
        let last = at_share(share);
        let first = last.modes[0].unwrap_or_else(|| panic!("{share}: {last:?}"));
        assert!((first.range_m - 20_000.0).abs() < 500.0 && first.weight > 0.9, "{share}: {last:?}");
        assert_eq!((first.detected, first.sure), (true, sure), "{share}: {last:?}");
    }
    assert!(at_share(0.0).modes.iter().all(Option::is_none));
}

#[test]
fn a_loud_vessel_s_echoes_count_at_their_own_strengths() {
    let energy = 0.5;
    let at = |share: f32| Presence::log_ratio_of_a_strong_vessel((2.0 * share - 1.0) * energy, energy);
    // At the table's strengths as ever; at two and a half times them what these make of it, less what not knowing them costs.
    assert!((at(1.0) - 0.96 * energy).abs() < 1e-5, "{}", at(1.0));
    assert!((at(2.5) - (6.25 * energy - 1.0)).abs() < 1e-5, "{}", at(2.5));
    assert!(at(10.0) < 20.0 * 3.0 * energy, "{}", at(10.0));
    // Silence and what has the other sign say no more against it than before.
    assert!((at(0.0) + 0.64 * energy).abs() < 1e-5, "{}", at(0.0));
    assert!(Presence::log_ratio_of_a_strong_vessel(-1.0, 0.0).is_finite());
    assert!(Presence::log_ratio_of_a_strong_vessel(1.0, 0.0).is_finite());
}

#[test]
fn what_stands_still_or_is_too_fast_is_a_vessels_only_where_a_track_expects_it() {
    let kept = |speeds: [f32; 4], expected: &ExpectedVessels| {
        let mut last = run(false);
        let first = last.modes[0].unwrap();
        last.modes = speeds.map(|speed_m_s| Some(RangeMode { speed_m_s, ..first }));
        last.without_odd_speeds(expected);
        last.modes.map(|m| m.is_some())
    };
    let speeds = [0.4, -13.0, 5.0, -5.0];
    assert_eq!(kept(speeds, &ExpectedVessels::default()), [false, false, true, true]);
    let mut expected = ExpectedVessels::default();
    expected[1] = Some(Expected {
        range_m: 22_500.0,
        speed_m_s: 0.0,
        established: false,
        strong: false,
        placed: false,
    });
    assert_eq!(kept(speeds, &expected), [true, false, true, true]);
    // What stands still beside a vessel that moves is not that.
    expected[1] = expected[1].map(|e| Expected { speed_m_s: 3.0, ..e });
    assert_eq!(kept(speeds, &expected), [false, false, true, true]);
}

/// A table of two pairs of paths, the second with the delays that the first has at half the range.
pub(super) fn two_pairs() -> Vec<u8> {
    let first: Vec<f32> = (0..716).map(|j| 4.5 - 0.004 * j as f32).collect();
    let second: Vec<f32> = (0..716).map(|j| 4.5 - 0.002 * j as f32).collect();
    let strength = [0.06f32; 716];
    let c = [&first, &second].map(|delay_s| BranchColumns {
        delay_s,
        phase_rad: &[0.0; 716],
        strength: &strength,
    });
    let mut out = vec![0; blob_bytes(2)];
    let header = Header { step_m: RANGE_STEP_M, f0_hz: 16.5, width_s: 0.05 };
    encode(&header, 50.0, &[4.0; 716], &c, &mut out).unwrap();
    out
}

#[test]
fn an_echo_moves_along_with_its_vessel() {
    let bytes = two_pairs();
    let model = Interference::new(&Table::parse(&bytes).unwrap());
    // The first pair's echo at 11 km, read as the second pair's of a vessel twice as far.
    assert!(model.follows((22_000.0, 8.0), (11_000.0, 4.0)));
    assert!(model.doubtful(22_000.0, 11_000.0) && !model.follows((22_000.0, -4.0), (11_000.0, 4.0)));
    assert!(!model.follows((26_000.0, 8.0), (11_000.0, 4.0)));

    let modes_left = |own_weight: f32, speed_m_s: f32| {
        let mut last = run(false);
        let first = RangeMode { sure: true, ..last.modes[0].unwrap() };
        last.modes = [None; 4];
        last.modes[0] = Some(RangeMode { range_m: 11_000.0, speed_m_s: 4.0, weight: own_weight, ..first });
        last.modes[1] = Some(RangeMode { range_m: 22_000.0, speed_m_s, weight: 1.0, ..first });
        let mut known = ExpectedVessels::default();
        known[0] = Some(Expected {
            range_m: 11_000.0,
            speed_m_s: 4.0,
            established: true,
            strong: true,
            placed: true,
        });
        last.without_echoes(&model, &known);
        last.modes.iter().flatten().count()
    };
    assert_eq!((modes_left(1.0, 8.0), modes_left(1.0, -4.0)), (1, 2));
    // A vessel that does not show itself may be the one that is read wrongly.
    assert_eq!(modes_left(0.1, 8.0), 2);
}

#[test]
fn a_track_whose_echoes_are_those_of_a_truer_mode_does_not_show() {
    let bytes = two_pairs();
    let model = Interference::new(&Table::parse(&bytes).unwrap());
    // A track at half the range of the vessel whose echoes it has; and both half as far, where a vessel's own echoes look so.
    let ranges_left = |range_m: f32, more: f32| {
        let mut last = run(false);
        let first = RangeMode { sure: true, weight: 1.0, support: 40.0, ..last.modes[0].unwrap() };
        last.modes = [None; 4];
        last.modes[0] = Some(RangeMode { range_m, speed_m_s: 1.5, ..first });
        let twice = RangeMode { range_m: 2.0 * range_m, speed_m_s: 3.0, support: 40.0 + more, ..first };
        last.modes[1] = Some(twice);
        let mut known = ExpectedVessels::default();
        known[0] = Some(Expected { range_m, speed_m_s: 1.5, established: true, strong: true, placed: false });
        last.without_echoes(&model, &known);
        last.modes.map(|m| m.map_or(0.0, |m| m.range_m))
    };
    assert_eq!(ranges_left(24_000.0, 70.0), [0.0, 48_000.0, 0.0, 0.0]);
    assert_eq!(ranges_left(24_000.0, 4.0), [24_000.0, 0.0, 0.0, 0.0]);
    assert_eq!(ranges_left(10_500.0, 70.0), [10_500.0, 0.0, 0.0, 0.0]);
}

#[test]
fn a_range_that_a_vessel_elsewhere_may_be_read_at_is_sure_where_a_placed_track_expects_it() {
    let sure = |range_m: f32, speed_m_s: f32, track: Option<bool>| {
        let mut last = run(false);
        let first = last.modes[0].unwrap();
        last.modes = [None; 4];
        last.modes[0] = Some(RangeMode { range_m, speed_m_s, sure: true, ..first });
        let mut known = ExpectedVessels::default();
        known[0] =
            track.map(|placed| Expected { range_m, speed_m_s, established: true, strong: true, placed });
        last.prefer(&Interference::EMPTY, &known);
        last.modes[0].unwrap().sure
    };
    // Of a vessel beyond the model's end, unless that would be too fast; of one half as far; of one 80 km away.
    assert!(!sure(30_000.0, 4.0, None) && !sure(42_000.0, -6.0, None) && sure(30_000.0, 10.0, None));
    assert!(!sure(20_000.0, 4.0, None) && sure(12_000.0, 4.0, None));
    assert!(!sure(7_500.0, -1.5, None) && sure(7_500.0, -1.5, Some(false)));
    for range_m in [7_500.0, 20_000.0, 30_000.0] {
        assert!(sure(range_m, 4.0, Some(true)), "{range_m}");
    }
    assert!(!sure(30_000.0, 4.0, Some(false)));
}
