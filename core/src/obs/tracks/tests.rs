use super::*;
use crate::angle::wrap_pi;
use crate::obs::course::{N, Seen};
use crate::obs::interference::Interference;
use crate::obs::presence::{RangeMode, RangePresence};
use crate::obs::presence_tests::two_pairs;
use crate::obs::table::Table;
use crate::obs::tonal::{Directions, Mode};
use crate::obs::travel::TravelTime;
use crate::wire::Track;
use std::boxed::Box;
use std::vec::Vec;

/// East, North and velocity at time 0.
const VESSELS: [[f64; 4]; 2] = [[-30_000.0, 8_000.0, 5.0, 0.5], [12_000.0, -25_000.0, -0.5, 4.5]];

/// No ranges.
pub(super) const NO_RANGES: RangePresence =
    RangePresence { log_odds: 5.0, log_evidence: 5.0, approaching: 0.5, modes: [None; 4] };

/// The directions of two vessels.
pub(super) fn directions(seen: [&Seen; 2]) -> Directions {
    let mut out =
        Directions { modes: [None; 3], log_presence: 20.0, log_below: f32::NEG_INFINITY, frames: 17 };
    for (slot, s) in out.modes.iter_mut().zip(seen) {
        let azimuth = s.azimuth() as f32;
        *slot = Some(Mode {
            azimuth,
            sd: 0.02,
            log_presence: 20.0,
            bins: 5,
            step: 0,
            impulsive: false,
            moved: None,
        });
    }
    out
}

/// A range.
pub(super) fn mode(range_m: f64, speed_m_s: f64) -> Option<RangeMode> {
    Some(RangeMode {
        range_m: range_m as f32,
        sd_range_m: 80.0,
        speed_m_s: speed_m_s as f32,
        sd_speed_m_s: 0.4,
        weight: 0.5,
        support: 10.0,
        detected: true,
        tracked: false,
        sure: true,
    })
}

/// What both vessels show in a minute: directions always, the range of one of them in turn, and a false range.
fn minute(n: u32) -> Minute {
    let jitter = |k: u32| (f64::from((n * 7919 + k * 104_729) % 1000) / 500.0 - 1.0) as f32;
    let seen = VESSELS.map(|p| Course { t0_s: 0.0, p }.seen(&TravelTime::EMPTY, STEP_S * f64::from(n)));
    let mut directions = directions([&seen[0], &seen[1]]);
    for (k, m) in directions.modes.iter_mut().flatten().enumerate() {
        m.azimuth += 0.02 * jitter(k as u32);
    }
    let mut modes = [None; 4];
    let own = &seen[(n / 3 % 2) as usize];
    modes[0] = mode(own.range_m + f64::from(60.0 * jitter(2)), own.speed_m_s + f64::from(0.3 * jitter(3)));
    // The same echo read as another pair of paths: twice the range at twice the speed.
    modes[1] = mode(2.0 * own.range_m, 2.0 * own.speed_m_s + f64::from(jitter(4)));
    Minute::new(n, &directions, &RangePresence { modes, ..NO_RANGES })
}

#[test]
fn two_vessels_end_as_two_tracks() {
    let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
    let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
    let mut said = Vec::new();
    let mut sink = |m: Message| {
        if let Message::Track(t) = m {
            said.push(t);
        }
    };
    for n in 1..=180 {
        evidence.push(minute(n));
        tracker.minute(&plan, &mut evidence, n, &mut sink);
    }
    tracker.finish(&plan, &evidence, 180, &mut sink);
    let last: Vec<_> = said.iter().filter(|t| t.stage == 1).collect();
    for p in VESSELS {
        let (want, _) = Course { t0_s: 0.0, p }.closest(&[[0.0; N]; N]).unwrap();
        let own = |t: &&&Track| {
            (f64::from(t.speed_m_s) - want.speed_m_s).abs() < 0.1
                && wrap_pi(f64::from(t.heading) - want.heading).abs() < 0.02
                && (f64::from(t.cpa_range_m) - want.range_m.abs()).abs() < 150.0
                && (t.cpa_time_s - want.time_s).abs() < 30.0
        };
        assert_eq!(last.iter().filter(own).count(), 1, "{want:?}: {last:?}");
    }
}

#[test]
fn directions_alone_are_no_vessel() {
    let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
    let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
    let mut said = 0;
    for n in 1..=120 {
        evidence.push(minute(n).without(|_| false, |_| true));
        tracker.minute(&plan, &mut evidence, n, &mut |_| said += 1);
    }
    tracker.finish(&plan, &evidence, 120, &mut |_| said += 1);
    assert_eq!(said, 0);
}

/// A vessel that shows direction and range, the range as another pair of paths has it too and as if that were the likelier; and where another
/// shows direction alone, on the course that has those ranges.
fn with_echoes(n: u32) -> Minute {
    let vessel = [-7_000.0, 9_500.0, 3.5, 0.5];
    let seen = |p: [f64; 4]| Course { t0_s: 0.0, p }.seen(&TravelTime::EMPTY, STEP_S * f64::from(n));
    let [x, y, vx, vy] = vessel.map(|v| 2.0 * v);
    let (own, other) = (seen(vessel), seen([y, -x, vy, -vx]));
    let mut minute = Minute::new(n, &directions([&own, &other]), &NO_RANGES);
    if n.is_multiple_of(2) {
        let modes = [mode(own.range_m, own.speed_m_s), mode(other.range_m, other.speed_m_s), None, None];
        minute = Minute::new(n, &directions([&own, &other]), &RangePresence { modes, ..NO_RANGES });
    }
    minute
}

#[test]
fn one_vessel_s_directions_and_another_s_echoes_are_no_vessel() {
    let bytes = two_pairs();
    let interference = Interference::new(&Table::parse(&bytes).unwrap());
    for (interference, vessels) in [(Interference::EMPTY, 2), (interference, 1)] {
        let plan = Box::new(Plan { rate_hz: 50.0, interference, ..Plan::EMPTY });
        let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
        for n in 1..=120 {
            evidence.push(with_echoes(n));
            tracker.minute(&plan, &mut evidence, n, &mut |_| {});
        }
        let mut finals = 0;
        tracker.finish(&plan, &evidence, 120, &mut |m| {
            finals += u32::from(matches!(m, Message::Track(t) if t.stage == Track::FINAL));
        });
        // Without a table nothing is known of pairs of paths, and it is one.
        assert_eq!(finals, vessels);
    }
}

/// A track of the vessel `p` that was reported and explains nothing of the evidence.
fn reported_and_wrong(p: [f64; 4], from: u32, to: u32) -> Live {
    let covariance = core::array::from_fn(|i| core::array::from_fn(|j| if i == j { 1.0 } else { 0.0 }));
    let score = Score { log: 100.0, directions: 20, distances: 20, both: 20, ..Score::default() };
    {
        let course = Course { t0_s: 0.0, p };
        Live { id: 7, course, covariance, now: course, score, from, to, sent: 1 }
    }
}

#[test]
fn a_track_that_was_reported_and_is_no_vessel_s_is_withdrawn() {
    let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
    for at_the_end in [false, true] {
        let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
        for n in 1..=60 {
            evidence.push(minute(n).without(|_| true, |_| true));
        }
        tracker.live[1] = Some(reported_and_wrong(VESSELS[0], 1, 60));
        let mut said = Vec::new();
        let mut sink = |m: Message| {
            if let Message::Track(t) = m {
                said.push((t.id, t.stage, t.range_observable));
            }
        };
        if at_the_end {
            tracker.finish(&plan, &evidence, 60, &mut sink);
        } else {
            tracker.minute(&plan, &mut evidence, 60, &mut sink);
        }
        assert_eq!(said, [(7, Track::WITHDRAWN, false)]);
    }
}

#[test]
fn tracks_state_two_thirds_of_their_range_while_pairs_of_paths_are_in_doubt() {
    let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
    let finals = |in_doubt: bool, minutes: u32| -> Vec<Track> {
        let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
        tracker.pairs_in_doubt = in_doubt;
        let mut said = Vec::new();
        for n in 1..=minutes {
            evidence.push(minute(n));
            tracker.minute(&plan, &mut evidence, n, &mut |_| {});
        }
        tracker.finish(&plan, &evidence, minutes, &mut |m| {
            if let Message::Track(t) = m {
                said.push(t);
            }
        });
        said
    };
    let (sure, doubted) = (finals(false, 180), finals(true, 180));
    assert_eq!((sure.len(), doubted.len()), (2, 2));
    // Of fewer minutes with direction and range than make a track established it may be no vessel's, and is not told as final.
    let finals_of = |track: Vec<Track>| track.iter().filter(|t| t.stage == Track::FINAL).count();
    assert_eq!((finals_of(finals(false, 39)), finals_of(finals(true, 39))), (2, 0));
    for (sure, doubted) in sure.iter().zip(&doubted) {
        assert!(sure.sd_cpa_range_m < 0.1 * sure.cpa_range_m, "{sure:?}");
        assert!(doubted.sd_cpa_range_m >= 0.67 * sure.cpa_range_m, "{doubted:?}");
        assert!(doubted.sd_speed_m_s >= 0.67 * sure.speed_m_s, "{doubted:?}");
        // What is stated is wider, and nothing else: the course, its heading and its closest time are the same.
        assert_eq!((doubted.cpa_range_m, doubted.heading), (sure.cpa_range_m, sure.heading));
        assert!((doubted.sd_cpa_time_s - sure.sd_cpa_time_s).abs() < 0.1 * sure.sd_cpa_time_s + 0.1);
    }
}

/// A vessel of directions and of ranges of noise; in every second or every ninth minute a range lies on its course.
fn with_few_ranges(n: u32, own: bool) -> Minute {
    let seen = Course { t0_s: 0.0, p: VESSELS[0] }.seen(&TravelTime::EMPTY, STEP_S * f64::from(n));
    let mut modes = [None; 4];
    if n.is_multiple_of(if own { 2 } else { 9 }) {
        modes[0] = mode(seen.range_m, seen.speed_m_s);
    } else {
        let away = f64::from(n * 7919 % 1000) / 1000.0;
        modes[0] = mode(8_000.0 + 40_000.0 * away, 12.0 - 24.0 * away);
    }
    Minute::new(n, &directions([&seen, &seen]), &RangePresence { modes, ..NO_RANGES })
}

#[test]
fn directions_and_a_few_ranges_of_noise_are_no_vessel() {
    let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
    for (own, vessels) in [(false, 0), (true, 1)] {
        let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
        let mut finals = 0;
        for n in 1..=150 {
            evidence.push(with_few_ranges(n, own));
            tracker.minute(&plan, &mut evidence, n, &mut |_| {});
        }
        tracker.finish(&plan, &evidence, 150, &mut |m| {
            finals += u32::from(matches!(m, Message::Track(t) if t.stage == Track::FINAL));
        });
        assert_eq!(finals, vessels);
    }
}

#[test]
fn a_vessel_that_may_be_half_or_twice_as_far_says_so() {
    let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
    let evidence = Box::new(Evidence::new());
    let sd_m = |p: [f64; 4], span_m: (f32, f32)| {
        let mut live = reported_and_wrong(p, 1, 60);
        live.score.span_m = span_m;
        let seen = super::Seen {
            evidence: &evidence,
            others: Others { courses: [None; LIVE], echoes: [false; LIVE] },
            gone: &Gone::new(),
            in_doubt: false,
            lasting: &plan.lasting,
        };
        live.told(&plan, &seen, None, Track::FINAL).unwrap().sd_cpa_range_m
    };
    // 20 km away at 12 m/s, seen from 20 to 22 km or from 20 to 45 km; and 30 km away at 4 and 9 m/s.
    let (near, far) = ([0.0, 20_000.0, 12.0, 0.0], [0.0, 30_000.0, 4.0, 0.0]);
    assert!(sd_m(near, (20_000.0, 22_000.0)) > 9_000.0 && sd_m(near, (20_000.0, 45_000.0)) < 1_000.0);
    assert!(sd_m(far, (30_000.0, 45_000.0)) > 14_000.0);
    assert!(sd_m([0.0, 30_000.0, 9.0, 0.0], (30_000.0, 45_000.0)) < 1_000.0);
}

/// A vessel that hardly moves: for the first 50 minutes its echoes are read at twice the range and speed alone, then mostly as they are.
fn hardly_moving(n: u32) -> Minute {
    const SLOW: [f64; 4] = [-8_000.0, 6_000.0, 1.5, 0.0];
    let s = Course { t0_s: 0.0, p: SLOW }.seen(&TravelTime::EMPTY, STEP_S * f64::from(n));
    let mut modes = [None; 4];
    let own = if n <= 50 || n.is_multiple_of(5) { 2.0 } else { 1.0 };
    modes[0] = mode(own * s.range_m, own * s.speed_m_s);
    Minute::new(n, &directions([&s, &s]), &RangePresence { modes, ..NO_RANGES })
}

#[test]
fn a_vessel_that_hardly_moves_is_not_left_at_another_pair_of_paths() {
    let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
    let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
    let mut stages = Vec::new();
    let mut sink = |m: Message| {
        if let Message::Track(t) = m {
            stages.push(t.stage);
        }
    };
    for n in 1..=180 {
        evidence.push(hardly_moving(n));
        tracker.minute(&plan, &mut evidence, n, &mut sink);
    }
    tracker.finish(&plan, &evidence, 180, &mut sink);
    assert!(stages.contains(&Track::RUNNING) && stages.last() == Some(&Track::WITHDRAWN), "{stages:?}");
}

#[test]
fn a_track_that_falls_silent_before_its_closest_point_is_no_vessel_s() {
    let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
    // Its closest point is in minute 103.
    for (heard, want) in [(80, Track::WITHDRAWN), (100, Track::WITHDRAWN), (130, Track::FINAL)] {
        let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
        let mut last = None;
        for n in 1..=heard + 2 * SILENCE + EVERY {
            let minute = with_few_ranges(n, true);
            evidence.push(if n <= heard { minute } else { minute.without(|_| true, |_| true) });
            tracker.minute(&plan, &mut evidence, n, &mut |m| {
                if let Message::Track(t) = m {
                    last = Some(t.stage);
                }
            });
        }
        assert_eq!(last, Some(want), "{heard}");
        assert_eq!(
            tracker.gone.is_again(&Course { t0_s: 0.0, p: VESSELS[0] }, &plan.travel, [6e3; 2]),
            want == Track::FINAL
        );
    }
}

/// A vessel louder than the table's that comes from 70 km: beyond 46 km its echoes are read at half its range and speed.
const LOUD: [f64; 4] = [-70_000.0, 8_000.0, 6.0, 0.0];

fn loud(n: u32) -> (Minute, f64) {
    let s = Course { t0_s: 0.0, p: LOUD }.seen(&TravelTime::EMPTY, STEP_S * f64::from(n));
    let nearer = if s.range_m > 46_000.0 { 2.01 } else { 1.0 };
    let modes = [mode(s.range_m / nearer, s.speed_m_s / nearer), None, None, None];
    (Minute::new(n, &directions([&s, &s]), &RangePresence { modes, ..NO_RANGES }), s.range_m)
}

#[test]
fn a_vessel_read_at_half_its_range_is_where_it_is_once_it_comes_into_the_model() {
    let plan = Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY });
    let (mut tracker, mut evidence) = (Tracker::new(), Box::new(Evidence::new()));
    let mut expected = |minutes: core::ops::RangeInclusive<u32>| {
        let last = *minutes.end();
        for n in minutes {
            evidence.push(loud(n).0);
            tracker.minute(&plan, &mut evidence, n, &mut |_| {});
        }
        let known: Vec<_> = tracker.expected(&plan, last).into_iter().flatten().collect();
        assert_eq!(known.len(), 1, "{known:?}");
        (f64::from(known[0].range_m) / loud(last).1, known[0].established, known[0].placed)
    };
    // 48 km away, and 13 minutes after it has come within 46 km.
    let (part, established, placed) = expected(1..=60);
    assert!((part - 0.5).abs() < 0.01 && established && !placed, "{part} {established} {placed}");
    let (part, ..) = expected(61..=80);
    assert!((part - 1.0).abs() < 0.01, "{part}");
    // Near enough, it is no vessel twice as far.
    let (part, _, placed) = expected(81..=160);
    assert!((part - 1.0).abs() < 0.01 && placed, "{part} {placed}");
}

#[test]
fn a_slow_vessel_that_was_never_near_may_be_one_beyond_the_model() {
    let beyond = |times: f64, speed_m_s: f64, near: u16| {
        let mut live = reported_and_wrong([0.0, 30_000.0, speed_m_s, 0.0], 1, 60);
        live.score.near = near;
        live.may_be_beyond(times)
    };
    assert!(beyond(2.0, 4.0, 0) && beyond(2.0, 6.0, FEW_NEAR - 1));
    assert!(!beyond(2.0, 7.0, 0) && !beyond(2.0, 4.0, FEW_NEAR));
    // Half as far again it need not be as fast.
    assert!(beyond(1.5, 7.0, 0) && !beyond(1.5, 9.0, 0));
}

#[test]
fn a_course_found_again_is_known_by_both_its_ends() {
    let live = reported_and_wrong([0.0, 30_000.0, 5.0, 0.0], 0, 60);
    // The same with another time for reference, and 30 m off at its beginning.
    let at_3000_s = |vx: f64| Course { t0_s: 3000.0, p: [15_000.0, 30_000.0, vx, 0.0] };
    assert!(live.goes_along(&at_3000_s(5.0)) && !live.goes_along(&at_3000_s(5.01)));
    assert!(!live.goes_along(&live.course.times(1.5)));
}
