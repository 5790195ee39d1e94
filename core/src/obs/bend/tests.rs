use super::*;
use crate::obs::presence::{RangeMode, RangePresence};
use crate::obs::tonal::{Directions, Mode};
use std::vec::Vec;

/// What a vessel at a place, with a velocity, shows in a minute.
fn minute(
    n: u32,
    (x, y): (f64, f64),
    (vx, vy): (f64, f64),
    off_rad: f64,
    normal: &mut impl FnMut() -> f64,
) -> Minute {
    let r = math::f64::hypot(x, y);
    let mut directions =
        Directions { modes: [None; 3], log_presence: 20.0, log_below: f32::NEG_INFINITY, frames: 17 };
    directions.modes[0] = Some(Mode {
        azimuth: (math::f64::atan2(x, y) + off_rad + 0.03 * normal()) as f32,
        sd: 0.022,
        log_presence: 20.0,
        bins: 5,
        step: 0,
        impulsive: false,
        moved: None,
    });
    let mut modes = [None; 4];
    modes[0] = (r < 45_000.0).then(|| RangeMode {
        range_m: (r + 90.0 * normal()) as f32,
        sd_range_m: 80.0,
        speed_m_s: ((x * vx + y * vy) / r + 0.5 * normal()) as f32,
        sd_speed_m_s: 0.3,
        weight: 0.9,
        support: 10.0,
        detected: true,
        tracked: false,
        sure: true,
    });
    let ranges = RangePresence { log_odds: 5.0, log_evidence: 5.0, approaching: 0.5, modes };
    Minute::new(n, &directions, &ranges)
}

/// A vessel that turns by 17° within four hours; what it shows each minute, with errors of the stated size, and more than 55 km
/// west directions that are off by so much.
fn seen(off_rad: f64) -> (Vec<Minute>, Course) {
    let (mut x, mut y, mut heading) = (-60_000.0f64, 6_000.0f64, 1.35f64);
    let (mut seed, mut out) = (5u32, Vec::new());
    let mut closest = Course { t0_s: 0.0, p: [x, y, 0.0, 0.0] };
    let mut normal = || {
        (0..12).fold(-6.0, |sum, _| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum + f64::from(seed >> 8) / 16_777_216.0
        })
    };
    for n in 1..=240u32 {
        heading += 0.3 / 240.0;
        let (vx, vy) = (8.0 * math::f64::sin(heading), 8.0 * math::f64::cos(heading));
        (x, y) = (x + 60.0 * vx, y + 60.0 * vy);
        if math::f64::hypot(x, y) < math::f64::hypot(closest.p[0], closest.p[1]) {
            closest = Course { t0_s: 60.0 * f64::from(n), p: [x, y, vx, vy] };
        }
        let off = if x < -55_000.0 { off_rad } else { 0.0 };
        out.push(minute(n, (x, y), (vx, vy), off, &mut normal));
    }
    (out, closest)
}

#[test]
fn where_a_vessel_is_now_is_told_of_a_way_that_bends() {
    let (minutes, ..) = seen(0.0);
    let start = Course { t0_s: 0.0, p: [-60_000.0, 6_000.0, 8.0, 0.5] };
    let (straight, of_straight) =
        super::super::fit::refine(&start, &TravelTime::EMPTY, 60.0, minutes.iter().copied()).unwrap();
    let (mut x, mut y, mut heading) = (-60_000.0f64, 6_000.0f64, 1.35f64);
    for n in 1..=240u32 {
        heading += 0.3 / 240.0;
        x += 480.0 * math::f64::sin(heading);
        y += 480.0 * math::f64::cos(heading);
        if n < 180 || n % 30 != 0 {
            continue;
        }
        let heard = || minutes.iter().copied().take(n as usize);
        let t_s = 60.0 * f64::from(n);
        let off = |course: &Course, covariance: &CourseCovariance| {
            let (east, north) = course.at(t_s);
            let (xx, yy, xy) = course.place_covariance(covariance, t_s);
            let (dx, dy) = (x - east, y - north);
            (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
        };
        let (now, of_now) = present(&straight, &TravelTime::EMPTY, 60.0, heard()).unwrap();
        assert!(off(&now, &of_now) < 9.0, "{n}: {}", off(&now, &of_now));
        assert!(off(&now, &of_now) < off(&straight, &of_straight), "{n}");
    }
}

/// Straight for three hours, then 3.4 degrees in one, while it is not ranged any more.
#[test]
fn a_vessel_that_turns_after_hours_is_followed() {
    let (mut x, mut y, mut heading) = (-60_000.0f64, 9_000.0f64, 1.5f64);
    let mut seed = 7u32;
    let mut normal = || {
        (0..12).fold(-6.0, |sum, _| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum + f64::from(seed >> 8) / 16_777_216.0
        })
    };
    let mut minutes = Vec::new();
    for n in 1..=240u32 {
        heading += if n > 180 { 0.06 / 60.0 } else { 0.0 };
        let (vx, vy) = (8.0 * math::f64::sin(heading), 8.0 * math::f64::cos(heading));
        (x, y) = (x + 60.0 * vx, y + 60.0 * vy);
        minutes.push(minute(n, (x, y), (vx, vy), 0.0, &mut normal));
    }
    let straight = Course { t0_s: 0.0, p: [-60_000.0, 9_000.0, 8.0 * 0.9975, 8.0 * 0.0707] };
    let (now, of_now) = present(&straight, &TravelTime::EMPTY, 60.0, minutes.iter().copied()).unwrap();
    let (east, north) = now.at(14_400.0);
    let (xx, yy, xy) = now.place_covariance(&of_now, 14_400.0);
    let (dx, dy) = (x - east, y - north);
    let off = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
    assert!(off < 9.0, "{dx} m east, {dy} m north: {off}");
}

#[test]
fn what_is_hardly_this_vessel_s_does_not_make_its_place_known() {
    let course = Course { t0_s: 0.0, p: [0.0, 40_000.0, 0.0, -6.0] };
    let told = |chance: f64| {
        let mut filter = Filter::new(&course, DRIFTS[0], 0.0);
        filter.observe(&[0.0, 1.0, 0.0, 0.0], 2_500.0, 80.0 * 80.0, chance);
        (filter.p[1] - 40_000.0, math::f64::sqrt(filter.covariance[1][1]))
    };
    // Of two answers 2.5 km apart, one 2 km wide and one 80 m, neither is known well.
    let ((moved, sd), (sure, close)) = (told(0.5), told(1.0));
    assert!((moved - 1_250.0).abs() < 5.0 && sd > 1_500.0, "{moved} ± {sd}");
    assert!((sure - 2_500.0).abs() < 5.0 && (close - 80.0).abs() < 1.0, "{sure} ± {close}");
}

#[test]
fn what_is_seen_where_it_is_not_heard_says_nothing_of_where_it_passes() {
    // Farther than 60 km for the first 40 minutes.
    let course = Course { t0_s: 0.0, p: [-80_000.0, 6_000.0, 8.0, 0.5] };
    let told = |off_rad: f64| {
        let (minutes, _) = seen(off_rad);
        let (before, after) = (minutes.iter().copied(), minutes.iter().rev().copied());
        about_closest(&course, &TravelTime::EMPTY, 60.0, before, after).unwrap()
    };
    assert_eq!(told(0.0), told(0.06));
}

#[test]
fn a_way_that_bends_is_known_where_it_passes() {
    let (minutes, want) = seen(0.0);
    let travel = TravelTime::EMPTY;
    let start = Course { t0_s: 0.0, p: [-60_000.0, 6_000.0, 8.0, 0.5] };
    let (straight, _) = super::super::fit::refine(&start, &travel, 60.0, minutes.iter().copied()).unwrap();
    let error = |c: &Course| {
        let (k, _) = c.closest(&[[0.0; N]; N]).unwrap();
        let (w, _) = want.closest(&[[0.0; N]; N]).unwrap();
        [
            k.time_s - w.time_s,
            math::f64::abs(k.range_m) - math::f64::abs(w.range_m),
            wrap_pi(k.heading - w.heading),
            k.speed_m_s - w.speed_m_s,
        ]
    };
    let (bent, covariance) =
        about_closest(&straight, &travel, 60.0, minutes.iter().copied(), minutes.iter().rev().copied())
            .unwrap();
    let (before, after) = (error(&straight), error(&bent));
    assert!(after[1].abs() < 0.5 * before[1].abs(), "{before:?} {after:?}");
    let (_, s) = bent.closest(&covariance).unwrap();
    for k in 0..N {
        let sd = math::f64::sqrt(s[k][k]);
        assert!(after[k].abs() < 3.0 * sd, "{k}: {} ± {sd}", after[k]);
    }
}
